"""What is drawn to go wrong, and how flights with it are judged."""

import tempfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from companion.campaign import drawn_faults, drawn_world, families, in_process, judge
from companion.campaign.drawn_faults import FAMILIES, FaultScript, ways
from companion.campaign.in_process import Flight
from companion.config import load_mission
from companion.errors import InputError
from companion.mission.state import Reason
from companion.world.zones import CircleZone
from vehicle_sim import faults
from vehicle_sim.faults import COMPANION_OFF, FAULTS, Drawn, Fault, Known, Timeline, conditions_of

VEHICLES = ("ardupilot-copter", "ardupilot-plane", "px4-copter", "px4-plane")
DRAWN = families.world("short-copter", 1, 0)
with tempfile.TemporaryDirectory() as _folder:
    MISSION = load_mission(str(drawn_world.write(DRAWN, Path(_folder))[1]))
HIGH_M = 1_500.0
TARGET = DRAWN.targets_ne_m[-1]


# --- draws


def drawn(family: str, seed: int, count: int, vehicle: str) -> list[tuple[str, str]]:
    """Names and timelines of so many scripts."""
    scripts = [FaultScript(family=family, seed=seed, index=index) for index in range(count)]
    return [drawn_faults.drawn(script, vehicle, 10.0) for script in scripts]


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("family", FAMILIES)
def test_a_script_can_be_flown_and_is_the_same_again(family: str, vehicle: str) -> None:
    found = drawn(family, 3, 60, vehicle)
    assert found == drawn(family, 3, 60, vehicle)
    for _, timeline in found:
        entries = faults.entries(timeline)
        assert len(entries) == len(timeline.splitlines())
        if all(each.fault.name != COMPANION_OFF for each in entries):
            Timeline.parse(timeline)
    assert len({timeline for _, timeline in found}) > 50


def test_singles_go_through_all_faults_and_another_seed_draws_others() -> None:
    """But for those of sensors that the drawn vehicles do not have."""
    without = {fault.name for fault in FAULTS if not fault.drawn}
    assert all(name.startswith(("lidar_", "rangefinder_")) for name in without)
    assert [way.number for way in ways()] == list(range(len({way.name for way in ways()})))
    one, other = (drawn("single", seed, len(ways()) - 1, "px4-plane") for seed in (1, 2))
    assert [name for name, _ in one] == [w.name for w in ways() if w.name != "battery_voltage"]
    assert one[0][0] == other[0][0]
    assert one[0][1] != other[0][1]


def test_a_fault_that_is_added_as_one_row_is_drawn_flown_and_judged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    row = Fault(
        "gps",
        "gps_few N",
        "The receiver sees so few satellites.",
        "satellites",
        drawn=[Drawn(len(ways()), "2..5 for 2.0..9.0 s")],
        known=Known("the sky was hidden"),
    )
    monkeypatch.setattr(faults, "FAULTS", (*FAULTS[:5], row, *FAULTS[5:]))
    name, timeline = drawn("single", 1, len(ways()), "ardupilot-plane")[-1]
    assert name == "gps_few"
    flown = Timeline.parse(timeline)
    flown.step(flown.next_us)
    assert conditions_of({}, flown.lasting).gps.satellites in range(2, 6)
    assert len(violated(flight(NEAR))) == 1
    excused = judge.judged(flight(NEAR), DRAWN, "at 0 s: gps_few 3")
    assert excused["violations"] == 0
    assert "the sky was hidden" in excused["excused"]


def test_without_a_simulator_that_can_say_what_may_go_wrong_there_is_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    older = [SimpleNamespace(load=lambda: print)]
    monkeypatch.setattr(in_process, "entry_points", lambda **_: older)
    with pytest.raises(InputError, match="Install the project again"):
        in_process.simulator.__wrapped__()


# --- the judge


