//! Executes the runs of a sweep on the cores of this machine, one thread for each run.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use anyhow::bail;

use super::{
    plan::{Sweep, SweepRun},
    task::{StopFlag, TaskOutcome, WhenTaken, execute},
};

/// Executes all runs, `jobs` at a time, and calls `report` with the outcome of each. A run that fails
/// does not stop the others. Runs that another process executes are left for the end, so that several machines
/// may share a sweep.
pub fn execute_all(
    sweep: &Sweep,
    jobs: usize,
    stop: &StopFlag,
    report: impl Fn(&SweepRun, anyhow::Result<TaskOutcome>) + Sync,
) {
    let taken = Mutex::new(Vec::new());
    let all: Vec<&SweepRun> = sweep.runs.iter().collect();
    in_threads(&all, jobs, |run| {
        match guarded(sweep, run, WhenTaken::Skip, stop) {
            Ok(TaskOutcome::Taken) => {
                let mut taken = taken.lock().unwrap_or_else(PoisonError::into_inner);
                taken.push(run);
            }
            outcome => report(run, outcome),
        }
    });
    let taken = taken.into_inner().unwrap_or_else(PoisonError::into_inner);
    in_threads(&taken, jobs, |run| {
        report(run, guarded(sweep, run, WhenTaken::Wait, stop));
    });
}

/// Executes a run; a panic is the error of this run.
fn guarded(
    sweep: &Sweep,
    run: &SweepRun,
    when_taken: WhenTaken,
    stop: &StopFlag,
) -> anyhow::Result<TaskOutcome> {
    match catch_unwind(AssertUnwindSafe(|| execute(sweep, run, when_taken, stop))) {
        Ok(outcome) => outcome,
        Err(_) => bail!("internal error: it panicked"),
    }
}

/// Calls a function for each run, in `jobs` threads.
fn in_threads<'a>(runs: &[&'a SweepRun], jobs: usize, function: impl Fn(&'a SweepRun) + Sync) {
    let next = AtomicUsize::new(0);
    thread::scope(|scope| {
        for _ in 0..jobs.min(runs.len()) {
            scope.spawn(|| {
                while let Some(run) = runs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    function(run);
                }
            });
        }
    });
}
