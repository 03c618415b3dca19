"""The whole companion as bytes in and bytes out, against a scripted vehicle."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import scripted_vehicle
from lidars import obstacle_distance
from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import BRAKE, GUIDED, LAND, MISSION, Pair, Vehicle, messages, pair

from companion.config import load_mission
from companion.mavlink.autopilots import ARDUPLANE, PX4_FIXED_WING
from companion.mavlink.autopilots.common import Autopilot
from companion.mission import checkpoint
from companion.mission.events import Outcome
from companion.mission.state import Phase, Reason
from companion.session import Session

SETPOINT = "SET_POSITION_TARGET_GLOBAL_INT"
COMMANDS = ("COMMAND_LONG", "COMMAND_INT", SETPOINT)
ASKS = (wire.MAV_CMD_SET_MESSAGE_INTERVAL, wire.MAV_CMD_REQUEST_MESSAGE)
"""What moves or changes nothing."""


@cache
def _flown_to(phase: Phase) -> Pair:
    it = pair()
    if phase is Phase.HOLDING:
        it.fly_out().ask(wire.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
    return it.fly_out() if phase is Phase.FLYING else it.fly_to(phase)


def flown_to(phase: Phase = Phase.FLYING) -> Pair:
    """Each gets its own; flying: on its first leg."""
    return deepcopy(_flown_to(phase))


def times(it: Pair, kind: str) -> list[float]:
    return [entry["t_s"] for entry in it.journal if entry["kind"] == kind]


def texts(frames: list[bytes]) -> list[str]:
    """What a ground station shows: chunks put together."""
    said = [message for message in messages(frames) if message.get_type() == "STATUSTEXT"]
    whole = "".join(f"{'' if message.chunk_seq else chr(0)}{message.text}" for message in said)
    return whole.split("\0")[1:]


def test_a_flight_ends_at_its_target_and_every_frame_is_ours_counts_on_and_is_recorded() -> None:
    """Each position is answered by one setpoint; heartbeats say in which state it is."""
    it = pair().run_until(lambda it: it.out.end is not None)
    assert (it.end.outcome, it.vehicle.mode, it.out.settled) == (Outcome.ARRIVED, BRAKE, True)
    assert (it.vehicle.north_m, it.vehicle.east_m) == pytest.approx((4000, 3000), abs=1.0)
    sent = messages(it.frames)
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in sent} == {(1, 195)}
    assert {m.target_system for m in sent if hasattr(m, "target_system")} == {1}
    assert all(frame[0] == 0xFD for frame in it.frames)
    assert all((a.get_seq() + 1) % 256 == b.get_seq() for a, b in pairwise(sent))
    assert [frame for _, frame in it.record if frame[6] == 195] == it.frames
    stamps = [time_s for time_s, _ in it.record]
    assert stamps == sorted(stamps)
    assert len(it.record) > len(it.frames) + 100
    answers_ms = [m.time_boot_ms for m in it.sent(SETPOINT)]
    assert len(answers_ms) > 300
    assert set(np.diff(answers_ms)) == {100}
    states = [message.system_status for message in it.sent("HEARTBEAT")]
    assert list(dict.fromkeys(states)) == [wire.MAV_STATE_STANDBY, wire.MAV_STATE_ACTIVE]
    [last] = messages(it.session.farewell().frames)
    assert (last.get_type(), last.system_status) == ("HEARTBEAT", wire.MAV_STATE_POWEROFF)


# --- lockstep, and when a plan counts


def test_every_timesync_is_answered_once_after_everything_before_it_and_answers_are_not() -> None:
    it = pair().run_for(5.0)
    answered = [m.ts1 for m in it.sent("TIMESYNC") if m.tc1 != 0]
    assert answered == [tick * 100_000_000 for tick in range(30, 51)]  # once it has latched
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
    it.session.deliver(it.planner(it.asked))
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
    it.session.deliver(it.planner(it.asked))
    assert not it.take(it.session.run()).awaits_plan
    assert it.sent("TIMESYNC")[-1].ts1 == it.vehicle.time_ms * 1_000_000
    assert "plan late" not in it.kinds()


def test_in_real_time_a_plan_that_is_due_is_late_once_and_taken_when_it_comes() -> None:
    it = asked(lockstep=False).run_for(8.0)
    assert it.kinds().count("plan late") == 1
    assert not it.out.awaits_plan
    it.session.deliver(it.planner(it.asked))
    it.tick()
    assert it.kinds().count("plan ready") == 1


@pytest.mark.parametrize("waits", [True, False])
def test_a_simulator_in_lockstep_is_noticed_by_a_companion_that_is_not(waits: bool) -> None:
    it = pair(lockstep=False)
    it.vehicle.lockstep = it.vehicle.sends_synchronisation = waits
    assert ("lockstep" in it.run_for(8.0).session.warned[1]) is waits


# --- who is listened to


def test_what_other_components_and_other_systems_say_is_not_the_vehicles() -> None:
    """Nor is terrain of a ground station believed."""
    it = pair().run_until(lambda it: bool(it.vehicle.to_scan))
    [request] = it.vehicle.to_scan
    before = it.session.state
    for system, component in ((1, 190), (1, 100), (2, 1), (255, 190)):
        codec = wire.MAVLink(None, srcSystem=system, srcComponent=component)
        late = wire.MAVLink_global_position_int_message(99_999_000, 1, 2, 3, 4, 5, 6, 7, 8)
        beat = wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        for message in (beat, late, wire.MAVLink_timesync_message(0, 99)):
            it.feed(message.pack(codec))
    assert it.session.state is before
    assert it.sent("TIMESYNC")[-1].ts1 != 99
    bit = next(bit for bit in range(56) if request.mask >> bit & 1)
    block = wire.MAVLink_terrain_data_message(request.lat, request.lon, 250, bit, [9] * 16)
    it.feed(block.pack(wire.MAVLink(None, srcSystem=255, srcComponent=190)))
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
    vehicles = [Vehicle(lockstep=False) for _ in systems]
    it = Pair(session, Vehicle(lockstep=False))
    for vehicle, system in zip(vehicles, systems, strict=True):
        vehicle.autopilot.srcSystem = system
    for vehicle in heartbeats * vehicles:
        it.feed(vehicle.heartbeat())
    assert it.phase is phase
    if phase is Phase.PREPARING:
        told = [message for message in messages(it.frames) if hasattr(message, "target_system")]
        assert {message.target_system for message in told} == {systems[-1]}
        assert messages(session.farewell().frames)[0].get_srcSystem() == systems[-1]
        assert session.selector.others == {*systems[:-1]}
    elif phase is Phase.DONE:
        assert session.selector.others == {2, 3}
        [end] = [entry for entry in it.journal if entry["kind"] == "end"]
        assert "systems 2, 3 are heard, choose one with --system" in end["reason"]


# --- streams and clocks


def test_streams_that_do_not_arrive_are_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """And no others."""
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
    """In flight all streams end, as after a reboot of a router; the radio itself goes on.

    What was heard just before is no older by it, or the vehicle is silent when it is found again.
    """
    it = flown_to()
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
    assert Reason.LINK_LOST.text not in texts(it.fly_to(Phase.FLYING).frames)


@pytest.mark.parametrize("copies", [1, 3])
def test_a_moment_of_a_wrong_time_changes_nothing_of_a_flight(copies: int) -> None:
    """Its position, 11 m to the north, is not believed either."""
    undisturbed = flown_to().run_for(5.0)
    for off_ms in (1_000_000, 2_500, -2_500, 4_000_000_000):
        it = flown_to()
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


def test_that_it_has_left_its_path_is_noted_at_once() -> None:
    """Not with what changes next."""
    it = flown_to()
    tube_m, before = it.session.state.leg.motion.tube_m, times(it, "path_left")
    for share in (0.2, 0.4, 0.6, 0.8, 0.95, 1.1):  # a jump that is larger is not believed
        it.vehicle.north_m -= 0.6 * share * tube_m
        it.vehicle.east_m += 0.8 * share * tube_m
        it.tick()
    assert times(it, "path_left") == [*before, pytest.approx(it.vehicle.time_ms * 1e-3)]


# --- silence, and what must not be sent


@pytest.mark.parametrize(("lockstep", "longest_s"), [(True, 30.0), (False, 600.0)])
def test_silence_in_flight_holds_and_much_later_ends_it(lockstep: bool, longest_s: float) -> None:
    it = asked(lockstep)
    it.session.silence(2.9)
    assert it.phase is Phase.FLYING
    it.session.silence(3.0)
    assert it.session.state.reason is Reason.LINK_LOST
    it.session.silence(longest_s - 0.1)
    assert it.session.run().end is None
    it.session.silence(longest_s + 0.1)
    assert it.session.run().end is not None


def test_a_refused_setpoint_is_followed_by_nothing_but_the_hold() -> None:
    """Resuming from a hold begins with a setpoint and the guided mode: refused, neither is sent."""
    it = flown_to()
    it.vehicle.streams_ms, streams = {}, it.vehicle.streams_ms
    for _ in range(4):
        it.feed(it.vehicle.heartbeat())
    assert it.phase is Phase.HOLDING
    it.vehicle.streams_ms, it.vehicle.altitude_m = streams, 60_000.0
    count = len(it.frames)
    said = it.run_for(10.0).since(count)
    assert "setpoint refused" in it.kinds()
    assert it.phase is Phase.FAULTED
    assert any("setpoint out of range" in text for text in texts(it.frames[count:]))
    assert GUIDED not in [m.param2 for m in said if m.get_type() == "COMMAND_LONG"]
    assert it.vehicle.mode == BRAKE


def test_what_steps_into_its_way_stops_it_within_0_2_s(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lidar is all that it sees by, and it sees all round."""

    class Seeing(Vehicle):
        thing_cm = 1601  # nothing

        def tick(self) -> bytes:
            said, things_cm = super().tick(), [self.thing_cm] * 72
            sweep = obstacle_distance(self.time_ms * 1e-3, things_cm, reach_cm=1600)
            return sweep.pack(wire.MAVLink(None, srcSystem=1, srcComponent=196)) + said

    monkeypatch.setattr(scripted_vehicle, "HOME_AMSL_M", 400.0)
    vehicle = Seeing()
    vehicle.parameters["GUID_TIMEOUT"] = 0.5
    it = Pair(Session(load_mission("forest"), seed=1, lockstep=True, go=True), vehicle).fly_out()
    it.run_until(lambda it: it.session.state.reference.speed_m_s > 2.0)
    vehicle.thing_cm = 600
    it.run_for(0.2)
    assert it.session.state.path.stop.reason is Reason.NEW_THREAT
    assert it.fly_to(Phase.HOLDING, 10.0).session.state.reason is Reason.NEW_THREAT


