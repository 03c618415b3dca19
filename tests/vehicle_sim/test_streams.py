"""Which message goes out when: ardupilot.md 1 and px4.md 2, row by row, and schedules by count."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import (
    Ack,
    Command,
    FirmwareProfile,
    Result,
    Sender,
    SendTelemetry,
    Text,
)
from vehicle_sim.parameters import Firmware, Parameters
from vehicle_sim.wire.streams import Streams

STEP_US = 10_000
BOOTED_US = 1_000_000
HERE = Sender(system=1, component=191, link=0)
POSITION, ATTITUDE, LOCAL, HEARTBEAT = 33, 30, 32, 0
NOBODY_KNOWS = 230
BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])


def fresh(firmware: Firmware, *, links: int = 2, **rates_hz: float) -> Streams:
    is_px4 = firmware == "px4"
    known = frozenset({POSITION, ATTITUDE, LOCAL, 74, 148})
    profile = FirmwareProfile(
        firmware=firmware,
        vehicle_type=2,
        autopilot=12 if is_px4 else 3,
        capabilities=0,
        software_version=0,
        rates_hz={HEARTBEAT: 1.0, **{int(name[1:]): rate for name, rate in rates_hz.items()}},
        streamable=known if is_px4 else known | {HEARTBEAT},
        requestable=known | {49},
        data_streams={} if is_px4 else {6: (POSITION, LOCAL), 10: (ATTITUDE,)},
    )
    streams = Streams(profile, Parameters((), {}))
    for link in range(links):
        streams.open(link, 0)
    return streams


def ask(
    streams: Streams, number: int, *parameters: float, now_us: int = BOOTED_US
) -> Sequence[Any]:
    p1, p2, p3, p4, p5, p6, p7 = (*parameters, *[0.0] * (7 - len(parameters)))
    command = Command(
        sender=HERE, target_component=1, number=number, parameters=(p1, p2, p3, p4, p5, p6, p7)
    )
    return streams.on_command(command, now_us)


def result(answers: Sequence[Any]) -> int:
    (ack,) = (answer for answer in answers if isinstance(answer, Ack))
    return ack.result


def counts(streams: Streams, seconds: float, begin_us: int = BOOTED_US) -> Counter[Any]:
    seen = Counter[Any]()
    for now_us in range(begin_us, begin_us + round(seconds * 1e6), STEP_US):
        if now_us >= streams.soonest_us:
            seen.update(streams.due(now_us))
    return seen


@BOTH
@pytest.mark.parametrize("rate_hz", [1, 3, 29.5, 30, 100])
def test_a_rate_is_met_exactly_and_only_on_the_link_that_asked(
    firmware: Firmware, rate_hz: float
) -> None:
    streams = fresh(firmware)
    interval_us = round(1e6 / rate_hz)
    assert result(ask(streams, 511, POSITION, interval_us)) == Result.ACCEPTED
    if firmware == "ardupilot":
        interval_us = interval_us // 1000 * 1000
    seen = counts(streams, 20.0)
    assert seen[0, POSITION] == pytest.approx(20e6 / interval_us, abs=1.5)
    assert seen[1, POSITION] == 0
    assert seen[0, HEARTBEAT] == seen[1, HEARTBEAT] == 20


def test_nothing_is_due_before_it_is_said_to_be_and_a_pause_is_not_made_up_for() -> None:
    streams = fresh("px4", links=1, _30=50.0)
    for now_us in range(0, 3_000_000, 1_000):
        before = streams.soonest_us
        assert bool(streams.due(now_us)) == (now_us >= before)
    streams.due(10_000_000)
    assert streams.due(10_000_001) == []
    assert streams.due(10_020_000) == [(0, ATTITUDE)]  # in its old beat


@BOTH
def test_minus_one_stops_and_zero_restores_the_default(firmware: Firmware) -> None:
    streams = fresh(firmware, _33=5.0)
    ask(streams, 511, POSITION, -1)
    ask(streams, 511, ATTITUDE, 100_000)
    assert counts(streams, 2.0)[0, POSITION] == 0
    ask(streams, 511, POSITION, 0)
    ask(streams, 511, ATTITUDE, 0)
    assert counts(streams, 2.0, 9_000_000)[0, POSITION] == pytest.approx(10, abs=1)
    assert streams.interval_us(0, ATTITUDE) is None


def test_what_is_not_streamed_is_denied_with_a_text_or_fails() -> None:
    text, ack = ask(fresh("ardupilot"), 511, NOBODY_KNOWS, 1e5)
    assert text == Text(severity=6, text="No ap_message for mavlink id (230)")
    assert ack.result == Result.DENIED
    for number in (HEARTBEAT, 42, 12345, math.nan, -1.0, 1e30):
        assert [ack.result for ack in ask(fresh("px4"), 511, number, 1e5)] == [Result.FAILED]


def test_ardupilots_intervals_are_whole_milliseconds_up_to_a_minute() -> None:
    streams = fresh("ardupilot")
    for asked, kept in ((10_900, 10_000), (5, 1_000), (-7, 1_000), (2e9, 60_000_000)):
        ask(streams, 511, POSITION, asked)
        assert streams.interval_us(0, POSITION) == kept


def test_a_message_is_sent_once_after_ardupilots_answer_and_before_px4s() -> None:
    send = SendTelemetry(message=148, to=HERE)
    ack = Ack(to=HERE, command=512, result=Result.ACCEPTED)
    assert ask(fresh("ardupilot"), 512, 148) == [ack, send]
    assert ask(fresh("px4"), 512, 148) == [send, ack]
    assert result(ask(fresh("ardupilot"), 512, NOBODY_KNOWS)) == Result.FAILED
    assert result(ask(fresh("px4"), 512, NOBODY_KNOWS)) == Result.DENIED


def stream_request(group: int, rate_hz: int, *, start: int = 1) -> Any:
    return mavlink.MAVLink_request_data_stream_message(1, 1, group, rate_hz, start)


def test_a_data_stream_sets_its_whole_group_and_overrides_single_intervals() -> None:
    streams = fresh("ardupilot")
    ask(streams, 511, POSITION, 20_000)
    streams.on_data_stream(stream_request(6, 4), 0, BOOTED_US)
    seen = counts(streams, 10.0)
    assert [seen[0, number] for number in (POSITION, LOCAL, ATTITUDE)] == pytest.approx(
        [40, 40, 0], abs=1
    )
    streams.on_data_stream(stream_request(0, 2), 0, BOOTED_US)
    assert counts(streams, 10.0, 20_000_000)[0, ATTITUDE] == pytest.approx(20, abs=1)
    streams.on_data_stream(stream_request(0, 2, start=0), 0, BOOTED_US)
    for unknown in (stream_request(77, 4), stream_request(6, 4, start=9)):
        streams.on_data_stream(unknown, 0, BOOTED_US)
    assert set(counts(streams, 3.0, 40_000_000)) == {(0, HEARTBEAT), (1, HEARTBEAT)}


def test_the_same_request_again_and_again_does_not_hold_up_a_slow_message() -> None:
    streams = fresh("ardupilot", links=1)
    seen = Counter[Any]()
    for now_us in range(BOOTED_US, BOOTED_US + 20_000_000, STEP_US):
        if now_us % 500_000 == 0:  # faster than the message itself
            streams.on_data_stream(stream_request(6, 1), 0, now_us)
            ask(streams, 511, LOCAL, 1_000_000)
        seen.update(streams.due(now_us))
    assert seen[0, POSITION] == seen[0, LOCAL] == pytest.approx(20, abs=1)


@pytest.mark.parametrize(
    ("firmware", "now_us", "kept"),
    [("ardupilot", 40_000, False), ("ardupilot", 80_000, True), ("px4", 10_000, True)],
)
def test_ardupilot_loses_what_is_asked_in_its_first_moment_but_says_yes(
    firmware: Firmware, now_us: int, *, kept: bool
) -> None:
    streams, booted_us = fresh(firmware, links=0), 77_000_000
    streams.open(0, booted_us)
    answers = ask(streams, 511, POSITION, 1e5, now_us=booted_us + now_us)
    assert result(answers) == Result.ACCEPTED
    assert (streams.interval_us(0, POSITION) is not None) is kept
