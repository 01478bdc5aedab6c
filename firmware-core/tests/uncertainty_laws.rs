// SPDX-License-Identifier: MIT OR Apache-2.0
//! The laws of `docs/mathematics.md`, section 10: slots whose channels are known up to errors with
//! given statistics. Expected MSE and achievable rate are always recomputed from the returned
//! powers and coefficients by the formulas of `aircomp`, and those are compared with drawn errors.

mod random_slots;

use firmware_core::{
    PowerGain, Scalar, Watt,
    inner::{
        LimitedBy, Method, SensorField, SlotAllocation, SlotError, Solution, Status,
        UncertainWorkspace, Workspace,
        alternating::AlternatingSettings,
        bounded::{GainBounds, Guarantee},
    },
    uncertainty::{SensorUncertainty, SlotUncertainty, Uncertainty},
};
use rand::{Rng, RngExt};
use random_slots::{Problem, generator, log_uniform};

/// A slot problem with the statistics of its errors.
#[derive(Clone, Debug)]
struct Uncertain {
    problem: Problem,
    /// `eps_j` and the phase error's standard deviation.
    sensors: Vec<(f64, f64)>,
    user_error_variance: f64,
}

impl Uncertain {
    /// Errors of all sensors, of some or of none, equal or not, up to large ones.
    fn draw(random: &mut impl Rng) -> Self {
        let problem = Problem::draw(random);
        let largest = log_uniform(random, 1e-4, 1.0);
        let affected = [0.0, 0.5, 1.0][random.random_range(0..3)];
        let equal = random.random_bool(0.2);
        let mut pair = || {
            if !random.random_bool(affected) {
                return (0.0, 0.0);
            }
            (
                largest * random.random_range(0.0..1.0),
                largest * random.random_range(0.0..1.5),
            )
        };
        let mut sensors: Vec<_> = (0..problem.sensors()).map(|_| pair()).collect();
        if equal {
            let first = sensors[0];
            sensors.fill(first);
        }
        let user_error_variance = pair().0;
        Self {
            problem,
            sensors,
            user_error_variance,
        }
    }

    fn statistics<T: Scalar>(&self) -> Uncertainty<T, 64> {
        let sensor = |&(variance, phase): &(f64, f64)| {
            SensorUncertainty::with_phase_error(T::of(variance), T::of(phase)).expect("in range")
        };
        let sensors: Vec<_> = self.sensors.iter().map(sensor).collect();
        Uncertainty::new(&sensors, T::of(self.user_error_variance)).expect("in range")
    }

