"""The scalar objective, as plain Python; `test_flight` holds its terms against another form."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import cube, random_scene

from companion.objective import kernel
from companion.objective.scene import radar_table
from companion.world.radars import Radar

seeds = st.integers(0, 10**6)


@given(seed=seeds, margins=st.sampled_from([-0.01, 0.01, 0.5, 0.99, 1.01, 1.5]))
def test_a_radar_ends_at_its_range_and_margin(seed: int, margins: float) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, samples=12)
    x = cube(rng, scene, 1)
    kernel.cost(x[0], math.inf, scene)
    centre, margin_m = (2_000.0, 2_000.0, 0.0), 2.5
    nearest_m = float(np.linalg.norm(scene.at.points[1:, :3] - centre, axis=-1).min())
    radar = Radar(name="r", centre_nea_m=centre, range_m=nearest_m - margins * margin_m)
    expected = 1.0 / (1.0 + (nearest_m / radar.range_m) ** 4) if margins < 1.0 else 0.0
    found = kernel.detection(scene.at.points, radar_table((radar,), margin_m))
    assert found >= expected * (1.0 - 1e-12)
    assert (found > 0.0) == (margins < 1.0)


@settings(max_examples=60)
@given(seed=seeds, share=st.sampled_from([0.0, 0.1, 0.4, 0.8, 0.97, 0.999999, 1.000001, 1.5]))
def test_beyond_a_bound_the_cost_is_infinite_and_below_it_the_cost(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, samples=12)
    x = cube(rng, scene, 1)[0]
    cost = kernel.cost(x, math.inf, scene)
    assert kernel.cost(x, share * cost, scene) == (math.inf if share < 1.0 else cost)
    assert kernel.cost(x, cost, scene) == cost


@settings(max_examples=15)
@given(seed=seeds)
def test_a_workspace_is_good_for_many_candidates_in_any_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, samples=12)
    x = cube(rng, scene, 4)
    there = [kernel.cost(each, math.inf, scene) for each in x]
    back = [kernel.cost(each, math.inf, scene) for each in x[::-1]]
    assert there == back[::-1]
    assert there == [kernel.cost(each, math.inf, scene.with_points(scene.points)) for each in x]
