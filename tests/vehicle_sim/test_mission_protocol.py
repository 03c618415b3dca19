"""Missions, fences and rally points over the wire: one server for all autopilots.

The client is a small one with pymavlink's waypoint list as its memory.
"""

import math
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any, Literal, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavwp
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import (
    Ack,
    Autopilot,
    Command,
    Place,
    Reply,
    Sender,
    SendMessage,
    SendTelemetry,
)
from vehicle_sim.plans import PlanItem, PlanKind, Plans
from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.wire.missions import Missions, opaque_id

Firmware = Literal["ardupilot", "px4"]
BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
HERE = Sender(system=255, component=190, link=0)
THERE = Sender(system=1, component=191, link=1)
HOME = Place(latitude_deg=-35.3632621, longitude_deg=149.1652374, altitude_amsl_m=584.0)
STEP_US = 10_000
MISSION, FENCE, RALLY = PlanKind.MISSION, PlanKind.FENCE, PlanKind.RALLY
ACCEPTED = mavlink.MAV_MISSION_ACCEPTED


class Vehicle:
    """A mission protocol and everything that it has said."""

    def __init__(self, firmware: Firmware) -> None:
        self.plans = Plans()
        self.status = SimpleNamespace(mission_current=1)
        autopilot = SimpleNamespace(
            plans=self.plans,
            home=HOME,
            status=lambda: self.status,
            on_plan=self.on_plan,
            on_command=self.on_command,
            profile=SimpleNamespace(firmware=firmware),
        )
        self.protocol = Missions(cast(Autopilot, autopilot))
        self.now_us = 0
        self.replaced: list[PlanKind] = []
        self.asked: list[Command] = []
        self.other: list[Reply] = []
        self.inbox: list[tuple[Sender | None, Any]] = []

    def on_plan(self, kind: PlanKind) -> list[Reply]:
        self.replaced.append(kind)
        return []

    def on_command(self, command: Command) -> list[Reply]:
        self.asked.append(command)
        return [Ack(to=command.sender, command=command.number, result=0)]

    def take(self, answers: Iterable[Reply]) -> None:
        for answer in answers:
            match answer:
                case SendMessage(message=message, to=to):
                    ((_, got),) = StreamParser(datagrams=True).feed(Packer(1, 1).frame(message))
                    self.inbox.append((to, got))
                case _:
                    self.other.append(answer)

    def say(self, message: Any, sender: Sender = HERE) -> list[Any]:
        """Send this and return what comes back to this sender."""
        frame = Packer(sender.system, sender.component).frame(message)
        ((_, got),) = StreamParser(datagrams=True).feed(frame)
        self.take(self.protocol.on_message(got, sender, self.now_us))
        return self.read(sender)

    def read(self, sender: Sender = HERE) -> list[Any]:
        mine = [message for to, message in self.inbox if to == sender]
        self.inbox = [each for each in self.inbox if each[0] != sender]
        for message in mine:
            assert (message.target_system, message.target_component) == (
                sender.system,
                sender.component,
            )
        return mine

    def run(self, seconds: float, sender: Sender = HERE) -> list[tuple[float, Any]]:
        """Let time pass: second and message of what comes."""
        got, begun_us = [], self.now_us
        for _ in range(round(seconds * 1e6) // STEP_US):
            self.now_us += STEP_US
            if self.protocol.busy:
                self.take(self.protocol.step(self.now_us))
            got += [((self.now_us - begun_us) / 1e6, each) for each in self.read(sender)]
        return got


def item(seq: int, kind: PlanKind, command: int, *p: float, frame: int = 3, **more: Any) -> Any:
    p1, p2, p3, p4 = (*p, *[0.0] * (4 - len(p)))
    place = {"x": -353_600_000 + seq, "y": 1_491_600_000 - seq, "z": 20.0 + seq, **more}
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, seq, frame, command, 0, 1, p1, p2, p3, p4, **place, mission_type=int(kind)
    )


