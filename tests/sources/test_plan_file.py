"""Plans and lists of waypoints: what they say, what is assumed, and what is refused."""

import contextlib
import copy
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
from geotiff import write_elevation
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavwp
from pymavlink.dialects.v20 import all as mavlink
from spoiled import JUNK, refusal, replace_somewhere

import companion
from companion.config import load_mission, mission_text
from companion.errors import InputError
from companion.mission.mission import EndAction, Mission
from companion.sources.plan_file import Plan, read_plan, read_waypoint_fence, read_waypoint_list

MISSIONS = Path(__file__).parent / "missions"
PLANS = sorted(path.name for path in MISSIONS.glob("*.plan"))
FENCED = json.loads((MISSIONS / "fenced.plan").read_text(encoding="utf-8"))
GEOD = pyproj.Geod(ellps="WGS84")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("plan") / "x.plan"


@pytest.fixture(scope="module")
def txt(path: Path) -> Path:
    return path.with_name("survey.txt")


def read(path: Path, content: Any) -> Plan:
    path.write_text(json.dumps(content), encoding="utf-8")
    return read_plan(path, "mission.toml: plan")


def item(command: int, *params: float | None, frame: int = 3, **more: Any) -> dict[str, Any]:
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": params, **more}


def waypoint(
    north: float = 0.01, altitude: float | None = 50.0, frame: int = 3, **more: Any
) -> Any:
    return item(16, 0, 0, 0, None, 47.4 + north, 8.55, altitude, frame=frame, **more)


def plan(*items: Any, **mission: Any) -> dict[str, Any]:
    content = copy.deepcopy(FENCED)
    content["mission"] |= {"items": list(items), "plannedHomePosition": [47.4, 8.55, 400]} | mission
    content["geoFence"] = {"circles": [], "polygons": [], "version": 2}
    return content


def naming(folder: Path, plan: Any, text: str) -> Mission:
    """The mission of a mission.toml that names a plan."""
    (folder / "x.plan").write_text(json.dumps(plan), encoding="utf-8")
    (folder / "mission.toml").write_text(f'plan = "x.plan"\n{text}', encoding="utf-8")
    return load_mission(str(folder / "mission.toml"))


def test_waypoints_fences_rally_points_and_the_end_are_those_of_the_file(path: Path) -> None:
    found = read(path, FENCED)
    places = [
        each["params"][4:6] for each in FENCED["mission"]["items"] if each["command"] in (16, 82)
    ]
    assert [[t["latitude_deg"], t["longitude_deg"]] for t in found.targets] == places
    assert found.end_action == "return"
    assert found.speed_m_s == {"copter": 5.0, "plane": 15.0}
    assert found.kind == "copter"
    fence = FENCED["geoFence"]
    assert [zone["vertices_deg"] for zone in found.keep_ins] == [fence["polygons"][0]["polygon"]]
    assert found.keep_outs[0]["radius_m"] == fence["circles"][0]["circle"]["radius"]
    assert found.keep_outs[1]["vertices_deg"] == fence["polygons"][1]["polygon"]
    rally = FENCED["rallyPoints"]["points"][0]
    assert found.rally_points == [{"latitude_deg": rally[0], "longitude_deg": rally[1]}]


def test_the_altitude_of_a_waypoint_is_known_by_its_frame(path: Path) -> None:
    found = read(
        path,
        plan(
            waypoint(altitude=50.0, frame=3),
            waypoint(altitude=460.0, frame=0),
            waypoint(altitude=30.0, frame=10, AMSLAltAboveTerrain=470.0),
            waypoint(altitude=30.0, frame=10, AMSLAltAboveTerrain=None),
            waypoint(0.03, altitude=80.0),
        ),
    )
    assert found.altitudes_amsl_m == [450.0, 460.0, 470.0, 480.0]
    assert [target["latitude_deg"] for target in found.targets] == [47.41] * 4 + [47.43]


@pytest.mark.parametrize(
    ("last", "action", "targets"),
    [
        (item(20, 0, 0, 0, 0, 0, 0, 0, frame=2), "return", 1),
        (item(21, 0, 0, 0, None, 0, 0, 0), "land", 1),
        (item(21, 0, 0, 0, None, None, None, None), "land", 1),
        (item(21, 0, 0, 0, None, 47.42, 8.55, 0), "land", 2),
        (item(17, 0, 0, 0, None, 47.42, 8.55, 50), "hold", 2),
    ],
)
def test_the_last_item_is_the_end(path: Path, last: Any, action: str, targets: int) -> None:
    found = read(path, plan(waypoint(), last))
    assert (found.end_action, len(found.targets)) == (action, targets)
    if targets == 2:
        assert "ends before this item" in refusal(read, path, plan(last, waypoint()))


