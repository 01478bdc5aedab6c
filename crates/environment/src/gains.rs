//! The amplitude gains of all sensors and of one user at once, with the vector instructions of the
//! processor.
//!
//! The functions `asin` and `exp` are those of `libm` (FreeBSD's `e_asin.c` and `e_exp.c`), written
//! without branches: each operation, and the order of operations, is the same, so the results are the same, bit for bit, as those of
//! [`Mission::power_gain`]. Nothing is contracted to fused operations.

use firmware_core::{
    Mission, Position, SENSORS_MAX, USERS_MAX, channel::SPEED_OF_LIGHT_MPS, mission::RadioModel,
};
use pulp::{Simd, WithSimd, x86::V3};

/// The number of nodes, rounded up so that vectors are full.
const NODES: usize = SENSORS_MAX + 8;
/// The number of nodes that are calculated at a time.
const LANES: usize = 8;
/// The largest argument of `exp`: `2^k` is then a normal number.
const EXPONENT_MAX: f64 = 700.0;

/// The constants of the channel.
#[derive(Clone, Copy, Debug)]
struct Channel {
    altitude_m: f64,
    a: f64,
    b: f64,
    los_db: f64,
    nlos_db: f64,
    free_space_m2: f64,
}

/// The nodes of a mission whose gains are calculated with vectors.
#[derive(Clone, Debug)]
pub(crate) struct NodeGains {
    simd: V3,
    channel: Channel,
    sensors: usize,
    /// The sensors, and at the index after them the user.
    east_m: [f64; NODES],
    north_m: [f64; NODES],
    amplitudes: [f64; NODES],
    /// The position that `amplitudes` are of.
    vehicle: Option<Position<f64>>,
}

impl NodeGains {
    /// Returns the nodes of a mission, or `None` if its channel is another one, or if the processor
    /// lacks AVX2.
    pub(crate) fn new(mission: &Mission<f64, USERS_MAX, SENSORS_MAX>) -> Option<Self> {
        let p = mission.parameters();
        let channel = Channel {
            altitude_m: p.altitude_m,
            a: p.environment.a,
            b: p.environment.b,
            los_db: p.excess_loss_db.los,
            nlos_db: p.excess_loss_db.nlos,
            free_space_m2: {
                let length = SPEED_OF_LIGHT_MPS / (4.0 * std::f64::consts::PI) / p.carrier_hz;
                length * length
            },
        };
        let supported = p.radio_model == RadioModel::ProbabilisticLos
            && !mission.has_gain_map()
            && channel.altitude_m > 0.0
            && channel.b.abs() * (90.0 + channel.a.abs()) < EXPONENT_MAX
            && channel.los_db.abs().max(channel.nlos_db.abs()) < EXPONENT_MAX;
        let simd = V3::try_new().filter(|_| supported)?;
        let mut gains = Self {
            simd,
            channel,
            sensors: p.sensors.len(),
            east_m: [0.0; NODES],
            north_m: [0.0; NODES],
            amplitudes: [0.0; NODES],
            vehicle: None,
        };
        let places = gains.east_m.iter_mut().zip(&mut gains.north_m);
        for ((east_m, north_m), place) in places.zip(&p.sensors) {
            (*east_m, *north_m) = (place.x, place.y);
        }
        Some(gains)
    }

    /// Returns the amplitude gains of the sensors and the amplitude and power gain of the user on
    /// the ground at `user`, with the vehicle over `vehicle`. If that is where it was last, only
    /// the user's gain is calculated.
    pub(crate) fn at(
        &mut self,
        vehicle: &Position<f64>,
        user: &Position<f64>,
        power_gain: &mut f64,
    ) -> &[f64] {
        self.east_m[self.sensors] = user.x;
        self.north_m[self.sensors] = user.y;
        let count = (self.sensors + 1).next_multiple_of(LANES).min(NODES);
        let stays = self.vehicle.replace(*vehicle) == Some(*vehicle);
        let first = if stays {
            self.sensors / LANES * LANES
        } else {
            0
        };
        let mut powers = [0.0; NODES];
        Simd::vectorize(
            self.simd,
            Kernel {
                channel: &self.channel,
                vehicle: [vehicle.x, vehicle.y],
                east_m: &self.east_m[first..count],
                north_m: &self.north_m[first..count],
                powers: &mut powers[first..count],
                amplitudes: &mut self.amplitudes[first..count],
            },
        );
        *power_gain = powers[self.sensors];
        &self.amplitudes[..self.sensors]
    }
}

struct Kernel<'a> {
    channel: &'a Channel,
    vehicle: [f64; 2],
    east_m: &'a [f64],
    north_m: &'a [f64],
    powers: &'a mut [f64],
    amplitudes: &'a mut [f64],
}

