import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.runtime.latency import Histogram, StreamTimes


@given(st.lists(st.floats(1e-5, 90.0), min_size=1, max_size=300), st.floats(0.1, 100.0))
def test_a_percentile_is_a_bound_that_is_hardly_above_the_true_one(
    durations_s: list[float], percent: float
) -> None:
    histogram = Histogram()
    for duration_s in durations_s:
        histogram.add(duration_s)
    true_s = np.sort(durations_s)[math.ceil(len(durations_s) * percent / 100.0) - 1]
    found_s = histogram.percentile_s(percent)
    assert found_s is not None
    assert true_s * (1.0 - 1e-9) <= found_s <= true_s * 10.0 ** (1 / 20) * (1.0 + 1e-9)
    assert histogram.longest_s == max(durations_s)
    assert histogram.count == len(durations_s)


@pytest.mark.parametrize(
    ("duration_s", "bound_s"), [(0.0, 1e-5), (1e-9, 1e-5), (90.0, 100.0), (1e5, 100.0)]
)
def test_what_is_beyond_its_classes_is_counted_with_the_first_or_last(
    duration_s: float, bound_s: float
) -> None:
    histogram = Histogram()
    histogram.add(duration_s)
    found_s = histogram.percentile_s(50.0)
    assert found_s == pytest.approx(min(bound_s, duration_s))
    assert histogram.longest_s == duration_s


def test_nothing_has_no_percentile() -> None:
    assert Histogram().percentile_s(50.0) is None
    assert StreamTimes().summary()["gap_p99_9_ms"] is None


def test_a_stream_that_pauses_on_purpose_has_no_gap_there() -> None:
    times = StreamTimes()
    for now_s in (0.0, 0.05, 0.10):
        times.sent(now_s, now_s - 0.002)
    times.paused()
    times.sent(7.0, None)
    times.sent(7.2, 7.1)
    summary = times.summary()
    assert summary["setpoints"] == 4
    assert summary["gap_max_ms"] == pytest.approx(200.0)
    assert summary["position_to_setpoint_max_ms"] == pytest.approx(100.0)


def test_a_vehicle_that_stutters_is_told_from_a_companion_that_does() -> None:
    times = StreamTimes()
    for at_s in (0.0, 0.05, 0.8, 0.85):
        times.heard(at_s)
        times.sent(at_s + 0.001, at_s)
    summary = times.summary()
    assert summary["gap_max_ms"] == summary["silence_max_ms"] == pytest.approx(750.0)
    assert summary["position_to_setpoint_max_ms"] == pytest.approx(1.0)
