"""The side panels: numbers, cost terms, charts and events, for the page."""

import html
import math
from bisect import bisect_right
from collections.abc import Iterator
from typing import Final

import numpy as np

from companion.geodesy import FloatArray
from companion.live_view.recording import BATTERY, Event, Recording
from companion.mission.state import Phase
from companion.objective import TERMS
from companion.telemetry.export.shapes import SubpathPoints, under_m
from companion.telemetry.flight import Decided, Flight, IntArray
from companion.views.words import clock_text, metres, metres_at_least, number
from companion.world.columns import distance_to_terrain_m
from companion.world.known_map import KnownMap

_CHART_POINTS: Final = 600
_DOWN: Final = (Phase.LANDING.value, Phase.DONE.value)
_MOST_APART: Final = 20  # cells: farther away from terrain a clearance is not told
_STANDS_M_S: Final = 0.5
_STYLE: Final = (
    "<style>.fl{font:13px/1.45 system-ui,sans-serif;padding:2px 8px 6px}"
    ".fl table{width:100%;border-collapse:collapse}.fl td{padding:1px 0;vertical-align:top}"
    ".fl td+td{text-align:right;font-variant-numeric:tabular-nums;font-weight:600}"
    ".fl .p{font-size:17px;font-weight:700}.fl .r{color:#b3261e;font-weight:600}"
    ".fl .h{color:#667;margin-top:6px;font-weight:600}.fl .n{color:#667}"
    ".fl .s{color:#00705a}</style>"
)
_ROW: Final = "<tr><td>{}</td><td>{}</td></tr>"
_EVENTS_BEFORE, _EVENTS_AFTER = 30, 10
_LIST: Final = "div:has(>.ev)+div"  # the button group after it
_LIST_STYLE: Final = (
    f"<style>{_LIST}>div>div:first-child{{display:none}}"
    f"{_LIST} button{{flex:1 0 100%!important;min-width:0!important;height:auto;border:0;"
    "padding:0 4px;color:inherit;font-weight:400}"
    f"{_LIST} button *{{justify-content:start;text-align:left;white-space:normal}}</style>"
)


def status_html(
    recording: Recording, known: KnownMap | None, time_s: float, behind: str, stretch: float
) -> str:
    """Phase and reason, target, speed, altitude, clearance and the last plan at a time.

    known: the terrain as it was then, None: not known; behind: what of it is not up to date;
    stretch: how much higher heights are drawn.
    """
    flight, track = recording.flight, recording.flight.track
    [decided] = flight.decided_at(np.array([time_s]))
    row = flight.row_at(time_s)
    place = flight.places_nea_m[row]
    north_m, east_m, altitude_m = place.tolist()
    above_m = away_m = math.nan
    if known is not None:
        above_m = altitude_m - float(under_m(known, place[None, :2])[0])
        most_m = _MOST_APART * known.cell_m
        away_m = distance_to_terrain_m(known, place, most_m, seen_only=True)
        away_m = math.nan if away_m >= most_m else away_m
    speed_m_s = math.hypot(float(track.north_m_s[row]), float(track.east_m_s[row]))
    rows = {
        "time": clock_text(time_s),
        "altitude": f"{number(altitude_m)} m AMSL",
        "over known ground": metres_at_least(above_m),
        "clearance": metres_at_least(away_m),
        "speed": f"{speed_m_s:.1f} m/s, {float(track.up_m_s[row]):+.1f} up",
    }
    if decided.targets_ne_m and flight.has_mission:
        target = decided.asked.target_ne_m if decided.asked else decided.targets_ne_m[-1]
        to_go_m = math.hypot(target[0] - north_m, target[1] - east_m)
        rows["target"] = f"{metres(target[0])} N, {metres(target[1])} E"
        left = clock_text(to_go_m / speed_m_s) if speed_m_s > _STANDS_M_S else "standing"
        rows["to go"] = f"{metres(to_go_m)}, {left}"
    battery = flight.newest(BATTERY, row)
    if battery is not None and battery.battery_remaining >= 0:
        rows["battery"] = f"{battery.battery_remaining} %"
    drawn = "" if stretch == 1.0 else f"; heights drawn {stretch:g} times"
    return _html(
        _line("n", f"{recording.name}{drawn}"),
        _line("p", decided.phase if flight.has_mission else ""),
        _line("r", decided.reason),
        _table(rows),
        *_plan(decided),
        _line("n", decided.warning),
        _line("n", behind),
    )


