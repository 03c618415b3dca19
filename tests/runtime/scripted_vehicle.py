"""A vehicle and its terrain radar made of pymavlink messages: bytes in, bytes out, no sockets."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pyproj
from made_up_plans import straight_plan as straight_plan
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission
from companion.mavlink.link import Output
from companion.mission.events import End
from companion.mission.journal import Told
from companion.mission.phases import Phase
from companion.planner.request import PlanOutcome, PlanRequest
from companion.runtime.link import Link
from companion.session import Session

MISSION = replace(load_mission("environment-1"), targets_ne_m=((4000.0, 3000.0),))
GEOD = pyproj.Geod(ellps="WGS84")
HOME_AMSL_M = 2990.0
ORIGIN = (470000000, 80000000)
TICK_MS = 100
_MOST = 5000  # datagrams of one flight, or the test has failed
GUIDED, BRAKE, LAND = 4, 17, 9
PARAMETERS = {  # ArduCopter's own names and units
    "ANGLE_MAX": 4500.0,
    "ARMING_CHECK": 1.0,
    "FENCE_ENABLE": 0.0,
    "GUID_OPTIONS": 0.0,
    "GUID_TIMEOUT": 3.0,
    "PSC_JERK_XY": 20.0,
    "SYSID_MYGCS": 255.0,
    "SYSID_THISMAV": 1.0,
    "WPNAV_ACCEL": 500.0,
    "WPNAV_ACCEL_Z": 200.0,
    "WPNAV_SPEED_UP": 2500.0,
}


class Vehicle:
    """Does at once what it is told, and says so at the next tick."""

    def __init__(self, *, lockstep: bool = True, deaf_to: tuple[int, ...] = ()) -> None:
        self.lockstep, self.deaf_to = lockstep, deaf_to
        self.autopilot = wire.MAVLink(None, srcSystem=1, srcComponent=1)
        self.radar = wire.MAVLink(None, srcSystem=1, srcComponent=100)
        self._parser = wire.MAVLink(None)
        self.time_ms = 0
        self.mode, self.armed, self.landed = 0, False, 1
        self.north_m = self.east_m = 0.0
        self.altitude_m = HOME_AMSL_M
        self.velocity_ned = (0.0, 0.0, 0.0)
        self.ticks_alone = 0
        self.climb_to_m: float | None = None
        self.streams_ms: dict[int, int] = {}
        self.heard: list[Any] = []
        self.to_scan: list[Any] = []
        self.to_answer: list[bytes] = []
        self.parameters = dict(PARAMETERS)
        self.sends_synchronisation = lockstep

    # --- what it says

    def tick(self) -> bytes:
        """A tick later: all telemetry that is due, in one datagram."""
        self.time_ms += TICK_MS
        self._fly_on()
        if self.climb_to_m is not None:
            self.altitude_m = min(self.altitude_m + 2.5, self.climb_to_m)
            if self.altitude_m == self.climb_to_m:
                self.landed, self.climb_to_m = 2, None
        elif self.mode == LAND and self.landed != 1:
            self.altitude_m = max(self.altitude_m - 2.5, HOME_AMSL_M)
            if self.altitude_m == HOME_AMSL_M:
                self.landed, self.armed = 1, False
        said = [b""]
        if self.time_ms % 1000 == 0:
            of_radar = wire.MAVLink_heartbeat_message(18, 8, 0, 9, 4, 3)
            said += [self.heartbeat(), self.pack(of_radar, self.radar)]
        said += [
            self.telemetry(message_id)
            for message_id, every_ms in self.streams_ms.items()
            if self.time_ms % every_ms == 0
        ]
        said += [frame for request in self.to_scan for frame in self.scanned(request)]
        said += self.to_answer
        self.to_scan, self.to_answer = [], []
        if self.sends_synchronisation:
            said.append(self.pack(wire.MAVLink_timesync_message(0, self.time_ms * 1_000_000)))
        return b"".join(said)

    def _fly_on(self) -> None:
        """Without a setpoint since the last tick it goes on as it was told, for three seconds."""
        self.ticks_alone += 1
        if 1 < self.ticks_alone < 30 and self.mode == GUIDED and self.landed == 2:
            north, east, down = (TICK_MS * 1e-3 * speed for speed in self.velocity_ned)
            self.north_m, self.east_m = self.north_m + north, self.east_m + east
            self.altitude_m -= down

    def pack(self, message: Any, codec: Any = None) -> bytes:
        codec = codec or self.autopilot
        frame: bytes = message.pack(codec)
        codec.seq = (codec.seq + 1) % 256
        return frame

    def heartbeat(self) -> bytes:
        base = 1 | (wire.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        return self.pack(wire.MAVLink_heartbeat_message(2, 3, base, self.mode, 4, 3))

    def position(self) -> bytes:
        azimuth = math.degrees(math.atan2(self.east_m, self.north_m))
        longitude, latitude, _ = GEOD.fwd(8.0, 47.0, azimuth, math.hypot(self.north_m, self.east_m))
        place = round(latitude * 1e7), round(longitude * 1e7), round(self.altitude_m * 1e3), 0
        speeds = (round(100.0 * speed) for speed in self.velocity_ned)
        return self.pack(wire.MAVLink_global_position_int_message(self.time_ms, *place, *speeds, 0))

    def telemetry(self, message_id: int) -> bytes:
        if message_id == wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            return self.position()
        home_mm, still = round(HOME_AMSL_M * 1e3), [0.0] * 6
        says = {
            1: lambda: wire.MAVLink_sys_status_message(*[0] * 5, -1, -1, *[0] * 6),
            24: lambda: wire.MAVLink_gps_raw_int_message(0, 6, *[0] * 8),
            30: lambda: wire.MAVLink_attitude_message(self.time_ms, *still),
            49: lambda: wire.MAVLink_gps_global_origin_message(*ORIGIN, 0),
            193: lambda: wire.MAVLink_ekf_status_report_message(0x33F, *[0.0] * 5),
            242: lambda: wire.MAVLink_home_position_message(
                *ORIGIN, home_mm, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0
            ),
            245: lambda: wire.MAVLink_extended_sys_state_message(0, self.landed),
        }
        return self.pack(says[message_id]()) if message_id in says else b""

    def scanned(self, request: Any) -> list[bytes]:
        area = request.lat, request.lon, request.grid_spacing
        bits = [bit for bit in range(56) if request.mask >> bit & 1]
        blocks = [wire.MAVLink_terrain_data_message(*area, bit, [500] * 16) for bit in bits]
        report = wire.MAVLink_terrain_report_message(*area, 0.0, 0.0, 0, len(blocks))
        return [self.pack(each, self.radar) for each in (*blocks, report)]

    # --- what it hears

    def hear(self, data: bytes) -> None:
        for message in self._parser.parse_buffer(data) or ():
            self.heard.append(message)
            match message.get_type():
                case "COMMAND_LONG":
                    self._obey(message)
                case "TERRAIN_REQUEST":
                    self.to_scan.append(message)
                case "PARAM_REQUEST_READ" if message.param_id in self.parameters:
                    name, count = message.param_id, len(self.parameters)
                    said = name.encode(), self.parameters[name], wire.MAV_PARAM_TYPE_REAL32
                    answer = wire.MAVLink_param_value_message(*said, count, 0)
                    self.to_answer.append(self.pack(answer))
                case "MISSION_REQUEST_LIST":  # there is none, of no kind
                    to = message.get_srcSystem(), message.get_srcComponent()
                    count = wire.MAVLink_mission_count_message(*to, 0, message.mission_type)
                    self.to_answer.append(self.pack(count))
                case "SET_POSITION_TARGET_GLOBAL_INT" if self.mode == GUIDED:
                    place = message.lon_int * 1e-7, message.lat_int * 1e-7
                    azimuth, _, distance = GEOD.inv(8.0, 47.0, *place)
                    self.north_m = distance * math.cos(math.radians(azimuth))
                    self.east_m = distance * math.sin(math.radians(azimuth))
                    self.altitude_m, self.ticks_alone = message.alt, 0
                    self.velocity_ned = (message.vx, message.vy, message.vz)
                case _:
                    pass

    def _obey(self, message: Any) -> None:
        if message.command in self.deaf_to:
            return
        match message.command:
            case wire.MAV_CMD_DO_SET_MODE:
                self.mode, self.velocity_ned = int(message.param2), (0.0, 0.0, 0.0)
            case wire.MAV_CMD_COMPONENT_ARM_DISARM:
                self.armed = True
            case wire.MAV_CMD_NAV_TAKEOFF:
                self.landed, self.climb_to_m = 3, HOME_AMSL_M + message.param7
            case wire.MAV_CMD_SET_MESSAGE_INTERVAL:
                every_ms = max(round(message.param2 / 1e5) * 100, 100)
                self.streams_ms[int(message.param1)] = every_ms


@dataclass
class Pair:
    """A session and a vehicle face to face."""

    session: Session
    vehicle: Vehicle
    planner: Callable[[PlanRequest], PlanOutcome] = straight_plan
    frames: list[bytes] = field(default_factory=list)
    journal: list[Told] = field(default_factory=list)
    record: list[tuple[float, bytes]] = field(default_factory=list)
    inputs: list[tuple[Any, ...]] = field(default_factory=list)
    asked: PlanRequest | None = None
    out: Output = field(default_factory=Output)

    def take(self, out: Output) -> Output:
        self.frames += out.frames
        self.journal += out.journal
        self.record += out.record
        self.inputs += out.inputs
        self.asked = out.plan or self.asked
        self.out = out
        for frame in out.frames:
            self.vehicle.hear(frame)
        return out

    def feed(self, data: bytes) -> None:
        """Bytes in, all answers out; in lockstep a plan that is due is computed."""
        self.session.receive(data)
        out = self.take(self.session.run())
        while out.awaits_plan:
            assert self.asked is not None
            self.session.deliver(self.planner(self.asked))
            out = self.take(self.session.run())

    def tick(self) -> None:
        self.feed(self.vehicle.tick())

    def ask(self, number: int, *values: float) -> None:
        """A ground station gives the companion a command; parameters left out are 0."""
        station = wire.MAVLink(None, srcSystem=255, srcComponent=190)
        seven = [*values, *[0.0] * (7 - len(values))]
        self.feed(wire.MAVLink_command_long_message(1, 195, number, 0, *seven).pack(station))

    def run_until(self, done: Callable[["Pair"], bool], limit_s: float = 300.0) -> "Pair":
        for _ in range(round(limit_s * 10)):
            if done(self):
                return self
            self.tick()
        raise AssertionError(f"nothing after {limit_s} s: {self.phase}")

    def run_for(self, seconds: float) -> "Pair":
        for _ in range(round(seconds * 10)):
            self.tick()
        return self

    def fly_to(self, phase: Phase, limit_s: float = 300.0) -> "Pair":
        return self.run_until(lambda it: it.phase is phase, limit_s)

    def fly_out(self) -> "Pair":
        """Until it is on its first leg."""
        return self.run_until(lambda it: it.session.state.leg is not None)

    @property
    def phase(self) -> Phase:
        return self.session.state.phase

    @property
    def end(self) -> End:
        assert self.out.end is not None, self.phase
        return self.out.end

    def kinds(self) -> list[str]:
        """Of what the journal tells."""
        return [entry["kind"] for entry in self.journal]

    def since(self, count: int) -> list[Any]:
        """What it has said after so many frames."""
        return messages(self.frames[count:])

    def sent(self, kind: str) -> list[Any]:
        return [message for message in messages(self.frames) if message.get_type() == kind]


def pair(*, lockstep: bool = True) -> Pair:
    session = Session(MISSION, seed=1, lockstep=lockstep, go=True)
    return Pair(session, Vehicle(lockstep=lockstep))


def messages(frames: list[bytes]) -> list[Any]:
    return list(wire.MAVLink(None).parse_buffer(b"".join(frames)) or ())


class ScriptedLink(Link):
    """Stands in for the socket: one tick of the vehicle for each receive."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle, self.count = vehicle, 0

    def receive(self, timeout_s: float) -> bytes | None:
        del timeout_s
        self.count += 1
        assert self.count < _MOST, "the flight does not end"
        return self.vehicle.tick() or None

    def clock(self) -> float:
        """A tenth of a second passes in each."""
        return 0.1 * self.count

    def send(self, frames: list[bytes]) -> None:
        for frame in frames:
            self.vehicle.hear(frame)
