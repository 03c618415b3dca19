"""Shadow mode on a log: what the companion would have done on a recorded flight.

    report = watch(path, mission)

The log is read once, in bounded memory, after a scan for its vehicle and first position.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final, final

from msgspec import Struct

from companion.errors import InputError
from companion.geodesy import LocalFrame, deg
from companion.mavlink.autopilots import NAMES, Autopilot, autopilot_of, described
from companion.mavlink.autopilots.messages import is_nowhere
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mavlink.frames import Receiver, number_of, sender_of
from companion.mavlink.who import TO_COMPONENT_1, ids_in_words
from companion.mission.mission import EndAction, Mission
from companion.path.limits import Limits
from companion.planner.settings import PlannerSettings, Task
from companion.replay.shadow_notes import Notes
from companion.replay.shadow_report import Limitation, ShadowReport
from companion.replay.shadow_watch import GPS, HEARTBEAT, POSITION, SLOW_S, OnOutput, Watch
from companion.telemetry.logs import Log, Missing, Odd, open_log

_SHOWN_BYTES: Final = 65_536
_PATIENCE_US: Final = 30_000_000  # for a word of the GPS, once there are positions
_FAR_M: Final = 50_000.0
_RANGE_M: Final = 20_000.0
_LOSSES: Final = (Odd.GARBAGE, Odd.CHECKSUM, Odd.DAMAGED, Odd.WRONG_STAMP)
"""What may be why a message is not in a log."""
_TERRAIN: Final = wire.MAVLINK_MSG_ID_TERRAIN_DATA


def watch(
    path: Path,
    mission: Mission | None,
    *,
    plans: bool = True,
    system_id: int | None = None,
    on_progress: Callable[[int, int], None] = lambda _read, _size: None,
    on_output: OnOutput = lambda _at_s, _out: None,
) -> ShadowReport:
    """Run the companion in shadow on a log.

    Parameters
    ----------
    path: of a .tlog, an ArduPilot .bin or a PX4 .ulg.
    mission: what to plan; None: only the vehicle's health is looked at.
    plans: False: nothing is planned.
    system_id: of the vehicle, if there are several in the log; the mission's if it names one.
    on_progress: told the bytes read and their sum, now and then.
    on_output: called with each output of the session.

    Raises InputError if log, vehicle and mission do not fit together.
    """
    began_s = time.perf_counter()
    wanted = system_id if system_id is not None or mission is None else mission.system_id
    log = open_log(path, system_id=wanted)
    look = _look(log)
    if mission is not None:
        _check_fits(mission, look)
    chosen = replace(mission or _health_alone(look), system_id=look.heartbeat.get_srcSystem())
    plans = plans and mission is not None
    if not plans:
        chosen = replace(chosen, targets_ne_m=(), targets_from_vehicle=False)
    charted = chosen.known is not None and bool(chosen.known.surveyed.any())
    blind = charted and chosen.scanner_component_id is not None
    if blind:  # what a radar answered then, it did not answer to these questions
        chosen = replace(chosen, scanner_component_id=None)
    report = ShadowReport(
        file=log.path.name,
        kind=log.kind,
        system_id=look.heartbeat.get_srcSystem(),
        vehicle=described(look.heartbeat),
        mission=None if mission is None else mission.name,
        planned=plans,
    )
    notes = Notes(report, chosen.frame, checks_area=mission is not None)
    watching = Watch(
        chosen,
        look.heartbeat,
        look.autopilot,
        notes,
        aboard=log.kind != "tlog",
        on_output=on_output,
    )
    first_us, now_us, shown = None, 0, 0
    for record in log.records():
        now_us = record.time_us
        first_us = now_us if first_us is None else first_us
        report.records += 1
        watching.on_record(record, (now_us - first_us) * 1e-6)
        if log.read_bytes - shown >= _SHOWN_BYTES:
            shown = log.read_bytes
            on_progress(shown, log.size_bytes)
    report.began_us = first_us or 0
    report.length_s = 0.0 if first_us is None else (now_us - first_us) * 1e-6
    watching.finish(report.length_s)
    on_progress(log.size_bytes, log.size_bytes)
    for seen in (report.health, report.outside):
        seen.sort(key=lambda each: each.from_s)
    report.missing, report.log_findings = log.missing(), log.findings
    report.could_not = list(_could_not(chosen, watching, notes))
    report.notes = [
        *(() if mission is None else mission.notes),
        *(["planned on the terrain of the mission alone, without its radar"] * (blind and plans)),
        *notes.judged,
        *(
            f"gave up watching {count} time{'s' if count > 1 else ''}: {why}"
            for why, count in notes.ends.items()
        ),
    ]
    report.took_s = time.perf_counter() - began_s
    return report


# --- the first look


@final
class _LogOverview(Struct, frozen=True, kw_only=True):
    """Vehicle and first position of a log."""

    heartbeat: Message
    autopilot: Autopilot
    place: tuple[float, float, float]
    """Latitude, longitude and altitude AMSL: of the first position with a GPS fix, if any has."""


def _look(log: Log) -> _LogOverview:
    """Read the log up to the first position that may be one.  InputError if nothing can be done."""
    heartbeat: Message | None = None
    first: tuple[float, float, float] | None = None
    place: tuple[float, float, float] | None = None
    first_us, fix = 0, False
    receiver = Receiver()
    for record in log.records():
        number, sender = number_of(record.frame), sender_of(record.frame)
        if number not in (HEARTBEAT, POSITION, GPS) or sender[1] != AUTOPILOT_COMPONENT:
            continue
        if log.system_id != sender[0]:
            continue
        for message in receiver.feed(record.frame):
            if number == HEARTBEAT:
                if heartbeat is None or autopilot_of(heartbeat) is None:
                    heartbeat = message  # the first may be of no kind: it boots
            elif number == GPS:
                fix = message.fix_type >= wire.GPS_FIX_TYPE_3D_FIX
            elif (here := _place_of(message)) is not None:
                if first is None:
                    first, first_us = here, record.time_us
                if fix or record.time_us - first_us > _PATIENCE_US:
                    place = here if fix else first
        if heartbeat is not None and autopilot_of(heartbeat) is not None and place is not None:
            break
    place = place or first
    if heartbeat is None:
        raise _of_no_use(log, "HEARTBEAT")
    autopilot = autopilot_of(heartbeat)
    if autopilot is None:  # whatever else it lacks
        rule = f"it is of {described(heartbeat)}, which the companion does not fly"
        raise InputError("LOG", str(log.path), rule, f"It flies: {', '.join(NAMES)}.")
    if place is None:
        raise _of_no_use(log, "GLOBAL_POSITION_INT")
    return _LogOverview(heartbeat=heartbeat, autopilot=autopilot, place=place)


def _place_of(message: Message) -> tuple[float, float, float] | None:
    """Of GLOBAL_POSITION_INT; None if it is none."""
    latitude, longitude = deg(message.lat), deg(message.lon)
    if is_nowhere(latitude, longitude) or abs(latitude) > 90.0 or abs(longitude) > 180.0:
        return None
    return latitude, longitude, message.alt * 1e-3


def _of_no_use(log: Log, name: str) -> InputError:
    """The error about a log without a usable position."""
    if log.system_id is None and log.elsewhere:
        ids = ids_in_words(sorted(log.elsewhere))
        rule = f"it has no HEARTBEAT of component 1, as autopilots are; it has that of {ids}"
        return InputError("LOG", str(log.path), rule, f"{TO_COMPONENT_1} Then record again.")
    missing: Missing | None = next((each for each in log.missing() if name in each.message), None)
    if missing is not None:
        rule = f"it has no {missing.message}: {missing.without}"
        lost = [each.said(count) for each in _LOSSES if (count := log.odd[each]) > 0]
        lost += [each for each in log.substitutes if name in each]
        rule = "; ".join([rule, *lost])
        return InputError("LOG", str(log.path), rule, f"{missing.remedy}.")
    rule = "its vehicle never knew where it was: each position is 0, 0"
    return InputError("LOG", str(log.path), rule, "Give a log of a flight with a position.")


# --- the mission


def _check_fits(mission: Mission, look: _LogOverview) -> None:
    """Raise InputError if the mission is none for this vehicle at this place."""
    remedy = "Give the mission of this flight, or leave --mission out for its health alone."
    kind, family = look.autopilot.traits.kind, look.autopilot.firmware.name
    if mission.kind != kind or mission.autopilot not in (None, family):
        wanted = f"{mission.autopilot or 'any autopilot'}, {mission.kind}"
        rule = f"it is for {wanted}; the log is of {described(look.heartbeat)}"
        raise InputError("--mission", mission.name, rule, remedy)
    latitude, longitude, _ = look.place
    north_m, east_m = mission.frame.to_local_m(latitude, longitude)
    limits = mission.task.limits
    inside = limits.north_m[0] <= north_m <= limits.north_m[1]
    if not (inside and limits.east_m[0] <= east_m <= limits.east_m[1]):
        rule = (
            f"the flight begins at {latitude:.6f}, {longitude:.6f}, {_m(north_m)} north and "
            f"{_m(east_m)} east of the mission's origin, outside its [area] "
            f"(north {_m(limits.north_m[0])} to {_m(limits.north_m[1])}, "
            f"east {_m(limits.east_m[0])} to {_m(limits.east_m[1])})"
        )
        raise InputError("--mission", mission.name, rule, remedy)


def _health_alone(look: _LogOverview) -> Mission:
    """A mission about the first position that goes nowhere."""
    hovers = look.autopilot.traits.hovers
    latitude, longitude, _ = look.place
    limits = Limits(
        speed_m_s=15.0 if hovers else 30.0,
        acceleration_m_s2=2.0,
        climb_rate_m_s=3.0,
        turn_radius_m=50.0 if hovers else 150.0,
        climb_angle_rad=math.radians(10.0),
        dive_angle_rad=math.radians(10.0),
        floor_amsl_m=-500.0,
        ceiling_amsl_m=20_000.0,
        north_m=(-_FAR_M, _FAR_M),
        east_m=(-_FAR_M, _FAR_M),
        loiter_radius_m=0.0 if hovers else 150.0,
    )
    settings = PlannerSettings(scan_range_m=_RANGE_M, safety_distance_m=30.0, planning_time_s=3.0)
    return Mission(
        name="health alone",
        frame=LocalFrame(latitude_deg=latitude, longitude_deg=longitude),
        targets_ne_m=(),
        task=Task(limits=limits, settings=settings),
        end_action=EndAction.HOLD,
        scanner_component_id=None,
        fence_from_vehicle=False,
    )


def _m(value_m: float) -> str:
    return f"{value_m / 1000.0:,.1f} km" if abs(value_m) >= 10_000.0 else f"{value_m:,.0f} m"


# --- what there is to say besides


def _could_not(mission: Mission, watching: Watch, notes: Notes) -> Iterator[Limitation]:
    """Limitations other than those of missing messages."""
    report, rate_hz = notes.report, mission.position_rate_hz
    remedies = {name: each.remedy for each in report.missing for name in each.message.split(" or ")}
    for name, since_s in watching.stood_in.items():
        what = "the GPS" if name == "GPS_RAW_INT" else "its estimator"
        yield Limitation(
            what=f"tell whether {what} is to be believed",
            because=f"{name} is missing: from {since_s:.0f} s on it was taken to be good "
            "(in flight the companion would not have begun)",
            remedy=remedies.get(name, "It came later in the log"),
            message=name,
        )
    if watching.slow_s > 0.0:
        yield Limitation(
            what="tell in time that a position is missing",
            because=f"GLOBAL_POSITION_INT comes at less than {1.0 / SLOW_S:.1f} Hz for "
            f"{math.ceil(watching.slow_s):,} s in all (at the slowest at "
            f"{1.0 / watching.slowest_s:.1f} Hz): in flight the companion asks for "
            f"{rate_hz:g} Hz, and takes 0.5 s without one for a fault",
            remedy="Record it at 6 Hz or more",
            message="GLOBAL_POSITION_INT",
        )
    if report.watched_from_s is None:
        yield Limitation(
            what="begin",
            because="the position was never one to be believed",
            remedy="See what is missing, and the vehicle's health",
        )
    if report.planned and mission.targets_from_vehicle:
        yield Limitation(
            what="plan to the targets of the vehicle's own mission",
            because="a log does not answer questions: MISSION_ITEM_INT is not heard",
            remedy="Give a mission with [[targets]]",
            message="MISSION_ITEM_INT",
        )
    if report.planned and notes.unanswered_scans and mission.scanner_component_id is not None:
        if watching.heard_of[_TERRAIN]:
            because = "TERRAIN_DATA of the log answers other questions than the shadow has"
        else:
            because = "TERRAIN_DATA is missing: nothing is known of the ground"
        refused = notes.refusals["NOTHING_SEEN"] + notes.refusals["START_NEAR_UNKNOWN"]
        yield Limitation(
            what=f"plan as it would ({notes.unanswered_scans} scans unanswered, "
            f"{refused} plans refused for it)",
            because=because,
            remedy="Give the mission [terrain]: an elevation file, or highest_amsl_m",
            message="TERRAIN_DATA",
        )