MOVES_HOME = item(179, 1, 0, 0, 0, 0, 0, 0)
HOME, NONE = "mission.plannedHomePosition", "launch has no latitude and longitude"
REFUSED: list[tuple[Any, str]] = [
    ({"fileType": "Mission"}, "no QGroundControl plan"),
    ({"fileType": "Plan"}, "x.plan: mission = None: it is missing"),
    (plan(waypoint(), vehicleType=21), "it is for vtol"),
    (plan(waypoint(), items=7), "x.plan: mission.items = 7"),
    # launch
    (plan(waypoint(), plannedHomePosition=[97.4, 8.5, 400]), HOME),
    (
        plan(waypoint(), plannedHomePosition=[47.4, 8.55, None]),
        f"{HOME}.*altitude of launch is missing.*QGroundControl",
    ),
    *(
        (plan(waypoint(), plannedHomePosition=home), f"{HOME}.*{NONE}")
        for home in ([0.0, 0.0, 250.0], [None, None, None])
    ),
    # above a home that the mission moves
    (plan(waypoint(), MOVES_HOME, waypoint(0.02)), r"^x\.plan: mission\.items\[2\].*do set home"),
    # versions that are not known
    (FENCED | {"version": 2}, "version = 2"),
    *(
        (FENCED | {part: FENCED[part] | {"version": 3}}, rf"{part}\.version = 3")
        for part in ("mission", "geoFence", "rallyPoints")
    ),
    # an item that cannot be flown is named
    *(
        (plan(waypoint(), bad), rf"^x\.plan: mission\.items\[1\].*{words}")
        for bad, words in (
            (item(177, 1, 3, 0, 0, 0, 0, 0, frame=2), "do jump cannot be flown"),
            (item(84, 0, 0, 0, None, 47.4, 8.5, 30), "vtol takeoff"),
            (item(16, 0, 0, 0, None, 0, 0, 50), "no latitude and longitude"),
            (item(16), "no latitude and longitude"),
            (item(16, 0, 0, 0, None, 97.4, 8.5, 50), "out of range"),
            (waypoint(frame=7), "what its altitude is above is not known"),
            ({"type": "SimpleItem"}, "command.*missing"),
            ({"type": "ComplexItem", "complexItemType": "StructureScan"}, "holds no waypoints"),
        )
    ),
]


@pytest.mark.parametrize(("bad", "words"), REFUSED, ids=range(len(REFUSED)))
def test_what_cannot_be_taken_is_told_why(path: Path, bad: Any, words: str) -> None:
    told = refusal(read, path, bad)
    assert re.search(words, told), told


ASSUMED = "What a plan lacks is assumed"


@pytest.mark.parametrize(
    ("place", "mission", "words"),
    [
        ((50.4, 11.5), {}, r"^x\.plan: items\[1\] = \[50.4, .* it lies 39\d\.?\d* km from launch"),
        ((-47.4, -171.45), {}, r"^x\.plan: items\[1\] = \[-47.4, .* 20,00\d km from launch"),
        ((47.41, 8.55), {"hoverSpeed": 90, "vehicleType": 2}, ASSUMED),
        ((86.01, 8.55), {"plannedHomePosition": [86.0, 8.55, 400]}, ASSUMED),
        ((47.41, 8.55), {"plannedHomePosition": [47.4, 8.55, 60_000]}, ASSUMED),
    ],
)
def test_what_a_mission_cannot_be_of_is_told_in_the_words_of_the_plan(
    path: Path, place: tuple[float, float], mission: dict[str, Any], words: str
) -> None:
    """A far waypoint, a speed, a launch: of those who wrote the plan and no mission file."""
    items = [waypoint(), item(16, 0, 0, 0, None, *place, 50)][0 if not mission else 1 :]
    path.write_text(json.dumps(plan(*items, **mission)), encoding="utf-8")
    told = refusal(lambda path, _: load_mission(str(path)), path, None)
    assert re.search(words, told), told


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_alone_is_a_mission_that_says_what_it_assumed(name: str, tmp_path: Path) -> None:
    """Its targets lie as far from launch as on the ellipsoid; the run folder gets all of it."""
    mission, content = load_mission(str(MISSIONS / name)), read_plan(MISSIONS / name, "MISSION")
    assert mission.name == name.removesuffix(".plan")
    said = " ".join(mission.notes)
    assert all(words in said for words in ("m/s", "AMSL", "terrain radar", "d_s = ", "map assumed"))
    latitude, longitude = content.home_deg
    for place, target in zip(mission.targets_ne_m, content.targets, strict=True):
        azimuth_deg, _, distance_m = GEOD.inv(
            longitude, latitude, target["longitude_deg"], target["latitude_deg"]
        )
        assert math.hypot(*place) == pytest.approx(distance_m, abs=1e-3)
        east_of_north = math.atan2(place[1], place[0])
        assert math.cos(east_of_north - math.radians(azimuth_deg)) > 1.0 - 1e-9
    text, alone = mission_text(str(MISSIONS / name)), tmp_path / "mission.toml"
    alone.write_text(text, encoding="utf-8")
    again = load_mission(str(alone))
    assert all(
        getattr(again, each) == getattr(mission, each)
        for each in Mission.__slots__
        if each != "notes"
    )
    assert mission_text(str(alone)) == text


