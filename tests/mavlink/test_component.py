"""Commands as a ground station packs them, byte by byte; places against pyproj's geodesics."""

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pyproj
import pytest
from by_hand import (
    OURS,
    PERSON,
    Ack,
    ack,
    command_int,
    command_long,
)
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission
from companion.geodesy import LocalFrame
from companion.mavlink.component import Component, Reply, heartbeat, version_number
from companion.mavlink.dialect import codec
from companion.mission.changes import OrderResult
from companion.mission.checkpoint import initial_state
from companion.mission.events import Order, OrderKind
from companion.mission.state import Phase

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, IN_PROGRESS, WRONG_FRAME = 0, 1, 2, 3, 5, 9
START, PAUSE, REPOSITION, RETURN, LAND = 300, 193, 192, 20, 21
REQUEST, CAPABILITIES = 512, 520
LATITUDE_DEG, LONGITUDE_DEG = ORIGIN_DEG = 47.0, 8.0
GEOD = pyproj.Geod(ellps="WGS84")
MISSION = load_mission("valley")  # 10 km x 7.5 km, 8 m/s
STRANGER = (42, 1)
READY = structs.replace(initial_state(MISSION, None), phase=Phase.READY)


def made(*, origin_deg: tuple[float, float] = ORIGIN_DEG, version: str = "1.2.3") -> Component:
    frame = LocalFrame(latitude_deg=origin_deg[0], longitude_deg=origin_deg[1])
    mission = replace(MISSION, frame=frame, commanders=((255, 0), (1, 191)))
    return Component(mission, OURS[0], version)


def answered(server: Component, message: Any, now_s: float = 10.0) -> tuple[Reply, list[Ack]]:
    """What comes back if the machine takes every order."""
    answer = server.on_message(message, now_s)
    replies = [*answer.replies]
    if answer.order is not None:
        replies += server.order_done(answer.order, OrderResult.ACCEPTED)
    return answer, [ack(reply) for reply in replies if reply.get_type() == "COMMAND_ACK"]


def place_e7(north_m: float, east_m: float) -> tuple[int, int]:
    """The point at a distance and azimuth of the origin, by the geodesic."""
    azimuth = math.degrees(math.atan2(east_m, north_m))
    longitude, latitude, _ = GEOD.fwd(
        LONGITUDE_DEG, LATITUDE_DEG, azimuth, math.hypot(north_m, east_m)
    )
    return round(latitude * 1e7), round(longitude * 1e7)


@pytest.mark.parametrize(
    ("command", "parameters", "kind"),
    [
        (START, (), OrderKind.START),
        (START, (0.0, 5.0), OrderKind.START),
        (START, (math.nan, math.nan), OrderKind.START),
        (PAUSE, (0.0,), OrderKind.PAUSE),
        (PAUSE, (1.0,), OrderKind.CONTINUE),
        (RETURN, (), OrderKind.RETURN),
        (RETURN, tuple([math.nan] * 7), OrderKind.RETURN),
        (LAND, (), OrderKind.LAND),
        (LAND, (0.0, 0.0, 0.0, math.nan), OrderKind.LAND),
    ],
)
def test_an_order_is_passed_on_and_acknowledged_when_it_was_taken(
    command: int, parameters: tuple[float, ...], kind: OrderKind
) -> None:
    for message in (command_long(command, *parameters), command_int(command, *parameters[:4])):
        server = made()
        answer = server.on_message(message, 12.5)
        assert answer.order == Order(time_s=12.5, kind=kind, sender="255/190")
        assert answer.replies == ()
        assert answer.note is not None
        [done] = server.order_done(answer.order, OrderResult.ACCEPTED)
        assert ack(done) == Ack(command, ACCEPTED, PERSON)
        assert server.order_done(answer.order, OrderResult.ACCEPTED) == ()


def test_an_order_that_the_machine_refuses_is_refused() -> None:
    server = made()
    for verdict, result in ((OrderResult.NOT_NOW, REJECTED), (OrderResult.INVALID, DENIED)):
        answer = server.on_message(command_long(START), 1.0)
        assert answer.order is not None
        [done] = server.order_done(answer.order, verdict)
        assert ack(done).result == result


