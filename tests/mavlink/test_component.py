"""Commands as a ground station sends them, and what it is answered; places by geodesics."""

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from msgspec import structs
from wires import FRAME, SYSTEM, assert_told, geodetic_e7, heard, over_the_wire, wire

from companion.config import load_mission
from companion.geodesy import LocalFrame
from companion.mavlink.component import Component, Reply, heartbeat, version_number
from companion.mission.changes import OrderResult
from companion.mission.checkpoint import initial_state
from companion.mission.events import Order, OrderKind
from companion.mission.phases import Phase, Stage

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, IN_PROGRESS, WRONG_FRAME = 0, 1, 2, 3, 5, 9
START, PAUSE, REPOSITION, RETURN, LAND = 300, 193, 192, 20, 21
REQUEST, CAPABILITIES = 512, 520
MISSION = load_mission("valley")  # 10 km x 7.5 km, 8 m/s
OURS, PERSON, STRANGER = (SYSTEM, 195), (255, 190), (42, 1)
READY = structs.replace(initial_state(MISSION, None), stage=Stage(phase=Phase.READY))
NAN, NOWHERE = math.nan, 0x7FFFFFFF
WITH_A_PLACE = (0, 3, 5, 6)
"""Frames that have a latitude and a height AMSL or above home."""


def made(frame: LocalFrame = FRAME) -> Component:
    mission = replace(MISSION, frame=frame, commanders=((255, 0), (1, 191)))
    return Component(mission, OURS[0], "1.2.3")


def long(command: int, *parameters: float, confirmation: int = 0, **ids: tuple[int, int]) -> Any:
    """COMMAND_LONG of the person, or another sender, as it is read; what is left out is 0."""
    system, component = ids.get("target", OURS)
    fields = {f"param{n}": value for n, value in enumerate(parameters, 1)}
    fields |= {"target_system": system, "target_component": component}
    sender, told = ids.get("sender", PERSON), {"command": command, "confirmation": confirmation}
    return heard("COMMAND_LONG", sender, **told, **fields)


def in_ints(command: int, first: float = 0.0, **fields: float) -> Any:
    """COMMAND_INT of the person."""
    to = {"target_system": SYSTEM, "target_component": 195}
    return heard("COMMAND_INT", PERSON, command=command, param1=first, **to, **fields)


def answered(
    server: Component,
    message: Any,
    now_s: float = 10.0,
    verdict: OrderResult = OrderResult.ACCEPTED,
) -> tuple[Reply, list[int]]:
    """What comes back to its sender if the machine decides so on every order."""
    answer = server.on_message(message, now_s)
    replies = [*answer.replies]
    if answer.order is not None:
        replies += server.order_done(answer.order, verdict)
        assert server.order_done(answer.order, verdict) == ()  # once
    to = {"target_system": message.get_srcSystem(), "target_component": message.get_srcComponent()}
    for reply in replies:
        assert_told(over_the_wire(reply), "COMMAND_ACK", command=message.command, **to)
    return answer, [reply.result for reply in replies]


def name_of(message: Any) -> str:
    return f"{message.get_srcSystem()}/{message.get_srcComponent()}"


COMMANDERS = ((255, 1), (255, 0), (1, 191))
"""By `made`, where 0 is any."""
STRANGERS = (STRANGER, (1, 190), (254, 191), (1, 1))
ORDERS = {
    OrderKind.START: [long(START), long(START, 0.0, 5.0), long(START, NAN, NAN), in_ints(START)],
    OrderKind.PAUSE: [long(PAUSE, 0.0), in_ints(PAUSE, 0.0)],
    OrderKind.CONTINUE: [long(PAUSE, 1.0), in_ints(PAUSE, 1.0)],
    OrderKind.RETURN: [long(RETURN, *[NAN] * 7), *(long(RETURN, sender=by) for by in COMMANDERS)],
    OrderKind.LAND: [long(LAND, 0.0, 0.0, 0.0, NAN), in_ints(LAND, x=NOWHERE, y=NOWHERE)],
}
VERDICTS = {OrderResult.ACCEPTED: 0, OrderResult.NOT_NOW: REJECTED, OrderResult.INVALID: DENIED}


@pytest.mark.parametrize("kind", ORDERS)
def test_orders_of_commanders_are_passed_on(kind: OrderKind) -> None:
    for message, (verdict, result) in itertools.product(ORDERS[kind], VERDICTS.items()):
        answer, results = answered(made(), message, 12.5, verdict)
        assert answer.order == Order(time_s=12.5, kind=kind, sender=name_of(message))
        assert results == [result]
        assert answer.note["sender"] == name_of(message)


