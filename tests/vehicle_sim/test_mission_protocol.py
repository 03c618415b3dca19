"""Missions, fences and rally points over the wire: one server for all autopilots."""

import math
from typing import Any

import pytest
from harness import COMPANION, GCS, PLACE, VEHICLE, Link, flying, ready
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink import mavwp
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.parameters import Firmware
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.wire.missions import opaque_id

BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
MISSION, FENCE, RALLY = PlanKind.MISSION, PlanKind.FENCE, PlanKind.RALLY
ACCEPTED, ERROR = mavlink.MAV_MISSION_ACCEPTED, mavlink.MAV_MISSION_ERROR
UNSUPPORTED, INVALID = mavlink.MAV_MISSION_UNSUPPORTED, mavlink.MAV_MISSION_INVALID
DENIED, WRONG_FRAME = mavlink.MAV_MISSION_DENIED, mavlink.MAV_MISSION_UNSUPPORTED_FRAME
ANSWERS = {"ACK", "COUNT", "REQUEST", "REQUEST_INT", "ITEM", "ITEM_INT"}


def fresh(firmware: Firmware) -> Link:
    vehicle = Link("copter", firmware, PLACE, links=2)
    vehicle.source = GCS
    return vehicle


def heard(vehicle: Link, seconds: float, link: int = 0) -> list[tuple[float, Any]]:
    """Second and message of what the mission protocol says on a link."""
    begun_s = vehicle.now_s
    return [
        (each.at_s - begun_s, each.message)
        for each in vehicle.run(seconds)
        if each.link == link and each.kind.removeprefix("MISSION_") in ANSWERS
    ]


def say(vehicle: Link, message: Any, *, source: tuple[int, int] = GCS, link: int = 0) -> list[Any]:
    """What comes back to who says this."""
    vehicle.send(message, source=source, link=link)
    got = [answer for _, answer in heard(vehicle, 0.02, link)]
    assert all((each.target_system, each.target_component) == source for each in got)
    return got


def item(seq: int, kind: PlanKind, command: int, *p: float, frame: int = 3, **more: Any) -> Any:
    p1, p2, p3, p4 = (*p, *[0.0] * (4 - len(p)))
    place = {"x": 473_977_420 + seq, "y": 85_455_940 - seq, "z": 20.0 + seq, **more}
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, seq, frame, command, 0, 1, p1, p2, p3, p4, **place, mission_type=int(kind)
    )


def count(number: int, kind: int) -> Any:
    return mavlink.MAVLink_mission_count_message(*VEHICLE, number, kind)


def request(seq: int, kind: int) -> Any:
    return mavlink.MAVLink_mission_request_int_message(*VEHICLE, seq, kind)


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


LISTS = {
    MISSION: mission,
    FENCE: lambda: [*polygon(3), circle(3)],
    RALLY: lambda: [item(k, RALLY, 5100) for k in range(2)],
}


def fields(message: Any) -> list[str]:
    names = ("command", "frame", "param1", "param2", "param3", "param4", "x", "y", "z")
    return [repr(float(getattr(message, name))) for name in names]


# --- both ways ------------------------------------------------------------------------------------


@BOTH
def test_what_is_uploaded_comes_back_to_anybody_as_it_was_sent(firmware: Firmware) -> None:
    vehicle = fresh(firmware)
    for kind, of in LISTS.items():
        items = of()
        assert vehicle.upload(items, kind) == ACCEPTED
        begin = int(kind is MISSION and firmware == "ardupilot")  # item 0 is home
        for link, source in ((0, GCS), (1, COMPANION)):
            got = vehicle.download(kind, link=link, source=source)
            assert [each.seq for each in got] == list(range(len(items)))
            assert list(map(fields, got[begin:])) == list(map(fields, items[begin:]))
            assert [g.current for g in got] == [0] * len(got) or kind is MISSION
        (beyond,) = say(vehicle, request(len(items), kind))
        assert beyond.type == mavlink.MAV_MISSION_INVALID_SEQUENCE


