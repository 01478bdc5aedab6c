//! Executes one run of a sweep, whatever its state is.
//!
//! Any number of processes may do so at any time, also for the same run: a lock admits one of them,
//! and the others find the run finished. A process may be killed at any time: checkpoints and the record of
//! a finished run are written atomically, and a resumed run writes the same bytes as an undisturbed
//! one.

use std::{
    fs, io,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use anyhow::{Context, bail, ensure};

use crate::{
    checkpoint::{self, TrainingProgress},
    ddpg::Ddpg,
    learner::Learner,
    run::{CHECKPOINT, DIVERGED, has_run},
    sac::Sac,
    settings::Algorithm,
    training::Training,
};

use super::{
    lock::RunLock,
    plan::{Sweep, SweepRun},
    record::RunRecord,
};

/// A flag that ends runs after their current episode, with a checkpoint.
pub type StopFlag = Arc<AtomicBool>;

/// What to do with a run that another process executes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenTaken {
    /// Return [`TaskOutcome::Taken`].
    Skip,
    /// Wait until it is finished there or that process has ended.
    Wait,
}

/// What became of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum TaskOutcome {
    /// It had been finished before.
    AlreadyFinished(RunRecord),
    /// It has been finished now.
    Finished(RunRecord),
    /// Another process executes it.
    Taken,
    /// The flag was set. If the run had begun, its checkpoint has been written.
    Interrupted,
}

/// The time between two attempts to lock a run. A blocking call could not be interrupted by the flag.
const LOCK_PERIOD: Duration = Duration::from_millis(200);

/// Skips a finished run, resumes one that was stopped, and starts any other.
///
/// # Errors
/// Fails if a loss diverges, now or earlier, if the directory contains another run, or if a file
/// cannot be read or written.
pub fn execute(
    sweep: &Sweep,
    run: &SweepRun,
    when_taken: WhenTaken,
    stop: &StopFlag,
) -> anyhow::Result<TaskOutcome> {
    let directory = sweep.directory(run);
    let finished = || -> anyhow::Result<Option<TaskOutcome>> {
        let Some(record) = RunRecord::read(&directory)? else {
            return Ok(None);
        };
        check_same(run, &directory, &record)?;
        Ok(Some(TaskOutcome::AlreadyFinished(record)))
    };
    if let Some(outcome) = finished()? {
        return Ok(outcome);
    }
    if stop.load(Ordering::Relaxed) {
        return Ok(TaskOutcome::Interrupted);
    }
    fs::create_dir_all(&directory).with_context(|| directory.display().to_string())?;
    let _lock = loop {
        match RunLock::try_exclusive(&directory)? {
            Some(lock) => break lock,
            None if when_taken == WhenTaken::Skip => return Ok(TaskOutcome::Taken),
            None => thread::sleep(LOCK_PERIOD),
        }
        if stop.load(Ordering::Relaxed) {
            return Ok(TaskOutcome::Interrupted);
        }
    };
    // Another process may have finished it while this one waited.
    if let Some(outcome) = finished()? {
        return Ok(outcome);
    }
    let diverged = directory.join(DIVERGED);
    ensure!(
        !diverged.exists(),
        "it diverged earlier and would do so again: see {}; without this file it is tried again",
        diverged.display()
    );
    remove_drafts(&directory).with_context(|| directory.display().to_string())?;
    let progress = match run.settings.algorithm {
        Algorithm::Sac => train::<Sac>(run, &directory, stop)?,
        Algorithm::Ddpg => train::<Ddpg>(run, &directory, stop)?,
    };
    if progress.episode < run.settings.episodes {
        return Ok(TaskOutcome::Interrupted);
    }
    let record = RunRecord::of(&progress);
    record.write(&directory)?;
    if !sweep.keep_checkpoints {
        let path = directory.join(CHECKPOINT);
        fs::remove_file(&path).with_context(|| path.display().to_string())?;
    }
    Ok(TaskOutcome::Finished(record))
}

/// Resumes or starts a run, and trains it until it is complete or the flag is set.
fn train<L: Learner>(
    run: &SweepRun,
    directory: &Path,
    stop: &StopFlag,
) -> anyhow::Result<TrainingProgress> {
    let checkpoint = directory.join(CHECKPOINT);
    let damaged = has_run(directory) && {
        let damaged = checkpoint::is_damaged(&checkpoint);
        damaged.with_context(|| checkpoint.display().to_string())?
    };
    if damaged {
        eprintln!(
            "warning: {} is damaged: the run starts from the beginning",
            checkpoint.display()
        );
    }
    let scenario = run.scenario.as_ref().clone();
    let training = match has_run(directory) && !damaged {
        true => {
            let progress = checkpoint::read_progress(&checkpoint)?;
            check_same(run, directory, &RunRecord::of(&progress))?;
            // It was killed between its last checkpoint and its record.
            if progress.episode >= run.settings.episodes {
                return Ok(progress);
            }
            Training::<L>::resume(scenario, directory.to_owned(), None)?
        }
        false => Training::<L>::start(scenario, run.settings.clone(), directory.to_owned())?,
    };
    training.stopped_by(Arc::clone(stop)).run(false)
}

/// Checks that what a directory contains belongs to this run: the scenario file, or the preset in another
/// version of this program, may have been changed since.
fn check_same(run: &SweepRun, directory: &Path, found: &RunRecord) -> anyhow::Result<()> {
    let place = directory.display();
    ensure!(
        found.scenario_digest == run.scenario.digest(),
        "{place}: it contains a run on another scenario: {} had the digest {:.12} there, and has {:.12} now",
        found.scenario,
        found.scenario_digest,
        run.scenario.digest()
    );
    if found.settings != run.settings {
        let (there, here) = (
            toml::Table::try_from(&found.settings)?,
            toml::Table::try_from(&run.settings)?,
        );
        let differing = here
            .iter()
            .find(|(key, value)| there.get(*key) != Some(value));
        let (key, value) = differing.context("settings differ")?;
        let there = there.get(key).map(ToString::to_string).unwrap_or_default();
        bail!("{place}: it contains another run: {key} is {there} there, and {value} in the sweep");
    }
    Ok(())
}

