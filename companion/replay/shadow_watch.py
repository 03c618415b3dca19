"""Feeds the frames of a vehicle in a log to sessions in shadow mode.

Only frames of its autopilot and its terrain radar are used, not those of a companion or ground
station on the same link.  Messages that the companion does not use are skipped without decoding.
Time is the vehicle's; silences are the log's.
"""

from collections import Counter, deque
from collections.abc import Callable
from statistics import median
from typing import Final, final

from companion.mavlink.autopilots import FIRMWARES, Autopilot
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, KINDS, Message, wire
from companion.mavlink.frames import boot_ms_of, decoded, number_of, payload_of, sender_of
from companion.mavlink.link import ClockReading, Output, VehicleClock
from companion.mission.mission import Mission
from companion.planning import plan
from companion.replay.shadow_notes import Notes
from companion.replay.shadow_report import VehicleReport
from companion.session import Session
from companion.telemetry.logs import Record

OnOutput = Callable[[float, Output], None]
"""(seconds of the log, what the session gave)."""

HEARTBEAT: Final = wire.MAVLINK_MSG_ID_HEARTBEAT
POSITION: Final = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
GPS: Final = wire.MAVLINK_MSG_ID_GPS_RAW_INT
STATUSTEXT: Final = wire.MAVLINK_MSG_ID_STATUSTEXT
_CLOCKS: Final = frozenset(
    {
        wire.MAVLINK_MSG_ID_ATTITUDE,
        wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        wire.MAVLINK_MSG_ID_SYSTEM_TIME,
    }
)
"""They only tell the time: needed where there is no position to tell it."""
LISTENED: Final = frozenset(
    {
        HEARTBEAT,
        POSITION,
        GPS,
        STATUSTEXT,
        wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        wire.MAVLINK_MSG_ID_HOME_POSITION,
        wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
        wire.MAVLINK_MSG_ID_PARAM_VALUE,
        wire.MAVLINK_MSG_ID_FENCE_STATUS,
        *(each.all_is_well().get_msgId() for each in FIRMWARES),
    }
)
"""Of the autopilot, besides the clocks.  Shadow mode needs neither battery nor setpoint echoes."""
_RADAR: Final = frozenset({wire.MAVLINK_MSG_ID_TERRAIN_DATA, wire.MAVLINK_MSG_ID_TERRAIN_REPORT})
_QUIET_S: Final = 0.2  # less is no silence
_LOOKS_S: Final = (3.0, 10.0, 30.0, 600.0)  # when a silence means something to the session
_TICK_S: Final = 0.1
_OVERDUE: Final = 3.0  # usual periods without a position, before the clock goes on without one
_PERIODS: Final = 21
_FEW: Final = 5
_FIRST_PERIOD_S: Final = 1.0  # until so many are known
_LONGEST_PERIOD_S: Final = 5.0
SLOW_S: Final = 0.17  # between positions: from here on some are taken for late that are not
_STAND_IN_AFTER_S: Final = 10.0
_STAND_IN_S: Final = 1.0
_TYPE_AT: Final = 4  # in the payload of HEARTBEAT


