"""How plan time and guidance time grow with the world: obstacles at equal density, and big DEMs.

    python scripts/benchmarks/growth.py [--most 100000] [--cells 100] [--scenes 5] [--json FILE]

Obstacles: worlds of 10 to 100,000 mountains and radars at 0.004 per km2; the small ones lie in the
middle of the large ones, so that what is in sight stays the same and only the world grows. The
task names all radars; the map covers all of the world, or as much about the start as a mission may
have (2.5e7 cells). DEMs: a GeoTIFF of fractal relief of 1 to 100 million cells of 3 arc seconds is
written to a temporary folder; the world around its middle is read and planned in.

Timed, the median of all scenes, each the best of some repetitions: `world` (reading the DEM; making
the known map), `scan` (taking it into the known map), `guidance` (`cost_to_go`), `plan` (all).
"""

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import running
from numpy.typing import NDArray
from rich.table import Table

from companion.campaign import drawn_world
from companion.campaign.drawn_world import DrawnWorld
from companion.geodesy import LocalFrame
from companion.planner.cost_to_go import cost_to_go
from companion.planner.plan import plan
from companion.planner.procedure import hover_pose
from companion.planner.request import Planned, PlanRequest
from companion.runtime.compiler import load_kernel
from companion.sources.elevation import read_terrain
from companion.world.known_map import KnownMap, Scan, empty_map
from companion.world.simulated_scan import simulated_scan, true_map
from companion.world.terrain import Peak, PeakTerrain, Terrain

FloatArray = NDArray[np.float64]
Result = TypeVar("Result")

_MOST_CELLS = 2.5e7  # of the map of a mission (companion.config)
_REPETITIONS = 3
_ARC_S = 3.0
_DEG_M = 111_320.0


Figures = dict[str, float]
"""Of one scene, or the medians of all of one size.

`map_cells`; `in_reach`: mountains and radars that the scan may have to do with; `world_s`,
`scan_s`, `guidance_s`, `plan_s`; `planned`: how many of the plans found a subpath.
"""


def timed(task: Callable[[], Result], repetitions: int = _REPETITIONS) -> tuple[Result, float]:
    """What it returns, and the least seconds that it took."""
    least_s = math.inf
    for _ in range(repetitions):
        began_s = time.perf_counter()
        result = task()
        least_s = min(least_s, time.perf_counter() - began_s)
    return result, least_s


# --- one scene


def map_of(world: DrawnWorld) -> KnownMap:
    """A map of which nothing is known: the area, or as much of it as a mission may have."""
    limits, cell = world.task.limits, world.task.cell_m
    half = 0.5 * cell * math.floor(math.sqrt(_MOST_CELLS))
    return empty_map(
        cell,
        (max(limits.north_m[0], -half), min(limits.north_m[1], half)),
        (max(limits.east_m[0], -half), min(limits.east_m[1], half)),
    )


def scan_of(world: DrawnWorld, terrain: Terrain, known: KnownMap) -> Scan:
    """What the radar sees from the start: made from a map of its surroundings alone."""
    reach = math.ceil(world.task.settings.scan_range_m / known.cell_m) + 4
    row, column = known.cell_of(*world.start_nea_m[:2])
    row, column = max(row - reach, 0), max(column - reach, 0)
    window = replace(
        known,
        north_min_m=known.north_min_m + row * known.cell_m,
        east_min_m=known.east_min_m + column * known.cell_m,
        upper_m=known.upper_m[row : row + 2 * reach, column : column + 2 * reach],
        seen=known.seen[row : row + 2 * reach, column : column + 2 * reach],
    )
    truth = true_map(terrain, window)
    scan = simulated_scan(truth, world.start_nea_m, world.task.settings.scan_range_m)
    return replace(scan, row=scan.row + row, column=scan.column + column)


