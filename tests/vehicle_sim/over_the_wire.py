"""A vehicle of which nothing is seen but its frames: what goes in and what comes out, by link.

Vehicles that have booted or fly already are made once and handed out as copies.
"""

import copy
import copyreg
import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.parameters import Firmware, Parameter
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import VehicleKind, flat_world

copyreg.pickle(Parameter, lambda row: row.name)  # never changes: copies share it

Ids = tuple[int, int]
Vector = tuple[float, float, float]
HOME_DEG, HOME_M = (-35.363262, 149.165237), 584.0
METRES_PER_DEG_NORTH = 110_955.0
"""Of the meridian there; ArduPilot's own flat earth has 111,318.8."""
VEHICLE, GCS, COMPANION = (1, 1), (255, 190), (1, 191)
ZERO: Vector = (0.0, 0.0, 0.0)
POSITION, POSITION_VELOCITY, ALL, VELOCITY = 0xDF8, 0xDC0, 0xC00, 0xDC7
GUIDED, LAND, BRAKE = 4, 9, 17
PLANE_GUIDED, PLANE_TAKEOFF = 15, 13
LOCAL_POSITION, ECHO, ATTITUDE = 32, 85, 30
QUIET = (2, 4, 8, 29, 31, 33, 36, 74, 83, 85, 87, 105, 111, 132, 141, 147, 231, 241, 331, 360, 380)
"""What PX4 streams and is rarely looked at."""
_STEPS_PER_S = 100
_WHERE = ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE", "HEARTBEAT")
_reader = mavlink.MAVLink(None)
_NAMES = {number: kind.msgname for number, kind in mavlink.mavlink_map.items()}


def kind_of(number: int) -> str:
    """The name of a message, as pymavlink gives it to those that it does not know too."""
    return _NAMES.get(number, f"UNKNOWN_{number}")


class Heard:
    """One frame that came out of the vehicle's end of a link; read when its message is wanted."""

    __slots__ = ("_message", "at_s", "frame", "kind", "link", "source")

    def __init__(self, at_s: float, link: int, frame: bytes) -> None:
        self.at_s, self.link, self.frame = at_s, link, frame
        """Vehicle time since the start."""
        self.source: Ids = (frame[5], frame[6])
        self.kind: str = kind_of(int.from_bytes(frame[7:10], "little"))
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
    ned: Vector,
    velocity: Vector = ZERO,
    acceleration: Vector = ZERO,
    *,
    mask: int = POSITION,
    frame: int = 1,
    target: Ids = VEHICLE,
    yaw_rad: float = 0.0,
) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED."""
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, *target, frame, mask, *ned, *velocity, *acceleration, yaw_rad, 0.0
    )


def place_e7(north_m: float, east_m: float) -> tuple[int, int]:
    """On ArduPilot's flat earth about home."""
    scale = 111_318.845
    latitude_deg = HOME_DEG[0] + north_m / scale
    longitude_deg = HOME_DEG[1] + east_m / (scale * math.cos(math.radians(HOME_DEG[0])))
    return round(latitude_deg * 1e7), round(longitude_deg * 1e7)


