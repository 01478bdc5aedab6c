"""A HyperQueue server, or a worker in a process of its own: hyperqueue_node.py server DIR,
hyperqueue_node.py worker DIR SERVER_DIR.

The package on PyPI contains HyperQueue's server, worker and client, but not the program `hq`. Its workers are
threads of the process with the server, and a thread cannot be killed. A worker finds its server by
a file; this process starts a server that nobody uses, replaces its file by that of the server proper,
and starts one worker with one core. Prints "ready", and runs until it is killed.
"""

import json
import signal
import sys
from pathlib import Path

from hyperqueue.cluster import LocalCluster, WorkerConfig

ACCESS = Path("hq-current", "access.json")


def on_loopback(access):
    """The file with which clients and workers find the server, with the address of this machine only."""
    for side in ("client", "worker"):
        access[side]["host"] = "127.0.0.1"
    return json.dumps(access)


kind, directory = sys.argv[1], Path(sys.argv[2])
directory.mkdir(parents=True, exist_ok=True)
cluster = LocalCluster(server_dir=str(directory))
source = directory if kind == "server" else Path(sys.argv[3])
access = json.loads((source / ACCESS).read_text())
(directory / ACCESS).write_text(on_loopback(access))
if kind == "worker":
    cluster.start_worker(WorkerConfig(cores=1))
print("ready", flush=True)
signal.pause()
