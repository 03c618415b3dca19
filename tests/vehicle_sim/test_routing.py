"""Who gets what: the tables of ardupilot.md 3 and 5 and px4.md 2, row by row."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.parameters import Firmware
from vehicle_sim.wire.frames import StreamParser
from vehicle_sim.wire.routing import Route, Router

Ids = tuple[int, int]
GCS, COMPANION, RADAR = (255, 190), (1, 191), 100
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
    vehicle.router.enforce = True
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
        (GCS, command((10, 1)), 0, Route()),
        (GCS, key((2, 1)), 0, Route()),
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
    vehicle.router.restart()
    for spoken in (False, True):
        assert vehicle.router.heard(ON_COMPANION_LINK) is spoken
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
        (command((1, 1)), True, ()),
        (command((1, 0)), True, TO_COMPANION),
        (command((0, 1)), False, TO_COMPANION),
        (command((1, 50)), False, ()),
        (command((0, 0), 512), True, TO_COMPANION),
        (command((1, 77), 512), True, ()),
        (command((2, 1), 512), False, ()),
        (command((1, 191)), False, TO_COMPANION),
        (mission((1, 190)), True, ()),
        (mission((1, 191)), False, TO_COMPANION),
        (mission((0, 1)), False, TO_COMPANION),
        (mavlink.MAVLink_param_request_list_message(1, 0), True, TO_COMPANION),
        (mavlink.MAVLink_param_request_list_message(0, 0), False, TO_COMPANION),
        (mavlink.MAVLink_timesync_message(0, 5), True, TO_COMPANION),
        (BEAT, True, TO_COMPANION),
    ],
)
def test_what_px4_takes_for_its_own_and_passes_on(
    message: Any, *, taken: bool, links: tuple[int, ...]
) -> None:
    route = Vehicle("px4").get(GCS, message)
    assert (route.to_autopilot, route.links) == (taken, links)
    assert Vehicle("px4").get(GCS, command((1, RADAR))).to_radar
