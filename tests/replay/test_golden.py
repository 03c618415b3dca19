"""Golden flights decide what they decided when a person last looked: see golden.py."""

import json
import tomllib

import pytest
from golden import GOLDENS, NAMES, decisions_of, differences, expected
from record_golden import texts


@pytest.mark.parametrize("name", NAMES)
def test_a_golden_flight_decides_what_it_decided(name: str) -> None:
    folder = GOLDENS / name
    assert len((folder / "why.md").read_text(encoding="utf-8")) > 80
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
