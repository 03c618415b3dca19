"""Without a terrain radar: flown at the plan's altitudes where they are safe, else it is said."""

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

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
VALLEY = Path(companion.__file__).parent / "environments" / "valley"
VALLEY_TEXT = (VALLEY / "mission.toml").read_text(encoding="utf-8")
Item = dict[str, Any]


def waypoint(height_m: float | None, number: int = 1, **more: Any) -> Item:
    """Each 300 m north of the one before, launch being the first; above launch if not told else."""
    params: list[Any] = [0, 0, 0, None, HOME[0] + 0.0027 * number, HOME[1], height_m]
    return {"command": 16, "frame": 3, "params": params} | more


def planned(folder: Path, items: Iterable[Item], text: str | None = None) -> Mission:
    """The plan of these items alone, or the mission that names it with this text."""
    mission = {"plannedHomePosition": HOME, "vehicleType": 2, "hoverSpeed": 5}
    content = {"fileType": "Plan", "mission": mission | {"items": list(items)}}
    plan, toml = folder / "field-7.plan", folder / "mission.toml"
    plan.write_text(json.dumps(content), encoding="utf-8")
    toml.write_text(f'plan = "field-7.plan"\n{text}', encoding="utf-8")
    return load_mission(str(plan if text is None else toml))


def blind(
    folder: Path, *above_launch_m: float | None, ground_amsl_m: float = HOME[2], more: str = ""
) -> Mission:
    """Without a radar, over ground that is stated."""
    items = [waypoint(height_m, k) for k, height_m in enumerate(above_launch_m, 1)]
    terrain = f"[vehicle]\nscanner = false\n[terrain]\nhighest_amsl_m = {ground_amsl_m}\n"
    return planned(folder, items, terrain + more)


def lowest_m(mission: Mission, target: int) -> float:
    """The lowest that a path to a target may lie, and so where it does."""
    return mission.task_to(target, mission.task).band_amsl_m[0]


def test_each_waypoint_is_flown_to_at_its_own_altitude(tmp_path: Path) -> None:
    """One without has that of the one before, which is said; the climb ends at the lowest."""
    mission = blind(tmp_path, 40.0, 60.0, None, 45.0)
    assert mission.name == "field-7"  # as its plan
    for target, height_m in enumerate((40.0, 60.0, 60.0, 45.0)):
        assert lowest_m(mission, target) == pytest.approx(HOME[2] + height_m, abs=0.2)
    assert mission.task.take_off_amsl_m == pytest.approx(HOME[2] + 40.0, abs=0.2)
    assert not any("flown at" in note for note in mission.notes)
    assert any("1 x waypoint without an altitude" in note for note in mission.notes)


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


@pytest.mark.parametrize(
    ("planned_m", "kept_m", "more", "said"),
    [
        (12.0, 10.0, "", "items[0] is planned at 500 m AMSL and flown at 509 m"),
        (40.0, 50.0, "[planner]\nsafety_distance_m = 50.0\n", "flown at 549 m"),
    ],
)
def test_a_waypoint_that_is_too_low_is_flown_higher_and_that_is_said(
    tmp_path: Path, planned_m: float, kept_m: float, more: str, said: str
) -> None:
    mission = blind(tmp_path, planned_m, 80.0, more=more)
    assert lowest_m(mission, 0) == pytest.approx(HOME[2] + kept_m + KEPT_M, abs=0.2)
    [note] = [note for note in mission.notes if "flown at" in note]
    assert said in note


def test_a_fence_below_a_targets_altitude_leaves_room_to_plan(tmp_path: Path) -> None:
    mission = blind(tmp_path, 40.0, 80.0)
    lowered = replace(mission.task.limits, ceiling_amsl_m=HOME[2] + 75.0)
    low_m, high_m = mission.task_to(1, replace(mission.task, limits=lowered)).band_amsl_m
    assert low_m < high_m <= HOME[2] + 75.0


def over_the_valley(folder: Path, north_m: float, east_m: float) -> Mission:
    """To one target at 520 m AMSL over an elevation file, without a radar."""
    raw = VALLEY_TEXT.replace("[[targets]]\nnorth_m = -3850.0\neast_m = 800.0\n", "")
    text = raw.replace('kind = "copter"\n', 'kind = "copter"\nscanner = false\n')
    text += f"[[targets]]\nname = 'at 520'\nnorth_m = {north_m}\neast_m = {east_m}\n"
    text += f'altitude_amsl_m = 520.0\n[terrain]\nfile = "{VALLEY / "terrain.tif"}"\n'
    path = folder / "mission.toml"
    path.write_text(text + 'vertical_datum = "AMSL"\n', encoding="utf-8")
    return load_mission(str(path))


