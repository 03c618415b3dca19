"""Parameters over the wire, with pymavlink's mavparm as a client; the hash by its definition."""

import math
import re
import struct
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Literal, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavparm
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot import arducopter, arduplane, px4copter, px4plane
from vehicle_sim.autopilots import Autopilot, Reply, Sender, SendMessage
from vehicle_sim.errors import InputError
from vehicle_sim.parameters import RENAMED, Kind, Parameter, Parameters
from vehicle_sim.simulation import Simulation
from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.wire.parameter_protocol import ParameterProtocol
from vehicle_sim.world import VehicleKind, flat_world

Firmware = Literal["ardupilot", "px4"]
HERE = Sender(system=255, component=230, link=1)
THERE = Sender(system=1, component=191, link=0)
STEP_US = 10_000
TABLE = (
    Parameter(name="ANGLE_MAX", default=3000, kind=Kind.INT16),
    Parameter(name="COM_OBL_RC_ACT", default=0, kind=Kind.INT32),
    Parameter(name="GUID_TIMEOUT", default=3.0),
    Parameter(name="SIXTEEN_LETTERS_", default=0.5),
    Parameter(name="TINY", default=-1, kind=Kind.INT8),
)


class Vehicle:
    def __init__(self, firmware: Firmware, *, rows: tuple[Parameter, ...] = TABLE) -> None:
        if firmware == "px4":  # it has these two types only
            rows = tuple(
                Parameter(
                    name=row.name,
                    default=row.default,
                    kind=Kind.REAL32 if row.kind is Kind.REAL32 else Kind.INT32,
                )
                for row in rows
            )
        self.parameters = Parameters(rows, {})
        profile = SimpleNamespace(firmware=firmware)
        autopilot = SimpleNamespace(
            parameters=self.parameters, profile=profile, on_parameter=self.on_parameter
        )
        self.told: list[str] = []
        self.protocol = ParameterProtocol(cast(Autopilot, autopilot))

    def on_parameter(self, name: str) -> list[Reply]:
        self.told.append(name)
        return []

    def ask(self, message: Any, sender: Sender = HERE, now_us: int = 0) -> list[Reply]:
        """By the wire, so that what a float field does to integers happens here too."""
        frame = Packer(sender.system, sender.component).frame(message)
        ((_, got),) = StreamParser(datagrams=True).feed(frame)
        return self.protocol.on_message(got, sender, now_us)

    def set(self, name: str, value: float, kind: int = 9) -> list[Reply]:
        return self.ask(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))

    def read(self, name: str = "", index: int = -1) -> list[Reply]:
        return self.ask(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), index))


def arrived(answer: Reply) -> Any:
    assert isinstance(answer, SendMessage)
    ((_, got),) = StreamParser(datagrams=True).feed(Packer(1, 1).frame(answer.message))
    return got


def as_float(whole: int) -> float:
    (value,) = struct.unpack("<f", struct.pack("<i", whole))
    return cast(float, value)


def as_whole(message: Any) -> int:
    (value,) = struct.unpack("<i", bytes(message.get_msgbuf())[10:14])
    return cast(int, value)


# --- list -----------------------------------------------------------------------------------------


def listed(vehicle: Vehicle, seconds: float = 10.0) -> list[tuple[int, Any]]:
    """Time and message of everything that a listing sends."""
    vehicle.ask(mavlink.MAVLink_param_request_list_message(1, 1))
    got = []
    for now_us in range(0, round(seconds * 1e6), STEP_US):
        if vehicle.protocol.busy:
            got += [(now_us, arrived(answer)) for answer in vehicle.protocol.step(now_us)]
    assert not vehicle.protocol.busy
    return got


def test_a_list_of_1348_takes_a_second_and_a_half_and_never_bursts() -> None:
    rows = tuple(Parameter(name=f"P{k}", default=k / 7) for k in range(1348))
    got = listed(Vehicle("ardupilot", rows=rows))
    assert [value.param_index for _, value in got] == list(range(1348))
    assert {value.param_count for _, value in got} == {1348}
    assert got[-1][0] == pytest.approx(1_500_000, abs=30_000)
    steps = [now_us for now_us, _ in got]
    assert max(steps.count(now_us) for now_us in set(steps)) <= 10


