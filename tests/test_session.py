"""The whole companion as bytes in and bytes out, against a scripted vehicle."""

from copy import deepcopy
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import BRAKE, GUIDED, MISSION, Pair, Vehicle, messages, pair, straight_plan

from companion.mission import checkpoint
from companion.mission.events import Outcome
from companion.mission.state import Phase, Reason
from companion.session import Session

LATCHED_S = 3.0  # heartbeats of one a second
SETPOINT = "SET_POSITION_TARGET_GLOBAL_INT"


def ended(it: Pair) -> bool:
    return it.out.end is not None


@cache
def _on_its_way() -> Pair:
    return pair().fly_out()


def flying() -> Pair:
    return deepcopy(_on_its_way())


def times(it: Pair, kind: str) -> list[float]:
    return [entry["t_s"] for entry in it.journal if entry["kind"] == kind]


# --- one whole flight


@pytest.fixture(scope="module")
def flown() -> Pair:
    return pair().run_until(ended)


def test_it_ends_at_its_target_and_every_frame_is_ours_counts_on_and_is_recorded(
    flown: Pair,
) -> None:
    assert flown.end.outcome is Outcome.ARRIVED
    assert (flown.vehicle.north_m, flown.vehicle.east_m) == pytest.approx((4000, 3000), abs=1.0)
    assert flown.vehicle.mode == BRAKE
    assert flown.out.settled
    sent = messages(flown.frames)
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in sent} == {(1, 195)}
    assert {m.target_system for m in sent if hasattr(m, "target_system")} == {1}
    assert all(frame[0] == 0xFD for frame in flown.frames)
    assert all((a.get_seq() + 1) % 256 == b.get_seq() for a, b in pairwise(sent))
    ours = [frame for _, frame in flown.record if messages([frame])[0].get_srcComponent() == 195]
    assert ours == flown.frames
    stamps = [time_s for time_s, _ in flown.record]
    assert stamps == sorted(stamps)
    assert len(flown.record) > len(flown.frames) + 100
    answers_ms = [m.time_boot_ms for m in flown.sent(SETPOINT)]  # one to each position
    assert len(answers_ms) > 300
    assert np.diff(answers_ms).tolist() == [100] * (len(answers_ms) - 1)


def test_it_says_each_vehicle_second_in_which_state_it_is_until_it_leaves(flown: Pair) -> None:
    said = [(time_s, message) for time_s, frame in flown.record for message in messages([frame])]
    beats = [(t_s, m) for t_s, m in said if (m.get_msgId(), m.get_srcComponent()) == (0, 195)]
    gaps = np.diff([time_s for time_s, _ in beats])
    assert beats[0][0] <= 1.0
    assert gaps.min() > 0.89
    assert gaps[1:].max() < 1.11  # a tick is 0.1 s; before it has latched nobody is there to tell
    states = [m.system_status for _, m in beats]
    assert list(dict.fromkeys(states)) == [wire.MAV_STATE_STANDBY, wire.MAV_STATE_ACTIVE]
    [last] = messages(flown.session.farewell().frames)
    assert (last.get_type(), last.system_status) == ("HEARTBEAT", wire.MAV_STATE_POWEROFF)


# --- lockstep, and when a plan counts


def test_every_timesync_is_answered_once_after_everything_before_it_and_answers_are_not() -> None:
    it = pair().run_for(5.0)
    answered = [m.ts1 for m in it.sent("TIMESYNC") if m.tc1 != 0]
    assert answered == [tick * 100_000_000 for tick in range(round(LATCHED_S * 10), 51)]
    count = len(it.frames)
    it.feed(it.vehicle.pack(wire.MAVLink_timesync_message(77, 88)))
    assert it.frames[count:] == []
    count = len(it.fly_out().frames)
    it.tick()
    *before, last = it.since(count)
    assert SETPOINT in [message.get_type() for message in before]
    assert (last.get_type(), last.tc1) == ("TIMESYNC", last.ts1)
    assert last.ts1 == it.vehicle.time_ms * 1_000_000


def asked(lockstep: bool) -> Pair:
    return pair(lockstep=lockstep).run_until(lambda it: it.asked is not None)


@pytest.mark.parametrize("lockstep", [True, False])
def test_a_plan_delivered_at_once_counts_at_request_plus_t(lockstep: bool) -> None:
    it = asked(lockstep)
    it.session.deliver(straight_plan(it.asked))
    it.run_until(lambda it: bool(times(it, "plan ready")))
    due_s = times(it, "plan asked")[0] + MISSION.task.settings.planning_time_s
    assert due_s - 1e-9 <= times(it, "plan ready")[0] < due_s + 0.1001


