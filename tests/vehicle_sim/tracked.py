"""How the four autopilots follow setpoints: what the documents measured, and the same flown here.

ardupilot.md 3 (ArduCopter) and 7 (ArduPlane), px4.md 5 (multicopter) and 10 (fixed wing): their
tables, and how it is measured there.  Lengths in metres, angles in radians unless named; vectors
are north, east, down, and what is level is north + east j.
"""

import math
import re
from collections import namedtuple
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from harness import STEP_S, ZERO, Rig, Vector, circling, copied, cruising, hover, hovering
from numpy.typing import NDArray

from vehicle_sim.geodesy import FloatArray

Level = NDArray[np.complex128]
SWING_RAD: Final = 2.404825557695773
"""First zero of J0: a route that swings so far to both sides closes."""


def _page(name: str) -> str:
    """Of docs/reference, whose tables are read from it."""
    return (Path(__file__).parents[2] / f"docs/lab/{name}.md").read_text("utf-8")


class Sine:
    """A route whose heading is a sine of the way along it, round and round: a point each step."""

    def __init__(
        self, swing_rad: float, wave_m: float, length_m: float, step_m: float, begins_rad: float = 0
    ) -> None:
        self.step_m, turn_1_m = step_m, math.tau / wave_m
        phase = begins_rad + turn_1_m * step_m * np.arange(round(length_m / step_m))
        steps = step_m * np.exp(1j * swing_rad * np.sin(phase + 0.5 * turn_1_m * step_m))
        self.at: Level = np.cumsum(steps) - steps
        self.heading_rad = swing_rad * np.sin(phase)
        self.way: Level = np.exp(1j * self.heading_rad)
        self.curvature_1_m = swing_rad * turn_1_m * np.cos(phase)

    def ahead(self, index: int, metres: float) -> int:
        """Index of the point so much further on."""
        return (index + round(metres / self.step_m)) % len(self.at)

    def nearest(self, here: complex, near: int) -> tuple[int, float]:
        """Index of the nearest point within 100 m of another, and how far right of it this is."""
        reach = round(100.0 / self.step_m)
        indices = (near + np.arange(-reach, reach + 1)) % len(self.at)
        index = int(indices[np.argmin(np.abs(here - self.at[indices]))])
        return index, float(((here - self.at[index]) / self.way[index]).imag)

    def followed(self, places: Level, begin: int = 0) -> tuple[FloatArray, FloatArray]:
        """Of each place in turn: metres along, lap after lap, and how far right.  -> two of (T,)"""
        found = list[tuple[int, float]]()
        for here in places.tolist():
            found.append(self.nearest(here, found[-1][0] if found else begin))
        index, right_m = np.array(found).T
        return np.unwrap(index, period=len(self.at)) * self.step_m, right_m


Off = namedtuple("Off", "rms_m most_m speed_m_s")
"""How far off a route a plane flew, and how fast over the ground."""


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _flat(level: complex, down: float = 0.0) -> Vector:
    return level.real, level.imag, down


class Seen(NamedTuple):
    """What was looked at twenty times a second: T of each."""

    step: FloatArray
    """Of the rig: the one that has been flown."""
    ne_m: Level
    """Where it believed to be."""
    down_m: FloatArray
    moves_m_s: Level
    climb_m_s: FloatArray
    lean_deg: FloatArray


def _flown(
    rig: Rig, seconds: float, hz: float, send: Callable[[int, Any], object], since_s: float = 0.0
) -> Seen:
    """Send at this rate, with the number of the step and what was seen, and look."""
    every, seen, vehicle = round(1.0 / hz / STEP_S), list[Any](), rig.vehicle
    for k in range(round(seconds / STEP_S)):
        if k % every == 0:
            send(k, seen)
        rig.step()
        if k % 5 == 0 and k * STEP_S >= since_s:
            (north, east, down), moves = rig.ned_m, vehicle.velocity_m_s
            lean_rad = math.acos(math.cos(vehicle.roll_rad) * math.cos(vehicle.pitch_rad))
            lean_deg, climb_m_s = math.degrees(lean_rad), vehicle.velocity_up_m_s
            seen.append((k, complex(north, east), down, moves, climb_m_s, lean_deg))
    return Seen(*map(np.array, zip(*seen, strict=True)))


# --- ArduCopter: ardupilot.md 3 -------------------------------------------------------------------

PERIOD_S = 12.0
"""Of the weaving heading, which the document does not tell: this one agrees with it best."""


