//! The effects of a bad radio on frames: loss, duplication, reordering, corruption, delay and
//! outage.
//!
//! A [`Channel`] is one direction, without I/O: frames go in with the present time, and come out
//! when they are due, unless they are lost. It can connect two state machines. [`Impaired`] puts
//! two channels around any link. An [`Impairment`] is the form used on the command line. The same
//! seed gives the same losses.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io;
use std::str::FromStr;
use std::time::{Duration as WallDuration, Instant as WallInstant};

use firmware_core::time::{Duration, Instant};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::Link;

/// The faults of a channel. Probabilities are per frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faults {
    /// The probability that a frame is lost.
    pub loss: f64,
    /// The probability that a frame is delivered twice.
    pub duplication: f64,
    /// The probability that a frame is held back by up to `reordering_delay`, so that others
    /// overtake it.
    pub reordering: f64,
    /// The longest time for which a frame is held back.
    pub reordering_delay: Duration,
    /// The probability that one bit of a frame is flipped.
    pub corruption: f64,
    /// The delay of every frame.
    pub delay: Duration,
    /// The outage: nothing passes from the first time to the second.
    pub cut: Option<(Instant, Instant)>,
}

/// One direction of a link.
#[derive(Debug)]
pub struct Channel {
    faults: Faults,
    random: Pcg64Mcg,
    /// The frames under way, by due time and then in the order in which they were sent.
    waiting: BinaryHeap<Reverse<(Instant, u64, Vec<u8>)>>,
    came: u64,
}

impl Channel {
    /// Creates a channel with these faults.
    pub fn new(faults: Faults, seed: u64) -> Self {
        Self {
            faults,
            random: Pcg64Mcg::seed_from_u64(seed),
            waiting: BinaryHeap::new(),
            came: 0,
        }
    }

    /// Sends a frame.
    pub fn push(&mut self, now: Instant, frame: &[u8]) {
        let f = &self.faults;
        let is_cut = f.cut.is_some_and(|(from, to)| from <= now && now < to);
        // Every random number is drawn for every frame, so that what happens to one frame does not
        // change that of the next.
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

    /// Returns the next frame that arrives by `now`.
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

/// The faults of both directions of a link, in the form of `--impair`:
/// `loss=0.2,duplicate=0.05,reorder=0.05,reorder-ms=100,corrupt=0.01,delay-ms=40,seed=3`.
#[derive(Clone, Debug, PartialEq)]
pub struct Impairment {
    /// The faults of each direction.
    pub faults: Faults,
    /// The seed of the random numbers.
    pub seed: u64,
}

/// The longest time for which a frame is held back, unless `reorder-ms` is given.
const REORDERING_DELAY: Duration = Duration::from_millis(100);

impl Impairment {
    /// Returns the channels to the vehicle and from it, with two random streams of one seed.
    pub fn channels(&self) -> (Channel, Channel) {
        let channel = |seed| Channel::new(self.faults.clone(), seed);
        (channel(self.seed), channel(!self.seed))
    }
}

impl FromStr for Impairment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        const KEYS: &str = "loss, duplicate, reorder, corrupt (0 to 1), delay-ms, reorder-ms (0 to \
                            10000) and seed";
        let mut faults = Faults {
            reordering_delay: REORDERING_DELAY,
            ..Faults::default()
        };
        let mut seed = 1;
        for part in text.split(',') {
            let (key, value) = part
                .split_once('=')
                .ok_or_else(|| format!("`{part}` is not KEY=NUMBER; keys are {KEYS}"))?;
            let number = |limit: f64| {
                let number = value.parse::<f64>().ok();
                number.filter(|n| (0.0..=limit).contains(n)).ok_or_else(|| {
                    format!("{key} is `{value}`, but must be a number from 0 to {limit}")
                })
            };
            let duration = || number(10_000.0).map(|ms| Duration::from_secs_f64(ms * 1e-3));
            match key {
                "loss" => faults.loss = number(1.0)?,
                "duplicate" => faults.duplication = number(1.0)?,
                "reorder" => faults.reordering = number(1.0)?,
                "corrupt" => faults.corruption = number(1.0)?,
                "delay-ms" => faults.delay = duration()?,
                "reorder-ms" => faults.reordering_delay = duration()?,
                "seed" => {
                    seed = value
                        .parse()
                        .map_err(|_| format!("seed is `{value}`, but must be a whole number"))?;
                }
                other => return Err(format!("there is no `{other}`; keys are {KEYS}")),
            }
        }
        Ok(Self { faults, seed })
    }
}

