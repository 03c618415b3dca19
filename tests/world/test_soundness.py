"""No cell's bound is below the ground, whatever the ground and whatever the scanner.

100 terrains, with `--all` 10,000.  The tolerance is nought (a micrometre, for the arithmetic).

Ground is bilinear between nodes, so the highest of a cell is exactly the highest of its nodes.
Lines of sight are marched outward in all directions, several to a cell and more beside the radar; a
point is in sight if it rises above all that is nearer to the radar in its direction, on a sphere.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import map_coordinates

from companion.geodesy import BoolArray, FloatArray
from companion.world.known_map import NO_ANSWER, NOT_SEEN, KnownMap, Scan, empty_map
from companion.world.simulated import simulated_scan

Point = tuple[float, float, float]

CELL_M = 100.0
ROWS, COLUMNS = 56, 64  # as many as 2 x 2 requests to the simulator's radar have
NODES = 4  # a cell and side
RANGE_M = 4_800.0
_STEP_M = CELL_M / NODES
_BETWEEN_RAYS = 0.12  # of a cell, at the farthest
_BETWEEN_STEPS = 0.23  # of a cell
_BESIDE_M = np.geomspace(0.5, _BETWEEN_STEPS * CELL_M, 30, endpoint=False)
EARTH_M = 6_371_009.0


@dataclass(frozen=True)
class Ground:
    """Heights at nodes, from the south-west corner of the map."""

    nodes_m: FloatArray  # (ROWS * NODES + 1, COLUMNS * NODES + 1)

    def height_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Between the nodes.  (...), (...) -> (...)."""
        at = np.stack(np.broadcast_arrays(north_m, east_m)) / _STEP_M
        return np.asarray(map_coordinates(self.nodes_m, at, order=1, mode="nearest"))

    def tops_m(self) -> FloatArray:
        """The highest of each cell.  -> (ROWS, COLUMNS)."""
        of_cells = sliding_window_view(self.nodes_m, (NODES + 1, NODES + 1))[::NODES, ::NODES]
        return np.asarray(of_cells.max(axis=(2, 3)))


# --- sorts of ground, all of slopes of 10 to 85 degrees


SHAPE = (ROWS * NODES + 1, COLUMNS * NODES + 1)
NORTH_M = np.arange(SHAPE[0])[:, None] * _STEP_M  # of the nodes
EAST_M = np.arange(SHAPE[1])[None, :] * _STEP_M


def _slope(rng: np.random.Generator) -> float:
    return math.tan(math.radians(float(rng.uniform(10.0, 85.0))))


def _somewhere(rng: np.random.Generator) -> tuple[float, float]:
    return float(rng.uniform(0.0, ROWS * CELL_M)), float(rng.uniform(0.0, COLUMNS * CELL_M))


def peaks(rng: np.random.Generator) -> FloatArray:
    """Mountains of eq. 1, whose steepest slope is 0.858 x height / spread."""
    result = np.zeros(SHAPE)
    for _ in range(int(rng.integers(1, 12))):
        n, e = _somewhere(rng)
        height = float(rng.uniform(100.0, 3_000.0))
        spread = max(0.858 * height / _slope(rng), 60.0)
        x, y = (NORTH_M - n) / spread, (EAST_M - e) / (spread * float(rng.uniform(1.0, 3.0)))
        np.maximum(result, height * np.exp(-x * x - y * y), out=result)
    return result


def ridges(rng: np.random.Generator) -> FloatArray:
    """Long crests in any direction, side by side or crossing, some with gaps."""
    result = np.zeros(SHAPE)
    height, slope = float(rng.uniform(200.0, 3_000.0)), _slope(rng)
    for _ in range(int(rng.integers(1, 5))):
        n, e = _somewhere(rng)
        bearing = float(rng.uniform(0.0, math.pi))
        aside = (NORTH_M - n) * math.cos(bearing) + (EAST_M - e) * math.sin(bearing)
        along = (EAST_M - e) * math.cos(bearing) - (NORTH_M - n) * math.sin(bearing)
        crest = height * (1.0 + float(rng.uniform(0.0, 0.1)) * np.sin(along / 300.0))
        if rng.random() < 0.5:
            crest = np.where(np.abs(along) < float(rng.uniform(100.0, 1_000.0)), 0.0, crest)
        np.maximum(result, crest - slope * np.abs(aside), out=result)
    return result


