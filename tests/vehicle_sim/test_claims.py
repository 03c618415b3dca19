"""What a personality says of itself, it has: its capabilities and its modes, one by one.

Everything goes over the wire: a client on UDP, as far as possible one for all four.
"""

import math
import socket
import struct
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots.ardupilot import copter_table, plane_modes
from vehicle_sim.autopilots.px4.modes import CUSTOM_MODES, NAMES, Mode
from vehicle_sim.testing import Simulator

Kind = tuple[str, str]
KINDS: Final = [
    ("ardupilot", "copter"),
    ("ardupilot", "plane"),
    ("px4", "copter"),
    ("px4", "plane"),
]
CAN: Final = {
    name.removeprefix("MAV_PROTOCOL_CAPABILITY_"): getattr(mavlink, name)
    for name in vars(mavlink)
    if name.startswith("MAV_PROTOCOL_CAPABILITY_") and not name.endswith("ENUM_END")
}
HOME: Final = (47.397742, 8.545594, 488.0)
ACCEPTED: Final = 0
IDS: Final = (1, 1)


class Client:
    """Somebody at the other end of the link."""

    def __init__(self, kind: Kind) -> None:
        self.firmware, self.vehicle = kind
        self.simulator = Simulator(autopilot=kind[0], vehicle=kind[1], home=HOME, ready=True)  # type: ignore[arg-type]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", self.simulator.port))
        self._socket.setblocking(False)
        self._mav = mavlink.MAVLink(None, 255, 190)
        self._mav.robust_parsing = True
        self.heard: list[Any] = []
        self.marks: set[int] = set()
        self.streamed: Callable[[], Any] | None = None
        self.run(1.0)
        for number in (24, 30, 33):  # GPS_RAW_INT, ATTITUDE, GLOBAL_POSITION_INT
            self.command(511, number, 100_000)

    def close(self) -> None:
        self._socket.close()
        self.simulator.close()

    def send(self, message: Any) -> None:
        self._socket.send(message.pack(self._mav))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            self.simulator.advance(0.05, meanwhile=self._read)
            if round(self.simulator.now_s / 0.05) % 20 == 0:
                self.send(self._mav.heartbeat_encode(6, 8, 0, 0, 4))
            if self.streamed is not None:
                self.send(self.streamed())

    def _read(self) -> None:
        while True:
            try:
                data = self._socket.recv(2048)
            except BlockingIOError:
                return
            self.marks.add(data[0])
            self.heard += self._mav.parse_buffer(data) or []

    def wait_for(self, kind: str, since: int = 0, within_s: float = 3.0) -> Any:
        for _ in range(round(within_s / 0.05)):
            found = [m for m in self.heard[since:] if m.get_type() == kind]
            if found:
                return found[-1]
            self.run(0.05)
        raise AssertionError(f"no {kind} within {within_s} s")

    def ask(self, message: Any, kind: str) -> Any:
        since = len(self.heard)
        self.send(message)
        return self.wait_for(kind, since)

    def command(self, number: int, *parameters: float) -> int:
        """The last of its results."""
        padded = (*parameters, *(0.0,) * (7 - len(parameters)))
        since = len(self.heard)
        self.send(self._mav.command_long_encode(*IDS, number, 0, *padded))
        self.run(0.3)
        results = [m.result for m in self.heard[since:] if m.get_type() == "COMMAND_ACK"]
        assert results, f"no answer to {number}"
        return int(results[-1])

    def set_mode(self, custom: int) -> int:
        if self.firmware == "px4":
            return self.command(176, 1, custom >> 16 & 0xFF, custom >> 24)
        return self.command(176, 1, custom)

    @property
    def mode(self) -> int:
        since = len(self.heard)
        return int(self.wait_for("HEARTBEAT", since).custom_mode)

    def last(self, kind: str) -> Any:
        return next(m for m in reversed(self.heard) if m.get_type() == kind)

    def texts(self, since: int) -> str:
        return " ".join(m.text for m in self.heard[since:] if m.get_type() == "STATUSTEXT")

    def fly_up(self) -> None:
        """Some 40 m up, in the mode in which it takes setpoints."""
        if self.firmware == "px4":
            assert self.command(22, 0, 0, 0, 0, *HOME[:2], HOME[2] + 40.0) == ACCEPTED
            assert self.command(400, 1) == ACCEPTED
            self.run(30.0)
            return
        if self.vehicle == "copter":
            assert self.set_mode(copter_table.GUIDED) == ACCEPTED
            assert self.command(400, 1) == ACCEPTED
            assert self.command(22, 0, 0, 0, 0, 0, 0, 40.0) == ACCEPTED
            self.run(25.0)
            return
        assert self.set_mode(plane_modes.Mode.TAKEOFF) == ACCEPTED
        assert self.command(400, 1) == ACCEPTED
        self.run(25.0)
        assert self.set_mode(plane_modes.Mode.GUIDED) == ACCEPTED

    def stream(self, make: Callable[[], Any], seconds: float) -> None:
        """Setpoints at 20 Hz, in the mode that flies them."""
        self.streamed = make
        if self.firmware == "px4":
            self.run(1.0)
            assert self.set_mode(CUSTOM_MODES[Mode.OFFBOARD]) == ACCEPTED
        self.run(seconds)


