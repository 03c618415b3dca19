"""Flies an ArduCopter as ardupilot.md section 3 did with the real one, and measures it alike.

Routes with a sinusoidal heading, streams that stop, targets that jump: the rows of the document
with its figures, and how to fly them.
"""

import copy
import functools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from harness import STEP_S, Rig

from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.dynamics.copter import Copter, Limits
from vehicle_sim.geodesy import metres_per_degree
from vehicle_sim.plans import Plans
from vehicle_sim.sensors.gps import Fix

HOME_DEG, GROUND_M = (47.0, 8.0), 500.0
LIMITS = Limits(
    speed_m_s=60.0,
    acceleration_m_s2=30.0,
    speed_vertical_m_s=10.0,
    acceleration_vertical_m_s2=8.0,
)
DRAG_1_S, DRAG_1_M = 0.340, 0.0193
"""Of the recorded airframe: 10.05 m/s at 28.7 degrees of tilt, 15.4 m/s at 45."""
PERIOD_S = 12.0
"""Of the weaving heading, which the document does not tell: this one agrees with it best."""
MASKS = {"position": 0xDF8, "pos+vel": 0xDC0, "pos+vel+acc": 0xC00, "velocity": 0xDC7}
MASKS |= {"GLOBAL pos+vel": 0xDC0, "GLOBAL +acc": 0xC00}
GUIDED = 4


def fix_of(copter: Copter, now_us: int) -> Fix:
    """A receiver without noise, 0.1 s late, as ArduPilot's estimator expects it."""
    if now_us < 10_000_000:
        return Fix(time_us=now_us, fix_type=0)
    metres_north, metres_east = metres_per_degree(copter.latitude_deg)
    late_s = 0.1
    north_m_s = copter.velocity_north_m_s - 0.5 * late_s * copter.acceleration_north_m_s2
    east_m_s = copter.velocity_east_m_s - 0.5 * late_s * copter.acceleration_east_m_s2
    return Fix(
        time_us=now_us,
        fix_type=6,
        latitude_deg=copter.latitude_deg - late_s * north_m_s / metres_north,
        longitude_deg=copter.longitude_deg - late_s * east_m_s / metres_east,
        altitude_amsl_m=copter.altitude_amsl_m,
        velocity_north_m_s=copter.velocity_north_m_s,
        velocity_east_m_s=copter.velocity_east_m_s,
        velocity_up_m_s=copter.velocity_up_m_s,
        satellites=10,
    )


class Flown(Rig):
    """An ArduCopter over level ground, told what to do by values."""

    def __init__(
        self,
        ground_amsl_m: float = GROUND_M,
        limits: Limits = LIMITS,
        *,
        drag: bool = True,
        **parameters: float,
    ) -> None:
        self.copter = Copter(
            latitude_deg=HOME_DEG[0],
            longitude_deg=HOME_DEG[1],
            altitude_amsl_m=ground_amsl_m,
            limits=limits,
            drag_1_s=DRAG_1_S * drag,
            drag_1_m=DRAG_1_M * drag,
        )
        rng = np.random.default_rng(1)
        personality = PERSONALITIES["ardupilot" if drag else "ideal", "copter"]
        autopilot = personality.boot(self.copter, parameters, Plans(), rng)
        super().__init__(autopilot, ground_amsl_m)
        self.wind_m_s = (0.0, 0.0)

    def receive(self) -> Fix:
        """Five fixes a second."""
        return fix_of(self.copter, self.now_us) if self.now_us % 200_000 == 0 else self.fix

    def step(self) -> None:
        self.copter.wind_north_m_s, self.copter.wind_east_m_s = self.wind_m_s
        super().step()

    def setpoint(
        self,
        ned_m: tuple[float, float, float],
        velocity_ned_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0),
        acceleration_ned_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        kind: str,
    ) -> None:
        """In LOCAL_NED, or as GLOBAL_INT above home."""
        position, frame, is_global = ned_m, 1, kind.startswith("GLOBAL")
        if is_global:
            there = self.autopilot.frame.place(*ned_m)
            position, frame = (there.latitude_deg, there.longitude_deg, -ned_m[2]), 6
        self.give(
            position,
            velocity_ned_m_s,
            acceleration_ned_m_s2,
            mask=MASKS[kind],
            frame=frame,
            is_global=is_global,
        )

    def local_m(self) -> tuple[float, float, float]:
        """North, east, up of the start: on the autopilot's flat earth, as setpoints are."""
        north, east, down = self.autopilot.local_ned_m() or (0.0, 0.0, 0.0)
        return north, east, -down

    def airborne(self, height_m: float = 30.0) -> "Flown":
        """Take off in GUIDED and hover."""
        self.run(42.5)
        assert [self.command(176, 1, GUIDED), self.command(400, 1)] == [0, 0]
        assert self.command(22, 0, 0, 0, 0, 0, 0, height_m) == 0
        self.run_until(lambda: self.autopilot.status().landed_state == 2, within_s=1000.0)
        self.run(3.0)
        return self


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """Where the route is at one time: north, east, down."""

    position: tuple[float, float, float]
    velocity: tuple[float, float, float]
    acceleration: tuple[float, float, float]


