"""Metres and degrees are those of pyproj, and nothing changes where 180 becomes -180 degrees."""

from collections.abc import Sequence
from typing import Any

import pytest
from harness import KINDS, Rig, heartbeat
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod, Transformer

from vehicle_sim.autopilot.earth import Projection
from vehicle_sim.autopilot.values import Place
from vehicle_sim.geodesy import LocalFrame, around
from vehicle_sim.plans import PlanItem, PlanKind

WGS84 = Geod(ellps="WGS84")
ANYWHERE = {"latitude_deg": st.floats(-80.0, 80.0), "longitude_deg": st.floats(-179.0, 179.0)}
AWAY = {"north_m": st.floats(-1e5, 1e5), "east_m": st.floats(-1e5, 1e5)}


def projection(latitude_deg: float, longitude_deg: float, earth: str) -> Transformer:
    """The azimuthal equidistant one, as pyproj has it."""
    flat = f"+proj=aeqd +lat_0={latitude_deg} +lon_0={longitude_deg} +units=m {earth}"
    return Transformer.from_crs(f"+proj=longlat +no_defs {earth}", flat, always_xy=True)


@given(**ANYWHERE, **AWAY)
def test_the_local_frame_is_pyprojs_on_the_ellipsoid_there_and_back(
    latitude_deg: float, longitude_deg: float, north_m: float, east_m: float
) -> None:
    frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    lat, lon = frame.to_geographic(north_m, east_m)
    x, y = projection(latitude_deg, longitude_deg, "+ellps=WGS84").transform(lon, lat)
    assert (y, x) == pytest.approx((north_m, east_m), abs=1e-3)
    assert frame.to_local(lat, lon) == pytest.approx((north_m, east_m), abs=1e-6)


@given(**ANYWHERE, **AWAY)
def test_an_autopilots_frame_is_pyprojs_on_the_sphere_there_and_back(
    latitude_deg: float, longitude_deg: float, north_m: float, east_m: float
) -> None:
    frame = Projection(Place(latitude_deg, longitude_deg, 400.0))
    place = frame.place(north_m, east_m, -30.0)
    sphere = projection(latitude_deg, longitude_deg, "+R=6371000")
    x, y = sphere.transform(place.longitude_deg, place.latitude_deg)
    assert (y, x) == pytest.approx((north_m, east_m), abs=1e-3)
    assert frame.ned_m(place) == pytest.approx((north_m, east_m, -30.0), abs=1e-4)


START_DEG = 179.9992
"""61 m before it."""


def fence(longitude_deg: float) -> tuple[PlanItem, ...]:
    """An inclusion zone about the start."""
    return tuple(
        PlanItem(
            frame=0,
            command=5001,
            parameters=(4.0, 0.0, 0.0, 0.0),
            x=round(1e7 * latitude_deg),
            y=round(1e7 * around(longitude_deg + east_deg)),
        )
        for latitude_deg, east_deg in ((46.99, -2e-3), (47.01, -2e-3), (47.01, 2e-3), (46.99, 2e-3))
    )


def flight(kind: Any, autopilot: str, longitude_deg: float) -> tuple[Any, Sequence[int]]:
    """Over the line to the east within a fence, into its edge, and what that makes it do."""
    on = (
        {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 4.0} if autopilot == "ardupilot" else {"GF_ACTION": 3.0}
    )
    flown = Rig(autopilot, kind, (47.0, longitude_deg, 400.0), heading_deg=90.0, **on).armable()
    flown.simulation.plans[PlanKind.FENCE] = fence(longitude_deg)
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
    assert max(row[2] for row in here) > 150.0  # over the line and the fence's edge
    assert {row[0] for row in here} & {"RTL", "Return"}
    for (mode, *one), (as_mode, *other) in zip(here, there, strict=True):
        assert mode == as_mode
        assert one == pytest.approx(other, abs=0.05)
    assert {lon > 0 for lon in places} == {True, False}
    assert max(map(abs, places)) <= 1_800_000_000
