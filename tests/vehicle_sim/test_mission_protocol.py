"""Missions, fences and rally points over the wire: one server for all autopilots."""

import math
from functools import partial
from typing import Any

import pytest
from harness import COMPANION, GCS, VEHICLE, Rig, flying
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.parameters import Firmware
from vehicle_sim.plans import PlanKind

BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
MISSION, FENCE, RALLY = PlanKind.MISSION, PlanKind.FENCE, PlanKind.RALLY
ACCEPTED, ERROR, FRAME, UNSUPPORTED, NO_SPACE, INVALID = range(6)
SEQUENCE, CANCELLED = 13, 15
"""MAV_MISSION_RESULT."""
REQUEST = mavlink.MAVLink_mission_request_int_message
ASKS = ("MISSION_REQUEST", "MISSION_REQUEST_INT")
FIELDS = ("command", "frame", "param1", "param2", "param3", "param4", "x", "y", "z")
NOWHERE = {"frame": 2, "x": 0, "y": 0, "z": 0}


def say(vehicle: Rig, message: Any, *, source: tuple[int, int] = GCS, link: int = 0) -> list[Any]:
    """What the mission protocol says to who says this."""
    heard = vehicle.ask(message, source=source, link=link)
    said = [each for each in heard if each.get_type().startswith("MISSION_")]
    got = [each for each in said if each.get_type() != "MISSION_CURRENT"]
    assert all((each.target_system, each.target_component) == source for each in got)
    return got


def item(seq: int, kind: int, command: int, *p: float, frame: int = 3, **more: Any) -> Any:
    place = {"x": 473_977_420 + seq, "y": 85_455_940 - seq, "z": 20.0 + seq, **more}
    head = (*VEHICLE, seq, frame, command, 0, 1, *p, *[0.0] * (4 - len(p)))
    return mavlink.MAVLink_mission_item_int_message(*head, **place, mission_type=kind)


def count(number: int, kind: int) -> Any:
    return mavlink.MAVLink_mission_count_message(*VEHICLE, number, kind)


def circle(seq: int, radius_m: float = 30.0, **more: Any) -> Any:
    return item(seq, FENCE, 5004, radius_m, **more)


def polygon(vertices: int) -> list[Any]:
    return [item(k, FENCE, 5001, vertices) for k in range(vertices)]


def lists() -> dict[PlanKind, list[Any]]:
    mission = [
        *(item(0, MISSION, 16, frame=0), item(1, MISSION, 22, 0, 0, 0, math.nan)),
        *(item(2, MISSION, 16, 5, 0, 0, 0, frame=6), item(3, MISSION, 178, 1, 5, -1, **NOWHERE)),
        *(item(4, MISSION, 16, frame=5), item(5, MISSION, 20, **NOWHERE)),
    ]
    rally = [item(k, RALLY, 5100) for k in range(2)]
    return {MISSION: mission, FENCE: [*polygon(3), circle(3)], RALLY: rally}


def upload(vehicle: Rig, items: list[Any], kind: int) -> int | None:
    """The result; None: none comes."""
    answers = say(vehicle, count(len(items), kind))
    while answers and answers[-1].get_type() != "MISSION_ACK":
        seq = answers[-1].seq
        items[seq].seq = seq
        answers = say(vehicle, items[seq])
    return answers[-1].type if answers else None


def download(vehicle: Rig, kind: int, source: tuple[int, int] = GCS, link: int = 0) -> list[Any]:
    tell, asks = partial(say, vehicle, source=source, link=link), partial(REQUEST, *VEHICLE)
    (told,) = tell(mavlink.MAVLink_mission_request_list_message(*VEHICLE, kind))
    items = [tell(asks(seq, kind))[0] for seq in range(told.count)]
    tell(mavlink.MAVLink_mission_ack_message(*VEHICLE, 0, kind))
    return items


@BOTH
def test_what_is_uploaded_comes_back_as_it_was_sent_until_cleared(firmware: Firmware) -> None:
    vehicle = Rig(firmware, links=2)

    def told(items: list[Any]) -> list[list[str]]:
        return [[repr(float(getattr(each, name))) for name in FIELDS] for each in items]

    for kind, items in lists().items():
        assert upload(vehicle, items, kind) == ACCEPTED
        begin = int(kind is MISSION and firmware == "ardupilot")  # item 0 is home
        for link, source in ((0, GCS), (1, COMPANION)):
            got = download(vehicle, kind, source, link)
            assert [each.seq for each in got] == list(range(len(items)))
            assert told(got[begin:]) == told(items[begin:])
        assert say(vehicle, REQUEST(*VEHICLE, len(items), kind))[0].type == SEQUENCE
    for kind, emptied in ((FENCE, [FENCE]), (255, list(PlanKind))):
        (ack,) = say(vehicle, mavlink.MAVLink_mission_clear_all_message(*VEHICLE, kind))
        assert (ack.get_type(), ack.type, ack.mission_type) == ("MISSION_ACK", ACCEPTED, kind)
        assert all(vehicle.simulation.plans[each] == () for each in emptied)
        upload(vehicle, [circle(0)], FENCE)
    assert say(vehicle, count(0, FENCE))[0].type == ACCEPTED
    assert download(vehicle, FENCE) == []


