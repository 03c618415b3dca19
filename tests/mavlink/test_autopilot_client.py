"""One autopilot's client against the simulator: fences, breaches, parameters, speed, take-off."""

import itertools
from dataclasses import replace
from typing import Any

import pytest
from harness import GCS
from held import FOUR, MISSIONS, Held, placed, polygon, stored, waypoints
from wires import assert_told, heard, over_the_wire

from companion.config import load_mission
from companion.mavlink.autopilot_client import AutopilotClient
from companion.mavlink.autopilots import ALL, ARDUCOPTER, PX4_MULTICOPTER, Autopilot, px4
from companion.mavlink.dialect import EventMessage, codec, wire
from companion.mavlink.frames import Receiver
from companion.mavlink.parameter_client import ANSWER_S
from companion.mission import checkpoint, events
from companion.mission.decisions import Context
from companion.mission.events import FenceChanged, FenceReading, Item
from companion.mission.state import State
from vehicle_sim.plans import PlanKind

COPTER, PX4 = FOUR[0], FOUR[2]
MISSION, FENCE, RALLY = PlanKind


def context(name: str = "sitl-px4", *, shadow: bool = True, **changes: Any) -> Context:
    mission = replace(load_mission(name), **changes)
    return Context(mission=mission, seed=1, lockstep=True, shadow=shadow)


class Side(Held):
    """A vehicle, its client, and the events that it tells."""

    def __init__(self, way: Any, *, sets: bool = False, **changes: Any) -> None:
        super().__init__(*way)
        number = FOUR.index(way)
        of = context(MISSIONS[number], shadow=not sets, **changes)
        self.side = AutopilotClient(of, 1, ALL[number])
        self.client, self.hears_home, self.deaf_to = self, True, ""
        self.events: list[Any] = []

    def on_message(self, message: Any, now_s: float) -> list[Any]:
        is_home = message.get_type() == "HOME_POSITION"
        if message.get_srcComponent() != 1 or (is_home and not self.hears_home):
            return []
        replies = self.side.on_message(message, now_s)
        self.side.event_of(message, now_s)
        self.events += self.side.news(now_s)
        return replies

    def say(self, messages: list[Any]) -> None:
        super().say([each for each in messages if each.get_type() != self.deaf_to])

    def on_time(self, now_s: float) -> list[Any]:
        begin = [] if self.side.streams.begun else self.side.streams.begin(now_s)
        return begin + self.side.on_time(now_s)

    def told(self, *kinds: type) -> list[Any]:
        return [event for event in self.events if isinstance(event, kinds)]

    def refusals(self, item: Item) -> list[str]:
        """Of what is prepared or refused: "" is prepared."""
        return [event.refusal for event in self.told(events.Prepared) if event.item is item]

    def until_prepared(self, item: Item = Item.PLANS) -> "Side":
        self.until(lambda: bool(self.refusals(item)), 60.0)
        return self


SETS = {
    "ardupilot": {"FENCE_TYPE": 3.0, "FENCE_RADIUS": 212.5},
    "px4": {"COM_OBL_RC_ACT": 5.0, "COM_OF_LOSS_T": 0.7, "COM_RCL_EXCEPT": -1.0},
}
FAULTS = {  # and within what time all is there
    "link_loss 0 %": 8.0,
    "link_loss 25 %": 60.0,
    "link_delay 700 ms": 90.0,
    "link_duplication 50 %": 15.0,
    "for 19 s: link_off": 40.0,
}


