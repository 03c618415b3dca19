"""Parameters, mission, fence and rally points, message by message (all: test_autopilot_client)."""

import itertools
import math
import struct
from typing import Any

import numpy as np
import pytest
from held import Held, polygon, recorded, waypoints
from hypothesis import given
from hypothesis import strategies as st
from wires import heard

from companion.mavlink.dialect import wire
from companion.mavlink.parameter_client import ParameterClient, decoded, encoded
from companion.mavlink.plan_client import FENCE, MISSION, RALLY, PlanClient
from vehicle_sim.plans import PlanKind

OURS, PERSON = (1, 195), (255, 190)
READ, LIST = "PARAM_REQUEST_READ", "MISSION_REQUEST_LIST"


# --- parameters


def told(name: str, value: float, kind: int = 9, source: tuple[int, int] = (1, 1)) -> Any:
    fields = {"param_id": name.encode(), "param_value": value, "param_type": kind}
    return heard("PARAM_VALUE", source, **fields)


def asked(messages: list[Any]) -> list[tuple[str, Any]]:
    """What is requested: a parameter, or a kind of list."""
    fields = {READ: "param_id", LIST: "mission_type"}
    return [(m.get_type(), getattr(m, fields.get(m.get_type(), "seq"), None)) for m in messages]


WHOLE = {1: (0, 255), 2: (-128, 127), 3: (0, 65535), 4: (-(2**15), 2**15 - 1)}
WHOLE |= {5: (0, 2**32 - 1), 6: (-(2**31), 2**31 - 1)}


@given(data=st.data(), kind=st.sampled_from([*WHOLE, 9]), bytewise=st.booleans())
def test_numbers_survive_the_wire(data: st.DataObject, kind: int, bytewise: bool) -> None:
    low, high = WHOLE.get(kind, (0, 0))
    most = high if bytewise else 2**24  # a float holds no more exactly
    floats = st.floats(width=32, allow_nan=False, allow_infinity=False)
    value = float(data.draw(floats if kind == 9 else st.integers(max(low, -most), min(high, most))))
    sent = encoded(value, kind, bytewise=bytewise)
    message = told("NAME", 0.0 if math.isnan(sent) else sent, kind)
    if math.isnan(sent):  # a float on the way would change its bits, the bytes do not
        frame = bytearray(message.get_msgbuf())
        frame[10:14] = struct.pack("<i", int(value))
        message._msgbuf = frame
    assert decoded(message, bytewise=bytewise) == value


def test_a_parameter_is_what_the_autopilot_says_by_any_of_its_names_or_there_is_none() -> None:
    client = ParameterClient(1, [("MAV_SYSID", "SYSID_THISMAV"), ("A",), ("B",)])
    assert len(asked(client.on_time(0.0))) == 4
    for source in ((2, 1), (1, 100), PERSON, (1, 1)):
        assert client.values == {}
        assert client.on_message(told("SYSID_THISMAV", 1.0, 4, source), 0.1) == []
    assert (client.values, client.waiting) == ({"SYSID_THISMAV": 1.0}, ("A", "B"))
    missing, read_only = wire.MAV_PARAM_ERROR_DOES_NOT_EXIST, wire.MAV_PARAM_ERROR_READ_ONLY
    for name, why in ((b"A", missing), (b"B", read_only)):
        client.on_message(heard("PARAM_ERROR", param_id=name, error=why), 0.1)
        assert client.waiting == ("B",)
    client.set("SYSID_THISMAV", 5e12)
    assert client.failed_sets == {"SYSID_THISMAV": "5e+12 does not fit into its type"}


# --- lists


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_looks_leave_the_autopilot_idle_for_the_others(firmware: Any) -> None:
    """A ground station on the same link may upload right after each of our looks."""
    held = Held(firmware)
    held.client = PlanClient(1)
    held.plan(PlanKind.FENCE, *polygon(12))
    held.plan(PlanKind.MISSION, *waypoints(10))
    held.run(30.0)
    looks = len(held.sent)
    held.until(lambda: len(held.sent) > looks, 6.0)
    held.run(0.3)
    begun = len(held.heard)
    held.send(wire.MAVLink_mission_count_message(1, 1, 1, FENCE), source=PERSON)
    held.run(0.05)
    requests = [each.message for each in held.heard[begun:] if "MISSION_REQUEST" in each.kind]
    assert [(each.target_system, each.target_component) for each in requests] == [PERSON]