@pytest.mark.parametrize(
    ("command", "parameters"),
    [
        (START, (3.0,)),
        (START, (math.inf,)),
        (PAUSE, (2.0,)),
        (PAUSE, (math.nan,)),
        (REPOSITION, (-1.0, 0.0, 0.0, math.nan, math.nan, 8.0, 100.0)),
        (REPOSITION, (-1.0, 0.0, 0.0, math.nan, 47.0, math.nan, 100.0)),
        (REPOSITION, (-1.0, 0.0, 0.0, math.nan, math.inf, 8.0, 100.0)),
        (REPOSITION, (-1.0, 0.0, 0.0, math.nan, 0.0, 0.0, 100.0)),
        (REPOSITION, (-1.0, 0.0, 0.0, math.nan, 95.0, 8.0, 100.0)),
        (REPOSITION, (-1.0, 0.0, 0.0, math.nan, 48.0, 8.0, 100.0)),
        (REPOSITION, (-1.0, 0.0, 0.0, math.nan, -47.0, -172.0, 100.0)),
        (LAND, (0.0, 0.0, 0.0, math.nan, 47.0, 8.0, 0.0)),
    ],
)
def test_values_that_cannot_be_are_denied_with_words(
    command: int, parameters: tuple[float, ...]
) -> None:
    answer, acks = answered(made(), command_long(command, *parameters))
    assert acks == [Ack(command, DENIED, PERSON)]
    assert answer.order is None
    assert 0 < len(answer.text) <= 60


@given(st.floats(-4_900.0, 4_900.0), st.floats(-3_900.0, 3_400.0), st.sampled_from([0, 3, 5, 6]))
def test_a_new_target_lies_where_the_geodesic_says(
    north_m: float, east_m: float, frame_id: int
) -> None:
    x, y = place_e7(north_m, east_m)
    message = command_int(REPOSITION, -1.0, x=x, y=y, z=math.nan, frame_id=frame_id)
    answer, acks = answered(made(), message)
    assert acks == [Ack(REPOSITION, ACCEPTED, PERSON)]
    assert answer.order is not None
    assert answer.order.kind is OrderKind.REPOSITION
    assert answer.order.target_ne_m == pytest.approx((north_m, east_m), abs=0.02)
    in_floats = command_long(REPOSITION, -1.0, 0.0, 0.0, math.nan, x * 1e-7, y * 1e-7, 50.0)
    answer, acks = answered(made(), in_floats)
    assert answer.order is not None
    assert answer.order.target_ne_m == pytest.approx((north_m, east_m), abs=0.5)


@pytest.mark.parametrize("frame_id", [1, 2, 4, 7, 8, 9, 10, 11, 12, 20, 21, 255])
def test_another_frame_is_refused_as_such(frame_id: int) -> None:
    x, y = place_e7(100.0, 100.0)
    _, acks = answered(made(), command_int(REPOSITION, x=x, y=y, frame_id=frame_id))
    assert acks == [Ack(REPOSITION, WRONG_FRAME, PERSON)]
    _, acks = answered(made(), command_int(PAUSE, frame_id=frame_id))  # it has no place
    assert acks == [Ack(PAUSE, ACCEPTED, PERSON)]


@pytest.mark.parametrize(("x", "y"), [(0x7FFFFFFF, 80_000_000), (470_000_000, 0x7FFFFFFF), (0, 0)])
def test_a_place_that_is_not_given_is_denied(x: int, y: int) -> None:
    _, acks = answered(made(), command_int(REPOSITION, x=x, y=y, frame_id=5))
    assert acks == [Ack(REPOSITION, DENIED, PERSON)]


def test_to_land_no_place_is_given() -> None:
    for nowhere in (command_int(LAND, x=0x7FFFFFFF, y=0x7FFFFFFF), command_int(LAND)):
        assert answered(made(), nowhere)[1] == [Ack(LAND, ACCEPTED, PERSON)]
    assert answered(made(), command_int(LAND, x=1, y=1))[1] == [Ack(LAND, DENIED, PERSON)]


def test_nor_is_0_0_even_if_it_lies_on_the_map() -> None:
    server = made(origin_deg=(0.001, 0.001))
    _, acks = answered(server, command_int(REPOSITION, x=1, y=1, frame_id=5))
    assert acks == [Ack(REPOSITION, ACCEPTED, PERSON)]
    for nowhere in (command_int(REPOSITION, frame_id=5), command_long(REPOSITION)):
        _, acks = answered(server, nowhere)
        assert acks == [Ack(REPOSITION, DENIED, PERSON)]


