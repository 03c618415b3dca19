"""PX4's events, and its report of health and arming checks, as bytes that were recorded.

The arguments of the checks are copied from the logs: their layouts are PX4's private matter, and a
client reads them with the metadata of the firmware.
"""

from typing import Final, final

import numpy as np

from vehicle_sim.autopilots import Event, Text

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
