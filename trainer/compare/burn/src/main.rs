//! Times the gradient step of `trainer::sac` as it is written with burn: same sizes, same losses.
//!
//! ```text
//! burn-steps [STEPS]
//! ```
//!
//! A step draws a batch from memory and updates two critics (eq:Q, expectation over users exact),
//! the policy (eq:pi), both temperatures (eq:beta) and the target networks, with Adam. It uses one
//! thread; this build of burn supports no more. The test `trainer/tests/compared_sizes.rs` compares
//! the constants below with the trainer's.

use std::{hint::black_box, time::Instant};

use burn::{
    module::{Module, Param},
    nn::{Linear, LinearConfig},
    optim::{AdamConfig, GradientsParams, ModuleOptimizer},
    tensor::{
        Device, Distribution, Int, Tensor, TensorData,
        activation::{log_softmax, relu, softplus},
    },
};

const USERS: usize = 15;
const STATES: usize = USERS + 4;
const HIDDEN: usize = 128;
const BATCH: usize = 64;
const MEMORY: usize = 12_000;
const RATE: f64 = 1e-4;
const DISCOUNT: f32 = 0.9;
const TAU: f32 = 0.005;
const DISPLACEMENT_ENTROPY: f32 = -2.0;
const USER_ENTROPY_FRACTION: f32 = 0.2;
/// `ln sigma` lies between these.
const LOG_SIGMA: [f32; 2] = [-5.0, 1.0];
/// A logit so low that softmax returns probability 0.
const EXCLUDED: f32 = -1e9;

#[derive(Module, Debug)]
struct Mlp {
    layers: [Linear; 3],
}

impl Mlp {
    fn new(inputs: usize, outputs: usize, device: &Device) -> Self {
        let sizes = [(inputs, HIDDEN), (HIDDEN, HIDDEN), (HIDDEN, outputs)];
        Self {
            layers: sizes.map(|(i, o)| LinearConfig::new(i, o).init(device)),
        }
    }

    fn forward(&self, input: Tensor<2>) -> Tensor<2> {
        let [first, second, third] = &self.layers;
        third.forward(relu(second.forward(relu(first.forward(input)))))
    }

    /// eq:theta1.
    fn soft_update(self, source: &Self) -> Self {
        let mut sources = source.layers.iter();
        let layers = self.layers.map(|layer| {
            let source = sources.next().expect("as many layers");
            let mix = |own: Tensor<2>, source: Tensor<2>| own * (1.0 - TAU) + source * TAU;
            let weight = layer.weight.map(|own| mix(own, source.weight.val()));
            let bias = layer
                .bias
                .zip(source.bias.as_ref())
                .map(|(own, source)| own.map(|own| own * (1.0 - TAU) + source.val() * TAU));
            Linear { weight, bias }
        });
        Self { layers }
    }
}

/// The logarithms of the temperatures (the paper's `beta`) of displacement and user.
#[derive(Module, Debug)]
struct Temperatures {
    log: Param<Tensor<1>>,
}

/// A network with its optimizer.
struct Trained<M: Module> {
    module: Option<M>,
    adam: ModuleOptimizer,
}

impl<M: Module> Trained<M> {
    fn new(module: M) -> Self {
        let adam = AdamConfig::new().with_epsilon(1e-8).init();
        Self {
            module: Some(module),
            adam,
        }
    }

    fn module(&self) -> &M {
        self.module.as_ref().expect("always one between two steps")
    }

    fn descend(&mut self, loss: &Tensor<1>) {
        let module = self.module.take().expect("always one between two steps");
        let gradients = GradientsParams::from_grads(loss.backward(), &module);
        self.module = Some(self.adam.step(RATE, module, gradients));
    }
}

/// The policy's distribution in a batch of states, and one displacement sampled from it per state.
struct PolicySample {
    displacement: Tensor<2>,
    /// `ln pi(a|s)`, a column.
    log_prob: Tensor<2>,
    log_user_prob: Tensor<2>,
    user_prob: Tensor<2>,
}

