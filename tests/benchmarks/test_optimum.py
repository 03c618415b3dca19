import math
from dataclasses import replace

import numpy as np
import optimum
import pytest
from campaign_rows import row

from companion.campaign import drawn_world, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.library import route_terms
from companion.world.radars import Radar
from companion.world.terrain import PeakTerrain


def small(*radars: Radar, target_ne_m: tuple[float, float] = (40e3, 0.0)) -> DrawnWorld:
    """A level world."""
    base = drawn_world.bundled("environment-2")
    limits = replace(base.task.limits, north_m=(-5e3, 45e3), east_m=(-20e3, 20e3))
    return replace(
        base,
        terrain=PeakTerrain(peaks=(), ground_amsl_m=0.0),
        task=replace(base.task, limits=limits, radars=radars),
        start_nea_m=(0.0, 0.0, base.floor_amsl_m),
        targets_ne_m=(target_ne_m,),
    )


def test_the_cost_of_level_flight_at_the_floor_is_the_paper_s_hundred_for_2_4_ranges() -> None:
    world = small()
    line = np.array([[n, 0.0, world.floor_amsl_m] for n in np.linspace(0.0, 40e3, 4)])
    wanted = world.task.settings.weights.length * 100.0 * 40e3 / (2.4 * 20e3)
    points = truth.sampled(line, 5.0).points_nea_m
    assert sum(route_terms(points, world.task).values()) == pytest.approx(wanted, rel=1e-9)


def test_the_way_round_one_radar_is_tangent_arc_tangent() -> None:
    aside = 2_000.0
    radar = Radar(name="r", centre_nea_m=(20e3, aside, 0.0), range_m=8_000.0)
    world = small(radar)
    round_m = math.sqrt(8_000.0**2 - world.floor_amsl_m**2)
    far_m = math.hypot(20e3, aside)
    angle = 2.0 * (math.acos(aside / far_m) - math.acos(round_m / far_m))
    wanted_m = 2.0 * math.sqrt(far_m**2 - round_m**2) + round_m * angle
    solver = optimum.Solver(world)
    routes = solver.candidates()
    assert len(routes) >= 2  # to the left and to the right
    control = solver.improved(solver.curve(routes[0][1], 20), (), 60)
    cost, control = solver.mended(control, ())
    assert wanted_m <= cost / solver.grid.unit <= 1.001 * wanted_m


@pytest.mark.parametrize("end", [(40e3, 13e3), (25e3, 18e3), (25e3, -18e3)])
def test_the_cheapest_way_over_an_open_grid_is_as_long_as_the_line_to_half_a_per_cent(
    end: tuple[float, float],
) -> None:
    grid = optimum.Grid(small(target_ne_m=end))
    ((cost_m, route),) = grid.ways(grid.rate(over=False, radar_free=True), 1, ((0.0, 0.0), end))
    assert math.hypot(*end) <= cost_m + 1e-6 <= 1.005 * math.hypot(*end)
    np.testing.assert_allclose(route[[0, -1]], [[0.0, 0.0], end])


def test_an_optimum_is_feasible_costs_what_is_said_and_what_a_flight_cannot_beat() -> None:
    world = drawn_world.bundled("environment-1")
    cost, control_nea_m = optimum.optimum(world)
    curve = truth.sampled(control_nea_m, 10.0)
    assert truth.measure(curve, world.terrain, world.task).violations(world.task) == ()
    terms = route_terms(curve.points_nea_m, world.task)
    assert sum(terms.values()) == pytest.approx(cost, rel=1e-4)
    assert cost == pytest.approx(29.73376, rel=1e-4)  # by gradients that were written by hand
    np.testing.assert_allclose(control_nea_m[0], world.start_nea_m)
    np.testing.assert_allclose(control_nea_m[-1][:2], world.targets_ne_m[0])


def test_costs_are_set_beside_the_optimum_of_their_own_world() -> None:
    dear, cheap, lost = row(0, cost=33.0), row(1, cost=60.0, world="b"), row(2, arrived=False)
    known = {optimum.place_of(dear): 30.0, optimum.place_of(cheap): 60.0}
    assert optimum.ratios([dear, cheap, lost], known) == pytest.approx([1.1, 1.0])
    assert len(optimum.ratios([dear], {optimum.place_of(dear): None})) == 0