@pytest.mark.sample(5)
@pytest.mark.parametrize("way", FOUR, ids=" ".join)
@pytest.mark.parametrize("fault", FAULTS)
def test_all_comes_whole_and_what_is_set_is_read_back(way: Any, fault: str) -> None:
    """A silent link is not flooded, and changes no list."""
    it, sets = Side(way), SETS[way[0]]
    client, plans, there = it.side.parameters, it.side.plans, it.simulation.parameters
    known = {name: there[name] for name in client.waiting if name in there}
    rally = [stored(5100, 0.0, -100.0 * k, 30.0) for k in range(3)]
    lists = {FENCE: polygon(40), MISSION: waypoints(9), RALLY: rally}
    for kind, items in lists.items():
        it.plan(kind, *items)
    it.fault(fault)
    it.until(lambda: client.is_done and plans.is_done, FAULTS[fault])
    assert client.values == pytest.approx(known, rel=1e-6)
    read_s = [at_s for at_s, m in it.sent if at_s < 20.0 and m.get_type() == "PARAM_REQUEST_READ"]
    for at_s in read_s if "link_off" in fault else ():
        assert sum(at_s <= other < at_s + ANSWER_S - 0.02 for other in read_s) <= 6
    for name, value in sets.items():
        client.set(name, value)
    it.until(lambda: client.is_done, 30.0)
    assert client.failed_sets == {}
    for values in (client.values, there):
        assert {name: values[name] for name in sets} == pytest.approx(sets)
    it.fault("for 30 s: link_off")
    it.run(30.0)
    for kind, items in lists.items():
        begin = int(kind == MISSION and way[0] == "ardupilot")  # item 0 is home there
        assert placed(plans.plans[kind].items)[begin:] == placed(items)[begin:]
    assert [plans.plans[kind].version for kind in lists] == [1, 1, 1]


@pytest.mark.sample(2)
@pytest.mark.parametrize("way", FOUR, ids=" ".join)
def test_a_fence_that_is_drawn_in_flight_is_told_before_it_is_read(way: Any) -> None:
    """One of a few items is known within 10 s."""
    it = Side(way).until_prepared()
    it.run(3.0)
    sizes = [(5, 100.0), (5, 140.0), (0, 0.0), (40, 100.0), (60, 100.0), (60, 140.0)]
    for fence in (polygon(items, size_m) for items, size_m in sizes):  # more; as many, elsewhere
        it.events.clear()
        it.plan(FENCE, *fence)
        it.until(lambda: bool(it.told(FenceChanged)), 10.0 if len(fence) < 40 else 90.0)
        it.run(1.3)
        told = it.told(FenceReading, FenceChanged)
        kinds = [FenceReading, FenceChanged, FenceReading] if fence else [FenceChanged]
        assert [type(event) for event in told] == kinds
        assert not fence or [told[0].items, told[2].items] == [len(fence), 0]
        assert placed(it.side.plans.plans[FENCE].items) == placed(fence)
    it.events.clear()
    it.run(90.0)  # it is read again, and is the same
    assert not it.told(FenceReading)


def test_a_fence_about_home_waits_for_home_and_stays_in_force_while_it_is_read_anew() -> None:
    """Else a vehicle whose home is heard last arms before its fence is held against the mission."""
    it = Side(PX4)
    it.simulation.set_parameter("GF_MAX_HOR_DIST", 60.0)
    it.plan(FENCE, *polygon(7))
    it.hears_home = False
    it.run(30.0)
    assert not it.refusals(Item.PLANS)
    it.hears_home = True
    assert "fence about home (radius 60 m)" in it.until_prepared().refusals(Item.PLANS)[0]
    it.side.rebooted()
    assert (it.side.parameters.is_done, it.side.parameters.values) == (False, {})
    it.hears_home = False
    it.run(8.0)
    assert [len(event.zones) for event in it.told(FenceChanged)] == [2]  # not: what needs no home
    assert any("2 zones stay in force" in note for note in it.side.notes)
    it.plan(FENCE)
    it.hears_home = True
    it.run(20.0)
    assert [len(event.zones) for event in it.told(FenceChanged)] == [2, 1]


def px4_event(name: str) -> Any:
    """As PX4 sends it to everybody: EVENT, the id of its component in the last byte."""
    number = px4.event_id(name) | 1 << 24
    payload = EventMessage.unpacker.pack(number, 5, 1, 0, 0, 0x33, *[0] * 40)
    sent = EventMessage(0, 0, number, 5, 1, 0x33, [0] * 40)
    [read] = Receiver().feed(sent._pack(codec(1), EventMessage.crc_extra, payload))
    return read


def text(said: str) -> Any:
    return heard("STATUSTEXT", text=said.encode())


