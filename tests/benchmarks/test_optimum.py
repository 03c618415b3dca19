import math
from dataclasses import replace

import numpy as np
import optimum
import pytest
from campaign_rows import row
from descent import Margins, Problem
from lattice import Lattice
from subpaths import world_of

from companion.campaign import drawn_world, truth
from companion.campaign.route_cost import Rates, cost_rate, curve_cost
from companion.world.radars import Radar
from companion.world.terrain import Peak, PeakTerrain


def small(
    *, radars: tuple[Radar, ...] = (), peaks: tuple[Peak, ...] = ()
) -> drawn_world.DrawnWorld:
    base = drawn_world.bundled("environment-2")
    limits = replace(base.task.limits, north_m=(-5e3, 45e3), east_m=(-20e3, 20e3))
    world = replace(
        base,
        terrain=PeakTerrain(peaks=peaks, ground_amsl_m=0.0),
        task=replace(base.task, limits=limits, radars=radars),
    )
    return replace(
        world, start_nea_m=(0.0, 0.0, world.floor_amsl_m), targets_ne_m=((40_000.0, 0.0),)
    )


PEAK = Peak(north_m=20e3, east_m=1e3, height_amsl_m=4_500.0, spread_north_m=4e3, spread_east_m=3e3)


def test_the_cost_of_level_flight_at_the_floor_is_the_paper_s_hundred_for_2_4_ranges() -> None:
    world = small()
    line = np.array([[n, 0.0, world.floor_amsl_m] for n in np.linspace(0.0, 40e3, 4)])
    wanted = world.task.settings.weights.length * 100.0 * 40e3 / (2.4 * 20e3)
    assert curve_cost(truth.sampled(line, 5.0), world) == pytest.approx(wanted, rel=1e-9)
    half = curve_cost(truth.sampled(line, 5.0), world, until_m=20e3)
    assert half == pytest.approx(0.5 * wanted, rel=1e-9)


def test_height_and_radars_cost_what_the_objective_charges_for_a_range_of_flight() -> None:
    radar = Radar(name="r", centre_nea_m=(0.0, 0.0, 0.0), range_m=8_000.0)
    world = small(radars=(radar,))
    at = np.array([[0.0, 0.0, world.ceiling_amsl_m], [30e3, 0.0, world.floor_amsl_m]])
    rates = cost_rate(at, world) * world.task.settings.scan_range_m
    weights = world.task.settings.weights
    seen = 1.0 / (1.0 + (world.ceiling_amsl_m / 8_000.0) ** 4)
    length = 100.0 * weights.length / 2.4
    assert rates[0] == pytest.approx(length + 100.0 * weights.height + 300.0 * weights.radar * seen)
    assert rates[1] == pytest.approx(length)


def test_gradients_are_those_of_finite_differences() -> None:
    soft = Radar(name="s", centre_nea_m=(10e3, -3e3, 0.0), range_m=6_000.0)
    hard = Radar(name="h", centre_nea_m=(30e3, 6e3, 0.0), range_m=8_000.0)
    solver = optimum.Solver(small(radars=(soft, hard), peaks=(PEAK,)))
    problem = Problem(solver.world, solver.surface, 12, (soft,), Margins())
    rng = np.random.default_rng(5)
    control = solver.curve(np.array([[0.0, 0.0], [40e3, 0.0]]), 12)
    control += rng.normal(scale=(500.0, 900.0, 60.0), size=control.shape)

    def parts(points: np.ndarray) -> list[float]:
        r, v, a = problem.b0 @ points, problem.b1 @ points, problem.b2 @ points
        values = [problem.cost(r, v, 40e3)[0]]
        return values + [float(ramp @ value) for value, _ in problem.bounds(r, v, a)]

    r, v, a = problem.b0 @ control, problem.b1 @ control, problem.b2 @ control
    ramp = np.linspace(1.0, 2.0, len(r))
    pulled = [(*problem.cost(r, v, 40e3)[1:], 0.0)]
    pulled += [pull(ramp) for _, pull in problem.bounds(r, v, a)]
    for control_point, axis in ((2, 0), (5, 1), (6, 2), (9, 1)):
        step = np.zeros_like(control)
        step[control_point, axis] = 0.01
        above, below = parts(control + step), parts(control - step)
        for number, (by_r, by_v, by_a) in enumerate(pulled):
            slope = sum(
                float(basis[:, control_point] @ (np.zeros_like(r) + by)[:, axis])
                for basis, by in ((problem.b0, by_r), (problem.b1, by_v), (problem.b2, by_a))
            )
            wanted = (above[number] - below[number]) / 0.02
            assert slope == pytest.approx(wanted, rel=2e-4, abs=1e-8), number


