"""What a person hears of a vehicle's own fence, drawn by a ground station in flight or before."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from held import Held, circle, polygon, waypoints
from wires import over_the_wire

from companion.config import load_mission
from companion.mavlink import fence
from companion.mavlink.autopilot_client import AutopilotClient
from companion.mavlink.autopilots import (
    ALL,
    ARDUCOPTER,
    PX4_MULTICOPTER,
    Autopilot,
    autopilot_of,
    px4,
)
from companion.mavlink.dialect import EventMessage, codec, wire
from companion.mavlink.frames import Receiver
from companion.mission import checkpoint
from companion.mission.decisions import Context
from companion.mission.events import (
    FenceBreach,
    FenceChanged,
    FenceReading,
    Item,
    Prepared,
    SetSpeed,
    TakeOffTaken,
)
from companion.mission.mission import Mission
from companion.mission.state import State
from vehicle_sim.plans import PlanItem as Stored

FENCE = 1


class Side:
    """A vehicle side as a client, and the events that it tells."""

    sets_parameters = False

    def __init__(self, held: Held, mission: str | Mission) -> None:
        self._held, self._mission = held, mission
        self.side: AutopilotClient | None = None
        self.events: list[Any] = []
        self.hears_home = True

    def on_message(self, message: Any, now_s: float) -> list[Any]:
        if self.side is None:
            autopilot = autopilot_of(message) if message.get_type() == "HEARTBEAT" else None
            if autopilot is None:
                return []
            self.side = AutopilotClient(
                load_mission(self._mission) if isinstance(self._mission, str) else self._mission,
                1,
                autopilot,
                lockstep=True,
                sets_parameters=self.sets_parameters,
            )
            return self.side.begin(now_s)
        if message.get_srcComponent() != 1:
            return []
        if message.get_type() == "HOME_POSITION" and not self.hears_home:
            return []
        replies = self.side.on_message(message, now_s)
        self.side.event_of(message, now_s)
        self.events += self.side.news(now_s)
        return replies

    def on_time(self, now_s: float) -> list[Any]:
        return [] if self.side is None else self.side.on_time(now_s, None)

    @property
    def refusals(self) -> list[str]:
        return [event.refusal for event in prepared_plans(self) if event.refusal]

    @property
    def said(self) -> list[str]:
        return [] if self.side is None else self.side.notes


def begun(firmware: Any) -> tuple[Held, Side]:
    held = Held(firmware)
    name = "sitl-px4" if firmware == "px4" else "sitl-arducopter"
    client = Side(held, name)
    held.run(60.0, client, until=lambda: bool(prepared_plans(client)))
    assert prepared_plans(client)
    return held, client


def prepared_plans(client: Side) -> list[Prepared]:
    told = (event for event in client.events if isinstance(event, Prepared))
    return [event for event in told if event.item is Item.PLANS]


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_what_is_said_of_a_fence_that_is_drawn_later_is_said_once(firmware: Any) -> None:
    held, client = begun(firmware)
    held.upload(FENCE, polygon(5, command=5002), client)
    held.run(20.0, client)
    assert len(client.said) == len(set(client.said))
    assert any(isinstance(event, FenceChanged) and event.zones for event in client.events)
    before = len(client.refusals)
    if firmware == "px4":  # ArduPilot takes none without an end
        held.upload(FENCE, [circle(math.inf)], client)
        held.run(10.0, client)
        assert "needs a radius" in client.refusals[before]


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
@pytest.mark.parametrize("command", [5001, 5002])
def test_a_polygon_after_a_circle_is_named_to_who_flies_a_px4_also_when_it_is_drawn_later(
    firmware: Any, command: int
) -> None:
    held, client = begun(firmware)
    assert client.side is not None
    held.upload(FENCE, [*polygon(5, command=command), circle(60.0)], client)
    held.run(20.0, client)
    assert client.side.warnings == []
    held.upload(FENCE, [circle(60.0), *polygon(5, command=command)], client)
    held.run(20.0, client)
    assert len(client.side.warnings) == (firmware == "px4")
    told = [event for event in client.events if isinstance(event, FenceChanged)]
    assert [event.misread for event in told[-2:]] == [False, firmware == "px4"]


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_a_fence_that_has_changed_is_told_before_it_is_read(firmware: Any) -> None:
    held, client = begun(firmware)
    for items in (40, 60, 60):  # the last: other places, as many
        count = len(client.events)
        fence_items = polygon(items, size_m=100.0 + count)
        held.upload(FENCE, fence_items, client)
        held.run(90.0, client, until=partial(is_read, client, count))
        told = [e for e in client.events[count:] if isinstance(e, FenceReading | FenceChanged)]
        assert [type(e) for e in told] == [FenceReading, FenceChanged, FenceReading]
        assert [e.items for e in told if isinstance(e, FenceReading)] == [items, 0]
    count = len(client.events)
    held.run(90.0, client)  # it is read again, and is the same
    assert not [event for event in client.events[count:] if isinstance(event, FenceReading)]


def is_read(client: Side, since: int) -> bool:
    told = [event for event in client.events[since:] if isinstance(event, FenceReading)]
    return len(told) == 2


def test_plans_are_not_done_before_a_fence_about_home_is_drawn() -> None:
    """Else a vehicle whose home is heard last arms before its fence is held against the mission."""
    held = Held("ardupilot")
    for name, value in (("FENCE_ENABLE", 1.0), ("FENCE_TYPE", 2.0), ("FENCE_RADIUS", 60.0)):
        held.other(wire.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        held.run(0.5)
    client = Side(held, "sitl-arducopter")
    client.hears_home = False
    held.run(30.0, client)
    assert not prepared_plans(client)
    client.hears_home = True
    held.run(60.0, client, until=lambda: bool(prepared_plans(client)))
    assert "fence about home (radius 60 m)" in prepared_plans(client)[0].refusal


# --- breaches of it


def fences_told(client: Side) -> list[int]:
    return [len(event.zones) for event in client.events if isinstance(event, FenceChanged)]


def test_the_fence_that_is_known_stays_in_force_while_it_is_read_again_after_a_reboot() -> None:
    held = Held("px4")
    held.simulation.set_parameter("GF_MAX_HOR_DIST", 400.0)
    held.upload(FENCE, polygon(7))
    client = Side(held, "sitl-px4")
    held.run(8.0, client)
    assert fences_told(client) == [2]
    assert client.side is not None
    client.side.rebooted()
    client.hears_home = False
    held.run(8.0, client)
    assert fences_told(client) == [2]  # not that without what is drawn about home
    assert any("2 zones stay in force" in note for note in client.said)
    held.upload(FENCE, [])
    client.hears_home = True
    held.run(20.0, client)
    assert fences_told(client) == [2, 1]


def test_a_long_fence_is_drawn_a_few_corners_at_a_time_and_told_when_it_is_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    held = Held("ardupilot")
    held.upload(FENCE, [*polygon(30), *polygon(31), *polygon(32)])
    client = Side(held, "sitl-arducopter")
    portions: list[int] = []
    times_s: list[float] = []
    draw = fence.drawn

    def counted(*of: Any) -> Iterator[fence.Fence | None]:
        for found in draw(*of):
            portions.append(0 if found is None else len(found.zones))
            times_s.append(held.simulation.now_us * 1e-6)
            yield found

    monkeypatch.setattr(fence, "_CORNERS_AT_ONCE", 20)
    monkeypatch.setattr(fence, "drawn", counted)
    held.run(8.0, client)
    assert portions == [0, 0, 0, 3]
    assert times_s[-1] - times_s[0] < 0.5  # with each message, whatever it is
    assert fences_told(client) == [3]


def told_of(message: Any, autopilot: Autopilot) -> Any:
    side = AutopilotClient(
        load_mission("sitl-px4"), 1, autopilot, lockstep=True, sets_parameters=False
    )
    return side.event_of(message, 7.0)


def px4_event(name: str) -> Any:
    """As PX4 sends it to everybody: EVENT, the id of its component in the last byte."""
    number = px4.event_id(name) | 1 << 24
    payload = EventMessage.unpacker.pack(number, 5, 1, 0, 0, 0x33, *[0] * 40)
    sent = EventMessage(0, 0, number, 5, 1, 0x33, [0] * 40)
    [heard] = Receiver().feed(sent._pack(codec(1), EventMessage.crc_extra, payload))
    return heard


def text(said: str) -> Any:
    return wire.MAVLink_statustext_message(4, said.encode())


@pytest.mark.parametrize(
    ("autopilot", "message", "breach"),
    [
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
    ],
)
def test_what_autopilots_say_of_a_breach(autopilot: Autopilot, message: Any, breach: bool) -> None:
    assert told_of(message, autopilot) == (FenceBreach(time_s=7.0) if breach else None)
    assert px4.event_id("check_modes_offboard_signal") == 3087815  # as recorded (px4.md 6)


def test_fence_status_tells_of_each_breach_once() -> None:
    mission = load_mission("sitl-arducopter")
    side = AutopilotClient(mission, 1, ALL[0], lockstep=True, sets_parameters=False)
    states = [(0, 0), (1, 1), (1, 1), (0, 1), (1, 2)]
    told = [
        side.event_of(wire.MAVLink_fence_status_message(status, count, 3, 0, 0), 1.0) is not None
        for status, count in states
    ]
    assert told == [False, True, False, False, True]


# --- somebody who sets parameters back


class Sets(Side):
    """One that may set parameters."""

    sets_parameters = True

    @property
    def refusals(self) -> list[str]:
        told = (event for event in self.events if isinstance(event, Prepared))
        return [event.refusal for event in told if event.item is Item.PARAMETERS and event.refusal]


def fought(times: int, *, seconds: float = 12.0) -> tuple[Held, Sets]:
    """COM_OBL_RC_ACT, which is to be 5, set back to 0 so many times by a ground station."""
    held = Held("px4")
    client = Sets(held, "sitl-px4")
    held.run(30.0, client, until=lambda: value_of(client) == 5.0)
    held.run(3.0, client)
    for _ in range(times):
        sets = wire.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", 0.0, 6)
        held.other(sets)
        held.run(seconds, client)
    return held, client


def value_of(client: Sets) -> float | None:
    """As the vehicle says it is."""
    return None if client.side is None else client.side.parameters.values.get("COM_OBL_RC_ACT")


def test_who_keeps_setting_a_parameter_back_is_said_once_and_not_fought_for_ever() -> None:
    _, client = fought(1)
    assert value_of(client) == 5.0  # once, it is set again
    assert client.refusals == []
    assert [text for text in client.said if "COM_OBL_RC_ACT" in text] == ["set COM_OBL_RC_ACT to 5"]
    held, client = fought(6, seconds=9.0)
    assert value_of(client) == 0.0
    [line] = client.refusals
    assert line.startswith("COM_OBL_RC_ACT = 0: somebody keeps setting it back. End that")
    ours = [
        message
        for _, message in held.sent
        if message.get_type() == "PARAM_SET" and message.param_id == "COM_OBL_RC_ACT"
    ]
    assert 3 <= len(ours) <= 6  # each may have been told twice


@pytest.mark.parametrize("shift_s", [-595.0, 86_400.0])
def test_by_another_clock_the_same_is_asked_at_the_same_moments(shift_s: float) -> None:
    """As after a restart in flight: the clock of before goes on until the vehicle's is heard."""
    asked = []
    for shifted_s in (0.0, shift_s):
        held = Held("ardupilot")
        client = Side(held, "sitl-arducopter")
        held.run(1.0, client)
        assert client.side is not None
        client.side.rebase_time(shifted_s)
        asked.append([])
        for tenth in range(100):  # nobody answers
            now_s = held.now_s + shifted_s + tenth / 10
            heard = [bytes(m.pack(codec(1))) for m in client.side.on_time(now_s, None)]
            asked[-1].append(sorted(heard))
    assert asked[0] == asked[1]
    assert len([each for each in asked[0] if each]) > 10


