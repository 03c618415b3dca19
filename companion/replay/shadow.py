"""Shadow mode on a log: what the companion would have done on a recorded flight.

    report = watch(path, mission)

The log is read once, in bounded memory, after a scan for its vehicle and first position.  Only
frames of the vehicle's autopilot are used, not those of a companion, a radar or a ground station
on the same link.  Time is the vehicle's; silences are the log's.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple, final

from companion.errors import InputError
from companion.geodesy import LocalFrame, deg
from companion.mavlink.autopilots import FIRMWARES, NAMES, Autopilot, autopilot_of, described
from companion.mavlink.autopilots.messages import NOWHERE_DEG
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, KINDS, Message, wire
from companion.mavlink.frames import decoded, number_of, payload_of, sender_of
from companion.mavlink.link import TIME_ONLY_MESSAGES, TO_COMPONENT_1, Output, ids_in_words
from companion.mavlink.signing import strip_signature
from companion.mission.mission import EndAction, Mission
from companion.path.limits import Limits
from companion.planner.settings import PlannerSettings, Task
from companion.planning import plan
from companion.replay.shadow_notes import Notes
from companion.replay.shadow_report import ShadowReport
from companion.session import Session
from companion.telemetry.logs import HOW_TO_RECORD, Log, Record, open_log
from companion.views.words import metres

HEARTBEAT: Final = wire.MAVLINK_MSG_ID_HEARTBEAT
POSITION: Final = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
GPS: Final = wire.MAVLINK_MSG_ID_GPS_RAW_INT
STATUSTEXT: Final = wire.MAVLINK_MSG_ID_STATUSTEXT
_CLOCKS: Final = TIME_ONLY_MESSAGES | {wire.MAVLINK_MSG_ID_SYSTEM_TIME}
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
        *(firmware.all_is_well().get_msgId() for firmware in FIRMWARES),
    }
)
"""Of the autopilot, besides the clocks.  Shadow mode needs neither battery nor setpoint echoes, and
what the autopilot answered to others is no answer to it."""
_LOOKS_S: Final = (3.0, 10.0, 30.0, 600.0)  # when a silence means something to the session
_OVERDUE: Final = 3.0  # usual periods without a position, before the clock goes on without one
_PERIODS: Final = 21
_FEW: Final = 5
_FIRST_OVERDUE_S: Final = 3.0  # until so many are known
_LONGEST_PERIOD_S: Final = 5.0
_SLOW_HZ: Final = 6.0  # positions that come less often: some are taken for late that are not
_STAND_IN_AFTER_S: Final = 10.0
_STAND_IN_S: Final = 1.0
_TYPE_AT: Final = 4  # in the payload of HEARTBEAT
_LOOKED_AT: Final = (HEARTBEAT, POSITION, GPS)


def watch(
    path: Path,
    mission: Mission | None,
    *,
    system_id: int | None = None,
    on_output: Callable[[float, Output], None] = lambda _at_s, _out: None,
) -> ShadowReport:
    """Run the companion in shadow on a log: a .tlog, an ArduPilot .bin or a PX4 .ulg.

    mission: what to plan; None: only the vehicle's health is looked at.
    system_id: of the vehicle, if there are several in the log; the mission's if it names one.
    on_output: told the seconds of the log, and what the session gave.

    Raises InputError if log, vehicle and mission do not fit together.
    """
    wanted = system_id if system_id is not None or mission is None else mission.system_id
    log = open_log(path, system_id=wanted)
    look = _look(log)
    if mission is not None:
        _check_fits(mission, look)
    chosen = replace(
        mission or _health_alone(look),
        system_id=log.system_id,
        scanner_component_id=None,  # what a radar answered then, it did not answer to this shadow
    )
    report = ShadowReport(
        file=log.path.name,
        system_id=look.heartbeat.get_srcSystem(),
        vehicle=described(look.heartbeat),
        mission=None if mission is None else mission.name,
        notes=[] if mission is None else [*mission.notes],
    )
    if mission is not None and mission.scanner_component_id is not None:
        report.notes.append("planned on the terrain of the mission alone, without its radar")
    notes = Notes(report, chosen.frame)
    watching = Watch(chosen, log, look, notes, on_output)
    for record in log.records():
        watching.on_record(record)
    watching.finish()
    report.missing, report.log_findings = log.missing(), log.findings
    report.could_not = list(_could_not(chosen, watching, report))
    return report


# --- log, vehicle and mission


class _Look(NamedTuple):
    """The vehicle of a log, and the first position that it can be believed to have."""

    heartbeat: Message
    autopilot: Autopilot
    latitude_deg: float
    longitude_deg: float


def _look(log: Log) -> _Look:
    """Read the log up to the first position with a GPS fix; if none has one, the first of all.

    InputError if nothing can be done with it.
    """
    heartbeat: Message | None = None
    autopilot: Autopilot | None = None
    place: tuple[float, float] | None = None
    fix = believed = False
    for record in log.records():
        number, sender = number_of(record.frame), sender_of(record.frame)
        if sender != (log.system_id, AUTOPILOT_COMPONENT) or number not in _LOOKED_AT:
            continue
        message = decoded(strip_signature(record.frame), KINDS[number])
        if number == HEARTBEAT and autopilot is None:
            heartbeat, autopilot = message, autopilot_of(message)  # while it boots it is of no kind
        elif number == GPS:
            fix = message.fix_type >= wire.GPS_FIX_TYPE_3D_FIX
        elif number == POSITION and not believed and (fix or place is None):
            place_deg = deg(message.lat), deg(message.lon)
            if _is_a_place(*place_deg):
                place, believed = place_deg, fix
        if autopilot is not None and believed:
            break
    if heartbeat is None:
        raise _of_no_use(log, "HEARTBEAT")
    if autopilot is None:  # whatever else it lacks
        rule = f"it is of {described(heartbeat)}, which the companion does not fly"
        raise InputError("LOG", str(log.path), rule, f"It flies: {', '.join(NAMES)}.")
    if place is None:
        raise _of_no_use(log, "GLOBAL_POSITION_INT")
    return _Look(heartbeat, autopilot, *place)


def _is_a_place(latitude_deg: float, longitude_deg: float) -> bool:
    is_on_earth = abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0
    return is_on_earth and max(abs(latitude_deg), abs(longitude_deg)) >= NOWHERE_DEG


def _of_no_use(log: Log, name: str) -> InputError:
    """The error about a log without a usable position."""
    if log.system_id is None and log.elsewhere:
        ids = ids_in_words(sorted(log.elsewhere))
        rule = f"it has no HEARTBEAT of component 1, as autopilots are; it has that of {ids}"
        return InputError("LOG", str(log.path), rule, f"{TO_COMPONENT_1} Then record again.")
    for message, without in log.missing().items():
        if name in message:  # what was odd about the log may be why
            rule = "; ".join([f"it has no {message}: {without}", *log.findings])
            return InputError("LOG", str(log.path), rule, f"{HOW_TO_RECORD}.")
    rule = "its vehicle never knew where it was: each position is 0, 0"
    return InputError("LOG", str(log.path), rule, "Give a log of a flight with a position.")


def _check_fits(mission: Mission, look: _Look) -> None:
    """Raise InputError if the mission is none for this vehicle at this place."""
    remedy = "Give the mission of this flight, or leave --mission out for its health alone."
    kind, family = look.autopilot.traits.kind, look.autopilot.firmware.name
    if mission.kind != kind or mission.autopilot not in (None, family):
        wanted = f"{mission.autopilot or 'any autopilot'}, {mission.kind}"
        rule = f"it is for {wanted}; the log is of {described(look.heartbeat)}"
        raise InputError("--mission", mission.name, rule, remedy)
    north_m, east_m = mission.frame.to_local_m(look.latitude_deg, look.longitude_deg)
    (south, north), (west, east) = mission.task.limits.north_m, mission.task.limits.east_m
    if not (south <= north_m <= north and west <= east_m <= east):
        rule = (
            f"the flight begins at {look.latitude_deg:.6f}, {look.longitude_deg:.6f}, "
            f"{metres(north_m)} north and {metres(east_m)} east of its origin, outside its [area]"
        )
        raise InputError("--mission", mission.name, rule, remedy)


def _health_alone(look: _Look) -> Mission:
    """A mission about the first position that goes nowhere."""
    hovers, far_m = look.autopilot.traits.hovers, (-50_000.0, 50_000.0)
    limits = Limits(
        speed_m_s=15.0 if hovers else 30.0,
        acceleration_m_s2=2.0,
        climb_rate_m_s=3.0,
        turn_radius_m=50.0 if hovers else 150.0,
        climb_angle_rad=math.radians(10.0),
        dive_angle_rad=math.radians(10.0),
        floor_amsl_m=-500.0,
        ceiling_amsl_m=20_000.0,
        north_m=far_m,
        east_m=far_m,
        loiter_radius_m=0.0 if hovers else 150.0,
    )
    settings = PlannerSettings(scan_range_m=20_000.0, safety_distance_m=30.0, planning_time_s=3.0)
    return Mission(
        name="health alone",
        frame=LocalFrame(latitude_deg=look.latitude_deg, longitude_deg=look.longitude_deg),
        targets_ne_m=(),
        task=Task(limits=limits, settings=settings),
        end_action=EndAction.HOLD,
        scanner_component_id=None,
        fence_from_vehicle=False,
    )


# --- the log, frame by frame


@final
class Watch:
    """Feeds the vehicle's frames to a session; after a gap or an end, to a new one."""

    def __init__(
        self,
        mission: Mission,
        log: Log,
        look: _Look,
        notes: Notes,
        on_output: Callable[[float, Output], None],
    ) -> None:
        """mission: with the vehicle's system id."""
        self._mission, self._log, self._notes, self._on_output = mission, log, notes, on_output
        self._modes = look.autopilot.modes
        self._vehicle = look.heartbeat.get_srcSystem(), AUTOPILOT_COMPONENT
        self._session: Session | None = None
        self._at_s = 0.0
        """Of the newest record, since the first one."""
        self._heard_s: float | None = None
        self._mode, self._armed = -1, False
        self._position_s = -math.inf
        self._periods: deque[float] = deque(maxlen=_PERIODS)
        self._positions = 0
        self._positions_s = 0.0  # between all positions, without the gaps
        self.stood_in_s: dict[str, float] = {}
        """Messages that were taken to be good because there are none, and since when."""
        self._stand_ins = _all_is_well(self._vehicle[0], look.autopilot)
        self._stand_in_due_s = math.inf

    def on_record(self, record: Record) -> None:
        """The next frame of the log, of any sender."""
        frame, report = record.frame, self._notes.report
        report.began_us = record.time_us if report.began_us is None else report.began_us
        self._at_s, number = (record.time_us - report.began_us) * 1e-6, number_of(frame)
        if sender_of(frame) != self._vehicle:
            return
        if self._heard_s is not None and self._at_s - self._heard_s >= _LOOKS_S[0]:
            self._not_heard_since(self._heard_s)
        self._heard_s = self._at_s
        if number == HEARTBEAT and payload_of(frame, 9)[_TYPE_AT] == wire.MAV_TYPE_GENERIC:
            return  # while it boots, it does not say of which kind it is
        if number in LISTENED or (number in _CLOCKS and self._is_overdue()):
            self._look_at(frame, number)
            if number == POSITION:
                self._on_position()
            self._feed(frame)

    def finish(self) -> None:
        """The log has ended; the vehicle may have fallen silent long before."""
        report = self._notes.report
        report.length_s = self._at_s
        if self._heard_s is not None and self._log.kind == "tlog":
            self._not_heard_since(self._heard_s)
        if self._positions_s > 0.0:
            report.position_rate_hz = self._positions / self._positions_s
        self._notes.finish()

    # --- time

    def _is_overdue(self) -> bool:
        """Whether a position is missing: until then, what only tells the time is not needed."""
        is_known = len(self._periods) >= _FEW
        overdue_s = _OVERDUE * median(self._periods) if is_known else _FIRST_OVERDUE_S
        return self._at_s - self._position_s >= overdue_s

    def _on_position(self) -> None:
        period_s, self._position_s = self._at_s - self._position_s, self._at_s
        self._positions += 1
        if period_s < _LONGEST_PERIOD_S:
            self._periods.append(period_s)
            self._positions_s += period_s
        self._stand_in_due_s = min(self._stand_in_due_s, self._at_s + _STAND_IN_AFTER_S)
        if self._at_s >= self._stand_in_due_s:
            self._stand_in_due_s = self._at_s + _STAND_IN_S
            for number in self._stand_ins.keys() - self._log.heard:
                self.stood_in_s.setdefault(KINDS[number].msgname, self._at_s)
                self._feed(self._stand_ins[number])

    def _not_heard_since(self, since_s: float) -> None:
        """The link was silent, up to now; or a log that is written aboard was not written."""
        if self._log.kind != "tlog":
            self._notes.not_recorded(since_s, self._at_s)
            self._session = None
        for look_s in _LOOKS_S:
            if self._session is not None and since_s + look_s < self._at_s:
                self._session.silence(look_s)
                self._run(self._session, since_s + look_s, silent_from_s=since_s)

    # --- the session

    def _feed(self, frame: bytes) -> None:
        if (session := self._session) is None:
            session = self._session = Session(self._mission, seed=1, lockstep=False, shadow=True)
            self._notes.begin_again()
        session.receive(frame, self._at_s)
        self._run(session, self._at_s)

    def _run(self, session: Session, at_s: float, silent_from_s: float | None = None) -> None:
        """Note what the session makes of what it was told, and of the plans that it asks for."""
        while True:
            out = session.run()
            self._on_output(at_s, out)
            self._notes.on_output(at_s, session, out.journal, silent_from_s)
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

    def _look_at(self, frame: bytes, number: int) -> None:
        """What the vehicle does and says by itself."""
        if number not in (HEARTBEAT, STATUSTEXT):
            return
        message, say = decoded(strip_signature(frame), KINDS[number]), self._notes.say
        if number == STATUSTEXT:
            if message.severity <= wire.MAV_SEVERITY_WARNING:
                say(self._at_s, f"“{message.text}”")
            return
        if message.custom_mode != self._mode:
            self._mode = message.custom_mode
            say(self._at_s, f"mode {self._modes.name_of(self._mode)}")
        if (armed := bool(message.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED)) is not self._armed:
            self._armed = armed
            say(self._at_s, "armed" if armed else "disarmed")


