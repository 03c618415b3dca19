"""What is drawn to go wrong, and how flights with it are judged."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.campaign import drawn_faults, drawn_world, families, judge
from companion.campaign.drawn_faults import FAMILIES, ROWS, FaultScript, Subject
from companion.campaign.drawn_world import mission_of
from companion.campaign.in_process import Flight
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
    for _, timeline in drawn:
        ours, killed = drawn_faults.split(timeline)
        Timeline.parse(ours)
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
    **end: Any,
) -> Flight:
    """A second at each place, at a height where there is no ground in the way."""
    truth = []
    for k in range(10 * len(places)):
        north_m, east_m = places[k // 10]
        row = {"t_s": round(0.1 * (k + 1), 1), "north_m": north_m, "east_m": east_m}
        row |= {"altitude_amsl_m": HIGH_M, "mode": mode}
        row |= {"velocity_north_m_s": 0.0, "velocity_east_m_s": 0.0}
        truth.append(row | {"armed": True, "landed": False})
    journal = [{"t_s": 0.0, "kind": "phase", "phase": "flying", "code": None, "reason": None}]
    ended = {"t_s": truth[-1]["t_s"], "kind": "end", "outcome": "arrived", "reason": "there"}
    journal.append(ended | end)
    names = ("t_s", "t_s", "north_m", "east_m", "altitude_amsl_m")
    told = np.array([[row[name] for name in names] for row in truth])
    told[:, -1] += told_off_m
    return Flight(
        mission=MISSION, journal=journal, truth=truth, plans_s=[], told=told, folder=folder
    )


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


SAFETY_M, ERROR_M = 12.0, 3.0  # of the world that is drawn: its safety distance, its position's
INSIDE, OUTSIDE = (-1_200.0, -1_200.0), (-1_150.0, -1_200.0)  # of a circle of 30 m that is drawn
FENCE, AWAY = "at 2.0 s: ground_fence 30 m", (TARGET[0] - 200.0, TARGET[1])
TOO_LOW = "at 0 s: radar_noise 5 m either_way"
SILENT = {"outcome": "failed", "reason": "the vehicle fell silent"}
HELD = {"mode": "BRAKE", "outcome": "failed", "reason": "no way"}
Case = tuple[list[tuple[float, float]], dict[str, Any], str, int]
"""Places, a second at each, and more of the flight; the faults; how many violations."""
VIOLATIONS: dict[str, Case] = {
    "as near as the safety distance": ([*[beside(12.2)] * 3, TARGET], {}, "", 0),
    "nearer": ([*[beside(11.5)] * 3, TARGET], {}, "", 1),
    "inside": ([*[beside(-3.0)] * 3, TARGET], {}, "", 1),
    "told wrong by its error": ([*[beside(0.0)] * 3, TARGET], {"told_off_m": 2.5}, "", 1),
    "told wrong by more": ([*[beside(0.0)] * 3, TARGET], {"told_off_m": 3.5}, "", 0),
    "told too low heights": ([*[beside(0.0)] * 3, TARGET], {}, TOO_LOW, 0),
    "flown by the autopilot": (
        [*[beside(0.0)] * 3, *[TARGET] * 5, *[beside(0.0)] * 4, TARGET],
        {"mode": "RTL"},
        "",
        0,
    ),
    # what is new is known after ten seconds, and then has to be left once
    "a new fence": ([*[INSIDE] * 11, TARGET], {}, FENCE, 0),
    "a new fence that is not left": ([*[INSIDE] * 40, TARGET], {}, FENCE, 1),
    "one that was left before it was known": (
        [*[INSIDE] * 3, *[OUTSIDE] * 2, *[INSIDE] * 2, *[OUTSIDE] * 10, TARGET],
        {},
        FENCE,
        0,
    ),
    "one that is left": ([*[INSIDE] * 16, *[OUTSIDE] * 10, TARGET], {}, FENCE, 0),
    "and entered again": ([*[INSIDE] * 16, *[OUTSIDE] * 10, INSIDE, TARGET], {}, FENCE, 1),
}
ENDINGS: dict[str, Case] = {
    "arrived": ([TARGET] * 3, {}, "", 0),
    "unexplained: no reason": ([TARGET] * 3, {"outcome": "failed", "reason": ""}, "", 1),
    "unexplained: left in guided mode": ([TARGET] * 3, SILENT, "", 1),
    "unexplained: left in guided mode, once in reach again": (
        [TARGET] * 3,
        SILENT,
        "at 0.1 s for 0.1 s: link_off",
        1,
    ),
    "landed, as it disarmed in the last tick": (
        [TARGET] * 3,
        {"outcome": "failed", "reason": "the vehicle disarmed"},
        "at 0.1 s: turbulence 1 m/s",
        0,
    ),
    "unexplained: no end": ([TARGET] * 3, {"kind": "say"}, "", 1),
    "unexplained: arrived elsewhere": ([AWAY] * 3, {}, "", 1),
    "arrived, its target was moved": (
        [AWAY] * 3,
        {},
        "at 1.0 s: ground_target 1 m north 1 m east",
        0,
    ),
    "held for good, out of reach": ([TARGET] * 3, SILENT, "at 0.1 s for 99 s: link_off", 0),
    "held for good, with nothing wrong": ([TARGET] * 3, HELD, "", 1),
    "held for good, in wind": ([TARGET] * 3, HELD, "at 0.1 s: turbulence 1 m/s", 0),
}


@pytest.mark.parametrize("case", VIOLATIONS)
def test_what_it_could_know_of_and_did_violates(case: str, tmp_path: Path) -> None:
    """What it could not know of excuses it, and so does whoever else flew."""
    assert DRAWN.task.settings.safety_distance_m == SAFETY_M
    assert DRAWN.task.limits.navigation_error_m == ERROR_M
    places, more, timeline, count = VIOLATIONS[case]
    flown = flight(tmp_path, places, **more)
    assert len(violated(flown, timeline)) == count
    if "told_off_m" in more:
        assert (judge.judged(flown, DRAWN, "")["excused"] is None) == bool(count)


@pytest.mark.parametrize("case", ENDINGS)
def test_an_ending_is_explained_by_a_reason_and_a_safe_mode(case: str, tmp_path: Path) -> None:
    places, more, timeline, count = ENDINGS[case]
    found = judge.judged(flight(tmp_path, places, **more), DRAWN, timeline)
    assert (found["ending"], found["violations"]) == (case.partition(",")[0], count)


def test_an_excuse_ends_with_its_grace(tmp_path: Path) -> None:
    places = [*[beside(0.0)] * 3, *[TARGET] * 5, *[beside(0.0)] * 10, TARGET]
    flown = flight(tmp_path, places)
    for row in flown.truth[:30]:
        row["mode"] = "LOITER"
    assert len(violated(flown)) == 1
    for row in flown.truth:
        row["mode"] = "LOITER"  # a copter's pilot
    assert not violated(flown)


def test_what_was_planned_before_an_excuse_is_checked_whole(tmp_path: Path) -> None:
    """From then on a subpath may be in a wrong place, and is right in its shape only."""
    flown = flight(tmp_path, [TARGET] * 4)
    up_m = 0.5 * sum(DRAWN.task.band_amsl_m)
    across = np.linspace((*beside(-40.0), up_m), (*beside(-1.0), up_m), 5).tolist()
    ready = [{"t_s": t_s, "kind": "plan ready", "control_nea_m": across} for t_s in (1.0, 3.0)]
    flown = replace(flown, journal=[*flown.journal[:1], *ready, *flown.journal[1:]])
    assert violated(flown, TOO_LOW.replace("0 s", "2 s")) == ["leg 1: keep-out zone"]
    assert violated(flown, TOO_LOW) == []
    assert violated(flown) == ["leg 1: keep-out zone", "leg 2: keep-out zone"]


def test_who_climbs_out_is_not_too_near_to_the_ground_and_who_flies_is(tmp_path: Path) -> None:
    ground_m = float(DRAWN.terrain.height_m(np.array(TARGET[0]), np.array(TARGET[1])))
    low_m = ground_m + 0.5 * SAFETY_M
    flown = flight(tmp_path, [TARGET] * 4, told_off_m=low_m - HIGH_M)
    for row in flown.truth:
        row["altitude_amsl_m"] = low_m
    for begins_s, count in ((1.0, 1), (9.0, 0)):
        leg = {"t_s": begins_s, "kind": "leg"}
        after = replace(flown, journal=[*flown.journal[:1], leg, *flown.journal[1:]])
        assert [each.startswith("terrain ") for each in violated(after)] == [True] * count


def test_who_leaves_a_keep_in_violates_it(tmp_path: Path) -> None:
    fence = CircleZone(name="in", north_m=-1_200.0, east_m=0.0, radius_m=50.0, keep_in=True)
    world = replace(DRAWN, task=replace(DRAWN.task, zones=(fence,)))
    for off_m, count in ((37.0, 0), (39.0, 1), (60.0, 1)):
        flown = flight(tmp_path, [(-1_200.0, off_m)] * 3, kind="say")
        assert judge.judged(flown, world, None)["violations"] == count


CRASH = {"t_s": 3.05, "into": "the ground", "speed_m_s": 9.13}


@pytest.mark.parametrize(
    ("mode", "told_off_m", "count"), [("GUIDED", 0.0, 1), ("GUIDED", 4.0, 0), ("LAND", 0.0, 0)]
)
def test_a_crash_violates_unless_somebody_else_flew_or_it_was_landing(
    mode: str, told_off_m: float, count: int, tmp_path: Path
) -> None:
    """Without faults it does wherever it was, and no ending is judged."""
    flown = flight(tmp_path, [beside(50.0)] * 4, told_off_m=told_off_m, mode=mode)
    before, said = violated(flown), "hit the ground at 9.1 m/s, 3.0 s"
    assert "ending" not in judge.judged(flown, DRAWN, None)
    for row in flown.truth[30:]:
        row |= {"landed": True, "armed": False, "crash": CRASH}
    assert len(after := violated(flown)) - len(before) == count
    assert (said in after) == bool(count)
    assert said in str(judge.judged(flown, DRAWN, None)["violated"])


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
