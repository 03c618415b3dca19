"""How the four autopilots follow setpoints: what the documents measured, and the same flown here.

ardupilot.md 3 (ArduCopter: routes with a sinusoidal heading, streams that stop, targets that jump)
and 7 (ArduPlane), px4.md 5 (multicopter) and 10 (fixed wing): their tables with their figures, and
how it is measured there.  Lengths in metres, angles in radians unless named.
"""

import functools
import math
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from harness import NAN, OFFBOARD, Vector
from rigs import STEP_S, ArduCopter, ArduPlane, Px4Copter, Px4Plane, circling, cruising, hovering

from vehicle_sim.geodesy import FloatArray

SWING_RAD: Final = 2.404825557695773
"""First zero of J0: a route that swings so far to both sides closes."""


class Sine:
    """A route whose heading is a sine of the way along it: a point each so many metres.

    It goes round: where it does not close it is to be longer than the flight.
    """

    def __init__(
        self, swing_rad: float, wave_m: float, length_m: float, step_m: float, begins_rad: float = 0
    ) -> None:
        self.step_m = step_m
        phase = begins_rad + math.tau / wave_m * step_m * np.arange(round(length_m / step_m))
        middle = swing_rad * np.sin(phase + 0.5 * math.tau / wave_m * step_m)
        steps = step_m * np.stack([np.cos(middle), np.sin(middle)], axis=-1)
        self.ne_m: FloatArray = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)[:-1]])
        self.heading_rad = swing_rad * np.sin(phase)
        self.curvature_1_m = swing_rad * math.tau / wave_m * np.cos(phase)

    def ahead(self, index: int, metres: float) -> int:
        """Index of the point so much further on."""
        return (index + round(metres / self.step_m)) % len(self.ne_m)

    def point(self, index: int) -> tuple[float, float]:
        """North and east."""
        north_m, east_m = self.ne_m[index % len(self.ne_m)].tolist()
        return north_m, east_m

    def nearest(self, ne_m: tuple[float, float], near: int) -> tuple[int, float]:
        """Index of the nearest point within 100 m of another, and how far right of it this is."""
        reach = round(100.0 / self.step_m)
        indices = (near + np.arange(-reach, reach + 1)) % len(self.ne_m)
        off = np.array(ne_m) - self.ne_m[indices]
        best = int(np.argmin((off * off).sum(axis=-1)))
        heading = float(self.heading_rad[indices[best]])
        right_m = off[best, 1] * math.cos(heading) - off[best, 0] * math.sin(heading)
        return int(indices[best]), float(right_m)


class Off(NamedTuple):
    """How far off a route a plane flew, and how fast over the ground."""

    rms_m: float
    most_m: float
    speed_m_s: float


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _followed(
    rig: ArduPlane | Px4Plane,
    route: Sine,
    aim: Callable[[int], object],
    *,
    hz: float,
    seconds: float,
    counts: Callable[[float, int], bool],
    begin: int = 0,
    age_steps: int = 0,
) -> Off:
    """Aim from the point nearest to where the vehicle was, so old; measure ten times a second."""
    every, index, known = round(1.0 / hz / STEP_S), begin, begin
    flown = list[tuple[float, float]]()
    for k in range(round(seconds / STEP_S)):
        if k % 10 == 0 or k % every == 0:
            index, right_m = route.nearest(rig.ne_m, index)
            if k % 10 == 0 and counts(k * STEP_S, index):
                flown.append((right_m, rig.speed_m_s))
        known = index if k % every == 0 else known
        if k % every == age_steps % every:
            aim(known)
        rig.step()
    off_m, speed_m_s = np.array(flown).T
    return Off(_rms(off_m), float(np.abs(off_m).max()), float(speed_m_s.mean()))


# --- ArduCopter: ardupilot.md 3 -------------------------------------------------------------------

PERIOD_S = 12.0
"""Of the weaving heading, which the document does not tell: this one agrees with it best."""
Reference = tuple[Vector, Vector, Vector]
"""Where the route is at one time, its velocity and acceleration: north, east, down."""


