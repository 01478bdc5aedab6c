//! The distribution, rewards, gradients of a step, and short runs.

use pulp::Arch;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::{
    distribution::{Displacement, UserDistribution},
    episode::{Episode, Pilot, REWARD_MAX},
    learner::Learner,
    memory::{Memory, Transition},
    networks::Networks,
    run::Reinforcement,
    settings::ReinforcementSettings,
    task::Task,
};
use crate::{
    imitation::settings::ImitationSettings,
    nn::sets::{Architecture, SetNetwork},
    record::Threads,
};

const SMALL: Architecture = Architecture {
    width: 32,
    hidden: 32,
    layers: 1,
};

fn quick() -> ReinforcementSettings {
    let settings = ReinforcementSettings::improving();
    ReinforcementSettings {
        critic_architecture: SMALL,
        actor_frozen_steps: 3,
        random_missions: 1,
        imitation_batch: 8,
        imitation: ImitationSettings {
            seed: 7,
            steps: 12,
            batch: 12,
            first_missions: 2,
            steps_per_mission: 3,
            planning_operations: 10_000_000,
            correction_operations: 100_000,
            architecture: SMALL,
            held_out_missions: 1,
            evaluate_every: 6,
            report_every: 3,
            warmup_steps: 2,
            ..settings.imitation
        },
        ..settings
    }
}

/// Returns a memory of missions that new networks flew, and the networks, whose heads have larger
/// weights so that users and displacements matter.
fn flown(settings: &ReinforcementSettings) -> (Memory, Networks) {
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let mut networks = Networks::new(settings);
    let mut enlarge = |network: &mut SetNetwork| {
        let mut values = network.export();
        for value in &mut values {
            *value = *value * 1.2 + rng.random_range(-0.1..0.1);
        }
        network.import(&values).expect("its own length");
    };
    enlarge(&mut networks.actor.network);
    for critic in &mut networks.critics {
        enlarge(&mut critic.network);
    }
    networks.targets.iter_mut().for_each(enlarge);
    let mut prepare = Task::preparation(&settings.imitation);
    let mut memory = Memory::new(10, Vec::new(), 0);
    let mut rng = Pcg64Mcg::seed_from_u64(4);
    for index in 0..3 {
        let task = prepare(index, None).expect("a mission");
        let pilot = Pilot::Network(&networks.actor.network, networks.exploration.sigma());
        let episode = Episode::fly(&task, pilot, Arch::new(), &mut rng).expect("flies");
        memory.push(task.demonstration, episode);
    }
    (memory, networks)
}

#[test]
fn the_policy_and_its_gradients_match_differences() {
    let scores = [0.3_f32, -0.4, 1.1, 0.2];
    let admissible = [true, true, false, true];
    let q = [0.5_f32, -0.2, 9.0, 0.1];
    let mut users = UserDistribution::default();
    users.evaluate(&scores, &admissible);
    assert_eq!(users.prob[2], 0.0);
    assert!((users.prob.iter().sum::<f32>() - 1.0).abs() < 1e-6);
    let mut gradient = [f32::NAN; 4];
    users.gradient(0.3, |m| q[m], &mut gradient);
    for (user, expected) in gradient.into_iter().enumerate() {
        let at = |shift: f32| {
            let mut moved = scores;
            moved[user] += shift;
            let mut users = UserDistribution::default();
            users.evaluate(&moved, &admissible);
            -users.soft_value(0.3, |m| q[m])
        };
        let slope = (at(1e-2) - at(-1e-2)) / 2e-2;
        assert!(
            (slope - expected).abs() < 1e-3,
            "{user}: {slope} {gradient:?}"
        );
    }
    // Inside the disc, and beyond it.
    for v in [[0.3, -0.2], [0.9, 0.8]] {
        let sample = |v| Displacement::new(v, 0.2, [0.5, -1.0]);
        let weights = [0.7, -0.4];
        let got = sample(v).backward(weights);
        for (i, expected) in got.into_iter().enumerate() {
            let at = |shift: f32| {
                let mut moved = v;
                moved[i] += shift;
                let a = sample(moved).value;
                a[0] * weights[0] + a[1] * weights[1]
            };
            let slope = (at(1e-2) - at(-1e-2)) / 2e-2;
            assert!((slope - expected).abs() < 1e-3, "{v:?}: {slope} {got:?}");
        }
    }
    let picked = [0.0, 0.999_999].map(|uniform| users.pick(uniform));
    assert_eq!(picked, [0, 3]);
}

