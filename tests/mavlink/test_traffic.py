"""Others in the air from the wire: what reports become; nonsense and floods are bounded."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as wire
from renewed import replace

from companion.config import load_mission
from companion.mavlink.frames import Incoming, Receiver, packed
from companion.mavlink.traffic import Listener, claim_message
from companion.mission.events import ClaimWay, OthersHeard, Position
from companion.mission.mission import TrafficRules

MISSION = replace(load_mission("environment-1"), traffic=TrafficRules(icao_address=0xABCDEF))
HERE = Position(time_s=100.0, position_nea_m=(0.0, 0.0, 3500.0), velocity_nea_m_s=(0.0, 0.0, 0.0))
ALL_VALID = 0x9F
OURS = 7


def frame_of(message: Any, system: int = 1, component: int = 1) -> Incoming:
    codec = wire.MAVLink(None, srcSystem=system, srcComponent=component)
    [heard] = Receiver().read(packed(message, codec), None)
    return heard


def aircraft(icao: int = 0x123456, **changed: Any) -> Any:
    fields: dict[str, Any] = {
        "ICAO_address": icao,
        "lat": 470100000,
        "lon": 80000000,
        "altitude_type": 1,
        "altitude": 3_600_000,
        "heading": 9000,
        "hor_velocity": 5000,
        "ver_velocity": -200,
        "callsign": b"TEST",
        "emitter_type": 1,
        "tslc": 2,
        "flags": ALL_VALID,
        "squawk": 0,
    }
    return wire.MAVLink_adsb_vehicle_message(**fields | changed)


def position_of(lat: int = 470100000, **changed: Any) -> Any:
    fields = {
        "time_boot_ms": 5,
        "lat": lat,
        "lon": 80000000,
        "alt": 3_600_000,
        "relative_alt": 0,
        "vx": 300,
        "vy": -400,
        "vz": 100,
        "hdg": 0,
    }
    return wire.MAVLink_global_position_int_message(**fields | changed)


def heartbeat(*, armed: bool, status: int = 4) -> Any:
    return wire.MAVLink_heartbeat_message(2, 3, 128 if armed else 0, 4, status, 3)


def heard(*messages: Any, at: Position = HERE) -> OthersHeard:
    listener = Listener(MISSION)
    for message in messages:
        it = message if isinstance(message, Incoming) else frame_of(message)
        listener.on_message(it, at.time_s, OURS)
    return listener.others(at, OURS)


def test_an_aircraft_is_where_and_when_it_was_last_heard_of() -> None:
    [track] = heard(aircraft()).tracks
    north, east, altitude = track.position_nea_m
    assert (north, east, altitude) == pytest.approx((1111.8, 0.0, 3600.0), abs=1.0)
    assert track.velocity_nea_m_s == pytest.approx((0.0, 50.0, -2.0), abs=0.02)
    assert track.time_s == 98.0
    assert track.error_up_m == 120.0
    assert [t.error_up_m for t in heard(aircraft(altitude_type=0)).tracks] == [300.0]


@pytest.mark.parametrize(
    ("flags", "height", "speed", "growth"),
    [
        (ALL_VALID & ~2, math.inf, 50.0, 6.0),
        (ALL_VALID & ~8, 120.0, 0.0, 100.0),
        (ALL_VALID & ~4, 120.0, 0.0, 51.0),
        (ALL_VALID & ~128, 120.0, 50.0, 6.0),
    ],
)
def test_what_is_not_valid_is_uncertain(
    flags: int, height: float, speed: float, growth: float
) -> None:
    [track] = heard(aircraft(flags=flags)).tracks
    assert track.error_up_m == height
    assert math.hypot(*track.velocity_nea_m_s[:2]) == pytest.approx(speed, abs=0.01)
    assert track.growth_m_s == pytest.approx(growth)
    climbs = (-2.0, 2.2) if flags & 128 else (0.0, 15.0)
    assert (track.velocity_nea_m_s[2], track.growth_up_m_s) == pytest.approx(climbs)


def test_no_coordinates_an_old_report_or_our_own_transponder_is_no_track() -> None:
    for message in (aircraft(flags=ALL_VALID & ~1), aircraft(tslc=61), aircraft(0xABCDEF)):
        assert heard(message).tracks == ()


def test_the_same_aircraft_by_two_senders_is_one_and_the_newest_counts() -> None:
    listener = Listener(MISSION)
    listener.on_message(frame_of(aircraft(tslc=0), 1, 156), 100.0, OURS)
    listener.on_message(frame_of(aircraft(tslc=5, lat=470000000 + 1), 1, 1), 100.2, OURS)
    [track] = listener.others(HERE, OURS).tracks
    assert track.time_s == 100.0


def test_other_systems_are_tracks_unless_they_are_ours_or_disarmed() -> None:
    [track] = heard(frame_of(position_of(), 3)).tracks
    assert (track.name, track.system) == ("system 3", 3)
    assert track.velocity_nea_m_s == pytest.approx((3.0, -4.0, -1.0), abs=0.05)
    assert heard(frame_of(position_of(), OURS)).tracks == ()
    assert heard(frame_of(position_of(), 3, 190)).tracks == ()
    assert heard(frame_of(heartbeat(armed=False), 3), frame_of(position_of(), 3)).tracks == ()
    flies = (frame_of(heartbeat(armed=True), 3), frame_of(position_of(), 3))
    assert len(heard(frame_of(heartbeat(armed=False), 3), *flies).tracks) == 1


def test_a_system_that_has_a_transponder_is_one_track() -> None:
    speed = {"heading": 30687, "hor_velocity": 500}
    both = heard(frame_of(position_of(), 3), aircraft(tslc=0, **speed))
    assert [track.name for track in both.tracks] == ["system 3"]
    far = heard(frame_of(position_of(), 3), aircraft(tslc=0, lat=470200000, **speed))
    assert len(far.tracks) == 2


def test_an_aircraft_above_a_system_is_another_one() -> None:
    speed = {"heading": 30687, "hor_velocity": 500}
    above = aircraft(tslc=0, altitude=4_100_000, **speed)
    assert len(heard(frame_of(position_of(), 3), above).tracks) == 2


def test_a_report_that_is_repeated_gets_older() -> None:
    """ArduPilot repeats its last one for five seconds, with the age that it had."""
    listener = Listener(MISSION)
    for second in range(5):
        listener.on_message(frame_of(aircraft(tslc=0)), 100.0 + second, OURS)
    [track] = listener.others(replace(HERE, time_s=104.0), OURS).tracks
    assert track.time_s == 100.0
    listener.on_message(frame_of(aircraft(tslc=0, hor_velocity=0)), 105.0, OURS)
    [track] = listener.others(replace(HERE, time_s=105.0), OURS).tracks
    assert track.time_s == 105.0  # it stands


def test_a_track_is_forgotten_after_a_minute() -> None:
    listener = Listener(MISSION)
    listener.on_message(frame_of(aircraft(tslc=0)), 100.0, OURS)
    assert listener.others(replace(HERE, time_s=159.0), OURS).tracks
    assert not listener.others(replace(HERE, time_s=161.0), OURS).tracks


def test_a_thousand_aircraft_leave_the_nearest_and_are_told_once() -> None:
    listener, texts = Listener(MISSION), []
    for now_s in (100.0, 100.1):
        for number in range(1000):
            report = aircraft(number + 1, lat=470000000 + 10_000 + 50_000 * (number % 100))
            listener.on_message(frame_of(report), now_s, OURS)
            texts += listener.news()
        tracks = listener.others(HERE, OURS).tracks
        assert len(tracks) == 64
        assert max(track.position_nea_m[0] for track in tracks) < 5000.0
    assert len(texts) == 1


def test_a_flood_is_read_twenty_times_a_second() -> None:
    listener = Listener(MISSION)
    for tick in range(200):
        report = aircraft(tslc=0, lon=80000000 + 5 * tick)
        listener.on_message(frame_of(report), 100.0 + 0.005 * tick, OURS)
    assert len({listener.others(HERE, OURS).tracks[0].time_s}) == 1
    [track] = listener.others(replace(HERE, time_s=101.0), OURS).tracks
    assert 100.9 <= track.time_s <= 100.995


@given(
    lat=st.integers(-(2**31), 2**31 - 1),
    lon=st.integers(-(2**31), 2**31 - 1),
    altitude=st.integers(-(2**31), 2**31 - 1),
    heading=st.integers(0, 65535),
    speed=st.integers(0, 65535),
    flags=st.integers(0, 65535),
    tslc=st.integers(0, 255),
)
def test_whatever_an_aircraft_says_a_track_has_finite_numbers(
    lat: int, lon: int, altitude: int, heading: int, speed: int, flags: int, tslc: int
) -> None:
    said = {"lat": lat, "lon": lon, "altitude": altitude, "heading": heading}
    for track in heard(aircraft(hor_velocity=speed, flags=flags, tslc=tslc, **said)).tracks:
        assert all(map(math.isfinite, (*track.position_nea_m, *track.velocity_nea_m_s)))
        assert track.error_m > 0.0


CLAIM = ClaimWay(
    time_s=100.0, begin_nea_m=(4000.0, 30_000.0, 3500.0), end_nea_m=(4030.0, 30_020.0, 3512.0)
)


def test_a_claim_comes_over_the_wire_to_a_centimetre() -> None:
    message = claim_message(CLAIM, MISSION)
    assert message is not None
    [claim] = heard(frame_of(message, 3, 195)).claims
    assert claim.system == 3
    assert claim.begin_nea_m == pytest.approx(CLAIM.begin_nea_m, abs=0.02)
    assert claim.end_nea_m == pytest.approx(CLAIM.end_nea_m, abs=0.03)


def test_only_companions_of_others_claim_and_a_farewell_ends_it() -> None:
    message = claim_message(CLAIM, MISSION)
    assert heard(frame_of(message, OURS, 195)).claims == ()
    assert heard(frame_of(message, 3, 1)).claims == ()
    farewell = frame_of(heartbeat(armed=False, status=wire.MAV_STATE_POWEROFF), 3, 195)
    assert heard(frame_of(message, 3, 195), farewell).claims == ()


def test_another_kind_of_target_is_no_claim() -> None:
    message = claim_message(CLAIM, MISSION)
    message.type_mask = 2496
    assert heard(frame_of(message, 3, 195)).claims == ()


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e9])
@pytest.mark.parametrize("field", ["alt", "vx", "vz"])
def test_a_claim_that_makes_no_sense_is_left_out_and_told_once(field: str, value: float) -> None:
    message, listener = claim_message(CLAIM, MISSION), Listener(MISSION)
    assert message is not None
    setattr(message, field, value)
    for _ in range(3):
        listener.on_message(frame_of(message, 3, 195), 100.0, OURS)
    assert listener.others(HERE, OURS).claims == ()
    assert len(listener.news()) == 1
    assert listener.news() == []
