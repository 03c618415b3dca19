"""Flies an ArduCopter as ardupilot.md section 3 did with the real one, and measures it alike.

Routes with a sinusoidal heading, streams that stop, targets that jump: `table()` gives the rows of
the document with its figures and this vehicle's, for tests and for whoever prints them.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from rig import STEP_S, Rig

from vehicle_sim.autopilots.ardupilot.arducopter import ArduCopter
from vehicle_sim.autopilots.ardupilot.flat_earth import flat_earth_place
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
POSITION, POSITION_VELOCITY, ALL, VELOCITY = 0xDF8, 0xDC0, 0xC00, 0xDC7
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

    def __init__(self, **parameters: float) -> None:
        self.copter = Copter(
            latitude_deg=HOME_DEG[0],
            longitude_deg=HOME_DEG[1],
            altitude_amsl_m=GROUND_M,
            limits=LIMITS,
            drag_1_s=DRAG_1_S,
            drag_1_m=DRAG_1_M,
        )
        rng = np.random.default_rng(1)
        autopilot = ArduCopter(self.copter, parameters, Plans(), hardware_id=1, rng=rng)
        super().__init__(autopilot, GROUND_M)
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
        mask: int,
        is_global: bool = False,
    ) -> None:
        """In LOCAL_NED, or as GLOBAL_INT above home."""
        position, frame = ned_m, 1
        if is_global:
            origin = self.autopilot.ekf.origin
            assert origin is not None
            there = flat_earth_place(origin, ned_m)
            position, frame = (there.latitude_deg, there.longitude_deg, -ned_m[2]), 6
        self.give(
            position,
            velocity_ned_m_s,
            acceleration_ned_m_s2,
            mask=mask,
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
        self.run_until(lambda: self.autopilot.landed_state() == 2, within_s=1000.0)
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
    """How a route was followed."""

    along_m: float
    """Mean; negative: behind."""
    off_rms_m: float
    off_max_m: float
    speed_m_s: float


def follow(
    it: Flown,
    route: Iterator[Reference],
    *,
    mask: int,
    rate_hz: float,
    is_global: bool = False,
    measured_from_s: float = 40.0,
) -> Tracked:
    """Stream a route and measure along and off it, as the document does."""
    every = round(1.0 / (rate_hz * STEP_S))
    path: list[tuple[float, float]] = []
    flown: list[tuple[float, float, float, float]] = []
    along: list[float] = []
    speeds: list[float] = []
    for k, at in enumerate(route):
        if k % every == 0:
            it.setpoint(at.position, at.velocity, at.acceleration, mask=mask, is_global=is_global)
        it.step()
        path.append(at.position[:2])
        if k * STEP_S >= measured_from_s and k % 10 == 0:
            north, east, _ = it.local_m()
            v_n, v_e, _ = at.velocity
            speed = math.hypot(v_n, v_e)
            ahead = (north - at.position[0]) * v_n + (east - at.position[1]) * v_e
            along.append(ahead / speed - speed * STEP_S)  # the step has been flown by now
            copter = it.copter
            speeds.append(math.hypot(copter.velocity_north_m_s, copter.velocity_east_m_s))
            flown.append((north, east, v_n, v_e))
    points = np.asarray(path)
    off = []
    for north, east, _, _ in flown:
        off.append(float(np.hypot(points[:, 0] - north, points[:, 1] - east).min()))
    return Tracked(
        along_m=float(np.mean(along)),
        off_rms_m=float(np.sqrt(np.mean(np.square(off)))),
        off_max_m=max(off),
        speed_m_s=float(np.mean(speeds)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One row of the document's table, with its figures."""

    speed_m_s: float
    lateral_m_s2: float
    lean_deg: float
    kind: str
    mask: int
    rate_hz: float
    along_m: float
    off_rms_m: float
    off_max_m: float
    is_global: bool = False