def aim(it: ArduCopter, kind: str, position: Vector, *derivatives: Vector) -> None:
    """A setpoint of this kind, in LOCAL_NED or as GLOBAL_INT above home."""
    if kind.startswith("GLOBAL"):
        there = it.autopilot.frame.place(*position)
        place = (there.latitude_deg, there.longitude_deg, -position[2])
        it.aim(place, *derivatives[: 2 if "acc" in kind else 1], frame=6, is_global=True)
    elif kind == "velocity":
        it.aim(None, derivatives[0])
    else:
        it.aim(position, *derivatives[: kind.count("+")])


def smooth(ramp: float) -> float:
    """A ramp from 0 to 1 without a corner."""
    ramp = min(ramp, 1.0)
    return ramp * ramp * (3.0 - 2.0 * ramp)


def weave(speed_m_s: float, lateral_m_s2: float, seconds: float) -> Iterator[Reference]:
    """A sinusoidal heading of this lateral acceleration, speed ramped up smoothly at 1 m/s2."""
    ramp_s, climb_m_s = 1.5 * speed_m_s, 1.0
    w, climb_w = math.tau / PERIOD_S, math.tau / 40.0
    swing_rad = lateral_m_s2 / (speed_m_s * w)
    north = east = 0.0
    for k in range(round(seconds / STEP_S)):
        t = k * STEP_S
        ramp = min(t / ramp_s, 1.0)
        share, rising = smooth(ramp), 6.0 * ramp * (1.0 - ramp) / ramp_s
        v, dv = speed_m_s * share, speed_m_s * rising
        course = swing_rad * share * math.sin(w * t)
        turn = swing_rad * (share * w * math.cos(w * t) + rising * math.sin(w * t))
        cosine, sine = math.cos(course), math.sin(course)
        climb = climb_m_s * share * math.sin(climb_w * t)
        height = 30.0 + climb_m_s / climb_w * share * (1.0 - math.cos(climb_w * t))
        yield (
            (north, east, -height),
            (v * cosine, v * sine, -climb),
            (
                dv * cosine - v * turn * sine,
                dv * sine + v * turn * cosine,
                -climb_m_s * share * climb_w * math.cos(climb_w * t),
            ),
        )
        north += v * cosine * STEP_S
        east += v * sine * STEP_S


class Weave(NamedTuple):
    """One row of the document's table, or how it was flown here."""

    speed_m_s: float
    lateral_m_s2: float
    lean_deg: float
    kind: str
    rate_hz: float
    along_m: float
    """Mean; negative: behind."""
    off_rms_m: float
    off_max_m: float
    flown_m_s: float = NAN
    nose_deg: float = NAN
    """Between the nose and the course of the route."""


WEAVES = (
    Weave(5, 1.0, 30, "position", 10, -10.3, 0.52, 0.8),
    Weave(5, 1.0, 30, "pos+vel", 4, -0.2, 0.64, 0.9),
    Weave(5, 1.0, 30, "pos+vel", 10, -0.1, 0.56, 0.8),
    Weave(5, 1.0, 30, "pos+vel+acc", 10, -0.1, 0.17, 0.3),
    Weave(8, 1.2, 45, "position", 10, -23.9, 1.3, 2.1),
    Weave(8, 1.2, 45, "pos+vel", 10, -0.2, 0.75, 1.1),
    Weave(8, 1.2, 45, "pos+vel+acc", 10, -0.1, 0.25, 0.4),
    Weave(10, 1.5, 45, "position", 4, -36.0, 2.2, 3.6),
    Weave(10, 1.5, 45, "position", 10, -35.0, 2.2, 3.6),
    Weave(10, 1.5, 45, "pos+vel", 4, -0.3, 1.1, 1.6),
    Weave(10, 1.5, 45, "pos+vel", 10, -0.3, 0.96, 1.4),
    Weave(10, 1.5, 45, "pos+vel+acc", 20, -0.2, 0.35, 0.55),
    Weave(10, 1.5, 45, "pos+vel+acc", 4, -0.2, 0.35, 0.55),
    Weave(10, 1.5, 45, "pos+vel+acc", 2, -0.2, 0.35, 0.55),
    Weave(10, 1.5, 45, "pos+vel+acc", 1, -0.1, 0.51, 1.1),
    Weave(10, 1.5, 45, "velocity", 10, -6.8, 0.23, 0.36),
    Weave(10, 1.5, 45, "GLOBAL pos+vel", 10, -0.3, 0.96, 1.4),
    Weave(10, 1.5, 45, "GLOBAL +acc", 10, -0.3, 0.96, 1.4),
    Weave(10, 2.4, 45, "pos+vel+acc", 10, -0.3, 0.53, 0.86),
    Weave(10, 3.5, 45, "pos+vel+acc", 10, -0.5, 0.72, 1.1),
    Weave(15, 1.8, 60, "position", 10, -69.0, 3.5, 5.9),
    Weave(15, 1.8, 60, "pos+vel+acc", 10, -0.3, 0.51, 0.8),
    Weave(10, 1.5, 30, "pos+vel", 10, -4.6, 4.4, 7.8),
    Weave(10, 1.5, 30, "pos+vel+acc", 10, -0.7, 4.7, 11.5),
)


