//! Compares the closed form and Alg. 1 with Clarabel.

use firmware_core::{
    PowerGain, Watt, aircomp,
    inner::{
        Method, PrefixSum, SensorField, SlotLimits, Solution, Status, UncertainWorkspace,
        alternating,
    },
    uncertainty::{SensorUncertainty, Uncertainty},
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use reference::conic::{self, ConicSolution, ConicStatus};
use reference::solve::Problem;

fn limits(problem: &Problem) -> SlotLimits<f64> {
    SlotLimits {
        sensor_power_max: Watt(problem.sensor_power_max),
        user_power_max: Watt(problem.user_power_max),
        noise_power: Watt(problem.noise_power),
        mse_threshold: problem.mse_threshold,
    }
}

fn gains(problem: &Problem) -> Vec<PowerGain<f64>> {
    problem.sensor_gain.iter().copied().map(PowerGain).collect()
}

fn exact(problem: &Problem) -> (Solution<f64>, f64) {
    let gains = gains(problem);
    let mut amplitude = vec![0.0; gains.len()];
    let mut sums = vec![PrefixSum::default(); gains.len()];
    let field =
        SensorField::new(&limits(problem), &gains, &mut amplitude, &mut sums).expect("a slot");
    let solution = field
        .solve(problem.user_gain.map(PowerGain))
        .expect("a gain");
    (solution, field.least_mse())
}

/// Checks the bounds and the accuracy by the printed formulas, whatever Clarabel returned.
fn check(problem: &Problem, solved: &ConicSolution) {
    let gains = gains(problem);
    assert!(
        solved
            .sensor_coefficients
            .iter()
            .all(|b| b * b <= problem.sensor_power_max)
    );
    assert!((0.0..=problem.user_power_max).contains(&solved.user_power_w));
    let slot = aircomp::Slot {
        sensor_gains: &gains,
        sensor_coefficients: &solved.sensor_coefficients,
        user_gain: PowerGain(problem.user_gain.unwrap_or(0.0)),
        user_power: Watt(solved.user_power_w),
        noise_power: Watt(problem.noise_power),
    };
    if solved.status != ConicStatus::Infeasible {
        let mse = slot.mse(solved.normalizing_factor);
        assert!(
            mse <= problem.mse_threshold * (1.0 + 1e-9),
            "{mse} {solved:?} {problem:?}"
        );
        assert!((solved.rate - slot.rate()).abs() <= 1e-9 * slot.rate() + 1e-15);
    }
}

/// Draws a slot with gains as in the shipped areas, `J` from 1 to 40.
fn draw(random: &mut Pcg64Mcg, orders: f64) -> Problem {
    let sensors = random.random_range(1..=40);
    let mut gain = || 10f64.powf(random.random_range(-12.0..-12.0 + orders));
    let sensor_gain = (0..sensors).map(|_| gain()).collect();
    let user_gain = Some(gain());
    Problem {
        sensor_gain,
        user_gain,
        sensor_power_max: 0.05,
        user_power_max: 0.2,
        noise_power: 3.162e-13,
        mse_threshold: random.random_range(0.2..0.95) / sensors as f64,
        ..Problem::default()
    }
}

#[test]
fn bisection_finds_the_closed_form() {
    let mut random = Pcg64Mcg::seed_from_u64(21);
    let (mut worst, mut without_rate) = (0.0_f64, 0);
    for case in 0..60 {
        let problem = draw(&mut random, [2.0, 4.0, 8.0, 12.0][case % 4]);
        let (solution, least_mse) = exact(&problem);
        let solved = conic::bisect(
            &limits(&problem),
            &gains(&problem),
            problem.user_gain.map(PowerGain),
            None,
        );
        check(&problem, &solved);
        assert_eq!(
            solved.status == ConicStatus::Infeasible,
            !solution.status.is_feasible(),
            "{solved:?} {problem:?}"
        );
        assert!(
            (solved.least_mse / least_mse - 1.0).abs() < 1e-6,
            "{} {least_mse}",
            solved.least_mse
        );
        assert!(
            solved.rate <= solution.rate * (1.0 + 1e-9),
            "{solved:?} {solution:?}"
        );
        if solution.rate > 0.0 {
            let short = 1.0 - solved.rate / solution.rate;
            println!("{case}: {short:e} {:?} {}", solved.status, solved.solves);
            worst = worst.max(short);
        } else {
            without_rate += 1;
        }
    }
    println!("worst {worst:e}, {without_rate} without a rate to compare");
    assert!(without_rate <= 20, "{without_rate} of 60 compared no rate");
    assert!(worst < 1e-6, "{worst}");
}

/// With error statistics: the closed form, Alg. 1 and both methods with Clarabel.
#[test]
fn with_errors_the_methods_agree() {
    let mut random = Pcg64Mcg::seed_from_u64(23);
    let settings = alternating::AlternatingSettings::default();
    let (mut worst, mut feasible, mut floors) = (0.0_f64, 0, 0);
    for case in 0..60 {
        let problem = draw(&mut random, [2.0, 4.0, 6.0][case % 3]);
        let mut sensor = || {
            let (variance, phase) = (random.random_range(0.0..0.3), random.random_range(0.0..0.8));
            SensorUncertainty::with_phase_error(variance, phase).expect("in range")
        };
        let sensors: Vec<_> = problem.sensor_gain.iter().map(|_| sensor()).collect();
        let statistics = Uncertainty::<f64, 64>::new(&sensors, 0.2).expect("in range");
        let statistics = statistics.of_slot();
        let (limits, gains) = (limits(&problem), gains(&problem));
        let user = problem.user_gain.map(PowerGain);
        let mut workspace = UncertainWorkspace::<f64, 64>::default();
        let field = workspace
            .sensors(&limits, &gains, &statistics)
            .expect("a slot");
        let exact = field.solve(user).expect("a gain");
        let alternated = Method::Alternating(settings)
            .solve(&field, user)
            .expect("a gain");
        let solved = conic::bisect(&limits, &gains, user, Some(&statistics));
        let context = || format!("{solved:?} {exact:?} {problem:?}");
        assert_eq!(
            solved.status.is_infeasible(),
            !exact.status.is_feasible(),
            "{}",
            context()
        );
        let is_floor = matches!(exact.status, Status::ErrorFloor { .. });
        assert_eq!(
            solved.status == ConicStatus::ErrorFloor,
            is_floor,
            "{}",
            context()
        );
        floors += u32::from(is_floor);
        assert!(
            (solved.least_mse / field.least_mse() - 1.0).abs() < 1e-6,
            "{}",
            context()
        );
        if exact.rate <= 0.0 {
            continue;
        }
        feasible += 1;
        let slot = aircomp::Slot {
            sensor_gains: &gains,
            sensor_coefficients: &solved.sensor_coefficients,
            user_gain: user.unwrap_or_default(),
            user_power: Watt(solved.user_power_w),
            noise_power: limits.noise_power,
        };
        let mse = slot.expected_mse(&statistics, solved.normalizing_factor);
        assert!(
            mse <= limits.mse_threshold * (1.0 + 1e-9),
            "{mse} {}",
            context()
        );
        let rate = slot.achievable_rate(&statistics);
        assert!(
            (solved.rate / rate - 1.0).abs() < 1e-9,
            "{rate} {}",
            context()
        );
        assert!(solved.rate <= exact.rate * (1.0 + 1e-9), "{}", context());
        worst = worst.max(1.0 - solved.rate / exact.rate);
        if case < 6 {
            let by_clarabel = conic::alternate(&limits, &gains, user, Some(&statistics), &settings);
            let difference = (by_clarabel.rate - alternated.rate).abs();
            assert!(
                difference <= 1e-4 * alternated.rate,
                "{by_clarabel:?} {alternated:?}"
            );
        }
    }
    println!("worst {worst:e} of {feasible}, {floors} below the floor");
    assert!(feasible >= 30 && floors >= 2, "{feasible} {floors}");
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn both_ways_of_alternating_agree() {
    let mut random = Pcg64Mcg::seed_from_u64(22);
    let settings = alternating::AlternatingSettings::default();
    let mut feasible_slots = 0;
    for case in 0..4 {
        let problem = draw(&mut random, [2.0, 4.0][case % 2]);
        let (limits, gains) = (limits(&problem), gains(&problem));
        let user = problem.user_gain.map(PowerGain);
        let mut amplitude = vec![0.0; gains.len()];
        let mut sums = vec![PrefixSum::default(); gains.len()];
        let field = SensorField::new(&limits, &gains, &mut amplitude, &mut sums).expect("a slot");
        let own = field.alternate(user, &settings, |_| {}).expect("a gain");
        let solved = conic::alternate(&limits, &gains, user, None, &settings);
        println!(
            "{case}: {} {} {:?} {} {}",
            own.solution.rate, solved.rate, solved.status, own.subproblems, solved.solves
        );
        check(&problem, &solved);
        let feasible = own.solution.status.is_feasible();
        feasible_slots += u32::from(feasible);
        assert_eq!(solved.status == ConicStatus::Infeasible, !feasible);
        assert!(
            (solved.rate - own.solution.rate).abs() <= 1e-4 * own.solution.rate,
            "{solved:?} {own:?}"
        );
    }
    assert!(feasible_slots >= 3, "only {feasible_slots} of 4 alternated");
}