@pytest.fixture
def client(request: pytest.FixtureRequest) -> Iterator[Client]:
    made = Client(request.param)
    yield made
    made.close()


# --- what shows that a capability is there


def takes_a_plan(client: Client, plan: int, *commands: int, as_float: bool = False) -> None:
    since = len(client.heard)
    client.send(mavlink.MAVLink_mission_count_message(*IDS, len(commands), plan))
    answered: set[int] = set()
    for _ in range(100):
        client.run(0.05)
        heard = client.heard[since:]
        acks = [m for m in heard if m.get_type() == "MISSION_ACK"]
        if acks:
            assert acks[-1].type == ACCEPTED
            return
        for wish in heard:
            if wish.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                if wish.seq in answered:
                    continue
                answered.add(wish.seq)
                angle = 0.001 * wish.seq
                latitude, longitude = HOME[0] + angle, HOME[1] + angle * (wish.seq % 2)
                place = (latitude, longitude) if as_float else (latitude * 1e7, longitude * 1e7)
                make = mavlink.MAVLink_mission_item_message
                if not as_float:
                    make = mavlink.MAVLink_mission_item_int_message
                    place = (round(place[0]), round(place[1]))
                frame = 0 if plan == 1 else 2 if commands[wish.seq] == 20 else 3
                first = 3.0 if plan == 1 else 0.0
                client.send(
                    make(*IDS, wish.seq, frame, commands[wish.seq], 0, 1, first,
                         0, 0, 0, *place, 30.0, plan)
                )  # fmt: skip
    raise AssertionError("the plan was never acknowledged")


def reads_a_parameter(client: Client) -> Any:
    name = b"MAV_SYS_ID" if client.firmware == "px4" else b"MAV_SYSID"
    return client.ask(mavlink.MAVLink_param_request_read_message(*IDS, name, -1), "PARAM_VALUE")


def codes_whole_numbers_bytewise(client: Client) -> None:
    value = reads_a_parameter(client)
    assert struct.unpack("<i", struct.pack("<f", value.param_value)) == (1,)


def codes_whole_numbers_as_floats(client: Client) -> None:
    assert reads_a_parameter(client).param_value == 1.0


def obeys_command_int(client: Client) -> None:
    request = mavlink.MAVLink_command_int_message(*IDS, 0, 512, 0, 0, 148, 0, 0, 0, 0, 0, 0)
    assert client.ask(request, "COMMAND_ACK").result == ACCEPTED
    assert client.last("AUTOPILOT_VERSION")


def transfers_files(client: Client) -> None:
    reset = mavlink.MAVLink_file_transfer_protocol_message(0, *IDS, bytes((1, 0, 0, 2, *[0] * 247)))
    assert client.ask(reset, "FILE_TRANSFER_PROTOCOL").payload[3] == 128  # ACK


def flies_by_attitude(client: Client) -> None:
    """Banked by 20 degrees to the right and held there; a copter then goes that way."""
    client.fly_up()
    half = math.radians(10.0)
    yaw = client.last("ATTITUDE").yaw
    w, z = math.cos(yaw / 2), math.sin(yaw / 2)
    roll = (math.cos(half) * w, math.sin(half) * w, math.sin(half) * z, math.cos(half) * z)

    def banked() -> Any:
        return mavlink.MAVLink_set_attitude_target_message(0, *IDS, 7, roll, 0, 0, 0, 0.5)

    client.stream(banked, 3.0)
    assert math.degrees(client.last("ATTITUDE").roll) == pytest.approx(20.0, abs=3.0)
    assert not client.simulator.landed


def flies_to(client: Client, frame_of: Callable[[float], Any]) -> None:
    client.fly_up()
    before = client.last("GLOBAL_POSITION_INT")
    client.stream(lambda: frame_of(200.0), 8.0)
    after = client.last("GLOBAL_POSITION_INT")
    moved = after.lat - before.lat if client.vehicle == "copter" else after.alt - before.alt
    assert moved > 1000


