"""What a session in shadow would have done, noted as it is fed: holds, plans, health."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Final, final

import numpy as np

from companion.geodesy import LocalFrame
from companion.mission import events, journal
from companion.mission.events import Item, Landed, Vector
from companion.mission.state import Phase, Reason, State, Vehicle
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
from companion.telemetry.export.shapes import SubpathPoints

_EVER: Final = -1e8  # before that: not heard of yet
_BEGINS: Final = "it begins to watch"
_AT_END_M: Final = 1.0
_OFF, _REACHED = "shadow: the vehicle is ", "shadow: target reached"
"""How texts of the mission machine begin that say why it leaves a path."""
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
@dataclass(slots=True, kw_only=True)
class _Asked:
    """A plan that was asked for, and the positions of the flown track that belong to it."""

    attempt: PlanAttempt
    subpath: Subpath | None = None
    track: list[tuple[float, Vector]] = field(default_factory=list)

    def off_m(self) -> Iterator[tuple[float, float]]:
        """When, and how far the track was from the subpath, up to its end."""
        if self.subpath is None or not self.track:
            return
        points = SubpathPoints(self.subpath)
        for at_s, position in self.track:
            off_m, along_m = points.nearest(position)
            yield at_s, off_m
            if self.subpath.length_m - along_m < _AT_END_M:
                return


@final
class Notes:
    """The notes of one log."""

    def __init__(self, report: ShadowReport, frame: LocalFrame) -> None:
        """report: what is noted goes there."""
        self.report, self._frame = report, frame
        self._vehicle = Vehicle()
        """As it was when this session was last run."""
        self._heard_s: float | None = None
        """When it was last heard, unless it has been silent since."""
        self._spans: dict[str, Observed] = {}
        """What is observed now, by its kind."""
        self._outside: dict[str, float] = {}
        """Limits of the mission that it is beyond, by how much: at the last position believed."""
        self._is_ready = False
        """Whether it could fly: the position was to be believed, since the recording goes on."""
        self._hold: Hold | None = None
        self._every: list[_Asked] = []
        self._asked: dict[int, _Asked] = {}
        """Those of this session since the last hold, by their numbers."""
        self._followed: _Asked | None = None
        """What the flown track is compared with."""
        self._cause = _BEGINS
        """Why the next plan from rest is asked for."""

    # --- what the log tells

    def begin_again(self) -> None:
        """A new session begins."""
        self._vehicle, self._asked, self._followed = Vehicle(), {}, None

    def not_recorded(self, from_s: float, until_s: float) -> None:
        """The log has a gap, and another session begins: nothing in progress goes on."""
        self._outside = {}
        self._observe(from_s, ())
        self._saw("not recorded", from_s, until_s)
        self._heard_s, self._hold, self._is_ready = until_s, None, False
        self._cause = _BEGINS

    def say(self, at_s: float, text: str) -> None:
        """The vehicle has done or said something."""
        self.report.said.append(VehicleReport(at_s=at_s, text=text))

    def on_output(
        self,
        at_s: float,
        session: Session,
        entries: list[journal.Told],
        silent_from_s: float | None = None,
    ) -> None:
        """The session has been run.  at_s: of the log.

        silent_from_s: the vehicle has been silent since then: what it was is not known to go on.
        """
        state, before = session.state, self._vehicle
        self._vehicle = vehicle = state.vehicle
        for values in entries:
            self._on_entry(at_s, journal.entry_of(values), session)
        self._look_for_a_hold(at_s, state, silent=silent_from_s is not None)
        if silent_from_s is not None:
            self._outside, self._heard_s = {}, None
            self._observe(silent_from_s, ["silence"])
            return
        in_air = is_in_air(vehicle)
        if in_air and self._heard_s is not None:
            self.report.in_air_s += at_s - self._heard_s
        if in_air is not is_in_air(before):
            self.say(at_s, "in the air" if in_air else "on the ground")
        self._heard_s = at_s
        if self._is_ready and vehicle.position_at_s != before.position_at_s:
            self._on_position(at_s, before.position_nea_m, state)
        self._observe(at_s, self._odd_now())

    def finish(self) -> None:
        """The log has ended."""
        report = self.report
        off_m = [[*asked.off_m()] for asked in self._every]
        for asked, its_m in zip(self._every, off_m, strict=True):
            asked.attempt.off = TrackDeviation.of(its_m)
        report.own_path = TrackDeviation.of([*chain(*off_m)])
        for seen in (report.health, report.outside):
            seen.sort(key=lambda observed: observed.from_s)

    # --- what it would have done

    def _look_for_a_hold(self, at_s: float, state: State, *, silent: bool) -> None:
        """Note where a hold begins and ends."""
        reason, hold = self._would_hold(state, silent=silent), self._hold
        if not self._is_ready:
            self._is_ready = reason is None
            if self._is_ready and self.report.watched_from_s is None:
                self.report.watched_from_s = at_s
            return
        if reason is None:
            if hold is not None:
                hold.went_on_s, hold.trusted_s = at_s, hold.trusted_s or at_s
                self._hold, self._cause = None, f"it goes on after: {hold.why[0].text}"
            return
        if hold is None:
            for asked in self._asked.values():
                if asked.attempt.outcome == "unanswered":
                    asked.attempt.outcome = "given up"
            self._asked, self._followed = {}, None
            place, in_air = self._place(state.vehicle.position_nea_m), is_in_air(state.vehicle)
            hold = self._hold = Hold(let_go_s=at_s, why=[], place=place, in_air=in_air)
            self.report.holds.append(hold)
        if not hold.why or hold.why[-1].code != reason.name:
            why = HoldReason(at_s=at_s, code=reason.name, text=reason.text, remedy=reason.remedy)
            hold.why.append(why)
        trusted = state.vehicle.distrust is None and not silent
        hold.trusted_s = (hold.trusted_s or at_s) if trusted else None

    def _would_hold(self, state: State, *, silent: bool) -> Reason | None:
        """Why it would hold now; None: it would not."""
        if silent:
            return Reason.LINK_LOST
        if state.phase is Phase.SHADOW:
            return state.reason if state.reason in _DISTRUST else None
        if self._hold is not None:  # it prepares again, or another session does
            return Reason[self._hold.why[-1].code]
        return state.reason or Reason.REBOOTED

    def _on_entry(self, at_s: float, entry: journal.Entry, session: Session) -> None:
        match entry:
            case events.StatusText(text=text) if text.startswith(_OFF):
                self._cause = text.removeprefix(_OFF)
            case events.StatusText(text=text) if text == _REACHED:
                self._cause = "on to the next target"
            case journal.PlanAsked(plan_id=plan_id, from_rest=from_rest):
                attempt = PlanAttempt(
                    plan_id=plan_id,
                    at_s=at_s,
                    place=self._place(entry.scan_nea_m),
                    why=self._cause if from_rest else "the next subpath",
                    goes_on=not from_rest,
                )
                self._cause = "the subpath has ended"
                self._asked[plan_id] = _Asked(attempt=attempt)
                self._every.append(self._asked[plan_id])
                self.report.plans.append(attempt)
            case journal.PlanReady() if (asked := self._asked.get(entry.plan_id)) is not None:
                asked.subpath, asked.attempt.outcome = entry.subpath, "ready"
                asked.attempt.length_m = entry.length_m
                asked.attempt.reaches_target = entry.reaches_target
                if entry.certificate.proven:
                    asked.attempt.clearance_m = entry.certificate.clearance_m
            case journal.PlanRefused(reason=reason):
                self._cause = "the last was refused"
                if (asked := self._asked.get(entry.plan_id)) is not None:
                    asked.attempt.outcome, asked.attempt.reason = "refused", reason
                    asked.attempt.remedy = Refusal[reason].value
                    if not asked.attempt.goes_on:  # the vehicle had left the last path long before
                        self._followed = None
            case events.Rebooted():
                self._saw("the autopilot has rebooted", at_s, at_s)
            case events.Prepared(item=item, refusal=refusal):
                if item is not Item.PARAMETERS and refusal:
                    self._note(f"would have refused the flight: {refusal}")
                self._judge_parameters(session)
            case events.End(reason=reason) if self._is_ready:
                self._note(f"gave up watching at {at_s:,.1f} s: {reason}")

    def _judge_parameters(self, session: Session) -> None:
        """Those that are known: of the others the log says nothing, and nobody can be asked."""
        if session.vehicle is None or self.report.mission is None:
            return
        for finding in session.vehicle.findings:
            if finding.value is not None and finding.set_to is not None:
                self._note(f"would have set {finding.name} to {finding.set_to:g}: {finding.rule}")
            elif finding.value is not None:
                self._note(f"would have refused the flight: {finding}")

    def _note(self, text: str) -> None:
        if text not in self.report.notes:
            self.report.notes.append(text)

    # --- what it has seen

    def _on_position(self, at_s: float, was_nea_m: Vector | None, state: State) -> None:
        vehicle, position = state.vehicle, state.vehicle.position_nea_m
        if position is None:  # it has rebooted
            return
        if was_nea_m is not None and vehicle.jumped_at_s == vehicle.position_at_s:
            self._saw("position jumped", at_s, at_s, math.dist(was_nea_m, position))
        if not is_in_air(vehicle):
            self._followed, self._outside = None, {}
        elif self.report.mission is not None and vehicle.distrust is None:
            self._outside = _beyond_m(position, state)
            if self._hold is None and state.leg is not None:
                self._followed = self._asked.get(state.leg.plan_id)
            if self._followed is not None:  # nothing is in a hold
                self._followed.track.append((at_s, position))

    def _odd_now(self) -> Iterator[str]:
        """What is odd about the vehicle's health; before it was ready, only a fix is waited for."""
        vehicle, had_fix = self._vehicle, self.report.watched_from_s is not None
        if vehicle.fix_at_s > _EVER and not vehicle.fix_good:
            yield "GPS fix lost" if had_fix else "no GPS fix yet"
        if not self._is_ready:
            return
        if vehicle.estimator_at_s > _EVER and not vehicle.estimator_good:
            yield "estimator not to be believed"
        if vehicle.failsafe:
            yield "the autopilot's own failsafe"
        if vehicle.distrust in _DOUBTS:
            yield _DOUBTS[vehicle.distrust]

    def _observe(self, at_s: float, odd: Iterable[str]) -> None:
        """Begin and end the spans of what is so now, and of what no longer is."""
        now = dict.fromkeys(sorted(odd)) | self._outside
        for kind in self._spans.keys() - now.keys():
            self._spans.pop(kind).until_s = at_s
        for kind, worst_m in now.items():
            if kind not in self._spans:
                self._spans[kind] = self._saw(kind, at_s, None, worst_m)
            elif worst_m is not None:
                self._spans[kind].worst_m = max(self._spans[kind].worst_m or 0.0, worst_m)

    def _saw(
        self, kind: str, from_s: float, until_s: float | None = None, worst_m: float | None = None
    ) -> Observed:
        """Note something where the vehicle is now."""
        place, in_air = self._place(self._vehicle.position_nea_m), is_in_air(self._vehicle)
        seen = Observed(
            kind=kind, from_s=from_s, until_s=until_s, in_air=in_air, worst_m=worst_m, place=place
        )
        (self.report.outside if kind in self._outside else self.report.health).append(seen)
        return seen

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


def _beyond_m(position: Vector, state: State) -> dict[str, float]:
    """The bounds of the mission that the vehicle is beyond, and by how much."""
    (north_m, east_m, altitude_m), limits = position, state.task.limits
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
    return {kind: by_m for kind, by_m in beyond.items() if by_m > 0.0}
