use std::{collections::HashSet, fs, path::Path};

use super::*;
use crate::{record::PathSample, report::fixture};

/// Parses as XML, which a page of this module is as well; gives the document's text.
fn well_formed(text: &str) -> roxmltree::Document<'_> {
    let options = roxmltree::ParsingOptions {
        allow_dtd: true,
        ..Default::default()
    };
    roxmltree::Document::parse_with_options(text, options).expect("well-formed")
}

fn page(record: &FlightRecord) -> String {
    html(record, &record.summary())
}

/// The slots that some element of this name and class is about.
fn slots_of<'a>(document: &'a roxmltree::Document<'_>, figure: &str) -> HashSet<&'a str> {
    let figures = document.descendants().filter(|node| {
        node.has_tag_name(("http://www.w3.org/2000/svg", "svg"))
            && node
                .attribute("aria-label")
                .is_some_and(|label| label.starts_with(figure))
    });
    figures
        .flat_map(|figure| figure.descendants())
        .filter_map(|node| node.attribute("data-slot"))
        .collect()
}

/// A mission of this size, with as much speed as its destination needs.
fn scenario(slots: u32, users: usize, sensors: usize, noise_dbm: f64) -> Scenario {
    use scenario::{Topology, generate};
    // The destination is 1273 m away: few slots need much speed.
    let speed_mps = 30.0f64.max(1300.0 / f64::from(slots + 1));
    let text = generate(Topology::Mixed, 7, users, sensors)
        .and_then(|scenario| scenario.with_mse_threshold(0.54 / sensors as f64))
        .expect("valid")
        .to_toml()
        .replace("slots = 60", &format!("slots = {slots}"))
        .replace(
            "max_speed_mps = 30.0",
            &format!("max_speed_mps = {speed_mps:?}"),
        )
        .replace("noise_dbm = -95.0", &format!("noise_dbm = {noise_dbm:?}"));
    Scenario::parse("sized", &text).expect("valid")
}

#[test]
fn every_slot_is_in_every_figure() {
    let record = fixture::separated();
    let text = page(&record);
    let document = well_formed(&text);
    for figure in [
        "Map of separated",
        "Rate per slot",
        "MSE per slot",
        "Estimate",
        "Schedule",
        "Transmit powers",
    ] {
        assert_eq!(slots_of(&document, figure).len(), 60, "{figure}");
    }
    let rows = document
        .descendants()
        .filter(|node| node.has_tag_name("tr") && node.children().count() > 10);
    assert_eq!(rows.count(), 61, "a head and 60 slots");
}

#[test]
fn missions_of_every_size_make_well_formed_pages() {
    for (slots, users, sensors, noise_dbm) in [
        (1, 1, 1, -95.0),
        (2, 16, 64, -95.0),
        (17, 3, 2, -95.0),
        (1000, 16, 64, -60.0),
    ] {
        let record = fixture::straight_line(scenario(slots, users, sensors, noise_dbm), 3);
        let text = page(&record);
        let document = well_formed(&text);
        assert_eq!(slots_of(&document, "Schedule").len(), slots as usize);
        well_formed(&map_svg(&record));
        for number in ["NaN", "inf\"", "-0\""] {
            assert!(!text.contains(number), "{number} at {slots} slots");
        }
    }
}

#[test]
fn infeasible_slots_are_marked() {
    let record = fixture::straight_line(scenario(40, 4, 16, -50.0), 3);
    assert!(
        record.slots.iter().all(|slot| !slot.feasible),
        "by its noise"
    );
    let text = page(&record);
    assert!(text.contains("threshold out of reach"));
    let crosses = text.matches("class=\"cross\"").count();
    assert!(crosses > 100, "{crosses} crosses");
    assert!(!page(&fixture::separated()).contains("class=\"cross\""));
}

