"""Reading recordings, the laws of the clock, and what is played into a vehicle, and when."""

import dataclasses
import itertools
import math
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink
from recordings import FOLDER, recording

from conformance.flights import (
    Clock,
    Recording,
    Span,
    decoded,
    flight_of,
    played,
    read_recording,
    records,
    timeline,
    world_of,
)
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.errors import InputError
from vehicle_sim.faults import Timeline

Recorded = Callable[[str], Recording]
SHORT, LATE, PLANE = "px4-offboard-short.tlog", "px4-gps-loss.tlog", "px4-fixedwing-offboard.tlog"
STEP_US = 10_000


def frame(message: Any, component: int = 1) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=component)))


def log(*frames: bytes) -> bytes:
    return b"".join(struct.pack(">Q", 10**15 + i) + f for i, f in enumerate(frames))


BEAT = frame(mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 0, 3))
SYNC = frame(mavlink.MAVLink_timesync_message(0, 5), component=191)


def test_a_log_that_was_cut_off_gives_what_is_complete() -> None:
    whole = log(BEAT, SYNC)
    for size in range(len(whole) + 1):
        complete = (size >= len(log(BEAT))) + (size == len(whole))
        assert [f for _, f in records(whole[:size])] == [BEAT, SYNC][:complete]


@pytest.mark.parametrize(
    ("called", "content", "words"),
    [
        ("x.tlog", b"no log at all, but text", "does not begin a MAVLink 2 frame"),
        ("x.tlog", bytes(100), "does not begin a MAVLink 2 frame"),
        ("x.tlog", b"\xfd" * 100, "no autopilot"),
        ("x.tlog", log(SYNC), "no autopilot"),
        ("x.tlog", None, "cannot be read"),
        ("x.tlog.xz", b"no archive at all", "cannot be read"),
        ("x.tlog.xz", (FOLDER / f"{SHORT}.xz").read_bytes()[:5000], "cannot be read"),
    ],
)
def test_something_else_is_refused_in_words(
    tmp_path: Path, called: str, content: bytes | None, words: str
) -> None:
    if content is not None:
        (tmp_path / called).write_bytes(content)
    with pytest.raises(InputError, match=f"LOG = .*{words}"):
        read_recording(tmp_path / called)


def test_a_packed_log_is_the_same_flight() -> None:
    ours, plain = (read_recording(p) for p in (FOLDER / f"{SHORT}.xz", recording(SHORT)))
    assert (ours.name, ours.sent, ours.said) == (plain.name, plain.sent, plain.said)


@pytest.mark.sample(3)
def test_a_recording_says_who_flew_and_who_said_what_at_which_vehicle_time(
    recorded: Recorded, name: str
) -> None:
    flight = recorded(name)
    known = flight_of(flight)
    assert flight.firmware == ("px4" if name.startswith("px4") else "ardupilot")
    assert flight.kind == ("plane" if "plane" in name or "fixedwing" in name else "copter")
    assert {one[2:4] for one in flight.said} == {(1, 1)}
    assert {one[2:4] for one in flight.sent} <= {(1, 191), (1, 195), (255, 190)}
    for half in (flight.sent, flight.said):
        times = [flight.begin_s, *(one.time_s for one in half), flight.end_s]
        assert times == sorted(times)
    late = [
        one.time_s - decoded(one).time_boot_ms / 1000.0
        for one in flight.said
        if one.number in (30, 33) and one.time_s > flight.begin_s + 3.0
    ]
    assert np.median(late) < 0.02  # a stamp is as old as the way took
    assert np.quantile(late, 0.001) > -0.03
    assert np.quantile(late, 0.9) < 0.1
    told, world = flight.home, world_of(flight, known)
    assert (world.vehicle.kind, world.vehicle.autopilot) == (flight.kind, flight.firmware)
    home = (world.origin.latitude_deg, world.origin.longitude_deg)
    assert home == pytest.approx((told.latitude_deg, told.longitude_deg), abs=1e-5)
    assert abs(math.remainder(world.vehicle.heading_deg - told.heading_deg, 360.0)) < 3.0
    assert known.reasons
    for reason in known.reasons:  # they are narrow, and say something
        assert len(reason.why) > 20
        assert not reason.names == reason.shown == ".*"


def test_a_recording_that_nobody_knows_is_taken_as_it_says(recorded: Recorded) -> None:
    flight = dataclasses.replace(recorded(SHORT), name="strange.tlog")
    known = flight_of(flight)
    assert known.home == flight.home
    assert not known.parameters
    assert not known.faults


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
        stamps.append((log_s + (0.0 if i % 5 == 0 else wait_s), offset_s + rate * log_s))
    clock = Clock(stamps)
    for log_s in np.linspace(0.0, 9.0, 19):
        assert clock.vehicle_s(log_s) == pytest.approx(offset_s + rate * log_s, abs=0.31 * rate)


