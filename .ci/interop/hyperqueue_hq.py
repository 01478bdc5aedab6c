"""`hq submit` for those options that `trainer sweep` uses, by the client of the package on PyPI, which
does not contain the program. Another option is an error.

The server's directory is in HQ_SERVER_DIR, as for hq.
"""

import argparse
import os
import sys

import hyperqueue
from hyperqueue.output import StdioDef


def numbers(text):
    """Of an array: 1-3,5."""
    for part in text.split(","):
        first, _, last = part.partition("-")
        yield from range(int(first), int(last or first) + 1)


separator = sys.argv.index("--")
parser = argparse.ArgumentParser(allow_abbrev=False)
parser.add_argument("command", choices=["submit"])
for option in ("--name", "--array", "--stderr", "--cwd"):
    parser.add_argument(option, required=True)
parser.add_argument("--crash-limit", type=int, required=True)
parser.add_argument("--stdout", choices=["none"], required=True)
parser.add_argument("--wait", action="store_true", required=True)
options = parser.parse_args(sys.argv[1:separator])

path, mode = options.stderr.rsplit(":", 1)
assert mode == "rm-if-finished", mode
client = hyperqueue.Client(os.environ["HQ_SERVER_DIR"])
# As `hq submit`: a task that fails does not cancel the others.
job = hyperqueue.Job(default_workdir=options.cwd, max_fails=None, name=options.name)
for number in numbers(options.array):
    task = job.program(
        sys.argv[separator + 1 :],
        stdout=None,
        stderr=StdioDef.remove_if_finished(path),
        crash_limit=options.crash_limit,
    )
    # HQ_TASK_ID of the task.
    task.task_id = number
submitted = client.submit(job)
# As `hq submit --wait`, this ends with 0 also if tasks have failed.
client.wait_for_jobs([submitted], raise_on_error=False)
