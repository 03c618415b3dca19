"""A bad link: shares, order, delays, and nothing at all when nothing is set."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_sim.faults import LinkConditions
from vehicle_sim.wire.impairments import MAX_FRAMES, Impairments

S = 1_000_000
STEP_US = 10_000


def frame(number: int) -> bytes:
    return number.to_bytes(4, "big") * 8


def link(conditions: LinkConditions, seed: int = 1, **which: int) -> Impairments:
    made = Impairments(np.random.default_rng(seed), **which)  # type: ignore[arg-type]
    made.impair(conditions)
    return made


def carried(made: Impairments, count: int) -> list[tuple[int, bytes]]:
    """When each frame that came out did so; one frame goes in each step."""
    out = []
    for now_us in range(0, count * STEP_US + 5 * S, STEP_US):
        if now_us < count * STEP_US:
            made.push(now_us, frame(now_us // STEP_US))
        out += [(now_us, data) for data in made.pop(now_us)]
    return out


def numbers(conditions: LinkConditions, count: int) -> list[int]:
    return [int.from_bytes(data[:4], "big") for _, data in carried(link(conditions), count)]


@pytest.mark.parametrize("share", [0.0, 0.05, 0.9])
def test_the_share_that_is_lost_is_lost_for_good(share: float) -> None:
    out = numbers(LinkConditions(lost=share), 5000)
    assert out == sorted(out)
    assert len(out) / 5000 == pytest.approx(1.0 - share, abs=0.025 if share else 0.0)


@given(delay_us=st.integers(0, 3 * S))
def test_a_delay_is_the_same_for_all_and_keeps_the_order(delay_us: int) -> None:
    out = carried(link(LinkConditions(delay_us=delay_us)), 50)
    assert [data for _, data in out] == list(map(frame, range(50)))
    for k, (time_us, _) in enumerate(out):
        assert 0 <= time_us - k * STEP_US - delay_us < STEP_US


def test_jitter_lets_frames_overtake_and_is_never_longer_than_it_says() -> None:
    out = carried(link(LinkConditions(delay_us=100_000, jitter_us=80_000)), 2000)
    order = [int.from_bytes(data[:4], "big") for _, data in out]
    late_us = np.array([time_us for time_us, _ in out]) - np.array(order) * STEP_US
    assert late_us.min() >= 100_000
    assert late_us.max() <= 190_000
    assert late_us.mean() == pytest.approx(145_000, abs=3000)  # half a step more for the steps
    assert order != sorted(order)
    assert sorted(order) == list(range(2000))


def test_duplicates_come_right_behind_and_what_is_reordered_is_overtaken_by_the_next() -> None:
    twice = numbers(LinkConditions(duplicated=0.3), 3000)
    assert twice == sorted(twice)
    assert len(twice) / 3000 == pytest.approx(1.3, abs=0.03)
    assert max(len(list(run)) for _, run in itertools.groupby(twice)) == 2
    out = numbers(LinkConditions(reordered=0.1), 5000)
    assert sorted(out) == list(range(5000))
    backwards = np.mean(np.diff(out) < 0)
    assert backwards == pytest.approx(0.1 * 0.9, abs=0.02)
    last = link(LinkConditions(reordered=1.0))
    last.push(0, frame(7))
    assert [last.pop(at) for at in (499_999, 500_000)] == [[], [frame(7)]]  # not held for ever


def test_corrupted_frames_differ_in_up_to_three_bits() -> None:
    wrong = [
        (int.from_bytes(data, "big") ^ int.from_bytes(frame(k), "big")).bit_count()
        for k, (_, data) in enumerate(carried(link(LinkConditions(corrupted=0.25)), 4000))
    ]
    assert np.mean(np.array(wrong) > 0) == pytest.approx(0.25, abs=0.03)
    assert max(wrong) == 3
    made = link(LinkConditions(corrupted=1.0))
    made.push(0, b"")
    assert made.pop(0) == [b""]


@pytest.mark.parametrize(
    ("conditions", "concerned"),
    [
        (LinkConditions(off=True), {(0, True), (0, False), (5, True), (5, False)}),
        (LinkConditions(off=True, to_vehicle=False), {(0, False), (5, False)}),
        (LinkConditions(off=True, from_vehicle=False), {(0, True), (5, True)}),
        (LinkConditions(off=True, only=5), {(5, True), (5, False)}),
    ],
)
def test_only_the_links_and_directions_that_are_meant_are_concerned(
    conditions: LinkConditions, concerned: set[tuple[int, bool]]
) -> None:
    for which, to_vehicle in itertools.product((0, 5), (True, False)):
        made = link(conditions, link=which, to_vehicle=to_vehicle)
        assert bool(carried(made, 1)) != ((which, to_vehicle) in concerned)
        made.impair(LinkConditions())
        assert len(carried(made, 3)) == 3


def test_what_is_on_its_way_arrives_after_the_link_has_cleared_and_before_what_follows() -> None:
    made = link(LinkConditions(delay_us=S))
    made.push(0, frame(0))
    made.impair(LinkConditions())
    made.push(10_000, frame(1))
    assert [made.pop(at) for at in (10_000, S)] == [[], [frame(0), frame(1)]]


def test_a_full_queue_loses_what_comes_on_top() -> None:
    made = link(LinkConditions(delay_us=60 * S))
    for k in range(MAX_FRAMES + 500):
        made.push(k, b"x")
    assert len(made.pop(200 * S)) == MAX_FRAMES


@given(
    conditions=st.builds(
        LinkConditions,
        lost=st.floats(0, 1),
        delay_us=st.integers(0, 300_000),
        jitter_us=st.integers(0, 300_000),
        duplicated=st.floats(0, 1),
        reordered=st.floats(0, 1),
        corrupted=st.floats(0, 1),
    ),
    seed=st.integers(0, 1000),
)
def test_the_same_seed_does_the_same_and_no_frame_is_forgotten(
    conditions: LinkConditions, seed: int
) -> None:
    out = carried(link(conditions, seed), 60)
    assert carried(link(conditions, seed), 60) == out
    assert (60 if conditions.lost == 0.0 else 0) <= len(out) <= 120
