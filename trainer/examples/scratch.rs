use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use std::time::Instant;
use trainer::{env::Environment, head, learner::*, replay::*, sac::Sac, settings::*};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let gamma: f64 = a.get(2).map_or(0.015, |g| g.parse().unwrap());
    let scenario = host_sim::scenario::Scenario::shipped(&a[1])
        .unwrap()
        .with_mse_threshold(gamma)
        .unwrap();
    let mut st = Settings::preset(Preset::Paper, Algorithm::Sac, 1);
    for kv in &a[3..] {
        let (k, v) = kv.split_once('=').unwrap();
        let f: f32 = v.parse().unwrap();
        match k {
            "lr" => {
                st.policy_learning_rate = f;
                st.critic_learning_rate = f;
                st.temperature_learning_rate = f
            }
            "tlr" => st.temperature_learning_rate = f,
            "g" => st.discount = f,
            "ent" => st.user_entropy_fraction = f,
            "dent" => st.displacement_entropy = f,
            "t0" => st.initial_temperature = f,
            "tau" => st.target_rate = f,
            "l2" => st.trajectory_weight = f,
            "ep" => st.episodes = f as u32,
            "seed" => st.seed = f as u64,
            "warm" => st.warmup_slots = f as u64,
            "rw" => st.rate_weight = f,
            _ => panic!(),
        }
    }
    let mission = scenario.mission.clone();
    let mut rng = Pcg64Mcg::seed_from_u64(st.seed);
    let mut env = Environment::<f64>::new(mission.clone(), &st);
    let d = env.dimensions();
    {
        let t = Instant::now();
        let mut c = vec![Choice::default(); 1];
        let mut n = 0;
        for _ in 0..2000 {
            env.reset();
            loop {
                let adm = env.admissible();
                Sac::choose_at_random(d.users, adm, &mut rng, &mut c[0]);
                n += 1;
                if env.step(&c[0]).last {
                    break;
                }
            }
        }
        println!(
            "env {:.0} slots/s; random sum {:.2}",
            n as f64 / t.elapsed().as_secs_f64(),
            env.episode().sum_rate
        );
        env.reset();
    }
    let mut sac = Sac::new(&st, d, &mut rng);
    let mut replay = Replay::new(st.buffer_capacity, d.observation, 2);
    let mut states = States {
        len: 1,
        width: 16,
        observation: vec![0.0; d.observation * 16],
        admissible: vec![u64::MAX; 16],
    };
    let mut c = vec![Choice::default(); 1];
    let (mut s, mut s2) = (vec![0.0; d.observation], vec![0.0; d.observation]);
    let mut slots = 0u64;
    let t = Instant::now();
    let mut steps = 0u64;
    let mut best = 0.0;
    for ep in 0..st.episodes {
        env.reset();
        env.observe(&mut s);
        loop {
            let adm = env.admissible();
            if slots < st.warmup_slots {
                Sac::choose_at_random(d.users, adm, &mut rng, &mut c[0])
            } else {
                scatter(&s, &mut states.observation, 16, 0);
                states.admissible[0] = adm;
                sac.explore(&states, &mut rng, &mut c);
            }
            let step = env.step(&c[0]);
            env.observe(&mut s2);
            replay.push(Transition {
                observation: &s,
                action: &c[0].action,
                user: c[0].user as u8,
                reward: step.reward.total as f32,
                next_observation: &s2,
                last: step.last,
                admissible: adm,
                next_admissible: env.admissible(),
            });
            std::mem::swap(&mut s, &mut s2);
            slots += 1;
            if slots > st.warmup_slots {
                sac.learn(&replay, &mut rng);
                steps += 1;
            }
            if step.last {
                break;
            }
        }
        let explored = env.episode().sum_rate;
        if ep % 100 == 99 {
            let net = sac.deterministic();
            env.reset();
            env.observe(&mut s);
            loop {
                let out = forward(&net, &s);
                let adm = env.admissible();
                let user = (0..d.users)
                    .filter(|m| adm >> m & 1 == 1)
                    .max_by(|a, b| out[2 + a].total_cmp(&out[2 + b]))
                    .unwrap();
                c[0].action = vec![out[0].tanh(), out[1].tanh()];
                c[0].user = user;
                let st = env.step(&c[0]);
                env.observe(&mut s);
                if st.last {
                    break;
                }
            }
            let e = env.episode();
            if e.sum_rate > best {
                best = e.sum_rate
            }
            let l: Vec<String> = sac
                .losses()
                .iter()
                .map(|(n, v)| format!("{}={:.3}", &n[7..], v))
                .collect();
            println!(
                "{ep} explored {:.2} det {:.2} best {:.2} arrived {} fair {} viol {} interv {} | {:.0}/s {}",
                explored,
                e.sum_rate,
                best,
                e.arrived,
                e.fair,
                e.mse_violations,
                e.interventions,
                steps as f64 / t.elapsed().as_secs_f64(),
                l.join(" ")
            );
        }
    }
    let _ = head::DISPLACEMENT_ROWS;
}
fn forward(net: &[trainer::actor::Dense], x: &[f32]) -> Vec<f32> {
    let mut x = x.to_vec();
    for (i, l) in net.iter().enumerate() {
        x = (0..l.outputs)
            .map(|o| {
                let z: f32 = l.bias[o]
                    + (0..l.inputs)
                        .map(|k| l.weights[o * l.inputs + k] * x[k])
                        .sum::<f32>();
                if i + 1 < net.len() { z.max(0.0) } else { z }
            })
            .collect();
    }
    x
}
