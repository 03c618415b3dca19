"""Experiments with a simulated PX4 in OFFBOARD: setpoints, and their end (px4.md 4, 6)."""

import functools
import math
from typing import Any, Literal

from harness import HOLD, NAN, OFFBOARD, Companion, Seen, Vector, local
from px4_flights import GROUND_STATION, cruise, disarmed, ground, hover, north, positions, refreshed

# --- 4: masks, frames, steps ----------------------------------------------------------------------


def velocity_after(setpoint: Any) -> Vector | None:
    """North, east and up, 4 s after 5 m/s to the north; None: it has left OFFBOARD."""
    flight = cruise()
    flight.aim = lambda _: setpoint
    flight.run(4.0)
    x, y, z = flight.velocity
    return (x, y, -z) if flight.mode == OFFBOARD else None


def ends_up(setpoint: Any) -> Vector | None:
    """North, east and up of the origin, 15 s later; None: it has left OFFBOARD."""
    flight = hover()
    flight.aim = lambda _: setpoint
    flight.run(15.0)
    x, y, z = flight.position
    return (x, y, -z) if flight.mode == OFFBOARD else None


def heading_after(setpoint: Any) -> float:
    """Degrees, 6 s later; it looked to the north before."""
    flight = hover()
    flight.aim = lambda _: setpoint
    flight.run(6.0)
    return math.degrees(flight.last("ATTITUDE").yaw)


def turned_body_velocity() -> tuple[float, float]:
    """North and east velocity of 3 m/s ahead, with the nose to the east."""
    flight = hover()
    flight.aim = lambda _: local((0.0, 0.0, -15.0), yaw=math.pi / 2)
    flight.run(6.0)
    flight.aim = lambda _: local(velocity=(3.0, 0.0, 0.0), frame=8)
    flight.run(4.0)
    return flight.velocity[:2]


def _stop(flight: Companion, seconds: float = 14.0) -> Seen:
    """From full speed.

    Seconds: until slower than 0.3 m/s; again_m_s: fastest after that.
    """
    start_s, start_m = flight.now_s, flight.position[0]
    flight.run(seconds)
    track = [
        (h.at_s - start_s, h.message.x - start_m, h.message) for h in positions(flight, start_s)
    ]
    speeds = [(t, math.hypot(m.vx, m.vy)) for t, _, m in track]
    seconds = min((t for t, speed in speeds if speed < 0.3), default=NAN)
    again_m_s = max((speed for t, speed in speeds if t > seconds), default=NAN)
    return {
        "metres": track[-1][1],
        "seconds": seconds,
        "again_m_s": again_m_s,
        "farthest_m": max(along for _, along, _ in track),
    }


@functools.cache
def stop(how: Literal["position", "velocity", "hold"]) -> Seen:
    """12 m/s to the north, and then this. From full speed.

    Seconds: until slower than 0.3 m/s; again_m_s: fastest after that.
    """
    flight = hover()
    flight.aim = north(12.0)
    flight.run(9.0)
    assert flight.speed > 11.5
    here = flight.position
    if how == "hold":
        flight.set_mode(HOLD)
    elif how == "position":
        flight.aim = lambda _: local((here[0], here[1], -15.0), yaw=0.0)
    else:
        flight.aim = north(0.0)
    return _stop(flight)


@functools.cache
def frozen() -> float:
    """Metres in all, after a stream of position and velocity at 10 m/s has stopped."""
    flight = hover()
    began_s = flight.now_s
    flight.aim = lambda t: local((10.0 * (t - began_s), 0.0, -15.0), (10.0, 0.0, 0.0), yaw=0.0)
    flight.run(12.0)
    flight.aim = None
    return _stop(flight)["metres"]


@functools.cache
def jump(metres: float, seconds: float) -> Seen:
    """A position setpoint far away, with the stock drag."""
    flight = hover(drag=1.0)
    flight.command(511, 30, 20_000)
    start_s, start_m = flight.now_s, flight.position[0]
    flight.aim = lambda _: local((start_m + metres, 0.0, -15.0), yaw=0.0)
    flight.run(seconds)
    track = [
        (h.at_s - start_s, h.message.x - start_m, h.message) for h in positions(flight, start_s)
    ]
    tilts = (
        math.acos(math.cos(m.roll) * math.cos(m.pitch)) for m in flight.of("ATTITUDE", start_s)
    )
    return {
        "tilt_deg": math.degrees(max(tilts)),
        "fastest_m_s": max(math.hypot(m.vx, m.vy) for *_, m in track),
        "at_last_m_s": sum(math.hypot(m.vx, m.vy) for *_, m in track[-60:]) / 60.0,
        "to_29_m_s": min((t for t, along_m, _ in track if along_m > 29.0), default=NAN),
        "farthest_m": max(along_m for _, along_m, _ in track),
        "offboard": flight.mode == OFFBOARD,
    }


@functools.cache
def reached(north_m_s: float, down_m_s: float) -> tuple[float, float]:
    """Speeds north and down that asking for these ends in."""
    flight = hover(30.0)
    flight.aim = north(north_m_s, down_m_s)
    flight.run(6.0)
    since_s = flight.now_s
    flight.run(2.0)
    track = [h.message for h in positions(flight, since_s)]
    return sum(m.vx for m in track) / len(track), sum(m.vz for m in track) / len(track)


