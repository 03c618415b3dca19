"""Families of random worlds to measure missions in, each world from (family, seed, index) alone.

The default seed draws what the tables of docs/benchmarks.md were measured in; another seed draws
worlds that nobody has seen.  Every world has a way through at the floor of the band, outside all
radars and keep-outs, by a flood fill that knows nothing of planners, and its straight line is
barred; what has not is drawn again.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import optimum
import worlds
from numpy.typing import NDArray
from worlds import BenchmarkWorld

from companion.world.terrain import Peak, PeakTerrain
from companion.world.threats import Radar

FloatArray = NDArray[np.float64]

SEED = 0
"""The default: the families `dense` and `sparse` are then what they have always been."""
_SPARE = 0.0375  # of R: half the width of the way through, beside the clearance
_MOST_DRAWS = 2_000
_SOLVER_SIDE_M = 110_000.0


@functools.cache
def world(family: str, seed: int, index: int) -> BenchmarkWorld:
    """One world, always the same for the same three."""
    if family in ("dense", "sparse"):
        return (worlds.dense if family == "dense" else worlds.sparse)(index, seed)
    stream, draw = _FAMILIES[family]
    rng = np.random.default_rng((stream, seed, index))
    for _ in range(_MOST_DRAWS):
        drawn = draw(rng, f"{family}-{seed}-{index}")
        if drawn is not None and has_way(drawn) and not worlds.is_straight_line_free(drawn):
            return drawn
    raise AssertionError(f"{family}: no world {index} of seed {seed} in {_MOST_DRAWS} draws")


def has_way(drawn: BenchmarkWorld) -> bool:
    """Whether there is a way through with some room."""
    return worlds.has_way_through(drawn, _SPARE * drawn.task.settings.scan_range_m)


# --- 100 km x 100 km, the mission of environment-2


def _gathered(rng: np.random.Generator, name: str) -> BenchmarkWorld:
    """12 mountains and 10 radars gathered about the straight line, where the mission must pass."""
    base = worlds.bundled("environment-2")
    peaks: list[Peak] = []
    while len(peaks) < 12:
        north, east = _beside_the_line(rng, base, 18_000.0)
        height = float(rng.uniform(3_400.0, 6_000.0))
        spreads = rng.uniform(4_000.0, 8_000.0, 2).tolist()
        if _leaves_ends(base, (north, east), max(spreads) * math.sqrt(math.log(height / 2_400.0))):
            peaks.append(
                Peak(
                    north_m=north,
                    east_m=east,
                    height_amsl_m=height,
                    spread_north_m=spreads[0],
                    spread_east_m=spreads[1],
                )
            )
    radars: list[Radar] = []
    while len(radars) < 10:
        north, east = _beside_the_line(rng, base, 20_000.0)
        reach = float(rng.uniform(6_000.0, 11_000.0))
        if _leaves_ends(base, (north, east), reach):
            name_ = f"radar {len(radars) + 1}"
            radars.append(Radar(name=name_, centre_nea_m=(north, east, 0.0), range_m=reach))
    return replace(
        base,
        name=name,
        terrain=PeakTerrain(peaks=tuple(peaks), ground_amsl_m=0.0),
        task=replace(base.task, radars=tuple(radars), zones=()),
    )


def _beside_the_line(
    rng: np.random.Generator, base: BenchmarkWorld, aside_m: float
) -> tuple[float, float]:
    """A place about the middle three quarters of the straight line, normally so far aside."""
    start, target = np.array(base.start_nea_m[:2]), np.array(base.targets_ne_m[0])
    ahead = (target - start) / np.linalg.norm(target - start)
    at = start + rng.uniform(0.125, 0.875) * (target - start)
    at += rng.normal(0.0, aside_m) * np.array([-ahead[1], ahead[0]])
    return float(at[0]), float(at[1])


def _leaves_ends(base: BenchmarkWorld, at_ne_m: tuple[float, float], reach_m: float) -> bool:
    """Whether something so large leaves room about the start and the target."""
    ends = (base.start_nea_m[:2], base.targets_ne_m[0])
    return all(math.dist(at_ne_m, end) >= reach_m + 3_000.0 for end in ends)


# --- the optimum


def best(drawn: BenchmarkWorld) -> optimum.Optimum:
    """The full-knowledge optimum, found in the world at the size that its solver is made for.

    J is the same at every size.  ValueError: none was found.
    """
    limits = drawn.task.limits
    side = max(limits.north_m[1] - limits.north_m[0], limits.east_m[1] - limits.east_m[0])
    scale = _SOLVER_SIDE_M / side
    if abs(scale - 1.0) < 1e-9:
        return optimum.optimum(drawn)
    found = optimum.optimum(worlds.scaled(drawn, scale))
    return replace(
        found,
        fingerprint=drawn.fingerprint,
        length_m=found.length_m / scale,
        shortest_m=found.shortest_m / scale,
        radar_m=found.radar_m / scale,
        control_nea_m=tuple((n / scale, e / scale, a / scale) for n, e, a in found.control_nea_m),
    )


_Draw = Callable[[np.random.Generator, str], BenchmarkWorld | None]
_FAMILIES: dict[str, tuple[int, _Draw]] = {
    "gathered": (11, _gathered),
}
FAMILIES = ("dense", "sparse", *_FAMILIES)
