"""What a flight of `pair` came to: how it ended, how near to what, what the companion could know.

A distance below d_s counts against the companion unless, at that moment or in the ten seconds
before, it could not know of it or had no say:

- the vehicle was not where its autopilot said: the position that the companion was told last lay
  off the true one by more than the mission's navigation_error_m;
- somebody else flew: the mode was not one that the companion had asked for (a pilot, a ground
  station, the autopilot's own failsafe, or what it went back to by itself when that was over: the
  companion has let go, design 7), or the autopilot was rebooting and the vehicle fell;
- it had put the vehicle into the autopilot's own hold because there was no position to be believed,
  and the autopilot had none either: a plane then flies blind;
- the radar had told heights below the true ones (`radar_noise ... either_way`: of terrain only);
- the zone was new: a fence is known ten seconds after the vehicle has it (issue 5), and whoever is
  inside then, or nearer than d_s, has the time to leave it once, by half the mission's speed;
- it was given back to the companion in there, or nearer than d_s: it has the same time.

Everything else counts: wind, a late or dead planner, lost frames, an autopilot that does not obey.
"""

import bisect
import itertools
import math
import re
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import NDArray
from pair import Flown

from companion.campaign import truth
from companion.mission.state import Reason
from companion.world.threats import Zone

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

GUIDED = frozenset({"GUIDED", "Offboard"})
HOLDS = frozenset({"BRAKE", "Hold", "LOITER"})
LANDS = frozenset({"LAND", "Land", "Descend", "AUTOLAND"})
RETURNS = frozenset({"RTL", "Return", "SMARTRTL"})
_BY_ORDER = {"hold": HOLDS, "land": LANDS, "return": RETURNS}
KNOWN_AFTER_S = 10.0
GRACE_S = 10.0
_SLACK_M = 0.1
_ARRIVED_M = 15.0
_CRASH_M_S = 3.5
_LET_GO = (Reason.MODE_TAKEN.text, Reason.FAILSAFE.text, Reason.FENCE_BREACHED.text)
_BLIND = frozenset(
    reason.text
    for reason in (
        Reason.POSITION_STALE,
        Reason.POSITION_FROZEN,
        Reason.POSITION_JUMPED,
        Reason.POSITION_ELSEWHERE,
        Reason.NO_FIX,
        Reason.ESTIMATOR,
    )
)
_UNSAID = "no reason given"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Breach:
    """One violation: the first moment of it, and the worst."""

    what: str
    t_s: float
    worst_m: float
    could_know: bool
    why: str
    """Why it could not know, or nothing."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """One flight, judged."""

    outcome: str
    reason: str
    terrain_m: float
    """Worst true distance to the ground while it flew the mission."""
    terrain_known_m: float
    """The same, of the moments at which it could know."""
    zone_m: float
    zone_known_m: float
    breaches: tuple[Breach, ...]
    inside_s: float
    """Time inside zones and within reach of radars, known or not."""
    silent_s: float
    """Longest time without a valid command."""
    own_silent_s: float
    """The same, without the times at which nothing passed, or there was no companion."""
    holds: int
    flown_s: float
    off_m: float
    """Largest error of the position that the companion was told."""

    @property
    def violations(self) -> int:
        """Breaches that it could know of."""
        return sum(breach.could_know for breach in self.breaches)

    @property
    def explained(self) -> bool:
        return not self.outcome.startswith("unexplained")


@final
@dataclass(slots=True, kw_only=True)
class _Table:
    """A flight in arrays, one row for each moment of truth while the mission flew."""

    t_s: FloatArray
    points: FloatArray
    modes: list[str]
    airborne: BoolArray
    phases: list[str]
    off_m: FloatArray
    ours: BoolArray
    excuses: dict[str, BoolArray] = field(default_factory=dict)


def judge(flown: Flown) -> Verdict:
    """Everything about one flight."""
    table = _table(flown)
    scene = flown.scene
    breaches: list[Breach] = []
    terrain = _terrain_m(flown, table)
    excuses = {**table.excuses, **_radar_excuse(flown, table)}
    breaches += _breaches("terrain", terrain, scene.safety_m, table, excuses)
    zone_m = zone_known_m = math.inf
    inside = np.zeros(len(table.t_s), dtype=bool)
    for zone, known_s in _zones(flown):
        gap = _gap_m(table.points, zone)
        new = _new_excuse(gap, known_s, flown, table)
        back = _back_excuse(gap, flown, table)
        excused = {**table.excuses, "the zone was new": new, "it was given back there": back}
        breaches += _breaches(zone.name, gap, scene.safety_m, table, excused)
        had = table.t_s >= known_s - KNOWN_AFTER_S
        inside |= (gap < 0.0) & had
        zone_m = min(zone_m, _least(gap[had]))
        zone_known_m = min(zone_known_m, _least(gap[~_any(excused) & had]))
    for radar in scene.mission.task.radars:
        away = np.linalg.norm(table.points - np.asarray(radar.centre_nea_m), axis=-1)
        inside |= away < radar.range_m
    outcome, reason = _outcome(flown)
    samples = flown.samples
    return Verdict(
        outcome=outcome,
        reason=reason,
        terrain_m=_least(terrain),
        terrain_known_m=_least(terrain[~_any(excuses)]),
        zone_m=zone_m,
        zone_known_m=zone_known_m,
        breaches=tuple(breaches),
        inside_s=0.1 * float(inside.sum()),
        silent_s=_silent_s(flown, table, ()),
        own_silent_s=_silent_s(flown, table, _outages_s(flown)),
        holds=sum(
            b.phase == "holding" and a.phase != "holding" for a, b in itertools.pairwise(samples)
        ),
        flown_s=float(table.t_s[-1] - table.t_s[0]) if len(table.t_s) else 0.0,
        off_m=float(table.off_m.max()) if len(table.off_m) else 0.0,
    )


def _least(values: FloatArray) -> float:
    return float(values.min()) if len(values) else math.inf


def _any(excuses: dict[str, BoolArray]) -> BoolArray:
    return np.any(list(excuses.values()), axis=0)


# --- the flight as arrays


def _table(flown: Flown) -> _Table:
    """The moments from the first one of the mission in the air to the end of the flight."""
    t_s, track = flown.track()
    sampled = {round(sample.t_s, 1): sample for sample in flown.samples}
    ground = flown.scene.world.terrain.ground_amsl_m or 0.0
    rows = [
        k
        for k, row in enumerate(flown.truth)
        if row["t_s"] >= flown.airborne_s
        and round(row["t_s"], 1) in sampled
        and not row["landed"]
        and row["altitude_amsl_m"] > ground
    ]
    samples = [sampled[round(float(t_s[k]), 1)] for k in rows]
    off = np.zeros(len(rows))
    reboots = [at for at, what in flown.done if what == "reboot"]
    for k, (row, sample) in enumerate(zip(rows, samples, strict=True)):
        if sample.believed_nea_m is None or any(at < t_s[row] for at in reboots):
            continue
        told = [np.interp(sample.believed_at_s, t_s, track[:, axis]) for axis in range(3)]
        off[k] = math.dist(told, sample.believed_nea_m)
    modes = [flown.truth[k]["mode"] for k in rows]
    blind = [
        s.phase == "holding" and s.reason in _BLIND and mode not in GUIDED
        for mode, s in zip(modes, samples, strict=True)
    ]
    table = _Table(
        t_s=t_s[rows],
        points=track[rows].reshape(-1, 3),
        modes=modes,
        airborne=np.array([flown.truth[k]["armed"] for k in rows], dtype=bool),
        phases=[s.phase for s in samples],
        off_m=off,
        ours=_ours(modes, t_s[rows], flown),
    )
    error_m = flown.scene.mission.task.limits.navigation_error_m
    rebooted = np.array([any(at <= t for at in reboots) for t in table.t_s], dtype=bool)
    table.excuses = {
        "the position was wrong": _lasting(table.t_s, off > error_m),
        "somebody else flew": _lasting(table.t_s, ~table.ours),
        "the autopilot rebooted": rebooted,
        "there was no position": _lasting(table.t_s, np.array(blind, dtype=bool)),
    }
    return table


def _ours(modes: list[str], t_s: FloatArray, flown: Flown) -> BoolArray:
    """Whether the companion has a say: the mode is guided, or the one that it asked for last.

    A mode that was taken away is not given back by the autopilot's own failsafe being over: the
    companion has let go, and goes on only when it is told to (design 7).
    """
    asked = [(e["at_s"], e["mode"]) for e in flown.journal if e["kind"] == "set mode"]
    ours, taken_s = [], -math.inf
    for mode, at_s in zip(modes, t_s.tolist(), strict=True):
        newest = bisect.bisect_right(asked, at_s, key=lambda each: each[0]) - 1
        asked_s, wanted = asked[newest] if newest >= 0 else (-math.inf, "")
        obeyed = mode in _BY_ORDER.get(wanted, ()) and asked_s >= taken_s
        ours.append(mode in GUIDED or obeyed)
        if not ours[-1]:
            taken_s = at_s
    return np.array(ours, dtype=bool)


def _lasting(t_s: FloatArray, bad: BoolArray) -> BoolArray:
    """Bad now, or less than the grace ago."""
    last_s = np.maximum.accumulate(np.where(bad, t_s, -math.inf))
    return np.asarray(t_s - last_s < GRACE_S)


# --- distances


def _terrain_m(flown: Flown, table: _Table) -> FloatArray:
    """True distance to the ground; landing and the flight after it are no business of d_s."""
    if not len(table.t_s):
        return np.empty(0)
    up_to_m = 4.0 * flown.scene.safety_m
    distance = truth.terrain_distance_m(table.points, flown.scene.terrain, up_to_m)
    lands = np.array([mode in LANDS | RETURNS for mode in table.modes])
    return np.where(lands, np.inf, distance)


def _gap_m(points: FloatArray, zone: Zone) -> FloatArray:
    """Horizontal distance to where the vehicle must not be; negative there."""
    if not len(points):
        return np.empty(0)
    gap = truth.keep_out_distance_m(points, zone)
    return -gap if zone.keep_in else gap


def _zones(flown: Flown) -> list[tuple[Zone, float]]:
    """Every zone with the time from which it could be known."""
    zones = [(zone, -math.inf) for zone in flown.scene.mission.task.zones]
    known: set[str] = set()
    for at_s, fence in flown.fences:
        for zone in fence:
            if repr(zone) not in known:
                known.add(repr(zone))
                before = at_s < flown.airborne_s - KNOWN_AFTER_S
                zones.append((zone, -math.inf if before else at_s + KNOWN_AFTER_S))
    return zones


def _radar_excuse(flown: Flown, table: _Table) -> dict[str, BoolArray]:
    lied_s = min((at for at, what in flown.done if "either_way" in what), default=math.inf)
    return {"the radar told too low heights": table.t_s >= lied_s}


def _new_excuse(gap: FloatArray, known_s: float, flown: Flown, table: _Table) -> BoolArray:
    """Not yet known, or on the way out for the first time."""
    excused: BoolArray = table.t_s < known_s
    after = np.nonzero(~excused)[0]
    if math.isinf(known_s) or not len(after):
        return excused
    return excused | _on_the_way_out(gap, int(after[0]), known_s, flown, table)


def _back_excuse(gap: FloatArray, flown: Flown, table: _Table) -> BoolArray:
    """On the way out for the first time since the companion has the vehicle back."""
    excused = np.zeros(len(gap), dtype=bool)
    for k in np.flatnonzero(table.ours[1:] & ~table.ours[:-1]) + 1:
        excused |= _on_the_way_out(gap, int(k), float(table.t_s[k]), flown, table)
    return excused


def _on_the_way_out(
    gap: FloatArray, first: int, since_s: float, flown: Flown, table: _Table
) -> BoolArray:
    """From row `first` until it is out, or could be: the grace, then d_s deep at half the speed."""
    safety_m = flown.scene.safety_m
    depth_m = max(safety_m - float(gap[first]), 0.0)
    if depth_m == 0.0:
        return np.zeros(len(gap), dtype=bool)
    speed = 0.5 * flown.scene.mission.task.limits.speed_m_s
    out = np.flatnonzero(gap[first:] >= safety_m)
    left_s = float(table.t_s[first + out[0]]) if len(out) else math.inf
    until_s = min(since_s + GRACE_S + depth_m / speed, left_s)
    return (np.arange(len(gap)) >= first) & (table.t_s < until_s)


def _breaches(
    what: str, gap: FloatArray, least_m: float, table: _Table, excuses: dict[str, BoolArray]
) -> list[Breach]:
    """Stretches of a flight that were too near, known and unknown ones apart."""
    found = []
    bad = gap < least_m - _SLACK_M
    excused = _any(excuses)
    for could_know in (True, False):
        here = np.nonzero(bad & (excused != could_know))[0]
        if len(here):
            why = [name for name, when in excuses.items() if when[here[0]]]
            found.append(
                Breach(
                    what=what,
                    t_s=float(table.t_s[here[0]]),
                    worst_m=float(gap[here].min()),
                    could_know=could_know,
                    why=", ".join(why),
                )
            )
    return found


# --- commands


_LASTS = re.compile(r"for ([\d.]+) s: link_off|is back after ([\d.]+) s")


def _outages_s(flown: Flown) -> tuple[tuple[float, float], ...]:
    """When no command could have reached the autopilot, or nobody was there to send one."""
    found = []
    for at_s, what in flown.done:
        if (match := _LASTS.search(what)) is not None:
            found.append((at_s, at_s + float(match[1] or match[2])))
        elif what == "reboot":
            found.append((at_s, math.inf))
    return tuple(found)


def _silent_s(flown: Flown, table: _Table, outages_s: tuple[tuple[float, float], ...]) -> float:
    """Longest time in guided mode in the air, before the end, without a setpoint that was taken."""
    received = sorted(flown.received_s)
    longest, last_s = 0.0, math.inf
    for k, t in enumerate(table.t_s):
        if t > flown.ended_s:
            break
        guided = table.airborne[k] and table.modes[k] in GUIDED
        if not guided or any(begin <= t < end for begin, end in outages_s):
            last_s = float(t)
            continue
        at = bisect.bisect_right(received, t + 1e-6)
        newest = received[at - 1] if at else -math.inf
        last_s = max(newest, last_s) if math.isfinite(last_s) else float(t)
        longest = max(longest, float(t) - last_s)
    return longest


# --- endings


def _outcome(flown: Flown) -> tuple[str, str]:
    """One of the classes of the table, and the reason in words."""
    if flown.died:
        return "unexplained: the companion died", flown.died
    if not flown.truth or math.isinf(flown.airborne_s):
        return _never_flew(flown)
    last, state = flown.truth[-1], flown.samples
    mode, said = last["mode"], [s for s in state if s.phase]
    phase, reason = (said[-1].phase, said[-1].reason) if said else ("", "")
    reason = flown.reason or reason
    held = any(s.phase == "holding" and s.t_s > flown.airborne_s for s in state)
    if flown.outcome == "arrived":
        circle_m = flown.scene.mission.task.limits.loiter_radius_m
        if _miss_m(flown) > _ARRIVED_M + 1.3 * circle_m:
            return "unexplained: arrived elsewhere", f"{_miss_m(flown):.0f} m off"
        return ("held and resumed" if held else "arrived"), reason
    if not reason:
        return "unexplained: no reason", f"{phase}, {mode}"
    if last["landed"] or not last["armed"]:
        fell = any(what == "reboot" for _, what in flown.done)
        return ("fell" if fell else "landed"), reason
    return _in_the_air(flown, mode, phase, reason)


def _never_flew(flown: Flown) -> tuple[str, str]:
    if flown.reason:
        return "refused", flown.reason
    return "unexplained: never flew", flown.samples[-1].phase if flown.samples else ""


def _in_the_air(flown: Flown, mode: str, phase: str, reason: str) -> tuple[str, str]:
    copter = flown.scene.kind == "copter"
    if mode in LANDS:
        return "landed", reason
    if mode in RETURNS:
        return "returned", reason
    if any(text in reason for text in _LET_GO):
        return "let go", reason
    if mode in GUIDED:
        if not flown.outcome and phase == "holding":
            return "held for good", reason
        if not flown.outcome:
            return "unexplained: flies on", f"{phase}: {reason}"
        if copter:
            return "unexplained: left in guided mode", reason
        return "held for good", reason
    if mode in HOLDS:
        return "held for good", reason
    return "let go", f"{reason} ({mode})"


def _miss_m(flown: Flown) -> float:
    """Where it came to, beside the target; as the companion believed if it was told wrong."""
    targets = [flown.scene.mission.targets_ne_m[-1]]
    if flown.target_ne_m is not None:  # an order that the companion may have refused, in words
        targets.append(flown.target_ne_m)
    believed = [s.believed_nea_m for s in flown.samples if s.believed_nea_m is not None]
    return min((math.dist(believed[-1][:2], t) for t in targets if believed), default=math.inf)
