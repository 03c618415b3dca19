"""What is proven of a curve: of random ones by search, just at their bounds, and of odd ones."""

import math

import numpy as np
import pytest
from brute_force import broken_by, random_case, truth
from hypothesis import given
from hypothesis import strategies as st
from planning import ARDUCOPTER, limits, spline

from companion import jit
from companion.path import proof
from companion.path.certificate import Certificate, certify
from companion.path.proof import piece_of
from companion.path.subpath import Subpath, cubics_of
from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import KnownMap

# --- curves that nobody chose

BOUNDS = (
    "terrain clearance", "keep-out zone", "dead-man reach", "turn radius", "climb angle",
    "dive angle", "floor of the band", "ceiling of the band", "edge of the map",
)  # fmt: skip


def test_random_curves_keep_what_their_certificates_promise_and_what_is_safe_is_proven(
    pytestconfig: pytest.Config,
) -> None:
    """Every bound is broken just beyond what a curve comes to, and kept just within."""
    safe, cases = 0, 160 if pytestconfig.getoption("--all") else 40
    for seed in range(cases):
        case = random_case(np.random.default_rng([9, seed]))
        around, real, told = case.surroundings(), truth(case, samples=100), case.certificate()
        assert broken_by(told, real) == [], seed
        assert told.radar_m <= real.radar_m + 0.01 * real.length_m
        nearest_m, span_m = min(real.clearance_m, real.keep_out_m), around.clearance_m
        contact_m = around.contact_m + 0.02 * (span_m - around.contact_m)
        if case.task.limits.hovers and nearest_m >= span_m and real.dead_man_m >= contact_m:
            assert "dead-man reach" not in told.broken, seed
            safe += 1
        points = spline(case.control_nea_m)(np.linspace(0.0, 1.0, 3_001))
        climb_rad, dive_rad = real.climb_angle_rad, real.dive_angle_rad
        for off in (-0.03, 0.03):  # so much beyond
            asked = around._replace(
                motion=around.motion._replace(
                    turn_radius_m=real.turn_radius_m * (1.0 + off),
                    climb_angle_rad=climb_rad - off * (0.1 + abs(climb_rad)),
                    dive_angle_rad=dive_rad - off * (0.1 + abs(dive_rad)),
                ),
                clearance_m=nearest_m + off * span_m,
                contact_m=real.dead_man_m + off * span_m,
                lowest_nea_m=tuple(points.min(axis=0) + off * span_m),
                highest_nea_m=tuple(points.max(axis=0) - off * span_m),
            )
            subpath = Subpath(control_nea_m=case.control_nea_m)
            broken = set(certify(subpath, asked, from_rest=case.from_rest).broken)
            beyond = set(BOUNDS)
            if real.clearance_m > asked.clearance_m:
                beyond.remove("terrain clearance")
            if real.keep_out_m > asked.clearance_m:
                beyond.remove("keep-out zone")
            is_bend_gentle = real.turn_radius_m > 0.3 * around.motion.turn_radius_m
            if off > 0.0:
                assert broken >= beyond, seed
            elif nearest_m > 0.1 * span_m and is_bend_gentle:  # else it is told less finely
                assert broken <= {"dead-man reach"}, seed
    assert safe > cases // 8


@given(seed=st.integers(0, 10**6), start=st.floats(0, 0.9), share=st.floats(0.05, 1.0))
def test_a_piece_lies_within_its_sag_and_its_tangents_within_their_cone(
    seed: int, start: float, share: float
) -> None:
    """Of curves that bend, climb and bunch up more than a path would."""
    rng = np.random.default_rng([12, seed])
    steps = rng.normal((300.0, 0.0, 0.0), (150.0, 250.0, 60.0), (int(rng.integers(3, 8)), 3))
    control = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    cubics, end = cubics_of(control), start + share * (1.0 - start)
    span = seed % len(cubics)
    segment, sag, cosine, length = piece_of(cubics, span, start, end)
    u = (span + np.linspace(start, end, 801)) / len(cubics)
    points, velocity, chord = spline(control)(u), spline(control)(u, 1), np.array(segment[3:])
    at = np.clip((points - segment[:3]) @ chord / (chord @ chord), 0.0, 1.0)
    assert np.linalg.norm(points - segment[:3] - at[:, None] * chord, axis=-1).max() <= sag + 1e-8
    tangent = velocity / np.linalg.norm(velocity, axis=-1)[:, None]
    assert (tangent @ chord).min() / np.linalg.norm(chord) >= cosine - 1e-9
    assert np.linalg.norm(np.diff(points, axis=0), axis=-1).sum() <= length + 1e-8


