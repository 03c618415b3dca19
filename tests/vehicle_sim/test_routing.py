"""Who gets what and when it is due: the tables of ardupilot.md 1, 3 and 5 and px4.md 2."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from harness import COMPANION, GCS, Ids
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.autopilot.values import Ack, Command, Sender, SendTelemetry, Text
from vehicle_sim.parameters import Firmware, Parameters
from vehicle_sim.wire.frames import StreamParser
from vehicle_sim.wire.routing import Route, Router
from vehicle_sim.wire.streams import Streams

STEP_US, S = 10_000, 1_000_000
BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])

# --- who gets what --------------------------------------------------------------------------------

RADAR = 100
ON_GCS_LINK, ON_COMPANION_LINK, ELSEWHERE = 0, 1, 2
TO_GCS, TO_COMPANION = (ON_GCS_LINK,), (ON_COMPANION_LINK,)


def setpoint(target: Ids) -> Any:
    return mavlink.MAVLink_set_position_target_local_ned_message(0, *target, 1, 0, *[0.0] * 11)


def command(target: Ids, number: int = 400) -> Any:
    return mavlink.MAVLink_command_long_message(*target, number, 0, *[0.0] * 7)


def mission(target: Ids) -> Any:
    return mavlink.MAVLink_mission_count_message(*target, 3)


def text(number: int = 5) -> Any:
    return mavlink.MAVLink_statustext_message(4, b"hello", number, 0)


def key(target: Ids) -> Any:
    return mavlink.MAVLink_setup_signing_message(*target, [7] * 32, 5)


BEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
ACK = mavlink.MAVLink_command_ack_message(400, 0, 0, 0, *GCS)
RADIO = mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1)
EVERYBODY = {"to_autopilot": True, "to_radar": True}


class Vehicle:
    """A router that has heard a ground station on link 0 and a companion on link 1."""

    def __init__(self, firmware: Firmware = "ardupilot") -> None:
        self.router = Router(system=1, radar=RADAR, firmware=firmware)
        self.get(GCS, BEAT, ON_GCS_LINK)
        self.get(COMPANION, BEAT, ON_COMPANION_LINK)

    def get(self, source: Ids, message: Any, link: int = ON_GCS_LINK) -> Route:
        frame = message.pack(mavlink.MAVLink(None, *source))
        ((_, got),) = StreamParser(datagrams=True).feed(bytes(frame))
        return self.router.route(got, link)


@pytest.mark.parametrize(
    ("firmware", "source", "target", "taken"),
    [
        *(("ardupilot", who, (1, 1), True) for who in [(1, 191), (255, 190), (42, 7), (0, 0)]),
        *(("ardupilot", who, (1, 1), False) for who in [(1, 1), (1, RADAR)]),  # an echo
        *(("ardupilot", (1, 195), to, True) for to in [(1, 0), (0, 0), (0, 1), (1, 50)]),
        *(("ardupilot", (1, 195), to, False) for to in [(1, 191), (1, RADAR), (2, 1), (2, 0)]),
        *(("px4", who, (1, 1), True) for who in [(42, 191), (1, 1)]),
        *(("px4", (1, 191), to, True) for to in [(0, 0), (0, 1), (1, 0)]),
        *(("px4", (1, 191), to, False) for to in [(1, 191), (1, 50), (2, 1)]),
    ],
)
def test_who_may_send_setpoints(
    firmware: Firmware, source: Ids, target: Ids, *, taken: bool
) -> None:
    assert Vehicle(firmware).get(source, setpoint(target)).to_autopilot is taken


@pytest.mark.parametrize(
    ("source", "taken"),
    [((1, 77), True), ((255, 190), True), ((255, 7), True), ((42, 7), False), ((254, 190), False)],
)
def test_enforcing_lets_only_the_own_system_and_the_ground_station_command(
    source: Ids, *, taken: bool
) -> None:
    vehicle = Vehicle()
    vehicle.router.commanders = frozenset({1, 255})
    assert vehicle.get(source, setpoint((1, 1))).to_autopilot is taken
    assert vehicle.get(source, command((1, 0))).links == TO_COMPANION
    assert vehicle.get(source, BEAT).to_autopilot


@pytest.mark.parametrize(
    ("source", "message", "link", "route"),
    [
        (GCS, command((1, 191)), 0, Route(TO_COMPANION)),
        (GCS, command((1, 0)), 0, Route(TO_COMPANION, **EVERYBODY)),
        (GCS, command((1, 99)), 0, Route(to_autopilot=True)),  # whom nobody knows is the vehicle
        (GCS, command((1, 1)), 0, Route(to_autopilot=True)),
        (GCS, command((1, RADAR)), 0, Route(to_radar=True)),
        # who lives only on the sender's link is the vehicle itself: measured, with surprise
        (COMPANION, setpoint((1, 191)), 1, Route(to_autopilot=True)),
        (COMPANION, ACK, 1, Route(TO_GCS)),
        (GCS, command((9, 33)), 0, Route((ELSEWHERE,))),  # of others any component will do
        *((GCS, command((10, 1)), 0, Route()), (GCS, key((2, 1)), 0, Route())),
        # STATUSTEXT.id = 0 is not HEARTBEAT: it must not be repeated as one
        ((9, 1), text(0), 2, Route((0, 1), **EVERYBODY)),
        (COMPANION, text(), 1, Route((0, 2), **EVERYBODY)),
        (GCS, BEAT, 0, Route((1, 2), **EVERYBODY)),
        (GCS, BEAT, 2, Route((1,), **EVERYBODY)),  # heard on two links
    ],
)
def test_a_message_goes_where_its_target_is(
    source: Ids, message: Any, link: int, route: Route
) -> None:
    vehicle = Vehicle()
    vehicle.get((1, 192), BEAT, ON_COMPANION_LINK)  # two on a link do not see each other
    vehicle.get((9, 1), BEAT, ELSEWHERE)
    assert vehicle.get(source, message, link) == route


@pytest.mark.parametrize("message", [key((1, 1)), key((1, 0)), key((0, 0)), RADIO])
def test_some_are_never_passed_on(message: Any) -> None:
    route = Vehicle().get(GCS, message)
    assert (route.links, route.to_autopilot) == ((), True)


def test_nothing_goes_to_a_component_before_it_has_spoken_and_routes_are_bounded() -> None:
    vehicle = Vehicle()
    vehicle.router = Router(system=1, radar=RADAR, firmware="ardupilot")
    for spoken in (False, True):
        assert (ON_COMPANION_LINK in vehicle.router.heard_on) is spoken
        route = Route(TO_COMPANION) if spoken else Route(to_autopilot=True)
        assert vehicle.get(GCS, command((1, 191))) == route
        vehicle.get(COMPANION, BEAT, ON_COMPANION_LINK)
    for system in range(2, 250):
        vehicle.get((system, 1), BEAT, ELSEWHERE)
    assert vehicle.get(GCS, command((19, 1))) == Route((ELSEWHERE,))
    assert vehicle.get(GCS, command((200, 1))) == Route()  # came too late


@pytest.mark.parametrize(
    ("message", "taken", "links"),
    [
        *((command((1, 1)), True, ()), (command((1, 0)), True, TO_COMPANION)),
        *((command((0, 1)), False, TO_COMPANION), (command((1, 50)), False, ())),
        *((command((0, 0), 512), True, TO_COMPANION), (command((1, 77), 512), True, ())),
        *((command((2, 1), 512), False, ()), (command((1, 191)), False, TO_COMPANION)),
        *((mission((1, 190)), False, ()), (mission((1, 191)), False, TO_COMPANION)),
        (mission((0, 1)), False, TO_COMPANION),
        (mavlink.MAVLink_param_request_list_message(1, 0), True, TO_COMPANION),
        (mavlink.MAVLink_param_request_list_message(0, 0), False, TO_COMPANION),
        *((mavlink.MAVLink_timesync_message(0, 5), True, TO_COMPANION), (BEAT, True, TO_COMPANION)),
    ],
)
def test_what_px4_takes_for_its_own_and_passes_on(
    message: Any, *, taken: bool, links: tuple[int, ...]
) -> None:
    route = Vehicle("px4").get(GCS, message)
    assert (route.to_autopilot, route.links) == (taken, links)
    assert Vehicle("px4").get(GCS, command((1, RADAR))).to_radar


# --- when it is due -------------------------------------------------------------------------------

HERE = Sender(system=1, component=191, link=0)
POSITION, ATTITUDE, LOCAL, HEARTBEAT, ORIGIN = 33, 30, 32, 0, 49
NOBODY_KNOWS = 230
ACCEPTED, DENIED, FAILED = 0, 2, 4


def fresh(firmware: Firmware, *, links: int = 2, rates_hz: Any = ()) -> Streams:
    is_px4, known = firmware == "px4", frozenset({POSITION, ATTITUDE, LOCAL})
    profile = replace(
        PERSONALITIES[firmware, "copter"].firmware,
        rates_hz={HEARTBEAT: 1.0, **dict(rates_hz)},
        first_heartbeat_us=S,
        streamable=known if is_px4 else known | {HEARTBEAT},
        requestable=known | {ORIGIN},
        data_streams={} if is_px4 else {6: (POSITION, LOCAL), 10: (ATTITUDE,)},
    )
    return Streams(profile, Parameters((), {}), range(links), 0)


def ask(streams: Streams, number: int, *p: float, now_us: int = S) -> Sequence[Any]:
    parameters: Any = (*p, *[0.0] * (7 - len(p)))
    return streams.on_command(Command(HERE, 1, number, parameters), now_us)


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
        said, ack = ask(fresh("ardupilot"), 511, number, asked_us)
        assert said == Text(severity=6, text=f"No ap_message for mavlink id ({number:.0f})")
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
    streams.on_data_stream(group(6, 4), 0, S)
    seen = counts(streams, 10.0)
    told = [seen[0, number] for number in (POSITION, LOCAL, ATTITUDE)]
    assert told == pytest.approx([40, 40, 0], abs=1)
    streams.on_data_stream(group(0, 2), 0, S)
    assert counts(streams, 10.0, 20 * S)[0, ATTITUDE] == pytest.approx(20, abs=1)
    for stopped in (group(0, 2, start=0), group(77, 4)):
        streams.on_data_stream(stopped, 0, S)
    assert set(counts(streams, 3.0, 40 * S)) == {(0, HEARTBEAT), (1, HEARTBEAT)}


def test_the_same_request_again_and_again_does_not_hold_up_a_slow_message() -> None:
    streams, seen = fresh("ardupilot", links=1), Counter[Any]()
    for now_us in range(S, 21 * S, STEP_US):
        if now_us % 500_000 == 0:  # faster than the message itself
            streams.on_data_stream(group(6, 1), 0, now_us)
            ask(streams, 511, LOCAL, S, now_us=now_us)
        seen.update(streams.due(now_us))
    assert seen[0, POSITION] == seen[0, LOCAL] == pytest.approx(20, abs=1)
