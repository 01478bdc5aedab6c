"""MAVSDK against our vehicle, as a ground station and offboard client, and against our client, as
an autopilot made of its server plugins.

MAVSDK 4.1 cannot sign: neither its interface nor its library has a key or a function for it, and
its maintainers do not plan it (mavlink/MAVSDK#1060). It reads signed frames without verifying them.
What a vehicle that requires signatures makes of it is tested, and that it works behind a gateway
that signs for it.

Usage: mavsdk_peer.py HOST_SIM_BINARY
"""

import asyncio
import json
import math
import os
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time

from counted import Checks, free_port

os.environ["MAVLINK20"] = "1"
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk  # noqa: E402
from mavsdk.asyncio.plugins.action import ActionAsync  # noqa: E402
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync  # noqa: E402
from mavsdk.asyncio.plugins.offboard import OffboardAsync  # noqa: E402
from mavsdk.asyncio.plugins.param import ParamAsync  # noqa: E402
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync  # noqa: E402
from mavsdk.plugins.action_server import ActionServer  # noqa: E402
from mavsdk.plugins.mavlink_direct_server import MavlinkDirectServer, MavlinkMessage  # noqa: E402
from mavsdk.plugins.mission_raw import MissionItem, MissionRawError  # noqa: E402
from mavsdk.plugins.mission_raw_server import MissionRawServer  # noqa: E402
from mavsdk.plugins.offboard import PositionNedYaw  # noqa: E402
from mavsdk.plugins.param_server import ParamServer  # noqa: E402
from mavsdk.plugins.telemetry_server import Battery, TelemetryServer  # noqa: E402
from pymavlink.dialects.v20 import ardupilotmega as wire  # noqa: E402

BINARY = sys.argv[1]
SPEED = 5
vehicles = []


class PatientChecks(Checks):
    """Not sys.exit: MAVSDK's threads outlive it."""

    def __call__(self, condition, what):
        try:
            super().__call__(condition, what)
        except SystemExit as failed:
            print(failed, flush=True)
            for vehicle in vehicles:
                vehicle.kill()
            os._exit(1)


check = PatientChecks("mavsdk")


async def until(seconds, ready):
    """Asks until it is so; False if it never was."""
    end = time.time() + seconds
    while time.time() < end:
        if await ready():
            return True
        await asyncio.sleep(0.2)
    return False


async def ground_station(profile, speed_parameter, takes_off):
    """Connects, reads and sets parameters, sends a mission and reads it back, flies offboard."""
    port = free_port()
    vehicle = subprocess.Popen(
        [BINARY, "vehicle", "--profile", profile, "--speed", str(SPEED),
         "--listen", f"udpin:127.0.0.1:{port}"],
        stderr=subprocess.DEVNULL,
    )
    vehicles.append(vehicle)
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        await mavsdk.add_any_connection(f"udpout://127.0.0.1:{port}")
        system = await mavsdk.first_autopilot(30.0)
        check(system is not None, f"{profile}: no autopilot")

        if speed_parameter:
            param = ParamAsync(system)
            everything = await param.get_all_params()
            names = [p.name for p in [*everything.float_params, *everything.int_params]]
            check(speed_parameter in names, f"{profile}: parameters {names}")
            await param.set_param_float(speed_parameter, 17.5)
            value = await param.get_param_float(speed_parameter)
            check(value == 17.5, f"{profile}: {speed_parameter} is {value}")
            await param.set_param_float(speed_parameter, 2000.0)

        mission = MissionRawAsync(system)
        items = [
            MissionItem(seq=n, frame=6, command=16, current=int(n == 0), autocontinue=1,
                        x=-353600000 + 1000 * n, y=1491600000 - 1000 * n, z=50.0 + n)
            for n in range(40)
        ]
        # As the real one, an ArduCopter has no space in the first seconds after it has booted.
        for attempt in range(20):
            try:
                await mission.upload_mission(items)
                break
            except MissionRawError as error:
                if attempt == 19 or "TOO_MANY_MISSION_ITEMS" not in str(error):
                    raise
                await asyncio.sleep(0.3)
        got = await mission.download_mission()
        check([(i.seq, i.x, i.y, i.z) for i in got] == [(i.seq, i.x, i.y, i.z) for i in items],
              f"{profile}: the mission differs")
        await mission.clear_mission()
        # For ArduPilot MAVSDK clears by sending a mission of one item, the place of home.
        left = len(await mission.download_mission())
        check(left == (1 if profile == "arducopter" else 0), f"{profile}: {left} items not cleared")

        if not speed_parameter:
            return  # MAVSDK knows no modes of an autopilot that is neither ArduPilot nor PX4
        action, offboard, telemetry = ActionAsync(system), OffboardAsync(system), TelemetryAsync(system)
        await telemetry.set_rate_position_velocity_ned(20.0)

        async def armed():
            try:
                await action.arm()
            except Exception:  # not ready yet: its estimator takes its time
                return False
            return True

        check(await until(40, armed), f"{profile}: does not arm")
        if takes_off:
            await action.set_takeoff_altitude(20.0)
            await action.takeoff()
            await until(20, lambda: above(telemetry, 15))
        await offboard.set_position_ned(PositionNedYaw(12.0, -7.0, -20.0, 0.0))
        await asyncio.sleep(1)
        await offboard.start()
        check(await until(20, lambda: near(telemetry, (12.0, -7.0, -20.0))),
              f"{profile}: offboard goes elsewhere: {await place(telemetry)}")
        await action.land()

        async def disarmed():
            return not await telemetry.armed()

        check(await until(30, disarmed), f"{profile}: does not land")
    finally:
        vehicle.kill()
        vehicle.wait()
        mavsdk.destroy()


