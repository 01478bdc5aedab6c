"""`trainer sweep --engine hyperqueue` with HyperQueue's own server and workers: a worker is lost half-way,
and every run ends with the bytes of the local engine. Usage: hyperqueue_sweep.py TRAINER
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from counted import Checks

HERE = Path(__file__).parent
TRAINER = Path(sys.argv[1]).resolve()
PATIENCE_S = 60
FILES = ["policy.onnx", "metrics.csv", "checkpoint.bin", "finished.json"]
SWEEP = """
scenarios = ["separated", "mixed"]
seeds = "1..3"
[settings]
episodes = 300
hidden = 32
batch = 16
warmup_slots = 120
checkpoint_every = 5
[hyperqueue]
crash_limit = {crash_limit}
"""

check = Checks("hyperqueue")
nodes = []


def start(*arguments):
    """A server or a worker."""
    node = subprocess.Popen(
        [sys.executable, HERE / "hyperqueue_node.py", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    nodes.append(node)
    check(any(line == "ready\n" for line in node.stdout), f"{arguments} starts")
    return node


def children(process):
    threads = Path(f"/proc/{process.pid}/task").iterdir()
    return [int(child) for thread in threads for child in (thread / "children").read_text().split()]


def lose(worker):
    """As a node that loses power: worker and task end at once, and the worker reports nothing."""
    worker.send_signal(signal.SIGSTOP)
    tasks = children(worker)
    for task in tasks:
        os.kill(task, signal.SIGKILL)
    worker.kill()
    worker.wait()
    return len(tasks)


def sweep(file, *arguments):
    return [TRAINER, "sweep", file, *arguments]


def status(file):
    text = subprocess.check_output(sweep(file, "--status"), text=True)
    counts = text.splitlines()[0].split(": ")[1].split(", ")
    return {name: int(count) for count, name in (count.split(" ", 1) for count in counts)}


def wait_until(condition, what):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            check(False, what)
        time.sleep(0.02)
    check(True, what)


def same_bytes(out, reference):
    runs = sorted(path.name for path in reference.iterdir() if path.name != "logs")
    check(len(runs) == 6, "the local engine has six runs")
    for run in runs:
        for file in FILES:
            here, there = (folder / run / file for folder in (out, reference))
            check(here.read_bytes() == there.read_bytes(), f"{run}/{file} has the same bytes")
    return [out / run for run in runs]


def processes(run):
    """The number of processes that have trained a run: each writes a file of events."""
    return len(list(run.glob("events.*")))


def with_lost_worker(folder, workers, crash_limit):
    """Submits a sweep, and loses a worker when runs are finished and its own is half-way."""
    folder.mkdir()
    file, out = folder / "sweep.toml", folder / "sweep-runs"
    file.write_text(SWEEP.format(crash_limit=crash_limit))
    submitted = subprocess.Popen(
        sweep(file, "--engine", "hyperqueue", "--hq", hq), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )

    def is_half_way():
        if submitted.poll() is not None:
            check(False, "the sweep ended before a worker was lost")
        rows = [len(path.read_text().splitlines()) for path in out.glob("*/metrics.csv")]
        return status(file)["finished"] > 0 and any(60 < count < 200 for count in rows)

    wait_until(is_half_way, "a run is half-way")
    # The worker whose run is half-way, rather than one that is between two runs.
    worker = max(workers, key=lambda worker: len(children(worker)))
    check(lose(worker) == 1, "the lost worker was executing a run")
    workers.remove(worker)
    workers.append(start("worker", root / f"worker-{len(nodes)}", server))
    output, errors = submitted.communicate(timeout=PATIENCE_S)
    return file, out, submitted.returncode, output, errors


root = Path(tempfile.mkdtemp(prefix="hyperqueue sweep "))
try:
    # The stand-in for the program `hq`, as one executable file.
    hq = root / "hq"
    hq.write_text(f"#!/bin/sh\nexec '{sys.executable}' '{HERE.resolve()}/hyperqueue_hq.py' \"$@\"\n")
    hq.chmod(0o755)
    server = root / "server"
    os.environ["HQ_SERVER_DIR"] = str(server)
    os.environ["TQDM_DISABLE"] = "1"

    local = root / "local.toml"
    local.write_text(SWEEP.format(crash_limit=20))
    begun = time.monotonic()
    subprocess.run(sweep(local), check=True, stdout=subprocess.DEVNULL)
    local_s = time.monotonic() - begun
    reference = root / "local-runs"

    start("server", server)
    workers = [start("worker", root / f"worker-{i}", server) for i in range(2)]

    # HyperQueue gives the task to another worker, which resumes the run.
    begun = time.monotonic()
    file, out, code, output, errors = with_lost_worker(root / "restarted", workers, crash_limit=20)
    lost_s = time.monotonic() - begun
    check(code == 0, f"the sweep succeeds: {errors}")
    check("all 6 runs are finished" in output, f"all runs are finished: {output}")
    resumed = [run for run in same_bytes(out, reference) if processes(run) == 2]
    check(len(resumed) == 1, f"one run was resumed by another worker, not {len(resumed)}")
    again = subprocess.check_output(sweep(file, "--engine", "hyperqueue", "--hq", hq), text=True)
    check(again.startswith("nothing to do: all 6 runs are finished"), again)

    # With a crash limit of 1 HyperQueue gives the run up. The same command continues it.
    file, out, code, output, errors = with_lost_worker(root / "given-up", workers, crash_limit=1)
    check(code == 1, f"a sweep that is not complete fails: {output}")
    check("1 of 6 runs are not finished" in errors and "(stopped)" in errors, errors)
    check(status(file)["stopped"] == 1, "the run is stopped")
    subprocess.run(
        sweep(file, "--engine", "hyperqueue", "--hq", hq), check=True, stdout=subprocess.DEVNULL
    )
    same_bytes(out, reference)
finally:
    for node in nodes:
        node.kill()
    shutil.rmtree(root, ignore_errors=True)
print(
    f"hyperqueue: 6 runs in {local_s:.1f} s here and in {lost_s:.1f} s with a lost worker, "
    f"{check.count} checks"
)
