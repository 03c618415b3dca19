"""What others read of the companion: fields by pymavlink's own parser."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as wire

from companion.mavlink.dialect import codec
from companion.mavlink.own_messages import OwnMessages, heartbeat, version_number

ACTIVE = wire.MAV_STATE_ACTIVE


def over_the_wire(message: Any) -> Any:
    [parsed] = wire.MAVLink(None).parse_buffer(message.pack(codec(7)))
    return parsed


def made() -> OwnMessages:
    return OwnMessages("1.2.3")


def counted(own_messages: OwnMessages, begin_s: float = 0.0, seconds: float = 10.0) -> Counter[str]:
    """What is sent in a time, asked at 20 Hz."""
    times = begin_s + np.arange(0.0, seconds, 0.05)
    sent = [own_messages.on_time(float(t), ACTIVE) for t in times]
    return Counter(message.get_type() for messages in sent for message in messages)


def test_the_heartbeat_is_that_of_an_onboard_controller() -> None:
    beat = over_the_wire(heartbeat(wire.MAV_STATE_CRITICAL))
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (7, 195)
    assert beat.type == 18  # MAV_TYPE_ONBOARD_CONTROLLER
    assert beat.autopilot == 8  # MAV_AUTOPILOT_INVALID
    assert (beat.base_mode, beat.custom_mode) == (0, 0)
    assert (beat.system_status, beat.mavlink_version) == (5, 3)


def test_it_beats_once_a_second_and_nothing_else_comes_unasked() -> None:
    assert counted(made()) == {"HEARTBEAT": 10}


def test_it_does_not_beat_while_faulted() -> None:
    own_messages = made()
    for tenth in range(100):
        assert own_messages.on_time(0.1 * tenth, None) == []
    assert len(own_messages.on_time(10.0, ACTIVE)) == 1


def test_it_goes_on_when_the_clock_begins_again() -> None:
    own_messages = made()
    counted(own_messages, begin_s=1000.0)
    assert counted(own_messages, begin_s=0.0) == {"HEARTBEAT": 10}


def test_the_version_is_told_when_it_is_asked_for() -> None:
    own_messages = made()
    assert own_messages.ask(148)
    _, version = own_messages.on_time(0.0, ACTIVE)
    read = over_the_wire(version)
    assert read.flight_sw_version == 1 << 24 | 2 << 16 | 3 << 8 | 255
    can = read.capabilities
    assert can & wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    assert can & wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    assert not can & wire.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    assert not can & wire.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    assert not can & wire.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    assert counted(own_messages, begin_s=1.0) == {"HEARTBEAT": 10}


@pytest.mark.parametrize(
    ("version", "number"),
    [
        ("0.1.0", 0x000100FF),
        ("1.2.3", 0x010203FF),
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


def test_what_is_not_ours_cannot_be_asked_for() -> None:
    own_messages = made()
    assert not own_messages.ask(330)
    assert counted(own_messages) == {"HEARTBEAT": 10}


def test_a_heartbeat_that_is_asked_for_comes_at_once_and_counts() -> None:
    own_messages = made()
    assert len(own_messages.on_time(0.0, ACTIVE)) == 1
    assert own_messages.ask(0)
    assert own_messages.due_s < 0.0
    assert len(own_messages.on_time(0.4, ACTIVE)) == 1
    assert own_messages.due_s == 1.4
    assert own_messages.on_time(1.3, ACTIVE) == []
