"""Checkpoint: the state that a companion restarted in flight resumes from (design 7).

Plain values, for a file: the current path, the mission's progress, the flown path and the vehicle's
fence.  The known map is stored beside it.  If they cannot be read, a vehicle in
the air is still taken over, without them (`without_checkpoint`).
"""

import math
from collections.abc import Callable
from enum import Enum
from functools import lru_cache
from operator import attrgetter
from typing import Any, Final, final

from msgspec.structs import replace

from companion.mission.events import FenceChanged
from companion.mission.mission import Mission
from companion.mission.state import (
    IN_AIR,
    Landing,
    OnPath,
    Orders,
    Phase,
    Reason,
    State,
    Waiting,
    Way,
)
from companion.path.subpath import Subpath
from companion.planner.procedure import Leg
from companion.planner.request import FlownSegment, Refusal, control_points
from companion.planner.settings import Task
from companion.world.known_map import KnownMap, empty_map
from companion.world.zones import CircleZone, PolygonZone, Zone

Values = dict[str, Any]

DECODE_ERRORS = (
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
)
"""Exceptions that restoring invalid values may raise."""
PERIOD_S, LONGEST_S = 1.0, 10.0


def values_of(state: State) -> Values:
    """The state as plain values (JSON)."""
    flight, path = state.flight, state.path
    return {
        "t_s": state.now_s,
        "phase": state.phase.name,
        "sank": isinstance(state.stage, Landing) and state.stage.obeyed,
        **{name: _plain(getattr(state, name)) for name in _OF_STATE},
        "standing": _plain(state.orders.active),
        "set_aside": _plain(state.orders.suspended),
        **{name: _plain(getattr(flight, name)) for name in (*_OF_FLIGHT, *_WAY)},
        "leg": None if path is None else _plain(path.leg),
        "next_leg": None if path is None else _plain(path.next_leg),
        "joined_m": 0.0 if path is None else path.joined_m,
    }


def _plain(value: Any) -> Any:
    """Enumerations by name, infinite limits as null."""
    match value:
        case Enum():
            return value.name
        case tuple():
            return [_plain(each) for each in value]
        case Leg():
            return {
                **{name: getattr(value, name) for name in _OF_LEG},
                "rules": None if value.rules is None else value.rules.digest,
                "control_nea_m": value.subpath.control_nea_m.tolist(),
            }
        case FenceChanged():
            zones = [_of_zone(zone) for zone in value.zones]
            return {"zones": zones, **{name: getattr(value, name) for name in _LIMITS}}
        case FlownSegment():
            return [value.control_nea_m.tolist(), value.from_m, value.until_m, value.speed_m_s]
        case float():
            return value if math.isfinite(value) else None
        case _:
            return value


def initial_state(mission: Mission, resume: tuple[Values, KnownMap | None] | None) -> State:
    """The initial state of a mission: blank, or from a checkpoint."""
    if resume is None:
        return State.of(mission, blank_map(mission))
    values, kept = resume
    known = blank_map(mission)
    if "lost" in values:
        state, time_s = State.of(mission, known), float(values["t_s"])
        flight = replace(state.flight, plan_id=int(values["plan_id"]))
        state = replace(state, now_s=time_s, airborne=True, flight=flight)
    else:
        state = restored(mission, kept or known, values)
    left = state.stage
    assert isinstance(left, Waiting)
    left.since_s, left.news = state.now_s, ". ".join(restore_notes(values))
    return state


def blank_map(mission: Mission) -> KnownMap:
    """The known map before the first scan."""
    task = mission.task
    return mission.known or empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)


def without_checkpoint(
    why: str, *, system_id: int | None = None, time_s: float = 0.0, plan_id: int = 0
) -> Values:
    """Substitute for a checkpoint that cannot be read.

    The vehicle may be in the air, so `airborne` is set and it is never armed.  system_id, time_s,
    plan_id: the vehicle, its clock and the newest plan, where known.
    """
    return {"lost": why, "system_id": system_id, "t_s": time_s, "plan_id": plan_id}


