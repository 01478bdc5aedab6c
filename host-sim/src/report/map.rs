//! The map of a mission: area, users, sensors, waypoints, and the flown path coloured by the rate.

use super::{
    flown_path,
    ground::{Ground, north},
    slot_words,
};
use crate::record::{FlightRecord, SlotRecord};
use figures::{
    axis::{self, Key, LEFT, RIGHT, WIDTH, round_step},
    markup::{Element, PathData, circle, element, label, line, rectangle},
    placement::{Align, Placement, Spot},
    quantity::{self, plain, shortened, significant},
    theme,
};
use scenario::Scenario;

const USER_RADIUS: f64 = 5.0;
const LABEL_SIZE: f64 = 11.0;

/// Draws the map of a scenario, with the flight if there is one, and with a headline if the drawing
/// is a file of its own.
pub(super) fn draw(
    scenario: &Scenario,
    flight: Option<&FlightRecord>,
    headline: Option<[&str; 2]>,
) -> Element {
    let p = scenario.mission.parameters();
    let top = if headline.is_some() { 62.0 } else { 12.0 };
    let ground = Ground::new(scenario, flight, top);
    let bottom = top + ground.size[1];
    let (keys, foot) = foot(scenario, flight, &ground, bottom);

    let title = format!("Map of {}", scenario.name);
    let mut drawing = axis::figure(foot + 14.0, &title, &description(scenario, flight));
    if let Some([name, words]) = headline {
        drawing.push(theme::drawing_style());
        drawing.push(rectangle("paper", [0.0, 0.0], [WIDTH, foot + 14.0]));
        drawing.push(label("headline", [LEFT - 52.0, 27.0], shortened(name, 50)));
        drawing.push(label("byline", [LEFT - 52.0, 45.0], shortened(words, 76)));
    }
    drawing.push(ground.draw(scenario));

    let west = ground.corner[0];
    let mut placement = match ground.size.iter().all(|size| *size > 240.0) {
        true => Placement::within([west, top], [west + ground.size[0], bottom]),
        false => Placement::within([4.0, top], [WIDTH - 4.0, bottom]),
    };
    for user in &p.users {
        placement.take(ground.of(user), USER_RADIUS);
    }
    for sensor in &p.sensors {
        placement.take(ground.of(sensor), 2.5);
    }
    for end in [&p.start, &p.destination] {
        placement.take(ground.of(end), 7.0);
    }
    let mut slot_ends = Vec::new();
    if let Some(record) = flight {
        drawing.push(services(record, &ground));
        drawing.push(planned_path(record, &ground));
        drawing.push(flown_path::draw(record, &ground));
        for slot in &record.slots {
            placement.take(ground.of(&slot.flown), 3.0);
        }
        slot_ends = marks(record, &ground);
    }
    // Sensors may lie under the path; they are small and keep their outline.
    drawing.push(
        element("g").with_all(
            p.sensors
                .iter()
                .map(|sensor| sensor_mark(ground.of(sensor))),
        ),
    );
    drawing.push(element("g").with_all(slot_ends));
    drawing.push(labels(scenario, flight, &ground, &mut placement));
    if let Some(record) = flight {
        drawing.push(hover(record, &ground));
    }
    drawing.with(keys)
}

fn description(scenario: &Scenario, flight: Option<&FlightRecord>) -> String {
    let p = scenario.mission.parameters();
    let area = format!(
        "{} m by {} m, north up, {}, {}",
        plain(p.area.east_m),
        plain(p.area.north_m),
        quantity::count(p.users.len(), "user"),
        quantity::count(p.sensors.len(), "sensor"),
    );
    match flight {
        Some(record) => format!(
            "{area}; the path flown in {} by the policy {}, coloured by rate",
            quantity::count(record.slots.len(), "slot"),
            record.policy
        ),
        None => area,
    }
}

