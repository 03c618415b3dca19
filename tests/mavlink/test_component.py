"""Commands as a ground station sends them, and what it is answered; places by geodesics."""

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
NAN, NOWHERE = math.nan, 0x7FFFFFFF


def made(frame: LocalFrame = FRAME) -> Component:
    """Its commanders: 255/any and 1/191."""
    mission = replace(MISSION, frame=frame, commanders=((255, 0), (1, 191)))
    return Component(mission, OURS[0], "1.2.3")


def said(
    command: int,
    *parameters: float,
    sender: tuple[int, int] = PERSON,
    target: tuple[int, int] = OURS,
    **fields: Any,
) -> Any:
    """COMMAND_LONG as it is read, or COMMAND_INT if it has a frame; what is left out is 0."""
    fields |= {f"param{n}": value for n, value in enumerate(parameters, 1)}
    fields |= {"command": command, "target_system": target[0], "target_component": target[1]}
    return heard("COMMAND_INT" if "frame" in fields else "COMMAND_LONG", sender, **fields)


def answered(
    server: Component, message: Any, now_s: float = 12.5, verdict: Any = OrderResult.ACCEPTED
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


COMMANDERS = ((255, 1), (255, 0), (1, 191))
NO_COMMANDERS = (STRANGER, (1, 190), (254, 191), (1, 1))
NO_PLACES = [(NAN, 8.0), (47.0, math.inf), (0.0, 0.0), (95.0, 8.0), (48.0, 8.0)]
BROADCASTS, OTHERS = ((7, 0), (0, 195), (0, 0)), ((8, 195), (7, 190), (7, 1), (255, 0))
ORDERS = (START, PAUSE, RETURN, LAND, REPOSITION)
UNKNOWN = (22, 176, 178, 400, 246, 510, 511, 2000, 5004, 0, 65_535)
RETURNS = [said(RETURN, *[NAN] * 7), *(said(RETURN, sender=by) for by in COMMANDERS)]
LANDS = [said(LAND, 0.0, 0.0, 0.0, NAN), said(LAND, frame=12, x=NOWHERE, y=NOWHERE)]
ANSWERS: dict[tuple[OrderKind | None, int | None], list[Any]] = {
    (OrderKind.START, 0): [said(START), said(START, 0.0, 5.0), said(START, NAN, frame=0)],
    (OrderKind.PAUSE, ACCEPTED): [said(PAUSE), said(PAUSE, frame=5)],
    (OrderKind.CONTINUE, ACCEPTED): [said(PAUSE, 1.0), said(PAUSE, 1.0, frame=3)],
    (OrderKind.RETURN, ACCEPTED): RETURNS,
    (OrderKind.LAND, ACCEPTED): LANDS,
    (None, DENIED): [
        *(said(START, value) for value in (3.0, math.inf)),
        *(said(PAUSE, value) for value in (2.0, NAN)),
        *(said(REPOSITION, -1.0, 0.0, 0.0, NAN, *place, 100.0) for place in NO_PLACES),
        *(said(REPOSITION, frame=5, x=x, y=y) for x, y in ((NOWHERE, 80), (47, NOWHERE))),
        said(LAND, 0.0, 0.0, 0.0, NAN, 47.0, 8.0, 0.0),
        said(LAND, frame=0, x=1, y=1),
        *(said(each, sender=by) for each in ORDERS for by in NO_COMMANDERS),
        *(said(REQUEST, number) for number in (30.0, 330.0, 148.5, -1.0, NAN, math.inf, 1e30)),
        *(said(CAPABILITIES, value) for value in (0.0, 148.0, NAN)),
    ],
    (None, UNSUPPORTED): [said(each, sender=by) for each in UNKNOWN for by in (PERSON, STRANGER)],
    (None, ACCEPTED): [said(REQUEST, 148.0, target=to) for to in (OURS, *BROADCASTS)],
    (None, None): [  # for others, for all, or our own that a router sends back
        *(said(each, target=to) for each in (*ORDERS, 400, 22) for to in BROADCASTS + OTHERS),
        *(said(REQUEST, 30.0, target=to) for to in BROADCASTS),
        *(said(REQUEST, 148.0, target=to) for to in OTHERS),
        *(said(each, 1.0, sender=OURS) for each in (*ORDERS, CAPABILITIES)),
    ],
}


@pytest.mark.parametrize(("kind", "result"), ANSWERS)
def test_what_is_ordered_and_answered(kind: OrderKind | None, result: int | None) -> None:
    """Why an order is refused is said in a text, too."""
    for message in ANSWERS[kind, result]:
        sender = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        answer, results = answered(made(), message)
        assert results == [result] * (result is not None)
        order = Order(time_s=12.5, kind=kind, sender=sender) if kind is not None else None
        assert answer.order == order
        assert bool(answer.text) is (result == DENIED and message.command in ORDERS)
        assert len(answer.text) <= 60
        assert not answer.text or sender in ("255/190", answer.text.split()[0])
        is_noted = result is not None and (message.target_system, message.target_component) == OURS
        assert (answer.note or {}).get("sender") == (sender if is_noted else None)


@given(st.floats(-9e3, 9e3), st.floats(-9e3, 9e3), st.sampled_from([0, 3, 5, 6, 1, 4, 8, 12]))
def test_a_new_target_lies_where_told(north_m: float, east_m: float, frame: int) -> None:
    x, y = geodetic_e7(north_m, east_m)
    limits = MISSION.task.limits
    edges_m = [north_m - at for at in limits.north_m] + [east_m - at for at in limits.east_m]
    assume(min(map(abs, edges_m)) > 1.0)  # as floats of 32 bits they are a metre off
    on_map = edges_m[0] > 0.0 > edges_m[1] and edges_m[2] > 0.0 > edges_m[3]
    result = ACCEPTED if on_map else DENIED
    message = said(REPOSITION, -1.0, x=x, y=y, frame=frame, z=NAN)
    in_floats = said(REPOSITION, -1.0, 0.0, 0.0, NAN, x * 1e-7, y * 1e-7, 50.0)
    wanted = result if frame in (0, 3, 5, 6) else WRONG_FRAME  # AMSL, or above home
    for each, expected, off_m in ((message, wanted, 0.02), (in_floats, result, 0.5)):
        answer, results = answered(made(), each)
        assert results == [expected]
        if expected == ACCEPTED:
            assert answer.order.kind is OrderKind.REPOSITION
            assert answer.order.target_ne_m == pytest.approx((north_m, east_m), abs=off_m)


def test_0_0_is_no_place_even_if_it_lies_on_the_map() -> None:
    gulf = made(LocalFrame(latitude_deg=0.001, longitude_deg=0.001))
    tried = [said(REPOSITION, frame=5, x=1), said(REPOSITION, frame=5), said(REPOSITION)]
    assert [answered(gulf, each)[1] for each in tried] == [[ACCEPTED], [DENIED], [DENIED]]


X, Y = geodetic_e7(50.0, 60.0)
THERE, BESIDE = (said(REPOSITION, -1.0, frame=5, x=X + k, y=Y) for k in (0, 1))
FIRST, AGAIN = said(PAUSE), said(PAUSE, confirmation=1)


@pytest.mark.parametrize(
    ("messages", "are_orders"),
    [
        # a repeated one is marked by its confirmation; later it is a new one
        ([(FIRST, 10.0), (AGAIN, 11.0), (AGAIN, 60.0)], [True, False, True]),
        ([(AGAIN, 1.0)], [True]),  # got through at the second attempt only
        ([(FIRST, 1.0)] * 3, [True, True, True]),
        # a question in between does not make it a new order
        ([(FIRST, 1.0), (said(REQUEST), 1.1), (said(22), 1.2), (AGAIN, 1.6)], [1, 0, 0, 0]),
        # other parameters, and other senders, do
        ([(said(PAUSE, value, confirmation=1), 1.0) for value in (0.0, 1.0, 0.0)], [1, 1, 1]),
        ([(FIRST, 1.0), (said(PAUSE, confirmation=1, sender=(1, 191)), 1.0)], [True, True]),
        ([(THERE, 1.0), (THERE, 1.5), (BESIDE, 1.6)], [True, False, True]),
    ],
)
def test_a_repeat_is_not_obeyed(messages: list[tuple[Any, float]], are_orders: list[bool]) -> None:
    server = made()
    told = [answered(server, message, at_s)[0] for message, at_s in messages]
    assert [answer.order is not None for answer in told] == are_orders


def test_a_repeat_has_the_answer_of_the_first_and_what_was_refused_may_be_tried_again() -> None:
    server = made()
    first = server.on_message(FIRST, 1.0)
    for result in (IN_PROGRESS, REJECTED):
        assert [reply.result for reply in server.on_message(AGAIN, 1.5).replies] == [result]
        server.order_done(first.order, OrderResult.NOT_NOW)
    verdicts = {OrderResult.NOT_NOW: REJECTED, OrderResult.INVALID: DENIED, OrderResult.ACCEPTED: 0}
    for verdict, result in verdicts.items():
        assert answered(server, said(START, frame=0), 2.0, verdict)[1] == [result]


def test_it_beats_once_a_second_whatever_its_clock_and_not_while_faulted() -> None:
    beat = over_the_wire(heartbeat(wire.MAV_STATE_CRITICAL))
    controller = {"type": 18, "autopilot": 8, "base_mode": 0, "custom_mode": 0}  # ONBOARD, INVALID
    assert_told(beat, "HEARTBEAT", system_status=5, **controller)
    component = made()
    ready = structs.replace(initial_state(MISSION, None), stage=Stage(phase=Phase.READY))

    def beats(*times_s: float, faulted: bool = False) -> int:
        return sum(len(component.on_time(at_s, ready, faulted=faulted)) for at_s in times_s)

    assert beats(*np.arange(0.0, 10.0, 0.1), faulted=True) == 0
    for begin_s in (1000.0, 0.0):  # it begins again
        assert beats(*np.arange(begin_s, begin_s + 10.0, 0.05)) == 10
    answered(component, said(REQUEST, 0.0))  # it comes once there is no fault
    assert beats(10.5, 10.6, 10.7, faulted=True) == 0
    assert component.due_s < 0.0
    assert (beats(10.8), beats(10.9), component.due_s) == (1, 0, 11.8)
    for asked in (said(REQUEST, 148.0), said(CAPABILITIES, 1.0, sender=STRANGER)):
        answered(component, asked)
        [version] = component.on_time(11.0, ready, faulted=True)  # once
        can = wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        ours = {"flight_sw_version": 0x010203FF, "capabilities": can}
        assert_told(over_the_wire(version), "AUTOPILOT_VERSION", **ours)
        assert beats(11.1) == 0


def test_a_version_is_told_as_its_number() -> None:
    versions = {"0.1.0": 0x000100FF, "1.2": 0x010200FF, "300.1.1": 0xFF0101FF, "unknown": 0, "": 0}
    versions |= dict.fromkeys(("3.4.5rc2", "3.4.5.dev7", "3.4.5+local"), 0x03040500)
    assert {version: version_number(version) for version in versions} == versions
