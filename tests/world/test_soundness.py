"""No cell's bound is below the ground, whatever the ground and whatever the scanner.

100 terrains, with `--all` 10,000.  The tolerance is nought (a micrometre, for the arithmetic).
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rough_ground import (
    CELL_M,
    COLUMNS,
    RANGE_M,
    ROWS,
    Ground,
    blank,
    ground,
    radar_over,
    scan_of,
    sight_of,
    with_losses,
)

from companion.world.known_map import KnownMap, Scan
from companion.world.simulated_scan import simulated_scan
from vehicle_sim.geodesy import LocalFrame, metres_per_degree
from vehicle_sim.grid import GridTerrain
from vehicle_sim.sensors.terrain_radar import UNSEEN_M, ScanRequest, TerrainRadar, Viewpoint

FloatArray = NDArray[np.float64]
Point = tuple[float, float, float]

BLOCK = 10
BLOCKS, ALL_BLOCKS = 5, 1_000
FRAME = LocalFrame(latitude_deg=0.0, longitude_deg=0.0)
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
    if not scan.complete and not scan.whole_width:
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
        for _ in range(2):
            after = simulated_scan(truth, radar_over(tops, rng), RANGE_M)
            alone = blank().with_scan(after)
            both = check(after, truth.upper_m, f"terrain {number}, several scans", known)
            assert (both.upper_m <= np.minimum(known.upper_m, alone.upper_m)).all()
            known = both


def test_what_a_scanner_that_keeps_its_promise_does_not_show_is_below_its_bound(
    first: int,
) -> None:
    for number in range(first, first + BLOCK, 4):
        place, rng = ground(number)
        tops = place.tops_m()
        radar = radar_over(tops, rng)
        sight = sight_of(place, radar)
        share = float(rng.choice([0.02, 0.1, 0.3]))
        complete = scan_of(tops, sight.somewhere, radar)
        across = scan_of(tops, sight.across, radar)
        sampled = scan_of(tops, sight.middle, radar)
        scanners = {
            "complete": complete,
            "complete, and does not say so": replace(complete, complete=False),
            "with losses": with_losses(complete, rng, share),
            "one sample a cell, with losses": with_losses(sampled, rng, share),
            "whole cells": replace(across, complete=False, whole_width=True),
            "whole cells, with losses": replace(with_losses(across, rng, share), whole_width=True),
        }
        for name, scan in scanners.items():
            check(scan, sight.met_m, f"terrain {number}, {name}")


def test_what_the_simulators_radar_does_not_see_is_below_its_bound(first: int) -> None:
    place, rng = ground(first + first // BLOCK % 5)
    tops = place.tops_m()
    radar = radar_over(tops, rng)
    scan = simulators_scan(place, radar)
    known = check(scan, tops, f"terrain {first}")
    check(with_losses(scan, rng, 0.1), tops, f"terrain {first}, with losses")
    again = simulators_scan(place, radar_over(tops, rng))
    check(again, tops, f"terrain {first}, two scans", known)


def simulators_scan(place: Ground, radar_nea_m: Point) -> Scan:
    """Four requests to the simulator's radar, on the equator, where a map is hardly bent."""
    step_m = CELL_M * ROWS / (len(place.nodes_m) - 1)
    steps_deg = tuple(step_m / each for each in metres_per_degree(0.0))
    terrain = GridTerrain.of(
        place.nodes_m[::-1],
        north_deg=steps_deg[0] * (len(place.nodes_m) - 1),
        west_deg=0.0,
        step_deg=(steps_deg[0], steps_deg[1]),
        frame=FRAME,
        area_m=(0.0, ROWS * CELL_M, 0.0, COLUMNS * CELL_M),
    )
    radar = TerrainRadar(terrain, FRAME, range_m=RANGE_M)
    latitude_deg, longitude_deg = FRAME.to_geographic(*radar_nea_m[:2])
    view = Viewpoint(
        latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_amsl_m=radar_nea_m[2]
    )
    heights = np.full((ROWS, COLUMNS), -np.inf)
    for row in range(0, ROWS, 28):
        for column in range(0, COLUMNS, 32):
            corner = FRAME.to_geographic(row * CELL_M, column * CELL_M)
            request = ScanRequest(
                latitude_deg=corner[0],
                longitude_deg=corner[1],
                spacing_m=round(CELL_M),
                mask=(1 << 56) - 1,
            )
            for block in radar.answer(request, view):
                i, j = row + block.gridbit // 8 * 4, column + block.gridbit % 8 * 4
                heights[i : i + 4, j : j + 4] = np.reshape(block.heights_amsl_m, (4, 4))
    seen = heights != UNSEEN_M
    return replace(scan_of(heights, seen, radar_nea_m), registration_m=1.0)
