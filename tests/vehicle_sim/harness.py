"""The one harness: whole vehicles, of which nothing is seen but their frames, and who flies them.

`Link` is a vehicle with a client at the other end of its links, `Flown` one that is flown into
things.  Those that have booted or fly already are made once and handed out as copies.  Autopilots
alone, told by values, are in rigs.py; sockets and processes in clients.py.
"""

import copy
import copyreg
import functools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Self, TypeVar

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.dynamics.copter import Limits
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.parameters import Firmware, Parameter
from vehicle_sim.plans import PlanItem
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
_NAMES = {number: kind.msgname for number, kind in mavlink.mavlink_map.items()}


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
        if self._message is None:
            self._message = _reader.decode(bytearray(self.frame))
        return self._message


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
        return [e.message.text for e in self.all("STATUSTEXT", since_s=since_s, link=link)]


# --- one client for all four ----------------------------------------------------------------------

KINDS: Final[tuple[tuple[Firmware, VehicleKind], ...]] = (
    *(("ardupilot", "copter"), ("ardupilot", "plane")),
    *(("px4", "copter"), ("px4", "plane")),
)
READY_S: Final = dict(zip(KINDS, (45.0, 25.0, 6.0, 6.0), strict=True))
"""After which it may be armed."""


@copied
def ready(firmware: Firmware, kind: VehicleKind) -> Link:
    """One that may be armed, with a ground station on link 0."""
    vehicle = Link(kind, firmware, PLACE)
    vehicle.source, vehicle.heartbeats = GCS, (mavlink.MAV_TYPE_GCS,)
    vehicle.run(READY_S[firmware, kind])
    for number in QUIET if firmware == "px4" else ():
        vehicle.command(511, number, -1)
    for number in (24, 33, 30):
        vehicle.command(511, number, 100_000)
    return vehicle


def take_off(vehicle: Link) -> None:
    """Into the air, to some 40 m, into the mode in which it takes setpoints (PX4: Hold)."""
    climb = (22, 0, 0, 0, 0, 0, 0, 40.0)
    orders: Sequence[tuple[float, ...]] = ((176, 1, PLANE_TAKEOFF), (400, 1))
    if vehicle.firmware == "px4":
        place = (round(PLACE[0] * 1e7), round(PLACE[1] * 1e7), PLACE[2] + 40.0)
        assert vehicle.command(22, 0, 0, 0, 0, *place, frame=5) == 0
        orders = ((400, 1),)
    elif vehicle.kind == "copter":
        orders = ((176, 1, GUIDED), (400, 1), climb)
    for number, *parameters in orders:
        assert vehicle.command(int(number), *parameters) == 0
    vehicle.run(30.0)
    if (vehicle.firmware, vehicle.kind) == ("ardupilot", "plane"):
        assert vehicle.set_mode(PLANE_GUIDED) == 0


@copied
def flying(firmware: Firmware, kind: VehicleKind) -> Link:
    """Some 40 m up, in the mode in which it takes setpoints (PX4: Hold)."""
    vehicle = ready(firmware, kind)
    take_off(vehicle)
    return vehicle


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
        return self.simulation.vehicle.altitude_amsl_m - GROUND_M

    def order(self, number: int, *values: float) -> None:
        padded = [*values, *[0.0] * (7 - len(values))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded))

    def go(
        self, north_m_s: float, down_m_s: float, east_m_s: float = 0.0, at_m: Vector | None = None
    ) -> None:
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
        """Up; planes fly straight on then, and PX4's copter is in OFFBOARD."""
        is_plane = isinstance(self.simulation.vehicle, Plane)
        aim: tuple[float, ...] = ()
        orders: dict[tuple[bool, bool], tuple[tuple[float, ...], ...]] = {
            (True, True): ((22, 0, 0, 0, *[math.nan] * 4), (400, 1)),  # for good straight on
            (True, False): ((176, 1, PLANE_TAKEOFF), (400, 1)),
            (False, True): ((176, 1, *OFFBOARD), (400, 1)),
            (False, False): ((176, 1, GUIDED), (400, 1), (22, *[0.0] * 6, height_m)),
        }
        if not is_plane and self.is_px4:
            self.fly_until(lambda: self.simulation.now_us % 1_000_000 == 0, 1.1, 0.0, 0.0)
            aim = (0.0, -2.0)
        for number, *values in orders[is_plane, self.is_px4]:
            self.order(int(number), *values)
        self.fly_until(lambda: self.above_m > height_m - 0.5, 60.0, *aim)
        if is_plane and not self.is_px4:
            self.order(176, 1, 7)  # CRUISE

    def truth(self) -> Sequence[dict[str, Any]]:
        return [json.loads(line) for line in self.simulation.take_truth()][1:]
