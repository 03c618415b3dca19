"""Frames and units: the local frame, meridian convergence, and the wire's integers.

The local frame is an azimuthal equidistant projection about an origin (WGS84), so that distances
and directions from the origin are those of the geodesic.  Its north axis agrees with true north
only at the origin (1 degree off 100 km east at 47 N): velocities and yaw are rotated by
the convergence on their way to and from the wire (design section 3).
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TypeVar, final

import numpy as np
import numpy.typing as npt
import pyproj
import shapely

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Places = TypeVar("Places", float, FloatArray)

_WGS84 = pyproj.Geod(ellps="WGS84")
LEAST_RADIUS_M = 6_330_000.0
"""The ground curves away no faster: WGS 84 has 6,335 km along the meridian at the equator, and
altitudes of up to 5 km count as in height above them."""
_BASELINE_M = 100.0  # long enough that rounding of the projection does not show in the azimuth
_SAME_M = 32.0  # over which the convergence changes by less than 1e-5 rad below 85 degrees
_NEAR = 64  # places whose convergence is kept: where the vehicle is, and is sent


@final
@dataclass(frozen=True, kw_only=True)
class LocalFrame:
    """North, east in metres about an origin, and back."""

    latitude_deg: float
    longitude_deg: float

    @cached_property
    def _projection(self) -> pyproj.Proj:
        return pyproj.Proj(
            proj="aeqd", lat_0=self.latitude_deg, lon_0=self.longitude_deg, datum="WGS84"
        )

    def to_local_m(self, latitude_deg: Places, longitude_deg: Places) -> tuple[Places, Places]:
        """Latitude, longitude in degrees -> north, east in metres: numbers, or (...) of them."""
        east_m, north_m = self._projection(longitude_deg, latitude_deg)
        return north_m, east_m

    def to_geodetic_deg(self, north_m: Places, east_m: Places) -> tuple[Places, Places]:
        """North, east in metres -> latitude, longitude in degrees: numbers, or (...) of them."""
        longitude_deg, latitude_deg = self._projection(east_m, north_m, inverse=True)
        return latitude_deg, longitude_deg

    def grid_north_rad(self, north_m: float, east_m: float) -> float:
        """True azimuth of the frame's north axis at a point, radians clockwise.

        A direction of azimuth a in the local frame has the true azimuth a + this.  It is that of
        the middle of a cell of 32 m, which is asked for with nearly every message.
        """
        return _north_of_cell_rad(self, round(north_m / _SAME_M), round(east_m / _SAME_M))

    def convergence_rad(self, north_m: tuple[float, float], east_m: tuple[float, float]) -> float:
        """How far true north is from the north axis of any frame on a rectangle of this one."""
        corners = [self.to_geodetic_deg(north, east) for north in north_m for east in east_m]
        frames = [LocalFrame(latitude_deg=p, longitude_deg=q) for p, q in corners]
        return max(
            abs(frame.grid_north_rad(*frame.to_local_m(*corner)))
            for frame in frames
            for corner in corners
        )


@lru_cache(maxsize=_NEAR)
def _north_of_cell_rad(frame: LocalFrame, row: int, column: int) -> float:
    north_m, east_m = row * _SAME_M, column * _SAME_M
    lat_a, lon_a = frame.to_geodetic_deg(north_m, east_m)
    lat_b, lon_b = frame.to_geodetic_deg(north_m + _BASELINE_M, east_m)
    azimuth_deg, _, _ = _WGS84.inv(lon_a, lat_a, lon_b, lat_b)
    return math.radians(azimuth_deg)


def offset_deg(
    latitude_deg: float, longitude_deg: float, north_m: float, east_m: float
) -> tuple[float, float]:
    """The point that lies north_m, east_m (true north and east, along the geodesic) of another."""
    azimuth_deg = math.degrees(math.atan2(east_m, north_m))
    longitude, latitude, _ = _WGS84.fwd(
        longitude_deg, latitude_deg, azimuth_deg, math.hypot(north_m, east_m)
    )
    return latitude, longitude


# --- outlines that are straight in degrees

_SIDE = 16
"""Places along each side of a window: between them a side of 1,000 km bulges by less than 1 km."""
_BEYOND_DEG = 0.1  # more than that bulge, up to the latitude from which a window goes all around
_EARTH_M = 6.37e6
_STRAIGHT_M = 0.15
"""Allowed distance between a side straight in degrees and one straight in the local frame."""
_MOST_PARTS = 512  # of a side
_POLAR_DEG = 84.0  # a metre east is ten times as many degrees there as at the equator


def parts_within(
    corners_deg: list[tuple[float, float]],
    frame: LocalFrame,
    north_m: tuple[float, float],
    east_m: tuple[float, float],
) -> list[list[tuple[float, float]]]:
    """The corners of what a polygon has about a rectangle of the local frame; [] if nothing.

    (latitude, longitude), edges straight in degrees, as the polygon's; its longitudes may go on
    beyond 180 degrees.  One that goes nearly all around the Earth may have two parts.
    Sutherland and Hodgman, side by side, at the latitudes and longitudes about the rectangle: what
    only hangs together outside of these is joined along their rim.
    """
    lattice_m = np.meshgrid(*(np.linspace(*span, _SIDE + 1) for span in (north_m, east_m)))
    latitude, longitude = frame.to_geodetic_deg(*lattice_m)
    south_deg, north_deg = latitude.min() - _BEYOND_DEG, latitude.max() + _BEYOND_DEG
    off = wrap_deg(longitude - frame.longitude_deg)
    half_deg = float(np.abs(off).max()) + _BEYOND_DEG / math.cos(math.radians(_POLAR_DEG))
    if max(-south_deg, north_deg) > _POLAR_DEG:
        half_deg = 180.0
        south_deg, north_deg = (-90.0, north_deg) if south_deg < -_POLAR_DEG else (south_deg, 90.0)
    longitudes = [corner[1] for corner in corners_deg]
    turned = round((frame.longitude_deg - 0.5 * (min(longitudes) + max(longitudes))) / 360.0)
    parts = []
    for turns in (turned - 1, turned, turned + 1):
        part = [(latitude, longitude + 360.0 * turns) for latitude, longitude in corners_deg]
        part = _cut(part, 0, float(south_deg), 1.0)
        part = _cut(part, 0, float(north_deg), -1.0)
        part = _cut(part, 1, frame.longitude_deg - half_deg, 1.0)
        part = _cut(part, 1, frame.longitude_deg + half_deg, -1.0)
        parts += [part] if len(part) > 2 else []
    return parts


def _cut(
    corners: list[tuple[float, float]], axis: int, limit: float, sign: float
) -> list[tuple[float, float]]:
    """The part of a polygon on one side of a line."""
    kept: list[tuple[float, float]] = []
    for k, corner in enumerate(corners):
        before = corners[k - 1]
        inside, was_inside = (sign * (point[axis] - limit) >= 0.0 for point in (corner, before))
        if inside is not was_inside:
            part = (limit - before[axis]) / (corner[axis] - before[axis])
            meets = [a + part * (b - a) for a, b in zip(before, corner, strict=True)]
            meets[axis] = limit
            kept.append((meets[0], meets[1]))
        if inside:
            kept.append(corner)
    return kept


def short_way(corners_deg: list[tuple[float, float]]) -> list[tuple[float, float]] | None:
    """The same corners with longitudes that go on: no edge goes more than half around the Earth.

    None: the polygon goes around a pole.
    """
    ring = corners_deg[:1]
    for latitude, longitude in corners_deg[1:]:
        ring.append((latitude, longitude + 360.0 * round((ring[-1][1] - longitude) / 360.0)))
    closes = ring[-1][1] + wrap_deg(ring[0][1] - ring[-1][1]) if ring else 0.0
    return ring if not ring or abs(closes - ring[0][1]) < 1.0 else None


def straight_in_degrees(corners_deg: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The corners of a polygon, and so many places between that its sides are straight here, too.

    (latitude, longitude), which goes on, as of `short_way`.  A side bulges in the local frame by
    length^2 (tan(latitude) + 1) / (8 R) at most.
    """
    if len(corners_deg) < 3:
        return corners_deg
    ring = shapely.LinearRing(corners_deg)
    longest_deg = float(np.hypot(*np.diff(ring.coords, axis=0).T).max())
    steepest = math.tan(math.radians(max(abs(latitude) for latitude, _ in corners_deg)))
    straight_rad = math.sqrt(8.0 * _STRAIGHT_M / (_EARTH_M * (steepest + 1.0)))
    step_deg = max(math.degrees(straight_rad), longest_deg / _MOST_PARTS)
    if longest_deg <= step_deg:
        return corners_deg
    return [(latitude, longitude) for latitude, longitude in ring.segmentize(step_deg).coords[:-1]]


def wrap_deg(angle_deg: Places) -> Places:
    """The same angle from -180 to 180 degrees: numbers, or (...) of them."""
    return (angle_deg + 180.0) % 360.0 - 180.0


def deg_e7(degrees: float) -> int:
    """Degrees -> the wire's 1e-7 degrees."""
    return round(degrees * 1e7)


def deg(degrees_e7: int) -> float:
    """The wire's 1e-7 degrees -> degrees."""
    return degrees_e7 * 1e-7


def wrap_rad(angle_rad: Places) -> Places:
    """The same angle from -pi to pi: numbers, or (...) of them."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi
