"""The one harness: whole vehicles told by frames (`Link`), autopilots alone told by values (`Rig`).

Those that have booted or fly already are made once and handed out as copies.  Sockets and
processes are in clients.py.
"""

import cmath
import copy
import copyreg
import functools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Self, TypeVar

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.core import Boot
from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.autopilot.px4plane import SIH_AIRPLANE
from vehicle_sim.autopilot.values import Ack, Command, Reply, Sender, SendMessage, Setpoint, Text
from vehicle_sim.dynamics.copter import Copter, Limits
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.faults import GpsConditions
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.parameters import Firmware, Parameter
from vehicle_sim.plans import PlanItem, PlanKind, Plans
from vehicle_sim.sensors.gps import Gps
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import VehicleKind, parse_world

copyreg.pickle(Parameter, lambda row: row.name)  # never changes: copies share it

Ids = tuple[int, int]
Vector = tuple[float, float, float]
VEHICLE, GCS, COMPANION = (1, 1), (255, 190), (1, 191)
ZERO: Vector = (0.0, 0.0, 0.0)
NAN: Final = math.nan
POSITION, POSITION_VELOCITY, ALL, VELOCITY = 0xDF8, 0xDC0, 0xC00, 0xDC7
"""Masks of setpoints."""
AUTO, GUIDED, RTL, LAND, BRAKE = 3, 4, 6, 9, 17
PLANE_AUTO, PLANE_RTL, PLANE_LOITER, PLANE_TAKEOFF, PLANE_GUIDED = 10, 11, 12, 13, 15
OFFBOARD, TAKEOFF, HOLD, MISSION, RETURN, PX4_LAND = (6, 0), *((4, sub) for sub in (2, 3, 4, 5, 6))
"""Modes: ArduCopter's, ArduPlane's, and main and sub mode of PX4's."""
QUIET = (2, 4, 8, 29, 31, 33, 36, 74, 83, 85, 87, 105, 111, 132, 141, 147, 231, 241, 331, 360, 380)
"""What PX4 streams and is rarely looked at."""
COPTER_HOME, PLANE_HOME = (47.0, 8.0, 500.0), (-35.3632621, 149.1652370, 584.09)
PLACE: Final = (47.397742, 8.545594, 488.0)
"""Where ArduCopter, ArduPlane and PX4 stand: latitude, longitude, metres AMSL."""
_STEPS_PER_S = 100
_WHERE = ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE", "HEARTBEAT")
_reader = mavlink.MAVLink(None)


Made = TypeVar("Made")


def copied(make: Callable[..., Made]) -> Callable[..., Made]:
    """What is made of the same arguments is made once, and each caller has a copy."""
    kept: Any = functools.cache(make)
    return functools.wraps(make)(lambda *given, **named: kept(*given, **named).copy())


def limits(speed: float, acceleration: float, vertical: float, up: float) -> Limits:
    """What an airframe can do, in m/s and m/s2."""
    return Limits(
        speed_m_s=speed,
        acceleration_m_s2=acceleration,
        speed_vertical_m_s=vertical,
        acceleration_vertical_m_s2=up,
    )


GENTLE, STRONG = limits(50.0, 9.0, 5.0, 5.0), limits(40.0, 30.0, 10.0, 9.0)
"""Airframes: one for sensors and weather, one for autopilots."""


def placed(place: tuple[float, ...], *, height: bool = True) -> dict[str, float]:
    """A place as the fields of a vehicle; without its height, of a frame."""
    names = ("latitude_deg", "longitude_deg", "altitude_amsl_m")[: 3 if height else 2]
    return dict(zip(names, place, strict=False))


def item(
    home_deg: tuple[float, ...],
    command: int,
    north_m: float = 0.0,
    east_m: float = 0.0,
    z_m: float = 0.0,
    *p: float,
    frame: int = 3,
) -> PlanItem:
    """Of a plan, at a place in metres from home."""
    home = LocalFrame(**placed(home_deg, height=False))
    x, y = (round(angle * 1e7) for angle in home.to_geographic(north_m, east_m))
    p1, p2, p3, p4 = (*p, 0.0, 0.0, 0.0, 0.0)[:4]
    return PlanItem(frame=frame, command=command, parameters=(p1, p2, p3, p4), x=x, y=y, z_m=z_m)


# --- by frames ------------------------------------------------------------------------------------


