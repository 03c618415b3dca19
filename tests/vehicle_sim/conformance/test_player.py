"""The player against a vehicle that only writes down what it is given, and when."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import all as mavlink

from conformance.flights import Fault, flight_of, played, timeline, world_of
from conformance.log import Recording, decoded
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.faults import Timeline

Recorded = Callable[[str], Recording]
STEP_US = 10_000
SHORT = "px4-offboard-short.tlog"
LATE = "px4-gps-loss.tlog"


class Notebook:
    """Answers each datagram at once, and says its time at every step."""

    def __init__(self) -> None:
        self.now_us = 0
        self.vehicle = Plane(latitude_deg=0.0, longitude_deg=0.0, altitude_amsl_m=0.0)
        self.received: list[tuple[int, int, bytes]] = []
        self._out: list[tuple[int, bytes]] = []
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)

    def step(self) -> None:
        self.now_us += STEP_US
        message = mavlink.MAVLink_system_time_message(0, self.now_us // 1000)
        self._out.append((0, bytes(message.pack(self._mav))))
        self._out.append((1, b"for another link"))

    def receive(self, link: int, data: bytes, /) -> None:
        self.received.append((self.now_us, link, data))
        answer = mavlink.MAVLink_command_ack_message(len(self.received), 0)
        self._out.append((0, bytes(answer.pack(self._mav))))

    def take_frames(self) -> Sequence[tuple[int, bytes]]:
        out, self._out = self._out, []
        return out


@pytest.mark.parametrize("name_of", [SHORT, LATE])
def test_each_frame_goes_in_at_the_first_step_that_is_not_before_it(
    recorded: Recorded, name_of: str
) -> None:
    flight, notebook = recorded(name_of), Notebook()
    played(cast(Any, notebook), flight, flight_of(flight))
    assert [(link, data) for _, link, data in notebook.received] == [
        (0, h.frame) for h in flight.sent
    ]
    for (now_us, _, _), sent in zip(notebook.received, flight.sent, strict=True):
        assert 0 <= now_us - round(sent.time_s * 1e6) < STEP_US


def test_what_comes_back_has_the_time_at_which_it_came(recorded: Recorded) -> None:
    flight, notebook = recorded(LATE), Notebook()
    back = played(cast(Any, notebook), flight, flight_of(flight))
    answers = [h for h in back if h.number == 77]
    assert [h.time_s for h in answers] == [t * 1e-6 for t, _, _ in notebook.received]
    steps = [h.time_s for h in back if h.number == 2]
    assert steps[0] >= flight.begin_s > steps[0] - 0.01  # it boots alone, unheard
    assert steps[-1] == pytest.approx(flight.end_s, abs=0.011)
    assert len(steps) == round((steps[-1] - steps[0]) / 0.01) + 1
    assert {(h.system, h.component) for h in back} == {(1, 1)}


@pytest.mark.sample(3)
def test_the_world_is_where_and_what_the_recording_was(recorded: Recorded, name: str) -> None:
    flight = recorded(name)
    world = world_of(flight, flight_of(flight))
    assert (world.vehicle.kind, world.vehicle.autopilot) == (flight.kind, flight.firmware)
    assert world.origin.latitude_deg == pytest.approx(flight.home.latitude_deg, abs=1e-5)
    assert world.origin.longitude_deg == pytest.approx(flight.home.longitude_deg, abs=1e-5)
    assert abs(world.vehicle.heading_deg - flight.home.heading_deg) % 360.0 == pytest.approx(
        0.0, abs=3.0
    ) or abs(world.vehicle.heading_deg - flight.home.heading_deg) == pytest.approx(360.0, abs=3.0)


def test_a_recording_that_nobody_knows_is_taken_as_it_says(recorded: Recorded) -> None:
    flight = dataclasses.replace(recorded(SHORT), name="strange.tlog")
    known = flight_of(flight)
    assert known.home == flight.home
    assert not known.parameters
    assert not known.faults


def test_faults_become_lines_of_a_timeline_in_vehicle_time(recorded: Recorded) -> None:
    flight = recorded(LATE)
    known = flight_of(flight)
    begin_s = flight.clock.vehicle_s(known.faults[0].begin_s)
    end_s = flight.clock.vehicle_s(known.faults[0].end_s)
    (line,) = timeline(flight, known).splitlines()
    assert line == f"at {begin_s:.2f} s for {end_s - begin_s:.2f} s: gps_off"
    assert begin_s > known.faults[0].begin_s + 4.0  # the recording began some time after boot
    assert len(Timeline.parse(line, firmware="px4").entries) == 1
    two = dataclasses.replace(known, faults=(Fault(begin_s=1, end_s=2, what="gps_off"),) * 2)
    assert len(timeline(flight, two).splitlines()) == 2


@pytest.mark.nightly  # as the comparison of this flight
def test_the_aeroplane_is_put_where_the_real_one_was_once(recorded: Recorded) -> None:
    flight, notebook = recorded("px4-fixedwing-offboard.tlog"), Notebook()
    known = flight_of(flight)
    played(cast(Any, notebook), flight, known)
    at_s = flight.clock.vehicle_s(known.placements[0].at_s)
    there = [decoded(h) for h in flight.said if h.number == 33 and abs(h.time_s - at_s) < 0.2]
    vehicle = notebook.vehicle
    assert min(m.lat for m in there) <= vehicle.latitude_deg * 1e7 <= max(m.lat for m in there)
    assert min(m.lon for m in there) <= vehicle.longitude_deg * 1e7 <= max(m.lon for m in there)
    assert vehicle.altitude_amsl_m == pytest.approx(488.0 + there[0].relative_alt / 1e3, abs=1.0)
    course_deg = math.degrees(vehicle.heading_rad)
    assert math.remainder(course_deg - there[0].hdg / 100.0, 360.0) == pytest.approx(0.0, abs=15.0)
    assert 9.0 < vehicle.airspeed_m_s < 16.0
    assert not flight_of(recorded(SHORT)).placements
