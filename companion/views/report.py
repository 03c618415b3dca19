"""A flight explained on one page: self-contained HTML, made from what was recorded.

What the flight comes to is computed here; how it reads is `report.html.j2`.
"""

import math
import statistics
from collections import Counter
from collections.abc import Iterator
from itertools import groupby, pairwise, starmap
from typing import Any, Final, NamedTuple, final

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from companion.geodesy import BoolArray, FloatArray
from companion.mission import events
from companion.mission import journal as noted
from companion.mission.state import IN_AIR, Phase, Reason
from companion.objective import TERMS
from companion.telemetry.export.shapes import utc_text
from companion.telemetry.flight import Flight, IntArray
from companion.views.figure import PATH, compose, recorded_figure
from companion.views.page import STYLE, page, svg
from companion.views.words import entry_words
from companion.world.columns import distances_to_terrain_m
from companion.world.known_map import KnownMap
from companion.world.radars import detection_probability

_ON_THE_WAY: Final = {
    phase.value
    for phase in (*IN_AIR, Phase.SHADOW)
    if phase not in (Phase.TAKING_OFF, Phase.LANDING)
}
_MOST_CELLS: Final = 16  # about a position, in which terrain is looked for
_AT_ONCE: Final = 4000  # positions, for which that fits into memory
_LATE: Final = 128  # a sequence number so far ahead is of a frame that came late, or twice
_NOT_TOLD: Final = 255  # of GPS_RAW_INT.satellites_visible
_NO_FIX: Final = "#d55e00"


class Nearest(NamedTuple):
    """Where the vehicle, by its own word, was nearest to terrain on its way."""

    distance_m: float
    time_s: float
    place_nea_m: list[float]
    place_deg: tuple[float, float]
    """Latitude and longitude."""


class Exposure(NamedTuple):
    """What the radars that the mission knows may have seen of the vehicle on its way."""

    duration_s: float = 0.0
    """Within any of their ranges."""
    detection: float = 0.0
    """The highest probability of detection at any position (eq. 3)."""
    radar: str = ""
    """Whose that is."""


