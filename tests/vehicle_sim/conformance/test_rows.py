"""Pairing events: its laws, and brute force over all pairings."""

import itertools
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conformance.rows import WINDOW_S, Event, Match, changes, paired

EVENTS = st.lists(
    st.tuples(st.floats(0.0, 60.0), st.sampled_from("abc")), max_size=6, unique_by=lambda e: e[0]
).map(sorted)


def cost(matches: list[Match[str]]) -> tuple[int, float]:
    both = [(a, b) for a, b in matches if a is not None and b is not None]
    return len(both), sum(abs(a[0] - b[0]) for a, b in both)


@given(EVENTS)
def test_a_side_pairs_with_itself(events: list[Event[str]]) -> None:
    assert paired(events, events) == [(e, e) for e in events]


@given(EVENTS, EVENTS)
def test_every_event_is_in_one_pair_and_only_with_its_like(
    real: list[Event[str]], simulated: list[Event[str]]
) -> None:
    matches = paired(real, simulated)
    assert sorted(a for a, _ in matches if a) == real
    assert sorted(b for _, b in matches if b) == simulated
    for a, b in matches:
        assert a is not None or b is not None
        if a is not None and b is not None:
            assert a[1] == b[1]
            assert abs(a[0] - b[0]) <= WINDOW_S


@given(EVENTS, EVENTS)
def test_what_is_left_alone_had_no_free_partner(
    real: list[Event[str]], simulated: list[Event[str]]
) -> None:
    matches = paired(real, simulated)
    alone = [a for a, b in matches if a and not b], [b for a, b in matches if b and not a]
    for a, b in itertools.product(*alone):
        assert a[1] != b[1] or abs(a[0] - b[0]) > WINDOW_S


@given(st.lists(st.floats(0.0, 1000.0), max_size=6, unique=True), st.floats(-0.4, 0.4))
def test_a_shift_smaller_than_half_the_distance_is_seen_through(
    tens: list[float], shift_s: float
) -> None:
    real = [(20.0 * i, "a") for i, _ in enumerate(tens)]
    simulated = [(t + shift_s, k) for t, k in real]
    assert paired(real, simulated) == list(zip(real, simulated, strict=True))


def test_changes_are_the_first_value_and_every_other() -> None:
    messages: list[tuple[float, Any]] = [(0.0, 1), (1.0, 1), (2.0, 2), (3.0, 2), (4.0, 1)]
    assert changes(messages, lambda m: m) == [(0.0, 1), (2.0, 2), (4.0, 1)]
    assert changes([], lambda m: m) == []


@pytest.mark.parametrize("apart_s", [0.0, 3.0, 9.9, 10.1, math.inf])
def test_events_too_far_apart_are_two(apart_s: float) -> None:
    assert len(paired([(5.0, "a")], [(5.0 + apart_s, "a")])) == (1 if apart_s <= WINDOW_S else 2)
