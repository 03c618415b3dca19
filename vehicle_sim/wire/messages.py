"""What clients send as values, and values as answers: here MAVLink's units and scales are known.

Telemetry is made in telemetry.py.  What is not a finite number passes through unharmed: the
autopilots decide what to make of it.
"""

import math
import struct
from functools import lru_cache
from typing import Any, Final

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


# --- in -------------------------------------------------------------------------------------------


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
    return Command(
        sender=origin,
        target_component=message.target_component,
        number=message.command,
        parameters=(message.param1, message.param2, message.param3, message.param4, *place),
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
    return Setpoint(
        is_global=is_global,
        frame=message.coordinate_frame,
        type_mask=message.type_mask,
        position=(message.lat_int / 1e7, message.lon_int / 1e7, message.alt)
        if is_global
        else (message.x, message.y, message.z),
        velocity_ned_m_s=(message.vx, message.vy, message.vz),
        acceleration_ned_m_s2=(message.afx, message.afy, message.afz),
        yaw_rad=message.yaw,
        yaw_rate_rad_s=message.yaw_rate,
    )


# --- out ------------------------------------------------------------------------------------------


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


def component_heartbeat() -> Prepared:
    """HEARTBEAT of the terrain radar and of the lidar's driver: active, no autopilot."""
    kind, none = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
    return make("HEARTBEAT", kind, none, 0, 0, mavlink.MAV_STATE_ACTIVE, 3)


# --- files ----------------------------------------------------------------------------------------

_ACK, _NAK = mavlink.MAV_FTP_OPCODE_ACK, mavlink.MAV_FTP_OPCODE_NAK
_ENDS: Final = (0, mavlink.MAV_FTP_OPCODE_TERMINATESESSION, mavlink.MAV_FTP_OPCODE_RESETSESSION)


def no_files(message: Any, to: Sender) -> Prepared | None:
    """The answer to a FILE_TRANSFER_PROTOCOL: that there are no files; none to an answer.

    So clients that look for files first (parameters, component metadata) go on at once with the
    plain protocols.  Layout of the payload: mavlink.io, services/ftp.
    """
    sequence, session, opcode = struct.unpack_from("<HBB", bytes(message.payload))
    if opcode in (_ACK, _NAK):
        return None
    result, size, why = (_ACK, 0, 0) if opcode in _ENDS else (_NAK, 1, 10)  # file not found
    head = struct.pack("<HBBBB", (sequence + 1) & 0xFFFF, session, result, size, opcode)
    payload = [*head, *bytes(6), why, *bytes(238)]
    return make("FILE_TRANSFER_PROTOCOL", 0, to.system, to.component, payload)
