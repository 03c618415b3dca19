"""A mission.toml is the mission that it tells; what is wrong with one: `test_refusals`."""

import itertools
import json
import math
import re
from collections import Counter
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from documents import HEIGHTS_M, STEP_DEG, mission, table_of, terrain
from hypothesis import given
from hypothesis import strategies as st
from planning import column_distance_m

from companion.config import load_mission, read_mission
from companion.errors import InputError
from companion.geodesy import FloatArray, LocalFrame
from companion.optimise.registry import OPTIMISERS
from companion.sources.mission_file import MissionTable
from companion.sources.zones import ZoneTable, zones_of
from companion.telemetry.run_folder import RunFolder

FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
KNOWS, BLIND = "mission that knows the ground", "mission without a radar"


def shown(value: Any) -> Any:
    """As JSON has it, numbers to a millionth."""
    match value:
        case float():
            return round(value, 6)
        case Enum():
            return value.value
        case list() | tuple():
            return [*map(shown, value)]
    return value


MEANINGS = table_of("meanings.txt")


@pytest.mark.parametrize("kind", MEANINGS)
def test_what_each_key_means_and_what_is_assumed_of_what_is_left_out(
    folder: Path, kind: str
) -> None:
    for edits, said in MEANINGS[kind]:
        found, told = mission(folder, kind, *edits), list[str]()
        for place in (each.split(" = ")[0] for each in said.split(" ; ")):
            value: Any = found
            for step in place.split("."):
                value = value[int(step)] if step.isdigit() else getattr(value, step)
            told.append(f"{place} = {json.dumps(shown(value), ensure_ascii=False)}")
        assert told == said.split(" ; ")


def test_of_a_sensor_of_near_things_the_ground_is_known_and_what_stands_on_it_is_not(
    folder: Path,
) -> None:
    found = mission(folder, "mission by a lidar")
    assert (found.known.guess_m == 400.5).all()
    assert not found.known.surveyed.any()


# --- places and zones


FAR_AWAY = {
    "antipodes": [[-47.0, -172.0], [-46.999, -172.0], [-47.0, -171.999]],
    "Antarctica as GeoJSON has it": [
        *([-85.0, -180.0], [-90.0, -180.0], [-90.0, 180.0], [-85.0, 180.0], [-65.0, 60.0])
    ],
    "over the date line": [[60.0, 175.0], [60.0, -170.0], [50.0, -170.0], [50.0, 175.0]],
}


def test_keep_outs_away_from_the_map_are_left_out_and_counted(folder: Path) -> None:
    """As in a file of all countries; beside it they count as far as paths keep from them."""
    by_m = mission(folder, "mission").task.zone_search_clearance_m
    square_m = 10.0 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    zones: list[Any] = [{"name": name, "vertices_deg": ring} for name, ring in FAR_AWAY.items()]
    zones.append({"name": "", "latitude_deg": 56.9, "longitude_deg": 8.0, "radius_m": 15e4})
    for more_m in (-1.0, 1.0):
        off_m, name = by_m + 10.0 + more_m, {"name": str(more_m)}
        for side_m in (6e3 + off_m, -4e3 - off_m):
            for place in ((side_m, 0.0), (0.0, side_m)):
                circle = {"north_m": place[0], "east_m": place[1], "radius_m": 10.0}
                zones += [{**circle, **name}]
                zones += [{"vertices_m": (square_m + np.array(place)).tolist(), **name}]
    found = mission(folder, "mission", f"keep_outs = {json.dumps(zones)}")
    assert [zone.name for zone in found.task.zones] == ["-1.0"] * 8
    assert found.notes == ("12 of 20 keep-outs lie away from the map",)


def star(random: np.random.Generator, size: float) -> FloatArray:
    """A concave polygon of 40 to 75 degrees times its size, (latitude, longitude) of each corner.

    Its rim goes by (0, 0).
    """
    angles = np.sort(random.uniform(0.0, 2.0 * math.pi, 7))
    rays = np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    corners = size * random.uniform(20.0, 37.0, (7, 1)) * rays
    k, part = random.integers(0, 7), random.uniform(0.3, 0.7)
    corners -= corners[k - 1] + part * (corners[k] - corners[k - 1])
    return corners + random.uniform(-0.1, 0.1, 2)