def _all_is_well(system_id: int, autopilot: Autopilot) -> dict[int, bytes]:
    """Frames by message number that report a good GPS and estimator, for logs without them."""
    codec = wire.MAVLink(None, srcSystem=system_id, srcComponent=AUTOPILOT_COMPONENT)
    fix = wire.MAVLink_gps_raw_int_message(
        0, wire.GPS_FIX_TYPE_3D_FIX, 0, 0, 0, 65535, 65535, 65535, 65535, 255
    )
    sure = autopilot.firmware.all_is_well()
    return {message.get_msgId(): bytes(message.pack(codec)) for message in (fix, sure)}


def _could_not(mission: Mission, watching: Watch, report: ShadowReport) -> Iterator[str]:
    """What shadow mode could not do on this log, beside that for which messages are missing."""
    rate_hz, known = report.position_rate_hz, mission.known
    if names := " and ".join(watching.stood_in_s):
        since_s = min(watching.stood_in_s.values())
        yield (
            f"tell whether the position is to be believed: {names} missing: taken to be good from "
            f"{since_s:.0f} s on (in flight it would not have begun). {HOW_TO_RECORD}"
        )
    if rate_hz is not None and rate_hz < _SLOW_HZ:
        yield (
            "tell in time that a position is missing: GLOBAL_POSITION_INT comes at "
            f"{rate_hz:.1f} Hz. Record it at {_SLOW_HZ:g} Hz or more"
        )
    if mission.targets_from_vehicle:
        yield (
            "plan to the targets of the vehicle's own mission: a log does not answer questions: "
            "MISSION_ITEM_INT is not heard. Give a mission with [[targets]]"
        )
    if report.plans and (known is None or not known.surveyed.any()):
        yield (
            "plan as it would: a log does not answer scans: nothing is known of the ground. Give "
            "the mission [terrain]: an elevation file, or highest_amsl_m"
        )