def waiting_html(recording: Recording) -> str:
    """Before there is a position."""
    return _html(_line("n", recording.name), _line("p", "waiting for the vehicle"))


def _plan(decided: Decided) -> Iterator[str]:
    """What is known of the newest plan."""
    plan = decided.ready
    if plan is None:
        return
    broken = ", ".join(plan.certificate.broken)
    rows = {
        "flying subpath": f"{decided.leg_number}",
        "length": metres(plan.length_m),
        "cost, and to go from its end": f"{number(plan.cost, 2)} + {number(plan.to_go, 2)}",
        "candidates": number(plan.evaluations),
        "proven clearance": metres_at_least(plan.certificate.clearance_m),
    }
    yield _line("h", f"newest plan (number {plan.plan_id})")
    yield _line("r", f"not proven: {broken}") if broken else _line("s", "proven")
    yield _table(rows)
    yield _line("h", "its cost terms, 0 to 100")
    yield _table({name: number(plan.terms.get(name), 1) for name in TERMS[:-1]})


def _html(*parts: str) -> str:
    return f"{_STYLE}<div class=fl>{''.join(parts)}</div>"


def _line(kind: str, text: str) -> str:
    """Text in one of the styles of the panel; nothing of none."""
    return f"<div class={kind}>{html.escape(text)}</div>" if text else ""


def _table(rows: dict[str, str]) -> str:
    lines = "".join(_ROW.format(*map(html.escape, row)) for row in rows.items())
    return f"<table>{lines}</table>"


def event_line(event: Event) -> str:
    """An event in the list of events."""
    return f"{clock_text(event.time_s)} {event.text}"


def event_list(events: list[Event], time_s: float) -> tuple[tuple[str, ...], str]:
    """Lines of the events about a time, newest first, and what makes a list of their buttons.

    Those that are yet to come are pale.
    """
    at = bisect_right(events, time_s, key=lambda event: event.time_s)
    around = events[max(at - _EVENTS_BEFORE, 0) : at + _EVENTS_AFTER]
    to_come = min(len(events) - at, _EVENTS_AFTER)
    pale = f"<style>{_LIST} button:nth-child(-n+{to_come}){{opacity:.5}}</style>"
    return tuple(map(event_line, reversed(around))), f"{_LIST_STYLE}{pale}<div class=ev></div>"


# --- charts


CHARTS: Final = {
    "altitude and known ground, m AMSL": {"altitude": "#0050b5", "ground": "#8a6a3a"},
    "off the path, m": {"off the path": "#c2389b"},
}
"""Their titles, and of each the lines by name and colour."""


def charts_of(flight: Flight, known: KnownMap | None) -> tuple[tuple[FloatArray, ...], ...]:
    """All of a flight so far, at a few hundred points: of each chart the times, then its lines."""
    count = len(flight.times_s)
    rows = np.unique(np.linspace(0, count - 1, min(count, _CHART_POINTS)).astype(np.int64))
    times_s, places = flight.times_s[rows], flight.places_nea_m[rows]
    ground_m = np.full(len(rows), np.nan) if known is None else under_m(known, places[:, :2])
    return (times_s, places[:, 2], ground_m), (times_s, _aside_m(flight, rows))


def _aside_m(flight: Flight, rows: IntArray) -> FloatArray:
    """Distance from the path that was flown, metres; NaN: there was none, or it lands.  (N,).

    The vehicle is behind the point that it is led by, so the subpath before counts too.
    """
    aside, points = np.full(len(rows), np.nan), dict[int, SubpathPoints]()
    for at, decided in enumerate(flight.decided_at(flight.times_s[rows])):
        for plan in (decided.leg, decided.leg_before):
            if plan is not None and decided.phase not in _DOWN:
                if plan.plan_id not in points:
                    points[plan.plan_id] = SubpathPoints(plan.subpath)
                away_m, _ = points[plan.plan_id].nearest(flight.places_nea_m[rows[at]])
                aside[at] = np.fmin(aside[at], away_m)
    return aside