@pytest.mark.parametrize(
    ("vehicle_type", "turns_m", "angles_deg", "others"),
    [
        (2, (20.0, 0.0), (16.6, 16.6), (5.0, 1.5, 5.0, 2000.0, 30.0)),
        (1, (115.0, 100.0), (7.0, 6.8), (15.0, 2.5, 15.0, 3000.0, 50.0)),
    ],
)
def test_what_a_plan_lacks_is_assumed_as_the_page_of_files_says(
    path: Path, vehicle_type: int, turns_m: Any, angles_deg: Any, others: Any
) -> None:
    content = plan(waypoint(), vehicleType=vehicle_type, hoverSpeed=None, cruiseSpeed=None)
    path.write_text(json.dumps(content), encoding="utf-8")
    task = load_mission(str(path)).task
    limits, settings = task.limits, task.settings
    assert (limits.turn_radius_m, limits.loiter_radius_m) == turns_m
    angles = limits.climb_angle_rad, limits.dive_angle_rad
    assert tuple(map(math.degrees, angles)) == pytest.approx(angles_deg)
    assert others == (
        *(limits.speed_m_s, limits.climb_rate_m_s, limits.tracking_error_m),
        *(settings.scan_range_m, settings.safety_distance_m),
    )


OWN = """
name = "mine"
altitude = { floor_amsl_m = 600.0, ceiling_amsl_m = 700.0 }
vehicle = { speed_m_s = 8.0 }
planner = { safety_distance_m = 20.0 }
end = { action = "land" }
keep_outs = [{ name = "own", north_m = -1000.0, east_m = 0.0, radius_m = 50.0 }]
"""


def test_a_mission_overrides_what_is_assumed_of_its_plan(tmp_path: Path) -> None:
    mission, alone = naming(tmp_path, FENCED, OWN), load_mission(str(MISSIONS / "fenced.plan"))
    limits, settings = mission.task.limits, mission.task.settings
    assert (mission.name, mission.end_action) == ("mine", EndAction.LAND)
    assert (limits.floor_amsl_m, limits.speed_m_s) == (600.0, 8.0)
    assert limits.turn_radius_m > alone.task.limits.turn_radius_m
    assert settings.safety_distance_m == 20.0
    assert mission.targets_ne_m == alone.targets_ne_m
    names = {zone.name for zone in mission.task.zones}
    assert names == {"own", *(zone.name for zone in alone.task.zones)}
    assert not any("altitude" in note or "speed of the plan" in note for note in mission.notes)


def test_targets_are_those_of_the_mission_or_of_its_plan(tmp_path: Path) -> None:
    own = "[[targets]]\nnorth_m = 1000.0\neast_m = 300.0\n"
    with pytest.raises(InputError, match=r"x\.plan has waypoints too"):
        naming(tmp_path, FENCED, own)
    fences = FENCED | {"mission": FENCED["mission"] | {"items": []}}
    assert naming(tmp_path, fences, own).targets_ne_m == ((1000.0, 300.0),)
    assert naming(tmp_path, fences, "from_vehicle.targets = true\n").targets_from_vehicle
    with pytest.raises(InputError, match="it has no waypoints"):
        load_mission(str(tmp_path / "x.plan"))


