"""Fig. 3 and Fig. 4: what a parameter of the planner decides (4.1).

In the bundled environments neither effect shows: their mountains on the way rise above the band,
and their radars are not passed where they overlap.  So each figure has a small world of its own,
100 km x 100 km, flown from corner to corner as in the paper.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from rich.table import Table

from companion.geodesy import FloatArray
from companion.paper.compare.missions import (
    Case,
    Outcome,
    bundled_case,
    narrow_table,
    planned_with,
)
from companion.profiles import Weights
from companion.world.radars import Radar
from companion.world.terrain import Peak, PeakTerrain

_T_S, _EVALUATIONS = 3.0, 3000  # as in Table 1
_RADAR_RANGE_M, _RADARS_OVERLAP_M, _RADARS_ASIDE_M = 16_000.0, 2_500.0, 1_000.0
_RIDGE = tuple((k * 1e3, 100e3 - k * 1e3, 3_900.0, 10_000.0) for k in (42.0, 50.0, 58.0))
_HILLS = (
    (88_000.0, 25_000.0, 4_200.0, 6_000.0),
    (22_000.0, 86_000.0, 4_800.0, 6_000.0),
    (66_000.0, 92_000.0, 3_400.0, 6_000.0),
)
"""Peaks: north, east, height AMSL and spread, metres."""
Point = tuple[float, float]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """A figure of the paper: two settings, and a line that routes cross or go round."""

    name: str
    title: str
    paper: str
    """The paper's description."""
    across: str
    round: str
    line_ne_m: tuple[Point, Point]
    cases: tuple[Case, Case]
    papers_ways: tuple[str, str]
    """Which way the paper's panels go."""

    def ways(self, outcome: Outcome) -> list[str]:
        """Which way each run of a setting went."""
        crossed = (crosses(run.route_nea_m, *self.line_ne_m) for run in outcome.runs)
        return [self.across if each else self.round for each in crossed]


def figure_3() -> Effect:
    """Climb over a ridge, or go round it: the weights of height (a2) and guide (a3)."""
    over, past = "climbs over", "goes round"
    base = _world("ridge", _RIDGE, ())
    settings = (Weights(height=0.15, guide=0.15), Weights(height=0.25, guide=0.05))
    one, two = (
        replace(planned_with(base, weights=w), label=f"a2 = {w.height:g}, a3 = {w.guide:g}")
        for w in settings
    )
    return Effect(
        name="figure-3",
        title="Fig. 3: 3D path and vertical profile for two weightings",
        paper="“UAV can choose climbing or bypassing the mountain by weighing the relative size "
        "of a2 and a3”; it “chooses bypassing the mountains when we increase the proportion of a2”",
        line_ne_m=(_RIDGE[0][:2], _RIDGE[-1][:2]),
        cases=(one, two),
        papers_ways=(over, past),
        across=over,
        round=past,
    )


def figure_4() -> Effect:
    """Fly between two overlapping radars, or round both: d_overlap."""
    half_m, between, past = _RADAR_RANGE_M - 0.5 * _RADARS_OVERLAP_M, "flies between", "goes round"
    aside_m = [math.sqrt(0.5) * (_RADARS_ASIDE_M + side * half_m) for side in (-1.0, 1.0)]
    centres = [(50_000.0 - each_m, 50_000.0 + each_m) for each_m in aside_m]
    radars = tuple(
        Radar(name=f"radar {number}", centre_nea_m=(*centre, 0.0), range_m=_RADAR_RANGE_M)
        for number, centre in enumerate(centres, start=1)
    )
    base = _world("two radars", _HILLS, radars)
    one, two = (
        replace(planned_with(base, overlap_m=1000.0 * km), label=f"d_overlap = {km:g} km")
        for km in (2.0, 6.0)
    )
    return Effect(
        name="figure-4",
        title="Fig. 4: 3D path for two values of d_overlap",
        paper="“when the value of d_overlap is small UAV will bypass all radars, otherwise it may "
        "traverse through the intersection of two radars”",
        line_ne_m=(centres[0], centres[1]),
        cases=(one, two),
        papers_ways=(past, between),
        across=between,
        round=past,
    )


def table(effect: Effect, found: Sequence[Outcome]) -> Table:
    """What each setting leads to."""
    headings = ("way", "arrived", "cost", "length", "highest", "in radars")
    result = narrow_table(effect.title, *headings)
    for outcome, way in zip(found, effect.papers_ways, strict=True):
        shown = outcome.shown
        result.add_row(
            outcome.case.label,
            f"{way}: {effect.ways(outcome).count(way)}/{len(outcome.runs)}",
            outcome.arrivals,
            f"{shown.cost:.1f}",
            f"{shown.length_m / 1000:.1f} km",
            f"{shown.route_nea_m[:, 2].max() / 1000:.2f} km",
            f"{shown.violations.radar_m / 1000:.1f} km",
        )
    return result


def remarks(effect: Effect) -> list[str]:
    """What the table cannot say by itself."""
    return [
        f"The paper: {effect.paper}.",
        "Cost, length and heights are those of the run of median cost, which the picture shows. "
        f"Improved DE, {_EVALUATIONS:,} evaluations for T = {_T_S:g} s.",
    ]


def facts(effect: Effect, found: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Everything in the table, and more, for --json."""
    return [
        outcome.facts() | {"papers_way": way, "ways": effect.ways(outcome)}
        for outcome, way in zip(found, effect.papers_ways, strict=True)
    ]


def crosses(route_nea_m: FloatArray, one_ne_m: Point, two_ne_m: Point) -> bool:
    """Whether a route passes between two points, seen from above.  (S, 3)."""
    one = np.asarray(one_ne_m)
    along = np.asarray(two_ne_m) - one
    offset = route_nea_m[:, :2] - one
    side = offset[:, 0] * along[1] - offset[:, 1] * along[0]
    before = np.nonzero((side[:-1] < 0.0) != (side[1:] < 0.0))[0]
    part = (side[before] / (side[before] - side[before + 1]))[:, None]
    meets = offset[before] + part * (offset[before + 1] - offset[before])
    at = meets @ along / (along @ along)
    return bool(np.any((at > 0.0) & (at < 1.0)))


def _world(
    name: str, peaks: Sequence[tuple[float, float, float, float]], radars: tuple[Radar, ...]
) -> Case:
    """A world with the vehicle, the band and the planner of environment-1."""
    base = planned_with(
        bundled_case("environment-1"),
        optimiser="improved-de",
        planning_time_s=_T_S,
        evaluations=_EVALUATIONS,
    )
    made = tuple(
        Peak(
            north_m=north_m,
            east_m=east_m,
            height_amsl_m=height_m,
            spread_north_m=spread_m,
            spread_east_m=spread_m,
        )
        for north_m, east_m, height_m, spread_m in peaks
    )
    terrain = PeakTerrain(peaks=made, ground_amsl_m=0.0)
    return replace(base, world=name, terrain=terrain, task=replace(base.task, radars=radars))