@BOTH
def test_old_clients_send_and_get_items_in_degrees(firmware: Firmware) -> None:
    vehicle = Rig(firmware, links=2)
    say(vehicle, count(2, MISSION))
    for seq in (0, 1):
        head = (*VEHICLE, seq, 3, 16, 0, 1, 0, 0, 0, 0)
        (last,) = say(vehicle, mavlink.MAVLink_mission_item_message(*head, -35.5, 149.25, 40.0))
    assert last.type == ACCEPTED
    (got,) = say(vehicle, mavlink.MAVLink_mission_request_message(*VEHICLE, 1))
    assert (got.get_type(), got.x, got.y, got.z) == ("MISSION_ITEM", -35.5, 149.25, 40.0)


def test_item_0_of_ardupilots_mission_is_home_and_one_of_current_2_a_place_to_fly_to() -> None:
    vehicle = flying("ardupilot", "copter")
    before = vehicle.last("GLOBAL_POSITION_INT")
    guided = item(0, MISSION, 16, x=before.lat + 10_000, y=before.lon, z=40.0)
    guided.current = 2
    assert say(vehicle, guided)[0].type == ACCEPTED
    assert vehicle.simulation.plans[MISSION] == ()
    vehicle.run(30.0)
    assert vehicle.last("GLOBAL_POSITION_INT").lat == pytest.approx(guided.x, abs=50)
    upload(vehicle, lists()[MISSION], MISSION)
    home = download(vehicle, MISSION)[0]
    assert (home.x, home.y) == pytest.approx([at * 1e7 for at in vehicle.home[:2]], abs=5)
    assert (home.z, home.frame) == (pytest.approx(vehicle.home[2], abs=0.5), 0)
    set_current = mavlink.MAVLink_mission_set_current_message(*VEHICLE, 2)
    answers = [each for each in vehicle.ask(set_current) if hasattr(each, "seq")]
    assert [(each.get_type(), each.seq) for each in answers] == [("MISSION_CURRENT", 2)]


def test_items_come_once_and_in_order_and_from_one_client_at_a_time() -> None:
    vehicle = Rig("ardupilot", links=2)
    say(vehicle, count(2, FENCE))
    assert say(vehicle, circle(1)) == []
    assert say(vehicle, circle(0))[0].seq == 1
    assert say(vehicle, circle(0)) == []  # so copies of a frame do not multiply
    (ack,) = say(vehicle, circle(1), source=COMPANION, link=1)
    assert (ack.get_type(), ack.type) == ("MISSION_ACK", ERROR)
    # the last, and again, as the answer was lost; then one for which nobody asked
    results = [say(vehicle, circle(seq))[0].type for seq in (1, 1, 0)]
    assert results == [ACCEPTED, ACCEPTED, ERROR]
    say(vehicle, count(2, FENCE))
    assert say(vehicle, count(1, FENCE), source=COMPANION)[0].seq == 0  # begun anew
    assert say(vehicle, circle(0))[0].type == ERROR
    assert say(vehicle, circle(0), source=COMPANION)[0].type == ACCEPTED


@BOTH
def test_what_does_not_come_is_asked_for_again_and_given_up_in_the_end(firmware: Firmware) -> None:
    """However silent the client is: an answer of the vehicle may have been lost."""
    vehicle = Rig(firmware, links=2)
    upload(vehicle, [circle(0)], FENCE)
    old = vehicle.simulation.plans[FENCE]
    say(vehicle, count(2, FENCE))
    say(vehicle, circle(0))
    began, begin_s = len(vehicle.heard), vehicle.heard[-1].at_s
    vehicle.run(20.0)
    *again, end = (it for it in vehicle.heard[began:] if it.kind in (*ASKS, "MISSION_ACK"))
    asked = {(round(it.at_s - begin_s), it.message.seq) for it in again}
    assert asked == {(k, 1) for k in range(1, 8)}
    assert (end.kind, end.message.type) == ("MISSION_ACK", CANCELLED)
    assert 8.0 < end.at_s - begin_s < 9.5
    assert vehicle.simulation.plans[FENCE] == old


@pytest.mark.parametrize(
    ("kind", "items", "result"),
    [
        *((FENCE, [item(0, FENCE, 5000), circle(1)], ACCEPTED), (FENCE, polygon(3)[:2], ERROR)),
        *((FENCE, polygon(2), ERROR), (FENCE, [item(0, FENCE, 5001, math.nan)], ERROR)),
        (FENCE, [*polygon(3)[:2], circle(2)], ERROR),
        *((FENCE, [circle(0, math.inf)], ACCEPTED), (FENCE, [circle(0, 0.0)], ERROR)),
        *((FENCE, [circle(0, math.nan)], ERROR), (FENCE, [circle(0, x=10**9)], INVALID)),
        *((FENCE, [circle(0, frame=1)], FRAME), (FENCE, [item(0, FENCE, 16)], UNSUPPORTED)),
        (FENCE, [circle(k) for k in range(725)], NO_SPACE),
        (MISSION, [item(0, MISSION, 82)], UNSUPPORTED),  # a spline
        (MISSION, [item(0, MISSION, 16, y=-1_800_000_001)], INVALID),
        (RALLY, [item(0, RALLY, 16)], UNSUPPORTED),
        (7, [circle(0)], UNSUPPORTED),  # a list that there is not
    ],
)
def test_a_list_is_taken_whole_or_the_old_stays(kind: Any, items: list[Any], result: int) -> None:
    vehicle = Rig("px4", links=2)
    kept = vehicle.simulation.plans
    upload(vehicle, lists().get(kind, []), kind)
    before = {each: kept[each] for each in PlanKind}
    assert upload(vehicle, items, kind) == result
    assert ({each: kept[each] for each in PlanKind} == before) is (result != ACCEPTED)
