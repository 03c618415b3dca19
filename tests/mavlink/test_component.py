"""Commands as a ground station sends them, and what it is answered; places by geodesics."""

import math
from collections import Counter
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from wires import FRAME, OURS, PERSON, command_int, command_long, geodetic_e7, over_the_wire, wire

from companion.config import load_mission
from companion.geodesy import LocalFrame
from companion.mavlink.component import Component, Reply, heartbeat, version_number
from companion.mavlink.dialect import codec
from companion.mission.changes import OrderResult
from companion.mission.checkpoint import initial_state
from companion.mission.events import Order, OrderKind
from companion.mission.phases import Phase, Stage

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, IN_PROGRESS, WRONG_FRAME = 0, 1, 2, 3, 5, 9
START, PAUSE, REPOSITION, RETURN, LAND = 300, 193, 192, 20, 21
REQUEST, CAPABILITIES = 512, 520
MISSION = load_mission("valley")  # 10 km x 7.5 km, 8 m/s
STRANGER = (42, 1)
READY = structs.replace(initial_state(MISSION, None), stage=Stage(phase=Phase.READY))
NAN = math.nan


class Ack(NamedTuple):
    """COMMAND_ACK."""

    command: int
    result: int
    target: tuple[int, int]


def made(frame: LocalFrame = FRAME) -> Component:
    mission = replace(MISSION, frame=frame, commanders=((255, 0), (1, 191)))
    return Component(mission, OURS[0], "1.2.3")


def ack(message: Any) -> Ack:
    """As it leaves the companion."""
    read = wire.MAVLink(None).decode(bytearray(message.pack(codec(OURS[0]))))
    assert (read.get_type(), read.get_srcSystem(), read.get_srcComponent()) == (
        "COMMAND_ACK",
        *OURS,
    )
    return Ack(read.command, read.result, (read.target_system, read.target_component))


def answered(
    server: Component,
    message: Any,
    now_s: float = 10.0,
    verdict: OrderResult = OrderResult.ACCEPTED,
) -> tuple[Reply, list[Ack]]:
    """What comes back if the machine decides so on every order."""
    answer = server.on_message(message, now_s)
    replies = [*answer.replies]
    if answer.order is not None:
        replies += server.order_done(answer.order, verdict)
        assert server.order_done(answer.order, verdict) == ()  # once
    return answer, [ack(reply) for reply in replies]


@pytest.mark.parametrize(
    ("command", "parameters", "kind"),
    [
        (START, (), OrderKind.START),
        (START, (0.0, 5.0), OrderKind.START),
        (START, (NAN, NAN), OrderKind.START),
        (PAUSE, (0.0,), OrderKind.PAUSE),
        (PAUSE, (1.0,), OrderKind.CONTINUE),
        (RETURN, (NAN,) * 7, OrderKind.RETURN),
        (LAND, (0.0, 0.0, 0.0, NAN), OrderKind.LAND),
    ],
)
def test_an_order_is_passed_on_and_acknowledged_by_what_the_machine_makes_of_it(
    command: int, parameters: tuple[float, ...], kind: OrderKind
) -> None:
    for message in (command_long(command, *parameters), command_int(command, *parameters[:4])):
        for verdict, result in (
            (OrderResult.ACCEPTED, ACCEPTED),
            (OrderResult.NOT_NOW, REJECTED),
            (OrderResult.INVALID, DENIED),
        ):
            answer, acks = answered(made(), message, 12.5, verdict)
            assert answer.order == Order(time_s=12.5, kind=kind, sender="255/190")
            assert acks == [Ack(command, result, PERSON)]
            assert answer.note is not None


