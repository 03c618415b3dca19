"""Mission, fence and rally points over the wire, against the simulator of all four autopilots."""

import itertools
import math
from collections.abc import Iterable
from typing import Any

import pytest
from held import (
    FOUR,
    OURS,
    Firmware,
    Held,
    Kind,
    circle,
    place_e7,
    polygon,
    recorded,
    waypoints,
)
from wires import over_the_wire

from companion.mavlink.dialect import codec, wire
from companion.mavlink.plan_client import FENCE, KINDS, MISSION, RALLY, Plan, PlanClient, PlanItem
from vehicle_sim.plans import PlanItem as Stored

ALL_FOUR = pytest.mark.parametrize(("firmware", "kind"), FOUR)
BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
PERSON = (255, 190)
KNOWN_WITHIN_S, LONG_KNOWN_WITHIN_S = 10.0, 31.0
"""Issue 5, build 3: a fence that is drawn in flight; and one of 60 corners, changed in place."""


def rally(count: int) -> list[Stored]:
    places = [place_e7(-100.0 * k, 30.0) for k in range(count)]
    return [Stored(frame=3, command=5100, x=x, y=y, z_m=30.0) for x, y in places]


def placed(items: Iterable[PlanItem | Stored]) -> list[tuple[int, float, int, int]]:
    return [(item.command, item.parameters[0], item.x, item.y) for item in items]


def known(client: PlanClient, kind: int = FENCE) -> list[tuple[int, float, int, int]]:
    return placed(client.plans[kind].items)


def count(
    number: int, kind: int = FENCE, to: tuple[int, int] = OURS, source: tuple[int, int] = (1, 1)
) -> Any:
    return over_the_wire(wire.MAVLink_mission_count_message(*to, number, kind), source)


def item(seq: int, kind: int = FENCE, to: tuple[int, int] = OURS, radius: float = 50.0) -> Any:
    numbers = (radius, 0.0, 0.0, math.nan, 474000000, 85000000 + seq, 0.0, kind)
    return over_the_wire(wire.MAVLink_mission_item_int_message(*to, seq, 0, 5004, 0, 1, *numbers))


def ack(result: int) -> Any:
    return over_the_wire(wire.MAVLink_mission_ack_message(*OURS, result, FENCE))


# --- against the simulator


@pytest.mark.sample(5)
@ALL_FOUR
@pytest.mark.parametrize(
    "fault", ["", "link_loss 25 %", "link_delay 400 ms", "link_duplication 50 %"]
)
def test_downloads_all_three_lists(firmware: Firmware, kind: Kind, fault: str) -> None:
    held = Held(firmware, kind)
    fence = [*polygon(40), circle(60.0)]
    held.upload(FENCE, fence)
    held.upload(MISSION, waypoints(9))
    held.upload(RALLY, rally(3))
    if fault:
        held.simulation.add_fault(fault + " on link 0")
    client = PlanClient(1, OURS)
    took_s = held.run(90.0, client, lambda: client.is_done)
    assert client.is_done
    assert took_s < (2.0 if not fault else 60.0)
    assert known(client) == placed(fence)
    assert known(client, RALLY) == placed(rally(3))
    begin = int(firmware == "ardupilot")  # item 0 is home there
    assert known(client, MISSION)[begin:] == placed(waypoints(9))[begin:]
    assert [client.plans[each].version for each in KINDS] == [1, 1, 1]


@pytest.mark.sample(5)
@ALL_FOUR
@pytest.mark.parametrize("waited_s", [0.0, 1.3, 2.9, 4.4])
def test_a_change_is_known_in_time(firmware: Firmware, kind: Kind, waited_s: float) -> None:
    held = Held(firmware, kind)
    held.upload(FENCE, polygon(5))
    client = PlanClient(1, OURS)
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
def test_a_long_fence_that_is_changed_in_place_is_known_in_time(firmware: Firmware) -> None:
    held, moved = Held(firmware), polygon(60, size_m=140.0)
    held.upload(FENCE, polygon(60))
    client = PlanClient(1, OURS)
    held.run(7.0, client)
    held.upload(FENCE, moved, client)
    took_s = held.run(60.0, client, lambda: known(client) == placed(moved))
    assert took_s < LONG_KNOWN_WITHIN_S