impl WithSimd for Kernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let channel = *self.channel;
        let [east_m, north_m] = self.vehicle;
        let places = self.east_m.iter().zip(self.north_m);
        let results = self.powers.iter_mut().zip(self.amplitudes.iter_mut());
        for ((&ground_east_m, &ground_north_m), (power, amplitude)) in places.zip(results) {
            let gain = power_gain(&channel, east_m - ground_east_m, north_m - ground_north_m);
            *power = gain;
            *amplitude = gain.sqrt();
        }
    }
}

/// `ChannelModel::power_gain`, operation by operation.
#[inline(always)]
fn power_gain(channel: &Channel, east_m: f64, north_m: f64) -> f64 {
    let altitude_m = channel.altitude_m;
    let distance_m = (east_m * east_m + north_m * north_m + altitude_m * altitude_m).sqrt();
    let ratio = altitude_m / distance_m;
    let ratio = if ratio < 1.0 { ratio } else { 1.0 };
    let elevation_deg = asin(ratio) * (180.0 / std::f64::consts::PI);
    let line_of_sight = 1.0 / (1.0 + channel.a * exp(-channel.b * (elevation_deg - channel.a)));
    let loss_db = channel.nlos_db + (channel.los_db - channel.nlos_db) * line_of_sight;
    let nepers = loss_db * (-std::f64::consts::LN_10 / 10.0);
    channel.free_space_m2 / (distance_m * distance_m) * exp(nepers)
}

/// `libm::asin` from 0 to 1.
#[inline(always)]
#[expect(clippy::excessive_precision, reason = "as in the original")]
fn asin(x: f64) -> f64 {
    const PIO2_HI: f64 = std::f64::consts::FRAC_PI_2;
    const PIO2_LO: f64 = 6.12323399573676603587e-17;
    const P_S0: f64 = 1.66666666666666657415e-01;
    const P_S1: f64 = -3.25565818622400915405e-01;
    const P_S2: f64 = 2.01212532134862925881e-01;
    const P_S3: f64 = -4.00555345006794114027e-02;
    const P_S4: f64 = 7.91534994289814532176e-04;
    const P_S5: f64 = 3.47933107596021167570e-05;
    const Q_S1: f64 = -2.40339491173441421878e+00;
    const Q_S2: f64 = 2.02094576023350569471e+00;
    const Q_S3: f64 = -6.88283971605453293030e-01;
    const Q_S4: f64 = 7.70381505559019352791e-02;
    /// The numbers from which on the high word is that of the constant.
    const NEARLY_ONE: f64 = f64::from_bits(0x3fef_3333_0000_0000);

    let is_small = x < 0.5;
    let z = if is_small { x * x } else { (1.0 - x) * 0.5 };
    let p = z * (P_S0 + z * (P_S1 + z * (P_S2 + z * (P_S3 + z * (P_S4 + z * P_S5)))));
    let q = 1.0 + z * (Q_S1 + z * (Q_S2 + z * (Q_S3 + z * Q_S4)));
    let r = p / q;
    let small = x + x * r;
    let s = z.sqrt();
    let nearly_one = PIO2_HI - (2. * (s + s * r) - PIO2_LO);
    let f = f64::from_bits(s.to_bits() & 0xffff_ffff_0000_0000);
    // At 1 this is not a number, and not taken.
    let c = (z - f * f) / (s + f);
    let large = 0.5 * PIO2_HI - (2.0 * s * r - (PIO2_LO - 2.0 * c) - (0.5 * PIO2_HI - 2.0 * f));
    let not_small = if x >= NEARLY_ONE { nearly_one } else { large };
    if is_small { small } else { not_small }
}

