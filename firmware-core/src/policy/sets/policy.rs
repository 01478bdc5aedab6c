// SPDX-License-Identifier: MIT OR Apache-2.0
//! A policy for any mission, on the bytes of its file.

use core::fmt;

use heapless::Vec;

use super::{
    columns::{SENSORS, USERS},
    error::SetsLoadError,
    format::{SetsHeader, SetsProvenance, read},
    network::{SetsOutput, SetsWork},
    observation::SetsObservation,
};
use crate::{
    collect::collect_first,
    inner::Workspace,
    mission::{Mission, MissionChange},
    policy::{Action, MeasuredGains, Observation, PlanQuality, Policy},
    scalar::{Displacement, Scalar},
};

/// A network on the bytes of its file, which it reads in place: `&'static [u8]` in flash, `Vec<u8>`
/// on a host.
#[derive(Clone)]
pub struct SetsNetwork<B> {
    file: B,
    header: SetsHeader,
    /// The offset of the weights.
    start: usize,
}

impl<B> fmt::Debug for SetsNetwork<B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SetsNetwork")
            .field("header", &self.header)
            .finish_non_exhaustive()
    }
}

impl<B: AsRef<[u8]>> SetsNetwork<B> {
    /// Loads a network: checks the file's bytes and its test vector.
    ///
    /// # Errors
    /// Returns what is wrong with the file.
    pub fn load(file: B, work: &mut SetsWork) -> Result<Self, SetsLoadError> {
        let (header, start) = read(file.as_ref(), work)?;
        Ok(Self {
            file,
            header,
            start,
        })
    }

    /// Returns the header, with provenance and sizes.
    pub fn header(&self) -> &SetsHeader {
        &self.header
    }

    /// Returns the origin of the policy.
    pub fn provenance(&self) -> &SetsProvenance {
        &self.header.provenance
    }

    /// Evaluates the network. `None` means that `B` returns other bytes than when the file was
    /// loaded.
    ///
    /// Worst case: `docs/training.md` has the instructions of a decision.
    pub fn evaluate(
        &self,
        observation: &SetsObservation,
        work: &mut SetsWork,
    ) -> Option<SetsOutput> {
        let end = self.start + self.header.weight_bytes();
        let weights = self.file.as_ref().get(self.start..end)?;
        self.header.evaluate(weights, observation, work)
    }
}

/// Error returned when a mission has more users or sensors than a policy observes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the policy observes at most {most} {what}, but the mission has {got}")]
pub struct SetsMismatch {
    /// `users` or `sensors`.
    pub what: &'static str,
    /// How many the mission has.
    pub got: usize,
    /// How many the policy observes.
    pub most: usize,
}

/// A network that is ready to evaluate observations.
pub trait EvaluateSets {
    /// Evaluates the network. `None` means that it cannot be evaluated, which the controller reports
    /// as a broken policy.
    fn evaluate(&mut self, observation: &SetsObservation) -> Option<SetsOutput>;
}

/// A [`SetsNetwork`] with the memory for evaluating it, `W`: a [`SetsWork`], or a box or mutable
/// reference of one.
#[derive(Clone, Debug)]
pub struct NetworkWithWork<B, W> {
    /// The network.
    pub network: SetsNetwork<B>,
    /// The memory.
    pub work: W,
}

impl<B: AsRef<[u8]>, W: AsMut<SetsWork>> EvaluateSets for NetworkWithWork<B, W> {
    fn evaluate(&mut self, observation: &SetsObservation) -> Option<SetsOutput> {
        self.network.evaluate(observation, self.work.as_mut())
    }
}

/// A network `N` as a [`Policy`]: with the mission, which it observes.
#[derive(Clone, Debug)]
pub struct SetsPolicy<T: Scalar, N, const M: usize, const J: usize> {
    network: N,
    mission: Mission<T, M, J>,
    workspace: Workspace<T, J>,
}

impl<T: Scalar, N: EvaluateSets, const M: usize, const J: usize> SetsPolicy<T, N, M, J> {
    /// Checks whether a mission has no more users and sensors than are observed.
    ///
    /// # Errors
    /// Returns an error if it has more.
    pub fn check(mission: &Mission<T, M, J>) -> Result<(), SetsMismatch> {
        for (what, got, most) in [
            ("users", mission.users().count(), USERS),
            ("sensors", mission.sensors().count(), SENSORS),
        ] {
            if got > most {
                return Err(SetsMismatch { what, got, most });
            }
        }
        Ok(())
    }

    /// Creates the policy for a mission. It fits any mission that does not have too many users or
    /// sensors.
    ///
    /// # Errors
    /// As [`check`](Self::check).
    pub fn new(network: N, mission: &Mission<T, M, J>) -> Result<Self, SetsMismatch> {
        Self::check(mission)?;
        Ok(Self {
            network,
            mission: mission.clone(),
            workspace: Workspace::default(),
        })
    }

    /// Returns the network.
    pub fn network(&self) -> &N {
        &self.network
    }

    /// Returns the mission as it is known, with all changes.
    pub fn mission(&self) -> &Mission<T, M, J> {
        &self.mission
    }
}

impl<T: Scalar, N: EvaluateSets, const M: usize, const J: usize> Policy<T, M>
    for SetsPolicy<T, N, M, J>
{
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M> {
        let sets = SetsObservation::new(&self.mission, observation, &mut self.workspace);
        let Some(output) = self.network.evaluate(&sets) else {
            // This action is not sound, and the controller reports it as broken.
            return Action {
                displacement: Displacement::repeat(T::of(f64::NAN)),
                user_scores: Vec::new(),
            };
        };
        let mut scores = output.user_scores.iter().take(sets.user_rows().len());
        // Users that left, and those that are not observed, come last.
        let mut score = |user: usize| {
            let present = self.mission.has_user(user);
            let score = if present { scores.next() } else { None };
            score.map_or(-T::LARGEST, |&score| T::of(score.into()))
        };
        let users = observation.counts.len().min(M);
        let component = |x: f32| T::of(x.into());
        let [east_m, north_m] = output.displacement_m;
        Action {
            displacement: Displacement::new(component(east_m), component(north_m)),
            user_scores: collect_first((0..users).map(&mut score)),
        }
    }

    /// Observes the changed mission from now on. A change that the mission refuses is refused by the
    /// controller as well.
    fn revise(&mut self, change: &MissionChange<T>, slots_begun: u32) {
        let _ = self.mission.change(change, slots_begun);
    }

    fn note_gains(&mut self, _: &MeasuredGains<'_, T>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<PlanQuality> {
        None
    }
}
