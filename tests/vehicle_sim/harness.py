"""The one harness: a whole vehicle in this process, and a client at the other end of its links.

A `Rig` is told by frames, read by frames, and looked at in truth.  Those that have booted or fly
already are made once and handed out as copies.  Sockets and processes are in clients.py.
"""

import cmath
import copy
import copyreg
import functools
import itertools
import json
import math
from collections.abc import Callable, Sequence
from typing import Any, Final, Self, TypeVar, get_args

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.px4plane import SIH_AIRPLANE
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.parameters import Firmware, Parameter
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import Vehicle, VehicleKind, parse_world

copyreg.pickle(Parameter, lambda row: row.name)  # never changes: copies share it

Ids = tuple[int, int]
Vector = tuple[float, float, float]
VEHICLE, GCS, COMPANION = (1, 1), (255, 190), (1, 191)
ZERO: Vector = (0.0, 0.0, 0.0)
NAN: Final = math.nan
COPTER_HOME, PLANE_HOME = (47.0, 8.0, 500.0), (-35.3632621, 149.1652370, 584.09)
PLACE: Final = (47.397742, 8.545594, 488.0)
"""Where ArduCopter, ArduPlane and PX4 stand: latitude, longitude, metres AMSL."""
STEP_S: Final = 0.01
_HOMES = {("ardupilot", "plane"): PLANE_HOME, ("px4", "copter"): PLACE, ("px4", "plane"): PLACE}
_AS_RECORDED = {"COM_OBL_RC_ACT": 5.0, "SIH_KDV": 0.25}
"""Parameters of PX4's recorded copters: a lost stream is Hold, and the drag."""
_NOWHERE = 0x7FFFFFFF
"""x or y of a COMMAND_INT that gives no place."""
_WHERE = ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE", "HEARTBEAT")
_reader = mavlink.MAVLink(None)

Made = TypeVar("Made")


def copied(make: Callable[..., Made]) -> Callable[..., Made]:
    """What is made of the same arguments is made once, and each caller has a copy."""
    kept: Any = functools.cache(make)
    return functools.wraps(make)(lambda *given, **named: kept(*given, **named).copy())


def placed(place: tuple[float, ...], *, height: bool = True) -> dict[str, float]:
    """A place as the fields of a vehicle; without its height, of a frame."""
    names = ("latitude_deg", "longitude_deg", "altitude_amsl_m")[: 3 if height else 2]
    return dict(zip(names, place, strict=False))


def item(home_deg: tuple[float, ...], command: int, *numbers: float, frame: int = 3) -> PlanItem:
    """Of a plan: metres north and east of home, z, and parameters; what is left out is 0."""
    home = LocalFrame(**placed(home_deg, height=False))
    north_m, east_m, z_m, *parameters = (*numbers, *(0.0,) * (7 - len(numbers)))
    x, y = (round(angle * 1e7) for angle in home.to_geographic(north_m, east_m))
    p1, p2, p3, p4 = parameters
    return PlanItem(frame=frame, command=command, parameters=(p1, p2, p3, p4), x=x, y=y, z_m=z_m)


def setpoint(
    position: Vector | None = None,
    velocity: Vector | None = None,
    acceleration: Vector | None = None,
    yaw_rad: float | None = None,
    *,
    mask: int | None = None,
    frame: int = 1,
    is_global: bool = False,
) -> Any:
    """SET_POSITION_TARGET_*; what is None is masked, unless a mask is given.

    Position: north, east, down in metres; or latitude and longitude in degrees, and a height.
    """
    given = (0x007, position), (0x038, velocity), (0x1C0, acceleration), (0x400, yaw_rad)
    masked = 0x800 | sum(bit for bit, what in given if what is None)
    x, y, z = position or ZERO
    made = mavlink.MAVLink_set_position_target_local_ned_message
    if is_global:
        x, y = round(x * 1e7), round(y * 1e7)
        made = mavlink.MAVLink_set_position_target_global_int_message
    vectors = (x, y, z, *(velocity or ZERO), *(acceleration or ZERO))
    return made(0, *VEHICLE, frame, masked if mask is None else mask, *vectors, yaw_rad or 0.0, 0)


def heartbeat(kind: int = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, status: int = 4) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, status, 3)


def command_long(number: int, *p: float, target: Ids = VEHICLE) -> Any:
    """What is left out is 0."""
    return mavlink.MAVLink_command_long_message(*target, number, 0, *p, *[0.0] * (7 - len(p)))