_NOWHERE = 0x7FFFFFFF
IMPOSSIBLE = [
    *(command_long(START, value) for value in (3.0, math.inf)),
    *(command_long(PAUSE, value) for value in (2.0, NAN)),
    *(
        command_long(REPOSITION, -1.0, 0.0, 0.0, NAN, latitude, longitude, 100.0)
        for latitude, longitude in (
            (NAN, 8.0), (47.0, NAN), (math.inf, 8.0), (0.0, 0.0), (95.0, 8.0), (48.0, 8.0),
            (-47.0, -172.0),
        )
    ),
    command_int(REPOSITION, x=_NOWHERE, y=80_000_000, frame_id=5),
    command_int(REPOSITION, x=470_000_000, y=_NOWHERE, frame_id=5),
    command_int(REPOSITION, frame_id=5),
    command_long(LAND, 0.0, 0.0, 0.0, NAN, 47.0, 8.0, 0.0),
    command_int(LAND, x=1, y=1),
]  # fmt: skip
OTHER_FRAMES = [
    command_int(REPOSITION, x=470_000_000, y=80_000_000, frame_id=frame)
    for frame in (1, 2, 4, 7, 8, 10, 11, 12, 20, 255)
]
NOT_OURS = [command_long(REQUEST, k) for k in (30.0, 330.0, 148.5, -1.0, NAN, math.inf, 1e30)]
UNKNOWN = [
    command_long(command, sender=sender)
    for command in (22, 176, 178, 400, 246, 510, 511, 2000, 5004, 0, 65_535)
    for sender in (PERSON, STRANGER)
]


@pytest.mark.parametrize(
    ("message", "result", "is_explained"),
    [
        *((message, DENIED, True) for message in IMPOSSIBLE),
        *((message, WRONG_FRAME, True) for message in OTHER_FRAMES),
        *((message, DENIED, False) for message in NOT_OURS),
        *((message, UNSUPPORTED, False) for message in UNKNOWN),
    ],
)
def test_what_cannot_be_done_is_refused_to_who_asked_for_it(
    message: Any, result: int, is_explained: bool
) -> None:
    answer, acks = answered(made(), message)
    sender = message.get_srcSystem(), message.get_srcComponent()
    assert acks == [Ack(message.command, result, sender)]
    assert answer.order is None
    assert bool(answer.text) is is_explained
    assert len(answer.text) <= 60


def test_what_needs_no_place_takes_none_and_any_frame() -> None:
    for message in (
        command_int(PAUSE, frame_id=12),
        command_int(LAND, x=_NOWHERE, y=_NOWHERE),
        command_int(LAND),
    ):
        assert [each.result for each in answered(made(), message)[1]] == [ACCEPTED]


@given(st.floats(-4_900.0, 4_900.0), st.floats(-3_900.0, 3_400.0), st.sampled_from([0, 3, 5, 6]))
def test_a_new_target_lies_where_the_geodesic_says(
    north_m: float, east_m: float, frame_id: int
) -> None:
    x, y = geodetic_e7(north_m, east_m)
    message = command_int(REPOSITION, -1.0, x=x, y=y, z=NAN, frame_id=frame_id)
    in_floats = command_long(REPOSITION, -1.0, 0.0, 0.0, NAN, x * 1e-7, y * 1e-7, 50.0)
    for each, off_m in ((message, 0.02), (in_floats, 0.5)):
        answer, acks = answered(made(), each)
        assert acks == [Ack(REPOSITION, ACCEPTED, PERSON)]
        assert answer.order is not None
        assert answer.order.kind is OrderKind.REPOSITION
        assert answer.order.target_ne_m == pytest.approx((north_m, east_m), abs=off_m)


def test_0_0_is_no_place_even_if_it_lies_on_the_map() -> None:
    server = made(LocalFrame(latitude_deg=0.001, longitude_deg=0.001))
    for message, result in (
        (command_int(REPOSITION, x=1, y=1, frame_id=5), ACCEPTED),
        (command_int(REPOSITION, frame_id=5), DENIED),
        (command_long(REPOSITION), DENIED),
    ):
        assert [each.result for each in answered(server, message)[1]] == [result]


# --- who may, and who is meant


@pytest.mark.parametrize(
    ("sender", "may"),
    [((255, 1), True), ((255, 0), True), ((1, 191), True)]
    + [(sender, False) for sender in (STRANGER, (1, 190), (254, 191), (1, 1))],
)
def test_only_commanders_may_order_matched_with_0_as_any(
    sender: tuple[int, int], may: bool
) -> None:
    name = f"{sender[0]}/{sender[1]}"
    for command in (START, PAUSE, RETURN):
        answer, acks = answered(made(), command_long(command, sender=sender))
        assert acks == [Ack(command, ACCEPTED if may else DENIED, sender)]
        assert (answer.order is not None) is may
        assert answer.note is not None
        assert answer.note["sender"] == name
        assert may or name in answer.text