def aim(it: Rig, kind: str, position: Vector, *derivatives: Vector) -> None:
    """A setpoint of this kind, in LOCAL_NED or as GLOBAL_INT above home."""
    if kind.startswith("GLOBAL"):
        there = it.autopilot.frame.place(*position)
        place = (there.latitude_deg, there.longitude_deg, -position[2])
        it.aim(place, *derivatives[: 2 if "acc" in kind else 1], frame=6, is_global=True)
    elif kind == "velocity":
        it.aim(None, derivatives[0])
    else:
        it.aim(position, *derivatives[: kind.count("+")])


def _ramp(share: Any) -> Any:
    """From 0 to 1 without a corner."""
    share = np.minimum(share, 1.0)
    return share * share * (3.0 - 2.0 * share)


def _moved(rate: Any) -> Any:
    """What a rate of each step has come to before it."""
    return (np.cumsum(rate, axis=0) - rate) * STEP_S


def weave(speed_m_s: float, lateral_m_s2: float, seconds: float) -> tuple[FloatArray, ...]:
    """Position, velocity and acceleration of each step: a sinusoidal heading of this lateral
    acceleration, speed ramped up smoothly at 1 m/s2, and climbs of 1 m/s.  -> three of (T, 3).
    """
    time_s, w = STEP_S * np.arange(round(seconds / STEP_S)), math.tau / PERIOD_S
    share = _ramp(time_s / (1.5 * speed_m_s))
    course = lateral_m_s2 / (speed_m_s * w) * share * np.sin(w * time_s)
    level, down_m_s = speed_m_s * share, -share * np.sin(math.tau / 40.0 * time_s)
    velocity = np.stack([level * np.cos(course), level * np.sin(course), down_m_s], axis=-1)
    return _moved(velocity) - (0.0, 0.0, 30.0), velocity, np.gradient(velocity, STEP_S, axis=0)


Weave = namedtuple(
    "Weave", "speed_m_s lateral_m_s2 lean_deg kind rate_hz along_m off_rms_m off_max_m"
)
"""A row of the document's table, or how it was flown: along is a mean, negative behind."""
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


def fly_weave(row: Weave, *, seconds: float = 90.0) -> Weave:
    """Stream a route and measure along and off it."""
    speed_cm_s = max(row.speed_m_s, 10.0) * 100.0
    it = hovering(lean_deg=row.lean_deg, WPNAV_SPEED=speed_cm_s, GUID_TIMEOUT=3.0)
    route = position, velocity, _ = weave(row.speed_m_s, row.lateral_m_s2, seconds)

    def send(k: int, _: Any) -> None:
        aim(it, row.kind, *(each[k].tolist() for each in route))

    seen = _flown(it, seconds, row.rate_hz, send, since_s=40.0)
    there, way = (each[:, 0] + 1j * each[:, 1] for each in (position, velocity))
    way, off_m = way[seen.step], [np.abs(there - here).min() for here in seen.ne_m]
    # the step has been flown by now
    ahead_m = ((seen.ne_m - there[seen.step]) / way).real * np.abs(way) - np.abs(way) * STEP_S
    return row._replace(along_m=ahead_m.mean(), off_rms_m=_rms(off_m), off_max_m=max(off_m))


Stop = namedtuple("Stop", "kind timeout_s brakes_s still_s furthest_m ends_m")
"""A stream at 10 m/s that ends: seconds and metres from its last setpoint."""
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
    """Fly straight at 10 m/s for 35 s, end the stream, and measure."""
    it, last = hovering(GUID_TIMEOUT=row.timeout_s, WPNAV_SPEED=1000.0), 3490
    speed = 10.0 * _ramp(np.arange(last + 1) * STEP_S / 15.0)
    north = _moved(speed).tolist()

    def send(k: int, _: Any) -> None:
        if k <= last:
            aim(it, row.kind, (north[k], 0.0, -30.0), (float(speed[k]), 0.0, 0.0), ZERO)

    seen = _flown(it, 65.0, 10.0, send, since_s=last * STEP_S)
    after_s, ahead_m = (seen.step + 1 - last) * STEP_S, seen.ne_m.real - north[last]
    brakes_s, still_s = (after_s[seen.moves_m_s.real < slow][0] for slow in (9.5, 0.1))
    return Stop(row.kind, row.timeout_s, brakes_s, still_s, ahead_m.max(), ahead_m[-1])


# --- PX4's multicopter: px4.md 5 ------------------------------------------------------------------