/// The reward of every admissible user is what the environment pays if it is served.
#[test]
fn rewards_are_those_of_the_environment() {
    let settings = quick();
    let task = Task::preparation(&settings.imitation)(5, None).expect("a mission");
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let episode = Episode::fly(&task, Pilot::Random, Arch::new(), &mut rng).expect("flies");
    let mut environment = task.environment();
    let (mut alternatives, mut limited) = (0, 0);
    for slot in 0..episode.slots() {
        let [east_m, north_m] = episode.positions_m[slot];
        let position = environment.position();
        assert_eq!([position.x, position.y], [east_m, north_m]);
        let set = environment.admissible();
        for user in 0..task.demonstration.mission.user_count() {
            let reward = episode.reward(slot, user);
            assert_eq!(reward.is_nan(), set >> user & 1 == 0);
            let action = environment::Action {
                components: episode.displacements[slot].to_vec(),
                user,
            };
            if !reward.is_nan() {
                let mut branched = environment.clone();
                let paid = branched.step(&action).reward.total / task.mean_rate();
                limited += u32::from(paid.abs() > REWARD_MAX);
                let paid = paid.clamp(-REWARD_MAX, REWARD_MAX);
                assert!((paid - f64::from(reward)).abs() < 1e-5, "{paid} {reward}");
                alternatives += 1;
            }
        }
        let served = usize::from(episode.users[slot]);
        environment.step(&environment::Action {
            components: episode.displacements[slot].to_vec(),
            user: served,
        });
    }
    assert!(alternatives > 2 * episode.slots());
    // Hardly any is limited.
    assert!(limited * 10 < alternatives as u32, "{limited}");
    let flown = environment.episode();
    let slots = episode.slots() as f64;
    assert!((episode.fraction - flown.sum_rate / task.mean_rate() / slots).abs() < 1e-9);
}

/// Checks that the derivative of `loss` along a gradient is the gradient's length.
fn check(name: &str, gradient: &[f32], mut loss: impl FnMut(f64) -> f64) {
    let h = 2e-3;
    let slope = (loss(h) - loss(-h)) / (2.0 * h);
    let length = f64::from(crate::record::norm(gradient));
    assert!(length > 1e-4, "{name}: {length}");
    assert!(
        (slope / length - 1.0).abs() < 0.03,
        "{name}: {slope} {length}"
    );
}

/// The derivative of a loss along its own gradient is the gradient's length: a wrong sign anywhere
/// between the critics and the actor fails.
#[test]
fn the_losses_fall_along_their_gradients() {
    let settings = ReinforcementSettings {
        alternative_fraction: 0.5,
        ..quick()
    };
    let (memory, networks) = flown(&settings);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let transitions: Vec<Transition> = (0..40).map(|_| memory.draw(0.5, &mut rng)).collect();
    let arch = Arch::new();
    let mut learner = Learner::new(&networks, arch, 1);
    let values = learner.critics(&settings, &networks, &memory, &transitions);
    let gradients: Vec<Vec<f32>> = values.networks.iter().map(|g| g.to_vec()).collect();
    let policy = learner.actor(&networks, transitions.len());
    let actor_gradient = policy.networks[0].to_vec();
    let by_log_sigma = policy.means.value_by_log_sigma;

    let moved = |network: &SetNetwork, gradient: &[f32], h: f64| {
        let mut moved = network.clone();
        let length = f64::from(crate::record::norm(gradient));
        moved.update(|parameters| {
            for (parameter, g) in parameters.iter_mut().zip(gradient) {
                *parameter += (h * f64::from(*g) / length) as f32;
            }
        });
        moved
    };
    for (i, gradient) in gradients.iter().enumerate() {
        let loss = |h: f64| {
            let mut changed = networks.clone();
            let critic = &mut changed.critics[i].network;
            *critic = moved(critic, gradient, h);
            let mut learner = Learner::new(&changed, arch, 1);
            let step = learner.critics(&settings, &changed, &memory, &transitions);
            step.means.critic_losses[i]
        };
        check("critic", gradient, loss);
    }
    let loss = |h: f64| {
        let mut changed = networks.clone();
        let actor = &mut changed.actor.network;
        *actor = moved(actor, &actor_gradient, h);
        learner.actor(&changed, transitions.len()).means.actor_loss
    };
    check("actor", &actor_gradient, loss);
    let mut loss = |h: f32| {
        let mut changed = networks.clone();
        // A step of Adam has the length of the learning rate.
        changed.exploration.descend(arch, h.abs(), -h);
        learner.actor(&changed, transitions.len()).means.actor_loss
    };
    let slope = (loss(2e-3) - loss(-2e-3)) / 4e-3;
    let scale = by_log_sigma.abs().max(1e-3);
    assert!(
        (slope + by_log_sigma).abs() < 0.05 * scale,
        "{slope} {by_log_sigma}"
    );
}