def count(number: int, kind: PlanKind | int) -> Any:
    return mavlink.MAVLink_mission_count_message(1, 1, number, int(kind))


def request(seq: int, kind: PlanKind) -> Any:
    return mavlink.MAVLink_mission_request_int_message(1, 1, seq, int(kind))


def circle(seq: int, radius_m: float = 30.0, **more: Any) -> Any:
    return item(seq, FENCE, 5004, radius_m, **more)


def polygon(vertices: int, *, at: int = 0, command: int = 5001) -> list[Any]:
    return [item(at + k, FENCE, command, vertices) for k in range(vertices)]


def mission() -> list[Any]:
    return [
        item(0, MISSION, 16, frame=0),
        item(1, MISSION, 22, 0, 0, 0, math.nan),
        item(2, MISSION, 16, 5, 0, 0, 0, frame=6),
        item(3, MISSION, 178, 1, 5, -1, frame=2, x=0, y=0, z=0),
        item(4, MISSION, 16, frame=5),
        item(5, MISSION, 20, frame=2, x=0, y=0, z=0),
    ]


def upload(vehicle: Vehicle, items: list[Any], kind: PlanKind, sender: Sender = HERE) -> int:
    """As a ground station does it; the result of the last MISSION_ACK."""
    answers = vehicle.say(count(len(items), kind), sender)
    for _ in range(3 * len(items) + 3):
        (answer,) = answers
        if answer.get_type() == "MISSION_ACK":
            assert answer.mission_type == kind
            return int(answer.type)
        assert answer.mission_type == kind
        answers = vehicle.say(items[answer.seq], sender)
    raise AssertionError("the upload never ended")


def download(vehicle: Vehicle, kind: PlanKind, sender: Sender = HERE) -> list[Any]:
    (number,) = vehicle.say(mavlink.MAVLink_mission_request_list_message(1, 1, int(kind)), sender)
    got = []
    for seq in range(number.count):
        (answer,) = vehicle.say(request(seq, kind), sender)
        assert answer.get_type() == "MISSION_ITEM_INT"
        assert answer.seq == seq
        got.append(answer)
    assert not vehicle.say(mavlink.MAVLink_mission_ack_message(1, 1, 0, int(kind)), sender)
    return got


def fields(message: Any) -> tuple[Any, ...]:
    names = ("command", "frame", "param1", "param2", "param3", "param4", "x", "y", "z")
    return tuple(repr(float(getattr(message, name))) for name in names)


# --- both -----------------------------------------------------------------------------------------


@BOTH
def test_what_is_uploaded_is_stored_told_and_comes_back(firmware: Firmware) -> None:
    vehicle = Vehicle(firmware)
    for kind, items in (
        (MISSION, mission()),
        (FENCE, [*polygon(3), circle(3)]),
        (RALLY, [item(0, RALLY, 5100), item(1, RALLY, 5100)]),
    ):
        assert upload(vehicle, items, kind) is ACCEPTED
        assert len(vehicle.plans[kind]) == len(items)
        for sender in (HERE, THERE):
            got = download(vehicle, kind, sender)
            assert [(each.command, each.seq) for each in got] == [
                (each.command, each.seq) for each in items
            ]
            places = [(each.x, each.y) for each in got]
            begin = int(kind is MISSION and firmware == "ardupilot")
            assert places[begin:] == [(each.x, each.y) for each in items][begin:]
    assert vehicle.replaced == [MISSION, FENCE, RALLY]
    assert not vehicle.protocol.busy


def test_which_request_asks_for_items() -> None:
    (ardupilot,) = Vehicle("ardupilot").say(count(1, FENCE))
    (px4,) = Vehicle("px4").say(count(1, FENCE))
    assert (ardupilot.get_type(), px4.get_type()) == ("MISSION_REQUEST", "MISSION_REQUEST_INT")


