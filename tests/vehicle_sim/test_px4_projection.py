"""PX4's local frame against pyproj's azimuthal equidistant projection of the same sphere."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

from vehicle_sim.autopilot.earth import Projection
from vehicle_sim.autopilot.values import Place


@given(
    latitude_deg=st.floats(-80.0, 80.0),
    longitude_deg=st.floats(-179.0, 179.0),
    north_m=st.floats(-50_000.0, 50_000.0),
    east_m=st.floats(-50_000.0, 50_000.0),
)
def test_there_and_back(
    latitude_deg: float, longitude_deg: float, north_m: float, east_m: float
) -> None:
    projection = Projection(Place(latitude_deg, longitude_deg, 400.0))
    back = projection.ned_m(projection.place(north_m, east_m, -30.0))
    assert back == pytest.approx((north_m, east_m, -30.0), abs=1e-4)


@pytest.mark.parametrize("origin", [(47.397742, 8.545594), (-33.9, 151.2), (0.0, 0.0)])
def test_it_is_pyprojs_on_the_sphere(origin: tuple[float, float]) -> None:
    latitude_deg, longitude_deg = origin
    transformer = Transformer.from_crs(
        "+proj=longlat +R=6371000 +no_defs",
        f"+proj=aeqd +lat_0={latitude_deg} +lon_0={longitude_deg} +R=6371000 +units=m",
        always_xy=True,
    )
    projection = Projection(Place(latitude_deg, longitude_deg, 0.0))
    for bearing_deg in range(0, 360, 37):
        for away_deg in (1e-5, 0.01, 0.5):
            north_deg = away_deg * math.cos(math.radians(bearing_deg))
            east_deg = away_deg * math.sin(math.radians(bearing_deg))
            place = (latitude_deg + north_deg, longitude_deg + east_deg)
            east_m, north_m = transformer.transform(place[1], place[0])
            there = projection.ned_m(Place(*place, 0.0))
            assert there == pytest.approx((north_m, east_m, 0.0), abs=1e-3)
