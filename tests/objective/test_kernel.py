"""The scalar objective, as plain Python; `test_flight` holds its terms against another form."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import cube, random_scene

from companion.objective import kernel
from companion.objective import scene as flight
from companion.world.radars import Radar

seeds = st.integers(0, 10**6)


@settings(max_examples=100)
@given(seed=seeds)
def test_the_cost_is_the_weighted_sum_of_the_terms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng)
    pack = kernel.pack(scene)
    for x in cube(rng, scene, 3):
        terms = dict(zip(kernel.TERMS, kernel.terms(x, pack), strict=True))
        weighted = sum(flight.weight(name, scene) * value for name, value in terms.items())
        assert kernel.cost(x, math.inf, pack) == pytest.approx(weighted, rel=1e-9)


@given(seed=seeds, margins=st.sampled_from([-0.01, 0.01, 0.5, 0.99, 1.01, 1.5]))
def test_a_radar_ends_at_its_range_and_margin(seed: int, margins: float) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, samples=12)
    x = cube(rng, scene, 1)
    pack = kernel.pack(scene)
    kernel.cost(x[0], math.inf, pack)
    centre = (2_000.0, 2_000.0, 0.0)
    nearest_m = float(np.linalg.norm(pack.points[1:, :3] - centre, axis=-1).min())
    radar = Radar(name="r", centre_nea_m=centre, range_m=nearest_m - margins * scene.radar_margin_m)
    scene = replace(scene, radars=(radar,))
    expected = 1.0 / (1.0 + (nearest_m / radar.range_m) ** 4) if margins < 1.0 else 0.0
    found = kernel.detection(pack.points, kernel.pack(scene).radars)
    assert found >= expected * (1.0 - 1e-12)
    assert (found > 0.0) == (margins < 1.0)


@given(seed=seeds)
def test_what_is_searched_is_what_is_flown(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng)
    x = cube(rng, scene, 1)
    pack = kernel.pack(scene)
    kernel.place_control_points(x[0], pack.control, pack.scene)
    np.testing.assert_allclose(
        pack.control, flight.control_points(x, scene)[0], rtol=1e-12, atol=1e-9
    )


@settings(max_examples=60)
@given(seed=seeds, share=st.sampled_from([0.0, 0.1, 0.4, 0.8, 0.97, 0.999999, 1.000001, 1.5]))
def test_beyond_a_bound_the_cost_is_infinite_and_below_it_the_cost(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, samples=12)
    x, pack = cube(rng, scene, 1)[0], kernel.pack(scene)
    cost = kernel.cost(x, math.inf, pack)
    assert kernel.cost(x, share * cost, pack) == (math.inf if share < 1.0 else cost)
    assert kernel.cost(x, cost, pack) == cost


@settings(max_examples=15)
@given(seed=seeds)
def test_a_pack_is_good_for_many_candidates_in_any_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, samples=12)
    x, pack = cube(rng, scene, 4), kernel.pack(scene)
    there = [kernel.cost(each, math.inf, pack) for each in x]
    back = [kernel.cost(each, math.inf, pack) for each in x[::-1]]
    assert there == back[::-1]
    assert there == [kernel.cost(each, math.inf, kernel.pack(scene)) for each in x]