#[test]
fn names_cannot_break_out_of_the_page() {
    let mut record = fixture::separated();
    record.policy = "</title><script>alert('1')</script> & \"co\" \u{1b}[31m\u{0}.onnx".into();
    record.scenario.name = "a<b".into();
    record.scenario.sensing.unit = "µg/m³ <&>".into();
    let text = page(&record);
    let document = well_formed(&text);
    let scripts = document
        .descendants()
        .filter(|node| node.has_tag_name("script"));
    assert_eq!(scripts.count(), 1, "our own");
    let heading = document
        .descendants()
        .find(|node| node.has_tag_name("h1"))
        .expect("a heading");
    assert!(heading.descendants().any(|node| {
        node.text()
            .is_some_and(|text| text.contains("<script>alert('1')</script> & \"co\""))
    }));
    well_formed(&map_svg(&record));
    let printed = table(&record, &record.summary(), Look { color: false });
    assert!(!printed.contains('\u{1b}'), "{printed}");
}

#[test]
fn the_page_needs_nothing_else() {
    let text = page(&fixture::separated());
    for loaded in ["src=", "href=", "url(", "@import", "fetch("] {
        assert!(!text.contains(loaded), "{loaded}");
    }
    let addresses = text.matches("http").count();
    assert_eq!(
        addresses,
        text.matches("http://www.w3.org/2000/svg").count()
    );
}

#[test]
fn the_same_flight_makes_the_same_files() {
    let [first, second] = [(), ()].map(|()| tempfile::tempdir().expect("a folder"));
    let [one, two] = [&first, &second].map(|folder| folder.path().join("new/report"));
    for folder in [&one, &two] {
        write(&fixture::separated(), folder).expect("written");
    }
    let mut names: Vec<_> = fs::read_dir(&one)
        .expect("there")
        .map(|entry| entry.expect("readable").file_name())
        .collect();
    names.sort();
    assert_eq!(
        names,
        ["map.svg", "report.html", "slots.csv", "summary.json"]
    );
    for name in names {
        let [a, b] = [&one, &two].map(|folder| fs::read(folder.join(&name)).expect("there"));
        assert!(a == b, "{name:?} differs");
    }
}

#[test]
fn the_csv_reads_back_to_the_last_bit() {
    let mut record = fixture::separated();
    record.slots[3].intervention.user = true;
    record.slots[3].intervention.displacement = true;
    record.slots[4].mse = 1.0 / 3.0;
    record.slots[5].rate = f64::MIN_POSITIVE;
    let csv = slots_csv::csv(&record).expect("written");
    let mut reader = csv::Reader::from_reader(&csv[..]);
    let heads: Vec<String> = reader
        .headers()
        .expect("heads")
        .iter()
        .map(str::to_owned)
        .collect();
    assert_eq!(heads[0], "slot");
    assert_eq!(heads[heads.len() - 2..], ["plan_us", "allocate_us"]);
    let column = |name: &str| heads.iter().position(|head| head == name).expect(name);
    let rows: Vec<csv::StringRecord> = reader.records().map(|row| row.expect("a row")).collect();
    assert_eq!(rows.len(), record.slots.len());
    for (row, slot) in rows.iter().zip(&record.slots) {
        let number = |name: &str| row[column(name)].parse::<f64>().expect(name);
        assert_eq!(number("slot"), f64::from(slot.slot));
        for (name, value) in [
            ("planned_east_m", slot.planned.x),
            ("flown_north_m", slot.flown.y),
            ("user_power_w", slot.user_power_w),
            ("sensor_power_mean_w", slot.sensor_power_mean_w),
            ("normalizing_factor", slot.normalizing_factor),
            ("rate_bit_s_hz", slot.rate),
            ("mse", slot.mse),
            ("empirical_mse", slot.signals.empirical_mse),
            ("estimate", slot.signals.estimate),
            ("error", slot.signals.error()),
        ] {
            assert_eq!(number(name).to_bits(), value.to_bits(), "{name}");
        }
        assert_eq!(&row[column("feasible")], "true");
        assert_eq!(&row[column("channel_source")], "measured");
    }
    assert_eq!(&rows[3][column("shield")], "displacement+user");
    assert_eq!(&rows[0][column("shield")], "none");
    assert_eq!(&rows[0][column("limited_by")], "power");
}