NO_PLACES = [(NAN, 8.0), (47.0, math.inf), (0.0, 0.0), (95.0, 8.0), (48.0, 8.0)]
REFUSED = [
    *(long(START, value) for value in (3.0, math.inf)),
    *(long(PAUSE, value) for value in (2.0, NAN)),
    *(long(REPOSITION, -1.0, 0.0, 0.0, NAN, *place, 100.0) for place in NO_PLACES),
    in_ints(REPOSITION, x=NOWHERE, y=80_000_000, frame=5),
    in_ints(REPOSITION, x=470_000_000, y=NOWHERE, frame=5),
    long(LAND, 0.0, 0.0, 0.0, NAN, 47.0, 8.0, 0.0),
    in_ints(LAND, x=1, y=1),
    *(long(command, sender=by) for command in (START, PAUSE, RETURN) for by in STRANGERS),
]
NO_QUESTIONS = [
    *(long(REQUEST, number) for number in (30.0, 330.0, 148.5, -1.0, NAN, math.inf, 1e30)),
    *(long(CAPABILITIES, value) for value in (0.0, 148.0, NAN)),
]


def test_the_impossible_is_refused_and_of_orders_it_is_said_why() -> None:
    for message in (*REFUSED, *NO_QUESTIONS):
        answer, results = answered(made(), message)
        assert (answer.order, results) == (None, [DENIED])
        assert bool(answer.text) is (message in REFUSED)
        assert len(answer.text) <= 60
        is_strange = name_of(message) != "255/190"
        assert (name_of(message) in answer.text) is is_strange
    for command in (22, 176, 178, 400, 246, 510, 511, 2000, 5004, 0, 65_535):
        for sender in (PERSON, STRANGER):
            answer, results = answered(made(), long(command, sender=sender))
            assert (answer.order, results, answer.text) == (None, [UNSUPPORTED], "")


@given(st.floats(-9e3, 9e3), st.floats(-9e3, 9e3), st.sampled_from([*WITH_A_PLACE, 1, 4, 8, 12]))
def test_a_new_target_lies_where_told_if_that_is_on_the_map_in_a_frame_with_a_place(
    north_m: float, east_m: float, frame_id: int
) -> None:
    x, y = geodetic_e7(north_m, east_m)
    limits = MISSION.task.limits
    edges_m = [north_m - at for at in limits.north_m] + [east_m - at for at in limits.east_m]
    assume(min(map(abs, edges_m)) > 1.0)  # as floats of 32 bits they are a metre off
    on_map = edges_m[0] > 0.0 > edges_m[1] and edges_m[2] > 0.0 > edges_m[3]
    result = ACCEPTED if on_map else DENIED
    message = in_ints(REPOSITION, -1.0, x=x, y=y, frame=frame_id, z=NAN)
    in_floats = long(REPOSITION, -1.0, 0.0, 0.0, NAN, x * 1e-7, y * 1e-7, 50.0)
    wanted = result if frame_id in WITH_A_PLACE else WRONG_FRAME
    for each, expected, off_m in ((message, wanted, 0.02), (in_floats, result, 0.5)):
        answer, results = answered(made(), each)
        assert results == [expected]
        if expected == ACCEPTED:
            assert answer.order.kind is OrderKind.REPOSITION
            assert answer.order.target_ne_m == pytest.approx((north_m, east_m), abs=off_m)


def test_0_0_is_no_place_even_if_it_lies_on_the_map() -> None:
    gulf = made(LocalFrame(latitude_deg=0.001, longitude_deg=0.001))
    assert answered(gulf, in_ints(REPOSITION, x=1, y=1, frame=5))[1] == [ACCEPTED]
    for nowhere in (in_ints(REPOSITION, frame=5), long(REPOSITION)):
        assert answered(gulf, nowhere)[1] == [DENIED]


def test_of_a_broadcast_our_questions_alone_are_answered_and_of_the_rest_nothing() -> None:
    orders = (START, PAUSE, RETURN, REPOSITION, LAND, 400, 22)
    for target in ((7, 0), (0, 195), (0, 0)):
        unanswered = [(each, 0.0) for each in orders] + [(REQUEST, 30.0)]
        for message in (long(*each, target=target) for each in unanswered):
            assert made().on_message(message, 1.0) == Reply()
        answer, results = answered(made(), long(REQUEST, 148.0, target=target))
        assert (answer.note, results) == (None, [ACCEPTED])
    others = ({"target": (8, 195)}, {"target": (7, 190)}, {"target": (7, 1)}, {"target": (255, 0)})
    for whose in (*others, {"sender": OURS}):  # the last: our own, sent back by a router
        for command in (*orders, REQUEST, CAPABILITIES):
            message = long(command, 148.0 * (command == REQUEST), **whose)
            assert made().on_message(message, 1.0) == Reply()


