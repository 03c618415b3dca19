"""Golden flights decide what they decided when a person last looked: see golden.py."""

import copy
import json
import tomllib

import pytest
from golden import GOLDENS, NAMES, decisions_of, differences, expected
from record_golden import texts


def test_there_are_golden_flights_and_each_says_why() -> None:
    assert len(NAMES) >= 5
    assert {path.name for path in GOLDENS.iterdir()} == set(NAMES)
    for name in NAMES:
        assert len((GOLDENS / name / "why.md").read_text(encoding="utf-8")) > 80


@pytest.mark.parametrize("name", NAMES)
def test_a_golden_flight_decides_what_it_decided(name: str) -> None:
    folder = GOLDENS / name
    report = differences(expected(folder), list(decisions_of(folder)))
    assert not report, f"{report}\nIf that is meant: scripts/update-goldens {name}"


@pytest.mark.parametrize("name", NAMES)
def test_a_recipe_gives_the_mission_that_was_flown(name: str) -> None:
    how = json.loads((GOLDENS / name / "flight.json").read_text(encoding="utf-8"))
    if "log" not in how:
        recorded = tomllib.loads((GOLDENS / name / "mission.toml").read_text(encoding="utf-8"))
        again = texts(GOLDENS / name, how)
        assert tomllib.loads(again["mission.toml"]) == recorded
        assert "vehicle" in tomllib.loads(again["world.toml"])


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.usefixtures("nudged")
def test_a_golden_flight_decides_the_same_a_micrometre_aside(name: str) -> None:
    folder = GOLDENS / name
    was, now = expected(folder), list(decisions_of(folder))
    report = differences(was, now)
    assert not report, f"{report}\na decision hangs on the last digits of a position"


def test_a_changed_decision_is_counted_and_shown() -> None:
    was = expected(GOLDENS / NAMES[0])
    now = copy.deepcopy(was)
    place = next(i for i, line in enumerate(now) if line.get("kind") == "phase")
    now[place]["phase"] = "elsewhere"
    report = differences(was, now)
    assert "1 x phase.phase" in report
    assert f"line {place + 1}, t {was[place]['t_s']}" in report
    assert '"elsewhere"' in report
    assert f"{len(was)} decisions before, {len(was) - 1} now" in differences(was, was[:-1])