class Heard:
    """One frame that came out of the vehicle's end of a link; read when its message is wanted."""

    def __init__(self, at_s: float, link: int, frame: bytes) -> None:
        self.at_s, self.link, self.frame = at_s, link, frame
        """Vehicle time since the start."""
        self.source: Ids = (frame[5], frame[6])
        self.kind: str = mavlink.mavlink_map[int.from_bytes(frame[7:10], "little")].msgname

    @functools.cached_property
    def message(self) -> Any:
        return _reader.decode(bytearray(self.frame))


def local(
    position: Vector | None = None, velocity: Vector | None = None, *, mask: int | None = None
) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED; what is None is masked, unless a mask is given."""
    wanted = 0xDC0 | (0 if position else 0x7) | (0 if velocity else 0x38)
    vectors = (*(position or ZERO), *(velocity or ZERO), *ZERO)
    mask = wanted if mask is None else mask
    return mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, mask, *vectors, 0, 0)


def heartbeat(kind: int = mavlink.MAV_TYPE_ONBOARD_CONTROLLER) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3)


class Link:
    """A vehicle of any kind, and a client at the other end of its links.

    ``aim`` makes the setpoint of a time in seconds, and is streamed at 20 Hz unless it is None;
    ``heartbeats`` are the MAV_TYPEs of which one is sent each second.
    """

    def __init__(
        self,
        kind: VehicleKind,
        autopilot: str,
        place: Vector,
        *,
        links: int = 1,
        faults: str = "",
        seed: int = 0,
        peaks: Sequence[Mapping[str, float]] = (),
        parameters: Mapping[str, float] | None = None,
        north_m: float = 0.0,
        heading_deg: float = 0.0,
        **tables: Any,
    ) -> None:
        vehicle = {"kind": kind, "autopilot": autopilot, "parameters": dict(parameters or {})}
        table = {
            "schema": 1,
            "name": "flat",
            "origin": {"latitude_deg": place[0], "longitude_deg": place[1]},
            "terrain": {"combine": "maximum", "ground_amsl_m": place[2], "peaks": list(peaks)},
            "vehicle": vehicle | {"north_m": north_m, "heading_deg": heading_deg},
        }
        world = parse_world(table | tables)
        self.simulation = Simulation(world, links=links, faults=faults, seed=seed)
        self.kind, self.firmware, self.source = kind, autopilot, COMPANION
        self.heard: list[Heard] = []
        self.aim: Callable[[float], Any] | None = None
        self.heartbeats: tuple[int, ...] = ()
        self._steps, self._ground_m = 0, place[2]
        self._sequence: dict[Ids, int] = {}

    def copy(self) -> Self:
        """The same again from here; of what was heard it knows only where it is."""
        where = {each.kind: each for each in self.heard if each.kind in _WHERE and each.link == 0}
        heard, self.heard = self.heard, list(where.values())
        other = copy.deepcopy(self)
        self.heard = heard
        return other

    # --- in -----------------------------------------------------------------------------------

    def send(self, *messages: Any, source: Ids | None = None, link: int = 0) -> None:
        """One datagram with these messages."""
        who, data = source or self.source, b""
        for message in messages:
            mav = mavlink.MAVLink(None, srcSystem=who[0], srcComponent=who[1])
            mav.seq = self._sequence.get(who, 0)
            data += bytes(message.pack(mav))
            self._sequence[who] = (mav.seq + 1) % 256
        self.put(data, link=link)

    def put(self, data: bytes, link: int = 0) -> None:
        """Raw bytes; what is answered at once is heard after the next step."""
        self.simulation.receive(link, data)

    def command(
        self, number: int, *parameters: float, frame: int | None = None, link: int = 0
    ) -> int | None:
        """COMMAND_LONG, or COMMAND_INT in this frame; its last result within 20 ms (PX4: 50)."""
        if frame is None:
            self.order(number, *parameters, link=link)
        else:
            head, (*p, x, y, z) = (*VEHICLE, frame, number, 0, 0), parameters
            place = (round(x), round(y), z)
            self.send(mavlink.MAVLink_command_int_message(*head, *p, *place), link=link)
        heard = self.run(0.05 if self.firmware == "px4" else 0.02)
        answers = [e.message for e in heard if (e.kind, e.source) == ("COMMAND_ACK", VEHICLE)]
        assert all((a.target_system, a.target_component) == self.source for a in answers)
        found = [int(answer.result) for answer in answers if answer.command == number]
        return found[-1] if found else None

    def order(self, number: int, *values: float, link: int = 0) -> None:
        """COMMAND_LONG, not waited for."""
        padded = [*values, *[0.0] * (7 - len(values))]
        self.send(mavlink.MAVLink_command_long_message(*VEHICLE, number, 0, *padded), link=link)

    def go(
        self, north_m_s: float, down_m_s: float, east_m_s: float = 0.0, at_m: Vector | None = None
    ) -> None:
        self.send(local(at_m, (north_m_s, east_m_s, down_m_s)))

    def set_mode(self, custom: int) -> int | None:
        if self.firmware == "px4":
            return self.command(176, 1, custom >> 16 & 0xFF, custom >> 24)
        return self.command(176, 1, custom)

    # --- time ---------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Vehicle time since the start."""
        return self.simulation.now_us * 1e-6

    def step(self) -> bool:
        """10 ms, and before them what is due to be sent; whether a lockstep tick is complete."""
        steps, self._steps = self._steps, self._steps + 1
        if self.aim is not None and steps % 5 == 0:
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

    def until(self, reached: Callable[[], bool], within_s: float, *aim: float) -> float:
        """Seconds until it is so, with a velocity sent five times a second if one is given."""
        begun_s, steps = self.now_s, 0
        while not reached():
            assert self.now_s - begun_s < within_s, self.simulation.outcome()
            if aim and steps % 20 == 0:
                self.go(*aim)
            self.step()
            steps += 1
        return self.now_s - begun_s

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

    @property
    def above_m(self) -> float:
        """Above the ground at the start, truly."""
        return self.simulation.vehicle.altitude_amsl_m - self._ground_m

    def truth(self) -> Sequence[dict[str, Any]]:
        return [json.loads(line) for line in self.simulation.take_truth()][1:]

    def texts(self, since_s: float = 0.0, *, link: int = 0) -> list[str]:
        return [e.message.text for e in self.all("STATUSTEXT", since_s=since_s, link=link)]


