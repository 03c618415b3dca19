"""What is drawn to go wrong, and how flights with it are judged."""

import json
import tempfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.campaign import drawn_faults, drawn_world, families, in_process, judge
from companion.campaign.drawn_faults import FAMILIES, FaultScript, ways
from companion.campaign.in_process import Flight, FlightFiles
from companion.config import load_mission
from companion.errors import InputError
from companion.mission.state import Reason
from companion.world.zones import CircleZone
from vehicle_sim import faults
from vehicle_sim.faults import COMPANION_OFF, Timeline

VEHICLES = ("ardupilot-copter", "ardupilot-plane", "px4-copter", "px4-plane")
DRAWN = families.world("short-copter", 1, 0)
with tempfile.TemporaryDirectory() as _folder:
    MISSION = load_mission(str(drawn_world.write(DRAWN, Path(_folder))[1]))
HIGH_M = 1_500.0
TARGET = DRAWN.targets_ne_m[-1]
SAFETY_M = 12.0
"""The safety distance of the world that is drawn; the error of its position is 3 m."""


# --- draws


def drawn(family: str, seed: int, count: int, vehicle: str) -> list[tuple[str, str]]:
    """Names and timelines of so many scripts."""
    scripts = [FaultScript(family=family, seed=seed, index=index) for index in range(count)]
    return [drawn_faults.drawn(script, vehicle, 10.0) for script in scripts]


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("family", FAMILIES)
def test_a_script_can_be_flown_and_is_the_same_again(family: str, vehicle: str) -> None:
    """Singles go through all that the vehicle can have."""
    found = drawn(family, 3, 60, vehicle)
    assert found == drawn(family, 3, 60, vehicle)
    assert found[0] != drawn(family, 4, 1, vehicle)[0]
    if family == "single":
        can = {w.name for w in ways() if not (w.not_on and vehicle.startswith(w.not_on))}
        assert {name for name, _ in found} == can
    for _, timeline in found:
        entries = faults.entries(timeline)
        assert len(entries) == len(timeline.splitlines())
        if all(each.fault.name != COMPANION_OFF for each in entries):
            Timeline(timeline)
    assert len({timeline for _, timeline in found}) > 50


# --- the judge

Places = list[tuple[float, float]]