# --- who may, and who is meant


@pytest.mark.parametrize("command", [START, PAUSE, RETURN])
def test_strangers_are_denied_and_noted(command: int) -> None:
    answer, acks = answered(made(), command_long(command, 1.0, 5.0, sender=STRANGER))
    assert acks == [Ack(command, DENIED, STRANGER)]
    assert answer.order is None
    assert answer.note is not None
    assert answer.note["sender"] == "42/1"
    assert "42/1" in answer.text


@pytest.mark.parametrize("sender", [(255, 1), (255, 0), (1, 191)])
def test_commanders_are_matched_with_0_as_any(sender: tuple[int, int]) -> None:
    answer, _ = answered(made(), command_long(PAUSE, sender=sender))
    assert answer.order is not None
    assert answer.order.sender == f"{sender[0]}/{sender[1]}"


@pytest.mark.parametrize("sender", [(1, 190), (254, 191), (1, 1)])
def test_nobody_else_is(sender: tuple[int, int]) -> None:
    answer, _ = answered(made(), command_long(PAUSE, sender=sender))
    assert answer.order is None


@pytest.mark.parametrize("target", [(7, 1), (8, 195), (8, 0), (1, 195), (0, 1), (255, 190)])
@pytest.mark.parametrize("command", [START, REQUEST, 400, 60_000])
def test_what_is_for_others_is_neither_answered_nor_obeyed(
    target: tuple[int, int], command: int
) -> None:
    assert made().on_message(command_long(command, 148.0, target=target), 1.0) == Reply()


@pytest.mark.parametrize("target", [(7, 0), (0, 195), (0, 0)])
def test_of_a_broadcast_only_our_questions_are_answered(target: tuple[int, int]) -> None:
    for command in (START, PAUSE, RETURN, REPOSITION, 400, 22):
        answer = made().on_message(command_long(command, 0.0, 5.0, target=target), 1.0)
        assert answer == Reply()
    _, acks = answered(made(), command_long(REQUEST, 148.0, target=target))
    assert acks == [Ack(REQUEST, ACCEPTED, PERSON)]
    _, acks = answered(made(), command_long(REQUEST, 30.0, target=target))  # an autopilot's
    assert acks == []


def test_our_own_messages_sent_back_by_a_router_are_ignored() -> None:
    assert made().on_message(command_long(START, sender=OURS), 1.0) == Reply()


@pytest.mark.parametrize("command", [22, 176, 178, 400, 246, 510, 511, 2000, 5004, 0, 65_535])
def test_what_we_cannot_do_is_unsupported(command: int) -> None:
    for sender in (PERSON, STRANGER):
        _, acks = answered(made(), command_long(command, sender=sender))
        assert acks == [Ack(command, UNSUPPORTED, sender)]


# --- the same again


def test_a_command_sent_again_is_acknowledged_again_and_not_obeyed_again() -> None:
    server = made()
    first, acks = answered(server, command_long(PAUSE), 10.0)
    assert first.order is not None
    for confirmation in (1, 2):
        again, repeated = answered(server, command_long(PAUSE, confirmation=confirmation), 11.0)
        assert again.order is None
        assert repeated == acks
    later, _ = answered(server, command_long(PAUSE, confirmation=1), 60.0)
    assert later.order is not None


def test_one_that_gets_through_at_the_second_attempt_only_is_obeyed() -> None:
    answer, _ = answered(made(), command_long(PAUSE, confirmation=1))
    assert answer.order is not None


def test_while_the_machine_has_not_answered_it_is_in_progress() -> None:
    server = made()
    assert server.on_message(command_long(PAUSE), 1.0).order is not None
    again = server.on_message(command_long(PAUSE, confirmation=1), 1.5)
    assert [ack(reply).result for reply in again.replies] == [IN_PROGRESS]


def test_pause_go_on_and_pause_are_three_orders() -> None:
    server = made()
    kinds = [
        answered(server, command_long(PAUSE, parameter, confirmation=1), 1.0)[0].order
        for parameter in (0.0, 1.0, 0.0)
    ]
    assert None not in kinds