def flies_local_setpoints(client: Client) -> None:
    nothing = (0.0,) * 6
    flies_to(
        client,
        lambda north_m: mavlink.MAVLink_set_position_target_local_ned_message(
            0, *IDS, 1, 0xDF8, north_m, 0.0, -60.0, *nothing, 0.0, 0.0
        ),
    )


def flies_global_setpoints(client: Client) -> None:
    nothing = (0.0,) * 6
    flies_to(
        client,
        lambda north_m: mavlink.MAVLink_set_position_target_global_int_message(
            0, *IDS, 6, 0xDF8, round((HOME[0] + north_m / 111e3) * 1e7), round(HOME[1] * 1e7),
            120.0, *nothing, 0.0, 0.0,
        ),
    )  # fmt: skip


def answers_questions_about_terrain(client: Client) -> None:
    check = mavlink.MAVLink_terrain_check_message(round(HOME[0] * 1e7), round(HOME[1] * 1e7))
    report = client.ask(check, "TERRAIN_REPORT")
    assert (report.lat, report.lon) == (check.lat, check.lon)


def terminates_the_flight(client: Client) -> None:
    client.fly_up()
    assert client.command(185, 1) == ACCEPTED
    assert not client.simulator.armed


def calibrates_its_compass(client: Client) -> None:
    assert client.command(42424, 0, 0, 1) == ACCEPTED
    assert client.command(42426) == ACCEPTED


def speaks_mavlink_2(client: Client) -> None:
    assert client.marks == {mavlink.PROTOCOL_MARKER_V2}


SHOWN: Final[dict[str, Callable[[Client], object]]] = {
    "MISSION_FLOAT": lambda client: takes_a_plan(client, 0, 22, 16, 16, as_float=True),
    "PARAM_FLOAT": reads_a_parameter,
    "MISSION_INT": lambda client: takes_a_plan(client, 0, 22, 16, 16),
    "COMMAND_INT": obeys_command_int,
    "PARAM_ENCODE_BYTEWISE": codes_whole_numbers_bytewise,
    "PARAM_ENCODE_C_CAST": codes_whole_numbers_as_floats,
    "FTP": transfers_files,
    "SET_ATTITUDE_TARGET": flies_by_attitude,
    "SET_POSITION_TARGET_LOCAL_NED": flies_local_setpoints,
    "SET_POSITION_TARGET_GLOBAL_INT": flies_global_setpoints,
    "TERRAIN": answers_questions_about_terrain,
    "FLIGHT_TERMINATION": terminates_the_flight,
    "COMPASS_CALIBRATION": calibrates_its_compass,
    "MAVLINK2": speaks_mavlink_2,
    "MISSION_FENCE": lambda client: takes_a_plan(client, 1, 5001, 5001, 5001),
    "MISSION_RALLY": lambda client: takes_a_plan(client, 2, 5100),
}


def claimed(kind: Kind) -> list[str]:
    client = Client(kind)
    request = mavlink.MAVLink_command_long_message(*IDS, 512, 0, 148, 0, 0, 0, 0, 0, 0)
    capabilities = client.ask(request, "AUTOPILOT_VERSION").capabilities
    client.close()
    names = [name for name, bit in CAN.items() if capabilities & bit]
    assert sum(CAN[name] for name in names) == capabilities
    return names


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_what_it_says_that_it_can_do_it_does(kind: Kind) -> None:
    for name in claimed(kind):
        client = Client(kind)
        try:
            SHOWN[name](client)
        except (AssertionError, KeyError) as error:
            error.add_note(f"{kind} says that it can do {name}")
            raise
        finally:
            client.close()


# --- modes


def modes_of(kind: Kind) -> dict[int, str]:
    if kind[0] == "px4":
        return {number: NAMES[mode] for mode, number in CUSTOM_MODES.items()}
    table = copter_table.MODES if kind[1] == "copter" else plane_modes.NAMES
    return dict(table)


@pytest.mark.parametrize("client", KINDS, ids="-".join, indirect=True)
def test_every_mode_is_flown_or_refused_with_a_word(client: Client) -> None:
    client.fly_up()
    if client.firmware == "px4":
        back = CUSTOM_MODES[Mode.LOITER]
    else:
        back = copter_table.GUIDED if client.vehicle == "copter" else plane_modes.Mode.GUIDED
    for number, name in modes_of((client.firmware, client.vehicle)).items():
        since = len(client.heard)
        result = client.set_mode(number)
        client.run(0.3)  # STABILIZE falls
        if result == ACCEPTED:
            told = [m.custom_mode for m in client.heard[since:] if m.get_type() == "HEARTBEAT"]
            assert number in (told or [client.mode]), name
            assert client.simulator.armed, name
        else:
            assert client.texts(since) or client.firmware == "px4", name
        assert client.set_mode(back) == ACCEPTED
        client.run(1.0)


