//! Demonstrations from a thread in the background.
//!
//! Demonstrations are asked for by index and come in the order in which they were asked for, so what a run
//! learns from does not depend on how long a plan takes.

use std::{
    collections::VecDeque,
    sync::{Arc, mpsc},
    thread,
};

use anyhow::{Context, anyhow};
use planning::planner::HostPlanner;

use super::{
    demonstration::{Demonstration, planned},
    settings::ImitationSettings,
};
use crate::nn::sets::SetNetwork;

/// A mission to plan, and the network that flies it.
type Request = (u64, Option<Arc<SetNetwork>>);

/// A queue of demonstrations.
#[derive(Debug)]
pub struct Demonstrations {
    workers: Vec<Worker>,
    /// Demonstrations that have been made but not taken.
    ready: VecDeque<Demonstration>,
    /// The index of the next demonstration to be asked for.
    next: u64,
    /// The number of demonstrations that have been asked for and have not come.
    expected: usize,
}

#[derive(Debug)]
struct Worker {
    requests: mpsc::Sender<Request>,
    demonstrations: mpsc::Receiver<anyhow::Result<Demonstration>>,
}

impl Worker {
    fn start(settings: ImitationSettings) -> Self {
        let (requests, incoming) = mpsc::channel::<Request>();
        let (outgoing, demonstrations) = mpsc::channel();
        thread::spawn(move || {
            let plan = only_plan(&settings);
            for (index, network) in incoming {
                let demonstration = plan.as_ref().map_err(|error| anyhow!("{error:#}"));
                let demonstration = demonstration.and_then(|plan| {
                    Demonstration::new(&settings, index, network.as_deref(), plan.as_ref())
                });
                // The run is over when nobody takes demonstrations.
                if outgoing.send(demonstration).is_err() {
                    break;
                }
            }
        });
        Self {
            requests,
            demonstrations,
        }
    }
}

/// Plans the mission of a run that has only one.
fn only_plan(settings: &ImitationSettings) -> anyhow::Result<Option<HostPlanner>> {
    if settings.scenario.is_none() {
        return Ok(None);
    }
    planned(&settings.mission(0)?, settings.planning_operations).map(Some)
}

impl Demonstrations {
    /// Starts `threads` threads. The first demonstration to be asked for is `next`; before it, `ready` are
    /// taken.
    pub fn new(
        settings: &ImitationSettings,
        threads: usize,
        next: u64,
        ready: VecDeque<Demonstration>,
    ) -> Self {
        let start = |_| Worker::start(settings.clone());
        Self {
            workers: (0..threads.max(1)).map(start).collect(),
            ready,
            next,
            expected: 0,
        }
    }

    /// Returns the number of demonstrations that have been asked for and not taken.
    pub fn outstanding(&self) -> usize {
        self.ready.len() + self.expected
    }

    /// Asks for a demonstration, flown by `network` or by the planner.
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

    /// Takes the next demonstration, and waits for it if need be.
    ///
    /// # Errors
    /// Fails if it could not be planned.
    pub fn take(&mut self) -> anyhow::Result<Demonstration> {
        match self.ready.pop_front() {
            Some(demonstration) => Ok(demonstration),
            None => self.receive(),
        }
    }

    fn receive(&mut self) -> anyhow::Result<Demonstration> {
        let index = self.next - self.expected as u64;
        let worker = &self.workers[index as usize % self.workers.len()];
        self.expected = self.expected.saturating_sub(1);
        let demonstration = worker.demonstrations.recv();
        demonstration.context("a planning thread has failed")?
    }

    /// Waits for all demonstrations that have been asked for, and returns those that have not been taken
    /// and the index of the next one to be asked for.
    ///
    /// # Errors
    /// Fails if one could not be planned.
    pub fn settle(&mut self) -> anyhow::Result<(&VecDeque<Demonstration>, u64)> {
        while self.expected > 0 {
            let demonstration = self.receive()?;
            self.ready.push_back(demonstration);
        }
        Ok((&self.ready, self.next))
    }
}
