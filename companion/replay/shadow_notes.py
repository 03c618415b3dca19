"""Observes the session in shadow mode and notes what it would have done."""

import math
from typing import Final, final

import numpy as np

from companion.geodesy import LocalFrame
from companion.mission import events, journal
from companion.mission.events import Item, Landed, Vector
from companion.mission.state import Phase, Reason, State, Vehicle
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
from companion.telemetry.export.shapes import SubpathPoints

_EVER: Final = -1e8  # before that: not heard of yet
_BEGINS: Final = "it begins to watch"
_SILENCE: Final = "silence"
_AT_END_M: Final = 1.0
_DOUBTS: Final = {
    Reason.POSITION_STALE: "no position",
    Reason.POSITION_FROZEN: "position stands still",
    Reason.POSITION_ELSEWHERE: "position where the vehicle cannot be",
    Reason.HEALTH_SILENT: "no word of GPS or estimator",
    Reason.INACCURATE: "position less accurate than allowed",
}
_DISTRUST: Final = {*_DOUBTS, Reason.POSITION_JUMPED, Reason.NO_FIX, Reason.ESTIMATOR}
"""Reasons for an invalid position (mission/health.py).  Missing plans are not among them: each
plan's result is reported separately."""


@final
class Notes:
    """The notes of one flight in shadow mode."""

    def __init__(self, report: ShadowReport, frame: LocalFrame) -> None:
        """report: what is noted goes there."""
        self.report = report
        self._frame, self._has_mission = frame, report.mission is not None
        self._vehicle = Vehicle()
        self._spans: dict[str, Observed] = {}
        """What is observed now, by its kind."""
        self._outside: dict[str, float | None] = {}
        """Limits of the mission that it is beyond, by how much: at the last position believed."""
        self._had_fix = False
        self._was_in_air: bool | None = None
        self._at_s: float | None = None
        self._is_ready = False
        """Whether it could fly: the position was to be believed, since this session has begun."""
        self._hold: Hold | None = None
        self._plans: dict[int, PlanAttempt] = {}
        """Of this session since the last hold, by their numbers."""
        self._cause = _BEGINS
        """Why the next plan from rest is asked for."""
        self._path: tuple[PlanAttempt, SubpathPoints] | None = None
        """What the flown track is compared with."""
        self._offs: dict[int, list[tuple[float, float]]] = {}
        """Of each plan, by its identity: when, and how far off."""
        self._target = 0
        self._looked_at: Vehicle | None = None
        """The vehicle when it last had a new position."""

    def begin_again(self) -> None:
        """A new session begins."""
        self._plans, self._path, self._looked_at, self._target = {}, None, None, 0

    def heard_again(self, at_s: float) -> None:
        """The vehicle was heard after a silence."""
        if (silence := self._spans.pop(_SILENCE, None)) is not None:
            silence.until_s = at_s
        self._at_s = at_s

    def not_recorded(self, from_s: float, until_s: float) -> None:
        """The log has a gap, and another session begins: nothing in progress goes on."""
        self._end_all(from_s)
        self.saw("not recorded", from_s, until_s)
        self._at_s, self._was_in_air, self._hold, self._is_ready = until_s, None, None, False
        self._cause = _BEGINS

    def saw(
        self,
        kind: str,
        from_s: float,
        until_s: float | None = None,
        worst_m: float | None = None,
        to: list[Observed] | None = None,
    ) -> Observed:
        """Note something where the vehicle is now.  to: a list of the report, else its health."""
        seen = Observed(
            kind=kind,
            from_s=from_s,
            until_s=until_s,
            in_air=is_in_air(self._vehicle),
            worst_m=worst_m,
            place=self._place(self._vehicle.position_nea_m),
        )
        (self.report.health if to is None else to).append(seen)
        return seen

    def say(self, at_s: float, text: str) -> None:
        """The vehicle has done or said something."""
        self.report.said.append(VehicleReport(at_s=at_s, text=text))

    def on_output(self, at_s: float, session: Session, entries: list[journal.Told]) -> None:
        """The session has been run.  at_s: of the log."""
        state = session.state
        self._vehicle = vehicle = state.vehicle
        for values in entries:
            self._on_entry(at_s, journal.entry_of(values), session)
        if _SILENCE in self._spans:  # what it was when it was last heard is not known to go on
            self._on_hold(at_s, state)
            return
        in_air = is_in_air(vehicle)
        if self._at_s is not None and in_air:
            self.report.in_air_s += at_s - self._at_s
        self._at_s = at_s
        if in_air is not self._was_in_air:
            if self._was_in_air is not None or in_air:
                self.say(at_s, "in the air" if in_air else "on the ground")
            self._was_in_air = in_air
        self._on_hold(at_s, state)
        before = self._looked_at
        if self._is_ready and (before is None or vehicle.position_at_s != before.position_at_s):
            self._looked_at = vehicle
            self._on_position(at_s, before, state)
        self._observe(at_s)

    def finish(self) -> None:
        """The log has ended: put together what was noted piece by piece."""
        report = self.report
        for asked in report.plans:
            if rows := self._offs.get(id(asked)):
                asked.off = TrackDeviation.of(rows)
        if all_rows := [row for rows in self._offs.values() for row in rows]:
            report.own_path = TrackDeviation.of(all_rows)
        for seen in (report.health, report.outside):
            seen.sort(key=lambda each: each.from_s)

    # --- what it would have done

    def _on_hold(self, at_s: float, state: State) -> None:
        """Note where a hold begins and ends."""
        watching, hold = state.phase is Phase.SHADOW, self._hold
        reason = state.reason if watching and state.reason in _DISTRUST else None
        if not self._is_ready:
            self._is_ready = watching and reason is None
            if self._is_ready and self.report.watched_from_s is None:
                self.report.watched_from_s = at_s
            return
        silent = _SILENCE in self._spans
        if silent:
            reason = Reason.LINK_LOST
        elif not watching:  # it prepares again, or another session does
            reason = state.reason or Reason.REBOOTED
            reason = reason if hold is None else Reason[hold.why[-1].code]
        if reason is None:
            if hold is not None:
                hold.went_on_s = at_s
                hold.trusted_s = at_s if hold.trusted_s is None else hold.trusted_s
                self._hold, self._cause = None, f"it goes on after: {hold.why[0].text}"
            return
        if hold is None:
            for asked in self._plans.values():
                if asked.outcome == "unanswered":
                    asked.outcome = "given up"
            self._plans, self._path = {}, None
            hold = self._hold = Hold(
                let_go_s=at_s,
                vehicle_s=state.now_s,
                why=[],
                place=self._place(state.vehicle.position_nea_m),
                in_air=is_in_air(state.vehicle),
            )
            self.report.holds.append(hold)
        if not hold.why or hold.why[-1].code != reason.name:
            why = HoldReason(at_s=at_s, code=reason.name, text=reason.text, remedy=reason.remedy)
            hold.why.append(why)
        trusted = watching and not silent and state.vehicle.distrust is None
        hold.trusted_s = (hold.trusted_s or at_s) if trusted else None

    def _on_entry(self, at_s: float, entry: journal.Entry, session: Session) -> None:
        match entry:
            case journal.PlanAsked(plan_id=plan_id, from_rest=from_rest):
                asked = self._plans[plan_id] = PlanAttempt(
                    plan_id=plan_id,
                    at_s=at_s,
                    place=self._place(entry.scan_nea_m),
                    why=self._cause if from_rest else "the next subpath",
                    goes_on=not from_rest,
                )
                self.report.plans.append(asked)
            case journal.PlanReady() if entry.plan_id in self._plans:
                asked = self._plans[entry.plan_id]
                asked.outcome, asked.length_m = "ready", entry.length_m
                asked.reaches_target = entry.reaches_target
                if entry.certificate.proven:
                    asked.clearance_m = entry.certificate.clearance_m
                if self._path is None or not asked.goes_on:
                    self._path = asked, SubpathPoints(entry.subpath)
            case journal.PlanRefused(plan_id=plan_id, reason=reason):
                self._cause = "the last was refused"
                if plan_id in self._plans:
                    asked = self._plans[plan_id]
                    asked.outcome, asked.reason = "refused", reason
                    asked.remedy = Refusal[reason].value
                    if not asked.goes_on:  # the vehicle had left the last path long before
                        self._path = None
            case events.LinkLost(silent_s=silent_s) if _SILENCE not in self._spans:
                self._end_all(at_s - silent_s)
                self._spans[_SILENCE] = self.saw(_SILENCE, at_s - silent_s)
            case events.Prepared(item=item, refusal=refusal):
                if item is not Item.PARAMETERS and refusal:
                    self._judge(f"would have refused the flight: {refusal}")
                self._judge_parameters(session)
            case events.End(reason=reason) if self._is_ready:
                self.report.notes.append(f"gave up watching at {at_s:,.1f} s: {reason}")

    def _judge_parameters(self, session: Session) -> None:
        """Those that are known: of the others the log says nothing, and nobody can be asked."""
        if session.vehicle is None or not self._has_mission:
            return
        for finding in session.vehicle.findings:
            if finding.value is not None and finding.set_to is not None:
                self._judge(f"would have set {finding.name} to {finding.set_to:g}: {finding.rule}")
            elif finding.value is not None:
                self._judge(f"would have refused the flight: {finding}")

    def _judge(self, text: str) -> None:
        if text not in self.report.notes:
            self.report.notes.append(text)

    # --- what it has seen

    def _on_position(self, at_s: float, before: Vehicle | None, state: State) -> None:
        vehicle, here = state.vehicle, state.vehicle.position_nea_m
        if here is None:  # it has rebooted
            return
        was = None if before is None else before.position_nea_m
        if was is not None and vehicle.jumped_at_s == vehicle.position_at_s:
            self.saw("position jumped", at_s, at_s, math.dist(was, here))
        in_air = is_in_air(vehicle)
        if not in_air:
            self._path = None
        if self._has_mission and (vehicle.distrust is None or not in_air):
            beyond = _beyond_m(here, state) if in_air else {}
            self._outside = {kind: off_m for kind, off_m in beyond.items() if off_m > 0.0}
        is_led = state.phase is Phase.SHADOW and state.reason not in _DISTRUST
        if in_air and is_led and vehicle.distrust is None:
            self._on_way(at_s, here, state)

    def _on_way(self, at_s: float, here: Vector, state: State) -> None:
        """Compare the flown track with the newest planned subpath."""
        flight, leg = state.flight, state.leg
        if leg is not None and (self._path is None or self._path[0].plan_id != leg.plan_id):
            planned = self._plans.get(leg.plan_id)
            self._path = None if planned is None else (planned, SubpathPoints(leg.subpath))
        if self._path is None:
            return
        asked, points = self._path
        off_m, along_m = points.nearest(here)
        self._offs.setdefault(id(asked), []).append((at_s, off_m))
        if leg is not None:
            return
        if flight.target != self._target:
            self._cause, self._path, self._target = "on to the next target", None, flight.target
        elif (asked.length_m or 0.0) - along_m < _AT_END_M:
            self._cause, self._path = "the subpath has ended", None
        else:
            self._cause = f"{off_m:.0f} m off its path"

    # --- spans of time

    def _observe(self, at_s: float) -> None:
        """Begin and end the spans of what is so now, and of what no longer is."""
        vehicle, ready = self._vehicle, self._is_ready  # before that, only a fix is waited for
        without_fix = vehicle.fix_at_s > _EVER and not vehicle.fix_good
        self._had_fix = self._had_fix or vehicle.fix_good
        unsure = vehicle.estimator_at_s > _EVER and not vehicle.estimator_good
        health = {
            "no GPS fix yet": without_fix and not self._had_fix,
            "GPS fix lost": without_fix and self._had_fix,
            "estimator not to be believed": ready and unsure,
            "the autopilot's own failsafe": ready and vehicle.failsafe,
            **{kind: ready and vehicle.distrust is reason for reason, kind in _DOUBTS.items()},
        }
        now = {kind: None for kind, is_so in health.items() if is_so} | self._outside
        for kind in self._spans.keys() - now.keys():
            self._spans.pop(kind).until_s = at_s
        for kind, worst_m in now.items():
            if (span := self._spans.get(kind)) is None:
                to = self.report.health if worst_m is None else self.report.outside
                self._spans[kind] = self.saw(kind, at_s, None, worst_m, to)
            elif worst_m is not None:
                span.worst_m = max(span.worst_m or 0.0, worst_m)

    def _end_all(self, at_s: float) -> None:
        """End everything in progress."""
        for span in self._spans.values():
            span.until_s = at_s
        self._spans, self._outside = {}, {}

    def _place(self, point_nea_m: Vector | None) -> Place | None:
        if point_nea_m is None:
            return None
        north_m, east_m, altitude_m = point_nea_m
        latitude, longitude = self._frame.to_geodetic_deg(north_m, east_m)
        return Place(latitude_deg=latitude, longitude_deg=longitude, altitude_amsl_m=altitude_m)


def is_in_air(vehicle: Vehicle) -> bool:
    """Whether it is in the air; if it does not report that, whether it is armed."""
    if vehicle.landed is Landed.UNKNOWN:
        return vehicle.armed
    return vehicle.landed is not Landed.ON_GROUND


def _beyond_m(here: Vector, state: State) -> dict[str, float]:
    """By how much the vehicle is beyond each bound of the mission; negative: within."""
    (north_m, east_m, altitude_m), limits = here, state.task.limits
    (south, north), (west, east) = limits.north_m, limits.east_m
    beyond = {
        "outside the map": max(south - north_m, north_m - north, west - east_m, east_m - east),
        "below the floor": limits.floor_amsl_m - altitude_m,
        "above the ceiling": altitude_m - limits.ceiling_amsl_m,
    }
    for zone in state.task.zones:
        where = "outside keep-in" if zone.keep_in else "inside keep-out"
        gap_m = float(zone.distance_m(np.asarray(north_m), np.asarray(east_m)))
        beyond[f"{where} {zone.name}"] = -gap_m
    return beyond