def test_a_question_in_between_does_not_make_it_a_new_order() -> None:
    server = made()
    answered(server, command_long(PAUSE), 1.0)
    answered(server, command_long(REQUEST, 148.0), 1.1)
    answered(server, command_long(22), 1.2)
    again, acks = answered(server, command_long(PAUSE, confirmation=1), 1.6)
    assert again.order is None
    assert acks == [Ack(PAUSE, ACCEPTED, PERSON)]


def test_what_another_ground_station_orders_is_not_the_same() -> None:
    server = made()
    answered(server, command_long(PAUSE), 1.0)
    other, _ = answered(server, command_long(PAUSE, confirmation=1, sender=(1, 191)), 1.0)
    assert other.order is not None


def test_without_confirmation_the_same_place_again_is_the_same_order() -> None:
    x, y = place_e7(50.0, 60.0)
    server, there = made(), {"x": x, "y": y, "frame_id": 5}
    first, acks = answered(server, command_int(REPOSITION, -1.0, **there), 1.0)
    assert first.order is not None
    again, repeated = answered(server, command_int(REPOSITION, -1.0, **there), 1.5)
    assert again.order is None
    assert repeated == acks
    nearby, _ = answered(server, command_int(REPOSITION, -1.0, x=x + 1, y=y, frame_id=5), 1.6)
    assert nearby.order is not None


def test_a_refused_one_may_be_tried_again() -> None:
    server = made()
    message = command_int(START)
    first = server.on_message(message, 1.0)
    assert first.order is not None
    server.order_done(first.order, OrderResult.NOT_NOW)
    assert server.on_message(message, 1.5).order is not None


def test_a_command_in_long_form_without_confirmation_is_a_new_one() -> None:
    server = made()
    for _ in range(3):
        assert answered(server, command_long(PAUSE), 1.0)[0].order is not None


def test_many_senders_do_not_fill_the_memory() -> None:
    server = made()
    for component in range(256):
        server.on_message(command_long(PAUSE, sender=(255, component)), 1.0)
    assert len(server._given) <= 64


# --- questions


def test_messages_of_ours_can_be_asked_for_by_everybody() -> None:
    for sender in (PERSON, STRANGER):
        for message in (
            command_long(REQUEST, 148.0, sender=sender),
            command_int(REQUEST, 148.0, sender=sender),
            command_long(CAPABILITIES, 1.0, sender=sender),
        ):
            server = made()
            _, acks = answered(server, message)
            assert [(one.result, one.target) for one in acks] == [(ACCEPTED, sender)]
            [version] = server.on_time(1.0, READY, faulted=True)
            assert version.get_type() == "AUTOPILOT_VERSION"


@pytest.mark.parametrize("number", [30.0, 330.0, 148.5, -1.0, math.nan, math.inf, 1e30])
def test_messages_that_are_not_ours_are_denied(number: float) -> None:
    _, acks = answered(made(), command_long(REQUEST, number))
    assert acks == [Ack(REQUEST, DENIED, PERSON)]


# --- whatever comes

IDS = st.tuples(st.sampled_from([0, 1, 7, 8, 255]), st.sampled_from([0, 1, 190, 195]))
COMMANDS = st.sampled_from([START, PAUSE, REPOSITION, RETURN, REQUEST, CAPABILITIES]) | st.integers(
    0, 65_535
)
FLOATS = st.floats(width=32) | st.sampled_from([0.0, 1.0, -1.0, 148.0, 330.0, 47.0, 8.0])