async def place(telemetry):
    at = (await telemetry.position_velocity_ned()).position
    return at.north_m, at.east_m, at.down_m


async def above(telemetry, height_m):
    return -(await place(telemetry))[2] > height_m


async def near(telemetry, there):
    return math.dist(await place(telemetry), there) < 1.0


class Relay(threading.Thread):
    """Between our client and MAVSDK, whose heartbeat cannot be told to say PX4: this says it."""

    def __init__(self, to):
        super().__init__(daemon=True)
        self.port, self.to = free_port(), ("127.0.0.1", to)
        self.client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.client.bind(("127.0.0.1", self.port))
        self.server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.set = []

    def as_px4(self, data):
        decoder = wire.MAVLink(None)
        out = b""
        for message in decoder.parse_buffer(data) or []:
            if message.get_type() == "HEARTBEAT":
                message.autopilot = wire.MAV_AUTOPILOT_PX4
                encoder = wire.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
                encoder.seq = message.get_seq()
                out += message.pack(encoder)
            else:
                out += bytes(message.get_msgbuf())
        return out

    def run(self):
        peer = None
        while True:
            for ready in select.select([self.client, self.server], [], [])[0]:
                data, sender = ready.recvfrom(4096)
                if ready is self.client:
                    peer = sender
                    self.server.sendto(data, self.to)
                elif peer:
                    self.client.sendto(self.as_px4(data), peer)


class SigningGateway(threading.Thread):
    """Signs what MAVSDK sends, as a router on the same computer could, and passes on what comes."""

    def __init__(self, to, key):
        super().__init__(daemon=True)
        self.port, self.to, self.key = free_port(), ("127.0.0.1", to), key
        self.inside = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.inside.bind(("127.0.0.1", self.port))
        self.outside = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.heard = wire.MAVLink(None)
        self.heard.signing.secret_key = key
        self.signed = 0

    def sign(self, data, decoder, encoders):
        out = b""
        for message in decoder.parse_buffer(data) or []:
            sender = message.get_srcSystem(), message.get_srcComponent()
            if sender not in encoders:
                encoders[sender] = wire.MAVLink(None, *sender)
                encoders[sender].signing.secret_key = self.key
                encoders[sender].signing.sign_outgoing = True
                encoders[sender].signing.timestamp = int((time.time() - 1420070400) * 1e5)
            encoders[sender].seq = message.get_seq()
            out += message.pack(encoders[sender])
            self.signed += 1
        return out

    def run(self):
        peer, decoder, encoders = None, wire.MAVLink(None), {}
        while True:
            for ready in select.select([self.inside, self.outside], [], [])[0]:
                data, sender = ready.recvfrom(4096)
                if ready is self.inside:
                    peer = sender
                    self.outside.sendto(self.sign(data, decoder, encoders), self.to)
                elif peer:
                    self.heard.parse_buffer(data)
                    self.inside.sendto(data, peer)


async def signed_vehicle():
    """A vehicle without a clock that requires signatures: MAVSDK hears it and is not heard. Through
    the gateway it is."""
    key = bytes(range(64, 96))
    with tempfile.NamedTemporaryFile("w") as file:  # mode 600
        file.write(key.hex())
        file.flush()
        port = free_port()
        vehicle = subprocess.Popen(
            [BINARY, "vehicle", "--profile", "px4", "--speed", str(SPEED), "--signing-key", file.name,
             "--signing-clock", "unknown", "--listen", f"udpin:127.0.0.1:{port}"],
            stderr=subprocess.DEVNULL,
        )
        vehicles.append(vehicle)
        gateway = SigningGateway(port, key)
        gateway.start()
        for name, to, is_heard in [("unsigned", port, False), ("gateway", gateway.port, True)]:
            mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
            try:
                await mavsdk.add_any_connection(f"udpout://127.0.0.1:{to}")
                system = await mavsdk.first_autopilot(30.0)
                check(system is not None, f"{name}: MAVSDK does not read signed heartbeats")
                param = ParamAsync(system)
                try:
                    await param.set_param_float("MPC_XY_CRUISE", 17.5)
                    answered = await param.get_param_float("MPC_XY_CRUISE") == 17.5
                except Exception as error:
                    answered = False
                    check("TIMEOUT" in str(error).upper(), f"{name}: {error}")
                check(answered == is_heard, f"{name}: a parameter was {'' if answered else 'not '}set")
            finally:
                mavsdk.destroy()
        signing = gateway.heard.signing
        check(gateway.signed > 0 and signing.sig_count > 0, "nothing went through the gateway")
        check(signing.badsig_count == 0, f"{signing.badsig_count} bad signatures of the vehicle")
        behind = (time.time() - 1420070400) * 1e5 - signing.timestamp
        check(-1e5 < behind < 60e5, f"the vehicle signs {behind / 1e5} s behind the gateway's time")
        vehicle.kill()
        vehicle.wait()


