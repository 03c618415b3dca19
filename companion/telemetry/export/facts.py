"""What is written beside a shape, for people who click on it: names with units, plain values."""

import math
from collections.abc import Iterator
from typing import Final

from companion.telemetry.export import shapes
from companion.telemetry.export.flight import Moment, PlannedSubpath, RecordedFlight
from companion.telemetry.export.track import Track
from companion.world.threats import CircleZone, Radar, Zone

Facts = dict[str, str | int | float | bool | None]
"""None: not known, or there is none."""


_OF_PLAN: Final = ("length_m", "cost", "evaluations", "reaches_target")
_OF_PROOF: Final = (
    *("clearance_m", "keep_out_m", "dead_man_m", "turn_radius_m", "climb_angle_rad"),
    *("dive_angle_rad", "lowest_amsl_m", "highest_amsl_m", "radar_m"),
)


def drawn_track(flight: RecordedFlight) -> Iterator[tuple[str, Track, Facts]]:
    """The flown track phase by phase, each up to where the next one begins; thinned if it is long.

    Of each the phase's name, the positions to draw, and what is known of it.
    """
    whole = flight.track
    for phase, part in flight.segments():
        drawn = slice(part.start, min(part.stop + 1, len(whole)))
        yield phase, whole.part(shapes.thinned(drawn, len(whole))), _segment_facts(whole, part)


def _segment_facts(track: Track, part: slice) -> Facts:
    return {
        "from_utc": shapes.utc_text(track.time_us[part.start]),
        "until_utc": shapes.utc_text(track.time_us[part.stop - 1]),
        "from_s": float(track.t_s[part.start]),
        "until_s": float(track.t_s[part.stop - 1]),
        "positions": part.stop - part.start,
    }


def plan_facts(planned: PlannedSubpath) -> Facts:
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


def moment_facts(moment: Moment) -> Facts:
    """Of a hold, or of what else has happened at a place."""
    return {
        "what": moment.what,
        "why": moment.why,
        "code": moment.code,
        "t_s": moment.t_s,
        "until_s": moment.until_s,
    }


def zone_facts(zone: Zone) -> Facts:
    """Of a zone that is not to be entered, or not to be left."""
    return {
        "keep_in": zone.keep_in,
        "radius_m": zone.radius_m if isinstance(zone, CircleZone) else None,
    }


def radar_facts(radar: Radar) -> Facts:
    """Of a radar."""
    return {"range_m": radar.range_m, "altitude_amsl_m": radar.centre_nea_m[2]}


def plain(text: str) -> str:
    """The text without characters that XML does not have."""
    return "".join(c if c.isprintable() or c in "\n\t" else " " for c in text)