class Heard:
    """One frame that came out of the vehicle's end of a link; read when its message is wanted."""

    def __init__(self, at_s: float, frame: bytes, link: int = 0) -> None:
        self.at_s, self.link, self.frame = at_s, link, frame
        """Vehicle time since the start."""
        self.source: Ids = (frame[5], frame[6])
        self.number = int.from_bytes(frame[7:10], "little")

    @property
    def kind(self) -> str:
        return str(mavlink.mavlink_map[self.number].msgname)

    @functools.cached_property
    def message(self) -> Any:
        return _reader.decode(bytearray(self.frame))


def world(
    autopilot: str = "ideal", kind: VehicleKind = "copter", place: Vector = COPTER_HOME, **told: Any
) -> dict[str, Any]:
    """A world file's table: a plain, and on it this vehicle.

    What is named in capitals is a parameter of its autopilot, what a vehicle of a world file has is
    its own, peaks are the plain's, and the rest are tables of that file.
    """
    vehicle: dict[str, Any] = {"kind": kind, "autopilot": autopilot}
    vehicle |= {name: told.pop(name) for name in Vehicle.model_fields if name in told}
    vehicle["parameters"] = {name: told.pop(name) for name in [*told] if name.isupper()}
    ground = {"ground_amsl_m": place[2], "peaks": told.pop("peaks", [])}
    origin = placed(place, height=False)
    named = {"schema": 1, "name": "flat", "origin": origin, "terrain": ground, "vehicle": vehicle}
    return named | told


