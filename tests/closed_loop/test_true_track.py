"""The judge of true tracks, against closed forms and brute force: it finds each kind of fault."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import true_track
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pyproj import Geod

from companion.sources.files import toml_text

Track = tuple[NDArray[np.float64], NDArray[np.float64]]
RADAR = {"name": "radar 1", "north_m": 10_000.0, "east_m": 0.0, "altitude_amsl_m": 0.0}


def world(*, ground_m: float = 0.0, peaks: Any = (), radars: Any = ()) -> dict[str, Any]:
    return {
        "origin": {"latitude_deg": 47.0, "longitude_deg": 8.0},
        "terrain": {"combine": "maximum", "ground_amsl_m": ground_m, "peaks": list(peaks)},
        "radars": list(radars),
    }


def mission(**changes: Any) -> dict[str, Any]:
    return {
        "origin": {"latitude_deg": 47.0, "longitude_deg": 8.0},
        "altitude": {"floor_amsl_m": 3000.0, "ceiling_amsl_m": 5000.0},
        "targets": [{"north_m": 20_000.0, "east_m": 0.0}],
        "vehicle": {"turn_radius_m": 2500.0, "climb_angle_deg": 10.0, "dive_angle_deg": 10.0},
        "planner": {"safety_distance_m": 500.0},
    } | changes


def straight(altitude_m: float = 3500.0, length_m: float = 20_000.0) -> Track:
    """To the north at 150 m/s."""
    t_s = np.append(np.arange(0.0, length_m / 150.0, 0.1), length_m / 150.0)
    return t_s, np.stack([150.0 * t_s, 0 * t_s, 0 * t_s + altitude_m], axis=-1)


def helix(radius_m: float, speed_m_s: float, climb_deg: float, duration_s: float = 60.0) -> Track:
    t_s = np.arange(0.0, duration_s, 0.1)
    angle = speed_m_s * t_s / radius_m
    up = speed_m_s * t_s * math.tan(math.radians(climb_deg))
    north, east = radius_m * np.cos(angle), radius_m * np.sin(angle)
    return t_s, np.stack([north, east, 4000.0 + up], axis=-1)


# --- figures, against closed forms


@settings(deadline=None, max_examples=20)
@given(
    radius_m=st.floats(500, 20_000), speed_m_s=st.floats(25, 170), climb_deg=st.floats(-12.0, 12.0)
)
def test_a_helix_has_its_radius_and_climbs_at_its_angle_up_to_chord_over_arc(
    radius_m: float, speed_m_s: float, climb_deg: float
) -> None:
    _, radii, slopes = true_track.turns_and_slopes(*helix(radius_m, speed_m_s, climb_deg))
    half = speed_m_s / radius_m / 2  # half the angle turned in 1 s
    expected = math.atan(math.tan(math.radians(climb_deg)) * half / math.sin(half))
    # Positions between two samples lie on their chord: up to (speed 0.1 s)^2 / 8 R inside.
    np.testing.assert_allclose(radii, radius_m, rtol=2e-3)
    np.testing.assert_allclose(slopes, expected, rtol=1e-3, atol=1e-12)


def test_a_slow_vehicle_is_judged_from_half_its_speed_on() -> None:
    assert len(true_track.turns_and_slopes(*helix(30.0, 15.0, 20.0))[0]) == 0
    slow = mission(vehicle=mission()["vehicle"] | {"speed_m_s": 8.0, "turn_radius_m": 25.0})
    for radius_m, ok in ((25.0, True), (22.0, False)):
        check = true_track.judge(world(), slow, *helix(radius_m, 8.0, 0.0))["turn radius"]
        assert check.value == pytest.approx(radius_m, rel=0.01)
        assert check.ok is ok


@given(speed_m_s=st.floats(5, 170), offset_m=st.floats(0, 4_900), period_s=st.floats(1.0, 100.0))
def test_time_inside_a_radar_is_the_chord_over_the_speed(
    speed_m_s: float, offset_m: float, period_s: float
) -> None:
    t_s = np.arange(0.0, 20_000.0 / speed_m_s + period_s, period_s)
    track = np.stack([speed_m_s * t_s, 0 * t_s, 0 * t_s + 3000.0], axis=-1)
    centre = np.array([10_000.0, offset_m * 0.6, 3000.0 - offset_m * 0.8])
    inside_s = true_track.seconds_inside(t_s, track, centre, 5_000.0).sum()
    chord_s = 2 * math.sqrt(5_000.0**2 - offset_m**2) / speed_m_s
    assert inside_s == pytest.approx(chord_s, rel=1e-6)
    hovers = np.tile(track[:1], (len(t_s), 1))  # every second counts there, or none
    for range_m, whole_s in ((12_000.0, t_s[-1]), (9_000.0, 0.0)):
        inside_s = true_track.seconds_inside(t_s, hovers, centre, range_m).sum()
        assert inside_s == pytest.approx(whole_s)


def test_clearance_agrees_with_brute_force_over_a_range_of_mountains() -> None:
    rng = np.random.default_rng(3)
    keys = ("north_m", "east_m", "height_amsl_m", "spread_north_m", "spread_east_m")
    low, high = (0, -4_000, 2_000, 800, 800), (12_000, 4_000, 3_200, 3_000, 3_000)
    peaks = [dict(zip(keys, rng.uniform(low, high).tolist(), strict=True)) for _ in range(12)]
    for combine in ("maximum", "sum"):
        terrain = world(peaks=peaks)
        terrain["terrain"]["combine"] = combine
        surface = true_track.surface_of(terrain)
        north = np.arange(0.0, 12_000.0, 400.0)
        heights_m = surface.height_m(north, 0.0 * north)
        points = np.stack([north, 0.0 * north, heights_m + rng.uniform(200, 2_000, 30)], axis=-1)
        for point, found in zip(points, true_track.clearances_m(points, surface), strict=True):
            around = np.arange(-abs(found), abs(found) + 10, 10.0)
            n, e = np.meshgrid(point[0] + around, point[1] + around)
            up = surface.height_m(n, e) - point[2]
            brute_m = np.sqrt((n - point[0]) ** 2 + (e - point[1]) ** 2 + up**2).min()
            assert found == pytest.approx(brute_m, abs=1.0)
        below = points - [0.0, 0.0, 4_000.0]
        assert ((true_track.clearances_m(below, surface) < 0.0) == (below[:, 2] < heights_m)).all()


def test_an_elevation_file_has_its_heights_where_geodesics_find_its_points(tmp_path: Path) -> None:
    """An own file, of which every pixel's middle is known; in between, the mean of neighbours."""
    heights = np.arange(60.0).reshape(6, 10)
    place = rasterio.Affine(0.002, 0.0, 7.99, 0.0, -0.004, 47.01)
    with rasterio.open(
        tmp_path / "terrain.tif", "w", driver="GTiff", dtype="float32", count=1,
        height=6, width=10, crs="EPSG:4326", transform=place,
    ) as file:  # fmt: skip
        file.write(heights.astype("float32"), 1)
    surface = true_track.surface_of(world() | {"terrain": {"file": "terrain.tif"}}, tmp_path)
    row, column = (each.ravel() for each in np.mgrid[0:6, 0:10])
    latitude, longitude = 47.01 - 0.004 * (row + 0.5), 7.99 + 0.002 * (column + 0.5)
    aside = np.full(60, 8.0), np.full(60, 47.0)
    azimuth, _, away = Geod(ellps="WGS84").inv(*aside, longitude, latitude)
    north, east = away * np.cos(np.radians(azimuth)), away * np.sin(np.radians(azimuth))
    inner = (row > 0) & (row < 5) & (column > 0) & (column < 9)
    found = surface.height_m(north[inner], east[inner])
    np.testing.assert_allclose(found, heights.ravel()[inner], atol=1e-4)
    between = surface.height_m((north[11] + north[22]) / 2, (east[11] + east[22]) / 2)
    assert between == pytest.approx(heights[1:3, 1:3].mean(), abs=0.01)
    assert np.isnan(surface.height_m(np.array(9_000.0), np.array(0.0)))


