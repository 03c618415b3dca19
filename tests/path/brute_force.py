"""What a certificate is measured by: random scenes, and the truth about a curve by search.

Shares nothing with the proof: the curve is scipy's, columns are compared one by one, minima are
refined by scipy's minimisers from dense samples.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import planning
from planning import ARDUCOPTER, drawn_zones, spline, zones_distance_m
from scipy.optimize import minimize, minimize_scalar

from companion.geodesy import FloatArray
from companion.path.certificate import Certificate, certify
from companion.path.envelope import Envelope
from companion.path.limits import Limits
from companion.path.proof import Surroundings
from companion.path.subpath import Subpath
from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import KnownMap, empty_map
from companion.world.simulated import true_map


@dataclass(frozen=True, kw_only=True)
class Case:
    """A curve and what it is flown in."""

    control_nea_m: FloatArray
    from_rest: bool
    known: KnownMap
    task: Task

    def certificate(self) -> Certificate:
        subpath = Subpath(control_nea_m=self.control_nea_m)
        return certify(subpath, self.surroundings(), from_rest=self.from_rest)

    def surroundings(self) -> Surroundings:
        north, east = self.control_nea_m.mean(axis=0)[:2].tolist()
        far = np.hypot(*(self.control_nea_m[:, :2] - (north, east)).T).max()
        return self.task.surroundings(self.known, (north, east), float(far))


class Scale(NamedTuple):
    cell_m: float
    cells: int
    distance_m: float
    error_m: float
    speed_m_s: float
    acceleration_m_s2: float
    turn_radius_m: float
    relief_m: float
    dead_man_s: float = 3.5
    overruns_m: tuple[float, ...] = (np.inf,)


NEAR = 1.0, (0.3, 0.5, 1.0, np.inf)
SCALES = (
    Scale(250.0, 44, 500.0, 15.0, 150.0, 5.0, 1_200.0, 1_500.0),
    Scale(19.0, 40, 40.0, 6.0, 8.0, 2.5, 40.0, 150.0),
    Scale(25.0, 56, 200.0, 10.0, 30.0, 4.0, 150.0, 300.0),
    Scale(0.25, 80, 0.5, 0.45, 3.0, 2.5, 6.0, 4.0, *NEAR),
    Scale(0.625, 90, 1.0, 0.9, 5.0, 2.5, 8.0, 8.0, *NEAR),
)


def random_case(rng: np.random.Generator) -> Case:
    """A curve over random terrain, near what is just safe."""
    scale = SCALES[rng.integers(len(SCALES))]
    size = scale.cell_m * scale.cells
    known = _terrain(rng, scale, size)
    if rng.random() < 0.4:
        known.upper_m[rng.random(known.upper_m.shape) < 0.003] = np.inf
    limits = Limits(
        speed_m_s=scale.speed_m_s,
        acceleration_m_s2=scale.acceleration_m_s2,
        climb_rate_m_s=5.0,
        turn_radius_m=scale.turn_radius_m,
        climb_angle_rad=0.25,
        dive_angle_rad=0.3,
        floor_amsl_m=-scale.relief_m,
        ceiling_amsl_m=4.0 * scale.relief_m,
        north_m=(0.0, size),
        east_m=(0.0, size),
        dead_man_s=scale.dead_man_s,
        tracking_error_m=scale.error_m,
        navigation_error_m=0.0,
        overrun_m=float(rng.choice(scale.overruns_m)),
        loiter_radius_m=scale.distance_m * rng.uniform(0.3, 1.5) if rng.random() < 0.2 else 0.0,
    )
    count = int(rng.choice([0, 0, 1, 2]))
    zones = drawn_zones(rng, count, 0.5 * size, 0.5 * size, 0.15 * size, 0.3)
    settings = PlannerSettings(
        scan_range_m=size, safety_distance_m=scale.distance_m, planning_time_s=1.0
    )
    count = int(rng.integers(0, 3))
    radars = tuple(planning.radar(*rng.uniform(0, size, 2), 0.15 * size) for _ in range(count))
    handling = replace(ARDUCOPTER, settling_s=0.4)
    return Case(
        control_nea_m=_control(rng, size, scale.distance_m + scale.error_m, known),
        from_rest=bool(rng.random() < 0.3),
        known=known,
        task=Task(limits=limits, settings=settings, handling=handling, radars=radars, zones=zones),
    )


def _terrain(rng: np.random.Generator, scale: Scale, size: float) -> KnownMap:
    """Peaks, pillars on rough ground, or a rough slope."""
    like = empty_map(scale.cell_m, (0.0, size), (0.0, size))
    kind = rng.integers(3)
    if kind == 0:
        low, high = (0.0, 0.0, 0.3, 0.08, 0.08), (1.0, 1.0, 1.0, 0.3, 0.3)
        drawn = rng.uniform(low, high, (int(rng.integers(1, 7)), 5))
        return true_map(
            planning.hills(*(drawn * [size, size, scale.relief_m, size, size]).tolist()), like
        )
    heights = rng.uniform(0.0, 0.15 * scale.relief_m, like.upper_m.shape)
    if kind == 1:
        heights += scale.relief_m * (rng.random(heights.shape) < 0.003)
    else:
        heights += np.linspace(0.0, rng.uniform(0.0, scale.relief_m), scale.cells)[:, None]
    registration_m = float(rng.choice([0.0, 0.0, 0.1, 0.35])) * scale.cell_m
    return replace(like, upper_m=heights, seen=~like.seen, registration_m=registration_m)


def _control(
    rng: np.random.Generator, size: float, clearance_m: float, known: KnownMap
) -> FloatArray:
    """Some way across the middle of the map, about the clearance above what is below it."""
    points = int(rng.integers(4, 8))
    heading = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(rng.normal(0.0, 0.3, points - 1))
    climb = rng.uniform(-0.1, 0.1) * 0.6 ** np.arange(points - 1) + rng.normal(0, 0.05, points - 1)
    leg = rng.uniform(0.25, 0.55) * size / (points - 1) * rng.uniform(0.6, 1.4, points - 1)
    steps = leg[:, None] * np.stack([np.cos(heading), np.sin(heading), np.tan(climb)], axis=-1)
    result = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    result += np.array([*rng.uniform(0.46 * size, 0.54 * size, 2), 0.0]) - result.mean(axis=0)
    track = spline(result)(np.linspace(0.0, 1.0, 60))
    cells = np.clip((track[:, :2] / known.cell_m).astype(int), 0, len(known.upper_m) - 1)
    under = known.upper_m[tuple(cells.T)]
    above = (track[:, 2] - under)[np.isfinite(under)].min(initial=np.inf)
    result[:, 2] += clearance_m * rng.uniform(0.9, 1.9) - (above if np.isfinite(above) else 0.0)
    if rng.random() < 0.05:
        result[1] = result[0]
    return result


def column_distance_m(
    known: KnownMap, points_nea_m: FloatArray, within_m: float = np.inf
) -> FloatArray:
    """Distance of points from every column of the map and from its edges.  (S, 3) -> (S,).

    within_m: columns farther than this need not count.
    """
    low = np.array([known.north_min_m, known.east_min_m])
    inside = points_nea_m[:, :2] - low
    edge = np.minimum(inside, np.array(known.shape) * known.cell_m - inside).min(axis=1)
    edge = np.maximum(edge - known.registration_m, 0.0)
    return np.minimum(planning.column_distance_m(known, points_nea_m, within_m), edge)


def terrain_m(case: Case, points_nea_m: FloatArray, within_m: float = np.inf) -> FloatArray:
    """Distance of the vehicle, or of its circle, from the terrain.  (S, 3) -> (S,)."""
    turn, loiter_m = np.linspace(0.0, 2.0 * np.pi, 24), case.task.limits.loiter_radius_m
    ring = loiter_m * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1)
    aside = np.concatenate([np.zeros((1, 3)), *((ring, 0.5 * ring) if loiter_m else ())])
    points = points_nea_m[:, None] + aside
    far = column_distance_m(case.known, points.reshape(-1, 3), within_m)
    return far.reshape(points.shape[:2]).min(axis=1)


class Truth(NamedTuple):
    """What a curve comes to: minima and maxima that were met, so never beyond the real ones."""

    clearance_m: float
    keep_out_m: float
    dead_man_m: float
    turn_radius_m: float
    climb_angle_rad: float
    dive_angle_rad: float
    lowest_amsl_m: float
    highest_amsl_m: float
    off_map_m: float
    radar_m: float
    length_m: float
    detection: float


def _least(of: Callable[..., FloatArray], u: FloatArray) -> float:
    """Least value over 0 <= u <= 1: samples, then refined near the three lowest."""
    values = of(u)
    inner = np.pad(values, 1, constant_values=np.inf)
    dips = np.nonzero((inner[1:-1] <= inner[:-2]) & (inner[1:-1] <= inner[2:]))[0]
    least = [float(values.min())]
    for k in dips[np.argsort(values[dips])][:3]:
        found = minimize_scalar(
            lambda at: float(of(np.array([at]), 2.0 * float(values[k]))[0]),  # noqa: B023
            bounds=(float(u[max(k - 1, 0)]), float(u[min(k + 1, len(u) - 1)])),
            method="bounded",
            options={"xatol": 1e-7, "maxiter": 30},
        )
        least.append(float(found.fun))
    return min(least)


def truth(case: Case, samples: int = 200) -> Truth:
    """Everything about a curve, by search; distances up to four times the clearance."""
    curve, far_m = spline(case.control_nea_m), 4.0 * case.task.required_clearance_m
    limits, u = case.task.limits, np.linspace(0.0, 1.0, samples + 1)
    clearance = _least(lambda at, far=far_m: terrain_m(case, curve(at), far), u)
    keep_out = np.inf
    for zone in case.task.zones:
        gap_m = _least(lambda at, _=0.0, z=zone: zones_distance_m((z,), curve(at)), u)  # type: ignore[misc]
        keep_out = min(keep_out, gap_m)
    keep_out -= limits.loiter_radius_m
    fine = np.linspace(0.0, 1.0, 3_001)
    points = curve(fine)
    ends = np.logspace(-9.0, -4.0, 20)
    close = np.concatenate([fine, ends, 1.0 - ends])
    first, second = curve(close, 1), curve(close, 2)
    speed = np.hypot(first[:, 0], first[:, 1])
    moving = speed > 1e-7 * speed.max()
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    slope = first[moving, 2] / speed[moving]
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=-1))])
    n, e, z = points.T
    (south_m, north_m), (west_m, east_m) = limits.north_m, limits.east_m
    off = np.concatenate([south_m - n, n - north_m, west_m - e, e - east_m])
    inside = np.zeros(len(points), dtype=bool)
    detection = 0.0
    for radar in case.task.radars:
        ratio = np.linalg.norm(points - radar.centre_nea_m, axis=-1) / radar.range_m
        inside |= ratio <= 1.0
        detection = max(detection, float(np.where(ratio <= 1, 1 / (1 + ratio**4), 0.0).max()))
    both = 0.5 * (inside[1:].astype(float) + inside[:-1])
    dead_man = min(clearance, keep_out)
    if limits.hovers:
        dead_man = _dead_man(case, curve, fine, lengths)
    return Truth(
        clearance_m=clearance,
        keep_out_m=keep_out,
        dead_man_m=max(dead_man, -1.0),  # how deep inside of a zone is not told
        turn_radius_m=float(1.0 / np.abs(cross[moving] / speed[moving] ** 3).max()),
        climb_angle_rad=float(np.arctan(slope.max())),
        dive_angle_rad=float(np.arctan(-slope.min())),
        lowest_amsl_m=float(z.min()),
        highest_amsl_m=float(z.max()),
        off_map_m=float(max(off.max(), 0.0)),
        radar_m=float((both * np.diff(lengths)).sum()),
        length_m=float(lengths[-1]),
        detection=detection,
    )


def broken_by(told: Any, real: Truth) -> list[str]:
    """The numbers of a certificate that the truth breaks."""
    least = ("clearance_m", "keep_out_m", "dead_man_m", "turn_radius_m", "lowest_amsl_m")
    most = ("climb_angle_rad", "dive_angle_rad", "highest_amsl_m", "off_map_m", "detection")
    wrong = [name for name in least if getattr(told, name) > getattr(real, name) + 2e-6]
    wrong = [n for n in wrong if getattr(told, n) > getattr(real, n) * (1.0 + 1e-9)]
    wrong += [name for name in most if getattr(told, name) < getattr(real, name) - 2e-6]
    return wrong + ["radar_m"] * (told.radar_m < real.radar_m - 0.002 * real.length_m)


def violations(
    control_nea_m: FloatArray, task: Task, known: KnownMap, *, from_rest: bool
) -> list[str]:
    """The bounds of a task that a curve breaks somewhere, in words; empty: none was found."""
    limits = task.limits
    error = limits.tracking_error_m + limits.navigation_error_m
    wanted = task.settings.safety_distance_m + error
    case = Case(
        control_nea_m=control_nea_m,
        from_rest=from_rest,
        known=known,
        task=replace(task, radars=()),
    )
    real = truth(case, samples=400)
    broken = {
        "clearance": min(real.clearance_m, real.keep_out_m) < wanted - 1e-3,
        "dead man": real.dead_man_m < error + task.envelope.aside_m - 1e-3,
        "turn": real.turn_radius_m < limits.turn_radius_m * (1.0 - 1e-6),
        "climb": real.climb_angle_rad > limits.climb_angle_rad + 1e-6,
        "dive": real.dive_angle_rad > limits.dive_angle_rad + 1e-6,
        "floor": real.lowest_amsl_m < limits.floor_amsl_m + error - 1e-3,
        "ceiling": real.highest_amsl_m > limits.ceiling_amsl_m - error + 1e-3,
        "map": real.off_map_m > 1e-3,
    }
    return [name for name, is_broken in broken.items() if is_broken]


def fastest_m_s(it: Envelope, left: FloatArray, flown: FloatArray | None = None) -> FloatArray:
    """The fastest that the reference point may be, by halving what its rules allow."""
    low, high = np.zeros_like(left), np.full_like(left, it.speed_m_s)
    for _ in range(60):
        speed = 0.5 * (low + high)
        brakes = speed**2 / (2.0 * it.braking_m_s2)
        ends = speed * it.dead_man_s + brakes <= left + it.overrun_m
        ends &= speed * it.settling_s + brakes <= left
        if flown is not None:
            ends &= speed**2 / (2.0 * it.gaining_m_s2) <= flown
        low, high = np.where(ends, speed, low), np.where(ends, high, speed)
    return low


def _dead_man(case: Case, spline: Any, fine: FloatArray, lengths: FloatArray) -> float:
    """Least distance over all straight stretches that leave the curve, level for those that climb.

    So low is a vehicle at the worst that brakes upwards at once and ahead as it can.
    """
    motion = case.task.envelope

    def at(u: FloatArray, share: FloatArray) -> FloatArray:
        flown = np.interp(u, fine, lengths)
        left = np.maximum(lengths[-1] - flown, 0.0)
        speed = fastest_m_s(motion, left, flown if case.from_rest else None)
        brakes = speed**2 / (2.0 * case.task.limits.acceleration_m_s2)
        velocity = spline(u, 1)
        size = np.linalg.norm(velocity, axis=-1)[..., None]
        reach = share * (speed * motion.dead_man_s + brakes)
        velocity[..., 2] = np.minimum(velocity[..., 2], 0.0)
        return np.asarray(spline(u) + reach[..., None] * velocity / np.maximum(size, 1e-9))

    def distance(
        points: FloatArray, far: float = 4.0 * case.task.required_clearance_m
    ) -> FloatArray:
        return np.minimum(
            column_distance_m(case.known, points, far), zones_distance_m(case.task.zones, points)
        )

    u, share = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, 50), np.linspace(0, 1, 14)))
    values = distance(at(u, share))
    k = int(values.argmin())
    best, where = float(values[k]), np.array([u[k], share[k]])
    if best <= 0.0:
        return best
    found = minimize(
        lambda x: float(distance(at(np.clip(x[:1], 0, 1), np.clip(x[1:], 0, 1)), 2 * best)[0]),
        where,
        method="Nelder-Mead",
        options={"maxfev": 60, "xatol": 1e-6, "fatol": 1e-4,
                 "initial_simplex": where + np.array([[0, 0], [0.01, 0], [0, 0.04]])},
    )  # fmt: skip
    return min(best, float(found.fun))