@pytest.mark.parametrize(
    ("target", "sender"),
    [(target, PERSON) for target in ((7, 1), (8, 195), (8, 0), (1, 195), (0, 1), (255, 190))]
    + [(OURS, OURS)],  # our own, sent back by a router
)
@pytest.mark.parametrize("command", [START, REQUEST, 400, 60_000])
def test_what_is_for_others_is_neither_answered_nor_obeyed(
    target: tuple[int, int], sender: tuple[int, int], command: int
) -> None:
    message = command_long(command, 148.0, target=target, sender=sender)
    assert made().on_message(message, 1.0) == Reply()


@pytest.mark.parametrize("target", [(7, 0), (0, 195), (0, 0)])
def test_of_a_broadcast_only_our_questions_are_answered(target: tuple[int, int]) -> None:
    for command in (START, PAUSE, RETURN, REPOSITION, 400, 22):
        answer = made().on_message(command_long(command, 0.0, 5.0, target=target), 1.0)
        assert answer == Reply()
    for number, acks in ((148.0, [Ack(REQUEST, ACCEPTED, PERSON)]), (30.0, [])):
        answer, told = answered(made(), command_long(REQUEST, number, target=target))
        assert (answer.note, told) == (None, acks)


# --- the same again


def orders(*given: tuple[Any, float]) -> list[bool]:
    """Which of these messages, with their times, are orders to carry out."""
    server = made()
    return [answered(server, message, at_s)[0].order is not None for message, at_s in given]


_X, _Y = geodetic_e7(50.0, 60.0)
_THERE = command_int(REPOSITION, -1.0, x=_X, y=_Y, frame_id=5)
_BESIDE = command_int(REPOSITION, -1.0, x=_X + 1, y=_Y, frame_id=5)


@pytest.mark.parametrize(
    ("given_", "are_orders"),
    [
        # a repeated one is marked by its confirmation; later, or by somebody else, it is a new one
        ([(PAUSE, 0, 10.0), (PAUSE, 1, 11.0), (PAUSE, 2, 11.0)], [True, False, False]),
        ([(PAUSE, 0, 10.0), (PAUSE, 1, 60.0)], [True, True]),
        ([(PAUSE, 1, 1.0)], [True]),  # got through at the second attempt only
        ([(PAUSE, 0, 1.0), (PAUSE, 0, 1.0), (PAUSE, 0, 1.0)], [True, True, True]),
        # a question in between does not make it a new order
        ([(PAUSE, 0, 1.0), (REQUEST, 0, 1.1), (22, 0, 1.2), (PAUSE, 1, 1.6)], [True] + 3 * [False]),
    ],
)
def test_a_command_sent_again_is_not_obeyed_again(
    given_: list[tuple[int, int, float]], are_orders: list[bool]
) -> None:
    told = [(command_long(c, confirmation=n), at_s) for c, n, at_s in given_]
    assert orders(*told) == are_orders


def test_other_parameters_and_other_senders_make_another_order() -> None:
    steps = [command_long(PAUSE, parameter, confirmation=1) for parameter in (0.0, 1.0, 0.0)]
    assert orders(*((each, 1.0) for each in steps)) == [True] * 3
    other = command_long(PAUSE, confirmation=1, sender=(1, 191))
    assert orders((command_long(PAUSE), 1.0), (other, 1.0)) == [True, True]
    assert orders((_THERE, 1.0), (_THERE, 1.5), (_BESIDE, 1.6)) == [True, False, True]


def test_a_repeated_command_has_the_ack_of_the_first() -> None:
    server = made()
    first = server.on_message(command_long(PAUSE), 1.0)
    assert first.order is not None
    again = command_long(PAUSE, confirmation=1)
    for result in (IN_PROGRESS, REJECTED):
        assert [ack(each).result for each in server.on_message(again, 1.5).replies] == [result]
        server.order_done(first.order, OrderResult.NOT_NOW)
    refused = server.on_message(command_int(START), 2.0)
    assert refused.order is not None
    server.order_done(refused.order, OrderResult.NOT_NOW)
    assert server.on_message(command_int(START), 2.5).order is not None  # it may be tried again


def test_many_senders_do_not_fill_the_memory() -> None:
    server = made()
    for component in range(256):
        server.on_message(command_long(PAUSE, sender=(255, component)), 1.0)
    assert len(server._given) <= 64


# --- whatever comes

