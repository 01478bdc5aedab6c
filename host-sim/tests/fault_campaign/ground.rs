//! The environment of the onboard computer: a mission, a policy, and a ground with true channels.

use firmware_core::{
    Mission, Position, PowerGain, SENSORS_MAX, USERS_MAX, Watt,
    controller::{ChannelState, SlotCommand},
    link::{Endpoint, FRAME_MAX, Message},
    mission::{Area, Environment, ExcessLoss, MEASUREMENT_M, MissionParameters, RadioModel},
    policy::{Action, Observation, Policy},
};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

pub(crate) type HostMission = Mission<f64, USERS_MAX, SENSORS_MAX>;
pub(crate) type HostState = ChannelState<f64, USERS_MAX, SENSORS_MAX>;
pub(crate) type HostMessage = Message<f64, USERS_MAX, SENSORS_MAX>;
pub(crate) type HostCommand = SlotCommand<f64, SENSORS_MAX>;

pub(crate) fn mission(random: &mut Pcg64Mcg, slots: u32) -> HostMission {
    let (east_m, north_m) = (300.0, 200.0);
    let mut place = || {
        Position::new(
            random.random_range(0.0..=east_m),
            random.random_range(0.0..=north_m),
        )
    };
    let (start, destination) = (place(), place());
    let (users, sensors) = (random.random_range(1..=6), random.random_range(1..=14));
    let share = random.random_range(0.3..0.9);
    let mut places = |count: usize| {
        let mut place = || {
            Position::new(
                random.random_range(0.0..=east_m),
                random.random_range(0.0..=north_m),
            )
        };
        (0..count).map(|_| place()).collect::<Vec<_>>()
    };
    Mission::new(MissionParameters {
        slots,
        slot_duration_s: 1.0,
        start,
        destination,
        area: Area { east_m, north_m },
        altitude_m: 30.0,
        max_speed_mps: 3.0,
        carrier_hz: 2e9,
        radio_model: RadioModel::ProbabilisticLos,
        environment: Environment { a: 9.613, b: 0.158 },
        excess_loss_db: ExcessLoss {
            los: 1.0,
            nlos: 20.0,
        },
        noise_power: Watt::from_dbm(-90.0),
        mse_threshold: share / sensors as f64,
        user_power_max: Watt(0.2),
        sensor_power_max: Watt(0.05),
        users: places(users).into_iter().collect(),
        sensors: places(sensors).into_iter().collect(),
    })
    .unwrap_or_else(|error| panic!("{error}"))
}

/// A policy that wanders and sometimes returns invalid actions.
pub(crate) struct Wanderer(pub(crate) Pcg64Mcg);

impl Policy<f64, USERS_MAX> for Wanderer {
    fn decide(&mut self, observation: &Observation<'_, f64>) -> Action<f64, USERS_MAX> {
        let random = &mut self.0;
        let mut number = |most: f64| match random.random_range(0..40) {
            0 => f64::NAN,
            _ => random.random_range(-most..=most),
        };
        Action {
            displacement: [number(3.0), number(3.0)].into(),
            user_scores: observation.counts.iter().map(|_| number(1.0)).collect(),
        }
    }

    fn revise(&mut self, _: &firmware_core::mission::MissionChange<f64>, _: u32) {}

    fn note_gains(&mut self, _: &firmware_core::policy::MeasuredGains<'_, f64>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<firmware_core::policy::PlanQuality> {
        None
    }
}

/// The gain of a link is the model's gain times a factor, as seen from a position that drifts.
#[derive(Clone, Copy)]
struct Truth {
    ground: Position<f64>,
    factor: f64,
    /// The distance by which the vehicle seems further away than it is, metres.
    strayed_m: f64,
}

impl Truth {
    fn gain(&self, mission: &HostMission, over: &Position<f64>) -> PowerGain<f64> {
        let area = &mission.parameters().area;
        let far = Position::new(
            self.ground.x.max(area.east_m - self.ground.x),
            self.ground.y.max(area.north_m - self.ground.y),
        );
        let seems_m = ((over - self.ground).norm() + self.strayed_m).max(0.0);
        let across = mission
            .channel()
            .power_gain_across(seems_m.min(far.coords.norm()));
        PowerGain(self.factor * across.0)
    }
}

/// The ground: the true channels, and the messages that were received. Each link changes
/// independently, as fast as the controller assumes at most.
pub(crate) struct Ground {
    mission: HostMission,
    links: Vec<Truth>,
    random: Pcg64Mcg,
    end: Endpoint,
    pub(crate) heard: Vec<HostMessage>,
}

impl Ground {
    pub(crate) fn new(mission: &HostMission, random: &Pcg64Mcg, end: Endpoint) -> Self {
        let p = mission.parameters();
        let link = |&ground: &Position<f64>| Truth {
            ground,
            factor: 1.0,
            strayed_m: 0.0,
        };
        Self {
            links: p.users.iter().chain(&p.sensors).map(link).collect(),
            random: random.clone(),
            mission: mission.clone(),
            end,
            heard: Vec::new(),
        }
    }

    pub(crate) fn truth(&self, slot: u32, over: &Position<f64>) -> HostState {
        let (users, sensors) = self.links.split_at(self.mission.user_count());
        let gain = |link: &Truth| link.gain(&self.mission, over);
        ChannelState {
            slot,
            user_gains: users.iter().map(gain).collect(),
            sensor_gains: sensors.iter().map(gain).collect(),
        }
    }

    /// Advances the channels by one slot.
    pub(crate) fn stray(&mut self) {
        // The limit is reduced by the accuracy of measured positions.
        let most_m = self.mission.reach_m() - MEASUREMENT_M;
        for link in &mut self.links {
            link.strayed_m += self.random.random_range(-most_m..=most_m);
        }
    }

    /// The vehicle knows the gains at this position: from now on the true gains drift away from
    /// them.
    pub(crate) fn become_known(&mut self, over: &Position<f64>) {
        for link in &mut self.links {
            let gain = link.gain(&self.mission, over);
            let away_m = (over - link.ground).norm();
            link.factor = gain.0 / self.mission.channel().power_gain_across(away_m).0;
            link.strayed_m = 0.0;
        }
    }

    /// Receives bytes and answers arrivals.
    pub(crate) fn receive(&mut self, bytes: &[u8], over: &Position<f64>) -> Vec<u8> {
        let mut answer = Vec::new();
        let mut buffer = [0; FRAME_MAX];
        for &byte in bytes {
            let message = self.end.push(byte);
            answer.extend_from_slice(self.end.take_handshake(&mut buffer).unwrap_or_default());
            if let Some(Ok(message)) = message {
                if let Message::Arrival(arrival) = &message {
                    let state = Message::ChannelState(self.truth(arrival.plan.slot, over));
                    let frame = self.end.encode(&state, &mut buffer);
                    answer.extend_from_slice(frame.expect("an arrival is of a session"));
                }
                self.heard.push(message);
            }
        }
        answer
    }
}
