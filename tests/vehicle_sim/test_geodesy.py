import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod, Transformer

from vehicle_sim.dynamics.copter import Copter, Limits
from vehicle_sim.geodesy import LocalFrame, metres_per_degree

WGS84 = Geod(ellps="WGS84")
FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
PROJECTION = Transformer.from_crs(
    "EPSG:4326", "+proj=aeqd +lat_0=47 +lon_0=8 +ellps=WGS84", always_xy=True
)


@given(north_m=st.floats(-2e5, 2e5), east_m=st.floats(-2e5, 2e5))
def test_the_local_frame_is_the_azimuthal_equidistant_projection(
    north_m: float, east_m: float
) -> None:
    latitude_deg, longitude_deg = FRAME.to_geographic(north_m, east_m)
    x, y = PROJECTION.transform(longitude_deg, latitude_deg)
    assert (y, x) == pytest.approx((north_m, east_m), abs=1e-3)
    assert FRAME.to_local(latitude_deg, longitude_deg) == pytest.approx((north_m, east_m), abs=1e-6)


@given(latitude_deg=st.floats(-80, 80))
def test_a_degree_is_as_long_as_the_geodesic_along_it(latitude_deg: float) -> None:
    small = 1e-4
    _, _, north_m = WGS84.inv(8, latitude_deg - small / 2, 8, latitude_deg + small / 2)
    _, _, east_m = WGS84.inv(8, latitude_deg, 8 + small, latitude_deg)
    expected = (north_m / small, east_m / small)
    assert metres_per_degree(latitude_deg) == pytest.approx(expected, rel=1e-6)


def test_flying_true_north_140_km_away_follows_the_meridian_there() -> None:
    latitude_deg, longitude_deg = FRAME.to_geographic(1e5, 1e5)
    copter = Copter(
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_amsl_m=3000.0,
        limits=Limits(
            speed_m_s=170.0,
            acceleration_m_s2=10.0,
            speed_vertical_m_s=25.0,
            acceleration_vertical_m_s2=5.0,
        ),
    )
    copter.velocity_north_m_s = 150.0
    for _ in range(10_000):
        copter.advance(0.0, 0.0, 0.0, 0.01)
    azimuth_deg, _, distance_m = WGS84.inv(
        longitude_deg, latitude_deg, copter.longitude_deg, copter.latitude_deg
    )
    assert distance_m == pytest.approx(15_000.0, abs=0.01)
    assert azimuth_deg == pytest.approx(0.0, abs=1e-9)
    north_m, east_m = FRAME.to_local(copter.latitude_deg, copter.longitude_deg)
    # Meridians converge: in the local frame the way leads about a degree to the west there.
    assert math.degrees(math.atan2(east_m - 1e5, north_m - 1e5)) == pytest.approx(-0.97, abs=0.15)