# --- 6: loss of the stream ------------------------------------------------------------------------


@functools.cache
def loss(action: int) -> Seen:
    """The stream stops at 5 m/s, and comes back 8 s later; times after the last setpoint.

    Sinks_m_s: between 2 and 5 s after the new mode; metres: flown to the north, from the new mode
    on; speed_m_s: at the end; back_s: to OFFBOARD, when the stream is back.
    """
    flight = cruise(loss_action=action)
    flight.heartbeats = (GROUND_STATION,)
    flight.run(1.5)
    flight.aim = None
    last_s = flight.aimed_s
    flight.until(lambda: flight.mode != OFFBOARD, 3.0)
    new_s, new_m, mode = flight.now_s, flight.position[0], flight.mode
    current = flight.last("CURRENT_MODE")
    flight.run(8.0)
    beats = [h for h in flight.times("HEARTBEAT", last_s) if h.message.custom_mode == mode]
    heights = {round((h.at_s - new_s) * 10): -h.message.z for h in positions(flight, new_s)}
    metres, speed_m_s, status = flight.position[0] - new_m, flight.speed, flight.status
    flight.aim = north(5.0)
    return {
        "mode": mode,
        "mode_s": new_s - last_s,
        "intended": current.intended_custom_mode,
        "heartbeat_s": beats[0].at_s - last_s,
        "status": status,
        "sinks_m_s": (heights[20] - heights[50]) / 3.0,
        "climbs_to_m": max(heights.values()),
        "metres": metres,
        "speed_m_s": speed_m_s,
        "back_s": flight.until(lambda: flight.mode == OFFBOARD, 2.0),
    }


def sinks_low() -> float:
    """m/s between 4.5 and 2 m above the ground, after a loss with COM_OBL_RC_ACT 4."""
    flight = cruise(loss_action=4)
    flight.aim = None
    flight.run(20.0)
    low = [h for h in positions(flight) if 2.0 < -h.message.z < 4.5]
    sunk_m: float = low[-1].message.z - low[0].message.z
    return sunk_m / (low[-1].at_s - low[0].at_s)


@functools.cache
def returned() -> tuple[float, float]:
    """How far from home a lost stream at 60 m brings it with COM_OBL_RC_ACT 3, and how high."""
    flight = cruise(loss_action=3)
    flight.run(4.0)
    flight.aim = None
    flight.run(40.0)
    return math.hypot(*flight.position[:2]), max(-h.message.z for h in positions(flight))


def modes_with_gap(gap_s: float) -> set[int]:
    flight = cruise()
    aim, flight.aim = flight.aim, None
    since_s = flight.aimed_s
    flight.run(gap_s - (flight.now_s - since_s))
    flight.aim = aim
    flight.run(1.0)
    return {mode for _, mode in flight.modes(since_s)}


def modes_at_rate(rate_hz: float, seconds: float = 12.0) -> list[int]:
    flight = cruise()
    flight.rate_hz = rate_hz
    flight.run(1.0)
    since_s = flight.now_s
    flight.run(seconds)
    return [mode for _, mode in flight.modes(since_s)]


@functools.cache
def loss_on_the_ground() -> Seen:
    """Armed in OFFBOARD; the stream stops.

    Seconds: to another mode; armed: still, 5 s later.
    """
    flight = ground()
    flight.aim = lambda _: local((0.0, 0.0, 0.0))
    flight.run(0.5)
    flight.set_mode(OFFBOARD)
    flight.command(400, 1)
    flight.run(1.0)
    flight.aim = None
    last_s = flight.aimed_s
    flight.until(lambda: flight.mode != OFFBOARD, 3.0)
    seconds = flight.now_s - last_s
    flight.run(5.0)
    return {
        "seconds": seconds,
        "mode": flight.mode,
        "armed": not disarmed(flight),
    }


def commanded(custom: int) -> int:
    """The mode 6 s after it was commanded, with the stream going on."""
    flight = cruise()
    flight.set_mode(custom)
    flight.run(6.0)
    return flight.mode


# --- 6: with a pilot ------------------------------------------------------------------------------


@functools.cache
def _piloted() -> Companion:
    flight = ground()
    flight.simulation.add_fault("pilot")
    return flight.flying(15.0)


def piloted(**parameters: float) -> Companion:
    """In OFFBOARD north at 5 m/s, with a pilot who keeps the sticks centred."""
    flight = refreshed(_piloted())
    for name, value in parameters.items():
        flight.set_parameter(name, value)
    flight.aim = north(5.0)
    flight.run(8.0)
    return flight


@functools.cache
def loss_with_pilot() -> Seen:
    """The stream stops and comes back, with a pilot."""
    flight = piloted(COM_OBL_RC_ACT=0)
    flight.aim = None
    flight.until(lambda: flight.mode != OFFBOARD, 3.0)
    mode, before = flight.mode, flight.position
    flight.run(8.0)
    after, speed_m_s = flight.position, flight.speed
    flight.aim = north(5.0)
    flight.run(1.0)
    return {
        "mode": mode,
        "metres": after[0] - before[0],
        "speed_m_s": speed_m_s,
        "sunk_m": after[2] - before[2],
        "mode_with_stream": flight.mode,
    }
