"""What a flight of a campaign came to: how it ended, how near it came to what, what it cost.

Every metre of every subpath is measured against the true world, and so is what was flown: nearer to
the ground or to a zone than d_s violates, among near things only what is touched.  Where something
goes wrong, that counts against the companion unless, at that moment or in the ten seconds before,

- the vehicle was not where its autopilot said: the position that the companion was told last lay
  off the true one by more than the mission's navigation_error_m;
- or its autopilot was wrong by as much, told or not, and clear of everything where it believed to
  be: for so long as it is wrong that is looked at in each moment;
- somebody else flew: the mode was not one that the companion had asked for (a pilot, a ground
  station, the autopilot's own failsafe, or what it went back to by itself when that was over: the
  companion has let go, design 7);

and unless the autopilot had rebooted and the vehicle fell, or the radar told too low heights.

A fence that comes during the flight is known ten seconds later (issue 5), and whoever is in it
then, or nearer than d_s, has the time to leave it once, by half the mission's speed.
An ending without a reason violates, or one that leaves the vehicle to nobody (`unexplained: ...`),
unless no command could reach it then: a copter that hears nothing hovers.  When its time is over
it may be on its way back for as long as it was on its way out.
"""

import bisect
import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from companion.campaign import truth
from companion.campaign.drawn_world import DrawnWorld, of_files
from companion.campaign.in_process import Flight, Happening, recorded, simulator
from companion.config import load_mission
from companion.geodesy import BoolArray, FloatArray
from companion.library import route_terms
from companion.mission.state import Phase, Reason
from companion.world.terrain import PeakTerrain
from companion.world.zones import CircleZone

GUIDED: Final = frozenset({"GUIDED", "Offboard"})
HOLDS: Final = frozenset({"BRAKE", "Hold", "LOITER"})
LANDS: Final = frozenset({"LAND", "Land", "Descend", "AUTOLAND"})
RETURNS: Final = frozenset({"RTL", "Return", "SMARTRTL"})
_BY_ORDER: Final = {"hold": HOLDS, "land": LANDS, "return": RETURNS}
_KNOWN_AFTER_S: Final = 10.0
_GRACE_S: Final = 10.0
_SLACK_M: Final = 0.1
_ARRIVED_M: Final = 15.0
_SPACING_M: Final = 1.0
"""Between the points of a subpath at which it is checked, as far as that makes a few thousand."""
_MOST_POINTS: Final = 20_000
_OF_SHAPE: Final = ("turn radius", "climb angle", "dive angle")
_OVER: Final = ("landing", "handing over", "done", "faulted")
"""Phases in which no subpath is flown any more."""
_LET_GO: Final = (Reason.MODE_TAKEN.text, Reason.FAILSAFE.text, Reason.FENCE_BREACHED.text)
_THERE: Final = ("arrived", "held and resumed")
"""Endings at the target."""
_NO_END: Final = {"outcome": "not ended", "reason": "the companion has not said how it ended"}


def judged(flight: Flight, drawn: DrawnWorld, timeline: str | None) -> dict[str, Any]:
    """The columns of a row.  timeline: what goes wrong in the flight; None: nothing does."""
    columns, with_faults = _came_to(flight, drawn), timeline is not None
    stops = flight.entries(kind="stop asked") if with_faults else []
    if stops:  # what followed when its time was over does not count
        rows = [row for row in flight.truth if row["t_s"] <= stops[0]["t_s"]]
        journal = flight.journal[: flight.journal.index(stops[0])]
        flight = replace(flight, journal=journal, truth=rows)
    case = _Case(flight, drawn, simulator().entries(timeline) if timeline else [])
    columns |= case.flown()
    if not with_faults and not len(case.t_s):
        return columns
    excuses = case.excuses() if with_faults else {}
    is_excused = np.any([np.zeros(len(case.t_s), dtype=bool), *excuses.values()], axis=0)
    known, excused = list[str](), list[str]()
    for what, at in (*case.too_near(is_excused), *case.hits(but_landing=with_faults)):
        why = ", ".join(name for name, when in excuses.items() if when[at])
        (excused if why else known).append(f"{what} ({why})" if why else what)
    if with_faults:
        ending, reason = case.ending(is_cut=bool(stops))
        if ending.startswith("unexplained"):
            known.append(f"{ending}: {reason}")
        elif not case.happenings and ending not in _THERE:
            known.append(f"{ending} with nothing wrong: {reason}")
        columns["ending"], columns["excused"] = ending, "; ".join(excused) or None
        columns["reason"] = None if ending == "arrived" else reason or None
    count = len(known)
    if flight.mission.near is None:
        # planned since then, in a wrong place or where the radar lied, one is right in shape only
        since_s = case.t_s[np.argmax(is_excused)] if is_excused.any() else math.inf
        ready = flight.entries(kind="plan ready")
        of_subpaths = checked(
            [(np.array(entry["control_nea_m"]), entry.get("speed_m_s")) for entry in ready],
            drawn,
            bounds=_OF_SHAPE,
            whole=sum(entry["t_s"] < since_s for entry in ready),
        )
        count += of_subpaths["violations"]
        known += filter(None, [of_subpaths["violated"]])
        columns = of_subpaths | columns
    return columns | {"violations": count, "violated": "; ".join(known) or None}


