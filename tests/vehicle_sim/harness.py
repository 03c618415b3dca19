"""The one harness: a vehicle that is told what to do, by values, by messages or by frames.

`Rig` is an autopilot alone over level ground, told by values: what tracking is measured with.
`Link` is a whole vehicle of which nothing is seen but its frames, `Flown` is flown into things.
Vehicles that have booted or fly already are made once and handed out as copies.
"""

import copy
import copyreg
import functools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.autopilot.values import Ack, Command, Reply, Sender, Setpoint, Text
from vehicle_sim.dynamics.copter import Limits
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.faults import GpsConditions
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.parameters import Firmware, Parameter
from vehicle_sim.plans import PlanItem, Plans
from vehicle_sim.sensors.gps import Fix, Gps
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import VehicleKind, parse_world

copyreg.pickle(Parameter, lambda row: row.name)  # never changes: copies share it

Ids = tuple[int, int]
Vector = tuple[float, float, float]
VEHICLE, GCS, COMPANION = (1, 1), (255, 190), (1, 191)
ZERO: Vector = (0.0, 0.0, 0.0)
NAN: Final = math.nan
POSITION, POSITION_VELOCITY, ALL, VELOCITY = 0xDF8, 0xDC0, 0xC00, 0xDC7
GUIDED, BRAKE = 4, 17
PLANE_GUIDED, PLANE_TAKEOFF = 15, 13
MISSION = 0x04040000
ATTITUDE = 30
QUIET = (2, 4, 8, 29, 31, 33, 36, 74, 83, 85, 87, 105, 111, 132, 141, 147, 231, 241, 331, 360, 380)
"""What PX4 streams and is rarely looked at."""
_STEPS_PER_S = 100
_WHERE = ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE", "HEARTBEAT")
_reader = mavlink.MAVLink(None)
_NAMES = {number: kind.msgname for number, kind in mavlink.mavlink_map.items()}


# --- by values ------------------------------------------------------------------------------------

STEP_US, STEP_S = 10_000, 0.01
_ASKER = Sender(system=1, component=191)
GENTLE = Limits(
    speed_m_s=50.0,
    acceleration_m_s2=9.0,
    speed_vertical_m_s=5.0,
    acceleration_vertical_m_s2=5.0,
)
STRONG = Limits(
    speed_m_s=40.0,
    acceleration_m_s2=30.0,
    speed_vertical_m_s=10.0,
    acceleration_vertical_m_s2=9.0,
)
"""What airframes can do: one for sensors and weather, one for autopilots."""