def fly_weave(
    row: Weave, *, seconds: float = 90.0, late_s: float = 0.0, wind_east_m_s: float = 0.0
) -> Weave:
    """Stream a route and measure along and off it, as the document does.

    late_s: how old the setpoints are when they are sent.
    """
    speed_cm_s = max(row.speed_m_s, 10.0) * 100.0
    it = hovering(row.lean_deg, WPNAV_SPEED=speed_cm_s, GUID_TIMEOUT=3.0)
    it.wind_m_s = (0.0, wind_east_m_s)
    it.run(15.0 if wind_east_m_s else 0.0)
    every, late = round(1.0 / (row.rate_hz * STEP_S)), round(late_s / STEP_S)
    path, flown = list[Reference](), list[tuple[float, ...]]()
    for k, at in enumerate(weave(row.speed_m_s, row.lateral_m_s2, seconds)):
        path.append(at)
        if k % every == 0:
            aim(it, row.kind, *path[max(k - late, 0)])
        it.step()
        if k * STEP_S >= 40.0 and k % 10 == 0:
            (north, east, _), (there_n, there_e, _), (v_n, v_e, _) = it.ned_m, at[0], at[1]
            speed = math.hypot(v_n, v_e)
            ahead = ((north - there_n) * v_n + (east - there_e) * v_e) / speed
            nose = math.remainder(it.vehicle.heading_rad - math.atan2(v_e, v_n), math.tau)
            # the step has been flown by now
            flown.append((north, east, ahead - speed * STEP_S, it.speed_m_s, abs(nose)))
    points = np.array([at[0][:2] for at in path])
    off = [float(np.hypot(points[:, 0] - n, points[:, 1] - e).min()) for n, e, *_ in flown]
    _, _, along, speeds, noses = np.array(flown).T
    return row._replace(
        along_m=float(along.mean()),
        off_rms_m=_rms(off),
        off_max_m=max(off),
        flown_m_s=float(speeds.mean()),
        nose_deg=math.degrees(float(noses.mean())),
    )


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
    it = hovering(GUID_TIMEOUT=row.timeout_s, WPNAV_SPEED=1000.0)
    north_m = begun_m = last_s = 0.0
    for k in range(3500):
        v = 10.0 * smooth(k * STEP_S / 15.0)
        if k % 10 == 0:
            begun_m, last_s = north_m, it.now_s
            aim(it, row.kind, (north_m, 0.0, -30.0), (v, 0.0, 0.0), (0.0, 0.0, 0.0))
        north_m += v * STEP_S
        it.step()
    slower_s = dict[float, float]()
    """When it was slower than this first."""
    furthest_m = -math.inf
    while it.now_s - last_s < 30.0:
        it.step()
        furthest_m = max(furthest_m, it.ned_m[0] - begun_m)
        for speed_m_s in (9.5, 0.1):
            if it.vehicle.velocity_m_s.real < speed_m_s:
                slower_s.setdefault(speed_m_s, it.now_s - last_s)
    return row._replace(
        brakes_s=slower_s[9.5],
        still_s=slower_s[0.1],
        furthest_m=furthest_m,
        ends_m=it.ned_m[0] - begun_m,
    )


