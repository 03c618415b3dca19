"""How the four autopilots follow setpoints: what the documents measured, and the same flown here.

ardupilot.md 3 (ArduCopter: routes with a sinusoidal heading, streams that stop, targets that jump)
and 7 (ArduPlane), px4.md 5 (multicopter) and 10 (fixed wing); their tables with their figures, the
rigs that fly them, and how it is measured there.
"""

import copy
import functools
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final, Literal, NamedTuple, final

import numpy as np
from harness import NAN, STEP_S, STRONG, ZERO, Rig, Vector

from vehicle_sim.autopilot.px4plane import SIH_AIRPLANE
from vehicle_sim.autopilot.values import Result, SendMessage
from vehicle_sim.dynamics.copter import Copter, Limits
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.faults import GpsConditions
from vehicle_sim.geodesy import FloatArray, LocalFrame, metres_per_degree
from vehicle_sim.sensors.gps import ARDUPLANE, PX4, Fix, Gps

POSITION, POSITION_VELOCITY, ALL_THREE, VELOCITY = 0xDF8, 0xDC0, 0xC00, 0xDC7
"""Masks of setpoints."""
SWING_RAD: Final = 2.404825557695773
"""First zero of J0: a route that swings so far to both sides closes."""
PX4_GPS: Final = GpsConditions(lag_s=0.0)


@final
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