def test_compiled_and_plain_agree_to_1e_9() -> None:
    compiled = jit.compiled(proof.prove)
    for seed in range(30):
        case = random_case(np.random.default_rng([11, seed]))
        asked = cubics_of(case.control_nea_m), case.surroundings(), case.from_rest
        np.testing.assert_allclose(compiled(*asked), proof.prove(*asked), rtol=1e-9, atol=1e-9)


# --- odd ones, over level ground

LIMITS = limits(
    turn_radius_m=200.0,
    dive_angle_rad=0.25,
    ceiling_amsl_m=800.0,
    north_m=(0.0, 4_000.0),
    east_m=(0.0, 4_000.0),
)
TASK = Task(
    limits=LIMITS,
    settings=PlannerSettings(scan_range_m=3e3, safety_distance_m=60.0, planning_time_s=1.0),
    handling=ARDUCOPTER,
)
LEVEL = [(500.0 + 1_000.0 * k, 2_000.0, 780.0) for k in range(4)]


def certified(
    corners: object, highest_m: float = 0.0, reach_m: float = 3_000.0, **changes: object
) -> Certificate:
    """highest_m: of the ground in a cell on the way."""
    upper_m = np.zeros((40, 40))
    upper_m[20, 20] = highest_m
    known = KnownMap(
        cell_m=100.0, north_min_m=0.0, east_min_m=0.0, upper_m=upper_m, seen=np.isfinite(upper_m)
    )
    around = TASK.surroundings(known, (2_000.0, 2_000.0), reach_m)
    around = around._replace(motion=around.motion._replace(**changes))
    return certify(Subpath(control_nea_m=np.array(corners, dtype=float)), around, from_rest=False)


def test_unknown_ground_has_no_top_beyond_the_reach_nothing_is_proven_and_a_plane_circles() -> None:
    assert certified(LEVEL).proven
    assert "terrain clearance" in certified(LEVEL, reach_m=500.0).broken
    for unknown in (math.inf, math.nan):
        told = certified(LEVEL, unknown)
        assert "terrain clearance" in told.broken
        assert told.clearance_m == 0.0
    ahead = [(1_920.0 + 660.0 * k, 2_000.0, 780.0) for k in range(4)]  # 100 m from the edge
    assert certified(ahead, speed_m_s=200.0).broken == ("dead-man reach",)
    assert certified(ahead, speed_m_s=200.0, loiter_m=10.0).proven  # it has no stretch ahead


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e12])
@pytest.mark.parametrize("where", [(0, 0), (1, 1), (3, 2)])
def test_a_curve_that_is_not_finite_is_never_proven_and_no_error(
    value: float, where: tuple[int, int]
) -> None:
    control = np.array(LEVEL)
    control[where] = value
    with np.errstate(all="ignore"):
        told = certified(control)
    assert not told.proven
    assert len(told.broken) == len(BOUNDS)


TWICE = ((500.0, 1_000.0), (500.0, 1_000.0))
AHEAD = ((1_300.0, 1_600.0), (2_100.0, 2_200.0))
ODD: dict[str, tuple[tuple[tuple[float, ...], ...], str]] = {
    "there and back": (((1e3, 7e2), (2e3, 14e2), (2e3, 14e2), (1e3, 7e2)), "turn radius"),
    "a cusp": (((1e3, 1e3), (2e3, 2e3), (1e3, 2e3), (2e3, 1e3)), "turn radius"),
    "straight from where points coincide": ((*TWICE, *AHEAD), ""),
    "and to where they do": ((*TWICE, *AHEAD, AHEAD[-1]), ""),
    "a bend from there": ((*TWICE, AHEAD[0], (2_100.0, 1_600.0)), "turn radius"),
    "straight up": (tuple((2e3, 2e3, 400.0 + 50.0 * k) for k in range(4)), "climb angle"),
    "no length": (((2e3, 2e3),) * 4, ""),
    "no length, too low": (((2e3, 2e3, 50.0),) * 4, "terrain clearance"),
}
"""Curves whose shape is a limit, and a bound that each breaks."""


@pytest.mark.parametrize("name", ODD)
def test_a_curve_whose_shape_is_a_limit_is_proven_if_it_can_be_flown(name: str) -> None:
    corners, bound = ODD[name]
    told = certified([(n, e, *(up or [400.0 + 0.1 * n])) for n, e, *up in corners])
    assert told.proven is (bound == "")
    assert {bound} - {""} <= set(told.broken)
    if name == "a bend from there":
        assert told.broken == (bound,)
        assert told.turn_radius_m < 0.01
    if name == "straight up":
        assert told.climb_angle_rad == pytest.approx(math.pi / 2)
