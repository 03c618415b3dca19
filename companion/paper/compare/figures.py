"""Fig. 3 and Fig. 4: what a parameter of the planner decides (4.1).

In the bundled environments neither effect shows: their mountains on the way rise above the band,
and their radars are not passed where they overlap.  So each figure has a small world of its own,
100 km x 100 km, flown from corner to corner as in the paper.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from companion.geodesy import FloatArray
from companion.paper.compare.missions import Case, Comparison, Outcome, bundled_case
from companion.paper.compare.table_1 import PER_SECOND
from companion.profiles import Weights
from companion.world.radars import Radar
from companion.world.terrain import Peak, PeakTerrain

_T_S = 3.0
_RADAR_RANGE_M, _RADARS_OVERLAP_M, _RADARS_ASIDE_M = 16_000.0, 2_500.0, 1_000.0
_RIDGE = tuple((k * 1e3, 100e3 - k * 1e3, 3_900.0, 10_000.0) for k in (42.0, 50.0, 58.0))
_HILLS = (
    (88_000.0, 25_000.0, 4_200.0, 6_000.0),
    (22_000.0, 86_000.0, 4_800.0, 6_000.0),
    (66_000.0, 92_000.0, 3_400.0, 6_000.0),
)
"""Peaks: north, east, height AMSL and spread, metres."""
Point = tuple[float, float]


def figure_3(per_second: int = PER_SECOND) -> Comparison:
    """Fig. 3: climb over a ridge or go round it, by the weights of height and guide."""
    base = _world("ridge", _RIDGE, (), per_second)
    settings = (
        ("climbs over", Weights(height=0.15, guide=0.15)),
        ("goes round", Weights(height=0.25, guide=0.05)),
    )
    return _effect(
        title="Fig. 3: 3D path and vertical profile for two weightings",
        paper="“UAV can choose climbing or bypassing the mountain by weighing the relative size "
        "of a2 and a3”; it “chooses bypassing the mountains when we increase the proportion of a2”",
        across="climbs over",
        line_ne_m=(_RIDGE[0][:2], _RIDGE[-1][:2]),
        cases=[
            replace(
                base.planned_with(weights=w),
                label=f"a2 = {w.height:g}, a3 = {w.guide:g}",
                papers_way=way,
            )
            for way, w in settings
        ],
    )


def figure_4(per_second: int = PER_SECOND) -> Comparison:
    """Fig. 4: fly between two overlapping radars or round both, by d_overlap."""
    half_m = _RADAR_RANGE_M - 0.5 * _RADARS_OVERLAP_M
    aside_m = [math.sqrt(0.5) * (_RADARS_ASIDE_M + side * half_m) for side in (-1.0, 1.0)]
    centres = [(50_000.0 - each_m, 50_000.0 + each_m) for each_m in aside_m]
    radars = tuple(
        Radar(name=f"radar {number}", centre_nea_m=(*centre, 0.0), range_m=_RADAR_RANGE_M)
        for number, centre in enumerate(centres, start=1)
    )
    base = _world("two radars", _HILLS, radars, per_second)
    return _effect(
        title="Fig. 4: 3D path for two values of d_overlap",
        paper="“when the value of d_overlap is small UAV will bypass all radars, otherwise it may "
        "traverse through the intersection of two radars”",
        across="flies between",
        line_ne_m=(centres[0], centres[1]),
        cases=[
            replace(
                base.planned_with(overlap_m=1000.0 * km),
                label=f"d_overlap = {km:g} km",
                papers_way=way,
            )
            for way, km in (("goes round", 2.0), ("flies between", 6.0))
        ],
    )


def _effect(
    *, title: str, paper: str, across: str, line_ne_m: tuple[Point, Point], cases: Sequence[Case]
) -> Comparison:
    """Settings with which routes cross a line, and are said to, or go round it.

    paper: its description.
    """

    def ways(outcome: Outcome) -> list[str]:
        crossed = (crosses(run.route_nea_m, *line_ne_m) for run in outcome.runs)
        return [across if each else "goes round" for each in crossed]

    def as_the_papers(outcome: Outcome) -> str:
        way = outcome.case.papers_way
        return f"{way}: {ways(outcome).count(way)}/{len(outcome.runs)}"

    columns: dict[str, Callable[[Outcome], str]] = {
        "way": as_the_papers,
        "arrived": lambda outcome: outcome.arrivals,
        "cost": lambda outcome: f"{outcome.shown.cost:.1f}",
        "length": lambda outcome: f"{outcome.shown.length_m / 1000:.1f} km",
        "highest": lambda outcome: f"{outcome.shown.highest_amsl_m / 1000:.2f} km",
        "in radars": lambda outcome: f"{outcome.shown.violations['radar'] / 1000:.1f} km",
    }
    remarks = [
        f"The paper: {paper}.",
        "Cost, length and heights are those of the run of median cost, which the picture shows. "
        f"Improved DE, {cases[0].task.settings.evaluations:,} evaluations for T = {_T_S:g} s.",
    ]
    return Comparison(
        cases=cases,
        tables={title: columns},
        remarks=lambda _: remarks,
        more=lambda each: {"papers_way": each.case.papers_way, "ways": ways(each)},
    )


def crosses(route_nea_m: FloatArray, one_ne_m: Point, two_ne_m: Point) -> bool:
    """Whether a route passes between two points, seen from above.  (S, 3)."""
    one = complex(*one_ne_m)
    place = (route_nea_m[:, 0] + 1j * route_nea_m[:, 1] - one) / (complex(*two_ne_m) - one)
    before = np.nonzero(np.diff(place.imag < 0.0))[0]  # the points lie at 0 and 1
    here, there = place[before], place[before + 1]
    at = here.real + here.imag / (here.imag - there.imag) * (there.real - here.real)
    return bool(np.any((at > 0.0) & (at < 1.0)))


def _world(
    name: str,
    peaks: Sequence[tuple[float, float, float, float]],
    radars: tuple[Radar, ...],
    per_second: int,
) -> Case:
    """A world with the vehicle, the band and the planner of environment-1."""
    base = bundled_case("environment-1").planned_with(
        optimiser="improved-de", planning_time_s=_T_S, evaluations=round(_T_S * per_second)
    )
    made = (
        Peak(north_m=n, east_m=e, height_amsl_m=height, spread_north_m=spread, spread_east_m=spread)
        for n, e, height, spread in peaks
    )
    terrain = PeakTerrain(peaks=tuple(made), ground_amsl_m=0.0)
    return replace(base, world=name, terrain=terrain, task=replace(base.task, radars=radars))