def flight(
    places: list[tuple[float, float]],
    *,
    told_off_m: float = 0.0,
    mode: str = "GUIDED",
    by_others: range = range(0),
    **end: Any,
) -> Flight:
    """A second at each place, at a height where there is no ground in the way.

    by_others: the places over which a copter's pilot flies it.
    """
    truth = []
    for k in range(10 * len(places)):
        north_m, east_m = places[k // 10]
        row = {"t_s": round(0.1 * (k + 1), 1), "north_m": north_m, "east_m": east_m}
        row |= {"altitude_amsl_m": HIGH_M, "mode": "LOITER" if k // 10 in by_others else mode}
        row |= {"velocity_north_m_s": 0.0, "velocity_east_m_s": 0.0}
        truth.append(row | {"armed": True, "landed": False})
    journal = [{"t_s": 0.0, "kind": "phase", "phase": "flying", "code": None, "reason": None}]
    ended = {"t_s": truth[-1]["t_s"], "kind": "end", "outcome": "arrived", "reason": "there"}
    journal.append(ended | end)
    names = ("t_s", "t_s", "north_m", "east_m", "altitude_amsl_m")
    told = np.array([[row[name] for name in names] for row in truth])
    told[:, -1] += told_off_m
    return Flight(mission=MISSION, journal=journal, truth=truth, plans_s=[], told=told)


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
TAKEN = {"mode": "LOITER", "outcome": "failed", "reason": Reason.MODE_TAKEN.text}
WIND = "at 0.1 s: turbulence 1 m/s"
DISARMED = {"outcome": "failed", "reason": "the vehicle disarmed"}
NEAR = [*[beside(0.0)] * 3, TARGET]
TWICE = [*[beside(0.0)] * 3, *[TARGET] * 5, *[beside(0.0)] * 10, TARGET]


class Judged(NamedTuple):
    """A flight, what goes wrong in it, and what the judge says."""

    places: list[tuple[float, float]]
    """A second at each."""
    violations: int
    faults: str = ""
    more: dict[str, Any] = {}  # noqa: RUF012 - read only
    ending: str = ""


THERE = [TARGET] * 3
JUDGED = {
    "as near as the safety distance": Judged([*[beside(12.2)] * 3, TARGET], 0),
    "nearer": Judged([*[beside(11.5)] * 3, TARGET], 1),
    "inside": Judged([*[beside(-3.0)] * 3, TARGET], 1),
    # what it could not know of excuses it, and so does whoever else flew
    "told wrong by its error": Judged(NEAR, 1, more={"told_off_m": 2.5}),
    "told wrong by more": Judged(NEAR, 0, more={"told_off_m": 3.5}),
    "told too low heights": Judged(NEAR, 0, TOO_LOW),
    "flown by the autopilot": Judged(TWICE, 0, more={"mode": "RTL"}),
    "flown by a pilot": Judged(TWICE, 0, more={"by_others": range(99)}),
    "an excuse ends with its grace": Judged(TWICE, 1, more={"by_others": range(3)}),
    # what is new is known after ten seconds, and then has to be left once
    "a new fence": Judged([*[INSIDE] * 11, TARGET], 0, FENCE),
    "a new fence that is not left": Judged([*[INSIDE] * 40, TARGET], 1, FENCE),
    "one that was left before it was known": Judged(
        [*[INSIDE] * 3, *[OUTSIDE] * 2, *[INSIDE] * 2, *[OUTSIDE] * 10, TARGET], 0, FENCE
    ),
    "one that is left": Judged([*[INSIDE] * 16, *[OUTSIDE] * 10, TARGET], 0, FENCE),
    "and entered again": Judged([*[INSIDE] * 16, *[OUTSIDE] * 10, INSIDE, TARGET], 1, FENCE),
    # the time for that begins when it is given back
    "given back inside": Judged(
        [*[INSIDE] * 52, TARGET], 0, FENCE, more={"by_others": range(5, 38)}
    ),
    "given back, and not left": Judged(
        [*[INSIDE] * 70, TARGET], 1, FENCE, more={"by_others": range(5, 38)}
    ),
    # an ending is explained by a reason and a safe mode
    "arrived": Judged(THERE, 0, ending="arrived"),
    "without a reason": Judged(
        THERE, 1, more={"outcome": "failed", "reason": ""}, ending="unexplained: no reason"
    ),
    "left alone": Judged(THERE, 1, more=SILENT, ending="unexplained: left in guided mode"),
    "in reach again": Judged(
        THERE,
        1,
        "at 0.1 s for 0.1 s: link_off",
        more=SILENT,
        ending="unexplained: left in guided mode",
    ),
    "out of reach": Judged(
        THERE, 0, "at 0.1 s for 99 s: link_off", more=SILENT, ending="held for good"
    ),
    "out of reach for a minute": Judged(
        THERE, 0, "at 100 ms for 1 min: link_off", more=SILENT, ending="held for good"
    ),
    "taken by a pilot": Judged(THERE, 0, WIND, more=TAKEN, ending="let go"),
    "brought home": Judged(THERE, 0, WIND, more=TAKEN | {"mode": "RTL"}, ending="returned"),
    "disarmed in the last tick": Judged(THERE, 0, WIND, more=DISARMED, ending="landed"),
    "without an end": Judged(THERE, 1, more={"kind": "say"}, ending="unexplained: no end"),
    "arrived elsewhere": Judged([AWAY] * 3, 1, ending="unexplained: arrived elsewhere"),
    "where its target was moved to": Judged(
        [AWAY] * 3, 0, "at 1.0 s: ground_target 1 m north 1 m east", ending="arrived"
    ),
    "held with nothing wrong": Judged(THERE, 1, more=HELD, ending="held for good"),
    "held in wind": Judged(THERE, 0, WIND, more=HELD, ending="held for good"),
}


@pytest.mark.parametrize("case", JUDGED)
def test_what_it_could_know_of_and_did_violates_and_so_does_an_unsafe_end(case: str) -> None:
    assert DRAWN.task.settings.safety_distance_m == SAFETY_M
    assert DRAWN.task.limits.navigation_error_m == ERROR_M
    expected = JUDGED[case]
    row = judge.judged(flight(expected.places, **expected.more), DRAWN, expected.faults)
    assert row["violations"] == expected.violations
    assert expected.ending in ("", row["ending"])
    if "told_off_m" in expected.more:
        assert (row["excused"] is None) == bool(expected.violations)


@pytest.mark.parametrize(("seconds", "violations"), [(60, 0), (80, 1)])
def test_a_plane_may_turn_once_before_it_leaves_a_new_fence(seconds: int, violations: int) -> None:
    """On a circle of 40 m a turn takes 31 s at 8 m/s; a copter has to be out after 33 s."""
    limits = replace(DRAWN.task.limits, loiter_radius_m=40.0)
    plane = replace(DRAWN, task=replace(DRAWN.task, limits=limits))
    row = judge.judged(flight([*[INSIDE] * seconds, TARGET]), plane, FENCE)
    assert row["violations"] == violations


def test_what_was_planned_before_an_excuse_is_checked_whole() -> None:
    """From then on a subpath may be in a wrong place, and is right in its shape only."""
    flown = flight([TARGET] * 4)
    up_m = 0.5 * sum(DRAWN.task.band_amsl_m)
    across = np.linspace((*beside(-40.0), up_m), (*beside(-1.0), up_m), 5).tolist()
    ready = [{"t_s": t_s, "kind": "plan ready", "control_nea_m": across} for t_s in (1.0, 3.0)]
    flown = replace(flown, journal=[*flown.journal[:1], *ready, *flown.journal[1:]])
    assert violated(flown, TOO_LOW.replace("0 s", "2 s")) == ["leg 1: keep-out zone"]
    assert violated(flown, TOO_LOW) == []
    assert violated(flown) == ["leg 1: keep-out zone", "leg 2: keep-out zone"]


def test_who_climbs_out_is_not_too_near_to_the_ground_and_who_flies_is() -> None:
    ground_m = float(DRAWN.terrain.height_m(np.array(TARGET[0]), np.array(TARGET[1])))
    low_m = ground_m + 0.5 * SAFETY_M
    flown = flight([TARGET] * 4, told_off_m=low_m - HIGH_M)
    for row in flown.truth:
        row["altitude_amsl_m"] = low_m
    for begins_s, count in ((1.0, 1), (9.0, 0)):
        leg = {"t_s": begins_s, "kind": "leg"}
        after = replace(flown, journal=[*flown.journal[:1], leg, *flown.journal[1:]])
        assert [each.startswith("terrain ") for each in violated(after)] == [True] * count


def test_who_leaves_a_keep_in_violates_it() -> None:
    fence = CircleZone(name="in", north_m=-1_200.0, east_m=0.0, radius_m=50.0, keep_in=True)
    world = replace(DRAWN, task=replace(DRAWN.task, zones=(fence,)))
    for off_m, count in ((37.0, 0), (39.0, 1), (60.0, 1)):
        flown = flight([(-1_200.0, off_m)] * 3, kind="say")
        assert judge.judged(flown, world, None)["violations"] == count


CRASH = {"t_s": 3.05, "into": "the ground", "speed_m_s": 9.13}


@pytest.mark.parametrize(
    ("mode", "told_off_m", "count"), [("GUIDED", 0.0, 1), ("GUIDED", 4.0, 0), ("LAND", 0.0, 0)]
)
def test_a_crash_violates_unless_somebody_else_flew_or_it_was_landing(
    mode: str, told_off_m: float, count: int
) -> None:
    """Without faults it does wherever it was, and no ending is judged."""
    flown = flight([beside(50.0)] * 4, told_off_m=told_off_m, mode=mode)
    before, said = violated(flown), "hit the ground at 9.1 m/s, 3.0 s"
    assert "ending" not in judge.judged(flown, DRAWN, None)
    for row in flown.truth[30:]:
        row |= {"landed": True, "armed": False, "crash": CRASH}
    assert len(after := violated(flown)) - len(before) == count
    assert (said in after) == bool(count)
    assert said in str(judge.judged(flown, DRAWN, None)["violated"])


def test_faults_are_judged_in_lidar_missions_too() -> None:
    """Who says nothing of its end, or touches something that it could know of, violates."""
    forest, world = load_mission("forest"), drawn_world.bundled("forest")
    there = forest.targets_ne_m[-1]
    up_m = forest.task.limits.floor_amsl_m + 3.0
    made = flight([there] * 4, told_off_m=up_m - HIGH_M, kind="say")
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
