//! An independent network in double precision, one state at a time, which tests differentiate
//! numerically. It reads the parameters in the order of the file.

use super::{batch::SetState, layout::Architecture};

struct Reader<'a>(&'a [f64]);

impl Reader<'_> {
    fn take(&mut self, count: usize) -> Vec<f64> {
        let (taken, rest) = self.0.split_at(count);
        self.0 = rest;
        taken.to_vec()
    }

    fn linear(&mut self, inputs: usize, outputs: usize) -> impl Fn(&[f64]) -> Vec<f64> + use<> {
        let weights = self.take(inputs * outputs);
        let bias = self.take(outputs);
        move |x: &[f64]| {
            assert_eq!(x.len(), inputs);
            let rows = weights.chunks(inputs).zip(&bias);
            rows.map(|(row, bias)| bias + dot(row, x)).collect()
        }
    }

    fn norm(&mut self, width: usize) -> impl Fn(&[f64]) -> Vec<f64> + use<> {
        let scales = self.take(width);
        move |x: &[f64]| {
            let mean = x.iter().sum::<f64>() / width as f64;
            let variance = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / width as f64;
            let scaled = x.iter().zip(&scales);
            scaled
                .map(|(x, s)| s * (x - mean) / (variance + 1e-5).sqrt())
                .collect()
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

fn silu(x: Vec<f64>) -> Vec<f64> {
    x.into_iter().map(|x| x * sigmoid(x)).collect()
}

fn softmax(x: &[f64]) -> Vec<f64> {
    let largest = x.iter().copied().fold(f64::MIN, f64::max);
    let exponentials: Vec<f64> = x.iter().map(|x| (x - largest).exp()).collect();
    let total: f64 = exponentials.iter().sum();
    exponentials.iter().map(|x| x / total).collect()
}

fn wide(x: &[f32]) -> Vec<f64> {
    x.iter().map(|&x| x.into()).collect()
}

/// A candidate for the displacement, and its logit.
pub(super) type Candidate = ([f64; 2], f64);

/// Returns the candidates for the displacement and the users' scores of one state.
pub(super) fn forward(
    architecture: Architecture,
    state: &SetState<'_>,
    parameters: &[f64],
) -> (Vec<Candidate>, Vec<f64>) {
    let width = architecture.width;
    let (tokens, mut next) = tokens(architecture, state, &wide(state.mission), parameters);
    let (first, second) = (next.linear(width, width), next.linear(width, 15));
    let outputs = second(&silu(first(&tokens[0])));
    let rated = per_user(width, &tokens, &mut next, 4);
    let candidate = |(index, o): (usize, &[f64])| {
        let pulls: Vec<f64> = rated.iter().map(|row| 3.0 * row[1 + index]).collect();
        let shares = softmax(&pulls);
        let u = [0, 1].map(|i| {
            let point: f64 = (shares.iter().zip(state.to_users))
                .map(|(share, to)| share * f64::from(to[i]))
                .sum();
            sigmoid(o[2]) * point + sigmoid(o[3]) * f64::from(state.to_destination[i]) + o[i]
        });
        let length = u[0].hypot(u[1]).max(1.0);
        (u.map(|u| u / length), o[4])
    };
    let candidates = outputs.chunks(5).enumerate().map(candidate).collect();
    (candidates, rated.iter().map(|r| r[0]).collect())
}

/// Returns the users' values of a critic in one state, whose mission has other features.
pub(super) fn values(
    architecture: Architecture,
    state: &SetState<'_>,
    mission: &[f64],
    parameters: &[f64],
) -> Vec<f64> {
    let (tokens, mut next) = tokens(architecture, state, mission, parameters);
    let rated = per_user(architecture.width, &tokens, &mut next, 1);
    rated.iter().map(|r| r[0]).collect()
}

/// Returns the outputs of the users' head, which is the last one.
fn per_user(
    width: usize,
    tokens: &[Vec<f64>],
    next: &mut Reader<'_>,
    outputs: usize,
) -> Vec<Vec<f64>> {
    let (first, second) = (next.linear(2 * width, width), next.linear(width, outputs));
    assert!(next.0.is_empty(), "{} parameters too many", next.0.len());
    let rate = |token: &Vec<f64>| second(&silu(first(&[&token[..], &tokens[0]].concat())));
    tokens[1..].iter().map(rate).collect()
}

/// Returns the final tokens, and the parameters of the heads.
fn tokens<'a>(
    architecture: Architecture,
    state: &SetState<'_>,
    mission: &[f64],
    parameters: &'a [f64],
) -> (Vec<Vec<f64>>, Reader<'a>) {
    let Architecture {
        width,
        hidden,
        layers,
    } = architecture;
    let users = state.to_users.len();
    let user = state.users.len() / users;
    let mut next = Reader(parameters);
    let sensor = state.sensors.len() / 3; // tests have three sensors in each state
    let first = next.linear(sensor, width);
    let second = next.linear(width, width);
    let encoded: Vec<Vec<f64>> = (state.sensors.chunks(sensor))
        .map(|row| second(&silu(first(&wide(row)))))
        .collect();
    let mut input = mission.to_vec();
    let count = encoded.len() as f64;
    input.extend((0..width).map(|i| encoded.iter().map(|h| h[i]).sum::<f64>() / count));
    input.extend((0..width).map(|i| encoded.iter().map(|h| h[i]).fold(f64::MIN, f64::max)));
    let mut tokens = vec![next.linear(mission.len() + 2 * width, width)(&input)];
    let embed = next.linear(user, width);
    tokens.extend(state.users.chunks(user).map(|row| embed(&wide(row))));
    for _ in 0..layers {
        let norm = next.norm(width);
        let (qkv, mix) = (next.linear(width, 3 * width), next.linear(width, width));
        let rows: Vec<Vec<f64>> = tokens.iter().map(|t| qkv(&norm(t))).collect();
        for (token, row) in tokens.iter_mut().zip(&rows) {
            let mut attended = Vec::new();
            for head in 0..4 {
                let w = width / 4;
                let part = |row: &[f64], which: usize| {
                    row[which * width + head * w..which * width + (head + 1) * w].to_vec()
                };
                let q = part(row, 0);
                let scores: Vec<f64> = (rows.iter())
                    .map(|other| dot(&q, &part(other, 1)) / (w as f64).sqrt())
                    .collect();
                let shares = softmax(&scores);
                attended.extend((0..w).map(|d| {
                    let values = rows.iter().zip(&shares);
                    values.map(|(other, p)| p * part(other, 2)[d]).sum::<f64>()
                }));
            }
            let change = mix(&attended);
            token.iter_mut().zip(change).for_each(|(t, c)| *t += c);
        }
        let norm = next.norm(width);
        let (up, down) = (next.linear(width, hidden), next.linear(hidden, width));
        for token in &mut tokens {
            let change = down(&silu(up(&norm(token))));
            token.iter_mut().zip(change).for_each(|(t, c)| *t += c);
        }
    }
    let norm = next.norm(width);
    (tokens.iter().map(|t| norm(t)).collect(), next)
}