class Jump(NamedTuple):
    """A jump of the target at 6 m/s, or from hover."""

    what: str
    kind: str
    ned_m: Vector
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
    """Fly on for 30 s, move the target, and measure along the jump."""
    it = hovering(height_m=60.0, GUID_TIMEOUT=3.0, WPNAV_SPEED=1000.0)
    axis = max(range(3), key=lambda k: abs(row.ned_m[k]))
    sign = math.copysign(1.0, row.ned_m[axis])
    north_m = jumped_s = left_s = peak = over_m = tilt_deg = lateral = 0.0
    for k in range(6500):
        t = k * STEP_S
        v = min(t, row.speed_m_s)
        if t >= 30.0 and not jumped_s:
            jumped_s = left_s = it.now_s
        shift = row.ned_m if jumped_s else (0.0, 0.0, 0.0)
        target = (north_m + shift[0], shift[1], -60.0 + shift[2])
        if k % 10 == 0:
            aim(it, row.kind, target, (v, 0.0, 0.0), (0.0, 0.0, 0.0))
        it.step()
        north_m += v * STEP_S
        if not jumped_s:
            continue
        away = [there - here for there, here in zip(target, it.ned_m, strict=True)]
        over_m = max(over_m, -sign * away[axis])
        # a stream of positions alone is trailed: then only the way across counts
        if (abs(away[axis]) if row.kind == "position" else math.hypot(*away)) > 1.0:
            left_s = it.now_s
        copter = it.vehicle
        peak = max(peak, abs(copter.velocity_up_m_s) if row.ned_m[2] else it.speed_m_s)
        lateral = max(lateral, abs(copter.velocity_m_s.imag))
        tilt_deg = max(tilt_deg, lean_deg(it))
    return row._replace(
        peak_m_s=peak,
        within_s=left_s - jumped_s,
        overshoot_m=over_m,
        tilt_deg=tilt_deg,
        lateral_m_s=lateral,
    )


def lean_deg(it: ArduCopter | Px4Copter) -> float:
    """How far a copter is inclined."""
    return math.degrees(math.acos(math.cos(it.vehicle.roll_rad) * math.cos(it.vehicle.pitch_rad)))


# --- PX4's multicopter: px4.md 5 ------------------------------------------------------------------

LENGTH_M, _HEIGHT_M, _WAVE_M = 756.0, 20.0, 3.0
"""The route is a figure eight of least radius 50 m, with 3 m of height up and down."""
_RUN_S, _RAMP_M_S2 = 42.0, 2.0


class Curve:
    """The figure eight, with heights and what the target does on it."""

    def __init__(self) -> None:
        self._route = Sine(SWING_RAD, LENGTH_M, LENGTH_M, 0.25)

    def at(self, along_m: float, speed_m_s: float) -> tuple[Vector, Vector, Vector, float]:
        """Position, velocity, acceleration (north, east, down) and yaw of the target there."""
        phase, per_m = math.tau * along_m / LENGTH_M, math.tau / LENGTH_M
        yaw_rad, turn = SWING_RAD * math.sin(phase), SWING_RAD * math.cos(phase) * per_m
        index, share = divmod(along_m / self._route.step_m, 1.0)
        here, there = (np.array(self._route.point(int(index) + k)) for k in (0, 1))
        north, east = (here * (1.0 - share) + there * share).tolist()
        sine, cosine = math.sin(yaw_rad), math.cos(yaw_rad)
        lateral = speed_m_s * speed_m_s * turn
        return (
            (north, east, -_HEIGHT_M - _WAVE_M * math.sin(phase)),
            (speed_m_s * cosine, speed_m_s * sine, -speed_m_s * _WAVE_M * per_m * math.cos(phase)),
            (-lateral * sine, lateral * cosine, 0.0),
            yaw_rad,
        )

    def nearest(self, ne_m: tuple[float, float], near_m: float) -> tuple[float, float]:
        """Metres along the curve of the nearest point, and how far right of it this is."""
        route = self._route
        index, right_m = route.nearest(ne_m, round(near_m / route.step_m))
        heading, (north_m, east_m) = float(route.heading_rad[index]), route.point(index)
        ahead_m = (ne_m[0] - north_m) * math.cos(heading) + (ne_m[1] - east_m) * math.sin(heading)
        laps = round((near_m - index * route.step_m) / LENGTH_M)
        return index * route.step_m + laps * LENGTH_M + ahead_m, right_m


