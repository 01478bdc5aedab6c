//! The subcommands. Each reads its arguments, calls the library and prints the result.

mod imitate;
mod outcome;
mod policies;
mod runs;
mod sweep;
mod train;

pub(crate) use policies::{Convert, Evaluate, Export, Probe};
pub(crate) use runs::{Compare, Curves, Publish};
pub(crate) use sweep::RunSweep;
pub(crate) use train::Train;