/// Computes the same as `trainer::head`, with burn's operations.
fn sample_policy(
    policy: &Mlp,
    states: Tensor<2>,
    exclusion: Tensor<2>,
    device: &Device,
) -> PolicySample {
    let output = policy.forward(states);
    let mean = output.clone().narrow(1, 0, 2);
    let spread = output.clone().narrow(1, 2, 2).tanh();
    let [low, high] = LOG_SIGMA;
    let log_sigma = (spread + 1.0) * (0.5 * (high - low)) + low;
    let noise = Tensor::<2>::random([BATCH, 2], Distribution::Normal(0.0, 1.0), device);
    let raw = mean + log_sigma.clone().exp() * noise.clone();
    let log_slope =
        (-raw.clone() - softplus(raw.clone() * -2.0, 1.0) + core::f32::consts::LN_2) * 2.0;
    let half_ln_2_pi = 0.5 * core::f32::consts::TAU.ln();
    let log_prob = (-(noise.square() * 0.5) - log_sigma - log_slope - half_ln_2_pi).sum_dim(1);
    let log_user_prob = log_softmax(output.narrow(1, 4, USERS) + exclusion, 1);
    PolicySample {
        displacement: raw.tanh(),
        log_prob,
        user_prob: log_user_prob.clone().exp(),
        log_user_prob,
    }
}

impl PolicySample {
    /// Minus the soft value, a column.
    fn soft_cost(&self, least: Tensor<2>, temperature: &[f32; 2]) -> Tensor<2> {
        let over_users = self.log_user_prob.clone() * temperature[1] - least;
        (self.user_prob.clone() * over_users).sum_dim(1) + self.log_prob.clone() * temperature[0]
    }
}

/// Transitions as rows of plain numbers.
struct Memory {
    random: u64,
    rows: Vec<[f32; 2 * STATES + 4 + 2 * USERS]>,
}

struct Batch {
    states: Tensor<2>,
    action: Tensor<2>,
    user: Tensor<2, Int>,
    reward: Tensor<2>,
    follows: Tensor<2>,
    next: Tensor<2>,
    exclusion: Tensor<2>,
    next_exclusion: Tensor<2>,
}

impl Memory {
    fn new() -> Self {
        let mut memory = Self {
            random: 1,
            rows: Vec::new(),
        };
        for _ in 0..MEMORY {
            let mut row = [0.0; 2 * STATES + 4 + 2 * USERS];
            row.fill_with(|| memory.uniform() * 2.0 - 1.0);
            row[2 * STATES + 3] = (memory.uniform() > 1.0 / 60.0).into();
            // All but one user in ten admitted, and the first always.
            for (m, x) in row[2 * STATES + 4..].iter_mut().enumerate() {
                *x = if m % USERS > 0 && *x < -0.8 {
                    EXCLUDED
                } else {
                    0.0
                };
            }
            memory.rows.push(row);
        }
        memory
    }

    /// In `[0, 1)`.
    fn uniform(&mut self) -> f32 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 40) as f32 / (1u64 << 24) as f32
    }

    fn sample(&mut self, device: &Device) -> Batch {
        let drawn: Vec<usize> = (0..BATCH)
            .map(|_| (self.uniform() * MEMORY as f32) as usize)
            .collect();
        let columns = |start: usize, len: usize| {
            let values: Vec<f32> = drawn
                .iter()
                .flat_map(|&i| self.rows[i][start..start + len].iter().copied())
                .collect();
            Tensor::<2>::from_data(TensorData::new(values, [BATCH, len]), device)
        };
        let users: Vec<i32> = drawn.iter().map(|i| (i % USERS) as i32).collect();
        Batch {
            states: columns(0, STATES),
            next: columns(STATES, STATES),
            action: columns(2 * STATES, 2),
            reward: columns(2 * STATES + 2, 1),
            follows: columns(2 * STATES + 3, 1),
            exclusion: columns(2 * STATES + 4, USERS),
            next_exclusion: columns(2 * STATES + 4 + USERS, USERS),
            user: Tensor::from_data(TensorData::new(users, [BATCH, 1]), device),
        }
    }
}

struct Sac {
    device: Device,
    policy: Trained<Mlp>,
    critics: [Trained<Mlp>; 2],
    targets: [Option<Mlp>; 2],
    temperatures: Trained<Temperatures>,
    memory: Memory,
}