def verified(folder: Path, world: str | None = None) -> str | None:
    """What a run folder with the truth in it violates, in words; None: nothing.

    world: a file or a bundled name; None: the one that is called as the mission is.
    """
    file = str(folder / "mission.toml")
    flight = recorded(folder, load_mission(file))
    columns = judged(flight, of_files(world or flight.mission.name, file), timeline=None)
    found: str | None = columns.get("violated", "it has never flown")
    return found


def _came_to(flight: Flight, drawn: DrawnWorld) -> dict[str, Any]:
    """How it ended, as the companion says."""
    end = [_NO_END, *flight.entries(kind="end")][-1]
    arrived, codes = end["outcome"] == "arrived", ("TAKING_OVER", "TAKEN_OFF")
    return of_task(drawn, flight.plans_s) | {
        "outcome": end["outcome"],
        "reason": None if arrived else end["reason"],
        "arrived": arrived,
        "plans": sum(e["kind"] in ("plan ready", "plan refused") for e in flight.journal),
        "holds": sum(e["code"] not in codes for e in flight.entries(phase="holding")),
    }


def _points(rows: Sequence[dict[str, Any]]) -> FloatArray:
    """North, east, altitude of rows of truth; (N, 3)."""
    keys = ("north_m", "east_m", "altitude_amsl_m")
    return np.array([[row[key] for key in keys] for row in rows]).reshape(-1, 3)