def test_in_lockstep_run_stops_before_the_position_at_which_the_plan_is_due() -> None:
    it = asked(lockstep=True)
    due_s = times(it, "plan asked")[0] + 5.0
    while not it.out.awaits_plan:
        it.session.receive(it.vehicle.tick())
        it.take(it.session.run())
    assert it.vehicle.time_ms * 1e-3 == pytest.approx(due_s, abs=0.1001)
    assert it.sent("TIMESYNC")[-1].ts1 < it.vehicle.time_ms * 1_000_000
    assert it.session.run().awaits_plan  # it keeps waiting
    it.session.deliver(straight_plan(it.asked))
    assert not it.take(it.session.run()).awaits_plan
    assert it.sent("TIMESYNC")[-1].ts1 == it.vehicle.time_ms * 1_000_000
    assert "plan late" not in it.kinds()


def test_in_real_time_a_plan_that_is_due_is_late_once_and_taken_when_it_comes() -> None:
    it = asked(lockstep=False).run_for(8.0)
    assert it.kinds().count("plan late") == 1
    assert not it.out.awaits_plan
    it.session.deliver(straight_plan(it.asked))
    it.tick()
    assert it.kinds().count("plan ready") == 1


@pytest.mark.parametrize("waits", [True, False])
def test_a_simulator_in_lockstep_is_noticed_by_a_companion_that_is_not(waits: bool) -> None:
    it = pair(lockstep=False)
    it.vehicle.lockstep = it.vehicle.sends_synchronisation = waits
    assert ("lockstep" in it.run_for(8.0).session.warned[1]) is waits


# --- who is listened to


def test_what_other_components_and_other_systems_say_is_not_the_vehicles() -> None:
    it = flying()
    before = it.session.state
    for system, component in ((1, 190), (1, 100), (2, 1), (255, 190)):
        codec = wire.MAVLink(None, srcSystem=system, srcComponent=component)
        late = wire.MAVLink_global_position_int_message(99_999_000, 1, 2, 3, 4, 5, 6, 7, 8)
        beat = wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        for message in (beat, late, wire.MAVLink_timesync_message(0, 99)):
            it.feed(message.pack(codec))
    assert it.session.state is before
    assert it.sent("TIMESYNC")[-1].ts1 != 99


def test_terrain_of_a_ground_station_is_not_believed() -> None:
    it = pair().run_until(lambda it: bool(it.vehicle.to_scan))
    [request] = it.vehicle.to_scan
    liar = wire.MAVLink(None, srcSystem=255, srcComponent=190)
    bit = next(bit for bit in range(56) if request.mask >> bit & 1)
    block = wire.MAVLink_terrain_data_message(request.lat, request.lon, 250, bit, [9] * 16)
    it.feed(block.pack(liar))
    it.run_until(lambda it: "scan done" in it.kinds())
    assert 9.0 not in it.session.state.flight.known.upper_m


@pytest.mark.parametrize(
    ("named", "heartbeats", "systems", "phase"),
    [
        (None, 2, (7,), Phase.WAITING),
        (None, 3, (7,), Phase.PREPARING),
        (None, 4, (2, 3), Phase.WAITING),
        (None, 5, (2, 3), Phase.DONE),
        (3, 5, (2, 3), Phase.PREPARING),
    ],
)
def test_the_only_vehicle_that_is_heard_three_times_is_ours_or_the_one_that_the_mission_names(
    named: int | None, heartbeats: int, systems: tuple[int, ...], phase: Phase
) -> None:
    """Of two vehicles none is taken, and both are told of; no other vehicle is told anything."""
    session = Session(replace(MISSION, system_id=named), seed=1, lockstep=False)
    pairs = [Pair(session, Vehicle(lockstep=False)) for _ in systems]
    for it, system in zip(pairs, systems, strict=True):
        it.vehicle.autopilot.srcSystem = system
    for _ in range(heartbeats):
        for it in pairs:
            it.feed(it.vehicle.heartbeat())
    assert session.state.phase is phase
    told = [m for it in pairs for m in messages(it.frames) if hasattr(m, "target_system")]
    if phase is Phase.PREPARING:
        assert {m.target_system for m in told} == {systems[-1]}
        assert messages(session.farewell().frames)[0].get_srcSystem() == systems[-1]
        assert session.selector.others == {*systems[:-1]}
    elif phase is Phase.DONE:
        assert session.selector.others == {2, 3}
        [end] = [entry for it in pairs for entry in it.journal if entry["kind"] == "end"]
        assert "systems 2, 3 are heard, choose one with --system" in end["reason"]


# --- streams and clocks


