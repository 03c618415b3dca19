"""The dense check: what a subpath must pass before it is flown (design 5.2, its first form).

Every 10 m of the curve (or a fiftieth of d_s, if that is less), against the bounds themselves.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.bspline import climb_angle_rad, horizontal_curvature_1_m
from companion.path.limits import Limits
from companion.path.subpath import Samples, Subpath
from companion.world.clearance import Surface
from companion.world.known_map import KnownMap
from companion.world.threats import KeepOut, Radar

_SPACING_M = 10.0
_FARTHEST_CELLS = 8  # clearance is measured to cells no further than this


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CheckReport:
    """The worst of each bounded quantity over a subpath."""

    clearance_m: float
    """Distance to the nearest known terrain (its cells taken as high as their highest point)."""
    farthest_m: float
    """Clearances are measured up to here."""
    above_safe_m: float
    """Height over the surface that keeps the required clearance; negative: violated."""
    keep_out_m: float
    """Distance to the nearest keep-out zone, infinite without zones."""
    turn_radius_m: float
    climb_angle_rad: float
    dive_angle_rad: float
    lowest_amsl_m: float
    highest_amsl_m: float
    off_map_m: float
    radar_m: float
    """Length inside radar ranges (a cost, not a bound)."""

    def violations(self, limits: Limits, required_clearance_m: float) -> tuple[str, ...]:
        """The bounds that are broken, in words; empty: safe to fly.

        required_clearance_m: d_s and the tracking error; the band too is kept by the latter.
        """
        inset = limits.tracking_error_m
        bounds = (
            ("terrain clearance", self.above_safe_m >= 0.0),
            ("keep-out zone", self.keep_out_m >= required_clearance_m),
            ("turn radius", self.turn_radius_m >= limits.turn_radius_m),
            ("climb angle", self.climb_angle_rad <= limits.climb_angle_rad),
            ("dive angle", self.dive_angle_rad <= limits.dive_angle_rad),
            ("floor of the band", self.lowest_amsl_m >= limits.floor_amsl_m + inset),
            ("ceiling of the band", self.highest_amsl_m <= limits.ceiling_amsl_m - inset),
            ("edge of the map", self.off_map_m <= 0.0),
        )
        return tuple(name for name, kept in bounds if not kept)


def check(
    subpath: Subpath,
    *,
    safe: Surface,
    known: KnownMap,
    limits: Limits,
    radars: tuple[Radar, ...],
    keep_outs: tuple[KeepOut, ...],
    safety_distance_m: float,
) -> CheckReport:
    """Measure a subpath, its tail included, against the surface and the bounds."""
    samples = subpath.sampled(min(_SPACING_M, safety_distance_m / 50.0))
    points = samples.points_nea_m
    north, east, altitude = points.T
    climb = climb_angle_rad(samples.first)
    curvature = horizontal_curvature_1_m(samples.first, samples.second)
    keep_out = [float(zone.distance_m(north, east).min()) for zone in keep_outs]
    off_map = np.maximum(_beyond(north, limits.north_m), _beyond(east, limits.east_m))
    return CheckReport(
        clearance_m=float(clearance_m(known, points[::5]).min()),
        farthest_m=_FARTHEST_CELLS * known.cell_m,
        above_safe_m=float((altitude - safe.altitude_m(north, east)).min()),
        keep_out_m=min(keep_out, default=np.inf),
        turn_radius_m=float(1.0 / max(curvature.max(), 1e-9)),
        climb_angle_rad=float(climb.max()),
        dive_angle_rad=float(-climb.min()),
        lowest_amsl_m=float(altitude.min()),
        highest_amsl_m=float(altitude.max()),
        off_map_m=float(off_map.max()),
        radar_m=_radar_m(samples, subpath, radars),
    )


def clearance_m(known: KnownMap, points_nea_m: FloatArray) -> FloatArray:
    """Distance of points to the known terrain, metres.  (S, 3) -> (S,).

    To the columns of the map's cells, each as high as its highest terrain; at most 8 cells.
    """
    cell = known.cell_m
    steps = np.arange(-_FARTHEST_CELLS, _FARTHEST_CELLS + 1)
    u = (points_nea_m[:, 0] - known.north_min_m) / cell
    v = (points_nea_m[:, 1] - known.east_min_m) / cell
    row, column = np.floor(u)[:, None] + steps, np.floor(v)[:, None] + steps  # (S, 17)
    gap_n = np.maximum(np.maximum(row - u[:, None], u[:, None] - row - 1.0), 0.0) * cell
    gap_e = np.maximum(np.maximum(column - v[:, None], v[:, None] - column - 1.0), 0.0) * cell
    rows = np.clip(row, 0, known.upper_m.shape[0] - 1).astype(np.intp)
    columns = np.clip(column, 0, known.upper_m.shape[1] - 1).astype(np.intp)
    upper = known.upper_m[rows[:, :, None], columns[:, None, :]]  # (S, 17, 17)
    below = np.maximum(points_nea_m[:, 2, None, None] - upper, 0.0)
    squared = gap_n[:, :, None] ** 2 + gap_e[:, None, :] ** 2 + below**2
    nearest = np.sqrt(np.where(np.isfinite(upper), squared, np.inf).min(axis=(1, 2)))
    return np.minimum(nearest, _FARTHEST_CELLS * cell)


def _radar_m(samples: Samples, subpath: Subpath, radars: tuple[Radar, ...]) -> float:
    inside = np.zeros(len(samples.points_nea_m), dtype=bool)
    for radar in radars:
        inside |= radar.distance_m(samples.points_nea_m) <= radar.range_m
    return float(inside.mean() * subpath.length_m)


def _beyond(values: FloatArray, bounds: tuple[float, float]) -> FloatArray:
    return np.maximum(np.maximum(bounds[0] - values, values - bounds[1]), 0.0)