def flight(
    places: Places,
    *,
    told_off_m: float = 0.0,
    believed: Places | None = None,
    mode: str = "GUIDED",
    by_others: range = range(0),
    up_m: float = HIGH_M,
    **end: Any,
) -> Flight:
    """A second at each place, at a height where there is no ground in the way.

    by_others: the places over which a copter's pilot flies it.
    believed: where its autopilot then believes to be; None: the truth does not tell.
    """
    truth = list[dict[str, Any]]()
    for k in range(10 * len(places)):
        north_m, east_m = places[k // 10]
        row = {"t_s": round(0.1 * (k + 1), 1), "north_m": north_m, "east_m": east_m}
        row |= {"altitude_amsl_m": up_m, "mode": "LOITER" if k // 10 in by_others else mode}
        row |= {"velocity_north_m_s": 0.0, "velocity_east_m_s": 0.0}
        if believed is not None:
            row["believed"] = row | dict(zip(("north_m", "east_m"), believed[k // 10], strict=True))
        truth.append(row | {"armed": True, "landed": False})
    begun = {"t_s": 0.0, "kind": "phase", "phase": "flying", "code": None, "reason": None}
    ended = {"t_s": truth[-1]["t_s"], "kind": "end", "outcome": "arrived", "reason": "there"}
    names = ("t_s", "t_s", "north_m", "east_m", "altitude_amsl_m")
    told = np.array([[row[name] for name in names] for row in truth])
    told[:, -1] += told_off_m
    journal = [begun, ended | end]
    return Flight(mission=MISSION, journal=journal, truth=truth, plans_s=[], reported=told)


def violated(flown: Flight, timeline: str | None = "", world: Any = DRAWN) -> list[str]:
    row = judge.judged(flown, world, timeline)
    found = str(row["violated"] or "").split("; ") if row["violated"] else []
    assert len(found) == row["violations"]
    return found


def beside(gap_m: float) -> tuple[float, float]:
    """A place so far from the northern edge of the first keep-out, where no other is."""
    zone = DRAWN.task.zones[0]
    assert isinstance(zone, CircleZone)
    return zone.north_m + zone.radius_m + gap_m, zone.east_m


def there(*seconds: tuple[int, tuple[float, float]]) -> Places:
    """So many seconds at each place, and then at the target."""
    return [*(place for count, place in seconds for _ in range(count)), TARGET]


def with_task(**changes: Any) -> Any:
    return replace(DRAWN, task=replace(DRAWN.task, **changes))


INSIDE, OUTSIDE = (-1_200.0, -1_200.0), (-1_150.0, -1_200.0)  # of a circle of 30 m that is drawn
FENCE, AWAY = "at 2.0 s: ground_fence 30 m", [(TARGET[0] - 200.0, TARGET[1])] * 3
TOO_LOW = "at 0 s: radar_noise 5 m either_way"
OFF, LONG = "at 0.1 s for 0.1 s: link_off", "at 100 ms for 1 min: link_off"
MOVED, WIND = "at 1.0 s: ground_target 1 m north 1 m east", "at 0.1 s: turbulence 1 m/s"
FAILED = {"outcome": "failed"}
SILENT = FAILED | {"reason": "the vehicle fell silent"}
HELD = FAILED | {"mode": "BRAKE", "reason": "no way"}
TAKEN = FAILED | {"mode": "LOITER", "reason": Reason.MODE_TAKEN.text}
NEAR, CLEAR = there((3, beside(0.0))), there((3, beside(12.2)))
NEARER = [*CLEAR[:2], beside(11.5), TARGET]
SOON, LATE = there((10, beside(0.0))), there((12, beside(0.0)))
TWICE = there((3, beside(0.0)), (5, TARGET), (10, beside(0.0)))
LEFT = [(16, INSIDE), (10, OUTSIDE)]
BEFORE = there((3, INSIDE), (2, OUTSIDE), (2, INSIDE), (10, OUTSIDE))
BACK = {"by_others": range(5, 38)}
THERE = [TARGET] * 3
ALONE = "unexplained: left in guided mode"
# on a circle of 40 m a turn takes 31 s at 8 m/s; a copter has to be out after 33 s
PLANE = {"world": with_task(limits=replace(DRAWN.task.limits, loiter_radius_m=40.0))}
# 10 m below where it plans from: at half of 1.5 m/s 13 s more
LOW = {"up_m": DRAWN.task.take_off_amsl_m - 10.0}
COUNTY = CircleZone(name="in", north_m=-1_200.0, east_m=0.0, radius_m=50.0, keep_in=True)
COUNTY_ALONE = {"kind": "say", "world": with_task(zones=(COUNTY,))}
JUDGED: dict[str, tuple[Places, str | None, dict[str, Any], int, str]] = {
    "as near as the safety distance": (there((3, beside(12.2))), "", {}, 0, ""),
    "nearer": (there((3, beside(11.5))), "", {}, 1, ""),
    # what it could not know of excuses it, and so does whoever else flew
    "told wrong by its error": (NEAR, "", {"told_off_m": 2.5}, 1, ""),
    "told wrong by more": (NEAR, "", {"told_off_m": 3.5}, 0, ""),
    # untold, its autopilot's own error does where that believed to be clear; then comes a grace
    "misled": (NEAR, "", {"believed": CLEAR}, 0, ""),
    "misled, and near there too": (NEAR, "", {"believed": NEARER}, 1, ""),
    "misled by its error": (there((3, beside(10.0))), "", {"believed": CLEAR}, 1, ""),
    "right again, and gone": (SOON, "", {"believed": [*CLEAR[:1], *SOON[1:]]}, 0, ""),
    "right again, and not gone": (LATE, "", {"believed": [*CLEAR[:1], *LATE[1:]]}, 1, ""),
    "told too low heights": (NEAR, TOO_LOW, {}, 0, ""),
    "flown by the autopilot": (TWICE, "", {"mode": "RTL"}, 0, ""),
    "flown by a pilot": (TWICE, "", {"by_others": range(99)}, 0, ""),
    "an excuse ends with its grace": (TWICE, "", {"by_others": range(3)}, 1, ""),
    # what is new is known after ten seconds, and then has to be left once
    "a new fence": (there((11, INSIDE)), FENCE, {}, 0, ""),
    "a new fence that is not left": (there((40, INSIDE)), FENCE, {}, 1, ""),
    "one that was left before it was known": (BEFORE, FENCE, {}, 0, ""),
    "one that is left": (there(*LEFT), FENCE, {}, 0, ""),
    "and entered again": (there(*LEFT, (1, INSIDE)), FENCE, {}, 1, ""),
    "one that it climbs in": (there((44, INSIDE)), FENCE, LOW, 0, ""),
    "one that it does not climb out of": (there((50, INSIDE)), FENCE, LOW, 1, ""),
    "one that a plane turns in once": (there((60, INSIDE)), FENCE, PLANE, 0, ""),
    "one that a plane does not leave": (there((80, INSIDE)), FENCE, PLANE, 1, ""),
    "within a keep-in": ([(-1_200.0, 37.0)] * 3, None, COUNTY_ALONE, 0, ""),
    "near its edge": ([(-1_200.0, 39.0)] * 3, None, COUNTY_ALONE, 1, ""),
    # the time for that begins when it is given back
    "given back inside": (there((52, INSIDE)), FENCE, BACK, 0, ""),
    "given back, and not left": (there((70, INSIDE)), FENCE, BACK, 1, ""),
    # an ending is explained by a reason and a safe mode
    "arrived": (THERE, "", {}, 0, "arrived"),
    "without a reason": (THERE, "", FAILED | {"reason": ""}, 1, "unexplained: no reason"),
    "in reach again": (THERE, OFF, SILENT, 1, ALONE),
    "out of reach": (THERE, LONG, SILENT, 0, "held for good"),
    "taken by a pilot": (THERE, WIND, TAKEN, 0, "let go"),
    "brought home": (THERE, WIND, TAKEN | {"mode": "RTL"}, 0, "returned"),
    "disarmed": (THERE, WIND, FAILED | {"reason": Reason.DISARMED.text}, 0, "landed"),
    "without an end": (THERE, "", {"kind": "say"}, 1, "unexplained: no end"),
    "arrived elsewhere": (AWAY, "", {}, 1, "unexplained: arrived elsewhere"),
    "where its target was moved to": (AWAY, MOVED, {}, 0, "arrived"),
    "held with nothing wrong": (THERE, "", HELD, 1, "held for good"),
    "held in wind": (THERE, WIND, HELD, 0, "held for good"),
}


@pytest.mark.parametrize("case", JUDGED)
def test_what_it_could_know_of_and_did_violates_and_so_does_an_unsafe_end(case: str) -> None:
    places, timeline, more, violations, ending = JUDGED[case]
    world = more.get("world", DRAWN)
    changes = {name: value for name, value in more.items() if name != "world"}
    row = judge.judged(flight(places, **changes), world, timeline)
    assert row["violations"] == violations
    assert ending in ("", row.get("ending"))
    if "told_off_m" in more:
        assert (row["excused"] is None) == bool(violations)


@pytest.mark.parametrize(
    ("cut_s", "ending"), [(9, "on its way back"), (11, "unexplained: flies on")]
)
def test_a_way_back_may_be_flown_for_as_long_as_the_way_out_was(cut_s: float, ending: str) -> None:
    held = {"kind": "phase", "phase": "holding", "code": "NO_PLAN", "reason": "no way"}
    back = {"t_s": 5.0, "kind": "phase", "phase": "returning", "code": None, "reason": None}
    flown = flight([TARGET] * 12, t_s=11.5, outcome="stopped")
    flown.journal[1:1] = [held | {"t_s": 4.0}, back, {"t_s": cut_s, "kind": "stop asked"}]
    row = judge.judged(flown, DRAWN, WIND)
    assert (row["ending"], row["violations"]) == (ending, int(cut_s == 11))
    assert row["reason"] == ("no way" if cut_s == 9 else "returning: ")


@pytest.mark.parametrize(
    ("places", "words"),
    [(CLEAR, None), (NEAR, f"{DRAWN.task.zones[0].name} -0.0 m from"), ([], "never flown")],
)
def test_a_run_folder_with_the_truth_in_it_is_judged_alike(
    places: Places, words: str | None, tmp_path: Path
) -> None:
    flown, (world, _) = flight([*places, TARGET]), drawn_world.write(DRAWN, tmp_path)
    truth = flown.truth if places else []
    for name, lines in {"journal": flown.journal, "truth": truth}.items():
        text = "\n".join(map(json.dumps, lines))
        (tmp_path / f"{name}.jsonl").write_text(text, encoding="utf-8")
    found = judge.verified(tmp_path, str(world))
    assert found == words if words is None else words in str(found)


def test_what_was_planned_before_an_excuse_is_checked_whole() -> None:
    """From then on a subpath may be in a wrong place, and is right in its shape only."""
    up_m = 0.5 * sum(DRAWN.task.band_amsl_m)
    across = np.linspace((*beside(-40.0), up_m), (*beside(-1.0), up_m), 5).tolist()
    flown = flight([TARGET] * 4)
    for t_s in (1.0, 3.0):
        flown.journal.append({"t_s": t_s, "kind": "plan ready", "control_nea_m": across})
    assert violated(flown, TOO_LOW.replace("0 s", "2 s")) == ["leg 1: keep-out zone"]
    assert violated(flown, TOO_LOW) == []
    assert violated(flown) == ["leg 1: keep-out zone", "leg 2: keep-out zone"]


def test_who_climbs_out_is_not_too_near_to_the_ground_and_who_flies_is() -> None:
    ground_m = float(DRAWN.terrain.height_m(np.array(TARGET[0]), np.array(TARGET[1])))
    low = flight([TARGET] * 4, up_m=ground_m + 0.5 * SAFETY_M)
    for begins_s, violations in ((9.0, 0), (1.0, 1)):
        low.journal.append({"t_s": begins_s, "kind": "leg"})
        found = violated(low)
        assert [each.startswith("terrain ") for each in found] == [True] * violations
    for row in low.truth:
        row["believed"] = row | {"altitude_amsl_m": HIGH_M}
    assert violated(low) == []


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
    assert said in violated(flown, None)


def test_a_reset_that_nobody_could_tell_it_of_is_the_simulators_to_tell(tmp_path: Path) -> None:
    """Its link is off, and it holds 42 m beside where it believes to be."""
    world, mission = drawn_world.write(DRAWN, tmp_path / "files")
    timeline = "at 68 s: link_off\nat 70 s: estimator_reset 42 m north"
    files = FlightFiles(world=world, mission=mission, faults=timeline, folder=tmp_path)
    flown = in_process.fly_here(files, seed=1, limit_s=84.0)
    last = flown.truth[-1]
    assert last["believed"]["north_m"] - last["north_m"] == pytest.approx(42.0, abs=0.5)
    here = CircleZone(name="here", north_m=last["north_m"], east_m=last["east_m"], radius_m=5.0)
    assert violated(flown, timeline, with_task(zones=(here,))) == []
    for row in flown.truth:
        row.pop("believed", None)  # as in older files
    assert len(violated(flown, timeline, with_task(zones=(here,)))) == 1


def test_faults_are_judged_in_lidar_missions_too() -> None:
    """Who touches something that it could know of violates."""
    forest, world = load_mission("forest"), drawn_world.bundled("forest")
    up_m = forest.task.limits.floor_amsl_m + 3.0
    touching = replace(flight([forest.targets_ne_m[-1]] * 4, up_m=up_m), mission=forest)
    for number, row in enumerate(touching.truth):
        row["near_m"] = abs(2.0 - 0.1 * number)
    said = "touched something at 2.1 s"
    assert violated(touching, "", world) == violated(touching, None, world) == [said]
    for row in touching.truth:
        row["mode"] = "LOITER"  # a pilot
    found = judge.judged(touching, world, "")
    assert (said in found["excused"], found["clearance_least_m"]) == (True, 0.0)


def test_without_a_simulator_that_can_say_what_may_go_wrong_there_is_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for installed in ([], [SimpleNamespace(load=lambda: print)]):  # none, or an older one
        monkeypatch.setattr(in_process, "entry_points", lambda found=installed, **_: found)
        with pytest.raises(InputError, match=r"^[^\n]*Install the project again[^\n]*$"):
            in_process.simulator.__wrapped__()
