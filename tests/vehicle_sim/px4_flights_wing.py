"""Experiments with a simulated PX4 aeroplane (px4.md 10)."""

import functools
import math
from typing import Any, NamedTuple

from px4_flights import disarmed, positions, refreshed
from px4_wire import GROUND_AMSL_M, HOLD, NAN, OFFBOARD, TAKEOFF, Aim, Companion, local

# --- 10: fixed wing -------------------------------------------------------------------------------


@functools.cache
def _plane_ground() -> Companion:
    return Companion("plane").booted(COM_OBL_RC_ACT=5)


class Departure(NamedTuple):
    """NAV_TAKEOFF 300 m ahead and 50 m up, then arming."""

    result: int | None
    to_20_m_s: float
    hold_s: float
    modes: list[int]


@functools.cache
def _departed() -> tuple[Companion, Departure]:
    flight = refreshed(_plane_ground())
    result = flight.command_at(22, (300.0, 0.0, GROUND_AMSL_M + 50.0), 0, 0, NAN, NAN)
    flight.until(lambda: flight.mode == TAKEOFF, 2.0)
    since_s = flight.now_s
    flight.command(400, 1)
    hold_s = flight.until(lambda: flight.mode == HOLD, 60.0) + 0.05
    high = [h.t_s - since_s for h in positions(flight, since_s) if h.message.z < -20.0]
    modes = [mode for _, mode in flight.modes(since_s)]
    return flight, Departure(result, min(high, default=NAN), hold_s, modes)


def departure() -> Departure:
    return _departed()[1]


def endless_takeoff() -> int:
    """The mode 90 s after NAV_TAKEOFF without a place."""
    flight = refreshed(_plane_ground())
    flight.command(22, 0, 0, 0, NAN, NAN, NAN, NAN)
    flight.command(400, 1)
    flight.run(90.0)
    return flight.mode


@functools.cache
def _circling() -> Companion:
    """In Hold, 70 m up, in the circle."""
    flight = refreshed(_departed()[0])
    flight.command_at(192, (300.0, 0.0, GROUND_AMSL_M + 70.0), -1, 1, 0, NAN)
    flight.run(60.0)
    return flight


def _radii(flight: Companion, north_m: float, seconds: float, east_m: float = 0.0) -> list[float]:
    since_s = flight.now_s
    flight.run(seconds)
    return [
        math.hypot(h.message.x - north_m, h.message.y - east_m) for h in positions(flight, since_s)
    ]


@functools.cache
def circle_flown(radius_m: float) -> tuple[float, float]:
    """Least and greatest distance from DO_REPOSITION's place, asked for this radius."""
    flight = refreshed(_circling())
    flight.command_at(192, (300.0, 0.0, GROUND_AMSL_M + 70.0), -1, 1, radius_m, NAN)
    flight.run(40.0)
    radii = _radii(flight, 300.0, 35.0)
    return min(radii), max(radii)


def wing_height() -> float:
    """Metres below the commanded altitude, in the circle."""
    return 70.0 + refreshed(_circling()).position[2]


def _offboard_wing(aim: Aim) -> Companion:
    flight = refreshed(_circling())
    flight.aim, flight.rate_hz = aim, 10.0
    flight.run(0.5)
    flight.set_mode(OFFBOARD)
    return flight


@functools.cache
def wing_at_a_point() -> tuple[int, float, float]:
    """Mode; least and greatest distance from a point that it was sent to, in the last 40 s."""
    flight = _offboard_wing(lambda _: local((600.0, 0.0, -70.0)))
    flight.run(50.0)
    radii = _radii(flight, 600.0, 40.0)
    return flight.mode, min(radii), max(radii)


def wing_climbing_at_a_point() -> tuple[float, float]:
    """Least and greatest distance from a point 200 m higher, after 25 s, 20 m below it or more."""
    flight = _offboard_wing(lambda _: local((300.0, 0.0, -270.0)))
    start_s = flight.now_s
    flight.run(90.0)
    near = [
        math.hypot(h.message.x - 300.0, h.message.y)
        for h in positions(flight, start_s + 25.0)
        if -h.message.z < 250.0
    ]
    return min(near), max(near)