/// A bad radio around a link, in real time. On the way out, it affects whole frames. On the way in,
/// it affects what was received together: a datagram, or a piece of a stream.
#[derive(Debug)]
pub struct Impaired {
    link: Box<dyn Link>,
    begun: WallInstant,
    up: Channel,
    down: Channel,
    piece: Vec<u8>,
}

impl Impaired {
    /// The longest time for which the inner link waits for input.
    const LOOK: WallDuration = WallDuration::from_millis(1);

    /// Wraps a link.
    pub fn new(link: Box<dyn Link>, impairment: &Impairment) -> Self {
        let (up, down) = impairment.channels();
        Self {
            link,
            begun: WallInstant::now(),
            up,
            down,
            piece: Vec::new(),
        }
    }

    fn now(&self) -> Instant {
        Instant::ZERO + Duration::from_secs_f64(self.begun.elapsed().as_secs_f64())
    }

    fn send_due(&mut self) -> io::Result<bool> {
        let mut up = true;
        while let Some(frame) = self.up.pop(self.now()) {
            up = self.link.send(&frame)?;
        }
        Ok(up)
    }
}

impl Link for Impaired {
    fn send(&mut self, frame: &[u8]) -> io::Result<bool> {
        self.up.push(self.now(), frame);
        self.send_due()
    }

    fn receive(&mut self, buffer: &mut Vec<u8>, timeout: WallDuration) -> io::Result<bool> {
        let begun = WallInstant::now();
        loop {
            self.send_due()?;
            if let Some(frame) = self.down.pop(self.now()) {
                *buffer = frame;
                return Ok(true);
            }
            let left = timeout.saturating_sub(begun.elapsed());
            if self.link.receive(&mut self.piece, left.min(Self::LOOK))? {
                self.down.push(self.now(), &self.piece);
            } else if left.is_zero() {
                buffer.clear();
                return Ok(false);
            }
        }
    }

    fn is_datagram(&self) -> bool {
        self.link.is_datagram()
    }

    fn last_error(&self) -> Option<String> {
        self.link.last_error()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impairments_are_read_and_wrong_ones_say_what_would_be_right() {
        let text = "loss=0.2,duplicate=0.05,reorder=0.1,corrupt=0.01,delay-ms=40,seed=3";
        let read: Impairment = text.parse().unwrap();
        let faults = Faults {
            loss: 0.2,
            duplication: 0.05,
            reordering: 0.1,
            reordering_delay: REORDERING_DELAY,
            corruption: 0.01,
            delay: Duration::from_millis(40),
            cut: None,
        };
        assert_eq!(read, Impairment { faults, seed: 3 });
        for (bad, complaint) in [
            ("", "`` is not KEY=NUMBER"),
            ("loss", "`loss` is not KEY=NUMBER"),
            ("loss=2", "loss is `2`, but must be a number from 0 to 1"),
            ("loss=nan", "from 0 to 1"),
            ("delay-ms=-1", "from 0 to 10000"),
            ("seed=x", "whole number"),
            ("latency=3", "there is no `latency`; keys are loss"),
        ] {
            let error = bad.parse::<Impairment>().unwrap_err();
            assert!(error.contains(complaint), "{bad}: {error}");
        }
    }

    /// A link that returns what was sent to it.
    #[derive(Debug, Default)]
    struct Echo(std::collections::VecDeque<Vec<u8>>);

    impl Link for Echo {
        fn send(&mut self, frame: &[u8]) -> io::Result<bool> {
            self.0.push_back(frame.to_vec());
            Ok(true)
        }

        fn receive(&mut self, buffer: &mut Vec<u8>, _: WallDuration) -> io::Result<bool> {
            buffer.clear();
            buffer.extend(self.0.pop_front().unwrap_or_default());
            Ok(!buffer.is_empty())
        }

        fn is_datagram(&self) -> bool {
            true
        }
    }

    #[test]
    fn around_a_link_both_directions_lose_and_double() {
        let through = |text: &str| {
            let impairment = text.parse().unwrap();
            let mut link = Impaired::new(Box::new(Echo::default()), &impairment);
            let (mut came, mut frame) = (0, Vec::new());
            for n in 0..2_000u32 {
                link.send(&n.to_be_bytes()).unwrap();
                while link.receive(&mut frame, WallDuration::ZERO).unwrap() {
                    came += 1;
                }
            }
            came
        };
        assert_eq!(through("loss=0"), 2_000);
        assert_eq!(through("loss=1"), 0);
        assert_eq!(through("duplicate=1"), 8_000);
        let passed = through("loss=0.2,seed=5");
        assert!((1_180..1_380).contains(&passed), "64 % of 2,000: {passed}");
    }

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
