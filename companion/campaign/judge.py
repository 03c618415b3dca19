"""What a flight in which something goes wrong came to: how it ended, how near it came to what.

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

Everything else counts: wind, lost frames, an autopilot that does not obey.
So does an ending without a reason, or one that leaves the vehicle to nobody (`unexplained: ...`),
unless no command could reach it then: a copter that hears nothing hovers.
"""

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from companion.campaign import truth
from companion.campaign.drawn_faults import KILLED, Happening, happenings
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.flight import Flight, crash_of
from companion.geodesy import BoolArray, FloatArray
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, wire
from companion.mavlink.frames import decoded, number_of, sender_of
from companion.mission.state import Reason
from companion.telemetry.run_folder import Records
from companion.world.terrain import PeakTerrain
from companion.world.zones import CircleZone, Zone

GUIDED: Final = frozenset({"GUIDED", "Offboard"})
HOLDS: Final = frozenset({"BRAKE", "Hold", "LOITER"})
LANDS: Final = frozenset({"LAND", "Land", "Descend", "AUTOLAND"})
RETURNS: Final = frozenset({"RTL", "Return", "SMARTRTL"})
_THERE: Final = ("arrived", "held and resumed")
"""Endings at the target."""
_BY_ORDER: Final = {"hold": HOLDS, "land": LANDS, "return": RETURNS}
KNOWN_AFTER_S: Final = 10.0
GRACE_S: Final = 10.0
_SLACK_M: Final = 0.1
_ARRIVED_M: Final = 15.0
_LET_GO: Final = (Reason.MODE_TAKEN.text, Reason.FAILSAFE.text, Reason.FENCE_BREACHED.text)
_BLIND: Final = ("POSITION_STALE", "POSITION_FROZEN", "POSITION_JUMPED", "POSITION_ELSEWHERE",
                 "NO_FIX", "ESTIMATOR")  # fmt: skip
