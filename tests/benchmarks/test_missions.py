import math
from dataclasses import replace

import missions
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.campaign import drawn_world

FloatArray = NDArray[np.float64]

CURVE = np.array([[0.0, 0, 3_100], [6e3, 0, 3_100], [9e3, 4e3, 3_400], [12e3, 11e3, 3_300]])


def split(control: FloatArray, at: float) -> tuple[FloatArray, FloatArray]:
    """De Casteljau: the two parts of a cubic Bezier curve."""
    rows = [control]
    while len(rows[-1]) > 1:
        rows.append((1 - at) * rows[-1][:-1] + at * rows[-1][1:])
    return np.array([row[0] for row in rows]), np.array([row[-1] for row in rows[::-1]])


def test_a_curve_goes_over_into_its_own_rest_without_a_jump() -> None:
    _, rest = split(CURVE, 0.6)
    found = missions.join(CURVE, rest, drawn_world.bundled("environment-2"))
    assert found.worst < 1e-9


def test_a_join_that_turns_jumps_by_the_angle() -> None:
    _, rest = split(CURVE, 0.6)
    angle = 0.01
    turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0]])
    turn = np.vstack([turn, [0.0, 0.0, 1.0]])
    turned = rest[0] + (rest - rest[0]) @ turn.T
    found = missions.join(CURVE, turned, drawn_world.bundled("environment-2"))
    assert found.position < 1e-12
    tangent = rest[1] - rest[0]
    level = np.linalg.norm(tangent[:2]) / np.linalg.norm(tangent)
    assert found.tangent == pytest.approx(2.0 * math.sin(0.5 * angle) * level, rel=1e-6)


def test_a_join_from_a_straight_line_jumps_by_the_curvature_of_the_next() -> None:
    line = np.array([[n, 0.0, 3_100.0] for n in (0.0, 3e3, 6e3, 9e3)])
    h, r2 = 700.0, 2_000.0
    bent = np.array([[8e3, 0, 3_100], [8e3 + r2, 0, 3_100], [14e3, h, 3_100], [18e3, 4e3, 3_100]])
    found = missions.join(line, bent, drawn_world.bundled("environment-2"))
    assert found.position < 1e-12
    assert found.tangent < 1e-12
    assert found.curvature == pytest.approx(2_500.0 * 2.0 / 3.0 * h / r2**2, rel=1e-9)


def test_a_join_beside_the_curve_jumps_in_position() -> None:
    line = np.array([[n, 0.0, 3_100.0] for n in (0.0, 3e3, 6e3, 9e3)])
    beside = line + np.array([7e3, 2.0, 0.0])
    found = missions.join(line, beside, drawn_world.bundled("environment-2"))
    assert found.position == pytest.approx(2.0 / 20_000.0)


def result(**changes: object) -> missions.MissionResult:
    base = missions.MissionResult(
        world="dense-1", seed=1, arrived=True, failure="", subpaths=9, stops=0, cost=30.0,
        best_cost=30.0, length_m=142e3, best_length_m=142e3, shortest_m=142e3,
        worst={"clearance_m": 530.0, "highest_amsl_m": 3_100.0}, radar_m=0.0, violations=(),
        flown_violations=0, joins=(missions.Join(position=0.0, tangent=0.0, curvature=1e-9),),
        plan_s=(0.01,) * 9,
    )  # fmt: skip
    return replace(base, **changes)


def test_the_bars_are_kept_by_a_perfect_planner() -> None:
    assert missions.kept(missions.summary([result()] * 10))


@pytest.mark.parametrize(
    "changes",
    [
        {"arrived": False},
        {"cost": 32.0},
        {"length_m": 190e3},
        {"violations": ("leg 2: turn radius",)},
        {"joins": (missions.Join(position=0.0, tangent=0.0, curvature=1e-4),)},
    ],
)
def test_a_bar_is_missed_when_most_missions_miss_it(changes: dict[str, object]) -> None:
    assert not missions.kept(missions.summary([result(), *[result(**changes)] * 3]))


def test_violating_subpaths_are_counted_once_each() -> None:
    broken = ("leg 2: turn radius", "leg 2: climb angle", "leg 5: turn radius")
    figures = missions.summary([result(violations=broken), result()])
    assert figures["subpaths_violating"] == 2
    assert figures["missions_violating"] == 1
    assert figures["violations"] == {"climb angle": 1, "turn radius": 2}


def beside(rival_cost: float, **changes: object) -> missions.MissionResult:
    return result(rival_plans=20, rival_cost=rival_cost, rival_clearance_m=530.0, **changes)


def test_the_rival_is_beaten_where_ours_arrives_no_dearer_or_alone() -> None:
    results = [
        beside(31.0),
        beside(29.0),
        beside(math.nan, cost=40.0, world="gathered-7-2"),
        beside(31.0, arrived=False, failure="TOO_MANY_LEGS: "),
    ]
    figures = missions.summary(results)
    assert figures["cheaper_than_rival"] == 0.5
    assert figures["rival_arrived"] == 3
    assert figures["rival_worst"] == pytest.approx(31.0 / 30.0)
    assert figures["arrived"] == 3
    assert "gathered-7-2: J/J* 1.3333" in missions.line(results[2])
    assert "did not arrive (TOO_MANY_LEGS: )" in missions.line(results[3])


def test_a_table_shows_the_rival_where_one_flew_and_what_has_no_optimum() -> None:
    plain = missions.summary([result()])
    beaten = missions.summary([beside(31.0, best_cost=math.nan)])
    assert beaten["without_optimum"] == 1
    rows = [missions.summary_table({"g": each}, "t").row_count for each in (plain, beaten)]
    assert rows == [12, 17]
