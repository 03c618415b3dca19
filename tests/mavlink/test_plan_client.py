"""Mission, fence and rally points over the wire, against the simulator of all four autopilots."""

import itertools
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from held import FOUR, OURS, Firmware, Held, circle, place_e7, polygon, recorded, waypoints
from wires import over_the_wire

from companion.mavlink.dialect import wire
from companion.mavlink.plan_client import FENCE, KINDS, MISSION, RALLY, PlanClient, PlanItem
from vehicle_sim.plans import PlanItem as Stored

ALL_FOUR = pytest.mark.parametrize("way", FOUR, ids=" ".join)
BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
PERSON = (255, 190)
KNOWN_WITHIN_S = 10.0
"""Issue 5, build 3: a fence that is drawn in flight."""
LIST = "MISSION_REQUEST_LIST"


def rally(count: int) -> list[Stored]:
    places = [place_e7(-100.0 * k, 30.0) for k in range(count)]
    return [Stored(frame=3, command=5100, x=x, y=y, z_m=30.0) for x, y in places]


def placed(items: Iterable[PlanItem | Stored]) -> list[tuple[int, float, int, int]]:
    return [(item.command, item.parameters[0], item.x, item.y) for item in items]


def known(client: PlanClient, kind: int = FENCE) -> list[tuple[int, float, int, int]]:
    return placed(client.plans[kind].items)


@pytest.mark.sample(5)
@ALL_FOUR
@pytest.mark.parametrize(
    ("fault", "within_s"),
    [("", 2.0), ("link_loss 25 %", 60), ("link_delay 400 ms", 60), ("link_duplication 50 %", 60)],
)
def test_lists_come_whole_and_silence_changes_none(way: Any, fault: str, within_s: float) -> None:
    held, client = Held(*way), PlanClient(1)
    lists = {FENCE: [*polygon(40), circle(60.0)], MISSION: waypoints(9), RALLY: rally(3)}
    for kind, items in lists.items():
        held.upload(kind, items)
    if fault:
        held.simulation.add_fault(fault + " on link 0")
    assert held.run(90.0, client, lambda: client.is_done) < within_s
    for kind, items in lists.items():
        begin = int(kind == MISSION and way[0] == "ardupilot")  # item 0 is home there
        assert known(client, kind)[begin:] == placed(items)[begin:]
    held.simulation.add_fault("for 30 s: link_off on link 0")
    held.run(30.0, client)
    assert [client.plans[kind].version for kind in KINDS] == [1, 1, 1]


@pytest.mark.sample(5)
@ALL_FOUR
@pytest.mark.parametrize("waited_s", [0.0, 1.3, 2.9, 4.4])
def test_a_change_is_known_in_time(way: Any, waited_s: float) -> None:
    held, client = Held(*way), PlanClient(1)
    held.upload(FENCE, polygon(5))
    held.run(10.0 + waited_s, client)
    bigger, moved = [*polygon(5), circle(80.0)], [*polygon(5), circle(80.0, east_m=40.0)]
    for fence in (bigger, moved, []):  # more items; the same number, elsewhere; none
        if fence:
            held.upload(FENCE, fence, client)
        else:
            held.other(wire.MAVLink_mission_clear_all_message(1, 1, FENCE))
        wanted = placed(fence)
        took_s = held.run(20.0, client, lambda wanted=wanted: known(client) == wanted)
        assert took_s < KNOWN_WITHIN_S
    assert client.plans[FENCE].version == 4


@BOTH
def test_looks_leave_the_autopilot_idle_for_the_others(firmware: Firmware) -> None:
    """A ground station on the same link may upload right after each of our looks."""
    held, client = Held(firmware), PlanClient(1)
    held.upload(FENCE, polygon(12))
    held.upload(MISSION, waypoints(10))
    held.run(30.0, client)
    looks = len(held.sent)
    held.run(6.0, client, lambda: len(held.sent) > looks)
    held.run(0.3, client)
    begun = len(held.heard)
    held.other(wire.MAVLink_mission_count_message(1, 1, 1, FENCE), link=0)
    held.run(0.05, client)
    asked = [each for each in held.heard[begun:] if each.get_type().startswith("MISSION_REQUEST")]
    assert [(each.target_system, each.target_component) for each in asked] == [PERSON]


def test_a_new_id_of_a_list_has_it_read_as_recorded() -> None:
    """A PX4's fence is uploaded at 0.82 s, and its id is told from then on."""
    client = PlanClient(1)
    watch = client.plans[FENCE]
    watch.opaque_id, watch.read_s, watch.due_s = 1, 0.0, math.inf
    for at_s, message in itertools.islice(recorded("px4-offboard-8mps.tlog"), 2000):
        client.on_message(message, at_s)
    assert watch.due_s == -math.inf


