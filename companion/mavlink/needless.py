"""What autopilots stream and the companion has no use for: recorded, and never decoded.

Half of what PX4 sends to an onboard computer by itself (px4.md 2).
"""

from typing import Final, final

from companion.mavlink.dialect import wire
from companion.mavlink.frames import number_of, sender_of

_NAMED: Final = """
    ACTUATOR_CONTROL_TARGET ACTUATOR_OUTPUT_STATUS AHRS AHRS2 ALTITUDE ATTITUDE_QUATERNION
    ATTITUDE_TARGET DISTANCE_SENSOR ESC_TELEMETRY_1_TO_4 GNSS_INTEGRITY HIGHRES_IMU HWSTATUS
    MCU_STATUS MEMINFO NAV_CONTROLLER_OUTPUT ODOMETRY OPEN_DRONE_ID_LOCATION
    OPEN_DRONE_ID_SYSTEM POWER_STATUS RAW_IMU RC_CHANNELS RC_CHANNELS_RAW SCALED_IMU SCALED_IMU2
    SCALED_IMU3 SCALED_PRESSURE SCALED_PRESSURE2 SCALED_PRESSURE3 SENSOR_OFFSETS SERVO_OUTPUT_RAW
    SIMSTATE SIM_STATE VFR_HUD VIBRATION WIND WIND_COV
"""
_NAMES: Final = frozenset(_NAMED.split())
_KINDS: Final = {
    number: str(kind.msgname) for number, kind in wire.mavlink_map.items() if kind.msgname in _NAMES
}
NEEDLESS: Final = frozenset(_KINDS)
"""Message numbers."""


@final
class Unread:
    """A message of such a kind: what pymavlink's messages tell of their frames."""

    __slots__ = ("_frame",)

    def __init__(self, frame: bytes) -> None:
        self._frame = frame

    def get_msgbuf(self) -> bytes:
        """The frame."""
        return self._frame

    def get_msgId(self) -> int:
        """Message number."""
        return number_of(self._frame)

    def get_type(self) -> str:
        """Name of the kind."""
        return _KINDS[number_of(self._frame)]

    def get_srcSystem(self) -> int:
        """System id of the sender."""
        return sender_of(self._frame)[0]

    def get_srcComponent(self) -> int:
        """Component id of the sender."""
        return sender_of(self._frame)[1]
