import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.world.radars import Radar, detection_probability


@given(range_m=st.floats(1.0, 1e5), fraction=st.floats(0.0, 1.0))
def test_detection_is_equation_3_within_the_range_and_nothing_beyond(
    range_m: float, fraction: float
) -> None:
    d = np.array([fraction * range_m, range_m, np.nextafter(range_m, np.inf)])
    told = detection_probability(d, range_m)
    assert told[0] == pytest.approx(range_m**4 / (range_m**4 + d[0] ** 4))
    assert told[1:].tolist() == [0.5, 0.0]


def test_distance_from_a_radar_is_euclidean_for_any_shape_of_points() -> None:
    radar = Radar(name="r", centre_nea_m=(100.0, -200.0, 50.0), range_m=1.0)
    points = np.random.default_rng(1).normal(size=(3, 4, 3)) * 1_000.0
    distance = radar.distance_m(points)
    assert distance.shape == (3, 4)
    for index in np.ndindex(3, 4):
        assert distance[index] == pytest.approx(math.dist(points[index], radar.centre_nea_m))