def scanner(range_m: float) -> dict[str, float]:
    """A terrain radar, as a world file has it."""
    return {"component_id": 100, "range_m": range_m}


# --- some that boot, may be armed, fly ------------------------------------------------------------

KINDS: Final[tuple[tuple[Firmware, VehicleKind], ...]] = (
    *(("ardupilot", "copter"), ("ardupilot", "plane")),
    *(("px4", "copter"), ("px4", "plane")),
)
GROUND_M = 400.0


def armable(
    kind: Any, autopilot: str, place: Vector = (47.0, 8.0, GROUND_M), **fields: Any
) -> Link:
    """One that may be armed."""
    vehicle = Link(kind, autopilot, place, **fields)
    vehicle.until(lambda: vehicle.simulation.armable, 60.0)
    return vehicle


def into_the_air(vehicle: Link, height_m: float) -> None:
    """Up; planes fly straight on then, and PX4's copter is in OFFBOARD."""
    aim: tuple[float, ...] = ()
    orders: Sequence[tuple[float, ...]]
    match vehicle.firmware, vehicle.kind:
        case "px4", "plane":
            orders = ((22, 0, 0, 0, *[NAN] * 4), (400, 1))  # for good straight on
        case "px4", _:
            vehicle.until(lambda: vehicle.simulation.now_us % 1_000_000 == 0, 1.1, 0.0, 0.0)
            orders, aim = ((176, 1, *OFFBOARD), (400, 1)), (0.0, -2.0)
        case _, "plane":
            orders = ((176, 1, PLANE_TAKEOFF), (400, 1))
        case _:
            orders = ((176, 1, GUIDED), (400, 1), (22, *[0.0] * 6, height_m))
    for number, *values in orders:
        vehicle.order(int(number), *values)
    vehicle.until(lambda: vehicle.above_m > height_m - 0.5, 60.0, *aim)
    if vehicle.kind == "plane" and vehicle.firmware != "px4":
        vehicle.order(176, 1, 7)  # CRUISE


@copied
def ready(firmware: Firmware, kind: VehicleKind) -> Link:
    """One that may be armed, with a ground station on link 0."""
    vehicle = armable(kind, firmware, PLACE)
    vehicle.source, vehicle.heartbeats = GCS, (mavlink.MAV_TYPE_GCS,)
    vehicle.run(1.0)
    for number in QUIET if firmware == "px4" else ():
        vehicle.command(511, number, -1)
    for number in (24, 33, 30):
        vehicle.command(511, number, 100_000)
    return vehicle