# --- another companion with our ids


def test_the_one_that_came_second_ends_in_the_air_and_the_first_flies_on() -> None:
    """Even with the path of the first, from the same run folder."""
    first = flown_to().run_for(3.0)
    values = {"system_id": 1, **checkpoint.values_of(first.session.state)}
    resume = values, first.session.state.flight.known
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
    assert sum(Reason.NOT_ALONE.text in text for text in texts(first.frames)) == 1
    assert "another companion" in first.kinds()
    assert first.session.warned[1].startswith(Reason.NOT_ALONE.text)
    assert first.phase is Phase.FLYING


# --- every end is said on the link before the heartbeat ends, by name and with its reason

DIED = f"{Reason.PLANNER_DIED.text}: writer: OSError: x"
ENDS: dict[str, tuple[Callable[[Session], object], Outcome, str]] = {
    "a person": (lambda it: it.stop(), Outcome.STOPPED, Reason.STOPPED.text),
    "a part": (lambda it: it.part_died("writer", "OSError: x"), Outcome.FAILED, DIED),
    "silence": (lambda it: it.silence(700.0), Outcome.FAILED, ""),
}
PHASES = (Phase.WAITING, Phase.PREPARING, Phase.ARMING, Phase.TAKING_OFF, Phase.FLYING)
PHASES += (Phase.HOLDING, Phase.ARRIVED)
"""That a scripted vehicle comes through by itself, or by one order."""


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("end", ENDS)
def test_whatever_ends_it_in_whatever_phase(end: str, phase: Phase) -> None:
    """The last text names the end, and goes out with the very output that tells of it.

    Led in the air it is left holding, and settled when it says so.
    """
    it, (ends, outcome, why) = flown_to(phase), ENDS[end]
    ends(it.session)
    out = it.take(it.session.run())
    assert (it.end.outcome, it.end.reason) == (outcome, why or it.end.reason)
    assert ("part died" in it.kinds()) is (end == "a part")
    last = texts(out.frames)[-1]
    assert last.startswith(f"ended, {it.end.outcome.value}: {it.end.reason}"[:190])
    count, is_led = len(it.frames), phase is Phase.FLYING and end != "silence"
    it.session.complain("refused: 7 unsigned")
    assert not (is_led and out.settled)
    it.run_for(10.0).take(it.session.farewell())
    assert texts(it.frames[count:]) == []
    assert not is_led or (it.out.settled and it.vehicle.mode == BRAKE)


