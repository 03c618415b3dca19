"""Observes the session in shadow mode and notes what it would have done.

Lists are limited, and the rest is counted, so that memory is bounded for long logs.
"""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, Final, final

import numpy as np

from companion.geodesy import FloatArray, LocalFrame
from companion.mavlink.autopilot_client import AutopilotClient
from companion.mavlink.parameter_checks import Severity
from companion.mission import journal
from companion.mission.entries import Entry
from companion.mission.events import Item, Landed, Vector
from companion.mission.health import distrust
from companion.mission.state import Phase, Reason, State, Vehicle
from companion.path.limits import Limits
from companion.path.subpath import Subpath
from companion.planner.request import Refusal
from companion.replay.shadow_report import (
    Hold,
    HoldReason,
    Observed,
    Place,
    PlanAttempt,
    ShadowReport,
    TrackDeviation,
    VehicleReport,
)
from companion.session import Session

MOST: Final = 2000
"""Of each kind of thing."""
_MAX_WHY: Final = 50
_MAX_OPEN: Final = 100  # plans that a path may still belong to
_EVER: Final = -1e8  # before that: not heard of yet
_AT_END_M: Final = 1.0
_SPACING_M: Final = 5.0
_BEGINS: Final = "it begins to watch"
_MAX_CHORDS: Final = 400

_DOUBTS: Final = {
    Reason.POSITION_STALE: "no position",
    Reason.POSITION_FROZEN: "position stands still",
    Reason.POSITION_ELSEWHERE: "position where the vehicle cannot be",
    Reason.HEALTH_SILENT: "no word of GPS or estimator",
    Reason.INACCURATE: "position less accurate than allowed",
}
_DISTRUST: Final = {
    *_DOUBTS,
    Reason.POSITION_JUMPED,
    Reason.NO_FIX,
    Reason.ESTIMATOR,
}
"""Reasons for an invalid position (mission/health.py).  Missing plans are not among them: each
plan's result is reported separately."""


