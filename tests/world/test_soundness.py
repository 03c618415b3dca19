"""No cell's bound is below the ground, whatever the ground and whatever the scanner.

100 terrains, with `--all` 10,000.  The tolerance is nought (a micrometre, for the arithmetic).
"""

from dataclasses import replace

import numpy as np
import pytest
from rough_ground import (
    COLUMNS,
    RANGE_M,
    ROWS,
    Ground,
    Point,
    answered,
    blank,
    elevation_tangent,
    ground,
    radar_at_a_wall,
    radar_over,
    scan_of,
    sight_of,
    with_losses,
)

from companion.geodesy import FloatArray
from companion.world.known_map import NO_ANSWER, KnownMap, Scan, empty_map
from companion.world.simulated import simulated_scan

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