class Tracking(NamedTuple):
    """One row of the table: metres and m/s."""

    along_mean_m: float
    along_max_m: float
    cross_rms_m: float
    cross_max_m: float
    altitude_rms_m: float
    speed_m_s: float


class Eight(NamedTuple):
    """One row of px4.md 5: what was flown and what the real one did."""

    kind: str
    speed_m_s: float
    rate_hz: float
    real: Tracking
    """Along is NaN where it was not measured."""
    lead_s: float = 0.0
    """How far ahead of its time the target is sent."""
    carrot_m: float | None = None
    """Position only, this far ahead of the nearest point, whatever the time is."""


def _moved(elapsed_s: float, speed_m_s: float) -> tuple[float, float]:
    """Distance of a target that gathers speed, and how fast it is."""
    ramp_s = speed_m_s / _RAMP_M_S2
    if elapsed_s < ramp_s:
        return 0.5 * _RAMP_M_S2 * elapsed_s * elapsed_s, _RAMP_M_S2 * elapsed_s
    return speed_m_s * (elapsed_s - 0.5 * ramp_s), speed_m_s


def fly_eight(row: Eight) -> Tracking:
    """One run of 42 s; measured 2 s after the target has gathered its speed, at 9 s at least."""
    rig, curve = Px4Copter().take_off(), Curve()
    begins_s = max(9.0, row.speed_m_s / _RAMP_M_S2 + 2.0)
    every, samples, reached_m = round(1.0 / row.rate_hz / STEP_S), list[tuple[float, ...]](), 0.0
    for index in range(round(_RUN_S / STEP_S)):
        elapsed_s = index * STEP_S
        if index % every == 0:
            target_m, moving_m_s = _moved(elapsed_s, row.speed_m_s)
            target_m += moving_m_s * row.lead_s
            if row.carrot_m is not None:
                target_m = reached_m + row.carrot_m
            position, velocity, acceleration, yaw_rad = curve.at(target_m, moving_m_s)
            rig.aim(
                None if row.kind == "velocity" else position,
                None if row.kind == "position" else velocity,
                acceleration if row.kind == "pos + vel + acc" else None,
                yaw_rad,
            )
        rig.step()
        if index % 5 == 0:
            north_m, east_m, down_m = rig.ned_m
            reached_m, cross_m = curve.nearest((north_m, east_m), reached_m)
            behind_m = _moved(elapsed_s + STEP_S, row.speed_m_s)[0] - reached_m
            high_m = down_m - curve.at(reached_m, row.speed_m_s)[0][2]
            if elapsed_s >= begins_s:
                samples.append((behind_m, cross_m, high_m, rig.speed_m_s))
    along, cross, height, speed = np.array(samples).T
    most_m, aside_m = float(np.abs(along).max()), float(np.abs(cross).max())
    mean = float(along.mean())
    return Tracking(mean, most_m, _rms(cross), aside_m, _rms(height), float(speed.mean()))


def _eight(kind: str, speed: float, rate: float, figures: str, lead_s: float = 0.0) -> Eight:
    return Eight(kind, speed, rate, Tracking(*map(float, figures.split())), lead_s)


def _carrot(carrot_m: float, *figures: float) -> Eight:
    real = Tracking(NAN, NAN, *figures)
    return Eight("position", real.speed_m_s, 20.0, real, carrot_m=carrot_m)