@given(data=st.data())
def test_any_value_anywhere_is_taken_or_an_input_error(path: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(PLANS))
    content = json.loads((MISSIONS / name).read_text(encoding="utf-8"))
    for _ in range(data.draw(st.integers(1, 3))):
        replace_somewhere(content, data)
    path.write_text(json.dumps(content), encoding="utf-8")
    with contextlib.suppress(InputError):
        load_mission(str(path))


def test_what_is_not_done_at_a_waypoint_is_counted(path: Path) -> None:
    found = read(
        path,
        plan(
            *(item(22, 0, 0, 0, None, 47.4, 8.55, 30), item(16, 15, 0, 0, None, 47.41, 8.55, 50)),
            *(item(16, 5, 0, 0, 90, 47.42, 8.55, 50), item(16, 0, 0, -20, None, 47.43, 8.55, 50)),
            *(item(22, 0, 0, 0, None, 47.4, 8.55, 30), item(19, 60, 0, 30, None, 47.44, 8.55, 50)),
            *(item(201, 0, 0, 0, 0, 47.4, 8.55, 0), MOVES_HOME),
            waypoint(0.05, altitude=450.0, frame=0),
        ),
    )
    [said] = found.notes
    not_done = (
        "2 x waiting at a waypoint, 1 x heading at a waypoint, 1 x passing beside a waypoint, "
        "1 x nav takeoff, 1 x loiter at a waypoint, 1 x do set roi, 1 x do set home"
    )
    assert all(words in said for words in not_done.split(", "))
    assert read(path, plan(waypoint())).notes == []
    survey = read_plan(MISSIONS / "survey.plan", "MISSION")
    assert (len(survey.targets), survey.end_action) == (6 + 1, "land")  # and where it lands
    assert survey.notes == ["left out: 6 x do set cam trigg dist"]


# --- lists, against pymavlink's own reader and writer of them

WAYPOINT, TAKE_OFF, RETURN = 16, 22, 20
FIRST = (0, 16, (0, 0, 0, 0), 47.4, 8.55, 400.0)
Row = tuple[int, int, tuple[float, ...], float, float, float]


def saved(txt: Path, *rows: Row) -> Path:
    """The list as MAVProxy saves it."""
    loader = mavwp.MAVWPLoader()
    for number, (frame, command, parameters, latitude, longitude, altitude) in enumerate(rows):
        loader.add(
            mavlink.MAVLink_mission_item_message(
                1, 1, number, frame, command, number == 0, 1, *parameters,
                latitude, longitude, altitude,
            )
        )  # fmt: skip
    loader.save(str(txt))
    return txt


def of_text(txt: Path, text: str) -> Plan:
    txt.write_text(text, encoding="utf-8")
    return read_waypoint_list(txt, "MISSION")


def to(north: float, altitude_m: float = 50.0, frame: int = 3) -> Row:
    return (frame, WAYPOINT, (0, 0, 0, 0), 47.4 + north, 8.55, altitude_m)


@pytest.mark.parametrize("command", [WAYPOINT, 0, RETURN, 177])
def test_a_list_is_qgroundcontrols_plan(txt: Path, path: Path, command: int) -> None:
    """Line 0 is launch whatever its command, as ArduPilot takes it."""
    rows = [
        (3, TAKE_OFF, (0, 0, 0, 0), 47.4, 8.55, 30.0),
        to(0.01, 45.0),
        to(0.02, 480.0, frame=0),
        (3, 178, (1, 7, -1, 0), 0.0, 0.0, 0.0),
        (2, RETURN, (0, 0, 0, 0), 0.0, 0.0, 0.0),
    ]
    found = read_waypoint_list(saved(txt, (0, command, *FIRST[2:]), *rows), "MISSION")
    expected = read(path, plan(*(item(c, *p, *place, frame=f) for f, c, p, *place in rows)))
    assert [target.pop("name") for target in found.targets] == ["item 2", "item 3"]
    for target in expected.targets:
        target.pop("name")
    for what in ["targets", "altitudes_amsl_m", "home_deg", "home_amsl_m", "end_action", "notes"]:
        assert getattr(found, what) == getattr(expected, what)
    assert found.altitudes_amsl_m == [430.0, 445.0, 480.0]
    theirs = mavwp.MAVWPLoader()
    theirs.load(str(txt))
    places = [(t["latitude_deg"], t["longitude_deg"]) for t in found.targets]
    assert [(w.x, w.y) for w in theirs.wpoints[2:4]] == places


