import dataclasses
import math
from typing import Any

import faults_judge
import pair_worlds
import pytest
from faults_trials import is_near, trials
from pair import Flown, Sample

from companion.world.threats import CircleZone
from vehicle_sim.faults.catalogue import FAULTS

SCENE = pair_worlds.scene("ardupilot", "copter", 1)
HIGH_M = 600.0


def flight(
    places: list[tuple[float, float]],
    *,
    told_off_m: float = 0.0,
    mode: str = "GUIDED",
    phase: str = "flying",
    **changes: Any,
) -> Flown:
    """A second at each place, at a height where there is no ground in the way."""
    flown = Flown(scene=SCENE, airborne_s=0.0, outcome="arrived", reason="target reached")
    for k in range(10 * len(places)):
        t_s = round(0.1 * (k + 1), 1)
        north_m, east_m = places[k // 10]
        row = {"t_s": t_s, "north_m": north_m, "east_m": east_m, "altitude_amsl_m": HIGH_M}
        flown.truth.append({**row, "mode": mode, "armed": True, "landed": False})
        told = (north_m + told_off_m, east_m, HIGH_M)
        flown.samples.append(
            Sample(t_s=t_s, phase=phase, reason="", believed_nea_m=told, believed_at_s=t_s)
        )
        flown.received_s.append(t_s)
    for name, value in changes.items():
        setattr(flown, name, value)
    return flown


def zone() -> CircleZone:
    found = SCENE.mission.task.zones[0]
    assert isinstance(found, CircleZone)
    return found


def beside(gap_m: float) -> tuple[float, float]:
    """A place so far from the edge of the first keep-out."""
    return zone().north_m + zone().radius_m + gap_m, zone().east_m


def test_every_fault_of_the_catalogue_has_a_trial() -> None:
    names = [trial.name for trial in trials()]
    faults = [fault.name for fault in FAULTS if not is_near(fault.name)]
    assert names[: len(faults)] == faults
    assert len(set(names)) == len(names) > len(faults)


@pytest.mark.parametrize(("gap_m", "violations"), [(12.2, 0), (11.5, 1), (-3.0, 1)])
def test_who_is_nearer_than_the_safety_distance_violates_it(gap_m: float, violations: int) -> None:
    assert SCENE.safety_m == 12.0
    verdict = faults_judge.judge(flight([beside(gap_m)] * 3))
    assert verdict.violations == violations
    assert verdict.zone_known_m == pytest.approx(gap_m)
    assert verdict.inside_s == pytest.approx(3.0 if gap_m < 0.0 else 0.0)


def test_a_position_that_was_told_wrong_excuses_and_one_within_its_error_does_not() -> None:
    assert SCENE.mission.task.limits.navigation_error_m == 3.0
    assert faults_judge.judge(flight([beside(0.0)] * 3, told_off_m=3.5)).violations == 0
    assert faults_judge.judge(flight([beside(0.0)] * 3, told_off_m=2.5)).violations == 1


def test_an_excuse_ends_with_its_grace() -> None:
    places = [beside(0.0)] * 3 + [beside(50.0)] * 5
    late = faults_judge.judge(flight([*places, *[beside(0.0)] * 4], mode="RTL"))
    assert late.violations == 0
    flown = flight([*places, *[beside(0.0)] * 10])
    for row in flown.truth[:30]:
        row["mode"] = "LOITER"
    assert faults_judge.judge(flown).violations == 1
    for row in flown.truth:
        row["mode"] = "LOITER"  # a copter's pilot
    assert faults_judge.judge(flown).violations == 0


def test_a_new_fence_is_known_after_ten_seconds_and_then_has_to_be_left_once() -> None:
    new = CircleZone(name="new", north_m=-200.0, east_m=-200.0, radius_m=30.0)
    inside, outside = (-200.0, -200.0), (-150.0, -200.0)
    fences = [(2.0, (new,))]
    stays = [inside] * 40
    assert faults_judge.judge(flight(stays[:11], fences=fences)).violations == 0
    assert faults_judge.judge(flight(stays, fences=fences)).violations == 1
    leaves = [inside] * 16 + [outside] * 10
    assert faults_judge.judge(flight(leaves, fences=fences)).violations == 0
    assert faults_judge.judge(flight([*leaves, inside], fences=fences)).violations == 1


def test_a_silence_is_counted_in_guided_mode_only() -> None:
    flown = flight([(0.0, 0.0)] * 10)
    flown.received_s = [t for t in flown.received_s if not 3.0 < t < 7.0]
    assert faults_judge.judge(flown).silent_s == pytest.approx(3.9)
    for row in flown.truth:
        row["mode"] = "BRAKE"
    assert faults_judge.judge(flown).silent_s == 0.0


@pytest.mark.parametrize(
    ("changes", "outcome"),
    [
        ({}, "arrived"),
        ({"died": "ValueError: no"}, "unexplained: the companion died"),
        ({"outcome": "failed", "reason": ""}, "unexplained: no reason"),
        ({"outcome": "failed", "reason": "the radar did not"}, "unexplained: left in guided mode"),
        ({"airborne_s": math.inf, "reason": "it would not arm"}, "refused"),
        ({"airborne_s": math.inf, "reason": ""}, "unexplained: never flew"),
    ],
)
def test_an_ending_is_explained_by_a_reason_and_a_safe_mode(
    changes: dict[str, Any], outcome: str
) -> None:
    target = SCENE.mission.targets_ne_m[-1]
    assert faults_judge.judge(flight([target] * 3, **changes)).outcome == outcome


def test_who_says_that_it_arrived_somewhere_else_is_found_out() -> None:
    verdict = faults_judge.judge(flight([(0.0, 0.0)] * 3))
    assert verdict.outcome == "unexplained: arrived elsewhere"
    there = dataclasses.asdict(faults_judge.judge(flight([(0.0, 0.0)] * 3, target_ne_m=(1.0, 1.0))))
    assert there["outcome"] == "arrived"
