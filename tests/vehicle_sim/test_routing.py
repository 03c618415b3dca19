"""Who gets what: the tables of ardupilot.md 3 and 5 and px4.md 2, row by row."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.parameters import Firmware
from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.wire.routing import Route, Router

Ids = tuple[int, int]
GCS, COMPANION, RADAR = (255, 190), (1, 191), 100
ON_GCS_LINK, ON_COMPANION_LINK = 0, 1


def message_from(source: Ids, message: Any) -> Any:
    ((_, got),) = StreamParser(datagrams=True).feed(Packer(*source).frame(message))
    return got


def setpoint(target: Ids) -> Any:
    return mavlink.MAVLink_set_position_target_local_ned_message(0, *target, 1, 0, *[0.0] * 11)


def command(target: Ids, number: int = 400) -> Any:
    return mavlink.MAVLink_command_long_message(*target, number, 0, *[0.0] * 7)


def heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


class Vehicle:
    """A router that has heard a ground station on link 0 and a companion on link 1."""

    def __init__(self, firmware: Firmware = "ardupilot", radar: int | None = RADAR) -> None:
        self.router = Router(system=1, radar=radar, firmware=firmware)
        self.get(GCS, heartbeat(), ON_GCS_LINK)
        self.get(COMPANION, heartbeat(), ON_COMPANION_LINK)

    def get(self, source: Ids, message: Any, link: int) -> Route:
        return self.router.route(message_from(source, message), link)


@pytest.mark.parametrize(
    ("source", "target", "taken"),
    [
        ((1, 191), (1, 1), True),
        ((1, 195), (1, 1), True),
        ((255, 190), (1, 1), True),
        ((42, 7), (1, 1), True),
        ((0, 0), (1, 1), True),
        ((1, 1), (1, 1), False),
        ((1, RADAR), (1, 1), False),
        ((1, 195), (1, 0), True),
        ((1, 195), (0, 0), True),
        ((1, 195), (0, 1), True),
        ((1, 195), (1, 50), True),
        ((1, 195), (1, 191), False),
        ((1, 195), (1, RADAR), False),
        ((1, 195), (2, 1), False),
        ((1, 195), (2, 0), False),
    ],
)
def test_who_may_send_setpoints_to_ardupilot(source: Ids, target: Ids, *, taken: bool) -> None:
    vehicle = Vehicle()
    assert vehicle.get(source, setpoint(target), ON_GCS_LINK).to_autopilot is taken


def test_a_component_that_lives_only_on_the_senders_link_is_the_vehicle_itself() -> None:
    route = Vehicle().get(COMPANION, setpoint((1, 191)), ON_COMPANION_LINK)
    assert route == Route(to_autopilot=True)  # measured with an exclamation mark


@pytest.mark.parametrize(
    ("source", "taken"),
    [((1, 77), True), ((255, 190), True), ((255, 7), True), ((42, 7), False), ((254, 190), False)],
)
def test_enforcing_lets_only_the_own_system_and_the_ground_station_command(
    source: Ids, *, taken: bool
) -> None:
    vehicle = Vehicle()
    vehicle.router.enforce = True
    assert vehicle.get(source, setpoint((1, 1)), ON_GCS_LINK).to_autopilot is taken
    assert vehicle.get(source, command((1, 0)), ON_GCS_LINK).links == (ON_COMPANION_LINK,)


@pytest.mark.parametrize(
    ("target", "route"),
    [
        ((1, 191), Route(links=(ON_COMPANION_LINK,))),
        ((1, 0), Route(links=(ON_COMPANION_LINK,), to_autopilot=True, to_radar=True)),
        ((1, 99), Route(to_autopilot=True)),  # whom nobody knows is the vehicle
        ((1, 1), Route(to_autopilot=True)),
        ((1, RADAR), Route(to_radar=True)),
    ],
)
def test_a_command_goes_where_its_target_is(target: Ids, route: Route) -> None:
    assert Vehicle().get(GCS, command(target), ON_GCS_LINK) == route


def test_the_answer_of_the_companion_finds_the_ground_station() -> None:
    ack = mavlink.MAVLink_command_ack_message(400, 0, 0, 0, *GCS)
    assert Vehicle().get(COMPANION, ack, ON_COMPANION_LINK) == Route(links=(ON_GCS_LINK,))


def test_heartbeats_are_repeated_on_every_other_link_where_somebody_was_heard() -> None:
    vehicle = Vehicle()
    vehicle.get((42, 1), heartbeat(), 2)
    assert vehicle.get(GCS, heartbeat(), ON_GCS_LINK).links == (ON_COMPANION_LINK, 2)
    assert vehicle.get(GCS, heartbeat(), ON_GCS_LINK).to_autopilot
    # one that is heard on two links is not sent to either
    assert vehicle.get(GCS, heartbeat(), 2).links == (ON_COMPANION_LINK,)
    assert vehicle.get(GCS, heartbeat(), ON_GCS_LINK).links == (ON_COMPANION_LINK,)


def test_broadcasts_reach_the_other_links_once_and_never_their_own() -> None:
    vehicle = Vehicle()
    vehicle.get((1, 192), heartbeat(), ON_COMPANION_LINK)
    vehicle.get((255, 191), heartbeat(), ON_GCS_LINK)
    text = mavlink.MAVLink_statustext_message(4, b"hello", 5, 0)
    assert vehicle.get(COMPANION, text, ON_COMPANION_LINK).links == (ON_GCS_LINK,)
    assert vehicle.get(GCS, text, ON_GCS_LINK).links == (ON_COMPANION_LINK,)


def test_two_on_one_link_do_not_see_each_other() -> None:
    vehicle = Vehicle()
    vehicle.get((1, 192), heartbeat(), ON_COMPANION_LINK)
    assert vehicle.get(COMPANION, command((1, 192)), ON_COMPANION_LINK).links == ()


def test_nothing_goes_to_a_component_before_it_has_spoken() -> None:
    router = Router(system=1, firmware="ardupilot")
    assert router.route(message_from(GCS, command((1, 191))), 0) == Route(to_autopilot=True)
    assert not router.heard(1)
    router.route(message_from(COMPANION, heartbeat()), 1)
    assert router.heard(1)
    assert router.route(message_from(GCS, command((1, 191))), 0) == Route(links=(1,))


def test_other_systems_are_reached_whatever_component_is_named() -> None:
    vehicle = Vehicle()
    vehicle.get((9, 1), heartbeat(), 2)
    assert vehicle.get(GCS, command((9, 33)), ON_GCS_LINK) == Route(links=(2,))
    assert vehicle.get(GCS, command((10, 1)), ON_GCS_LINK) == Route()


@pytest.mark.parametrize("target", [(1, 1), (1, 0), (0, 0)])
def test_some_are_never_passed_on(target: Ids) -> None:
    key = mavlink.MAVLink_setup_signing_message(*target, [7] * 32, 5)
    for message in (key, mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1)):
        route = Vehicle().get(GCS, message, ON_GCS_LINK)
        assert (route.links, route.to_autopilot) == ((), True)


def test_a_key_for_another_vehicle_is_not_ours() -> None:
    key = mavlink.MAVLink_setup_signing_message(2, 1, [7] * 32, 5)
    assert Vehicle().get(GCS, key, ON_GCS_LINK) == Route()


def test_a_message_whose_own_id_field_looks_like_a_number_is_routed_by_its_real_one() -> None:
    # STATUSTEXT.id = 0 is not HEARTBEAT: it must not be repeated as one
    vehicle = Vehicle()
    vehicle.get((9, 1), heartbeat(), 2)
    vehicle.get((9, 1), heartbeat(), 3)
    text = mavlink.MAVLink_statustext_message(4, b"hello", 0, 0)
    assert vehicle.get((9, 1), text, 2).links == (ON_GCS_LINK, ON_COMPANION_LINK, 3)


def test_routes_are_bounded_and_forgotten_at_a_boot() -> None:
    vehicle = Vehicle()
    for system in range(2, 250):
        vehicle.get((system, 1), heartbeat(), 2)
    assert len(vehicle.router._routes) == 20
    assert vehicle.get(GCS, command((200, 1)), ON_GCS_LINK) == Route()  # came too late
    vehicle.router.restart()
    assert vehicle.get(GCS, command((1, 191)), ON_GCS_LINK) == Route(to_autopilot=True)


# --- PX4 ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "target", "taken"),
    [
        ((42, 191), (1, 1), True),
        ((1, 1), (1, 1), True),
        ((1, 191), (0, 0), True),
        ((1, 191), (0, 1), True),
        ((1, 191), (1, 0), True),
        ((1, 191), (1, 191), False),
        ((1, 191), (1, 50), False),
        ((1, 191), (2, 1), False),
    ],
)
def test_who_may_send_setpoints_to_px4(source: Ids, target: Ids, *, taken: bool) -> None:
    assert Vehicle("px4").get(source, setpoint(target), ON_GCS_LINK).to_autopilot is taken


@pytest.mark.parametrize(
    ("message", "taken"),
    [
        (command((1, 1)), True),
        (command((1, 0)), True),
        (command((0, 1)), False),
        (command((1, 50)), False),
        (command((0, 0), 512), True),
        (command((1, 77), 512), True),
        (command((2, 1), 512), False),
        (mavlink.MAVLink_mission_count_message(1, 190, 3), True),
        (mavlink.MAVLink_mission_count_message(1, 191, 3), False),
        (mavlink.MAVLink_mission_count_message(0, 1, 3), False),
        (mavlink.MAVLink_param_request_list_message(1, 0), True),
        (mavlink.MAVLink_param_request_list_message(0, 0), False),
        (mavlink.MAVLink_timesync_message(0, 5), True),
    ],
)
def test_what_px4_takes_for_its_own(message: Any, *, taken: bool) -> None:
    assert Vehicle("px4").get(GCS, message, ON_GCS_LINK).to_autopilot is taken


def test_px4_passes_on_what_is_not_for_it_alone() -> None:
    vehicle = Vehicle("px4")
    assert vehicle.get(GCS, command((1, 1)), ON_GCS_LINK).links == ()
    assert vehicle.get(GCS, command((1, 191)), ON_GCS_LINK).links == (ON_COMPANION_LINK,)
    assert vehicle.get(GCS, command((1, 192)), ON_GCS_LINK).links == ()
    assert vehicle.get(GCS, heartbeat(), ON_GCS_LINK).links == (ON_COMPANION_LINK,)
    assert vehicle.get(GCS, command((1, RADAR)), ON_GCS_LINK).to_radar