def over_ground(
    north_m: float,
    east_m: float,
    altitude_m: float,
    velocity: Vector = ZERO,
    acceleration: Vector = ZERO,
    *,
    mask: int = POSITION,
    frame: int = 6,
) -> Any:
    """SET_POSITION_TARGET_GLOBAL_INT of a place so far from home."""
    return mavlink.MAVLink_set_position_target_global_int_message(
        0,
        *VEHICLE,
        frame,
        mask,
        *place_e7(north_m, east_m),
        altitude_m,
        *velocity,
        *acceleration,
        0.0,
        0.0,
    )


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
        firmware: Firmware,
        place: Vector,
        *,
        links: int = 1,
        parameters: Mapping[str, float] | None = None,
        scan_range_m: float | None = None,
        faults: str = "",
        seed: int = 0,
    ) -> None:
        radar = {} if scan_range_m is None else {"scan_range_m": scan_range_m}
        world = flat_world(
            kind,
            firmware,
            latitude_deg=place[0],
            longitude_deg=place[1],
            altitude_amsl_m=place[2],
            heading_deg=0.0,
            **radar,
        )
        vehicle = dataclasses.replace(world.vehicle, parameters=parameters or {})
        world = dataclasses.replace(world, vehicle=vehicle)
        self.simulation = Simulation(world, links=links, faults=faults, seed=seed)
        self.kind, self.firmware, self.source = kind, firmware, COMPANION
        self.heard: list[Heard] = []
        self.aim: Callable[[float], Any] | None = None
        self.rate_hz = 20.0
        self.aimed_s = math.nan
        """When the newest of the stream was sent."""
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

    def step(self) -> None:
        """10 ms, and before them what is due to be sent."""
        steps, self._steps = self._steps, self._steps + 1
        if self.aim is not None and steps % round(_STEPS_PER_S / self.rate_hz) == 0:
            self.aimed_s = self.now_s
            self.send(self.aim(self.aimed_s))
        if steps % _STEPS_PER_S == 0:
            for kind in self.heartbeats:
                self.send(heartbeat(kind))
        self.simulation.step()
        now_s = self.now_s
        self.heard += [Heard(now_s, link, frame) for link, frame in self.simulation.take_frames()]

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


class Wire(Link):
    """The three links of one ArduPilot."""

    def __init__(self, kind: VehicleKind = "copter", **parameters: float) -> None:
        super().__init__(kind, "ardupilot", (*HOME_DEG, HOME_M), links=3, parameters=parameters)

    @property
    def not_survived(self) -> str | None:
        """What came in that the real autopilot does not survive."""
        return self.simulation.not_survived

    def takes_new_port(self) -> bool:
        """Whether it sends from another UDP port since the last call."""
        return self.simulation.take_port_change()

    def interval(
        self, number: int, hz: float, link: int = 0, source: Ids | None = None
    ) -> int | None:
        """SET_MESSAGE_INTERVAL."""
        return self.command(511, number, 1e6 / hz if hz > 0 else hz, link=link, source=source)

    def parameter(self, name: str, value: float | None = None) -> float:
        """The value that PARAM_VALUE tells, after it has been set if one is given."""
        message: Any
        if value is None:
            message = mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1)
        else:
            message = mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, 9)
        self.send(message)
        (told,) = [
            each.message.param_value
            for each in self.run(0.02)
            if each.kind == "PARAM_VALUE" and each.link == 0 and each.message.param_id == name
        ]
        return float(told)

    def run_until(self, reached: Callable[[], bool], within_s: float) -> float:
        """Until this is so; how long that took."""
        begun_s = self.now_s
        while not reached():
            assert self.now_s - begun_s < within_s, "it never came to that"
            self.run(0.05)
        return self.now_s - begun_s

    def said_s(self, text: str) -> list[float]:
        """When a text with this in it was said."""
        return [each.at_s for each in self.all("STATUSTEXT") if text in each.message.text]

    @property
    def ned_m(self) -> Vector:
        """The newest LOCAL_POSITION_NED."""
        m = self.last("LOCAL_POSITION_NED")
        return m.x, m.y, m.z

    @property
    def level_m_s(self) -> float:
        """The horizontal speed in it."""
        m = self.last("LOCAL_POSITION_NED")
        return math.hypot(m.vx, m.vy)

    @property
    def mode(self) -> int:
        """Of the newest heartbeat."""
        return int(self.last("HEARTBEAT").custom_mode)

    def echo_of(self, setpoint: Any, **how: Any) -> Any:
        """Send it; the POSITION_TARGET_LOCAL_NED that a ground station then asks for."""
        self.send(setpoint, **how)
        self.run(0.02)
        return self.echo()

    def echo(self) -> Any:
        """POSITION_TARGET_LOCAL_NED, asked for by a ground station."""
        assert self.command(512, ECHO, source=GCS) == 0
        return self.last("POSITION_TARGET_LOCAL_NED")