@BOTH
def test_old_clients_send_and_get_items_in_degrees(firmware: Firmware) -> None:
    vehicle = fresh(firmware)
    say(vehicle, count(2, MISSION))
    for seq in (0, 1):
        head = (*VEHICLE, seq, 3, 16, 0, 1, 0, 0, 0, 0)
        (last,) = say(vehicle, mavlink.MAVLink_mission_item_message(*head, -35.5, 149.25, 40.0))
    assert last.type == ACCEPTED
    stored = vehicle.simulation.plans[MISSION][1]
    assert (stored.x, stored.y) == (-355000000, 1492500000)
    (got,) = say(vehicle, mavlink.MAVLink_mission_request_message(*VEHICLE, 1))
    assert got.get_type() == "MISSION_ITEM"
    assert (got.x, got.y, got.z) == pytest.approx((-35.5, 149.25, 40.0))


@BOTH
def test_what_mavwp_holds_arrives_and_comes_back(firmware: Firmware, tmp_path: Any) -> None:
    loader, vehicle = mavwp.MAVWPLoader(1, 1), fresh(firmware)
    for each in mission():
        loader.add(each)
    assert vehicle.upload([loader.item(k) for k in range(6)], MISSION) == ACCEPTED
    back = mavwp.MAVWPLoader(1, 1)
    for each in vehicle.download(MISSION):
        back.add(each)
    assert [back.item(k).command for k in range(6)] == [16, 22, 16, 178, 16, 20]
    back.save(str(tmp_path / "mission.txt"))
    assert mavwp.MAVWPLoader(1, 1).load(str(tmp_path / "mission.txt")) == 6


@BOTH
def test_an_empty_upload_and_a_clear_empty_the_list_or_all_three(firmware: Firmware) -> None:
    vehicle = fresh(firmware)
    for how in (count(0, FENCE), mavlink.MAVLink_mission_clear_all_message(*VEHICLE, 1)):
        assert vehicle.upload([circle(0)], FENCE) == ACCEPTED
        (ack,) = say(vehicle, how)
        assert (ack.get_type(), ack.type, ack.mission_type) == ("MISSION_ACK", ACCEPTED, 1)
        assert vehicle.download(FENCE) == []
    for kind, of in LISTS.items():
        vehicle.upload(of(), kind)
    (ack,) = say(vehicle, mavlink.MAVLink_mission_clear_all_message(*VEHICLE, 255))
    assert (ack.type, ack.mission_type) == (ACCEPTED, 255)
    assert all(vehicle.simulation.plans[kind] == () for kind in PlanKind)


def test_item_0_of_ardupilots_mission_is_home() -> None:
    vehicle = ready("ardupilot", "copter")
    for of in ([], mission()):
        vehicle.upload(of, MISSION)
        (home,) = say(vehicle, request(0, MISSION))
        assert (home.x, home.y) == pytest.approx((PLACE[0] * 1e7, PLACE[1] * 1e7), abs=5)
        assert (home.z, home.frame) == (pytest.approx(PLACE[2], abs=0.5), 0)


def test_the_id_of_a_list_is_the_one_that_the_real_px4_gave_it() -> None:
    # the fence and the MISSION_ACK of px4-gps-loss.tlog at 0.8 s
    vehicle = fresh("px4")
    say(vehicle, count(1, FENCE))
    (ack,) = say(vehicle, circle(0, 30.0, frame=5, x=474013408, y=85455948, z=0.0))
    raw = bytes(ack.get_msgbuf())
    assert raw[10 : 10 + raw[1]].hex() == "ffbe0001470676d1"
    (told,) = say(vehicle, mavlink.MAVLink_mission_request_list_message(*VEHICLE, 1))
    assert bytes(told.get_msgbuf())[15:19].hex() == "470676d1"
    assert opaque_id(()) == 0


# --- an upload that does not go well --------------------------------------------------------------


@BOTH
@pytest.mark.parametrize("lost", range(4))
def test_an_unfinished_upload_leaves_the_old_list(firmware: Firmware, lost: int) -> None:
    """What does not come is asked for again and given up in the end."""
    vehicle, items = fresh(firmware), LISTS[FENCE]()
    vehicle.upload([circle(0)], FENCE)
    old = vehicle.simulation.plans[FENCE]
    for message in (count(4, FENCE), *items[:lost]):
        say(vehicle, message)
    *asked, (last_s, ack) = heard(vehicle, 8.0)
    assert {message.seq for _, message in asked} == {lost}
    assert [s for s, _ in asked] == pytest.approx([0.5 * k for k in range(1, 10)], abs=0.1)
    assert (ack.type, ack.mission_type) == (mavlink.MAV_MISSION_OPERATION_CANCELLED, 1)
    assert last_s == pytest.approx(5.0, abs=0.05)
    assert vehicle.simulation.plans[FENCE] == old
    assert vehicle.upload(items, FENCE) == ACCEPTED


