"""One strategy per autopilot: its modes, and the messages that a flight needs of it.

ArduCopter: position + velocity + yaw setpoints in guided mode; it holds in BRAKE, not LOITER,
which sinks without a throttle stick (measured: reference/ardupilot.md, section 2).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

from companion.mavlink.dialect import wire
from companion.mission.events import Mode


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Autopilot:
    """How one kind of autopilot is told what to do."""

    name: str
    autopilot: int
    """MAV_AUTOPILOT."""
    vehicle_types: frozenset[int]
    """MAV_TYPE of its airframes."""
    mode_numbers: Mapping[Mode, int]
    streams_hz: Mapping[int, float]
    """Message id -> rate, besides the position."""

    def flies(self, autopilot: int, vehicle_type: int) -> bool:
        """Whether a heartbeat's autopilot and type are of this kind."""
        return autopilot == self.autopilot and vehicle_type in self.vehicle_types

    def mode_of(self, custom_mode: int) -> Mode:
        """The mode that a heartbeat reports."""
        for mode, number in self.mode_numbers.items():
            if number == custom_mode:
                return mode
        return Mode.OTHER


ARDUCOPTER = Autopilot(
    name="ArduCopter",
    autopilot=wire.MAV_AUTOPILOT_ARDUPILOTMEGA,
    vehicle_types=frozenset(
        {
            wire.MAV_TYPE_QUADROTOR,
            wire.MAV_TYPE_COAXIAL,
            wire.MAV_TYPE_HELICOPTER,
            wire.MAV_TYPE_HEXAROTOR,
            wire.MAV_TYPE_OCTOROTOR,
            wire.MAV_TYPE_TRICOPTER,
            wire.MAV_TYPE_DODECAROTOR,
            wire.MAV_TYPE_DECAROTOR,
        }
    ),
    mode_numbers={
        Mode.GUIDED: wire.COPTER_MODE_GUIDED,
        Mode.HOLD: wire.COPTER_MODE_BRAKE,
        Mode.LAND: wire.COPTER_MODE_LAND,
    },
    streams_hz={
        wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
        wire.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
        wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
        wire.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
        wire.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
        wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
        wire.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        wire.MAVLINK_MSG_ID_ATTITUDE: 1.0,
    },
)
