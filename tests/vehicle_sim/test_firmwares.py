"""What every autopilot does alike, and what is told to whom; another autopilot is data."""

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from harness import (
    GCS,
    KINDS,
    OFFBOARD,
    PLACE,
    ArduCopter,
    Link,
    Px4Copter,
    Rig,
    armable,
    circling,
    cruising,
    flying,
    heartbeat,
    hovering,
    local,
    ready,
)
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot import factory
from vehicle_sim.autopilot.arducopter import FIRMWARE
from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.autopilot.values import Result
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.parameters import Firmware, Parameter

ALL_FOUR = pytest.mark.parametrize("kind", KINDS, ids="-".join)


@pytest.mark.parametrize(("firmware", "boot_s"), [("ardupilot", 44.0), ("px4", 7.0)])
def test_ardupilot_tells_texts_where_anybody_was_heard_and_px4_to_ground_stations_only(
    firmware: Firmware, boot_s: float
) -> None:
    vehicle = Link("copter", firmware, PLACE, links=2)
    vehicle.run(boot_s)
    if firmware == "px4":
        vehicle.send(heartbeat())
        vehicle.send(heartbeat(mavlink.MAV_TYPE_GCS), link=1, source=GCS)
    else:
        vehicle.send(heartbeat(), link=1)
        vehicle.command(176, 1, 4, link=1)
    vehicle.command(400, 1, link=1)
    vehicle.run(1.0)
    assert vehicle.texts() == []
    assert vehicle.texts(link=1)


def test_px4_takes_what_is_signed_and_what_is_not_and_never_signs() -> None:
    vehicle, mav, stamp = ready("px4", "copter"), mavlink.MAVLink(None, *GCS), 400_000_000_000
    mav.signing.secret_key, mav.signing.link_id = bytes([7]) * 32, 3
    mav.signing.timestamp, mav.signing.sign_outgoing = stamp, True
    arm = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, *[0] * 6)
    vehicle.put(bytes(arm.pack(mav)))
    vehicle.run(0.1)
    assert vehicle.simulation.armed
    vehicle.send(mavlink.MAVLink_setup_signing_message(1, 1, mav.signing.secret_key, stamp + 1))
    vehicle.run(0.1)
    assert vehicle.command(400, 0) == 0
    assert not any(heard.frame[2] & 1 for heard in vehicle.heard)


@ALL_FOUR
def test_every_mode_is_flown_or_refused_with_a_word(kind: Any) -> None:
    client, is_px4 = flying(*kind), kind[0] == "px4"
    modes = PERSONALITIES[kind].firmware.modes
    numbers = {mode.name: mode.number for mode in modes}
    back = numbers["Hold" if is_px4 else "GUIDED"]
    for mode in modes:
        since_s = client.now_s
        result, now = client.set_mode(mode.number), client.simulation.mode_name
        client.run(0.3)  # STABILIZE falls
        if result == 0:
            assert numbers[now] == mode.number
            assert client.simulation.armed, mode.name
        else:
            assert is_px4 or client.texts(since_s), mode.name
        assert client.set_mode(back) == 0
        client.run(1.0)
        assert client.last("HEARTBEAT").custom_mode == back


@ALL_FOUR
def test_in_flight_it_is_disarmed_by_force_alone_and_falls(kind: Any) -> None:
    client = flying(*kind)
    assert client.command(400, 0) != 0
    assert client.command(400, 0, 21196) == 0
    free_s = math.sqrt(2.0 * client.above_m / GRAVITY_M_S2)
    fell_s = client.until(lambda: client.simulation.landed, 20.0)
    assert free_s - 0.1 < fell_s < (free_s + 0.1 if kind[1] == "copter" else 15.0)


_NUMBERS = {"GUIDED": 40, "LAND": 41, "RTL": 42}
"""custom_mode of an autopilot that there is not."""
SPARROW = replace(
    FIRMWARE,
    rates_hz={0: 2.0},
    autopilot=0,  # MAV_AUTOPILOT_GENERIC
    modes=tuple(replace(m, number=_NUMBERS.get(m.name, m.number)) for m in FIRMWARE.modes),
    table=tuple(
        Parameter(name="WPNAV_SPEED", default=300.0) if row.name == "WPNAV_SPEED" else row
        for row in FIRMWARE.table
    ),
    refused=Result.DENIED,
    prearm_s=2.5,
    arms="Off we go",
)


def test_a_world_names_another_autopilot_and_it_flies_as_its_data_say(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mine = replace(PERSONALITIES["ardupilot", "copter"], firmware=SPARROW)
    monkeypatch.setitem(PERSONALITIES, ("sparrow", "copter"), mine)
    flown = armable("copter", "sparrow")
    assert flown.command(224, 7) == Result.DENIED  # no such item: ArduPilot says FAILED
    assert [flown.command(176, 1, 40), flown.command(400, 1)] == [0, 0]
    assert flown.texts() == ["Off we go"]
    flown.order(22, *[0.0] * 6, 10.0)
    flown.until(lambda: flown.above_m > 9.5, 30.0)
    beat = flown.last("HEARTBEAT")
    assert (beat.custom_mode, beat.autopilot, flown.simulation.mode_name) == (40, 0, "GUIDED")
    flown.send(local((200.0, 0.0, -10.0), (0.0, 0.0, 0.0)))
    speeds_m_s = list[float]()
    flown.run(20.0, lambda: speeds_m_s.append(flown.simulation.vehicle.velocity_m_s.real))
    assert max(speeds_m_s) == pytest.approx(3.0, abs=0.5)


FLYING: dict[str, Callable[[], Rig]] = {
    "arducopter": hovering,
    "arduplane": circling,
    "ideal": lambda: ArduCopter(drag=False).airborne(),
    "px4copter": lambda: Px4Copter().take_off(),
    "px4plane": cruising,
}


@pytest.mark.parametrize("name", FLYING)
def test_a_step_that_follows_a_path_calls_at_most_15_functions_of_the_autopilots(name: str) -> None:
    rig, called, counts = FLYING[name](), set[Any](), list[int]()
    rig.aim((300.0, 0.0, -40.0), (5.0, 0.0, 0.0))
    if name == "px4plane":
        assert rig.command(176, 1.0, *OFFBOARD) == Result.ACCEPTED
    where = str(Path(factory.__file__).parent)

    def note(at: Any, event: str, _: Any) -> None:
        if event == "call" and at.f_code.co_filename.startswith(where):
            called.add(at.f_code)

    for k in range(200):
        if name == "arduplane":
            rig.command(192, -1.0, 1.0, 0.0, 0.0, -35.36, 149.17, 80.0, frame=3)
        elif k % 10 == 0:
            rig.aim((300.0, 0.0, -40.0), (5.0, 0.0, 0.0))
        called.clear()
        sys.setprofile(note)
        rig.step()
        sys.setprofile(None)
        counts.append(len(called))
    assert 5 < median(counts) <= 15