IDS = st.tuples(st.sampled_from([0, 1, 7, 8, 255]), st.sampled_from([0, 1, 190, 195]))
COMMANDS = st.sampled_from([START, PAUSE, REPOSITION, RETURN, REQUEST, CAPABILITIES]) | st.integers(
    0, 65_535
)
FLOATS = st.floats(width=32) | st.sampled_from([0.0, 1.0, -1.0, 148.0, 330.0, 47.0, 8.0])
_WHOLE = st.integers(-(2**31), 2**31 - 1)
LONG = st.tuples(st.just(command_long), st.lists(FLOATS, min_size=7, max_size=7), st.just({}))
INT = st.tuples(
    st.just(command_int),
    st.lists(FLOATS, min_size=4, max_size=4),
    st.fixed_dictionaries({"x": _WHOLE, "y": _WHOLE, "z": FLOATS, "frame_id": st.integers(0, 255)}),
)


@given(
    st.lists(st.tuples(COMMANDS, LONG | INT, IDS, IDS, st.sampled_from(OrderResult)), max_size=6)
)
def test_one_ack_answers_each_command_for_us_and_none_any_other(given_: list[Any]) -> None:
    server = made()
    for now_s, (command, (pack, parameters, more), target, sender, verdict) in enumerate(given_):
        message = pack(command, *parameters, target=target, sender=sender, **more)
        answer, acks = answered(server, message, float(now_s), verdict)
        if answer.order is not None:
            assert target == OURS
            assert sender[0] == 255
        if target == OURS and sender != OURS:
            assert [(one.command, one.target) for one in acks] == [(command, sender)]
        else:
            assert len(acks) <= 1
            assert all(one.result == ACCEPTED for one in acks)
        if target[0] not in (0, 7) or target[1] not in (0, 195):
            assert answer == Reply()


# --- its own messages


def counted(component: Component, begin_s: float) -> Counter[str]:
    """What is sent in 10 s, asked at 20 Hz."""
    times = begin_s + np.arange(0.0, 10.0, 0.05)
    sent = [component.on_time(float(t), READY, faulted=False) for t in times]
    return Counter(message.get_type() for messages in sent for message in messages)


def test_the_heartbeat_is_that_of_an_onboard_controller() -> None:
    beat = over_the_wire(heartbeat(wire.MAV_STATE_CRITICAL), OURS)
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
    answered(component, command_long(REQUEST, 0.0))  # one that is asked for comes, and counts
    assert component.due_s < 0.0
    assert len(component.on_time(10.4, READY, faulted=False)) == 1
    assert component.due_s == 11.4
    answered(component, command_long(REQUEST, 0.0))  # or once the fault is over
    for tenth in range(5, 8):
        assert component.on_time(10.0 + 0.1 * tenth, READY, faulted=True) == []
        assert component.due_s < 0.0
    told = [component.on_time(at_s, READY, faulted=False) for at_s in (10.8, 10.9)]
    assert [[message.get_type() for message in each] for each in told] == [["HEARTBEAT"], []]


@pytest.mark.parametrize("sender", [PERSON, STRANGER])
def test_the_version_is_told_to_everybody_who_asks_for_it(sender: tuple[int, int]) -> None:
    for message in (
        command_long(REQUEST, 148.0, sender=sender),
        command_int(REQUEST, 148.0, sender=sender),
        command_long(CAPABILITIES, 1.0, sender=sender),
    ):
        server = made()
        assert [each.result for each in answered(server, message)[1]] == [ACCEPTED]
        [version] = server.on_time(1.0, READY, faulted=True)
        read = over_the_wire(version)
        assert read.flight_sw_version == 1 << 24 | 2 << 16 | 3 << 8 | 255
        assert read.capabilities == (
            wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        )
        assert counted(server, 1.0) == {"HEARTBEAT": 10}


@pytest.mark.parametrize(
    ("version", "number"),
    [
        *(("0.1.0", 0x000100FF), ("1.2", 0x010200FF), ("3.4.5rc2", 0x030405C0)),
        *(("3.4.5b1", 0x03040580), ("3.4.5a1", 0x03040540), ("3.4.5.dev7", 0x03040500)),
        *(("3.4.5+local", 0x03040500), ("300.1.1", 0xFF0101FF), ("", 0), ("unknown", 0)),
    ],
)
def test_versions(version: str, number: int) -> None:
    assert version_number(version) == number


@given(st.text("0123456789.+-_abcdevr \u0663\u00b2\n", max_size=30))
def test_whatever_the_version_is_it_fits(version: str) -> None:
    assert 0 <= version_number(version) < 2**32