def near(world: DrawnWorld) -> PeakTerrain:
    """The mountains that reach into the surroundings of the start (the simulator's business)."""
    reach = 1.2 * world.task.settings.scan_range_m
    n, e = world.start_nea_m[:2]

    def touches(peak: Peak) -> bool:
        far = reach + 3.0 * max(peak.spread_north_m, peak.spread_east_m)
        return abs(peak.north_m - n) < far and abs(peak.east_m - e) < far

    return replace(world.terrain, peaks=tuple(p for p in world.terrain.peaks if touches(p)))


def in_reach(world: DrawnWorld) -> int:
    """Mountains and radars that come within the scan range of the start."""
    start, reach = world.start_nea_m[:2], world.task.settings.scan_range_m
    close = [math.dist((p.north_m, p.east_m), start) < reach for p in world.terrain.peaks]
    close += [math.dist(r.centre_nea_m[:2], start) < reach + r.range_m for r in world.task.radars]
    return sum(close)


def measured(
    world: DrawnWorld, terrain: Terrain, kernel: Any, seed: int, read_s: float = 0.0
) -> Figures:
    """One scene.  read_s: what reading its world took."""
    blank, map_s = timed(lambda: map_of(world), 1)
    scan = scan_of(world, terrain, blank)
    known, scan_s = timed(lambda: blank.with_scan(scan))
    here, there = world.start_nea_m[:2], world.targets_ne_m[0]
    _, guidance_s = timed(lambda: cost_to_go(known, world.task, here, there))
    request = PlanRequest(
        plan_id=1,
        seed=seed,
        task=world.task,
        known=known,
        scan_nea_m=world.start_nea_m,
        start=hover_pose(world.start_nea_m),
        from_rest=True,
        target_ne_m=there,
    )
    outcome, plan_s = timed(lambda: plan(request, kernel=kernel))
    return {
        "map_cells": blank.upper_m.size,
        "in_reach": 0 if read_s else in_reach(world),
        "world_s": map_s + read_s,
        "scan_s": scan_s,
        "guidance_s": guidance_s,
        "plan_s": plan_s,
        "planned": isinstance(outcome, Planned),
    }


# --- worlds that grow


def obstacles(most: int, scenes: int, kernel: Any) -> list[Figures]:
    """10, 100, ... obstacles at equal density."""
    rows = []
    for size in (10**k for k in range(1, 9) if 10**k <= most):
        grown = [drawn_world.spread_out(size, variant) for variant in range(scenes)]
        found = [measured(w, near(w), kernel, seed) for seed, w in enumerate(grown, 1)]
        rows.append(_row(size, found))
    return rows


def relief(cells: int, folder: Path) -> Path:
    """A GeoTIFF of about so many cells about 47 N 8 E: fractal relief of 0 to 4,500 m, mirrored."""
    import rasterio  # only where a DEM is wanted, as in companion.sources.elevation

    side = round(math.sqrt(cells))
    tile = fractal(1024)
    tile = np.block([[tile, tile[:, ::-1]], [tile[::-1], tile[::-1, ::-1]]])
    rows = np.arange(side) % len(tile)
    step = _ARC_S / 3600.0
    path = folder / f"relief-{side}.tif"
    profile = {
        "driver": "GTiff", "dtype": "int16", "count": 1, "height": side, "width": side,
        "crs": "EPSG:4326", "compress": "deflate", "tiled": True,
        "transform": rasterio.Affine(step, 0.0, 8.0 - 0.5 * side * step,
                                     0.0, -step, 47.0 + 0.5 * side * step),
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as file:
        for first in range(0, side, 1024):
            height = min(1024, side - first)
            block = tile[np.ix_(rows[first : first + height], rows)]
            file.write(block, 1, window=((first, first + height), (0, side)))
    return path


def fractal(side: int) -> NDArray[np.int16]:
    """Gaussian relief, its amplitude as the wave number to the power of -2; 0 to 4,500 m."""
    rng = np.random.default_rng(7)
    wave = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side)[None, :])
    wave[0, 0] = np.inf
    noise = np.fft.fft2(rng.normal(size=(side, side)))
    heights = np.fft.ifft2(noise / np.maximum(wave, 4.0 / side) ** 2).real
    heights = (heights - heights.min()) / np.ptp(heights)
    return np.round(4_500.0 * heights).astype(np.int16)