def walls(rng: np.random.Generator) -> FloatArray:
    """Walls from one node to several cells thick, towers, and pits."""
    result = np.zeros(SHAPE)
    for _ in range(int(rng.integers(2, 14))):
        n, e = _somewhere(rng)
        half = rng.choice([12.0, 30.0, 80.0, 200.0, 900.0], 2)
        inside = (np.abs(NORTH_M - n) <= half[0]) & (np.abs(EAST_M - e) <= half[1])
        result[inside] = float(rng.uniform(-300.0, 2_000.0))
    return result


def steps(rng: np.random.Generator) -> FloatArray:
    """Terraces."""
    bearing, slope = float(rng.uniform(0.0, 2.0 * math.pi)), _slope(rng)
    rise = slope * (NORTH_M * math.cos(bearing) + EAST_M * math.sin(bearing))
    height = float(rng.uniform(30.0, 600.0))
    return np.asarray(np.floor((rise - rise.min()) / height) % float(rng.integers(2, 9)) * height)


def relief(rng: np.random.Generator) -> FloatArray:
    """Gaussian relief as the earth has it: amplitude as the wave number to the power of -2."""
    wave = np.hypot(np.fft.fftfreq(SHAPE[0])[:, None], np.fft.fftfreq(SHAPE[1])[None, :])
    wave[0, 0] = np.inf
    noise = np.fft.fft2(rng.normal(size=SHAPE))
    heights = np.fft.ifft2(noise / np.maximum(wave, 0.004) ** float(rng.uniform(1.4, 2.2))).real
    return np.asarray(
        (heights - heights.min()) / np.ptp(heights) * float(rng.uniform(300.0, 4_000.0))
    )


SORTS = (peaks, ridges, walls, steps, relief)


def ground(number: int) -> tuple[Ground, np.random.Generator]:
    """Terrain number so and so, always the same, and chance for what is done with it."""
    rng = np.random.default_rng([20, number])
    nodes = SORTS[number % len(SORTS)](rng)
    if rng.random() < 0.3:
        nodes = np.maximum(nodes, SORTS[int(rng.integers(len(SORTS)))](rng))
    return Ground(nodes + 50.0), rng


def radar_over(tops_m: FloatArray, rng: np.random.Generator) -> Point:
    """A place on the map that no ground within a cell of its own rises above."""
    n, e = (float(x) for x in rng.uniform(0.1, 0.9, 2) * (ROWS * CELL_M, COLUMNS * CELL_M))
    row, column = int(n / CELL_M), int(e / CELL_M)
    near = tops_m[row - 1 : row + 2, column - 1 : column + 2]
    return n, e, float(near.max() + rng.choice([5.0, 60.0, 300.0, 1_500.0]))


def radar_at_a_wall(place: Ground, rng: np.random.Generator) -> Point:
    """A place hardly above the ground, that ground within a cell rises above if any does."""
    places = rng.uniform(0.1, 0.9, (300, 2)) * (ROWS * CELL_M, COLUMNS * CELL_M)
    aside = rng.uniform(-CELL_M, CELL_M, places.shape)
    ground, beside = place.height_m(*places.T), place.height_m(*(places + aside).T)
    best = int(rng.choice(np.argsort(beside - ground)[-30:]))
    rise = max(float(beside[best] - ground[best]), 4.0)
    above = float(rng.choice([2.0, rng.uniform(0.0, 0.9) * rise + 1.0]))
    return float(places[best, 0]), float(places[best, 1]), float(ground[best]) + above


def elevation_tangent(
    height_m: FloatArray, away_m: FloatArray, eye_m: float, earth_m: float = EARTH_M
) -> FloatArray:
    """How high a point looks from an eye above a sphere, by its place in space."""
    angle, radius = away_m / earth_m, earth_m + height_m
    up = height_m - eye_m - 2.0 * radius * np.sin(0.5 * angle) ** 2
    return np.asarray(up / (radius * np.sin(angle)))