@final
class Watch:
    """Shadow mode for one vehicle of a log, with a new session after each reboot or silence."""

    def __init__(
        self,
        mission: Mission,
        heartbeat: Message,
        autopilot: Autopilot,
        notes: Notes,
        *,
        aboard: bool,
        on_output: OnOutput,
    ) -> None:
        """heartbeat: one of the vehicle's; aboard: the log was written there, not over a link."""
        self._mission, self._autopilot, self._notes = mission, autopilot, notes
        self._on_output = on_output
        self._aboard, self._clock = aboard, VehicleClock(0.0)
        self._system = heartbeat.get_srcSystem()
        self._radar = (self._system, mission.scanner_component_id)
        self._session: Session | None = None
        self._periods: deque[float] = deque(maxlen=_PERIODS)
        self._mode = -1
        self._armed = False
        self._heard_s: float | None = None
        self._position_s: float | None = None
        self._clock_s = 0.0
        self._first_position_s: float | None = None
        self._stand_in_s = -1e9
        self._stand_ins = _all_is_well(self._system, autopilot)
        self.heard_of: Counter[int] = Counter()
        """Message numbers of the autopilot and the radar."""
        self.slow_s = 0.0
        """For how long positions came too seldom to tell in time that one is missing."""
        self.slowest_s = 0.0
        self._positions_s = 0.0  # between all positions, without the gaps
        self.stood_in: dict[str, float] = {}
        """Messages that were taken to be good because there are none, and since when."""

    def on_record(self, record: Record, at_s: float) -> None:
        """The next frame of the log, of any sender; at_s: seconds after the first."""
        frame = record.frame
        sender, number = sender_of(frame), number_of(frame)
        if sender == self._radar and number in _RADAR:
            self.heard_of[number] += 1
            self._feed(frame, record.time_us * 1e-6, at_s)
            return
        if sender != (self._system, AUTOPILOT_COMPONENT):
            return
        self._hear_again(at_s)
        if number == HEARTBEAT and payload_of(frame, 9)[_TYPE_AT] == wire.MAV_TYPE_GENERIC:
            return  # while it boots, it does not say of which kind it is
        self.heard_of[number] += 1
        self._look_at_clock(frame, number, at_s)
        if number in _CLOCKS:
            if not self._tells_time(at_s):
                return
        elif number not in LISTENED:
            return
        self._look_at(frame, number, at_s)
        if number == POSITION:
            self._on_position(at_s, record.time_us * 1e-6)
        self._feed(frame, record.time_us * 1e-6, at_s)

    def finish(self, at_s: float) -> None:
        """The log has ended; the vehicle may have fallen silent long before."""
        if self._heard_s is not None and not self._aboard:
            self._be_silent(self._heard_s, at_s)
        if self._session is not None:
            self._run(self._session, at_s)
        report = self._notes.report
        if self._positions_s > 0.0:
            report.position_rate_hz = self.heard_of[POSITION] / self._positions_s

    # --- time

    def _tells_time(self, at_s: float) -> bool:
        """Whether a message that only tells the time is needed: positions tell it as well."""
        if at_s - self._clock_s < _TICK_S:
            return False
        overdue_s = _OVERDUE * self._period_s()
        if self._position_s is not None and at_s - self._position_s < overdue_s:
            return False
        self._clock_s = at_s
        return True

    def _period_s(self) -> float:
        """Usual time between two positions of late."""
        return median(self._periods) if len(self._periods) >= _FEW else _FIRST_PERIOD_S

    def _on_position(self, at_s: float, wall_s: float) -> None:
        before_s, self._position_s = self._position_s, at_s
        self._clock_s = at_s
        if self._first_position_s is None:
            self._first_position_s = at_s
        if before_s is not None and at_s - before_s < _LONGEST_PERIOD_S:
            self._periods.append(at_s - before_s)
            self._positions_s += at_s - before_s
            period_s = self._period_s()
            if period_s > SLOW_S and len(self._periods) == _PERIODS:
                self.slow_s += at_s - before_s
                self.slowest_s = max(self.slowest_s, period_s)
        if at_s - self._first_position_s >= _STAND_IN_AFTER_S:
            self._stand_in(at_s, wall_s)

    def _look_at_clock(self, frame: bytes, number: int, at_s: float) -> None:
        """Whether it has rebooted, also while no session could tell."""
        boot_ms = boot_ms_of(frame, number)
        if boot_ms is None:
            return
        if self._clock.read(boot_ms * 1e-3, at_s) is ClockReading.REBOOTED:
            self._notes.rebooted(at_s)

    def _hear_again(self, at_s: float) -> None:
        """The autopilot was heard, after whatever time."""
        before_s, self._heard_s = self._heard_s, at_s
        if before_s is None or at_s - before_s < _QUIET_S:
            return
        if not self._aboard:
            self._be_silent(before_s, at_s)
            if at_s - before_s >= _LOOKS_S[0]:
                self._notes.heard_again(at_s)
        elif at_s - before_s >= _LOOKS_S[0]:
            self._notes.not_recorded(before_s, at_s)
            self._session = None

    def _be_silent(self, since_s: float, until_s: float) -> None:
        """Nothing was heard of the autopilot between these times."""
        for silent_s in _LOOKS_S:
            if self._session is None or since_s + silent_s >= until_s:
                break
            self._session.silence(silent_s)
            self._run(self._session, since_s + silent_s)
        if self._session is not None and until_s - since_s < _LOOKS_S[0]:
            self._session.silence(until_s - since_s)

    # --- the session

    def _feed(self, frame: bytes, wall_s: float, at_s: float) -> None:
        session = self._session
        if session is None:
            session = Session(self._mission, seed=1, lockstep=False, shadow=True)
            self._session = session
            self._notes.begin_again()
        self._notes.report.heard += 1
        session.receive(frame, wall_s)
        self._run(session, at_s)

    def _run(self, session: Session, at_s: float) -> None:
        """Note what the session makes of what it was told, and of the plans that it asks for."""
        while True:
            out = session.run()
            self._on_output(at_s, out)
            self._notes.on_output(at_s, session, out.journal)
            if out.plan is None:
                break
            try:
                outcome = plan(out.plan)
            except Exception as error:  # noqa: BLE001 - as in flight: it ends the watch, not the program
                session.part_died("planner", f"{type(error).__name__}: {error}")
            else:
                session.deliver(outcome)
        if out.end is not None:
            self._session = None

    def _stand_in(self, at_s: float, wall_s: float) -> None:
        """Feed messages that report a good GPS and estimator if the log has none."""
        if at_s - self._stand_in_s < _STAND_IN_S:
            return
        self._stand_in_s = at_s
        for number, frame in self._stand_ins.items():
            if not self.heard_of[number]:
                name = KINDS[number].msgname
                self.stood_in.setdefault(name, at_s)
                self._feed(frame, wall_s, at_s)

    # --- what the vehicle does by itself

    def _look_at(self, frame: bytes, number: int, at_s: float) -> None:
        if number == HEARTBEAT:
            beat = decoded(frame, wire.MAVLink_heartbeat_message)
            if beat.custom_mode != self._mode:
                self._mode = beat.custom_mode
                name = self._autopilot.modes.name_of(self._mode)
                self._notes.say(VehicleReport(at_s=at_s, what="mode", text=name))
            armed = bool(beat.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED)
            if armed is not self._armed:
                self._notes.say(VehicleReport(at_s=at_s, what="armed" if armed else "disarmed"))
                self._armed = armed
        elif number == STATUSTEXT:
            payload = payload_of(frame, 54)
            if payload[0] <= wire.MAV_SEVERITY_WARNING:
                raw = payload[1:51].split(b"\0")[0].decode("utf-8", "replace")
                text = "".join(c for c in raw if c.isprintable())
                self._notes.say(VehicleReport(at_s=at_s, what="says", text=text))


def _all_is_well(system_id: int, autopilot: Autopilot) -> dict[int, bytes]:
    """Frames by message number that report a good GPS and estimator, for logs without them."""
    codec = wire.MAVLink(None, srcSystem=system_id, srcComponent=AUTOPILOT_COMPONENT)
    fix = wire.MAVLink_gps_raw_int_message(
        0, wire.GPS_FIX_TYPE_3D_FIX, 0, 0, 0, 65535, 65535, 65535, 65535, 255
    )
    sure = autopilot.firmware.all_is_well()
    return {each.get_msgId(): bytes(each.pack(codec)) for each in (fix, sure)}