@given(times=st.lists(st.tuples(st.floats(0, 100), st.floats(0, 100)), max_size=30))
def test_the_clock_never_runs_backwards(times: list[tuple[float, float]]) -> None:
    clock = Clock(times)
    mapped = [clock.vehicle_s(t) for t in np.linspace(-10.0, 120.0, 200)]
    assert all(a <= b + 1e-9 for a, b in itertools.pairwise(mapped))


@given(rate=st.floats(0.9, 1.1), at_s=st.floats(-5.0, 60.0))
def test_both_directions_of_the_clock_are_inverse(rate: float, at_s: float) -> None:
    clock = Clock((t, 3.0 + rate * t) for t in np.arange(0.0, 50.0, 0.1))
    assert clock.log_s(clock.vehicle_s(at_s)) == pytest.approx(at_s, abs=1e-6)


# --- the player -----------------------------------------------------------------------------------


class Notebook:
    """A vehicle that writes down what it gets; answers at once, tells its time at every step."""

    def __init__(self) -> None:
        self.now_us = 0
        self.vehicle = Plane(latitude_deg=0.0, longitude_deg=0.0, altitude_amsl_m=0.0)
        self.received: list[tuple[int, int, bytes]] = []
        self._out: list[tuple[int, bytes]] = []

    def step(self) -> None:
        self.now_us += STEP_US
        self._out.append((0, frame(mavlink.MAVLink_system_time_message(0, self.now_us // 1000))))
        self._out.append((1, b"for another link"))

    def receive(self, link: int, data: bytes, /) -> None:
        self.received.append((self.now_us, link, data))
        self._out.append((0, frame(mavlink.MAVLink_command_ack_message(len(self.received), 0))))

    def take_frames(self) -> Sequence[tuple[int, bytes]]:
        out, self._out = self._out, []
        return out


def test_each_frame_goes_in_at_the_first_step_after_it_and_what_comes_back_has_its_time(
    recorded: Recorded,
) -> None:
    flight, notebook = recorded(LATE), Notebook()
    back = played(cast(Any, notebook), flight, flight_of(flight))
    assert [each[1:] for each in notebook.received] == [(0, one.frame) for one in flight.sent]
    for (now_us, _, _), sent in zip(notebook.received, flight.sent, strict=True):
        assert 0 <= now_us - round(sent.time_s * 1e6) < STEP_US
    answers = [one.time_s for one in back if one.number == 77]
    assert answers == [t * 1e-6 for t, _, _ in notebook.received]
    steps = [one.time_s for one in back if one.number == 2]
    assert steps[0] >= flight.begin_s > steps[0] - 0.01  # it boots alone, unheard
    assert steps[-1] == pytest.approx(flight.end_s, abs=0.011)
    assert len(steps) == round((steps[-1] - steps[0]) / 0.01) + 1


def test_faults_become_lines_of_a_timeline_in_vehicle_time(recorded: Recorded) -> None:
    flight = recorded(LATE)
    known = flight_of(flight)
    begin_s, end_s = map(flight.clock.vehicle_s, (known.faults[0].begin_s, known.faults[0].end_s))
    (line,) = timeline(flight, known).splitlines()
    assert line == f"at {begin_s:.2f} s for {end_s - begin_s:.2f} s: gps_off"
    assert begin_s > known.faults[0].begin_s + 4.0  # the recording began some time after boot
    assert len(Timeline.parse(line, firmware="px4").entries) == 1
    two = msgspec.structs.replace(known, faults=[Span(begin_s=1, end_s=2, what="gps_off")] * 2)
    assert len(timeline(flight, two).splitlines()) == 2


@pytest.mark.nightly  # as the comparison of this flight
def test_the_aeroplane_is_put_where_the_real_one_was_once(recorded: Recorded) -> None:
    flight, notebook = recorded(PLANE), Notebook()
    known = flight_of(flight)
    played(cast(Any, notebook), flight, known)
    at_s = flight.clock.vehicle_s(known.placements[0].at_s)
    near = (one for one in flight.said if one.number == 33 and abs(one.time_s - at_s) < 0.2)
    there, vehicle = [decoded(one) for one in near], notebook.vehicle
    assert min(m.lat for m in there) <= vehicle.latitude_deg * 1e7 <= max(m.lat for m in there)
    assert min(m.lon for m in there) <= vehicle.longitude_deg * 1e7 <= max(m.lon for m in there)
    assert vehicle.altitude_amsl_m == pytest.approx(488.0 + there[0].relative_alt / 1e3, abs=1.0)
    off_deg = math.remainder(math.degrees(vehicle.heading_rad) - there[0].hdg / 100.0, 360.0)
    assert abs(off_deg) < 15.0
    assert 9.0 < vehicle.airspeed_m_s < 16.0
