"""Rows of a lidar behind an autopilot: where its echoes lie, and what is wrong with them.

Each side is held against the posts as it flew past them itself: DISTANCE_SENSOR 10 to 17 against
SIMSTATE and ATTITUDE (docs/reference/proximity.md 1).
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conformance.flights import Flight, FloatArray, Posts, Side
from conformance.rows import NOTHING, Comparison, Row, row

_SYS_STATUS, _ATTITUDE, _DISTANCE_SENSOR, _SIMSTATE = 1, 30, 132, 164
_PROXIMITY = 0x4000000
_SECTORS, _FIRST_ID = 8, 10
_AGE_S = 0.05
_BEAMS = 31
_REACH_M, _EDGE_M = 16.0, 0.5
_NEAR_M = 0.3
_FAR = 99.0
_COUNT, _MEDIAN_M, _SHARE, _ROW = 48.0, 0.03, 0.04, 4.0
_BOGUS_SHARE, _STALE_S, _SILENT_S = 0.015, 0.35, 1.1
"""Tolerances."""


class _Sector(NamedTuple):
    """What one sector said, and what was there."""

    said: int
    median_m: float
    near_share: float
    """Of the echoes: within _NEAR_M of the post."""
    longest_row: int
    """Of messages that say "max" although a post is there."""
    bogus_share: float
    longest_stale_s: float
    """An echo of nothing."""


def lidar_rows(comparison: Comparison) -> Iterator[Row]:
    """Rows of a flight whose posts are known."""
    posts = comparison.flight.posts
    if posts is None:
        return
    sides = [_sectors(side, comparison.flight, posts) for side in comparison.sides]
    for sector in range(_SECTORS):
        pair, name = [side.get(sector) for side in sides], f"sector {sector}"
        yield _row("lidar count", name, [p and p.said for p in pair], _COUNT)
        yield _row("lidar error", name, [p and p.median_m for p in pair], _MEDIAN_M)
        yield _row("lidar echoes", name, [p and p.near_share for p in pair], _SHARE)
    whole = [list(side.values()) or None for side in sides]
    rows = [s and max(p.longest_row for p in s) for s in whole]
    yield _row("bogus empties", "longest row", rows, _ROW)
    shares = [s and float(np.mean([p.bogus_share for p in s])) for s in whole]
    yield _row("bogus empties", "share of all", shares, _BOGUS_SHARE)
    stale = [s and max(p.longest_stale_s for p in s) for s in whole]
    yield _row("stale echo", "longest", stale, _STALE_S)
    silences = [_silence_s(side) for side in comparison.sides]
    yield _row("healthy silence", "longest", silences, _SILENT_S)


def _row(kind: str, name: str, pair: Sequence[float | None], tolerance: float) -> Row:
    real, simulated = pair
    difference = math.inf
    if real is not None and simulated is not None:
        difference = abs(real - simulated) / tolerance
    shown = (NOTHING if value is None else f"{value:.3g}" for value in pair)
    return row(kind, name, shown, difference)


def _sectors(side: Side, flight: Flight, posts: Posts) -> dict[int, _Sector]:
    truth, turns = side.of(_SIMSTATE), side.of(_ATTITUDE)
    said = dict[int, list[tuple[float, float]]]()
    for _, m in side.of(_DISTANCE_SENSOR):
        if m.id >= _FIRST_ID:
            measured = (m.time_boot_ms * 1e-3, m.current_distance * 0.01)
            said.setdefault(m.orientation, []).append(measured)
    if not (truth and turns and said):
        return {}
    places = posts.places_ne_m()
    scale = (posts.metres_per_latitude, posts.metres_per_longitude)
    home = (flight.home.latitude_deg, flight.home.longitude_deg)
    flown_ne_m = (np.array([(m.lat / 1e7, m.lng / 1e7) for _, m in truth]) - home) * scale
    flown_s = np.array([time_s for time_s, _ in truth])
    yaw_s = np.array([m.time_boot_ms * 1e-3 for _, m in turns])
    yaw_rad = np.unwrap([m.yaw for _, m in turns])
    found = {}
    for sector, values in said.items():
        time_s, told_m = np.array(values).T
        at_s = time_s - _AGE_S
        here = np.stack([np.interp(at_s, flown_s, column) for column in flown_ne_m.T], axis=-1)
        yaw = np.interp(at_s, yaw_s, yaw_rad)
        true_m = _nearest_m(here, yaw + sector * np.radians(45.0), places, posts.radius_m)
        found[sector] = _judged(time_s, told_m, true_m)
    return found


def _nearest_m(
    here_ne_m: FloatArray, middle_rad: FloatArray, places_ne_m: FloatArray, radius_m: float
) -> FloatArray:
    """The nearest post in each sector of 45 degrees.  (T, 2), (T,), (P, 2) -> (T,)."""
    away = places_ne_m - here_ne_m[:, None]  # (T, P, 2)
    square = (away * away).sum(axis=-1)
    nearest = np.full(len(here_ne_m), _FAR)
    for off_deg in np.linspace(-22.5, 22.5, _BEAMS):
        bearing = middle_rad + np.radians(off_deg)
        ahead = away[..., 0] * np.cos(bearing)[:, None] + away[..., 1] * np.sin(bearing)[:, None]
        inside = radius_m * radius_m - (square - ahead * ahead)
        met = (inside > 0.0) & (ahead > 0.0)
        length = np.where(met, ahead - np.sqrt(np.maximum(inside, 0.0)), _FAR).min(axis=1)
        nearest = np.minimum(nearest, length)
    return nearest


def _judged(time_s: FloatArray, told_m: FloatArray, true_m: FloatArray) -> _Sector:
    empty = told_m >= _REACH_M - 0.005
    both = ~empty & (true_m < _REACH_M)
    error_m = np.abs(told_m - true_m)[both]
    bogus = empty & (true_m < _REACH_M - _EDGE_M)
    stale = ~empty & (true_m > _REACH_M + _EDGE_M)
    return _Sector(
        said=len(time_s),
        median_m=float(np.median(error_m)) if len(error_m) else _FAR,
        near_share=float(np.mean(error_m < _NEAR_M)) if len(error_m) else 0.0,
        longest_row=max((len(row) for row in _rows(bogus)), default=0),
        bogus_share=float(bogus.mean()),
        longest_stale_s=max((float(np.ptp(time_s[row])) for row in _rows(stale)), default=0.0),
    )


def _rows(flags: NDArray[np.bool_]) -> list[list[int]]:
    """Indices of the runs of true."""
    groups = itertools.groupby(range(len(flags)), key=lambda k: bool(flags[k]))
    return [list(members) for is_set, members in groups if is_set]


def _silence_s(side: Side) -> float | None:
    """The longest time without a sector while SYS_STATUS says that the lidar is well."""
    times = [time_s for time_s, m in side.of(_DISTANCE_SENSOR) if m.id >= _FIRST_ID]
    ill = [t for t, m in side.of(_SYS_STATUS) if not m.onboard_control_sensors_health & _PROXIMITY]
    gaps = [
        after - before
        for before, after in itertools.pairwise(times)
        if not any(before < t < after for t in ill)
    ]
    return max(gaps, default=None)