/// Draws a thin line from the vehicle's position to the served user in each slot.
fn services(record: &FlightRecord, ground: &Ground) -> Element {
    let users = &record.scenario.mission.parameters().users;
    let mut data = PathData::default();
    for slot in &record.slots {
        if let Some(user) = slot.served_user.and_then(|user| users.get(user)) {
            let [x, y] = ground.of(&slot.flown);
            data.move_to(x, y);
            let [x, y] = ground.of(user);
            data.line_to(x, y);
        }
    }
    // Hundreds of lines would hide the map.
    let opacity = (100.0 / record.slots.len().max(1) as f64).clamp(0.12, 1.0);
    data.path("service").at("stroke-opacity", opacity)
}

/// Draws the planned path from the start through the waypoints.
fn planned_path(record: &FlightRecord, ground: &Ground) -> Element {
    let start = record.scenario.mission.parameters().start;
    let places = std::iter::once(&start).chain(record.slots.iter().map(|slot| &slot.planned));
    PathData::through(places.map(|place| ground.of(place))).path("plan")
}

/// Draws a dot at the end of each slot if there is enough space, and a cross at the end of each
/// infeasible slot.
fn marks(record: &FlightRecord, ground: &Ground) -> Vec<Element> {
    let mut last: Option<[f64; 2]> = None;
    let mut marks = Vec::new();
    for slot in &record.slots {
        let [x, y] = ground.of(&slot.flown);
        if last.is_some_and(|[x0, y0]| (x - x0).hypot(y - y0) < 7.0) {
            continue;
        }
        last = Some([x, y]);
        marks.push(match slot.feasible {
            true => circle("stop", [x, y], 1.1),
            false => cross([x, y], 3.5),
        });
    }
    marks
}

/// Draws the marker of an infeasible slot.
pub(super) fn cross([x, y]: [f64; 2], size: f64) -> Element {
    let mut data = PathData::default();
    data.move_to(x - size, y - size);
    data.line_to(x + size, y + size);
    data.move_to(x - size, y + size);
    data.line_to(x + size, y - size);
    data.path("cross")
}

fn sensor_mark([x, y]: [f64; 2]) -> Element {
    let data = PathData::through([
        [x, y - 4.2],
        [x + 4.0, y + 3.0],
        [x - 4.0, y + 3.0],
        [x, y - 4.2],
    ]);
    data.path("sensor")
}

fn user_mark(place: [f64; 2]) -> Element {
    circle("user", place, USER_RADIUS)
}

/// Draws the labels of users, start and destination, and the numbers of some slots.
fn labels(
    scenario: &Scenario,
    flight: Option<&FlightRecord>,
    ground: &Ground,
    placement: &mut Placement,
) -> Element {
    let p = scenario.mission.parameters();
    let mut group = element("g");
    let mut write = |class: [&'static str; 3], spot: Spot, words: String| {
        let class = match spot.align {
            Align::Start => class[0],
            Align::Middle => class[1],
            Align::End => class[2],
        };
        group.push(label(class, spot.at, words));
    };
    let strong = ["place", "place middle", "place end"];
    for (place, words) in [(&p.start, "start"), (&p.destination, "destination")] {
        let spot = placement.place(ground.of(place), 7.0, words, 12.5);
        write(strong, spot, words.into());
    }
    let plain = ["node", "node middle", "node end"];
    for (user, place) in p.users.iter().enumerate() {
        let words = format!("u{user}");
        let spot = placement.place(ground.of(place), USER_RADIUS, &words, LABEL_SIZE);
        write(plain, spot, words);
    }
    let small = ["time", "time middle", "time end"];
    let slots = flight.map_or(&[][..], |record| &record.slots);
    let every = round_step(slots.len() as f64 / 7.0).max(1.0) as usize;
    for slot in slots.iter().skip(every - 1).step_by(every) {
        let words = slot.slot.to_string();
        if let Some(spot) = placement.place_if_free(ground.of(&slot.flown), 4.0, &words, 10.5) {
            write(small, spot, words);
        }
    }
    for user in &p.users {
        group.push(user_mark(ground.of(user)));
    }
    group
        .with(circle("start", ground.of(&p.start), 6.0))
        .with(circle("start-core", ground.of(&p.start), 2.2))
        .with(destination_mark(ground.of(&p.destination)))
}