    fn with_field<T: Scalar, R>(&self, ask: impl FnOnce(&SensorField<'_, T>) -> R) -> R {
        let statistics = self.statistics();
        let mut workspace = UncertainWorkspace::<T, 64>::default();
        let gains = self.problem.gains_in();
        let statistics = statistics.of_slot();
        let field = workspace.sensors(&self.problem.limits_in(), &gains, &statistics);
        ask(&field.unwrap_or_else(|error| panic!("{error} in {self:?}")))
    }

    fn solve<T: Scalar>(&self) -> Solution<T> {
        let user = PowerGain(T::of(self.problem.user_gain.0));
        self.with_field(|field| {
            let solution = field.solve(Some(user)).expect("a gain");
            assert_eq!(field.rate(user), solution.rate, "{self:?}");
            solution
        })
    }

    fn coefficients(&self, solution: &Solution<f64>) -> Vec<f64> {
        let statistics = self.statistics();
        let sensors = statistics.of_slot().sensors();
        let gains = self.problem.sensor_gains.iter().zip(sensors);
        gains
            .map(|(&gain, sensor)| solution.uncertain_coefficient(gain, sensor))
            .collect()
    }

    /// `W / J^2 MSE` of the sums, from the definition: `f(c*) / kappa`.
    fn headroom(&self) -> f64 {
        let sensors = self.problem.sensors() as f64;
        let least = self.with_field(|field: &SensorField<'_, f64>| field.least_mse());
        (sensors - least * sensors * sensors) / self.problem.limits.kappa(self.problem.sensors())
    }

    /// Checks what every solution must satisfy.
    fn check(&self) -> Solution<f64> {
        let solution = self.solve();
        let limits = self.problem.limits;
        let coefficients = self.coefficients(&solution);
        let context = || format!("{solution:?} of {self:?}");
        for b in &coefficients {
            let power = b * b;
            assert!(
                *b >= 0.0 && power <= limits.sensor_power_max.0,
                "{}",
                context()
            );
        }
        let power = solution.user_power;
        assert!(
            power.0 >= 0.0 && power <= limits.user_power_max,
            "{}",
            context()
        );
        let slot = self.problem.slot(&coefficients, power);
        let statistics = self.statistics();
        let statistics = statistics.of_slot();
        let eta = slot.expected_normalizing_factor(&statistics);
        assert!(
            (solution.normalizing_factor - eta).abs() <= 1e-9 * eta,
            "{}",
            context()
        );
        let rate = slot.achievable_rate(&statistics);
        assert!(
            (solution.rate - rate).abs() <= 1e-9 * rate,
            "{rate}: {}",
            context()
        );
        let mse = slot.expected_mse(&statistics, solution.normalizing_factor);
        let binds = (mse / limits.mse_threshold - 1.0).abs() <= 1e-9;
        match solution.status {
            Status::Optimal { limited_by } => match limited_by {
                LimitedBy::Accuracy => assert!(binds, "{mse}: {}", context()),
                LimitedBy::Power => {
                    assert!(
                        binds && power == limits.user_power_max,
                        "{mse}: {}",
                        context()
                    );
                }
                LimitedBy::None => {
                    assert!(mse <= limits.mse_threshold * (1.0 + 1e-9), "{}", context());
                    assert!(solution.rate == 0.0, "{}", context());
                }
            },
            Status::Infeasible { least_mse } | Status::ErrorFloor { least_mse } => {
                assert!(
                    least_mse > limits.mse_threshold * (1.0 - 1e-9),
                    "{}",
                    context()
                );
                assert!(
                    (mse - least_mse).abs() <= 1e-9 * mse,
                    "{mse}: {}",
                    context()
                );
                assert!(power.0 == 0.0 && solution.rate == 0.0, "{}", context());
            }
            _ => panic!("not the exact solver's: {}", context()),
        }
        solution
    }

    /// A random choice of coefficients, and the rate with the most user power that keeps `Gamma` with
    /// them; `None` if there is none.
    fn rival(&self, best: &Solution<f64>, random: &mut impl Rng) -> Option<f64> {
        let b_max = self.problem.limits.coefficient_max();
        let near = random.random_bool(0.6);
        let spread = log_uniform(random, 1e-7, 0.5);
        let level = random.random_range(0.0..1.0);
        let mut coefficients = self.coefficients(best);
        for b in &mut coefficients {
            *b = if near {
                (*b * (1.0 + random.random_range(-spread..spread))).min(b_max)
            } else {
                b_max * random.random_range(level..=1.0)
            };
        }
        // J^2 MSE = J - (sum rho y)^2 / (N + (1 + eps_g) q) is at most J^2 Gamma.
        let (mut sum, mut received) = (0.0, self.problem.limits.noise_power.0);
        let gains = self.problem.sensor_gains.iter().zip(&coefficients);
        for ((gain, b), &(variance, phase)) in gains.zip(&self.sensors) {
            let y = b * gain.amplitude();
            sum += (-phase * phase / 2.0).exp() * y;
            received += (1.0 + variance) * y * y;
        }
        let kappa = self.problem.limits.kappa(self.problem.sensors());
        let signal = (sum * sum / kappa - received) / (1.0 + self.user_error_variance);
        if signal < 0.0 || self.problem.user_gain.0 <= 0.0 {
            return None;
        }
        let power = (signal / self.problem.user_gain.0).min(self.problem.limits.user_power_max.0);
        let q = power * self.problem.user_gain.0;
        let sinr = q / (received + self.user_error_variance * q);
        Some(sinr.ln_1p() / core::f64::consts::LN_2)
    }
}

#[test]
fn answers_keep_the_constraints_and_no_random_point_is_better() {
    let mut random = generator(11);
    let (mut feasible, mut floors, mut power_limited, mut rivals) = (0, 0, 0, 0);
    for _ in 0..50_000 {
        let slot = Uncertain::draw(&mut random);
        let solution = slot.check();
        feasible += u32::from(solution.status.is_feasible());
        power_limited += u32::from(solution.status.limited_by() == LimitedBy::Power);
        floors += u32::from(matches!(solution.status, Status::ErrorFloor { .. }));
        for _ in 0..4 {
            let Some(rate) = slot.rival(&solution, &mut random) else {
                continue;
            };
            rivals += 1;
            assert!(solution.status.is_feasible(), "rival {rate}: {slot:?}");
            let slack = 1e-9 * solution.rate + 1e-13 * slot.problem.sensors() as f64;
            assert!(
                rate <= solution.rate + slack,
                "{rate} > {solution:?}: {slot:?}"
            );
        }
    }
    assert!((10_000..45_000).contains(&feasible), "{feasible} feasible");
    assert!(power_limited > 2_000, "{power_limited} limited by power");
    assert!(floors > 1_000, "{floors} below the floor");
    assert!(rivals > 20_000, "{rivals} rivals");
}

/// Statistics that are all zero give the same bits as no statistics.
#[test]
fn without_errors_the_bits_are_those_of_known_channels() {
    let mut random = generator(12);
    for _ in 0..20_000 {
        let mut slot = Uncertain::draw(&mut random);
        slot.sensors.fill((0.0, 0.0));
        slot.user_error_variance = 0.0;
        same_bits::<f64>(&slot);
        same_bits::<f32>(&slot);
    }
}

fn same_bits<T: Scalar>(slot: &Uncertain) {
    let user = Some(PowerGain(T::of(slot.problem.user_gain.0)));
    let gains = slot.problem.gains_in::<T>();
    let amplitudes: Vec<T> = gains.iter().map(|gain| gain.amplitude()).collect();
    let methods = [
        Method::Exact,
        Method::Alternating(AlternatingSettings {
            outer_max: 3,
            ..AlternatingSettings::default()
        }),
        Method::FixedUserPower(Watt(T::of(0.01))),
        Method::FixedSensorPower(Watt(T::of(0.01))),
    ];
    let every = |field: &SensorField<'_, T>| {
        methods.map(|method| {
            let mut coefficients = vec![T::zero(); gains.len()];
            let allocation = field.allocate(&method, &amplitudes, user, &mut coefficients);
            let allocation: SlotAllocation<T> = allocation.expect("a slot problem");
            (allocation, coefficients, field.least_mse())
        })
    };
    let mut workspace = Workspace::<T, 64>::default();
    let known = workspace.sensors(&slot.problem.limits_in(), &gains);
    let known = every(&known.expect("a slot problem"));
    assert_eq!(slot.with_field(every), known, "{slot:?}");
}

/// Neither rate nor feasibility gains from larger errors.
#[test]
fn errors_never_help() {
    let mut random = generator(13);
    let mut at_border = 0;
    for _ in 0..10_000 {
        let slot = Uncertain::draw(&mut random);
        let before = slot.check();
        let more = log_uniform(&mut random, 1e-6, 0.5);
        let which = random.random_range(0..slot.sensors.len());
        let mut worse = [slot.clone(), slot.clone(), slot.clone(), slot.clone()];
        worse[0].sensors[which].0 += more;
        worse[1].sensors[which].1 += more;
        worse[2].user_error_variance += more;
        for sensor in &mut worse[3].sensors {
            *sensor = (sensor.0 + more, sensor.1 + more);
        }
        for worse in worse {
            let after = worse.check();
            let slack = 1e-9 * before.rate + 1e-13 * slot.problem.sensors() as f64;
            assert!(
                after.rate <= before.rate + slack,
                "{before:?} {after:?} {slot:?}"
            );
            if after.status.is_feasible() && !before.status.is_feasible() {
                at_border += 1;
                assert!(slot.headroom() > 1.0 - 1e-12, "{slot:?}");
            }
        }
    }
    assert!(at_border <= 5, "{at_border} of 40,000 crossed the border");
}

/// The error floor: with `W <= kappa` no power makes the slot feasible, and that is said; with a
/// little more, enough power does.
#[test]
fn the_error_floor_is_told_apart_from_power() {
    let mut random = generator(14);
    for _ in 0..2_000 {
        let mut slot = Uncertain::draw(&mut random);
        let gain = log_uniform(&mut random, 1e-12, 1e-9);
        slot.problem.sensor_gains.fill(PowerGain(gain));
        for sensor in &mut slot.sensors {
            sensor.0 += 0.01;
        }
        let sensors = slot.problem.sensors() as f64;
        let weight = |&(variance, phase): &(f64, f64)| (-phase * phase).exp() / (1.0 + variance);
        let sum: f64 = slot.sensors.iter().map(weight).sum();
        for (factor, reachable) in [(1.0 + 1e-6, true), (1.0 - 1e-6, false)] {
            let floor = (sensors - sum) / (sensors * sensors);
            let mut slot = slot.clone();
            slot.problem.limits.mse_threshold = floor * factor;
            slot.problem.limits.sensor_power_max = Watt(1e-9);
            let weak = slot.check();
            slot.problem.limits.sensor_power_max = Watt(1e12);
            let strong = slot.check();
            let reported = slot.with_field(|field: &SensorField<'_, f64>| field.error_floor());
            assert!((reported / floor - 1.0).abs() < 1e-9, "{reported} {slot:?}");
            assert!(!weak.status.is_feasible(), "{weak:?} {slot:?}");
            let is_floor = |status| matches!(status, Status::ErrorFloor { .. });
            assert_eq!(is_floor(weak.status), !reachable, "{weak:?} {slot:?}");
            assert_eq!(is_floor(strong.status), !reachable, "{strong:?} {slot:?}");
            assert_eq!(
                strong.status.is_feasible(),
                reachable,
                "{strong:?} {slot:?}"
            );
        }
    }
}

/// Single precision agrees wherever the border of feasibility is not within its rounding.
#[test]
fn single_precision_follows_double() {
    let mut random = generator(15);
    let (mut at_border, mut worst) = (0, 0.0_f64);
    for _ in 0..50_000 {
        let slot = Uncertain::draw(&mut random);
        let (double, single) = (slot.solve::<f64>(), slot.solve::<f32>());
        let slack = 1.0 - slot.problem.sensors() as f64 * slot.problem.limits.mse_threshold;
        let rounding = 4e-6 / slack;
        if (slot.headroom() - 1.0).abs() < rounding {
            at_border += 1;
            continue;
        }
        let (f, g) = (double.status.is_feasible(), single.status.is_feasible());
        assert_eq!(f, g, "{slot:?}");
        let (d, s) = (double.rate, f64::from(single.rate));
        assert!(
            (d - s).abs() <= 2e-4 * d + 3.0 * rounding,
            "{d} {s} {slot:?}"
        );
        if d > 0.1 {
            worst = worst.max((d - s).abs() / d);
        }
    }
    println!("worst above 0.1 bit/s/Hz: {worst:e}");
    assert!(at_border <= 10, "{at_border} of 50,000 not compared");
}

/// The expected MSE and the powers in the SINR are averages over drawn errors.
#[test]
fn expectations_are_averages_over_errors() {
    let mut random = generator(16);
    let mut normal = move || {
        let (u, v): (f64, f64) = (random.random_range(f64::MIN_POSITIVE..1.0), random.random());
        (-2.0 * u.ln()).sqrt() * (core::f64::consts::TAU * v).cos()
    };
    let slot = Uncertain {
        problem: Problem::draw_with(&mut generator(3), 12),
        sensors: (0..12)
            .map(|j| (0.05 * f64::from(j % 3), 0.1 * f64::from(j % 5)))
            .collect(),
        user_error_variance: 0.1,
    };
    let mut problem = slot.problem.clone();
    let gains = (0..12).map(|j| PowerGain(1e-11 * (1.0 + f64::from(j))));
    problem.sensor_gains = gains.collect();
    problem.user_gain = PowerGain(2e-11);
    let coefficients: Vec<f64> = (0..12).map(|j| 0.05 + 0.01 * f64::from(j)).collect();
    let air = problem.slot(&coefficients, Watt(0.1));
    let statistics = slot.statistics();
    let statistics = statistics.of_slot();
    let eta = air.expected_normalizing_factor(&statistics);
    let expected = air.expected_mse(&statistics, eta);
    assert!(expected > air.mse(eta));

    let draws = 20_000;
    let (mut sum, mut squares) = (0.0, 0.0);
    for _ in 0..draws {
        // Standardized symbols, complex Gaussian errors, Gaussian phases: real and imaginary part.
        let (mut re, mut im, mut wanted) = (0.0, 0.0, 0.0);
        for (j, &(variance, phase)) in slot.sensors.iter().enumerate() {
            let symbol = normal();
            wanted += symbol;
            let y = coefficients[j] * problem.sensor_gains[j].amplitude();
            let side = (variance / 2.0).sqrt();
            let (error_re, error_im) = (side * normal(), side * normal());
            let (sin, cos) = (phase * normal()).sin_cos();
            re += symbol * y * ((1.0 + error_re) * cos - error_im * sin);
            im += symbol * y * ((1.0 + error_re) * sin + error_im * cos);
        }
        let user = (problem.user_gain.0 * 0.1 / 2.0 * (1.0 + slot.user_error_variance)).sqrt();
        let noise = (problem.limits.noise_power.0 / 2.0).sqrt();
        re += user * normal() + noise * normal();
        im += user * normal() + noise * normal();
        let error = ((eta * re - wanted).powi(2) + (eta * im).powi(2)) / 144.0;
        sum += error;
        squares += error * error;
    }
    let mean = sum / f64::from(draws);
    let deviation = (squares / f64::from(draws) - mean * mean).sqrt() / f64::from(draws).sqrt();
    assert!(
        (mean - expected).abs() < 3.0 * deviation,
        "{mean} {expected} {deviation}"
    );
    // The test would see formulas that leave errors out.
    assert!((mean - air.mse(eta)).abs() > 10.0 * deviation);
}

/// Every method keeps the constraints in expectation, and none is better than the exact one.
#[test]
fn other_methods_keep_the_constraints() {
    let mut random = generator(17);
    let (mut compared, mut least) = (0, 1.0_f64);
    for _ in 0..3_000 {
        let slot = Uncertain::draw(&mut random);
        let best = slot.check();
        let power = |limit: Watt<f64>| Watt(limit.0 * 0.5);
        let limits = slot.problem.limits;
        let user = Some(slot.problem.user_gain);
        let amplitudes: Vec<f64> = slot
            .problem
            .sensor_gains
            .iter()
            .map(|g| g.amplitude())
            .collect();
        for method in [
            Method::Alternating(AlternatingSettings::default()),
            Method::FixedUserPower(power(limits.user_power_max)),
            Method::FixedSensorPower(power(limits.sensor_power_max)),
        ] {
            let mut coefficients = vec![0.0; amplitudes.len()];
            let allocation = slot.with_field(|field: &SensorField<'_, f64>| {
                field.allocate(&method, &amplitudes, user, &mut coefficients)
            });
            let SlotAllocation { solution, mse } = allocation.expect("a slot problem");
            let context = || format!("{method:?} {solution:?} {best:?} {slot:?}");
            assert!(
                solution.rate <= best.rate * (1.0 + 1e-9) + 1e-12,
                "{}",
                context()
            );
            let statistics = slot.statistics();
            let statistics = statistics.of_slot();
            let air = slot.problem.slot(&coefficients, solution.user_power);
            let recomputed = air.expected_mse(&statistics, solution.normalizing_factor);
            assert!(
                (mse - recomputed).abs() <= 1e-9 * mse,
                "{recomputed}: {}",
                context()
            );
            let rate = air.achievable_rate(&statistics);
            assert!(
                (solution.rate - rate).abs() <= 1e-9 * rate + 1e-15,
                "{}",
                context()
            );
            if solution.status.is_feasible() {
                assert!(
                    mse <= limits.mse_threshold * (1.0 + 1e-9),
                    "{mse}: {}",
                    context()
                );
            }
            if let Method::Alternating(_) = method {
                assert_eq!(solution.status.is_feasible(), best.status.is_feasible());
                if best.rate > 1e-3 {
                    compared += 1;
                    least = least.min(solution.rate / best.rate);
                }
            }
        }
    }
    assert!(compared > 500, "{compared}");
    assert!(least > 0.99, "{least}");
}

/// Guarantees for estimates within bounds hold for every estimate drawn from them, in expectation.
#[test]
fn guarantees_hold_within_the_bounds() {
    let mut random = generator(18);
    let mut feasible = 0;
    for _ in 0..5_000 {
        let slot = Uncertain::draw(&mut random);
        let widest = log_uniform(&mut random, 1e-9, 1.0);
        let mut around = |gain: PowerGain<f64>| GainBounds {
            least: PowerGain(gain.0 * (-random.random_range(0.0..widest)).exp()),
            most: PowerGain(gain.0 * random.random_range(0.0..widest).exp()),
        };
        let bounds: Vec<_> = slot
            .problem
            .sensor_gains
            .iter()
            .map(|&gain| around(gain))
            .collect();
        let user = around(slot.problem.user_gain);
        let statistics = slot.statistics::<f64>();
        let statistics = statistics.of_slot();
        let mut workspace = UncertainWorkspace::<f64, 64>::default();
        let promise: Guarantee<f64> = workspace
            .guarantee(&slot.problem.limits, &bounds, Some(user), &statistics)
            .expect("a slot problem");
        feasible += u32::from(promise.status.is_feasible());
        let coefficients: Vec<f64> = (bounds.iter().zip(statistics.sensors()))
            .map(|(gain, sensor)| promise.uncertain_coefficient(gain, sensor))
            .collect();
        let context = || format!("{promise:?} {slot:?} {bounds:?} {user:?}");
        for b in &coefficients {
            assert!(
                b * b <= slot.problem.limits.sensor_power_max.0,
                "{}",
                context()
            );
        }
        for _ in 0..10 {
            let mut drawn = slot.problem.clone();
            let mut within = |bounds: &GainBounds<f64>| match random.random_range(0..3) {
                0 => bounds.least,
                1 => bounds.most,
                _ => PowerGain(
                    bounds.least.0
                        + (bounds.most.0 - bounds.least.0) * random.random_range(0.0..1.0),
                ),
            };
            drawn.sensor_gains = bounds.iter().map(&mut within).collect();
            drawn.user_gain = within(&user);
            let air = drawn.slot(&coefficients, promise.user_power);
            let mse = air.expected_mse(&statistics, promise.normalizing_factor);
            assert!(mse <= promise.mse * (1.0 + 1e-9), "{mse}: {}", context());
            let rate = air.achievable_rate(&statistics);
            assert!(rate >= promise.rate * (1.0 - 1e-9), "{rate}: {}", context());
        }
        if promise.status.is_feasible() {
            let threshold = slot.problem.limits.mse_threshold;
            assert!(promise.mse <= threshold * (1.0 + 1e-9), "{}", context());
        }
    }
    assert!(feasible > 1_000, "{feasible}");
}

/// Bounds that coincide give the optimum, and statistics of zero the bits of known channels.
#[test]
fn guarantees_without_width_or_errors_cost_nothing() {
    let mut random = generator(19);
    for _ in 0..5_000 {
        let mut slot = Uncertain::draw(&mut random);
        let bounds: Vec<_> = slot
            .problem
            .sensor_gains
            .iter()
            .copied()
            .map(GainBounds::exactly)
            .collect();
        let user = Some(GainBounds::exactly(slot.problem.user_gain));
        let guarantee = |slot: &Uncertain| {
            let statistics = slot.statistics::<f64>();
            let mut workspace = UncertainWorkspace::<f64, 64>::default();
            workspace
                .guarantee(&slot.problem.limits, &bounds, user, &statistics.of_slot())
                .expect("a slot problem")
        };
        let (promise, best) = (guarantee(&slot), slot.check());
        // Sensors without gain are told to stay silent in both.
        let close = (promise.rate - best.rate).abs() <= 1e-9 * best.rate + 1e-10;
        assert!(
            close || slot.headroom() < 1.0 + 1e-9,
            "{promise:?} {best:?} {slot:?}"
        );

        slot.sensors.fill((0.0, 0.0));
        slot.user_error_variance = 0.0;
        let mut workspace = Workspace::<f64, 64>::default();
        let known = workspace.guarantee(&slot.problem.limits, &bounds, user);
        assert_eq!(guarantee(&slot), known.expect("a slot problem"), "{slot:?}");
    }
}

/// Sensors at the ends of what is valid: the answer is still a number and keeps the constraints.
#[test]
fn extreme_statistics_are_solved() {
    let hopeless = SensorUncertainty::new(f32::MAX, f32::MIN_POSITIVE).expect("in range");
    let known = SensorUncertainty::exactly_known();
    let problem = Problem::draw_with(&mut generator(5), 4).with(|limits| {
        limits.mse_threshold = 0.2;
        limits.sensor_power_max.0 = 0.05;
        limits.noise_power.0 = 3e-13;
    });
    let gains = [
        PowerGain(1e-9_f32),
        PowerGain(0.0),
        PowerGain(1e-9),
        PowerGain(1e-10),
    ];
    for sensors in [[known, hopeless, known, hopeless], [hopeless; 4]] {
        let statistics = Uncertainty::<f32, 4>::new(&sensors, f32::MAX).expect("in range");
        let mut workspace = UncertainWorkspace::<f32, 4>::default();
        let statistics = statistics.of_slot();
        let field = workspace.sensors(&problem.limits_in(), &gains, &statistics);
        let field = field.expect("a slot problem");
        let amplitudes = gains.map(PowerGain::amplitude);
        let mut coefficients = [0.0; 4];
        for method in [
            Method::Exact,
            Method::Alternating(AlternatingSettings::default()),
        ] {
            let user = Some(PowerGain(1e-9));
            let answer = field.allocate(&method, &amplitudes, user, &mut coefficients);
            let SlotAllocation { solution, mse } = answer.expect("a slot problem");
            assert!(
                mse.is_finite() && solution.rate.is_finite(),
                "{solution:?} {mse}"
            );
            assert_eq!(
                solution.status.is_feasible(),
                sensors[0] == known,
                "{solution:?}"
            );
            assert!(
                coefficients.iter().all(|b| b * b <= 0.05 && *b >= 0.0),
                "{coefficients:?}"
            );
        }
    }
}

#[test]
fn statistics_must_fit_the_sensors() {
    let problem = Problem::draw_with(&mut generator(6), 3);
    let sensors = [SensorUncertainty::exactly_known(); 2];
    let statistics = SlotUncertainty::new(&sensors, 0.0).expect("in range");
    let mut workspace = UncertainWorkspace::<f64, 4>::default();
    let refused = workspace.sensors(&problem.limits, &problem.sensor_gains, &statistics);
    let refused = refused.expect_err("two statistics for three sensors");
    let expected = SlotError::UncertaintyCount {
        statistics: 2,
        sensors: 3,
    };
    assert_eq!(refused, expected);
    let expected = "there are error statistics of 2 sensors, but gains of 3";
    assert_eq!(refused.to_string(), expected);
    let mut small = UncertainWorkspace::<f64, 2>::default();
    let refused = small.sensors(&problem.limits, &problem.sensor_gains, &statistics);
    assert!(matches!(refused, Err(SlotError::TooManySensors { .. })));
}