class Rig:
    """A vehicle of any kind over a plain, and a client at the other end of its links."""

    def __init__(
        self,
        autopilot: str = "ardupilot",
        kind: VehicleKind = "copter",
        place: Vector | None = None,
        *,
        links: int = 1,
        faults: str = "",
        seed: int = 0,
        **told: Any,
    ) -> None:
        self.home = place or _HOMES.get((autopilot, kind), COPTER_HOME)
        table = world(autopilot, kind, self.home, **told)
        self.simulation = Simulation(parse_world(table), links=links, faults=faults, seed=seed)
        self.kind, self.firmware, self.source = kind, autopilot, COMPANION
        self.heard: list[Heard] = []
        self.streamed: Any = None
        """A message that is sent at 20 Hz."""
        self.beat: Any = None
        """One that is sent each second."""
        self._steps, self._sequence = 0, dict[Ids, int]()

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
        """Raw bytes; what is answered at once is heard at once."""
        self.simulation.receive(link, data)
        self._hear()

    def ask(self, message: Any, *, source: Ids | None = None, link: int = 0) -> list[Any]:
        """What the vehicle itself says on this link within 20 ms of being told this."""
        begun = len(self.heard)
        self.send(message, source=source, link=link)
        self.run(0.02)
        return [each.message for each in self.heard[begun:] if each.link == link]

    def command(self, number: int, *p: float, frame: int | None = None) -> int | None:
        """COMMAND_LONG, or COMMAND_INT in this frame with x and y in degrees; its result, at once.

        None: there is no answer.
        """
        begun, order = len(self.heard), command_long(number, *p)
        if frame is not None:
            *four, x, y, z = (*p, *[0.0] * (7 - len(p)))
            place = (_NOWHERE if math.isnan(angle) else round(angle * 1e7) for angle in (x, y))
            head = (*VEHICLE, frame, number, 0, 0)
            order = mavlink.MAVLink_command_int_message(*head, *four, *place, z)
        self.send(order)
        return self._result(number, begun)

    def _result(self, number: int, begun: int) -> int | None:
        """Of the newest acknowledgement since then."""
        heard = (e for e in self.heard[begun:] if (e.kind, e.source) == ("COMMAND_ACK", VEHICLE))
        acks = [each.message for each in heard]
        assert all((ack.target_system, ack.target_component) == self.source for ack in acks)
        results = [int(ack.result) for ack in acks if ack.command == number]
        return results[-1] if results else None

    def set_mode(self, mode: str | int) -> int | None:
        """The result of DO_SET_MODE; PX4's second answer, as the first is always yes."""
        numbers = {each.name: each.number for each in self.autopilot.firmware.modes}
        number, begun = numbers[mode] if isinstance(mode, str) else mode, len(self.heard)
        if self.firmware != "px4":
            return self.command(176, 1, number)
        assert self.command(176, 1, number >> 16 & 0xFF, number >> 24) == 0
        self.step()
        return self._result(176, begun)

    def arm(self) -> int | None:
        return self.command(400, 1)

    def aim(self, *vectors: Any, **fields: Any) -> None:
        """A setpoint, once."""
        self.send(setpoint(*vectors, **fields))

    def reposition(
        self, north_m: float, east_m: float, up_m: float, radius_m: float = 0.0, ccw: float = 0.0
    ) -> int | None:
        """DO_REPOSITION to a place from home."""
        left, place = NAN if self.firmware == "px4" else ccw, self.place(north_m, east_m, up_m)
        return self.command(192, -1, 1, radius_m, left, *place, frame=5)

    def fault(self, line: str) -> None:
        self.simulation.add_fault(line)

    def plan(self, kind: PlanKind, *items: PlanItem) -> None:
        self.simulation.plans[kind] = items
        self.autopilot.on_plan(kind)

    # --- time ---------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Vehicle time since the start."""
        return self.simulation.now_us * 1e-6

    def step(self) -> None:
        """10 ms, and before them what is due to be sent."""
        steps, self._steps = self._steps, self._steps + 1
        if self.streamed is not None and steps % 5 == 0:
            self.send(self.streamed)
        if self.beat is not None and steps % 100 == 0:
            self.send(self.beat)
        self.simulation.step()
        self._hear()

    def _hear(self) -> None:
        now_s = self.now_s
        self.heard += [Heard(now_s, frame, link) for link, frame in self.simulation.take_frames()]

    def run(self, seconds: float, each: Callable[[], object] | None = None) -> Self:
        """Fly on, with something to do before each step."""
        for _ in range(round(seconds / STEP_S)):
            if each is not None:
                each()
            self.step()
        return self

    def until(self, reached: Callable[[], bool], within_s: float = 300.0) -> float:
        """Fly until this is so; returns how long it took, in seconds."""
        begun_s = self.now_s
        while not reached():
            assert self.now_s - begun_s < within_s, self.simulation.outcome()
            self.step()
        return self.now_s - begun_s

    def stream(self, seconds: float, *vectors: Any, **fields: Any) -> Self:
        """The same setpoint again and again, and no more then."""
        self.streamed = setpoint(*vectors, **fields)
        self.run(seconds).streamed = None
        return self

    def armable(self) -> Self:
        """Boot until it may be armed."""
        self.until(lambda: self.simulation.armable, 60.0)
        return self

    def climb(self, height_m: float) -> Self:
        """Boot and into the air: a plane flies straight on then, PX4's copter is in OFFBOARD."""
        self.armable()
        if self.firmware == "px4" and self.kind == "copter":
            self.streamed = setpoint(None, (0.0, 0.0, -2.0))
            self.run(1.0).set_mode("Offboard")
        elif self.firmware == "px4":
            height_amsl_m = self.home[2] + height_m
            self.command(22, 0, 0, 0, *[NAN] * 3, height_amsl_m, frame=5)  # for good straight on
        else:
            self.set_mode("TAKEOFF" if self.kind == "plane" else "GUIDED")
        assert self.arm() == 0
        if self.firmware != "px4" and self.kind == "copter":
            assert self.command(22, *[0.0] * 6, height_m) == 0
        self.until(lambda: self.height_m > height_m - 0.5, 60.0)
        self.streamed = None
        if (self.firmware, self.kind) == ("ardupilot", "plane"):
            self.set_mode("CRUISE")
        return self

    def take_off(self, height_m: float = 30.0) -> Self:
        """Into the air and into the mode that takes setpoints: copters above home, ArduPlane on its
        way to a circle about it at 80 m, PX4's plane in Hold.
        """
        self.climb(height_m)
        for number in {*self.autopilot.firmware.rates_hz} - {0}:
            self.command(511, number, -1)  # what is streamed unasked is rarely looked at
        if self.firmware == "px4":
            if self.kind == "copter":
                return self.stream(5.0, (0.0, 0.0, -height_m))
            self.set_mode("Hold")
        elif self.kind == "plane":
            assert self.reposition(0.0, 0.0, 80.0) == 0
        else:
            self.until(lambda: self.status.landed_state == 2, 30.0)
        return self.run(3.0)

    def put_at(self, place: Vector, velocity_m_s: complex) -> Self:
        """A plane, wings level in still air, north + east j."""
        plane = self.vehicle
        plane.latitude_deg, plane.longitude_deg, plane.altitude_amsl_m = place
        plane.velocity_m_s, plane.airspeed_m_s = velocity_m_s, abs(velocity_m_s)
        plane.heading_rad, plane.roll_rad = cmath.phase(velocity_m_s) % math.tau, 0.0
        return self.run(STEP_S)

    # --- out ----------------------------------------------------------------------------------

    def all(
        self, kind: str, *, link: int = 0, since_s: float = 0.0, source: Ids | None = None
    ) -> list[Heard]:
        """Every one of this kind that came by this link, from this source or any."""
        heard = (each for each in self.heard if (each.kind, each.link) == (kind, link))
        return [each for each in heard if each.at_s >= since_s and source in (None, each.source)]

    def said(self, kind: str, source: Ids = VEHICLE, since_s: float = 0.0) -> list[Any]:
        """The messages of this kind and source on link 0."""
        return [each.message for each in self.all(kind, source=source, since_s=since_s)]

    def last(self, kind: str) -> Any:
        """The newest of this kind on link 0; it must have come."""
        return self.all(kind)[-1].message

    def texts(self, since_s: float = 0.0) -> list[str]:
        """What was said, of each text the first 50 characters."""
        told = (each.message for each in self.all("STATUSTEXT", since_s=since_s))
        return [message.text for message in told if not message.chunk_seq]

    # --- to look at ---------------------------------------------------------------------------

    @property
    def autopilot(self) -> Any:
        return self.simulation._controller.autopilot

    @property
    def vehicle(self) -> Any:
        """Where it is, truly."""
        return self.simulation.vehicle

    @property
    def height_m(self) -> float:
        """Above the ground at the start, truly."""
        return float(self.vehicle.altitude_amsl_m - self.home[2])

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

    def place(self, north_m: float, east_m: float, up_m: float) -> Vector:
        """Latitude, longitude and altitude AMSL of a point of that frame."""
        there = self.autopilot.frame.place(north_m, east_m, 0.0)
        return there.latitude_deg, there.longitude_deg, self.home[2] + up_m

    @property
    def mode(self) -> str:
        return self.simulation.mode_name

    @property
    def status(self) -> Any:
        return self.autopilot.status()

    def truth(self) -> Sequence[dict[str, Any]]:
        return [json.loads(line) for line in self.simulation.take_truth()][1:]


