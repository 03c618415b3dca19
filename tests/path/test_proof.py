import math

import numpy as np
import pytest
from brute_force import Case, column_distance_m, curve, fastest_m_s, random_case
from hypothesis import given
from hypothesis import strategies as st

from companion import jit
from companion.geodesy import FloatArray
from companion.path import proof
from companion.path.proof import exposure, first_pieces, piece_of, stretch_of
from companion.path.proof_shape import extremes, largest
from companion.path.subpath import cubics_of
from companion.world.columns import terrain_distance

seeds = st.integers(0, 10**6)


def a_case(seed: int) -> Case:
    return random_case(np.random.default_rng([11, seed]))


def a_curve(seed: int) -> FloatArray:
    """Control points that bend, climb and bunch up more than a path would."""
    rng = np.random.default_rng([12, seed])
    steps = rng.normal((300.0, 0.0, 0.0), (150.0, 250.0, 60.0), (int(rng.integers(3, 8)), 3))
    return np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])


@given(seed=seeds, start=st.floats(0, 0.9), share=st.floats(0.05, 1.0))
def test_a_piece_lies_within_its_sag_and_its_tangents_within_their_cone(
    seed: int, start: float, share: float
) -> None:
    control = a_curve(seed)
    cubics = cubics_of(control)
    span = seed % len(cubics)
    end = start + share * (1.0 - start)
    segment, sag, cosine, length = piece_of(cubics, span, start, end)
    u = (span + np.linspace(start, end, 801)) / len(cubics)
    points, velocity = curve(control)(u), curve(control)(u, 1)
    chord = np.array(segment[3:])
    at = np.clip((points - segment[:3]) @ chord / (chord @ chord), 0.0, 1.0)
    off = np.linalg.norm(points - segment[:3] - at[:, None] * chord, axis=-1)
    assert off.max() <= sag + 1e-8
    tangent = velocity / np.linalg.norm(velocity, axis=-1)[:, None]
    assert (tangent @ chord).min() / np.linalg.norm(chord) >= cosine - 1e-9
    chords = np.linalg.norm(np.diff(points, axis=0), axis=-1).sum()
    assert chords <= length + 1e-8


@given(seed=seeds, block=st.sampled_from([1, 2, 3, 7, 16]), limit=st.floats(0.3, 3.0))
def test_the_distance_from_the_terrain_is_that_of_the_nearest_column(
    seed: int, block: int, limit: float
) -> None:
    case = a_case(seed)
    here = case.surroundings()
    heights_m = here.columns.heights_m
    south, west = (range(0, count, block) for count in heights_m.shape)
    maxima = np.maximum.reduceat(np.maximum.reduceat(heights_m, south, axis=0), west, axis=1)
    columns_ = here.columns._replace(block=block, blocks_m=maxima)
    segment, _, _, length = piece_of(cubics_of(case.control_nea_m), 0, 0.2, 0.7)
    limit *= here.clearance_m
    told = terrain_distance(columns_, segment, limit, 0.1, np.empty((maxima.size, 3)))
    points = np.array(segment[:3]) + np.linspace(0, 1, 200)[:, None] * np.array(segment[3:])
    around = case.known.grown(case.task.limits.loiter_radius_m)
    brute = min(float(column_distance_m(around, points).min()), limit)
    assert told <= brute + 1e-6
    assert told >= brute - 0.1 - length / 200.0


