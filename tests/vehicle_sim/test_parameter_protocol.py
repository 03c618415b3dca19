"""Parameters over the wire; pymavlink's own client sets some in tests/interop."""

import math
import struct
from typing import Any

import pytest
from harness import VEHICLE, Rig
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.parameters import Firmware

BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
FLOAT = {"ardupilot": "GUID_TIMEOUT", "px4": "COM_DISARM_LAND"}
LIST = mavlink.MAVLink_param_request_list_message(*VEHICLE)
REAL, INT8, INT32 = 9, 2, 6


def values(vehicle: Rig, message: Any) -> list[Any]:
    """The PARAM_VALUE that answer this on link 0."""
    return [each for each in vehicle.ask(message) if each.get_type() == "PARAM_VALUE"]


def read(vehicle: Rig, name: str = "", index: int = -1) -> list[Any]:
    asked = mavlink.MAVLink_param_request_read_message(*VEHICLE, name.encode(), index)
    return values(vehicle, asked)


def put(vehicle: Rig, name: str, value: float, kind: int = REAL) -> list[Any]:
    return values(vehicle, mavlink.MAVLink_param_set_message(*VEHICLE, name.encode(), value, kind))


def as_float(whole: int) -> Any:
    return struct.unpack("<f", struct.pack("<i", whole))[0]


@BOTH
def test_values_are_listed_in_order_read_by_index_or_name_told_to_every_link_and_kept(
    firmware: Firmware,
) -> None:
    vehicle, name = Rig(firmware, links=2), FLOAT[firmware]
    table = vehicle.simulation.parameters
    listed = [(m.param_id, m.param_index, m.param_count) for m in values(vehicle, LIST)]
    assert listed == [(each, k, len(table)) for k, each in enumerate(table)]
    assert vehicle.all("PARAM_VALUE", link=1) == []  # it has not asked
    place = list(table).index(name)
    for (message,) in (read(vehicle, index=place), read(vehicle, name)):
        assert (message.param_id, message.param_index) == (name, place)
        assert message.param_value == table[name]
    assert read(vehicle, "NO_SUCH_NAME") == read(vehicle, index=len(table)) == []
    assert put(vehicle, "NO_SUCH_NAME", 1.0) == []
    begun_s = vehicle.now_s
    (told,) = put(vehicle, name, 1.5)
    (there,) = [h.message for h in vehicle.all("PARAM_VALUE", link=1, since_s=begun_s)]
    assert told.param_value == there.param_value == table[name] == 1.5
    (told_again,) = put(vehicle, name, math.nan)  # neither firmware keeps it
    assert told_again.param_value == table[name] == 1.5


@pytest.mark.parametrize(
    ("name", "asked", "kept"),
    [
        ("ANGLE_MAX", 4500.6, 4501),
        *(("ANGLE_MAX", 1e9, 32767), ("DISARM_DELAY", -1e9, -128)),
        *(("RTL_LOIT_TIME", 1e30, 2**31 - 1), ("GUID_TIMEOUT", 1e30, 1e30)),
    ],
)
def test_ardupilot_converts_to_the_type_whatever_type_is_named(
    name: str, asked: float, kept: float
) -> None:
    vehicle = Rig("ardupilot", links=2)
    for kind in (REAL, INT8, INT32):
        (told,) = put(vehicle, name, asked, kind)
        assert told.param_value == pytest.approx(kept, rel=1e-6)
        assert vehicle.simulation.parameters[name] == pytest.approx(kept, rel=1e-6)


@given(value=st.integers(-(2**31), 2**31 - 1).filter(lambda v: v & 0x7FC00000 != 0x7F800000))
@settings(max_examples=20)
def test_px4s_integers_travel_as_their_bits_and_no_other_type_is_taken(value: int) -> None:
    vehicle, name = Rig("px4", links=2), "COM_OBL_RC_ACT"
    (told,) = put(vehicle, name, as_float(value), INT32)
    assert struct.unpack("<i", bytes(told.get_msgbuf())[10:14]) == (value,)
    assert vehicle.simulation.parameters[name] == value
    assert told.param_type == INT32
    assert put(vehicle, name, 3.0, REAL) == put(vehicle, FLOAT["px4"], as_float(3), INT32) == []


# --- what a parameter does ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("firmware", "names"), [("ardupilot", ("MAV_SYSID",)), ("px4", ("MAV_SYS_ID", "MAV_COMP_ID"))]
)
def test_the_parameters_of_ids_count_from_the_next_boot_on(
    firmware: Firmware, names: tuple[str, ...]
) -> None:
    vehicle, after = Rig(firmware, links=2), (9, 50 if firmware == "px4" else 1)
    for name, value in zip(names, after, strict=False):
        vehicle.simulation.set_parameter(name, value)
    assert {each.source for each in vehicle.run(3.0).heard} == {VEHICLE}
    vehicle.fault("reboot")
    vehicle.run(1.2).heard.clear()
    assert {each.source for each in vehicle.run(3.0).heard} == {after}
    for target, obeys in ((after, True), (VEHICLE, False)):
        order = mavlink.MAVLink_command_long_message(*target, 400, 0, 1, *[0] * 6)
        assert any(each.get_type() == "COMMAND_ACK" for each in vehicle.ask(order)) is obeys
