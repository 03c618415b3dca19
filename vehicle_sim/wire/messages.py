"""What clients send as values, and values as answers: here MAVLink's units and scales are known.

Telemetry is made in telemetry.py.  What is not a finite number passes through unharmed: the
autopilots decide what to make of it.
"""

import math
from functools import lru_cache
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Ack, Command, Sender, Setpoint, Text
from vehicle_sim.parameters import Firmware
from vehicle_sim.wire.frames import Prepared, make

AUTOPILOT_COMPONENT = 1
_DO_SET_MODE = 176
_NOWHERE = 0x7FFFFFFF
"""x or y of a COMMAND_INT that gives no place."""
_LOCAL_FRAMES = frozenset({1, 2, 4, 7, 8, 9, 12, 20, 21})
"""MAV_FRAME in which x and y are 1e-4 metres."""
_sender = lru_cache(maxsize=64)(Sender)
"""The same few speak all the time."""
_TEXT_BYTES = 50
_FILE_NOT_FOUND = 10


def sender(message: Any, link: int) -> Sender:
    """Who sent this message that came by this link."""
    header = message.get_header()
    return _sender(system=header.srcSystem, component=header.srcComponent, link=link)


def command(message: Any, origin: Sender) -> Command:
    """A COMMAND_LONG or COMMAND_INT."""
    if message.get_type() == "COMMAND_LONG":
        place, frame = (message.param5, message.param6, message.param7), None
    else:
        frame = message.frame
        scale = 1e4 if frame in _LOCAL_FRAMES else 1e7
        x, y = (math.nan if n == _NOWHERE else n / scale for n in (message.x, message.y))
        place = (x, y, message.z)
    parameters = (message.param1, message.param2, message.param3, message.param4, *place)
    return Command(
        sender=origin,
        target_component=message.target_component,
        number=message.command,
        parameters=parameters,
        frame=frame,
    )


def mode_command(message: Any, origin: Sender, firmware: Firmware) -> Command:
    """A SET_MODE, as the DO_SET_MODE that means the same.

    PX4 takes its custom_mode apart into main and sub mode.
    """
    mode = message.custom_mode
    main, sub = (mode >> 16 & 0xFF, mode >> 24 & 0xFF) if firmware == "px4" else (mode, 0)
    parameters = (float(message.base_mode), float(main), float(sub), 0.0, 0.0, 0.0, 0.0)
    return Command(sender=origin, target_component=0, number=_DO_SET_MODE, parameters=parameters)


def setpoint(message: Any) -> Setpoint:
    """A SET_POSITION_TARGET_GLOBAL_INT or _LOCAL_NED."""
    is_global = message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
    place = (message.lat_int / 1e7, message.lon_int / 1e7, message.alt) if is_global else ()
    return Setpoint(
        is_global=is_global,
        frame=message.coordinate_frame,
        type_mask=message.type_mask,
        position=place or (message.x, message.y, message.z),
        velocity_ned_m_s=(message.vx, message.vy, message.vz),
        acceleration_ned_m_s2=(message.afx, message.afy, message.afz),
        yaw_rad=message.yaw,
        yaw_rate_rad_s=message.yaw_rate,
    )


def ack(value: Ack) -> Prepared:
    """COMMAND_ACK, addressed to the asker."""
    to = (value.to.system, value.to.component)
    return make("COMMAND_ACK", value.command, value.result, value.progress, 0, *to)


def texts(value: Text, number: int) -> list[Prepared]:
    """STATUSTEXT; what does not fit into one goes on in chunks of this number, to a zero byte."""
    said, severity, size = value.text.encode("ascii", "replace"), value.severity, _TEXT_BYTES
    if len(said) <= size:
        return [make("STATUSTEXT", severity, said)]
    parts = [said[start : start + size] for start in range(0, len(said) + 1, size)]
    return [make("STATUSTEXT", severity, part, number, k) for k, part in enumerate(parts)]


def time_sync(tc1_ns: int, ts1_ns: int, to: Sender | None = None) -> Prepared:
    """TIMESYNC: a request with tc1 = 0, else an answer to its sender."""
    return make("TIMESYNC", tc1_ns, ts1_ns, *((to.system, to.component) if to else ()))


def no_files(message: Any, to: Sender) -> Prepared | None:
    """The answer to a FILE_TRANSFER_PROTOCOL: that there are none; None to an answer of theirs.

    So clients that look for files first (parameters, component metadata) go on at once with the
    plain protocols.  Layout of the payload: mavlink.io, services/ftp.
    """
    low, high, session, opcode, *_ = message.payload
    ack, nak = mavlink.MAV_FTP_OPCODE_ACK, mavlink.MAV_FTP_OPCODE_NAK
    if opcode in (ack, nak):
        return None
    ends = (0, mavlink.MAV_FTP_OPCODE_TERMINATESESSION, mavlink.MAV_FTP_OPCODE_RESETSESSION)
    answer = (ack, 0) if opcode in ends else (nak, 1)
    head = ((low + high * 256 + 1) & 0xFFFF).to_bytes(2, "little")
    payload = [*head, session, *answer, opcode, *bytes(6), _FILE_NOT_FOUND * answer[1], *bytes(238)]
    return make("FILE_TRANSFER_PROTOCOL", 0, to.system, to.component, payload)