EIGHT: Final = Sine(SWING_RAD, 756.0, 756.0, 0.02)
"""A figure eight of least radius 50 m."""
_LENGTH_M, _HEIGHT_M, _WAVE_M, _RAMP_M_S2 = 756.0, 20.0, 3.0, 2.0
"""With 3 m of height up and down, and of a target that gathers speed."""
Tracking = namedtuple(
    "Tracking", "along_mean_m along_max_m cross_rms_m cross_max_m altitude_rms_m speed_m_s"
)
"""How well."""
Eight = namedtuple("Eight", "kind speed_m_s rate_hz real")
"""One row of the table: what is sent, some of it ahead of its time."""
EIGHTS: Final = tuple(
    Eight(kind, float(speed), float(rate), Tracking(*map(float, re.findall(r"[-.\d]+", figures))))
    for speed, kind, rate, figures in re.findall(
        r"^\| (\d+) \| ((?:pos|vel).*?) \| (\d+) \| (.*) \|$", _page("px4"), re.MULTILINE
    )
)


def _down_m(along_m: Any) -> Any:
    return -_HEIGHT_M - _WAVE_M * np.sin(math.tau * along_m / _LENGTH_M)


def fly_eight(row: Eight) -> Tracking:
    """One run of 42 s; measured 2 s after the target has gathered its speed, at 9 s at least."""
    rig, ramp_s = hover(20.0), row.speed_m_s / _RAMP_M_S2

    def moved(elapsed_s: Any) -> tuple[Any, Any]:
        """Distance of the target, and how fast it is."""
        ramped_s = np.minimum(elapsed_s, ramp_s)
        moving_m_s = _RAMP_M_S2 * ramped_s
        return moving_m_s * (elapsed_s - 0.5 * ramped_s), moving_m_s

    def send(k: int, _: Any) -> None:
        target_m, moving_m_s = map(float, moved(k * STEP_S))
        target_m += moving_m_s * (0.15 if "0.15 s ahead" in row.kind else 0.0)
        there, phase = EIGHT.ahead(0, target_m), math.tau * target_m / _LENGTH_M
        sinks_m_s = -moving_m_s * _WAVE_M * math.tau / _LENGTH_M * math.cos(phase)
        way, bend_1_m = EIGHT.way[there], EIGHT.curvature_1_m[there]
        rig.aim(
            _flat(EIGHT.at[there], float(_down_m(target_m))) if "pos" in row.kind else None,
            _flat(moving_m_s * way, sinks_m_s) if "vel" in row.kind else None,
            _flat(1j * moving_m_s**2 * bend_1_m * way) if "acc" in row.kind else None,
            float(EIGHT.heading_rad[there]),
        )

    seen = _flown(rig, 42.0, row.rate_hz, send)
    along_m, cross_m = EIGHT.followed(seen.ne_m)
    counts = seen.step * STEP_S >= max(9.0, ramp_s + 2.0)
    behind, cross, high, speed = (
        each[counts]
        for each in (
            moved((seen.step + 1) * STEP_S)[0] - along_m,
            cross_m,
            seen.down_m - _down_m(along_m),
            np.abs(seen.moves_m_s),
        )
    )
    most_m, aside_m = np.abs(behind).max(), np.abs(cross).max()
    return Tracking(behind.mean(), most_m, _rms(cross), aside_m, _rms(high), speed.mean())


# --- planes: aimed from the point of the route nearest to where the vehicle was -------------------


def _followed(
    rig: Rig,
    route: Sine,
    aim: Callable[[int], object],
    *,
    hz: float,
    seconds: float,
    counts: Callable[[Any, Any], Any],
    begin: int = 0,
    age: int = 0,
) -> Off:
    """Aim from the point nearest to where the vehicle was, so many looks ago; counts: which of the
    seconds and metres along."""
    index = begin

    def send(_: int, seen: Sequence[Any]) -> None:
        nonlocal index
        here = seen[-age][1] if len(seen) > age > 0 else complex(*rig.ne_m)
        index, _ = route.nearest(here, index)
        aim(index)

    seen = _flown(rig, seconds, hz, send)
    along_m, right_m = route.followed(seen.ne_m, begin)
    there = counts(seen.step * STEP_S, along_m)
    off_m, speed_m_s = right_m[there], np.abs(seen.moves_m_s[there])
    return Off(_rms(off_m), float(np.abs(off_m).max()), float(speed_m_s.mean()))


