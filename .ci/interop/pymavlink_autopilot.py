"""An autopilot that none of our code wrote, flown by our client: it behaves as ArduCopter does,
around a point mass, on pymavlink's messages.

Usage: pymavlink_autopilot.py HOST_SIM_BINARY

The default mission is flown at five times real time, with parameters set and put back, and a
ground station beside; then once more with signatures, where neither end has a clock and the
autopilot gets the date, as from GPS; then once more, and the pilot takes over in the middle.
"""

import json
import math
import os
import pathlib
import socket
import subprocess
import sys
import tempfile
import threading
import time

from counted import Checks, free_port

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402
from pymavlink.dialects.v20 import ardupilotmega as wire  # noqa: E402

BINARY = sys.argv[1]
SPEED = 5.0
GUIDED, LOITER, LAND = 4, 5, 9
# The default scenario: where its map lies, and where on it the vehicle stands, north and east.
ORIGIN = (-35.363262, 149.165237)
START = (50.0, 50.0)
METRES_PER_DEGREE = 6378137.0 * math.pi / 180
check = Checks("pymavlink autopilot")


class Autopilot(threading.Thread):
    """GUIDED and LAND, nothing else; position, velocity in its own frame, which begins at START."""

    def __init__(self, key=None):
        super().__init__(daemon=True)
        self.port = free_port()
        self.link = mavutil.mavlink_connection(
            f"udpin:127.0.0.1:{self.port}", source_system=1, source_component=1,
            dialect="ardupilotmega")
        if key:
            # As one without a real-time clock that has just booted.
            self.link.setup_signing(key, sign_outgoing=True, initial_timestamp=1)
            self.sent, write = [], self.link.write
            self.link.write = lambda data: (self.sent.append(bytes(data)), write(data))
        self.parameters = {"WPNAV_SPEED": 1000.0, "WPNAV_ACCEL": 250.0, "ANGLE_MAX": 3000.0, "PSC_JERK_XY": 5.0,
                           "FS_GCS_ENABLE": 1.0, "GUID_TIMEOUT": 3.0, "FENCE_ENABLE": 0.0}
        self.highest = dict(self.parameters)
        self.mode, self.armed, self.landed = 0, False, False
        self.position, self.velocity, self.target = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], None
        self.climbing_to, self.intervals, self.due = None, {}, {}
        self.setpoints, self.setpoints_outside, self.peak_mps = 0, 0, 0.0
        self.running = True

    def boot_ms(self):
        return int((time.monotonic() - self.begun) * SPEED * 1e3)

    def run(self):
        self.begun = last = time.monotonic()
        while self.running:
            message = self.link.recv_match(blocking=True, timeout=0.002)
            if message is not None:
                self.handle(message)
            now = time.monotonic()
            while last + 0.002 <= now:
                last += 0.002
                self.move(0.002 * SPEED)
            if self.link.clients:  # nobody to talk to before
                self.talk()

    def move(self, dt):
        if self.climbing_to is not None:
            self.velocity = [0.0, 0.0, -5.0]
            if -self.position[2] >= self.climbing_to:
                self.climbing_to, self.velocity = None, [0.0, 0.0, 0.0]
        elif self.mode == LAND and self.armed:
            self.velocity = [0.0, 0.0, 4.0]
            if self.position[2] >= 0:
                self.armed, self.velocity, self.position[2] = False, [0.0, 0.0, 0.0], 0.0
                self.landed = True
                self.link.mav.statustext_send(6, b"Disarming motors")
        elif self.mode == GUIDED and self.armed and self.target:
            position, velocity, at = self.target
            age = min(self.boot_ms() / 1e3 - at, self.parameters["GUID_TIMEOUT"])
            limit = self.parameters["WPNAV_SPEED"] / 100
            reach = self.parameters["WPNAV_ACCEL"] / 100 * dt
            wanted = [v + 2.0 * (p + v * age - x)
                      for p, v, x in zip(position, velocity, self.position)]
            size = math.hypot(*wanted)
            wanted = [w * min(1.0, limit / size) if size else w for w in wanted]
            step = [w - v for w, v in zip(wanted, self.velocity)]
            size = math.hypot(*step)
            self.velocity = [v + s * (min(1.0, reach / size) if size else 1)
                             for v, s in zip(self.velocity, step)]
        else:
            self.velocity = [0.0, 0.0, 0.0]
        self.peak_mps = max(self.peak_mps, math.hypot(*self.velocity[:2]))
        self.position = [x + v * dt for x, v in zip(self.position, self.velocity)]

    def talk(self):
        now = self.boot_ms()
        for name, interval in [(0, 1000), (2, 1000), *self.intervals.items()]:
            if name in self.intervals and self.intervals[name] != interval:
                continue
            if now >= self.due.get(name, 0):
                self.due[name] = now + interval
                self.tell(name)

    def tell(self, name):
        mav = self.link.mav
        if name == 0:
            mav.heartbeat_send(2, 3, 128 * self.armed + 1, self.mode, 4)
        elif name == 1:
            ready = 0x10000020
            mav.sys_status_send(ready, ready, ready, 100, 16000, -1, 80, 0, 0, 0, 0, 0, 0)
        elif name == 2:
            # No date in the first ten seconds: no GPS.
            date_us = int(time.time() * 1e6) if self.boot_ms() > 10_000 else 0
            mav.system_time_send(date_us, self.boot_ms())
        elif name == 32:
            mav.local_position_ned_send(self.boot_ms(), *self.position, *self.velocity)
        elif name == 49:
            north, east = START
            latitude = ORIGIN[0] + north / METRES_PER_DEGREE
            longitude = ORIGIN[1] + east / METRES_PER_DEGREE / math.cos(math.radians(ORIGIN[0]))
            mav.gps_global_origin_send(round(latitude * 1e7), round(longitude * 1e7), 584000)
        elif name == 193:
            mav.ekf_status_report_send(0x33F, 0, 0, 0, 0, 0)
        elif name == 245:
            mav.extended_sys_state_send(0, 1 if self.position[2] > -0.1 else 2)

    def handle(self, m):
        kind, mav = m.get_type(), self.link.mav
        if getattr(m, "target_system", 1) not in (0, 1):
            return
        if kind == "PARAM_REQUEST_READ" and m.param_id in self.parameters:
            mav.param_value_send(m.param_id.encode(), self.parameters[m.param_id], 9, 6, 65535)
        elif kind == "PARAM_SET" and m.param_id in self.parameters:
            self.parameters[m.param_id] = m.param_value
            self.highest[m.param_id] = max(self.highest[m.param_id], m.param_value)
            mav.param_value_send(m.param_id.encode(), m.param_value, 9, 6, 65535)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            self.setpoints += 1
            self.setpoints_outside += self.mode != GUIDED
            if self.mode == GUIDED and self.armed and self.position[2] < -1:
                self.climbing_to = None
                self.target = ([m.x, m.y, m.z], [m.vx, m.vy, m.vz], self.boot_ms() / 1e3)
        elif kind == "COMMAND_LONG":
            result = self.obey(m)
            mav.command_ack_send(m.command, result, 0, 0, m.get_srcSystem(), m.get_srcComponent())

    def obey(self, m):
        if m.command == wire.MAV_CMD_SET_MESSAGE_INTERVAL:
            self.intervals[int(m.param1)] = int(m.param2 / 1e3)
        elif m.command == wire.MAV_CMD_REQUEST_MESSAGE:
            self.tell(int(m.param1))
        elif m.command == wire.MAV_CMD_DO_SET_MODE and int(m.param2) in (GUIDED, LOITER):
            self.mode = int(m.param2)
        elif m.command == wire.MAV_CMD_COMPONENT_ARM_DISARM:
            if not m.param1 and self.position[2] < -0.1:
                return 4
            self.armed = bool(m.param1)
            # On the ground, and told so before it noticed itself.
            self.landed = not self.armed
        elif m.command == wire.MAV_CMD_NAV_TAKEOFF and self.armed and self.mode == GUIDED:
            self.climbing_to = m.param7
        elif m.command == wire.MAV_CMD_NAV_LAND:
            self.mode = LAND
        else:
            return 3
        return 0


