"""Who gets what and when it is due: the tables of ardupilot.md 1, 3 and 5 and px4.md 2."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from harness import COMPANION, GCS, Ids
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.autopilot.values import Ack, Command, Sender, SendTelemetry
from vehicle_sim.parameters import Firmware
from vehicle_sim.wire.frames import StreamParser
from vehicle_sim.wire.routing import Router
from vehicle_sim.wire.streams import Streams

STEP_US, S = 10_000, 1_000_000
BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])

# --- who gets what --------------------------------------------------------------------------------

RADAR, OTHER = 100, (9, 1)


def message(kind: str, *target: int, **fields: Any) -> Any:
    """To this target; what is not given is 0."""
    made = getattr(mavlink, f"MAVLink_{kind}_message")
    addressed = dict(zip(("target_system", "target_component"), target, strict=False))
    return made(**dict.fromkeys(made.fieldnames, 0) | addressed | fields)


setpoint = partial(message, "set_position_target_local_ned")
command = partial(message, "command_long", command=400)
key = partial(message, "setup_signing", secret_key=[7] * 32)
text = partial(message, "statustext", text=b"hello")
BEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
ACK, RADIO, SYNC = message("command_ack", *GCS), message("radio_status"), message("timesync")


class Vehicle:
    """A router that has heard a ground station on link 0, two on link 1, another system on 2."""

    def __init__(self) -> None:
        self.router = Router(RADAR)
        for source, link in ((GCS, 0), (COMPANION, 1), ((1, 192), 1), (OTHER, 2)):
            self.get(source, BEAT, link)

    def get(self, source: Ids, message: Any, link: int = 0) -> str:
        """Where it goes: the numbers of links, A for the autopilot, R for the radar."""
        frame = message.pack(mavlink.MAVLink(None, *source))
        ((_, got),) = StreamParser(datagrams=True).feed(bytes(frame))
        links, to_autopilot, to_radar = self.router.route(got, Sender(*source, link))
        return "".join(map(str, sorted(links))) + "A" * to_autopilot + "R" * to_radar


@pytest.mark.parametrize(
    ("source", "link", "message", "route"),
    [
        *((who, 0, setpoint(1, 1), "A") for who in (GCS, (42, 7), (0, 0))),
        ((1, 1), 0, setpoint(1, 1), ""),  # an echo
        *((GCS, 0, setpoint(1, 0), "1AR"), (GCS, 0, setpoint(0, 0), "12AR")),
        *((GCS, 0, setpoint(0, 1), "12A"), (GCS, 0, setpoint(1, 191), "1")),
        *((GCS, 0, setpoint(1, RADAR), "R"), (GCS, 0, setpoint(2, 0), "")),
        *((GCS, 0, setpoint(1, 50), ""), (COMPANION, 1, ACK, "0")),
        (GCS, 0, command(9, 33), "2"),  # of others any component will do
        (OTHER, 2, text(), "01AR"),
        (COMPANION, 1, text(id=5), "02AR"),  # two on a link do not see each other
        *((GCS, 0, BEAT, "12AR"), (GCS, 0, SYNC, "12AR")),
        (GCS, 2, BEAT, "1AR"),  # of who is on two links it would go round
        # never passed on
        *((GCS, 0, key(1, 1), "A"), (GCS, 0, key(0, 0), "AR"), (GCS, 0, key(2, 1), "")),
        (GCS, 0, RADIO, "AR"),
    ],
)
def test_where_a_message_goes(source: Ids, link: int, message: Any, route: str) -> None:
    assert Vehicle().get(source, message, link) == route


def test_nothing_goes_to_a_component_before_it_has_spoken_and_routes_are_bounded() -> None:
    vehicle = Vehicle()
    vehicle.router = Router(RADAR)
    for spoken in (False, True):
        assert vehicle.get(GCS, command(1, 191)) == ("1" if spoken else "")
        vehicle.get(COMPANION, BEAT, 1)
    for system in range(2, 250):
        vehicle.get((system, 1), BEAT, 2)
    assert vehicle.get(GCS, command(19, 1)) == "2"
    assert vehicle.get(GCS, command(200, 1)) == ""  # came too late


# --- when it is due -------------------------------------------------------------------------------

HERE = Sender(system=1, component=191, link=0)
POSITION, ATTITUDE, LOCAL, HEARTBEAT, ORIGIN = 33, 30, 32, 0, 49
ACCEPTED, DENIED, FAILED = 0, 2, 4


def fresh(firmware: Firmware, rates_hz: Any = ()) -> Streams:
    is_px4, known = firmware == "px4", frozenset({POSITION, ATTITUDE, LOCAL})
    profile = replace(
        PERSONALITIES[firmware, "copter"].firmware,
        rates_hz={HEARTBEAT: 1.0, **dict(rates_hz)},
        first_heartbeat_us=S,
        streamable=known if is_px4 else known | {HEARTBEAT},
        requestable=known | {ORIGIN},
        data_streams={} if is_px4 else {6: (POSITION, LOCAL), 10: (ATTITUDE,)},
    )
    return Streams(profile, range(2), 0)


def ask(streams: Streams, number: int, *p: float, now_us: int = S) -> Sequence[Any]:
    padded: Any = (*p, *[0.0] * (7 - len(p)))
    return streams.on_command(Command(HERE, 1, number, padded), now_us)


def counts(streams: Streams, seconds: float, begin_us: int = S) -> Counter[Any]:
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
    streams.due(100 * S)  # a pause is not made up for
    assert streams.due(100 * S + 1) == []


@BOTH
def test_minus_one_stops_and_zero_restores_the_default(firmware: Firmware) -> None:
    streams = fresh(firmware, {POSITION: 5.0})
    for number, told_us in ((POSITION, -1), (ATTITUDE, 100_000)):
        ask(streams, 511, number, told_us)
    assert counts(streams, 2.0)[0, POSITION] == 0
    for number in (POSITION, ATTITUDE):
        ask(streams, 511, number, 0)
    assert counts(streams, 2.0, 9_000_000)[0, POSITION] == pytest.approx(10, abs=1)
    assert streams.interval_us(0, ATTITUDE) == 0


@pytest.mark.parametrize("number", [230, 33.5, math.nan])
def test_what_is_not_streamed_is_denied_or_fails(number: float) -> None:
    for firmware, results in (("ardupilot", (DENIED, FAILED)), ("px4", (FAILED, DENIED))):
        for asks, result in zip((511, 512), results, strict=True):
            (ack,) = ask(fresh(firmware), asks, number, 1e5)  # type: ignore[arg-type]
            assert ack.result == result


@BOTH
def test_one_message_can_be_asked_for_and_an_interval_that_is_no_number_is_refused(
    firmware: Firmware,
) -> None:
    streams, send = fresh(firmware), SendTelemetry(message=ORIGIN, to=HERE)
    for asked_us in (math.inf, math.nan):
        assert ask(streams, 511, POSITION, asked_us)[-1].result in (DENIED, FAILED)
        assert streams.interval_us(0, POSITION) == 0
    answers = [Ack(to=HERE, command=512, result=ACCEPTED), send]  # PX4: the message first
    assert ask(streams, 512, ORIGIN) == answers[:: -1 if firmware == "px4" else 1]


def test_a_data_stream_sets_its_group_over_single_intervals_and_asked_again_holds_up_nothing() -> (
    None
):
    streams, seen = fresh("ardupilot"), Counter[Any]()
    group = partial(mavlink.MAVLink_request_data_stream_message, 1, 1)
    ask(streams, 511, POSITION, 20_000)
    for now_us in range(S, 21 * S, STEP_US):
        if now_us % 500_000 == 0:  # faster than the messages themselves
            streams.on_data_stream(group(6, 1, 1), HERE, now_us)
        seen.update(streams.due(now_us))
    told = [seen[0, number] for number in (POSITION, LOCAL, ATTITUDE)]
    assert told == pytest.approx([20, 20, 0], abs=1)
    streams.on_data_stream(group(0, 2, 1), HERE, S)
    assert counts(streams, 10.0, 30 * S)[0, ATTITUDE] == pytest.approx(20, abs=1)
    for stopped in (group(0, 2, 0), group(77, 4, 1)):
        streams.on_data_stream(stopped, HERE, S)
    assert set(counts(streams, 3.0, 50 * S)) == {(0, HEARTBEAT), (1, HEARTBEAT)}
