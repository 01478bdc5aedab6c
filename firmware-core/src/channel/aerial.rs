// SPDX-License-Identifier: MIT OR Apache-2.0
//! Path loss and probability of line of sight of aerial vehicles, from 3GPP TR 36.777 V15.0.0,
//! Annex B, tables B-1 (probability) and B-2 (path loss).
//!
//! With the vehicle's height `h` (m), the horizontal distance `d2`, the distance `d3` (m) and the
//! carrier `f` (GHz):
//!
//! ```text
//! P = 1 where d2 <= d1, and d1/d2 + exp(-d2/p1) (1 - d1/d2) beyond
//!
//!                   UMa-AV                 UMi-AV                       RMa-AV
//! p1                4300 lg h - 3800       233.98 lg h - 0.95           max(15021 lg h - 16053, 1000)
//! d1                max(460 lg h - 700,    max(294.05 lg h - 432.94,    max(1350.8 lg h - 1602,
//!                       18)                    18)                          18)
//! P = 1 at h above  100 m                  (never)                      40 m
//! LoS, dB           28 + 22 lg d3          30.9                         max(23.9 - 1.8 lg h, 20) lg d3
//!                      + 20 lg f             + (22.25 - 0.5 lg h) lg d3    + 20 lg(40 pi f / 3)
//!                                            + 20 lg f
//! NLoS, dB          -17.5                  32.4                         -12
//!                   + (46 - 7 lg h) lg d3    + (43.2 - 7.6 lg h) lg d3    + (35 - 5.3 lg h) lg d3
//!                   + 20 lg(40 pi f / 3)     + 20 lg f                    + 20 lg(40 pi f / 3)
//! ```
//!
//! The table gives the LoS loss of UMi-AV as no less than that in free space, which it never is at
//! these heights, and the NLoS losses of UMi-AV and RMa-AV as no less than with line of sight. Here
//! the latter holds for all three: at the heights at which UMa-AV has NLoS, it changes nothing.
//!
//! As in the paper's eq:gain, the mean is taken of decibels: `P LoS + (1 - P) NLoS`. It falls short
//! of the mean power gain. Shadowing, which has mean 0 dB, is not part of it.
//! `docs/mathematics.md` names what using these tables for a receiver in the air assumes.

use serde::{Deserialize, Serialize};

use crate::{
    mission::{MissionParameters, RadioModel},
    scalar::Scalar,
};

/// The heights and distances that tables B-1 and B-2 are for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValidRange<T> {
    /// The vehicle is higher than this, metres. At and below it the tables refer to TR 38.901.
    pub above_m: T,
    /// The vehicle is at most this high, metres.
    pub up_to_m: T,
    /// The horizontal distance is at most this, metres.
    pub distance_m: T,
}

/// A path loss `at_1m_db + per_decade_db lg d`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct LogDistance<T> {
    at_1m_db: T,
    per_decade_db: T,
}

impl<T: Scalar> LogDistance<T> {
    fn at(&self, decades: T) -> T {
        self.at_1m_db + self.per_decade_db * decades
    }
}

/// The rows of tables B-1 and B-2 for one environment, height and carrier.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct AerialModel<T> {
    /// `d1`, metres; the largest number where line of sight is certain.
    certain_m: T,
    /// `p1`, metres.
    decay_m: T,
    los_db: LogDistance<T>,
    nlos_db: LogDistance<T>,
}

impl RadioModel {
    /// Returns the range of validity, or `None` if the model has none of its own.
    pub fn valid_range<T: Scalar>(self) -> Option<ValidRange<T>> {
        let (above_m, distance_m) = match self {
            Self::ProbabilisticLos => return None,
            Self::UmaAv | Self::UmiAv => (T::of(22.5), T::of(4_000.0)),
            Self::RmaAv => (T::of(10.0), T::of(10_000.0)),
        };
        Some(ValidRange {
            above_m,
            up_to_m: T::of(300.0),
            distance_m,
        })
    }
}