class Rig:
    """An autopilot of any kind over level ground; a vehicle's own adds how it gets into the air."""

    def __init__(
        self,
        personality: tuple[str, VehicleKind],
        vehicle: Any,
        parameters: Mapping[str, float],
        gps: Gps | None = None,
        conditions: GpsConditions | None = None,
        *,
        seed: int = 1,
    ) -> None:
        self.ground_amsl_m, self.plans = vehicle.altitude_amsl_m, Plans()
        boot = PERSONALITIES[personality].boot
        rng = np.random.default_rng(seed)
        self.autopilot: Any = boot(vehicle, parameters, self.plans, rng)
        self.gps, self.gps_conditions = gps, conditions or GpsConditions()
        self.now_us = 0
        self.fix = Fix()
        self.said: list[tuple[float, Reply]] = []
        """With the time in seconds."""

    @property
    def now_s(self) -> float:
        """Since boot."""
        return self.now_us * 1e-6

    @property
    def height_m(self) -> float:
        """Above the ground, truly."""
        return self.autopilot.vehicle.altitude_amsl_m - self.ground_amsl_m

    @property
    def speed_m_s(self) -> float:
        """Over the ground, truly."""
        vehicle = self.autopilot.vehicle
        return math.hypot(vehicle.velocity_north_m_s, vehicle.velocity_east_m_s)

    @property
    def texts(self) -> list[str]:
        return [reply.text for _, reply in self.said if isinstance(reply, Text)]

    def when(self, text: str) -> list[float]:
        """The times at which this was said."""
        return [at for at, reply in self.said if isinstance(reply, Text) and reply.text == text]

    def receive(self) -> Fix:
        """The newest fix."""
        assert self.gps is not None
        return self.gps.step(self.now_us, self.autopilot.vehicle, self.gps_conditions)

    def take(self, replies: Sequence[Reply]) -> Sequence[Reply]:
        self.said.extend((self.now_s, reply) for reply in replies)
        return replies

    def step(self) -> None:
        """One hundredth of a second."""
        self.now_us += STEP_US
        self.fix = self.receive()
        self.take(self.autopilot.step(self.now_us, STEP_S, self.ground_amsl_m, self.fix))

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Fly on, with something to do before each step."""
        for _ in range(round(seconds / STEP_S)):
            if each is not None:
                each()
            self.step()

    def run_until(self, reached: Callable[[], bool], within_s: float = 300.0) -> float:
        """Fly until this is so; returns how long it took, in seconds."""
        start_us = self.now_us
        while not reached():
            assert self.now_us - start_us < within_s * 1e6, "it never came to that"
            self.step()
        return (self.now_us - start_us) * 1e-6

    def answers(
        self,
        number: int,
        *parameters: float,
        frame: int | None = None,
        target_component: int = 1,
    ) -> list[int]:
        """What a command is answered at once."""
        command = Command(
            sender=_ASKER,
            target_component=target_component,
            number=number,
            parameters=(*parameters, *(0.0,) * (7 - len(parameters))),
            frame=frame,
        )
        acks = [r for r in self.take(self.autopilot.on_command(command)) if isinstance(r, Ack)]
        assert all((ack.to, ack.command) == (_ASKER, number) for ack in acks)
        return [ack.result for ack in acks]

    def command(self, number: int, *parameters: float, **fields: Any) -> int:
        """The only answer."""
        (answer,) = self.answers(number, *parameters, **fields)
        return answer

    def give(
        self,
        position: Vector = ZERO,
        velocity: Vector = ZERO,
        acceleration: Vector = ZERO,
        *,
        mask: int,
        frame: int = 1,
        is_global: bool = False,
        yaw_rad: float = 0.0,
    ) -> None:
        """A setpoint."""
        setpoint = Setpoint(
            is_global=is_global,
            frame=frame,
            type_mask=mask,
            position=position,
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=acceleration,
            yaw_rad=yaw_rad,
        )
        self.take(self.autopilot.on_setpoint(setpoint))


def item(
    home_deg: tuple[float, float],
    command: int,
    north_m: float = 0.0,
    east_m: float = 0.0,
    z_m: float = 0.0,
    *p: float,
    frame: int = 3,
) -> PlanItem:
    """Of a plan, at a place in metres from home."""
    home = LocalFrame(latitude_deg=home_deg[0], longitude_deg=home_deg[1])
    x, y = (round(angle * 1e7) for angle in home.to_geographic(north_m, east_m))
    p1, p2, p3, p4 = (*p, 0.0, 0.0, 0.0, 0.0)[:4]
    return PlanItem(frame=frame, command=command, parameters=(p1, p2, p3, p4), x=x, y=y, z_m=z_m)


# --- by frames ------------------------------------------------------------------------------------


class Heard:
    """One frame that came out of the vehicle's end of a link; read when its message is wanted."""

    __slots__ = ("_message", "at_s", "frame", "kind", "link", "source")

    def __init__(self, at_s: float, link: int, frame: bytes) -> None:
        self.at_s, self.link, self.frame = at_s, link, frame
        """Vehicle time since the start."""
        self.source: Ids = (frame[5], frame[6])
        number = int.from_bytes(frame[7:10], "little")
        self.kind: str = _NAMES.get(number, f"UNKNOWN_{number}")
        self._message: Any = None

    @property
    def message(self) -> Any:
        """As pymavlink reads it."""
        if self._message is None:
            self._message = _reader.decode(bytearray(self.frame))
        return self._message


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """With what a client signs."""

    secret: bytes
    link: int
    timestamp: int


