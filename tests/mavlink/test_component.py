"""Commands as a ground station sends them, and what it is answered; places by geodesics."""

import math
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
NAN, NOWHERE = math.nan, 0x7FFFFFFF


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
    told = (read.get_type(), read.get_srcSystem(), read.get_srcComponent())
    assert told == ("COMMAND_ACK", *OURS)
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


def results(message: Any, server: Component | None = None) -> list[int]:
    return [each.result for each in answered(server or made(), message)[1]]


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
def test_orders_are_passed_on(command: int, parameters: tuple[float, ...], kind: OrderKind) -> None:
    verdicts = {OrderResult.NOT_NOW: REJECTED, OrderResult.INVALID: DENIED}
    for message in (command_long(command, *parameters), command_int(command, *parameters[:4])):
        for verdict, result in (verdicts | {OrderResult.ACCEPTED: ACCEPTED}).items():
            answer, acks = answered(made(), message, 12.5, verdict)
            assert answer.order == Order(time_s=12.5, kind=kind, sender="255/190")
            assert acks == [Ack(command, result, PERSON)]
            assert answer.note is not None


NO_PLACES = [(NAN, 8.0), (47.0, math.inf), (0.0, 0.0), (95.0, 8.0), (48.0, 8.0)]
REFUSED = [
    *((command_long(START, value), DENIED) for value in (3.0, math.inf)),
    *((command_long(PAUSE, value), DENIED) for value in (2.0, NAN)),
    *(
        (command_long(REPOSITION, -1.0, 0.0, 0.0, NAN, *place, 100.0), DENIED)
        for place in NO_PLACES
    ),
    (command_int(REPOSITION, x=NOWHERE, y=80_000_000, frame_id=5), DENIED),
    (command_int(REPOSITION, x=470_000_000, y=NOWHERE, frame_id=5), DENIED),
    (command_int(REPOSITION, frame_id=5), DENIED),
    (command_long(LAND, 0.0, 0.0, 0.0, NAN, 47.0, 8.0, 0.0), DENIED),
    (command_int(LAND, x=1, y=1), DENIED),
    *(
        (command_int(REPOSITION, x=470_000_000, y=80_000_000, frame_id=frame), WRONG_FRAME)
        for frame in (1, 2, 4, 7, 8, 10, 11, 12, 20, 255)
    ),
]
NONE_OF_OURS = [
    *(
        (command_long(REQUEST, number), DENIED)
        for number in (30.0, 330.0, 148.5, -1.0, NAN, math.inf, 1e30)
    ),
    *((command_long(CAPABILITIES, value), DENIED) for value in (0.0, 148.0, NAN)),
    *(
        (command_long(command, sender=sender), UNSUPPORTED)
        for command in (22, 176, 178, 400, 246, 510, 511, 2000, 5004, 0, 65_535)
        for sender in (PERSON, STRANGER)
    ),
]


@pytest.mark.parametrize(
    ("message", "result"),
    [*REFUSED, *NONE_OF_OURS],
    ids=range(len(REFUSED) + len(NONE_OF_OURS)),
)
def test_the_impossible_is_refused_and_of_orders_it_is_said_why(message: Any, result: int) -> None:
    answer, acks = answered(made(), message)
    sender = message.get_srcSystem(), message.get_srcComponent()
    assert acks == [Ack(message.command, result, sender)]
    assert answer.order is None
    assert bool(answer.text) is ((message, result) in REFUSED)
    assert len(answer.text) <= 60


@given(st.floats(-4_900.0, 4_900.0), st.floats(-3_900.0, 3_400.0), st.sampled_from([0, 3, 5, 6]))
def test_a_new_target_lies_where_told(north_m: float, east_m: float, frame_id: int) -> None:
    x, y = geodetic_e7(north_m, east_m)
    message = command_int(REPOSITION, -1.0, x=x, y=y, z=NAN, frame_id=frame_id)
    in_floats = command_long(REPOSITION, -1.0, 0.0, 0.0, NAN, x * 1e-7, y * 1e-7, 50.0)
    for each, off_m in ((message, 0.02), (in_floats, 0.5)):
        answer, acks = answered(made(), each)
        assert acks == [Ack(REPOSITION, ACCEPTED, PERSON)]
        assert answer.order.kind is OrderKind.REPOSITION
        assert answer.order.target_ne_m == pytest.approx((north_m, east_m), abs=off_m)