@final
class FlightFacts:
    """A recorded flight, and what it comes to.

    Times are the vehicle's, seconds since its boot; after a reboot they go on.
    """

    def __init__(
        self,
        flight: Flight,
        *,
        known: KnownMap | None,
        run: dict[str, Any],
        mission_toml: str,
        notes: tuple[str, ...],
    ) -> None:
        """known: the terrain as far as it was known at the end; None: it was not recorded.

        run: what run.json says; empty without it.  notes: what is missing, or odd about what was
        recorded, in words.
        """
        self.flight, self.known, self.run = flight, known, run
        self.mission_toml, self.notes = mission_toml, notes
        began_s = float(flight.track.t_s[0]) if len(flight.track) else 0.0
        self.times_s: FloatArray = flight.times_s + began_s
        """When the vehicle was at each position.  (N,)"""
        phases = [decided.phase for decided in flight.decided_at(flight.times_s)]
        self.way: IntArray = np.flatnonzero([phase in _ON_THE_WAY for phase in phases])
        """The positions in flight, after take-off and before landing.  (K,)"""
        self.duration_s = float(np.ptp(self.times_s[self.way])) if len(self.way) else 0.0
        """From the first to the last position on the way."""
        self._tell_what_happened([entry for _, entry in flight.entries])
        self._tell_the_route()
        self.exposure = self._exposure()
        self._tell_of_terrain()
        self._tell_of_link_and_gps()

    def _tell_what_happened(self, entries: list[noted.Entry]) -> None:
        self.vehicle = next((e.name for e in entries if isinstance(e, noted.VehicleFound)), "")
        """What was flown."""
        self.end = next((e for e in reversed(entries) if isinstance(e, events.End)), None)
        """The end of the mission; None: the record ends before."""
        why = "" if self.end is None else self.end.reason
        self.remedy = next((reason.remedy for reason in Reason if why.startswith(reason.text)), "")
        """What to do about a flight that has failed, if that is known."""
        self.holds = [moment for moment in self.flight.moments if moment.what == "hold"]
        """When it was held, and why."""
        last_s = float(self.times_s[-1]) if len(self.times_s) else 0.0
        lasted_s = ((last_s if h.until_s is None else h.until_s) - h.t_s for h in self.holds)
        self.held_s = sum(max(seconds, 0.0) for seconds in lasted_s)
        """For how long in all, as far as it was recorded."""
        self.counts = Counter(entry.kind for entry in entries)
        """How many entries of each kind the journal has."""
        plans = (e for e in entries if isinstance(e, noted.PlanReady | noted.PlanRefused))
        self.out_of_time = sum(plan.out_of_time for plan in plans)
        """How many plans were cut by time, found or not."""
        times = self.run.get("planning_s")
        took_s = [t for t in times if isinstance(t, int | float)] if isinstance(times, list) else []
        self.planning_s = (statistics.median(took_s), max(took_s)) if took_s else None
        """How long plans took, median and longest, wall time; None: that was not recorded."""

    def _tell_the_route(self) -> None:
        seconds = np.floor(self.times_s[self.way])  # finer, and the noise of a hover adds up
        rows = np.union1d(np.flatnonzero(np.diff(seconds, prepend=-1.0)), [len(self.way) - 1])
        route_ne_m = self.flight.places_nea_m[self.way[rows] if len(self.way) else self.way, :2]
        self.flown_m = float(np.hypot(*np.diff(route_ne_m, axis=0).T).sum())
        """How far it flew over ground, by where it was once a second."""
        self.straight_m = self.left_m = 0.0
        """From the start of its way straight from target to target; from where it was last."""
        if len(route_ne_m):
            stations_ne_m = [route_ne_m[0], *self.flight.decided.targets_ne_m]
            self.straight_m = sum(starmap(math.dist, pairwise(stations_ne_m)))
            self.left_m = math.dist(route_ne_m[-1], stations_ne_m[-1])

    def _exposure(self) -> Exposure:
        points_nea_m, inside = self.flight.places_nea_m[self.way], np.zeros(len(self.way), bool)
        most = Exposure()
        for radar in self.flight.mission.task.radars:
            distances_m = radar.distance_m(points_nea_m)
            inside |= distances_m <= radar.range_m
            detection = float(detection_probability(distances_m, radar.range_m).max(initial=0.0))
            if detection > most.detection:
                most = Exposure(detection=detection, radar=radar.name)
        steps_s = np.diff(self.times_s[self.way])[inside[:-1]]
        return most._replace(duration_s=float(steps_s.sum()))

    def _tell_of_terrain(self) -> None:
        flight, known, way = self.flight, self.known, self.way
        task, points = flight.mission.task, flight.places_nea_m[way]
        cell_m = task.cell_m if known is None else known.cell_m
        reach_m = max(min(8.0 * task.required_clearance_m, _MOST_CELLS * cell_m), 2.0 * cell_m)
        self.clearance_reach_m = reach_m
        """Farther away terrain is not looked for."""
        self.clearances_m: FloatArray = np.full(len(points), np.nan)
        """Distance from the known terrain at each position on the way, in three dimensions, from
        columns as high as their cells; at most `clearance_reach_m`.  (K,)"""
        self.nearest: Nearest | None = None
        """Where the way was nearest to terrain; None: no terrain or no way was recorded."""
        if known is None or not len(points):
            return
        parts = np.array_split(points, max(len(points) // _AT_ONCE, 1))
        self.clearances_m = np.concatenate(
            [distances_to_terrain_m(known, part, reach_m, seen_only=True) for part in parts]
        )
        least = int(np.argmin(self.clearances_m))
        self.nearest = Nearest(
            distance_m=float(self.clearances_m[least]),
            time_s=float(self.times_s[way[least]]),
            place_nea_m=points[least].tolist(),
            place_deg=flight.frame.to_geodetic_deg(*points[least, :2].tolist()),
        )

    def _tell_of_link_and_gps(self) -> None:
        flight, longest_us = self.flight, 0
        heard_us, sequence = np.array(flight.heard, dtype=np.int64).reshape(-1, 2).T
        missing = (np.diff(sequence) - 1) % 256
        self.heard = len(heard_us)
        """Frames of the autopilot."""
        self.lost = int(missing[missing < _LATE].sum())
        """Frames of the autopilot that are missing, by their sequence numbers."""
        self.silence_s = int(np.diff(heard_us).max(initial=0)) * 1e-6
        """The longest time without a frame of the autopilot."""
        sent_us, positions_us = np.array(flight.setpoints_us, np.int64), flight.track.time_us
        for phase, part in flight.segments():
            if phase == Phase.FLYING.value:
                begin, end = np.searchsorted(sent_us, positions_us[[part.start, part.stop - 1]])
                longest_us = max(longest_us, int(np.diff(sent_us[begin:end]).max(initial=0)))
        self.setpoint_gap_s = longest_us * 1e-6
        """The longest time between two setpoints in one stretch of flying; 0: there are none."""
        gps_us, fixes, seen = np.array(flight.gps, dtype=np.int64).reshape(-1, 3).T
        self.gps_s: FloatArray = np.zeros(len(gps_us))
        if len(positions_us):
            self.gps_s = np.interp(gps_us, positions_us, self.times_s)
        """Each time that the GPS spoke,"""
        self.has_fix: BoolArray = fixes >= 3
        """whether it had a fix in three dimensions,"""
        self.satellites: FloatArray = np.where(seen == _NOT_TOLD, np.nan, seen)
        """and how many satellites it saw; NaN: not known.  (M,) each"""
        has_had_one = np.cumsum(self.has_fix) > 0
        lasted_s = np.diff(gps_us, append=gps_us[-1:]) * 1e-6
        self.without_fix_s = float(lasted_s[~self.has_fix & has_had_one].sum())
        """How long the GPS said that it had no fix in three dimensions, after its first one."""

    @property
    def began(self) -> str:
        """When its first position was recorded, in UTC."""
        times_us = self.flight.track.time_us
        return utc_text(times_us[0]) if len(times_us) else "at a time that was not recorded"

    def events(self) -> Iterator[tuple[float, str, bool]]:
        """Vehicle time, what happened, and whether it is bad; what is said twice in a row once."""
        worded = ((entry.t_s, entry_words(entry)) for _, entry in self.flight.entries)
        events = ((t_s, *words) for t_s, words in worded if words is not None)
        return (next(alike) for _, alike in groupby(events, key=lambda event: event[1]))


def report_html(facts: FlightFacts) -> str:
    """The page.  What could not be recorded is named in it."""
    figures = {name: Markup(svg) for name, svg in svg_figures(facts).items()}
    task = facts.flight.mission.task
    return page("report.html.j2", facts=facts, task=task, figures=figures, terms=TERMS[:-1])


def svg_figures(facts: FlightFacts) -> dict[str, str]:
    """The figures by name, as SVG: flight and charts; without a track or a subpath, none."""
    shown = recorded_figure(facts.flight, facts.known)
    if shown is None:
        return {}
    with rc_context(STYLE):
        return {"flight": svg("flight", compose(shown)), "charts": svg("charts", _charts(facts))}


def _charts(facts: FlightFacts) -> Figure:
    """Over time: clearance, speed, satellites; holds are hatched."""
    canvas = Figure(figsize=(14.0, 7.0), layout="constrained")
    charts = clearance, speed, satellites = canvas.subplots(3, 1, sharex=True)
    task, track = facts.flight.mission.task, facts.flight.track
    clearance.plot(facts.times_s[facts.way], facts.clearances_m, color=PATH, lw=1.4)
    clearance.axhline(task.settings.safety_distance_m, color="black", lw=1.2, ls="--")
    clearance.set_ylabel("clearance of known\nterrain, m")
    speed.plot(facts.times_s, np.hypot(track.north_m_s, track.east_m_s), color=PATH, lw=1.4)
    speed.axhline(task.limits.speed_m_s, color="black", lw=1.2, ls="--")
    speed.set_ylabel("ground speed,\nm/s")
    satellites.step(facts.gps_s, facts.satellites, where="post", color=PATH, lw=1.4)
    all_of_it = satellites.get_xaxis_transform()  # from the bottom to the top
    lost: dict[str, Any] = {"where": ~facts.has_fix, "step": "post", "transform": all_of_it}
    satellites.fill_between(facts.gps_s, 0.0, 1.0, fc=_NO_FIX, alpha=0.45, lw=0.0, **lost)
    satellites.set(ylabel="satellites", xlabel="vehicle time, s")
    for axes in charts:
        for hold in facts.holds if len(track) else ():
            begin_s = facts.times_s[0] + hold.time_s
            end_s = facts.times_s[-1] if hold.until_s is None else begin_s + hold.until_s - hold.t_s
            axes.axvspan(begin_s, end_s, fc="none", ec="#888888", hatch="////", lw=0.0)
        axes.grid(color="#888888", alpha=0.3, lw=0.6)
        axes.margins(x=0.0)
        axes.set_ylim(bottom=0.0)
    canvas.align_ylabels()
    return canvas
