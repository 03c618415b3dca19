import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import limits

from companion.errors import InputError
from companion.planner import rules
from companion.planner.settings import PlannerSettings, Task
from companion.world.zones import CircleZone

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
