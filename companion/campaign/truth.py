"""What a curve truly is, measured without a line of companion's code for curves or clearance.

Curves are evaluated by scipy's BSpline. The distance to the terrain is the true Euclidean one: the
solid is the union of what lies under each mountain (eq. 1, the highest counts) and under the
plain, so the distance to it is the least of the distances to each. For one mountain the nearest
point is found on ever finer grids, for every sample for which a bound that needs no search does
not show it to be far.
"""

import math
from typing import NamedTuple

import numpy as np
import shapely
from scipy.interpolate import BSpline
from scipy.ndimage import map_coordinates, maximum_filter
from scipy.spatial import cKDTree

from companion.geodesy import FloatArray
from companion.planner.settings import Task
from companion.world.terrain import ArrayTerrain, Peak, PeakTerrain
from companion.world.zones import CircleZone, Zone

_STEEPEST = math.sqrt(2.0) * math.exp(-0.5)  # of exp(-x^2), times height over spread: 0.858
_GRID = np.stack(np.meshgrid(*2 * [np.linspace(-1.0, 1.0, 11)]), axis=-1).reshape(-1, 2)
_FINER = 0.4
"""Each grid has two cells of the one before to each side of the nearest point on that."""
_FINEST_M = 0.01
"""Half a side: then the distance is right to a tenth of a millimetre."""
_STOPPED_M = 1.0
_JUMP = 1e-6
_STILL = 1e-6  # of the fastest: far above rounding, and the next sample is a metre away
_PART = 4_000
"""Points that are looked at together."""


class Curve(NamedTuple):
    """Samples of a curve: length (S,), the rest (S, 3)."""

    length_m: FloatArray
    points_nea_m: FloatArray
    first: FloatArray
    second: FloatArray

    @property
    def curvature_1_m(self) -> FloatArray:
        """Horizontal, signed: positive turns from north to east; 0 where the curve stands still.

        It does where control points coincide; a real corner there shows at the samples beside it.
        """
        (n1, e1), (n2, e2) = self.first[:, :2].T, self.second[:, :2].T
        speed = np.hypot(n1, e1)
        stands = speed <= _STILL * speed.max()
        return np.where(stands, 0.0, (n1 * e2 - e1 * n2) / np.where(stands, 1.0, speed) ** 3)


def spline(control_nea_m: FloatArray) -> BSpline:
    """The clamped cubic B-spline over 0 <= u <= 1 with uniform inner knots."""
    inner = np.linspace(0.0, 1.0, len(control_nea_m) - 2)
    return BSpline(np.concatenate([np.zeros(3), inner, np.ones(3)]), control_nea_m, 3)


def sampled(control_nea_m: FloatArray, spacing_m: float) -> Curve:
    """The curve at about equal spacing, ends included."""
    curve = spline(control_nea_m)
    table = np.linspace(0.0, 1.0, 4001)
    speed = np.linalg.norm(curve.derivative()(table), axis=-1)
    middle = np.linalg.norm(curve.derivative()(table[:-1] + 0.5 / 4000.0), axis=-1)
    steps = (speed[:-1] + 4.0 * middle + speed[1:]) / 24000.0  # Simpson
    along = np.concatenate([[0.0], np.cumsum(steps)])
    count = max(math.ceil(along[-1] / spacing_m), 2)
    length = np.linspace(0.0, along[-1], count + 1)
    u = np.interp(length, along, table)
    return Curve(length, curve(u), curve.derivative()(u), curve.derivative(2)(u))


# --- joins


def goes_over(before_nea_m: FloatArray, after_nea_m: FloatArray, task: Task) -> bool:
    """Whether a curve begins on the one before without a jump, or at its end, from rest.

    Measured by R in place, in the unit tangent, and in curvature by that of the tightest turn.  Its
    start is projected onto the curve before (Newton from the nearest of 2,000 points).
    """
    before, after = spline(before_nea_m), spline(after_nea_m)
    there, table = after(0.0), np.linspace(0.0, 1.0, 2001)
    if math.dist(before(1.0), there) < _STOPPED_M:
        return True
    u = float(table[np.argmin(np.linalg.norm(before(table) - there, axis=-1))])
    for _ in range(20):
        gap, v, a = before(u) - there, before(u, 1), before(u, 2)
        slope = float(v @ v + gap @ a)
        u = min(max(u - float(gap @ v) / max(slope, 1e-12), 0.0), 1.0)
    place_m, tangent, bend_1_m = (
        float(np.linalg.norm(now - then))
        for now, then in zip(_course(after, 0.0), _course(before, u), strict=True)
    )
    by_range, bent = place_m / task.settings.scan_range_m, bend_1_m * task.limits.turn_radius_m
    return max(by_range, tangent, bent) <= _JUMP