# --- some that fly --------------------------------------------------------------------------------

KINDS: Final = tuple(itertools.product(get_args(Firmware), get_args(VehicleKind)))


@copied
def flying(firmware: str, kind: VehicleKind) -> Rig:
    """In the mode that takes setpoints, with a ground station on link 0."""
    vehicle = Rig(firmware, kind)
    vehicle.source, vehicle.beat = GCS, heartbeat(mavlink.MAV_TYPE_GCS)
    vehicle.take_off(40.0)
    for number in (24, 33, 30):
        vehicle.command(511, number, 100_000)
    return vehicle.run(1.0)


@copied
def hovering(height_m: float = 30.0, lean_deg: float = 45.0, **told: Any) -> Rig:
    """An ArduCopter in GUIDED above home."""
    return Rig(ANGLE_MAX=lean_deg * 100.0, **told).take_off(height_m)


@copied
def circling(settle_s: float = 30.0, **told: Any) -> Rig:
    """An ArduPlane in GUIDED about home."""
    return Rig("ardupilot", "plane", **told).take_off(48.0).run(settle_s)


@copied
def hover(height_m: float = 15.0, **told: Any) -> Rig:
    """PX4's copter in OFFBOARD above the origin, with the parameters of the recorded ones."""
    return Rig("px4", **_AS_RECORDED | told).take_off(height_m)


@copied
def _cruising(**told: Any) -> Rig:
    return Rig("px4", "plane", **{"COM_OBL_RC_ACT": 5.0} | told).take_off(50.0)


def cruising(north_m: float = 0, east_m: float = 0, heading_rad: float = 0, **told: Any) -> Rig:
    """PX4's plane that has long been on its way, put there 68 m up."""
    rig, velocity_m_s = _cruising(**told), cmath.rect(SIH_AIRPLANE.airspeed_max_m_s, heading_rad)
    return rig.put_at(rig.place(north_m, east_m, 68.0), velocity_m_s)
