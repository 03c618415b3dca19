"""The simulator's receive path under arbitrary input: what both fuzzers call.

Bytes are read as a small program: raw bytes on a link, intact frames with any payload and sender,
and time that passes.  So the fuzzer gets past the checksums and into every handler.
"""

import math
import time

from pymavlink.dialects.v20 import all as mavlink
from random_programs import COMMANDS, MESSAGES, Reader, command, intact, message_numbers

from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

PERSONALITIES = (
    ("ardupilot", "copter"),
    ("ardupilot", "plane"),
    ("px4", "copter"),
    ("px4", "plane"),
)
HANDLED = message_numbers(
    """
    HEARTBEAT COMMAND_LONG COMMAND_INT SET_POSITION_TARGET_LOCAL_NED
    SET_POSITION_TARGET_GLOBAL_INT TIMESYNC PARAM_SET PARAM_REQUEST_READ PARAM_REQUEST_LIST
    MISSION_COUNT MISSION_ITEM_INT MISSION_ITEM MISSION_REQUEST_INT MISSION_REQUEST
    MISSION_REQUEST_LIST MISSION_CLEAR_ALL MISSION_ACK MISSION_SET_CURRENT
    REQUEST_DATA_STREAM SET_MODE SETUP_SIGNING
    FILE_TRANSFER_PROTOCOL TERRAIN_REQUEST PING
    """
)
LINKS = 2
SLOWEST_S = 5.0
"""An input that takes longer is called a hang: the longest honest ones take milliseconds."""
_FRESH_AFTER = 2000
_STATION = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)


class Target:
    """One vehicle of each personality, ready to be armed; made anew now and then."""

    def __init__(self) -> None:
        self._vehicles: dict[int, Simulation] = {}
        self._inputs = 0

    def prepare(self) -> None:
        """Vehicles are made when they are first needed."""

    def vehicle(self, which: int) -> Simulation:
        self._inputs += 1
        if self._inputs % _FRESH_AFTER == 0:
            self._vehicles.clear()
        if which not in self._vehicles:
            autopilot, kind = PERSONALITIES[which]
            world = flat_world(
                kind,  # type: ignore[arg-type]
                autopilot,  # type: ignore[arg-type]
                latitude_deg=47.4,
                longitude_deg=8.5,
                altitude_amsl_m=488.0,
                heading_deg=0.0,
            )
            vehicle = Simulation(world, links=LINKS, byte_streams={1})
            for _ in range(4500):
                vehicle.step()
            vehicle.take_frames()
            self._vehicles[which] = vehicle
        return self._vehicles[which]

    def play(self, data: bytes) -> None:
        """Let one input run; an exception or a hang is a finding."""
        start_s = time.process_time()
        reader = Reader(data)
        vehicle = self.vehicle(reader.byte() % len(PERSONALITIES))
        while reader.left:
            match reader.byte() % 8:
                case 0:
                    vehicle.receive(reader.byte() % LINKS, reader.bytes(reader.byte()))
                case 1:
                    for _ in range(reader.byte() % 50):
                        vehicle.step()
                case 2:
                    number = MESSAGES[(reader.byte() << 8 | reader.byte()) % len(MESSAGES)]
                    vehicle.receive(reader.byte() % LINKS, _frame(number, reader))
                case 3:
                    vehicle.receive(
                        reader.byte() % LINKS, command(reader, COMMANDS, _STATION, (1, 1))
                    )
                case 4:
                    names = list(vehicle.parameters)
                    name = names[(reader.byte() << 8 | reader.byte()) % len(names)]
                    vehicle.receive(0, _parameter(name, reader.value()))
                case _:
                    number = HANDLED[reader.byte() % len(HANDLED)]
                    vehicle.receive(reader.byte() % LINKS, _frame(number, reader))
        for _ in range(10):
            vehicle.step()
        self._check(vehicle)
        took_s = time.process_time() - start_s
        if took_s > SLOWEST_S:
            raise TimeoutError(f"{took_s:.1f} s for {len(data)} bytes")

    def _check(self, vehicle: Simulation) -> None:
        """What goes out is intact, and the vehicle is somewhere."""
        for _, frame in vehicle.take_frames():
            assert 12 <= len(frame) <= 293
        vehicle.take_truth()
        vehicle.take_notices()
        flown = vehicle.vehicle
        for value in (flown.latitude_deg, flown.longitude_deg, flown.altitude_amsl_m):
            assert math.isfinite(value)
        assert abs(flown.latitude_deg) <= 90.0


def _frame(number: int, reader: Reader) -> bytes:
    """An intact frame with any payload; most are addressed to the vehicle."""
    size = mavlink.mavlink_map[number].unpacker.size
    payload = reader.bytes(size).ljust(size, b"\0")
    who = reader.byte()
    sender = ((255, 1, 42)[who % 3], (190, 191, 195)[who // 3 % 3])
    return intact(number, payload, sender, target=(1, 1) if who & 0xC0 else None)


def _parameter(name: str, value: float) -> bytes:
    kind = 6 if abs(value) < 1e6 and value == int(value) else 9
    message = mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind)
    packed: bytes = message.pack(_STATION)
    return packed