@pytest.mark.sample(2)  # of both firmwares
@ALL_FOUR
def test_a_list_that_is_being_uploaded_is_never_seen_half(firmware: Firmware, kind: Kind) -> None:
    """Uploads in a row, of which ArduPilot denies all others any part while they last."""
    held = Held(firmware, kind)
    versions = [polygon(12, size_m=100.0 + 10.0 * k) for k in range(4)]
    held.upload(FENCE, versions[0])
    client = PlanClient(1, OURS)
    held.simulation.add_fault("link_loss 10 % on link 0")
    held.run(20.0, client, lambda: client.is_done)
    seen = set[int]()
    for number, fence in enumerate(versions[1:], start=1):
        held.upload(FENCE, fence, client, pause_s=0.2)
        for _ in range(40):
            held.run(0.2, client)
            now = known(client)
            assert now in [placed(each) for each in versions[: number + 1]]
            seen.add([placed(each) for each in versions].index(now))
        assert known(client) == placed(fence)
    assert len(seen) >= 3


@BOTH
def test_looks_are_cheap_and_leave_the_autopilot_idle_for_the_others(firmware: Firmware) -> None:
    """A ground station on the same link may upload right after each of our looks."""
    held = Held(firmware)
    held.upload(FENCE, polygon(12))
    held.upload(MISSION, waypoints(10))
    client = PlanClient(1, OURS)
    held.run(3.0, client)
    begun = len(held.sent)
    held.run(30.0, client)
    sent = sum(len(message.pack(codec(OURS[0]))) for _, message in held.sent[begun:])
    assert sent / 30.0 < (150.0 if firmware == "ardupilot" else 50.0)  # bytes a second
    looks = len(held.sent)
    held.run(6.0, client, lambda: len(held.sent) > looks)
    held.run(0.3, client)
    begun = len(held.heard)
    held.other(wire.MAVLink_mission_count_message(1, 1, 1, FENCE), link=0)
    held.run(0.05, client)
    asked = [each for each in held.heard[begun:] if each.get_type().startswith("MISSION_REQUEST")]
    assert [(each.target_system, each.target_component) for each in asked] == [PERSON]


@BOTH
def test_a_link_that_is_silent_changes_nothing(firmware: Firmware) -> None:
    held = Held(firmware)
    held.upload(FENCE, polygon(7))
    client = PlanClient(1, OURS)
    held.run(3.0, client)
    before = dict(client.plans)
    held.simulation.add_fault("for 30 s: link_off on link 0")
    held.run(30.0, client)
    assert client.trouble
    held.run(15.0, client, lambda: not client.trouble)
    assert client.plans == before
    assert not client.trouble


def test_px4_tells_the_ids_of_its_lists() -> None:
    """As recorded: a fence is uploaded at 0.82 s, and its id is told from then on."""
    client = PlanClient(1, OURS)
    watch = client._watches[FENCE]
    watch.opaque_id, watch.read_s, watch.due_s = 1, 0.0, math.inf
    for at_s, message in itertools.islice(recorded("px4-offboard-8mps.tlog"), 2000):
        client.on_message(message, at_s)
    assert watch.due_s == -math.inf


# --- who is answered


def begun() -> PlanClient:
    client = PlanClient(1, OURS)
    (asked,) = client.on_time(0.0)
    assert (asked.get_type(), asked.mission_type) == ("MISSION_REQUEST_LIST", FENCE)
    return client


def test_the_transfers_of_others_are_none_of_ours() -> None:
    client = begun()
    others = (
        count(3, to=PERSON),
        count(3, to=(1, 191)),
        count(3, MISSION),
        count(3, source=(2, 1)),
    )
    assert [client.on_message(message, 0.1) for message in others] == [[]] * 4
    (asked,) = client.on_message(count(1), 0.1)
    assert asked.seq == 0
    assert client.on_message(item(0, to=PERSON, radius=9.0), 0.2) == []
    over, *_ = client.on_message(item(0), 0.3)
    assert client.on_message(item(0), 0.3) == []  # one that comes twice counts once
    assert (over.get_type(), over.type) == ("MISSION_ACK", wire.MAV_MISSION_ACCEPTED)
    assert client.plans[FENCE].items[0].parameters[0] == 50.0