LIST, LAUNCH = "QGC WPL 110\n", "0 1 0 16 0 0 0 0 47 8 9 1\n"
NO_LISTS = [
    (f"{LIST}0 1 0 16 0 0 0 0 0 0 0 1\n", "Set home before you save it"),
    ("QGC WPL 120\n", "only QGC WPL 110 is known"),
    (f"{LIST}0 1 0\n", "line 2 = '0 1 0': invalid waypoint line with 3 values"),
    (f"{LIST}\n0 1 0 16 0 0 0 0 x 8 9 1\n", "line 3 = '0 1 0 16 0 0 0 0 x 8 9 1'"),
    (f"{LIST}0 1 0 16 0 inf 0 0 47 8 9 1\n", "item 0: params[1] = inf: it must be a finite number"),
    (f"{LIST}0 1 0 16 0 0 0 0 nan 8 9 1\n", "launch has no latitude and longitude"),
    (f"{LIST}0 1 0 16 0 0 0 0 47 8 nan 1\n", "the altitude of launch is missing"),
    (f"{LIST}0 1 0 16.5 0 0 0 0 47 8 9 1\n", "invalid literal for int()"),
    (f"{LIST}0 1 0 16 0 0 0 0 147 8 9 1\n", "survey.txt: item 0"),
    (
        f"{LIST}{LAUNCH}1 0 3 177 1 2 0 0 0 0 0 1\n",
        "survey.txt: item 1.command = 177: do jump cannot be flown",
    ),
    *(
        (LIST + LAUNCH + "1 0 0 5002 3 0 0 0 47.4 8.5 0 1\n" * n, f"has {n} of 3 corners")
        for n in (1, 2)
    ),
]


@pytest.mark.parametrize(("text", "expected"), NO_LISTS)
def test_what_is_wrong_with_a_list_is_told(txt: Path, text: str, expected: str) -> None:
    assert expected in refusal(of_text, txt, text)


@given(st.data())
def test_a_spoiled_list_is_read_or_an_input_error(txt: Path, data: st.DataObject) -> None:
    corner = (0, 5001, (3, 0, 0, 0), 47.5, 8.5, 0.0)
    lines = saved(txt, FIRST, to(0.01), corner, corner, corner).read_text().splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        line = data.draw(st.integers(0, len(lines) - 1))
        words = lines[line].split("\t")
        words[data.draw(st.integers(0, len(words) - 1))] = str(data.draw(JUNK))
        lines[line] = "\t".join(words)
    txt.write_text("\n".join(lines), encoding="utf-8")
    for read in (read_waypoint_list, read_waypoint_fence):
        with contextlib.suppress(InputError):
            read(txt, "MISSION")


@pytest.mark.parametrize("spelled", ["nan", "NaN", "-nan", "NAN"])
def test_how_a_list_is_written_does_not_matter(txt: Path, spelled: str) -> None:
    """A parameter that is no number is not given."""
    text = saved(txt, FIRST, (3, TAKE_OFF, (0, 0, 0, 0), 0, 0, 30.0), to(0.01)).read_text()
    rows = [line.split("\t") for line in text.splitlines()]
    for words in rows[1:]:
        words[4:8] = [spelled] * 4
    dressed = "\r\n\r\n# a comment\r\n".join(map("\t".join, rows))
    assert of_text(txt, f"\ufeff{dressed}") == of_text(txt, text)


