"""What is shown of a flight is what the vehicle said, as other programs read its messages."""

import itertools
import math
import random
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from golden import GOLDENS
from pymavlink.dialects.v20 import all as wire
from renewed import replace

from companion.config import load_mission
from companion.mission.state import Phase, Reason
from companion.replay.feed import flown_mission, outputs
from companion.session import Session
from companion.telemetry.flight_status import FlightStatus, flight_status
from companion.telemetry.flight_summary import FlightSummary
from vehicle_sim.geodesy import LocalFrame

MISSION = load_mission("environment-1")
EVERY = 25  # inputs
LEFT_OVER = (Reason.NO_VEHICLE, Reason.NOT_READY, Reason.LINK_LOST, Reason.PLANNER_DIED)
"""What ends a companion and no flight."""


def summary(**options: Any) -> FlightSummary:
    return FlightSummary(session=Session(MISSION, seed=1, lockstep=True, **options))


def flights(name: str) -> Iterator[tuple[FlightSummary, dict[str, Any]]]:
    """A golden flight again, and by name the newest messages of its autopilot until then."""
    folder, newest, parser = GOLDENS / name, dict[str, Any](), wire.MAVLink(None)
    flown = None
    for number, (told, session, _) in enumerate(outputs(folder, flown_mission(folder))):
        flown = flown or FlightSummary(session=session)
        if told[0] == "receive" and len(told) == 3:
            for message in parser.parse_buffer(told[1]) or ():
                if (message.get_srcSystem(), message.get_srcComponent()) == (1, 1):
                    newest[message.get_type()] = message
        if number % EVERY == 0:
            yield flown, newest


def test_it_is_what_the_messages_say_and_whole_as_json() -> None:
    phases = list[str]()
    for flown, newest in flights("copter-loses-gps"):
        it, state = flight_status(flown), flown.session.state
        assert msgspec.json.decode(msgspec.json.encode(it), type=FlightStatus) == it
        assert (it.reason is None) == (it.code is None)
        position, power = newest.get("GLOBAL_POSITION_INT"), newest.get("SYS_STATUS")
        if position is None or power is None or it.latitude_deg is None:
            continue
        if state.vehicle.position_at_s * 1e3 != pytest.approx(position.time_boot_ms):
            continue  # the newest has not been handled yet
        origin = flown.session.mission.frame
        frame = LocalFrame(latitude_deg=origin.latitude_deg, longitude_deg=origin.longitude_deg)
        place_deg = (position.lat * 1e-7, position.lon * 1e-7)
        to_go_m = math.dist(frame.to_local(*place_deg), state.targets_ne_m[state.flight.target])
        assert (it.latitude_deg, it.longitude_deg) == pytest.approx(place_deg, abs=1e-6)
        assert it.to_go_m == pytest.approx(to_go_m, rel=1e-4, abs=0.1)
        expected = {
            "altitude_amsl_m": position.alt * 1e-3,
            "speed_m_s": math.hypot(position.vx, position.vy) * 1e-2,
            "climb_m_s": -position.vz * 1e-2,
            "position_age_s": it.t_s - position.time_boot_ms * 1e-3,
            "battery_left": power.battery_remaining / 100,
            "armed": bool(newest["HEARTBEAT"].base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED),
        }
        told = {name: getattr(it, name) for name in expected}
        assert told == pytest.approx(expected, abs=1e-3)
        if state.phase is Phase.FLYING and it.time_left_s is not None:
            way_m = it.time_left_s * flown.session.mission.task.limits.speed_m_s
            assert way_m > 0.999 * it.to_go_m
        phases.append(it.phase)
    assert len(phases) > 50
    assert {*phases} >= {"flying", "holding"}


def test_frames_that_are_missing_are_counted() -> None:
    """By their numbers, which begin again after 255; those of others do not count."""
    rng, autopilot = random.Random(1), wire.MAVLink(None, srcSystem=1, srcComponent=1)
    it, dropped, sent = summary(), 0, 600
    for number in range(sent):
        frame = wire.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(autopilot)
        autopilot.seq = (autopilot.seq + 1) % 256
        other = wire.MAVLink_heartbeat_message(6, 8, 0, 0, 3, 3).pack(wire.MAVLink(None, 255, 190))
        if 5 < number < sent - 1 and rng.random() < 0.2:
            dropped += 1
        else:
            it.session.receive(frame + other)
    it.session.run()
    status = flight_status(it)
    assert (status.frames_heard, status.frames_lost) == (sent - dropped, dropped)


def test_a_plane_is_told_what_it_passed_its_last_target_at_not_where_it_circles() -> None:
    """The nearest of all positions on the way to that target, and of no other."""
    it = summary()
    it.session.state = replace(it.session.state, targets_ne_m=((0.0, 0.0), (1_000.0, 0.0)))
    assert it.to_go_m is None
    on_the_way = [(0, 3.0, 0.0), (1, 990.2, 30.0), (1, 1_000.0, 9.8), (1, 1_000.0, 32.6)]
    for target, north_m, east_m in on_the_way:
        state = it.session.state
        here = replace(state.vehicle, position_nea_m=(north_m, east_m, 4_000.0))
        it.session.state = replace(state, vehicle=here, flight=replace(state.flight, target=target))
        it.note_passing()
    assert it.passed_m == pytest.approx(9.8)
    assert it.to_go_m == pytest.approx(32.6)  # horizontal


def test_only_a_flight_that_nobody_has_decided_to_end_in_the_air_may_go_on() -> None:
    """And none that was only watched."""
    for reason, airborne, shadow in itertools.product(Reason, (False, True), (False, True)):
        it = summary(shadow=shadow)
        it.session.state = replace(it.session.state, reason=reason, airborne=airborne)
        in_flight = airborne and not shadow
        assert it.may_go_on is (in_flight and reason in LEFT_OVER)
        it.died = True
        assert it.may_go_on is in_flight
