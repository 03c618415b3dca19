"""Without a terrain radar: flown at the plan's altitudes where they are safe, else it is said."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from geotiff import write_elevation

import companion
from companion.config import load_mission
from companion.errors import InputError
from companion.mission.mission import Mission

HOME = (47.3977, 8.5456, 488.0)
ERROR_M = 10.0  # of the copter that is assumed: tracking and navigation
KEPT_M = 1.1 * ERROR_M


def plan(folder: Path, above_launch_m: Sequence[float | None], kind: int = 2) -> Path:
    """Waypoints 300 m apart, to the north."""
    items = [
        {
            "type": "SimpleItem",
            "command": 16,
            "frame": 3,
            "params": [0, 0, 0, None, HOME[0] + 0.0027 * (number + 1), HOME[1], height],
        }
        for number, height in enumerate(above_launch_m)
    ]
    mission = {"plannedHomePosition": HOME, "vehicleType": kind, "hoverSpeed": 5, "items": items}
    path = folder / "field-7.plan"
    path.write_text(json.dumps({"fileType": "Plan", "mission": mission}), encoding="utf-8")
    return path


def blind(
    folder: Path, *above_launch_m: float | None, ground_amsl_m: float = HOME[2], more: str = ""
) -> Mission:
    """The same without a radar, over ground that is stated."""
    path = folder / "mission.toml"
    terrain = f"[terrain]\nhighest_amsl_m = {ground_amsl_m}\n"
    text = f'plan = "{plan(folder, above_launch_m).name}"\n[vehicle]\nscanner = false\n'
    path.write_text(text + terrain + more, encoding="utf-8")
    return load_mission(str(path))


def lowest_m(mission: Mission, target: int) -> float:
    """The lowest that a path to a target may lie, and so where it does."""
    return mission.task_to(target, mission.task).band_amsl_m[0]


def test_a_mission_is_called_by_the_file_of_its_plan(tmp_path: Path) -> None:
    assert load_mission(str(plan(tmp_path, [40.0]))).name == "field-7"
    assert blind(tmp_path, 40.0).name == "field-7"


def test_each_waypoint_is_flown_to_at_its_own_altitude(tmp_path: Path) -> None:
    """One without has that of the one before, which is said; the climb ends at the lowest."""
    mission = blind(tmp_path, 40.0, 60.0, None, 45.0)
    for target, height_m in enumerate((40.0, 60.0, 60.0, 45.0)):
        assert lowest_m(mission, target) == pytest.approx(HOME[2] + height_m, abs=0.2)
    assert mission.task.take_off_amsl_m == pytest.approx(HOME[2] + 40.0, abs=0.2)
    assert not any("flown at" in note for note in mission.notes)
    assert any("without an altitude" in note and "items[2]" in note for note in mission.notes)


def test_with_a_radar_the_altitude_is_free_within_the_band(tmp_path: Path) -> None:
    mission = load_mission(str(plan(tmp_path, [40.0, 60.0])))
    assert mission.altitudes_amsl_m == ()
    assert mission.task_to(1, mission.task) is mission.task


@pytest.mark.parametrize(
    ("above_m", "ground_m", "distance_m"),
    [(40.0, 0.0, 29.0), (90.0, 0.0, 30.0), (40.0, 15.0, 14.0)],
)
def test_the_distance_that_is_assumed_is_what_the_plan_leaves(
    tmp_path: Path, above_m: float, ground_m: float, distance_m: float
) -> None:
    mission = blind(tmp_path, above_m, ground_amsl_m=HOME[2] + ground_m)
    assert mission.task.settings.safety_distance_m == distance_m
    assert any(f"d_s = {distance_m:g} m" in note for note in mission.notes)


def test_a_waypoint_that_is_too_low_is_flown_higher_and_that_is_said(tmp_path: Path) -> None:
    mission = blind(tmp_path, 12.0, 60.0)
    assert lowest_m(mission, 0) == pytest.approx(HOME[2] + 10.0 + KEPT_M, abs=0.2)
    [said] = [note for note in mission.notes if "flown at" in note]
    assert "items[0] is planned at 500 m AMSL and flown at 509 m" in said
    mission = blind(tmp_path, 40.0, more="[planner]\nsafety_distance_m = 50.0\n")  # it is kept
    assert lowest_m(mission, 0) == pytest.approx(HOME[2] + 50.0 + KEPT_M, abs=0.2)
    assert any("flown at 549 m" in note for note in mission.notes)


def test_a_target_that_the_ceiling_is_too_low_for_is_refused_before_take_off(
    tmp_path: Path,
) -> None:
    band = "[altitude]\nfloor_amsl_m = 540.0\nceiling_amsl_m = 600.0\n"
    with pytest.raises(InputError, match=r"altitude\.floor_amsl_m"):
        blind(tmp_path, 40.0, ground_amsl_m=HOME[2] + 80.0, more=band)


VALLEY = Path(companion.__file__).parent / "environments" / "valley"


def over_the_valley(folder: Path, *targets: tuple[float, float, float]) -> Mission:
    """Over an elevation file, without a radar; each target's north, east and altitude."""
    raw = (VALLEY / "mission.toml").read_text(encoding="utf-8")
    raw = raw.replace("[[targets]]\nnorth_m = -3850.0\neast_m = 800.0\n", "")
    text = raw.replace('kind = "copter"\n', 'kind = "copter"\nscanner = false\n')
    for north_m, east_m, altitude_m in targets:
        text += f"[[targets]]\nname = 'at {altitude_m:g}'\nnorth_m = {north_m}\n"
        text += f"east_m = {east_m}\naltitude_amsl_m = {altitude_m}\n"
    text += f'[terrain]\nfile = "{VALLEY / "terrain.tif"}"\nvertical_datum = "AMSL"\n'
    path = folder / "mission.toml"
    path.write_text(text, encoding="utf-8")
    return load_mission(str(path))


