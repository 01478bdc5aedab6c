//! A sweep as one job array of HyperQueue.
//!
//! HyperQueue gives a task whose worker was lost to another worker, which resumes the run. It fails the
//! task after [`crash_limit`](super::file::HyperqueueOptions::crash_limit) lost workers; workers that
//! reach their time limit are not counted.

use std::{ffi::OsString, path::Path};

use super::{array::ranges, plan::Sweep};

/// The environment variable in which HyperQueue tells a task its number.
pub const TASK_VARIABLE: &str = "HQ_TASK_ID";
/// The directory of the tasks' error output, beside those of the runs.
pub const LOGS: &str = "logs";

/// Returns the arguments of `hq` that submit these runs and wait for them. `trainer` is the absolute
/// path of this program on the workers.
pub fn submission(
    sweep: &Sweep,
    numbers: &[usize],
    trainer: &Path,
    show_progress: bool,
) -> Vec<OsString> {
    let errors = sweep.out.join(LOGS).join("%{TASK_ID}.stderr");
    let mut errors = errors.into_os_string();
    // The output of a run that ended well is not kept: a sweep may have thousands.
    errors.push(":rm-if-finished");
    let mut arguments: Vec<OsString> = vec![
        "submit".into(),
        "--name".into(),
        format!("sweep-{}", sweep.name()).into(),
        "--array".into(),
        ranges(numbers).into(),
        "--crash-limit".into(),
        sweep.hyperqueue.crash_limit.to_string().into(),
        "--stdout".into(),
        "none".into(),
        "--stderr".into(),
        errors,
        "--cwd".into(),
        sweep.out.clone().into(),
        match show_progress {
            true => "--progress".into(),
            false => "--wait".into(),
        },
    ];
    arguments.extend(sweep.hyperqueue.options.iter().map(OsString::from));
    arguments.push("--".into());
    arguments.extend([trainer.into(), "sweep".into(), sweep.file.clone().into()]);
    arguments.extend(["--out".into(), sweep.out.clone().into()]);
    arguments.extend(["--plan".into(), sweep.checksum().into()]);
    arguments.extend(["--task".into(), TASK_VARIABLE.into()]);
    arguments
}