def _course(curve: BSpline, u: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place, unit tangent and curvature vector dt/ds; (3,) each."""
    v, a = curve(u, 1), curve(u, 2)
    speed2 = max(float(v @ v), 1e-18)
    tangent = v / math.sqrt(speed2)
    return curve(u), tangent, (a - float(a @ tangent) * tangent) / speed2


# --- terrain


def height_m(
    terrain: PeakTerrain | ArrayTerrain, north_m: FloatArray, east_m: FloatArray
) -> FloatArray:
    """Eq. 1, the highest of all peaks and the plain; or bilinear.  (...) x2 -> (...)."""
    if isinstance(terrain, ArrayTerrain):
        rows = (north_m - terrain.south_m) / terrain.spacing_m
        columns = (east_m - terrain.west_m) / terrain.spacing_m
        at = np.broadcast_arrays(rows, columns)
        heights = terrain.heights_m.astype(np.float64)
        return np.asarray(map_coordinates(heights, at, order=1, mode="nearest"))
    result = np.full(np.broadcast_shapes(north_m.shape, east_m.shape), terrain.ground_amsl_m)
    for peak in terrain.peaks:
        x = (north_m - peak.north_m) / peak.spread_north_m
        y = (east_m - peak.east_m) / peak.spread_east_m
        # on a lattice, rows (N, 1) and columns (1, M), the exponentials are few
        np.maximum(result, peak.height_amsl_m * np.exp(-x * x) * np.exp(-y * y), out=result)
    return result


def terrain_distance_m(
    points_nea_m: FloatArray, terrain: PeakTerrain | ArrayTerrain, up_to_m: float
) -> FloatArray:
    """Distance of points to the ground, at most up_to_m; negative inside.  (S, 3) -> (S,)."""
    if isinstance(terrain, ArrayTerrain):
        return _array_distance_m(points_nea_m, terrain, up_to_m)
    parts = range(0, len(points_nea_m), _PART)
    return np.concatenate(
        [_peaks_distance_m(points_nea_m[k : k + _PART], terrain, up_to_m) for k in parts]
    )


def _peaks_distance_m(points_nea_m: FloatArray, terrain: PeakTerrain, up_to_m: float) -> FloatArray:
    """As above, of points that are near to each other: most peaks are too far to look at."""
    result = np.minimum(points_nea_m[:, 2] - terrain.ground_amsl_m, up_to_m)
    low = float(points_nea_m[:, 2].min())
    box = points_nea_m[:, :2].min(axis=0) - up_to_m, points_nea_m[:, :2].max(axis=0) + up_to_m
    for peak in terrain.peaks:
        nearest = np.clip((peak.north_m, peak.east_m), *box)
        if _peak_height_m(peak, nearest[None, :])[0] < low - up_to_m:
            continue
        steepest = _STEEPEST * peak.height_amsl_m / min(peak.spread_north_m, peak.spread_east_m)
        above = points_nea_m[:, 2] - _peak_height_m(peak, points_nea_m[:, :2])
        inside = above <= 0.0
        result[inside] = np.minimum(result[inside], above[inside])
        near = ~inside & (above / math.hypot(1.0, steepest) < result)
        aside = np.hypot(points_nea_m[:, 0] - peak.north_m, points_nea_m[:, 1] - peak.east_m)
        least = np.maximum(aside - up_to_m, 0.0) / max(peak.spread_north_m, peak.spread_east_m)
        near &= peak.height_amsl_m * np.exp(-(least**2)) > points_nea_m[:, 2] - up_to_m
        if near.any():
            distance_m = _peak_distance_m(peak, points_nea_m[near], up_to_m)
            result[near] = np.minimum(result[near], distance_m)
    return result


def _array_distance_m(
    points_nea_m: FloatArray, terrain: ArrayTerrain, up_to_m: float
) -> FloatArray:
    """Distance to points of a bilinear surface, up_to_m / 40 apart: too far by 0.1 % at most."""
    corner, cell = np.array([terrain.south_m, terrain.west_m]), terrain.spacing_m
    heights = terrain.heights_m.astype(np.float64)
    last = np.array(heights.shape) - 2
    index = np.floor((points_nea_m[:, :2] - corner) / cell).astype(np.intp)
    rows, columns = np.clip(index, 0, last).T
    near = np.zeros((last[0] + 1, last[1] + 1), dtype=bool)
    near[rows, columns] = True
    near = maximum_filter(near, 2 * math.ceil(up_to_m / cell) + 1)
    four = (heights[:-1, :-1], heights[:-1, 1:], heights[1:, :-1], heights[1:, 1:])
    near &= np.maximum.reduce(four) > float(points_nea_m[:, 2].min()) - up_to_m
    i, j = (a[:, None, None] for a in np.nonzero(near))
    steps = np.linspace(0.0, 1.0, math.ceil(40.0 * cell / up_to_m) + 1)
    u, v = steps[:, None], steps[None, :]
    height = (1 - u) * ((1 - v) * heights[i, j] + v * heights[i, j + 1]) + u * (
        (1 - v) * heights[i + 1, j] + v * heights[i + 1, j + 1]
    )
    north, east = corner[0] + cell * (i + u), corner[1] + cell * (j + v)
    surface = np.stack(np.broadcast_arrays(north, east, height), axis=-1).reshape(-1, 3)
    result = np.full(len(points_nea_m), up_to_m)
    if len(surface):
        away, _ = cKDTree(surface).query(points_nea_m, distance_upper_bound=up_to_m)
        np.minimum(result, away, out=result)
    above = points_nea_m[:, 2] - height_m(terrain, points_nea_m[:, 0], points_nea_m[:, 1])
    return np.where(above <= 0.0, above, result)


def _peak_height_m(peak: Peak, at_ne_m: FloatArray) -> FloatArray:
    x = (at_ne_m[..., 0] - peak.north_m) / peak.spread_north_m
    y = (at_ne_m[..., 1] - peak.east_m) / peak.spread_east_m
    return peak.height_amsl_m * np.exp(-x * x - y * y)


def _peak_distance_m(peak: Peak, points_nea_m: FloatArray, up_to_m: float) -> FloatArray:
    """Distance of points above one mountain to its surface, at most up_to_m.  (S, 3) -> (S,)."""
    at, up = points_nea_m[:, None, :2], points_nea_m[:, None, 2]
    centre, nearest, half_m = at, np.full(len(points_nea_m), up_to_m), up_to_m
    while half_m > _FINEST_M:
        feet = centre + half_m * _GRID  # (S, G, 2)
        above = np.maximum(up - _peak_height_m(peak, feet), 0.0)
        away = np.sqrt(np.sum((feet - at) ** 2, axis=-1) + above**2)
        best = np.argmin(away, axis=1)[:, None]
        nearest = np.minimum(nearest, np.take_along_axis(away, best, axis=1)[:, 0])
        centre, half_m = np.take_along_axis(feet, best[:, :, None], axis=1), _FINER * half_m
    return nearest


# --- bounds


def zone_clearance_m(points_nea_m: FloatArray, zone: Zone) -> FloatArray:
    """Signed horizontal distance to what a zone bars: of a keep-in, all around.  (S, 3) -> (S,)."""
    at = points_nea_m[:, :2]
    if isinstance(zone, CircleZone):
        outside_m = np.linalg.norm(at - (zone.north_m, zone.east_m), axis=-1) - zone.radius_m
    else:
        area, points = shapely.Polygon(zone.vertices_ne_m), shapely.points(at)
        away_m = np.asarray(shapely.distance(points, area.exterior), dtype=np.float64)
        outside_m = np.where(shapely.contains(area, points), -away_m, away_m)
    return -outside_m if zone.keep_in else outside_m


class Measures(NamedTuple):
    """The worst of everything over one curve."""

    clearance_m: float
    """True distance to the terrain; at most twice what is required."""
    zones_m: float
    turn_radius_m: float
    climb_rad: float
    dive_rad: float
    lowest_amsl_m: float
    highest_amsl_m: float
    off_map_m: float

    def violations(self, task: Task) -> tuple[str, ...]:
        """The bounds of a task that are broken by more than rounding."""
        limits, required_m = task.limits, task.required_clearance_m
        inset, little = task.error_m, 1e-6
        bounds = (
            ("terrain clearance", self.clearance_m >= required_m - 0.01),
            ("keep-out zone", self.zones_m >= required_m - 0.01),
            ("turn radius", self.turn_radius_m >= limits.turn_radius_m * (1.0 - little)),
            ("climb angle", self.climb_rad <= limits.climb_angle_rad + little),
            ("dive angle", self.dive_rad <= limits.dive_angle_rad + little),
            ("floor of the band", self.lowest_amsl_m >= limits.floor_amsl_m + inset - 0.01),
            ("ceiling of the band", self.highest_amsl_m <= limits.ceiling_amsl_m - inset + 0.01),
            ("edge of the map", self.off_map_m <= 0.01),
        )
        return tuple(name for name, kept in bounds if not kept)


def measure(curve: Curve, terrain: PeakTerrain | ArrayTerrain, task: Task) -> Measures:
    """Everything about one sampled curve."""
    points, limits = curve.points_nea_m, task.limits
    climb_rad = np.arctan2(curve.first[:, 2], np.hypot(*curve.first[:, :2].T))
    low, high = points.min(axis=0), points.max(axis=0)
    least, most = np.transpose((limits.north_m, limits.east_m))
    clearance = terrain_distance_m(points, terrain, 2.0 * task.required_clearance_m)
    aside = [float(zone_clearance_m(points, zone).min()) for zone in task.zones]
    return Measures(
        clearance_m=float(clearance.min()),
        zones_m=min(aside, default=math.inf),
        turn_radius_m=float(1.0 / max(np.abs(curve.curvature_1_m).max(), 1e-9)),
        climb_rad=float(climb_rad.max()),
        dive_rad=float(-climb_rad.min()),
        lowest_amsl_m=float(low[2]),
        highest_amsl_m=float(high[2]),
        off_map_m=max(float(np.max([least - low[:2], high[:2] - most])), 0.0),
    )