def test_a_late_step_does_not_burst_either() -> None:
    rows = tuple(Parameter(name=f"P{k}", default=k) for k in range(500))
    vehicle = Vehicle("px4", rows=rows)
    vehicle.ask(mavlink.MAVLink_param_request_list_message(1, 1))
    assert len(vehicle.protocol.step(60_000_000)) <= 21


def test_a_list_goes_to_whoever_asked_and_two_can_be_under_way() -> None:
    vehicle = Vehicle("ardupilot")
    for sender in (HERE, THERE):
        vehicle.ask(mavlink.MAVLink_param_request_list_message(1, 1), sender)
    answers = vehicle.protocol.step(10_000_000)
    assert [answer.to for answer in answers if isinstance(answer, SendMessage)] == [HERE] * 5 + [
        THERE
    ] * 5


def test_asking_again_begins_again() -> None:
    vehicle = Vehicle("ardupilot")
    for now_us in range(0, 50_000, STEP_US):
        vehicle.ask(mavlink.MAVLink_param_request_list_message(1, 1), HERE, now_us)
    assert len(vehicle.protocol.step(10_000_000)) == 5


def crc32_from_zero(data: bytes) -> int:
    """Bit by bit, as the polynomial says: neither begun nor ended with ones."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    return crc


def test_px4_sends_the_hash_of_names_and_values_first() -> None:
    vehicle = Vehicle("px4")
    got = [value for _, value in listed(vehicle)]
    assert [value.param_id for value in got] == ["_HASH_CHECK", *(row.name for row in TABLE)]
    assert [value.param_index for value in got] == [65535, *range(5)]
    assert {value.param_count for value in got} == {5}
    raw = b"".join(
        row.name.encode() + struct.pack("<f" if row.kind == 9 else "<i", row.default)
        for row in vehicle.parameters.rows
    )
    assert as_whole(got[0]) & 0xFFFFFFFF == crc32_from_zero(raw)
    (asked,) = vehicle.read("_HASH_CHECK")
    assert as_whole(arrived(asked)) == as_whole(got[0])


def test_setting_the_hash_stops_px4s_list() -> None:
    vehicle = Vehicle("px4")
    vehicle.ask(mavlink.MAVLink_param_request_list_message(1, 1))
    assert vehicle.set("_HASH_CHECK", 0.0, 5) == []
    assert not vehicle.protocol.busy


# --- read -----------------------------------------------------------------------------------------


def test_reading_by_index_and_by_name() -> None:
    for firmware, named in (("ardupilot", 65535), ("px4", 2)):
        vehicle = Vehicle(firmware)  # type: ignore[arg-type]
        (by_index,), (by_name,) = vehicle.read(index=2), vehicle.read("GUID_TIMEOUT")
        assert (arrived(by_index).param_id, arrived(by_index).param_index) == ("GUID_TIMEOUT", 2)
        assert (arrived(by_name).param_value, arrived(by_name).param_index) == (3.0, named)
        assert isinstance(by_name, SendMessage)
        assert by_name.to == HERE
        assert arrived(vehicle.read("SIXTEEN_LETTERS_")[0]).param_id == "SIXTEEN_LETTERS_"


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_nobody_answers_a_question_for_what_there_is_not(firmware: Firmware) -> None:
    vehicle = Vehicle(firmware)
    assert vehicle.read("NO_SUCH_NAME") == []
    assert vehicle.read(index=5) == []
    assert vehicle.set("NO_SUCH_NAME", 1.0) == []


# --- set ------------------------------------------------------------------------------------------


def test_a_set_value_is_told_to_every_link_and_to_the_autopilot() -> None:
    for firmware, index in (("ardupilot", 65535), ("px4", 2)):
        vehicle = Vehicle(firmware)  # type: ignore[arg-type]
        (told,) = vehicle.set("GUID_TIMEOUT", 1.5)
        assert isinstance(told, SendMessage)
        assert told.to is None
        assert (arrived(told).param_value, arrived(told).param_index) == (1.5, index)
        assert vehicle.told == ["GUID_TIMEOUT"]


@pytest.mark.parametrize(
    ("name", "asked", "kept"),
    [
        ("ANGLE_MAX", 4500.0, 4500),
        ("ANGLE_MAX", 4500.6, 4500),
        ("ANGLE_MAX", 4500.995, 4501),
        ("ANGLE_MAX", -7.995, -8),
        ("ANGLE_MAX", 1e9, 32767),
        ("TINY", -1e9, -128),
        ("COM_OBL_RC_ACT", 1e30, 2**31 - 1),
        ("GUID_TIMEOUT", 1e30, 1e30),
    ],
)
def test_ardupilot_converts_to_the_type_whatever_type_is_named(
    name: str, asked: float, kept: float
) -> None:
    vehicle = Vehicle("ardupilot")
    for kind in (9, 2, 6):
        (told,) = vehicle.set(name, asked, kind)
        assert arrived(told).param_value == pytest.approx(kept, rel=1e-6)
        assert vehicle.parameters[name] == pytest.approx(kept, rel=1e-6)
    assert arrived(told).param_type == vehicle.parameters.row(name).kind


@given(value=st.integers(-(2**31), 2**31 - 1).filter(lambda v: v & 0x7FC00000 != 0x7F800000))
def test_px4s_integers_travel_as_their_bits(value: int) -> None:
    vehicle = Vehicle("px4")
    (told,) = vehicle.set("COM_OBL_RC_ACT", as_float(value), 6)
    assert vehicle.parameters["COM_OBL_RC_ACT"] == value
    assert as_whole(arrived(told)) == value
    assert arrived(told).param_type == 6


def test_px4_refuses_a_value_of_another_type_in_silence() -> None:
    vehicle = Vehicle("px4")
    assert vehicle.set("COM_OBL_RC_ACT", 3.0, 9) == []
    assert vehicle.set("GUID_TIMEOUT", as_float(3), 6) == []
    assert vehicle.parameters["GUID_TIMEOUT"] == 3.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_a_number_is_never_kept(value: float) -> None:
    for firmware, answers in (("ardupilot", 0), ("px4", 1)):
        vehicle = Vehicle(firmware)  # type: ignore[arg-type]
        got = vehicle.set("GUID_TIMEOUT", value)
        assert len(got) == answers
        assert all(arrived(answer).param_value == 3.0 for answer in got)
        assert vehicle.parameters["GUID_TIMEOUT"] == 3.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 300.0, -1e30, 7.4])
@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
def test_a_table_takes_only_what_its_types_hold(row: Parameter, value: float) -> None:
    """From inside, as by faults and tests; what is given at the start is refused instead."""
    parameters = Parameters(TABLE, {})
    parameters[row.name] = value
    kept = parameters[row.name]
    if not math.isfinite(value):
        assert kept == row.default
        with pytest.raises(InputError, match="must be a number from"):
            Parameters(TABLE, {row.name: value})
        return
    bits = {Kind.INT8: 8, Kind.INT16: 16, Kind.INT32: 32}.get(row.kind)
    if bits is None:
        assert kept == value
        return
    least, most = -(2 ** (bits - 1)), 2 ** (bits - 1) - 1
    assert kept == min(max(round(value), least), most)
    if not least <= value <= most:
        with pytest.raises(InputError, match=f"it has {bits} bits"):
            Parameters(TABLE, {row.name: value})


@given(name=st.binary(max_size=16), value=st.floats(width=32), kind=st.integers(0, 255))
def test_no_name_value_or_type_does_harm(name: bytes, value: float, kind: int) -> None:
    for firmware in ("ardupilot", "px4"):
        vehicle = Vehicle(firmware)  # type: ignore[arg-type]
        for asked in (name, b"ANGLE_MAX", b"GUID_TIMEOUT"):
            vehicle.ask(mavlink.MAVLink_param_set_message(1, 1, asked, value, kind))
        assert all(math.isfinite(kept) for kept in vehicle.parameters.values().values())
        assert len(listed(vehicle, 1.0)) >= 5


# --- a client that nobody here wrote --------------------------------------------------------------


class Connection:
    """What mavparm needs of a connection."""

    target_system, target_component = 1, 1

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self.arrived: list[Any] = []

    def param_set_send(self, name: str, value: float, parm_type: int | None = None) -> None:
        answers = self.vehicle.set(name, value, 9 if parm_type is None else parm_type)
        self.arrived += [arrived(answer) for answer in answers if isinstance(answer, SendMessage)]

    def recv_match(self, **_: object) -> Any:
        return self.arrived.pop(0)


def test_mavparm_sets_on_either_firmware() -> None:
    for firmware, kind in (("ardupilot", None), ("px4", 6)):
        vehicle = Vehicle(firmware)  # type: ignore[arg-type]
        known = mavparm.MAVParmDict()
        connection = Connection(vehicle)
        assert known.mavset(connection, "COM_OBL_RC_ACT", 5, parm_type=kind)
        assert vehicle.parameters["COM_OBL_RC_ACT"] == 5
        assert known.mavset(connection, "GUID_TIMEOUT", 0.25, parm_type=9)
        assert vehicle.parameters["GUID_TIMEOUT"] == 0.25


# --- what a parameter does ------------------------------------------------------------------------


def ids(simulation: Simulation) -> set[tuple[int, int]]:
    """Who has said something."""
    said = mavlink.MAVLink(None).parse_buffer(b"".join(f for _, f in simulation.take_frames()))
    return {(m.get_srcSystem(), m.get_srcComponent()) for m in said or [] if m.get_srcSystem()}


@pytest.mark.parametrize(
    ("firmware", "given", "before", "after"),
    [
        ("ardupilot", {"MAV_SYSID": 5.0}, (5, 1), {"MAV_SYSID": 9.0}),
        ("px4", {"MAV_SYS_ID": 5.0, "MAV_COMP_ID": 7.0}, (5, 7), {"MAV_SYS_ID": 9.0}),
        ("px4", {}, (1, 1), {"MAV_SYS_ID": 9.0, "MAV_COMP_ID": 50.0}),
    ],
)
def test_the_parameters_of_ids_are_what_it_boots_as(
    firmware: Firmware, given: dict[str, float], before: tuple[int, int], after: dict[str, float]
) -> None:
    """Set at the start, or by PARAM_SET and then a reboot, and not before that."""
    world = flat_world(
        "copter",
        firmware,
        latitude_deg=47.0,
        longitude_deg=8.0,
        altitude_amsl_m=400.0,
        heading_deg=0.0,
    )
    vehicle = replace(world.vehicle, parameters=given)
    simulation = Simulation(replace(world, vehicle=vehicle))

    def run(seconds: float) -> set[tuple[int, int]]:
        for _ in range(round(seconds * 100.0)):
            simulation.step()
        return ids(simulation)

    def acknowledged(system: int, component: int, number: int) -> bool:
        command = mavlink.MAVLink_command_long_message(system, component, number, 0, 1, *[0] * 6)
        simulation.receive(0, command.pack(mavlink.MAVLink(None, 255, 190)))
        said = mavlink.MAVLink(None).parse_buffer(b"".join(f for _, f in simulation.take_frames()))
        return any(m.get_type() == "COMMAND_ACK" for m in said or [])

    assert run(3.0) == {before}
    assert simulation.system_id == before[0]
    assert acknowledged(*before, 400)
    for name, value in after.items():
        simulation.set_parameter(name, value)
    assert run(2.0) == {before}
    simulation.add_fault("reboot")
    run(1.2)
    booted_as = (9, int(after.get("MAV_COMP_ID", before[1])))
    assert run(3.0) == {booted_as}
    assert simulation.system_id == 9
    assert acknowledged(*booted_as, 400)
    assert not acknowledged(*before, 400)


@pytest.mark.parametrize(("kind", "unasked_hz"), [("copter", 0), ("plane", 1)])
def test_the_rates_of_streams_are_parameters_that_count_from_the_boot(
    kind: VehicleKind, unasked_hz: int
) -> None:
    """SRn_ before 4.7.  A reboot loses what REQUEST_DATA_STREAM set, but of a plane."""
    world = flat_world(
        kind,
        "ardupilot",
        latitude_deg=47.0,
        longitude_deg=8.0,
        altitude_amsl_m=400.0,
        heading_deg=0.0,
    )
    vehicle = replace(world.vehicle, parameters={"MAV1_POSITION": 10.0})
    simulation, mav = Simulation(replace(world, vehicle=vehicle)), mavlink.MAVLink(None, 255, 190)

    def rate_hz(kind: str) -> float:
        parser = mavlink.MAVLink(None)
        said: list[str] = []
        for k in range(400):
            simulation.step()
            frames = [frame for _, frame in simulation.take_frames()]
            if k >= 200:
                said += [m.get_type() for m in parser.parse_buffer(b"".join(frames)) or []]
        return said.count(kind) / 2.0

    assert rate_hz("GLOBAL_POSITION_INT") == 10.0
    assert rate_hz("ATTITUDE") == unasked_hz
    simulation.set_parameter("MAV1_EXTRA1", 4.0)  # from the next boot on
    assert rate_hz("ATTITUDE") == unasked_hz
    ask = mavlink.MAVLink_request_data_stream_message(1, 1, 11, 5, 1)  # EXTRA2
    simulation.receive(0, ask.pack(mav))
    assert rate_hz("VFR_HUD") == 5.0
    assert simulation.parameters["MAV1_EXTRA2"] == 5.0
    simulation.add_fault("reboot")
    for _ in range(120):
        simulation.step()
    assert rate_hz("GLOBAL_POSITION_INT") == 10.0
    assert rate_hz("ATTITUDE") == 4.0
    assert rate_hz("VFR_HUD") == (5.0 if kind == "plane" else 0.0)


@pytest.mark.parametrize(
    ("table", "name", "words"),
    [
        (arducopter.FIRMWARE.table, "SYSID_THISMAV", "It is called MAV_SYSID here."),
        (arducopter.FIRMWARE.table, "SYSID_MYGCS", "It is called MAV_GCS_SYSID here."),
        (arducopter.FIRMWARE.table, "SR0_POSITION", "It is called MAV1_POSITION here."),
        (arducopter.FIRMWARE.table, "SR1_EXTRA1", "It is called MAV2_EXTRA1 here."),
        (
            arducopter.FIRMWARE.table,
            "SR2_EXTRA1",
            "MAV2_EXTRA1 here, for the second link; the others have",
        ),
        (arducopter.FIRMWARE.table, "WP_SPD_DN", "It is called WPNAV_SPEED_DN here, in cm/s."),
        (arducopter.FIRMWARE.table, "MAV_SYS_ID", "It is called MAV_SYSID here."),
        (arduplane.FIRMWARE.table, "TRIM_ARSPD_CM", "It is called AIRSPEED_CRUISE here, in m/s."),
        (arduplane.FIRMWARE.table, "FS_GCS_ENABLE", "It is called FS_GCS_ENABL here."),
        (px4copter.FIRMWARE.table, "SYSID_THISMAV", "It is called MAV_SYS_ID here."),
        (
            px4copter.FIRMWARE.table,
            "COM_OBL_ACT",
            "It is called COM_OBL_RC_ACT here.",
        ),
        (arducopter.FIRMWARE.table, "GUID_TIMEOUTS", "Did you mean GUID_TIMEOUT?"),
        (arducopter.FIRMWARE.table, "QQQQQQQQ", "Leave it out."),
    ],
)
def test_names_of_other_releases_are_told_by_the_one_of_here(
    table: tuple[Parameter, ...], name: str, words: str
) -> None:
    with pytest.raises(InputError) as refused:
        Parameters(table, {name: 1.0})
    assert words in str(refused.value)


def test_every_name_of_another_release_is_known_by_its_new_one_somewhere() -> None:
    rows = {row.name for row in (*arducopter.FIRMWARE.table, *arduplane.FIRMWARE.table)}
    rows |= {row.name for row in (*px4copter.FIRMWARE.table, *px4plane.FIRMWARE.table)}
    for was, now, *_ in RENAMED:
        pattern = now.replace("\\1", r"\w+")
        assert any(re.fullmatch(pattern, name) for name in rows), f"{was}: there is no {now}"
