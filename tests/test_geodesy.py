"""Metres and degrees are those of pyproj."""

import cmath
import math

import pyproj
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from companion.geodesy import LocalFrame, deg, deg_e7, offset_deg, wrap_rad

GEOD = pyproj.Geod(ellps="WGS84")
HERE = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)

latitudes = st.floats(-80.0, 80.0)
longitudes = st.floats(-180.0, 180.0)
frames = st.builds(LocalFrame, latitude_deg=latitudes, longitude_deg=longitudes)
metres = st.floats(-150_000.0, 150_000.0)


def angle_between(a_rad: float, b_rad: float) -> float:
    return abs(cmath.phase(cmath.rect(1.0, a_rad - b_rad)))


@given(frame=frames, azimuth_deg=st.floats(-180.0, 180.0), distance_m=st.floats(0.0, 150_000.0))
def test_distance_and_direction_from_the_origin_are_those_of_the_geodesic_there_and_back(
    frame: LocalFrame, azimuth_deg: float, distance_m: float
) -> None:
    """And an offset by as much lies there, too."""
    origin = frame.latitude_deg, frame.longitude_deg
    longitude, latitude, _ = GEOD.fwd(*origin[::-1], azimuth_deg, distance_m)
    north_m, east_m = frame.to_local_m(latitude, longitude)
    expected = cmath.rect(distance_m, math.radians(azimuth_deg))
    assert abs(complex(north_m, east_m) - expected) < 1e-3
    for there in (frame.to_geodetic_deg(north_m, east_m), offset_deg(*origin, north_m, east_m)):
        assert frame.to_local_m(*there) == pytest.approx((north_m, east_m), abs=1e-3)


@given(
    frame=st.builds(LocalFrame, latitude_deg=st.floats(-70.0, 70.0), longitude_deg=longitudes),
    north_m=metres,
    east_m=metres,
)
def test_a_step_to_true_north_leans_from_the_frames_north_by_the_convergence(
    frame: LocalFrame, north_m: float, east_m: float
) -> None:
    latitude, longitude = frame.to_geodetic_deg(north_m, east_m)
    farther_lon, farther_lat, _ = GEOD.fwd(longitude, latitude, 0.0, 100.0)
    north_b, east_b = frame.to_local_m(farther_lat, farther_lon)
    true_north_in_frame = math.atan2(east_b - east_m, north_b - north_m)
    # 3e-4: the projection is not conformal, it stretches by (d / earth)^2 / 6 across the radius
    assert angle_between(-true_north_in_frame, frame.grid_north_rad(north_m, east_m)) < 3e-4


@given(
    frame=st.builds(LocalFrame, latitude_deg=st.floats(-70.0, 70.0), longitude_deg=longitudes),
    share=st.tuples(*[st.floats(0.0, 1.0)] * 4),
    far_m=st.floats(100.0, 150_000.0),
)
def test_no_frame_of_a_map_has_its_north_farther_from_the_true_one_than_the_convergence(
    frame: LocalFrame, share: tuple[float, float, float, float], far_m: float
) -> None:
    north_m, east_m = (-5e3, -5e3 + far_m), (-0.3 * far_m, far_m)
    at, other = (
        frame.to_geodetic_deg(
            north_m[0] + a * (north_m[1] - north_m[0]), east_m[0] + b * (east_m[1] - east_m[0])
        )
        for a, b in (share[:2], share[2:])
    )
    mine = LocalFrame(latitude_deg=at[0], longitude_deg=at[1])
    _, _, apart_m = GEOD.inv(at[1], at[0], other[1], other[0])
    assume(apart_m > 1.0)
    away_rad = angle_between(mine.grid_north_rad(*mine.to_local_m(*other)), 0.0)
    assert away_rad <= frame.convergence_rad(north_m, east_m) * 1.02 + 3e-4


@given(st.integers(-1_800_000_000, 1_800_000_000), st.floats(-0.5, 0.5))
def test_degrees_become_the_nearest_integer_of_the_wire(degrees_e7: int, off: float) -> None:
    assert deg_e7(deg(degrees_e7)) == degrees_e7
    assert abs(deg_e7((degrees_e7 + off) * 1e-7) - degrees_e7 - off) <= 0.500001


@given(st.floats(-1_000.0, 1_000.0))
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle: float) -> None:
    wrapped = wrap_rad(angle)
    assert -math.pi <= wrapped <= math.pi
    assert abs(cmath.rect(1.0, wrapped) - cmath.rect(1.0, angle)) < 1e-9
