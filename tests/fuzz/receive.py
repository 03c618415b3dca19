"""The simulator's receive path under arbitrary input: what both fuzzers and tests call.

Bytes are read as a small program: raw bytes on a link, intact frames with any payload and sender,
orders, setpoints, parameters, plans and faults, and time that passes.  So the fuzzer gets past the
checksums and into every handler.
"""

import math
import time
from typing import Any

from pymavlink.dialects.v20 import all as mavlink
from random_programs import (
    COMMANDS,
    EDGES_E7,
    FAULTS,
    FRAMES,
    MESSAGES,
    PLACE,
    Reader,
    any_frame,
    command,
    message_numbers,
    plan_items,
)

from vehicle_sim.plans import PlanKind
from vehicle_sim.simulation import Simulation
from vehicle_sim.wire.missions import store
from vehicle_sim.world import flat_world

PERSONALITIES: Any = [(kind, of) for of in ("ardupilot", "px4") for kind in ("copter", "plane")]
SENDERS = [(system, component) for system in (255, 1, 42) for component in (190, 191, 195)]
MASKS = (0, 0xDF8, 0xDC0, 0xC00, 0x9C0, 0xDC7)
LINKS = 2
SLOWEST_S = 5.0
"""An input that takes longer is called a hang: the longest honest ones take milliseconds."""
_FRESH_AFTER = 2000
_STATION = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
_READER = mavlink.MAVLink(None)


class Target:
    """One vehicle of each personality, ready to be armed; made anew now and then."""

    def __init__(self) -> None:
        self._vehicles: dict[int, Simulation] = {}
        self._inputs = 0

    def vehicle(self, which: int) -> Simulation:
        self._inputs += 1
        if self._inputs % _FRESH_AFTER == 0:
            self._vehicles.clear()
        if which not in self._vehicles:
            above = {"altitude_amsl_m": 488.0, "heading_deg": 0.0}
            world = flat_world(*PERSONALITIES[which], **PLACE, **above)
            vehicle = Simulation(world, links=LINKS, byte_streams={1})
            for _ in range(4500):
                vehicle.step()
            vehicle.take_frames()
            self._vehicles[which] = vehicle
        return self._vehicles[which]

    def play(self, data: bytes, vehicle: Simulation | None = None) -> None:
        """Let one input run, on one of its own or another; an exception or a hang is a finding."""
        start_s, reader = time.process_time(), Reader(data)
        which = reader.byte() % len(PERSONALITIES)
        vehicle, links = (self.vehicle(which), LINKS) if vehicle is None else (vehicle, 1)
        while reader.left:
            link = reader.byte() % links
            match reader.byte() % 12:
                case 0:
                    vehicle.receive(link, reader.bytes(reader.byte()))
                case 1 | 2:
                    for _ in range(reader.byte() % 50):
                        vehicle.step()
                    check(vehicle)
                case 3:
                    number = MESSAGES[(reader.byte() << 8 | reader.byte()) % len(MESSAGES)]
                    vehicle.receive(link, any_frame(number, reader, SENDERS, (1, 1)))
                case 4:
                    vehicle.receive(link, command(reader, COMMANDS, _STATION, (1, 1)))
                case 5:
                    frame = FRAMES[reader.byte() % len(FRAMES)]
                    mask = MASKS[reader.byte() % len(MASKS)]
                    values = [reader.value() for _ in range(11)]
                    made: Any = mavlink.MAVLink_set_position_target_local_ned_message
                    if reader.byte() % 2:
                        made = mavlink.MAVLink_set_position_target_global_int_message
                        values[:2] = (EDGES_E7[reader.byte() % len(EDGES_E7)] for _ in range(2))
                    setpoint = made(0, 1, 1, frame, mask, *values)
                    vehicle.receive(link, bytes(setpoint.pack(_STATION)))
                case 6:
                    names = list(vehicle.parameters)
                    name = names[(reader.byte() << 8 | reader.byte()) % len(names)].encode()
                    value = reader.value()
                    kind = 6 if abs(value) < 1e6 and value == int(value) else 9
                    change = mavlink.MAVLink_param_set_message(1, 1, name, value, kind)
                    vehicle.receive(0, bytes(change.pack(_STATION)))
                case 7:
                    autopilot, plan = vehicle._controller.autopilot, PlanKind(reader.byte() % 3)
                    vehicle._controller.answer(store(autopilot, plan, plan_items(reader)))
                case 8:
                    vehicle.add_fault(FAULTS[reader.byte() % len(FAULTS)])
                case _:
                    handled = [*vehicle._controller.handlers, "TERRAIN_REQUEST", "PING"]
                    [number] = message_numbers(handled[reader.byte() % len(handled)])
                    vehicle.receive(link, any_frame(number, reader, SENDERS, (1, 1)))
        for _ in range(10):
            vehicle.step()
        check(vehicle)
        took_s = time.process_time() - start_s
        if took_s > SLOWEST_S + 1e-3 * len(data):
            raise TimeoutError(f"{took_s:.1f} s for {len(data)} bytes")


def check(vehicle: Simulation) -> None:
    """What goes out is intact and in numbers, and the vehicle is somewhere."""
    for _, frame in vehicle.take_frames():
        assert 12 <= len(frame) <= 293
        if frame[7] in (mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED):
            fields = _READER.decode(bytearray(frame)).to_dict().values()
            assert all(math.isfinite(field) for field in fields if isinstance(field, float))
    vehicle.take_truth()
    vehicle.take_notices()
    flown = vehicle.vehicle
    angles = flown.roll_rad + flown.pitch_rad + flown.heading_rad
    assert math.isfinite(angles + flown.airspeed_m_s + sum(flown.velocity_neu_m_s))
    assert abs(flown.latitude_deg) <= 90.0
    assert abs(flown.longitude_deg) <= 180.0
    assert vehicle.contact.ground_amsl_m - 41.0 <= flown.altitude_amsl_m < 2e6
    assert 0.0 <= flown.throttle <= 1.0