# --- scanners


class Sight(NamedTuple):
    """What is in sight from a point.  (ROWS, COLUMNS) each."""

    somewhere: BoolArray  # some of the cell
    middle: BoolArray  # the sample nearest to its middle
    met_m: FloatArray  # the highest of its samples; -inf: none


def sight_of(place: Ground, radar_nea_m: Point) -> Sight:
    """By marching over the ground."""
    far = RANGE_M + CELL_M
    count = math.ceil(2.0 * math.pi * far / (_BETWEEN_RAYS * CELL_M))
    azimuth = np.arange(count) * (2.0 * math.pi / count)
    away = np.arange(1.0, far / CELL_M / _BETWEEN_STEPS) * _BETWEEN_STEPS * CELL_M
    away = np.append(_BESIDE_M, away)
    north = radar_nea_m[0] + np.multiply.outer(away, np.cos(azimuth))
    east = radar_nea_m[1] + np.multiply.outer(away, np.sin(azimuth))
    height = place.height_m(north, east)
    slope = elevation_tangent(height, away[:, None], radar_nea_m[2])
    inside = (north >= 0.0) & (north < ROWS * CELL_M) & (east >= 0.0) & (east < COLUMNS * CELL_M)
    slope[~inside] = -np.inf
    free = (slope >= np.maximum.accumulate(slope, axis=0)) & inside
    row, column = (north / CELL_M).astype(np.intp), (east / CELL_M).astype(np.intp)
    cell = np.where(inside, row * COLUMNS + column, ROWS * COLUMNS)
    size = ROWS * COLUMNS + 1
    somewhere = np.zeros(size, dtype=bool)
    somewhere[cell[free]] = True
    off = np.hypot(north - (row + 0.5) * CELL_M, east - (column + 0.5) * CELL_M)
    nearest = np.full(size, np.inf)
    np.minimum.at(nearest, cell.ravel(), np.where(inside, off, np.inf).ravel())
    middle = np.zeros(size, dtype=bool)
    middle[cell[free & (off <= nearest[cell])]] = True
    met = np.full(size, -np.inf)
    np.maximum.at(met, cell.ravel(), height.ravel())
    shape = (ROWS, COLUMNS)
    seen = (each[:-1].reshape(shape) for each in (somewhere, middle))
    return Sight(*seen, met[:-1].reshape(shape))


def blank() -> KnownMap:
    """Nothing is known."""
    return empty_map(CELL_M, (0.0, ROWS * CELL_M), (0.0, COLUMNS * CELL_M))


def answered(heights_m: FloatArray, radar_nea_m: Point, range_m: float) -> Scan:
    """Of a complete radar."""
    radars = np.broadcast_to(np.array(radar_nea_m), (*heights_m.shape, 3))
    return Scan(row=0, column=0, heights_m=heights_m, radar_nea_m=radars, range_m=range_m)


def scan_of(tops_m: FloatArray, seen: BoolArray, radar_nea_m: Point) -> Scan:
    """The answers of a radar that saw these cells, within range."""
    north, east = blank().middles_m()
    near = np.hypot(north - radar_nea_m[0], east - radar_nea_m[1]) <= RANGE_M
    return answered(np.where(seen & near, np.ceil(tops_m), NOT_SEEN), radar_nea_m, RANGE_M)


def with_losses(scan: Scan, rng: np.random.Generator, share: float) -> Scan:
    """Returns of single cells are lost, and the radar does not say so."""
    lost = rng.random(scan.heights_m.shape) < share
    return replace(scan, heights_m=np.where(lost, NOT_SEEN, scan.heights_m), complete=False)


# --- the law

BLOCK = 10
BLOCKS, ALL_BLOCKS = 5, 1_000
_ROUNDING_M = 1e-6


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "first" in metafunc.fixturenames:
        blocks = ALL_BLOCKS if metafunc.config.getoption("--all") else BLOCKS
        metafunc.parametrize("first", range(0, blocks * BLOCK, BLOCK))


