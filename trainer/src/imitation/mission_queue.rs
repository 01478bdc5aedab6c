//! Missions that threads in the background prepare, by planning them for instance.
//!
//! Missions are asked for by index and come in the order in which they were asked for, so what a run
//! learns from does not depend on how long a plan takes.

use std::{
    collections::VecDeque,
    sync::{Arc, mpsc},
    thread,
};

use anyhow::Context;

use crate::nn::sets::SetNetwork;

/// A mission to prepare, and the network that flies it.
type Request = (u64, Option<Arc<SetNetwork>>);

/// A queue of prepared missions `T`.
#[derive(Debug)]
pub struct MissionQueue<T> {
    workers: Vec<Worker<T>>,
    /// Missions that have been prepared but not taken.
    ready: VecDeque<T>,
    /// The index of the next mission to be asked for.
    next: u64,
    /// The number of missions that have been asked for and have not come.
    expected: usize,
}

#[derive(Debug)]
struct Worker<T> {
    requests: mpsc::Sender<Request>,
    prepared: mpsc::Receiver<anyhow::Result<T>>,
}

impl<T: Send + 'static> Worker<T> {
    fn start<F>(mut prepare: F) -> Self
    where
        F: FnMut(u64, Option<&SetNetwork>) -> anyhow::Result<T> + Send + 'static,
    {
        let (requests, incoming) = mpsc::channel::<Request>();
        let (outgoing, prepared) = mpsc::channel();
        thread::spawn(move || {
            for (index, network) in incoming {
                // The run is over when nobody takes missions.
                if outgoing.send(prepare(index, network.as_deref())).is_err() {
                    break;
                }
            }
        });
        Self { requests, prepared }
    }
}

impl<T: Send + 'static> MissionQueue<T> {
    /// Starts `threads` threads, each of which prepares missions by a function that `preparation`
    /// returns. The first mission to be asked for is `next`; before it, `ready` are taken.
    pub fn new<F>(
        preparation: impl Fn() -> F,
        threads: usize,
        next: u64,
        ready: VecDeque<T>,
    ) -> Self
    where
        F: FnMut(u64, Option<&SetNetwork>) -> anyhow::Result<T> + Send + 'static,
    {
        let start = |_| Worker::start(preparation());
        Self {
            workers: (0..threads.max(1)).map(start).collect(),
            ready,
            next,
            expected: 0,
        }
    }

    /// Asks for a mission, flown by `network` or by the planner.
    ///
    /// # Errors
    /// Fails if a thread has failed.
    pub fn ask(&mut self, network: Option<Arc<SetNetwork>>) -> anyhow::Result<()> {
        let worker = &self.workers[self.next as usize % self.workers.len()];
        let sent = worker.requests.send((self.next, network));
        sent.ok().context("a planning thread has failed")?;
        self.next += 1;
        self.expected += 1;
        Ok(())
    }

    /// Takes the next mission, and waits for it if need be.
    ///
    /// # Errors
    /// Fails if it could not be prepared.
    pub fn take(&mut self) -> anyhow::Result<T> {
        match self.ready.pop_front() {
            Some(mission) => Ok(mission),
            None => self.receive(),
        }
    }

    fn receive(&mut self) -> anyhow::Result<T> {
        let index = self.next - self.expected as u64;
        let worker = &self.workers[index as usize % self.workers.len()];
        self.expected = self.expected.saturating_sub(1);
        let mission = worker.prepared.recv();
        mission.context("a planning thread has failed")?
    }

    /// Waits for all missions that have been asked for, and returns those that have not been taken
    /// and the index of the next one to be asked for.
    ///
    /// # Errors
    /// Fails if one could not be prepared.
    pub fn settle(&mut self) -> anyhow::Result<(&VecDeque<T>, u64)> {
        while self.expected > 0 {
            let mission = self.receive()?;
            self.ready.push_back(mission);
        }
        Ok((&self.ready, self.next))
    }
}