@final
class Notes:
    """The notes of one flight in shadow mode."""

    def __init__(self, report: ShadowReport, frame: LocalFrame, *, checks_area: bool) -> None:
        """report: what is noted goes there; checks_area: there is a mission with an area."""
        self.report = report
        self.health = _Spans(report.health, report.left_out, self._place)
        self.outside = _Spans(report.outside, report.left_out, self._place)
        self.unanswered_scans = 0
        self.refusals: Counter[str] = Counter()
        self.ends: Counter[str] = Counter()
        """Why the companion gave up watching, before it began again."""
        self.judged: dict[str, None] = {}
        """What of the vehicle it would have refused or changed, in order."""
        self._frame, self._checks_area = frame, checks_area
        self._hold: Hold | None = None
        self._is_ready = False
        """Whether it could fly: the position was to be believed, since this session has begun."""
        self._had_fix = self._silent = False
        self._state: State | None = None
        self._open: dict[int, PlanAttempt] = {}
        self._cause = _BEGINS
        self._path: _Path | None = None
        self._paths: dict[int, _Path] = {}
        """That and its successor, by the plan's number."""
        self._target = 0
        self._at_s: float | None = None
        self._was_in_air: bool | None = None
        self._position_at_s = self._jumped_at_s = -1e9
        self._position: Vector | None = None

    def begin_again(self, *, afresh: bool = False) -> None:
        """A new session begins.

        afresh: discard the notes in progress as well.
        """
        self._forget_paths()
        if afresh:
            self._hold, self._is_ready, self._was_in_air = None, False, None
            self._cause = _BEGINS
        self._position = None
        self._position_at_s = self._jumped_at_s = -1e9
        self._target = 0

    def heard_again(self, at_s: float) -> None:
        """The vehicle was heard after a silence."""
        self._silent = False
        self._at_s = at_s
        self.health.set("silence", on=False, at_s=at_s)

    def not_recorded(self, from_s: float, until_s: float) -> None:
        """The log has a gap: end everything in progress."""
        self._end_all(from_s)
        self.health.set("not recorded", on=True, at_s=from_s)
        self.health.set("not recorded", on=False, at_s=until_s)
        self._at_s = until_s

    def rebooted(self, at_s: float) -> None:
        """The vehicle's clock has begun again."""
        if self._state is not None:
            self._note_at("the autopilot has rebooted", at_s, self._state)

    def say(self, said: VehicleReport) -> None:
        """The vehicle has said something."""
        self._keep(self.report.said, said, "said")

    def on_output(self, at_s: float, session: Session, entries: list[Entry]) -> None:
        """The session has been run.  at_s: of the log."""
        self._state = state = session.state
        for values in entries:
            self._on_entry(at_s, entry := journal.entry_of(values), state)
            if isinstance(entry, journal.Prepared) and session.vehicle is not None:
                self._on_parameters(session.vehicle)
        if self._silent:  # what it was when it was last heard is not known to go on
            self._on_hold(at_s, state, None)
            return
        in_air = is_in_air(state.vehicle)
        if self._at_s is not None and in_air:
            self.report.in_air_s += at_s - self._at_s
        self._at_s = at_s
        if in_air is not self._was_in_air:
            if self._was_in_air is not None or in_air:
                self.say(VehicleReport(at_s=at_s, what="in the air" if in_air else "on the ground"))
            self._was_in_air = in_air
        doubt = distrust(state.vehicle, state.now_s, state.task.limits)
        self._on_hold(at_s, state, doubt)
        self._on_health(at_s, state, doubt)
        if self._is_ready and state.vehicle.position_at_s != self._position_at_s:
            self._on_position(at_s, state, doubt)

    # --- what it would have done

    def _on_hold(self, at_s: float, state: State, doubt: Reason | None) -> None:
        watching = state.phase is Phase.SHADOW
        if not self._is_ready:
            self._is_ready = watching and state.reason not in _DISTRUST
            if self._is_ready and self.report.watched_from_s is None:
                self.report.watched_from_s = at_s
            return
        reason = self._reason(state, watching=watching)
        hold = self._hold
        if reason is None:
            if hold is not None:
                hold.went_on_s = at_s
                hold.trusted_s = at_s if hold.trusted_s is None else hold.trusted_s
                self._hold, self._cause = None, f"it goes on after: {hold.why[0].text}"
            return
        if hold is None:
            hold = self._hold = self._new_hold(at_s, state)
        if not hold.why or hold.why[-1].code != reason.name:
            why = HoldReason(at_s=at_s, code=reason.name, text=reason.text, remedy=reason.remedy)
            if len(hold.why) < _MAX_WHY:
                hold.why.append(why)
        trusted = doubt is None and not self._silent and watching
        hold.trusted_s = (hold.trusted_s or at_s) if trusted else None

    def _new_hold(self, at_s: float, state: State) -> Hold:
        hold = Hold(
            let_go_s=at_s,
            vehicle_s=state.now_s,
            why=[],
            place=self._place(state.vehicle.position_nea_m),
            in_air=is_in_air(state.vehicle),
        )
        for asked in self._open.values():
            if asked.outcome == "unanswered":
                asked.outcome = "given up"
        self._forget_paths()
        self._keep(self.report.holds, hold, "holds")
        return hold

    def _reason(self, state: State, *, watching: bool) -> Reason | None:
        """Why it would hold now; None: it would not."""
        if self._silent:
            return Reason.LINK_LOST
        if watching:
            return state.reason if state.reason in _DISTRUST else None
        before = self._hold
        if before is not None and before.why:  # it prepares again, or another session does
            return Reason[before.why[-1].code]
        return state.reason or Reason.REBOOTED

    def _on_entry(self, at_s: float, entry: journal.Entry, state: State) -> None:
        match entry:
            case journal.PlanAsked():
                self._on_asked(at_s, entry, state)
            case journal.PlanReady():
                self._on_ready(entry)
            case journal.PlanRefused():
                self._on_refused(entry)
            case journal.PlanLate(plan_id=plan_id):
                if (asked := self._open.get(plan_id)) is not None:
                    asked.outcome = "late"
                self._cause = "the last came too late"
            case journal.ScanDone(blocks_asked=asked_for, blocks_answered=answered):
                self.unanswered_scans += asked_for > 0 == answered
            case journal.LinkLost(silent_s=silent_s):
                began_s = at_s - silent_s
                if not self._silent:
                    self._end_all(began_s)
                self._silent = True
                in_air = is_in_air(state.vehicle)
                self.health.set("silence", on=True, at_s=began_s, in_air=in_air)
            case journal.Prepared(item=item, refusal=refusal):
                if item != Item.PARAMETERS.value and refusal:
                    self._judge(f"would have refused the flight: {refusal}")
            case journal.End(reason=reason) if self._is_ready:
                self.ends[reason] += 1
            case _:
                pass

    def _on_asked(self, at_s: float, entry: journal.PlanAsked, state: State) -> None:
        goes_on = not entry.from_rest
        asked = PlanAttempt(
            plan_id=entry.plan_id,
            at_s=at_s,
            vehicle_s=state.now_s,
            place=self._place_of(entry.scan_nea_m),
            why="the next subpath" if goes_on else self._cause,
            goes_on=goes_on,
        )
        self._keep(self.report.plans, asked, "plans")
        self._open[asked.plan_id] = asked
        if len(self._open) > _MAX_OPEN:
            del self._open[next(iter(self._open))]

    def _on_ready(self, plan: journal.PlanReady) -> None:
        asked = self._open.get(plan.plan_id)
        if asked is not None:
            path = _Path(plan.plan_id, Subpath(control_nea_m=np.array(plan.control_nea_m)))
            asked.off = path.off
            if asked.goes_on and self._path is not None:
                self._paths = {self._path.plan_id: self._path, path.plan_id: path}
            else:
                self._path, self._paths = path, {path.plan_id: path}
            asked.outcome, asked.length_m = "ready", plan.length_m
            asked.reaches_target = plan.reaches_target
            asked.clearance_m = plan.certificate.clearance_m if plan.certificate.proven else None

    def _on_refused(self, refused: journal.PlanRefused) -> None:
        asked, reason = self._open.get(refused.plan_id), refused.reason
        self.refusals[reason] += 1
        self._cause = "the last was refused"
        if asked is not None:
            asked.outcome, asked.reason = "refused", reason
            asked.remedy = Refusal[reason].value
            if not asked.goes_on:  # the vehicle had left the last path long before
                self._path = None

    def _on_parameters(self, vehicle: AutopilotClient) -> None:
        """Those that are known: of the others the log says nothing, and nobody can be asked."""
        for finding in vehicle.findings if self._checks_area else ():
            if finding.value is None:
                continue
            if finding.severity is Severity.SET and finding.set_to is not None:
                self._judge(f"would have set {finding.name} to {finding.set_to:g}: {finding.rule}")
            elif finding.severity is Severity.REFUSE:
                self._judge(f"would have refused the flight: {finding}")

    def _judge(self, text: str) -> None:
        if len(self.judged) < _MAX_WHY:
            self.judged.setdefault(text)

    # --- what it has seen

    def _on_health(self, at_s: float, state: State, doubt: Reason | None) -> None:
        vehicle, in_air = state.vehicle, is_in_air(state.vehicle)
        without_fix = vehicle.fix_at_s > _EVER and not vehicle.fix_good
        self._had_fix = self._had_fix or vehicle.fix_good
        doubts_estimator = vehicle.estimator_at_s > _EVER and not vehicle.estimator_good
        ready = self._is_ready  # before that, only the fix is waited for
        now = {
            "no GPS fix yet": without_fix and not self._had_fix,
            "GPS fix lost": without_fix and self._had_fix,
            "estimator not to be believed": ready and doubts_estimator,
            "the autopilot's own failsafe": ready and vehicle.failsafe,
            **{kind: ready and doubt is reason for reason, kind in _DOUBTS.items()},
        }
        for kind, on in now.items():
            here = vehicle.position_nea_m
            self.health.set(kind, on=on, at_s=at_s, in_air=in_air, here=here)

    def _on_position(self, at_s: float, state: State, doubt: Reason | None) -> None:
        vehicle, here, before = state.vehicle, state.vehicle.position_nea_m, self._position
        self._position, self._position_at_s = here, vehicle.position_at_s
        if here is None:  # it has rebooted
            return
        if vehicle.jumped_at_s != self._jumped_at_s:
            self._jumped_at_s = vehicle.jumped_at_s
            if before is not None and vehicle.jumped_at_s == vehicle.position_at_s:
                self._note_at("position jumped", at_s, state, math.dist(before, here))
        if not is_in_air(vehicle):
            self.outside.end_all(at_s)
            self._path = None
        if doubt is not None or not is_in_air(vehicle):
            return
        if self._checks_area:
            for kind, off_m in _out_by_m(here, state):
                on = off_m > 0.0
                self.outside.set(kind, on=on, at_s=at_s, in_air=True, here=here, worst_m=off_m)
        if state.phase is Phase.SHADOW and state.reason not in _DISTRUST:
            self._on_way(at_s, here, state)

    def _on_way(self, at_s: float, here: Vector, state: State) -> None:
        """Compare the flown track with the newest planned subpath."""
        flight, path = state.flight, self._path
        if flight.leg is not None and (path is None or path.plan_id != flight.leg.plan_id):
            path = self._path = self._paths.get(flight.leg.plan_id)
        if path is None:
            return
        path.add(at_s, here)
        if flight.leg is not None:
            return
        if flight.target != self._target:
            self._cause, self._path, self._target = "on to the next target", None, flight.target
        elif path.has_ended:
            self._cause, self._path = "the subpath has ended", None
        else:
            self._cause = f"{path.last_m:.0f} m off its path"

    def _forget_paths(self) -> None:
        """Discard the plans so far."""
        self._open.clear()
        self._paths.clear()
        self._path = None

    # --- helpers

    def _end_all(self, at_s: float) -> None:
        """End everything in progress."""
        self.health.end_all(at_s)
        self.outside.end_all(at_s)

    def _note_at(self, kind: str, at_s: float, state: State, worst_m: float | None = None) -> None:
        """Something that takes no time."""
        in_air, here = is_in_air(state.vehicle), state.vehicle.position_nea_m
        self.health.set(kind, on=True, at_s=at_s, in_air=in_air, here=here, worst_m=worst_m)
        self.health.set(kind, on=False, at_s=at_s)

    def _place(self, point_nea_m: Vector | None) -> Place | None:
        return None if point_nea_m is None else self._place_of(point_nea_m)

    def _place_of(self, point_nea_m: Vector) -> Place:
        north_m, east_m, altitude_m = point_nea_m
        latitude, longitude = self._frame.to_geodetic_deg(north_m, east_m)
        return Place(
            latitude_deg=latitude,
            longitude_deg=longitude,
            altitude_amsl_m=altitude_m,
            north_m=north_m,
            east_m=east_m,
        )

    def _keep(self, kept: list[Any], new: object, kind: str) -> None:
        if len(kept) < MOST:
            kept.append(new)
        else:
            self.report.left_out[kind] += 1


