#!/usr/bin/env python3
"""Makes the excerpts and the facts in this folder from recordings of real flights.

    python3 excerpt.py FOLDER_WITH_TLOG_GZ        (needs pymavlink and numpy)

An excerpt is a `.tlog` (8 bytes of microseconds since 1970, big endian, before each MAVLink 2
frame) with fewer frames: what the autopilot sent and the client takes, and what the client
commanded. The setpoints of the client are kept in the flights that the tracking test replays.
`facts.md` states what the stand-in has to reproduce. Run by hand; no build depends on it.
"""

import gzip
import pathlib
import struct
import sys

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

HERE = pathlib.Path(__file__).parent
CLIENT = (255, 191)
HEARTBEAT, SYS_STATUS, LOCAL_POSITION_NED = 0, 1, 32
# HEARTBEAT, SYS_STATUS, PARAM_VALUE, LOCAL_POSITION_NED, GPS_GLOBAL_ORIGIN, COMMAND_ACK,
# EKF_STATUS_REPORT, ESTIMATOR_STATUS, EXTENDED_SYS_STATE, STATUSTEXT
TAKEN = {0, 1, 22, 32, 49, 77, 193, 230, 245, 253}
# PARAM_REQUEST_READ, PARAM_SET, COMMAND_LONG
COMMANDED = {20, 23, 76}
SETPOINT = 84
WITH_SETPOINTS = {"arducopter-sac", "px4-sac"}
# The vehicle stands still in this one to the end.
CUT_S = {"px4-unmodified-never-starts": 60.0}


def records(data):
    """Time in us, sender, message id and frame of each record."""
    at = 0
    while at + 8 < len(data):
        (time,) = struct.unpack(">Q", data[at : at + 8])
        at += 8
        length = 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0)
        frame = data[at : at + length]
        at += length
        yield time, (frame[5], frame[6]), int.from_bytes(frame[7:10], "little"), frame


def kept(name, sender, message):
    if sender == CLIENT:
        return message in COMMANDED or (message == SETPOINT and name in WITH_SETPOINTS)
    # Ground stations (component 190) are no part of what the client takes.
    return sender[1] == 1 and message in TAKEN


def percentiles(values, unit=1e3):
    return " / ".join(f"{v * unit:.0f}" for v in np.percentile(values, [1, 50, 99, 100]))


def facts(name, data):
    reader = dialect.MAVLink(None)
    reader.robust_parsing = True
    begin, positions, heartbeats, flags, modes = None, [], [], [], []
    for time, sender, message, frame in records(data):
        begin = begin or time
        if sender[1] != 1:
            continue
        seconds = (time - begin) * 1e-6
        if message not in (HEARTBEAT, LOCAL_POSITION_NED, 193, 230):
            continue
        decoded = reader.decode(bytearray(frame))
        if message == HEARTBEAT:
            heartbeats.append(seconds)
            state = (decoded.custom_mode, bool(decoded.base_mode & 128))
            if not modes or modes[-1][1:] != state:
                modes.append((round(seconds, 1), *state))
        elif message == LOCAL_POSITION_NED:
            d = decoded
            positions.append((seconds, d.time_boot_ms * 1e-3, d.vx, d.vy, d.vz, d.z))
        elif not flags or flags[-1][1] != decoded.flags:
            flags.append((round(seconds, 1), decoded.flags))
    p = np.array(positions)
    settled = p[p[:, 0] > p[0, 0] + 3.0]
    rate, offset = np.polyfit(settled[:, 0], settled[:, 1], 1)
    received, stamped = np.diff(settled[:, 0]), np.diff(settled[:, 1])
    # Lateness beyond the fastest sample of the second around.
    delay = settled[:, 0] - settled[:, 1] / rate
    late = np.array([d - delay[max(0, i - 50) : i + 50].min() for i, d in enumerate(delay)])
    speed = np.hypot(p[:, 2], p[:, 3])
    step = 20
    change = np.hypot(*(p[step:, 2:4] - p[:-step, 2:4]).T) / (p[step:, 1] - p[:-step, 1])
    hiccups = [(round(float(t), 1), round(float(g) * 1e3)) for t, g in
               zip(settled[1:, 0], received) if g > 0.08]
    yield f"## {name}"
    yield ""
    yield f"* clock rate {rate:.4f}"
    yield f"* LOCAL_POSITION_NED, first after {p[0, 0]:.1f} s, intervals in ms (1 % / median / 99 % / most):"
    yield f"  received {percentiles(received)}, stamped {percentiles(stamped)}"
    yield f"* later than the fastest sample around, ms: {percentiles(late)}"
    yield f"* silences of more than 80 ms (s, ms): {hiccups}"
    yield f"* first heartbeat after {heartbeats[0]:.1f} s, then every {np.median(np.diff(heartbeats)):.2f} s"
    yield f"* speed at most {speed.max():.1f} m/s, its 99 % {np.percentile(speed, 99):.1f} m/s;"
    yield f"  acceleration over 1 s at most {change.max():.1f} m/s^2;"
    yield f"  climb {-p[:, 4].min():.1f} m/s, descent {p[:, 4].max():.1f} m/s"
    yield f"* estimator flags: {flags[:14]}"
    yield f"* modes (s, custom mode, armed): {modes}"
    yield ""


def main(folder):
    page = ["# What the recordings show", "", "Made by `excerpt.py`; read by people and matched by the stand-in's tests.", ""]
    for path in sorted(pathlib.Path(folder).glob("*.tlog.gz")):
        name = path.name.removesuffix(".tlog.gz")
        data = gzip.decompress(path.read_bytes())
        page += facts(name, data)
        begin, excerpt = None, bytearray()
        for time, sender, message, frame in records(data):
            begin = begin or time
            if (time - begin) * 1e-6 <= CUT_S.get(name, 1e9) and kept(name, sender, message):
                excerpt += struct.pack(">Q", time) + frame
        (HERE / f"{name}.tlog").write_bytes(excerpt)
    (HERE / "facts.md").write_text("\n".join(page))


if __name__ == "__main__":
    main(sys.argv[1])