@BOTH
def test_old_clients_send_and_get_items_in_degrees(firmware: Firmware) -> None:
    vehicle = Vehicle(firmware)
    vehicle.say(count(2, MISSION))
    for seq in (0, 1):
        old = mavlink.MAVLink_mission_item_message(
            1, 1, seq, 3, 16, 0, 1, 0, 0, 0, 0, -35.5, 149.25, 40.0
        )
        (last,) = vehicle.say(old)
    assert last.type == ACCEPTED
    assert (vehicle.plans[MISSION][1].x, vehicle.plans[MISSION][1].y) == (-355000000, 1492500000)
    vehicle.say(mavlink.MAVLink_mission_request_list_message(1, 1))
    vehicle.say(mavlink.MAVLink_mission_request_message(1, 1, 0))
    (got,) = vehicle.say(mavlink.MAVLink_mission_request_message(1, 1, 1))
    assert got.get_type() == "MISSION_ITEM"
    assert (got.x, got.y, got.z) == pytest.approx((-35.5, 149.25, 40.0))


@BOTH
def test_an_empty_upload_and_a_clear_empty_the_list(firmware: Firmware) -> None:
    vehicle = Vehicle(firmware)
    for how in (count(0, FENCE), mavlink.MAVLink_mission_clear_all_message(1, 1, 1)):
        assert upload(vehicle, [circle(0)], FENCE) is ACCEPTED
        (ack,) = vehicle.say(how)
        assert (ack.get_type(), ack.type, ack.mission_type) == ("MISSION_ACK", ACCEPTED, 1)
        assert vehicle.plans[FENCE] == ()
        assert vehicle.replaced[-1] is FENCE
        assert download(vehicle, FENCE) == []
    (again,) = vehicle.say(mavlink.MAVLink_mission_clear_all_message(1, 1, 1))
    assert again.type == ACCEPTED


@BOTH
@pytest.mark.parametrize("lost", range(4))
def test_an_unfinished_upload_leaves_the_old_list(firmware: Firmware, lost: int) -> None:
    vehicle = Vehicle(firmware)
    upload(vehicle, [circle(0)], FENCE)
    old = vehicle.plans[FENCE]
    items = [*polygon(3), circle(3)]
    vehicle.say(count(4, FENCE))
    for each in items[:lost]:
        vehicle.say(each)
    vehicle.run(12.0)
    assert vehicle.plans[FENCE] == old
    assert not vehicle.protocol.busy
    assert upload(vehicle, items, FENCE) is ACCEPTED


@BOTH
def test_asking_for_a_part_of_a_list_changes_nothing(firmware: Firmware) -> None:
    vehicle = Vehicle(firmware)
    upload(vehicle, [circle(0)], FENCE)
    assert vehicle.say(mavlink.MAVLink_mission_request_partial_list_message(1, 1, 0, 0, 1)) == []
    assert len(vehicle.plans[FENCE]) == 1


@BOTH
@given(pattern=st.lists(st.booleans(), min_size=40, max_size=40))
def test_an_upload_over_a_lossy_link_ends_right_or_not_at_all(
    firmware: Firmware, pattern: list[bool]
) -> None:
    """Every k-th frame of either side is lost or not; the client repeats what it said last."""
    vehicle, items = Vehicle(firmware), [*polygon(3), circle(3)]
    lost = iter(pattern)
    last, ack = count(4, FENCE), None
    for _ in range(60):
        answers = [] if next(lost, False) else vehicle.say(last)
        answers += [message for _, message in vehicle.run(0.3)]
        for answer in answers:
            if next(lost, False):
                continue
            if answer.get_type() == "MISSION_ACK":
                ack = answer.type
            else:
                last = items[answer.seq]
        if ack == ACCEPTED:
            assert len(vehicle.plans[FENCE]) == 4
            return
        if ack is not None and not vehicle.protocol.busy:
            last, ack = count(4, FENCE), None
    assert len(vehicle.plans[FENCE]) in (0, 4)