def local(
    position: Vector | None = None, velocity: Vector | None = None, *, mask: int | None = None
) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED; what is None is masked, unless a mask is given."""
    wanted = 0xDC0 | (0 if position else 0x7) | (0 if velocity else 0x38)
    vectors = (*(position or ZERO), *(velocity or ZERO), *ZERO)
    mask = wanted if mask is None else mask
    return mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, mask, *vectors, 0, 0)


def heartbeat(kind: int = mavlink.MAV_TYPE_ONBOARD_CONTROLLER) -> Any:
    """Of a client."""
    return mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3)


class Link:
    """A vehicle of any kind, and a client at the other end of its links.

    ``aim`` makes the setpoint of a time in seconds, and is streamed at ``rate_hz`` unless it is
    None; ``heartbeats`` are the MAV_TYPEs of which one is sent each second.
    """

    def __init__(
        self,
        kind: VehicleKind,
        autopilot: str,
        place: Vector,
        *,
        links: int = 1,
        parameters: Mapping[str, float] | None = None,
        scan_range_m: float | None = None,
        north_m: float = 0.0,
        heading_deg: float = 0.0,
        peaks: Sequence[Mapping[str, float]] = (),
        faults: str = "",
        seed: int = 0,
        **tables: Any,
    ) -> None:
        terrain = {"combine": "maximum", "ground_amsl_m": place[2], "peaks": list(peaks)}
        vehicle = {"kind": kind, "autopilot": autopilot, "parameters": dict(parameters or {})}
        table = {
            "schema": 1,
            "name": "flat",
            "origin": {"latitude_deg": place[0], "longitude_deg": place[1]},
            "terrain": terrain,
            "vehicle": vehicle | {"north_m": north_m, "heading_deg": heading_deg},
        }
        if scan_range_m is not None:
            tables["scanner"] = {"component_id": 100, "range_m": scan_range_m}
        world = parse_world(table | tables)
        self.simulation = Simulation(world, links=links, faults=faults, seed=seed)
        self.kind, self.firmware, self.source = kind, autopilot, COMPANION
        self.heard: list[Heard] = []
        self.aim: Callable[[float], Any] | None = None
        self.rate_hz = 20.0
        self.heartbeats: tuple[int, ...] = ()
        self._steps = 0
        self._sequence: dict[Ids, int] = {}

    def copy(self) -> Self:
        """The same again from here; of what was heard it knows only where it is."""
        where = {each.kind: each for each in self.heard if each.kind in _WHERE and each.link == 0}
        heard, self.heard = self.heard, list(where.values())
        other = copy.deepcopy(self)
        self.heard = heard
        return other

    # --- in -----------------------------------------------------------------------------------

    def send(
        self, *messages: Any, source: Ids | None = None, link: int = 0, key: Key | None = None
    ) -> None:
        """One datagram with these messages."""
        who, data = source or self.source, b""
        for message in messages:
            mav = mavlink.MAVLink(None, srcSystem=who[0], srcComponent=who[1])
            mav.seq = self._sequence.get(who, 0)
            if key is not None:
                mav.signing.secret_key = key.secret
                mav.signing.link_id = key.link
                mav.signing.timestamp = key.timestamp
                mav.signing.sign_outgoing = True
            data += bytes(message.pack(mav))
            self._sequence[who] = (mav.seq + 1) % 256
        self.put(data, link=link)

    def put(self, data: bytes, link: int = 0) -> None:
        """Raw bytes; what is answered at once is heard after the next step."""
        self.simulation.receive(link, data)

    def command(
        self,
        number: int,
        *parameters: float,
        frame: int | None = None,
        target: Ids = VEHICLE,
        source: Ids | None = None,
        link: int = 0,
    ) -> int | None:
        """COMMAND_LONG, or COMMAND_INT in this frame; its last result within 20 ms (PX4: 50)."""
        p = (*parameters, *[0.0] * (7 - len(parameters)))
        message: Any
        if frame is None:
            message = mavlink.MAVLink_command_long_message(*target, number, 0, *p)
        else:
            x, y = round(p[4]), round(p[5])
            message = mavlink.MAVLink_command_int_message(
                *target, frame, number, 0, 0, *p[:4], x, y, p[6]
            )
        begun = len(self.heard)
        self.send(message, source=source, link=link)
        self.run(0.05 if self.firmware == "px4" else 0.02)
        answers = [
            each.message
            for each in self.heard[begun:]
            if each.kind == "COMMAND_ACK" and each.source == VEHICLE and each.link == link
        ]
        to = source or self.source
        assert all((a.target_system, a.target_component) == to for a in answers)
        found = [int(answer.result) for answer in answers if answer.command == number]
        return found[-1] if found else None

    def set_mode(self, custom: int) -> int | None:
        """By the number that a heartbeat tells."""
        if self.firmware == "px4":
            return self.command(176, 1, custom >> 16 & 0xFF, custom >> 24)
        return self.command(176, 1, custom)

    def upload(
        self, items: list[Any], kind: int, *, source: Ids | None = None, link: int = 0
    ) -> int | None:
        """A mission (0), a fence (1) or rally points (2): the result; None: none within 5 s."""
        count = mavlink.MAVLink_mission_count_message(*VEHICLE, len(items), kind)
        self.send(count, source=source, link=link)
        answered: set[int] = set()
        for _ in range(5 * _STEPS_PER_S):
            for each in [each for each in self.run(0.01) if each.link == link]:
                if each.kind == "MISSION_ACK":
                    return int(each.message.type)
                if each.kind.startswith("MISSION_REQUEST") and each.message.seq not in answered:
                    assert self.firmware == "px4" or each.kind == "MISSION_REQUEST"
                    answered.add(each.message.seq)
                    items[each.message.seq].seq = each.message.seq
                    self.send(items[each.message.seq], source=source, link=link)
        return None

    def download(self, kind: int, *, source: Ids | None = None, link: int = 0) -> list[Any]:
        """Its items as MISSION_ITEM_INT."""
        asked = mavlink.MAVLink_mission_request_list_message(*VEHICLE, kind)
        self.send(asked, source=source, link=link)
        (count,) = [each.message.count for each in self.run(0.02) if each.kind == "MISSION_COUNT"]
        for seq in range(count):
            request = mavlink.MAVLink_mission_request_int_message(*VEHICLE, seq, kind)
            self.send(request, source=source, link=link)
            self.run(0.01)
        done = mavlink.MAVLink_mission_ack_message(*VEHICLE, 0, kind)
        self.send(done, source=source, link=link)
        told = self.all("MISSION_ITEM_INT", link=link)
        return [each.message for each in told[len(told) - count :]]

    # --- time ---------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Vehicle time since the start."""
        return self.simulation.now_us * 1e-6

    def step(self) -> bool:
        """10 ms, and before them what is due to be sent; whether a lockstep tick is complete."""
        steps, self._steps = self._steps, self._steps + 1
        if self.aim is not None and steps % round(_STEPS_PER_S / self.rate_hz) == 0:
            self.send(self.aim(self.now_s))
        if steps % _STEPS_PER_S == 0:
            for kind in self.heartbeats:
                self.send(heartbeat(kind))
        complete, now_s = self.simulation.step(), self.now_s
        self.heard += [Heard(now_s, link, frame) for link, frame in self.simulation.take_frames()]
        return complete

    def run(self, seconds: float, meanwhile: Callable[[], object] | None = None) -> list[Heard]:
        """What comes while time passes; meanwhile: what to do ten times a second."""
        begun = len(self.heard)
        for k in range(round(seconds * _STEPS_PER_S)):
            if meanwhile is not None and k % 10 == 0:
                meanwhile()
            self.step()
        return self.heard[begun:]

    def until(self, reached: Callable[[], bool], within_s: float) -> float:
        """Seconds until it is so; NaN: never."""
        start_s = self.now_s
        while self.now_s - start_s < within_s:
            self.step()
            if reached():
                return self.now_s - start_s
        return math.nan

    # --- out ----------------------------------------------------------------------------------

    def all(self, kind: str, *, link: int | None = 0, since_s: float = 0.0) -> list[Heard]:
        """Every one of this kind that came by this link."""
        return [
            each
            for each in self.heard
            if each.kind == kind and link in (None, each.link) and each.at_s >= since_s
        ]

    def last(self, kind: str) -> Any:
        """The newest of this kind on link 0; it must have come."""
        for each in reversed(self.heard):
            if each.kind == kind and each.link == 0:
                return each.message
        raise AssertionError(f"no {kind} has come")

    def texts(self, since_s: float = 0.0, *, link: int = 0) -> list[str]:
        """Every STATUSTEXT."""
        return [e.message.text for e in self.all("STATUSTEXT", since_s=since_s, link=link)]