# --- what was missing


@pytest.mark.parametrize(
    "client", [("px4", "copter"), ("px4", "plane")], ids="-".join, indirect=True
)
def test_px4_returns_in_mode_return_when_its_mission_says_so(client: Client) -> None:
    takes_a_plan(client, 0, 22, 16, 20)
    assert client.set_mode(CUSTOM_MODES[Mode.MISSION]) == ACCEPTED
    assert client.command(400, 1) == ACCEPTED
    for _ in range(180):
        client.run(1.0)
        if client.last("HEARTBEAT").custom_mode == CUSTOM_MODES[Mode.RTL]:
            return
    raise AssertionError("it never returned")


@pytest.mark.parametrize(
    "client", [("px4", "copter"), ("px4", "plane")], ids="-".join, indirect=True
)
def test_px4_orbits_the_place_at_the_radius_that_it_is_given(client: Client) -> None:
    client.fly_up()
    radius_m = 30.0 if client.vehicle == "copter" else 120.0
    assert client.command(34, radius_m, 5.0, 0, 0, *HOME[:2], HOME[2] + 40.0) == ACCEPTED
    client.run(60.0)
    away_m = []
    for _ in range(20):
        client.run(1.0)
        here = client.simulator.moment
        north_m = (here.latitude_deg - HOME[0]) * 111_200.0
        east_m = (here.longitude_deg - HOME[1]) * 111_200.0 * math.cos(math.radians(HOME[0]))
        away_m.append(math.hypot(north_m, east_m))
    assert max(abs(away - radius_m) for away in away_m) < 0.15 * radius_m
    moved = client.simulator.moments[-1]
    assert moved is not client.simulator.moments[-400]


@pytest.mark.parametrize("client", [("px4", "copter")], ids="-".join, indirect=True)
def test_px4_denies_follow_me_and_a_wild_orbit_in_its_own_words(client: Client) -> None:
    client.fly_up()
    since = len(client.heard)
    assert client.command(176, 1, 4, 8) != ACCEPTED
    assert "Unsupported auto mode" in client.texts(since)
    assert client.command(34, 1.0, 9.0, 0, 0, *HOME[:2], HOME[2] + 40.0) != ACCEPTED
    assert "Orbit command rejected" in client.texts(since)


@pytest.mark.parametrize("client", [("px4", "copter")], ids="-".join, indirect=True)
def test_px4_answers_inject_failure_and_does_it(client: Client) -> None:
    client.fly_up()
    assert client.command(420, 4, 1, 0) == ACCEPTED  # GPS off
    client.run(2.0)
    assert client.last("GPS_RAW_INT").fix_type < 3
    assert client.command(420, 4, 0, 0) == ACCEPTED
    client.run(2.0)
    assert client.last("GPS_RAW_INT").fix_type >= 3
    assert client.command(420, 2, 1, 0) == mavlink.MAV_RESULT_UNSUPPORTED


@pytest.mark.parametrize(
    "kind", [("ardupilot", "copter"), ("px4", "copter"), ("px4", "plane")], ids="-".join
)
def test_an_attitude_needs_no_position(kind: Kind) -> None:
    """GUIDED_NOGPS, and OFFBOARD by attitude, go on when the receiver is off."""
    client = Client(kind)
    client.fly_up()
    level = mavlink.MAVLink_set_attitude_target_message(0, *IDS, 7, (1, 0, 0, 0), 0, 0, 0, 0.5)
    if client.firmware == "ardupilot":
        assert client.set_mode(copter_table.GUIDED_NOGPS) == ACCEPTED
    client.stream(lambda: level, 1.0)
    mode = client.mode
    client.simulator.fault("gps_off")
    client.run(15.0)
    assert client.mode == mode
    assert not client.simulator.landed
    client.close()


@pytest.mark.parametrize("client", [("ardupilot", "copter")], ids="-".join, indirect=True)
def test_a_copter_whose_attitudes_cease_levels_out(client: Client) -> None:
    """GUID_TIMEOUT: 3 s after the last of them."""
    client.fly_up()
    lean = (math.cos(0.15), 0.0, -math.sin(0.15), 0.0)
    pitched = mavlink.MAVLink_set_attitude_target_message(0, *IDS, 7, lean, 0, 0, 0, 0.5)
    client.stream(lambda: pitched, 3.0)
    assert math.degrees(client.last("ATTITUDE").pitch) == pytest.approx(-17.2, abs=3.0)
    client.streamed = None
    client.run(5.0)
    assert abs(math.degrees(client.last("ATTITUDE").pitch)) < 3.0