def weave(
    speed_m_s: float,
    lateral_m_s2: float,
    seconds: float,
    *,
    climb_m_s: float = 1.0,
    period_s: float = PERIOD_S,
) -> Iterator[Reference]:
    """A sinusoidal heading of this lateral acceleration, speed ramped up smoothly at 1 m/s2."""
    ramp_s = 1.5 * speed_m_s
    w, climb_w = math.tau / period_s, math.tau / 40.0
    swing_rad = lateral_m_s2 / (speed_m_s * w)
    north = east = 0.0
    for k in range(round(seconds / STEP_S)):
        t = k * STEP_S
        ramp = min(t / ramp_s, 1.0)
        smooth = ramp * ramp * (3.0 - 2.0 * ramp)
        v, dv = speed_m_s * smooth, speed_m_s * 6.0 * ramp * (1.0 - ramp) / ramp_s
        course = swing_rad * smooth * math.sin(w * t)
        turn = swing_rad * smooth * w * math.cos(w * t)
        turn += swing_rad * 6.0 * ramp * (1.0 - ramp) / ramp_s * math.sin(w * t)
        cosine, sine = math.cos(course), math.sin(course)
        climb = climb_m_s * smooth * math.sin(climb_w * t)
        height = 30.0 + climb_m_s / climb_w * smooth * (1.0 - math.cos(climb_w * t))
        yield Reference(
            position=(north, east, -height),
            velocity=(v * cosine, v * sine, -climb),
            acceleration=(
                dv * cosine - v * turn * sine,
                dv * sine + v * turn * cosine,
                -climb_m_s * smooth * climb_w * math.cos(climb_w * t),
            ),
        )
        north += v * cosine * STEP_S
        east += v * sine * STEP_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracked:
    """How a route was followed: means, but for the two that are off the path."""

    along_m: float
    """Negative: behind."""
    off_rms_m: float
    off_max_m: float
    speed_m_s: float
    nose_deg: float
    """Between the nose and the course of the route."""


def follow(
    it: Flown,
    route: Iterable[Reference],
    *,
    kind: str,
    rate_hz: float,
    late_s: float = 0.0,
    measured_from_s: float = 40.0,
) -> Tracked:
    """Stream a route and measure along and off it, as the document does."""
    every, late = round(1.0 / (rate_hz * STEP_S)), round(late_s / STEP_S)
    path: list[Reference] = []
    flown: list[tuple[float, ...]] = []
    for k, at in enumerate(route):
        path.append(at)
        if k % every == 0:
            sent = path[max(k - late, 0)]
            it.setpoint(sent.position, sent.velocity, sent.acceleration, kind=kind)
        it.step()
        if k * STEP_S >= measured_from_s and k % 10 == 0:
            north, east, _ = it.local_m()
            v_n, v_e, _ = at.velocity
            speed = math.hypot(v_n, v_e)
            ahead = (north - at.position[0]) * v_n + (east - at.position[1]) * v_e
            nose = math.remainder(it.copter.heading_rad - math.atan2(v_e, v_n), math.tau)
            # the step has been flown by now
            flown.append((north, east, ahead / speed - speed * STEP_S, it.speed_m_s, abs(nose)))
    points = np.array([at.position[:2] for at in path])
    off = [float(np.hypot(points[:, 0] - n, points[:, 1] - e).min()) for n, e, *_ in flown]
    _, _, along, speeds, noses = np.array(flown).T
    return Tracked(
        along_m=float(along.mean()),
        off_rms_m=float(np.sqrt(np.mean(np.square(off)))),
        off_max_m=max(off),
        speed_m_s=float(speeds.mean()),
        nose_deg=math.degrees(float(noses.mean())),
    )


class Row(NamedTuple):
    """One row of the document's table, with its figures."""

    speed_m_s: float
    lateral_m_s2: float
    lean_deg: float
    kind: str
    rate_hz: float
    along_m: float
    off_rms_m: float
    off_max_m: float