@final
class _Case:
    """A flight as it is judged: where the vehicle truly was in the air.

    That is from when its mission first flew: N moments.  `happenings`: what is said to go wrong.
    """

    def __init__(self, flight: Flight, drawn: DrawnWorld, happenings: Sequence[Happening]) -> None:
        self.flight, self.drawn, self.happenings = flight, drawn, happenings
        self.airborne_s = min((e["t_s"] for e in flight.entries(phase="flying")), default=math.inf)
        self.begun_s = min((e["t_s"] for e in flight.entries(kind="leg")), default=-math.inf)
        """When its first subpath was begun, by the journal; -inf: none was."""
        self.least_m = drawn.task.settings.safety_distance_m - _SLACK_M
        terrain = drawn.terrain
        ground_m = terrain.ground_amsl_m if isinstance(terrain, PeakTerrain) else -math.inf
        self.rows = rows = [
            row
            for row in flight.truth
            if row["t_s"] >= self.airborne_s
            and not row["landed"]
            and row["altitude_amsl_m"] > ground_m
        ]
        self.t_s, self.points_nea_m = np.array([row["t_s"] for row in rows]), _points(rows)
        self.lands = np.array([row["mode"] in LANDS | RETURNS for row in rows], bool)
        """Whether it lands or returns by itself: the ground may be near then."""
        self.has_a_say = self._has_a_say(rows)
        self.gaps_m = list(self._gaps_m(self.points_nea_m))
        near_m = np.array([row.get("near_m", math.inf) for row in rows])
        self.away_m = self.gaps_m[0][1] if self.gaps_m else np.where(self.lands, np.inf, near_m)
        """To the ground, or to the nearest of near things; (N,), infinite while it lands."""

    def _has_a_say(self, rows: Sequence[dict[str, Any]]) -> BoolArray:
        """Whether the mode is guided, or the one that the companion asked for last; (N,).

        A mode that was taken away is not given back by the autopilot's own failsafe being over: the
        companion has let go, and goes on only when it is told to (design 7).
        """
        asked = [(e["t_s"], e["mode"]) for e in self.flight.entries(kind="set mode")]
        has_a_say, taken_s = [], -math.inf
        for row in rows:
            newest = bisect.bisect_right(asked, row["t_s"], key=lambda entry: entry[0]) - 1
            asked_s, wanted = asked[newest] if newest >= 0 else (-math.inf, "")
            obeyed = row["mode"] in _BY_ORDER.get(wanted, ()) and asked_s >= taken_s
            has_a_say.append(row["mode"] in GUIDED or obeyed)
            taken_s = taken_s if has_a_say[-1] else row["t_s"]
        return np.array(has_a_say, dtype=bool)

    def flown(self) -> dict[str, Any]:
        """What was flown of subpaths: until it is told to land or is let go."""
        over = (e["t_s"] for e in self.flight.journal if e.get("phase") in _OVER)
        until_s = next((t_s for t_s in over if t_s >= self.begun_s), math.inf)
        flown = (self.t_s >= self.begun_s) & (self.t_s <= until_s)
        if flown.sum() < 2:
            return {}
        t_s, away_m = self.t_s[flown], self.away_m[flown]
        columns = of_track(self.points_nea_m[flown], self.drawn) | {"flight_s": np.ptp(t_s).item()}
        least = int(np.argmin(away_m))
        if math.isfinite(away_m[least]):
            columns["clearance_least_m"] = float(away_m[least])
            columns["clearance_least_t_s"] = float(t_s[least])
        return columns

    # what the companion could not know or had no say in

    def excuses(self) -> dict[str, BoolArray]:
        """Why something does not count against it, and when; (N,) each."""
        known = dict[str, BoolArray]()
        for entry in self.happenings:
            row = entry.fault.known
            if row.excuse and entry.sets.get(row.excuse_needs, True):
                since = self.t_s >= entry.at_us / 1e6
                known[row.excuse] = since | known.get(row.excuse, since)
        is_off = self._off_m() > self.drawn.task.limits.navigation_error_m
        return {
            "the position was wrong": self._lately(is_off) | self._misled(),
            "somebody else flew": self._lately(~self.has_a_say),
            **dict(sorted(known.items())),
        }

    def _misled(self) -> BoolArray:
        """When its autopilot was wrong, and clear of everything where it believed to be; (N,).

        Among near things never: how far it believed to be from them no truth tells.
        """
        believed_nea_m = _points([row.get("believed", row) for row in self.rows])
        off_m = np.linalg.norm(believed_nea_m - self.points_nea_m, axis=-1)
        is_off = off_m > self.drawn.task.limits.navigation_error_m
        if not self.gaps_m or not is_off.any():
            return np.zeros_like(is_off)
        believed_m = [gap_m for _, gap_m in self._gaps_m(believed_nea_m)]
        is_clear = np.min(believed_m, axis=0) >= self.least_m
        return np.where(is_off, is_clear, self._lately(is_off & is_clear))

    def _lately(self, is_so: BoolArray) -> BoolArray:
        """When something is so, or was less than the grace ago; (N,)."""
        last_s = np.maximum.accumulate(np.where(is_so, self.t_s, -math.inf))
        return np.asarray(self.t_s - last_s < _GRACE_S)

    def _off_m(self) -> FloatArray:
        """How far the position that was told last lay off the truth of its own time; (N,)."""
        if not len(self.flight.reported):
            return np.zeros(len(self.t_s))
        told_s, of_s, *reported = self.flight.reported.T
        times = [row["t_s"] for row in self.flight.truth]
        true = [np.interp(of_s, times, values) for values in _points(self.flight.truth).T]
        newest = np.searchsorted(told_s, self.t_s, side="right") - 1
        return np.linalg.norm(np.subtract(reported, true), axis=0)[np.maximum(newest, 0)]

    # what it came too near to: what, and at which moment

    def too_near(self, is_excused: BoolArray) -> Iterator[tuple[str, int]]:
        """What lay nearer than d_s, once of what counts and once of what is excused."""
        for what, gap_m in self.gaps_m:
            bad = gap_m < self.least_m
            for where in (bad & ~is_excused, bad & is_excused):
                if where.any():
                    at = int(np.argmax(where))
                    yield f"{what} {gap_m[where].min():.1f} m from {self.t_s[at]:.1f} s", at

    def _gaps_m(self, points_nea_m: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Distances of places that must be d_s or more, the ground's first; (N, 3) -> (N,) each.

        Infinite where they do not count; among near things none does.
        """
        if self.flight.mission.near is not None or not len(points_nea_m):
            return
        task = self.drawn.task
        up_to_m = 2.0 * task.required_clearance_m
        ground_m = truth.terrain_distance_m(points_nea_m, self.drawn.terrain, up_to_m)
        # until its first subpath it climbs out from where it stood, also when it goes on after a
        # hold meanwhile
        yield "terrain", np.where(self.lands | (self.t_s < self.begun_s), np.inf, ground_m)
        for zone in task.zones:
            yield zone.name, truth.zone_clearance_m(points_nea_m, zone)
        for at_s, row, sets in self._brought("fence"):
            velocity_m_s = np.array([row["velocity_north_m_s"], row["velocity_east_m_s"]])
            ahead_s = sets["ahead_m"] / max(math.hypot(*velocity_m_s), 1e-6)
            n, e = ahead_s * velocity_m_s + (row["north_m"], row["east_m"])
            fence = CircleZone(name="new fence", north_m=n, east_m=e, radius_m=sets["radius_m"])
            gap_m = truth.zone_clearance_m(points_nea_m, fence)
            counts = self._could_leave(gap_m, at_s + _KNOWN_AFTER_S)
            yield fence.name, np.where(counts, gap_m, np.inf)

    def _brought(self, what: str) -> Iterator[tuple[float, dict[str, Any], Mapping[str, Any]]]:
        """When a ground station told of one more, the truth then, and what its line sets."""
        for entry in self.happenings:
            at_s = entry.at_us / 1e6
            row = next((row for row in self.flight.truth if row["t_s"] >= at_s - 1e-3), None)
            if entry.fault.known.brings == what and row is not None:
                yield at_s, row, entry.sets

    def _could_leave(self, gap_m: FloatArray, known_s: float) -> BoolArray:
        """Whether a new fence that is known has been left once, or could have been; (N,).

        For so long as the companion has a say: the grace, the climb to where it plans from, a turn
        of a plane, which sets out where its circle points along its way, then at half the speed.
        On its circle a plane comes out of a fence and into it again: it has not left it so.
        """
        known, limits = self.t_s >= known_s, self.drawn.task.limits
        if not known.any():
            return known
        low_m = self.drawn.task.take_off_amsl_m - float(self.points_nea_m[known][0, 2])
        safety_m = self.drawn.task.settings.safety_distance_m
        depth_m = max(safety_m - float(gap_m[known][0]), 0.0)
        takes_s = _GRACE_S + 2.0 * max(low_m, 0.0) / limits.climb_rate_m_s
        takes_s += (math.tau * limits.loiter_radius_m + 2.0 * depth_m) / limits.speed_m_s
        passed_s = np.diff(self.t_s, prepend=self.t_s[:1])
        led_s = np.cumsum(np.where(known & self.has_a_say, passed_s, 0.0))
        is_out = known & (gap_m >= safety_m) & limits.hovers
        return known & ((led_s >= takes_s) | np.maximum.accumulate(is_out))

    def hits(self, *, but_landing: bool) -> Iterator[tuple[str, int]]:
        """The first touch of a near thing, else the first crash, at the moment before.

        A crash is a contact that nobody survives, as the simulator judged it.
        """
        touches = self.away_m <= 0.0
        crash = next((row["crash"] for row in self.flight.truth if "crash" in row), None)
        if self.flight.mission.near is not None and touches.any():
            first = int(np.argmax(touches))
            yield f"touched something at {self.t_s[first]:.1f} s", first
        elif crash is not None:
            last = int(np.searchsorted(self.t_s, crash["t_s"])) - 1
            if not (but_landing and (last < 0 or self.lands[last])):
                how = f"{crash['speed_m_s']:.1f} m/s, {crash['t_s']:.1f} s"
                yield f"hit {crash['into']} at {how}", last

    # how it ended

    def ending(self, *, is_cut: bool) -> tuple[str, str]:
        """How it ended, and the reason in words.  is_cut: its time was over."""
        end = next(iter(self.flight.entries(kind="end")), None)
        if end is None and not is_cut:
            return "unexplained: no end", "the journal has none"
        phases = [e for e in self.flight.entries(kind="phase") if e["phase"] != "done"]
        phase, reason = (phases[-1]["phase"], phases[-1].get("reason")) if phases else ("", None)
        reason = (end["reason"] if end else None) or reason or ""
        if all(row["landed"] for row in self.flight.truth):
            return ("refused", reason) if reason else ("unexplained: never flew", phase)
        last, limits = self.flight.truth[-1], self.drawn.task.limits
        mode = last["mode"]
        if end is not None and end["outcome"] == "arrived":
            if (miss_m := self._miss_m()) > _ARRIVED_M + 1.3 * limits.loiter_radius_m:
                return "unexplained: arrived elsewhere", f"{miss_m:.0f} m off"
            held = any(e["phase"] == "holding" and e["t_s"] > self.airborne_s for e in phases)
            return ("held and resumed" if held else "arrived"), reason
        if is_cut and phase not in ("holding", "landing"):
            back_s, out_s = last["t_s"] - phases[-1]["t_s"], phases[-1]["t_s"] - self.airborne_s
            if phase == Phase.RETURNING.value and back_s < out_s:  # the way it came, as far
                why = [e["reason"] for e in phases if e.get("reason")]
                return "on its way back", why[-1] if why else ""
            return "unexplained: flies on", f"{phase}: {reason}"
        if not reason:
            return "unexplained: no reason", f"{phase}, {mode}"
        disarmed = reason == Reason.DISARMED.text  # in the last tick: no truth came after it
        if last["landed"] or not last["armed"] or disarmed:
            may_fall = any(entry.fault.known.may_fall for entry in self.happenings)
            return ("fell" if may_fall else "landed"), reason
        if mode in LANDS | RETURNS:
            return ("landed" if mode in LANDS else "returned"), reason
        if any(text in reason for text in _LET_GO) or mode not in GUIDED | HOLDS:
            return "let go", reason
        # when no command could have reached the autopilot, or nobody was there to send one
        end_us = 1e6 * end["t_s"] if end else math.inf
        out_of_reach = any(
            entry.at_us <= end_us < (math.inf if entry.fault.once else entry.until_us)
            for entry in self.happenings
            if entry.fault.known.out_of_reach
        )
        held = mode in HOLDS or is_cut or out_of_reach or not limits.hovers
        return ("held for good" if held else "unexplained: left in guided mode"), reason

    def _miss_m(self) -> float:
        """Where it was told to be in the end, beside the target."""
        targets = [self.flight.mission.targets_ne_m[-1]]
        for _, row, sets in self._brought("target"):  # which it may have refused, in words
            north_m, east_m, _ = sets["by_m"]
            targets.append((row["north_m"] + north_m, row["east_m"] + east_m))
        reported = self.flight.reported
        if not len(reported):
            return math.inf
        return min(math.dist(reported[-1, 2:4], target) for target in targets)


# --- what was planned, and what was flown


def of_task(drawn: DrawnWorld, plans_s: Sequence[float]) -> dict[str, Any]:
    """What was to be flown, and how long its plans took."""
    settings, places = drawn.task.settings, [drawn.start_nea_m[:2], *drawn.targets_ne_m]
    plan_ms = 1e3 * np.array(plans_s)
    return {
        "profile": settings.profile.name,
        "optimiser": settings.optimiser or settings.profile.optimiser,
        "budget": settings.evaluations,
        "straight_m": sum(math.dist(a, b) for a, b in pairwise(places)),
        "plan_ms_median": float(np.median(plan_ms)) if plans_s else None,
        "plan_ms_p99": float(np.quantile(plan_ms, 0.99)) if plans_s else None,
    }


def of_track(track_nea_m: FloatArray, drawn: DrawnWorld) -> dict[str, Any]:
    """Length and cost of what was flown."""
    terms = route_terms(track_nea_m, drawn.task)
    return {
        "length_m": float(np.linalg.norm(np.diff(track_nea_m, axis=0), axis=-1).sum()),
        "cost": sum(terms.values()),
        **{f"cost_{name}": value for name, value in terms.items()},
    }


def checked(
    subpaths: Sequence[tuple[FloatArray, float | None]],
    drawn: DrawnWorld,
    *,
    joined: bool = False,
    bounds: Container[str] | None = None,
    whole: int = 0,
) -> dict[str, Any]:
    """Every metre of every subpath, its tail included, against the true world.

    subpaths: control points, and the highest speed that each is flown at, as a copter turns the
    tighter the slower it is; None: V.  joined: each begins on the one before, or at its end, from
    rest.  bounds: only these, but for the first so many subpaths (`whole`).
    """
    task, violated, bad, least_m = drawn.task, list[str](), 0, math.inf
    for number, (control_nea_m, speed_m_s) in enumerate(subpaths, 1):
        long_m = float(np.linalg.norm(np.diff(control_nea_m, axis=0), axis=-1).sum())
        curve = truth.sampled(control_nea_m, max(_SPACING_M, long_m / _MOST_POINTS))
        measures = truth.measure(curve, drawn.terrain, task)
        broken = [*measures.violations(task.at_speed(speed_m_s))]
        before = subpaths[number - 2][0]
        if joined and number > 1 and not truth.goes_over(before, control_nea_m, task):
            broken.append("join")
        if bounds is not None and number > whole:
            broken = [name for name in broken if name in bounds]
        bad += bool(broken)
        violated += [f"leg {number}: {name}" for name in broken]
        least_m = min(least_m, measures.clearance_m)
    return {
        "subpaths_checked": len(subpaths),
        "violations": bad,
        "violated": "; ".join(violated) or None,
        "clearance_least_m": least_m if subpaths else None,
    }