def test_streams_that_do_not_arrive_alone_are_asked_for_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    it, never, arrive = pair(), (1, 30), {33, 245, 24, 193, 242}
    says = it.vehicle.telemetry
    monkeypatch.setattr(it.vehicle, "telemetry", lambda each: b"" if each in never else says(each))
    it.vehicle.deaf_to = (511,)
    count = len(it.run_for(6.0).frames)
    it.vehicle.deaf_to = ()
    later = [m for m in it.run_for(20.0).since(count) if m.get_type() == "COMMAND_LONG"]
    again = [int(m.param1) for m in later if m.command == 511]
    assert sorted(number for number in again if number in arrive) == sorted(arrive)  # each once
    assert len(again) > 15  # those that never arrive, every two seconds


@pytest.mark.parametrize("hears_s", [3, 30])
def test_a_stream_request_lost_before_the_clock_runs_is_repeated(hears_s: int) -> None:
    """ArduPilot loses requests in its first 40 ms, and says only HEARTBEAT until it is asked."""
    it = pair(lockstep=False)
    for second in range(30):
        it.vehicle.deaf_to = (511,) if second < hears_s else ()
        it.feed(it.vehicle.heartbeat())
        for tenth in range(1, 10):
            it.session.silence(tenth / 10)
            it.take(it.session.run())
    assert (33 in it.vehicle.streams_ms) is (hears_s < 30)
    assert len(it.sent("HEARTBEAT")) >= 15  # they go on meanwhile


@pytest.mark.parametrize("gaps_are_told", [True, False])
def test_heartbeats_alone_do_not_make_time_stand_still(gaps_are_told: bool) -> None:
    """In flight all streams end, as after a reboot of a router; the radio itself goes on."""
    it = flying()
    streams, it.vehicle.streams_ms = it.vehicle.streams_ms, {}
    for _ in range(4):
        for tenth in range(2, 10) if gaps_are_told else ():
            it.session.silence(tenth / 10)
        it.take(it.session.run())
        it.feed(it.vehicle.heartbeat())
    assert (it.phase, it.session.state.reason) == (Phase.HOLDING, Reason.POSITION_STALE)
    assert it.vehicle.mode == BRAKE
    it.vehicle.time_ms += 2000  # less than was guessed meanwhile
    it.vehicle.streams_ms = streams
    it.tick()
    assert it.session.state.now_s == it.session.now_s == it.vehicle.time_ms * 1e-3
    it.fly_to(Phase.FLYING)


def test_copies_of_a_heartbeat_do_not_make_time_pass() -> None:
    it = flying()
    before_s = it.session.state.now_s
    for _ in range(5):
        it.feed(3 * it.vehicle.heartbeat())
        it.tick()
    assert it.session.state.now_s == pytest.approx(before_s + 0.5)


def test_a_reboot_of_the_vehicle_on_the_ground_does_not_stop_the_companions_clock() -> None:
    it = pair(lockstep=False)
    it.vehicle.time_ms = 3_600_000
    count = len(it.run_for(3.0).frames)
    it.vehicle = Vehicle(lockstep=False)  # all intervals are gone, time begins again
    it.vehicle.autopilot.seq = 17
    it.vehicle.streams_ms = {33: 100}
    again = {m.get_type() for m in it.run_for(10.0).since(count)}
    assert again >= {"HEARTBEAT", "COMMAND_LONG"}


@pytest.mark.parametrize("copies", [1, 3])
def test_a_moment_of_a_wrong_time_changes_nothing_of_a_flight(copies: int) -> None:
    """Its position, 11 m to the north, is not believed either."""
    undisturbed = flying().run_for(5.0)
    for off_ms in (1_000_000, 2_500, -2_500, 4_000_000_000):
        it = flying()
        sender, stamp_ms = it.vehicle.autopilot, it.vehicle.time_ms + off_ms
        [here] = messages([it.vehicle.position()])
        place = (here.lat + 1_000, here.lon, here.alt, 0, here.vx, here.vy, here.vz, 0)
        for wrong in (
            wire.MAVLink_attitude_message(stamp_ms, 0, 0, 0, 0, 0, 0),
            wire.MAVLink_global_position_int_message(stamp_ms, *place),
            wire.MAVLink_system_time_message(0, stamp_ms),
            wire.MAVLink_local_position_ned_message(stamp_ms, 0, 0, 0, 0, 0, 0),
        ):
            it.feed(copies * wrong.pack(sender))
        it.run_for(5.0)
        told = [[m.to_dict() for m in each.sent(SETPOINT)] for each in (it, undisturbed)]
        assert told[0] == told[1]
        assert it.phase is Phase.FLYING