@pytest.mark.parametrize("origin", [(a, b) for a in (0.01, 47.0, -13.0) for b in (8.0, -179.98)])
@pytest.mark.parametrize("size", [0.002, 0.1, 1.0])
def test_a_polygon_is_that_which_is_straight_in_degrees_or_refused_if_it_is_too_far_to_tell(
    folder: Path, origin: tuple[float, float], size: float
) -> None:
    """By shapely, over a map of 10 km; corners up to 1,000 km away are not too far."""
    frame = LocalFrame(latitude_deg=origin[0], longitude_deg=origin[1])
    task, random, ends = mission(folder, "mission").task, np.random.default_rng(7), Counter[str]()
    north, east = random.uniform(-4000.0, 6000.0, (2, 60))
    latitude, longitude = frame.to_geodetic_deg(north, east)
    places = shapely.points(latitude - origin[0], (longitude - origin[1] + 180.0) % 360.0 - 180.0)
    for number in range(60):
        corners, keep_in = star(random, size), number % 2 == 1
        corners[:, 0] = np.clip(corners[:, 0], -89.0 - origin[0], 89.0 - origin[0])
        drawn = shapely.Polygon(corners)
        if not drawn.is_simple or 8.0 < np.hypot(*corners.T).min() < 15.0:  # about 1,000 km
            continue
        told = corners + np.array(origin)
        told[:, 1] = (told[:, 1] + 180.0) % 360.0 - 180.0
        zone = ZoneTable(name="", vertices_deg=told.tolist())
        inside = shapely.contains(drawn, places)
        try:
            zones, _ = zones_of([] if keep_in else [zone], [zone] if keep_in else [], task, frame)
        except InputError as error:
            ends["refused"] += 1
            assert size == 1.0
            if "all of the map lies outside" in error.rule:
                assert keep_in
                assert not inside.any()
            else:
                assert inside.any() or keep_in or shapely.distance(drawn, places).min() < 0.5
        else:
            ends["taken" if zones else "left out"] += 1
            assert zones or not inside.any()
            rim = shapely.segmentize(drawn.exterior & shapely.box(-0.1, -0.1, 0.1, 0.1), 0.01)
            rim_deg = shapely.get_coordinates(rim) + np.array(origin)
            rim_ne_m = np.array([frame.to_local_m(*place) for place in rim_deg]).reshape(-1, 2)
            for found in zones:
                assert (abs(found.distance_m(*rim_ne_m.T)) < 0.2).all()
                distance_m = found.distance_m(north, east)
                told_inside = (distance_m < 0.0) != keep_in
                assert (told_inside == inside)[abs(distance_m) > 0.2].all()
    assert ends["refused" if size == 1.0 else "taken"] > 10


# --- ground that is known in advance


def test_the_ground_is_nowhere_higher_than_the_known_map_says(folder: Path) -> None:
    found = mission(folder, KNOWS)
    known = found.known
    assert np.isfinite(known.upper_m).all()
    assert not known.seen.any()  # a scan may still find the ground lower
    assert known.surveyed.all()
    rng = np.random.default_rng(2)
    for row, column in zip(rng.integers(60, 130, 300), rng.integers(80, 200, 300), strict=True):
        # the file's own nodes: each lies in its cell
        place = 47.0 + (99.5 - row) * STEP_DEG, 8.0 + (column - 119.5) * STEP_DEG
        assert known.upper_m[known.cell_of(*FRAME.to_local_m(*place))] >= HEIGHTS_M[row, column] + 5
    assert known.upper_m.max() <= 800.0 + 5.0
    exact = mission(folder, KNOWS, "terrain.datum_error_m = 0.0")  # of the terrain, of nothing else
    np.testing.assert_array_equal(known.upper_m, exact.known.upper_m + 5.0)
    assert found.task == exact.task
    guidance = mission(folder, KNOWS, 'terrain.trust = "guidance"').known  # which is no knowledge
    assert np.isinf(guidance.upper_m).all()
    assert not guidance.surveyed.any()
    np.testing.assert_array_equal(guidance.guess_m, known.upper_m)


def test_what_a_run_folder_keeps_of_a_mission_is_the_mission_without_its_files(
    tmp_path: Path,
) -> None:
    terrain(tmp_path / "dem.tif")
    begun = mission(tmp_path, KNOWS)
    (file,) = tmp_path.glob("*.toml")
    read = read_mission(str(file))
    file.write_text("another by now")  # what is flown is what was read, and that is kept
    assert read.mission().task == begun.task
    text, beside = read.files()
    with RunFolder(tmp_path / "run", mission_toml=text, beside=beside, epoch_us=1):
        pass
    (tmp_path / "dem.tif").unlink()
    again = load_mission(str(tmp_path / "run" / "mission.toml"))
    assert again.task == begun.task
    np.testing.assert_array_equal(again.known.upper_m, begun.known.upper_m)