def test_fences_and_rally_points_of_a_list_are_zones_whatever_else_is_in_it(txt: Path) -> None:
    """As threats it is no mission: what cannot be flown of it does not matter."""
    square = [(47.4, 8.5), (47.4, 8.6), (47.5, 8.6), (47.5, 8.5)]
    rows: list[Row] = [FIRST, (0, 5000, (0, 0, 0, 0), 47.4, 8.55, 0.0), to(0.01)]
    rows += [(0, 5001, (4, 0, 0, 0), lat, lon, 0.0) for lat, lon in square]
    rows += [(0, 5002, (3, 0, 0, 0), lat, lon, 0.0) for lat, lon in square[:3] + square[1:]]
    rows += [(0, 5003, (9000.0, 0, 0, 0), 47.45, 8.55, 0.0)]
    rows += [(0, 5004, (120.0, 0, 0, 0), 47.41, 8.56, 0.0)]
    rows += [(3, 5100, (0, 0, 0, 0), 47.42, 8.57, 40.0)]
    plan = read_waypoint_list(saved(txt, *rows), "plan")
    assert plan.rally_points == [{"latitude_deg": 47.42, "longitude_deg": 8.57}]
    assert len(plan.targets) == 1
    jump: Row = (2, 177, (1, 2, 0, 0), 0.0, 0.0, 0.0)
    found = read_waypoint_fence(saved(txt, *rows, jump, to(0.02, frame=7)), "threats")
    assert (found.keep_ins, found.keep_outs) == (plan.keep_ins, plan.keep_outs)
    assert found.notes == ["survey.txt: 3 items of its mission are not flown"]
    assert found.keep_ins[0]["vertices_deg"] == [list(corner) for corner in square]
    assert [zone.get("vertices_deg") for zone in found.keep_outs] == [
        [list(corner) for corner in square[:3]],
        [list(corner) for corner in square[1:]],
        None,
    ]
    assert found.keep_ins[1]["radius_m"] == 9000.0
    circle = {"name": "fence circle 5", "latitude_deg": 47.41, "longitude_deg": 8.56}
    assert found.keep_outs[2] == circle | {"radius_m": 120.0}


def test_a_mission_keeps_out_of_what_its_fence_list_says(txt: Path) -> None:
    mission, text = load_mission("valley"), mission_text("valley")
    lat, lon = mission.frame.latitude_deg, mission.frame.longitude_deg
    places = [(lat + 0.001 * n, lon + 0.002 * (n % 2)) for n in range(3)]
    saved(txt, *((0, 5002, (3, 0, 0, 0), *place, 0.0) for place in places))
    flown = txt.with_name("mission.toml")
    flown.write_text(f'threats = "{txt.name}"\n{text}', encoding="utf-8")
    assert len(load_mission(str(flown)).task.zones) == len(mission.task.zones) + 1


# --- without a terrain radar: flown at the plan's altitudes where they are safe, else it is said

LAUNCH_M = 400.0
KEPT_M = 1.1 * 10.0  # of the errors of the copter that is assumed: tracking and navigation
BLIND = "[vehicle]\nscanner = false\n"
VALLEY = Path(companion.__file__).parent / "environments" / "valley"
VALLEY_TEXT = (VALLEY / "mission.toml").read_text(encoding="utf-8")


def blind(
    folder: Path, *above_launch_m: float | None, ground_m: float = LAUNCH_M, more: str = ""
) -> Mission:
    """To waypoints 300 m apart, over ground that is stated."""
    items = [waypoint(0.0027 * k, height_m) for k, height_m in enumerate(above_launch_m, 1)]
    return naming(folder, plan(*items), f"{BLIND}[terrain]\nhighest_amsl_m = {ground_m}\n{more}")


def lowest_m(mission: Mission, target: int) -> float:
    """The lowest that a path to a target may lie, and so where it does."""
    return mission.task_to(target, mission.task).band_amsl_m[0]


def test_each_waypoint_is_flown_to_at_its_own_altitude(tmp_path: Path) -> None:
    """One without has that of the one before, which is said; the climb ends at the lowest."""
    mission = blind(tmp_path, 40.0, 60.0, None, 45.0)
    for target, height_m in enumerate((40.0, 60.0, 60.0, 45.0)):
        assert lowest_m(mission, target) == pytest.approx(LAUNCH_M + height_m, abs=0.2)
    assert mission.task.take_off_amsl_m == pytest.approx(LAUNCH_M + 40.0, abs=0.2)
    assert not any("flown at" in note for note in mission.notes)
    assert any("1 x waypoint without an altitude" in note for note in mission.notes)


@pytest.mark.parametrize(
    ("above_m", "ground_m", "distance_m"),
    [(40.0, 0.0, 29.0), (90.0, 0.0, 30.0), (40.0, 15.0, 14.0)],
)
def test_the_distance_that_is_assumed_is_what_the_plan_leaves(
    tmp_path: Path, above_m: float, ground_m: float, distance_m: float
) -> None:
    mission = blind(tmp_path, above_m, ground_m=LAUNCH_M + ground_m)
    assert mission.task.settings.safety_distance_m == distance_m
    assert any(f"d_s = {distance_m:g} m" in note for note in mission.notes)