def test_what_the_elevation_file_says_against_it_is_said(tmp_path: Path) -> None:
    assert over_the_valley(tmp_path, -3850.0, 800.0).notes == ()
    [low] = over_the_valley(tmp_path, -3850.0, -2000.0).notes
    assert "at 520 is planned at 520 m AMSL and flown at 585 m" in low
    with pytest.raises(InputError, match="not known, or too high for the ceiling"):
        over_the_valley(tmp_path, 0.0, -3500.0)  # in a mountain


def test_a_target_outside_of_the_band_is_refused(tmp_path: Path) -> None:
    path, target = tmp_path / "mission.toml", "east_m = 800.0\n"
    text = VALLEY_TEXT.replace(target, f"{target}altitude_amsl_m = 650.0\n")
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"targets\[0\].altitude_amsl_m = .*no path lies higher"):
        load_mission(str(path))
    band = "[altitude]\nfloor_amsl_m = 540.0\nceiling_amsl_m = 600.0\n"
    with pytest.raises(InputError, match=r"altitude\.floor_amsl_m"):
        blind(tmp_path, 40.0, ground_amsl_m=HOME[2] + 80.0, more=band)


def of_terrain(height_m: float, number: int = 2, mode: int | None = None, frame: int = 10) -> Item:
    """As frame 10, or as QGroundControl's AltitudeMode with the height in a key of its own."""
    if mode is None:
        return waypoint(height_m, number, frame=frame)
    sent_m, frame = (None, 0) if mode == 3 else (height_m, frame)  # 3: sent as AMSL
    return waypoint(sent_m, number, frame=frame, AltitudeMode=mode, Altitude=height_m)


@pytest.mark.parametrize("said", [{}, {"mode": 3}, {"mode": 4}, {"frame": 11}])
def test_above_terrain_is_above_the_ground_stated(tmp_path: Path, said: dict[str, int]) -> None:
    terrain = "[vehicle]\nscanner = false\n[terrain]\nhighest_amsl_m = 505.0\n"
    mission = planned(tmp_path, [waypoint(100.0), of_terrain(120.0, **said)], terrain)
    assert mission.altitudes_amsl_m == (588.0, 625.0)


def test_above_terrain_is_above_the_ground_of_a_file(tmp_path: Path) -> None:
    """The ground rises by 1 m for each 0.0002 degrees of latitude, so by 27 m to the waypoint."""
    rows, step_deg, south_west = 400, 0.0002, (HOME[0] - 0.04, HOME[1] - 0.04)
    rise_m = np.arange(rows)[::-1, None] + np.zeros((rows, rows)) - 0.04 / step_deg
    corner = south_west[0] + (rows - 1) * step_deg, south_west[1]
    write_elevation(tmp_path / "slope.tif", HOME[2] + rise_m, corner, step_deg)
    terrain = (
        '[vehicle]\nscanner = false\n[terrain]\nfile = "slope.tif"\nvertical_datum = "EGM96"\n'
    )
    mission = planned(tmp_path, [waypoint(100.0), of_terrain(120.0)], terrain)
    ground_m = HOME[2] + 0.0054 / step_deg
    assert ground_m + 120.0 <= mission.altitudes_amsl_m[1] <= ground_m + 122.0
    with pytest.raises(InputError, match=r"items\[1\].*the ground is there is not known"):
        planned(tmp_path, [waypoint(100.0), of_terrain(120.0, 22)], terrain)


def test_an_altitude_above_ground_that_is_not_known_is_refused_or_said(tmp_path: Path) -> None:
    """Without a radar it would be flown; with one every altitude of the band is as good."""
    modes = ((120.0, None), (90.0, 3), (80.0, 4))
    items = [waypoint(100.0), *(of_terrain(height_m, mode=mode) for height_m, mode in modes)]
    with pytest.raises(InputError, match=r"field-7\.plan: mission\.items\[1\].* = 120"):
        planned(tmp_path, items, "[vehicle]\nscanner = false\n")
    mission = planned(tmp_path, items)
    assert mission.altitudes_amsl_m == ()
    assert mission.task_to(1, mission.task) is mission.task
    said = next(note for note in mission.notes if "above terrain" in note)
    assert "3 x altitude above terrain" in said