def autopilot():
    """MAVSDK's servers are the autopilot: our doctor and our upload are the clients."""
    from mavsdk import Mavsdk as Blocking

    port = free_port()
    mavsdk = Blocking(Configuration.create_with_component_type(ComponentType.AUTOPILOT))
    mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
    component = mavsdk.server_component()
    params = ParamServer(component)
    for name, value in [("MPC_XY_VEL_MAX", 35.0), ("MPC_XY_CRUISE", 32.0), ("MPC_ACC_HOR_MAX", 10.0),
                        ("MPC_TILTMAX_AIR", 45.0), ("COM_OF_LOSS_T", 1.0),
                        ("GF_MAX_HOR_DIST", 0.0), ("GF_MAX_VER_DIST", 0.0)]:
        params.provide_param_float(name, value)
    for name, value in [("COM_OBL_RC_ACT", 4), ("NAV_DLL_ACT", 0), ("COM_DL_LOSS_T", 10), ("GF_ACTION", 2)]:
        params.provide_param_int(name, value)
    action = ActionServer(component)
    action.set_armable(True, True)
    telemetry = TelemetryServer(component)
    missions = MissionRawServer(component)
    received = []
    missions.subscribe_incoming_mission(lambda result, plan, _: received.append(plan.mission_items))
    direct = MavlinkDirectServer(component)

    def send(name, **fields):
        direct.send_message(MavlinkMessage(name, 1, 1, 0, 0, json.dumps(fields)))

    def feed():
        begun = time.time()
        while running.is_set():
            millis = int((time.time() - begun) * 1e3)
            send("LOCAL_POSITION_NED", time_boot_ms=millis, x=0.0, y=0.0, z=0.0, vx=0.0, vy=0.0, vz=0.0)
            send("ESTIMATOR_STATUS", time_usec=millis * 1000, flags=0x37F, vel_ratio=0.0,
                 pos_horiz_ratio=0.0, pos_vert_ratio=0.0, mag_ratio=0.0, hagl_ratio=0.0,
                 tas_ratio=0.0, pos_horiz_accuracy=0.5, pos_vert_accuracy=0.5)
            send("GPS_GLOBAL_ORIGIN", latitude=-353632620, longitude=1491652370, altitude=584000)
            telemetry.publish_sys_status(
                Battery(remaining_percent=90.0, voltage_v=16.0), True, True, True, True, True)
            time.sleep(0.05)

    running = threading.Event()
    running.set()
    feeder = threading.Thread(target=feed)
    feeder.start()
    relay = Relay(port)
    relay.start()

    def ours(command, *arguments):
        done = subprocess.run(
            [BINARY, command, "--link", f"udpout:127.0.0.1:{relay.port}", *arguments],
            capture_output=True, text=True, timeout=60)
        check(done.returncode == 0, f"{command}: {done.stdout}{done.stderr}")
        return done.stdout

    words = ours("doctor")
    for expected in ["connected: PX4, system 1", "a mission would fly",
                     "MPC_XY_CRUISE is 32: it clips speed; set it to 35", "NAV_DLL_ACT is 0",
                     "COM_OBL_RC_ACT: 4, land"]:
        check(expected in words, f"doctor does not say {expected!r}:\n{words}")
    for unexpected in ["MPC_XY_VEL_MAX", "could not be read"]:
        check(unexpected not in words, f"doctor says {unexpected!r}:\n{words}")
    check("63 mission items uploaded and read back" in ours("upload"), "upload says something else")
    (items,) = received
    check(len(items) == 63 and items[-1].command == 21, f"MAVSDK has {len(items)} items")
    # The change of speed has no place.
    places = [i.x for i in items[:-1] if i.command != 178]
    check(len(places) == 61 and all(abs(x + 353632620) < 100_000 for x in places), "the mission is elsewhere")
    running.clear()
    feeder.join()


async def clients():
    await ground_station("px4", "MPC_XY_CRUISE", takes_off=False)
    await ground_station("arducopter", "WPNAV_SPEED", takes_off=True)
    await ground_station("multirotor", None, takes_off=False)
    await signed_vehicle()


asyncio.run(clients())
autopilot()
print(f"mavsdk: ground station, offboard, signatures and autopilot, {check.count} checks", flush=True)
# MAVSDK's threads do not end by themselves.
os._exit(0)
