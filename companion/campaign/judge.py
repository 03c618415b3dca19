"""What a flight of a campaign came to: how it ended, how near it came to what, what it cost.

Every metre of every subpath is measured against the true world, and so is what was flown: nearer to
the ground or to a zone than d_s violates, among near things only what is touched.  Where something
goes wrong, that counts against the companion unless, at that moment or in the ten seconds before,

- the vehicle was not where its autopilot said: the position that the companion was told last lay
  off the true one by more than the mission's navigation_error_m;
- somebody else flew: the mode was not one that the companion had asked for (a pilot, a ground
  station, the autopilot's own failsafe, or what it went back to by itself when that was over: the
  companion has let go, design 7);

and unless the autopilot had rebooted and the vehicle fell, or the radar told too low heights.

A fence that comes during the flight is known ten seconds later (issue 5), and whoever is in it
then, or nearer than d_s, has the time to leave it once, by half the mission's speed.
An ending without a reason violates, or one that leaves the vehicle to nobody (`unexplained: ...`),
unless no command could reach it then: a copter that hears nothing hovers.
"""

import bisect
import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, final

import numpy as np

from companion.campaign import truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.in_process import Flight, Happening, simulator
from companion.geodesy import BoolArray, FloatArray
from companion.library import route_terms
from companion.mission.state import Reason
from companion.planner.settings import Task
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
    columns, is_cut = _came_to(flight, drawn), False
    done = simulator().entries(timeline) if timeline else []
    if timeline is not None:
        flight, is_cut = _until_stopped(flight)
    track = _in_the_air(flight, drawn)
    columns |= _of_flight(track, flight, drawn)
    if timeline is None and not len(track.t_s):
        return columns
    known, excused = list[str](), list[str]()
    excuses = {} if timeline is None else _excuses(flight, track, drawn, done)
    is_excused = np.any([np.zeros(len(track.t_s), dtype=bool), *excuses.values()], axis=0)

    def tell(what: str, at: int) -> None:
        """Against the companion, or excused by what is so at a row of the track."""
        why = ", ".join(name for name, when in excuses.items() if when[at])
        (excused if why else known).append(f"{what} ({why})" if why else what)

    for what, gap_m in _gaps_m(track, flight, drawn, done):
        bad = gap_m < drawn.task.settings.safety_distance_m - _SLACK_M
        for where in (bad & ~is_excused, bad & is_excused):
            if where.any():
                first = int(np.argmax(where))
                tell(f"{what} {gap_m[where].min():.1f} m from {track.t_s[first]:.1f} s", first)
    if hit := _hit(flight, track, but_landing=timeline is not None):
        tell(*hit)
    if timeline is not None:
        ending, reason = _ending(flight, drawn, done, is_cut=is_cut)
        if ending.startswith("unexplained"):
            known.append(f"{ending}: {reason}")
        elif not done and ending not in _THERE:
            known.append(f"{ending} with nothing wrong: {reason}")
        columns["ending"], columns["excused"] = ending, "; ".join(excused) or None
        columns["reason"] = None if ending == "arrived" else reason or None
    count = len(known)
    if flight.mission.near is None:
        ready = _entries(flight, kind="plan ready")
        subpaths = [(np.array(e["control_nea_m"]), e.get("speed_m_s")) for e in ready]
        # planned since then, in a wrong place or where the radar lied, one is right in shape only
        since_s = track.t_s[np.argmax(is_excused)] if is_excused.any() else math.inf
        before = sum(e["t_s"] < since_s for e in ready)
        of_subpaths = checked(subpaths, drawn, bounds=_OF_SHAPE, whole=before)
        count += of_subpaths["violations"]
        known += filter(None, [of_subpaths["violated"]])
        columns = of_subpaths | columns
    return columns | {"violations": count, "violated": "; ".join(known) or None}


def _entries(flight: Flight, **like: str) -> list[dict[str, Any]]:
    """The entries of its journal that have these values."""
    return [e for e in flight.journal if all(e.get(key) == like[key] for key in like)]


def _first_s(entries: Sequence[dict[str, Any]], otherwise_s: float) -> float:
    """When the first of some entries was written."""
    return float(entries[0]["t_s"]) if entries else otherwise_s


def _came_to(flight: Flight, drawn: DrawnWorld) -> dict[str, Any]:
    """How it ended."""
    end = [_NO_END, *_entries(flight, kind="end")][-1]
    arrived, codes = end["outcome"] == "arrived", ("TAKING_OVER", "TAKEN_OFF")
    return of_task(flight.mission.task, drawn, flight.plans_s) | {
        "outcome": end["outcome"],
        "reason": None if arrived else end["reason"],
        "arrived": arrived,
        "plans": sum(e["kind"] in ("plan ready", "plan refused") for e in flight.journal),
        "holds": sum(e["code"] not in codes for e in _entries(flight, phase="holding")),
    }


