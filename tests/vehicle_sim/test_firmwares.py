"""What a client meets first: defaults, capabilities, unasked rates, who is told texts.

ardupilot.md (head, 1), px4.md (1 to 3, 10).
"""

from typing import Any

import pytest
from harness import GCS, KINDS, MISSION, PLACE, Link, flying, heartbeat, ready
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot import core
from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.parameters import Firmware, Kind
from vehicle_sim.world import VehicleKind

DEFAULTS = {
    ("ardupilot", "copter"): """ANGLE_MAX 3000 WPNAV_SPEED 1000 WPNAV_ACCEL 250 PSC_JERK_XY 5
        GUID_TIMEOUT 3 FS_GCS_ENABLE 0 WP_YAW_BEHAVIOR 2 DISARM_DELAY 10 FENCE_ENABLE 0
        FENCE_TYPE 7 FENCE_ACTION 1 FENCE_RADIUS 150 FENCE_ALT_MAX 100 FENCE_MARGIN 2
        MAV_SYSID 1 MAV_GCS_SYSID 255 MAV1_POSITION 0 MAV_OPTIONS 0""",
    ("ardupilot", "plane"): "AIRSPEED_CRUISE 22 WP_LOITER_RAD 80 NAVL1_PERIOD 15",
    ("px4", "copter"): """COM_OF_LOSS_T 1 COM_OBL_RC_ACT 0 MPC_LAND_SPEED 0.7 SIH_KDV 1
        COM_OBC_LOSS_T 5 NAV_DLL_ACT 0 COM_RC_IN_MODE 1 COM_LOW_BAT_ACT 3 MIS_TAKEOFF_ALT 2.5
        COM_DISARM_PRFLT 10 COM_DISARM_LAND 2 MPC_XY_VEL_MAX 12 MPC_Z_VEL_MAX_UP 3
        MPC_Z_VEL_MAX_DN 1.5 MPC_TILTMAX_AIR 45 MPC_XY_P 0.95 COM_RC_OVERRIDE 1
        COM_RCL_EXCEPT 0 RTL_RETURN_ALT 30 GF_ACTION 2 SIM_GPS_USED 10""",
    ("px4", "plane"): "FW_AIRSPD_TRIM 15 NAV_LOITER_RAD 80 NAV_FW_ALT_RAD 10",
}
CAPABILITIES = (64495, 62319, 59647, 59647)
VERSIONS = {"ardupilot": 0x04070000, "px4": 17891392}


@pytest.mark.parametrize("kind", KINDS)
def test_defaults_and_capabilities_are_those_of_the_documents(
    kind: tuple[str, VehicleKind],
) -> None:
    firmware, make = PERSONALITIES[kind].firmware, PERSONALITIES[kind].make
    assert all(hasattr(make, hook) for hook in core.Autopilot.__annotations__)
    words = DEFAULTS[kind].split()
    rows = {row.name: row for row in firmware.table}
    assert {name: rows[name].default for name in words[::2]} == {
        name: float(value) for name, value in zip(words[::2], words[1::2], strict=True)
    }
    assert all(len(name) <= 16 for name in rows)
    assert not rows.keys() & {"SYSID_THISMAV", "SYSID_MYGCS", "SR0_POSITION"}
    assert firmware.profile.capabilities == CAPABILITIES[KINDS.index(kind)]
    assert firmware.profile.software_version == VERSIONS[kind[0]]
    if kind[0] == "px4":  # in the order that it numbers them in
        own = [name for name in rows if not name.startswith("SIM_")]
        assert own == sorted(own)
        integers = {name for name, row in rows.items() if row.kind is Kind.INT32}
        assert integers >= {"COM_OBL_RC_ACT", "GF_ACTION"}


@pytest.mark.parametrize(
    ("firmware", "streamed", "not_streamed", "not_requested"),
    [
        (
            "ardupilot",
            (33, 32, 30, 245, 85, 87, 162, 193),
            (230, 331, 64, 111, 330, 231),
            (230, 300),
        ),
        ("px4", (30, 32, 33, 436, 31), (0, 42, 9999, 140), (9999, 193)),
    ],
)
def test_what_can_be_streamed_and_asked_for(
    firmware: str,
    streamed: tuple[int, ...],
    not_streamed: tuple[int, ...],
    not_requested: tuple[int, ...],
) -> None:
    profile = PERSONALITIES[firmware, "copter"].firmware.profile
    assert profile.streamable >= set(streamed)
    assert not profile.streamable & set(not_streamed)
    assert profile.requestable >= {148, 242, 49}
    assert not profile.requestable & set(not_requested)


@pytest.mark.parametrize(("firmware", "boot_s"), [("ardupilot", 44.0), ("px4", 7.0)])
def test_ardupilot_tells_texts_where_anybody_was_heard_and_px4_to_ground_stations_only(
    firmware: Firmware, boot_s: float
) -> None:
    vehicle = Link("copter", firmware, PLACE, links=2)
    vehicle.run(boot_s)
    assert vehicle.texts() == vehicle.texts(link=1) == []
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


def test_px4_tells_its_mode_twice_a_second_and_at_once_when_it_changes() -> None:
    vehicle = ready("px4", "copter")
    vehicle.command(511, 436, 50_000)
    since_s = vehicle.now_s
    vehicle.run(10.0)
    assert len(vehicle.all("CURRENT_MODE", since_s=since_s)) == pytest.approx(20, abs=1)
    mission = MISSION[0] << 16 | MISSION[1] << 24
    vehicle.set_mode(mission)
    assert vehicle.last("CURRENT_MODE").custom_mode == mission


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
    assert not vehicle.simulation.armed
    assert not any(heard.frame[2] & 1 for heard in vehicle.heard)


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
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