def _row(
    speed: float,
    lateral: float,
    lean: float,
    kind: str,
    rate: float,
    along: float,
    rms: float,
    most: float,
) -> Row:
    masks = {"position": POSITION, "pos+vel": POSITION_VELOCITY, "pos+vel+acc": ALL}
    masks |= {"velocity": VELOCITY, "GLOBAL pos+vel": POSITION_VELOCITY, "GLOBAL +acc": ALL}
    return Row(
        speed_m_s=speed,
        lateral_m_s2=lateral,
        lean_deg=lean,
        kind=kind,
        mask=masks[kind],
        rate_hz=rate,
        along_m=along,
        off_rms_m=rms,
        off_max_m=most,
        is_global=kind.startswith("GLOBAL"),
    )


ROWS = (
    _row(5, 1.0, 30, "position", 10, -10.3, 0.52, 0.8),
    _row(5, 1.0, 30, "pos+vel", 4, -0.2, 0.64, 0.9),
    _row(5, 1.0, 30, "pos+vel", 10, -0.1, 0.56, 0.8),
    _row(5, 1.0, 30, "pos+vel+acc", 10, -0.1, 0.17, 0.3),
    _row(8, 1.2, 45, "position", 10, -23.9, 1.3, 2.1),
    _row(8, 1.2, 45, "pos+vel", 10, -0.2, 0.75, 1.1),
    _row(8, 1.2, 45, "pos+vel+acc", 10, -0.1, 0.25, 0.4),
    _row(10, 1.5, 45, "position", 4, -36.0, 2.2, 3.6),
    _row(10, 1.5, 45, "position", 10, -35.0, 2.2, 3.6),
    _row(10, 1.5, 45, "pos+vel", 4, -0.3, 1.1, 1.6),
    _row(10, 1.5, 45, "pos+vel", 10, -0.3, 0.96, 1.4),
    _row(10, 1.5, 45, "pos+vel+acc", 20, -0.2, 0.35, 0.55),
    _row(10, 1.5, 45, "pos+vel+acc", 4, -0.2, 0.35, 0.55),
    _row(10, 1.5, 45, "pos+vel+acc", 2, -0.2, 0.35, 0.55),
    _row(10, 1.5, 45, "pos+vel+acc", 1, -0.1, 0.51, 1.1),
    _row(10, 1.5, 45, "velocity", 10, -6.8, 0.23, 0.36),
    _row(10, 1.5, 45, "GLOBAL pos+vel", 10, -0.3, 0.96, 1.4),
    _row(10, 1.5, 45, "GLOBAL +acc", 10, -0.3, 0.96, 1.4),
    _row(10, 2.4, 45, "pos+vel+acc", 10, -0.3, 0.53, 0.86),
    _row(10, 3.5, 45, "pos+vel+acc", 10, -0.5, 0.72, 1.1),
    _row(15, 1.8, 60, "position", 10, -69.0, 3.5, 5.9),
    _row(15, 1.8, 60, "pos+vel+acc", 10, -0.3, 0.51, 0.8),
    _row(10, 1.5, 30, "pos+vel", 10, -4.6, 4.4, 7.8),
    _row(10, 1.5, 30, "pos+vel+acc", 10, -0.7, 4.7, 11.5),
)


