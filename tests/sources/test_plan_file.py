"""Plans and lists of waypoints: what they say and what is assumed; refused: `test_refusals`."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from documents import HEIGHTS_M, STEP_DEG, item, mission, plan, refusal, waypoint
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavwp
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission, read_mission
from companion.mission.mission import EndAction, Mission
from companion.sources.plan_file import read_plan, read_waypoint_fence, read_waypoint_list

MISSIONS = Path(__file__).parent / "missions"
PLANS = sorted(path.name for path in MISSIONS.glob("*.plan"))
FENCED = json.loads((MISSIONS / "fenced.plan").read_text(encoding="utf-8"))


def naming(folder: Path, plan: Any, text: str) -> Mission:
    """The mission of a mission.toml that names a plan."""
    (folder / "x.plan").write_text(json.dumps(plan), encoding="utf-8")
    (folder / "mission.toml").write_text(f'plan = "x.plan"\n{text}', encoding="utf-8")
    return load_mission(str(folder / "mission.toml"))


# --- what they say: a plan as QGroundControl saves it, a list as pymavlink does

PLACES = st.tuples(st.integers(1, 3_000), st.integers(1, 3_000)).map(
    lambda of_1e5: (round(47.0 + of_1e5[0] * 1e-5, 5), round(8.0 + of_1e5[1] * 1e-5, 5))
)
ENDS = {17: "hold", 20: "return", 21: "land"}
LAST, NO_PARAMETERS = (47.02, 8.01), (0.0,) * 4
Row = tuple[int, int, tuple[float, ...], float, float, float]
"""Frame, command, parameters 1 to 4 and place of an item."""


def saved(txt: Path, *rows: Row) -> None:
    """The list as MAVProxy saves it."""
    loader = mavwp.MAVWPLoader()
    for number, (frame, command, parameters, *place) in enumerate(rows):
        head = 1, 1, number, frame, command, number == 0, 1
        loader.add(wire.MAVLink_mission_item_message(*head, *parameters, *place))
    loader.save(str(txt))


def shapes(zones: list[Any]) -> list[Any]:
    """Zones without their names."""
    return [{key: value for key, value in zone.items() if key != "name"} for zone in zones]


@given(
    waypoints=st.lists(
        st.tuples(PLACES, st.integers(-300, 900), st.sampled_from((0, 3))), min_size=1, max_size=4
    ),
    end=st.sampled_from(sorted(ENDS)),
    circles=st.lists(st.tuples(st.booleans(), PLACES, st.integers(1, 9000)), max_size=3),
    polygons=st.lists(
        st.tuples(st.booleans(), st.lists(PLACES, min_size=3, max_size=5)), max_size=4
    ),
    rally=st.lists(PLACES, max_size=2),
    launch=st.sampled_from((16, 0, 20, 177)),
)
def test_plans_and_lists_say_what_they_were_made_of(
    folder: Path, waypoints: Any, end: int, circles: Any, polygons: Any, rally: Any, launch: int
) -> None:
    """Line 0 of a list is launch whatever its command, as ArduPilot takes it."""
    rows: list[Row] = [(f, 16, NO_PARAMETERS, *place, up_m) for place, up_m, f in waypoints]
    rows.append((3, end, NO_PARAMETERS, *LAST, 50.0))
    content = plan(*(item(c, *p, *place, frame=f) for f, c, p, *place in rows))
    content["geoFence"]["circles"] = [
        {"inclusion": inside, "circle": {"center": place, "radius": radius_m}}
        for inside, place, radius_m in circles
    ]
    content["geoFence"]["polygons"] = [
        {"inclusion": inside, "polygon": ring} for inside, ring in polygons
    ]
    content["rallyPoints"]["points"] = [[*place, 40.0] for place in rally]
    rows.insert(0, (0, launch, NO_PARAMETERS, 47.0, 8.0, 400.0))
    for inside, place, radius_m in circles:
        rows.append((0, 5003 if inside else 5004, (radius_m, 0, 0, 0), *place, 0.0))
    for inside, ring in polygons:
        command, size = 5001 if inside else 5002, (len(ring), 0, 0, 0)
        rows += [(0, command, size, *place, 0.0) for place in ring]
    rows += [(3, 5100, NO_PARAMETERS, *place, 40.0) for place in rally]
    saved(folder / "survey.txt", *rows)
    targets = [place for place, _, _ in waypoints] + [LAST] * (end != 20)
    zones: dict[bool, list[Any]] = {True: [], False: []}
    for inside, (latitude, longitude), radius_m in circles:
        place = {"latitude_deg": latitude, "longitude_deg": longitude}
        zones[inside].append({**place, "radius_m": radius_m})
    for inside, ring in polygons:
        zones[inside].append({"vertices_deg": [*map(list, ring)]})
    (folder / "x.plan").write_text(json.dumps(content), encoding="utf-8")
    as_plan = read_plan(folder / "x.plan", "mission.toml: plan")
    for found in (as_plan, read_waypoint_list(folder / "survey.txt", "plan")):
        assert [tuple(shapes([each])[0].values())[:2] for each in found.targets] == targets
        planned_m = [up_m + (400.0 if frame == 3 else 0.0) for _, up_m, frame in waypoints]
        assert found.altitudes_amsl_m == planned_m + [450.0] * (end == 17)
        assert (found.home_deg, found.home_amsl_m) == ((47.0, 8.0), 400.0)
        assert found.end_action == ENDS[end]
        assert (shapes(found.keep_ins), shapes(found.keep_outs)) == (zones[True], zones[False])
        assert [tuple(point.values()) for point in found.rally_points] == rally
        assert [note for note in found.notes if "inclusion" not in note] == []
    fence = read_waypoint_fence(folder / "survey.txt", "threats")
    assert (shapes(fence.keep_ins), shapes(fence.keep_outs)) == (zones[True], zones[False])


def test_how_a_list_is_written_does_not_matter(folder: Path) -> None:
    """A parameter that is no number is not given."""
    txt = folder / "survey.txt"
    saved(txt, *((3, 16, NO_PARAMETERS, *LAST, 30.0 * number) for number in range(5)))
    plain = read_waypoint_list(txt, "MISSION")
    rows = [line.split("\t") for line in txt.read_text().splitlines()]
    for words, spelled in zip(rows[1:], ("0", "nan", "NaN", "-nan", "NAN"), strict=True):
        words[4:8] = [spelled] * 4
    dressed = "\r\n\r\n# a comment\r\n".join(map("\t".join, rows))
    txt.write_text(f"\ufeff{dressed}", encoding="utf-8")
    assert read_waypoint_list(txt, "MISSION") == plain


def test_as_threats_a_list_is_no_mission_and_need_not_be_one_that_can_be_flown(
    folder: Path,
) -> None:
    corners = ((47.01, 8.01), (47.02, 8.01), (47.02, 8.02))
    rows: list[Row] = [(0, 5002, (3, 0, 0, 0), *place, 0.0) for place in corners]
    txt = folder / "survey.txt"
    saved(txt, *rows)
    assert len(mission(folder, "mission", 'threats = "survey.txt"').task.zones) == 1
    saved(txt, *rows, (2, 177, (1, 2, 0, 0), 0.0, 0.0, 0.0), (7, 16, NO_PARAMETERS, *LAST, 1.0))
    found = mission(folder, "mission", 'threats = "survey.txt"')
    assert len(found.task.zones) == 1
    assert found.notes == ("survey.txt: 2 items of its mission are not flown",)


# --- a plan by itself is a mission


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_alone_is_a_mission(name: str, tmp_path: Path) -> None:
    """The run folder gets all of it."""
    mission = load_mission(str(MISSIONS / name))
    assert mission.name == name.removesuffix(".plan")
    text, alone = read_mission(str(MISSIONS / name)).text, tmp_path / "mission.toml"
    alone.write_text(text, encoding="utf-8")
    again, fields = load_mission(str(alone)), {*Mission.__slots__} - {"notes"}
    assert all(getattr(again, each) == getattr(mission, each) for each in fields)
    assert read_mission(str(alone)).text == text


def test_a_plan_may_be_of_zones_alone_beside_targets_of_the_mission(tmp_path: Path) -> None:
    """What a mission says beside its plan: `test_mission_file`."""
    zones = FENCED | {"mission": FENCED["mission"] | {"items": []}}
    own = "[[targets]]\nnorth_m = 1000.0\neast_m = 300.0\n"
    assert naming(tmp_path, zones, own).targets_ne_m == ((1000.0, 300.0),)


# --- without a terrain radar: flown at the plan's altitudes where they are safe, else it is said

LAUNCH_M = 400.0
KEPT_M = 1.1 * 10.0  # of the errors of the copter that is assumed: tracking and navigation
BLIND = "[vehicle]\nscanner = false\n"


def blind(
    folder: Path, *above_launch_m: float | None, ground_m: float = LAUNCH_M, more: str = ""
) -> Mission:
    """To waypoints 300 m apart, over ground that is stated."""
    items = [waypoint(0.0027 * k, height_m) for k, height_m in enumerate(above_launch_m, 1)]
    return naming(folder, plan(*items), f"{BLIND}[terrain]\nhighest_amsl_m = {ground_m}\n{more}")


def lowest_m(mission: Mission, target: int) -> float:
    """The lowest that a path to a target may lie, and so where it does."""
    return mission.task_to(target, mission.task).band_amsl_m[0]


@given(
    heights_m=st.lists(st.integers(-20, 120), min_size=1, max_size=4),
    ground_m=st.integers(0, 40),
    asked_m=st.none() | st.integers(5, 60),
)
def test_each_waypoint_is_flown_to_at_its_own_altitude_or_higher_where_that_is_unsafe(
    folder: Path, heights_m: list[int], ground_m: int, asked_m: int | None
) -> None:
    """The distance that is kept is what the plan leaves, if none is asked for; both are said."""
    more = "" if asked_m is None else f"[planner]\nsafety_distance_m = {asked_m}.0\n"
    found = blind(folder, *heights_m, ground_m=LAUNCH_M + ground_m, more=more)
    left_m = min(max(min(heights_m) - ground_m - KEPT_M, 10.0), 30.0)
    kept_m = left_m if asked_m is None else asked_m
    assert found.task.settings.safety_distance_m == kept_m
    assert asked_m or any(f"d_s = {kept_m:g} m" in note for note in found.notes)
    safe_m = LAUNCH_M + ground_m + kept_m + KEPT_M
    for target, height_m in enumerate(heights_m):
        planned_m = LAUNCH_M + height_m
        assert lowest_m(found, target) == pytest.approx(max(planned_m, safe_m), abs=0.2)
        notes = [note for note in found.notes if note.startswith(f"items[{target}] is planned")]
        if abs(safe_m - planned_m - 1.0) > 0.3:  # a metre is worth no mention
            assert len(notes) == (planned_m < safe_m - 1.0)
        for note in notes:
            assert f"planned at {planned_m:g} m AMSL and flown at {safe_m:.0f} m" in note


def test_a_waypoint_without_an_altitude_has_that_of_the_one_before(tmp_path: Path) -> None:
    """The climb ends at the lowest, and a fence below a target's own leaves room to plan."""
    found = blind(tmp_path, 60.0, None, 40.0)
    assert [round(lowest_m(found, target) - LAUNCH_M) for target in range(3)] == [60, 60, 40]
    assert any("1 x waypoint without an altitude" in note for note in found.notes)
    assert found.task.take_off_amsl_m == pytest.approx(LAUNCH_M + 40.0, abs=0.2)
    fence = replace(found.task.limits, ceiling_amsl_m=LAUNCH_M + 55.0)
    low_m, high_m = found.task_to(1, replace(found.task, limits=fence)).band_amsl_m
    assert low_m < high_m <= LAUNCH_M + 55.0