def test_a_breach_is_what_autopilots_say_of_one() -> None:
    assert px4.event_id("check_modes_offboard_signal") == 3087815  # as recorded (px4.md 6)
    for autopilot, message, is_breach in (
        (ARDUCOPTER, text("Polygon fence breached"), True),
        (ARDUCOPTER, text("Max Alt and Circle fences breached"), True),
        (ARDUCOPTER, text("Fence upload timeout"), False),
        (PX4_MULTICOPTER, text("Geofence: approaching or outside geofence\t"), True),
        (PX4_MULTICOPTER, text("Reposition is outside geofence\t"), False),
        (PX4_MULTICOPTER, text("Geofence requires valid home"), False),
        (PX4_MULTICOPTER, px4_event("check_gf_violation"), True),
        (PX4_MULTICOPTER, px4_event("check_gf_violation_custom_gf"), True),
        (PX4_MULTICOPTER, px4_event("check_modes_offboard_signal"), False),
        (ARDUCOPTER, px4_event("check_gf_violation"), False),
    ):
        told = AutopilotClient(context(), 1, autopilot).event_of(message, 7.0)
        assert told == (events.FenceBreach(time_s=7.0) if is_breach else None), message
    side, told_of = AutopilotClient(context(), 1, ARDUCOPTER), []
    for breached, count in ((0, 0), (1, 1), (1, 1), (0, 1), (1, 2)):  # each once
        message = heard("FENCE_STATUS", breach_status=breached, breach_count=count)
        told_of.append(side.event_of(message, 1.0) is not None)
    assert told_of == [False, True, False, False, True]