@final
class _Spans:
    """Time spans during which a condition was true."""

    def __init__(
        self,
        kept: list[Observed],
        left_out: Counter[str],
        place: Callable[[Vector | None], Place | None],
    ) -> None:
        self._kept, self._left_out, self._place = kept, left_out, place
        self._open: dict[str, Observed] = {}

    def end_all(self, at_s: float) -> None:
        """None of it is so any more."""
        for kind in list(self._open):
            self.set(kind, on=False, at_s=at_s)

    def set(
        self,
        kind: str,
        *,
        on: bool,
        at_s: float,
        in_air: bool = False,
        here: Vector | None = None,
        worst_m: float | None = None,
    ) -> None:
        """Set a condition to true or false."""
        span = self._open.get(kind)
        if on and span is None:
            span = self._open[kind] = Observed(
                kind=kind, from_s=at_s, in_air=in_air, place=self._place(here), worst_m=worst_m
            )
            if len(self._kept) < MOST:
                self._kept.append(span)
            else:
                self._left_out[kind] += 1
        elif on and span is not None and worst_m is not None:
            span.worst_m = max(span.worst_m or 0.0, worst_m)
        elif not on and span is not None:
            span.until_s = at_s
            del self._open[kind]


@final
class _Path:
    """A planned subpath as chords, and how far the track was from it."""

    def __init__(self, plan_id: int, subpath: Subpath) -> None:
        self.plan_id = plan_id
        length_m = subpath.length_m
        chords = min(max(math.ceil(length_m / _SPACING_M), 1), _MAX_CHORDS)
        self._lengths_m = np.linspace(0.0, length_m, chords + 1)
        points: FloatArray = subpath.points_nea_m(self._lengths_m)
        self._starts, self._along = points[:-1], np.diff(points, axis=0)
        self._squares = np.maximum(np.einsum("sk,sk->s", self._along, self._along), 1e-12)
        self.last_m = self._at_m = 0.0
        self.off = TrackDeviation()

    @property
    def has_ended(self) -> bool:
        """Whether the vehicle has come to its end."""
        return float(self._lengths_m[-1]) - self._at_m < _AT_END_M

    def add(self, at_s: float, here: Vector) -> None:
        """One more position of the track."""
        to = np.asarray(here) - self._starts  # (S, 3)
        share = np.clip(np.einsum("sk,sk->s", to, self._along) / self._squares, 0.0, 1.0)
        rest = to - share[:, None] * self._along
        squares = np.einsum("sk,sk->s", rest, rest)
        k = int(squares.argmin())
        self.last_m = math.sqrt(float(squares[k]))
        step_m = self._lengths_m[k + 1] - self._lengths_m[k]
        at_m, off = float(self._lengths_m[k] + share[k] * step_m), self.off
        self._at_m = at_m
        off.from_s, off.until_s = min(off.from_s, at_s), max(off.until_s, at_s)
        off.positions += 1
        off.squares_m2 += self.last_m**2
        off.from_m, off.until_m = min(off.from_m, at_m), max(off.until_m, at_m)
        if self.last_m >= off.max_m:
            off.max_m, off.max_at_s = self.last_m, at_s


def is_in_air(vehicle: Vehicle) -> bool:
    """Whether it is in the air; if it does not report that, whether it is armed."""
    if vehicle.landed is Landed.UNKNOWN:
        return vehicle.armed
    return vehicle.landed is not Landed.ON_GROUND


def _out_by_m(here: Vector, state: State) -> Iterator[tuple[str, float]]:
    """Each bound of the mission, and by how much the vehicle is beyond it; negative: within."""
    task = state.task
    limits: Limits = task.limits
    edges = zip(here, (limits.north_m, limits.east_m), strict=False)
    beyond = itertools.chain.from_iterable((low - at, at - high) for at, (low, high) in edges)
    yield "outside the map", max(beyond)
    yield "below the floor", limits.floor_amsl_m - here[2]
    yield "above the ceiling", here[2] - limits.ceiling_amsl_m
    for zone in task.zones:
        gap_m = float(zone.distance_m(np.asarray(here[0]), np.asarray(here[1])))
        where = "outside keep-in" if zone.keep_in else "inside keep-out"
        yield f"{where} {zone.name}", -gap_m