# --- bounds


@pytest.mark.parametrize(
    ("name", "track", "ok"),
    [
        ("turn radius", helix(2_400.0, 150.0, 0.0), True),
        ("turn radius", helix(2_350.0, 150.0, 0.0), False),
        ("climb angle", helix(9_000.0, 25.0, 10.4, 30.0), True),
        ("climb angle", helix(9_000.0, 25.0, 10.6, 30.0), False),
        ("dive angle", helix(9_000.0, 25.0, -10.4, 30.0), True),
        ("dive angle", helix(9_000.0, 25.0, -10.6, 30.0), False),
        ("highest altitude AMSL", straight(altitude_m=5024.0), True),
        ("highest altitude AMSL", straight(altitude_m=5026.0), False),
        ("end to target", straight(length_m=20_049.0), True),
        ("end to target", straight(length_m=20_051.0), False),
        ("lowest altitude AMSL", straight(altitude_m=2000.0), False),  # never in the band
        ("distance to terrain", straight(altitude_m=3480.0), True),
        ("distance to terrain", straight(altitude_m=3470.0), False),
    ],
)
def test_a_bound_may_be_missed_by_its_tolerance_and_no_more(
    name: str, track: Track, ok: bool
) -> None:
    assert true_track.judge(world(ground_m=3000.0), mission(), *track)[name].ok is ok