/// `libm::exp` from `-EXPONENT_MAX` to `EXPONENT_MAX`.
#[inline(always)]
#[expect(clippy::excessive_precision, reason = "as in the original")]
fn exp(x: f64) -> f64 {
    const LN2HI: f64 = 6.93147180369123816490e-01;
    const LN2LO: f64 = 1.90821492927058770002e-10;
    const INVLN2: f64 = std::f64::consts::LOG2_E;
    const P1: f64 = 1.66666666666666019037e-01;
    const P2: f64 = -2.77777777770155933842e-03;
    const P3: f64 = 6.61375632143793436117e-05;
    const P4: f64 = -1.65339022054652515390e-06;
    const P5: f64 = 4.13813679705723846039e-08;
    /// The bounds of `|x|`, whose high words are compared in the original.
    const THREE_HALVES_LN2: f64 = f64::from_bits(0x3ff0_a2b2_0000_0000);
    const HALF_LN2: f64 = f64::from_bits(0x3fd6_2e43_0000_0000);
    const TINY: f64 = f64::from_bits(0x3e30_0001_0000_0000);
    /// Added to a whole number, this makes its bits those of a whole number with the bias of
    /// exponents.
    const BIASED: f64 = 1023.0 + 4_503_599_627_370_496.0;

    let magnitude = x.abs();
    let rounded = (INVLN2 * x + 0.5_f64.copysign(x)).trunc();
    let near = if magnitude >= HALF_LN2 {
        1.0_f64.copysign(x)
    } else {
        0.0
    };
    let k = if magnitude >= THREE_HALVES_LN2 {
        rounded
    } else {
        near
    };
    let hi = x - k * LN2HI;
    let lo = k * LN2LO;
    let reduced = hi - lo;
    let xx = reduced * reduced;
    let c = reduced - xx * (P1 + xx * (P2 + xx * (P3 + xx * (P4 + xx * P5))));
    let y = 1. + (reduced * c / (2. - c) - lo + hi);
    let power_of_two = f64::from_bits((k + BIASED).to_bits() << 52);
    if magnitude < TINY {
        1. + x
    } else {
        y * power_of_two
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;
    use scenario::Scenario;

    use super::*;

    /// Around every bound in the functions, and anywhere, results are those of `libm`.
    #[test]
    fn functions_are_those_of_libm() {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        let mut near =
            |center: f64| f64::from_bits(center.to_bits() + random.random_range(0..200) - 100);
        for center in [
            0.5,
            0.975,
            0.9999,
            1e-9,
            0.25,
            1.490116e-8,
            f64::from_bits(0x3fef_3333_0000_0000),
        ] {
            for _ in 0..1000 {
                let x = near(center);
                assert_eq!(asin(x).to_bits(), libm::asin(x).to_bits(), "asin {x}");
            }
        }
        assert_eq!(asin(1.0), libm::asin(1.0));
        let bounds = [
            0x3ff0_a2b2_u64,
            0x3fd6_2e43,
            0x3fd6_2e42,
            0x3e30_0001,
            0x3e30_0000,
        ];
        let bounds = bounds.map(|high| f64::from_bits(high << 32));
        for center in bounds.into_iter().chain([1e-9, 0.1, 5.0, 699.0, 1e-300]) {
            for _ in 0..1000 {
                for x in [near(center), -near(center)] {
                    assert_eq!(exp(x).to_bits(), libm::exp(x).to_bits(), "exp {x}");
                }
            }
        }
        for _ in 0..1_000_000 {
            let x: f64 = random.random_range(0.0..1.0);
            assert_eq!(asin(x).to_bits(), libm::asin(x).to_bits(), "asin {x}");
            let x = random.random_range(-50.0..50.0) * x;
            assert_eq!(exp(x).to_bits(), libm::exp(x).to_bits(), "exp {x}");
        }
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(exp(-0.0), 1.0);
    }

    /// The gains of missions of all kinds, also straight above a node.
    #[test]
    fn gains_are_those_of_the_mission() {
        if V3::try_new().is_none() {
            return;
        }
        let mut random = Pcg64Mcg::seed_from_u64(2);
        let shipped =
            ["separated", "mixed", "slow"].map(|name| Scenario::shipped(name).expect(name));
        let drawn = (0..40).map(|seed| scenario::random(seed, None).expect("a mission"));
        for scenario in shipped.into_iter().chain(drawn) {
            let mission = scenario.mission;
            let p = mission.parameters();
            let mut gains = NodeGains::new(&mission).expect("supported");
            for round in 0..100 {
                let user = round % p.users.len();
                let place = match round {
                    0 => p.sensors[0],
                    1 => p.users[1],
                    _ => Position::new(
                        random.random_range(0.0..p.area.east_m),
                        random.random_range(0.0..p.area.north_m),
                    ),
                };
                let mut power = 0.0;
                let amplitudes = gains.at(&place, &p.users[user], &mut power);
                use firmware_core::channel::GroundNode::{Sensor, User};
                assert_eq!(power, mission.power_gain(User(user), &place).0);
                assert_eq!(amplitudes.len(), p.sensors.len());
                for (sensor, &amplitude) in amplitudes.iter().enumerate() {
                    let expected = mission.power_gain(Sensor(sensor), &place).amplitude();
                    assert_eq!(amplitude, expected, "{} {sensor}", scenario.name);
                }
                // The vehicle stays, and another user is served.
                let sensors = amplitudes.to_vec();
                let other = (round + 1) % p.users.len();
                assert_eq!(gains.at(&place, &p.users[other], &mut power), sensors);
                assert_eq!(power, mission.power_gain(User(other), &place).0);
            }
        }
    }
}
