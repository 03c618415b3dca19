import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.paper.compare import figures
from companion.paper.compare.missions import fly_all

coordinate = st.floats(-100.0, 100.0)
Point = tuple[float, float]


@given(ends=st.tuples(*[st.tuples(coordinate, coordinate)] * 4))
def test_a_straight_route_crosses_a_line_when_each_separates_the_ends_of_the_other(
    ends: tuple[Point, Point, Point, Point],
) -> None:
    a, b, c, d = ends

    def left_of(p: Point, q: Point, r: Point) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    turns = [left_of(c, d, a), left_of(c, d, b), left_of(a, b, c), left_of(a, b, d)]
    if min(abs(turn) for turn in turns) < 1e-6:
        return  # they touch: either answer is right
    expected = turns[0] * turns[1] < 0.0 and turns[2] * turns[3] < 0.0
    route = np.array([(*a, 0.0), (*b, 0.0)])
    assert figures.crosses(route, c, d) == expected
    middle = np.array([(*a, 0.0), ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, 9.0), (*b, 0.0)])
    assert figures.crosses(middle, c, d) == expected


def test_a_route_that_crosses_beyond_the_ends_goes_round() -> None:
    route = np.array([(0.0, 0.0, 0.0), (10.0, 20.0, 0.0), (20.0, 0.0, 0.0)])
    assert not figures.crosses(route, (10.0, -5.0), (10.0, 5.0))
    assert figures.crosses(route, (10.0, -5.0), (10.0, 25.0))


def test_the_weights_of_figure_3_are_the_papers() -> None:
    weights = [case.task.settings.weights for case in figures.figure_3().cases]
    assert [(w.height, w.guide) for w in weights] == [(0.15, 0.15), (0.25, 0.05)]
    assert all((w.length, w.crash, w.radar, w.constraints) == (0.1, 0.3, 0.3, 1) for w in weights)


def test_the_radars_of_figure_4_overlap_by_more_than_one_d_overlap_and_less_than_the_other() -> (
    None
):
    small, large = (case.task for case in figures.figure_4().cases)
    one, two = small.radars
    apart = math.dist(one.centre_nea_m, two.centre_nea_m)
    overlap = one.range_m + two.range_m - apart
    assert small.settings.overlap_m == 2_000.0 < overlap < large.settings.overlap_m == 6_000.0


@pytest.mark.parametrize(("runs", "seed"), [(1, 2), pytest.param(3, 1, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("effect", [figures.figure_3(), figures.figure_4()], ids=lambda e: e.name)
def test_the_paper_s_way_is_flown_in_both_settings(
    effect: figures.Effect, runs: int, seed: int
) -> None:
    found = fly_all(effect.cases, runs, seed, 1)
    # a search of chance: nearly always
    for outcome, way in zip(found, effect.papers_ways, strict=True):
        assert effect.ways(outcome).count(way) >= (runs + 1) // 2
        assert outcome.arrivals == f"{runs}/{runs}"
    assert set(effect.papers_ways) == {effect.across, effect.round}
    facts = json.loads(json.dumps(figures.facts(effect, found), allow_nan=False))
    assert [each["ways"] for each in facts] == [effect.ways(outcome) for outcome in found]
    one, other = (outcome.shown for outcome in found)
    if effect.name == "figure-3":  # over: higher and shorter
        over, past = one, other
        assert over.route_nea_m[:, 2].max() > past.route_nea_m[:, 2].max() + 300.0
        assert over.length_m < past.length_m
    else:  # between: through what both radars see
        past, between = one, other
        assert past.violations.radar_m == 0.0
        assert between.violations.radar_m > 5_000.0