def test_0_0_is_no_place_even_if_it_lies_on_the_map_and_what_needs_none_takes_none() -> None:
    gulf = made(LocalFrame(latitude_deg=0.001, longitude_deg=0.001))
    assert results(command_int(REPOSITION, x=1, y=1, frame_id=5), gulf) == [ACCEPTED]
    for nowhere in (command_int(REPOSITION, frame_id=5), command_long(REPOSITION)):
        assert results(nowhere, gulf) == [DENIED]
    for command, no_place in ((LAND, {"frame_id": 12}), (LAND, {"x": NOWHERE, "y": NOWHERE})):
        assert results(command_int(command, **no_place)) == [ACCEPTED]


@pytest.mark.parametrize(
    ("sender", "may"),
    [
        *((sender, True) for sender in ((255, 1), (255, 0), (1, 191))),
        *((sender, False) for sender in (STRANGER, (1, 190), (254, 191), (1, 1))),
    ],
)
def test_only_commanders_may_order_0_meaning_any(sender: tuple[int, int], may: bool) -> None:
    name = f"{sender[0]}/{sender[1]}"
    for command in (START, PAUSE, RETURN):
        answer, acks = answered(made(), command_long(command, sender=sender))
        assert acks == [Ack(command, ACCEPTED if may else DENIED, sender)]
        assert (answer.order is not None) is may
        assert answer.note is not None
        assert answer.note["sender"] == name
        assert may or name in answer.text


ALL_KINDS = (START, PAUSE, RETURN, REPOSITION, LAND, REQUEST, CAPABILITIES, 400, 22)


def test_of_a_broadcast_our_questions_alone_are_answered_and_of_the_rest_nothing() -> None:
    for target in ((7, 0), (0, 195), (0, 0)):
        for command in set(ALL_KINDS) - {REQUEST, CAPABILITIES}:
            answer = made().on_message(command_long(command, 0.0, 5.0, target=target), 1.0)
            assert answer == Reply()
        for number, acks in ((148.0, [Ack(REQUEST, ACCEPTED, PERSON)]), (30.0, [])):
            answer, told = answered(made(), command_long(REQUEST, number, target=target))
            assert (answer.note, told) == (None, acks)
    others = ({"target": (8, 195)}, {"target": (7, 190)}, {"target": (7, 1)}, {"target": (255, 0)})
    for whose in (*others, {"sender": OURS}):  # the last: our own, sent back by a router
        for command in ALL_KINDS:
            message = command_long(command, 148.0 * (command == REQUEST), **whose)
            assert made().on_message(message, 1.0) == Reply()


def said(command: int, confirmation: int, at_s: float, value: float = 0.0) -> tuple[Any, float]:
    return command_long(command, value, confirmation=confirmation), at_s


X, Y = geodetic_e7(50.0, 60.0)
THERE, BESIDE = (command_int(REPOSITION, -1.0, x=X + k, y=Y, frame_id=5) for k in (0, 1))
OTHERS = command_long(PAUSE, confirmation=1, sender=(1, 191))


