"""Rows of a lidar behind an autopilot: where its echoes lie, and what is wrong with them.

Each side is held against the posts as it flew past them itself: DISTANCE_SENSOR 10 to 17 against
SIMSTATE and ATTITUDE (docs/lab/proximity.md 1).
"""

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from conformance.flights import Flight, FloatArray, Posts, Side
from conformance.rows import NOTHING, Comparison, Row, apart

_SYS_STATUS, _ATTITUDE, _DISTANCE_SENSOR, _SIMSTATE = 1, 30, 132, 164
_PROXIMITY = 0x4000000
_FIRST_ID = 10
_AGE_S = 0.05
_BEAMS = 31
_REACH_M, _EDGE_M, _NEAR_M, _FAR_M = 16.0, 0.5, 0.3, 99.0
_TOLERANCES = {
    "lidar count": 48.0,
    "lidar error": 0.03,  # median, in metres
    "lidar echoes": 0.04,  # the share that lies within _NEAR_M of the post
    "longest row": 4.0,  # of messages that say "max" although a post is there
    "share of all": 0.015,  # of such messages
    "stale echo": 0.35,  # seconds of an echo of nothing
    "healthy silence": 1.1,  # seconds without a sector while SYS_STATUS says that the lidar is well
}
Found = dict[tuple[str, str], float]
"""By kind and name of a row."""


def lidar_rows(comparison: Comparison) -> Iterator[Row]:
    """Rows of a flight whose posts are known."""
    flight = comparison.flight
    if flight.posts is None:
        return
    real, simulated = (_found(side, flight, flight.posts) for side in comparison.sides)
    for kind, name in dict.fromkeys((*real, *simulated)):
        tolerance = _TOLERANCES.get(kind) or _TOLERANCES[name]
        pair = real.get((kind, name)), simulated.get((kind, name))
        shown = [NOTHING if value is None else f"{value:.3g}" for value in pair]
        yield Row(kind, name, shown, apart(*pair, tolerance))


def _found(side: Side, flight: Flight, posts: Posts) -> Found:
    """What one side's lidar said, held against what was there."""
    truth, turns, found = side.of(_SIMSTATE), side.of(_ATTITUDE), Found()
    echoes = [(time_s, m) for time_s, m in side.of(_DISTANCE_SENSOR) if m.id >= _FIRST_ID]
    ill = [t for t, m in side.of(_SYS_STATUS) if not m.onboard_control_sensors_health & _PROXIMITY]
    pairs = itertools.pairwise(time_s for time_s, _ in echoes)
    gaps = [after - t for t, after in pairs if not any(t < each < after for each in ill)]
    if gaps:
        found["healthy silence", "longest"] = max(gaps)
    if not (truth and turns and echoes):
        return found
    away_deg = np.array([(m.lat / 1e7, m.lng / 1e7) for _, m in truth]) - flight.home[:2]
    flown_ne_m = away_deg * posts.metres_per_degree
    flown_s = np.array([time_s for time_s, _ in truth])
    yaw_s = np.array([m.time_boot_ms * 1e-3 for _, m in turns])
    yaw_rad = np.unwrap([m.yaw for _, m in turns])
    rows, shares, stales = [], [], []
    for sector in sorted({m.orientation for _, m in echoes}):
        said = [m for _, m in echoes if m.orientation == sector]
        time_s = np.array([m.time_boot_ms * 1e-3 for m in said])
        told_m = np.array([m.current_distance * 0.01 for m in said])
        at_s = time_s - _AGE_S
        here = np.stack([np.interp(at_s, flown_s, column) for column in flown_ne_m.T], axis=-1)
        middle_rad = np.interp(at_s, yaw_s, yaw_rad) + sector * np.radians(45.0)
        true_m = _nearest_m(here, middle_rad, posts)
        empty = told_m >= _REACH_M - 0.005
        error_m = np.abs(told_m - true_m)[~empty & (true_m < _REACH_M)]
        name, met = f"sector {sector}", len(error_m) > 0
        found["lidar count", name] = len(said)
        found["lidar error", name] = float(np.median(error_m)) if met else _FAR_M
        found["lidar echoes", name] = float(np.mean(error_m < _NEAR_M)) if met else 0.0
        bogus = empty & (true_m < _REACH_M - _EDGE_M)
        rows += [len(run) for run in _runs(bogus)]
        shares.append(float(bogus.mean()))
        stale = ~empty & (true_m > _REACH_M + _EDGE_M)
        stales += [float(np.ptp(time_s[run])) for run in _runs(stale)]
    found["bogus empties", "longest row"] = max(rows, default=0)
    found["bogus empties", "share of all"] = float(np.mean(shares))
    found["stale echo", "longest"] = max(stales, default=0.0)
    return found


def _nearest_m(here_ne_m: FloatArray, middle_rad: FloatArray, posts: Posts) -> FloatArray:
    """The nearest post in each sector of 45 degrees.  (T, 2), (T,) -> (T,)."""
    away = posts.places_ne_m() - here_ne_m[:, None]  # (T, P, 2)
    square = (away * away).sum(axis=-1)
    nearest = np.full(len(here_ne_m), _FAR_M)
    for off_deg in np.linspace(-22.5, 22.5, _BEAMS):
        bearing = middle_rad + np.radians(off_deg)
        ahead = away[..., 0] * np.cos(bearing)[:, None] + away[..., 1] * np.sin(bearing)[:, None]
        inside = posts.radius_m**2 - (square - ahead * ahead)
        met = (inside > 0.0) & (ahead > 0.0)
        length = np.where(met, ahead - np.sqrt(np.maximum(inside, 0.0)), _FAR_M).min(axis=1)
        nearest = np.minimum(nearest, length)
    return nearest


def _runs(flags: NDArray[np.bool_]) -> list[list[int]]:
    groups = itertools.groupby(range(len(flags)), key=lambda k: bool(flags[k]))
    return [list(members) for is_set, members in groups if is_set]