def command(vehicle, out, *arguments):
    return [BINARY, "run", "--json", "--policy", "straight-line", "--profile", "arducopter",
            "--speed", str(SPEED), "--link", f"udpout:127.0.0.1:{vehicle.port}", "--out", str(out),
            *arguments]


def whole_mission(folder, key):
    """Arrives fair and accurate at the mission's pace; parameters are as they were."""
    vehicle = Autopilot(key and bytes.fromhex(key.read_text()))
    vehicle.start()
    before = dict(vehicle.parameters)
    beside = mavutil.mavlink_connection("udpin:127.0.0.1:0", source_system=254)
    port = beside.port.getsockname()[1]
    state = folder / "state.json"
    signing = ["--signing-key", str(key), "--signing-clock", "unknown", "--signing-state", str(state),
               "--signing-link", "5"] if key else []
    run = command(vehicle, folder / "whole", "--set-params", "--also", f"udpout:127.0.0.1:{port}", *signing)
    done = subprocess.run(run, capture_output=True, text=True, timeout=150)
    check(done.returncode == 0, f"run: {done.stderr}")
    summary = json.loads(done.stdout)
    for promise in ["arrived", "fair"]:
        check(summary[promise], f"not {promise}: {summary}")
    for fault in ["mse_violations", "constraint_violations"]:
        check(summary[fault] == 0, f"{fault}: {summary}")
    check(summary["planned_vs_flown_median_m"] < 3, f"off the plan: {summary}")
    check(vehicle.landed and not vehicle.armed, "it did not land")
    check(vehicle.parameters == before, f"not put back: {vehicle.parameters}")
    check(vehicle.highest["WPNAV_SPEED"] == 3500, f"not set: {vehicle.highest}")
    check(vehicle.peak_mps > 20, f"slow: {vehicle.peak_mps} m/s")
    check(vehicle.setpoints > 500 and vehicle.setpoints_outside < 5, "setpoints outside GUIDED")
    heard = set()
    while (message := beside.recv_match(blocking=True, timeout=0.1)) is not None:
        heard.add((message.get_srcComponent(), message.get_type()))
        if len(heard) > 20:
            break
    check({(1, "HEARTBEAT"), (191, "HEARTBEAT")} <= heard, f"beside: {heard}")
    vehicle.running = False
    if key:
        # Both have the date of the autopilot's SYSTEM_TIME, ours is saved.
        now = (time.time() - 1420070400) * 1e5
        streams = vehicle.link.mav.signing.stream_timestamps
        check(set(streams) == {(5, 1, 191)}, f"streams at the autopilot: {streams}")
        check(vehicle.link.mav.signing.badsig_count == 0, "our signatures were refused")
        saved = json.loads(state.read_text())["time"]
        for name, own in [("autopilot", vehicle.link.mav.signing.timestamp), ("client", saved)]:
            check(now - 60e5 < own <= now, f"{name}: {(now - own) / 1e5} s behind the date")
        # It talks on for a moment after the client has ended; those frames are new to the client.
        heard = [frame for frame in vehicle.sent if int.from_bytes(frame[-12:-6], "little") <= saved]
        check(len(heard) > 1000, f"{len(heard)} frames are recorded")
        replayed(folder, key, state, heard)
    return summary