def plane_told_its_speed() -> tuple[AutopilotClient, list[Any]]:
    """An ArduPlane in guided mode, and the command, whose first frame may have been lost."""
    mission = load_mission("sitl-arduplane")
    side = AutopilotClient.found(
        heartbeat(), Context(mission=mission, seed=1, lockstep=True, shadow=True)
    )
    assert side is not None
    side.begin(0.0)
    told = side.command_messages(
        SetSpeed(speed_m_s=22.0), State.of(mission, checkpoint.blank_map(mission))
    )
    assert told is not None
    return side, told


def heartbeat(mode: int = wire.PLANE_MODE_GUIDED) -> Any:
    beat = wire.MAVLink_heartbeat_message(1, wire.MAV_AUTOPILOT_ARDUPILOTMEGA, 129, mode, 4, 3)
    return over_the_wire(beat)


def times_told(side: AutopilotClient, from_s: float) -> int:
    """How often a plane is told in the next 10 s."""
    said = [each for tenth in range(100) for each in side.on_time(from_s + tenth / 10, None)]
    return [each.get_type() for each in said].count("COMMAND_INT")


def test_a_plane_is_told_its_speed_until_it_answers_or_somebody_else_flies_it() -> None:
    side, [told] = plane_told_its_speed()
    assert told.command == wire.MAV_CMD_GUIDED_CHANGE_SPEED
    assert 9 <= times_told(side, 0.0) <= 10
    other = wire.MAVLink_command_ack_message(wire.MAV_CMD_DO_REPOSITION, 0)
    answers = (over_the_wire(other), heartbeat(wire.PLANE_MODE_GUIDED), heartbeat())
    for number, message in enumerate(answers):
        side.event_of(message, 10.0 + 10.0 * number)
        assert times_told(side, 10.0 + 10.0 * number) == 10
    for ends, notes in (
        (heartbeat(wire.PLANE_MODE_LOITER), []),
        (over_the_wire(wire.MAVLink_command_ack_message(told.command, 0)), []),
        (
            over_the_wire(wire.MAVLink_command_ack_message(told.command, 2)),
            ["the autopilot does not take the mission's speed"],
        ),
    ):
        side, _ = plane_told_its_speed()
        side.event_of(ends, 0.5)
        assert times_told(side, 1.0) == 0
        assert side.notes == notes


