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
from harness import STEP_S, Rig, Vector, circling, cruising, hover, hovering
from numpy.typing import NDArray

from vehicle_sim.geodesy import FloatArray

Level = NDArray[np.complex128]
SWING_RAD: Final = 2.404825557695773
"""First zero of J0: a route that swings so far to both sides closes."""


def _page(name: str) -> str:
    """Of docs/lab, whose tables are read from it."""
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


def _flown(rig: Rig, seconds: float, hz: float, send: Callable[[int, Any], object]) -> Seen:
    """Send at this rate, with the number of the step and what was seen, and look."""
    every, seen = round(1.0 / hz / STEP_S), list[Any]()
    for k in range(round(seconds / STEP_S)):
        if k % every == 0:
            send(k, seen)
        rig.step()
        if k % 5 == 0:
            north, east, down = rig.ned_m
            seen.append((k, complex(north, east), down, rig.vehicle.velocity_m_s))
    return Seen(*map(np.array, zip(*seen, strict=True)))


# --- copters: told where a target is --------------------------------------------------------------

Tracking = namedtuple(
    "Tracking", "along_mean_m along_max_m cross_rms_m cross_max_m altitude_rms_m speed_m_s"
)
"""How far a vehicle is behind its target along the route, beside the route, and off in height."""


class Target(NamedTuple):
    """What is followed: it gathers speed along the route, and goes up and down as it goes."""

    route: Sine
    speed_m_s: float
    ramp_m_s2: float = 1.0
    height_m: float = 30.0
    wave_m: float = 0.0
    wave_length_m: float = 1.0

    def moved(self, elapsed_s: Any) -> tuple[Any, Any]:
        """How far it has come, and how fast it is."""
        ramped_s = np.minimum(elapsed_s, self.speed_m_s / self.ramp_m_s2)
        moving_m_s = self.ramp_m_s2 * ramped_s
        return moving_m_s * (elapsed_s - 0.5 * ramped_s), moving_m_s

    def down_m(self, along_m: Any) -> Any:
        return -self.height_m - self.wave_m * np.sin(math.tau * along_m / self.wave_length_m)

    def tell(self, rig: Rig, elapsed_s: float, kind: str, *, yaw: bool = False) -> None:
        """A setpoint of this kind, some ahead of their time; in LOCAL_NED or GLOBAL_INT."""
        along_m, moving_m_s = map(float, self.moved(elapsed_s))
        along_m += moving_m_s * (0.15 if "0.15 s ahead" in kind else 0.0)
        there, turn_1_m = self.route.ahead(0, along_m), math.tau / self.wave_length_m
        sinks_m_s = -moving_m_s * self.wave_m * turn_1_m * math.cos(turn_1_m * along_m)
        way, bend_1_m = self.route.way[there], self.route.curvature_1_m[there]
        place = _flat(self.route.at[there], float(self.down_m(along_m)))
        is_global = kind.startswith("GLOBAL")
        if is_global:
            latitude_deg, longitude_deg, _ = rig.place(*place)
            place = (latitude_deg, longitude_deg, -place[2])
        rig.aim(
            place if "pos" in kind else None,
            _flat(moving_m_s * way, sinks_m_s) if "vel" in kind else None,
            _flat(1j * moving_m_s**2 * bend_1_m * way) if "acc" in kind else None,
            float(self.route.heading_rad[there]) if yaw else None,
            frame=6 if is_global else 1,
            is_global=is_global,
        )

    def left_behind(self, seen: Seen, since_s: float) -> Tracking:
        """How well it was followed, from then on."""
        along_m, cross_m = self.route.followed(seen.ne_m)
        behind_m = self.moved((seen.step + 1) * STEP_S)[0] - along_m
        off = behind_m, cross_m, seen.down_m - self.down_m(along_m), np.abs(seen.moves_m_s)
        behind, cross, high, speed = (each[seen.step * STEP_S >= since_s] for each in off)
        most_m, aside_m = np.abs(behind).max(), np.abs(cross).max()
        return Tracking(behind.mean(), most_m, _rms(cross), aside_m, _rms(high), speed.mean())


# --- ArduCopter: ardupilot.md 3 -------------------------------------------------------------------