# --- silence, stop, death


@pytest.mark.parametrize(("lockstep", "longest_s"), [(True, 30.0), (False, 600.0)])
def test_silence_in_flight_holds_after_3_s_and_ends_it_much_later(
    lockstep: bool, longest_s: float
) -> None:
    it = asked(lockstep)
    it.session.silence(2.9)
    assert it.phase is Phase.FLYING
    it.session.silence(3.0)
    assert it.session.state.reason is Reason.LINK_LOST
    it.session.silence(longest_s - 0.1)
    assert it.session.run().end is None
    it.session.silence(longest_s + 0.1)
    assert it.session.run().end is not None


def test_hold_frames_and_a_farewell_put_a_vehicle_that_flies_for_us_on_hold() -> None:
    """A reserve for the parts that die; it changes nothing, and is empty once another has it."""
    it = flying()
    before = it.session.state
    [hold] = messages(it.session.hold_frames())
    assert it.session.state is before
    again, text, heartbeat = messages(deepcopy(it.session).farewell().frames)
    for each in (hold, again):
        assert (each.command, each.param2) == (176, BRAKE)
    assert text.text == "ended: the companion was stopped"
    assert heartbeat.get_type() == "HEARTBEAT"
    it.vehicle.mode = 5  # somebody takes it
    assert it.fly_to(Phase.HOLDING).session.hold_frames() == []


def test_a_refused_setpoint_is_followed_by_nothing_but_the_hold() -> None:
    """Resuming from a hold begins with a setpoint and the guided mode: refused, neither is sent."""
    it = flying()
    it.vehicle.streams_ms, streams = {}, it.vehicle.streams_ms
    for _ in range(4):
        it.feed(it.vehicle.heartbeat())
    assert it.phase is Phase.HOLDING
    it.vehicle.streams_ms, it.vehicle.altitude_m = streams, 60_000.0
    count = len(it.frames)
    said = it.run_for(10.0).since(count)
    assert "setpoint refused" in it.kinds()
    assert it.phase is Phase.FAULTED
    texts = "".join(m.text for m in said if m.get_type() == "STATUSTEXT")
    assert "setpoint out of range" in texts
    assert GUIDED not in [m.param2 for m in said if m.get_type() == "COMMAND_LONG"]
    assert it.vehicle.mode == BRAKE


# --- another companion with our ids


def test_a_link_that_sends_back_what_we_say_is_no_second_companion() -> None:
    it = flying()
    for _ in range(200):
        count = len(it.frames)
        it.tick()
        for _ in range(2):
            it.feed(b"".join(it.frames[count:]))
    assert it.phase is Phase.FLYING
    assert not it.session.state.is_duplicate_suspected
    assert len(it.sent(SETPOINT)) > 200


COMMANDS = ("COMMAND_LONG", "COMMAND_INT", SETPOINT)
ASKS = (wire.MAV_CMD_SET_MESSAGE_INTERVAL, wire.MAV_CMD_REQUEST_MESSAGE)
"""What moves or changes nothing."""


@pytest.mark.parametrize("same_folder", [False, True])
def test_the_one_that_came_second_ends_in_the_air_and_the_first_flies_on(same_folder: bool) -> None:
    """Also one that has the path of the first, from the same run folder."""
    first = flying().run_for(3.0)
    values = {"system_id": 1, **checkpoint.values_of(first.session.state)}
    resume = (values, first.session.state.flight.known) if same_folder else None
    mission = replace(MISSION, system_id=1)
    joins = Session(mission, seed=1, lockstep=False, go=True, resume=resume)
    second = Pair(joins, first.vehicle)
    for _ in range(300):
        begun, answered = len(first.frames), len(second.frames)
        said = first.vehicle.tick()
        first.feed(said)
        if second.out.end is None:
            second.feed(said + b"".join(first.frames[begun:]))
            first.feed(b"".join(second.frames[answered:]))
    assert (second.end.outcome, second.end.reason) == (Outcome.FAILED, Reason.NOT_ALONE.text)
    told = [message for message in messages(second.frames) if message.get_type() in COMMANDS]
    assert {getattr(message, "command", 0) for message in told} <= set(ASKS)
    says = [entry["text"] for entry in first.journal if entry["kind"] == "say"]
    assert len([text for text in says if Reason.NOT_ALONE.text in text]) == 1
    assert "another companion" in first.kinds()
    assert Reason.NOT_ALONE.text in "".join(m.text for m in first.sent("STATUSTEXT"))
    assert first.session.warned[1].startswith(Reason.NOT_ALONE.text)
    assert first.phase is Phase.FLYING
