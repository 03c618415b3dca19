"""What follows from a mission's settings, and which missions are refused before they fly."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import LARGE, limits

from companion.errors import InputError
from companion.path.envelope import ending_m_s, slowing_m
from companion.planner import rules
from companion.planner.settings import PlannerSettings, Task
from companion.profiles import FLIGHT, PAPER
from companion.world.zones import CircleZone

ENVIRONMENT_1 = Task(
    limits=LARGE,
    settings=PlannerSettings(
        scan_range_m=20_000.0, safety_distance_m=500.0, planning_time_s=5.0, scan_time_s=4.0
    ),
)


def test_the_profile_of_the_paper_is_the_papers() -> None:
    papers = replace(ENVIRONMENT_1, settings=replace(ENVIRONMENT_1.settings, profile=PAPER))
    assert papers.cell_m == 250.0  # R / 80
    assert (PAPER.samples, PAPER.margin, PAPER.optimiser) == (10, 1.0, "improved-de")
    assert papers.tail_m == papers.search_clearance_m == 500.0
    assert papers.end_radius_m == 20_000.0  # on the range of the scan
    assert papers.band_amsl_m == (3_000.0, 5_000.0)


def drawn(profile: Any, limits: dict[str, float], settings: dict[str, float]) -> Task:
    settled = replace(ENVIRONMENT_1.settings, profile=profile, **settings)
    return replace(ENVIRONMENT_1, limits=replace(LARGE, **limits), settings=settled)


tasks = st.builds(
    drawn,
    st.sampled_from([FLIGHT, PAPER]),
    st.fixed_dictionaries({
        "speed_m_s": st.floats(1.0, 300.0), "acceleration_m_s2": st.floats(0.5, 20.0),
        "dead_man_s": st.floats(0.0, 10.0), "tracking_error_m": st.floats(0.0, 60.0),
        "navigation_error_m": st.floats(0.0, 60.0),
    }),
    st.fixed_dictionaries({
        "scan_range_m": st.floats(100.0, 50_000.0), "safety_distance_m": st.floats(1.0, 600.0),
        "planning_time_s": st.floats(0.1, 20.0),
    }),
)  # fmt: skip


@given(task=tasks)
def test_the_scan_distance_keeps_equation_4_and_the_tail_holds_a_stop(task: Task) -> None:
    """And the search aims at more than the certificate asks for."""
    limits, settled = task.limits, task.settings
    d_s, speed = settled.safety_distance_m, limits.speed_m_s
    assert task.scan_distance_m >= speed * settled.planning_time_s + d_s
    assert task.tail_m >= d_s
    assert task.cell_m == int(task.cell_m) >= 1.0
    assert abs(task.cell_m - settled.scan_range_m / 80.0) <= 0.5 or task.cell_m == 1.0
    if settled.profile is FLIGHT:
        brakes_m = 0.5 * speed**2 / limits.acceleration_m_s2
        assert task.tail_m >= brakes_m + d_s - 1e-9
        # flying on for the dead man's time, and then braking
        assert task.tail_m >= speed * limits.dead_man_s + brakes_m - 1e-9
        error = limits.tracking_error_m + limits.navigation_error_m
        assert task.search_clearance_m >= task.required_clearance_m >= d_s
        assert 3_000.0 + error <= task.band_amsl_m[0]
        assert task.band_amsl_m[1] <= 5_000.0 - error
        assert task.band_amsl_m[0] <= task.take_off_amsl_m < task.band_amsl_m[1]


@given(
    task=tasks, share=st.floats(0.05, 1.5), loiter_m=st.sampled_from([0.0, 900.0]),
    amsl_m=st.floats(2_000.0, 5_000.0),
)  # fmt: skip
def test_a_slower_leg_turns_with_the_same_lateral_acceleration_and_planes_are_never_slower(
    task: Task, share: float, loiter_m: float, amsl_m: float
) -> None:
    """A floor may be raised and is never lowered."""
    low, high = task.band_amsl_m
    assert task.no_lower_than(amsl_m).band_amsl_m == pytest.approx((max(low, amsl_m), high))
    task = replace(task, limits=replace(task.limits, loiter_radius_m=loiter_m))
    limits, speed_m_s = task.limits, share * task.limits.speed_m_s
    slow = task.at_speed(speed_m_s)
    assert task.at_speed(None) is task
    if share >= 1.0 or loiter_m:
        assert slow is task
        return
    assert slow.limits.speed_m_s == speed_m_s
    sideways_m_s2 = limits.speed_m_s**2 / limits.turn_radius_m
    assert speed_m_s**2 / slow.limits.turn_radius_m == pytest.approx(sideways_m_s2)


@given(task=tasks)
def test_who_is_left_alone_near_the_end_of_sight_stays_over_ground_that_was_scanned(
    task: Task,
) -> None:
    planner = replace(ENVIRONMENT_1.settings, safety_distance_m=task.settings.safety_distance_m)
    task = replace(task, settings=planner)
    speed, limits = min(task.limits.speed_m_s, 200.0), task.limits
    task = replace(task, limits=replace(limits, speed_m_s=speed))
    before_end_m = slowing_m(task.envelope, speed) * np.linspace(0.0, 1.0, 400) ** 2
    slowing = np.array([ending_m_s(task.envelope, left_m) for left_m in before_end_m.tolist()])
    brakes_m = slowing**2 / (2.0 * limits.acceleration_m_s2)
    beyond_m = slowing * limits.dead_man_s + brakes_m - before_end_m
    farthest_m = task.end_radius_m + beyond_m.max() + task.error_m
    cell_diagonal_m = math.hypot(task.cell_m, task.cell_m)  # a cell is seen by its middle
    assert farthest_m <= task.settings.scan_range_m - cell_diagonal_m
    assert task.end_radius_m + task.required_clearance_m <= 20_000.0 - cell_diagonal_m


# --- rules

COPTER = limits(
    speed_m_s=8.0, acceleration_m_s2=2.0, climb_rate_m_s=2.5, turn_radius_m=25.0,
    climb_angle_rad=0.3, dive_angle_rad=0.3, floor_amsl_m=500.0, ceiling_amsl_m=660.0,
    north_m=(-5000.0, 5000.0), east_m=(-5000.0, 5000.0),
)  # fmt: skip
PLANE = replace(COPTER, speed_m_s=18.0, turn_radius_m=80.0, loiter_radius_m=80.0)
SETTINGS = PlannerSettings(scan_range_m=2000.0, safety_distance_m=40.0, planning_time_s=3.0)
LEAST_L_M = Task(limits=COPTER, settings=SETTINGS).shortest_scan_distance_m
TIGHTEST_M = 18.0**2 / 9.81  # tan(45 degrees) = 1


def changed(base: Any, changes: dict[str, Any]) -> Task:
    """A task with changes of its limits, its settings or itself."""
    of = [replace(held, **{k: v for k, v in changes.items() if hasattr(held, k)})
          for held in (base, SETTINGS)]  # fmt: skip
    return Task(
        limits=of[0], settings=of[1], stated_ground_amsl_m=changes.get("stated_ground_amsl_m")
    )


@pytest.mark.parametrize(
    ("base", "passes", "breaks", "field"),
    [
        (COPTER, {"north_m": (0.0, 500.0)}, {"north_m": (1.0, 1.0)}, "area.north_max_m"),
        (COPTER, {"east_m": (0.0, 500.0)}, {"east_m": (1.0, -1.0)}, "area.east_max_m"),
        (COPTER, {"ceiling_amsl_m": 540.1}, {"ceiling_amsl_m": 540.0}, "altitude.ceiling_amsl_m"),
        (COPTER, {"north_m": (0.0, 1.5e6)}, {"north_m": (0.0, 1.6e6)}, "planner.scan_range_m"),
        (COPTER, {"scan_distance_m": LEAST_L_M}, {"scan_distance_m": LEAST_L_M - 0.1},
         "planner.scan_distance_m"),
        (COPTER, {"speed_m_s": 20.0}, {"speed_m_s": 200.0}, "planner.planning_time_s"),
        (COPTER, {"scan_time_s": 3.31}, {"scan_time_s": 3.2}, "planner.scan_time_s"),
        (COPTER, {"turn_radius_m": 3.3}, {"turn_radius_m": 3.1}, "vehicle.turn_radius_m"),
        (COPTER, {"turn_radius_m": 999.0}, {"turn_radius_m": 1001.0}, "vehicle.turn_radius_m"),
        (PLANE, {"turn_radius_m": TIGHTEST_M + 0.01}, {"turn_radius_m": TIGHTEST_M - 0.01},
         "vehicle.turn_radius_m"),
        (PLANE, {"loiter_radius_m": TIGHTEST_M + 0.01}, {"loiter_radius_m": TIGHTEST_M - 0.01},
         "vehicle.loiter_radius_m"),
        (PLANE, {"loiter_radius_m": 500.0}, {"loiter_radius_m": 800.0}, "vehicle.loiter_radius_m"),
        (COPTER, {"stated_ground_amsl_m": 459.0}, {"stated_ground_amsl_m": 461.0},
         "altitude.floor_amsl_m"),
    ],
)  # fmt: skip
def test_a_broken_rule_is_told_in_one_line_by_the_field_of_a_mission_file(
    base: Any, passes: dict[str, Any], breaks: dict[str, Any], field: str
) -> None:
    assert not list(rules.of_task(changed(base, passes)))
    with pytest.raises(InputError) as caught:
        rules.refuse(rules.of_task(changed(base, breaks)), "x: ")
    assert caught.value.field == f"x: {field}"
    assert len(str(caught.value).splitlines()) == 1


@settings(max_examples=50)
@given(st.floats(8.0, 300.0))
def test_a_copter_flies_as_fast_as_it_sees_and_no_slower_than_half_of_what_is_asked(
    asked_m_s: float,
) -> None:
    task = changed(COPTER, {"speed_m_s": asked_m_s, "turn_radius_m": 60.0})

    def is_short(task: Task) -> bool:
        return "planner.planning_time_s" in [field for field, *_ in rules.of_task(task)]

    slowed = rules.slowed_to_sight(task)
    flown_m_s = slowed.limits.speed_m_s
    as_asked = not is_short(task) or is_short(task.at_speed(0.5 * asked_m_s + 0.1))
    too_tight = asked_m_s**2 / 60.0 > 20.0  # m/s2: refused at any speed
    assert (slowed is task) == (as_asked or too_tight)
    if slowed is not task:
        assert 0.5 * asked_m_s <= flown_m_s < asked_m_s
        assert not is_short(slowed)
        assert is_short(task.at_speed(min(flown_m_s + 0.1, asked_m_s)))
        asked, flown = task.limits, slowed.limits
        assert flown_m_s**2 / flown.turn_radius_m == pytest.approx(
            asked_m_s**2 / asked.turn_radius_m
        )


def test_a_change_is_refused_for_what_it_breaks_not_for_what_was_broken() -> None:
    fine, target = Task(limits=COPTER, settings=SETTINGS), (0.0, 0.0)
    low, tight = (changed(COPTER, {key: 3.1}) for key in ("ceiling_amsl_m", "turn_radius_m"))
    both = replace(low, limits=replace(low.limits, turn_radius_m=3.1))
    told = [rules.newly_broken(a, b, target) for a, b in ((fine, low), (tight, both), (both, low))]
    assert [error and error.field for error in told] == [*["altitude.ceiling_amsl_m"] * 2, None]


def test_a_target_must_lie_on_the_map_outside_keep_outs_and_inside_keep_ins() -> None:
    zones = (
        CircleZone(name="out", north_m=1000.0, east_m=0.0, radius_m=300.0),
        CircleZone(name="in", north_m=0.0, east_m=0.0, radius_m=3000.0, keep_in=True),
    )
    task = Task(limits=COPTER, settings=SETTINGS, zones=zones)
    rules.refuse(rules.of_target(task, (0.0, 0.0), "target"))
    assert rules.target_refusal(task, (0.0, 0.0)) == ""
    for place, words in (
        ((6000.0, 0.0), "outside the map"), ((4990.0, 0.0), "to the edge of the map"),
        ((-4990.0, 0.0), "to the edge of the map"), ((0.0, 4990.0), "to the edge of the map"),
        ((0.0, -4990.0), "to the edge of the map"), ((1000.0, 0.0), "inside keep-out 'out'"),
        ((1320.0, 0.0), "to keep-out 'out'"), ((0.0, 3100.0), "outside keep-in 'in'"),
        ((0.0, -2990.0), "to the edge of keep-in 'in'"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            rules.refuse(rules.of_target(task, place, "target"))
        assert rules.target_refusal(task, place).startswith("the target: it lies ")
    plane = Task(limits=PLANE, settings=SETTINGS, zones=zones[1:])
    edge_m = 3000.0 - plane.required_clearance_m - 80.0  # its circle stays within
    assert rules.target_refusal(plane, (0.0, edge_m - 2.5)) == ""
    assert "the circle that a plane holds on" in rules.target_refusal(plane, (0.0, edge_m + 1.0))


# --- polygons


@pytest.mark.parametrize(
    ("corners", "words"),
    [
        (((0.0, 0.0), (1.0, 1.0)), "three or more"),
        (((0.0, 0.0), (9.0, 9.0), (0.0, 0.0)), "three or more"),
        (((0.0, 0.0), (50.0, 0.0), (100.0, 0.0)), "no area"),
        (((0.0, 0.0), (9.0, 9.0), (9.0, 0.0), (0.0, 9.0)), "corners 0 and 2"),
        (((0.0, 0.0), (9.0, 0.0), (9.0, 9.0), (4.0, -1.0), (0.0, 9.0)), "corners 0 and 2"),
        (((0.0, 0.0), (9.0, 0.0), (9.0, 9.0), (4.0, 0.0), (0.0, 9.0)), ""),  # it only touches
        (tuple((math.cos(k / 320.0), math.sin(k / 320.0)) for k in range(2001)), "2000 corners"),
    ],
)
def test_a_polygon_without_a_clear_inside_or_with_too_many_corners_is_refused(
    corners: tuple[tuple[float, float], ...], words: str
) -> None:
    told = " ".join(
        str(part) for broken in rules.of_polygon(corners, "f", "zone") for part in broken
    )
    assert words in told if words else told == ""
    assert words != "2000 corners" or not list(rules.of_polygon(corners[:-1], "f", ""))