impl<T: Scalar> AerialModel<T> {
    /// Returns the rows for a mission, or `None` if its model is not from these tables.
    pub(super) fn of<const M: usize, const J: usize>(
        p: &MissionParameters<T, M, J>,
    ) -> Option<Self> {
        let (height_m, lg_h) = (p.altitude_m, p.altitude_m.log10());
        let n = |value: f64| T::of(value);
        let carrier_db = n(20.0) * (p.carrier_hz * n(1e-9)).log10();
        // 20 lg(40 pi f / 3)
        let free_space_db = carrier_db + n(20.0) * n(40.0 * core::f64::consts::PI / 3.0).log10();
        let (certain_m, decay_m, los, nlos) = match p.radio_model {
            RadioModel::ProbabilisticLos => return None,
            RadioModel::UmaAv => (
                (height_m <= n(100.0)).then(|| n(460.0) * lg_h - n(700.0)),
                n(4300.0) * lg_h - n(3800.0),
                (n(28.0) + carrier_db, n(22.0)),
                (free_space_db - n(17.5), n(46.0) - n(7.0) * lg_h),
            ),
            RadioModel::UmiAv => (
                Some(n(294.05) * lg_h - n(432.94)),
                n(233.98) * lg_h - n(0.95),
                (n(30.9) + carrier_db, n(22.25) - n(0.5) * lg_h),
                (n(32.4) + carrier_db, n(43.2) - n(7.6) * lg_h),
            ),
            RadioModel::RmaAv => (
                (height_m <= n(40.0)).then(|| n(1350.8) * lg_h - n(1602.0)),
                (n(15_021.0) * lg_h - n(16_053.0)).max(n(1000.0)),
                (free_space_db, (n(23.9) - n(1.8) * lg_h).max(n(20.0))),
                (free_space_db - n(12.0), n(35.0) - n(5.3) * lg_h),
            ),
        };
        let line = |(at_1m_db, per_decade_db)| LogDistance {
            at_1m_db,
            per_decade_db,
        };
        Some(Self {
            certain_m: certain_m.map_or(T::LARGEST, |d1| d1.max(n(18.0))),
            decay_m,
            los_db: line(los),
            nlos_db: line(nlos),
        })
    }

    /// Returns the probability of line of sight across a horizontal distance.
    pub(super) fn line_of_sight_probability(&self, horizontal_m: T) -> T {
        if horizontal_m <= self.certain_m {
            return T::one();
        }
        let share = self.certain_m / horizontal_m;
        share + (-horizontal_m / self.decay_m).exp() * (T::one() - share)
    }