def test_hold_frames_and_a_farewell_put_a_vehicle_that_flies_for_us_on_hold() -> None:
    """A reserve for the parts that die; it changes nothing, and is empty once another has it."""
    it = flown_to()
    before = it.session.state
    [hold] = messages(it.session.hold_frames())
    [said] = messages(it.session.final_text("x"))
    assert (said.text, it.session.state is before) == ("ended, failed: x", True)
    again, text, heartbeat = messages(deepcopy(it.session).farewell().frames)
    for each in (hold, again):
        assert (each.command, each.param2) == (176, BRAKE)
    assert text.text == "ended: the companion was stopped"
    assert heartbeat.get_type() == "HEARTBEAT"
    it.vehicle.mode = 5  # somebody takes it
    assert it.fly_to(Phase.HOLDING).session.hold_frames() == []


@pytest.mark.parametrize("kind", [ARDUPLANE, PX4_FIXED_WING], ids=lambda kind: kind.name)
def test_a_plane_that_circles_is_left_on_its_circle(kind: Autopilot) -> None:
    """By itself it would hold on another, a radius beside: nobody has proven that one."""
    it = flown_to()
    state, vehicle = it.session.state, it.session.vehicle
    vehicle.autopilot, state.vehicle.traits = kind, kind.traits
    state.path.circling, state.flight.hover_nea_m = True, (30.0, 40.0, 650.0)
    *modes, circle = messages(it.session.hold_frames())
    assert (circle.command, circle.z) == (wire.MAV_CMD_DO_REPOSITION, 650.0)
    place = [circle.x * 1e-7, circle.y * 1e-7]
    assert place == pytest.approx(it.session.mission.frame.to_geodetic_deg(30.0, 40.0), abs=1e-6)
    assert [each.command for each in modes] == [176] * (kind is PX4_FIXED_WING)


@pytest.mark.parametrize("phase", [Phase.FLYING, Phase.LANDING])
def test_who_lands_it_in_the_moment_of_the_end_is_not_overruled(phase: Phase) -> None:
    """But a landing of ours, which a person has broken off, is told to stop until it does."""
    it = flown_to()
    if phase is Phase.LANDING:
        it.ask(wire.MAV_CMD_NAV_LAND)
        it.fly_to(phase)
    it.vehicle.deaf_to = (wire.MAV_CMD_DO_SET_MODE,)
    it.session.stop()
    it.take(it.session.run())
    it.vehicle.mode = LAND
    it.run_until(lambda it: it.vehicle.time_ms % 1000 == 0)  # its heartbeat says so
    count = len(it.frames)
    told = [m for m in it.run_for(4.0).since(count) if m.get_type() == "COMMAND_LONG"]
    holds = [m for m in told if (m.command, m.param2) == (wire.MAV_CMD_DO_SET_MODE, BRAKE)]
    assert bool(holds) == (phase is Phase.LANDING)