ROWS = (
    Row(5, 1.0, 30, "position", 10, -10.3, 0.52, 0.8),
    Row(5, 1.0, 30, "pos+vel", 4, -0.2, 0.64, 0.9),
    Row(5, 1.0, 30, "pos+vel", 10, -0.1, 0.56, 0.8),
    Row(5, 1.0, 30, "pos+vel+acc", 10, -0.1, 0.17, 0.3),
    Row(8, 1.2, 45, "position", 10, -23.9, 1.3, 2.1),
    Row(8, 1.2, 45, "pos+vel", 10, -0.2, 0.75, 1.1),
    Row(8, 1.2, 45, "pos+vel+acc", 10, -0.1, 0.25, 0.4),
    Row(10, 1.5, 45, "position", 4, -36.0, 2.2, 3.6),
    Row(10, 1.5, 45, "position", 10, -35.0, 2.2, 3.6),
    Row(10, 1.5, 45, "pos+vel", 4, -0.3, 1.1, 1.6),
    Row(10, 1.5, 45, "pos+vel", 10, -0.3, 0.96, 1.4),
    Row(10, 1.5, 45, "pos+vel+acc", 20, -0.2, 0.35, 0.55),
    Row(10, 1.5, 45, "pos+vel+acc", 4, -0.2, 0.35, 0.55),
    Row(10, 1.5, 45, "pos+vel+acc", 2, -0.2, 0.35, 0.55),
    Row(10, 1.5, 45, "pos+vel+acc", 1, -0.1, 0.51, 1.1),
    Row(10, 1.5, 45, "velocity", 10, -6.8, 0.23, 0.36),
    Row(10, 1.5, 45, "GLOBAL pos+vel", 10, -0.3, 0.96, 1.4),
    Row(10, 1.5, 45, "GLOBAL +acc", 10, -0.3, 0.96, 1.4),
    Row(10, 2.4, 45, "pos+vel+acc", 10, -0.3, 0.53, 0.86),
    Row(10, 3.5, 45, "pos+vel+acc", 10, -0.5, 0.72, 1.1),
    Row(15, 1.8, 60, "position", 10, -69.0, 3.5, 5.9),
    Row(15, 1.8, 60, "pos+vel+acc", 10, -0.3, 0.51, 0.8),
    Row(10, 1.5, 30, "pos+vel", 10, -4.6, 4.4, 7.8),
    Row(10, 1.5, 30, "pos+vel+acc", 10, -0.7, 4.7, 11.5),
)


@functools.cache
def _airborne(lean_deg: float, timeout_s: float, height_m: float, wpnav_m_s: float) -> Flown:
    parameters = {"ANGLE_MAX": lean_deg * 100.0, "GUID_TIMEOUT": timeout_s}
    return Flown(**parameters, WPNAV_SPEED=wpnav_m_s * 100.0).airborne(height_m)


def airborne(
    *,
    lean_deg: float = 45.0,
    timeout_s: float = 3.0,
    height_m: float = 30.0,
    wpnav_m_s: float = 10.0,
) -> Flown:
    """A copy of one that hovers in GUIDED."""
    return copy.deepcopy(_airborne(lean_deg, timeout_s, height_m, wpnav_m_s))


def fly(
    row: Row, *, seconds: float = 90.0, late_s: float = 0.0, wind_east_m_s: float = 0.0
) -> Tracked:
    """Fly one row of the table; late_s: how old its setpoints are when they are sent."""
    it = airborne(lean_deg=row.lean_deg, wpnav_m_s=max(row.speed_m_s, 10.0))
    it.wind_m_s = (0.0, wind_east_m_s)
    it.run(15.0 if wind_east_m_s else 0.0)
    route = weave(row.speed_m_s, row.lateral_m_s2, seconds)
    return follow(it, route, kind=row.kind, rate_hz=row.rate_hz, late_s=late_s)


class Stop(NamedTuple):
    """A stream at 10 m/s that ends: seconds and metres from its last setpoint."""

    kind: str
    timeout_s: float
    brakes_s: float | None
    still_s: float
    furthest_m: float
    ends_m: float


STOPS = (
    Stop("position", 3.0, None, 6.4, 0.8, 0.0),
    Stop("pos+vel", 3.0, 3.7, 7.1, 53.7, 30.0),
    Stop("pos+vel+acc", 3.0, 3.7, 7.1, 53.7, 30.0),
    Stop("velocity", 3.0, 3.7, 7.1, 47.9, 46.9),
    Stop("pos+vel", 1.0, 1.7, 5.0, 33.6, 10.0),
    Stop("velocity", 1.0, 1.7, 5.1, 27.9, 26.9),
    Stop("pos+vel", 0.3, 1.0, 4.3, 26.8, 3.0),
    Stop("velocity", 0.3, 1.0, 4.4, 20.8, 19.9),
)