@copied
def flying(firmware: Firmware, kind: VehicleKind) -> Link:
    """Some 40 m up, in the mode in which it takes setpoints (PX4: Hold)."""
    vehicle = ready(firmware, kind)
    if firmware == "px4":
        place = (round(PLACE[0] * 1e7), round(PLACE[1] * 1e7), PLACE[2] + 40.0)
        assert vehicle.command(22, 0, 0, 0, 0, *place, frame=5) == vehicle.command(400, 1) == 0
        vehicle.run(30.0)
        return vehicle
    into_the_air(vehicle, 40.0)
    assert kind == "copter" or vehicle.set_mode(PLANE_GUIDED) == 0
    vehicle.run(5.0)
    return vehicle


# --- by values ------------------------------------------------------------------------------------

STEP_US, STEP_S = 10_000, 0.01
_ASKER = Sender(system=1, component=191)
PX4_GPS: Final = GpsConditions(lag_s=0.0)


class Rig:
    """An autopilot of any kind over level ground; a vehicle's own adds how it gets into the air."""

    def __init__(
        self,
        autopilot: str,
        kind: VehicleKind,
        vehicle: Any,
        parameters: Mapping[str, float],
        *,
        seed: int = 1,
        gps_seed: int = 1,
        conditions: GpsConditions = GpsConditions(),  # noqa: B008
    ) -> None:
        self.vehicle, self.plans = vehicle, Plans()
        self.ground_amsl_m, self.now_us = vehicle.altitude_amsl_m, 0
        its, rng = PERSONALITIES[autopilot, kind], np.random.default_rng(seed)
        self.autopilot: Any = its.make(Boot(its.firmware, vehicle, parameters, self.plans, rng))
        self.gps = Gps(its.receiver, np.random.default_rng(gps_seed))
        self.gps_conditions = conditions
        self.said: list[tuple[float, Reply]] = []
        """With the time in seconds."""

    def copy(self) -> Self:
        return copy.deepcopy(self)

    @property
    def now_s(self) -> float:
        return self.now_us * 1e-6

    @property
    def height_m(self) -> float:
        """Above the ground, truly."""
        return float(self.vehicle.altitude_amsl_m - self.ground_amsl_m)

    @property
    def speed_m_s(self) -> float:
        """Over the ground, truly."""
        return math.hypot(*self.vehicle.velocity_neu_m_s[:2])

    @property
    def ned_m(self) -> Vector:
        """Where it believes to be, in the frame that its setpoints are in."""
        return self.autopilot.local_ned_m() or ZERO

    @property
    def ne_m(self) -> tuple[float, float]:
        """The same without the height."""
        return self.ned_m[:2]

    @property
    def mode(self) -> str:
        return str(self.autopilot.mode.name)

    @property
    def armed(self) -> bool:
        return bool(self.autopilot.armed)

    @property
    def landed(self) -> bool:
        return bool(self.autopilot.landed)

    @property
    def status(self) -> Any:
        return self.autopilot.status()

    @property
    def texts(self) -> list[str]:
        return [reply.text for _, reply in self.said if isinstance(reply, Text)]

    def when(self, text: str) -> list[float]:
        """The times at which this was said."""
        return [at for at, reply in self.said if isinstance(reply, Text) and reply.text == text]

    def reached(self) -> list[tuple[float, int]]:
        """When MISSION_ITEM_REACHED was said, and of which item."""
        told = ((at, reply) for at, reply in self.said if isinstance(reply, SendMessage))
        return [(at, reply.message.seq) for at, reply in told]

    # --- time ---------------------------------------------------------------------------------

    def take(self, replies: Sequence[Reply]) -> Sequence[Reply]:
        self.said.extend((self.now_s, reply) for reply in replies)
        return replies

    def step(self) -> None:
        self.now_us += STEP_US
        fix = self.gps.step(self.now_us, self.vehicle, self.gps_conditions)
        self.take(self.autopilot.step(self.now_us, STEP_S, self.ground_amsl_m, fix))

    def run(self, seconds: float, each: Callable[[], object] | None = None) -> Self:
        """Fly on, with something to do before each step."""
        for _ in range(round(seconds / STEP_S)):
            if each is not None:
                each()
            self.step()
        return self

    def until(self, reached: Callable[[], bool], within_s: float = 300.0) -> float:
        """Fly until this is so; returns how long it took, in seconds."""
        start_us = self.now_us
        while not reached():
            assert self.now_us - start_us < within_s * 1e6, "it never came to that"
            self.step()
        return (self.now_us - start_us) * 1e-6

    # --- orders -------------------------------------------------------------------------------

    def command(
        self, number: int, *p: float, frame: int | None = None, target_component: int = 1
    ) -> int:
        """What it is answered at once."""
        parameters: Any = (*p, *(0.0,) * (7 - len(p)))
        command = Command(_ASKER, target_component, number, parameters, frame)
        acks = [r for r in self.take(self.autopilot.on_command(command)) if isinstance(r, Ack)]
        assert [(ack.to, ack.command) for ack in acks] == [(_ASKER, number)]
        return acks[0].result

    def set_mode(self, *mode: float) -> int:
        """The result of DO_SET_MODE; PX4's second answer, as the first is always yes."""
        result = self.command(176, 1.0, *mode)
        if self.autopilot.firmware.family == "px4":
            assert result == 0
            self.step()
            result = [r.result for _, r in self.said if isinstance(r, Ack)][-1]
        return result

    def aim(
        self,
        position: Vector | None = None,
        velocity: Vector | None = None,
        acceleration: Vector | None = None,
        yaw_rad: float | None = None,
        *,
        mask: int | None = None,
        frame: int = 1,
        is_global: bool = False,
    ) -> None:
        """A setpoint; what is None is masked, unless a mask is given."""
        given = zip(
            (0x007, 0x038, 0x1C0, 0x400), (position, velocity, acceleration, yaw_rad), strict=True
        )
        masked = 0x800 | sum(bit for bit, what in given if what is None)
        setpoint = Setpoint(
            is_global=is_global,
            frame=frame,
            type_mask=masked if mask is None else mask,
            position=position or ZERO,
            velocity_ned_m_s=velocity or ZERO,
            acceleration_ned_m_s2=acceleration or ZERO,
            yaw_rad=yaw_rad or 0.0,
        )
        self.take(self.autopilot.on_setpoint(setpoint))

    def stream(self, seconds: float, *vectors: Any, rate_hz: float = 20.0, **fields: Any) -> Self:
        """The same setpoint again and again."""
        every = round(1.0 / rate_hz / STEP_S)
        for index in range(round(seconds / STEP_S)):
            if index % every == 0:
                self.aim(*vectors, **fields)
            self.step()
        return self

    def plan(self, kind: PlanKind, *items: PlanItem) -> None:
        self.plans[kind] = items
        self.autopilot.on_plan(kind)