def test_what_the_elevation_file_says_against_an_altitude_is_said_before_take_off(
    tmp_path: Path,
) -> None:
    in_the_valley = (-3850.0, 800.0, 520.0)
    assert over_the_valley(tmp_path, in_the_valley).notes == ()
    [low] = over_the_valley(tmp_path, (-3850.0, -2000.0, 520.0)).notes
    assert "at 520 is planned at 520 m AMSL and flown at 585 m" in low
    with pytest.raises(InputError, match="not known, or too high for the ceiling"):
        over_the_valley(tmp_path, (0.0, -3500.0, 520.0))  # in a mountain


@pytest.mark.parametrize("altitude_m", [650.0, 10_000.0])
def test_an_altitude_above_the_band_is_refused_with_a_radar_too(
    tmp_path: Path, altitude_m: float
) -> None:
    raw, target = (VALLEY / "mission.toml").read_text(encoding="utf-8"), "east_m = 800.0\n"
    path = tmp_path / "mission.toml"
    path.write_text(raw.replace(target, f"{target}altitude_amsl_m = {altitude_m}\n"), "utf-8")
    with pytest.raises(InputError, match=r"targets\[0\].altitude_amsl_m = .*no path lies higher"):
        load_mission(str(path))


def test_a_fence_below_a_targets_altitude_leaves_room_to_plan(tmp_path: Path) -> None:
    mission = blind(tmp_path, 40.0, 80.0)
    lowered = replace(mission.task.limits, ceiling_amsl_m=HOME[2] + 75.0)
    low_m, high_m = mission.task_to(1, replace(mission.task, limits=lowered)).band_amsl_m
    assert low_m < high_m <= HOME[2] + 75.0


# --- altitudes above terrain