def end_stream(row: Stop) -> Stop:
    """Fly straight at 10 m/s, end the stream, and measure."""
    it = airborne(timeout_s=row.timeout_s)
    north_m = begun_m = 0.0
    last_us = 0
    for k in range(3500):
        ramp = min(k * STEP_S / 15.0, 1.0)
        v = 10.0 * ramp * ramp * (3.0 - 2.0 * ramp)
        if k % 10 == 0:
            begun_m, last_us = north_m, it.now_us
            it.setpoint((north_m, 0.0, -30.0), (v, 0.0, 0.0), kind=row.kind)
        north_m += v * STEP_S
        it.step()
    brakes_us = still_us = 0
    furthest_m = -1e9
    while it.now_us - last_us < 30e6:
        it.step()
        speed = it.copter.velocity_north_m_s
        furthest_m = max(furthest_m, it.local_m()[0] - begun_m)
        if not brakes_us and speed < 9.5:
            brakes_us = it.now_us
        if not still_us and speed < 0.1:
            still_us = it.now_us
    return row._replace(
        brakes_s=(brakes_us - last_us) * 1e-6,
        still_s=(still_us - last_us) * 1e-6,
        furthest_m=furthest_m,
        ends_m=it.local_m()[0] - begun_m,
    )


class Jump(NamedTuple):
    """A jump of the target at 6 m/s, or from hover."""

    what: str
    kind: str
    ned_m: tuple[float, float, float]
    speed_m_s: float
    peak_m_s: float
    """Of the speed: horizontal, or vertical for a vertical jump."""
    within_s: float
    """Until it is within 1 m for good."""
    overshoot_m: float | None = None
    tilt_deg: float | None = None
    lateral_m_s: float | None = None
    """Peak of the speed across."""


JUMPS = (
    Jump("5 m sideways", "pos+vel+acc", (0.0, 5.0, 0.0), 6.0, 6.5, 2.6, 0.3, 24.0, 2.5),
    Jump("20 m sideways", "pos+vel+acc", (0.0, 20.0, 0.0), 6.0, 8.1, 5.6, 0.6, 30.0, 5.4),
    Jump("20 m sideways, position", "position", (0.0, 20.0, 0.0), 6.0, 7.1, 7.8, 0.0, 26.0, 4.8),
    Jump("60 m sideways", "pos+vel+acc", (0.0, 60.0, 0.0), 6.0, 11.4, 10.2, 0.9, 40.0, 9.6),
    Jump("200 m ahead, position", "position", (200.0, 0.0, 0.0), 0.0, 10.4, 27.0, 0.8),
    Jump("200 m ahead, pos+vel(0)", "pos+vel", (200.0, 0.0, 0.0), 0.0, 10.3, 24.0, 0.8),
    Jump("20 m up", "pos+vel+acc", (0.0, 0.0, -20.0), 0.0, 2.5, 10.0),
    Jump("20 m down", "pos+vel+acc", (0.0, 0.0, 20.0), 0.0, 1.5, 14.0),
)


def jump(row: Jump) -> Jump:
    """Fly on, move the target, and measure along the jump."""
    it = airborne(height_m=60.0)
    axis = max(range(3), key=lambda k: abs(row.ned_m[k]))
    sign = math.copysign(1.0, row.ned_m[axis])
    north_m, jumped_us, left_us = 0.0, 0, 0
    peak = over_m = tilt_deg = lateral = 0.0
    for k in range(6500):
        t = k * STEP_S
        v = min(t, row.speed_m_s)
        jumped = t >= 30.0
        if jumped and not jumped_us:
            jumped_us = left_us = it.now_us
        shift = row.ned_m if jumped else (0.0, 0.0, 0.0)
        target = (north_m + shift[0], shift[1], -60.0 + shift[2])
        if k % 10 == 0:
            it.setpoint(target, (v, 0.0, 0.0), kind=row.kind)
        it.step()
        north_m += v * STEP_S
        if not jumped:
            continue
        is_north, is_east, is_up = it.local_m()
        away = (target[0] - is_north, target[1] - is_east, target[2] + is_up)
        over_m = max(over_m, -sign * away[axis])
        # a stream of positions alone is trailed: then only the way across counts
        if (abs(away[axis]) if row.kind == "position" else math.hypot(*away)) > 1.0:
            left_us = it.now_us
        copter = it.copter
        level = math.hypot(copter.velocity_north_m_s, copter.velocity_east_m_s)
        peak = max(peak, abs(copter.velocity_up_m_s) if row.ned_m[2] else level)
        lateral = max(lateral, abs(copter.velocity_east_m_s))
        lean_rad = math.acos(math.cos(copter.roll_rad) * math.cos(copter.pitch_rad))
        tilt_deg = max(tilt_deg, math.degrees(lean_rad))
    return row._replace(
        peak_m_s=peak,
        within_s=(left_us - jumped_us) * 1e-6,
        overshoot_m=over_m,
        tilt_deg=tilt_deg,
        lateral_m_s=lateral,
    )