@given(st.data())
def test_one_ack_answers_each_command_for_us_and_none_any_other(data: st.DataObject) -> None:
    server = made()
    for _ in range(data.draw(st.integers(1, 6))):
        target, sender = data.draw(IDS), data.draw(IDS)
        command = data.draw(COMMANDS)
        if data.draw(st.booleans()):
            parameters = data.draw(st.lists(FLOATS, min_size=7, max_size=7))
            confirmation = data.draw(st.integers(0, 3))
            message = command_long(
                command, *parameters, target=target, sender=sender, confirmation=confirmation
            )
        else:
            message = command_int(
                command,
                *data.draw(st.lists(FLOATS, min_size=4, max_size=4)),
                x=data.draw(st.integers(-(2**31), 2**31 - 1)),
                y=data.draw(st.integers(-(2**31), 2**31 - 1)),
                z=data.draw(FLOATS),
                frame_id=data.draw(st.integers(0, 255)),
                target=target,
                sender=sender,
            )
        answer = server.on_message(message, data.draw(st.floats(0.0, 100.0)))
        replies = list(answer.replies)
        if answer.order is not None:
            assert target == OURS
            assert sender[0] == 255
            done = server.order_done(answer.order, data.draw(st.sampled_from(OrderResult)))
            assert len(done) == 1
            replies += done
        acks = [ack(reply) for reply in replies if reply.get_type() == "COMMAND_ACK"]
        if target == OURS and sender != OURS:
            assert [(one.command, one.target) for one in acks] == [(command, sender)]
        else:
            assert len(acks) <= 1
            assert all(one.result == ACCEPTED for one in acks)
        if target[0] not in (0, 7) or target[1] not in (0, 195):
            assert answer == Reply()


# --- its own messages


def over_the_wire(message: Any) -> Any:
    """As pymavlink's own parser reads it."""
    [parsed] = wire.MAVLink(None).parse_buffer(message.pack(codec(7)))
    return parsed


def counted(component: Component, begin_s: float = 0.0, seconds: float = 10.0) -> Counter[str]:
    """What is sent in a time, asked at 20 Hz."""
    times = begin_s + np.arange(0.0, seconds, 0.05)
    sent = [component.on_time(float(t), READY, faulted=False) for t in times]
    return Counter(message.get_type() for messages in sent for message in messages)


def test_the_heartbeat_is_that_of_an_onboard_controller() -> None:
    beat = over_the_wire(heartbeat(wire.MAV_STATE_CRITICAL))
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (7, 195)
    assert beat.type == 18  # MAV_TYPE_ONBOARD_CONTROLLER
    assert beat.autopilot == 8  # MAV_AUTOPILOT_INVALID
    assert (beat.base_mode, beat.custom_mode) == (0, 0)
    assert (beat.system_status, beat.mavlink_version) == (5, 3)


def test_it_beats_once_a_second_also_when_the_clock_begins_again_and_not_while_faulted() -> None:
    component = made()
    for tenth in range(100):
        assert component.on_time(0.1 * tenth, READY, faulted=True) == []
    for begin_s in (1000.0, 0.0):
        assert counted(component, begin_s) == {"HEARTBEAT": 10}


def test_the_version_is_told_when_it_is_asked_for() -> None:
    component = made()
    answered(component, command_long(REQUEST, 148.0))
    _, version = component.on_time(0.0, READY, faulted=False)
    read = over_the_wire(version)
    assert read.flight_sw_version == 1 << 24 | 2 << 16 | 3 << 8 | 255
    can = read.capabilities
    assert can & wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    assert can & wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    assert not can & wire.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    assert not can & wire.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    assert not can & wire.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    assert counted(component, begin_s=1.0) == {"HEARTBEAT": 10}


@pytest.mark.parametrize(
    ("version", "number"),
    [
        ("0.1.0", 0x000100FF),
        ("1.2", 0x010200FF),
        ("3.4.5rc2", 0x030405C0),
        ("3.4.5b1", 0x03040580),
        ("3.4.5a1", 0x03040540),
        ("3.4.5.dev7", 0x03040500),
        ("3.4.5+local", 0x03040500),
        ("300.1.1", 0xFF0101FF),
        ("", 0),
        ("unknown", 0),
    ],
)
def test_versions(version: str, number: int) -> None:
    assert version_number(version) == number


@given(st.text("0123456789.+-_abcdevr \u0663\u00b2\n", max_size=30))
def test_whatever_the_version_is_it_fits(version: str) -> None:
    assert 0 <= version_number(version) < 2**32


def test_a_heartbeat_that_is_asked_for_comes_at_once_and_counts() -> None:
    component = made()
    assert len(component.on_time(0.0, READY, faulted=False)) == 1
    answered(component, command_long(REQUEST, 0.0))
    assert component.due_s < 0.0
    assert len(component.on_time(0.4, READY, faulted=False)) == 1
    assert component.due_s == 1.4
    assert component.on_time(1.3, READY, faulted=False) == []