@BOTH
def test_what_mavwp_holds_arrives(firmware: Firmware, tmp_path: Any) -> None:
    loader = mavwp.MAVWPLoader(1, 1)
    for each in mission():
        loader.add(each)
    assert loader.count() == 6
    vehicle = Vehicle(firmware)
    assert upload(vehicle, [loader.item(k) for k in range(6)], MISSION) is ACCEPTED
    back = mavwp.MAVWPLoader(1, 1)
    for each in download(vehicle, MISSION):
        back.add(each)
    assert [back.item(k).command for k in range(6)] == [16, 22, 16, 178, 16, 20]
    back.save(str(tmp_path / "mission.txt"))
    assert mavwp.MAVWPLoader(1, 1).load(str(tmp_path / "mission.txt")) == 6


@BOTH
def test_the_current_item_is_set_by_a_command_without_an_acknowledgement(
    firmware: Firmware,
) -> None:
    vehicle = Vehicle(firmware)
    upload(vehicle, mission(), MISSION)
    assert vehicle.say(mavlink.MAVLink_mission_set_current_message(1, 1, 3)) == []
    (tell,), (asked,) = vehicle.other, vehicle.asked
    assert (asked.number, asked.parameters[0]) == (224, 3.0)
    assert isinstance(tell, SendTelemetry)
    assert tell.message == 42


@given(
    messages=st.lists(
        st.tuples(
            st.sampled_from([37, 38, 39, 40, 41, 43, 44, 45, 47, 51, 73]),
            st.binary(min_size=38, max_size=38),
            st.sampled_from([HERE, THERE]),
            st.integers(0, 4_000_000),
        ),
        max_size=25,
    )
)
def test_no_message_in_no_order_does_harm(
    messages: list[tuple[int, bytes, Sender, int]],
) -> None:
    for firmware in ("ardupilot", "px4"):
        vehicle = Vehicle(firmware)  # type: ignore[arg-type]
        upload(vehicle, [circle(0)], FENCE)
        for number, raw, sender, later_us in messages:
            kind = mavlink.mavlink_map[number]
            names = dict(zip(kind.ordered_fieldnames, kind.unpacker.unpack_from(raw), strict=True))
            message = kind(**names)
            message.mission_type = raw[0] % 4
            if hasattr(message, "seq"):
                message.seq %= 4
            vehicle.say(message, sender)
            vehicle.now_us += later_us
            vehicle.take(vehicle.protocol.step(vehicle.now_us))
        for kind in PlanKind:
            assert all(isinstance(each, PlanItem) for each in vehicle.plans[kind])
        vehicle.run(9.0)
        assert not vehicle.protocol.busy


# --- the upload ---------------------------------------------------------------------------------


@BOTH
def test_what_does_not_come_is_asked_for_again_and_given_up_in_the_end(firmware: Firmware) -> None:
    vehicle = Vehicle(firmware)
    vehicle.say(count(2, FENCE))
    vehicle.run(4.0)
    vehicle.say(circle(0))  # the time counts from here
    *asked, (last_s, ack) = vehicle.run(10.0)
    seconds = [s for s, each in asked if each.get_type().startswith("MISSION_REQUEST")]
    assert seconds == pytest.approx([0.5 * k for k in range(1, 10)], abs=0.1)
    cancelled = mavlink.MAV_MISSION_OPERATION_CANCELLED
    assert (ack.get_type(), ack.type, ack.mission_type) == ("MISSION_ACK", cancelled, 1)
    assert last_s == pytest.approx(5.0, abs=0.02)


@BOTH
def test_the_wrong_item_is_left_out_and_the_right_one_asked_for_again(firmware: Firmware) -> None:
    vehicle = Vehicle(firmware)
    vehicle.say(count(2, FENCE))
    assert vehicle.say(circle(1)) == []
    (again, *_) = vehicle.run(1.1)
    assert again[1].seq == 0
    vehicle.say(circle(0))
    assert vehicle.say(circle(0)) == []  # once is enough
    assert vehicle.say(circle(1))[0].type == ACCEPTED
    assert vehicle.say(circle(1))[0].type == ACCEPTED  # the acknowledgement was lost
    assert vehicle.say(circle(0))[0].type == mavlink.MAV_MISSION_ERROR  # nobody asked


