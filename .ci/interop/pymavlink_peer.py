"""pymavlink against our vehicle and our client: parameters, missions, signing both ways, also by a
vehicle that has no clock and is restarted.

Usage: pymavlink_peer.py HOST_SIM_BINARY
"""

import itertools
import os
import socket
import subprocess
import sys
import tempfile
import time

from counted import Checks, free_port

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil, mavwp  # noqa: E402

BINARY = sys.argv[1]
SPEED = "10"
check = Checks("pymavlink")


class Vehicle:
    def __init__(self, *arguments):
        self.port = free_port()
        listen = f"udpin:127.0.0.1:{self.port}"
        command = [BINARY, "vehicle", "--listen", listen, "--speed", SPEED, *arguments]
        self.process = subprocess.Popen(command, stderr=subprocess.DEVNULL)

    def crash(self):
        self.process.kill()
        self.process.wait()

    def connect(self, key=None):
        link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{self.port}", source_system=255, source_component=190
        )
        if key:
            link.setup_signing(key, sign_outgoing=True)
        return link

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.returncode is not None:
            return  # it was killed
        self.process.send_signal(2)
        check(self.process.wait(10) == 0, "the vehicle does not end cleanly on ctrl-C")


def greet(link, seconds=10.0):
    """The vehicle's heartbeat, or None."""
    end = time.time() + seconds
    while time.time() < end:
        link.mav.heartbeat_send(6, 8, 0, 0, 0)
        beat = link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.3)
        if beat is not None and beat.autopilot != 8:
            link.target_system, link.target_component = 1, 1
            return beat
    return None


def parameters():
    with Vehicle("--profile", "arducopter", "--param", "WPNAV_SPEED=3000") as vehicle:
        link = vehicle.connect()
        check(greet(link), "no heartbeat")
        link.param_fetch_all()
        got, total, end = {}, None, time.time() + 10
        while time.time() < end and len(got) != total:
            value = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=1)
            if value:
                got[value.param_id], total = value.param_value, value.param_count
        check(total and len(got) == total, f"{len(got)} of {total} parameters")
        check(got["WPNAV_SPEED"] == 3000, "WPNAV_SPEED")
        link.param_set_send("WPNAV_ACCEL", 500)
        value = link.recv_match(
            type="PARAM_VALUE", condition="PARAM_VALUE.param_id=='WPNAV_ACCEL'", blocking=True, timeout=3
        )
        check(value and value.param_value == 500, "PARAM_SET")


def read_mission(link):
    link.waypoint_request_list_send()
    count = link.recv_match(type="MISSION_COUNT", blocking=True, timeout=3)
    check(count is not None, "no MISSION_COUNT")
    items = []
    for seq in range(count.count):
        item = None
        for _ in range(5):  # UDP: a datagram may be lost
            link.mav.mission_request_int_send(1, 1, seq)
            item = link.recv_match(
                type="MISSION_ITEM_INT", condition=f"MISSION_ITEM_INT.seq=={seq}", blocking=True, timeout=1
            )
            if item is not None:
                break
        check(item is not None, f"item {seq}")
        items.append(item)
    return items


def missions():
    for profile in ["multirotor", "arducopter", "px4"]:
        with Vehicle("--profile", profile) as vehicle:
            link = vehicle.connect()
            check(greet(link), "no heartbeat")
            # pymavlink sends a mission, and reads it back.
            loader = mavwp.MAVWPLoader(1, 1)
            for n in range(12):
                loader.add(
                    mavutil.mavlink.MAVLink_mission_item_message(
                        1, 1, n, 3, 16, 0, 1, 0, 0, 0, 0, 47.0 + n * 1e-3, 8.0 - n * 1e-3, 50 + n
                    )
                )
            link.waypoint_count_send(loader.count())
            result, refused = None, 0
            while result is None:
                message = link.recv_match(
                    type=["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"], blocking=True, timeout=3
                )
                check(message is not None, f"{profile}: the upload stalls")
                if message.get_type() == "MISSION_ACK" and message.type == 4 and refused < 10:
                    # ArduCopter has no space for a mission in its first seconds.
                    refused += 1
                    time.sleep(0.1)
                    link.waypoint_count_send(loader.count())
                elif message.get_type() == "MISSION_ACK":
                    result = message.type
                else:
                    item = loader.wp(message.seq)
                    link.mav.mission_item_int_send(
                        1, 1, item.seq, 3, 16, 0, 1, 0, 0, 0, 0,
                        round(item.x * 1e7), round(item.y * 1e7), item.z,
                    )
            check(result == 0, f"{profile}: MISSION_ACK {result}")
            items = read_mission(link)
            check([i.x for i in items] == [470000000 + n * 10000 for n in range(12)], f"{profile}: items differ")
            # Our client sends the whole default mission; pymavlink reads it.
            command = [BINARY, "upload", "--link", f"udpout:127.0.0.1:{vehicle.port}", "--speed", SPEED]
            done = subprocess.run(command, capture_output=True, text=True, timeout=60)
            check(done.returncode == 0, f"{profile}: upload: {done.stderr}")
            link = vehicle.connect()
            check(greet(link), "no heartbeat")
            items = read_mission(link)
            check(len(items) == (63 if profile == "px4" else 64), f"{profile}: {len(items)} items")
            check(items[-1].command == 21, f"{profile}: no landing at the end")