#[test]
fn a_report_replaces_an_earlier_one_and_nothing_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name);
    fs::write(file("flight.tlog"), "log").expect("written");
    fs::write(file("summary.json"), "{}").expect("written");
    prepare(folder.path()).expect("ready");
    assert!(
        !file("summary.json").exists(),
        "looks complete before it is"
    );
    let summary = write(&fixture::separated(), folder.path()).expect("written");
    assert_eq!(fs::read(file("flight.tlog")).expect("kept"), b"log");
    let json: serde_json::Value =
        serde_json::from_slice(&fs::read(file("summary.json")).expect("there")).expect("JSON");
    assert_eq!(json["sum_rate"], summary.sum_rate);
    assert_eq!(json["users"].as_array().map(Vec::len), Some(15));
}

#[test]
fn a_folder_that_cannot_be_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("occupied");
    fs::write(&file, "something").expect("written");
    for path in [file.clone(), file.join("below")] {
        let error = write(&fixture::separated(), &path).expect_err("a file");
        assert!(error.to_string().contains("occupied"), "{error}");
    }
    assert_eq!(fs::read(&file).expect("kept"), b"something");
    // A directory has the name of one of the files: no file of the report is left.
    let blocked = folder.path().join("blocked");
    fs::create_dir_all(blocked.join("report.html/inside")).expect("made");
    let error = write(&fixture::separated(), &blocked).expect_err("a folder in the way");
    assert!(error.to_string().contains("report.html"), "{error}");
    assert!(!blocked.join("summary.json").exists(), "looks complete");
    let left = fs::read_dir(&blocked).expect("there");
    for entry in left {
        let name = entry.expect("readable").file_name();
        assert!(!name.to_string_lossy().ends_with(".partial"), "{name:?}");
    }
}

#[test]
fn the_table_fits_a_terminal() {
    let record = fixture::straight_line(scenario(1000, 16, 64, -80.0), 3);
    for record in [fixture::separated(), record] {
        let summary = record.summary();
        let plain = table(&record, &summary, Look { color: false });
        for line in plain.lines() {
            assert!(line.chars().count() <= 80, "{line}");
        }
        for word in ["total rate", "arrived", "fair", "MSE", "u14"] {
            assert!(plain.contains(word), "{word} in\n{plain}");
        }
        let colored = table(&record, &summary, Look { color: true });
        assert!(colored.contains("\u{1b}[32m✓"));
    }
}

#[test]
fn the_path_is_drawn_where_the_vehicle_was() {
    let mut record = fixture::separated();
    let straight = map_svg(&record);
    // A detour between two slots' ends is seen only in the path.
    let detour = PathSample {
        time_s: 10.5,
        position: firmware_core::Position::new(100.0, 900.0),
        altitude_m: 100.0,
    };
    record.path.insert(11, detour);
    assert!(map_svg(&record) != straight);
    record.path.clear();
    assert!(map_svg(&record) == straight, "slots' ends make the path");
}

#[test]
fn an_aborted_flight_says_so() {
    let mut record = fixture::separated();
    let words = "Aborted after 12 of 60 slots.";
    assert!(!page(&record).contains(words));
    record.slots.truncate(12);
    record.path.truncate(13);
    let text = page(&record);
    assert!(text.contains(words));
    let document = well_formed(&text);
    assert_eq!(slots_of(&document, "Rate per slot").len(), 12);
    record.slots.clear();
    record.path.clear();
    well_formed(&page(&record));
    well_formed(&map_svg(&record));
    let printed = table(&record, &record.summary(), Look { color: false });
    assert!(!printed.contains("NaN"), "{printed}");
}

#[test]
fn a_scenario_can_be_drawn_before_it_is_flown() {
    for name in ["separated", "mixed"] {
        let scenario = Scenario::shipped(name).expect("shipped");
        let text = scenario_svg(&scenario);
        let document = well_formed(&text);
        let drawn = |class: &str| {
            let nodes = document.descendants();
            nodes
                .filter(|node| node.attribute("class") == Some(class))
                .count()
        };
        // One more of each: the legend's.
        assert_eq!(drawn("user"), 16);
        assert_eq!(drawn("sensor"), 37);
        assert_eq!(drawn("flown"), 0);
    }
    assert!(!Path::new("map.svg").exists(), "drawing writes no file");
}