def _until_stopped(flight: Flight) -> tuple[Flight, bool]:
    """A flight without what followed when its time was over, and whether that was so."""
    if not (stop := _entries(flight, kind="stop asked")):
        return flight, False
    rows = [row for row in flight.truth if row["t_s"] <= stop[0]["t_s"]]
    journal = flight.journal[: flight.journal.index(stop[0])]
    return replace(flight, journal=journal, truth=rows), True


def _of_flight(track: "_Track", flight: Flight, drawn: DrawnWorld) -> dict[str, Any]:
    """What was flown of subpaths: until it is told to land or is let go."""
    over = [e for e in flight.journal if e.get("phase") in _OVER and e["t_s"] >= track.begun_s]
    flown = (track.t_s >= track.begun_s) & (track.t_s <= _first_s(over, math.inf))
    if flown.sum() < 2:
        return {}
    t_s, away_m = track.t_s[flown], track.away_m[flown]
    columns = of_track(track.points_nea_m[flown], drawn) | {"flight_s": float(t_s[-1] - t_s[0])}
    least = int(np.argmin(away_m))
    if math.isfinite(away_m[least]):
        columns["clearance_least_m"] = float(away_m[least])
        columns["clearance_least_t_s"] = float(t_s[least])
    return columns


# --- what was planned, and what was flown