def replayed(folder, key, state, frames):
    """The frames of a flight, sent again: a client with the state of that flight hears nobody."""
    listen = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listen.bind(("127.0.0.1", 0))
    listen.settimeout(0.05)
    running = threading.Event()
    running.set()

    def replay():
        peer, waiting = None, list(frames)
        while running.is_set():
            try:
                peer = listen.recvfrom(4096)[1]
            except TimeoutError:
                pass
            for frame in waiting[:200] if peer else []:
                listen.sendto(frame, peer)
            waiting = waiting[200:] if peer else waiting

    thread = threading.Thread(target=replay, daemon=True)
    thread.start()
    run = [BINARY, "run", "--policy", "straight-line", "--profile", "arducopter", "--speed", "20",
           "--link", f"udpout:127.0.0.1:{listen.getsockname()[1]}", "--out", str(folder / "replayed"),
           "--signing-key", str(key), "--signing-clock", "unknown"]
    done = subprocess.run([*run, "--signing-state", str(state)], capture_output=True, text=True, timeout=60)
    check(done.returncode == 1 and "no heartbeat" in done.stderr, f"replayed flight: {done.stderr}")
    check("or replayed" in done.stderr, f"nothing was refused: {done.stderr}")
    running.clear()
    thread.join()
    listen.close()


def pilot_takes_over(folder):
    """From the ground station beside, in the middle of the mission: nothing moves it any more."""
    vehicle = Autopilot()
    # Fast enough as it is: parameters that were set would be put back after the landing only.
    vehicle.parameters.update(WPNAV_SPEED=3500.0, WPNAV_ACCEL=1000.0, ANGLE_MAX=4500.0,
                              PSC_JERK_XY=20.0)
    vehicle.start()
    station = mavutil.mavlink_connection("udpin:127.0.0.1:0", source_system=254)
    port = station.port.getsockname()[1]
    run = command(vehicle, folder / "taken", "--also", f"udpout:127.0.0.1:{port}")
    flight = subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    end = time.time() + 60
    while time.time() < end and not (vehicle.target and vehicle.setpoints > 100):
        station.recv_match(blocking=True, timeout=0.05)
    station.mav.command_long_send(1, 1, wire.MAV_CMD_DO_SET_MODE, 0, 1, LOITER, 0, 0, 0, 0, 0)
    _, words = flight.communicate(timeout=60)
    check(flight.returncode == 1 and "control taken by" in words, f"taken over: {words}")
    check(vehicle.mode == LOITER and vehicle.armed, "somebody took control back")
    check(vehicle.setpoints_outside < 5, f"{vehicle.setpoints_outside} setpoints after that")
    vehicle.running = False


def wrong_key(folder, key):
    """A client with a key does not fly an autopilot without it."""
    vehicle = Autopilot()
    vehicle.start()
    run = command(vehicle, folder / "deaf", "--signing-key", str(key))
    run[run.index(str(SPEED))] = "20"
    done = subprocess.run(run, capture_output=True, text=True, timeout=60)
    check(done.returncode == 1 and "not signed with the key" in done.stderr, f"unsigned: {done.stderr}")
    check(not vehicle.armed and vehicle.mode == 0, "it was flown all the same")
    check(key.read_text() not in done.stderr, "the key is shown")
    vehicle.running = False


with tempfile.TemporaryDirectory() as name:
    folder = pathlib.Path(name)
    key = folder / "key"
    key.touch(mode=0o600)
    key.write_text(bytes(range(7, 39)).hex())
    summary = whole_mission(folder, None)
    signed = whole_mission(folder, key)
    pilot_takes_over(folder)
    wrong_key(folder, key)
print(f"pymavlink autopilot: {check.count} checks; rate {summary['sum_rate']:.3f} (signed "
      f"{signed['sum_rate']:.3f}), median {summary['planned_vs_flown_median_m']:.2f} m off the plan")