# --- ArduPlane: ardupilot.md 7 --------------------------------------------------------------------

AGE = 3
"""Looks: a client knows where the vehicle was 0.15 s ago: telemetry at 10 Hz, and its own time."""
LookAhead = namedtuple("LookAhead", "ahead_m radius_m lateral_m_s2 rms_m most_m")
"""A row of "Following a weaving route at 21 m/s": DO_REPOSITION at 4 Hz to a circle of this radius,
0 for the usual, about a point ahead on a route of this lateral acceleration."""
LOOK_AHEADS: Final = tuple(
    LookAhead(float(ahead_m), 0.0 if "default radius" in how else 10.0, *map(float, figures))
    for ahead_m, how, *figures in re.findall(
        r"^\| (?:DO_REPOSITION,? )?(?:look-ahead )?(\d+) m(.*?) \| ([.\d]+).*? \| "
        r"\**([.\d]+) / ([.\d]+)",
        _page("ardupilot").partition("## 7. Plane")[2],
        re.MULTILINE,
    )
)


@copied
def _before_the_route() -> Rig:
    """400 m south of home, where routes begin."""
    rig = circling(0.0, AIRSPEED_CRUISE=20.0)
    for to_m, from_m in ((-900.0, -800.0), (-200.0, -410.0)):
        rig.reposition(to_m, 0.0, 80.0, 10.0)
        rig.until(lambda: (rig.ne_m[0] > from_m) is (to_m > -900.0))  # noqa: B023
    return rig


def fly_look_ahead(row: LookAhead) -> Off:
    """At an airspeed of 20 m/s along a route that swings by 25 deg; its first 400 m apart."""
    swing_rad, speed_m_s = math.radians(25.0), 21.0
    # curvature at most swing * 2 pi / wave = lateral / speed^2
    wave_m = swing_rad * math.tau * speed_m_s**2 / row.lateral_m_s2
    route, rig = Sine(swing_rad, wave_m, 6000.0, 1.0), _before_the_route()
    route.at -= 400.0

    def send(nearest: int) -> None:
        there = route.at[route.ahead(nearest, row.ahead_m)]
        rig.reposition(*_flat(there, 80.0), row.radius_m)

    return _followed(
        rig,
        route,
        send,
        hz=4.0,
        seconds=100.0,
        counts=lambda _, along_m: (along_m > 400.0) & (along_m < 5900.0),
        age=AGE,
    )


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


FixedWing = namedtuple("FixedWing", "name rms_m most_m")
"""One row of the table."""
FIXED_WING: Final = tuple(
    FixedWing(name, float(rms_m), float(most_m))
    for name, rms_m, most_m in re.findall(
        r"^\| ((?:pos|DO_REPO).*?) \| ([.\d]+) / ([.\d]+)", _page("px4"), re.MULTILINE
    )
)


def _told(name: str, unit: str, otherwise: float) -> float:
    """The number before this unit in the name of a row."""
    found = re.search(rf"([.\d]+) {unit}\b", name)
    return float(found[1]) if found else otherwise


def fly_fixed(row: FixedWing) -> Off:
    """Fly a row: the last 70 of 95 s along the curve count."""
    route, sent = fixed_wing_route(), 0
    begins, heading_rad = route.at[_START], float(route.heading_rad[_START])
    rig = cruising(begins.real, begins.imag, _PLANE_HEIGHT_M - 2.0, heading_rad)

    def send(nearest: int) -> None:
        nonlocal sent
        sent += 1
        index = route.ahead(nearest, _told(row.name, "m", 0.0))
        at, way, bend_1_m = route.at[index], route.way[index], route.curvature_1_m[index]
        if row.name.startswith("DO_REPOSITION"):
            rig.reposition(*_flat(at, _PLANE_HEIGHT_M))
            return
        if sent == 3:
            rig.set_mode("Offboard")
        lateral = _ASKED_M_S**2 * bend_1_m * (-1.0 if "- acc" in row.name else 1.0)
        vectors = _flat(_ASKED_M_S * way), _flat(1j * lateral * way)
        given = ("vel" in row.name) + ("acc" in row.name)
        rig.aim(_flat(at, -_PLANE_HEIGHT_M), *vectors[:given])

    return _followed(
        rig,
        route,
        send,
        hz=_told(row.name, "Hz", 10.0),
        seconds=_LEAD_IN_S + _PLANE_RUN_S,
        counts=lambda time_s, _: time_s >= _LEAD_IN_S,
        begin=_START,
    )