class ArduCopter(Rig):
    """An ArduCopter, or the law `ideal`, which is without drag."""

    def __init__(
        self,
        *,
        ground_amsl_m: float = COPTER_HOME[2],
        airframe: Limits = limits(60.0, 30.0, 10.0, 8.0),  # noqa: B008
        drag: bool = True,
        **parameters: float,
    ) -> None:
        # of the recorded airframe: 10.05 m/s at 28.7 degrees of tilt, 15.4 m/s at 45
        drags = {"drag_1_s": 0.340, "drag_1_m": 0.0193} if drag else {}
        place = placed((*COPTER_HOME[:2], ground_amsl_m))
        copter = Copter(**place, limits=airframe, **drags)
        super().__init__("ardupilot" if drag else "ideal", "copter", copter, parameters)

    def take_off(self, height_m: float) -> int:
        return self.command(22, 0, 0, 0, 0, 0, 0, height_m)

    def airborne(self, height_m: float = 30.0) -> "ArduCopter":
        """Boot, take off in GUIDED and hover."""
        self.run(42.5)
        assert [self.set_mode(GUIDED), self.command(400, 1), self.take_off(height_m)] == [0, 0, 0]
        self.until(lambda: self.status.landed_state == 2, within_s=1000.0)
        return self.run(3.0)


@copied
def hovering(lean_deg: float = 45.0, height_m: float = 30.0, **parameters: float) -> ArduCopter:
    """An ArduCopter in GUIDED above home."""
    return ArduCopter(ANGLE_MAX=lean_deg * 100.0, **parameters).airborne(height_m)