def fly(row: Row, *, seconds: float = 90.0) -> Tracked:
    """Fly one row of the table."""
    fast = max(row.speed_m_s, 10.0) * 100.0
    it = Flown(ANGLE_MAX=row.lean_deg * 100.0, WPNAV_SPEED=fast).airborne(30.0)
    route = weave(row.speed_m_s, row.lateral_m_s2, seconds)
    return follow(it, route, mask=row.mask, rate_hz=row.rate_hz, is_global=row.is_global)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A stream at 10 m/s that ends: seconds and metres from its last setpoint."""

    kind: str
    mask: int
    timeout_s: float
    still_s: float
    furthest_m: float
    ends_m: float
    brakes_s: float | None = None


STOPS = (
    Stop(kind="position", mask=POSITION, timeout_s=3.0, still_s=6.4, furthest_m=0.8, ends_m=0.0),
    Stop(
        kind="pos+vel",
        mask=POSITION_VELOCITY,
        timeout_s=3.0,
        brakes_s=3.7,
        still_s=7.1,
        furthest_m=53.7,
        ends_m=30.0,
    ),
    Stop(
        kind="pos+vel+acc",
        mask=ALL,
        timeout_s=3.0,
        brakes_s=3.7,
        still_s=7.1,
        furthest_m=53.7,
        ends_m=30.0,
    ),
    Stop(
        kind="velocity",
        mask=VELOCITY,
        timeout_s=3.0,
        brakes_s=3.7,
        still_s=7.1,
        furthest_m=47.9,
        ends_m=46.9,
    ),
    Stop(
        kind="pos+vel",
        mask=POSITION_VELOCITY,
        timeout_s=1.0,
        brakes_s=1.7,
        still_s=5.0,
        furthest_m=33.6,
        ends_m=10.0,
    ),
    Stop(
        kind="velocity",
        mask=VELOCITY,
        timeout_s=1.0,
        brakes_s=1.7,
        still_s=5.1,
        furthest_m=27.9,
        ends_m=26.9,
    ),
    Stop(
        kind="pos+vel",
        mask=POSITION_VELOCITY,
        timeout_s=0.3,
        brakes_s=1.0,
        still_s=4.3,
        furthest_m=26.8,
        ends_m=3.0,
    ),
    Stop(
        kind="velocity",
        mask=VELOCITY,
        timeout_s=0.3,
        brakes_s=1.0,
        still_s=4.4,
        furthest_m=20.8,
        ends_m=19.9,
    ),
)


def end_stream(row: Stop) -> Stop:
    """Fly straight at 10 m/s, end the stream, and measure."""
    it = Flown(ANGLE_MAX=4500.0, GUID_TIMEOUT=row.timeout_s).airborne(30.0)
    last_m, last_us = 0.0, 0
    for k in range(3500):
        t = k * STEP_S
        ramp = min(t / 15.0, 1.0)
        v = 10.0 * ramp * ramp * (3.0 - 2.0 * ramp)
        if k % 10 == 0:
            north_m, last_us = last_m, it.now_us
            it.setpoint((north_m, 0.0, -30.0), (v, 0.0, 0.0), mask=row.mask)
            begun_m = north_m
        last_m += v * STEP_S
        it.step()
    brakes_us = still_us = 0
    furthest_m = -1e9
    while it.now_us - last_us < 60e6:
        it.step()
        speed = it.copter.velocity_north_m_s
        furthest_m = max(furthest_m, it.local_m()[0] - begun_m)
        if not brakes_us and speed < 9.5:
            brakes_us = it.now_us
        if not still_us and speed < 0.1:
            still_us = it.now_us
    return Stop(
        kind=row.kind,
        mask=row.mask,
        timeout_s=row.timeout_s,
        brakes_s=(brakes_us - last_us) * 1e-6,
        still_s=(still_us - last_us) * 1e-6,
        furthest_m=furthest_m,
        ends_m=it.local_m()[0] - begun_m,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Jump:
    """A jump of the target at 6 m/s (or from hover), pos+vel+acc unless said."""

    kind: str
    mask: int
    ned_m: tuple[float, float, float]
    speed_m_s: float
    peak_m_s: float
    """Of the speed: horizontal, or vertical for a vertical jump."""
    within_s: float
    """Until it is within 1 m for good."""
    overshoot_m: float | None = None
    tilt_deg: float | None = None


JUMPS = (
    Jump(
        kind="5 m sideways",
        mask=ALL,
        ned_m=(0.0, 5.0, 0.0),
        speed_m_s=6.0,
        peak_m_s=6.5,
        within_s=2.6,
        overshoot_m=0.3,
        tilt_deg=24.0,
    ),
    Jump(
        kind="20 m sideways",
        mask=ALL,
        ned_m=(0.0, 20.0, 0.0),
        speed_m_s=6.0,
        peak_m_s=8.1,
        within_s=5.6,
        overshoot_m=0.6,
        tilt_deg=30.0,
    ),
    Jump(
        kind="60 m sideways",
        mask=ALL,
        ned_m=(0.0, 60.0, 0.0),
        speed_m_s=6.0,
        peak_m_s=11.4,
        within_s=10.2,
        overshoot_m=0.9,
        tilt_deg=40.0,
    ),
    Jump(
        kind="200 m ahead, position",
        mask=POSITION,
        ned_m=(200.0, 0.0, 0.0),
        speed_m_s=0.0,
        peak_m_s=10.4,
        within_s=27.0,
        overshoot_m=0.8,
    ),
    Jump(
        kind="200 m ahead, pos+vel(0)",
        mask=POSITION_VELOCITY,
        ned_m=(200.0, 0.0, 0.0),
        speed_m_s=0.0,
        peak_m_s=10.3,
        within_s=24.0,
        overshoot_m=0.8,
    ),
    Jump(
        kind="20 m up",
        mask=ALL,
        ned_m=(0.0, 0.0, -20.0),
        speed_m_s=0.0,
        peak_m_s=2.5,
        within_s=10.0,
    ),
    Jump(
        kind="20 m down",
        mask=ALL,
        ned_m=(0.0, 0.0, 20.0),
        speed_m_s=0.0,
        peak_m_s=1.5,
        within_s=14.0,
    ),
)


def jump(row: Jump) -> Jump:
    """Fly on, move the target, and measure along the jump."""
    it = Flown(ANGLE_MAX=4500.0).airborne(60.0)
    size_m = math.sqrt(sum(part * part for part in row.ned_m))
    unit = tuple(part / size_m for part in row.ned_m)
    north_m, jumped_us, left_us = 0.0, 0, 0
    peak = over_m = tilt_deg = 0.0
    for k in range(7500):
        t = k * STEP_S
        v = min(t, row.speed_m_s)
        jumped = t >= 30.0
        if jumped and not jumped_us:
            jumped_us = left_us = it.now_us
        shift = row.ned_m if jumped else (0.0, 0.0, 0.0)
        target = (north_m + shift[0], shift[1], -60.0 + shift[2])
        if k % 10 == 0:
            it.setpoint(target, (v, 0.0, 0.0), mask=row.mask)
        it.step()
        north_m += v * STEP_S
        if not jumped:
            continue
        is_north, is_east, is_up = it.local_m()
        away = (target[0] - is_north, target[1] - is_east, target[2] + is_up)
        left = sum(a * u for a, u in zip(away, unit, strict=True))
        over_m = max(over_m, -left)
        if math.sqrt(sum(a * a for a in away)) > 1.0:
            left_us = it.now_us
        copter = it.copter
        level = math.hypot(copter.velocity_north_m_s, copter.velocity_east_m_s)
        peak = max(peak, abs(copter.velocity_up_m_s) if row.ned_m[2] else level)
        lean_rad = math.acos(math.cos(copter.roll_rad) * math.cos(copter.pitch_rad))
        tilt_deg = max(tilt_deg, math.degrees(lean_rad))
    return Jump(
        kind=row.kind,
        mask=row.mask,
        ned_m=row.ned_m,
        speed_m_s=row.speed_m_s,
        peak_m_s=peak,
        within_s=(left_us - jumped_us) * 1e-6,
        overshoot_m=over_m,
        tilt_deg=tilt_deg,
    )


def table() -> list[tuple[Row, Tracked]]:
    """Every row, with what this vehicle does."""
    return [(row, fly(row)) for row in ROWS]