@BOTH
def test_the_wrong_item_is_left_out_and_the_last_may_be_repeated(firmware: Firmware) -> None:
    vehicle = fresh(firmware)
    say(vehicle, count(2, FENCE))
    assert say(vehicle, circle(1)) == []
    assert [message.seq for _, message in heard(vehicle, 0.6)] == [0]
    assert say(vehicle, circle(0))[0].seq == 1
    assert say(vehicle, circle(0)) == []  # once is enough
    assert say(vehicle, circle(1))[0].type == ACCEPTED
    assert say(vehicle, circle(1))[0].type == ACCEPTED  # the acknowledgement was lost
    assert say(vehicle, circle(0))[0].type == ERROR  # nobody asked


@BOTH
def test_while_one_uploads_the_others_are_denied(firmware: Firmware) -> None:
    vehicle = fresh(firmware)
    say(vehicle, count(2, FENCE))
    for message in (count(1, FENCE), circle(0), count(1, MISSION)):
        (ack,) = say(vehicle, message, source=COMPANION, link=1)
        assert (ack.get_type(), ack.type) == ("MISSION_ACK", DENIED)
    (begun_again,) = say(vehicle, count(1, FENCE))
    assert begun_again.seq == 0
    assert say(vehicle, circle(0))[0].type == ACCEPTED


@BOTH
@given(lost=st.lists(st.booleans(), min_size=40, max_size=40))
@settings(max_examples=15)
def test_an_upload_over_a_lossy_link_ends_right_or_not_at_all(
    firmware: Firmware, lost: list[bool]
) -> None:
    """Every k-th frame of either side is lost or not; the client repeats what it said last."""
    vehicle, items, goes = fresh(firmware), LISTS[FENCE](), iter(lost)
    last, done = count(4, FENCE), False
    for _ in range(60):
        if not next(goes, False):
            vehicle.send(last)
        for _, answer in heard(vehicle, 0.3):
            if next(goes, False):
                continue
            if answer.get_type() != "MISSION_ACK":
                last = items[answer.seq]
            elif answer.type == ACCEPTED:
                done = True
            else:
                last = count(4, FENCE)
    assert len(vehicle.simulation.plans[FENCE]) in ((4,) if done else (0, 4))


# --- what is refused, and what is not for a list --------------------------------------------------


def bow_tie() -> list[Any]:
    corners = [(0, 0), (100, 100), (100, 0), (0, 100)]
    return [item(k, FENCE, 5001, 4, x=x, y=y) for k, (x, y) in enumerate(corners)]