# --- one client for all four ----------------------------------------------------------------------

KINDS: Final[tuple[tuple[Firmware, VehicleKind], ...]] = (
    *(("ardupilot", "copter"), ("ardupilot", "plane")),
    *(("px4", "copter"), ("px4", "plane")),
)
READY_S: Final = dict(zip(KINDS, (45.0, 25.0, 6.0, 6.0), strict=True))
"""After which it may be armed."""
PLACE: Final = (47.397742, 8.545594, 488.0)


@functools.cache
def _ready(firmware: Firmware, kind: VehicleKind) -> Link:
    vehicle = Link(kind, firmware, PLACE)
    vehicle.source, vehicle.heartbeats = GCS, (mavlink.MAV_TYPE_GCS,)
    vehicle.run(READY_S[firmware, kind])
    for number in QUIET if firmware == "px4" else ():
        vehicle.command(511, number, -1)
    for number in (24, 33, ATTITUDE):
        vehicle.command(511, number, 100_000)
    return vehicle


def ready(firmware: Firmware, kind: VehicleKind) -> Link:
    """One that may be armed, with a ground station on link 0."""
    return _ready(firmware, kind).copy()


def take_off(vehicle: Link) -> None:
    """Into the air, to some 40 m, into the mode in which it takes setpoints (PX4: Hold)."""
    height = (0.0,) * 4
    orders: list[tuple[float, ...]]
    if vehicle.firmware == "px4":
        place = (round(PLACE[0] * 1e7), round(PLACE[1] * 1e7), PLACE[2] + 40.0)
        orders = [(22, *height, *place), (400, 1)]
    elif vehicle.kind == "copter":
        orders = [(176, 1, GUIDED), (400, 1), (22, *height, 0, 0, 40.0)]
    else:
        orders = [(176, 1, PLANE_TAKEOFF), (400, 1)]
    for number, *parameters in orders:
        frame = 5 if number == 22 and vehicle.firmware == "px4" else None
        assert vehicle.command(int(number), *parameters, frame=frame) == 0
    vehicle.run(30.0)
    if (vehicle.firmware, vehicle.kind) == ("ardupilot", "plane"):
        assert vehicle.set_mode(PLANE_GUIDED) == 0