_DEG_M: Final = 111_195.0
_POSITION: Final = wire.MAVLink_global_position_int_message
_COMMAND: Final = wire.MAVLink_command_long_message
_SET_MODE: Final = wire.MAV_CMD_DO_SET_MODE
_SETPOINTS: Final = (
    wire.MAVLINK_MSG_ID_COMMAND_INT,
    wire.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    wire.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Table:
    """A flight in arrays, one row for each moment of truth while the mission flew in the air."""

    rows: list[dict[str, Any]]
    t_s: FloatArray
    points_nea_m: FloatArray
    off_m: FloatArray
    """How far the position that the companion was told lay off the true one."""
    ours: BoolArray
    excuses: dict[str, BoolArray]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Told:
    """Of flight.tlog: positions that came in, and when setpoints and modes went out."""

    at_s: FloatArray
    """When it was told, vehicle time."""
    of_s: FloatArray
    """What time it is of."""
    deg_m: FloatArray
    """Latitude, longitude, degrees, and altitude, metres AMSL; (K, 3)."""
    sent_s: list[float]


def judged(flight: Flight, drawn: DrawnWorld, timeline: str) -> dict[str, Any]:
    """The columns of a row that this judge fills in; `violated` in words, empty: nothing."""
    flight, is_cut = _until_stopped(flight)
    done, told = happenings(timeline), _told(flight.folder / "flight.tlog")
    table = _table(flight, drawn, done, told)
    safety_m = drawn.task.settings.safety_distance_m
    terrain_m = _terrain_m(table, drawn)
    excuses = table.excuses | _radar_excuse(table, done)
    known, unknown = _breaches("terrain", terrain_m, safety_m, table, excuses)
    touched = _touched(flight, table)
    hit = touched if any(touched) else _crash(flight, table, excuses)
    known, unknown = known + hit[0], unknown + hit[1]
    for zone, known_s in _zones(flight, drawn, done):
        gap_m = _gap_m(table.points_nea_m, zone)
        excused = table.excuses | {
            "the zone was new": _new_excuse(gap_m, known_s, table, drawn),
            "it was given back there": _back_excuse(gap_m, table, drawn),
        }
        near = _breaches(zone.name, gap_m, safety_m, table, excused)
        known, unknown = known + near[0], unknown + near[1]
    ending, reason = _ending(flight, drawn, done, told, is_cut=is_cut)
    if ending.startswith("unexplained"):
        known.append(f"{ending}: {reason}")
    elif not done and ending not in _THERE:
        known.append(f"{ending} with nothing wrong: {reason}")
    return {
        "ending": ending,
        "reason": reason or None,
        "violated": known,
        "excused": "; ".join(unknown) or None,
        "is_distorted": bool(_any(table.excuses | excuses).any()),
        "silent_s": _silent_s(table, told, _outages_s(done), _end_s(flight)),
        "position_off_m": float(table.off_m.max()) if len(table.t_s) else None,
    }


def _until_stopped(flight: Flight) -> tuple[Flight, bool]:
    """A flight without what followed when its time was over."""
    stop = next((k for k, e in enumerate(flight.journal) if e["kind"] == "stop asked"), None)
    if stop is None:
        return flight, False
    until_s = flight.journal[stop]["t_s"]
    rows = [row for row in flight.truth if row["t_s"] <= until_s]
    return replace(flight, journal=flight.journal[:stop], truth=rows), True


def _any(excuses: dict[str, BoolArray]) -> BoolArray:
    return np.any(list(excuses.values()), axis=0)


# --- the flight as arrays


def _told(log: Path) -> _Told:
    """What the companion and its vehicle said to each other."""
    at_us, of_s, places, sent_us = list[int](), list[float](), list[tuple[float, ...]](), []
    with Records(log) as records:
        while (record := records.take()) is not None:
            us, frame = record
            number, (_, component) = number_of(frame), sender_of(frame)
            from_vehicle = component == AUTOPILOT_COMPONENT
            if number == _POSITION.id and from_vehicle:
                told = decoded(frame, _POSITION)
                at_us.append(us)
                of_s.append(told.time_boot_ms * 1e-3)
                places.append((told.lat * 1e-7, told.lon * 1e-7, told.alt * 1e-3))
            elif not from_vehicle and (
                number in _SETPOINTS
                or (number == _COMMAND.id and decoded(frame, _COMMAND).command == _SET_MODE)
            ):
                sent_us.append(us)
    # stamps count from an epoch of their own, positions from the vehicle's boot
    first_us, first_s = (at_us[0], of_s[0]) if at_us else (0, 0.0)
    return _Told(
        at_s=1e-6 * np.array([us - first_us for us in at_us]) + first_s,
        of_s=np.array(of_s),
        deg_m=np.array(places).reshape(-1, 3),
        sent_s=[1e-6 * (us - first_us) + first_s for us in sent_us],
    )


def _airborne_s(flight: Flight) -> float:
    """When the mission first flew."""
    phases = (e for e in flight.journal if e.get("phase") == "flying")
    return next((e["t_s"] for e in phases), math.inf)


def _end_s(flight: Flight) -> float:
    return next((e["t_s"] for e in flight.journal if e["kind"] == "end"), math.inf)


def _table(flight: Flight, drawn: DrawnWorld, done: Sequence[Happening], told: _Told) -> _Table:
    terrain, airborne_s = drawn.terrain, _airborne_s(flight)
    ground_m = terrain.ground_amsl_m if isinstance(terrain, PeakTerrain) else -math.inf
    rows = [
        row
        for row in flight.truth
        if row["t_s"] >= airborne_s and not row["landed"] and row["altitude_amsl_m"] > ground_m
    ]
    t_s = np.array([row["t_s"] for row in rows])
    keys = ("north_m", "east_m", "altitude_amsl_m")
    points = np.array([[row[key] for key in keys] for row in rows]).reshape(-1, 3)
    rebooted = t_s >= min((each.at_s for each in done if each.what == "reboot"), default=math.inf)
    off_m = np.where(rebooted, 0.0, _off_m(flight, t_s, told))
    phases = _phases(flight)
    starts = [at_s for at_s, _, _ in phases]
    blind = []
    for row in rows:
        _, phase, code = phases[max(bisect.bisect_right(starts, row["t_s"]) - 1, 0)]
        blind.append(phase == "holding" and code in _BLIND and row["mode"] not in GUIDED)
    ours = _ours(rows, flight)
    error_m = drawn.task.limits.navigation_error_m
    return _Table(
        rows=rows,
        t_s=t_s,
        points_nea_m=points,
        off_m=off_m,
        ours=ours,
        excuses={
            "the position was wrong": _lasting(t_s, off_m > error_m),
            "somebody else flew": _lasting(t_s, ~ours),
            "the autopilot rebooted": rebooted,
            "there was no position": _lasting(t_s, np.array(blind, dtype=bool)),
        },
    )


def _phases(flight: Flight) -> list[tuple[float, str, str | None]]:
    """When which phase began, and its reason's name; to the first restart of the clock."""
    found: list[tuple[float, str, str | None]] = []
    for entry in flight.journal:
        if entry["kind"] == "phase" and (not found or entry["t_s"] >= found[-1][0]):
            found.append((entry["t_s"], entry["phase"], entry.get("code")))
    return found


def _off_m(flight: Flight, t_s: FloatArray, told: _Told) -> FloatArray:
    """By the position that was told last, against the truth at the time that it is of."""
    if not len(t_s) or not len(told.at_s):
        return np.zeros(len(t_s))
    times = np.array([row["t_s"] for row in flight.truth])
    names = ("lat_deg", "lon_deg", "altitude_amsl_m")
    true = [np.interp(told.of_s, times, [row[name] for row in flight.truth]) for name in names]
    aside = told.deg_m - np.stack(true, axis=-1)
    east = _DEG_M * math.cos(math.radians(flight.mission.frame.latitude_deg))
    off_m = np.linalg.norm(aside * (_DEG_M, east, 1.0), axis=-1)
    newest = np.searchsorted(np.maximum.accumulate(told.at_s), t_s, side="right") - 1
    return np.asarray(off_m[np.maximum(newest, 0)])


def _ours(rows: Sequence[dict[str, Any]], flight: Flight) -> BoolArray:
    """Whether the companion has a say: the mode is guided, or the one that it asked for last.

    A mode that was taken away is not given back by the autopilot's own failsafe being over: the
    companion has let go, and goes on only when it is told to (design 7).
    """
    asked = [(e["t_s"], e["mode"]) for e in flight.journal if e["kind"] == "set mode"]
    ours, taken_s = [], -math.inf
    for row in rows:
        newest = bisect.bisect_right(asked, row["t_s"], key=lambda each: each[0]) - 1
        asked_s, wanted = asked[newest] if newest >= 0 else (-math.inf, "")
        obeyed = row["mode"] in _BY_ORDER.get(wanted, ()) and asked_s >= taken_s
        ours.append(row["mode"] in GUIDED or obeyed)
        if not ours[-1]:
            taken_s = row["t_s"]
    return np.array(ours, dtype=bool)


def _lasting(t_s: FloatArray, bad: BoolArray) -> BoolArray:
    """Bad now, or less than the grace ago."""
    last_s = np.maximum.accumulate(np.where(bad, t_s, -math.inf))
    return np.asarray(t_s - last_s < GRACE_S)


# --- distances


def _terrain_m(table: _Table, drawn: DrawnWorld) -> FloatArray:
    """True distance to the ground; landing and the flight after it are no business of d_s."""
    if not len(table.t_s):
        return np.empty(0)
    up_to_m = 4.0 * drawn.task.settings.safety_distance_m
    distance_m = truth.terrain_distance_m(table.points_nea_m, drawn.terrain, up_to_m)
    lands = np.array([row["mode"] in LANDS | RETURNS for row in table.rows])
    return np.where(lands, np.inf, distance_m)


def _gap_m(points_nea_m: FloatArray, zone: Zone) -> FloatArray:
    """Horizontal distance to where the vehicle must not be; negative there."""
    if not len(points_nea_m):
        return np.empty(0)
    gap_m = truth.keep_out_distance_m(points_nea_m, zone)
    return -gap_m if zone.keep_in else gap_m


def _zones(
    flight: Flight, drawn: DrawnWorld, done: Sequence[Happening]
) -> list[tuple[Zone, float]]:
    """Every zone with the time from which it could be known."""
    zones: list[tuple[Zone, float]] = [(zone, -math.inf) for zone in drawn.task.zones]
    for each in done:
        name, *words = each.what.split()
        row = _row_at(flight, each.at_s)
        if name != "ground_fence" or row is None:
            continue
        ahead_m = float(words[2]) if len(words) > 2 else 0.0
        speed = math.hypot(row["velocity_north_m_s"], row["velocity_east_m_s"])
        share = ahead_m / max(speed, 1e-6)
        north_m = row["north_m"] + share * row["velocity_north_m_s"]
        east_m = row["east_m"] + share * row["velocity_east_m_s"]
        circle = CircleZone(
            name="new fence", north_m=north_m, east_m=east_m, radius_m=float(words[0])
        )
        zones.append((circle, each.at_s + KNOWN_AFTER_S))
    return zones


def _row_at(flight: Flight, time_s: float) -> dict[str, Any] | None:
    """The truth at that time."""
    return next((row for row in flight.truth if row["t_s"] >= time_s - 1e-3), None)


def _radar_excuse(table: _Table, done: Sequence[Happening]) -> dict[str, BoolArray]:
    lied_s = min((each.at_s for each in done if "either_way" in each.what), default=math.inf)
    return {"the radar told too low heights": table.t_s >= lied_s}


def _new_excuse(gap_m: FloatArray, known_s: float, table: _Table, drawn: DrawnWorld) -> BoolArray:
    """Not yet known, or on the way out for the first time: from when it is led, or was told."""
    excused: BoolArray = table.t_s < known_s
    after = np.nonzero(~excused & table.ours)[0]
    if math.isinf(known_s) or not len(after):
        return excused
    first = int(after[0])
    since_s = max(known_s, float(table.t_s[first]))
    return excused | _on_the_way_out(gap_m, first, since_s, table, drawn)


def _back_excuse(gap_m: FloatArray, table: _Table, drawn: DrawnWorld) -> BoolArray:
    """On the way out for the first time since the companion has the vehicle back."""
    excused = np.zeros(len(gap_m), dtype=bool)
    for k in np.flatnonzero(table.ours[1:] & ~table.ours[:-1]) + 1:
        excused |= _on_the_way_out(gap_m, int(k), float(table.t_s[k]), table, drawn)
    return excused


def _on_the_way_out(
    gap_m: FloatArray, first: int, since_s: float, table: _Table, drawn: DrawnWorld
) -> BoolArray:
    """From row `first` until it is out, or could be: the grace, then d_s deep at half the speed."""
    safety_m = drawn.task.settings.safety_distance_m
    depth_m = max(safety_m - float(gap_m[first]), 0.0)
    if depth_m == 0.0:
        return np.zeros(len(gap_m), dtype=bool)
    speed = 0.5 * drawn.task.limits.speed_m_s
    out = np.flatnonzero(gap_m[first:] >= safety_m)
    left_s = float(table.t_s[first + out[0]]) if len(out) else math.inf
    until_s = min(since_s + GRACE_S + depth_m / speed, left_s)
    return (np.arange(len(gap_m)) >= first) & (table.t_s < until_s)


def _breaches(
    what: str,
    gap_m: FloatArray,
    least_m: float,
    table: _Table,
    excuses: dict[str, BoolArray],
) -> tuple[list[str], list[str]]:
    """What was too near: that it could know of, and that it could not."""
    bad, excused = gap_m < least_m - _SLACK_M, _any(excuses)
    known, unknown = list[str](), list[str]()
    for where, said in ((bad & ~excused, known), (bad & excused, unknown)):
        here = np.nonzero(where)[0]
        if len(here):
            why = ", ".join(name for name, when in excuses.items() if when[here[0]])
            worst = f"{what} {gap_m[here].min():.1f} m from {table.t_s[here[0]]:.1f} s"
            said.append(f"{worst} ({why})" if why else worst)
    return known, unknown


def _crash(
    flight: Flight, table: _Table, excuses: dict[str, BoolArray]
) -> tuple[list[str], list[str]]:
    """Into the ground or a thing, but for a landing, by whoever flew in the moment before."""
    crash, known, unknown = crash_of(flight), list[str](), list[str]()
    if crash is None:
        return known, unknown
    last = int(np.searchsorted(table.t_s, crash["t_s"])) - 1
    if last >= 0 and table.rows[last]["mode"] not in LANDS | RETURNS:
        what = f"hit {crash['into']} at {crash['speed_m_s']:.1f} m/s, {crash['t_s']:.1f} s"
        why = ", ".join(name for name, when in excuses.items() if when[last])
        (unknown if why else known).append(f"{what} ({why})" if why else what)
    return known, unknown


def _touched(flight: Flight, table: _Table) -> tuple[list[str], list[str]]:
    """Whether it touched a tree, wall, building or wire, likewise; landing is no business of it."""
    for row in flight.truth:
        if row.get("near_m", math.inf) > 0.0 or row["mode"] in LANDS | RETURNS:
            continue
        newest = int(np.searchsorted(table.t_s, row["t_s"], side="right")) - 1
        if newest < 0:  # before it flew
            continue
        said = f"flown: touched something at {row['t_s']:.1f} s"
        why = ", ".join(name for name, when in table.excuses.items() if when[newest])
        return ([], [f"{said} ({why})"]) if why else ([said], [])
    return [], []


# --- commands


def _outages_s(done: Sequence[Happening]) -> list[tuple[float, float]]:
    """When no command could have reached the autopilot, or nobody was there to send one."""
    ends = [(e.at_s, e.until_s) for e in done if e.what.startswith(("link_off", KILLED))]
    return [*ends, *((e.at_s, math.inf) for e in done if e.what == "reboot")]


def _silent_s(
    table: _Table, told: _Told, outages_s: Sequence[tuple[float, float]], until_s: float
) -> float:
    """Longest time in guided mode in the air, before the end, without a command to the vehicle."""
    sent_s, longest, last_s = sorted(told.sent_s), 0.0, math.inf
    for row, t in zip(table.rows, table.t_s.tolist(), strict=True):
        if t > until_s:
            break
        guided = row["armed"] and row["mode"] in GUIDED
        if not guided or any(begin <= t < end for begin, end in outages_s):
            last_s = t
            continue
        at = bisect.bisect_right(sent_s, t + 1e-6)
        newest = sent_s[at - 1] if at else -math.inf
        last_s = max(newest, last_s) if math.isfinite(last_s) else t
        longest = max(longest, t - last_s)
    return longest


# --- endings


def _ending(
    flight: Flight,
    drawn: DrawnWorld,
    done: Sequence[Happening],
    told: _Told,
    *,
    is_cut: bool,
) -> tuple[str, str]:
    """How it ended, and the reason in words."""
    end = next((e for e in flight.journal if e["kind"] == "end"), None)
    if end is None and not is_cut:
        return "unexplained: no end", "the journal has none"
    said = [e for e in flight.journal if e["kind"] == "phase" and e["phase"] != "done"]
    phase, reason = (said[-1]["phase"], said[-1].get("reason")) if said else ("", None)
    reason = (end["reason"] if end else None) or reason or ""
    airborne_s = _airborne_s(flight)
    if all(row["landed"] for row in flight.truth):
        return ("refused", reason) if reason else ("unexplained: never flew", phase)
    last = flight.truth[-1]
    if end is not None and end["outcome"] == "arrived":
        circle_m = drawn.task.limits.loiter_radius_m
        if (miss_m := _miss_m(flight, done, told)) > _ARRIVED_M + 1.3 * circle_m:
            return "unexplained: arrived elsewhere", f"{miss_m:.0f} m off"
        held = any(e["phase"] == "holding" and e["t_s"] > airborne_s for e in said)
        return ("held and resumed" if held else "arrived"), reason
    if is_cut and phase not in ("holding", "landing"):
        return "unexplained: flies on", f"{phase}: {reason}"
    if not reason:
        return "unexplained: no reason", f"{phase}, {last['mode']}"
    if last["landed"] or not last["armed"]:
        return ("fell" if any(e.what == "reboot" for e in done) else "landed"), reason
    out_of_reach = any(begin_s <= _end_s(flight) < end_s for begin_s, end_s in _outages_s(done))
    held = is_cut or out_of_reach or not drawn.task.limits.hovers
    return _in_the_air(last["mode"], reason, held_in_guided=held), reason


def _in_the_air(mode: str, reason: str, *, held_in_guided: bool) -> str:
    if mode in LANDS:
        return "landed"
    if mode in RETURNS:
        return "returned"
    if any(text in reason for text in _LET_GO):
        return "let go"
    if mode in GUIDED:
        return "held for good" if held_in_guided else "unexplained: left in guided mode"
    return "held for good" if mode in HOLDS else "let go"


def _miss_m(flight: Flight, done: Sequence[Happening], told: _Told) -> float:
    """Where it came to, beside the target; as the companion believed if it was told wrong."""
    targets = [flight.mission.targets_ne_m[-1]]
    for each in done:
        name, *words = each.what.split()
        row = _row_at(flight, each.at_s)
        if name == "ground_target" and row is not None:  # which it may have refused, in words
            north, east = (-1.0 if word in ("south", "west") else 1.0 for word in words[2::3])
            place = row["north_m"] + north * float(words[0]), row["east_m"] + east * float(words[3])
            targets.append(place)
    if not len(told.deg_m):
        return math.inf
    north_m, east_m = flight.mission.frame.to_local_m(told.deg_m[-1:, 0], told.deg_m[-1:, 1])
    believed = float(north_m[0]), float(east_m[0])
    return min(math.dist(believed, target) for target in targets)