def elevations(most: float, scenes: int, kernel: Any) -> list[Figures]:
    """DEMs of 1, 3, 10, ... million cells; the map covers the DEM."""
    rows = []
    for millions in (1.0, 3.0, 10.0, 30.0, 100.0):
        if millions <= most:
            with tempfile.TemporaryDirectory() as folder:
                path = relief(round(1e6 * millions), Path(folder))
                rows.append(_elevation(path, round(1e6 * millions), scenes, kernel))
    return rows


def _elevation(path: Path, cells: int, scenes: int, kernel: Any) -> Figures:
    base = drawn_world.bundled("environment-2")
    half_m = 0.45 * math.sqrt(cells) * _ARC_S / 3600.0 * _DEG_M
    north, east = (-half_m, half_m), (-0.65 * half_m, 0.65 * half_m)  # cos 47 deg, and to spare
    frame = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)

    def read() -> Terrain:
        return read_terrain(
            path, frame, (north, east), vertical_datum="EGM96", nodata=None, field="terrain.file"
        )

    terrain, read_s = timed(read, 1)
    limits = replace(base.task.limits, north_m=north, east_m=east)
    found = []
    for variant in range(scenes):
        place = np.random.default_rng((8, variant)).uniform(-10_000.0, 10_000.0, 2)
        world = replace(
            base,
            task=replace(base.task, limits=limits, radars=()),
            start_nea_m=(float(place[0]), float(place[1]), 4_800.0),
            targets_ne_m=((float(place[0]) + 12_000.0, float(place[1]) + 12_000.0),),
        )
        found.append(measured(world, terrain, kernel, variant + 1, read_s))
    return _row(cells, found)


def _row(size: int, found: list[Figures]) -> Figures:
    medians = {name: float(np.median([each[name] for each in found])) for name in found[0]}
    planned = sum(each["planned"] for each in found)
    return medians | {"size": size, "planned": planned, "scenes": len(found)}


def table(rows: list[Figures], title: str, what: str) -> Table:
    """Milliseconds by size."""
    result = Table(what, "cells of the map", "in reach", "world", "scan", "guidance", "plan",
                   "plan / smallest", "found", title=f"{title} (ms)")  # fmt: skip
    for row in rows:
        times = [1e3 * row[f"{name}_s"] for name in ("world", "scan", "guidance", "plan")]
        result.add_row(
            f"{row['size']:,}", f"{row['map_cells']:,.0f}", f"{row['in_reach']:.0f}",
            *(f"{each:.1f}" for each in times), f"{row['plan_s'] / rows[0]['plan_s']:.2f}",
            f"{row['planned']:.0f} of {row['scenes']:.0f}",
        )  # fmt: skip
    return result


def main() -> None:
    """Measure, print, store."""
    options, console = running.begin(
        __doc__,
        width=120,
        most=(100_000, "obstacles"),
        cells=(100.0, "of the DEM, in millions"),
        scenes=5,
    )
    kernel = load_kernel()
    smallest = drawn_world.spread_out(10)
    measured(smallest, near(smallest), kernel, seed=1)  # compiles
    grown = obstacles(options.most, options.scenes, kernel)
    console.print(table(grown, "Growth with the obstacles at equal density", "obstacles"))
    read = elevations(options.cells, options.scenes, kernel)
    console.print(table(read, "Growth with the elevation file", "cells of the DEM"))
    running.store(options.json, {"obstacles": grown, "elevation": read})


if __name__ == "__main__":
    main()
