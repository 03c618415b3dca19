"""Experiments with a simulated PX4 over the wire: links, start, arming, modes (px4.md 2, 3).

Each returns what a client saw.  The conditions are those of px4.md: SIH_KDV 0.25
and COM_OBL_RC_ACT 5 unless stated.
"""

import functools
from typing import Any, Final, NamedTuple

from px4_wire import (
    GROUND_AMSL_M,
    HOLD,
    LAND,
    MISSION,
    NAN,
    NORTH_M_PER_DEG,
    OFFBOARD,
    Aim,
    Companion,
    Heard,
    Vector,
    local,
)
from pymavlink.dialects.v20 import all as mavlink

GROUND_STATION, COMPANION = 6, 18
PREARM = 0x10000000
REAL_TIME_FACTOR = 0.985
"""Of the measurements: rates of the document are per second of wall time."""
LISTEN_S = 20.0
CLIMB: Final = local((0.0, 0.0, -10.0), yaw=0.0)


# --- beginnings -----------------------------------------------------------------------------------


@functools.cache
def _ground(drag: float, loss_action: int) -> Companion:
    return Companion().booted(SIH_KDV=drag, COM_OBL_RC_ACT=loss_action)


def ground(drag: float = 0.25, loss_action: int = 5) -> Companion:
    """Booted and armable; each call gives a fresh one."""
    return refreshed(_ground(drag, loss_action))


@functools.cache
def _hover(height_m: float, drag: float, loss_action: int) -> Companion:
    return ground(drag, loss_action).flying(height_m)


def hover(height_m: float = 15.0, drag: float = 0.25, loss_action: int = 5) -> Companion:
    """In OFFBOARD above the origin."""
    return refreshed(_hover(height_m, drag, loss_action))


def refreshed(flight: Companion) -> Companion:
    flight = flight.copy()
    flight.run(1.0)
    return flight


def north(speed_m_s: float, down_m_s: float = 0.0) -> Aim:
    return lambda _: local(velocity=(speed_m_s, 0.0, down_m_s), yaw=0.0)


@functools.cache
def _cruise(speed_m_s: float, drag: float, loss_action: int) -> Companion:
    flight = hover(drag=drag, loss_action=loss_action)
    flight.aim = north(speed_m_s)
    flight.run(7.0)
    return flight


def cruise(speed_m_s: float = 5.0, drag: float = 0.25, loss_action: int = 5) -> Companion:
    """Flying north with a stream of velocities."""
    return refreshed(_cruise(speed_m_s, drag, loss_action))


# --- 2: links -------------------------------------------------------------------------------------


@functools.cache
def listening() -> Companion:
    """On the ground in Hold for 20 s, with all the default rates."""
    vehicle = Companion()
    vehicle.run(10.0)
    vehicle.heard.clear()
    vehicle.run(LISTEN_S)
    return vehicle


def rate(kind: str) -> float:
    return len(listening().of(kind)) / LISTEN_S * REAL_TIME_FACTOR


def ids() -> set[tuple[int, int]]:
    frames = (heard.message.get_msgbuf() for heard in listening().heard)
    return {(frame[5], frame[6]) for frame in frames}


class Traffic(NamedTuple):
    """What came of the default streams in 10 s of OFFBOARD."""

    per_second: float
    kilobytes_per_second: float
    kinds: set[str]
    commands: list[tuple[int, int]]
    """COMMAND_LONGs of the next change of the mode: command and target system."""


@functools.cache
def traffic(kind: str = "copter") -> Traffic:
    vehicle = Companion(kind)  # type: ignore[arg-type]
    vehicle.aim = lambda _: CLIMB
    vehicle.run(8.0)
    vehicle.set_mode(OFFBOARD)
    vehicle.command(400, 1)
    vehicle.run(8.0)
    vehicle.heard.clear()
    vehicle.run(10.0)
    messages = [heard.message for heard in vehicle.heard]
    size = sum(len(message.get_msgbuf()) for message in messages)
    since_s = vehicle.now_s
    vehicle.set_mode(LAND)
    vehicle.run(4.0)
    return Traffic(
        len(messages) / 10.0 * REAL_TIME_FACTOR,
        size / 10e3 * REAL_TIME_FACTOR,
        {message.get_type() for message in messages},
        [(m.command, m.target_system) for m in vehicle.of("COMMAND_LONG", since_s)],
    )


