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

FloatArray = NDArray[np.float64]


PEAK = {
    "north_m": 10_000.0,
    "east_m": 2_000.0,
    "height_amsl_m": 5_200.0,
    "spread_north_m": 3_000.0,
    "spread_east_m": 4_000.0,
}


def a_world(*peaks: dict[str, float], radars: tuple[dict[str, Any], ...] = ()) -> dict[str, Any]:
    return {
        "origin": {"latitude_deg": 47.0, "longitude_deg": 8.0},
        "terrain": {"combine": "maximum", "ground_amsl_m": 0.0, "peaks": list(peaks)},
        "radars": list(radars),
    }


def a_mission(**changes: Any) -> dict[str, Any]:
    mission: dict[str, Any] = {
        "origin": {"latitude_deg": 47.0, "longitude_deg": 8.0},
        "altitude": {"floor_amsl_m": 3000.0, "ceiling_amsl_m": 5000.0},
        "targets": [{"north_m": 20_000.0, "east_m": 0.0}],
        "vehicle": {"turn_radius_m": 2500.0, "climb_angle_deg": 10.0, "dive_angle_deg": 10.0},
        "planner": {"safety_distance_m": 500.0},
    }
    return mission | changes


def a_straight_track(
    speed_m_s: float = 150.0, altitude_m: float = 3500.0, length_m: float = 20_000.0
) -> tuple[FloatArray, FloatArray]:
    t_s = np.append(np.arange(0.0, length_m / speed_m_s, 0.1), length_m / speed_m_s)
    return t_s, np.stack([speed_m_s * t_s, 0 * t_s, 0 * t_s + altitude_m], axis=-1)


def a_helix(
    radius_m: float, speed_m_s: float, climb_deg: float, duration_s: float = 60.0
) -> tuple[FloatArray, FloatArray]:
    t_s = np.arange(0.0, duration_s, 0.1)
    angle = speed_m_s * t_s / radius_m
    up = speed_m_s * t_s * math.tan(math.radians(climb_deg))
    north, east = radius_m * np.cos(angle), radius_m * np.sin(angle)
    return t_s, np.stack([north, east, 4000.0 + up], axis=-1)


@settings(deadline=None, max_examples=20)
@given(radius_m=st.floats(500, 20_000), speed_m_s=st.floats(25, 170))
def test_a_circle_has_its_radius_at_any_speed(radius_m: float, speed_m_s: float) -> None:
    _, radii, slopes = true_track.turns_and_slopes(*a_helix(radius_m, speed_m_s, 0.0))
    # Positions between two samples lie on their chord: up to (speed 0.1 s)^2 / 8 R inside.
    np.testing.assert_allclose(radii, radius_m, rtol=2e-3)
    np.testing.assert_allclose(slopes, 0.0, atol=1e-12)


@pytest.mark.parametrize("climb_deg", [-12.0, -3.0, 3.0, 10.0])
def test_a_helix_climbs_at_its_angle_up_to_chord_over_arc(climb_deg: float) -> None:
    radius_m, speed_m_s = 3000.0, 150.0
    _, radii, slopes = true_track.turns_and_slopes(*a_helix(radius_m, speed_m_s, climb_deg))
    half = speed_m_s / radius_m / 2  # half the angle turned in 1 s
    expected = math.atan(math.tan(math.radians(climb_deg)) * half / math.sin(half))
    np.testing.assert_allclose(slopes, expected, rtol=1e-3)
    np.testing.assert_allclose(radii, radius_m, rtol=2e-3)


def test_a_slow_vehicle_is_judged_from_half_its_speed_on() -> None:
    times, _, _ = true_track.turns_and_slopes(*a_helix(30.0, 15.0, 20.0))
    assert len(times) == 0
    slow = a_mission(vehicle=a_mission()["vehicle"] | {"speed_m_s": 8.0, "turn_radius_m": 25.0})
    for radius_m, ok in ((25.0, True), (22.0, False)):
        track = true_track.judge(a_world(), slow, *a_helix(radius_m, 8.0, 0.0))
        assert track["turn radius"].value == pytest.approx(radius_m, rel=0.01)
        assert track["turn radius"].ok is ok


def test_a_crash_anywhere_in_the_truth_is_a_violation(tmp_path: Path) -> None:
    """Also one before the judged part begins, as of a landing that missed its place."""
    truth = tmp_path / "truth.jsonl"
    rows: list[dict[str, Any]] = [{"schema": 1}, {"t_s": 1.0}, {"t_s": 1.1}]
    for crash in (None, {"t_s": 1.04, "speed_m_s": 9.1, "into": "the ground"}):
        if crash is not None:
            rows[-1]["crash"] = crash
        truth.write_text("\n".join(map(json.dumps, rows)))
        check = true_track.crash_check(truth)
        assert check.ok is (crash is None)
    assert (check.value, check.t_s) == (9.1, 1.04)