def check(scan: Scan, truth_m: FloatArray, what: str, before: KnownMap | None = None) -> KnownMap:
    """truth_m: heights of ground in each cell, as high as it is or was looked at."""
    known = (before or blank()).with_scan(scan)
    deep_m = truth_m - known.upper_m
    assert deep_m.max() <= _ROUNDING_M, f"{what}: {deep_m.max():.1f} m, {(deep_m > 0).sum()} cells"
    if not scan.complete:
        assert (np.isfinite(known.upper_m) == known.seen).all()
    return known


def test_what_the_offline_scan_does_not_see_is_below_its_bound(first: int) -> None:
    for number in range(first, first + BLOCK):
        place, rng = ground(number)
        tops = place.tops_m()
        radar = radar_over(tops, rng)
        truth = replace(blank(), upper_m=np.ceil(tops))
        scan = simulated_scan(truth, radar, RANGE_M)
        known = check(scan, truth.upper_m, f"terrain {number}")
        check(with_losses(scan, rng, 0.1), truth.upper_m, f"terrain {number}, with losses")
        for again in (radar_over(tops, rng), radar_over(tops, rng), radar_at_a_wall(place, rng)):
            after = simulated_scan(truth, again, RANGE_M)
            alone = blank().with_scan(after)
            both = check(after, truth.upper_m, f"terrain {number}, several scans", known)
            assert (both.upper_m <= np.minimum(known.upper_m, alone.upper_m)).all()
            known = both


