"""A mission.toml is the mission that it tells, or one line says what is wrong with it."""

import contextlib
import itertools
import json
import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from geotiff import write_elevation
from hypothesis import given
from hypothesis import strategies as st
from spoiled import collection, feature, refusal, replace_somewhere

import companion
from companion.config import load_mission, load_world, mission_text
from companion.errors import InputError
from companion.geodesy import FloatArray, LocalFrame
from companion.mavlink.near_scanner import messages_of, streams_hz
from companion.mission.mission import EndAction, Fallback, Mission
from companion.optimise.registry import OPTIMISERS
from companion.sources.files import toml_text
from companion.sources.mission_file import MissionTable
from companion.sources.zones import ZoneTable, zones_of
from companion.world.zones import CircleZone

COPTER = """
schema = 1
name = "test"
origin = { latitude_deg = 47.0, longitude_deg = 8.0 }
area = { north_min_m = -4000.0, north_max_m = 6000.0, east_min_m = -4000.0, east_max_m = 6000.0 }
altitude = { floor_amsl_m = 900.0, ceiling_amsl_m = 1100.0 }
planner = { scan_range_m = 2000.0, safety_distance_m = 40.0, planning_time_s = 3.0 }
end = { action = "hold" }
[[targets]]
north_m = 3000.0
east_m = 2000.0
[vehicle]
kind = "copter"
speed_m_s = 8.0
acceleration_m_s2 = 2.0
climb_rate_m_s = 2.5
turn_radius_m = 25.0
climb_angle_deg = 17.0
dive_angle_deg = 17.0
"""
PLANE = (
    COPTER.replace('"copter"', '"plane"\nloiter_radius_m = 80.0')
    .replace("speed_m_s = 8.0", "speed_m_s = 18.0")
    .replace("turn_radius_m = 25.0", "turn_radius_m = 80.0")
)
KNOWN = COPTER + '[terrain]\nfile = "dem.tif"\nvertical_datum = "EGM96"\n'
STATED = COPTER + "[terrain]\nhighest_amsl_m = 840.0\n"
TRIANGLE = [[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
HEIGHTS = np.random.default_rng(4).integers(300, 800, (200, 240)).astype(np.int16)
"""Every 3 seconds over more than the map."""
STEP_DEG = 1 / 1200
WOOD = [[8.01, 47.01], [8.02, 47.01], [8.02, 47.015], [8.01, 47.01]]
THREATS = collection(feature("Polygon", [WOOD, WOOD], name="wood"))
NO_TARGETS = COPTER.replace("[[targets]]\nnorth_m = 3000.0\neast_m = 2000.0\n", "")
THEIRS = "[from_vehicle]\ntargets = true\n"
FOREST = mission_text("forest")
ENVIRONMENTS = Path(companion.__file__).parent / "environments"
OBSTACLE = 'kind = "obstacle_distance"\nspeaks_for_m = 4.0\n'
KIND, FLAT = 'kind = "copter"', "[terrain]\nhighest_amsl_m = 400.5"
FILE = '[terrain]\nfile = "x"\nvertical_datum = "EGM96"\ntrust = "guidance"'
AROUND = "vertices_m = [[-3e3, -3e3], [-3e3, 5e3], [5e3, 5e3], [5e3, -3e3]]"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With the files that missions here name."""
    path = tmp_path_factory.mktemp("mission")
    terrain(path / "dem.tif", HEIGHTS)
    (path / "threats.geojson").write_text(json.dumps(THREATS), encoding="utf-8")
    return path


def load(folder: Path, text: str) -> Mission:
    path = folder / "mission.toml"
    path.write_text(text, encoding="utf-8")
    return load_mission(str(path))


def terrain(path: Path, heights: np.ndarray[Any, Any]) -> None:
    """An elevation file about the origin."""
    write_elevation(path, heights, (47.0 + 99.5 * STEP_DEG, 8.0 - 119.5 * STEP_DEG), STEP_DEG)


def vehicle(text: str, base: str = COPTER) -> str:
    return base.replace("[vehicle]\n", f"[vehicle]\n{text}\n")


def place(text: str) -> str:
    return COPTER.replace("north_m = 3000.0\neast_m = 2000.0", text)


def zone(text: str, kind: str = "keep_outs") -> str:
    return f'{COPTER}\n[[{kind}]]\nname = "zone"\n{text}\n'


def scanner(table: str, *changes: tuple[str, str]) -> str:
    """The forest's mission with another table of its sensor."""
    before, rest = FOREST.split("[scanner]")
    text = f"{before}[scanner]\n{table}\n[planner]{rest.split('[planner]')[1]}"
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


# --- what it says


def test_all_that_can_be_said_is_taken(folder: Path) -> None:
    text = vehicle(
        'autopilot = "px4"\nsystem_id = 7\nscanner_component_id = 101\nposition_rate_hz = 200.0\n'
        "yaw_deg = 270.0\ntracking_error_m = 9.5\nnavigation_error_m = 7.5\ndead_man_s = 2.0"
    )
    more = """
    fallback = { action = "land", attempts = 2 }
    battery = { reserve_percent = 35.0, endurance_s = 900.0 }
    link = { commanders = ["255/0", "7/190"], sets_parameters = false }
    from_vehicle = { fence = false }
    scanner = { complete = false }
    rally_points = [{ north_m = 10.0, east_m = -20.0 }]
    """
    mission = load(folder, more + text.replace('"hold"', '"return"'))
    assert mission.task.settings.position_period_s == 0.005
    assert mission.yaw_rad == pytest.approx(-math.pi / 2)
    limits = mission.task.limits
    errors = limits.tracking_error_m, limits.navigation_error_m, limits.dead_man_s
    assert errors == (9.5, 7.5, 2.0)
    expected = {
        "autopilot": "px4", "system_id": 7, "scanner_component_id": 101,
        "position_rate_hz": 200.0, "scanner_complete": False, "sets_parameters": False,
        "fallback": Fallback.LAND, "attempts": 2, "reserve": 0.35, "endurance_s": 900.0,
        "commanders": ((255, 0), (7, 190)), "fence_from_vehicle": False,
        "rally_ne_m": ((10.0, -20.0),), "end_action": EndAction.RETURN,
    }  # fmt: skip
    assert {name: getattr(mission, name) for name in expected} == expected


ERRORS = {"forward_m": 0.1, "right_m": -0.2, "blind_m": 0.4, "latency_s": 0.01}
ERRORS |= {"latency_error_s": 0.02, "range_error_m": 0.3}
ERRORS |= {"position_error_m": 0.06, "drift_m_s": 0.01}


@pytest.mark.parametrize(
    ("kind", "more", "component", "message", "of_autopilot"),
    [
        ("obstacle_distance", "", 196, 330, False),
        ("obstacle_distance", "component = 50\n", 50, 330, False),
        ("distance_sensor", "", 1, 132, True),
        ("distance_sensor", "component = 158\n", 158, 132, False),
    ],
)
def test_a_sensor_of_near_things_is_what_its_table_says(
    folder: Path, kind: str, more: str, component: int, message: int, of_autopilot: bool
) -> None:
    more += "yaw_deg = 90.0\nbearing_error_deg = 2.0\n" + toml_text(ERRORS)
    mission = load(folder, scanner(f'kind = "{kind}"\nspeaks_for_m = 4.0\n{more}'))
    near = mission.near
    assert (near.kind, near.component_id, near.speaks_for_m) == (kind, component, 4.0)
    assert (mission.kind, mission.scanner_component_id) == ("copter", None)
    assert (near.yaw_rad, near.bearing_error_rad) == (0.5 * math.pi, math.radians(2.0))
    assert {name: getattr(near, name) for name in ERRORS} == ERRORS
    assert near.range_m == mission.task.settings.scan_range_m
    assert (mission.known.guess_m == 400.5).all()  # of the ground; of what stands on it nothing
    assert not mission.known.surveyed.any()
    assert messages_of(mission) == {30, message}
    assert set(streams_hz(mission)) == ({30, message} if of_autopilot else {30})


@given(tracking_m=st.floats(0.2, 40.0), navigation_m=st.floats(0.0, 40.0))
def test_a_take_off_ends_in_the_band(folder: Path, tracking_m: float, navigation_m: float) -> None:
    """However the errors compare: a vehicle hovering there is within the band of a certificate."""
    errors = f"tracking_error_m = {tracking_m}\nnavigation_error_m = {navigation_m}"
    task = load(folder, vehicle(errors).replace("1100.0", "1300.0")).task
    error_m = tracking_m + navigation_m
    low, high = task.band_amsl_m
    assert 900.0 + error_m <= low <= task.take_off_amsl_m < high <= 1300.0 - error_m


def test_a_copter_that_outruns_its_sight_is_flown_more_slowly_and_says_so() -> None:
    forest = load_mission("forest", settings=["vehicle.speed_m_s=5"])
    flown_m_s = forest.task.limits.speed_m_s
    assert 2.5 <= flown_m_s < 5.0
    [note] = [note for note in forest.notes if "eq. 4" in note]
    assert f"V = 5 m/s (eq. 4): it is flown at {flown_m_s:g} m/s" in note
    with pytest.raises(InputError, match=r"planner.planning_time_s = 0.2: eq. 4"):
        load_mission("forest", settings=["vehicle.speed_m_s=50", "vehicle.turn_radius_m=500"])


# --- places and zones


def test_zones_and_radars_in_degrees_are_those_in_metres(folder: Path) -> None:
    latitude, longitude = FRAME.to_geodetic_deg(1000.0, -500.0)
    there = f"latitude_deg = {latitude!r}\nlongitude_deg = {longitude!r}\n"
    radar = f'[[radars]]\nname = "sam"\n{there}altitude_amsl_m = 700.0\nrange_m = 900.0\n'
    inside = f'[[keep_ins]]\nname = "in"\n{AROUND}\n'
    mission = load(folder, zone(f"{there}radius_m = 100.0") + inside + radar)
    circle, around = mission.task.zones
    assert isinstance(circle, CircleZone)
    assert (circle.north_m, circle.east_m) == pytest.approx((1000.0, -500.0), abs=1e-6)
    assert (circle.radius_m, circle.keep_in, around.keep_in) == (100.0, False, True)
    [sam] = mission.task.radars
    assert sam.centre_nea_m == pytest.approx((1000.0, -500.0, 700.0), abs=1e-6)
    assert sam.range_m == 900.0


def test_an_edge_in_degrees_is_straight_in_degrees(folder: Path) -> None:
    """A parallel of 150 km bends by 480 m in the local frame: the edge follows it to a metre."""
    corners = [[46.99, 7.0], [46.99, 9.0], [46.8, 9.0], [46.8, 7.0]]
    (found,) = load(folder, zone(f"vertices_deg = {corners}")).task.zones
    along = np.linspace(7.0, 9.0, 501)
    places = np.array([FRAME.to_local_m(46.99, longitude) for longitude in along])
    assert abs(found.distance_m(places[:, 0], places[:, 1])).max() < 0.16
    straight = np.linspace(places[0], places[-1], 501)
    assert abs(found.distance_m(straight[:, 0], straight[:, 1])).max() > 400.0


FAR_AWAY = {
    "north": [[48.0, 8.0], [48.001, 8.0], [48.0, 8.001]],
    "antipodes": [[-47.0, -172.0], [-46.999, -172.0], [-47.0, -171.999]],
    "Antarctica as GeoJSON has it": [
        *([-85.0, -180.0], [-90.0, -180.0], [-90.0, 180.0], [-85.0, 180.0], [-65.0, 60.0])
    ],
    "over the date line": [[60.0, 175.0], [60.0, -170.0], [50.0, -170.0], [50.0, 175.0]],
    "near": [[47.03, 8.0], [47.031, 8.0], [47.03, 8.001]],
}


def test_keep_outs_away_from_the_map_are_left_out_and_counted(folder: Path) -> None:
    """As in a file of a whole country; also those that the local frame cannot reach."""
    zones = [f'name = "{name}"\nvertices_deg = {ring}' for name, ring in FAR_AWAY.items()]
    circle = 'name = "circle"\nlatitude_deg = {}\nlongitude_deg = 8.0\nradius_m = {}'
    zones += [circle.format(*each) for each in ((47.03, 30.0), (48.0, 30.0), (56.9, 15e4))]
    mission = load(folder, COPTER + "".join(f"[[keep_outs]]\n{zone}\n" for zone in zones))
    assert [found.name for found in mission.task.zones] == ["near", "circle"]
    assert mission.notes == ("6 of 8 keep-outs lie away from the map",)


def test_keep_outs_beside_the_map_count_as_far_as_paths_keep_from_them(folder: Path) -> None:
    task, square = load(folder, COPTER).task, np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    for more_m, count in ((-1.0, 8), (1.0, 0)):
        off_m = task.zone_search_clearance_m + 10.0 + more_m
        sides = [6e3 + off_m, -4e3 - off_m]
        places = [*((north, 0.0) for north in sides), *((0.0, east) for east in sides)]
        zones = [ZoneTable(name="", north_m=n, east_m=e, radius_m=10.0) for n, e in places]
        zones += [ZoneTable(name="", vertices_m=(10.0 * square + each).tolist()) for each in places]
        assert len(zones_of(zones, [], task, FRAME)[0]) == count


def star(random: np.random.Generator) -> FloatArray:
    """A concave polygon of 40 to 75 degrees whose rim goes by (0, 0); (latitude, longitude)."""
    angles = np.sort(random.uniform(0.0, 2.0 * math.pi, 7))
    rays = np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    corners = random.uniform(20.0, 37.0, (7, 1)) * rays
    k, part = random.integers(0, 7), random.uniform(0.3, 0.7)
    corners -= corners[k - 1] + part * (corners[k] - corners[k - 1])
    return corners + random.uniform(-0.15, 0.15, 2)


@pytest.mark.parametrize("origin", [(a, b) for a in (0.01, 47.0, -13.0) for b in (8.0, -179.98)])
@pytest.mark.parametrize("kind", ["keep_outs", "keep_ins"])
def test_a_polygon_of_far_corners_is_refused_if_it_reaches_the_map(
    folder: Path, origin: Any, kind: str
) -> None:
    """Of a map of 10 km; its sides are straight in degrees, which shapely knows as well."""
    frame = LocalFrame(latitude_deg=origin[0], longitude_deg=origin[1])
    task, random, refused = load(folder, COPTER).task, np.random.default_rng(7), 0
    points = random.uniform(-4000.0, 6000.0, (60, 2)).T
    latitude, longitude = frame.to_geodetic_deg(*points)
    places = shapely.points(latitude - origin[0], (longitude - origin[1] + 180.0) % 360.0 - 180.0)
    for _ in range(80):
        corners = star(random)
        corners[:, 0] = np.clip(corners[:, 0], -89.0 - origin[0], 89.0 - origin[0])
        drawn = shapely.Polygon(corners)
        if not drawn.is_simple or np.hypot(*corners.T).min() < 15.0:  # 1,000 km, and some more
            continue
        told = corners + np.array(origin)
        told[:, 1] = (told[:, 1] + 180.0) % 360.0 - 180.0
        table = ZoneTable(name="far", vertices_deg=told.tolist())
        tables = ([table], []) if kind == "keep_outs" else ([], [table])
        inside = shapely.contains(drawn, places).any()
        try:
            assert zones_of(*tables, task, frame)[0] == ()
            assert not inside
        except InputError:
            far_deg = shapely.distance(drawn, places).min()
            assert inside or kind == "keep_ins" or far_deg < 0.5
            refused += 1
    assert refused > 15


def test_a_run_folder_needs_no_other_file(folder: Path, tmp_path: Path) -> None:
    text = 'threats = "threats.geojson"\n' + KNOWN
    mission = load(folder, text)
    copy = tmp_path / "mission.toml"
    copy.write_text(mission_text(str(folder / "mission.toml")), encoding="utf-8")
    again = load_mission(str(copy))
    assert again.task == mission.task
    np.testing.assert_array_equal(again.known.upper_m, mission.known.upper_m)


# --- ground that is known in advance


def test_the_ground_is_nowhere_higher_than_the_known_map_says(folder: Path) -> None:
    mission = load(folder, KNOWN)
    known = mission.known
    assert np.isfinite(known.upper_m).all()
    assert not known.seen.any()  # a scan may still find the ground lower
    assert known.surveyed.all()
    rng = np.random.default_rng(2)
    for _ in range(300):  # the file's own nodes: each lies in its cell
        row, column = int(rng.integers(60, 130)), int(rng.integers(80, 200))
        place = FRAME.to_local_m(47.0 + (100 - row - 0.5) / 1200, 8.0 + (column + 0.5 - 120) / 1200)
        at = known.cell_of(*place)
        assert known.upper_m[at] >= HEIGHTS[row, column] + 5.0
    assert known.upper_m.max() <= 800.0 + 5.0
    exact = load(folder, KNOWN + "datum_error_m = 0.0\n")  # of the terrain, and of nothing else
    np.testing.assert_array_equal(known.upper_m, exact.known.upper_m + 5.0)
    assert mission.task == exact.task


def test_a_file_for_guidance_is_no_knowledge(folder: Path) -> None:
    proof, guidance = (load(folder, f'{KNOWN}trust = "{t}"\n').known for t in ("proof", "guidance"))
    assert np.isinf(guidance.upper_m).all()
    assert not guidance.surveyed.any()
    np.testing.assert_array_equal(guidance.guess_m, proof.upper_m)


def test_beyond_the_file_nothing_is_known_even_if_holes_in_it_are_sea(tmp_path: Path) -> None:
    terrain(tmp_path / "dem.tif", HEIGHTS[:100])  # ends at the origin's latitude
    for more in ("", 'nodata = "sea"\n'):
        known = load(tmp_path, KNOWN + more).known
        row, _ = known.cell_of(0.0, 0.0)
        assert np.isinf(known.upper_m[: row - 3]).all()
        assert np.isfinite(known.upper_m[row + 8 :]).all()
        np.testing.assert_array_equal(known.surveyed, np.isfinite(known.upper_m))
        assert not known.seen.any()


def test_ground_that_is_stated_is_known_everywhere(folder: Path) -> None:
    with_radar = load(folder, STATED).known
    assert not with_radar.seen.any()
    assert mission_text(str(folder / "mission.toml")) == STATED
    mission = load(folder, vehicle("scanner = false", STATED))
    assert mission.scanner_component_id is None
    assert (mission.known.upper_m == 840.0).all()
    assert mission.known.seen.all()
    assert with_radar.surveyed.all()
    limits = mission.task.limits
    for north, east in itertools.product(limits.north_m, limits.east_m):
        assert mission.known.is_known(min(north, 5999.0), min(east, 5999.0))
    assert any("nowhere higher than 840 m AMSL" in note for note in mission.notes)
    known = load(folder, vehicle("scanner = false", KNOWN)).known
    assert known.seen.all()  # all that there is of it


@given(
    highest_m=st.floats(700.0, 1000.0),
    tracking_m=st.floats(1.0, 12.0),
    safety_m=st.floats(5.0, 60.0),
)
def test_every_path_of_the_band_is_clear_of_the_stated_ground_or_the_floor_is_refused(
    folder: Path, highest_m: float, tracking_m: float, safety_m: float
) -> None:
    """And what is proposed instead is taken."""
    text = vehicle(f"scanner = false\ntracking_error_m = {tracking_m}", STATED)
    text = text.replace("highest_amsl_m = 840.0", f"highest_amsl_m = {highest_m}")
    text = text.replace("safety_distance_m = 40.0", f"safety_distance_m = {safety_m}")
    text = text.replace("ceiling_amsl_m = 1100.0", "ceiling_amsl_m = 1400.0")
    try:
        mission = load(folder, text)
    except InputError as error:
        message = str(error)
        proposed = re.search(r"altitude\.floor_amsl_m = 900\.0: .*Raise it to (\d+)", message)
        floor = "no proposal" if proposed is None else f"floor_amsl_m = {proposed[1]}.0"
        mission = load(folder, text.replace("floor_amsl_m = 900.0", floor))
    lowest_m, _ = mission.task.band_amsl_m
    assert lowest_m - highest_m >= safety_m + mission.task.error_m
    assert mission.task.take_off_amsl_m - highest_m >= safety_m + mission.task.error_m


# --- what is refused

SHAPE = "a circle or a polygon"
NONE = [
    ("vertices_deg = [[8.0, 147.0], [47.0, 8.0], [47.0, 8.1]]", "more than 1,000 km"),
    ("vertices_deg = [[108.0, 47.0], [47.0, 8.0], [47.0, 8.1]]", "latitude comes first"),
    ("vertices_m = [[0.0, 0.0], [9.0, 9.0], [9.0, 0.0], [0.0, 9.0]]", "cross"),
    ("vertices_m = []", "three or more"),
    ("north_m = 1.0\neast_m = 1.0", SHAPE),
    ("radius_m = 1.0", SHAPE),
    (f"radius_m = 3.0\nvertices_m = {TRIANGLE}", SHAPE),
    (f"vertices_deg = {TRIANGLE}\nvertices_m = []", SHAPE),
    (
        "vertices_deg = [[36.0, -180.0], [36.0, 180.0], [58.0, 180.0], [58.0, -180.0]]",
        "may reach the map",
    ),
    ("vertices_deg = [[35.0, 0.0], [36.0, 120.0], [35.0, -120.0]]", "around a pole"),
    (
        "vertices_deg = [[60.0, -20.0], [60.0, 40.0], [47.0, 40.0], [47.0, 8.01]]",
        "may reach the map",
    ),
    ("latitude_deg = 56.01\nlongitude_deg = 8.0\nradius_m = 1000e3", "as a polygon"),  # it reaches
]
ARDUPLANE = vehicle('autopilot = "ardupilot"', PLANE)
BLIND = vehicle("scanner = false", KNOWN)
GUIDES = 'trust = "guidance"\n'
REFUSED: list[tuple[str, str]] = [
    (
        COPTER.replace('name = "test"', 'name = "Über den Wald"'),
        "name = 'Über den Wald': .*64 of A-Z",
    ),
    (COPTER.replace('name = "test"', 'name = "a/b"'), "name = 'a/b'"),
    *(
        (f'{COPTER}[link]\ncommanders = ["{who}"]\n', r"link\.commanders\[0\]")
        for who in ("0/0", "255/256", "255", "a/b")
    ),
    (COPTER + THEIRS, "targets = 1: there are either"),
    (NO_TARGETS, "targets = None: there are either"),
    (COPTER.replace("floor_amsl_m =", "floor_agl_m ="), "Did you mean floor_amsl_m.*Known here: "),
    (COPTER.replace('"hold"', '"loiter"'), "end.action = 'loiter'.*'hold', 'land' or 'return'"),
    (COPTER.replace("climb_angle_deg = 17.0", "climb_angle_deg = 90.0"), "angle_deg.*less than 90"),
    (COPTER.replace("speed_m_s = 8.0", "speed_m_s = true"), "speed_m_s = True.*valid number"),
    (vehicle("system_id = 1.5"), "system_id = 1.5: .*Write a whole number,"),
    (vehicle("navigation_error_m = -0.1"), "vehicle.navigation_error_m = -0.1: .*equal to 0"),
    # what a kind of vehicle cannot do
    (PLANE.replace("loiter_radius_m = 80.0", ""), "loiter_radius_m .*missing.*circles"),
    (vehicle("loiter_radius_m = 80.0"), "loiter_radius_m = 80.0.*a copter stops"),
    (vehicle("yaw_deg = 0.0", PLANE), "yaw_deg = 0.0.*where it flies"),
    (
        ARDUPLANE.replace('"hold"', '"land"'),
        "end.action = 'land'.*ArduPlane cannot be told to land",
    ),
    (f'{ARDUPLANE}[fallback]\naction = "land"', "fallback.action = 'land'.*ArduPlane"),
    # places
    (place("north_m = 1.0"), r"targets\[0\] = \['north_m'\]: a place is given by"),
    (place("north_m = 1.0\nlatitude_deg = 47.0"), "Give one of these pairs"),
    (place("latitude_deg = -47.0\nlongitude_deg = -172.0"), "1,000 km from the origin"),
    (place("latitude_deg = 47.1\nlongitude_deg = 8.0"), "outside the map"),
    *((zone(text), rf"keep_outs\[0\].*{words}") for text, words in NONE),
    (zone(NONE[0][0], "keep_ins"), r"keep_ins\[0\].*more than 1,000 km"),
    (zone(f"vertices_deg = {TRIANGLE}", "keep_ins"), r"keep_ins\[0\].*all of the map lies outside"),
    (
        place("north_m = 5500.0\neast_m = 0.0") + f'[[keep_ins]]\nname = "zone"\n{AROUND}\n',
        r"targets\[0\] = \[5500.0, 0.0\]: it lies outside keep-in 'zone'",
    ),
    ('threats = "absent.geojson"\n' + COPTER, "mission.toml: threats = .*no such file"),
    # a radar, or none
    (vehicle("scanner = false"), "terrain = None: .*nothing is known of the ground"),
    (vehicle("scanner_component_id = 100", BLIND), "there is no terrain radar"),
    (f"{BLIND}[scanner]\ncomplete = false\n", r"vehicle.scanner = False: \[scanner\] says"),
    (BLIND + GUIDES, "terrain.trust = 'guidance'.*guidance proves nothing"),
    # terrain
    (STATED + GUIDES, "mission.toml: terrain.trust = 'guidance'"),
    ("terrain = 7\n" + COPTER, "terrain = 7: it must be a table"),
    (KNOWN.replace("longitude_deg = 8.0", "longitude_deg = 18.0"), "no height anywhere on the map"),
    (KNOWN.replace("dem.tif", "absent.tif"), "no such file"),
    (KNOWN.replace('vertical_datum = "EGM96"\n', ""), "vertical_datum = None: it is missing"),
    (KNOWN.replace("EGM96", "WGS84"), "vertical_datum = 'WGS84'"),
    (KNOWN + "datum_error_m = -1.0\n", "greater than or equal to 0"),
    (STATED + 'file = "dem.tif"\n', r"terrain\.file = .*: no such key"),  # it stands alone
    (STATED.replace("840.0", "inf"), "terrain.highest_amsl_m = inf"),
    (COPTER + "[terrain]\n", "terrain.file = None: it is missing. Add file"),
    (STATED.replace("highest_amsl_m", "highest_m"), r"Did you mean highest_amsl_m\?"),
    # a sensor of near things
    (scanner('kind = "radar"'), "scanner.kind.*terrain_radar"),
    (scanner("yaw_deg = 90.0"), "scanner.yaw_deg = 90.0: it is of kind obstacle_distance or"),
    (scanner(OBSTACLE + "complete = true"), "scanner.complete = True.*it is of kind terrain_radar"),
    (
        scanner(OBSTACLE, (KIND, f"{KIND}\nscanner_component_id = 100")),
        "vehicle.scanner_component_id = 100.*write scanner.component.",
    ),
    (
        scanner(OBSTACLE, (KIND, 'kind = "plane"\nloiter_radius_m = 30.0')),
        "scanner.kind = 'obstacle_distance'.*can stop",
    ),
    (scanner('kind = "obstacle_distance"'), "scanner.speaks_for_m.*band is 4 m high"),
    (scanner(OBSTACLE, (FLAT, "")), "terrain = None.*nothing is known of the ground"),
    (scanner(OBSTACLE, (FLAT, FILE)), "terrain.trust = 'guidance'.*without a terrain radar"),
    (scanner(OBSTACLE, (KIND, f"{KIND}\nscanner = false")), "vehicle.scanner = False.*Remove one"),
    (scanner(OBSTACLE + "component = 195"), "scanner.component = 195.*the companion itself"),
    (scanner(OBSTACLE + "bearing_error_deg = 46.0"), "bearing_error_deg = 46.0.*less than"),
    (scanner(OBSTACLE + "range_error_m = nan"), "scanner.range_error_m = nan.*finite"),
    (
        COPTER.replace("planner = {", 'planner = { optimiser = "magic",'),
        "planner.optimiser = 'magic'" + "".join(f"(?=.*{name})" for name in OPTIMISERS),
    ),
    ((ENVIRONMENTS / "environment-1" / "world.toml").read_text(), "this is a world, not a mission"),
]


@pytest.mark.parametrize(("text", "words"), REFUSED, ids=range(len(REFUSED)))
def test_what_breaks_a_rule_is_refused_in_one_line(folder: Path, text: str, words: str) -> None:
    """Where, field, value, rule, remedy."""
    told = refusal(load, folder, text)
    assert told.startswith((f"{folder / 'mission.toml'}: ", "MISSION = ")), told
    assert re.fullmatch(r"\S[^\n]*? = [^\n]+: [^\n]+\. [A-Z][^\n]*[.?]", told), told
    assert re.search(words, told), told


def keys_in(table: dict[str, Any]) -> Iterator[tuple[dict[str, Any], str]]:
    """Every key, with the table that it is in."""
    for key, value in table.items():
        yield table, key
        for inner in value if isinstance(value, list) else [value]:
            if isinstance(inner, dict):
                yield from keys_in(inner)


@pytest.mark.parametrize("number", range(len(list(keys_in(tomllib.loads(COPTER))))))
def test_a_key_that_is_left_out_misspelt_or_no_number_is_named(folder: Path, number: int) -> None:
    def with_key(name: str | None, value: float | None = None) -> tuple[str, Any, str]:
        table = tomllib.loads(COPTER)
        inner, key = list(keys_in(table))[number]
        was = inner.pop(key)
        if name is not None:
            inner[name.format(key)] = was if value is None else value
        return key, was, refusal(load, folder, toml_text(table))

    key, was, told = with_key(None)
    assert key in told
    assert re.search("it is missing|a place is given by|there are either", told)
    _, _, told = with_key("{}_x")
    assert f"{key}_x = " in told
    assert f"Did you mean {key}?" in told
    assert "Known here: " in told
    for value in (math.nan, math.inf, -math.inf) if isinstance(was, float) else ():
        assert f"{key} = {value}" in with_key("{}", value)[2]


def test_what_is_no_mission_or_world_is_told(folder: Path) -> None:
    """Files of another kind: `test_files.py`."""
    names = r"'nowhere'.*no such file.*environment-1, environment-2"
    a_folder = r"it is a folder\. Give a mission\.toml"
    for name, words in (("nowhere", names), (str(folder), a_folder), ("x" * 5000, "xxx")):
        with pytest.raises(InputError, match=words):
            load_mission(name)
    path, world = folder / "world.toml", ENVIRONMENTS / "environment-1" / "world.toml"
    text = world.read_text(encoding="utf-8")
    for bad, words in (
        (COPTER, "this is a mission, not a world. Give its world.toml"),
        (text.replace("height_amsl_m", "height_m", 1), r"peaks\[0\]\.height_m = .*height_amsl_m"),
        (re.sub(r"(spread_north_m) = [\d.]+", r"\1 = 1e-300", text, count=1), r"north_m = 1e-300"),
    ):
        path.write_text(bad, encoding="utf-8")
        with pytest.raises(InputError, match=words):
            load_world(str(path))


# --- whatever is written

EVERYTHING = """
threats = "threats.geojson"
fallback = { action = "return" }
battery = { reserve_percent = 35.0 }
link = { commanders = ["255/0"] }
from_vehicle = { fence = false }
rally_points = [{ latitude_deg = 47.0, longitude_deg = 8.0 }]
keep_outs = [{ name = "a", vertices_deg = [[47.01, 8.01], [47.02, 8.01], [47.02, 8.02]] }]
keep_ins = [{ name = "b", north_m = 0.0, east_m = 0.0, radius_m = 9000.0 }]
[[radars]]
name = "c"
latitude_deg = 47.0
longitude_deg = 8.0
altitude_amsl_m = 700.0
range_m = 900.0
"""


@given(data=st.data())
def test_any_value_anywhere_is_taken_or_an_input_error(folder: Path, data: st.DataObject) -> None:
    table: Any = tomllib.loads(COPTER) | tomllib.loads(EVERYTHING)
    for _ in range(data.draw(st.integers(1, 3))):
        replace_somewhere(table, data)
    with contextlib.suppress(InputError):
        load(folder, toml_text(table))
        mission_text(str(folder / "mission.toml"))


PAGE = (Path(__file__).parents[2] / "docs" / "files.md").read_text(encoding="utf-8")
SCHEMA = MissionTable.model_json_schema()


def keys_of(table: dict[str, Any], path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every key with its tables, and how it is declared."""
    for name, declared in table["properties"].items():
        named = re.findall(r"#/\$defs/(\w+)", json.dumps(declared))
        tables = [inner for inner in named if "properties" in SCHEMA["$defs"][inner]]
        for inner in tables:
            yield from keys_of(SCHEMA["$defs"][inner], f"{path}{name}.")
        if not tables:
            yield path + name, declared


def test_the_page_of_files_has_every_key_and_the_default_that_it_is_declared_with() -> None:
    said = {}
    for line in re.findall(r"^\| `.*\|$", PAGE, re.MULTILINE):
        keys, *_, default = (cell.strip(' `"|') for cell in line.split(" | "))
        said |= dict.fromkeys(re.findall(r"[a-z]\w*\.\w+", keys), default)
    for key, declared in keys_of(SCHEMA):
        if key.startswith("planner.weights."):  # one for each term of the cost
            continue
        assert key.rpartition(".")[2] in PAGE
        default = declared.get("default", "")
        if default is not None:
            shown = f"{default:g}" if isinstance(default, float) else str(default)
            assert said.get(key, "") == (shown.lower() if default in (True, False) else shown), key