_P, _PV, _PVA = "position", "position + velocity", "pos + vel + acc"
EIGHTS = (
    _eight(_P, 5.0, 20.0, "5.5 5.8 0.20 0.45 0.13 5.1"),
    _eight(_PV, 5.0, 20.0, "0.2 0.7 0.18 0.43 0.16 5.0"),
    _eight(_PVA, 5.0, 20.0, "0.3 0.4 0.40 0.80 0.13 5.1"),
    _eight(_P, 8.0, 20.0, "8.7 9.0 0.33 0.66 0.13 8.0"),
    _eight(_PV, 8.0, 20.0, "0.4 0.7 0.62 1.26 0.12 8.1"),
    _eight(_PVA, 8.0, 20.0, "0.5 0.9 0.46 0.96 0.17 8.1"),
    _eight(_P, 10.0, 20.0, "10.9 11.2 0.22 0.43 0.14 10.0"),
    _eight(_PV, 10.0, 20.0, "0.4 0.6 0.84 1.51 0.11 10.1"),
    _eight(_PVA, 10.0, 20.0, "0.7 1.0 0.69 1.10 0.12 10.1"),
    _eight(_P, 12.0, 20.0, "15.8 18.8 0.65 1.11 0.23 11.9"),
    _eight(_PV, 12.0, 20.0, "5.5 9.2 0.60 0.95 0.12 12.0"),
    _eight(_PVA, 12.0, 20.0, "11.0 17.9 0.44 0.96 0.22 11.5"),
    _eight("velocity", 8.0, 20.0, "7.3 8.7 0.70 1.34 1.00 8.0"),
    _eight(_PV, 8.0, 5.0, "0.9 1.2 0.48 0.70 0.13 8.1"),
    _eight(_PVA, 8.0, 5.0, "1.0 1.2 0.41 1.09 0.11 8.0"),
    _eight(_PV, 8.0, 10.0, "0.5 0.7 0.40 0.89 0.13 8.0"),
    _eight(_PVA, 8.0, 10.0, "0.5 0.8 0.28 0.60 0.16 7.9"),
    _eight(_PV, 8.0, 50.0, "0.3 0.7 0.59 1.23 0.22 8.2"),
    _eight(_PVA, 8.0, 50.0, "0.3 0.9 0.41 0.81 0.08 8.1"),
    _eight(_P, 8.0, 2.0, "10.5 10.8 0.29 0.59 0.09 8.0"),
    _eight(_P, 8.0, 5.0, "9.3 9.6 0.21 0.48 0.14 8.0"),
    _eight(_PVA, 8.0, 20.0, "-0.8 1.3 0.43 0.87 0.16 8.0", 0.15),
    _eight(_PVA, 10.0, 20.0, "0.3 3.1 0.61 1.06 0.07 10.3", 0.15),
    _carrot(5.0, 0.38, 0.75, 0.10, 4.6),
    _carrot(8.0, 0.35, 0.62, 0.10, 7.3),
    _carrot(10.0, 0.30, 0.67, 0.12, 9.2),
)


# --- ArduPlane: ardupilot.md 7 --------------------------------------------------------------------

RADIUS_MOST_M = 600.0
"""Of an osculating circle: the route has straight places."""
AGE_STEPS = 15
"""A client knows where the vehicle was 0.15 s ago: telemetry at 10 Hz, and its own time."""
Law = Callable[[ArduPlane, Sine, int], object]
"""Sends what it takes, with the index of the nearest point."""


def look_ahead(ahead_m: float, radius_m: float) -> Law:
    """DO_REPOSITION to a point ahead on the route."""
    return lambda rig, route, nearest: rig.reposition(
        *route.point(route.ahead(nearest, ahead_m)), 80.0, radius_m
    )


def osculating(ahead_s: float, smaller_m: float = 17.0) -> Law:
    """DO_REPOSITION to the centre of curvature of the route some seconds ahead."""

    def send(rig: ArduPlane, route: Sine, nearest: int) -> object:
        k = route.ahead(nearest, ahead_s * rig.speed_m_s)
        curvature, heading = float(route.curvature_1_m[k]), float(route.heading_rad[k])
        radius_m = min(1.0 / max(abs(curvature), 1e-6), RADIUS_MOST_M)
        north, east = route.point(k)
        aside_m = math.copysign(radius_m, curvature)
        place = (north - aside_m * math.sin(heading), east + aside_m * math.cos(heading))
        return rig.reposition(*place, 80.0, max(radius_m - smaller_m, 2.0), float(curvature < 0.0))

    return send


def heading_towards(ahead_m: float, lateral_m_s2: float = 6.0) -> Law:
    """GUIDED_CHANGE_HEADING, course over ground, towards a point ahead."""

    def send(rig: ArduPlane, route: Sine, nearest: int) -> object:
        north, east = np.subtract(route.point(route.ahead(nearest, ahead_m)), rig.ne_m).tolist()
        course_deg = math.degrees(math.atan2(east, north)) % 360.0
        return rig.command(43002, 0.0, course_deg, lateral_m_s2, frame=3)

    return send