def test_an_item_that_does_not_come_is_asked_for_again_then_given_up() -> None:
    client = begun()
    client.on_message(count(2), 0.1)
    client.on_message(item(0), 0.2)
    asked: list[float] = []
    at_s = 0.2
    while not client.trouble and at_s < 20.0:
        at_s += 0.05
        asked += [at_s for each in client.on_time(at_s) if each.get_type() == "MISSION_REQUEST_INT"]
    assert client.trouble == {FENCE: "no answer"}
    assert client.plans[FENCE] == Plan()
    assert len(asked) >= 5
    assert all(0.24 < b - a < 0.31 for a, b in itertools.pairwise(asked))


def test_a_kind_that_is_not_supported_is_done_and_empty() -> None:
    client = begun()
    (asked,) = client.on_message(ack(wire.MAV_MISSION_UNSUPPORTED), 0.1)
    assert asked.mission_type != FENCE
    assert client.plans[FENCE] == Plan(version=1, supported=False)
    for kind in (RALLY, MISSION):
        client.on_message(count(0, kind), 0.2)
    assert client.is_done
    assert not client.waiting
    client.refresh()  # after a reboot
    (asked,) = client.on_time(0.3)
    assert asked.mission_type in (RALLY, MISSION, FENCE)
    assert client.plans[FENCE].supported


def test_somebody_elses_upload_is_waited_for() -> None:
    client = begun()
    (other,) = client.on_message(ack(wire.MAV_MISSION_DENIED), 0.1)
    assert other.mission_type == RALLY
    assert "fence (somebody else is transferring it)" in client.waiting
    client.on_message(count(0, RALLY), 0.2)
    client.on_message(count(0, MISSION), 0.3)
    assert not client.is_done
    again = [each for at in range(30) for each in client.on_time(0.1 * at)]
    assert (again[0].get_type(), again[0].mission_type) == ("MISSION_REQUEST_LIST", FENCE)


def test_the_same_items_are_no_change_also_where_a_parameter_is_no_number() -> None:
    client = begun()
    for round_s in (0.0, 40.0, 80.0):
        client.on_time(round_s)
        for kind in KINDS:
            for message in (count(1, kind), item(0, kind)):
                client.on_message(message, round_s + 0.1)
    assert client.plans[FENCE].version == 1


def test_a_list_that_was_read_with_gaps_counts_when_it_is_read_twice_the_same() -> None:
    """In a gap somebody may have replaced it: half old, half new."""
    client = begun()

    def read(at_s: float, *radii: float, gap_s: float = 0.0) -> None:
        client.on_message(count(len(radii)), at_s)
        for seq, radius in enumerate(radii):
            at_s += 0.01 + gap_s
            client.on_time(at_s)
            client.on_message(item(seq, radius=radius), at_s)

    def radii() -> list[float]:
        return [each.parameters[0] for each in client.plans[FENCE].items]

    read(0.1, 50.0, 60.0, gap_s=0.5)
    assert radii() == [50.0, 60.0]  # the first is better than none, and is read again at once
    for kind in (RALLY, MISSION):
        client.on_message(count(0, kind), 1.5)
    read(2.0, 51.0, 60.0, gap_s=0.5)
    assert radii() == [50.0, 60.0]
    read(4.0, 51.0, 61.0, gap_s=0.5)
    assert radii() == [50.0, 60.0]
    read(6.0, 51.0, 61.0, gap_s=0.5)
    assert radii() == [51.0, 61.0]
    assert client.on_time(8.0) == []
    assert client.on_time(13.0)[0].mission_type != FENCE
    for kind in (RALLY, MISSION):
        client.on_message(count(0, kind), 13.1)
    read(13.2, 70.0, 80.0)
    assert radii() == [70.0, 80.0]


def test_a_fence_that_is_empty_right_after_a_reboot_counts_when_it_is_still_empty_later() -> None:
    """An autopilot may answer before it has loaded its lists."""
    client = begun()
    client.on_message(count(1), 0.0)
    client.on_message(item(0), 0.0)
    for number in (0, 0):  # rally points, mission
        client.on_message(count(number, client._transfer.kind), 0.1)
    client.refresh()
    asked = client.on_time(1.0)
    assert asked[0].mission_type == FENCE
    client.on_message(count(0), 1.0)
    assert len(client.plans[FENCE].items) == 1
    now_s, looks = 1.0, 0
    while client.plans[FENCE].items and now_s < 20.0:
        now_s += 0.1
        for each in client.on_time(now_s):
            kind = each.mission_type
            looks += kind == FENCE
            client.on_message(count(0, kind), now_s)
    assert not client.plans[FENCE].items
    assert looks == 1
    assert now_s >= 1.0 + 3.9