def test_a_track_through_a_radar_is_a_violation_and_one_above_it_is_not() -> None:
    through, above = (world(radars=[RADAR | {"range_m": each}]) for each in (5_000.0, 3_400.0))
    seen = true_track.judge(through, mission(), *straight(altitude_m=3000.0))
    assert seen["time inside radar 1"].value == pytest.approx(8_000.0 / 150.0)  # 3-4-5
    assert {c.name for c in seen.violations} == {"time inside radar 1", "time inside radars"}
    track = true_track.judge(above, mission(), *straight())
    assert track.ok
    assert track["distance to terrain"].value == pytest.approx(3500.0, abs=1e-6)
    assert track["turn radius"].value == math.inf


@pytest.mark.parametrize(
    ("zone", "away_m"),
    [
        ({"north_m": 10_000.0, "east_m": 300.0, "radius_m": 1_000.0}, -700.0),
        ({"north_m": 10_000.0, "east_m": -1_520.0, "radius_m": 1_000.0}, 520.0),
        *(
            ({"vertices_m": [[9e3, east], [11e3, east], [11e3, 9e3], [9e3, 9e3]]}, east)
            for east in (-400.0, 10.0, 510.0)
        ),
    ],
)
def test_a_keep_out_is_as_far_as_its_edge_or_entered_as_deep_as_that_is_away(
    zone: dict[str, Any], away_m: float
) -> None:
    track = true_track.judge(world(), mission(keep_outs=[zone]), *straight())
    assert track["distance to keep-outs"].value == pytest.approx(away_m, abs=0.1)
    assert track.ok == (away_m >= 500.0)


def test_the_climb_out_is_not_judged_but_a_later_dip_below_the_floor_is() -> None:
    """A vehicle that never flew is an error and not a success."""
    t_s, cruise = straight()
    climb = np.stack([np.zeros(36), np.zeros(36), np.linspace(0, 3500, 36)], axis=-1)
    times, whole = np.concatenate([np.arange(36.0), 36.0 + t_s]), np.concatenate([climb, cruise])
    track = true_track.judge(world(), mission(), times, whole)
    assert track["lowest altitude AMSL"].value == 3500.0
    assert track["begins"].value == 36.0
    whole[700, 2] = 2900.0
    dipped = true_track.judge(world(), mission(), times, whole)["lowest altitude AMSL"]
    assert (dipped.value, dipped.ok) == (2900.0, False)
    with pytest.raises(ValueError, match="never flew"):
        true_track.judge(world(), mission(), np.arange(9.0), np.zeros((9, 3)))


# --- files


def test_the_command_reads_the_files_and_exits_1_on_a_violation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also on a crash anywhere, before what is judged, as of a landing that missed its place."""
    files = [tmp_path / name for name in ("world.toml", "mission.toml", "truth.jsonl")]
    for file, table in zip(files, (world(), mission()), strict=False):
        file.write_text(toml_text(table), encoding="utf-8")
    crash = {"t_s": 0.04, "speed_m_s": 9.1, "into": "the ground"}
    for altitude_m, more, code in ((3500.0, {}, 0), (5500.0, {}, 1), (3500.0, {"crash": crash}, 1)):
        rows: list[dict[str, Any]] = [{"schema": 1}]
        for t_s, (north, east, up) in zip(*straight(altitude_m=altitude_m), strict=True):
            place = {"north_m": north, "east_m": east, "altitude_amsl_m": up}
            rows.append({"t_s": t_s, **place, **more})
        files[2].write_text("\n".join(map(json.dumps, rows)) + "\n")
        assert true_track.main(list(map(str, files))) == code
        said = capsys.readouterr().out
        assert ("VIOLATION" in said) == bool(code)
        assert not more or "speed of a crash [m/s]: 9.1 <= 0.0 (limit 0.0) at 0.0 s" in said


def test_truth_that_is_not_finite_or_runs_backwards_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    good = '{"t_s": 1.0, "north_m": 0.0, "east_m": 0.0, "altitude_amsl_m": 0.0}'
    for bad in (good, good.replace("1.0", "NaN"), ""):
        path.write_text("\n".join(["{}", good, bad]))
        with pytest.raises(ValueError, match="rising t_s"):
            true_track.read_truth(path)