def said(command: int, confirmation: int, at_s: float, value: float = 0.0) -> tuple[Any, float]:
    return long(command, value, confirmation=confirmation), at_s


X, Y = geodetic_e7(50.0, 60.0)
THERE, BESIDE = (in_ints(REPOSITION, -1.0, x=X + k, y=Y, frame=5) for k in (0, 1))
OTHERS = long(PAUSE, confirmation=1, sender=(1, 191))


@pytest.mark.parametrize(
    ("messages", "are_orders"),
    [
        # a repeated one is marked by its confirmation; later it is a new one
        ([said(PAUSE, 0, 10.0), said(PAUSE, 1, 11.0), said(PAUSE, 1, 60.0)], [True, False, True]),
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
def test_a_repeat_is_not_obeyed(messages: list[tuple[Any, float]], are_orders: list[bool]) -> None:
    server = made()
    told = [answered(server, message, at_s)[0] for message, at_s in messages]
    assert [answer.order is not None for answer in told] == are_orders


def test_a_repeat_has_the_answer_of_the_first_and_what_was_refused_may_be_tried_again() -> None:
    server, again = made(), long(PAUSE, confirmation=1)
    first = server.on_message(long(PAUSE), 1.0)
    for result in (IN_PROGRESS, REJECTED):
        assert [reply.result for reply in server.on_message(again, 1.5).replies] == [result]
        server.order_done(first.order, OrderResult.NOT_NOW)
    assert answered(server, in_ints(START), 2.0, OrderResult.NOT_NOW)[1] == [REJECTED]
    assert answered(server, in_ints(START), 2.5)[1] == [ACCEPTED]


def kinds_sent(component: Component, at_s: float, *, faulted: bool = False) -> list[str]:
    return [message.get_type() for message in component.on_time(at_s, READY, faulted=faulted)]


def test_it_beats_once_a_second_whatever_its_clock_and_not_while_faulted() -> None:
    beat = over_the_wire(heartbeat(wire.MAV_STATE_CRITICAL))
    controller = {"type": 18, "autopilot": 8, "base_mode": 0, "custom_mode": 0}  # ONBOARD, INVALID
    assert_told(beat, "HEARTBEAT", system_status=5, **controller)
    component = made()
    assert not any(kinds_sent(component, 0.1 * tenth, faulted=True) for tenth in range(100))
    for begin_s in (1000.0, 0.0):  # it begins again
        times_s = begin_s + np.arange(0.0, 10.0, 0.05)
        sent = [kind for at_s in times_s for kind in kinds_sent(component, float(at_s))]
        assert sent == ["HEARTBEAT"] * 10
    answered(component, long(REQUEST, 0.0))  # it comes once there is no fault
    assert not any(kinds_sent(component, at_s, faulted=True) for at_s in (10.5, 10.6, 10.7))
    assert component.due_s < 0.0
    assert [kinds_sent(component, at_s) for at_s in (10.8, 10.9)] == [["HEARTBEAT"], []]
    assert component.due_s == 11.8


def test_the_version_is_told_once_to_everybody_who_asks_for_it() -> None:
    can = wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    ours = {"flight_sw_version": 1 << 24 | 2 << 16 | 3 << 8 | 255, "capabilities": can}
    by_strangers = (long(REQUEST, 148.0, sender=STRANGER), long(CAPABILITIES, 1.0, sender=STRANGER))
    for message in (in_ints(REQUEST, 148.0), *by_strangers):
        server = made()
        assert answered(server, message)[1] == [ACCEPTED]
        [version] = server.on_time(1.0, READY, faulted=True)
        assert_told(over_the_wire(version), "AUTOPILOT_VERSION", **ours)
        assert kinds_sent(server, 2.0) == ["HEARTBEAT"]
    versions = {"0.1.0": 0x000100FF, "1.2": 0x010200FF, "300.1.1": 0xFF0101FF, "unknown": 0, "": 0}
    versions |= dict.fromkeys(("3.4.5rc2", "3.4.5.dev7", "3.4.5+local"), 0x03040500)
    assert {version: version_number(version) for version in versions} == versions