# --- vehicles that are ready made -----------------------------------------------------------------


@functools.cache
def _booted(kind: VehicleKind) -> Wire:
    wire = Wire(kind)
    wire.run(45.0 if kind == "copter" else 25.0)
    return wire


def booted(kind: VehicleKind = "copter") -> Wire:
    """One that may be armed, and that has heard nobody yet."""
    return _booted(kind).copy()


@functools.cache
def _hovering(lean_deg: int) -> Wire:
    wire = booted()
    wire.parameter("ANGLE_MAX", lean_deg * 100.0)
    for number, hz in ((LOCAL_POSITION, 20), (33, 10), (245, 5), (ATTITUDE, 20)):
        assert wire.interval(number, hz) == 0
    assert [wire.command(176, 1, GUIDED), wire.command(400, 1)] == [0, 0]
    assert wire.command(22, 0, 0, 0, 0, 0, 0, 30) == 0
    wire.run(22.0)
    assert wire.ned_m[2] < -29.5
    return wire


def hovering(lean_deg: int = 30) -> Wire:
    """A copter in GUIDED, 30 m above home, with its telemetry on link 0."""
    return _hovering(lean_deg).copy()


@functools.cache
def _cruising(speed_m_s: float, mask: int) -> Wire:
    wire = hovering(45)
    route = straight(speed_m_s)
    for _ in range(round(2.5 * speed_m_s + (10.0 if mask == POSITION else 2.0)) * 10):
        wire.send(next(route)(mask))
        wire.run(0.1)
    return wire


def straight(speed_m_s: float) -> Iterator[Callable[[int], Any]]:
    """Northwards from above home, ten setpoints a second, by the mask that they are to have."""
    north_m = t = 0.0
    ramp_s = 1.5 * speed_m_s
    while True:
        ramp = min(t / ramp_s, 1.0)
        v = speed_m_s * ramp * ramp * (3.0 - 2.0 * ramp)
        yield functools.partial(_ahead, north_m, v)
        for k in range(10):  # as fine as the vehicle's own steps
            ramp = min((t + 0.01 * k) / ramp_s, 1.0)
            north_m += speed_m_s * ramp * ramp * (3.0 - 2.0 * ramp) * 0.01
        t += 0.1


def _ahead(north_m: float, v: float, mask: int) -> Any:
    return local((north_m, 0.0, -30.0), (v, 0.0, 0.0), mask=mask)


def cruising(speed_m_s: float, mask: int) -> tuple[Wire, float]:
    """A copter in mid-stream, northwards, and how far north its next setpoint would lie."""
    wire = _cruising(speed_m_s, mask).copy()
    route = straight(speed_m_s)
    for _ in range(round(2.5 * speed_m_s + (10.0 if mask == POSITION else 2.0)) * 10):
        next(route)
    return wire, float(next(route)(mask).x)


@functools.cache
def _circling() -> Wire:
    wire = booted("plane")
    for number, hz in ((LOCAL_POSITION, 10), (33, 10), (87, 5)):
        assert wire.interval(number, hz) == 0
    assert [wire.command(176, 1, PLANE_TAKEOFF), wire.command(400, 1)] == [0, 0]
    wire.run(14.0)
    assert reposition(wire, 0.0, 0.0, 80.0) == 0
    wire.run(40.0)
    return wire


def circling() -> Wire:
    """A plane in GUIDED about home, 80 m up."""
    return _circling().copy()


def reposition(
    wire: Wire,
    north_m: float,
    east_m: float,
    up_m: float,
    *,
    radius_m: float = 0.0,
    ccw: float = 0.0,
    frame: int = 3,
    flags: float = 1.0,
) -> int | None:
    """COMMAND_INT DO_REPOSITION."""
    height_m = up_m if frame in (3, 6, 10, 11) else up_m + HOME_M
    place = place_e7(north_m, east_m)
    return wire.command(192, -1.0, flags, radius_m, ccw, *place, height_m, frame=frame)


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
