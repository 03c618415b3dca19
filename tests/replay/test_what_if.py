"""What if: the same settings give the same plans; others change what they say, and nothing else."""

import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from answers import answered
from golden import GOLDENS

from companion import config
from companion.config import load_mission
from companion.replay.what_if import what_if, with_changes
from companion.sources.files import read_text
from companion.world.zones import CircleZone

FLIGHT = GOLDENS / "copter-loses-gps"
MISSION = str(FLIGHT / "mission.toml")


def test_the_same_settings_give_plans_as_good_as_were_flown_on_any_processor() -> None:
    """The very same on one that computes alike: tests/closed_loop/test_reproduce.py."""
    flown = load_mission(MISSION)
    found = list(what_if(FLIGHT, lambda _start: flown, flown, seed=None))
    assert len(found) >= 2
    for each in found:
        assert each.now.cost == pytest.approx(each.flown.cost, rel=0.01)
        assert (each.now.refusal, each.now.terms.keys()) == ("", each.flown.terms.keys())
        assert each.flown.length_m == pytest.approx(150.0 * each.flown.time_s)


def test_what_changed_in_flight_stays_and_only_what_the_settings_say_changes() -> None:
    before = load_mission(MISSION).task
    drawn = CircleZone(name="drawn", north_m=9000.0, east_m=9000.0, radius_m=100.0)
    in_flight = replace(
        before, zones=(drawn,), limits=replace(before.limits, ceiling_amsl_m=2_200.0)
    )
    after = load_mission(MISSION, settings=["vehicle.speed_m_s=100"]).task
    task = with_changes(in_flight, before, after)
    assert task.zones == (drawn,)
    assert (task.limits.ceiling_amsl_m, task.limits.speed_m_s) == (2_200.0, 100.0)
    assert task.settings == before.settings
    assert with_changes(in_flight, before, before).limits == in_flight.limits


def test_the_command_tabulates_and_writes_what_is_proven_by_another_distance(
    tmp_path: Path,
) -> None:
    setting, report = "planner.safety_distance_m=200", tmp_path / "report.json"
    required_m = load_mission(MISSION, settings=[setting]).task.required_clearance_m
    code, shown, _ = answered("replay", FLIGHT, "--set", setting, "--json", report)
    rows = json.loads(report.read_text(encoding="utf-8"))
    assert code == 0
    assert "2 whole subpaths, then: cost" in shown
    assert f"{rows[0]['flown']['cost']:.2f}" in shown
    assert [row["plan_id"] for row in rows] == [1, 2]
    assert any(row["now"] != row["flown"] for row in rows)
    for row in rows:
        assert row["now"]["clearance_m"] >= required_m - 1e-6
        assert row["flown"]["clearance_m"] >= 500.0


def test_the_command_refuses_a_setting_that_no_mission_may_have_or_that_does_nothing() -> None:
    for setting, words in {
        "=3": "it is not a key, an = and a value",
        "name.of=3": "name = {'of': 3}: it must be a valid string",
        "planner.safty_distance_m=3": "no such key",
        "planner.planning_time_s=1e4": "eq. 4",
        "terrain.highest_amsl_m=900": "it changes nothing by which recorded subpaths are planned",
    }.items():
        code, _, said = answered("replay", FLIGHT, "--set", setting)
        assert (code, said.count("\n")) == (2, 1)
        assert words in said


def test_the_mission_is_read_as_often_for_many_settings_as_for_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    idle, reads = "terrain.highest_amsl_m=900", list[int]()
    for settings in ([idle], ["vehicle.speed_m_s=100", "planner.safety_distance_m=200", idle]):
        read = Mock(wraps=read_text)
        monkeypatch.setattr(config, "read_text", read)
        _, _, said = answered("replay", FLIGHT, *(f"--set={setting}" for setting in settings))
        assert idle in said
        reads.append(read.call_count)
    assert reads[0] == reads[1] > 0
