"""Observes the session in shadow mode and notes what it would have done."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Final, final

import numpy as np

from companion.geodesy import LocalFrame
from companion.mavlink.autopilot_client import AutopilotClient
from companion.mission import journal
from companion.mission.entries import Entry
from companion.mission.events import Item, Landed, Vector
from companion.mission.health import distrust
from companion.mission.state import Phase, Reason, State, Vehicle
from companion.planner.request import Refusal
from companion.replay.shadow_report import (
    Hold,
    HoldReason,
    Observed,
    OffPath,
    Place,
    PlanAttempt,
    ShadowReport,
    VehicleReport,
)
from companion.session import Session
from companion.telemetry.export.shapes import Chords

_MAX_WHY: Final = 50
_EVER: Final = -1e8  # before that: not heard of yet
_BEGINS: Final = "it begins to watch"
_AT_END_M: Final = 1.0

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
        self.unanswered_scans = 0
        self.refusals: Counter[str] = Counter()
        self.ends: Counter[str] = Counter()
        """Why the companion gave up watching, before it began again."""
        self.judged: dict[str, None] = {}
        """What of the vehicle it would have refused or changed, in order."""
        self._frame, self._checks_area = frame, checks_area
        self._spans: dict[str, Observed] = {}
        """What is observed now, by its kind."""
        self._hold: Hold | None = None
        self._is_ready = False
        """Whether it could fly: the position was to be believed, since this session has begun."""
        self._had_fix = self._silent = False
        self._vehicle: Vehicle | None = None
        self._asked: dict[int, PlanAttempt] = {}
        """Plans that are not answered yet, by their numbers."""
        self._cause = _BEGINS
        self._path: tuple[PlanAttempt, Chords] | None = None
        self._paths: dict[int, tuple[PlanAttempt, Chords]] = {}
        """That and its successor, by the plan's number."""
        self._target = 0
        self._at_s: float | None = None
        self._was_in_air: bool | None = None
        self._looked_at: Vehicle | None = None
        """When it last had a new position."""

    def begin_again(self) -> None:
        """A new session begins."""
        self._forget_paths()
        self._looked_at, self._target = None, 0

    def heard_again(self, at_s: float) -> None:
        """The vehicle was heard after a silence."""
        self._silent = False
        self._at_s = at_s
        self._observe("silence", at_s, on=False)

    def not_recorded(self, from_s: float, until_s: float) -> None:
        """The log has a gap, and another session begins: nothing in progress goes on."""
        self._end_all(from_s)
        self._observe("not recorded", from_s, until_s=until_s)
        self._at_s, self._was_in_air, self._hold, self._is_ready = until_s, None, None, False
        self._cause = _BEGINS

    def rebooted(self, at_s: float) -> None:
        """The vehicle's clock has begun again."""
        if self._vehicle is not None:
            self._observe("the autopilot has rebooted", at_s, until_s=at_s)

    def say(self, said: VehicleReport) -> None:
        """The vehicle has said something."""
        self.report.said.append(said)

    def on_output(self, at_s: float, session: Session, entries: list[Entry]) -> None:
        """The session has been run.  at_s: of the log."""
        state = session.state
        self._vehicle = vehicle = state.vehicle
        for values in entries:
            self._on_entry(at_s, entry := journal.entry_of(values), state)
            if isinstance(entry, journal.Prepared) and session.vehicle is not None:
                self._on_parameters(session.vehicle)
        if self._silent:  # what it was when it was last heard is not known to go on
            self._on_hold(at_s, state, None)
            return
        in_air = is_in_air(vehicle)
        if self._at_s is not None and in_air:
            self.report.in_air_s += at_s - self._at_s
        self._at_s = at_s
        if in_air is not self._was_in_air:
            if self._was_in_air is not None or in_air:
                self.say(VehicleReport(at_s=at_s, what="in the air" if in_air else "on the ground"))
            self._was_in_air = in_air
        doubt = distrust(vehicle, state.now_s, state.task.limits)
        self._on_hold(at_s, state, doubt)
        self._on_health(at_s, vehicle, doubt)
        before = self._looked_at
        if self._is_ready and (before is None or vehicle.position_at_s != before.position_at_s):
            self._looked_at = vehicle
            self._on_position(at_s, before, state, doubt)

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
            place = state.vehicle.position_nea_m
            hold = self._hold = Hold(
                let_go_s=at_s,
                vehicle_s=state.now_s,
                why=[],
                place=place and self._place(place),
                in_air=is_in_air(state.vehicle),
            )
            self.report.holds.append(hold)
            for asked in self._asked.values():
                if asked.outcome == "unanswered":
                    asked.outcome = "given up"
            self._forget_paths()
        if (not hold.why or hold.why[-1].code != reason.name) and len(hold.why) < _MAX_WHY:
            why = HoldReason(at_s=at_s, code=reason.name, text=reason.text, remedy=reason.remedy)
            hold.why.append(why)
        trusted = doubt is None and not self._silent and watching
        hold.trusted_s = (hold.trusted_s or at_s) if trusted else None

    def _reason(self, state: State, *, watching: bool) -> Reason | None:
        """Why it would hold now; None: it would not."""
        if self._silent:
            return Reason.LINK_LOST
        if watching:
            return state.reason if state.reason in _DISTRUST else None
        if self._hold is not None:  # it prepares again, or another session does
            return Reason[self._hold.why[-1].code]
        return state.reason or Reason.REBOOTED

    def _on_entry(self, at_s: float, entry: journal.Entry, state: State) -> None:
        match entry:
            case journal.PlanAsked():
                asked = PlanAttempt(
                    plan_id=entry.plan_id,
                    at_s=at_s,
                    vehicle_s=state.now_s,
                    place=self._place(entry.scan_nea_m),
                    why=self._cause if entry.from_rest else "the next subpath",
                    goes_on=not entry.from_rest,
                )
                self.report.plans.append(asked)
                self._asked[asked.plan_id] = asked
            case journal.PlanReady(plan_id=plan_id) if plan_id in self._asked:
                self._on_ready(entry, self._asked.pop(plan_id))
            case journal.PlanRefused(plan_id=plan_id, reason=reason):
                self.refusals[reason] += 1
                self._cause = "the last was refused"
                if (refused := self._asked.pop(plan_id, None)) is not None:
                    refused.outcome, refused.reason = "refused", reason
                    refused.remedy = Refusal[reason].value
                    if not refused.goes_on:  # the vehicle had left the last path long before
                        self._path = None
            case journal.ScanDone(blocks_asked=asked_for, blocks_answered=answered):
                self.unanswered_scans += asked_for > 0 == answered
            case journal.LinkLost(silent_s=silent_s):
                began_s = at_s - silent_s
                if not self._silent:
                    self._end_all(began_s)
                self._silent = True
                self._observe("silence", began_s)
            case journal.Prepared(item=item, refusal=refusal):
                if item != Item.PARAMETERS.value and refusal:
                    self._judge(f"would have refused the flight: {refusal}")
            case journal.End(reason=reason) if self._is_ready:
                self.ends[reason] += 1
            case _:
                pass

    def _on_ready(self, plan: journal.PlanReady, asked: PlanAttempt) -> None:
        path = asked, Chords(plan.subpath)
        self._path = (self._path if asked.goes_on else None) or path
        self._paths = {each.plan_id: (each, chords) for each, chords in (self._path, path)}
        asked.outcome, asked.length_m = "ready", plan.length_m
        asked.reaches_target = plan.reaches_target
        asked.clearance_m = plan.certificate.clearance_m if plan.certificate.proven else None

    def _on_parameters(self, vehicle: AutopilotClient) -> None:
        """Those that are known: of the others the log says nothing, and nobody can be asked."""
        for finding in vehicle.findings if self._checks_area else ():
            if finding.value is None:
                continue
            if finding.set_to is not None:
                self._judge(f"would have set {finding.name} to {finding.set_to:g}: {finding.rule}")
            else:
                self._judge(f"would have refused the flight: {finding}")

    def _judge(self, text: str) -> None:
        if len(self.judged) < _MAX_WHY:
            self.judged.setdefault(text)

    # --- what it has seen

    def _on_health(self, at_s: float, vehicle: Vehicle, doubt: Reason | None) -> None:
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
            self._observe(kind, at_s, on=on)

    def _on_position(
        self, at_s: float, before: Vehicle | None, state: State, doubt: Reason | None
    ) -> None:
        vehicle, here = state.vehicle, state.vehicle.position_nea_m
        if here is None:  # it has rebooted
            return
        was = None if before is None else before.position_nea_m
        if was is not None and vehicle.jumped_at_s == vehicle.position_at_s:
            jumped_m = math.dist(was, here)
            self._observe("position jumped", at_s, until_s=at_s, worst_m=jumped_m)
        in_air = is_in_air(vehicle)
        if not in_air:
            self._path = None
        if self._checks_area and (doubt is None or not in_air):
            for kind, off_m in _out_by_m(here, state):
                self._observe(kind, at_s, on=in_air and off_m > 0.0, worst_m=off_m, outside=True)
        trusted = state.phase is Phase.SHADOW and state.reason not in _DISTRUST
        if doubt is None and in_air and trusted:
            self._on_way(at_s, here, state)

    def _on_way(self, at_s: float, here: Vector, state: State) -> None:
        """Compare the flown track with the newest planned subpath."""
        flight, leg = state.flight, state.flight.leg
        if leg is not None and (self._path is None or self._path[0].plan_id != leg.plan_id):
            self._path = self._paths.get(leg.plan_id)
        if self._path is None:
            return
        asked, chords = self._path
        off_m, along_m = chords.nearest(here)
        asked.samples.append(OffPath(at_s, off_m, along_m))
        if leg is not None:
            return
        if flight.target != self._target:
            self._cause, self._path, self._target = "on to the next target", None, flight.target
        elif (asked.length_m or 0.0) - along_m < _AT_END_M:
            self._cause, self._path = "the subpath has ended", None
        else:
            self._cause = f"{off_m:.0f} m off its path"

    def _forget_paths(self) -> None:
        """Discard the plans so far."""
        self._asked.clear()
        self._paths.clear()
        self._path = None

    # --- helpers

    def _observe(
        self,
        kind: str,
        at_s: float,
        *,
        on: bool = True,
        until_s: float | None = None,
        worst_m: float | None = None,
        outside: bool = False,
    ) -> None:
        """Something is so from now on, or no longer.

        until_s: it is known when it ends; outside: it is of the mission's limits, else of health.
        """
        span = self._spans.get(kind)
        if on and span is None:
            vehicle = self._vehicle or Vehicle()
            place = vehicle.position_nea_m
            span = self._spans[kind] = Observed(
                kind=kind,
                from_s=at_s,
                in_air=is_in_air(vehicle),
                worst_m=worst_m,
                place=place and self._place(place),
            )
            (self.report.outside if outside else self.report.health).append(span)
        elif on and span is not None and worst_m is not None:
            span.worst_m = max(span.worst_m or 0.0, worst_m)
        if span is not None and (until_s is not None or not on):
            span.until_s = at_s if until_s is None else until_s
            del self._spans[kind]

    def _end_all(self, at_s: float) -> None:
        """End everything in progress."""
        for kind in list(self._spans):
            self._observe(kind, at_s, on=False)

    def _place(self, point_nea_m: Vector) -> Place:
        north_m, east_m, altitude_m = point_nea_m
        latitude, longitude = self._frame.to_geodetic_deg(north_m, east_m)
        return Place(
            latitude_deg=latitude,
            longitude_deg=longitude,
            altitude_amsl_m=altitude_m,
            north_m=north_m,
            east_m=east_m,
        )


def is_in_air(vehicle: Vehicle) -> bool:
    """Whether it is in the air; if it does not report that, whether it is armed."""
    if vehicle.landed is Landed.UNKNOWN:
        return vehicle.armed
    return vehicle.landed is not Landed.ON_GROUND


def _out_by_m(here: Vector, state: State) -> Iterator[tuple[str, float]]:
    """Each bound of the mission, and by how much the vehicle is beyond it; negative: within."""
    (north_m, east_m, altitude_m), limits = here, state.task.limits
    south_m, west_m = limits.north_m[0] - north_m, limits.east_m[0] - east_m
    yield (
        "outside the map",
        max(south_m, north_m - limits.north_m[1], west_m, east_m - limits.east_m[1]),
    )
    yield "below the floor", limits.floor_amsl_m - altitude_m
    yield "above the ceiling", altitude_m - limits.ceiling_amsl_m
    for zone in state.task.zones:
        gap_m = float(zone.distance_m(np.asarray(north_m), np.asarray(east_m)))
        where = "outside keep-in" if zone.keep_in else "inside keep-out"
        yield f"{where} {zone.name}", -gap_m
