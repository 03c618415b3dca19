"""Distances against rays that are marched in small steps through the truth of the same map."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as wire

from companion.geodesy import FloatArray, LocalFrame
from companion.mavlink.dialect import codec
from companion.mavlink.obstacle_distance import VehicleSurroundings, distances_cm, obstacle_distance
from companion.world.known_map import KnownMap, empty_map
from companion.world.threats import CircleZone, PolygonZone, Zone

NOTHING, UNKNOWN = 65_534, 65_535
FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
ALTITUDE_M = 500.0
REACH_M = 655.33


def flat(cell_m: float = 25.0, height_m: float = 100.0) -> KnownMap:
    known = empty_map(cell_m, (-2e3, 2e3), (-2e3, 2e3))
    return replace(known, upper_m=np.full_like(known.upper_m, height_m))


def around(
    known: KnownMap | None = None, zones: tuple[Zone, ...] = (), **changes: Any
) -> VehicleSurroundings:
    values = {"frame": FRAME, "position_nea_m": (0.0, 0.0, ALTITUDE_M)} | changes
    return VehicleSurroundings(known=flat() if known is None else known, zones=zones, **values)


def marched_m(
    where: VehicleSurroundings, azimuths_rad: FloatArray, reach_m: float = REACH_M
) -> FloatArray:
    """How far rays in these directions of the local frame come.  (N,) -> (N,), inf: all the way."""
    here = where.position_nea_m
    along = np.arange(0.0, reach_m, 1.0)
    north = here[0] + np.outer(np.cos(azimuths_rad), along)
    east = here[1] + np.outer(np.sin(azimuths_rad), along)
    known = where.known
    rows = np.floor((north - known.north_min_m) / known.cell_m).astype(int)
    columns = np.floor((east - known.east_min_m) / known.cell_m).astype(int)
    hit = known.upper_m[rows, columns] >= here[2]
    for zone in where.zones:
        hit |= zone.distance_m(north, east) <= 0.0
    first = np.argmax(hit, axis=1)
    return np.where(hit.any(axis=1), along[first], np.inf)


def test_the_message_is_read_as_it_is_meant() -> None:
    known = flat()
    known.upper_m[known.cell_of(310.0, 10.0)] = 600.0  # a tower: 300 to 325 m north, 0 to 25 m east
    message = obstacle_distance(around(known), 12.5)
    [read] = wire.MAVLink(None).parse_buffer(message.pack(codec(7)))
    assert read.time_usec == 12_500_000
    assert (read.min_distance, read.max_distance) == (0, 65_533)
    assert read.frame == wire.MAV_FRAME_GLOBAL
    assert len(read.distances) == 72
    assert read.increment * 72 == 360
    assert read.angle_offset == 0.0
    # it is seen under 0 to 4.8 degrees: in the sectors about 0 and 5 degrees
    assert read.distances[0] == read.distances[1] == 30_000
    assert set(read.distances[2:]) == {NOTHING}


def test_directions_are_true_ones() -> None:
    """100 km east of the origin, north of the frame is a degree off true north."""
    known = empty_map(25.0, (-2e3, 2e3), (398e3, 402e3))
    known = replace(known, upper_m=np.full_like(known.upper_m, 100.0))
    turn_deg = math.degrees(FRAME.grid_north_rad(0.0, 400e3))
    assert turn_deg > 3.0
    wall = PolygonZone(  # seen under 2 degrees of the frame
        name="w", vertices_ne_m=((500.0, 400_017.4), (501.0, 400_017.4), (501.0, 400_017.6))
    )
    distances = distances_cm(around(known, (wall,), position_nea_m=(0.0, 400e3, ALTITUDE_M)))
    assert [k for k in range(72) if distances[k] != NOTHING] == [round((2.0 + turn_deg) / 5.0)]
    known = empty_map(1.0, (-700.0, 700.0), (399.3e3, 400.7e3))
    known = replace(known, upper_m=np.full_like(known.upper_m, 100.0))
    known.upper_m[known.cell_of(500.5, 400_017.5)] = 600.0
    distances = distances_cm(around(known, position_nea_m=(0.0, 400e3, ALTITUDE_M)))
    assert [k for k in range(72) if distances[k] < NOTHING] == [round((2.0 + turn_deg) / 5.0)]


def test_terrain_below_is_no_obstacle_and_unknown_ground_is_unknown() -> None:
    known = flat(height_m=ALTITUDE_M - 0.1)
    assert set(distances_cm(around(known))) == {NOTHING}
    known.upper_m[known.cell_of(0.0, 1.0)[0] + 20 :, :] = np.inf  # 500 m north and beyond
    distances = distances_cm(around(known))
    assert distances[0] == UNKNOWN
    assert distances[36] == NOTHING
    assert set(distances_cm(around(empty_map(25.0, (-2e3, 2e3), (-2e3, 2e3))))) == {UNKNOWN}


@pytest.mark.parametrize("place", [(5_000.0, 0.0), (0.0, -5e6), (2_000.0, 2_000.0)])
def test_off_the_map_nothing_is_known(place: tuple[float, float]) -> None:
    distances = distances_cm(around(position_nea_m=(*place, ALTITUDE_M)))
    assert set(distances) <= {UNKNOWN, NOTHING}
    assert distances.count(UNKNOWN) >= 36


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_position_that_is_none_gives_nothing(value: float) -> None:
    assert set(distances_cm(around(position_nea_m=(value, 0.0, 1.0)))) == {UNKNOWN}


def test_inside_of_what_is_forbidden_it_is_zero_all_round() -> None:
    inside = CircleZone(name="z", north_m=50.0, east_m=0.0, radius_m=100.0)
    outside = CircleZone(name="z", north_m=500.0, east_m=0.0, radius_m=100.0, keep_in=True)
    for zone in (inside, outside):
        assert set(distances_cm(around(zones=(zone,)))) == {0}
    known = flat()
    known.upper_m[known.cell_of(0.0, 0.0)] = 1_000.0
    assert set(distances_cm(around(known))) == {0}


def test_a_circle_by_its_closed_form() -> None:
    zone = CircleZone(name="z", north_m=0.0, east_m=400.0, radius_m=150.0)
    distances = distances_cm(around(zones=(zone,)))
    assert distances[18] == pytest.approx(25_000, abs=30)
    half = math.degrees(math.asin(150.0 / 400.0))  # 22 degrees
    seen = [k for k in range(72) if distances[k] != NOTHING]
    assert seen == [k for k in range(72) if abs(5 * k - 90) <= half + 2.5]


def test_a_large_circle_to_stay_in() -> None:
    zone = CircleZone(name="z", north_m=-9_700.0, east_m=0.0, radius_m=10_000.0, keep_in=True)
    distances = distances_cm(around(zones=(zone,)))
    assert distances[0] == pytest.approx(30_000, abs=30)
    assert distances[36] == NOTHING


@settings(max_examples=15)
@given(
    seed=st.integers(0, 10_000),
    north_m=st.floats(-300.0, 300.0),
    east_m=st.floats(-300.0, 300.0),
)
def test_never_more_than_the_nearest_along_any_ray_of_the_sector(
    seed: int, north_m: float, east_m: float
) -> None:
    rng = np.random.default_rng(seed)
    known = flat(cell_m=float(rng.uniform(15.0, 60.0)))
    known.upper_m[rng.random(known.upper_m.shape) < 0.01] = 900.0
    zones: list[Zone] = []
    for number in range(3):
        place = rng.uniform(-700.0, 700.0, 2)
        if number % 2:
            angles = np.sort(rng.uniform(0.0, math.tau, 5))
            radii = rng.uniform(20.0, 150.0, 5)
            corners = place[:, None] + radii * np.stack([np.cos(angles), np.sin(angles)])
            zones.append(PolygonZone(name="p", vertices_ne_m=tuple(zip(*corners, strict=True))))
        else:
            radius = float(rng.uniform(20.0, 150.0))
            zones.append(
                CircleZone(
                    name="c", north_m=float(place[0]), east_m=float(place[1]), radius_m=radius
                )
            )
    where = around(known, tuple(zones), position_nea_m=(north_m, east_m, ALTITUDE_M))
    turn = FRAME.grid_north_rad(north_m, east_m)
    distances = distances_cm(where)
    offsets = np.radians([-2.49, -1.3, 0.0, 1.3, 2.49])
    rays = np.radians(np.arange(72) * 5.0)[:, None] + offsets - turn
    nearest = marched_m(where, rays.ravel()).reshape(72, -1).min(axis=1)
    for sector, (told, ray_m) in enumerate(zip(distances, nearest, strict=True)):
        told_m = told * 0.01 if told < NOTHING else math.inf
        assert told_m <= ray_m + 1e-6
        if ray_m == math.inf and told_m < math.inf:  # no phantoms: a ray between them finds it
            between = np.radians(5.0 * sector + np.linspace(-4.0, 4.0, 161)) - turn
            assert marched_m(where, between, reach_m=REACH_M + 90.0).min() < math.inf


def test_registration_makes_it_nearer() -> None:
    known = flat()
    known.upper_m[known.cell_of(310.0, 10.0)] = 600.0
    distances = distances_cm(around(replace(known, registration_m=12.0)))
    assert distances[0] == 28_800