def of_terrain(height_m: float, frame: int, mode: int | None = None, rows: int = 8) -> Any:
    """As frame 10 or 11, or as QGroundControl's AltitudeMode with the height in a key of its own.

    So many rows of `HEIGHTS_M` north of launch.
    """
    if mode is None:
        return waypoint(rows * STEP_DEG, height_m, frame)
    sent_m = None if mode == 3 else height_m  # 3: sent as AMSL
    return waypoint(rows * STEP_DEG, sent_m, frame, AltitudeMode=mode, Altitude=height_m)


def by_each_frame(folder: Path, text: str, rows: int = 8) -> Mission:
    """Above launch, AMSL, as the plan knows the ground, and by four ways 500 m above terrain."""
    knows = waypoint(altitude_m=30.0, frame=10, AMSLAltAboveTerrain=970.0)
    ways = ((10, None), (11, None), (0, 3), (10, 4))
    lands = item(21, 0, 0, 0, None, None, None, None)  # where it is: no place to go to
    items = waypoint(altitude_m=600.0), waypoint(altitude_m=960.0, frame=0), knows
    above_terrain = (of_terrain(500.0, *way, rows) for way in ways)
    return naming(folder, plan(*items, *above_terrain, lands), text)


STATED = f"{BLIND}[terrain]\nhighest_amsl_m = 417.0\n"
OF_FILE = f'{BLIND}[terrain]\nfile = "dem.tif"\nvertical_datum = "EGM96"\n'