def above_terrain(
    folder: Path, terrain: str, *items: dict[str, object], blind: bool = True
) -> Path:
    """Waypoints that follow a first one at 100 m above launch."""
    first = {"command": 16, "frame": 3, "params": [0, 0, 0, None, HOME[0] + 0.002, HOME[1], 100]}
    mission = {"plannedHomePosition": HOME, "vehicleType": 2, "items": [first, *items]}
    content = {"fileType": "Plan", "mission": mission}
    (folder / "over.plan").write_text(json.dumps(content), encoding="utf-8")
    path = folder / "mission.toml"
    sensor = "[vehicle]\nscanner = false\n" if blind else ""
    path.write_text(f'plan = "over.plan"\n{sensor}{terrain}', encoding="utf-8")
    return path


def of_terrain(height_m: float, north_deg: float = 0.004, **more: object) -> dict[str, object]:
    """As frame 10, or as QGroundControl's AltitudeMode with the height in a key of its own."""
    place: list[object] = [0, 0, 0, None, HOME[0] + north_deg, HOME[1], height_m]
    item: dict[str, object] = {"command": 16, "frame": 10, "params": place}
    if more.get("AltitudeMode") == 3:  # sent as AMSL
        item |= {"frame": 0, "params": [*place[:-1], None]}
    return item | ({"Altitude": height_m} if "AltitudeMode" in more else {}) | more


@pytest.mark.parametrize("said", [{}, {"AltitudeMode": 3}, {"AltitudeMode": 4}, {"frame": 11}])
def test_an_altitude_above_terrain_counts_from_the_ground_that_is_stated(
    tmp_path: Path, said: dict[str, object]
) -> None:
    terrain = "[terrain]\nhighest_amsl_m = 505.0\n"
    mission = load_mission(str(above_terrain(tmp_path, terrain, of_terrain(120.0, **said))))
    assert mission.altitudes_amsl_m == (588.0, 625.0)
    assert any("above terrain" in note and "items[1]" in note for note in mission.notes)


def test_an_altitude_above_terrain_counts_from_the_ground_of_an_elevation_file(
    tmp_path: Path,
) -> None:
    """The ground rises by 1 m for each 0.0002 degrees of latitude, so by 20 m to the waypoint."""
    rows = 400
    south_deg, step = HOME[0] - 0.04, 0.0002
    heights_m = HOME[2] + np.arange(rows)[::-1, None] - 0.04 / step + np.zeros((rows, rows))
    corner = HOME[0] - 0.04 + (rows - 1) * step, HOME[1] - 0.04
    write_elevation(tmp_path / "slope.tif", heights_m, corner, step)
    assert south_deg < HOME[0]
    terrain = '[terrain]\nfile = "slope.tif"\nvertical_datum = "EGM96"\n'
    mission = load_mission(str(above_terrain(tmp_path, terrain, of_terrain(120.0))))
    ground_m = HOME[2] + 0.004 / step
    assert ground_m + 120.0 <= mission.altitudes_amsl_m[1] <= ground_m + 122.0
    beyond = above_terrain(tmp_path, terrain, of_terrain(120.0, north_deg=0.06))
    with pytest.raises(InputError, match=r"items\[1\].*the ground is there is not known"):
        load_mission(str(beyond))


def test_an_altitude_above_ground_that_is_not_known_is_refused_or_said(tmp_path: Path) -> None:
    """Without a radar it would be flown; with one every altitude of the band is as good."""
    items = of_terrain(120.0), of_terrain(90.0, AltitudeMode=3), of_terrain(80.0, AltitudeMode=4)
    with pytest.raises(InputError, match=r"over\.plan: mission\.items\[1\].* = 120"):
        load_mission(str(above_terrain(tmp_path, "", *items)))
    mission = load_mission(str(above_terrain(tmp_path, "", *items, blind=False)))
    said = next(note for note in mission.notes if "above terrain" in note)
    assert "3 x altitude above terrain" in said
    assert "items[3]" in said
