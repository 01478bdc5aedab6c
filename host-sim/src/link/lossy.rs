//! What a bad radio does to frames: loss, duplication, reordering, corruption, delay, a cut.
//!
//! A [`Channel`] is one direction, without I/O: frames go in with the time, and come out when
//! they are due, if at all. It goes around any link or between two state machines; the same
//! seed gives the same losses.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use firmware_core::time::{Duration, Instant};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// How bad it is. Probabilities are per frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faults {
    /// A frame is lost.
    pub loss: f64,
    /// A frame comes twice.
    pub duplication: f64,
    /// A frame is held back by up to `reordering_delay`, so that others overtake it.
    pub reordering: f64,
    /// How far a frame can be held back.
    pub reordering_delay: Duration,
    /// One bit of a frame is wrong.
    pub corruption: f64,
    /// Every frame is late by this.
    pub delay: Duration,
    /// Nothing passes from the first moment to the second.
    pub cut: Option<(Instant, Instant)>,
}

/// One direction of a link.
#[derive(Debug)]
pub struct Channel {
    faults: Faults,
    random: Pcg64Mcg,
    /// By due time, then in the order they came.
    waiting: BinaryHeap<Reverse<(Instant, u64, Vec<u8>)>>,
    came: u64,
}

impl Channel {
    /// A channel with these faults.
    pub fn new(faults: Faults, seed: u64) -> Self {
        Self {
            faults,
            random: Pcg64Mcg::seed_from_u64(seed),
            waiting: BinaryHeap::new(),
            came: 0,
        }
    }

    /// A frame is sent.
    pub fn push(&mut self, now: Instant, frame: &[u8]) {
        let f = &self.faults;
        let is_cut = f.cut.is_some_and(|(from, to)| from <= now && now < to);
        // Every draw is made for every frame: what happens to one frame does not change what
        // happens to the next.
        let mut draw = || self.random.random::<f64>();
        let (lost, twice, held, wrong) = (draw(), draw(), draw(), draw());
        let (how_long, which_bit) = (draw(), draw());
        if is_cut || lost < f.loss {
            return;
        }
        let mut due = now + f.delay;
        if held < f.reordering {
            due += Duration::from_secs_f64(f.reordering_delay.as_secs_f64() * how_long);
        }
        let mut frame = frame.to_vec();
        if wrong < f.corruption && !frame.is_empty() {
            let bit = (which_bit * (frame.len() * 8) as f64) as usize;
            frame[bit / 8] ^= 1 << (bit % 8);
        }
        let copies = if twice < f.duplication { 2 } else { 1 };
        for _ in 0..copies {
            self.waiting.push(Reverse((due, self.came, frame.clone())));
            self.came += 1;
        }
    }

    /// The next frame that arrives by `now`.
    pub fn pop(&mut self, now: Instant) -> Option<Vec<u8>> {
        let due = self
            .waiting
            .peek()
            .is_some_and(|Reverse((due, ..))| *due <= now);
        due.then(|| self.waiting.pop())
            .flatten()
            .map(|Reverse((_, _, frame))| frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(faults: Faults, seed: u64) -> Vec<u32> {
        let mut channel = Channel::new(faults, seed);
        let mut got = Vec::new();
        for n in 0..10_000u32 {
            let now = Instant::from_micros(u64::from(n) * 1_000);
            channel.push(now, &n.to_be_bytes());
            while let Some(frame) = channel.pop(now) {
                got.push(u32::from_be_bytes(frame.try_into().unwrap()));
            }
        }
        got
    }

    #[test]
    fn without_faults_all_pass_in_order() {
        assert_eq!(run(Faults::default(), 1), (0..10_000).collect::<Vec<_>>());
    }

    #[test]
    fn faults_happen_as_often_as_asked_and_the_same_each_time() {
        let faults = Faults {
            loss: 0.2,
            duplication: 0.05,
            reordering: 0.05,
            reordering_delay: Duration::from_millis(20),
            ..Faults::default()
        };
        let got = run(faults.clone(), 7);
        assert_eq!(got, run(faults.clone(), 7));
        assert_ne!(got, run(faults, 8));
        let mut distinct = got.clone();
        distinct.sort_unstable();
        distinct.dedup();
        let lost = 1.0 - distinct.len() as f64 / 1e4;
        let twice = (got.len() - distinct.len()) as f64 / distinct.len() as f64;
        assert!((lost - 0.2).abs() < 0.015, "{lost}");
        assert!((twice - 0.05).abs() < 0.01, "{twice}");
        assert!(got.windows(2).any(|pair| pair[0] > pair[1]), "reordered");
    }

    #[test]
    fn a_cut_lets_nothing_through() {
        let cut = Some((
            Instant::from_micros(2_000_000),
            Instant::from_micros(3_000_000),
        ));
        let got = run(
            Faults {
                cut,
                ..Faults::default()
            },
            1,
        );
        assert!(got.contains(&1_999) && !got.contains(&2_000));
        assert!(!got.contains(&2_999) && got.contains(&3_000));
    }
}