@pytest.mark.parametrize(
    ("command", "result", "taken"),
    [
        (wire.MAV_CMD_NAV_TAKEOFF, wire.MAV_RESULT_ACCEPTED, True),
        (wire.MAV_CMD_NAV_TAKEOFF, wire.MAV_RESULT_FAILED, False),
        (wire.MAV_CMD_NAV_TAKEOFF, wire.MAV_RESULT_IN_PROGRESS, False),
        (wire.MAV_CMD_COMPONENT_ARM_DISARM, wire.MAV_RESULT_ACCEPTED, False),
    ],
)
def test_a_take_off_is_taken_once_it_is_accepted(command: int, result: int, taken: bool) -> None:
    message = over_the_wire(wire.MAVLink_command_ack_message(command, result))
    event = plane_told_its_speed()[0].event_of(message, 3.0)
    assert event == (TakeOffTaken(time_s=3.0) if taken else None)


def test_how_the_vehicles_own_mission_ends_is_not_passed_over_in_silence() -> None:
    """The companion ends as its own mission says: who has drawn an RTL has to hear of it."""
    mission = replace(load_mission("sitl-arducopter"), targets_from_vehicle=True)
    held = Held("ardupilot")
    held.upload(0, [*waypoints(3), Stored(frame=2, command=20)])
    client = Side(held, mission)
    held.run(60.0, client, until=lambda: bool(prepared_plans(client)))
    assert client.said == ["its mission ends with return; what counts is end.action: land"]
