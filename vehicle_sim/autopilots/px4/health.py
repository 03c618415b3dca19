"""PX4's events, and its report of health and arming checks, as bytes that were recorded.

The arguments of the checks are copied from the logs: their layouts are PX4's private matter, and a
client reads them with the metadata of the firmware.
"""

import math
from typing import Any, Final, final

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Event, Reply, SendMessage, SendParameter, Text
from vehicle_sim.parameters import Parameters

INFO, WARNING, CRITICAL, PROTOCOL = 0x66, 0x44, 0x42, 0x88
ARMED: Final = 26266355
DISARMED: Final = 32794487
LOG_STARTED: Final = 17980399
TAKEOFF_DETECTED: Final = 21054825
LANDING_DETECTED: Final = 26622124
LANDING_HERE: Final = 20099806
FAILSAFE: Final = 31382480
"""14605264: "Failsafe activated: switching to ..."; mode and action."""
DISENGAGED: Final = 29547634
"""12770418: "Autopilot disengaged, switching to ..."; mode and action."""
FUSION_STOPPED: Final = 31476391
FUSION_STARTED: Final = 32069699

ARMED_BY_COMMAND = 4
DISARMED_BY_COMMAND, DISARMED_BY_LANDING, DISARMED_UNFLOWN = 4, 6, 7
DISARMED_BY_FAILURE = 11
"""arm_disarm_reason_t."""

REPORT_INTERVAL_US: Final = 2_050_000
"""Changed results are reported at most this often: 2.088, 4.140, 6.264 s in the log."""

_SUMMARY: Final = 27825120
_NO_POSITION: Final = (
    Event(number=30612409, log_levels=0x33, arguments=bytes.fromhex("7c007e0011")),
    Event(number=26788467, log_levels=0x33, arguments=bytes.fromhex("3800000018")),
)
_ALWAYS: Final = Event(number=17154777, log_levels=0x66, arguments=bytes.fromhex("0800000014"))
_NO_OFFBOARD_SIGNAL: Final = Event(
    number=19865031, log_levels=0x33, arguments=bytes.fromhex("0040000014")
)
_LAST: Final = (
    Event(number=17231145, log_levels=0x44, arguments=bytes.fromhex("ffffffff07")),
    Event(number=23579003, log_levels=0x66, arguments=bytes.fromhex("ffffffff0c")),
)
_HEALTH: Final = 18691879


REASONS: Final = {
    DISARMED_BY_COMMAND: "external command",
    DISARMED_BY_LANDING: "landing",
    DISARMED_UNFLOWN: "auto preflight disarming",
    DISARMED_BY_FAILURE: "failure detector",
}
BOOT_UNIX_S: Final = 1795227739.3
"""GPS time at boot, of px4-offboard-short.tlog."""


def text(severity: int, words: str) -> Text:
    """A STATUSTEXT; PX4 ends those that are events as well with a tab."""
    return Text(severity=severity, text=words + "\t")


def log_started(now_us: int) -> Event:
    """The logger names its file by the time: year, month, day, hour, minute, second."""
    at = np.datetime64(int(BOOT_UNIX_S + now_us * 1e-6), "s").item().timetuple()
    arguments = at.tm_year.to_bytes(2, "little") + bytes(at[1:6])
    return Event(number=LOG_STARTED, log_levels=INFO, arguments=arguments)


@final
class Checks:
    """The results of the arming checks, and when they were last told.  Mutable."""

    def __init__(self, *, airspeed: bool) -> None:
        self._airspeed = airspeed
        """Has an airspeed sensor."""
        self.logs_always = False
        """SDLOG_MODE 1 or 2: logs from boot on."""
        self._reported: tuple[bool, bool, bool] | None = None
        self._reported_us = -REPORT_INTERVAL_US
        self.reported_position_ok = False
        """What SYS_STATUS goes by is the last report, not the state itself."""
        self.reported_signal = self.reported_fusing = False

    def report(
        self, now_us: int, *, position_ok: bool, offboard_signal: bool, fusing: bool
    ) -> list[Event]:
        """The events to send now, none if nothing has changed or it was told just before."""
        state = (position_ok, offboard_signal, fusing)
        if state == self._reported or now_us - self._reported_us < REPORT_INTERVAL_US:
            return []
        self._reported, self._reported_us = state, now_us
        self.reported_position_ok, self.reported_signal = position_ok, offboard_signal
        self.reported_fusing = fusing
        signal_matters = not (position_ok and offboard_signal)
        return [
            Event(number=_SUMMARY, log_levels=PROTOCOL, arguments=_summary(state)),
            *(() if position_ok else _NO_POSITION),
            _ALWAYS,
            *((_NO_OFFBOARD_SIGNAL,) if signal_matters else ()),
            *_LAST,
            Event(number=_HEALTH, log_levels=PROTOCOL, arguments=self._health(fusing=fusing)),
        ]

    def _health(self, *, fusing: bool) -> bytes:
        sensors = 0x02 | (0x08 if fusing else 0) | (0x04 if self._airspeed else 0)
        return bytes((0x00, sensors, 0x0C if self.logs_always else 0x08, 0x02, 0x38))