def test_an_elevation_file_has_its_heights_where_geodesics_find_its_points(tmp_path: Path) -> None:
    """An own file, of which every pixel's middle is known; in between, the mean of neighbours."""
    heights = np.arange(60.0).reshape(6, 10)
    place = rasterio.Affine(0.002, 0.0, 7.99, 0.0, -0.004, 47.01)
    with rasterio.open(
        tmp_path / "terrain.tif", "w", driver="GTiff", dtype="float32", count=1,
        height=6, width=10, crs="EPSG:4326", transform=place,
    ) as file:  # fmt: skip
        file.write(heights.astype("float32"), 1)
    world = a_world() | {"terrain": {"file": "terrain.tif"}}
    surface = true_track.surface_of(world, tmp_path)
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


def test_clearance_agrees_with_brute_force_over_a_range_of_mountains() -> None:
    rng = np.random.default_rng(3)
    peaks = [
        {
            "north_m": float(rng.uniform(0, 12_000)),
            "east_m": float(rng.uniform(-4_000, 4_000)),
            "height_amsl_m": float(rng.uniform(2_000, 3_200)),
            "spread_north_m": float(rng.uniform(800, 3_000)),
            "spread_east_m": float(rng.uniform(800, 3_000)),
        }
        for _ in range(8)
    ]
    for combine in ("maximum", "sum"):
        world = a_world(*peaks)
        world["terrain"]["combine"] = combine
        surface = true_track.surface_of(world)
        points = rng.uniform((2_000, -2_000, 3_400), (10_000, 2_000, 5_000), (20, 3))
        if combine == "sum":
            points[:, 2] += 4_000
        found = true_track.clearances_m(points, surface)
        for point, clearance in zip(points, found, strict=True):
            around = np.arange(-abs(clearance), abs(clearance) + 10, 10.0)
            n, e = np.meshgrid(point[0] + around, point[1] + around)
            brute = np.sqrt((n - point[0]) ** 2 + (e - point[1]) ** 2
                            + (surface.height_m(n, e) - point[2]) ** 2).min()  # fmt: skip
            assert clearance == pytest.approx(brute, abs=1.0)
        heights_m = surface.height_m(points[:, 0], points[:, 1])
        below = points - [0.0, 0.0, 4_000.0]
        inside = true_track.clearances_m(below, surface) < 0.0
        assert (inside == (below[:, 2] < heights_m)).all()


def test_level_flight_over_a_plain_has_its_altitude_as_clearance() -> None:
    track = true_track.judge(a_world(), a_mission(), *a_straight_track(altitude_m=3500.0))
    assert track.ok
    for name, value in {
        "distance to terrain": pytest.approx(3500.0, abs=1e-6),
        "distance to keep-outs": math.inf,
        "turn radius": math.inf,
        "length flown": pytest.approx(20_000.0),
        "duration": pytest.approx(20_000.0 / 150.0),
    }.items():
        assert track[name].value == value, name


@given(
    speed_m_s=st.floats(5, 170),
    offset_m=st.floats(0, 4_900),
    period_s=st.floats(1.0, 100.0),
)
def test_time_inside_a_radar_is_the_chord_over_the_speed(
    speed_m_s: float, offset_m: float, period_s: float
) -> None:
    t_s = np.arange(0.0, 20_000.0 / speed_m_s + period_s, period_s)
    track = np.stack([speed_m_s * t_s, 0 * t_s, 0 * t_s + 3000.0], axis=-1)
    centre = np.array([10_000.0, offset_m * 0.6, 3000.0 - offset_m * 0.8])
    inside = true_track.seconds_inside(t_s, track, centre, 5_000.0).sum()
    chord_s = 2 * math.sqrt(5_000.0**2 - offset_m**2) / speed_m_s
    assert inside == pytest.approx(chord_s, rel=1e-6)


def test_hovering_inside_a_radar_counts_every_second() -> None:
    t_s = np.arange(0.0, 10.0)
    track = np.tile([100.0, 0.0, 3000.0], (10, 1))
    assert true_track.seconds_inside(t_s, track, np.zeros(3), 3100.0).sum() == 9.0
    assert true_track.seconds_inside(t_s, track, np.zeros(3), 2900.0).sum() == 0.0


def test_a_track_through_a_radar_is_a_violation_and_one_above_it_is_not() -> None:
    radar = {"name": "radar 1", "north_m": 10_000.0, "east_m": 0.0, "altitude_amsl_m": 0.0}
    through = a_world(radars=(radar | {"range_m": 5_000.0},))
    below = a_world(radars=(radar | {"range_m": 3_400.0},))
    seen = true_track.judge(through, a_mission(), *a_straight_track(altitude_m=3000.0))
    assert seen["time inside radar 1"].value == pytest.approx(8_000.0 / 150.0)  # 3-4-5
    names = {check.name for check in seen.violations}
    assert names == {"time inside radar 1", "time inside radars"}
    assert true_track.judge(below, a_mission(), *a_straight_track()).ok