@given(
    seed=seeds,
    flown=st.floats(0, 500),
    left=st.floats(0, 500),
    overrun_m=st.sampled_from([0.0, 10.0, math.inf]),
    settling_s=st.sampled_from([0.0, 0.5, 5.0]),
)
def test_all_stretches_of_a_piece_are_within_the_slack_of_the_segment(
    seed: int, flown: float, left: float, overrun_m: float, settling_s: float
) -> None:
    case = a_case(seed)
    motion = case.task.envelope._replace(loiter_m=0.0)  # a plane has no stretches
    motion = motion._replace(overrun_m=overrun_m, settling_s=settling_s)
    here = case.surroundings()._replace(motion=motion)
    control = a_curve(seed)
    cubics = cubics_of(control)
    piece = piece_of(cubics, 0, 0.2, 0.6)
    left += piece[3]
    segment, slack = stretch_of(here, piece, flown + piece[3], left)
    u = (0.2 + 0.4 * np.linspace(0, 1, 200)) / len(cubics)
    points, velocity = curve(control)(u), curve(control)(u, 1)
    tangent = velocity / np.linalg.norm(velocity, axis=-1)[:, None]
    tangent[:, 2] = np.minimum(tangent[:, 2], 0.0)
    chords = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    at = np.concatenate([[0.0], np.cumsum(chords)])
    speed = fastest_m_s(motion, np.maximum(left - at, 0.0), flown + at)
    far = speed * motion.dead_man_s + speed**2 / (2.0 * motion.braking_m_s2)
    base, chord = np.array(segment[:3]), np.array(segment[3:])
    for share in (0.0, 0.5, 1.0):
        ends = points + (share * far)[:, None] * tangent
        foot = np.clip((ends - base) @ chord / (chord @ chord), 0.0, 1.0)
        assert np.linalg.norm(ends - base - foot[:, None] * chord, axis=-1).max() <= slack + 1e-6


@given(seed=seeds)
def test_shape_is_bounded_to_about_one_percent_and_proven_just_above_it(seed: int) -> None:
    """Against dense samples of the curvature and of the tangents of climb and dive."""
    control = a_curve(seed)
    cubics, u = cubics_of(control), np.linspace(0.0, 1.0, 4_001)
    points, first, second = (curve(control)(u, order) for order in range(3))
    speed, cross = (
        np.hypot(first[:, 0], first[:, 1]),
        first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0],
    )
    curvature, slope = float(np.abs(cross / speed**3).max()), first[:, 2] / speed
    squared, _ = largest(cubics, 0, 1e-6, 0.004)
    assert squared >= curvature**2 * (1.0 - 1e-9)
    if curvature < 0.05:  # tighter than 20 m the samples are too far apart to be the truth
        assert math.sqrt(squared) <= curvature * 1.02 + 2e-5
    if curvature < 0.02:
        limit = (curvature * 1.005) ** 2
        assert largest(cubics, 0, limit, 0.004)[0] <= limit
    for sign, real in ((1, float(slope.max())), (-1, float(-slope.min()))):
        bound, _ = largest(cubics, sign, 0.2, 0.004)
        assert bound >= real - 1e-9
        assert bound <= 1.02 * max(real, 0.0) + 0.001 or curvature > 0.05
        if real > 0.01 and curvature < 0.02:
            assert largest(cubics, sign, real * 1.005, 0.004)[0] <= real * 1.005
    for axis in range(3):
        ends = points[:, axis].min(), points[:, axis].max()
        told = extremes(cubics, axis)
        assert told[0] <= ends[0] + 1e-8
        assert told[1] >= ends[1] - 1e-8
        assert told == pytest.approx(ends, abs=1e-5 * np.abs(control).max())


@pytest.mark.parametrize("miss", [0.0, 0.5, 0.9, 1.1])
def test_exposure_is_the_chord_once_and_the_detection_that_of_the_nearest_point(
    miss: float,
) -> None:
    cubics = cubics_of(np.array([[1_000.0 * k, 0.0, 0.0] for k in range(4)]))
    radar = np.array([1_500.0, 500.0 * miss, 0.0, 500.0])
    chord = 1_000.0 * math.sqrt(max(1.0 - miss**2, 0.0))
    for further in (0.0, 0.4 * chord):  # of a second radar that the path meets later
        radars = radar + np.outer([0.0, further], [1.0, 0.0, 0.0, 0.0])
        within, detection = exposure(cubics, radars, first_pieces(cubics))
        assert chord + further <= within + 1e-9
        assert within <= chord + further + 2 * 0.002 * 3_000.0
        assert detection == pytest.approx(1.0 / (1.0 + miss**4) if chord else 0.0)


def test_compiled_and_plain_agree_to_1e_9() -> None:
    compiled = jit.compiled(proof.prove)
    for seed in range(30):
        case = a_case(seed)
        cubics, here = cubics_of(case.control_nea_m), case.surroundings()
        np.testing.assert_allclose(
            compiled(cubics, here, case.from_rest),
            proof.prove(cubics, here, case.from_rest),
            rtol=1e-9,
            atol=1e-9,
        )
