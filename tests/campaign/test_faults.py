"""What is drawn to go wrong, and how flights with it are judged."""

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flights import one_target

from companion.campaign import drawn_faults, drawn_world, families, judge
from companion.campaign.drawn_faults import FAMILIES, ROWS, FaultScript, Subject
from companion.campaign.drawn_world import mission_of
from companion.campaign.file import load_campaign, runs_of
from companion.campaign.in_process import Flight
from companion.campaign.run import fly_run
from companion.config import load_mission
from companion.world.zones import CircleZone
from vehicle_sim.faults import FAULTS, Timeline

VEHICLES = ("ardupilot-copter", "ardupilot-plane", "px4-copter", "px4-plane")
DRAWN = families.world("short-copter", 1, 0)
MISSION = mission_of(DRAWN)
HIGH_M = 1_500.0
TARGET = DRAWN.targets_ne_m[-1]


def subject(vehicle: str) -> Subject:
    return Subject(vehicle=vehicle, speed_m_s=10.0)


# --- draws


def test_every_fault_of_the_simulator_is_drawn() -> None:
    near = ("lidar_", "rangefinder_", "ground_")
    assert {fault.name for fault in FAULTS if not fault.name.startswith(near)} <= ROWS.keys()


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("family", FAMILIES)
def test_a_script_can_be_flown_and_is_the_same_again(family: str, vehicle: str) -> None:
    scripts = [FaultScript(family=family, seed=3, index=index) for index in range(60)]
    drawn = [drawn_faults.drawn(script, subject(vehicle)) for script in scripts]
    assert drawn == [drawn_faults.drawn(script, subject(vehicle)) for script in scripts]
    firmware: Any = vehicle.partition("-")[0]
    for _, timeline in drawn:
        ours, killed = drawn_faults.split(timeline)
        Timeline.parse(ours, firmware=firmware)
        assert len(ours.splitlines()) + len(killed) == len(timeline.splitlines())
    assert len({timeline for _, timeline in drawn}) > 50
    assert all(each.what == drawn_faults.KILLED for each in killed)


def test_singles_go_through_all_rows_and_another_seed_draws_others() -> None:
    names = [
        drawn_faults.drawn(FaultScript(family="single", seed=1, index=k), subject("px4-plane"))[0]
        for k in range(len(ROWS) - 1)
    ]
    assert set(names) == ROWS.keys() - {"battery_voltage"}
    one, other = (
        drawn_faults.drawn(FaultScript(family="single", seed=seed, index=0), subject("px4-plane"))
        for seed in (1, 2)
    )
    assert one[0] == other[0]
    assert one[1] != other[1]


# --- the judge