def test_a_keep_out_is_as_far_as_its_edge_or_entered_as_deep_as_that_is_away() -> None:
    circle = {"north_m": 10_000.0, "east_m": 300.0, "radius_m": 1_000.0}
    square = {"vertices_m": [[9_000, -400], [11_000, -400], [11_000, 9_000], [9_000, 9_000]]}
    beside = {"vertices_m": [[9_000, 10], [11_000, 10], [11_000, 9_000], [9_000, 9_000]]}
    clear = {"vertices_m": [[9_000, 510], [11_000, 510], [11_000, 9_000], [9_000, 9_000]]}
    aside = circle | {"east_m": -1_520.0}
    for zone, away_m in (
        (circle, -700.0), (square, -400.0), (beside, 10.0), (clear, 510.0), (aside, 520.0)
    ):  # fmt: skip
        mission = a_mission(keep_outs=[zone])
        track = true_track.judge(a_world(), mission, *a_straight_track())
        assert track["distance to keep-outs"].value == pytest.approx(away_m, abs=0.1)
        assert track.ok == (away_m >= 500.0)


@pytest.mark.parametrize(
    ("name", "track", "ok"),
    [
        ("turn radius", a_helix(2_400.0, 150.0, 0.0), True),
        ("turn radius", a_helix(2_350.0, 150.0, 0.0), False),
        ("climb angle", a_helix(9_000.0, 25.0, 10.4, 30.0), True),
        ("climb angle", a_helix(9_000.0, 25.0, 10.6, 30.0), False),
        ("dive angle", a_helix(9_000.0, 25.0, -10.4, 30.0), True),
        ("dive angle", a_helix(9_000.0, 25.0, -10.6, 30.0), False),
        ("highest altitude AMSL", a_straight_track(altitude_m=5024.0), True),
        ("highest altitude AMSL", a_straight_track(altitude_m=5026.0), False),
        ("end to target", a_straight_track(length_m=20_049.0), True),
        ("end to target", a_straight_track(length_m=20_051.0), False),
        ("lowest altitude AMSL", a_straight_track(altitude_m=2000.0), False),  # never in the band
    ],
)
def test_a_bound_may_be_missed_by_its_tolerance_and_no_more(
    name: str, track: tuple[FloatArray, FloatArray], ok: bool
) -> None:
    assert true_track.judge(a_world(), a_mission(), *track)[name].ok is ok


@pytest.mark.parametrize(("clearance_m", "ok"), [(480.0, True), (470.0, False)])
def test_terrain_may_be_five_percent_nearer_than_the_safety_distance(
    clearance_m: float, ok: bool
) -> None:
    world = a_world()
    world["terrain"]["ground_amsl_m"] = 3500.0 - clearance_m
    track = true_track.judge(world, a_mission(), *a_straight_track())
    assert track["distance to terrain"].ok is ok


def test_the_climb_out_is_not_judged_but_a_later_dip_below_the_floor_is() -> None:
    t_s, cruise = a_straight_track()
    climb = np.stack([np.zeros(36), np.zeros(36), np.linspace(0, 3500, 36)], axis=-1)
    times = np.concatenate([np.arange(36.0), 36.0 + t_s])
    whole = np.concatenate([climb, cruise])
    track = true_track.judge(a_world(), a_mission(), times, whole)
    assert track["lowest altitude AMSL"].value == 3500.0
    assert track["begins"].value == 36.0
    whole[700, 2] = 2900.0
    dipped = true_track.judge(a_world(), a_mission(), times, whole)
    assert dipped["lowest altitude AMSL"].value == 2900.0
    assert not dipped["lowest altitude AMSL"].ok


def test_a_vehicle_that_never_flew_is_an_error_and_not_a_success() -> None:
    with pytest.raises(ValueError, match="never flew"):
        true_track.judge(a_world(), a_mission(), np.arange(9.0), np.zeros((9, 3)))


def test_the_command_reads_the_files_and_exits_1_on_a_violation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [tmp_path / name for name in ("world.toml", "mission.toml", "truth.jsonl")]
    for file, table in zip(files, (a_world(), a_mission()), strict=False):
        file.write_text(toml_text(table), encoding="utf-8")
    for altitude_m, code in ((3500.0, 0), (5500.0, 1)):
        keys, lines = ("north_m", "east_m", "altitude_amsl_m"), ['{"schema": 1}']
        for t, point in zip(*a_straight_track(altitude_m=altitude_m), strict=True):
            row = dict(zip(keys, point.tolist(), strict=True))
            lines.append(json.dumps({"t_s": float(t), **row, "mode": "GUIDED"}))
        files[2].write_text("\n".join(lines) + "\n")
        assert true_track.main(list(map(str, files))) == code
        assert ("VIOLATION" in capsys.readouterr().out) == bool(code)


def test_truth_that_is_not_finite_or_runs_backwards_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    good = '{"t_s": 1.0, "north_m": 0.0, "east_m": 0.0, "altitude_amsl_m": 0.0}'
    for bad in (good, good.replace("1.0", "NaN"), ""):
        path.write_text("\n".join(["{}", good, bad]))
        with pytest.raises(ValueError, match="rising t_s"):
            true_track.read_truth(path)
