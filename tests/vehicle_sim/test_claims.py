"""What a personality says of itself, it has: its capabilities and its modes, one by one."""

import struct
from collections.abc import Callable
from typing import Any, Final

import pytest
from harness import KINDS, PLACE, VEHICLE, ZERO, Link, flying, local, ready
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot import arducopter, arduplane, px4

CAN: Final = {
    name.removeprefix("MAV_PROTOCOL_CAPABILITY_"): getattr(mavlink, name)
    for name in vars(mavlink)
    if name.startswith("MAV_PROTOCOL_CAPABILITY_") and not name.endswith("ENUM_END")
}
ACCEPTED: Final = 0
PX4: Final = {mode.name: mode.number for mode in px4.MODES}
OFFBOARD, HOLD = PX4["Offboard"], PX4["Hold"]
PLACE_E7: Final = [round(angle * 1e7) for angle in PLACE[:2]]


def plan(kind: int, *commands: int, first: float = 0.0, degrees: bool = False) -> list[Any]:
    """Items of these commands, one north of the other, every second one farther east."""
    items, made = [], mavlink.MAVLink_mission_item_int_message
    for seq, command in enumerate(commands):
        x, y = PLACE_E7[0] + 10_000 * seq, PLACE_E7[1] + 10_000 * (seq % 2)
        head = (*VEHICLE, seq, {1: 0, 2: 3}.get(kind, 3), command, 0, 1, first, 0, 0, 0)
        if degrees:
            place = (x * 1e-7, y * 1e-7, 30.0)
            items.append(mavlink.MAVLink_mission_item_message(*head, *place, kind))
        else:
            items.append(made(*head, x, y, 30.0, kind))
    return items


def takes(kind: int, *commands: int, **how: Any) -> Callable[[Link], bool]:
    return lambda client: client.upload(plan(kind, *commands, **how), kind) == ACCEPTED


def answer(client: Link, message: Any, kind: str) -> Any:
    client.send(message)
    client.run(0.05)
    return client.last(kind)


def own_id(client: Link) -> float:
    name = b"MAV_SYS_ID" if client.firmware == "px4" else b"MAV_SYSID"
    asked = mavlink.MAVLink_param_request_read_message(*VEHICLE, name, -1)
    return float(answer(client, asked, "PARAM_VALUE").param_value)


def flies(aim: Any) -> Callable[[Link], bool]:
    """200 m north and 80 m higher: a copter goes there, a plane climbs at least."""

    def shown(client: Link) -> bool:
        before, client.aim = client.last("GLOBAL_POSITION_INT"), lambda _: aim
        client.run(1.0)
        assert client.firmware == "ardupilot" or client.set_mode(OFFBOARD) == ACCEPTED
        client.run(8.0)
        after = client.last("GLOBAL_POSITION_INT")
        return bool(
            (after.lat - before.lat if client.kind == "copter" else after.alt - before.alt) > 1000
        )

    return shown


AHEAD = mavlink.MAVLink_set_position_target_global_int_message(
    *(0, *VEHICLE, 6, 0xDF8, PLACE_E7[0] + 18_000, PLACE_E7[1], 120.0, *ZERO, *ZERO, 0.0, 0.0)
)
RESET = mavlink.MAVLink_file_transfer_protocol_message(0, *VEHICLE, bytes((1, 0, 0, 2, *[0] * 247)))
SHOWN: Final[dict[str, Callable[[Link], Any]]] = {
    "MISSION_FLOAT": takes(0, 22, 16, 16, degrees=True),
    "MISSION_INT": takes(0, 22, 16, 16),
    "MISSION_FENCE": takes(1, 5001, 5001, 5001, first=3.0),
    "MISSION_RALLY": takes(2, 5100),
    "PARAM_FLOAT": own_id,
    "PARAM_ENCODE_BYTEWISE": lambda it: struct.pack("<f", own_id(it)) == struct.pack("<i", 1),
    "PARAM_ENCODE_C_CAST": lambda it: own_id(it) == 1.0,
    "COMMAND_INT": lambda it: it.command(512, 148, 0, 0, 0, 0, 0, 0, frame=0) == ACCEPTED,
    "FTP": lambda it: answer(it, RESET, "FILE_TRANSFER_PROTOCOL").payload[3] == 128,
    "MAVLINK2": lambda it: {heard.frame[0] for heard in it.run(1.0)} == {0xFD},
    "SET_POSITION_TARGET_LOCAL_NED": flies(local((200.0, 0.0, -120.0), mask=0xDF8)),
    "SET_POSITION_TARGET_GLOBAL_INT": flies(AHEAD),
}
NOT_FLOWN: Final = {"SET_ATTITUDE_TARGET", "TERRAIN", "FLIGHT_TERMINATION", "COMPASS_CALIBRATION"}
"""The real ones say so, and clients compare."""


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_what_it_says_that_it_can_do_it_does(kind: Any) -> None:
    client = ready(*kind)
    assert client.command(512, 148) == ACCEPTED
    capabilities = client.last("AUTOPILOT_VERSION").capabilities
    claimed = {name for name, bit in CAN.items() if capabilities & bit}
    assert sum(CAN[name] for name in claimed) == capabilities
    for name in sorted(claimed - NOT_FLOWN):
        of = flying if name.startswith("SET_POSITION") else ready
        assert SHOWN[name](of(*kind)), f"{kind} says that it can do {name}"


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_every_mode_is_flown_or_refused_with_a_word(kind: Any) -> None:
    client, is_px4 = flying(*kind), kind[0] == "px4"
    back = HOLD if is_px4 else {"copter": 4, "plane": 15}[kind[1]]
    firmware = arducopter.FIRMWARE if kind[1] == "copter" else arduplane.FIRMWARE
    modes = px4.MODES if is_px4 else firmware.modes
    numbers = {mode.name: mode.number for mode in modes}
    for mode in modes:
        since_s = client.now_s
        result, now = client.set_mode(mode.number), client.simulation.mode_name
        client.run(0.3)  # STABILIZE falls
        if result == ACCEPTED:
            assert numbers[now] == mode.number
            assert client.simulation.armed, mode.name
        else:
            assert is_px4 or client.texts(since_s), mode.name
        assert client.set_mode(back) == ACCEPTED
        client.run(1.0)
        assert client.last("HEARTBEAT").custom_mode == back


@pytest.mark.parametrize("kind", KINDS[2:], ids="-".join)
def test_px4_returns_in_mode_return_when_its_mission_says_so(kind: Any) -> None:
    client, (*way, home) = ready(*kind), plan(0, 22, 16, 20)
    home.frame = 2
    assert client.upload([*way, home], 0) == ACCEPTED
    assert client.set_mode(PX4["Mission"]) == ACCEPTED
    assert client.command(400, 1) == ACCEPTED
    returns = PX4["Return"]
    assert client.until(lambda: client.last("HEARTBEAT").custom_mode == returns, 180.0) < 180.0