@BOTH
@pytest.mark.parametrize("sender", [THERE, Sender(system=9, component=9, link=0)])
def test_while_one_uploads_a_list_the_others_are_denied(firmware: Firmware, sender: Sender) -> None:
    vehicle = Vehicle(firmware)
    vehicle.say(count(2, FENCE))
    for message in (count(1, FENCE), circle(0)):
        (ack,) = vehicle.say(message, sender)
        assert (ack.get_type(), ack.type) == ("MISSION_ACK", mavlink.MAV_MISSION_DENIED)
    assert "MISSION_REQUEST" in vehicle.say(count(1, MISSION), sender)[0].get_type()
    (begun_again,) = vehicle.say(count(1, FENCE))
    assert begun_again.seq == 0
    assert vehicle.say(circle(0))[0].type == ACCEPTED


def bow_tie() -> list[Any]:
    corners = [(0, 0), (100, 100), (100, 0), (0, 100)]
    return [item(k, FENCE, 5001, 4, x=x, y=y) for k, (x, y) in enumerate(corners)]


@BOTH
@pytest.mark.parametrize(
    ("items", "result"),
    [
        (bow_tie(), ACCEPTED),
        ([*polygon(3), circle(3)], ACCEPTED),
        (polygon(3)[:2], mavlink.MAV_MISSION_ERROR),
        (polygon(2), mavlink.MAV_MISSION_ERROR),
        ([item(0, FENCE, 5001, math.nan)], mavlink.MAV_MISSION_ERROR),
        ([*polygon(3)[:2], circle(2)], mavlink.MAV_MISSION_ERROR),
        ([*polygon(3)[:2], *polygon(3, at=2, command=5002)[:1]], mavlink.MAV_MISSION_ERROR),
        ([circle(0, math.inf)], ACCEPTED),
        ([circle(0, 0.0)], mavlink.MAV_MISSION_ERROR),
        ([circle(0, math.nan)], mavlink.MAV_MISSION_ERROR),
        ([circle(0, x=10**9)], mavlink.MAV_MISSION_INVALID),
        ([circle(0, frame=1)], mavlink.MAV_MISSION_UNSUPPORTED_FRAME),
        ([item(0, FENCE, 16)], mavlink.MAV_MISSION_UNSUPPORTED),
    ],
)
def test_a_fence_is_taken_whole_or_refused_and_the_old_one_stays(
    firmware: Firmware, items: list[Any], result: int
) -> None:
    vehicle = Vehicle(firmware)
    upload(vehicle, [circle(0, 77.0)], FENCE)
    assert upload(vehicle, items, FENCE) is result
    kept = vehicle.plans[FENCE][0].parameters[0] == 77.0
    assert kept is (result is not ACCEPTED)
    assert not vehicle.protocol.busy


@BOTH
@pytest.mark.parametrize(
    ("bad", "result"),
    [
        (item(1, MISSION, 82), mavlink.MAV_MISSION_UNSUPPORTED),  # a spline
        (item(1, MISSION, 112), mavlink.MAV_MISSION_UNSUPPORTED),  # a condition
        (item(1, MISSION, 5004, 3), mavlink.MAV_MISSION_UNSUPPORTED),
        (item(1, MISSION, 16, frame=1), mavlink.MAV_MISSION_UNSUPPORTED_FRAME),
        (item(1, MISSION, 16, x=900_000_001), mavlink.MAV_MISSION_INVALID),
        (item(1, MISSION, 16, y=-1_800_000_001), mavlink.MAV_MISSION_INVALID),
        (item(1, RALLY, 16), mavlink.MAV_MISSION_UNSUPPORTED),
    ],
)
def test_one_item_that_is_wrong_ends_the_upload(firmware: Firmware, bad: Any, result: int) -> None:
    vehicle = Vehicle(firmware)
    kind = PlanKind(bad.mission_type)
    good = item(0, kind, 5100 if kind is RALLY else 16, z=99.0)
    upload(vehicle, [good], kind)
    old = vehicle.plans[kind]
    assert upload(vehicle, [good, bad, good], kind) is result
    assert vehicle.plans[kind] == old
    assert not vehicle.protocol.busy