@functools.cache
def _flying(firmware: Firmware, kind: VehicleKind) -> Link:
    vehicle = ready(firmware, kind)
    take_off(vehicle)
    return vehicle


def flying(firmware: Firmware, kind: VehicleKind) -> Link:
    """Some 40 m up, in the mode in which it takes setpoints (PX4: Hold)."""
    return _flying(firmware, kind).copy()


# --- into things ----------------------------------------------------------------------------------

GROUND_M = 400.0
VEHICLES = [(kind, autopilot) for kind in ("copter", "plane") for autopilot in ("ardupilot", "px4")]


class Flown(Link):
    """Ready to be armed, on a plain at GROUND_M; told what to do and not waited for."""

    def __init__(
        self, kind: VehicleKind, autopilot: str, *, longitude_deg: float = 8.0, **fields: Any
    ) -> None:
        super().__init__(kind, autopilot, (47.0, longitude_deg, GROUND_M), **fields)
        self.is_px4 = autopilot == "px4"
        self.source = (1, 195)
        while not self.simulation.armable:
            self.simulation.step()

    @property
    def above_m(self) -> float:
        """Above the plain."""
        return self.simulation.vehicle.altitude_amsl_m - GROUND_M

    def order(self, number: int, *values: float) -> None:
        """A command; what is answered is not looked at."""
        padded = [*values, *[0.0] * (7 - len(values))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded))

    def go(
        self, north_m_s: float, down_m_s: float, east_m_s: float = 0.0, at_m: Vector | None = None
    ) -> None:
        """A velocity, from where it is or through a place of the local frame."""
        self.send(local(at_m, (north_m_s, east_m_s, down_m_s)))

    def fly_until(self, reached: Callable[[], bool], within_s: float, *aim: float) -> None:
        """Until this is so, with a velocity sent five times a second if one is given."""
        for k in range(round(within_s * 100.0)):
            if reached():
                return
            if aim and k % 20 == 0:
                self.go(*aim)
            self.simulation.step()
        raise AssertionError(f"it never came to that: {self.simulation.outcome()}")

    def into_the_air(self, height_m: float) -> None:
        simulation = self.simulation
        up = lambda: self.above_m > height_m - 0.5  # noqa: E731
        if isinstance(simulation.vehicle, Plane):
            if self.is_px4:
                self.order(22, 0, 0, 0, *[math.nan] * 4)  # for good straight on
            else:
                self.order(176, 1, 13)
            self.order(400, 1)
            self.fly_until(up, 60.0)
            if not self.is_px4:
                self.order(176, 1, 7)  # CRUISE: straight on
        elif not self.is_px4:
            self.order(176, 1, 4)
            self.order(400, 1)
            self.order(22, *[0.0] * 6, height_m)
            self.fly_until(up, 60.0)
        else:
            self.fly_until(lambda: simulation.now_us % 1_000_000 == 0, 1.1, 0.0, 0.0)
            self.order(176, 1, 6)
            self.order(400, 1)
            self.fly_until(up, 60.0, 0.0, -2.0)

    def truth(self) -> Sequence[dict[str, Any]]:
        return [json.loads(line) for line in self.simulation.take_truth()][1:]
