"""Missions, fences and rally points over the wire: ardupilot.md 4 and px4.md 7, row by row.

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
    Text,
)
from vehicle_sim.plans import PlanItem, PlanKind, Plans
from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.wire.missions import ArduPilotMissions, Px4Missions, opaque_id

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
        kind = Px4Missions if firmware == "px4" else ArduPilotMissions
        self.protocol = kind(cast(Autopilot, autopilot))
        self.now_us = 0
        self.replaced: list[PlanKind] = []
        self.asked: list[Command] = []
        self.texts: list[str] = []
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
                case Text(text=text):
                    self.texts.append(text.strip())
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
    assert not vehicle.protocol.busy or firmware == "px4"


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


# --- ArduPilot ------------------------------------------------------------------------------------


def test_ardupilot_asks_again_after_1_s_and_gives_up_after_8_s_with_a_text() -> None:
    vehicle = Vehicle("ardupilot")
    vehicle.say(count(2, FENCE))
    got = vehicle.run(10.0)
    asked = [seconds for seconds, each in got if each.get_type() == "MISSION_REQUEST"]
    assert asked == pytest.approx([1, 2, 3, 4, 5, 6, 7], abs=0.1)
    (seconds, ack) = got[-1]
    assert (ack.get_type(), ack.type, ack.mission_type) == (
        "MISSION_ACK",
        mavlink.MAV_MISSION_OPERATION_CANCELLED,
        1,
    )
    assert seconds == pytest.approx(8.0, abs=0.02)
    assert vehicle.texts == ["Fence upload timeout"]
    vehicle.say(count(1, MISSION))
    vehicle.run(10.0)
    vehicle.say(count(1, RALLY))
    vehicle.run(10.0)
    assert vehicle.texts[1:] == ["Mission upload timeout", "Rally upload timeout"]


def test_the_8_s_count_from_the_last_item() -> None:
    vehicle = Vehicle("ardupilot")
    vehicle.say(count(2, FENCE))
    vehicle.run(7.5)
    vehicle.say(circle(0))
    assert all(each.get_type() == "MISSION_REQUEST" for _, each in vehicle.run(7.5))
    (ack,) = vehicle.say(circle(1))
    assert ack.type == ACCEPTED


def test_the_wrong_item_is_refused_and_the_right_one_asked_for_again() -> None:
    vehicle = Vehicle("ardupilot")
    vehicle.say(count(3, FENCE))
    (ack,) = vehicle.say(circle(2))
    assert ack.type == mavlink.MAV_MISSION_INVALID_SEQUENCE
    (again, *_) = vehicle.run(1.1)
    assert (again[1].get_type(), again[1].seq) == ("MISSION_REQUEST", 0)


def test_while_one_uploads_the_others_are_denied_both_ways() -> None:
    vehicle = Vehicle("ardupilot")
    vehicle.say(count(2, FENCE))
    for message in (
        count(1, FENCE),
        mavlink.MAVLink_mission_request_list_message(1, 1, 1),
        request(0, FENCE),
        circle(0),
    ):
        (ack,) = vehicle.say(message, THERE)
        assert (ack.get_type(), ack.type) == ("MISSION_ACK", mavlink.MAV_MISSION_DENIED)
    assert vehicle.say(count(1, MISSION), THERE)[0].get_type() == "MISSION_REQUEST"
    (begun_again,) = vehicle.say(count(1, FENCE))
    assert begun_again.seq == 0
    assert vehicle.say(circle(0))[0].type == ACCEPTED


def test_item_0_is_home_and_frames_are_the_short_ones() -> None:
    vehicle = Vehicle("ardupilot")
    upload(vehicle, mission(), MISSION)
    got = download(vehicle, MISSION)
    assert (got[0].x, got[0].y, got[0].frame) == (-353632621, 1491652374, 0)
    assert got[0].z == pytest.approx(584.0)
    assert [each.frame for each in got] == [0, 3, 3, 0, 0, 0]
    assert got[1].param4 == 0  # a yaw that was not given
    assert {each.autocontinue for each in got} == {1}
    empty = Vehicle("ardupilot")
    assert empty.say(request(0, MISSION))[0].x == -353632621  # always there
    assert vehicle.texts == ["Flight plan received"]


@pytest.mark.parametrize("frame", [0, 3, 5, 6])
def test_fences_come_back_in_frame_0_with_radius_or_vertex_count(frame: int) -> None:
    vehicle = Vehicle("ardupilot")
    items = [*polygon(4), circle(4, 12.5, frame=frame), item(5, FENCE, 5003, 99.25, 8, 8, 8)]
    assert upload(vehicle, items, FENCE) is ACCEPTED
    got = download(vehicle, FENCE)
    assert [each.param1 for each in got] == [4, 4, 4, 4, 12.5, 99.25]
    assert {(each.frame, each.param2, each.z) for each in got} == {(0, 0, 0)}
    assert [(each.x, each.y) for each in got] == [(each.x, each.y) for each in items]


def bow_tie() -> list[Any]:
    corners = [(0, 0), (100, 100), (100, 0), (0, 100)]
    return [item(k, FENCE, 5001, 4, x=x, y=y) for k, (x, y) in enumerate(corners)]


@pytest.mark.parametrize(
    ("items", "result", "text"),
    [
        (bow_tie(), ACCEPTED, None),
        (polygon(3)[:2], mavlink.MAV_MISSION_ERROR, "Incorrect item count"),
        (polygon(2), mavlink.MAV_MISSION_ERROR, "Invalid vertex count (2)"),
        ([*polygon(3)[:2], circle(2)], mavlink.MAV_MISSION_ERROR, "Received incorrect type"),
        (
            [*polygon(3)[:2], *polygon(3, at=2, command=5002)[:1]],
            mavlink.MAV_MISSION_ERROR,
            "Received incorrect vertex type (want=98 got=97)",
        ),
        ([circle(0, 0.0)], mavlink.MAV_MISSION_ERROR, "Non-positive circle radius"),
        ([circle(0, math.nan)], mavlink.MAV_MISSION_ERROR, "Non-positive circle radius"),
        ([circle(0, x=10**9)], mavlink.MAV_MISSION_ERROR, "Bad lat or lon"),
        ([circle(0, frame=1)], mavlink.MAV_MISSION_UNSUPPORTED_FRAME, None),
        ([item(0, FENCE, 16)], mavlink.MAV_MISSION_UNSUPPORTED, None),
        ([item(k, FENCE, 5000) for k in (0, 1)], mavlink.MAV_MISSION_ERROR, "Multiple return"),
    ],
)
def test_which_fences_ardupilot_takes(items: list[Any], result: int, text: str | None) -> None:
    vehicle = Vehicle("ardupilot")
    upload(vehicle, [circle(0, 77.0)], FENCE)
    assert upload(vehicle, items, FENCE) is result
    assert [said[: len(text or "")] for said in vehicle.texts] == ([text] if text else [])
    kept = vehicle.plans[FENCE][0].parameters[0] == 77.0
    assert kept is (result is not ACCEPTED)
    assert not vehicle.protocol.busy


@pytest.mark.parametrize(
    ("bad", "result"),
    [
        (item(1, MISSION, 9999), mavlink.MAV_MISSION_UNSUPPORTED),
        (item(1, MISSION, 16, frame=1), mavlink.MAV_MISSION_UNSUPPORTED_FRAME),
        (item(1, MISSION, 16, math.nan), mavlink.MAV_MISSION_INVALID_PARAM1),
        (item(1, MISSION, 16, 0, math.inf), mavlink.MAV_MISSION_INVALID_PARAM2),
        (item(1, MISSION, 178, 1, 5, math.nan), mavlink.MAV_MISSION_INVALID_PARAM3),
        (item(1, MISSION, 178, 1, 5, 0, math.nan), mavlink.MAV_MISSION_INVALID_PARAM4),
        (item(1, MISSION, 16, x=900_000_001), mavlink.MAV_MISSION_INVALID_PARAM5_X),
        (item(1, MISSION, 16, y=-1_800_000_001), mavlink.MAV_MISSION_INVALID_PARAM6_Y),
        (item(1, MISSION, 16, z=math.nan), mavlink.MAV_MISSION_INVALID_PARAM7),
        (item(1, MISSION, 16, z=1e6), mavlink.MAV_MISSION_INVALID_PARAM7),
        (item(1, MISSION, 177, 9, 1), mavlink.MAV_MISSION_ERROR),
        (item(1, RALLY, 16), mavlink.MAV_MISSION_UNSUPPORTED),
    ],
)
def test_one_item_that_is_wrong_ends_the_upload(bad: Any, result: int) -> None:
    vehicle = Vehicle("ardupilot")
    kind = PlanKind(bad.mission_type)
    upload(vehicle, [item(0, kind, 5100 if kind is RALLY else 16)], kind)
    old = vehicle.plans[kind]
    good = item(0, kind, 5100 if kind is RALLY else 16, z=99.0)
    assert upload(vehicle, [good, bad, good], kind) is result
    assert vehicle.plans[kind] == old
    assert not vehicle.protocol.busy


def test_circles_straight_after_a_polygon_are_taken_and_then_erased() -> None:
    vehicle = Vehicle("ardupilot")
    upload(vehicle, [*polygon(3), circle(3)], FENCE)
    vehicle.run(2.0)
    assert upload(vehicle, [circle(0)], FENCE) is ACCEPTED
    assert len(download(vehicle, FENCE)) == 1
    vehicle.run(0.05)
    assert download(vehicle, FENCE) == []
    assert vehicle.replaced == [FENCE] * 3
    assert upload(vehicle, [circle(0)], FENCE) is ACCEPTED
    vehicle.run(2.0)
    assert len(download(vehicle, FENCE)) == 1
    assert upload(vehicle, polygon(3), FENCE) is ACCEPTED
    vehicle.run(2.0)
    assert len(download(vehicle, FENCE)) == 3


def test_a_download_may_be_pipelined_repeated_and_left_unfinished() -> None:
    vehicle = Vehicle("ardupilot")
    upload(vehicle, mission(), MISSION)
    upload(vehicle, [circle(0)], FENCE)
    for kind, seq in ((MISSION, 4), (FENCE, 0), (MISSION, 1), (MISSION, 1)):
        assert vehicle.say(request(seq, kind))[0].seq == seq
    assert upload(vehicle, mission(), MISSION) is ACCEPTED


def test_beyond_the_end_there_is_an_error() -> None:
    vehicle = Vehicle("ardupilot")
    upload(vehicle, mission(), MISSION)
    upload(vehicle, [circle(0)], FENCE)
    told, ack = vehicle.say(request(6, MISSION))
    assert (told.get_type(), told.count, ack.type) == (
        "MISSION_COUNT",
        6,
        mavlink.MAV_MISSION_ERROR,
    )
    assert vehicle.say(request(1, FENCE))[0].type == mavlink.MAV_MISSION_ERROR
    assert vehicle.say(request(2, FENCE))[0].type == mavlink.MAV_MISSION_INVALID_SEQUENCE
    assert vehicle.say(request(0, RALLY))[0].type == mavlink.MAV_MISSION_INVALID_SEQUENCE


def test_some_items_can_be_replaced() -> None:
    vehicle = Vehicle("ardupilot")
    upload(vehicle, mission(), MISSION)
    before = vehicle.plans[MISSION]
    partial = mavlink.MAVLink_mission_write_partial_list_message(1, 1, 2, 2, 0)
    (asked,) = vehicle.say(partial)
    assert (asked.get_type(), asked.seq) == ("MISSION_REQUEST", 2)
    (ack,) = vehicle.say(item(2, MISSION, 16, z=333.0))
    assert ack.type == ACCEPTED
    after = vehicle.plans[MISSION]
    assert after[2].z_m == 333.0
    assert (after[:2], after[3:]) == (before[:2], before[3:])
    beyond = mavlink.MAVLink_mission_write_partial_list_message(1, 1, 2, 9, 0)
    assert vehicle.say(beyond)[0].type == mavlink.MAV_MISSION_ERROR


def test_a_list_that_there_is_not_and_one_that_is_too_long() -> None:
    vehicle = Vehicle("ardupilot")
    assert vehicle.say(count(1, 7))[0].type == mavlink.MAV_MISSION_UNSUPPORTED
    assert vehicle.say(count(256, FENCE))[0].type == mavlink.MAV_MISSION_NO_SPACE
    assert vehicle.texts == ["Only 255 items are supported"]
    assert vehicle.say(circle(0))[0].type == mavlink.MAV_MISSION_ERROR  # nobody asked


def test_an_item_with_current_2_is_a_place_to_fly_to() -> None:
    vehicle = Vehicle("ardupilot")
    guided = item(0, MISSION, 16, frame=3)
    guided.current = 2
    (ack,) = vehicle.say(guided)
    assert ack.type == ACCEPTED
    (asked,) = vehicle.asked
    assert (asked.number, asked.frame) == (192, 3)
    assert asked.parameters[4:] == (-35.36, 149.16, 20.0)


# --- PX4 ------------------------------------------------------------------------------------------


def test_px4_gives_items_back_in_the_form_that_is_asked_for() -> None:
    vehicle = Vehicle("px4")
    for kind, items in (
        (MISSION, [each for each in mission() if each.frame in (2, 5, 6)]),
        (FENCE, [*polygon(3), circle(3, frame=5)]),
        (RALLY, [item(0, RALLY, 5100, frame=6)]),
    ):
        for seq, each in enumerate(items):
            each.seq = seq
        assert upload(vehicle, items, kind) is ACCEPTED
        got = download(vehicle, kind)
        for each in items:  # heights of fences mean nothing
            each.frame = 5 if kind is FENCE else each.frame
        assert [fields(each) for each in got] == [fields(each) for each in items]
    upload(vehicle, mission(), MISSION)
    assert [each.frame for each in download(vehicle, MISSION)] == [5, 6, 6, 2, 5, 2]
    vehicle.say(mavlink.MAVLink_mission_request_list_message(1, 1))
    old = [vehicle.say(mavlink.MAVLink_mission_request_message(1, 1, k))[0] for k in range(6)]
    assert [each.frame for each in old] == [0, 3, 3, 2, 0, 2]


def test_px4_keeps_the_parameters_that_it_uses_and_a_yaw_that_is_not_given() -> None:
    vehicle = Vehicle("px4")
    takeoff = item(0, MISSION, 22, *[math.nan] * 4, frame=6)
    speed = item(1, MISSION, 178, 1, 5, -1, frame=2, x=0, y=0, z=math.nan)
    waypoint = item(2, MISSION, 16, 7, 8, 9, 10, frame=6)
    assert upload(vehicle, [takeoff, speed, waypoint], MISSION) is ACCEPTED
    got = download(vehicle, MISSION)
    assert [fields(each)[2:6] for each in got] == [
        ("0.0", "0.0", "0.0", "nan"),
        ("1.0", "5.0", "-1.0", "0.0"),
        ("7.0", "8.0", "0.0", "10.0"),
    ]
    assert math.isnan(got[1].z)


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


def test_the_same_list_again_replaces_nothing() -> None:
    vehicle = Vehicle("px4")
    for _ in range(2):
        assert upload(vehicle, [circle(0)], FENCE) is ACCEPTED
    assert vehicle.replaced == [FENCE]


def test_px4_asks_again_four_times_a_second_and_gives_up_after_5_s_in_words_only() -> None:
    vehicle = Vehicle("px4")
    vehicle.say(count(2, FENCE))
    got = vehicle.run(8.0)
    assert {each.get_type() for _, each in got} == {"MISSION_REQUEST_INT"}
    assert [seconds for seconds, _ in got[:3]] == pytest.approx([0.26, 0.52, 0.78], abs=0.02)
    assert got[-1][0] < 5.1
    assert vehicle.texts == ["Operation timeout"]


@pytest.mark.parametrize("sender", [THERE, Sender(system=9, component=9, link=0)])
def test_px4_refuses_a_second_uploader_on_any_link(sender: Sender) -> None:
    vehicle = Vehicle("px4")
    vehicle.say(count(2, FENCE))
    (ack,) = vehicle.say(count(1, FENCE), sender)
    assert ack.type == mavlink.MAV_MISSION_ERROR
    vehicle.say(circle(0))
    assert vehicle.say(circle(1))[0].type == ACCEPTED


def test_px4_repeats_itself_when_an_answer_was_lost() -> None:
    vehicle = Vehicle("px4")
    first = vehicle.say(count(2, FENCE))
    assert [each.seq for each in (*first, *vehicle.say(count(2, FENCE)))] == [0, 0]
    vehicle.say(circle(0))
    assert vehicle.say(circle(0)) == []  # once is enough
    vehicle.say(circle(1))
    (again,) = vehicle.say(circle(1))
    assert (again.get_type(), again.type) == ("MISSION_ACK", ACCEPTED)


def test_px4_hands_out_in_order_and_ends_when_it_is_left() -> None:
    vehicle = Vehicle("px4")
    upload(vehicle, mission(), MISSION)
    listing = mavlink.MAVLink_mission_request_list_message(1, 1)
    vehicle.say(listing)
    got = [vehicle.say(request(seq, MISSION)) for seq in (0, 1, 1, 2)]
    assert [each.seq for (each,) in got] == [0, 1, 1, 2]
    assert [each.current for (each,) in got] == [0, 1, 1, 0]
    assert vehicle.say(count(1, MISSION))[0].type == mavlink.MAV_MISSION_ERROR  # busy
    (ack,) = vehicle.say(request(5, MISSION))
    assert ack.type == mavlink.MAV_MISSION_ERROR
    assert vehicle.texts[-1] == "WPM: REJ. CMD: Req. WP was unexpected"
    vehicle.say(listing)
    for seq in range(6):
        vehicle.say(request(seq, MISSION))
    assert vehicle.say(listing)[0].count == 6  # the last acknowledgement never came
    vehicle.run(6.0)
    assert vehicle.say(count(1, MISSION))[0].get_type() == "MISSION_REQUEST_INT"


def test_px4_clears_all_three_at_once_if_asked() -> None:
    vehicle = Vehicle("px4")
    upload(vehicle, mission(), MISSION)
    upload(vehicle, [circle(0)], FENCE)
    (ack,) = vehicle.say(mavlink.MAVLink_mission_clear_all_message(1, 1, 255))
    assert (ack.type, ack.mission_type) == (ACCEPTED, 255)
    assert all(vehicle.plans[kind] == () for kind in PlanKind)


@pytest.mark.parametrize(
    ("bad", "result"),
    [
        (item(1, MISSION, 9999), mavlink.MAV_MISSION_UNSUPPORTED),
        (item(1, MISSION, 16, frame=10), mavlink.MAV_MISSION_UNSUPPORTED_FRAME),
        (item(1, MISSION, 16, frame=2), mavlink.MAV_MISSION_UNSUPPORTED),
        (item(1, MISSION, 5004, 3), mavlink.MAV_MISSION_ERROR),
        (item(1, FENCE, 5001, 2), mavlink.MAV_MISSION_ERROR),
        (item(1, FENCE, 5001, math.nan), mavlink.MAV_MISSION_ERROR),
    ],
)
def test_which_items_px4_refuses(bad: Any, result: int) -> None:
    vehicle = Vehicle("px4")
    kind = PlanKind(bad.mission_type)
    good = circle(0) if kind is FENCE else item(0, MISSION, 16)
    assert upload(vehicle, [good, bad, good], kind) is result
    assert vehicle.plans[kind] == ()
    assert upload(vehicle, [good], kind) is ACCEPTED