def count(
    number: int, kind: int = FENCE, to: tuple[int, int] = OURS, source: tuple[int, int] = (1, 1)
) -> Any:
    return over_the_wire(wire.MAVLink_mission_count_message(*to, number, kind), source)


def item(seq: int, kind: int = FENCE, to: tuple[int, int] = OURS, radius: float = 50.0) -> Any:
    numbers = (radius, 0.0, 0.0, math.nan, 474000000, 85000000 + seq, 0.0, kind)
    return over_the_wire(wire.MAVLink_mission_item_int_message(*to, seq, 0, 5004, 0, 1, *numbers))


def asked(messages: list[Any]) -> list[tuple[str, int]]:
    return [(message.get_type(), message.mission_type) for message in messages]


def begun(*answers: Any) -> PlanClient:
    """A client that has asked for its first list, and had these answers."""
    client = PlanClient(1)
    assert asked(client.on_time(0.0)) == [(LIST, FENCE)]
    for message in answers:
        client.on_message(message, 0.1)
    return client


def radii(client: PlanClient) -> list[float]:
    return [each.parameters[0] for each in client.plans[FENCE].items]


def test_the_transfers_of_others_are_none_of_ours() -> None:
    client = begun()
    others = [count(3, to=PERSON), count(3, to=(1, 191)), count(3, MISSION)]
    for message in (*others, count(3, source=(2, 1))):
        assert client.on_message(message, 0.1) == []
    (wanted,) = client.on_message(count(1), 0.1)
    assert wanted.seq == 0
    assert client.on_message(item(0, to=PERSON, radius=9.0), 0.2) == []
    over, *_ = client.on_message(item(0), 0.3)
    assert client.on_message(item(0), 0.3) == []  # one that comes twice counts once
    assert (over.get_type(), over.type) == ("MISSION_ACK", wire.MAV_MISSION_ACCEPTED)
    assert radii(client) == [50.0]


@pytest.mark.parametrize(
    ("result", "is_done"),
    [(wire.MAV_MISSION_UNSUPPORTED, True), (wire.MAV_MISSION_DENIED, False)],
)
def test_what_is_not_supported_is_done_and_denied_asked_again(result: int, is_done: bool) -> None:
    """Denied: somebody else is uploading."""
    client = begun()
    refused = over_the_wire(wire.MAVLink_mission_ack_message(*OURS, result, FENCE))
    assert asked(client.on_message(refused, 0.1)) == [(LIST, RALLY)]
    assert client.plans[FENCE].supported is not is_done
    for kind in (RALLY, MISSION):
        client.on_message(count(0, kind), 0.2)
    assert client.is_done is is_done
    assert client.waiting == (() if is_done else ("fence (somebody else is transferring it)",))
    if is_done:
        client.refresh()  # after a reboot
    again = [each for tenth in range(30) for each in asked(client.on_time(0.1 * tenth))]
    assert again[0] == (LIST, FENCE)
    assert client.plans[FENCE].supported


def test_a_list_that_was_read_with_gaps_counts_when_it_is_read_twice_the_same() -> None:
    """In a gap somebody may have replaced it: half old, half new is never seen; but at first."""
    client, known = begun(), []
    for at_s, radius in ((0.1, 50.0), (2.0, 51.0), (4.0, 52.0), (6.0, 52.0)):
        client.on_message(count(1), at_s)
        client.on_time(at_s + 0.5)  # asked for again
        client.on_message(item(0, radius=radius), at_s + 0.5)
        known.append(radii(client))
        for kind in (RALLY, MISSION):
            client.on_message(count(0, kind), at_s + 0.6)
    assert known == [[50.0], [50.0], [50.0], [52.0]]
    assert math.isnan(client.plans[FENCE].items[0].parameters[3])  # which does not make it another
    assert client.plans[FENCE].version == 2


def test_a_fence_that_is_empty_right_after_a_reboot_counts_when_it_is_still_empty_later() -> None:
    """An autopilot may answer before it has loaded its lists."""
    client = begun(count(1), item(0), count(0, RALLY), count(0, MISSION))
    client.refresh()
    looks_s = []
    for now_s in np.arange(1.0, 20.0, 0.1):
        for _, kind in asked(client.on_time(now_s)):
            if kind == FENCE and radii(client):
                looks_s.append(now_s)
            client.on_message(count(0, kind), now_s)
    assert radii(client) == []
    assert looks_s == pytest.approx([1.0, 5.0], abs=0.2)