@functools.cache
def _before_the_route() -> ArduPlane:
    """400 m south of home, where routes begin."""
    rig = circling(0.0, AIRSPEED_CRUISE=20.0)
    rig.reposition(-900.0, 0.0, 80.0, 10.0)
    rig.until(lambda: rig.ne_m[0] < -800.0)
    rig.reposition(-200.0, 0.0, 80.0, 10.0)
    rig.until(lambda: rig.ne_m[0] > -410.0)
    return rig


def off_path(law: Law, lateral_m_s2: float, *, hz: float = 4.0) -> Off:
    """At an airspeed of 20 m/s along a route that swings by 25 deg; its first 400 m apart."""
    swing_rad, speed_m_s = math.radians(25.0), 21.0
    # curvature at most swing * 2 pi / wave = lateral / speed^2
    route = Sine(swing_rad, swing_rad * math.tau * speed_m_s**2 / lateral_m_s2, 6000.0, 1.0)
    route.ne_m -= (400.0, 0.0)
    rig = _before_the_route().copy()
    return _followed(
        rig,
        route,
        lambda nearest: law(rig, route, nearest),
        hz=hz,
        seconds=100.0,
        counts=lambda _, index: 400 < index < 5900,
        age_steps=AGE_STEPS,
    )


PLANE_ROWS: tuple[tuple[str, Law, float, float, tuple[float, float]], ...] = (
    ("reposition 115 m ahead, radius 10 m", look_ahead(115.0, 10.0), 1.0, 4.0, (3.0, 4.4)),
    ("reposition 60 m ahead, radius 10 m", look_ahead(60.0, 10.0), 2.0, 4.0, (31.0, 40.0)),
    ("reposition 80 m ahead, radius 10 m", look_ahead(80.0, 10.0), 2.0, 4.0, (24.0, 35.0)),
    ("reposition 100 m ahead, radius 10 m", look_ahead(100.0, 10.0), 2.0, 4.0, (7.5, 13.9)),
    ("reposition 115 m ahead, radius 10 m", look_ahead(115.0, 10.0), 2.0, 4.0, (6.0, 8.8)),
    ("reposition 115 m ahead, radius 2 m", look_ahead(115.0, 2.0), 2.0, 4.0, (6.0, 8.8)),
    ("reposition 130 m ahead, radius 10 m", look_ahead(130.0, 10.0), 2.0, 4.0, (7.9, 12.5)),
    ("reposition 130 m ahead, radius 10 m", look_ahead(130.0, 10.0), 2.0, 10.0, (8.2, 12.8)),
    ("reposition 160 m ahead, radius 10 m", look_ahead(160.0, 10.0), 2.0, 4.0, (11.6, 18.7)),
    ("reposition 160 m ahead, radius 10 m", look_ahead(160.0, 10.0), 2.0, 1.0, (10.6, 16.6)),
    ("reposition 200 m ahead, usual radius", look_ahead(200.0, 0.0), 2.0, 4.0, (16.6, 28.0)),
    ("reposition 300 m ahead, usual radius", look_ahead(300.0, 0.0), 2.0, 4.0, (25.0, 48.0)),
    ("osculating circle 2 s ahead", osculating(2.0), 2.0, 4.0, (5.0, 12.0)),
    ("heading to a point 60 m ahead", heading_towards(60.0), 2.0, 4.0, (11.0, 16.0)),
    ("reposition 110 m ahead, radius 10 m", look_ahead(110.0, 10.0), 3.5, 4.0, (9.5, 14.3)),
    ("reposition 130 m ahead, radius 10 m", look_ahead(130.0, 10.0), 3.5, 4.0, (12.1, 19.6)),
    ("osculating circle 2 s ahead", osculating(2.0), 3.5, 4.0, (8.7, 12.0)),
)
"""ardupilot.md 7, "Following a weaving route at 21 m/s": law, lateral acceleration of the route in
m/s2, Hz, and what the real one was off the path, rms and most in m.  That "80 m" of the row
"60 m, radius 10 / 80 m" is a look-ahead is read from its figures."""


# --- PX4's fixed wing: px4.md 10 ------------------------------------------------------------------

_PLANE_HEIGHT_M, _ASKED_M_S = 70.0, 14.0
"""The speed that is asked for means nothing."""
_START = 3022
"""Where flights begin: what DO_REPOSITION measures in 70 s depends on it (30 to 51 m rms)."""
_LEAD_IN_S, _PLANE_RUN_S = 25.0, 70.0