#[test]
fn gradients_do_not_depend_on_threads() {
    let settings = quick();
    let (memory, networks) = flown(&settings);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let transitions: Vec<Transition> = (0..70).map(|_| memory.draw(0.5, &mut rng)).collect();
    let gradients = |threads: usize| {
        let mut learner = Learner::new(&networks, Arch::new(), threads);
        let step = learner.critics(&settings, &networks, &memory, &transitions);
        let mut all: Vec<Vec<f32>> = step.networks.iter().map(|g| g.to_vec()).collect();
        let step = learner.actor(&networks, transitions.len());
        all.extend(step.networks.iter().map(|g| g.to_vec()));
        all
    };
    let expected = gradients(1);
    assert!((2..=4).all(|threads| gradients(threads) == expected));
}

/// The oldest missions leave a full memory, and every transition's user is admissible.
#[test]
fn the_memory_is_bounded_and_has_admissible_transitions() {
    let settings = quick();
    let (memory, _) = flown(&settings);
    let newest: Vec<u64> = memory.missions().map(|(d, _)| d.seed).collect();
    let mut small = Memory::new(2, Vec::new(), 0);
    for (demonstration, episode) in memory.missions() {
        small.push(demonstration.clone(), episode.clone());
    }
    let kept: Vec<u64> = small.missions().map(|(d, _)| d.seed).collect();
    assert_eq!((kept.as_slice(), small.added()), (&newest[1..], 3));
    let mut rng = Pcg64Mcg::seed_from_u64(9);
    let mut others = 0;
    for _ in 0..500 {
        let drawn = small.draw(0.5, &mut rng);
        let (_, episode) = small.mission(drawn.mission);
        assert!(!episode.reward(drawn.slot, drawn.user).is_nan());
        others += u32::from(drawn.user != usize::from(episode.users[drawn.slot]));
    }
    assert!((100..300).contains(&others), "{others}");
}

/// Runs to the end; returns the metrics and the checkpoint's networks.
fn finished(settings: ReinforcementSettings, threads: Threads) -> (String, Vec<u8>) {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().to_owned();
    let mut run = Reinforcement::start(settings, None, path, threads).expect("starts");
    run.run(false).expect("runs");
    files(directory.path())
}

fn files(directory: &std::path::Path) -> (String, Vec<u8>) {
    let metrics = std::fs::read_to_string(directory.join("metrics.csv")).expect("metrics");
    let saved = super::run::saved::Saved::read(&directory.join("checkpoint.bin")).expect("saved");
    let networks = postcard::to_allocvec(&(saved.networks, saved.missions));
    (metrics, networks.expect("postcard"))
}

#[test]
fn one_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let expected = finished(quick(), Threads::default());
    let threads = Threads {
        gradient: 3,
        planning: 2,
    };
    assert!(finished(quick(), threads) == expected);
    let mut other = quick();
    other.imitation.seed = 8;
    assert!(finished(other, Threads::default()).1 != expected.1);
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    let mut whole = quick();
    // The learning rate must be that of the whole run.
    whole.imitation.final_rate_fraction = 1.0;
    let expected = finished(whole.clone(), Threads::default());
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().to_owned();
    let threads = Threads::default();
    let mut half = whole;
    half.imitation.steps = 6;
    let mut run = Reinforcement::start(half, None, path.clone(), threads).expect("starts");
    run.run(false).expect("runs");
    let mut run = Reinforcement::resume(path, Some(12), None, threads).expect("resumes");
    run.run(false).expect("runs");
    assert!(files(directory.path()) == expected);
}

/// While the actor is frozen, only the critics change.
#[test]
fn a_frozen_actor_stays_as_it_is() {
    let mut settings = quick();
    settings.actor_frozen_steps = 12;
    let (_, parameters) = {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().to_owned();
        let threads = Threads::default();
        let mut run = Reinforcement::start(settings.clone(), None, path, threads).expect("starts");
        run.run(false).expect("runs");
        let network =
            crate::any_mission::read_network(&directory.path().join("checkpoint.bin"), true);
        (directory, network.expect("saved").parameters)
    };
    let start = Networks::new(&settings).actor.network.export();
    assert!(parameters == start);
    settings.actor_frozen_steps = 0;
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().to_owned();
    let mut run = Reinforcement::start(settings, None, path, Threads::default()).expect("starts");
    run.run(false).expect("runs");
    let network = crate::any_mission::read_network(&directory.path().join("checkpoint.bin"), true);
    assert!(network.expect("saved").parameters != start);
}

#[test]
fn settings_out_of_range_are_named() {
    let mut settings = quick();
    settings.discount = 1.0;
    let error = settings.check().expect_err("refused");
    assert!(error.starts_with("discount"), "{error}");
    settings = quick();
    settings.critic_architecture.width = 33;
    let error = settings.check().expect_err("refused");
    assert!(
        error.starts_with("critic_architecture.width is 33"),
        "{error}"
    );
}