def without_map(values: Values, why: str) -> Values:
    """The checkpoint of a flight whose known map cannot be read."""
    return {**values, "map_lost": why}


def restore_notes(values: Values) -> list[str]:
    """What could not be restored, as text for the operator."""
    news = []
    if "lost" in values:
        news.append(f"taking over without memory of the flight: {values['lost']}")
    if "map_lost" in values:
        news.append(f"scanning anew: {values['map_lost']}")
    return news


def resumed_entry(values: Values) -> Values:
    """The journal entry of a resumed flight."""
    lost: Values = {key: values[key] for key in ("lost", "map_lost") if key in values}
    return {"phase": values.get("phase"), **lost}


def restored(mission: Mission, known: KnownMap, values: Values) -> State:
    """The state to resume from; raises one of `DECODE_ERRORS` for invalid values.

    The vehicle's state is not part of it: the vehicle is prepared again.
    """
    _must_be_finite(values)
    kept = _read(values, _OF_STATE)
    state = State.of(mission, known)
    state.take_fence(mission.task, kept["fence"])
    rules = state.task
    back = tuple(leg for each in values["back"] if (leg := _leg(each, rules)) is not None)
    leg, next_leg = _leg(values["leg"], rules), _leg(values["next_leg"], rules)
    joined_m = float(values["joined_m"])
    flight = replace(
        state.flight,
        **_read(values, _OF_FLIGHT),
        way=Way.BACK if values["returning"] else Way.HOME if values["homeward"] else Way.OUT,
        back=back if values["returning"] else (),
    )
    time_s = float(values["t_s"])
    left = Waiting(
        since_s=time_s,
        path=None if leg is None else OnPath(leg=leg, next_leg=next_leg, joined_m=joined_m),
        landing=values["phase"] == Phase.LANDING.name,
        sank=bool(values["sank"]),
    )
    state = replace(
        state,
        stage=left,
        now_s=time_s,
        orders=Orders(_reason(values["standing"]), _reason(values["set_aside"])),
        flight=flight,
        **kept,
    )
    if not 0 <= flight.target < max(len(state.targets_ne_m), 1):
        raise ValueError(f"target {flight.target} of {len(state.targets_ne_m)}")
    return state


def _read(values: Values, kinds: dict[str, Callable[[Any], Any]]) -> Values:
    """Fields of a state, of their types."""
    return {name: kind(values[name]) for name, kind in kinds.items()}