def flight(
    folder: Path,
    places: list[tuple[float, float]],
    *,
    told_off_m: float = 0.0,
    mode: str = "GUIDED",
    quiet_s: tuple[float, float] = (0.0, 0.0),
    asks_s: float | None = None,
    **end: Any,
) -> Flight:
    """A second at each place, at a height where there is no ground in the way."""
    truth, log = [], b""
    for k in range(10 * len(places)):
        t_s = round(0.1 * (k + 1), 1)
        north_m, east_m = places[k // 10]
        latitude, longitude = MISSION.frame.to_geodetic_deg(north_m, east_m)
        row = {"t_s": t_s, "north_m": north_m, "east_m": east_m, "altitude_amsl_m": HIGH_M}
        row |= {"lat_deg": latitude, "lon_deg": longitude, "mode": mode}
        row |= {"velocity_north_m_s": 0.0, "velocity_east_m_s": 0.0}
        truth.append(row | {"armed": True, "landed": False})
        places_e7 = round(latitude * 1e7), round(longitude * 1e7)
        body = struct.pack(
            "<Iiiii", round(t_s * 1e3), *places_e7, round(1e3 * (HIGH_M + told_off_m)), 0
        )
        stamp = struct.pack(">Q", 10**15 + round(t_s * 1e6))
        log += stamp + frame(33, 1, body.ljust(28, b"\1"))
        if not quiet_s[0] < t_s < quiet_s[1]:
            log += stamp + frame(86, 195, b"\1" * 53)
        if t_s == asks_s:  # DO_SET_MODE
            log += stamp + frame(76, 195, bytes(28) + struct.pack("<HBBB", 176, 1, 1, 0))
    (folder / "flight.tlog").write_bytes(log)
    journal = [{"t_s": 0.0, "kind": "phase", "phase": "flying", "code": None, "reason": None}]
    ended = {"t_s": truth[-1]["t_s"], "kind": "end", "outcome": "arrived", "reason": "there"}
    journal.append(ended | end)
    return Flight(mission=MISSION, journal=journal, truth=truth, plans_s=[], folder=folder)


def frame(number: int, component: int, body: bytes) -> bytes:
    head = bytes([0xFD, len(body), 0, 0, 0, 1, component]) + number.to_bytes(3, "little")
    return head + body + b"\0\0"


def violated(flown: Flight, timeline: str = "") -> list[str]:
    row = judge.judged(flown, DRAWN, timeline)
    found = str(row["violated"] or "").split("; ") if row["violated"] else []
    assert len(found) == row["violations"]
    return found


def zone() -> CircleZone:
    found = DRAWN.task.zones[0]
    assert isinstance(found, CircleZone)
    return found


def beside(gap_m: float) -> tuple[float, float]:
    """A place so far from the edge of the first keep-out, towards where no other is."""
    away = np.array([zone().north_m, zone().east_m])
    others = [z for z in DRAWN.task.zones[1:] if isinstance(z, CircleZone)]
    for bearing in np.linspace(0.0, 6.0, 25):
        at = away + (zone().radius_m + gap_m) * np.array([np.cos(bearing), np.sin(bearing)])
        if all(np.hypot(*(at - (z.north_m, z.east_m))) > z.radius_m + 20.0 for z in others):
            return float(at[0]), float(at[1])
    raise AssertionError


@pytest.mark.parametrize(("gap_m", "count"), [(12.2, 0), (11.5, 1), (-3.0, 1)])
def test_who_is_nearer_than_the_safety_distance_violates_it(
    gap_m: float, count: int, tmp_path: Path
) -> None:
    assert DRAWN.task.settings.safety_distance_m == 12.0
    assert len(violated(flight(tmp_path, [*[beside(gap_m)] * 3, TARGET]))) == count


def test_who_leaves_a_keep_in_violates_it(tmp_path: Path) -> None:
    fence = CircleZone(name="in", north_m=-1_200.0, east_m=0.0, radius_m=50.0, keep_in=True)
    world = replace(DRAWN, task=replace(DRAWN.task, zones=(fence,)))
    for off_m, count in ((37.0, 0), (39.0, 1), (60.0, 1)):
        flown = flight(tmp_path, [(-1_200.0, off_m)] * 3, kind="say")
        assert judge.judged(flown, world, None)["violations"] == count


@pytest.mark.parametrize(("off_m", "count"), [(3.5, 0), (2.5, 1)])
def test_a_position_that_was_told_wrong_excuses_and_one_within_its_error_does_not(
    off_m: float, count: int, tmp_path: Path
) -> None:
    assert DRAWN.task.limits.navigation_error_m == 3.0
    flown = flight(tmp_path, [*[beside(0.0)] * 3, TARGET], told_off_m=off_m)
    assert len(violated(flown)) == count
    assert (judge.judged(flown, DRAWN, "")["excused"] is None) == bool(count)


CRASH = {"t_s": 3.05, "into": "the ground", "speed_m_s": 9.13}


@pytest.mark.parametrize(
    ("mode", "told_off_m", "count"), [("GUIDED", 0.0, 1), ("GUIDED", 4.0, 0), ("LAND", 0.0, 0)]
)
def test_a_crash_violates_unless_somebody_else_flew_or_it_was_landing(
    mode: str, told_off_m: float, count: int, tmp_path: Path
) -> None:
    flown = flight(tmp_path, [beside(50.0)] * 4, told_off_m=told_off_m, mode=mode)
    before = violated(flown)
    for row in flown.truth[30:]:
        row |= {"landed": True, "armed": False, "crash": CRASH}
    assert len(after := violated(flown)) - len(before) == count
    assert ("hit the ground at 9.1 m/s, 3.0 s" in after) == bool(count)


def test_without_faults_a_crash_is_a_violation_wherever_it_was_and_no_ending_is(
    tmp_path: Path,
) -> None:
    flown = flight(tmp_path, [TARGET] * 2, mode="LAND", kind="say")
    row = judge.judged(flown, DRAWN, None)
    assert (row["violations"], row["violated"], "ending" in row) == (0, None, False)
    flown.truth[-1]["crash"] = CRASH | {"t_s": 2.0}
    row = judge.judged(flown, DRAWN, None)
    assert (row["violations"], row["violated"]) == (1, "hit the ground at 9.1 m/s, 2.0 s")


def test_an_excuse_ends_with_its_grace(tmp_path: Path) -> None:
    far = TARGET
    places = [beside(0.0)] * 3 + [far] * 5
    assert not violated(flight(tmp_path, [*places, *[beside(0.0)] * 4, far], mode="RTL"))
    flown = flight(tmp_path, [*places, *[beside(0.0)] * 10, far])
    for row in flown.truth[:30]:
        row["mode"] = "LOITER"
    assert len(violated(flown)) == 1
    for row in flown.truth:
        row["mode"] = "LOITER"  # a copter's pilot
    assert not violated(flown)


def test_a_new_fence_is_known_after_ten_seconds_and_then_has_to_be_left_once(
    tmp_path: Path,
) -> None:
    inside, outside = (-1_200.0, -1_200.0), (-1_150.0, -1_200.0)
    line = "at 2.0 s: ground_fence 30 m"
    assert not violated(flight(tmp_path, [*[inside] * 11, TARGET]), line)
    assert len(violated(flight(tmp_path, [*[inside] * 40, TARGET]), line)) == 1
    unknown = [inside] * 3 + [outside] * 2 + [inside] * 2 + [outside] * 10
    assert not violated(flight(tmp_path, [*unknown, TARGET]), line)
    leaves = [inside] * 16 + [outside] * 10
    assert not violated(flight(tmp_path, [*leaves, TARGET]), line)
    assert len(violated(flight(tmp_path, [*leaves, inside, TARGET]), line)) == 1


def test_a_silence_is_counted_in_guided_mode_and_when_somebody_could_speak(tmp_path: Path) -> None:
    flown = flight(tmp_path, [TARGET] * 10, quiet_s=(3.0, 7.0))
    assert judge.judged(flown, DRAWN, "")["silent_s"] == pytest.approx(3.9)
    asked = flight(tmp_path, [TARGET] * 10, quiet_s=(3.0, 7.0), asks_s=5.0)
    assert judge.judged(asked, DRAWN, "")["silent_s"] == pytest.approx(1.9)
    flown = flight(tmp_path, [TARGET] * 10, quiet_s=(3.0, 7.0))
    lost = judge.judged(flown, DRAWN, "at 3.0 s for 3.5 s: link_off")
    assert lost["silent_s"] < 1.0
    for row in flown.truth:
        row["mode"] = "BRAKE"
    assert judge.judged(flown, DRAWN, "")["silent_s"] == 0.0


@pytest.mark.parametrize(
    ("end", "ending"),
    [
        ({}, "arrived"),
        ({"outcome": "failed", "reason": ""}, "unexplained: no reason"),
        ({"outcome": "failed", "reason": "the radar did not"}, "unexplained: left in guided mode"),
        ({"kind": "say"}, "unexplained: no end"),
    ],
)
def test_an_ending_is_explained_by_a_reason_and_a_safe_mode(
    end: dict[str, Any], ending: str, tmp_path: Path
) -> None:
    found = judge.judged(flight(tmp_path, [TARGET] * 3, **end), DRAWN, "")
    assert found["ending"] == ending
    assert found["violations"] == ending.startswith("unexplained")


@pytest.mark.parametrize(
    ("until_s", "ending"), [(0.1, "unexplained: left in guided mode"), (99.0, "held for good")]
)
def test_a_copter_that_no_command_could_reach_at_the_end_holds(
    until_s: float, ending: str, tmp_path: Path
) -> None:
    flown = flight(tmp_path, [TARGET] * 3, outcome="failed", reason="the vehicle fell silent")
    lost = f"at 0.1 s for {until_s} s: link_off"
    assert judge.judged(flown, DRAWN, lost)["ending"] == ending


@pytest.mark.parametrize(("timeline", "count"), [("", 1), ("at 0.1 s: turbulence 1 m/s", 0)])
def test_to_hold_for_good_with_nothing_wrong_violates(
    timeline: str, count: int, tmp_path: Path
) -> None:
    flown = flight(tmp_path, [TARGET] * 3, mode="BRAKE", outcome="failed", reason="no way")
    found = judge.judged(flown, DRAWN, timeline)
    assert (found["ending"], found["violations"]) == ("held for good", count)


def test_who_says_that_it_arrived_somewhere_else_is_found_out(tmp_path: Path) -> None:
    flown = flight(tmp_path, [(TARGET[0] - 200.0, TARGET[1])] * 3)
    assert judge.judged(flown, DRAWN, "")["ending"] == "unexplained: arrived elsewhere"
    told = "at 1.0 s: ground_target 1 m north 1 m east"
    assert judge.judged(flown, DRAWN, told)["ending"] == "arrived"


def test_faults_are_judged_in_lidar_missions_too(tmp_path: Path) -> None:
    """Who says nothing of its end, or touches something that it could know of, violates."""
    forest, world = load_mission("forest"), drawn_world.bundled("forest")
    there = forest.targets_ne_m[-1]
    up_m = forest.task.limits.floor_amsl_m + 3.0
    made = flight(tmp_path, [there] * 4, told_off_m=up_m - HIGH_M, kind="say")
    plain = replace(made, mission=forest)
    for row in plain.truth:
        row |= {"altitude_amsl_m": up_m, "near_m": 2.0}
    row = judge.judged(plain, world, "")
    assert (row["violations"], row["ending"]) == (1, "unexplained: no end")
    assert row["clearance_least_m"] == 2.0
    end = plain.journal[-1] | {"kind": "end"}
    touching = replace(plain, journal=[*plain.journal[:-1], end])
    touching.truth[20]["near_m"] = 0.0
    said = "touched something at 2.1 s"
    assert said in judge.judged(touching, world, "")["violated"]
    assert judge.judged(touching, world, None)["violated"] == said
    for row in touching.truth:
        row["mode"] = "LOITER"  # a pilot
    found = judge.judged(touching, world, "")
    assert (said in str(found["violated"]), said in found["excused"]) == (False, True)


# --- flown


@pytest.mark.closed_loop
def test_a_companion_that_is_killed_goes_on(tmp_path: Path) -> None:
    (tmp_path / "mission.toml").write_text(one_target(), encoding="utf-8")
    (tmp_path / "campaign.toml").write_text(
        'schema = 1\nname = "killed"\nkeep = "all"\n'
        '[[places]]\nworld = "sitl-arducopter"\nmission = "mission.toml"\n'
        '[factors]\nfaults = ["dead"]\n'
        '[[choices]]\nname = "dead"\nfaults = "at 70 s for 2 s: companion_off"\n',
        encoding="utf-8",
    )
    table, _, base = load_campaign(str(tmp_path / "campaign.toml"))
    [run] = runs_of(table, base)
    row = fly_run(run, tmp_path)
    assert (row.arrived, row.violations, row.violated) == (True, 0, None)
    assert row.ending in ("arrived", "held and resumed")
    lines = (tmp_path / str(row.folder) / "journal.jsonl").read_text().splitlines()
    assert sum("resumed" in json.loads(line) for line in lines if '"schema"' in line) == 1