@pytest.mark.parametrize(
    ("times", "each_s", "ends_as", "refusal"),
    [
        (1, 12.0, 5.0, ""),
        (6, 9.0, 0.0, "somebody keeps setting it back. End that: "),
        (0, 0.0, 0.0, "it was told 5 and says 0. Set it to 5 by hand: "),
    ],
)
def test_a_parameter_that_does_not_stay_as_set_is_refused_once_and_not_fought_for_ever(
    times: int, each_s: float, ends_as: float, refusal: str
) -> None:
    """COM_OBL_RC_ACT is to be 5; a station sets it back to 0 so often, or PARAM_SET is lost."""
    it = Side(PX4, sets=True)
    it.simulation.set_parameter("COM_OBL_RC_ACT", 0.0)
    it.deaf_to = "" if times else "PARAM_SET"
    it.until(lambda: it.side.parameters.is_done and bool(it.refusals(Item.PARAMETERS)), 30.0)
    for _ in range(times):
        it.send(wire.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", 0.0, 6), source=GCS)
        it.run(each_s)
    assert it.side.parameters.values["COM_OBL_RC_ACT"] == ends_as
    said = [line for line in it.refusals(Item.PARAMETERS) if line]
    rule = "when the stream stops the vehicle sinks without RC"
    assert said == [f"COM_OBL_RC_ACT = 0: {refusal}{rule}"] * bool(refusal)
    notes = [note for note in it.side.notes if "COM_OBL_RC_ACT" in note]
    assert notes == ["set COM_OBL_RC_ACT to 5"]
    sets = [each for _, each in it.sent if each.get_type() == "PARAM_SET"]
    assert 2 * bool(times) <= [each.param_id for each in sets].count("COM_OBL_RC_ACT") <= 6


@pytest.mark.parametrize("shift_s", [-595.0, 86_400.0])
def test_by_another_clock_the_same_is_asked_at_the_same_moments(shift_s: float) -> None:
    """As after a restart in flight: the clock of before goes on until the vehicle's is heard."""
    asked = []
    for shifted_s in (0.0, shift_s):
        it = Side(COPTER)
        it.run(1.0)
        it.side.rebase_time(shifted_s)
        now_s = it.now_s + shifted_s
        times_s = (now_s + 0.097 * k for k in range(100))  # unanswered; no wait ends at one of them
        said = (it.side.on_time(at_s) for at_s in times_s)
        asked.append([sorted(bytes(each.pack(codec(1))) for each in told) for told in said])
    assert asked[0] == asked[1]
    assert len([told for told in asked[0] if told]) > 10


def beat(mode: int = wire.PLANE_MODE_GUIDED) -> Any:
    return heard("HEARTBEAT", type=1, autopilot=3, base_mode=129, custom_mode=mode)


def ack(command: int, result: int) -> Any:
    return heard("COMMAND_ACK", command=command, result=result)


SPEED, REPOSITION = wire.MAV_CMD_GUIDED_CHANGE_SPEED, wire.MAV_CMD_DO_REPOSITION


@pytest.mark.parametrize(
    ("hears", "goes_on", "notes"),
    [
        ([ack(REPOSITION, 0), beat(), beat()], True, []),
        ([beat(wire.PLANE_MODE_LOITER)], False, []),
        ([ack(SPEED, wire.MAV_RESULT_ACCEPTED)], False, []),
        (
            [ack(SPEED, wire.MAV_RESULT_DENIED)],
            *(False, ["the autopilot does not take the mission's speed"]),
        ),
    ],
)
def test_a_plane_is_told_its_speed_each_second_until_it_answers_or_somebody_else_flies_it(
    hears: list[Any], goes_on: bool, notes: list[str]
) -> None:
    """The first frame may have been lost; and by another clock the seconds are the same."""
    of = context("sitl-arduplane")
    side: Any = AutopilotClient.of(beat(), of)
    side.streams.begin(0.0)
    state = State.of(of.mission, checkpoint.blank_map(of.mission))
    [told] = side.command_messages(events.SetSpeed(speed_m_s=22.0), state)
    for message in hears:
        side.event_of(message, 0.5)
    side.rebase_time(-595.0)
    said = [each for tenth in range(100) for each in side.on_time(tenth / 10 - 595.0)]
    times = [each.get_type() for each in said].count(told.get_type())
    assert 9 * goes_on <= times <= 10 * goes_on
    assert side.notes == notes


def test_it_is_armed_and_disarmed_without_force_and_a_take_off_is_taken_once_accepted() -> None:
    of = context()
    side = AutopilotClient(of, 7, PX4_MULTICOPTER)
    state = State.of(of.mission, checkpoint.blank_map(of.mission))
    for command, value in ((events.Arm(), 1.0), (events.Disarm(), 0.0)):
        [message] = side.command_messages(command, state)
        numbers = {"param1": value} | {f"param{n}": 0.0 for n in range(2, 8)}
        to = {"target_system": 7, "target_component": 1}
        assert_told(over_the_wire(message), "COMMAND_LONG", command=400, **to, **numbers)
    for number in (wire.MAV_CMD_NAV_TAKEOFF, wire.MAV_CMD_COMPONENT_ARM_DISARM):
        told = [side.event_of(ack(number, result), 3.0) for result in range(6)]
        taken = events.TakeOffTaken(time_s=3.0) if number == wire.MAV_CMD_NAV_TAKEOFF else None
        assert told == [taken, *[None] * 5]  # MAV_RESULT_ACCEPTED is 0


@pytest.mark.parametrize("autopilot", ALL, ids=lambda each: each.name)
def test_of_answers_to_setpoints_only_the_refusals_of_an_arduplane_are_noted(
    autopilot: Autopilot,
) -> None:
    client = AutopilotClient(context(), 7, autopilot)
    for command, result in itertools.product((REPOSITION, wire.MAV_CMD_DO_SET_MODE), range(10)):
        refuses = autopilot.traits.name == "ArduPlane" and result != wire.MAV_RESULT_ACCEPTED
        noted = client.journal_entry(ack(command, result))
        assert (noted is not None) is (refuses or command != REPOSITION)


def test_how_the_vehicles_own_mission_ends_is_not_passed_over_in_silence() -> None:
    """The companion ends as its own mission says: who has drawn an RTL has to hear of it."""
    it = Side(COPTER, targets_from_vehicle=True)
    it.plan(MISSION, *waypoints(3), stored(20, 0.0, 0.0, 0.0))
    said = it.until_prepared().side.notes
    assert said == ["its mission ends with return; what counts is end.action: land"]