/// Removes the temporary files that a killed process left. Each may have the size of a checkpoint.
fn remove_drafts(directory: &Path) -> io::Result<()> {
    for entry in fs::read_dir(directory)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with('.') && name.ends_with(".partial") {
            fs::remove_file(&path)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::record::RunState;

    const TEXT: &str = "scenarios = \"separated\"\nseeds = [1, 2]\n[settings]\nepisodes = 4\n\
                        hidden = 16\nbatch = 8\nwarmup_slots = 60\nbuffer_capacity = 500\n\
                        checkpoint_every = 2\nevaluate_every = 2\n";

    fn sweep(folder: &Path, text: &str) -> Sweep {
        let file = folder.join("s.toml");
        fs::write(&file, text).unwrap();
        Sweep::load(&file, None).unwrap()
    }

    fn run(sweep: &Sweep, number: usize) -> anyhow::Result<TaskOutcome> {
        let stop = StopFlag::default();
        execute(sweep, sweep.run(number)?, WhenTaken::Skip, &stop)
    }

    #[test]
    fn a_finished_run_is_skipped_and_a_damaged_checkpoint_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let sweep = sweep(folder.path(), TEXT);
        let TaskOutcome::Finished(record) = run(&sweep, 1).unwrap() else {
            panic!("not finished");
        };
        assert_eq!(record.episodes, 4);
        assert!(record.best.unwrap().sum_rate > 0.0);
        let again = run(&sweep, 1).unwrap();
        assert_eq!(again, TaskOutcome::AlreadyFinished(record.clone()));

        let directory = sweep.directory(&sweep.runs[0]);
        let checkpoint = directory.join(CHECKPOINT);
        let whole = fs::read(&checkpoint).unwrap();
        for length in [0, 7, whole.len() / 2] {
            fs::remove_file(directory.join(super::super::record::RECORD)).unwrap();
            fs::write(&checkpoint, &whole[..length]).unwrap();
            fs::write(directory.join(".abc.partial"), "left behind").unwrap();
            assert_eq!(
                run(&sweep, 1).unwrap(),
                TaskOutcome::Finished(record.clone())
            );
            assert!(fs::read(&checkpoint).unwrap() == whole);
            assert!(!directory.join(".abc.partial").exists());
        }
    }

    #[test]
    fn a_run_that_is_interrupted_is_resumed() {
        let folder = tempfile::tempdir().unwrap();
        let text = TEXT.replace("seeds", "keep_checkpoints = false\nseeds");
        let sweep = sweep(folder.path(), &text);
        let first = &sweep.runs[0];
        let stop = StopFlag::default();
        stop.store(true, Ordering::Relaxed);
        let outcome = execute(&sweep, first, WhenTaken::Wait, &stop).unwrap();
        assert_eq!(outcome, TaskOutcome::Interrupted);
        let directory = sweep.directory(first);
        assert_eq!(RunState::of(&directory), RunState::NotBegun);
        assert!(matches!(run(&sweep, 1).unwrap(), TaskOutcome::Finished(_)));
        assert_eq!(RunState::of(&directory), RunState::Finished);
        assert!(!directory.join(CHECKPOINT).exists());
    }

    #[test]
    fn a_run_of_another_process_is_left_to_it() {
        let folder = tempfile::tempdir().unwrap();
        let sweep = sweep(folder.path(), TEXT);
        let directory = sweep.directory(&sweep.runs[0]);
        fs::create_dir_all(&directory).unwrap();
        let lock = RunLock::try_exclusive(&directory).unwrap();
        assert_eq!(run(&sweep, 1).unwrap(), TaskOutcome::Taken);
        assert_eq!(RunState::of(&directory), RunState::Running);
        assert!(!has_run(&directory));
        drop(lock);
        assert!(matches!(run(&sweep, 1).unwrap(), TaskOutcome::Finished(_)));
    }

    #[test]
    fn another_run_in_the_directory_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let first = sweep(folder.path(), TEXT);
        run(&first, 1).unwrap();
        // The same name with other content, as another version of the presets would have.
        let mut second = sweep(folder.path(), TEXT);
        second.runs[0].settings.tau = 0.5;
        let directory = second.directory(&second.runs[0]);
        let check = |expected: &str| {
            let problem = run(&second, 1).unwrap_err().to_string();
            assert!(problem.contains(expected), "{problem}");
            // Without the record, the checkpoint is checked.
            let _ = fs::remove_file(directory.join(super::super::record::RECORD));
        };
        for _ in 0..2 {
            check("target_rate is 0.004999999888241291 there, and 0.5 in the sweep");
        }
    }

    #[test]
    fn a_run_that_diverged_is_not_tried_again() {
        let folder = tempfile::tempdir().unwrap();
        let text = format!("{TEXT}learning_rate = 1e6\n");
        let sweep = sweep(folder.path(), &text);
        let problem = run(&sweep, 1).unwrap_err().to_string();
        assert!(problem.starts_with("episode "), "{problem}");
        let directory = sweep.directory(&sweep.runs[0]);
        assert_eq!(RunState::of(&directory), RunState::Diverged);
        let problem = run(&sweep, 1).unwrap_err().to_string();
        assert!(problem.starts_with("it diverged earlier"), "{problem}");
    }
}