@BOTH
@pytest.mark.parametrize(
    ("kind", "items", "result"),
    [
        (FENCE, bow_tie(), ACCEPTED),
        (FENCE, polygon(3)[:2], ERROR),
        (FENCE, polygon(2), ERROR),
        (FENCE, [item(0, FENCE, 5001, math.nan)], ERROR),
        (FENCE, [*polygon(3)[:2], circle(2)], ERROR),
        (FENCE, [*polygon(3)[:2], *polygon(3, at=2, command=5002)[:1]], ERROR),
        (FENCE, [circle(0, math.inf)], ACCEPTED),
        (FENCE, [circle(0, 0.0)], ERROR),
        (FENCE, [circle(0, math.nan)], ERROR),
        (FENCE, [circle(0, x=10**9)], INVALID),
        (FENCE, [circle(0, frame=1)], WRONG_FRAME),
        (FENCE, [item(0, FENCE, 16)], UNSUPPORTED),
        (FENCE, [circle(k) for k in range(725)], mavlink.MAV_MISSION_NO_SPACE),
        (MISSION, [item(0, MISSION, 82)], UNSUPPORTED),  # a spline
        (MISSION, [item(0, MISSION, 112)], UNSUPPORTED),  # a condition
        (MISSION, [item(0, MISSION, 5004, 3)], UNSUPPORTED),
        (MISSION, [item(0, MISSION, 16, frame=1)], WRONG_FRAME),
        (MISSION, [item(0, MISSION, 16, x=900_000_001)], INVALID),
        (MISSION, [item(0, MISSION, 16, y=-1_800_000_001)], INVALID),
        (RALLY, [item(0, RALLY, 16)], UNSUPPORTED),
        (7, [circle(0)], UNSUPPORTED),  # a list that there is not
    ],
)
def test_a_list_is_taken_whole_or_refused_and_the_old_one_stays(
    firmware: Firmware, kind: Any, items: list[Any], result: int
) -> None:
    vehicle = fresh(firmware)
    kept = vehicle.simulation.plans
    if kind in list(PlanKind):
        vehicle.upload(LISTS[kind](), kind)
    before = {each: kept[each] for each in PlanKind}
    assert vehicle.upload(items, kind) == result
    assert ({each: kept[each] for each in PlanKind} == before) is (result != ACCEPTED)
    assert vehicle.upload([], FENCE) == ACCEPTED  # nothing is under way


@BOTH
def test_asking_for_a_part_of_a_list_changes_nothing(firmware: Firmware) -> None:
    vehicle = fresh(firmware)
    vehicle.upload([circle(0)], FENCE)
    part = mavlink.MAVLink_mission_request_partial_list_message(*VEHICLE, 0, 0, 1)
    assert say(vehicle, part) == []
    assert len(vehicle.simulation.plans[FENCE]) == 1


@BOTH
def test_the_current_item_is_set_and_told_without_an_acknowledgement(firmware: Firmware) -> None:
    vehicle = fresh(firmware)
    vehicle.upload(mission(), MISSION)
    vehicle.send(mavlink.MAVLink_mission_set_current_message(*VEHICLE, 2))
    answers = vehicle.run(0.02)
    assert not [each for each in answers if each.kind == "COMMAND_ACK"]
    assert {each.message.seq for each in answers if each.kind == "MISSION_CURRENT"} == {2}


def test_an_item_with_current_2_is_a_place_to_fly_to() -> None:
    vehicle = flying("ardupilot", "copter")
    before = vehicle.last("GLOBAL_POSITION_INT")
    guided = item(0, MISSION, 16, frame=3, x=before.lat + 10_000, y=before.lon, z=40.0)
    guided.current = 2
    (ack,) = say(vehicle, guided)
    assert ack.type == ACCEPTED
    assert vehicle.simulation.plans[MISSION] == ()
    vehicle.run(30.0)
    assert vehicle.last("GLOBAL_POSITION_INT").lat == pytest.approx(guided.x, abs=50)
    guided.x = 10**9
    assert say(vehicle, guided)[0].type == INVALID


@given(
    messages=st.lists(
        st.tuples(
            st.sampled_from([37, 38, 39, 40, 41, 43, 44, 45, 47, 51, 73]),
            st.binary(min_size=38, max_size=38),
            st.sampled_from([GCS, COMPANION]),
            st.floats(0.0, 4.0),
        ),
        max_size=12,
    )
)
@settings(max_examples=25)
def test_no_message_in_no_order_does_harm(messages: list[tuple[int, bytes, Any, float]]) -> None:
    for firmware in ("ardupilot", "px4"):
        vehicle = fresh(firmware)  # type: ignore[arg-type]
        for number, raw, source, later_s in messages:
            kind = mavlink.mavlink_map[number]
            names = dict(zip(kind.ordered_fieldnames, kind.unpacker.unpack_from(raw), strict=True))
            message = kind(**names)
            message.target_system, message.target_component = VEHICLE
            message.mission_type = raw[0] % 4
            if hasattr(message, "seq"):
                message.seq %= 4
            vehicle.send(message, source=source)
            vehicle.run(later_s)
        for kind in PlanKind:
            assert all(isinstance(each, PlanItem) for each in vehicle.simulation.plans[kind])
        vehicle.run(5.1)
        assert vehicle.upload([circle(0)], FENCE) == ACCEPTED