fn destination_mark([x, y]: [f64; 2]) -> Element {
    element("g")
        .with(rectangle("start", [x - 5.5, y - 5.5], [11.0, 11.0]))
        .with(rectangle("start-core", [x - 2.2, y - 2.2], [4.4, 4.4]))
}

fn hover(record: &FlightRecord, ground: &Ground) -> Element {
    let mut group = element("g");
    if record.slots.len() > axis::DETAILED_SLOTS_MAX {
        return group;
    }
    let words = |slot: &SlotRecord| element("title").text(slot_words(record, slot));
    for slot in &record.slots {
        group.push(
            circle("hit ring", ground.of(&slot.flown), 7.0)
                .set("data-slot", slot.slot.to_string())
                .with(words(slot)),
        );
    }
    group
}

/// Draws the scale bar, the north arrow and the legend below the map. Returns the vertical
/// coordinate of its lower edge.
fn foot(
    scenario: &Scenario,
    flight: Option<&FlightRecord>,
    ground: &Ground,
    bottom: f64,
) -> (Element, f64) {
    let y = bottom + 76.0;
    let mut group = element("g")
        .with(north([LEFT - 46.0, y]))
        .with(ground.scale_bar([LEFT, y]));
    let mut keys = vec![
        Key {
            mark: user_mark([0.0, 0.0]),
            words: "user".into(),
        },
        Key {
            mark: sensor_mark([0.0, 0.0]),
            words: "sensor".into(),
        },
    ];
    if let Some(record) = flight {
        group.push(color_bar(
            scenario.mission.slot_rate_limit(),
            [RIGHT - 250.0, y],
        ));
        let across = [[-5.0, 0.0], [5.0, 0.0]];
        keys.push(Key {
            mark: PathData::through(across).path("plan"),
            words: "planned".into(),
        });
        keys.push(Key {
            mark: element("g")
                .with(PathData::through(across).path("casing"))
                .with(
                    PathData::through(across)
                        .path("flown")
                        .set("stroke", theme::viridis(0.75)),
                ),
            words: "flown, with slot numbers".into(),
        });
        keys.push(Key {
            mark: line("service", [-9.0, 0.0], [9.0, 0.0]),
            words: "serves".into(),
        });
        if record.slots.iter().any(|slot| !slot.feasible) {
            keys.push(Key {
                mark: cross([0.0, 0.0], 4.0),
                words: "threshold out of reach".into(),
            });
        }
    }
    let (legend, end) = axis::legend(keys, [LEFT - 52.0, y + 34.0]);
    (group.with(legend), end)
}

/// Draws the colour scale of the rates, from 0 to the physical limit.
fn color_bar(limit: f64, [x, y]: [f64; 2]) -> Element {
    const STEPS: usize = 50;
    const BAR: f64 = 250.0;
    let step = BAR / STEPS as f64;
    let mut group = element("g");
    for index in 0..STEPS {
        let share = (index as f64 + 0.5) / STEPS as f64;
        // An overlap of half a unit avoids gaps between neighbours.
        let width = if index + 1 < STEPS { step + 0.5 } else { step };
        let cell = rectangle("swatch", [x + index as f64 * step, y - 14.0], [width, 10.0]);
        group.push(cell.set("fill", theme::viridis(share)));
    }
    group
        .with(rectangle("border", [x, y - 14.0], [BAR, 10.0]))
        .with(label("tick", [x, y + 10.0], "0"))
        .with(label(
            "tick middle",
            [x + BAR / 2.0, y - 20.0],
            "rate (bit/s/Hz)",
        ))
        .with(label(
            "tick end",
            [x + BAR, y + 10.0],
            format!("limit {}", significant(limit, 4)),
        ))
}