class ArduPlane(Rig):
    """An ArduPlane over flat ground at home."""

    def __init__(self, **parameters: float) -> None:
        self.frame = LocalFrame(**placed(PLANE_HOME, height=False))
        super().__init__("ardupilot", "plane", Plane(**placed(PLANE_HOME)), parameters)

    @property
    def ne_m(self) -> tuple[float, float]:
        """Where it is, truly."""
        return self.frame.to_local(self.vehicle.latitude_deg, self.vehicle.longitude_deg)

    def reposition(
        self, north_m: float, east_m: float, up_m: float, radius_m: float = 0.0, ccw: float = 0.0
    ) -> int:
        place = (*self.frame.to_geographic(north_m, east_m), up_m)
        return self.command(192, -1.0, 1.0, radius_m, ccw, *place, frame=3)

    def take_off(self) -> Self:
        """By TAKEOFF, then GUIDED, on the way to 80 m above home."""
        self.run(24.0)
        assert [self.set_mode(PLANE_TAKEOFF), self.command(400, 1.0)] == [0, 0]
        self.until(lambda: self.height_m > 48.0)
        assert self.reposition(0.0, 0.0, 80.0) == 0
        return self


@copied
def circling(settle_s: float = 30.0, **parameters: float) -> ArduPlane:
    return ArduPlane(**parameters).take_off().run(settle_s)


class Px4Rig(Rig):
    """A PX4 vehicle in still air; COM_OBL_RC_ACT 5 is Hold."""

    def __init__(self, kind: VehicleKind, vehicle: Any, seed: int, **parameters: float) -> None:
        given, gps_seed = {"COM_OBL_RC_ACT": 5.0, **parameters}, seed + 1000
        told: Any = {"seed": seed, "gps_seed": gps_seed, "conditions": PX4_GPS}
        super().__init__("px4", kind, vehicle, given, **told)

    @property
    def ned_m(self) -> Vector:
        """Where it last believed to be."""
        north_m, east_m, down_m = self.autopilot.local_m
        return north_m, east_m, down_m

    def place(self, north_m: float, east_m: float, height_m: float) -> Vector:
        """Latitude, longitude and altitude AMSL of a point of the local frame."""
        place = self.autopilot.frame.place(north_m, east_m, 0.0)
        return place.latitude_deg, place.longitude_deg, PLACE[2] + height_m


class Px4Copter(Px4Rig):
    def __init__(self, seed: int = 1, **parameters: float) -> None:
        copter = Copter(**placed(PLACE), limits=STRONG)
        super().__init__("copter", copter, seed, **{"SIH_KDV": 0.25} | parameters)

    def take_off(self, height_m: float = 20.0, seconds: float = 16.0) -> Self:
        """Boot, OFFBOARD, arm, climb above the origin."""
        up = (0.0, 0.0, -height_m)
        self.run(5.0).stream(2.5, up)
        self.command(176, 1.0, *OFFBOARD)
        self.stream(0.2, up)
        self.command(400, 1.0)
        return self.stream(seconds, up)


class Px4Plane(Px4Rig):
    def __init__(self, seed: int = 1, **parameters: float) -> None:
        super().__init__("plane", Plane(**placed(PLACE), limits=SIH_AIRPLANE), seed, **parameters)

    def take_off(self, north_m: float = 300.0, height_m: float = 50.0) -> Self:
        """As in the recorded flight: NAV_TAKEOFF, arm, until Hold."""
        self.run(6.0)
        self.command(22, 0, 0, NAN, NAN, *self.place(north_m, 0.0, height_m), frame=5)
        self.run(0.5)
        self.command(400, 1.0)
        self.until(lambda: self.mode == "Hold", 60.0)
        return self


@copied
def _taken_off(**parameters: float) -> Px4Plane:
    return Px4Plane(**parameters).take_off()


def cruising(
    north_m: float = 0.0,
    east_m: float = 0.0,
    height_m: float = 68.0,
    heading_rad: float = 0.0,
    **parameters: float,
) -> Px4Plane:
    """A PX4 aeroplane that has long been on its way, put there."""
    rig = _taken_off(**parameters)
    plane, speed_m_s = rig.vehicle, SIH_AIRPLANE.airspeed_max_m_s
    plane.stand(PLACE[2])
    plane.stands = False
    place = rig.place(north_m, east_m, height_m)
    plane.latitude_deg, plane.longitude_deg, plane.altitude_amsl_m = place
    plane.heading_rad, plane.roll_rad, plane.airspeed_m_s = heading_rad, 0.0, speed_m_s
    plane.velocity_m_s = cmath.rect(speed_m_s, heading_rad)
    rig.step()
    return rig