def set_interval(number: int, interval_us: float, *rest: float) -> int | None:
    return ground().command(511, number, interval_us, *rest)


def rate_after(kind: str, number: int, *intervals_us: float) -> float:
    """Rate of the message after these intervals were set, one after the other."""
    vehicle = ground()
    for interval_us in intervals_us:
        vehicle.command(511, number, interval_us)
    vehicle.run(0.1)
    since_s = vehicle.now_s
    vehicle.run(10.0)
    return len(vehicle.of(kind, since_s)) / 10.0


def interval_told(number: int) -> int:
    vehicle = ground()
    vehicle.command(510, number)
    return int(vehicle.last("MESSAGE_INTERVAL").interval_us)


def mode_is_told_after() -> float:
    """CURRENT_MODE after a command, with an interval of 50 ms asked for."""
    vehicle = ground()
    since_s = vehicle.now_s
    vehicle.set_mode(MISSION)
    vehicle.run(0.3)
    return min(t for t, mode in vehicle.modes(since_s) if mode == MISSION) - since_s


def requested(number: int, kind: str, field: str) -> Any:
    """What REQUEST_MESSAGE brings."""
    vehicle = ground()
    since_s = vehicle.now_s
    vehicle.command(512, number)
    return getattr(vehicle.of(kind, since_s)[-1], field)


def global_target_rates() -> tuple[float, float]:
    """POSITION_TARGET_GLOBAL_INT in the air, in OFFBOARD and in Hold."""
    flight = hover()
    flight.command(511, 87, 0)
    flight.run(10.0)
    flight.set_mode(HOLD)
    since_s = flight.now_s
    flight.run(10.0)
    after = len(flight.of("POSITION_TARGET_GLOBAL_INT", since_s))
    before = len(flight.of("POSITION_TARGET_GLOBAL_INT")) - after
    return before / 10.0, after / 10.0


def origins() -> tuple[int, int]:
    """GPS_GLOBAL_ORIGIN to one who came later: unasked in 20 s, and when asked for."""
    unasked = len(listening().of("GPS_GLOBAL_ORIGIN"))
    vehicle = ground()
    vehicle.command(512, 49)
    return unasked, len(vehicle.of("GPS_GLOBAL_ORIGIN"))


