"""A flight as it is shown while it is flown: on a terminal, as JSON, to readers that leave."""

import json
import re
from typing import Any

import pytest
from flights import Flight, flown_as
from programs import ROOT
from shown import WIDTH, Shown

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("hills")]
PAGE = ROOT / "docs" / "reference" / "fly-json.md"
TICK_S = 0.15  # a position, and its rounding


@pytest.fixture
def shown(flown: Any) -> Shown:
    it: Shown = flown(by=Shown)
    return it


@pytest.fixture
def flight(flown: Any) -> Flight:
    """The same: it decides what that does, and all of it is recorded."""
    it: Flight = flown(*flown_as("hills"))
    return it


@pytest.fixture
def lines(shown: Shown) -> list[dict[str, Any]]:
    assert shown.json.endswith(b"\n")
    return [json.loads(line) for line in shown.json.splitlines()]


def documented() -> dict[str, dict[str, str]]:
    """Kind of line -> field -> type, by the page."""
    kinds: dict[str, dict[str, str]] = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if heading := re.fullmatch(r"## `(\w+)`", line):
            fields = kinds[heading[1]] = {}
        elif row := re.fullmatch(r"\| `(\w+)` \| (.+?) \| (.+) \|", line):
            fields[row[1]] = row[2]
    return kinds


def fits(value: object, kind: str) -> bool:
    """Whether a value is of a type as the page has it."""
    if kind.endswith(" or null"):
        return value is None or fits(value, kind.removesuffix(" or null"))
    if kind.startswith("`"):
        return f"`{value}`" in kind.split(", ")
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return {
        "text": isinstance(value, str),
        "number": is_number,
        "whole number": is_number and isinstance(value, int),
        "true or false": isinstance(value, bool),
        "[north, east, altitude]": isinstance(value, list) and len(value) == 3,
        "list of text": isinstance(value, list) and all(isinstance(each, str) for each in value),
    }[kind]


def test_every_line_has_the_fields_of_the_page_and_no_others(lines: list[dict[str, Any]]) -> None:
    kinds = documented()
    assert [line["kind"] for line in lines[:1] + lines[-1:]] == ["begun", "ended"]
    assert {line["kind"] for line in lines[1:-1]} == {"status"}
    for line in lines:
        fields = kinds[line["kind"]]
        assert line.keys() == fields.keys() | {"kind"}
        for name, kind in fields.items():
            assert fits(line[name], kind), (name, line[name])


def test_the_lines_say_what_the_journal_says(
    shown: Shown, flight: Flight, lines: list[dict[str, Any]]
) -> None:
    header, *entries = flight.journal
    first, *statuses, ended = lines
    assert {name: first[name] for name in ("mission", "seed", "profile", "lockstep")} == {
        name: header[name] for name in ("mission", "seed", "profile", "lockstep")
    }
    assert (ended["outcome"], ended["reason"]) == (flight.end["outcome"], flight.end["reason"])
    assert ended["exit_code"] == shown.code == 0
    phases = [(0.0, "waiting"), *((e["t_s"], e["phase"]) for e in entries if e["kind"] == "phase")]
    legs = [entry["t_s"] for entry in entries if entry["kind"] == "leg"]
    costs = {entry["cost"] for entry in entries if entry["kind"] == "plan ready"}
    for line in statuses:
        begun = [p for t, p in phases if abs(t - line["t_s"]) <= TICK_S]
        before = [p for t, p in phases if t <= max(line["t_s"] - TICK_S, 0.0)][-1]
        assert line["phase"] in (before, *begun), line
        count = [sum(t <= line["t_s"] + by for t in legs) for by in (-TICK_S, TICK_S)]
        assert count[0] <= line["subpaths_flown"] <= count[1]
        assert line["plan_cost"] in {None, *costs}
    assert {"flying", "done"} <= {line["phase"] for line in statuses}
    assert [line["t_s"] for line in statuses] == sorted(line["t_s"] for line in statuses)


def test_the_lines_say_where_the_vehicle_truly_is(
    flight: Flight, lines: list[dict[str, Any]]
) -> None:
    truth = {round(row["t_s"], 1): row for row in flight.truth}
    compared = 0
    for line in lines[1:-1]:
        row = truth.get(round(line["t_s"], 1))
        if line["phase"] == "flying" and row is not None:
            compared += 1
            assert line["altitude_amsl_m"] == pytest.approx(row["altitude_amsl_m"], abs=10.0)
            speed = (row["velocity_north_m_s"] ** 2 + row["velocity_east_m_s"] ** 2) ** 0.5
            assert line["speed_m_s"] == pytest.approx(speed, abs=5.0)
    assert compared > 3


def test_on_a_terminal_a_table_is_drawn_and_the_cursor_is_given_back(shown: Shown) -> None:
    text = shown.screen.decode()
    assert text.count("\x1b[?25l") == text.count("\x1b[?25h") > 0
    assert text.rindex("\x1b[?25h") < text.index("run folder: ")
    for word in ("FLYING", "to go", "AMSL", "clearance", "battery", "link", "proof"):
        assert word in shown.text
    table = [line for line in shown.text.splitlines() if line.startswith(("to go ", "FLYING "))]
    assert table
    assert max(map(len, table)) <= WIDTH
