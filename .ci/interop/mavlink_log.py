"""pymavlink reads every frame of a run's MAVLink log.

usage: mavlink_log.py RUN_FOLDER
"""

import collections
import json
import os
import pathlib
import struct
import sys

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402

folder = pathlib.Path(sys.argv[1])
[log] = folder.glob("*.tlog")
summary = json.loads((folder / "summary.json").read_text())

# The format itself: 8 bytes of microseconds since 1970, big endian, then a MAVLink 2 frame.
data, frames, offset, last = log.read_bytes(), 0, 0, 0
while offset < len(data):
    (micros,) = struct.unpack_from(">Q", data, offset)
    assert micros >= last, f"time goes back at byte {offset}"
    last = micros
    start = offset + 8
    assert data[start] == 0xFD, f"no MAVLink 2 frame at byte {start}"
    signature = 13 if data[start + 2] & 1 else 0
    offset = start + 10 + data[start + 1] + 2 + signature
    frames += 1

connection = mavutil.mavlink_connection(str(log), dialect="ardupilotmega", notimestamps=False)
kinds, bad = collections.Counter(), 0
while (message := connection.recv_msg()) is not None:
    kinds[message.get_type()] += 1
    bad += message.get_type() == "BAD_DATA"
print(f"{log.name}: {frames} frames, {sum(kinds.values())} decoded, {bad} bad; "
      + ", ".join(f"{kind} {count}" for kind, count in kinds.most_common(8)))
assert frames == sum(kinds.values()) and bad == 0
for kind in ("HEARTBEAT", "COMMAND_LONG", "COMMAND_ACK", "LOCAL_POSITION_NED",
             "SET_POSITION_TARGET_LOCAL_NED"):
    assert kinds[kind] > 0, f"no {kind}"
assert kinds["SET_POSITION_TARGET_LOCAL_NED"] >= summary["slots"]
