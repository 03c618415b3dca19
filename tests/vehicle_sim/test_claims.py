"""What a personality says of itself, it has: its capabilities and its modes, one by one."""

import struct
from collections.abc import Callable
from typing import Any, Final

import pytest
from harness import KINDS, PLACE, Link, flying, ready
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot import arducopter, arduplane, px4

Kind = tuple[Any, Any]
CAN: Final = {
    name.removeprefix("MAV_PROTOCOL_CAPABILITY_"): getattr(mavlink, name)
    for name in vars(mavlink)
    if name.startswith("MAV_PROTOCOL_CAPABILITY_") and not name.endswith("ENUM_END")
}
ACCEPTED: Final = 0
IDS: Final = (1, 1)
PX4S = KINDS[2:]
PX4: Final = {mode.name: mode.number for mode in px4.MODES}


def ask(client: Link, message: Any, kind: str) -> Any:
    client.send(message)
    for _ in range(60):
        for heard in client.run(0.05):
            if heard.kind == kind:
                return heard.message
    raise AssertionError(f"no {kind} within 3 s")


def stream(client: Link, make: Callable[[], Any], seconds: float) -> None:
    """Setpoints at 20 Hz, in the mode that flies them."""
    client.aim = lambda _: make()
    if client.firmware == "px4":
        client.run(1.0)
        assert client.set_mode(PX4["Offboard"]) == ACCEPTED
    client.run(seconds)


def mode(client: Link) -> int:
    """The one that the next heartbeat tells."""
    client.run(1.0)
    return int(client.last("HEARTBEAT").custom_mode)


# --- what shows that a capability is there


def takes_a_plan(client: Link, plan: int, *commands: int, as_float: bool = False) -> None:
    items = []
    for seq, command in enumerate(commands):
        place: Any = (PLACE[0] + 0.001 * seq, PLACE[1] + 0.001 * seq * (seq % 2))
        make = mavlink.MAVLink_mission_item_message
        if not as_float:
            make = mavlink.MAVLink_mission_item_int_message
            place = [round(angle * 1e7) for angle in place]
        frame = 0 if plan == 1 else 2 if command == 20 else 3
        first = 3.0 if plan == 1 else 0.0
        head = (*IDS, seq, frame, command, 0, 1, first, 0, 0, 0)
        items.append(make(*head, *place, 30.0, plan))
    assert client.upload(items, plan) == ACCEPTED


def reads_a_parameter(client: Link) -> Any:
    name = b"MAV_SYS_ID" if client.firmware == "px4" else b"MAV_SYSID"
    return ask(client, mavlink.MAVLink_param_request_read_message(*IDS, name, -1), "PARAM_VALUE")


def codes_whole_numbers_bytewise(client: Link) -> None:
    value = reads_a_parameter(client)
    assert struct.unpack("<i", struct.pack("<f", value.param_value)) == (1,)


def codes_whole_numbers_as_floats(client: Link) -> None:
    assert reads_a_parameter(client).param_value == 1.0


def obeys_command_int(client: Link) -> None:
    request = mavlink.MAVLink_command_int_message(*IDS, 0, 512, 0, 0, 148, 0, 0, 0, 0, 0, 0)
    assert ask(client, request, "COMMAND_ACK").result == ACCEPTED
    assert client.last("AUTOPILOT_VERSION")


def transfers_files(client: Link) -> None:
    reset = mavlink.MAVLink_file_transfer_protocol_message(0, *IDS, bytes((1, 0, 0, 2, *[0] * 247)))
    assert ask(client, reset, "FILE_TRANSFER_PROTOCOL").payload[3] == 128  # ACK


def flies_to(client: Link, frame_of: Callable[[float], Any]) -> None:
    before = client.last("GLOBAL_POSITION_INT")
    stream(client, lambda: frame_of(200.0), 8.0)
    after = client.last("GLOBAL_POSITION_INT")
    moved = after.lat - before.lat if client.kind == "copter" else after.alt - before.alt
    assert moved > 1000


def flies_local_setpoints(client: Link) -> None:
    nothing = (0.0,) * 6
    flies_to(
        client,
        lambda north_m: mavlink.MAVLink_set_position_target_local_ned_message(
            0, *IDS, 1, 0xDF8, north_m, 0.0, -60.0, *nothing, 0.0, 0.0
        ),
    )