fn least([first, second]: [&Mlp; 2], states: Tensor<2>, action: Tensor<2>) -> Tensor<2> {
    let input = Tensor::cat(vec![states, action], 1);
    first.forward(input.clone()).min_pair(second.forward(input))
}

impl Sac {
    fn new() -> Self {
        let plain = Device::flex();
        let device = plain.clone().autodiff();
        let critics = [(); 2].map(|()| Mlp::new(STATES + 2, USERS, &device));
        let targets = critics.each_ref().map(|critic| Some(critic.valid()));
        let log = Param::from_tensor(Tensor::full([2], 0.1_f32.ln(), &device));
        Self {
            policy: Trained::new(Mlp::new(STATES, 4 + USERS, &device)),
            critics: critics.map(Trained::new),
            targets,
            temperatures: Trained::new(Temperatures { log }),
            memory: Memory::new(),
            device: plain,
        }
    }

    fn learn(&mut self) {
        let batch = self.memory.sample(&self.device);
        let log = self.temperatures.module().log.val().without_autodiff();
        let beta = log
            .exp()
            .into_data()
            .try_to_vec::<f32>()
            .expect("two numbers");
        let beta = [beta[0], beta[1]];

        // eq:Q: no gradients on the way to the target.
        let next = sample_policy(
            &self.policy.module().valid(),
            batch.next.clone(),
            batch.next_exclusion,
            &self.device,
        );
        let targets = self.targets.each_ref().map(|t| t.as_ref().expect("there"));
        let value = least(targets, batch.next, next.displacement.clone());
        let value = -next.soft_cost(value, &beta);
        let target = batch.reward + batch.follows * value * DISCOUNT;
        let states = batch.states.autodiff();
        let input = Tensor::cat(vec![states.clone(), batch.action.autodiff()], 1);
        let (target, user) = (target.autodiff(), batch.user.autodiff());
        for critic in &mut self.critics {
            let values = critic.module().forward(input.clone());
            let error = values.gather(1, user.clone()) - target.clone();
            critic.descend(&(error.square() * 0.5).mean());
        }

        // eq:pi: through the critics to the displacement, not into their weights.
        let device = self.device.clone().autodiff();
        let exclusion = batch.exclusion.autodiff();
        let now = sample_policy(
            self.policy.module(),
            states.clone(),
            exclusion.clone(),
            &device,
        );
        let critics = self
            .critics
            .each_ref()
            .map(|c| c.module().clone().no_grad());
        let values = least(critics.each_ref(), states, now.displacement.clone());
        let loss = now.soft_cost(values, &beta).mean();
        self.policy.descend(&loss);

        // eq:beta.
        let admitted = exclusion
            .without_autodiff()
            .greater_equal_elem(-1.0)
            .float();
        let even = admitted.sum_dim(1).log() * USER_ENTROPY_FRACTION;
        let entropy = (now.user_prob * now.log_user_prob).without_autodiff();
        let surplus = -(entropy.sum_dim(1) + even).mean();
        let density = now.log_prob.without_autodiff().mean();
        let surplus = Tensor::cat(vec![-(density + DISPLACEMENT_ENTROPY), surplus], 0);
        let beta = self.temperatures.module().log.val().exp();
        self.temperatures
            .descend(&(beta * surplus.autodiff()).sum());

        for (target, critic) in self.targets.iter_mut().zip(&self.critics) {
            let network = target.take().expect("there");
            *target = Some(network.soft_update(&critic.module().valid()));
        }
    }
}

fn main() {
    let steps = std::env::args().nth(1).map_or(1_000, |text| {
        text.parse::<u32>().expect("STEPS must be a whole number")
    });
    let mut sac = Sac::new();
    for _ in 0..100 {
        sac.learn();
    }
    let start = Instant::now();
    for _ in 0..steps {
        sac.learn();
    }
    let rate = f64::from(steps) / start.elapsed().as_secs_f64();
    let weight = sac.policy.module().layers[2]
        .weight
        .val()
        .without_autodiff();
    let size: f32 = black_box(weight.square().sum().into_scalar());
    assert!(size.is_finite(), "the policy diverged");
    println!("burn {rate:.1}");
}