def test_a_new_id_of_a_list_has_it_read_as_recorded() -> None:
    """A PX4's fence is uploaded at 0.82 s, and its id is told from then on."""
    client = PlanClient(1)
    watch = client.plans[FENCE]
    watch.opaque_id, watch.read_s, watch.due_s = 1, 0.0, math.inf
    for at_s, message in itertools.islice(recorded("px4-offboard-8mps.tlog"), 2000):
        client.on_message(message, at_s)
    assert watch.due_s == -math.inf


def to(ids: tuple[int, int], kind: int) -> dict[str, int]:
    return {"target_system": ids[0], "target_component": ids[1], "mission_type": kind}


def count(
    number: int, kind: int = FENCE, ids: tuple[int, int] = OURS, source: tuple[int, int] = (1, 1)
) -> Any:
    return heard("MISSION_COUNT", source, count=number, **to(ids, kind))


def item(ids: tuple[int, int] = OURS, radius: float = 50.0) -> Any:
    """The first of a fence."""
    numbers = {"param1": radius, "param4": math.nan, "x": 474000000, "y": 85000000}
    return heard("MISSION_ITEM_INT", command=5004, **numbers, **to(ids, FENCE))


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
    others = [count(3, ids=PERSON), count(3, ids=(1, 191)), count(3, MISSION)]
    for message in (*others, count(3, source=(2, 1))):
        assert client.on_message(message, 0.1) == []
    assert asked(client.on_message(count(1), 0.1)) == [("MISSION_REQUEST_INT", 0)]
    assert client.on_message(item(PERSON, 9.0), 0.2) == []
    over, *_ = client.on_message(item(), 0.3)
    assert client.on_message(item(), 0.3) == []  # one that comes twice counts once
    assert (over.get_type(), over.type) == ("MISSION_ACK", wire.MAV_MISSION_ACCEPTED)
    assert radii(client) == [50.0]


@pytest.mark.parametrize(
    ("answer", "waiting"),
    [("UNSUPPORTED", ()), ("DENIED", ("fence (somebody else is transferring it)",))],
)
def test_what_is_not_supported_is_done_and_denied_asked_again(answer: str, waiting: Any) -> None:
    result = getattr(wire, f"MAV_MISSION_{answer}")
    refused = heard("MISSION_ACK", type=result, **to(OURS, FENCE))
    client = begun(refused, count(0, RALLY), count(0, MISSION))
    assert (client.waiting, client.is_done) == (waiting, not waiting)
    assert client.plans[FENCE].supported is bool(waiting)
    if not waiting:
        client.refresh()  # after a reboot
    again = [each for tenth in range(30) for each in asked(client.on_time(0.1 * tenth))]
    assert again[0] == (LIST, FENCE)


def test_a_list_that_was_read_with_gaps_counts_when_it_is_read_twice_the_same() -> None:
    """In a gap somebody may have replaced it: half old, half new is never seen; but at first."""
    client, known = begun(), []
    for at_s, radius in ((0.1, 50.0), (2.0, 51.0), (4.0, 52.0), (6.0, 52.0)):
        client.on_message(count(1), at_s)
        client.on_time(at_s + 0.5)  # asked for again
        client.on_message(item(radius=radius), at_s + 0.5)
        known.append(radii(client))
        for kind in (RALLY, MISSION):
            client.on_message(count(0, kind), at_s + 0.6)
    assert known == [[50.0], [50.0], [50.0], [52.0]]
    assert math.isnan(client.plans[FENCE].items[0].parameters[3])  # which does not make it another
    assert client.plans[FENCE].version == 2


def test_a_fence_that_is_empty_right_after_a_reboot_counts_when_it_is_still_empty_later() -> None:
    """An autopilot may answer before it has loaded its lists."""
    client = begun(count(1), item(), count(0, RALLY), count(0, MISSION))
    client.refresh()
    looks_s = []
    for now_s in np.arange(1.0, 20.0, 0.1):
        for _, kind in asked(client.on_time(now_s)):
            if kind == FENCE and radii(client):
                looks_s.append(now_s)
            client.on_message(count(0, kind), now_s)
    assert radii(client) == []
    assert looks_s == pytest.approx([1.0, 5.0], abs=0.2)