def _must_be_finite(value: Any) -> None:
    """Raise ValueError for numbers that are not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} among the numbers")
    inner = value.values() if isinstance(value, dict) else value
    if isinstance(value, dict | list):
        for each in inner:
            _must_be_finite(each)


def _reason(name: str | None) -> Reason | None:
    return None if name is None else Reason[name]


def _places(values: list[list[float]]) -> tuple[tuple[float, float], ...]:
    return tuple((float(north), float(east)) for north, east in values)


def _segments(values: list[Any]) -> tuple[FlownSegment, ...]:
    return tuple(
        FlownSegment(
            control_nea_m=control_points(control),
            from_m=float(low),
            until_m=float(high),
            speed_m_s=_speed(speed),
        )
        for control, low, high, speed in values
    )


def _speed(value: Any) -> float | None:
    return None if value is None else float(value)


def _leg(values: Values | None, rules: Task) -> Leg | None:
    """rules: those in force; their digest tells whether the leg was proven under them."""
    if values is None:
        return None
    return Leg(
        **_read(values, _OF_LEG),
        subpath=Subpath(control_nea_m=control_points(values["control_nea_m"])),
        rules=rules if values.get("rules") == rules.digest else None,
    )


def _fence(values: Values | None) -> FenceChanged | None:
    if values is None:
        return None
    return FenceChanged(
        time_s=0.0,
        zones=tuple(_zone(each) for each in values["zones"]),
        **{name: values[name] for name in _LIMITS},
    )


@lru_cache(maxsize=1024)
def _of_zone(zone: Zone) -> Values:
    """Cached, not to be modified: needed every second, and the same for a whole flight."""
    values: Values = {"name": zone.name, "keep_in": zone.keep_in}
    if isinstance(zone, CircleZone):
        return {**values, "circle": [zone.north_m, zone.east_m, zone.radius_m]}
    return {**values, "vertices_ne_m": [list(vertex) for vertex in zone.vertices_ne_m]}


def _zone(values: Values) -> Zone:
    name, keep_in = str(values["name"]), bool(values["keep_in"])
    if "circle" in values:
        north_m, east_m, radius_m = (float(value) for value in values["circle"])
        return CircleZone(
            name=name, north_m=north_m, east_m=east_m, radius_m=radius_m, keep_in=keep_in
        )
    return PolygonZone(name=name, vertices_ne_m=_places(values["vertices_ne_m"]), keep_in=keep_in)


_LIMITS: Final = ("floor_amsl_m", "ceiling_amsl_m")
_OF_STATE: Final[dict[str, Callable[[Any], Any]]] = {
    **dict.fromkeys(("airborne", "taken", "armed_by_us"), bool),
    "targets_ne_m": _places,
    "fence": _fence,
}
_OF_FLIGHT: Final[dict[str, Callable[[Any], Any]]] = {
    **dict.fromkeys(("target", "plan_id", "legs_flown", "stops", "departures"), int),
    "route_ne_m": _places,
    "flown": _segments,
    "refusal": lambda name: None if name is None else Refusal[name],
    "fallen_back": _reason,
}
_OF_LEG: Final[dict[str, Callable[[Any], Any]]] = {
    **dict.fromkeys(("number", "plan_id"), int),
    "speed_m_s": _speed,
    **dict.fromkeys(("reaches_target", "through"), bool),
}
"""Fields that are stored, and their decoders from what `_plain` returns."""
_WAY: Final = ("returning", "homeward", "back")
persisted: Final = attrgetter(
    *(*_OF_STATE, "orders", "phase"),
    *(f"flight.{name}" for name in (*_OF_FLIGHT, "way", "back")),
)
"""All fields of a state in a checkpoint, except the time and the legs."""


@final
class CheckpointPolicy:
    """Decides when to write a checkpoint: once a second, and when the map has grown.

    If only the time has changed, every ten seconds: rewriting a file wears out flash memory, and
    took a sixth of the run time of a flight in lockstep.
    """

    def __init__(self, *, keeps_map: bool = True) -> None:
        """keeps_map: not one of near things, which may have moved."""
        self._keeps_map = keeps_map
        self.kept_at_s = self.looked_at_s = -math.inf
        """When the last checkpoint was written, and when it was last seen whether one is due."""
        self.kept: tuple[Any, ...] = ()
        """The fields of the last checkpoint."""
        self.known: KnownMap | None = None

    def due(
        self, state: State, now_s: float, *, at_once: bool = False
    ) -> tuple[Values | None, KnownMap | None]:
        """The checkpoint, if it is time for one, and the map, if it has changed since the last."""
        if state.phase not in (*IN_AIR, Phase.PREPARING, Phase.READY, Phase.ARMING):
            return None, None
        grown = self._keeps_map and state.flight.known is not self.known
        must = grown or at_once
        if 0.0 <= now_s - self.looked_at_s < PERIOD_S and not must:
            return None, None
        self.looked_at_s = now_s
        path, landing = state.path, isinstance(state.stage, Landing) and state.stage.obeyed
        kept = *persisted(state), landing, path and (path.leg, path.next_leg)
        if kept == self.kept and 0.0 <= now_s - self.kept_at_s < LONGEST_S and not must:
            return None, None
        self.kept_at_s, self.known, self.kept = now_s, state.flight.known, kept
        return values_of(state), self.known if grown else None