    /// Returns the mean path loss, decibels, across a horizontal distance and over a distance.
    pub(super) fn path_loss_db(&self, horizontal_m: T, distance_m: T) -> T {
        let decades = distance_m.log10();
        let los_db = self.los_db.at(decades);
        let nlos_db = self.nlos_db.at(decades).max(los_db);
        nlos_db + (los_db - nlos_db) * self.line_of_sight_probability(horizontal_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Mission, scalar::Position, test_missions::table_one_parameters};

    fn mission<T: Scalar>(
        model: RadioModel,
        altitude_m: f64,
        carrier_hz: f64,
    ) -> Mission<T, 16, 64> {
        Mission::new(MissionParameters {
            radio_model: model,
            altitude_m: T::of(altitude_m),
            carrier_hz: T::of(carrier_hz),
            ..table_one_parameters()
        })
        .expect("within the model's range")
    }

    /// Worked by hand from tables B-1 and B-2. For example UMa-AV, h = 100 m, d2 = 500 m, 2 GHz:
    /// d1 = max(460 x 2 - 700, 18) = 220, p1 = 4300 x 2 - 3800 = 4800,
    /// P = 0.44 + exp(-500/4800) x 0.56 = 0.44 + 0.901075 x 0.56 = 0.944602;
    /// d3 = sqrt(500^2 + 100^2) = 509.902, lg d3 = 2.707487, 20 lg 2 = 6.020600,
    /// 20 lg(80 pi / 3) = 38.462372;
    /// LoS = 28 + 22 x 2.707487 + 6.020600 = 93.585307,
    /// NLoS = -17.5 + (46 - 14) x 2.707487 + 38.462372 = 107.601946;
    /// mean = 0.944602 x 93.585307 + 0.055398 x 107.601946 = 94.361800.
    ///
    /// UMi-AV, h = 50 m, d2 = 1000 m, 2 GHz: lg h = 1.698970,
    /// d1 = 294.05 x 1.698970 - 432.94 = 66.642130, p1 = 233.98 x 1.698970 - 0.95 = 396.575,
    /// P = 0.066642 + exp(-2.521591) x 0.933358 = 0.066642 + 0.080332 x 0.933358 = 0.141620;
    /// lg d3 = 3.000542; LoS = 30.9 + 21.400515 x 3.000542 + 6.020600 = 101.133748,
    /// NLoS = 32.4 + 30.287828 x 3.000542 + 6.020600 = 129.300506.
    ///
    /// RMa-AV, h = 25 m, d2 = 800 m, 0.7 GHz: lg h = 1.397940,
    /// d1 = 1350.8 x 1.397940 - 1602 = 286.337, p1 = 15021 x 1.397940 - 16053 = 4945.457,
    /// P = 0.357922 + exp(-0.161765) x 0.642078 = 0.904100;
    /// lg d3 = 2.903302, 20 lg(28 pi / 3) = 29.343733;
    /// LoS = 21.383708 x 2.903302 + 29.343733 = 91.427094,
    /// NLoS = -12 + 27.590918 x 2.903302 + 29.343733 = 97.448499.
    #[test]
    fn values_are_those_of_the_tables() {
        use RadioModel::{RmaAv, UmaAv, UmiAv};
        // Model, h (m), d2 (m), f (GHz); P, LoS, NLoS and mean (dB).
        let rows = [
            (
                UmaAv, 100.0, 150.0, 2.0, 1.0, 83.651317, 93.152506, 83.651317,
            ),
            (
                UmaAv, 100.0, 500.0, 2.0, 0.944602, 93.585307, 107.601946, 94.361800,
            ),
            (
                UmaAv, 30.0, 400.0, 2.0, 0.861436, 91.292716, 113.795660, 94.410819,
            ),
            (
                UmaAv, 120.0, 1000.0, 2.0, 1.0, 100.088902, 115.397193, 100.088902,
            ),
            (
                UmiAv, 100.0, 300.0, 2.0, 0.771170, 90.045600, 108.420600, 94.250343,
            ),
            (UmiAv, 30.0, 18.0, 2.0, 1.0, 70.131911, 87.784774, 70.131911),
            (
                UmiAv, 50.0, 1000.0, 2.0, 0.141620, 101.133748, 129.300506, 125.311520,
            ),
            (
                UmiAv, 300.0, 1000.0, 2.0, 0.420591, 100.348110, 111.998350, 107.098367,
            ),
            (
                RmaAv, 25.0, 800.0, 0.7, 0.904100, 91.427094, 97.448499, 92.004546,
            ),
            // Nearby, the NLoS line (57.4 dB) is below LoS, and the maximum of both counts.
            (
                RmaAv, 12.0, 20.0, 0.7, 0.998020, 59.377154, 59.377154, 59.377154,
            ),
            (
                RmaAv, 40.0, 500.0, 0.7, 1.0, 86.095189, 88.927674, 86.095189,
            ),
            (
                RmaAv, 40.0, 3000.0, 0.7, 0.746179, 102.420740, 109.520049, 104.222695,
            ),
            (
                RmaAv, 60.0, 3000.0, 0.7, 1.0, 101.319603, 106.276106, 101.319603,
            ),
        ];
        for (model, height_m, horizontal_m, carrier_ghz, p_los, los, nlos, mean) in rows {
            let mission = mission::<f64>(model, height_m, carrier_ghz * 1e9);
            let aerial = AerialModel::of(mission.parameters()).expect("an aerial model");
            let distance_m = f64::hypot(horizontal_m, height_m);
            let decades = distance_m.log10();
            let los_db = aerial.los_db.at(decades);
            let channel = mission.channel();
            for (what, got, expected) in [
                ("P", channel.line_of_sight_probability(distance_m), p_los),
                ("LoS", los_db, los),
                ("NLoS", aerial.nlos_db.at(decades).max(los_db), nlos),
                ("mean", channel.path_loss_db(distance_m), mean),
                (
                    "gain",
                    -10.0 * channel.power_gain_across(horizontal_m).0.log10(),
                    mean,
                ),
            ] {
                assert!(
                    (got - expected).abs() < 1e-6,
                    "{model} {height_m} m, {horizontal_m} m: {what} {got}, not {expected}"
                );
            }
        }
    }

    /// Heights of the whole range, with both sides of every change of formula.
    fn heights_m(range: ValidRange<f64>) -> impl Iterator<Item = f64> {
        [
            range.above_m + 1e-6,
            23.0,
            39.999,
            40.0,
            40.001,
            99.999,
            100.0,
            100.001,
            300.0,
        ]
        .into_iter()
        .chain((0..=290).map(|step| 10.5 + f64::from(step)))
        .filter(move |&height_m| height_m > range.above_m && height_m <= range.up_to_m)
    }

    /// What the certified bound relies on, at all heights, distances and changes of formula: the
    /// loss rises strictly with distance, and the probability of line of sight never does.
    #[test]
    fn the_gain_falls_with_distance_at_every_height() {
        for model in [RadioModel::UmaAv, RadioModel::UmiAv, RadioModel::RmaAv] {
            let range = model.valid_range::<f64>().expect("an aerial model");
            for height_m in heights_m(range) {
                let mission = mission::<f64>(model, height_m, 2e9);
                let aerial = AerialModel::of(mission.parameters()).expect("an aerial model");
                let mut distances: std::vec::Vec<f64> = (0..=4000)
                    .map(|step| range.distance_m * f64::from(step) / 4000.0)
                    .collect();
                let d1 = aerial.certain_m.min(range.distance_m);
                distances.extend([d1 - 1e-3, d1, d1 + 1e-3].map(|d| d.min(range.distance_m)));
                distances.sort_by(f64::total_cmp);
                distances.dedup();
                let (mut last_db, mut last_p) = (f64::NEG_INFINITY, 1.0);
                for horizontal_m in distances {
                    let distance_m = horizontal_m.hypot(height_m);
                    let loss_db = aerial.path_loss_db(horizontal_m, distance_m);
                    let p_los = aerial.line_of_sight_probability(horizontal_m);
                    assert!(
                        loss_db > last_db && p_los <= last_p && p_los > 0.0,
                        "{model} {height_m} m, {horizontal_m} m: {loss_db} dB after {last_db}"
                    );
                    (last_db, last_p) = (loss_db, p_los);
                }
            }
        }
    }

    /// What the module's documentation says of maxima in table B-2: the free-space loss never
    /// exceeds that of UMi-AV with line of sight, and where UMa-AV has NLoS, its loss is larger
    /// than with line of sight.
    #[test]
    fn maxima_that_are_left_out_change_nothing() {
        let range = RadioModel::UmiAv
            .valid_range::<f64>()
            .expect("an aerial model");
        for height_m in heights_m(range) {
            for step in 0..=400 {
                let distance_m = (10.0 * f64::from(step)).hypot(height_m);
                let of = |model| {
                    let mission = mission::<f64>(model, height_m, 2e9);
                    let aerial = AerialModel::of(mission.parameters()).expect("an aerial model");
                    let decades = distance_m.log10();
                    (aerial.los_db.at(decades), aerial.nlos_db.at(decades))
                };
                let free_space_db = 20.0
                    * (4.0 * core::f64::consts::PI * 2e9 * distance_m
                        / super::super::SPEED_OF_LIGHT_MPS)
                        .log10();
                assert!(of(RadioModel::UmiAv).0 > free_space_db);
                let (los_db, nlos_db) = of(RadioModel::UmaAv);
                assert!(height_m > 100.0 || nlos_db > los_db);
            }
        }
    }

    #[test]
    fn single_precision_follows_double() {
        for model in [RadioModel::UmaAv, RadioModel::UmiAv, RadioModel::RmaAv] {
            for height_m in [25.0, 38.0, 90.0, 250.0] {
                let double = mission::<f64>(model, height_m, 2e9);
                let single = mission::<f32>(model, height_m, 2e9);
                for step in 0..100 {
                    let (east, north) = (14.0 * f64::from(step), 3.0 * f64::from(step));
                    let ground = Position::new(0.0, 0.0);
                    let d = double
                        .channel()
                        .power_gain(&Position::new(east, north), &ground);
                    let here = Position::new(east as f32, north as f32);
                    let s = single.channel().power_gain(&here, &Position::new(0.0, 0.0));
                    assert!(
                        (f64::from(s.0) / d.0 - 1.0).abs() < 1e-4,
                        "{model} {height_m} {step}: {} {}",
                        s.0,
                        d.0
                    );
                }
            }
        }
    }

    #[test]
    fn missions_beyond_the_tables_are_refused() {
        use RadioModel::{RmaAv, UmaAv, UmiAv};
        let problem = |change: fn(&mut MissionParameters<f64, 16, 64>)| {
            let mut parameters = table_one_parameters();
            change(&mut parameters);
            let refused = Mission::new(parameters).expect_err("beyond the tables");
            std::format!("{refused}")
        };
        let annex = "(3GPP TR 36.777, Annex B)";
        assert_eq!(
            problem(|p| (p.radio_model, p.altitude_m) = (UmaAv, 22.5)),
            std::format!(
                "mission.altitude_m is 22.5, but must be above 22.5 and at most 300 m for \
                 radio.model \"uma-av\" {annex}"
            )
        );
        assert_eq!(
            problem(|p| (p.radio_model, p.altitude_m) = (RmaAv, 300.5)),
            std::format!(
                "mission.altitude_m is 300.5, but must be above 10 and at most 300 m for \
                 radio.model \"rma-av\" {annex}"
            )
        );
        assert_eq!(
            problem(|p| (p.radio_model, p.carrier_hz) = (UmiAv, 0.4e9)),
            "radio.carrier_hz is 400000000, but must be from 0.5e9 to 100e9 Hz for the radio models \
             of 3GPP TR 36.777, Annex B"
        );
        assert_eq!(
            problem(|p| {
                p.radio_model = UmiAv;
                (p.area.east_m, p.area.north_m) = (3000.0, 4000.0);
            }),
            std::format!(
                "mission.area_m has a diagonal of 5000 m, but it must be at most 4000 m for \
                 radio.model \"umi-av\" {annex}"
            )
        );
    }
}
