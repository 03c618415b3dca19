"""Metres and degrees are those of pyproj, and nothing changes where 180 becomes -180 degrees."""

from collections.abc import Sequence
from typing import Any

import pytest
from harness import KINDS, Rig, heartbeat
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

from vehicle_sim.autopilot.earth import Projection
from vehicle_sim.autopilot.values import Place
from vehicle_sim.geodesy import LocalFrame

ANYWHERE = {"latitude_deg": st.floats(-80.0, 80.0), "longitude_deg": st.floats(-179.0, 179.0)}
AWAY = {"north_m": st.floats(-1e5, 1e5), "east_m": st.floats(-1e5, 1e5)}


@given(**ANYWHERE, **AWAY)
def test_frames_are_pyprojs_azimuthal_equidistant_ones_there_and_back(
    latitude_deg: float, longitude_deg: float, north_m: float, east_m: float
) -> None:
    """The world's on the ellipsoid, an autopilot's on the sphere."""

    def flat(latitude: float, longitude: float, earth: str) -> Any:
        here = f"+proj=aeqd +lat_0={latitude_deg} +lon_0={longitude_deg} +units=m {earth}"
        there = Transformer.from_crs(f"+proj=longlat +no_defs {earth}", here, always_xy=True)
        return pytest.approx(there.transform(longitude, latitude)[::-1], abs=1e-3)

    frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    there = frame.to_geographic(north_m, east_m)
    assert (north_m, east_m) == flat(*there, "+ellps=WGS84")
    assert frame.to_local(*there) == pytest.approx((north_m, east_m), abs=1e-6)
    sphere = Projection(Place(latitude_deg, longitude_deg, 400.0))
    place = sphere.place(north_m, east_m, -30.0)
    assert (north_m, east_m) == flat(place.latitude_deg, place.longitude_deg, "+R=6371000")
    assert sphere.ned_m(place) == pytest.approx((north_m, east_m, -30.0), abs=1e-4)


START_DEG = 179.9992
"""61 m before it."""


def flight(kind: Any, autopilot: str, longitude_deg: float) -> tuple[Any, Sequence[int]]:
    """Over the line to the east within a fence, into its edge, and what that makes it do."""
    on = {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 2.0, "FENCE_RADIUS": 150.0}
    if autopilot == "px4":
        on = {"GF_ACTION": 3.0, "GF_MAX_HOR_DIST": 150.0}
    flown = Rig(autopilot, kind, (47.0, longitude_deg, 400.0), heading_deg=90.0, **on).armable()
    flown.send(heartbeat())
    for message in (24, 33):
        flown.command(511, message, 500_000)
    flown.climb(12.0)
    for k in range(2800):
        if kind == "copter" and k % 20 == 0:
            flown.aim((0.0, 0.08 * k, -12.0), (0.0, 8.0, 0.0))
        if k == 100:
            flown.fault("ground_fence 5 m 9000 m ahead")  # all of it is read again
        flown.step()
    told = (*flown.all("GLOBAL_POSITION_INT"), *flown.all("GPS_RAW_INT"))
    fields = ("mode", "north_m", "east_m", "altitude_amsl_m")
    rows = [[row[field] for field in fields] for row in flown.truth()]
    return rows, [each.message.lon for each in told]


@pytest.mark.parametrize(("autopilot", "kind"), KINDS)
def test_a_flight_over_the_date_line_is_that_over_any_other_meridian(
    kind: str, autopilot: str
) -> None:
    here, _ = flight(kind, autopilot, START_DEG - 170.0)
    there, places = flight(kind, autopilot, START_DEG)
    assert max(row[2] for row in here) > 140.0  # over the line and the fence's edge
    assert {row[0] for row in here} & {"RTL", "Return"}
    for (mode, *one), (as_mode, *other) in zip(here, there, strict=True):
        assert mode == as_mode
        assert one == pytest.approx(other, abs=0.05)
    assert {lon > 0 for lon in places} == {True, False}
    assert max(map(abs, places)) <= 1_800_000_000