def test_the_way_round_one_radar_is_tangent_arc_tangent() -> None:
    aside = 2_000.0
    radar = Radar(name="r", centre_nea_m=(20e3, aside, 0.0), range_m=8_000.0)
    world = small(radars=(radar,))
    round_m = math.sqrt(8_000.0**2 - world.floor_amsl_m**2)
    far_m = math.hypot(20e3, aside)
    angle = 2.0 * (math.acos(aside / far_m) - math.acos(round_m / far_m))
    wanted_m = 2.0 * math.sqrt(far_m**2 - round_m**2) + round_m * angle
    solver = optimum.Solver(world)
    routes = solver.candidates()
    assert len(routes) >= 2  # to the left and to the right
    control = solver.improved(solver.curve(routes[0][1], 20), (), 60)
    cost, control = solver.mended(control, ())
    unit = Rates.of(world).unit
    assert wanted_m <= cost / unit <= 1.001 * wanted_m


def test_the_cheapest_way_over_an_open_grid_is_as_long_as_the_line_to_half_a_per_cent() -> None:
    world = replace(small(), targets_ne_m=((40e3, 13e3),))
    lattice = Lattice(world)
    rate = lattice.rate(over=False, radar_free=True)
    ((cost_m, route),) = lattice.ways(rate, 1, ((0.0, 0.0), (40e3, 13e3)))
    assert math.hypot(40e3, 13e3) <= cost_m + 1e-6 <= 1.005 * math.hypot(40e3, 13e3)
    np.testing.assert_allclose(route[[0, -1]], [[0.0, 0.0], [40e3, 13e3]])


def test_a_finer_curve_is_the_same_curve() -> None:
    control = np.random.default_rng(6).normal(size=(9, 3)) * 1_000.0
    u = np.linspace(0.0, 1.0, 50)
    finer = optimum.refined(control, 3 + 2 * (9 - 3))  # every span halved: no approximation
    np.testing.assert_allclose(truth.spline(finer)(u), truth.spline(control)(u), atol=1e-6)


@pytest.mark.parametrize("name", ["environment-1", "environment-2", "dense-0", "dense-8"])
def test_stored_optima_are_feasible_and_cost_what_is_said(name: str) -> None:
    world = world_of(name)
    known = optimum.load()
    assert world.fingerprint in known, "the world has changed: its row is stale"
    found = known[world.fingerprint]
    curve = truth.sampled(np.array(found.control_nea_m), 10.0)
    solver = optimum.Solver(world)
    assert solver.violations(solver.measured(curve)) == ()
    assert curve_cost(curve, world) == pytest.approx(found.cost, rel=1e-4)
    np.testing.assert_allclose(found.control_nea_m[0], world.start_nea_m)
    np.testing.assert_allclose(found.control_nea_m[-1][:2], world.targets_ne_m[0])


def test_costs_are_set_beside_the_optimum_of_their_own_world() -> None:
    dear, cheap, lost = row(0, cost=33.0), row(1, cost=60.0, world="b"), row(2, arrived=False)
    base = optimum.load()[world_of("dense-0").fingerprint]
    known = {
        optimum.place_of(dear): replace(base, cost=30.0),
        optimum.place_of(cheap): replace(base, cost=60.0),
    }
    assert optimum.ratios([dear, cheap, lost], known) == pytest.approx([1.1, 1.0])
    assert len(optimum.ratios([dear], {optimum.place_of(dear): None})) == 0
