"""Experiments with a simulated PX4 over the wire: links, start, arming, modes (px4.md 2, 3).

Each returns what a client saw.  The conditions are those of px4.md: SIH_KDV 0.25
and COM_OBL_RC_ACT 5 unless stated.
"""

import functools
from collections.abc import Iterable
from typing import Any, Final

from harness import HOLD, MISSION, NAN, OFFBOARD, Aim, Companion, Heard, Key, Seen, local
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.world import VehicleKind

GROUND_STATION, COMPANION = 6, 18
PREARM = 0x10000000
REAL_TIME_FACTOR = 0.985
"""Of the measurements: rates of the document are per second of wall time."""
LISTEN_S = 20.0
CLIMB: Final = local((0.0, 0.0, -10.0), yaw=0.0)


# --- beginnings -----------------------------------------------------------------------------------


@functools.cache
def _ground(drag: float) -> Companion:
    return Companion().booted(SIH_KDV=drag, COM_OBL_RC_ACT=5)


def ground(drag: float = 0.25) -> Companion:
    """Booted and armable; each call gives a fresh one."""
    return refreshed(_ground(drag))


@functools.cache
def _hover(height_m: float, drag: float) -> Companion:
    return ground(drag).flying(height_m)


def hover(height_m: float = 15.0, drag: float = 0.25) -> Companion:
    """In OFFBOARD above the origin."""
    return refreshed(_hover(height_m, drag))


def refreshed(flight: Companion) -> Companion:
    flight = flight.copy()
    flight.run(1.0)
    return flight


def north(speed_m_s: float, down_m_s: float = 0.0) -> Aim:
    return lambda _: local(velocity=(speed_m_s, 0.0, down_m_s), yaw=0.0)


@functools.cache
def _cruise(speed_m_s: float) -> Companion:
    flight = hover()
    flight.aim = north(speed_m_s)
    flight.run(7.0)
    return flight


def cruise(speed_m_s: float = 5.0, loss_action: int = 5) -> Companion:
    """Flying north with a stream of velocities."""
    flight = refreshed(_cruise(speed_m_s))
    flight.set_parameter("COM_OBL_RC_ACT", loss_action)
    return flight


# --- 2: links -------------------------------------------------------------------------------------


@functools.cache
def listening() -> Companion:
    """On the ground in Hold for 20 s, with all the default rates."""
    vehicle = Companion()
    vehicle.run(10.0)
    vehicle.heard.clear()
    vehicle.run(LISTEN_S)
    return vehicle


def rates(kinds: Iterable[str]) -> dict[str, float]:
    return {kind: len(listening().of(kind)) / LISTEN_S * REAL_TIME_FACTOR for kind in kinds}


@functools.cache
def default_streams() -> Seen:
    """What came of the default streams in 10 s of OFFBOARD."""
    vehicle = Companion()
    vehicle.aim = lambda _: CLIMB
    vehicle.run(8.0)
    vehicle.set_mode(OFFBOARD)
    vehicle.command(400, 1)
    vehicle.run(8.0)
    vehicle.heard.clear()
    vehicle.run(10.0)
    kinds = {heard.kind for heard in vehicle.heard}
    return {"echoes": "POSITION_TARGET_LOCAL_NED" in kinds, "wind": "WIND_COV" in kinds}


def rate_after(kind: str, number: int, *intervals_us: float) -> float:
    """Rate of the message after these intervals were set, one after the other."""
    vehicle = ground()
    for interval_us in intervals_us:
        vehicle.command(511, number, interval_us)
    vehicle.run(0.1)
    since_s = vehicle.now_s
    vehicle.run(10.0)
    return len(vehicle.of(kind, since_s)) / 10.0


def mode_is_told_after() -> float:
    """CURRENT_MODE after a command, with an interval of 50 ms asked for."""
    vehicle = ground()
    since_s = vehicle.now_s
    vehicle.set_mode(MISSION)
    vehicle.run(0.3)
    return min(t for t, mode in vehicle.modes(since_s) if mode == MISSION) - since_s


def origins() -> tuple[int, int]:
    """GPS_GLOBAL_ORIGIN to one who came later: unasked in 20 s, and when asked for."""
    unasked = len(listening().of("GPS_GLOBAL_ORIGIN"))
    vehicle = ground()
    vehicle.command(512, 49)
    return unasked, len(vehicle.of("GPS_GLOBAL_ORIGIN"))


def texts(*heartbeats: int) -> bool:
    """Whether arming brings STATUSTEXTs to one with these heartbeats."""
    vehicle = ground()
    vehicle.heartbeats = heartbeats
    vehicle.run(1.5)
    since_s = vehicle.now_s
    vehicle.command(400, 1)
    vehicle.run(1.0)
    return bool(vehicle.texts(since_s))


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


def signing() -> tuple[bool, bool, bool]:
    """Armed by a signed frame; disarmed by an unsigned one in spite of a key; ever signed."""
    vehicle = ground()
    key = Key(secret=bytes([7]) * 32, link=3, timestamp=400_000_000_000)
    arm, disarm = (
        mavlink.MAVLink_command_long_message(1, 1, 400, 0, wanted, 0, 0, 0, 0, 0, 0)
        for wanted in (1, 0)
    )
    vehicle.send(arm, key=key)
    vehicle.run(1.5)
    armed = not disarmed(vehicle)
    vehicle.send(mavlink.MAVLink_setup_signing_message(1, 1, key.secret, key.timestamp + 1))
    vehicle.run(0.1)
    vehicle.send(disarm)
    vehicle.run(1.5)
    ever = any(heard.frame[2] & 1 for heard in vehicle.heard)
    return armed, disarmed(vehicle), ever