def signing():
    key = bytes(range(32))
    with tempfile.NamedTemporaryFile("w") as file:  # mode 600
        file.write(key.hex())
        file.flush()
        with Vehicle("--profile", "multirotor", "--signing-key", file.name) as vehicle:
            # Ours are checked by pymavlink (it drops what is wrongly signed) and the reverse.
            link = vehicle.connect(key)
            check(greet(link), "our signed frames are not accepted")
            check(link.mav.signing.sig_count > 0, "frames came unsigned")
            check(link.mav.signing.badsig_count == 0, "bad signatures")
            read_mission(link)
            for wrong in [None, bytes(32)]:
                link = vehicle.connect(wrong)
                # Hear all of it, however it is signed: only then is silence an answer.
                link.mav.signing.allow_unsigned_callback = lambda *_: True
                check(greet(link), "not even heartbeats are heard: the next check would be empty")
                link.waypoint_request_list_send()
                count = link.recv_match(type="MISSION_COUNT", blocking=True, timeout=1)
                check(count is None, "an unsigned or wrongly signed request was answered")


EPOCH = 1420070400


def now():
    """In units of signatures: 10 us since 2015."""
    return int((time.time() - EPOCH) * 1e5)


def record_sent(link):
    """The bytes of every frame that is sent from now on."""
    frames, write = [], link.write
    link.write = lambda data: (frames.append(bytes(data)), write(data))
    return frames


def answers_replayed(vehicle, key, frames):
    """Whether a recorded request for the mission is answered to someone who only replays it."""
    heard = mavutil.mavlink.MAVLink(None)
    heard.signing.secret_key = key
    count = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.settimeout(0.1)
        end = time.time() + 2.0
        # Again and again: the vehicle may still be starting.
        for frame in itertools.cycle(frames):
            if time.time() > end:
                break
            s.sendto(frame, ("127.0.0.1", vehicle.port))
            try:
                messages = heard.parse_buffer(s.recv(4096)) or []
            except TimeoutError:
                continue
            count += len(messages)
            if any(message.get_type() == "MISSION_COUNT" for message in messages):
                return True
    check(count > 0, "the vehicle says nothing at all: silence would be no answer")
    return False


def no_clock():
    """A vehicle whose clock shows nothing takes over our time, keeps it over a crash, and refuses
    what was recorded before that."""
    key = bytes(range(32, 64))
    with tempfile.TemporaryDirectory() as folder:
        file, state = os.path.join(folder, "key"), os.path.join(folder, "state.json")
        with open(os.open(file, os.O_CREAT | os.O_WRONLY, 0o600), "w") as out:
            out.write(key.hex())
        arguments = ["--profile", "multirotor", "--signing-key", file, "--signing-clock", "unknown",
                     "--signing-link", "7"]
        kept = [*arguments, "--signing-state", state]
        with Vehicle(*kept) as vehicle:
            link = vehicle.connect(key)
            sent = record_sent(link)
            begun = now()
            check(greet(link), "a vehicle without a clock is not heard")
            # What it sent before it took over our time had an old one, and was rightly refused.
            early = link.mav.signing.badsig_count
            check(early < 10, f"{early} frames with bad signatures before it took over our time")
            streams = link.mav.signing.stream_timestamps
            check(set(streams) == {(7, 1, 1)}, f"link id and sender: {streams}")
            check(begun - 100_000 <= streams[7, 1, 1] <= now(), "it signs with another time than ours")
            read_mission(link)
            check(link.mav.signing.badsig_count == early, "bad signatures without a clock")
            requests = [frame for frame in sent if frame[7] == 43]  # MISSION_REQUEST_LIST
            check(len(requests) == 1, "no request was recorded")
            check(not answers_replayed(vehicle, key, requests), "answers a replayed request")
            time.sleep(1.5)  # it saves every second
            vehicle.crash()
        with Vehicle(*kept) as vehicle:
            check(not answers_replayed(vehicle, key, sent), "answers a request from before the crash")
            link = vehicle.connect(key)
            check(greet(link), "not heard after the crash")
            read_mission(link)
            check(link.mav.signing.badsig_count == 0, "bad signatures after the crash")
            check(link.mav.signing.stream_timestamps[7, 1, 1] > streams[7, 1, 1], "its time went back")
        # Without the state the same frames are accepted: the checks above are not empty.
        with Vehicle(*arguments) as vehicle:
            check(answers_replayed(vehicle, key, sent), "replays are not even tried")
        # One that has a clock refuses them also without a state.
        aged = mavutil.mavlink.MAVLink(None, 255, 190)
        aged.signing.secret_key, aged.signing.sign_outgoing = key, True
        aged.signing.timestamp = now() - 61 * 100_000
        old = mavutil.mavlink.MAVLink_mission_request_list_message(1, 1).pack(aged)
        aged.signing.timestamp = now() - 50 * 100_000
        fresh = mavutil.mavlink.MAVLink_mission_request_list_message(1, 1).pack(aged)
        with Vehicle("--profile", "multirotor", "--signing-key", file) as vehicle:
            check(not answers_replayed(vehicle, key, [bytes(old)]), "accepts a frame of a minute ago")
            check(answers_replayed(vehicle, key, [bytes(fresh)]), "refuses a frame of 50 seconds ago")


parameters()
missions()
signing()
no_clock()
print(f"pymavlink: parameters, missions and signing, {check.count} checks")
