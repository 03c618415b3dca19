"""Separation from tracks and claims, against brute force in time and space."""

import math

import numpy as np
import pytest

from companion.world.traffic import (
    HEARD_S,
    STRAIGHT_M,
    Claim,
    Separation,
    Track,
    free_pieces,
    keeps_apart,
    straight_until,
)

APART = Separation(horizontal_m=20.0, vertical_m=10.0)


def track(rng: np.random.Generator) -> Track:
    north, east, up = rng.uniform(-90.0, 90.0, 3).tolist()
    vn, ve, vu = (rng.uniform(-1.0, 1.0, 3) * (20.0, 20.0, 3.0)).tolist()
    return Track(
        name="made up",
        time_s=rng.uniform(-5.0, 0.0),
        position_nea_m=(north, east, up / 3.0),
        velocity_nea_m_s=(vn, ve, vu),
        error_m=rng.uniform(0.0, 10.0),
        error_up_m=rng.uniform(0.0, 5.0),
        growth_m_s=rng.uniform(0.0, 2.0),
        growth_up_m_s=rng.uniform(0.0, 1.0),
    )


def motion(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Straight pieces at changing speeds."""
    times = 0.5 * np.arange(41)
    steps = rng.uniform(-1.0, 1.0, 3) * (4.0, 4.0, 0.7) * rng.uniform(0.0, 1.0, (40, 1))
    start = rng.uniform(-100.0, 100.0, 3) * (1.0, 1.0, 0.2)
    return start + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), times


def worst_share(points: np.ndarray, times: np.ndarray, other: Track) -> float:
    """Least share of the separation kept at 4,000 moments, the track anywhere in its cylinder."""
    fine = np.linspace(times[0], times[-1], 4001)
    place = np.stack([np.interp(fine, times, axis) for axis in points.T], axis=-1)
    age_s = fine - other.time_s
    apart = place - (other.position_nea_m + age_s[:, None] * np.array(other.velocity_nea_m_s))
    level = np.hypot(*apart.T[:2]) - other.error_m - other.growth_m_s * age_s
    up = np.abs(apart[:, 2]) - other.error_up_m - other.growth_up_m_s * age_s
    return float(np.maximum(level / APART.horizontal_m, up / APART.vertical_m).min())


def test_a_certified_motion_keeps_the_separation_at_every_moment() -> None:
    rng = np.random.default_rng(1)
    proven = refused = 0
    for _ in range(60):
        points, times = motion(rng)
        other = track(rng)
        worst = worst_share(points, times, other)
        if keeps_apart(points, times, [other], APART):
            proven += 1
            assert worst >= 1.0 - 1e-9
        else:
            refused += 1
            assert worst < 1.35  # refused for half a second's growth and no more
    assert proven > 10
    assert refused > 5


def test_an_aircraft_of_unknown_height_is_passed_aside_only() -> None:
    high = Track(
        name="a",
        time_s=0.0,
        position_nea_m=(0.0, 0.0, 0.0),
        velocity_nea_m_s=(0.0, 0.0, 0.0),
        error_m=5.0,
        error_up_m=math.inf,
        growth_m_s=0.0,
        growth_up_m_s=0.0,
    )
    times = np.array([0.0, 1.0])
    for north_m, free in ((24.0, False), (26.0, True)):
        points = np.array([[north_m, -1.0, 5000.0], [north_m, 1.0, 5000.0]])
        assert keeps_apart(points, times, [high], APART) is free


def claim(begin: np.ndarray, end: np.ndarray, heard_s: float = 0.0) -> Claim:
    (a, b, c), (d, e, f) = begin.tolist(), end.tolist()
    return Claim(system=2, heard_s=heard_s, begin_nea_m=(a, b, c), end_nea_m=(d, e, f))


def test_a_piece_that_is_free_of_a_claim_is_so_everywhere() -> None:
    rng = np.random.default_rng(2)
    share = np.linspace(0.0, 1.0, 101)[:, None]
    free_ones = taken_ones = far_ones = 0
    for _ in range(80):
        begin, end = rng.uniform(-60.0, 60.0, (2, 3)) * (1.0, 1.0, 0.4)
        path = np.cumsum(rng.uniform(-2.0, 3.0, (12, 3)) * (1.0, 1.0, 0.3), axis=0)
        free = free_pieces(path, claim(begin, end), APART)
        box = path[:, :2].min(axis=0).tolist(), path[:, :2].max(axis=0).tolist()
        assert free.all() or claim(begin, end).comes_near(*box, APART.horizontal_m)
        far_ones += not claim(begin, end).comes_near(*box, APART.horizontal_m)
        theirs = begin + share * (end - begin)
        for piece in range(len(path) - 1):
            ours = path[piece] + share * (path[piece + 1] - path[piece])
            apart = ours[:, None] - theirs[None]
            level = np.hypot(apart[..., 0], apart[..., 1])
            kept = np.maximum(level / 20.0, np.abs(apart[..., 2]) / 10.0).min()
            if free[piece]:
                free_ones += 1
                assert kept >= 1.0 - 1e-9
            else:
                taken_ones += 1
                assert kept < 1.6  # half a piece, and an eighth of the claim's height
    assert far_ones > 5
    assert free_ones > 100
    assert taken_ones > 50


def test_who_was_not_heard_may_have_claimed_all_that_it_can_reach() -> None:
    quiet = claim(np.zeros(3), np.ones(3), heard_s=10.0)
    assert quiet.grown_m(10.0 + HEARD_S, 8.0, 40.0) == 0.0
    assert quiet.grown_m(12.0, 8.0, 40.0) == pytest.approx(40.0 + 16.0)


def test_a_claim_ends_where_the_path_leaves_its_chord() -> None:
    angles = np.linspace(0.0, 1.5, 200)
    points = np.stack([30.0 * np.sin(angles), 30.0 - 30.0 * np.cos(angles), 0 * angles], axis=-1)
    last = straight_until(points)
    sagitta_m = 30.0 * (1.0 - math.cos(angles[last] / 2.0))
    assert sagitta_m <= STRAIGHT_M + 1e-9
    assert 30.0 * (1.0 - math.cos(angles[last + 2] / 2.0)) > STRAIGHT_M
    straight = np.linspace([0.0, 0.0, 0.0], [50.0, 9.0, 3.0], 40)
    assert straight_until(straight) == 39


def two_claimants(rng: np.random.Generator, lost: float) -> list[tuple[float, str]]:
    """The protocol alone: both want one stretch; who entered it, and when.  10 ms steps."""
    from companion.world.traffic import CLAIM_S  # the rules, restated by hand below

    wants = {name: rng.uniform(0.0, 2.0) for name in "ab"}
    told: dict[str, tuple[float, bool]] = {"a": (-1e9, False), "b": (-1e9, False)}
    since = dict.fromkeys("ab", math.inf)
    entered: list[tuple[float, str]] = []
    under_way: list[tuple[float, str, bool]] = []
    for tick in range(1, 1500):
        t = tick * 0.01
        for at, to, claims in [each for each in under_way if each[0] <= t]:
            told[to] = (t, claims)
            del at
        under_way = [each for each in under_way if each[0] > t]
        for name, other in (("a", "b"), ("b", "a")):
            heard_s, claims = told[name]
            done = name in [who for _, who in entered]
            if name == "b" and claims and not done:
                since[name] = math.inf  # the other goes first
            elif t >= wants[name] and since[name] == math.inf and not (name == "b" and claims):
                since[name] = t
            fresh = t - heard_s <= HEARD_S
            if not done and t - since[name] >= CLAIM_S and fresh and not claims:
                entered.append((t, name))
            if (tick + (name == "b") * 7) % 20 == 0 and rng.random() >= lost:
                under_way.append((t + rng.uniform(0.0, 0.29), other, since[name] < math.inf))
    return entered


@pytest.mark.parametrize("lost", [0.0, 0.1, 0.5, 0.9])
def test_two_that_want_the_same_never_both_enter_whatever_is_lost(lost: float) -> None:
    rng = np.random.default_rng(3)
    ways = [two_claimants(rng, lost) for _ in range(60)]
    assert all(len(entered) <= 1 for entered in ways)  # nobody leaves in this
    if lost <= 0.1:
        assert sum(map(len, ways)) == len(ways)


def test_nobody_is_met_sooner_than_the_earliest_time() -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        other, here = track(rng), rng.uniform(-400.0, 400.0, 3)
        earliest_s = other.reach_s(here.tolist(), 10.0, 1.0)
        for after_s in np.linspace(0.0, 0.999 * earliest_s, 20).tolist():
            [there], [radius], _ = other.at(np.array([1.0 + after_s]))
            gap_m = math.dist(there[:2], here[:2].tolist()) - radius
            assert gap_m >= 10.0 * after_s - 1e-6