def _followed(
    rig: Any,
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
    rms_m = float(np.sqrt(np.mean(np.square(off_m))))
    return Off(rms_m, float(np.abs(off_m).max()), float(speed_m_s.mean()))


# --- ArduCopter: ardupilot.md 3 -------------------------------------------------------------------

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
MASKS = {"position": POSITION, "pos+vel": POSITION_VELOCITY, "pos+vel+acc": ALL_THREE}
MASKS |= {"velocity": VELOCITY, "GLOBAL pos+vel": POSITION_VELOCITY, "GLOBAL +acc": ALL_THREE}
GUIDED = 4


def fix_of(copter: Copter, now_us: int) -> Fix:
    """A receiver without noise, 0.1 s late, as ArduPilot's estimator expects it."""
    if now_us < 10_000_000:
        return Fix(time_us=now_us, fix_type=0)
    metres_north, metres_east = metres_per_degree(copter.latitude_deg)
    late_s, (north_m_s, east_m_s, up_m_s) = 0.1, copter.velocity_neu_m_s
    north_m = late_s * (north_m_s - 0.5 * late_s * copter.acceleration_north_m_s2)
    east_m = late_s * (east_m_s - 0.5 * late_s * copter.acceleration_east_m_s2)
    return Fix(
        time_us=now_us,
        fix_type=6,
        latitude_deg=copter.latitude_deg - north_m / metres_north,
        longitude_deg=copter.longitude_deg - east_m / metres_east,
        altitude_amsl_m=copter.altitude_amsl_m,
        velocity_north_m_s=north_m_s,
        velocity_east_m_s=east_m_s,
        velocity_up_m_s=up_m_s,
        satellites=10,
    )


class ArduCopter(Rig):
    """An ArduCopter, or the law `ideal`, which is without drag."""

    def __init__(
        self,
        ground_amsl_m: float = GROUND_M,
        limits: Limits = LIMITS,
        *,
        drag: bool = True,
        **parameters: float,
    ) -> None:
        drags = {"drag_1_s": DRAG_1_S, "drag_1_m": DRAG_1_M} if drag else {}
        place = dict(zip(("latitude_deg", "longitude_deg"), HOME_DEG, strict=True))
        self.copter = Copter(**place, altitude_amsl_m=ground_amsl_m, limits=limits, **drags)
        name: Any = "ardupilot" if drag else "ideal"
        super().__init__((name, "copter"), self.copter, parameters)
        self.wind_m_s = (0.0, 0.0)

    def receive(self) -> Fix:
        """Five fixes a second."""
        return fix_of(self.copter, self.now_us) if self.now_us % 200_000 == 0 else self.fix

    def step(self) -> None:
        self.copter.wind_north_m_s, self.copter.wind_east_m_s = self.wind_m_s
        super().step()

    def setpoint(
        self, ned_m: Vector, velocity: Vector = ZERO, acceleration: Vector = ZERO, *, kind: str
    ) -> None:
        """In LOCAL_NED, or as GLOBAL_INT above home."""
        place, fields = ned_m, dict[str, Any]()
        if kind.startswith("GLOBAL"):
            there = self.autopilot.frame.place(*ned_m)
            place = (there.latitude_deg, there.longitude_deg, -ned_m[2])
            fields = {"frame": 6, "is_global": True}
        self.give(place, velocity, acceleration, mask=MASKS[kind], **fields)

    def local_m(self) -> Vector:
        """North, east, up of the start: on the autopilot's flat earth, as setpoints are."""
        north, east, down = self.autopilot.local_ned_m() or ZERO
        return north, east, -down

    def airborne(self, height_m: float = 30.0) -> "ArduCopter":
        """Take off in GUIDED and hover."""
        self.run(42.5)
        assert [self.command(176, 1, GUIDED), self.command(400, 1)] == [0, 0]
        assert self.command(22, 0, 0, 0, 0, 0, 0, height_m) == 0
        self.run_until(lambda: self.autopilot.status().landed_state == 2, within_s=1000.0)
        self.run(3.0)
        return self


class Reference(NamedTuple):
    """Where the route is at one time: north, east, down."""

    position: Vector
    velocity: Vector
    acceleration: Vector


def weave(speed_m_s: float, lateral_m_s2: float, seconds: float) -> Iterator[Reference]:
    """A sinusoidal heading of this lateral acceleration, speed ramped up smoothly at 1 m/s2."""
    ramp_s, climb_m_s = 1.5 * speed_m_s, 1.0
    w, climb_w = math.tau / PERIOD_S, math.tau / 40.0
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


class Tracked(NamedTuple):
    """How a route was followed: means, but for the two that are off the path."""

    along_m: float
    """Negative: behind."""
    off_rms_m: float
    off_max_m: float
    speed_m_s: float
    nose_deg: float
    """Between the nose and the course of the route."""


def follow(
    it: ArduCopter, route: Iterable[Reference], *, kind: str, rate_hz: float, late_s: float = 0.0
) -> Tracked:
    """Stream a route and measure along and off it, as the document does."""
    every, late = round(1.0 / (rate_hz * STEP_S)), round(late_s / STEP_S)
    path: list[Reference] = []
    flown: list[tuple[float, ...]] = []
    for k, at in enumerate(route):
        path.append(at)
        if k % every == 0:
            sent = path[max(k - late, 0)]
            it.setpoint(*sent, kind=kind)
        it.step()
        if k * STEP_S >= 40.0 and k % 10 == 0:
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


class WeaveRow(NamedTuple):
    """One row of the document's table, with its figures."""

    speed_m_s: float
    lateral_m_s2: float
    lean_deg: float
    kind: str
    rate_hz: float
    along_m: float
    off_rms_m: float
    off_max_m: float


WEAVES = (
    WeaveRow(5, 1.0, 30, "position", 10, -10.3, 0.52, 0.8),
    WeaveRow(5, 1.0, 30, "pos+vel", 4, -0.2, 0.64, 0.9),
    WeaveRow(5, 1.0, 30, "pos+vel", 10, -0.1, 0.56, 0.8),
    WeaveRow(5, 1.0, 30, "pos+vel+acc", 10, -0.1, 0.17, 0.3),
    WeaveRow(8, 1.2, 45, "position", 10, -23.9, 1.3, 2.1),
    WeaveRow(8, 1.2, 45, "pos+vel", 10, -0.2, 0.75, 1.1),
    WeaveRow(8, 1.2, 45, "pos+vel+acc", 10, -0.1, 0.25, 0.4),
    WeaveRow(10, 1.5, 45, "position", 4, -36.0, 2.2, 3.6),
    WeaveRow(10, 1.5, 45, "position", 10, -35.0, 2.2, 3.6),
    WeaveRow(10, 1.5, 45, "pos+vel", 4, -0.3, 1.1, 1.6),
    WeaveRow(10, 1.5, 45, "pos+vel", 10, -0.3, 0.96, 1.4),
    WeaveRow(10, 1.5, 45, "pos+vel+acc", 20, -0.2, 0.35, 0.55),
    WeaveRow(10, 1.5, 45, "pos+vel+acc", 4, -0.2, 0.35, 0.55),
    WeaveRow(10, 1.5, 45, "pos+vel+acc", 2, -0.2, 0.35, 0.55),
    WeaveRow(10, 1.5, 45, "pos+vel+acc", 1, -0.1, 0.51, 1.1),
    WeaveRow(10, 1.5, 45, "velocity", 10, -6.8, 0.23, 0.36),
    WeaveRow(10, 1.5, 45, "GLOBAL pos+vel", 10, -0.3, 0.96, 1.4),
    WeaveRow(10, 1.5, 45, "GLOBAL +acc", 10, -0.3, 0.96, 1.4),
    WeaveRow(10, 2.4, 45, "pos+vel+acc", 10, -0.3, 0.53, 0.86),
    WeaveRow(10, 3.5, 45, "pos+vel+acc", 10, -0.5, 0.72, 1.1),
    WeaveRow(15, 1.8, 60, "position", 10, -69.0, 3.5, 5.9),
    WeaveRow(15, 1.8, 60, "pos+vel+acc", 10, -0.3, 0.51, 0.8),
    WeaveRow(10, 1.5, 30, "pos+vel", 10, -4.6, 4.4, 7.8),
    WeaveRow(10, 1.5, 30, "pos+vel+acc", 10, -0.7, 4.7, 11.5),
)


@functools.cache
def _airborne(lean_deg: float, timeout_s: float, height_m: float, wpnav_m_s: float) -> ArduCopter:
    parameters = {"ANGLE_MAX": lean_deg * 100.0, "GUID_TIMEOUT": timeout_s}
    return ArduCopter(**parameters, WPNAV_SPEED=wpnav_m_s * 100.0).airborne(height_m)


def airborne(
    lean_deg: float = 45.0, timeout_s: float = 3.0, height_m: float = 30.0, wpnav_m_s: float = 10.0
) -> ArduCopter:
    """A copy of one that hovers in GUIDED."""
    return copy.deepcopy(_airborne(lean_deg, timeout_s, height_m, wpnav_m_s))


def fly_weave(
    row: WeaveRow, *, seconds: float = 90.0, late_s: float = 0.0, wind_east_m_s: float = 0.0
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


# --- PX4's multicopter: px4.md 5 ------------------------------------------------------------------

Kind = Literal["position", "position + velocity", "pos + vel + acc", "velocity"]
LENGTH_M, GROUND_AMSL_M = 756.0, 488.0
"""The route is a figure eight of least radius 50 m, with 3 m of height up and down."""
PX4_HOME_DEG: Final = (47.397742, 8.545594)
_HEIGHT_M, _WAVE_M = 20.0, 3.0
_RUN_S, _RAMP_M_S2 = 42.0, 2.0
Vector4 = tuple[float, float, float, float]


@final
class Px4Copter(Rig):
    """A PX4 multicopter in still air."""

    def __init__(self, seed: int = 1, **parameters: float) -> None:
        place = dict(zip(("latitude_deg", "longitude_deg"), PX4_HOME_DEG, strict=True))
        self.copter = Copter(**place, altitude_amsl_m=GROUND_AMSL_M, limits=STRONG)
        given = {"SIH_KDV": 0.25, "COM_OBL_RC_ACT": 5.0, **parameters}
        gps = Gps(PX4, np.random.default_rng(seed + 1000))
        super().__init__(("px4", "copter"), self.copter, given, gps, PX4_GPS, seed=seed)
        self.px4 = self.autopilot

    def command(self, number: int, *parameters: float, **fields: Any) -> list[int]:
        """The results that came at once: PX4 does not answer everything."""
        return self.answers(number, *parameters, **fields)

    def send(
        self,
        position: Vector | None = None,
        velocity: Vector | None = None,
        acceleration: Vector | None = None,
        yaw_rad: float | None = None,
        *,
        mask: int | None = None,
        **fields: Any,
    ) -> None:
        """A setpoint; what is None is masked, unless a mask is given."""
        given = (position, velocity, acceleration, yaw_rad)
        bits = (0x007, 0x038, 0x1C0, 0x400)
        masked = sum(bit for bit, what in zip(bits, given, strict=True) if what is None)
        vectors = (vector or ZERO for vector in given[:3])
        mask = 0x800 | masked if mask is None else mask
        self.give(*vectors, mask=mask, yaw_rad=yaw_rad or 0.0, **fields)

    def stream(self, seconds: float, rate_hz: float = 20.0, **setpoint: Any) -> None:
        """The same setpoint again and again."""
        every = round(1.0 / rate_hz / STEP_S)
        for index in range(round(seconds / STEP_S)):
            if index % every == 0:
                self.send(**setpoint)
            self.step()

    def take_off(self, height_m: float = _HEIGHT_M, seconds: float = 16.0) -> None:
        """Boot, OFFBOARD, arm, climb above the origin."""
        target = (0.0, 0.0, -height_m)
        self.run(5.0)
        self.stream(2.5, position=target)
        self.command(176, 1.0, 6.0)
        self.stream(0.2, position=target)
        self.command(400, 1.0)
        self.stream(seconds, position=target)


@final
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
        behind = near_m - index * route.step_m
        laps = round(behind / LENGTH_M)
        return index * route.step_m + laps * LENGTH_M + ahead_m, right_m


class Tracking(NamedTuple):
    """One row of the table: metres and m/s."""

    along_mean_m: float
    along_max_m: float
    cross_rms_m: float
    cross_max_m: float
    altitude_rms_m: float
    speed_m_s: float


class EightRow(NamedTuple):
    """One row of px4.md 5: what was flown and what the real one did."""

    kind: Kind
    speed_m_s: float
    rate_hz: float
    real: Tracking
    """Along is NaN where it was not measured."""
    lead_s: float = 0.0
    """How far ahead of its time the target is sent."""
    carrot_m: float | None = None
    """Position only, this far ahead of the nearest point, whatever the time is."""


def fly_eight(row: EightRow) -> Tracking:
    """One run of 42 s; measured 2 s after the target has gathered its speed, at 9 s at least."""
    rig, curve, ramp_s = Px4Copter(), Curve(), row.speed_m_s / _RAMP_M_S2
    rig.take_off()

    def moved(elapsed_s: float) -> tuple[float, float]:
        """Distance of the target along the curve, and its speed."""
        if elapsed_s < ramp_s:
            return 0.5 * _RAMP_M_S2 * elapsed_s * elapsed_s, _RAMP_M_S2 * elapsed_s
        return row.speed_m_s * (elapsed_s - 0.5 * ramp_s), row.speed_m_s

    every, samples, reached_m = round(1.0 / row.rate_hz / STEP_S), list[Vector4](), 0.0
    for index in range(round(_RUN_S / STEP_S)):
        elapsed_s = index * STEP_S
        if index % every == 0:
            target_m, moving_m_s = moved(elapsed_s)
            target_m += moving_m_s * row.lead_s
            if row.carrot_m is not None:
                target_m = reached_m + row.carrot_m
            position, velocity, acceleration, yaw_rad = curve.at(target_m, moving_m_s)
            rig.send(
                None if row.kind == "velocity" else position,
                None if row.kind == "position" else velocity,
                acceleration if row.kind == "pos + vel + acc" else None,
                yaw_rad,
            )
        rig.step()
        if index % 5 == 0:
            north_m, east_m, down_m = rig.px4.local_m
            reached_m, cross_m = curve.nearest((north_m, east_m), reached_m)
            behind_m = moved(elapsed_s + STEP_S)[0] - reached_m
            high_m = down_m - curve.at(reached_m, row.speed_m_s)[0][2]
            if elapsed_s >= max(9.0, ramp_s + 2.0):
                samples.append((behind_m, cross_m, high_m, rig.speed_m_s))
    along, cross, height, speed = np.array(samples).T
    return Tracking(
        along_mean_m=float(along.mean()),
        along_max_m=float(np.abs(along).max()),
        cross_rms_m=float(np.sqrt((cross**2).mean())),
        cross_max_m=float(np.abs(cross).max()),
        altitude_rms_m=float(np.sqrt((height**2).mean())),
        speed_m_s=float(speed.mean()),
    )


def _row(kind: Kind, speed: float, rate: float, figures: str, lead_s: float = 0.0) -> EightRow:
    return EightRow(kind, speed, rate, Tracking(*map(float, figures.split())), lead_s)


def _carrot(carrot_m: float, *figures: float) -> EightRow:
    real = Tracking(math.nan, math.nan, *figures)
    return EightRow("position", real.speed_m_s, 20.0, real, carrot_m=carrot_m)


_P: Kind = "position"
_PV: Kind = "position + velocity"
_PVA: Kind = "pos + vel + acc"
EIGHTS: tuple[EightRow, ...] = (
    _row(_P, 5.0, 20.0, "5.5 5.8 0.20 0.45 0.13 5.1"),
    _row(_PV, 5.0, 20.0, "0.2 0.7 0.18 0.43 0.16 5.0"),
    _row(_PVA, 5.0, 20.0, "0.3 0.4 0.40 0.80 0.13 5.1"),
    _row(_P, 8.0, 20.0, "8.7 9.0 0.33 0.66 0.13 8.0"),
    _row(_PV, 8.0, 20.0, "0.4 0.7 0.62 1.26 0.12 8.1"),
    _row(_PVA, 8.0, 20.0, "0.5 0.9 0.46 0.96 0.17 8.1"),
    _row(_P, 10.0, 20.0, "10.9 11.2 0.22 0.43 0.14 10.0"),
    _row(_PV, 10.0, 20.0, "0.4 0.6 0.84 1.51 0.11 10.1"),
    _row(_PVA, 10.0, 20.0, "0.7 1.0 0.69 1.10 0.12 10.1"),
    _row(_P, 12.0, 20.0, "15.8 18.8 0.65 1.11 0.23 11.9"),
    _row(_PV, 12.0, 20.0, "5.5 9.2 0.60 0.95 0.12 12.0"),
    _row(_PVA, 12.0, 20.0, "11.0 17.9 0.44 0.96 0.22 11.5"),
    _row("velocity", 8.0, 20.0, "7.3 8.7 0.70 1.34 1.00 8.0"),
    _row(_PV, 8.0, 5.0, "0.9 1.2 0.48 0.70 0.13 8.1"),
    _row(_PVA, 8.0, 5.0, "1.0 1.2 0.41 1.09 0.11 8.0"),
    _row(_PV, 8.0, 10.0, "0.5 0.7 0.40 0.89 0.13 8.0"),
    _row(_PVA, 8.0, 10.0, "0.5 0.8 0.28 0.60 0.16 7.9"),
    _row(_PV, 8.0, 50.0, "0.3 0.7 0.59 1.23 0.22 8.2"),
    _row(_PVA, 8.0, 50.0, "0.3 0.9 0.41 0.81 0.08 8.1"),
    _row(_P, 8.0, 2.0, "10.5 10.8 0.29 0.59 0.09 8.0"),
    _row(_P, 8.0, 5.0, "9.3 9.6 0.21 0.48 0.14 8.0"),
    _row(_PVA, 8.0, 20.0, "-0.8 1.3 0.43 0.87 0.16 8.0", 0.15),
    _row(_PVA, 10.0, 20.0, "0.3 3.1 0.61 1.06 0.07 10.3", 0.15),
    _carrot(5.0, 0.38, 0.75, 0.10, 4.6),
    _carrot(8.0, 0.35, 0.62, 0.10, 7.3),
    _carrot(10.0, 0.30, 0.67, 0.12, 9.2),
)
"""px4.md 5, one row each."""


# --- ArduPlane: ardupilot.md 7 --------------------------------------------------------------------

PLANE_HOME_DEG: Final = (-35.3632621, 149.1652370)
REPOSITION, CHANGE_SPEED, CHANGE_HEADING = 192, 43000, 43002
PLANE_GUIDED, PLANE_TAKEOFF = 15, 13
RADIUS_MOST_M = 600.0
"""Of an osculating circle: the route has straight places."""
AGE_STEPS = 15
"""A client knows where the vehicle was 0.15 s ago: telemetry at 10 Hz, and its own time."""


class ArduPlane(Rig):
    """A plane over flat ground at home."""

    def __init__(self, parameters: dict[str, float] | None = None) -> None:
        place = dict(zip(("latitude_deg", "longitude_deg"), PLANE_HOME_DEG, strict=True))
        self.plane, self.frame = Plane(**place, altitude_amsl_m=584.09), LocalFrame(**place)
        gps = Gps(ARDUPLANE, np.random.default_rng(1))
        super().__init__(("ardupilot", "plane"), self.plane, parameters or {}, gps)

    def set_mode(self, mode: int) -> int:
        return self.command(176, 1.0, mode)

    def reposition(
        self, north_m: float, east_m: float, up_m: float, radius_m: float = 0.0, ccw: float = 0.0
    ) -> int:
        latitude_deg, longitude_deg = self.frame.to_geographic(north_m, east_m)
        return self.command(
            REPOSITION, -1.0, 1.0, radius_m, ccw, latitude_deg, longitude_deg, up_m, frame=3
        )

    def into_the_air(self, height_m: float = 80.0) -> None:
        """Take off by TAKEOFF, then GUIDED, on the way to this height above home."""
        if self.now_s < 24.0:
            self.run(24.0 - self.now_s)
        assert self.set_mode(PLANE_TAKEOFF) is Result.ACCEPTED
        assert self.command(400, 1.0) is Result.ACCEPTED
        self.run_until(lambda: self.height_m > 48.0)
        assert self.reposition(0.0, 0.0, height_m) is Result.ACCEPTED

    @property
    def ne_m(self) -> tuple[float, float]:
        return self.frame.to_local(self.plane.latitude_deg, self.plane.longitude_deg)

    def reached(self) -> list[float]:
        """When MISSION_ITEM_REACHED was said."""
        return [time_s for time_s, reply in self.said if isinstance(reply, SendMessage)]


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
        return rig.command(CHANGE_HEADING, 0.0, course_deg, lateral_m_s2, frame=3)

    return send


@functools.cache
def _flying(settle_s: float, parameters: tuple[tuple[str, float], ...]) -> ArduPlane:
    rig = ArduPlane(dict(parameters))
    rig.into_the_air()
    rig.run(settle_s)
    return rig


def flying(parameters: dict[str, float] | None = None, *, settle_s: float = 30.0) -> ArduPlane:
    """A copy of one that has been in the air for so long."""
    return copy.deepcopy(_flying(settle_s, tuple((parameters or {}).items())))


@functools.cache
def _before_the_route() -> ArduPlane:
    """400 m south of home, where routes begin."""
    rig = flying({"AIRSPEED_CRUISE": 20.0}, settle_s=0.0)
    rig.reposition(-900.0, 0.0, 80.0, 10.0)
    rig.run_until(lambda: rig.ne_m[0] < -800.0)
    rig.reposition(-200.0, 0.0, 80.0, 10.0)
    rig.run_until(lambda: rig.ne_m[0] > -410.0)
    return rig


def off_path(law: Law, lateral_m_s2: float, *, hz: float = 4.0) -> Off:
    """At an airspeed of 20 m/s along a route that swings by 25 deg; its first 400 m apart."""
    swing_rad, speed_m_s = math.radians(25.0), 21.0
    # curvature at most swing * 2 pi / wave = lateral / speed^2
    route = Sine(swing_rad, swing_rad * math.tau * speed_m_s**2 / lateral_m_s2, 6000.0, 1.0)
    route.ne_m -= (400.0, 0.0)
    rig = copy.deepcopy(_before_the_route())
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

FixedKind = Literal["pos + vel", "pos + vel + acc", "pos + vel - acc", "position", "reposition"]
_PLANE_HEIGHT_M = 70.0
_START = 3022
"""Where flights begin: what DO_REPOSITION measures in 70 s depends on it (30 to 51 m rms)."""
_LEAD_IN_S, _PLANE_RUN_S = 25.0, 70.0


def fixed_wing_route() -> Sine:
    """A figure eight of least radius 100 m, 1511 m long; its heading goes with the cosine."""
    length_m = SWING_RAD * math.tau * 100.0
    return Sine(SWING_RAD, length_m, length_m, length_m / 6044, math.pi / 2.0)


@functools.cache
def _taken_off(*made_of: Any) -> dict[str, Any]:
    """What a vehicle consists of that has reached Hold."""
    seed, *parameters = made_of
    one = Px4Plane(seed, **dict(parameters))
    one.take_off()
    return vars(one)


@final
class Px4Plane(Rig):
    """A PX4 aeroplane."""

    def __init__(self, seed: int = 1, **parameters: float) -> None:
        self._made_of = seed, *parameters.items()
        place = dict(zip(("latitude_deg", "longitude_deg"), PX4_HOME_DEG, strict=True))
        self.plane = Plane(**place, altitude_amsl_m=GROUND_AMSL_M, limits=SIH_AIRPLANE)
        given = {"COM_OBL_RC_ACT": 5.0, **parameters}
        gps = Gps(PX4, np.random.default_rng(seed + 1000))
        super().__init__(("px4", "plane"), self.plane, given, gps, PX4_GPS, seed=seed)
        self.px4 = self.autopilot

    @property
    def ne_m(self) -> tuple[float, float]:
        """Where it believes to be."""
        north_m, east_m, _ = self.px4.local_m
        return north_m, east_m

    def mode(self, main: int, sub: int = 0) -> int:
        """DO_SET_MODE."""
        return self.command(176, 1.0, float(main), float(sub))

    def send(
        self,
        mask: int,
        position: Vector = (NAN, NAN, NAN),
        velocity: Vector = ZERO,
        acceleration: Vector = ZERO,
    ) -> None:
        """SET_POSITION_TARGET_LOCAL_NED, frame LOCAL_NED."""
        self.give(position, velocity, acceleration, mask=mask)

    def place(self, north_m: float, east_m: float, height_m: float) -> Vector:
        """Latitude, longitude and altitude AMSL of a point of the local frame."""
        place = self.px4.frame.place(north_m, east_m, 0.0)
        return place.latitude_deg, place.longitude_deg, GROUND_AMSL_M + height_m

    def take_off(self, north_m: float = 300.0, height_m: float = 50.0) -> None:
        """As in the recorded flight: NAV_TAKEOFF, arm, until Hold."""
        self.run(6.0)
        self.command(22, 0, 0, NAN, NAN, *self.place(north_m, 0.0, height_m), frame=5)
        self.run(0.5)
        self.command(400, 1.0)
        for _ in range(6000):
            self.step()
            if self.px4.mode_name == "Hold":
                return

    def put(
        self,
        north_m: float,
        east_m: float,
        height_m: float,
        heading_rad: float,
        speed_m_s: float = SIH_AIRPLANE.airspeed_max_m_s,
    ) -> None:
        """Into the air, flying: the state of a plane that has long been on its way."""
        vars(self).update(copy.deepcopy(_taken_off(*self._made_of)))
        plane = self.plane
        plane.stand(GROUND_AMSL_M)
        plane.stands = False
        plane.latitude_deg, plane.longitude_deg, plane.altitude_amsl_m = self.place(
            north_m, east_m, height_m
        )
        plane.heading_rad, plane.roll_rad, plane.airspeed_m_s = heading_rad, 0.0, speed_m_s
        plane.velocity_north_m_s = speed_m_s * math.cos(heading_rad)
        plane.velocity_east_m_s = speed_m_s * math.sin(heading_rad)
        self.step()


class FixedRow(NamedTuple):
    """One line of the table of px4.md 10, and how near the simulator is to be."""

    name: str
    kind: FixedKind
    lead_m: float
    rate_hz: float
    rms_m: float
    most_m: float
    within_m: float
    """Of the rms."""


FIXED_WING: Final = (
    FixedRow("pos + vel, nearest point", "pos + vel", 0.0, 10.0, 3.8, 6.7, 0.6),
    FixedRow("pos + vel, nearest point, 2.5 Hz", "pos + vel", 0.0, 2.5, 3.9, 8.0, 1.0),
    FixedRow("pos + vel, lead 15 m", "pos + vel", 15.0, 10.0, 1.8, 4.1, 1.2),
    FixedRow("pos + vel, lead 20 m", "pos + vel", 20.0, 10.0, 1.1, 3.8, 1.0),
    FixedRow("pos + vel, lead 30 m", "pos + vel", 30.0, 10.0, 1.3, 6.9, 1.3),
    FixedRow("pos + vel, lead 60 m", "pos + vel", 60.0, 10.0, 1.6, 3.0, 1.2),
    FixedRow("pos + vel + acc", "pos + vel + acc", 0.0, 10.0, 7.9, 12.6, 1.2),
    FixedRow("pos + vel - acc (negated)", "pos + vel - acc", 0.0, 10.0, 0.9, 2.2, 0.9),
    FixedRow("pos only, lead 30 m", "position", 30.0, 10.0, 0.8, 1.5, 0.7),
    FixedRow("pos only, lead 60 m", "position", 60.0, 10.0, 5.2, 7.1, 1.0),
    FixedRow("pos only, lead 100 m", "position", 100.0, 10.0, 18.0, 24.5, 2.5),
    FixedRow("DO_REPOSITION at 1 Hz, lead 130 m", "reposition", 130.0, 1.0, 53.0, 86.0, 20.0),
)
"""px4.md 10, "Curve of least radius 100 m", all of it."""


def fly_fixed(row: FixedRow) -> Off:
    """Fly a row: the last 70 of 95 s along the curve count."""
    rig, route = Px4Plane(), fixed_wing_route()
    rig.put(*route.point(_START), _PLANE_HEIGHT_M - 2.0, float(route.heading_rad[_START]))
    sent = 0

    def aim(nearest: int) -> None:
        nonlocal sent
        sent += 1
        if sent == 3 and row.kind != "reposition":
            rig.mode(6)
        _aim(rig, route, route.ahead(nearest, row.lead_m), row.kind)

    return _followed(
        rig,
        route,
        aim,
        hz=row.rate_hz,
        seconds=_LEAD_IN_S + _PLANE_RUN_S,
        counts=lambda time_s, _: time_s >= _LEAD_IN_S,
        begin=_START,
    )


def _aim(rig: Px4Plane, route: Sine, index: int, kind: FixedKind) -> None:
    """Send the point of this index."""
    north_m, east_m = route.point(index)
    if kind == "reposition":
        place = rig.place(north_m, east_m, _PLANE_HEIGHT_M)
        rig.command(192, -1.0, 1.0, 0.0, NAN, *place, frame=5)
        return
    heading, bend = float(route.heading_rad[index]), float(route.curvature_1_m[index])
    speed_m_s = 14.0  # asked for; the size of the velocity means nothing
    ahead_n, ahead_e = math.cos(heading), math.sin(heading)
    lateral = speed_m_s**2 * bend * (-1.0 if kind == "pos + vel - acc" else 1.0)
    masks = {"position": POSITION, "pos + vel": POSITION_VELOCITY}
    rig.send(
        masks.get(kind, ALL_THREE),
        (north_m, east_m, -_PLANE_HEIGHT_M),
        (speed_m_s * ahead_n, speed_m_s * ahead_e, 0.0),
        (-lateral * ahead_e, lateral * ahead_n, 0.0),
    )