@pytest.mark.parametrize(
    ("planned_m", "kept_m", "more", "said"),
    [
        (12.0, 10.0, "", "items[0] is planned at 412 m AMSL and flown at 421 m"),
        (40.0, 50.0, "[planner]\nsafety_distance_m = 50.0\n", "flown at 461 m"),
    ],
)
def test_a_waypoint_that_is_too_low_is_flown_higher_and_that_is_said(
    tmp_path: Path, planned_m: float, kept_m: float, more: str, said: str
) -> None:
    mission = blind(tmp_path, planned_m, 80.0, more=more)
    assert lowest_m(mission, 0) == pytest.approx(LAUNCH_M + kept_m + KEPT_M, abs=0.2)
    [note] = [note for note in mission.notes if "flown at" in note]
    assert said in note


def test_a_fence_below_a_targets_altitude_leaves_room_to_plan(tmp_path: Path) -> None:
    mission = blind(tmp_path, 40.0, 80.0)
    lowered = replace(mission.task.limits, ceiling_amsl_m=LAUNCH_M + 75.0)
    low_m, high_m = mission.task_to(1, replace(mission.task, limits=lowered)).band_amsl_m
    assert low_m < high_m <= LAUNCH_M + 75.0


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
    band = "[altitude]\nfloor_amsl_m = 440.0\nceiling_amsl_m = 520.0\n"
    with pytest.raises(InputError, match=r"altitude\.floor_amsl_m"):
        blind(tmp_path, 40.0, ground_m=LAUNCH_M + 80.0, more=band)


def of_terrain(
    height_m: float, mode: int | None = None, frame: int = 10, north: float = 0.0054
) -> Any:
    """As frame 10, or as QGroundControl's AltitudeMode with the height in a key of its own."""
    if mode is None:
        return waypoint(north, height_m, frame)
    sent_m, frame = (None, 0) if mode == 3 else (height_m, frame)  # 3: sent as AMSL
    return waypoint(north, sent_m, frame, AltitudeMode=mode, Altitude=height_m)


@pytest.mark.parametrize("said", [{}, {"mode": 3}, {"mode": 4}, {"frame": 11}])
def test_above_terrain_is_above_the_ground_stated(tmp_path: Path, said: dict[str, int]) -> None:
    terrain = f"{BLIND}[terrain]\nhighest_amsl_m = 417.0\n"
    mission = naming(tmp_path, plan(waypoint(0.0027, 100.0), of_terrain(120.0, **said)), terrain)
    assert mission.altitudes_amsl_m == (500.0, 537.0)


def test_above_terrain_is_above_the_ground_of_a_file(tmp_path: Path) -> None:
    """The ground rises by 1 m for each 0.0002 degrees of latitude, so by 27 m to the waypoint."""
    rows, step_deg = 400, 0.0002
    rise_m = np.arange(rows)[::-1, None] + np.zeros((rows, rows)) - 0.04 / step_deg
    corner = 47.4 - 0.04 + (rows - 1) * step_deg, 8.55 - 0.04
    write_elevation(tmp_path / "slope.tif", LAUNCH_M + rise_m, corner, step_deg)
    terrain = f'{BLIND}[terrain]\nfile = "slope.tif"\nvertical_datum = "EGM96"\n'
    mission = naming(tmp_path, plan(waypoint(0.0027, 100.0), of_terrain(120.0)), terrain)
    ground_m = LAUNCH_M + 0.0054 / step_deg
    assert ground_m + 120.0 <= mission.altitudes_amsl_m[1] <= ground_m + 122.0
    with pytest.raises(InputError, match=r"items\[1\].*the ground is there is not known"):
        naming(tmp_path, plan(waypoint(), of_terrain(120.0, north=0.06)), terrain)


def test_an_altitude_above_ground_that_is_not_known_is_refused_or_said(tmp_path: Path) -> None:
    """Without a radar it would be flown; with one every altitude of the band is as good."""
    modes = ((120.0, None), (90.0, 3), (80.0, 4))
    items = [waypoint(altitude=100.0), *(of_terrain(height_m, mode) for height_m, mode in modes)]
    with pytest.raises(InputError, match=r"x\.plan: mission\.items\[1\].* = 120"):
        naming(tmp_path, plan(*items), BLIND)
    mission = naming(tmp_path, plan(*items), "")
    assert mission.altitudes_amsl_m == ()
    assert mission.task_to(1, mission.task) is mission.task
    said = next(note for note in mission.notes if "above terrain" in note)
    assert "3 x altitude above terrain" in said