def test_the_altitude_of_a_waypoint_is_known_by_its_frame(folder: Path) -> None:
    """Above terrain it is above the highest ground about it, as that is stated or a file has it."""
    stated = by_each_frame(folder, STATED)
    assert stated.altitudes_amsl_m == (1000.0, 960.0, 970.0, *(917.0,) * 4)
    assert stated.end_action is EndAction.LAND
    *_, one, other, a_third, last = by_each_frame(folder, OF_FILE).altitudes_amsl_m
    assert one == other == a_third == last
    assert last - 500.0 in HEIGHTS_M[90:93, 118:121]
    assert last - 500.0 >= HEIGHTS_M[91:93, 119:121].max()


def test_above_ground_that_is_not_known_an_altitude_is_refused_or_that_is_said(
    folder: Path,
) -> None:
    """Without a radar it would be flown; with one every altitude of the band is as good."""
    for text, rows in ((BLIND, 8), (OF_FILE, 120)):
        told = refusal(by_each_frame, folder, text, rows)
        assert told.startswith("x.plan: mission.items[3]: altitude = 500.0: it is above terrain")
    found = by_each_frame(folder, "")
    assert found.altitudes_amsl_m == ()
    assert found.task_to(1, found.task) is found.task
    assert any("4 x altitude above terrain" in note for note in found.notes)