def of_task(task: Task, drawn: DrawnWorld, plans_s: Sequence[float]) -> dict[str, Any]:
    """What was to be flown, and how long its plans took."""
    settings, places = task.settings, [drawn.start_nea_m[:2], *drawn.targets_ne_m]
    return {
        "profile": settings.profile.name,
        "optimiser": settings.optimiser or settings.profile.optimiser,
        "budget": settings.evaluations,
        "straight_m": sum(math.dist(a, b) for a, b in pairwise(places)),
        "plan_ms_median": 1e3 * float(np.median(plans_s)) if len(plans_s) else None,
        "plan_ms_p99": 1e3 * float(np.quantile(plans_s, 0.99)) if len(plans_s) else None,
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


# --- a flight as arrays


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Track:
    """Where the vehicle truly was in the air, from when its mission first flew; N moments."""

    t_s: FloatArray
    points_nea_m: FloatArray
    lands: BoolArray
    """Whether it lands or returns by itself: the ground may be near then."""
    has_a_say: BoolArray
    """Whether the companion has a say."""
    away_m: FloatArray
    """To the ground, or to the nearest of near things; infinite while it lands."""
    begun_s: float
    """When its first subpath was begun, by the journal; -inf: none was."""


def _in_the_air(flight: Flight, drawn: DrawnWorld) -> _Track:
    terrain, airborne_s = drawn.terrain, _airborne_s(flight)
    ground_m = terrain.ground_amsl_m if isinstance(terrain, PeakTerrain) else -math.inf
    rows = [
        row
        for row in flight.truth
        if row["t_s"] >= airborne_s and not row["landed"] and row["altitude_amsl_m"] > ground_m
    ]
    points, lands = _points(rows), np.array([row["mode"] in LANDS | RETURNS for row in rows], bool)
    if flight.mission.near is not None or not rows:
        away_m = np.array([row.get("near_m", math.inf) for row in rows])
    else:
        away_m = truth.terrain_distance_m(points, terrain, 2.0 * drawn.task.required_clearance_m)
    return _Track(
        t_s=np.array([row["t_s"] for row in rows]),
        points_nea_m=points,
        lands=lands,
        has_a_say=_has_a_say(rows, flight),
        away_m=np.where(lands, np.inf, away_m),
        begun_s=_first_s(_entries(flight, kind="leg"), -math.inf),
    )


def _points(rows: Sequence[dict[str, Any]]) -> FloatArray:
    """North, east, altitude of rows of truth; (N, 3)."""
    keys = ("north_m", "east_m", "altitude_amsl_m")
    return np.array([[row[key] for key in keys] for row in rows]).reshape(-1, 3)


def _airborne_s(flight: Flight) -> float:
    return _first_s(_entries(flight, phase="flying"), math.inf)


def _has_a_say(rows: Sequence[dict[str, Any]], flight: Flight) -> BoolArray:
    """Whether the companion has a say: the mode is guided, or the one that it asked for last; (N,).

    A mode that was taken away is not given back by the autopilot's own failsafe being over: the
    companion has let go, and goes on only when it is told to (design 7).
    """
    asked = [(-math.inf, ""), *((e["t_s"], e["mode"]) for e in _entries(flight, kind="set mode"))]
    has_a_say, taken_s = [], -math.inf
    for row in rows:
        newest = bisect.bisect_right(asked, row["t_s"], key=lambda entry: entry[0]) - 1
        asked_s, wanted = asked[newest]
        obeyed = row["mode"] in _BY_ORDER.get(wanted, ()) and asked_s >= taken_s
        has_a_say.append(row["mode"] in GUIDED or obeyed)
        taken_s = taken_s if has_a_say[-1] else row["t_s"]
    return np.array(has_a_say, dtype=bool)


# --- what the companion could not know or had no say in


def _excuses(
    flight: Flight, track: _Track, drawn: DrawnWorld, done: Sequence[Happening]
) -> dict[str, BoolArray]:
    """Why something does not count against it, and when; (N,) each."""
    t_s, known = track.t_s, dict[str, BoolArray]()
    for entry in done:
        row = entry.fault.known
        if row.excuse and entry.sets.get(row.excuse_needs, True):
            since = t_s >= entry.at_us / 1e6
            known[row.excuse] = since | known.get(row.excuse, since)
    is_off = _off_m(flight, t_s) > drawn.task.limits.navigation_error_m
    return {
        "the position was wrong": _lately(t_s, is_off),
        "somebody else flew": _lately(t_s, ~track.has_a_say),
        **dict(sorted(known.items())),
    }


def _lately(t_s: FloatArray, is_so: BoolArray) -> BoolArray:
    """When something is so, or was less than the grace ago; (N,)."""
    last_s = np.maximum.accumulate(np.where(is_so, t_s, -math.inf))
    return np.asarray(t_s - last_s < _GRACE_S)


def _off_m(flight: Flight, t_s: FloatArray) -> FloatArray:
    """How far the position that was told last lay off the truth of its own time; (N,)."""
    if not len(flight.reported):
        return np.zeros(len(t_s))
    told_s, of_s, *reported = flight.reported.T
    times = [row["t_s"] for row in flight.truth]
    true = [np.interp(of_s, times, values) for values in _points(flight.truth).T]
    newest = np.searchsorted(told_s, t_s, side="right") - 1
    return np.linalg.norm(np.subtract(reported, true), axis=0)[np.maximum(newest, 0)]


# --- too near


def _gaps_m(
    track: _Track, flight: Flight, drawn: DrawnWorld, done: Sequence[Happening]
) -> Iterator[tuple[str, FloatArray]]:
    """True distances that must be d_s or more, (N,); infinite where they do not count."""
    if flight.mission.near is not None or not len(track.t_s):
        return
    # before that it climbs out from where it stood, also when it goes on after a hold meanwhile
    yield "terrain", np.where(track.t_s < track.begun_s, np.inf, track.away_m)
    for zone in drawn.task.zones:
        gap_m = truth.keep_out_distance_m(track.points_nea_m, zone)
        yield zone.name, -gap_m if zone.keep_in else gap_m
    for at_s, row, sets in _brought("fence", flight, done):
        velocity_m_s = np.array([row["velocity_north_m_s"], row["velocity_east_m_s"]])
        ahead_s = sets["ahead_m"] / max(math.hypot(*velocity_m_s), 1e-6)
        n, e = ahead_s * velocity_m_s + (row["north_m"], row["east_m"])
        fence = CircleZone(name="new fence", north_m=n, east_m=e, radius_m=sets["radius_m"])
        gap_m = truth.keep_out_distance_m(track.points_nea_m, fence)
        counts = _could_leave(gap_m, track, at_s + _KNOWN_AFTER_S, drawn)
        yield fence.name, np.where(counts, gap_m, np.inf)


def _brought(
    what: str, flight: Flight, done: Sequence[Happening]
) -> Iterator[tuple[float, dict[str, Any], Mapping[str, Any]]]:
    """When a ground station told of one more, the truth then, and what its line sets."""
    for entry in done:
        at_s = entry.at_us / 1e6
        row = next((row for row in flight.truth if row["t_s"] >= at_s - 1e-3), None)
        if entry.fault.known.brings == what and row is not None:
            yield at_s, row, entry.sets


def _could_leave(gap_m: FloatArray, track: _Track, known_s: float, drawn: DrawnWorld) -> BoolArray:
    """Whether a new fence that is known has been left once, or could have been; (N,).

    For so long as the companion has a say: the grace, a turn of a plane, which sets out where its
    circle points along its way, then at half the speed.  On its circle a plane comes out of a fence
    and into it again: it has not left it so.
    """
    known, limits = track.t_s >= known_s, drawn.task.limits
    if not known.any():
        return known
    depth_m = max(drawn.task.settings.safety_distance_m - float(gap_m[known][0]), 0.0)
    takes_s = _GRACE_S + (math.tau * limits.loiter_radius_m + 2.0 * depth_m) / limits.speed_m_s
    passed_s = np.diff(track.t_s, prepend=track.t_s[:1])
    led_s = np.cumsum(np.where(known & track.has_a_say, passed_s, 0.0))
    is_out = known & (gap_m >= drawn.task.settings.safety_distance_m) & limits.hovers
    return known & ((led_s >= takes_s) | np.maximum.accumulate(is_out))


def _hit(flight: Flight, track: _Track, *, but_landing: bool) -> tuple[str, int] | None:
    """The first touch of a near thing, else the first crash: what, and the row of the track before.

    A crash is a contact that nobody survives, as the simulator judged it.
    """
    touches = track.away_m <= 0.0
    if flight.mission.near is not None and touches.any():
        first = int(np.argmax(touches))
        return f"touched something at {track.t_s[first]:.1f} s", first
    crash = next((row["crash"] for row in flight.truth if "crash" in row), None)
    if crash is None:
        return None
    last = int(np.searchsorted(track.t_s, crash["t_s"])) - 1
    if but_landing and (last < 0 or track.lands[last]):
        return None
    return f"hit {crash['into']} at {crash['speed_m_s']:.1f} m/s, {crash['t_s']:.1f} s", last


# --- endings


def _ending(
    flight: Flight, drawn: DrawnWorld, done: Sequence[Happening], *, is_cut: bool
) -> tuple[str, str]:
    """How it ended, and the reason in words."""
    end = next(iter(_entries(flight, kind="end")), None)
    if end is None and not is_cut:
        return "unexplained: no end", "the journal has none"
    phases = [e for e in _entries(flight, kind="phase") if e["phase"] != "done"]
    phase, reason = (phases[-1]["phase"], phases[-1].get("reason")) if phases else ("", None)
    reason = (end["reason"] if end else None) or reason or ""
    if all(row["landed"] for row in flight.truth):
        return ("refused", reason) if reason else ("unexplained: never flew", phase)
    last, mode = flight.truth[-1], flight.truth[-1]["mode"]
    if end is not None and end["outcome"] == "arrived":
        circle_m = drawn.task.limits.loiter_radius_m
        if (miss_m := _miss_m(flight, done)) > _ARRIVED_M + 1.3 * circle_m:
            return "unexplained: arrived elsewhere", f"{miss_m:.0f} m off"
        airborne_s = _airborne_s(flight)
        held = any(e["phase"] == "holding" and e["t_s"] > airborne_s for e in phases)
        return ("held and resumed" if held else "arrived"), reason
    if is_cut and phase not in ("holding", "landing"):
        return "unexplained: flies on", f"{phase}: {reason}"
    if not reason:
        return "unexplained: no reason", f"{phase}, {mode}"
    disarmed = reason == Reason.DISARMED.text  # in the last tick: no truth came after it
    if last["landed"] or not last["armed"] or disarmed:
        may_fall = any(entry.fault.known.may_fall for entry in done)
        return ("fell" if may_fall else "landed"), reason
    if mode in LANDS | RETURNS:
        return ("landed" if mode in LANDS else "returned"), reason
    if any(text in reason for text in _LET_GO) or mode not in GUIDED | HOLDS:
        return "let go", reason
    # when no command could have reached the autopilot, or nobody was there to send one
    end_us = 1e6 * end["t_s"] if end else math.inf
    out_of_reach = any(
        entry.at_us <= end_us < (math.inf if entry.fault.once else entry.until_us)
        for entry in done
        if entry.fault.known.out_of_reach
    )
    held = mode in HOLDS or is_cut or out_of_reach or not drawn.task.limits.hovers
    return ("held for good" if held else "unexplained: left in guided mode"), reason


def _miss_m(flight: Flight, done: Sequence[Happening]) -> float:
    """Where it was told to be in the end, beside the target."""
    targets = [flight.mission.targets_ne_m[-1]]
    for _, row, sets in _brought("target", flight, done):  # which it may have refused, in words
        north_m, east_m, _ = sets["by_m"]
        targets.append((row["north_m"] + north_m, row["east_m"] + east_m))
    if not len(flight.reported):
        return math.inf
    return min(math.dist(flight.reported[-1, 2:4], target) for target in targets)
