//! The runs that train a policy for any mission, as read from their checkpoints: by imitation
//! ([`imitation::run`](crate::imitation::run)) or by SAC
//! ([`reinforcement::run`](crate::reinforcement::run)).

use std::{fs::File, io::Read, path::Path};

use crate::{
    imitation::{
        run::{self as imitation, Summary},
        trained::TrainedNetwork,
    },
    reinforcement::run::saved as reinforcement,
};

/// How a policy for any mission is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// By imitation of the planner.
    Imitation,
    /// By SAC.
    Reinforcement,
}

/// Returns how the run of a checkpoint trains a policy for any mission, or `None` if the file is no
/// checkpoint of such a run.
pub fn method(path: &Path) -> Option<Method> {
    let mut magic = [0; 4];
    File::open(path).ok()?.read_exact(&mut magic).ok()?;
    match magic {
        imitation::MAGIC => Some(Method::Imitation),
        reinforcement::MAGIC => Some(Method::Reinforcement),
        _ => None,
    }
}

/// Reads the best network of a checkpoint, or the latest one if none has been evaluated or `latest`
/// asks for it.
///
/// # Errors
/// Fails if the file is no valid checkpoint of a run for any mission.
pub fn read_network(path: &Path, latest: bool) -> anyhow::Result<TrainedNetwork> {
    match method(path) {
        Some(Method::Reinforcement) => reinforcement::Saved::read(path)?.network(latest),
        _ => imitation::read_network(path, latest),
    }
}

/// Reads what a run did until it was saved.
///
/// # Errors
/// Fails if the file is no valid checkpoint of a run for any mission.
pub fn read_summary(path: &Path) -> anyhow::Result<Summary> {
    match method(path) {
        Some(Method::Reinforcement) => Ok(reinforcement::Saved::read(path)?.summary()),
        _ => imitation::read_summary(path),
    }
}
