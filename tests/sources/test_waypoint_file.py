"""Waypoint and fence lists, against pymavlink's own reader and writer of them."""

import contextlib
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavwp
from pymavlink.dialects.v20 import all as mavlink
from spoiled import JUNK, refusal

from companion.errors import InputError
from companion.sources.plan_file import Plan, read_plan, read_waypoint_fence, read_waypoint_list

WAYPOINT, TAKE_OFF, RETURN = 16, 22, 20
HOME = (0, 16, (0, 0, 0, 0), 47.4, 8.55, 400.0)
Row = tuple[int, int, tuple[float, ...], float, float, float]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("waypoints") / "survey.txt"


def saved(path: Path, *rows: Row) -> Path:
    """The list as MAVProxy saves it."""
    loader = mavwp.MAVWPLoader()
    for number, (frame, command, parameters, latitude, longitude, altitude) in enumerate(rows):
        loader.add(
            mavlink.MAVLink_mission_item_message(
                1, 1, number, frame, command, number == 0, 1, *parameters,
                latitude, longitude, altitude,
            )
        )  # fmt: skip
    loader.save(str(path))
    return path


def of_text(path: Path, text: str) -> Plan:
    path.write_text(text, encoding="utf-8")
    return read_waypoint_list(path, "MISSION")


def waypoint(north: float, altitude_m: float = 50.0, frame: int = 3) -> Row:
    return (frame, WAYPOINT, (0, 0, 0, 0), 47.4 + north, 8.55, altitude_m)


@pytest.mark.parametrize("command", [WAYPOINT, TAKE_OFF, 179, 0, RETURN, 177])
def test_a_list_is_qgroundcontrols_plan(path: Path, tmp_path: Path, command: int) -> None:
    """Line 0 is launch whatever its command, as ArduPilot takes it."""
    rows = [
        (3, TAKE_OFF, (0, 0, 0, 0), 47.4, 8.55, 30.0),
        waypoint(0.01, 45.0),
        waypoint(0.02, 480.0, frame=0),
        (3, 178, (1, 7, -1, 0), 0.0, 0.0, 0.0),
        (2, RETURN, (0, 0, 0, 0), 0.0, 0.0, 0.0),
    ]
    found = read_waypoint_list(saved(path, (0, command, *HOME[2:]), *rows), "MISSION")
    items = [
        {"type": "SimpleItem", "command": c, "frame": f, "params": [*p, lat, lon, alt]}
        for f, c, p, lat, lon, alt in rows
    ]
    mission = {"items": items, "plannedHomePosition": [47.4, 8.55, 400.0], "version": 2}
    same = tmp_path / "same.plan"
    same.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}))
    expected = read_plan(same, "MISSION")
    names = [target.pop("name") for target in found.targets]
    assert names == ["item 2", "item 3"]
    for target in expected.targets:
        target.pop("name")
    for what in ["targets", "altitudes_amsl_m", "home_deg", "home_amsl_m", "end_action", "notes"]:
        assert getattr(found, what) == getattr(expected, what)
    assert found.altitudes_amsl_m == [430.0, 445.0, 480.0]
    theirs = mavwp.MAVWPLoader()
    theirs.load(str(path))
    places = [(t["latitude_deg"], t["longitude_deg"]) for t in found.targets]
    assert [(w.x, w.y) for w in theirs.wpoints[2:4]] == places


LIST, LAUNCH = "QGC WPL 110\n", "0 1 0 16 0 0 0 0 47 8 9 1\n"
REFUSED = [
    (f"{LIST}0 1 0 16 0 0 0 0 0 0 0 1\n", "Set home before you save it"),
    ("QGC WPL 120\n", "only QGC WPL 110 is known"),
    (f"{LIST}0 1 0\n", "line 2 = '0 1 0': invalid waypoint line with 3 values"),
    (f"{LIST}\n0 1 0 16 0 0 0 0 x 8 9 1\n", "line 3 = '0 1 0 16 0 0 0 0 x 8 9 1'"),
    (f"{LIST}0 1 0 16 0 inf 0 0 47 8 9 1\n", "finite numbers"),
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


@pytest.mark.parametrize(("text", "expected"), REFUSED)
def test_what_cannot_be_taken_is_named_with_its_line(path: Path, text: str, expected: str) -> None:
    assert expected in refusal(of_text, path, text)


@given(st.data())
def test_a_spoiled_list_is_read_or_an_input_error(path: Path, data: st.DataObject) -> None:
    corner = (0, 5001, (3, 0, 0, 0), 47.5, 8.5, 0.0)
    lines = saved(path, HOME, waypoint(0.01), corner, corner, corner).read_text().splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        line = data.draw(st.integers(0, len(lines) - 1))
        words = lines[line].split("\t")
        words[data.draw(st.integers(0, len(words) - 1))] = str(data.draw(JUNK))
        lines[line] = "\t".join(words)
    path.write_text("\n".join(lines), encoding="utf-8")
    for read in (read_waypoint_list, read_waypoint_fence):
        with contextlib.suppress(InputError):
            read(path, "MISSION")


@pytest.mark.parametrize("spelled", ["nan", "NaN", "-nan", "NAN"])
def test_how_a_list_is_written_does_not_matter(path: Path, spelled: str) -> None:
    """A parameter that is no number is not given."""
    text = saved(path, HOME, (3, TAKE_OFF, (0, 0, 0, 0), 0, 0, 30.0), waypoint(0.01)).read_text()
    rows = [line.split("\t") for line in text.splitlines()]
    for words in rows[1:]:
        words[4:8] = [spelled] * 4
    dressed = "\r\n\r\n# a comment\r\n".join(map("\t".join, rows))
    assert of_text(path, f"\ufeff{dressed}") == of_text(path, text)


def test_fences_and_rally_points_of_a_list_are_zones(path: Path) -> None:
    square = [(47.4, 8.5), (47.4, 8.6), (47.5, 8.6), (47.5, 8.5)]
    rows: list[Row] = [(0, 5000, (0, 0, 0, 0), 47.4, 8.55, 0.0)]
    rows += [(0, 5001, (4, 0, 0, 0), lat, lon, 0.0) for lat, lon in square]
    rows += [(0, 5002, (3, 0, 0, 0), lat, lon, 0.0) for lat, lon in square[:3]]
    rows += [(0, 5003, (9000.0, 0, 0, 0), 47.45, 8.55, 0.0)]
    rows += [(0, 5004, (120.0, 0, 0, 0), 47.41, 8.56, 0.0)]
    rows += [(3, 5100, (0, 0, 0, 0), 47.42, 8.57, 40.0)]
    found = read_waypoint_fence(saved(path, *rows), "threats")
    assert found.keep_ins[0]["vertices_deg"] == [list(corner) for corner in square]
    assert found.keep_outs[0]["vertices_deg"] == [list(corner) for corner in square[:3]]
    assert found.keep_ins[1]["radius_m"] == 9000.0
    circle = found.keep_outs[1]
    assert (circle["latitude_deg"], circle["longitude_deg"]) == (47.41, 8.56)
    assert circle["radius_m"] == 120.0
    assert found.rally_points == [{"latitude_deg": 47.42, "longitude_deg": 8.57}]
    assert not found.targets