def _summary(state: tuple[bool, bool, bool]) -> bytes:
    """Errors, warnings, and the modes that can be armed and run in."""
    position_ok, offboard_signal, _ = state
    if not position_ok:
        return bytes.fromhex("000000120180000000803a0180803a0180")
    if not offboard_signal:
        return bytes.fromhex("000000100080000000b03a7f80b03a7f80")
    return bytes.fromhex("000000000080000000b07a7f80b07a7f80")


# --- What PX4 says and writes down on its own: its log, parameters it has changed, its flights
# Times and lists are those of the recorded flights. Gimbal: the commands that it broadcasts when
# it lands, not for anybody who is here.

_BAROMETER: Final = ("CAL_BARO0_ID", "CAL_BARO0_OFF", "CAL_BARO0_PRIO")
_AT_BOOT: Final = (
    *("CAL_ACC0_ID", "CAL_ACC1_ID", "CAL_ACC2_ID", *_BAROMETER),
    *("CAL_GYRO0_ID", "CAL_GYRO1_ID", "CAL_GYRO2_ID"),
    *("CAL_MAG0_ID", "CAL_MAG0_PRIO", "CAL_MAG1_ID", "CAL_MAG1_PRIO"),
    *("COM_OBL_RC_ACT", "EKF2_MAG_DECL", "SENS_BOARD_X_OFF", "SENS_DPRES_OFF"),
    *("SIH_KDV", "SIH_LOC_H0", "SYS_AUTOCONFIG", "SYS_AUTOSTART"),
)
UNASKED: Final = ((1_000_000, _AT_BOOT), (5_360_000, _BAROMETER))
"""Unsolicited messages, and when after boot (px4-offboard-short.tlog)."""
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
class LoggerState:
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
        """Unsolicited messages that are due."""
        said: list[Reply] = []
        if self._unasked and now_us >= self._unasked[0][0]:
            names, self._unasked = self._unasked[0][1], self._unasked[1:]
            said += [SendParameter(name=name) for name in names if name in self._parameters]
        if self._log_due and now_us >= _LOG_US:
            self._log_due = False
            if self.logs_always:
                said.append(log_started(now_us))
        return said

    def arm(self, now_us: int) -> list[Reply]:
        """The motors start."""
        starts = int(self._parameters["SDLOG_MODE"]) == 0
        return [log_started(now_us)] if starts else []

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
        return [SendParameter(name=name) for name in AFTER_FLIGHT]


_FIRST_US: Final = 250_000
_AGAIN_US: Final = (1_000_000, 510_000, 510_000)
"""Repetition periods without an answer (px4-gps-loss.tlog, from 174.84 s on)."""
_NAN: Final = math.nan
NEVER_US: Final = 1 << 62


def _command(number: int, confirmation: int, *parameters: float) -> Any:
    seven = (*parameters, *(0.0,) * (7 - len(parameters)))
    return mavlink.MAVLink_command_long_message(1, 0, number, confirmation, *seven)


@final
class Gimbal:
    """Acquires control, turns the gimbal straight, releases it; repeats without an answer."""

    def __init__(self) -> None:
        self.due_us = NEVER_US
        """When there is something to take."""
        self._sent = 0

    def straighten(self, now_us: int) -> None:
        """A landing begins."""
        self.due_us = now_us + _FIRST_US
        self._sent = 0

    def take(self, now_us: int) -> list[SendMessage]:
        """What is due now."""
        acquire = _command(1001, self._sent, 1.0, 1.0, -1.0, -1.0)
        said = [SendMessage(message=acquire)]
        if self._sent == 0:
            said.append(SendMessage(message=_command(1000, 0, _NAN, _NAN, _NAN, _NAN, 2.0)))
            said.append(SendMessage(message=_command(1001, 0, -3.0, -3.0, -1.0, -1.0)))
        self.due_us = now_us + _AGAIN_US[self._sent] if self._sent < len(_AGAIN_US) else NEVER_US
        self._sent += 1
        return said