def test_what_a_scanner_that_keeps_its_promise_does_not_show_is_below_its_bound(first: int) -> None:
    for k, number in enumerate(range(first, first + BLOCK)):
        place, rng = ground(number)
        tops = place.tops_m()
        radar = radar_over(tops, rng) if (k + first // BLOCK) % 2 else radar_at_a_wall(place, rng)
        sight = sight_of(place, radar)
        share = float(rng.choice([0.02, 0.1, 0.3]))
        complete = scan_of(tops, sight.somewhere, radar)
        sampled = scan_of(tops, sight.middle, radar)
        lost = np.kron(rng.random((ROWS // 4, COLUMNS // 4)) < 0.2, np.ones((4, 4))) > 0.0
        in_parts = np.where(lost, NO_ANSWER, complete.heights_m)
        turn = rng.uniform(0.0, 2.0 * np.pi)
        off_m = 200.0 * np.array([np.cos(turn), np.sin(turn), 0.0])
        scanners = {
            "complete": complete,
            "complete, and does not say so": replace(complete, complete=False),
            "with losses": with_losses(complete, rng, share),
            "one sample a cell, with losses": with_losses(sampled, rng, share),
            "in parts not answered": replace(complete, heights_m=in_parts),
            "it moves a little": moving(place, complete, radar, rng, 15.0),
            "it moves far": moving(place, complete, radar, rng, 300.0),
            "not where it says, nor the cells": replace(
                complete,
                radar_nea_m=complete.radar_nea_m + off_m,
                drift_m=120.0,
                registration_m=80.0,
            ),
        }
        for name, scan in scanners.items():
            check(scan, sight.met_m, f"terrain {number}, {name}")


def moving(
    place: Ground, early: Scan, radar: Point, rng: np.random.Generator, away_m: float
) -> Scan:
    """A scan of which the second half of the answers, here and there, is given from elsewhere."""
    turn = rng.uniform(0.0, 2.0 * np.pi)
    n, e = radar[0] + away_m * np.cos(turn), radar[1] + away_m * np.sin(turn)
    ground_m = float(place.height_m(np.array([n]), np.array([e]))[0])
    there = n, e, max(radar[2] + float(rng.choice([0.0, 5.0])), ground_m + 5.0)
    late = scan_of(place.tops_m(), sight_of(place, there).somewhere, there)
    moved = np.kron(rng.random((ROWS // 4, COLUMNS // 4)) < 0.5, np.ones((4, 4))) > 0.0
    return replace(
        early,
        heights_m=np.where(moved, late.heights_m, early.heights_m),
        radar_nea_m=np.where(moved[..., None], there, radar),
    )


@pytest.mark.parametrize(
    ("earth_m", "refraction"), [(6_371e3, 1.0), (6_336e3, 1.0), (6_371e3, 7 / 6)]
)
def test_what_a_ridge_hides_on_a_round_earth_is_below_its_bound(
    earth_m: float, refraction: float
) -> None:
    """A ridge all round, with a gap, and ground beyond it that rises right up to the line of sight.

    Refraction makes the earth look flatter, and hides less.
    """
    rng = np.random.default_rng(39)
    earth_m *= refraction
    for _ in range(8):
        range_m = float(rng.choice([5_000.0, 20_000.0, 60_000.0]))
        cell_m = range_m / 80.0
        known = empty_map(cell_m, (0.0, 2.25 * range_m), (0.0, 2.25 * range_m))
        north, east = known.middles_m()
        radar = 1.125 * range_m + 1.0, 1.125 * range_m + 1.0, float(rng.uniform(500.0, 3_500.0))
        away = np.hypot(north - radar[0], east - radar[1])
        first = float(rng.uniform(0.05, 0.5)) * range_m
        top = radar[2] + float(rng.uniform(-1.0, 1.0))
        ridge = (away >= first) & (away < first + 2.0 * cell_m)
        beyond = (away >= first + 4.0 * cell_m) & (away <= range_m)
        look = elevation_tangent(np.full(1, top), away[ridge], radar[2], earth_m).min()
        angle = away / earth_m
        line = (earth_m + radar[2]) / (np.cos(angle) - look * np.sin(angle)) - earth_m
        ground = np.where(beyond, line - 1e-3, -400.0)
        ground[ridge] = top
        gap = np.abs(np.arctan2(east - radar[1], north - radar[0])) < 0.3
        ground[gap & beyond] = -400.0
        seen = (away <= range_m) & (ridge | (away < first) | gap)
        after = known.with_scan(answered(np.where(seen, ground, -np.inf), radar, range_m))
        hidden = beyond & ~gap & np.isfinite(after.upper_m)
        assert hidden.sum() > 1_000
        assert (after.upper_m[hidden] >= ground[hidden]).all()


def test_what_a_wall_beside_the_radar_hides_is_below_its_bound() -> None:
    """A thin wall, hardly higher than the radar; behind it ground right up to the line of sight."""
    rng, bounded = np.random.default_rng(7), 0
    for _ in range(60):
        cell_m = float(rng.choice([19.0, 250.0]))
        known = empty_map(cell_m, (0.0, 80 * cell_m), (0.0, 80 * cell_m))
        radar = (*(rng.uniform(39.0, 41.0, 2) * cell_m).tolist(), 500.0)
        bearing, gap_m = rng.uniform(0.0, 2.0 * np.pi), float(rng.uniform(0.02, 1.3)) * cell_m
        across = np.array([np.cos(bearing), np.sin(bearing)])
        along, rise_m = np.array([-across[1], across[0]]), float(rng.uniform(0.05, 0.6)) * gap_m
        half_m = 3.0 * cell_m
        wall = np.linspace(-half_m, half_m, 2_000)[:, None] * along + gap_m * across
        cells = ((wall + radar[:2]) / cell_m).astype(np.intp)
        corners = np.indices((81, 81)) * cell_m - np.array(radar[:2])[:, None, None]
        depth_m, aside_m = np.tensordot(across, corners, 1), np.tensordot(along, corners, 1)
        in_shadow = (depth_m > 4.0 * cell_m) & (np.abs(aside_m) * gap_m < half_m * depth_m)
        quads = [(slice(i, i + 80), slice(j, j + 80)) for i in (0, 1) for j in (0, 1)]
        hidden = np.all([in_shadow[quad] for quad in quads], axis=0)
        deepest_m = np.max([depth_m[quad] for quad in quads], axis=0)
        ground = np.where(hidden, radar[2] + rise_m * deepest_m / gap_m - 1e-3, 0.0)
        ground[tuple(cells.T)] = radar[2] + rise_m
        after = known.with_scan(answered(np.where(hidden, -np.inf, ground), radar, 38.0 * cell_m))
        bounded += int((np.isfinite(after.upper_m) & hidden).sum())
        assert (after.upper_m >= ground).all()
    assert bounded > 10_000