def armed_by(
    source: tuple[int, int] = (1, 191), target: tuple[int, int] = (1, 1), kind: int = COMPANION
) -> bool:
    vehicle = ground()
    vehicle.send(mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3), source=source)
    arm = mavlink.MAVLink_command_long_message(*target, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    vehicle.send(arm, source=source)
    vehicle.run(1.5)
    return bool(vehicle.last("HEARTBEAT").base_mode & 128)


def setpoints_to(system: int, component: int, source: int = 1) -> tuple[bool, int]:
    """Whether they keep it in OFFBOARD, and how many answers came."""
    flight = hover()
    flight.source = (source, 191)
    since_s = flight.now_s
    flight.aim = lambda _: local((0.0, 0.0, -15.0), target=(system, component))
    flight.run(2.0)
    return flight.mode == OFFBOARD, len(flight.of("COMMAND_ACK", since_s))


@functools.cache
def companion_lost() -> tuple[str, int, int]:
    """Texts, mode and system_status after a companion's heartbeats have ended; it still streams."""
    flight = hover()
    flight.heartbeats = (COMPANION, GROUND_STATION)
    flight.run(4.0)
    since_s = flight.now_s
    flight.heartbeats = (GROUND_STATION,)
    flight.run(8.0)
    return " ".join(flight.texts(since_s)), flight.mode, flight.status


def texts_and_events(*heartbeats: int) -> tuple[bool, bool]:
    """Whether arming brings STATUSTEXTs and EVENTs to one with these heartbeats."""
    vehicle = ground()
    vehicle.heartbeats = heartbeats
    vehicle.run(1.5)
    since_s = vehicle.now_s
    vehicle.command(400, 1)
    vehicle.run(1.0)
    return bool(vehicle.texts(since_s)), bool(vehicle.events(since_s))


def texts_by_link() -> tuple[bool, bool]:
    """With a companion on the first link and a ground station on the second."""
    vehicle = Companion(links=2)
    vehicle.run(7.0)
    heartbeat = mavlink.MAVLink_heartbeat_message
    vehicle.send(heartbeat(COMPANION, 8, 0, 0, 4, 3))
    vehicle.send(heartbeat(GROUND_STATION, 8, 0, 0, 4, 3), link=1, source=(255, 190))
    vehicle.command(400, 1)
    vehicle.run(1.0)
    return bool(vehicle.texts(link=0)), bool(vehicle.texts(link=1))


class _Signed:
    """Packs a message signed with a key of 7s."""

    def __init__(self, message: Any) -> None:
        self._message = message

    def pack(self, mav: Any) -> bytes:
        mav.signing.secret_key = bytes([7]) * 32
        mav.signing.link_id = 3
        mav.signing.timestamp = 400_000_000_000
        mav.signing.sign_outgoing = True
        return bytes(self._message.pack(mav))


@functools.cache
def signing() -> tuple[bool, bool, bool]:
    """Armed by a signed frame; disarmed by an unsigned one in spite of a key; ever signed."""
    vehicle = ground()
    arm, disarm = (
        mavlink.MAVLink_command_long_message(1, 1, 400, 0, wanted, 0, 0, 0, 0, 0, 0)
        for wanted in (1, 0)
    )
    vehicle.send(_Signed(arm))
    vehicle.run(1.5)
    armed = bool(vehicle.last("HEARTBEAT").base_mode & 128)
    vehicle.send(mavlink.MAVLink_setup_signing_message(1, 1, bytes([7]) * 32, 400_000_000_001))
    vehicle.run(0.1)
    vehicle.send(disarm)
    vehicle.run(1.5)
    ever = any(heard.message.get_msgbuf()[2] & 1 for heard in vehicle.heard)
    return armed, not vehicle.last("HEARTBEAT").base_mode & 128, ever


def leaves_it_cold(message: Any) -> bool:
    """Whether an OFFBOARD flight goes on just as without this message, and nobody answers."""
    flights = [cruise(), cruise()]
    flights[1].send(message)
    for flight in flights:
        flight.run(2.0)
    told = [[heard.message.get_type() for heard in flight.heard] for flight in flights]
    return flights[0].position == flights[1].position and told[0] == told[1]


OBSTACLES: Final = mavlink.MAVLink_obstacle_distance_message(0, 0, [100] * 72, 5, 20, 3000)
ROUTE: Final = mavlink.MAVLink_trajectory_representation_waypoints_message(
    0, 1, *([[0.0] * 5] * 11), [0] * 5
)


def whole_parameter(name: str, value: int) -> float | None:
    """Set bytewise, read back bytewise."""
    vehicle = ground()
    vehicle.set_parameter(name, value)
    return vehicle.parameter(name)


@functools.cache
def default(name: str, kind: str = "copter") -> float | None:
    """Of a parameter, in a vehicle of which nothing was changed."""
    vehicle = Companion(kind)  # type: ignore[arg-type]
    vehicle.run(2.0)
    return vehicle.parameter(name)


# --- 3: start, arming, modes ----------------------------------------------------------------------


class Boot(NamedTuple):
    """Seconds after power-on."""

    heartbeat_s: float
    heartbeat: tuple[int, int]
    """Status and mode of the first one."""
    standby_s: float
    armable_s: float
    masks: int
    """Bits of PREARM seen in present or enabled."""


@functools.cache
def boot(kind: str = "copter") -> Boot:
    vehicle = Companion(kind)  # type: ignore[arg-type]
    vehicle.run(10.0)
    beats = vehicle.times("HEARTBEAT")
    reports = vehicle.times("SYS_STATUS")
    first = beats[0].message
    masks = 0
    for report in reports:
        masks |= report.message.onboard_control_sensors_present
        masks |= report.message.onboard_control_sensors_enabled
    return Boot(
        beats[0].t_s,
        (first.system_status, first.custom_mode),
        min(h.t_s for h in beats if h.message.system_status == 3),
        min(h.t_s for h in reports if h.message.onboard_control_sensors_health & PREARM),
        masks & PREARM,
    )


def disarmed_mode(custom: int, *, old: bool = False) -> tuple[int, int]:
    """Of the heartbeat, mode and status, after DO_SET_MODE (or the old SET_MODE) on the ground."""
    vehicle = ground()
    if old:
        vehicle.send(mavlink.MAVLink_set_mode_message(1, 1, custom))
    else:
        vehicle.set_mode(custom)
    vehicle.run(2.5)
    beat = vehicle.last("HEARTBEAT")
    return beat.custom_mode, beat.system_status


def prearm_in(custom: int) -> bool:
    """Whether SYS_STATUS says that it can be armed in this mode, without a stream."""
    vehicle = ground()
    vehicle.set_mode(custom)
    vehicle.run(4.0)
    return bool(vehicle.last("SYS_STATUS").onboard_control_sensors_health & PREARM)


def mode_results(flight: Companion, custom: int) -> list[tuple[int, bool]]:
    """Results of all the ACKs of DO_SET_MODE, and whether they came within 10 ms."""
    since_s = flight.now_s
    flight.command(176, 1, custom >> 16 & 0xFF, custom >> 24)
    flight.run(0.2)
    return [
        (h.message.result, h.t_s - since_s <= 0.02) for h in flight.times("COMMAND_ACK", since_s)
    ]


def without_stream() -> Companion:
    """In the air in Hold, without a stream for three seconds."""
    flight = hover()
    flight.aim = None
    flight.set_mode(HOLD)
    flight.run(3.0)
    return flight


def arming_in_offboard_without_stream() -> int | None:
    vehicle = ground()
    vehicle.set_mode(OFFBOARD)
    vehicle.run(0.5)
    return vehicle.command(400, 1)


def enters_offboard_after(setpoints: int, wait_s: float, *, airborne: bool) -> bool:
    """The order follows the setpoints at once; whether OFFBOARD comes with retries for wait_s."""
    flight = without_stream() if airborne else ground()
    if not airborne:
        flight.command(400, 1)
    for _ in range(setpoints):
        flight.send(local((0.0, 0.0, -10.0)))
    flight.aim, flight.rate_hz = lambda _: local((0.0, 0.0, -10.0)), 2.0
    start_s = flight.now_s
    while flight.mode != OFFBOARD and flight.now_s - start_s < wait_s:
        flight.set_mode(OFFBOARD)
        flight.run(0.05)
    return flight.mode == OFFBOARD


def early_setpoint_is_flown() -> float:
    """Metres climbed towards a setpoint that came before OFFBOARD, in 0.9 s and the Hold after."""
    flight = without_stream()
    before_m = flight.position[2]
    flight.send(local((0.0, 0.0, -60.0)))
    flight.run(0.2)
    flight.set_mode(OFFBOARD)
    flight.run(3.0)
    return before_m - flight.position[2]


class Climb(NamedTuple):
    """A take-off in OFFBOARD, times after arming."""

    lift_off_s: float
    """As EXTENDED_SYS_STATE says."""
    to_9_5_m_s: float
    fastest_m_s: float
    highest_m: float


@functools.cache
def climb(*, by_velocity: bool = False) -> Climb:
    flight = ground()
    flight.aim = (lambda _: local(velocity=(0, 0, -1.0))) if by_velocity else (lambda _: CLIMB)
    flight.run(0.5)
    flight.set_mode(OFFBOARD)
    start_s = flight.now_s
    flight.command(400, 1)
    flight.run(16.0)
    track = [(h.t_s - start_s, -h.message.z, -h.message.vz) for h in positions(flight, start_s)]
    states = flight.times("EXTENDED_SYS_STATE", start_s)
    return Climb(
        min(h.t_s for h in states if h.message.landed_state != 1) - start_s,
        min((t for t, height, _ in track if height > 9.5), default=NAN),
        max(up for *_, up in track),
        max(height for _, height, _ in track),
    )


def positions(flight: Companion, since_s: float = 0.0) -> list[Heard]:
    return flight.times("LOCAL_POSITION_NED", since_s)


@functools.cache
def commanded_takeoff() -> tuple[list[int], float, float]:
    """Modes, seconds from arming to Hold, and the height, of NAV_TAKEOFF without a place."""
    flight = ground()
    flight.command(22, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    since_s = flight.now_s
    flight.command(400, 1)
    hold_s = flight.until(lambda: flight.mode == HOLD, 20.0)
    flight.run(5.0)
    modes = [mode for _, mode in flight.modes(since_s)]
    return modes, hold_s, -flight.position[2]


def disarmed(flight: Companion) -> bool:
    return not flight.last("HEARTBEAT").base_mode & 128


def disarms_unflown_after() -> float:
    vehicle = ground()
    vehicle.command(400, 1)
    vehicle.run(1.5)
    assert not disarmed(vehicle)
    return 1.5 + vehicle.until(lambda: disarmed(vehicle), 20.0)


class Landing(NamedTuple):
    """NAV_LAND with the stream going on."""

    result: int | None
    mode: int
    disarms_after_s: float
    """From ON_GROUND."""
    mode_after: int
    height_after_arming_m: float


@functools.cache
def landing() -> Landing:
    flight = hover(6.0)
    result = flight.command(21, 0, 0, 0, NAN)
    flight.run(1.0)
    mode = flight.mode
    flight.until(lambda: flight.last("EXTENDED_SYS_STATE").landed_state == 1, 40.0)
    on_ground_s = flight.now_s
    flight.until(lambda: disarmed(flight), 10.0)
    disarmed_s = flight.now_s
    flight.run(3.0)
    mode_after = flight.mode
    flight.command(400, 1)
    flight.run(8.0)
    return Landing(result, mode, disarmed_s - on_ground_s, mode_after, -flight.position[2])


def after_command(number: int, *parameters: float, point: Vector | None = None) -> tuple[Any, int]:
    """Result and mode, from OFFBOARD with the stream going on."""
    flight = hover()
    if point is None:
        result = flight.command(number, *parameters)
    else:
        result = flight.command_at(number, point, *parameters)
    flight.run(3.0)
    return result, flight.mode


@functools.cache
def home_moved() -> tuple[int | None, float, float]:
    """DO_SET_HOME by COMMAND_INT: result, new altitude, and metres of the shift to the north."""
    vehicle = ground()
    vehicle.command(512, 242)
    before = vehicle.last("HOME_POSITION")
    result = vehicle.command_at(179, (30.0, 0.0, GROUND_AMSL_M + 5.0), frame=5)
    after = vehicle.last("HOME_POSITION")
    shift_m = (after.latitude - before.latitude) * 1e-7 * NORTH_M_PER_DEG
    return result, after.altitude * 1e-3, shift_m


def speed_after_change() -> tuple[int | None, float]:
    flight = cruise(6.0)
    result = flight.command(178, 1, 2, -1)
    flight.run(4.0)
    return result, flight.speed