PERIOD_S = 12.0
"""Of the weaving heading, which the document does not tell: this one agrees with it best."""
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
    *(Weave(10, 1.5, 45, "pos+vel+acc", rate_hz, -0.2, 0.35, 0.55) for rate_hz in (20, 4, 2)),
    Weave(10, 1.5, 45, "pos+vel+acc", 1, -0.1, 0.51, 1.1),
    Weave(10, 1.5, 45, "velocity", 10, -6.8, 0.23, 0.36),
    Weave(10, 1.5, 45, "GLOBAL pos+vel", 10, -0.3, 0.96, 1.4),
    Weave(10, 1.5, 45, "GLOBAL pos+vel+acc", 10, -0.3, 0.96, 1.4),
    Weave(10, 2.4, 45, "pos+vel+acc", 10, -0.3, 0.53, 0.86),
    Weave(10, 3.5, 45, "pos+vel+acc", 10, -0.5, 0.72, 1.1),
    Weave(15, 1.8, 60, "position", 10, -69.0, 3.5, 5.9),
    Weave(15, 1.8, 60, "pos+vel+acc", 10, -0.3, 0.51, 0.8),
    Weave(10, 1.5, 30, "pos+vel", 10, -4.6, 4.4, 7.8),
    Weave(10, 1.5, 30, "pos+vel+acc", 10, -0.7, 4.7, 11.5),
)


def fly_weave(row: Weave) -> Weave:
    """Stream for 54 s a sinusoidal heading of this lateral acceleration, with climbs of 1 m/s."""
    speed_m_s, speed_cm_s = row.speed_m_s, max(row.speed_m_s, 10.0) * 100.0
    it = hovering(lean_deg=row.lean_deg, WPNAV_SPEED=speed_cm_s, GUID_TIMEOUT=3.0)
    wave_m, swing_rad = speed_m_s * PERIOD_S, row.lateral_m_s2 / speed_m_s * PERIOD_S / math.tau
    route = Sine(swing_rad, wave_m, 10.0 * wave_m, 0.02)
    target = Target(route, speed_m_s, wave_m=40.0 / math.tau, wave_length_m=40.0 * speed_m_s)
    seen = _flown(it, 54.0, row.rate_hz, lambda k, _: target.tell(it, k * STEP_S, row.kind))
    got = target.left_behind(seen, since_s=40.0)
    return Weave(*row[:5], -got.along_mean_m, got.cross_rms_m, got.cross_max_m)


Stop = namedtuple("Stop", "kind timeout_s brakes_s still_s furthest_m ends_m")
"""A stream at 10 m/s that ends: seconds and metres from its last setpoint."""
STOPS = (
    Stop("position", 3.0, None, 6.4, 0.8, 0.0),
    *(Stop(kind, 3.0, 3.7, 7.1, 53.7, 30.0) for kind in ("pos+vel", "pos+vel+acc")),
    Stop("velocity", 3.0, 3.7, 7.1, 47.9, 46.9),
    Stop("pos+vel", 1.0, 1.7, 5.0, 33.6, 10.0),
    Stop("velocity", 1.0, 1.7, 5.1, 27.9, 26.9),
    Stop("pos+vel", 0.3, 1.0, 4.3, 26.8, 3.0),
    Stop("velocity", 0.3, 1.0, 4.4, 20.8, 19.9),
)


def end_stream(row: Stop) -> Stop:
    """Fly straight at 10 m/s for 35 s, end the stream, and measure."""
    it, last = hovering(GUID_TIMEOUT=row.timeout_s, WPNAV_SPEED=1000.0), 3490
    target = Target(Sine(0.0, 1.0, 400.0, 0.02), 10.0)

    def send(k: int, _: Any) -> None:
        if k <= last:
            target.tell(it, k * STEP_S, row.kind)

    seen = _flown(it, 65.0, 10.0, send)
    after = seen.step >= last
    ahead_m = seen.ne_m[after].real - target.moved(last * STEP_S)[0]
    after_s = (seen.step[after] + 1 - last) * STEP_S
    brakes_s, still_s = (after_s[seen.moves_m_s[after].real < slow][0] for slow in (9.5, 0.1))
    return Stop(row.kind, row.timeout_s, brakes_s, still_s, ahead_m.max(), ahead_m[-1])


# --- PX4's multicopter: px4.md 5 ------------------------------------------------------------------

Eight = namedtuple("Eight", "kind speed_m_s rate_hz real")
"""One row of the table: what is sent, and how it was followed."""
EIGHTS: Final = tuple(
    Eight(kind, float(speed), float(rate), Tracking(*map(float, re.findall(r"[-.\d]+", figures))))
    for speed, kind, rate, figures in re.findall(
        r"^\| (\d+) \| ((?:pos|vel).*?) \| (\d+) \| (.*) \|$", _page("px4"), re.MULTILINE
    )
)


