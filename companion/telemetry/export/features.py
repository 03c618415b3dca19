"""Features of a flight for maps of any format: places, lines and areas with attributes."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from companion.geodesy import FloatArray
from companion.telemetry.export import shapes
from companion.telemetry.flight import Flight, IntArray, PlannedSubpath
from companion.world.zones import CircleZone

Facts = dict[str, str | int | float | bool | None]
"""For people who click on it: names with units, plain values; None: not known, or none."""
_NO_FACTS: Final[Facts] = {}
_OF_PLAN: Final = ("length_m", "cost", "evaluations", "reaches_target")
_OF_PROOF: Final = (
    *("clearance_m", "keep_out_m", "dead_man_m", "turn_radius_m", "climb_angle_rad"),
    *("dive_angle_rad", "lowest_amsl_m", "highest_amsl_m", "radar_m"),
)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Feature:
    """One thing to show."""

    kind: str
    """track, subpath, target, rally, keep_out, keep_in, radar or event (docs/export.md)."""
    name: str
    points: FloatArray
    """(N, 3) longitude, latitude, altitude AMSL; (1, 2) of a place on the ground.  Of an area its
    edge, anticlockwise, the first point not repeated; a zone's is at the mission's ceiling."""
    facts: Facts
    times_us: IntArray | None = None
    """When the vehicle was at each point, microseconds since 1970; of tracks and events."""


def features_of(flight: Flight) -> Iterator[Feature]:
    """The features of a flight, kind by kind."""
    yield from _track(flight)
    frame, task = flight.mission.frame, flight.mission.task
    for each in flight.planned:
        line = shapes.of_subpath(each.plan.subpath, frame)
        name = f"plan {each.plan.plan_id}"
        yield Feature(kind="subpath", name=name, points=line, facts=_plan_facts(each))
    for kind, places in {"target": flight.targets_ne_m, "rally": flight.mission.rally_ne_m}.items():
        for number, place_ne_m in enumerate(places, start=1):
            place = np.array([frame.to_geodetic_deg(*place_ne_m)[::-1]])
            yield Feature(kind=kind, name=f"{kind} {number}", points=place, facts=_NO_FACTS)
    for zone in flight.zones:
        yield Feature(
            kind="keep_in" if zone.keep_in else "keep_out",
            name=zone.name,
            points=shapes.of_zone(zone, frame, task.limits.ceiling_amsl_m),
            facts={
                "keep_in": zone.keep_in,
                "radius_m": zone.radius_m if isinstance(zone, CircleZone) else None,
            },
        )
    for radar in task.radars:
        facts: Facts = {"range_m": radar.range_m, "altitude_amsl_m": radar.centre_nea_m[2]}
        edge = shapes.of_radar(radar, frame)
        yield Feature(kind="radar", name=radar.name, points=edge, facts=facts)
    yield from _events(flight)


def _track(flight: Flight) -> Iterator[Feature]:
    """The flown track phase by phase, each up to where the next one begins; thinned if long."""
    whole = flight.track
    for phase, part in flight.segments():
        drawn = slice(part.start, min(part.stop + 1, len(whole)))
        piece = whole.part(shapes.thinned(drawn, len(whole)))
        facts: Facts = {
            "from_utc": shapes.utc_text(whole.time_us[part.start]),
            "until_utc": shapes.utc_text(whole.time_us[part.stop - 1]),
            "from_s": float(whole.t_s[part.start]),
            "until_s": float(whole.t_s[part.stop - 1]),
            "positions": part.stop - part.start,
        }
        line = shapes.of_track(piece)
        yield Feature(kind="track", name=phase, points=line, facts=facts, times_us=piece.time_us)


def _plan_facts(planned: PlannedSubpath) -> Facts:
    """Of a subpath: what it costs, and what is proven of it."""
    plan, proven = planned.plan, planned.plan.certificate
    facts: Facts = {
        "plan_id": plan.plan_id,
        "leg": planned.leg,
        "flown": planned.leg is not None,
        "ready_s": plan.t_s,
        "begun_s": planned.begun_s,
        **{name: getattr(plan, name) for name in _OF_PLAN},
        **{name: getattr(proven, name) for name in _OF_PROOF},
        "broken": ", ".join(proven.broken),
    }
    return {name: None if _is_unbounded(fact) else fact for name, fact in facts.items()}


def _is_unbounded(fact: object) -> bool:
    """Whether it is a number that JSON does not have."""
    return isinstance(fact, float) and not math.isfinite(fact)


def _events(flight: Flight) -> Iterator[Feature]:
    """Holds, and what else has happened, where the vehicle was then."""
    for moment in flight.moments:
        at = flight.index_at(moment.boot, moment.t_s)
        if at is None:
            continue
        here = flight.track.part(slice(at, at + 1))
        facts = {name: getattr(moment, name) for name in ("what", "why", "code", "t_s", "until_s")}
        yield Feature(
            kind="event",
            name=moment.what,
            points=shapes.of_track(here),
            facts=facts,
            times_us=here.time_us,
        )
