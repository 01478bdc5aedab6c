//! Sweeps: many runs, described by one file.
//!
//! A sweep is the Cartesian product of scenarios, parameters of the mission, settings and seeds. Each
//! of its runs has a number and a directory, which are fixed before any of them is started, so that
//! any process on any machine with access to the folder can execute run number K: a finished run is
//! skipped, one that was stopped is resumed from its checkpoint, and any other one is started. All
//! engines, local threads, HyperQueue and Slurm, execute runs in this way and in no other.
//!
//! | module | content |
//! |---|---|
//! | [`file`] | the file that describes a sweep |
//! | [`fields`] | reads a table of TOML and names what is wrong |
//! | [`plan`] | the runs of a sweep, with their names, scenarios and settings |
//! | `choices` | the products of mission and settings |
//! | [`task`] | executes one run, whatever its state is |
//! | [`lock`] | excludes other processes from a run |
//! | [`record`] | the file that marks a run as finished, and the state of a run |
//! | [`local`] | executes runs on the cores of this machine |
//! | [`array`] | numbers of runs as the text of an array job |
//! | [`hyperqueue`], [`slurm`] | the array jobs |
//! | [`results`] | the table of a sweep's results |

pub mod array;
mod choices;
pub mod fields;
pub mod file;
pub mod hyperqueue;
pub mod local;
pub mod lock;
pub mod plan;
pub mod record;
pub mod results;
pub mod slurm;
pub mod task;