def fixed_wing_route() -> Sine:
    """A figure eight of least radius 100 m, 1511 m long; its heading goes with the cosine."""
    length_m = SWING_RAD * math.tau * 100.0
    return Sine(SWING_RAD, length_m, length_m, length_m / 6044, math.pi / 2.0)


class FixedWing(NamedTuple):
    """One line of the table of px4.md 10, and how near the simulator is to be."""

    name: str
    kind: str
    lead_m: float
    rate_hz: float
    rms_m: float
    most_m: float
    within_m: float
    """Of the rms."""


FIXED_WING: Final = (
    FixedWing("pos + vel, nearest point", "pos + vel", 0.0, 10.0, 3.8, 6.7, 0.6),
    FixedWing("pos + vel, nearest point, 2.5 Hz", "pos + vel", 0.0, 2.5, 3.9, 8.0, 1.0),
    FixedWing("pos + vel, lead 15 m", "pos + vel", 15.0, 10.0, 1.8, 4.1, 1.2),
    FixedWing("pos + vel, lead 20 m", "pos + vel", 20.0, 10.0, 1.1, 3.8, 1.0),
    FixedWing("pos + vel, lead 30 m", "pos + vel", 30.0, 10.0, 1.3, 6.9, 1.3),
    FixedWing("pos + vel, lead 60 m", "pos + vel", 60.0, 10.0, 1.6, 3.0, 1.2),
    FixedWing("pos + vel + acc", "pos + vel + acc", 0.0, 10.0, 7.9, 12.6, 1.2),
    FixedWing("pos + vel - acc (negated)", "pos + vel - acc", 0.0, 10.0, 0.9, 2.2, 0.9),
    FixedWing("pos only, lead 30 m", "position", 30.0, 10.0, 0.8, 1.5, 0.7),
    FixedWing("pos only, lead 60 m", "position", 60.0, 10.0, 5.2, 7.1, 1.0),
    FixedWing("pos only, lead 100 m", "position", 100.0, 10.0, 18.0, 24.5, 2.5),
    FixedWing("DO_REPOSITION at 1 Hz, lead 130 m", "reposition", 130.0, 1.0, 53.0, 86.0, 20.0),
)
"""px4.md 10, "Curve of least radius 100 m", all of it."""


def fly_fixed(row: FixedWing) -> Off:
    """Fly a row: the last 70 of 95 s along the curve count."""
    route, sent = fixed_wing_route(), 0
    north_m, east_m = route.point(_START)
    heading_rad = float(route.heading_rad[_START])
    rig = cruising(north_m, east_m, _PLANE_HEIGHT_M - 2.0, heading_rad)

    def send(nearest: int) -> None:
        nonlocal sent
        sent += 1
        if sent == 3 and row.kind != "reposition":
            rig.command(176, 1.0, *OFFBOARD)
        index = route.ahead(nearest, row.lead_m)
        ahead_n_m, ahead_e_m = route.point(index)
        if row.kind == "reposition":
            place = rig.place(ahead_n_m, ahead_e_m, _PLANE_HEIGHT_M)
            rig.command(192, -1.0, 1.0, 0.0, NAN, *place, frame=5)
            return
        heading, bend = float(route.heading_rad[index]), float(route.curvature_1_m[index])
        way_n, way_e = math.cos(heading), math.sin(heading)
        lateral = _ASKED_M_S**2 * bend * (-1.0 if row.kind == "pos + vel - acc" else 1.0)
        velocity = (_ASKED_M_S * way_n, _ASKED_M_S * way_e, 0.0)
        vectors = (velocity, (-lateral * way_e, lateral * way_n, 0.0))
        given = {"position": 0, "pos + vel": 1}.get(row.kind, 2)
        rig.aim((ahead_n_m, ahead_e_m, -_PLANE_HEIGHT_M), *vectors[:given])

    return _followed(
        rig,
        route,
        send,
        hz=row.rate_hz,
        seconds=_LEAD_IN_S + _PLANE_RUN_S,
        counts=lambda time_s, _: time_s >= _LEAD_IN_S,
        begin=_START,
    )
