"""Reading recordings: against pymavlink's own reader's rules, and the clock's laws."""

import io
import itertools
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink
from recordings import FOLDER, recording

from conformance.log import Clock, Recording, decoded, read_recording, records
from vehicle_sim.errors import InputError

Recorded = Callable[[str], Recording]


def frame(message: object, *, system: int = 1, component: int = 1) -> bytes:
    mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    return bytes(message.pack(mav))  # type: ignore[attr-defined]


def log(*frames: bytes) -> bytes:
    return b"".join(struct.pack(">Q", 10**15 + i) + f for i, f in enumerate(frames))


BEAT = frame(mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 0, 3))
SYNC = frame(mavlink.MAVLink_timesync_message(0, 5), component=191)


@given(cut=st.integers(1, len(log(BEAT, SYNC))))
def test_a_log_that_was_cut_off_gives_what_is_complete(cut: int) -> None:
    whole = log(BEAT, SYNC)
    read = [r.frame for r in records(io.BytesIO(whole[:-cut]), "x")]
    assert read == ([BEAT] if cut <= len(SYNC) + 8 and cut < len(whole) - 8 - len(BEAT) + 1 else [])


@pytest.mark.parametrize("content", [b"no log at all, but text", bytes(100), b"\xfd" * 100])
def test_something_else_is_refused_in_words(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.tlog"
    path.write_bytes(content)
    with pytest.raises(InputError, match="LOG"):
        read_recording(path)


def test_a_log_without_an_autopilot_or_a_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.tlog"
    path.write_bytes(log(SYNC))
    with pytest.raises(InputError, match="no autopilot"):
        read_recording(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_recording(tmp_path / "nothing.tlog")


def test_a_packed_log_is_the_same_flight_and_a_damaged_one_is_refused_in_words(
    tmp_path: Path,
) -> None:
    packed = FOLDER / "px4-offboard-short.tlog.xz"
    ours, plain = read_recording(packed), read_recording(recording("px4-offboard-short.tlog"))
    assert (ours.name, ours.sent, ours.said) == (plain.name, plain.sent, plain.said)
    for damaged in (packed.read_bytes()[:5000], b"no archive at all"):
        path = tmp_path / "x.tlog.xz"
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="cannot be read"):
            read_recording(path)


@pytest.mark.sample(3)
def test_every_frame_is_either_sent_or_said(recorded: Recorded, name: str) -> None:
    flight = recorded(name)
    assert {(h.system, h.component) for h in flight.said} == {(1, 1)}
    assert {(h.system, h.component) for h in flight.sent} <= {(1, 191), (1, 195), (255, 190)}
    assert flight.sent
    for half in (flight.sent, flight.said):
        times = [h.time_s for h in half]
        assert times == sorted(times)
        assert flight.begin_s <= times[0]
        assert times[-1] <= flight.end_s


@pytest.mark.sample(3)
def test_vehicle_time_is_what_the_vehicle_stamped(recorded: Recorded, name: str) -> None:
    flight = recorded(name)
    late = [
        h.time_s - decoded(h).time_boot_ms / 1000.0
        for h in flight.said
        if h.number in (30, 33) and h.time_s > flight.begin_s + 3.0
    ]
    assert np.median(late) < 0.02  # a stamp is as old as the way took
    assert np.quantile(late, 0.001) > -0.03
    assert np.quantile(late, 0.9) < 0.1


@pytest.mark.sample(3)
def test_what_flew_is_read_from_the_heartbeat(recorded: Recorded, name: str) -> None:
    flight = recorded(name)
    assert flight.firmware == ("px4" if name.startswith("px4") else "ardupilot")
    assert flight.kind == ("plane" if "plane" in name or "fixedwing" in name else "copter")


# --- the clock ------------------------------------------------------------------------------------


@given(
    rate=st.floats(0.95, 1.05),
    offset_s=st.floats(-5.0, 5.0),
    late_s=st.lists(st.floats(0.0, 0.3), min_size=50, max_size=50),
)
def test_the_clock_finds_rate_and_offset_whatever_waited(
    rate: float, offset_s: float, late_s: list[float]
) -> None:
    """One stamp in five did not wait."""
    stamps = []
    for i, wait_s in enumerate(late_s):
        log_s = 0.2 * i
        vehicle_s = offset_s + rate * log_s
        stamps.append((log_s + (0.0 if i % 5 == 0 else wait_s), vehicle_s))
    clock = Clock(stamps)
    for log_s in np.linspace(0.0, 9.0, 19):
        assert clock.vehicle_s(log_s) == pytest.approx(offset_s + rate * log_s, abs=0.31 * rate)


@given(times=st.lists(st.tuples(st.floats(0, 100), st.floats(0, 100)), min_size=1, max_size=30))
def test_the_clock_never_runs_backwards(times: list[tuple[float, float]]) -> None:
    clock = Clock(times)
    mapped = [clock.vehicle_s(t) for t in np.linspace(-10.0, 120.0, 200)]
    assert all(a <= b + 1e-9 for a, b in itertools.pairwise(mapped))


@given(rate=st.floats(0.9, 1.1), at_s=st.floats(-5.0, 60.0))
def test_both_directions_of_the_clock_are_inverse(rate: float, at_s: float) -> None:
    clock = Clock((t, 3.0 + rate * t) for t in np.arange(0.0, 50.0, 0.1))
    assert clock.log_s(clock.vehicle_s(at_s)) == pytest.approx(at_s, abs=1e-6)
