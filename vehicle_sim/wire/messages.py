"""Messages to values and back: the only place that knows MAVLink's units, scales and numbers.

Telemetry is made in telemetry.py; here is what clients send, and the answers.  What is not a finite
number passes through unharmed: the autopilots decide what to make of it.
"""

import math
from functools import lru_cache
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Ack, Command, Sender, Setpoint, Text
from vehicle_sim.parameters import Firmware
from vehicle_sim.wire.frames import Prepared, make

AUTOPILOT_COMPONENT = 1
DO_SET_MODE = 176
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
    if message.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
        place, frame = (message.param5, message.param6, message.param7), None
    else:
        frame = message.frame
        scale = 1e4 if frame in _LOCAL_FRAMES else 1e7
        x = math.nan if message.x == _NOWHERE else message.x / scale
        y = math.nan if message.y == _NOWHERE else message.y / scale
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

    PX4 takes its custom_mode apart into main and sub mode; ArduPilot answers with a COMMAND_ACK
    whose command is 11, the number of SET_MODE itself (the answer to a Command knows 176).
    """
    mode = message.custom_mode
    p2, p3 = (mode >> 16 & 0xFF, mode >> 24 & 0xFF) if firmware == "px4" else (mode, 0)
    return Command(
        sender=origin,
        target_component=0,
        number=DO_SET_MODE,
        parameters=(float(message.base_mode), float(p2), float(p3), 0.0, 0.0, 0.0, 0.0),
    )


def setpoint(message: Any) -> Setpoint:
    """A SET_POSITION_TARGET_GLOBAL_INT or _LOCAL_NED."""
    is_global = message.get_msgId() == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
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
    return make(
        "COMMAND_ACK",
        command=value.command,
        result=value.result,
        progress=value.progress,
        target_system=value.to.system,
        target_component=value.to.component,
    )


def texts(value: Text, number: int) -> list[Prepared]:
    """STATUSTEXT; what does not fit into one goes on in chunks of this number, to a zero byte."""
    said, severity = value.text.encode("ascii", "replace"), value.severity
    if len(said) <= _TEXT_BYTES:
        return [make("STATUSTEXT", severity=severity, text=said)]
    starts = range(0, len(said) + 1, _TEXT_BYTES)
    return [
        make(
            "STATUSTEXT",
            severity=severity,
            text=said[start : start + _TEXT_BYTES],
            id=number,
            chunk_seq=k,
        )
        for k, start in enumerate(starts)
    ]


def time_sync(tc1_ns: int, ts1_ns: int, to: Sender | None = None) -> Prepared:
    """TIMESYNC: a request with tc1 = 0, else an answer to its sender."""
    system, component = (to.system, to.component) if to else (0, 0)
    target = {"target_system": system, "target_component": component}
    return make("TIMESYNC", tc1=tc1_ns, ts1=ts1_ns, **target)


def component_heartbeat() -> Prepared:
    """HEARTBEAT of the terrain radar and of the lidar's driver: active, no autopilot."""
    return make(
        "HEARTBEAT",
        type=mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot=mavlink.MAV_AUTOPILOT_INVALID,
        system_status=mavlink.MAV_STATE_ACTIVE,
        mavlink_version=3,
    )