def leaves_it_cold(message: Any) -> bool:
    """Whether an OFFBOARD flight goes on just as without this message, and nobody answers."""
    flights = [cruise(), cruise()]
    flights[1].send(message)
    for flight in flights:
        flight.run(2.0)
    told = [[heard.kind for heard in flight.heard] for flight in flights]
    return flights[0].position == flights[1].position and told[0] == told[1]


OBSTACLES: Final = mavlink.MAVLink_obstacle_distance_message(0, 0, [100] * 72, 5, 20, 3000)
ROUTE: Final = mavlink.MAVLink_trajectory_representation_waypoints_message(
    0, 1, *([[0.0] * 5] * 11), [0] * 5
)


# --- 3: start, arming, modes ----------------------------------------------------------------------


@functools.cache
def _untouched(kind: VehicleKind) -> Companion:
    vehicle = Companion(kind)
    vehicle.run(2.0)
    return vehicle


def defaults(names: Iterable[str], kind: VehicleKind = "copter") -> dict[str, float | None]:
    """Of parameters, in a vehicle of which nothing was changed."""
    return {name: _untouched(kind).parameter(name) for name in names}


def disarmed_mode(custom: int) -> tuple[int, int, bool]:
    """Mode, status and whether SYS_STATUS says that it can be armed, without a stream."""
    vehicle = ground()
    vehicle.set_mode(custom)
    vehicle.run(4.0)
    beat, health = vehicle.last("HEARTBEAT"), vehicle.last("SYS_STATUS")
    return (
        beat.custom_mode,
        beat.system_status,
        bool(health.onboard_control_sensors_health & PREARM),
    )


def without_stream() -> Companion:
    """In the air in Hold, without a stream for three seconds."""
    flight = hover()
    flight.aim = None
    flight.set_mode(HOLD)
    flight.run(3.0)
    return flight


def enters_offboard_within(wait_s: float) -> bool:
    """In flight, the order straight after a setpoint, repeated for so long."""
    flight = without_stream()
    flight.aim, flight.rate_hz = lambda _: local((0.0, 0.0, -10.0)), 2.0
    start_s = flight.now_s
    while flight.mode != OFFBOARD and flight.now_s - start_s < wait_s:
        flight.set_mode(OFFBOARD)
        flight.run(0.05)
    return flight.mode == OFFBOARD


@functools.cache
def climb(by_velocity: bool = False) -> Seen:
    """A take-off in OFFBOARD, times after arming.

    Lift_off_s: as EXTENDED_SYS_STATE says; fastest_m_s: in the mean of a second (30 positions).
    """
    flight = ground()
    flight.aim = (lambda _: local(velocity=(0, 0, -1.0))) if by_velocity else (lambda _: CLIMB)
    flight.run(0.5)
    flight.set_mode(OFFBOARD)
    start_s = flight.now_s
    flight.command(400, 1)
    flight.run(16.0)
    track = [(h.at_s - start_s, -h.message.z, -h.message.vz) for h in positions(flight, start_s)]
    states, up = flight.times("EXTENDED_SYS_STATE", start_s), [up for *_, up in track]
    return {
        "lift_off_s": min(h.at_s for h in states if h.message.landed_state != 1) - start_s,
        "to_9_5_m_s": min((t for t, height, _ in track if height > 9.5), default=NAN),
        "fastest_m_s": max(sum(up[k : k + 30]) / 30.0 for k in range(len(up) - 30)),
        "highest_m": max(height for _, height, _ in track),
    }


def positions(flight: Companion, since_s: float = 0.0) -> list[Heard]:
    return flight.times("LOCAL_POSITION_NED", since_s)


@functools.cache
def commanded_takeoff() -> Seen:
    """NAV_TAKEOFF without a place: from arming to Hold."""
    flight = ground()
    flight.command(22, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    since_s = flight.now_s
    flight.command(400, 1)
    hold_s = flight.until(lambda: flight.mode == HOLD, 20.0)
    flight.run(5.0)
    return {
        "modes": [mode for _, mode in flight.modes(since_s)],
        "hold_s": hold_s,
        "height_m": -flight.position[2],
    }


def disarmed(flight: Companion) -> bool:
    return not flight.last("HEARTBEAT").base_mode & 128


def disarms_unflown_after() -> float:
    vehicle = ground()
    vehicle.command(400, 1)
    vehicle.run(1.5)
    assert not disarmed(vehicle)
    return 1.5 + vehicle.until(lambda: disarmed(vehicle), 20.0)


@functools.cache
def landing() -> Seen:
    """NAV_LAND with the stream going on.

    Disarms_after_s: from ON_GROUND.
    """
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
    return {
        "result": result,
        "mode": mode,
        "disarms_after_s": disarmed_s - on_ground_s,
        "mode_after": mode_after,
        "height_after_arming_m": -flight.position[2],
    }


def speed_after_change() -> tuple[int | None, float]:
    flight = cruise(6.0)
    result = flight.command(178, 1, 2, -1)
    flight.run(4.0)
    return result, flight.speed