def flies_global_setpoints(client: Link) -> None:
    nothing = (0.0,) * 6
    flies_to(
        client,
        lambda north_m: mavlink.MAVLink_set_position_target_global_int_message(
            0, *IDS, 6, 0xDF8, round((PLACE[0] + north_m / 111e3) * 1e7), round(PLACE[1] * 1e7),
            120.0, *nothing, 0.0, 0.0,
        ),
    )  # fmt: skip


def speaks_mavlink_2(client: Link) -> None:
    assert {heard.frame[0] for heard in client.run(1.0)} == {mavlink.PROTOCOL_MARKER_V2}


SHOWN: Final[dict[str, Callable[[Link], object]]] = {
    "MISSION_FLOAT": lambda client: takes_a_plan(client, 0, 22, 16, 16, as_float=True),
    "PARAM_FLOAT": reads_a_parameter,
    "MISSION_INT": lambda client: takes_a_plan(client, 0, 22, 16, 16),
    "COMMAND_INT": obeys_command_int,
    "PARAM_ENCODE_BYTEWISE": codes_whole_numbers_bytewise,
    "PARAM_ENCODE_C_CAST": codes_whole_numbers_as_floats,
    "FTP": transfers_files,
    "SET_POSITION_TARGET_LOCAL_NED": flies_local_setpoints,
    "SET_POSITION_TARGET_GLOBAL_INT": flies_global_setpoints,
    "MAVLINK2": speaks_mavlink_2,
    "MISSION_FENCE": lambda client: takes_a_plan(client, 1, 5001, 5001, 5001),
    "MISSION_RALLY": lambda client: takes_a_plan(client, 2, 5100),
}


NOT_FLOWN: Final = {"SET_ATTITUDE_TARGET", "TERRAIN", "FLIGHT_TERMINATION", "COMPASS_CALIBRATION"}
"""The real ones say so, and clients compare."""
IN_FLIGHT: Final = {
    *("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"),
}


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_what_it_says_that_it_can_do_it_does(kind: Kind) -> None:
    request = mavlink.MAVLink_command_long_message(*IDS, 512, 0, 148, 0, 0, 0, 0, 0, 0)
    capabilities = ask(ready(*kind), request, "AUTOPILOT_VERSION").capabilities
    claimed = [name for name, bit in CAN.items() if capabilities & bit]
    assert sum(CAN[name] for name in claimed) == capabilities
    for name in {*claimed} - NOT_FLOWN:
        try:
            SHOWN[name](flying(*kind) if name in IN_FLIGHT else ready(*kind))
        except (AssertionError, KeyError) as error:
            error.add_note(f"{kind} says that it can do {name}")
            raise


# --- modes


def modes_of(kind: Kind) -> dict[int, str]:
    if kind[0] == "px4":
        return px4.MODE_NAMES
    firmware = arducopter.FIRMWARE if kind[1] == "copter" else arduplane.FIRMWARE
    return {mode.number: mode.name for mode in firmware.modes}


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_every_mode_is_flown_or_refused_with_a_word(kind: Kind) -> None:
    client = flying(*kind)
    back = PX4["Hold"] if client.firmware == "px4" else {"copter": 4, "plane": 15}[client.kind]
    for number, name in modes_of((client.firmware, client.kind)).items():
        since_s = client.now_s
        result = client.set_mode(number)
        client.run(0.3)  # STABILIZE falls
        if result == ACCEPTED:
            beats = client.all("HEARTBEAT", since_s=since_s)
            assert number in ([h.message.custom_mode for h in beats] or [mode(client)]), name
            assert client.simulation.armed, name
        else:
            assert client.texts(since_s) or client.firmware == "px4", name
        assert client.set_mode(back) == ACCEPTED
        client.run(1.0)


# --- what was missing


@pytest.mark.parametrize("kind", PX4S, ids="-".join)
def test_px4_returns_in_mode_return_when_its_mission_says_so(kind: Kind) -> None:
    client = ready(*kind)
    takes_a_plan(client, 0, 22, 16, 20)
    assert client.set_mode(PX4["Mission"]) == ACCEPTED
    assert client.command(400, 1) == ACCEPTED
    returns = PX4["Return"]
    assert client.until(lambda: client.last("HEARTBEAT").custom_mode == returns, 180.0) < 180.0
