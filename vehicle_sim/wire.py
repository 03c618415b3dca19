"""Frames to values and back: the only place that knows MAVLink's units, scales and numbers.

Telemetry is made in telemetry.py; here are the identities, the parser and the answers.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Ack, Command, Sender, Setpoint, Text
from vehicle_sim.sensors import ScanBlock, ScanRequest

AUTOPILOT_COMPONENT = 1
DATAGRAM_BYTES = 1400
_MARKER = 0xFD
_OVERHEAD_BYTES = 12
_SIGNATURE_BYTES = 13
_SIGNED = 0x01


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Heartbeat:
    """Somebody on the link is there."""

    sender: Sender
    system_status: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TimeSync:
    """A question (tc1 = 0) or an answer."""

    tc1_ns: int
    ts1_ns: int


Received = Heartbeat | TimeSync | Command | Setpoint | ScanRequest


def degrees_e7(angle_deg: float) -> int:
    """Degrees -> MAVLink's 1e-7 degrees."""
    return round(angle_deg * 1e7)


@final
class Packer:
    """Messages of one component into frames."""

    def __init__(self, system: int, component: int) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)

    def restart(self) -> None:
        """Begin the sequence numbers again."""
        self._mav.seq = 0

    def frame(self, message: Any) -> bytes:
        """The message as a frame with the next sequence number."""
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame


@final
class Parser:
    """Datagrams into what the vehicle and its radar have to do.  Garbage is passed over."""

    def __init__(self, system: int, radar_component: int) -> None:
        self._mav = mavlink.MAVLink(None)
        self._system = system
        self._radar = radar_component
        self._own = {(system, AUTOPILOT_COMPONENT), (system, radar_component)}

    def parse(self, datagram: bytes) -> list[Received]:
        """What this datagram asks for, in order."""
        received = []
        for message in self._messages(datagram):
            item = self._received(message)
            if item is not None:
                received.append(item)
        return received

    def _messages(self, datagram: bytes) -> Iterable[Any]:
        """Every intact frame; after a broken one, look for the next marker."""
        at, size = 0, len(datagram)
        while 0 <= (at := datagram.find(_MARKER, at)) <= size - _OVERHEAD_BYTES:
            flags = datagram[at + 2]
            end = at + datagram[at + 1] + _OVERHEAD_BYTES
            end += _SIGNATURE_BYTES if flags & _SIGNED else 0
            if end > size or flags & ~_SIGNED:
                at += 1
                continue
            try:
                message = self._mav.decode(bytearray(datagram[at:end]))
            except mavlink.MAVError:
                at += 1
                continue
            if isinstance(message, mavlink.MAVLink_unknown):
                at += 1  # its checksum cannot be checked: its length may be anything
                continue
            yield message
            at = end

    def _received(self, message: Any) -> Received | None:
        sender = Sender(system=message.get_srcSystem(), component=message.get_srcComponent())
        if (sender.system, sender.component) in self._own:
            return None  # loop-back, as ArduPilot takes it
        match message.get_type():
            case "SET_POSITION_TARGET_GLOBAL_INT" | "SET_POSITION_TARGET_LOCAL_NED":
                return _setpoint(message) if self._takes_setpoint(message) else None
            case "TIMESYNC":
                return TimeSync(tc1_ns=message.tc1, ts1_ns=message.ts1)
            case "HEARTBEAT":
                return Heartbeat(sender=sender, system_status=message.system_status)
            case "COMMAND_LONG" | "COMMAND_INT":
                return _command(message, sender) if self._is_ours(message) else None
            case "TERRAIN_REQUEST":
                return ScanRequest(
                    latitude_deg=message.lat / 1e7,
                    longitude_deg=message.lon / 1e7,
                    spacing_m=message.grid_spacing,
                    mask=message.mask,
                )
            case _:
                return None

    def _is_ours(self, message: Any) -> bool:
        return message.target_system in (0, self._system)

    def _takes_setpoint(self, message: Any) -> bool:
        return self._is_ours(message) and message.target_component != self._radar


def _command(message: Any, sender: Sender) -> Command:
    if message.get_type() == "COMMAND_LONG":
        tail = (message.param5, message.param6, message.param7)
        frame = None
    else:
        tail = (message.x / 1e7, message.y / 1e7, message.z)
        frame = message.frame
    return Command(
        sender=sender,
        target_component=message.target_component,
        number=message.command,
        parameters=(message.param1, message.param2, message.param3, message.param4, *tail),
        frame=frame,
    )


def _setpoint(message: Any) -> Setpoint:
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
    )


def ack(value: Ack) -> Any:
    """COMMAND_ACK, addressed to the asker."""
    return mavlink.MAVLink_command_ack_message(
        command=value.command,
        result=value.result,
        target_system=value.to.system,
        target_component=value.to.component,
    )


def text(value: Text) -> Any:
    """STATUSTEXT; what does not fit is cut off."""
    return mavlink.MAVLink_statustext_message(
        severity=value.severity, text=value.text.encode("ascii", "replace")[:50]
    )


def time_sync(tc1_ns: int, ts1_ns: int) -> Any:
    """TIMESYNC: a question with tc1 = 0, else an answer."""
    return mavlink.MAVLink_timesync_message(tc1=tc1_ns, ts1=ts1_ns)


def radar_heartbeat() -> Any:
    """HEARTBEAT of the terrain radar: there, active, and not an autopilot."""
    return mavlink.MAVLink_heartbeat_message(
        type=mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot=mavlink.MAV_AUTOPILOT_INVALID,
        base_mode=0,
        custom_mode=0,
        system_status=mavlink.MAV_STATE_ACTIVE,
        mavlink_version=3,
    )


def terrain_data(request: ScanRequest, block: ScanBlock) -> Any:
    """TERRAIN_DATA: one block; corner and spacing are the request's."""
    return mavlink.MAVLink_terrain_data_message(
        lat=degrees_e7(request.latitude_deg),
        lon=degrees_e7(request.longitude_deg),
        grid_spacing=request.spacing_m,
        gridbit=block.gridbit,
        data=list(block.heights_amsl_m),
    )


def terrain_report(
    request: ScanRequest, *, ground_amsl_m: float, above_ground_m: float, blocks: int
) -> Any:
    """TERRAIN_REPORT: the request is answered, with so many blocks."""
    return mavlink.MAVLink_terrain_report_message(
        lat=degrees_e7(request.latitude_deg),
        lon=degrees_e7(request.longitude_deg),
        spacing=request.spacing_m,
        terrain_height=ground_amsl_m,
        current_height=above_ground_m,
        pending=0,
        loaded=blocks,
    )


def datagrams(frames: Sequence[bytes]) -> list[bytes]:
    """Frames in order, as many to a datagram as fit."""
    packed, batch, size = list[bytes](), list[bytes](), 0
    for frame in frames:
        if size + len(frame) > DATAGRAM_BYTES:
            packed.append(b"".join(batch))
            batch, size = [], 0
        batch.append(frame)
        size += len(frame)
    if batch:
        packed.append(b"".join(batch))
    return packed


def bounded(value: float, most: int) -> int:
    """The nearest whole number within +-most: what an integer field can carry."""
    return round(min(max(value, -most), most)) if math.isfinite(value) else 0
