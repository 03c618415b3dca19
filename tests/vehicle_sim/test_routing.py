"""Who gets what and when it is due: the tables of ardupilot.md 1, 3 and 5 and px4.md 2."""

import math
from collections import Counter
from functools import partial
from typing import Any

import pytest
from harness import COMPANION, GCS, Ids, Rig, copied, heartbeat
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Sender
from vehicle_sim.parameters import Firmware
from vehicle_sim.wire.frames import StreamParser
from vehicle_sim.wire.routing import Router

BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])

# --- who gets what --------------------------------------------------------------------------------

RADAR, OTHER = 100, (9, 1)


def message(kind: str, *target: int, **fields: Any) -> Any:
    """To this target; what is not given is 0."""
    made = getattr(mavlink, f"MAVLink_{kind}_message")
    addressed = dict(zip(("target_system", "target_component"), target, strict=False))
    return made(**dict.fromkeys(made.fieldnames, 0) | addressed | fields)


BEAT = heartbeat(mavlink.MAV_TYPE_GCS)
setpoint = partial(message, "set_position_target_local_ned")
command = partial(message, "command_long", command=400)
key = partial(message, "setup_signing", secret_key=[7] * 32)
text = partial(message, "statustext", text=b"hello")
ACK, RADIO, SYNC = message("command_ack", *GCS), message("radio_status"), message("timesync")


class Vehicle:
    """A router that has heard a ground station on link 0, two on link 1, another system on 2."""

    def __init__(self) -> None:
        self.router = Router(RADAR)
        assert self.get(GCS, command(1, 191)) == ""  # before it has spoken
        for source, link in ((GCS, 0), (COMPANION, 1), ((1, 192), 1), (OTHER, 2)):
            self.get(source, BEAT, link)

    def get(self, source: Ids, message: Any, link: int = 0) -> str:
        """Where it goes: the numbers of links, A for the autopilot, R for the radar."""
        frame = message.pack(mavlink.MAVLink(None, *source))
        ((_, got),) = StreamParser(datagrams=True).feed(bytes(frame))
        links, to_autopilot, to_radar = self.router.route(got, Sender(*source, link))
        return "".join(map(str, sorted(links))) + "A" * to_autopilot + "R" * to_radar


ROUTES: list[tuple[Ids, int, Any, str]] = [
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
]


def test_where_a_message_goes() -> None:
    for source, link, message, route in ROUTES:
        vehicle = Vehicle()
        assert vehicle.get(source, message, link) == route, (source, link, message)
    for system in range(10, 250):  # routes are bounded
        vehicle.get((system, 1), BEAT, 2)
    assert [vehicle.get(GCS, command(system, 1)) for system in (19, 249)] == ["2", ""]


# --- when it is due -------------------------------------------------------------------------------

POSITION, ORIGIN = 33, 49
GLOBAL_POSITION, ACCEPTED, DENIED, FAILED = "GLOBAL_POSITION_INT", 0, 2, 4


@copied
def fresh(firmware: Firmware) -> Rig:
    return Rig(firmware, links=2).armable()


def counts(it: Rig, seconds: float) -> Counter[Any]:
    """Of what comes in so long, by message, and by link too."""
    it.heard.clear()
    said = [each for each in it.run(seconds).heard if each.source == (1, 1)]
    return Counter(each.kind for each in said) + Counter((each.kind, each.link) for each in said)


@BOTH
def test_an_interval_is_met_exactly_on_the_asking_link_alone(firmware: Firmware) -> None:
    """Any, none (-1), and the usual (0); what is no number is refused and changes nothing."""
    it, came = fresh(firmware), 0.0
    usual = counts(it, 20.0)
    for asked_us in (1_000_000, 33_898, math.nan, 10_000, -1, math.inf, 0):
        is_number = math.isfinite(asked_us)
        result = it.command(511, POSITION, asked_us)
        assert result in ((ACCEPTED,) if is_number else (DENIED, FAILED))
        if asked_us > 0 and is_number:  # of an ArduPilot in whole milliseconds
            came = 20e6 / (asked_us // 1000 * 1000 if firmware == "ardupilot" else asked_us)
        elif is_number:
            came = usual[GLOBAL_POSITION, 0] if asked_us == 0 else 0.0
        seen = counts(it, 20.0)
        assert seen[GLOBAL_POSITION, 0] == pytest.approx(came, abs=1.5)
        assert seen[GLOBAL_POSITION, 1] == usual[GLOBAL_POSITION, 1]
        assert seen["HEARTBEAT", 0] == seen["HEARTBEAT", 1] == 20
    it.command(511, POSITION, 10_000)
    it.simulation.now_us += 80_000_000  # a pause is not made up for
    assert counts(it, 0.5)[GLOBAL_POSITION, 0] == pytest.approx(50, abs=1.5)


@BOTH
def test_one_message_can_be_asked_for_if_there_is_such_a_one(firmware: Firmware) -> None:
    it = fresh(firmware)
    asked = message("command_long", 1, 1, command=512, param1=ORIGIN)
    kinds = [each.get_type() for each in it.ask(asked)]
    answers = ["COMMAND_ACK", "GPS_GLOBAL_ORIGIN"]  # PX4: the message first
    assert [k for k in kinds if k in answers] == answers[:: -1 if firmware == "px4" else 1]
    for number in (230.5, 12920, math.nan):
        refused = [it.command(asks, number, 1e5) for asks in (511, 512)]
        assert refused == ([DENIED, FAILED] if firmware == "ardupilot" else [FAILED, DENIED])


def test_a_data_stream_sets_its_group_over_intervals_and_asked_again_holds_up_nothing() -> None:
    it = fresh("ardupilot")
    group = partial(mavlink.MAVLink_request_data_stream_message, 1, 1)
    it.command(511, POSITION, 20_000)
    it.streamed = group(6, 1, 1)  # faster than the messages themselves
    seen = counts(it, 20.0)
    told = [seen[kind, 0] for kind in (GLOBAL_POSITION, "LOCAL_POSITION_NED", "ATTITUDE")]
    assert told == pytest.approx([20, 20, 0], abs=1)
    it.streamed = None
    it.send(group(0, 2, 1))
    assert counts(it, 10.0)["ATTITUDE", 0] == pytest.approx(20, abs=1)
    it.send(group(0, 2, 0), group(77, 4, 1))
    assert {*counts(it, 3.0)} - {"HEARTBEAT"} == {("HEARTBEAT", 0), ("HEARTBEAT", 1)}