@pytest.mark.parametrize(
    ("messages", "are_orders"),
    [
        # a repeated one is marked by its confirmation; later it is a new one
        ([said(PAUSE, 0, 10.0), said(PAUSE, 1, 11.0), said(PAUSE, 2, 11.0)], [True, False, False]),
        ([said(PAUSE, 0, 10.0), said(PAUSE, 1, 60.0)], [True, True]),
        ([said(PAUSE, 1, 1.0)], [True]),  # got through at the second attempt only
        ([said(PAUSE, 0, 1.0)] * 3, [True, True, True]),
        # a question in between does not make it a new order
        (
            [said(PAUSE, 0, 1.0), said(REQUEST, 0, 1.1), said(22, 0, 1.2), said(PAUSE, 1, 1.6)],
            [True, False, False, False],
        ),
        # other parameters, and other senders, do
        ([said(PAUSE, 1, 1.0, value) for value in (0.0, 1.0, 0.0)], [True, True, True]),
        ([said(PAUSE, 0, 1.0), (OTHERS, 1.0)], [True, True]),
        ([(THERE, 1.0), (THERE, 1.5), (BESIDE, 1.6)], [True, False, True]),
    ],
)
def test_a_repeat_is_not_obeyed_and_has_the_answer_of_the_first(
    messages: list[tuple[Any, float]], are_orders: list[bool]
) -> None:
    server = made()
    told = [answered(server, message, at_s) for message, at_s in messages]
    assert [answer.order is not None for answer, _ in told] == are_orders
    accepted = {
        each.result for _, acks in told for each in acks if each.command in (PAUSE, REPOSITION)
    }
    assert accepted == {ACCEPTED}


def test_a_repeated_command_has_the_ack_of_the_first() -> None:
    server = made()
    first = server.on_message(command_long(PAUSE), 1.0)
    again = command_long(PAUSE, confirmation=1)
    for result in (IN_PROGRESS, REJECTED):
        assert [ack(each).result for each in server.on_message(again, 1.5).replies] == [result]
        server.order_done(first.order, OrderResult.NOT_NOW)
    refused = server.on_message(command_int(START), 2.0)
    server.order_done(refused.order, OrderResult.NOT_NOW)
    assert server.on_message(command_int(START), 2.5).order is not None  # it may be tried again


def kinds_sent(component: Component, at_s: float, *, faulted: bool = False) -> list[str]:
    return [message.get_type() for message in component.on_time(at_s, READY, faulted=faulted)]


def test_it_beats_once_a_second_whatever_its_clock_and_not_while_faulted() -> None:
    beat = over_the_wire(heartbeat(wire.MAV_STATE_CRITICAL), OURS)
    assert (beat.type, beat.autopilot) == (18, 8)  # MAV_TYPE_ONBOARD_CONTROLLER, INVALID
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (0, 0, 5)
    component = made()
    assert not any(kinds_sent(component, 0.1 * tenth, faulted=True) for tenth in range(100))
    for begin_s in (1000.0, 0.0):  # it begins again
        times_s = begin_s + np.arange(0.0, 10.0, 0.05)
        sent = [kind for at_s in times_s for kind in kinds_sent(component, float(at_s))]
        assert sent == ["HEARTBEAT"] * 10
    answered(component, command_long(REQUEST, 0.0))  # it comes once there is no fault
    assert not any(kinds_sent(component, at_s, faulted=True) for at_s in (10.5, 10.6, 10.7))
    assert component.due_s < 0.0
    assert [kinds_sent(component, at_s) for at_s in (10.8, 10.9)] == [["HEARTBEAT"], []]
    assert component.due_s == 11.8


def test_the_version_is_told_once_to_everybody_who_asks_for_it() -> None:
    can = wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    for message in (
        command_long(REQUEST, 148.0),
        command_int(REQUEST, 148.0, sender=STRANGER),
        command_long(CAPABILITIES, 1.0, sender=STRANGER),
    ):
        server = made()
        assert results(message, server) == [ACCEPTED]
        [version] = server.on_time(1.0, READY, faulted=True)
        read = over_the_wire(version)
        assert read.flight_sw_version == 1 << 24 | 2 << 16 | 3 << 8 | 255
        assert read.capabilities == can
        assert kinds_sent(server, 2.0) == ["HEARTBEAT"]
    versions = {"0.1.0": 0x000100FF, "1.2": 0x010200FF, "300.1.1": 0xFF0101FF, "unknown": 0, "": 0}
    versions |= dict.fromkeys(("3.4.5rc2", "3.4.5.dev7", "3.4.5+local"), 0x03040500)
    assert {version: version_number(version) for version in versions} == versions
