"""Which message goes out when: ardupilot.md 1 and px4.md 2, row by row, and schedules by count."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Ack, Command, FirmwareProfile, Sender, SendTelemetry, Text
from vehicle_sim.parameters import Firmware, Parameters
from vehicle_sim.wire.streams import Streams

STEP_US, BOOTED_US = 10_000, 1_000_000
HERE = Sender(system=1, component=191, link=0)
POSITION, ATTITUDE, LOCAL, HEARTBEAT, ORIGIN = 33, 30, 32, 0, 49
NOBODY_KNOWS = 230
ACCEPTED, DENIED, FAILED = 0, 2, 4
BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])


def fresh(firmware: Firmware, *, links: int = 2, rates_hz: Any = ()) -> Streams:
    is_px4 = firmware == "px4"
    known = frozenset({POSITION, ATTITUDE, LOCAL})
    profile = FirmwareProfile(
        firmware=firmware,
        vehicle_type=2,
        autopilot=12 if is_px4 else 3,
        capabilities=0,
        software_version=0,
        rates_hz={HEARTBEAT: 1.0, **dict(rates_hz)},
        streamable=known if is_px4 else known | {HEARTBEAT},
        requestable=known | {ORIGIN},
        data_streams={} if is_px4 else {6: (POSITION, LOCAL), 10: (ATTITUDE,)},
    )
    return Streams(profile, Parameters((), {}), range(links), 0)


def ask(streams: Streams, number: int, *p: float, now_us: int = BOOTED_US) -> Sequence[Any]:
    parameters: Any = (*p, *[0.0] * (7 - len(p)))
    command = Command(sender=HERE, target_component=1, number=number, parameters=parameters)
    return streams.on_command(command, now_us)


def counts(streams: Streams, seconds: float, begin_us: int = BOOTED_US) -> Counter[Any]:
    seen = Counter[Any]()
    for now_us in range(begin_us, begin_us + round(seconds * 1e6), STEP_US):
        if now_us >= streams.soonest_us:
            seen.update(streams.due(now_us))
    return seen


@BOTH
@pytest.mark.parametrize("rate_hz", [1, 29.5, 100])
def test_a_rate_is_met_exactly_and_only_on_the_link_that_asked(
    firmware: Firmware, rate_hz: float
) -> None:
    streams, interval_us = fresh(firmware), round(1e6 / rate_hz)
    assert ask(streams, 511, POSITION, interval_us) == [Ack(to=HERE, command=511, result=ACCEPTED)]
    if firmware == "ardupilot":  # whole milliseconds
        interval_us = interval_us // 1000 * 1000
    assert streams.interval_us(0, POSITION) == interval_us
    seen = counts(streams, 20.0)
    assert seen[0, POSITION] == pytest.approx(20e6 / interval_us, abs=1.5)
    assert seen[1, POSITION] == 0
    assert seen[0, HEARTBEAT] == seen[1, HEARTBEAT] == 20


def test_nothing_is_due_before_it_is_said_to_be_and_a_pause_is_not_made_up_for() -> None:
    streams = fresh("px4", links=1, rates_hz={ATTITUDE: 50.0})
    for now_us in range(0, 3_000_000, 1_000):
        before_us = streams.soonest_us
        assert bool(streams.due(now_us)) == (now_us >= before_us)
    streams.due(10_000_000)
    assert streams.due(10_000_001) == []
    assert streams.due(10_020_000) == [(0, ATTITUDE)]  # in its old beat


@BOTH
def test_minus_one_stops_and_zero_restores_the_default(firmware: Firmware) -> None:
    streams = fresh(firmware, rates_hz={POSITION: 5.0})
    ask(streams, 511, POSITION, -1)
    ask(streams, 511, ATTITUDE, 100_000)
    assert counts(streams, 2.0)[0, POSITION] == 0
    ask(streams, 511, POSITION, 0)
    ask(streams, 511, ATTITUDE, 0)
    assert counts(streams, 2.0, 9_000_000)[0, POSITION] == pytest.approx(10, abs=1)
    assert streams.interval_us(0, ATTITUDE) is None


@pytest.mark.parametrize("number", [NOBODY_KNOWS, 33.5, -1.0, 1e30, math.nan])
def test_what_is_not_streamed_is_denied_with_a_text_or_fails(number: float) -> None:
    for asked_us in (1e5, math.nan):
        text, ack = ask(fresh("ardupilot"), 511, number, asked_us)
        assert text == Text(severity=6, text=f"No ap_message for mavlink id ({number:.0f})")
        assert ack.result == DENIED
        assert [ack.result for ack in ask(fresh("px4"), 511, number, asked_us)] == [FAILED]
    for firmware in ("ardupilot", "px4"):
        streams = fresh(firmware)  # type: ignore[arg-type]
        assert ask(streams, 511, POSITION, math.inf)[-1].result in (DENIED, FAILED)
        assert streams.interval_us(0, POSITION) is None
        assert ask(streams, 512, number)[-1].result == (FAILED if firmware[0] == "a" else DENIED)


def test_a_message_is_sent_once_after_ardupilots_answer_and_before_px4s() -> None:
    send = SendTelemetry(message=ORIGIN, to=HERE)
    ack = Ack(to=HERE, command=512, result=ACCEPTED)
    assert ask(fresh("ardupilot"), 512, ORIGIN) == [ack, send]
    assert ask(fresh("px4"), 512, ORIGIN) == [send, ack]


def group(number: int, rate_hz: int, *, start: int = 1) -> Any:
    return mavlink.MAVLink_request_data_stream_message(1, 1, number, rate_hz, start)


def test_a_data_stream_sets_its_whole_group_and_overrides_single_intervals() -> None:
    streams = fresh("ardupilot")
    ask(streams, 511, POSITION, 20_000)
    streams.on_data_stream(group(6, 4), 0, BOOTED_US)
    seen = counts(streams, 10.0)
    told = [seen[0, number] for number in (POSITION, LOCAL, ATTITUDE)]
    assert told == pytest.approx([40, 40, 0], abs=1)
    streams.on_data_stream(group(0, 2), 0, BOOTED_US)
    assert counts(streams, 10.0, 20_000_000)[0, ATTITUDE] == pytest.approx(20, abs=1)
    for stopped in (group(0, 2, start=0), group(77, 4)):
        streams.on_data_stream(stopped, 0, BOOTED_US)
    assert set(counts(streams, 3.0, 40_000_000)) == {(0, HEARTBEAT), (1, HEARTBEAT)}


def test_the_same_request_again_and_again_does_not_hold_up_a_slow_message() -> None:
    streams, seen = fresh("ardupilot", links=1), Counter[Any]()
    for now_us in range(BOOTED_US, BOOTED_US + 20_000_000, STEP_US):
        if now_us % 500_000 == 0:  # faster than the message itself
            streams.on_data_stream(group(6, 1), 0, now_us)
            ask(streams, 511, LOCAL, 1_000_000, now_us=now_us)
        seen.update(streams.due(now_us))
    assert seen[0, POSITION] == seen[0, LOCAL] == pytest.approx(20, abs=1)