def fly_eight(row: Eight) -> Tracking:
    """A figure eight of least radius 50 m, with 3 m of height up and down; measured 2 s after the
    target has gathered its speed, at 9 s at least."""
    rig, length_m = hover(20.0), 756.0
    route = Sine(SWING_RAD, length_m, length_m, 0.02)
    target = Target(route, row.speed_m_s, 2.0, 20.0, wave_m=3.0, wave_length_m=length_m)

    def send(k: int, _: Any) -> None:
        target.tell(rig, k * STEP_S, row.kind, yaw=True)

    since_s = max(9.0, row.speed_m_s / target.ramp_m_s2 + 2.0)
    return target.left_behind(_flown(rig, 42.0, row.rate_hz, send), since_s)


# --- planes: aimed from the point of the route nearest to where the vehicle was -------------------

Off = namedtuple("Off", "rms_m most_m speed_m_s")
"""How far off a route a plane flew, and how fast over the ground."""


Aim = Callable[[int], object]
Span = tuple[float, float]


def _followed(
    rig: Rig, route: Sine, aim: Aim, hz: float, counts_s: Span, *, begin: int = 0, age: int = 0
) -> Off:
    """Aim from the point nearest to where the vehicle was, so many looks ago; from when to when it
    counts how far off it is."""
    index, (since_s, seconds) = begin, counts_s

    def send(_: int, seen: Sequence[Any]) -> None:
        nonlocal index
        here = seen[-age][1] if len(seen) > age > 0 else complex(*rig.ne_m)
        index, _ = route.nearest(here, index)
        aim(index)

    seen = _flown(rig, seconds, hz, send)
    there = seen.step * STEP_S >= since_s
    off_m = route.followed(seen.ne_m, begin)[1][there]
    return Off(_rms(off_m), np.abs(off_m).max(), np.abs(seen.moves_m_s[there]).mean())


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


def fly_look_ahead(row: LookAhead) -> Off:
    """At an airspeed of 20 m/s along a route that swings by 25 deg; its first 400 m apart."""
    swing_rad, speed_m_s = math.radians(25.0), 21.0
    # curvature at most swing * 2 pi / wave = lateral / speed^2
    wave_m = swing_rad * math.tau * speed_m_s**2 / row.lateral_m_s2
    route, rig = Sine(swing_rad, wave_m, 6000.0, 1.0), circling(0.0, AIRSPEED_CRUISE=20.0)
    rig.put_at(rig.place(0.0, 0.0, 80.0), 20.0 + 0j)

    def send(nearest: int) -> None:
        there = route.at[route.ahead(nearest, row.ahead_m)]
        rig.reposition(*_flat(there, 80.0), row.radius_m)

    return _followed(rig, route, send, 4.0, (20.0, 100.0), age=AGE)


# --- PX4's fixed wing: px4.md 10 ------------------------------------------------------------------

_START = 3022
"""Where flights begin: what DO_REPOSITION measures in 70 s depends on it (30 to 51 m rms)."""
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
    """Along a figure eight of least radius 100 m, 1511 m long, whose heading goes with the cosine;
    the last 70 of 95 s count."""
    length_m, height_m, asked_m_s = SWING_RAD * math.tau * 100.0, 70.0, 14.0
    route, sent = Sine(SWING_RAD, length_m, length_m, length_m / 6044, math.pi / 2.0), 0
    begins, heading_rad = route.at[_START], float(route.heading_rad[_START])
    rig = cruising(begins.real, begins.imag, heading_rad)

    def send(nearest: int) -> None:
        nonlocal sent
        sent += 1
        index = route.ahead(nearest, _told(row.name, "m", 0.0))
        at, way, bend_1_m = route.at[index], route.way[index], route.curvature_1_m[index]
        if row.name.startswith("DO_REPOSITION"):
            rig.reposition(*_flat(at, height_m))
            return
        if sent == 3:
            rig.set_mode("Offboard")
        lateral = asked_m_s**2 * bend_1_m * (-1.0 if "- acc" in row.name else 1.0)
        vectors = _flat(asked_m_s * way), _flat(1j * lateral * way)  # that speed means nothing
        given = ("vel" in row.name) + ("acc" in row.name)
        rig.aim(_flat(at, -height_m), *vectors[:given])

    return _followed(rig, route, send, _told(row.name, "Hz", 10.0), (25.0, 95.0), begin=_START)
