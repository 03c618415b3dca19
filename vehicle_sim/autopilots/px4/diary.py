"""What PX4 says and writes down on its own: its log, parameters it has changed, its flights.

Times and lists are those of the recorded flights.  Gimbal: the commands that it broadcasts when it
lands, not for anybody who is here.
"""

import math
from typing import Any, Final, final

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Reply, Say, SayParameter
from vehicle_sim.autopilots.px4 import health
from vehicle_sim.parameters import Parameters

_BAROMETER: Final = ("CAL_BARO0_ID", "CAL_BARO0_OFF", "CAL_BARO0_PRIO")
_AT_BOOT: Final = (
    *("CAL_ACC0_ID", "CAL_ACC1_ID", "CAL_ACC2_ID", *_BAROMETER),
    *("CAL_GYRO0_ID", "CAL_GYRO1_ID", "CAL_GYRO2_ID"),
    *("CAL_MAG0_ID", "CAL_MAG0_PRIO", "CAL_MAG1_ID", "CAL_MAG1_PRIO"),
    *("COM_OBL_RC_ACT", "EKF2_MAG_DECL", "SENS_BOARD_X_OFF", "SENS_DPRES_OFF"),
    *("SIH_KDV", "SIH_LOC_H0", "SYS_AUTOCONFIG", "SYS_AUTOSTART"),
)
UNASKED: Final = ((1_000_000, _AT_BOOT), (5_360_000, _BAROMETER))
"""What is said unasked, and when after boot (px4-offboard-short.tlog)."""
LEARNT: Final = ("CAL_ACC0_XOFF", "CAL_ACC0_YOFF", "CAL_ACC0_ZOFF")
"""What a long flight teaches, m/s^2."""
LEARNT_M_S2: Final = 0.03
"""Standard deviation of it (px4-offboard-8mps.tlog: -0.038, -0.039, 0.009)."""
AFTER_FLIGHT: Final = (
    *("CAL_ACC0_ID", "CAL_ACC0_PRIO", "CAL_ACC0_ROT", "CAL_ACC0_XOFF", "CAL_ACC0_XSCALE"),
    *("CAL_ACC0_YOFF", "CAL_ACC0_YSCALE", "CAL_ACC0_ZOFF", "CAL_ACC0_ZSCALE", *_BAROMETER),
    *("COM_FLIGHT_UUID", "LND_FLIGHT_T_HI", "LND_FLIGHT_T_LO"),
)
"""What is said on disarming when the accelerometer has been calibrated in flight."""
_LOG_US: Final = 700_000
"""Boot to the first line of a log that begins there: 0.77 s in px4-offboard-short.tlog."""
_CALIBRATED_US: Final = 240_000_000
"""A flight that long (SENS_IMU_AUTOCAL): after 254 s in px4-offboard-8mps.tlog, not after 195 s."""


@final
class Diary:
    """One boot's.  Mutable."""

    def __init__(self, parameters: Parameters, rng: np.random.Generator) -> None:
        self._parameters = parameters
        self._rng = rng
        self._unasked: tuple[tuple[int, tuple[str, ...]], ...] = UNASKED
        self._log_due = True

    @property
    def logs_always(self) -> bool:
        """SDLOG_MODE: -1 never, 0 from arming on, 1 and 2 from boot on."""
        return int(self._parameters["SDLOG_MODE"]) >= 1

    def due(self, now_us: int) -> list[Reply]:
        """What is to be said now without being asked."""
        said: list[Reply] = []
        if self._unasked and now_us >= self._unasked[0][0]:
            names, self._unasked = self._unasked[0][1], self._unasked[1:]
            said += [SayParameter(name=name) for name in names if name in self._parameters]
        if self._log_due and now_us >= _LOG_US:
            self._log_due = False
            if self.logs_always:
                said.append(health.log_started(now_us))
        return said

    def arm(self, now_us: int) -> list[Reply]:
        """The motors start."""
        starts = int(self._parameters["SDLOG_MODE"]) == 0
        return [health.log_started(now_us)] if starts else []

    def book(self, flown_us: int, *, calm: bool) -> list[Reply]:
        """Count a flight; a long calm one calibrates the accelerometer, and all of it is told."""
        parameters = self._parameters
        parameters["COM_FLIGHT_UUID"] += 1.0
        total_us = int(parameters["LND_FLIGHT_T_HI"]) << 31 | int(parameters["LND_FLIGHT_T_LO"])
        total_us += flown_us
        parameters["LND_FLIGHT_T_HI"] = float(total_us >> 31)
        parameters["LND_FLIGHT_T_LO"] = float(total_us & 0x7FFFFFFF)
        if not calm or flown_us < _CALIBRATED_US:
            return []
        for name in LEARNT:
            parameters[name] = float(self._rng.normal(0.0, LEARNT_M_S2))
        return [SayParameter(name=name) for name in AFTER_FLIGHT]


_FIRST_US: Final = 250_000
_AGAIN_US: Final = (1_000_000, 510_000, 510_000)
"""After the one before: nobody has answered (px4-gps-loss.tlog, 174.84 s and on)."""
_NAN: Final = math.nan
NEVER_US: Final = 1 << 62


def _command(number: int, confirmation: int, *parameters: float) -> Any:
    p1, p2, p3, p4, p5, p6, p7 = (*parameters, *(0.0,) * (7 - len(parameters)))
    return mavlink.MAVLink_command_long_message(
        target_system=1,
        target_component=0,
        command=number,
        confirmation=confirmation,
        param1=p1,
        param2=p2,
        param3=p3,
        param4=p4,
        param5=p5,
        param6=p6,
        param7=p7,
    )


@final
class Gimbal:
    """Acquires control, turns the gimbal straight, releases it; repeats while nobody answers."""

    def __init__(self) -> None:
        self.due_us = NEVER_US
        """When there is something to take."""
        self._sent = 0

    def straighten(self, now_us: int) -> None:
        """A landing begins."""
        self.due_us = now_us + _FIRST_US
        self._sent = 0

    def take(self, now_us: int) -> list[Say]:
        """What is due now."""
        acquire = _command(1001, self._sent, 1.0, 1.0, -1.0, -1.0)
        said = [Say(message=acquire)]
        if self._sent == 0:
            said.append(Say(message=_command(1000, 0, _NAN, _NAN, _NAN, _NAN, 2.0)))
            said.append(Say(message=_command(1001, 0, -3.0, -3.0, -1.0, -1.0)))
        self.due_us = now_us + _AGAIN_US[self._sent] if self._sent < len(_AGAIN_US) else NEVER_US
        self._sent += 1
        return said