class Line(NamedTuple):
    """Off a line to the north, flown with a nearest point and the tangent."""

    mode: int
    offset_m: float
    speed_m_s: float
    airspeed_m_s: float


@functools.cache
def wing_on_a_line(velocity_m_s: float) -> Line:
    flight = refreshed(_circling())
    flight.rate_hz = 10.0
    flight.command(511, 74, 100_000)
    east_m = flight.position[1]

    def aim(_: float) -> Any:
        ahead_m = flight.position[0] + 20.0
        return local((ahead_m, east_m, -70.0), (velocity_m_s, 0.0, 0.0))

    flight.aim = aim
    flight.run(0.5)
    flight.set_mode(OFFBOARD)
    flight.run(40.0)
    since_s = flight.now_s
    flight.run(10.0)
    track = [h.message for h in positions(flight, since_s)]
    return Line(
        flight.mode,
        max(abs(m.y - east_m) for m in track),
        sum(math.hypot(m.vx, m.vy) for m in track) / len(track),
        flight.last("VFR_HUD").airspeed,
    )


def wing_without_position(setpoint: Any) -> tuple[int, float]:
    """Mode; degrees that it has turned in 15 s (a circle of 80 m would be 160)."""
    flight = _offboard_wing(lambda _: setpoint)
    flight.run(1.0)
    roll = flight.last("ATTITUDE").roll
    flight.run(14.0)
    return flight.mode, math.degrees(abs(flight.last("ATTITUDE").roll - roll))


class WingLoss(NamedTuple):
    """The stream stops."""

    seconds: float
    mode: int
    radius_m: tuple[float, float]
    back_s: float


@functools.cache
def wing_loss() -> WingLoss:
    flight = _offboard_wing(lambda _: local((2000.0, 0.0, -70.0)))
    flight.run(10.0)
    flight.aim = None
    last_s = flight.aimed_s
    flight.until(lambda: flight.mode != OFFBOARD, 3.0)
    seconds, mode = flight.now_s - last_s, flight.mode
    x, y, _ = flight.position
    flight.run(60.0)
    since_s = flight.now_s
    flight.run(45.0)
    track = [h.message for h in positions(flight, since_s)]
    middle = tuple(
        (max(values) + min(values)) / 2.0 for values in ([m.x for m in track], [m.y for m in track])
    )
    radii = [math.hypot(m.x - middle[0], m.y - middle[1]) for m in track]
    flight.aim = lambda _: local((x, y, -70.0))
    back_s = flight.until(lambda: flight.mode == OFFBOARD, 3.0)
    return WingLoss(seconds, mode, (min(radii), max(radii)), back_s)


@functools.cache
def _landing() -> tuple[int | None, float, bool]:
    """Result of NAV_LAND, radians turned on the way down, and whether it disarms by itself."""
    flight = refreshed(_circling())
    result = flight.command(21, 0, 0, 0, NAN)
    turned, before = 0.0, flight.last("ATTITUDE").yaw
    for _ in range(1500):
        flight.run(0.1)
        yaw = flight.last("ATTITUDE").yaw
        turned += math.remainder(yaw - before, math.tau)
        before = yaw
        if disarmed(flight):
            break
    return result, abs(turned), disarmed(flight)


def landed_and_disarmed() -> tuple[int | None, bool]:
    return _landing()[0], _landing()[2]


def turns_while_landing() -> float:
    return _landing()[1] / math.tau


def wind_rate() -> float:
    """WIND_COV in flight."""
    flight = refreshed(_circling())
    flight.command(511, 231, 0)
    since_s = flight.now_s
    flight.run(10.0)
    return len(flight.of("WIND_COV", since_s)) / 10.0


def takeoff_is_told_after() -> float:
    """Seconds from NAV_TAKEOFF to a heartbeat that says so."""
    flight = refreshed(_plane_ground())
    since_s = flight.now_s
    flight.command_at(22, (300.0, 0.0, GROUND_AMSL_M + 50.0), 0, 0, NAN, NAN)
    flight.run(2.0)
    beats = flight.times("HEARTBEAT", since_s)
    return min(h.t_s for h in beats if h.message.custom_mode == TAKEOFF) - since_s