@BOTH
def test_a_list_that_there_is_not_and_one_that_is_too_long(firmware: Firmware) -> None:
    vehicle = Vehicle(firmware)
    assert vehicle.say(count(1, 7))[0].type == mavlink.MAV_MISSION_UNSUPPORTED
    assert vehicle.say(count(256, FENCE))[0].type == mavlink.MAV_MISSION_NO_SPACE
    assert not vehicle.protocol.busy


@BOTH
def test_all_three_lists_are_cleared_at_once_if_asked(firmware: Firmware) -> None:
    vehicle = Vehicle(firmware)
    upload(vehicle, mission(), MISSION)
    upload(vehicle, [circle(0)], FENCE)
    (ack,) = vehicle.say(mavlink.MAVLink_mission_clear_all_message(1, 1, 255))
    assert (ack.type, ack.mission_type) == (ACCEPTED, 255)
    assert all(vehicle.plans[kind] == () for kind in PlanKind)


# --- the download, and what is not for a list -----------------------------------------------------


@BOTH
def test_items_come_back_as_they_were_sent_in_any_order(firmware: Firmware) -> None:
    vehicle, items = Vehicle(firmware), mission()
    upload(vehicle, items, MISSION)
    for seq in (4, 1, 1, 3):
        (got,) = vehicle.say(request(seq, MISSION))
        assert fields(got) == fields(items[seq])
        assert got.current == (seq == 1)
    (beyond,) = vehicle.say(request(6, MISSION))
    assert beyond.type == mavlink.MAV_MISSION_INVALID_SEQUENCE


def test_item_0_of_ardupilots_mission_is_home() -> None:
    vehicle = Vehicle("ardupilot")
    upload(vehicle, mission(), MISSION)
    (got,) = vehicle.say(request(0, MISSION))
    assert (got.x, got.y, got.frame) == (-353632621, 1491652374, 0)
    assert got.z == pytest.approx(584.0)
    empty = Vehicle("ardupilot")
    assert empty.say(request(0, MISSION))[0].x == -353632621  # always there


def test_the_id_of_a_list_is_the_one_that_the_real_px4_gave_it() -> None:
    # the fence and the MISSION_ACK of px4-gps-loss.tlog at 0.8 s
    recorded = circle(0, 30.0, frame=5, x=474013408, y=85455948, z=0.0)
    vehicle = Vehicle("px4")
    vehicle.say(count(1, FENCE))
    (ack,) = vehicle.say(recorded)
    raw = bytes(ack.get_msgbuf())
    assert raw[10 : 10 + raw[1]].hex() == "ffbe0001470676d1"
    (told,) = vehicle.say(mavlink.MAVLink_mission_request_list_message(1, 1, 1))
    assert bytes(told.get_msgbuf())[15:19].hex() == "470676d1"
    assert opaque_id(()) == 0


@BOTH
def test_an_item_with_current_2_is_a_place_to_fly_to(firmware: Firmware) -> None:
    vehicle = Vehicle(firmware)
    guided = item(0, MISSION, 16, frame=3)
    guided.current = 2
    (ack,) = vehicle.say(guided)
    assert ack.type == ACCEPTED
    (asked,) = vehicle.asked
    assert (asked.number, asked.frame) == (192, 3)
    assert asked.parameters[4:] == (-35.36, 149.16, 20.0)