def test_beyond_the_file_nothing_is_known_even_if_holes_in_it_are_sea(tmp_path: Path) -> None:
    terrain(tmp_path / "dem.tif", HEIGHTS_M[:100])  # ends at the origin's latitude
    for more in ([], ['terrain.nodata = "sea"']):
        known = mission(tmp_path, KNOWS, *more).known
        row, _ = known.cell_of(0.0, 0.0)
        assert np.isinf(known.upper_m[: row - 3]).all()
        assert np.isfinite(known.upper_m[row + 8 :]).all()
        np.testing.assert_array_equal(known.surveyed, np.isfinite(known.upper_m))
        assert not known.seen.any()


def test_ground_that_is_stated_is_known_everywhere(folder: Path) -> None:
    with_radar = mission(folder, "mission", "terrain.highest_amsl_m = 840.0").known
    assert with_radar.surveyed.all()
    assert not with_radar.seen.any()
    found = mission(folder, BLIND)
    known, limits = found.known, found.task.limits
    assert found.scanner_component_id is None
    assert (known.upper_m == 840.0).all()
    assert known.seen.all()  # all that there is of it
    for north, east in itertools.product(limits.north_m, limits.east_m):
        assert known.is_known(min(north, 5999.0), min(east, 5999.0))
    assert any("nowhere higher than 840 m AMSL" in note for note in found.notes)
    assert mission(folder, KNOWS, "vehicle.scanner = false").known.seen.all()


@given(
    highest_m=st.floats(700.0, 1000.0),
    tracking_m=st.floats(1.0, 12.0),
    safety_m=st.floats(5.0, 60.0),
)
def test_every_path_of_the_band_is_clear_of_the_stated_ground_or_the_floor_is_refused(
    folder: Path, highest_m: float, tracking_m: float, safety_m: float
) -> None:
    """And what is proposed instead is taken."""
    said = [f"terrain.highest_amsl_m = {highest_m}", f"vehicle.tracking_error_m = {tracking_m}"]
    said += [f"planner.safety_distance_m = {safety_m}", "altitude.ceiling_amsl_m = 1400.0"]
    try:
        found = mission(folder, BLIND, *said)
    except InputError as error:
        [proposed] = re.findall(r"altitude\.floor_amsl_m = 900\.0: .*Raise it to (\d+)", str(error))
        found = mission(folder, BLIND, *said, f"altitude.floor_amsl_m = {proposed}.0")
    lowest_m, _ = found.task.band_amsl_m
    assert lowest_m - highest_m >= safety_m + found.task.error_m
    assert found.task.take_off_amsl_m - highest_m >= safety_m + found.task.error_m


def test_a_target_lower_than_the_elevation_file_allows_is_flown_to_higher_which_is_said(
    folder: Path,
) -> None:
    said = "vehicle.scanner = false", "altitude.floor_amsl_m = 400.0"
    assert mission(folder, KNOWS, *said, "targets.0.altitude_amsl_m = 1000.0").notes == ()
    found = mission(folder, KNOWS, *said, "targets.0.altitude_amsl_m = 500.0")
    [note] = found.notes
    [flown_m] = re.findall(r"target 1 is planned at 500 m AMSL and flown at (\d+) m", note)
    for up_m, is_clear in ((0.5, True), (-5.5, False)):  # it is looked for in steps of 5 m
        place = np.array([[3000.0, 2000.0, float(flown_m) + up_m]])
        distance_m = column_distance_m(found.known, place, 200.0)
        assert (distance_m >= found.task.required_clearance_m) == is_clear


# --- the page of files

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


def test_the_page_of_files_has_every_key_with_its_declared_default_and_every_optimiser() -> None:
    assert [name for name in OPTIMISERS if f'`"{name}"`' not in PAGE] == []
    said = {}
    for line in re.findall(r"^\| `.*\|$", PAGE, re.MULTILINE):
        keys, *_, default = (cell.strip(' `"|') for cell in line.split(" | "))
        said |= dict.fromkeys(re.findall(r"[a-z]\w*\.\w+", keys), default)
    for key, declared in keys_of(SCHEMA):
        if key.startswith("planner.weights."):  # one for each term of the cost
            assert f"{key}`" in PAGE or f"`.{key.rpartition('.')[2]}`" in PAGE, key
            continue
        assert key.rpartition(".")[2] in PAGE
        default = declared.get("default", "")
        if default is not None:
            shown = f"{default:g}" if isinstance(default, float) else str(default)
            assert said.get(key, "") == (shown.lower() if default in (True, False) else shown), key
