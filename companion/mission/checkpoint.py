"""What a companion that is started again in flight has to know of the one before it (design 7).

Plain values, for a file: the path in force, how far the mission has come, the way here, the
settings, and the vehicle's fence.  The known map is kept beside it.  Where they cannot be read, a
vehicle in the air is taken over all the same, without them (`forgotten`).
"""

import math
from collections.abc import Callable
from functools import lru_cache
from operator import attrgetter
from typing import Any, final

import numpy as np

from companion.mission.events import FenceChanged
from companion.mission.mission import Mission
from companion.mission.renewed import replace
from companion.mission.state import IN_AIR, Flight, Phase, Reason, State
from companion.path.subpath import Subpath
from companion.planner import adjustable
from companion.planner.procedure import Leg
from companion.planner.request import Refusal, Stretch
from companion.planner.rules import newly_broken
from companion.planner.settings import Task
from companion.world.known_map import KnownMap, empty_map
from companion.world.threats import CircleZone, PolygonZone, Zone

Values = dict[str, Any]

NOT_SUCH = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""What values that are no checkpoint may raise when they are restored."""
PERIOD_S, _LONGEST_S = 1.0, 10.0
_OF_STATE: dict[str, Callable[[Any], Any]] = dict.fromkeys(
    ("airborne", "taken", "armed_by_us"), bool
)
_OF_FLIGHT: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("target", "plan_id", "legs_flown", "stops", "departures"), int),
    "joined_m": float,
    **dict.fromkeys(("returning", "homeward"), bool),
}
"""Fields that are kept as they are, and of what type."""
_kept_of_state = attrgetter(
    *_OF_STATE,
    *("phase", "obeyed", "standing", "set_aside", "targets_ne_m", "given", "flown_under", "fence"),
)
_kept_of_flight = attrgetter(
    *_OF_FLIGHT,
    *("leg", "next_leg", "route_ne_m", "speed_limit_m_s", "flown", "back"),
    *("refusal", "fallen_back"),
)
"""All that a checkpoint is made of, but for the time."""


def values_of(state: State) -> Values:
    """The state as plain values (JSON)."""
    flight = state.flight
    return {
        "t_s": state.now_s,
        "phase": state.phase.name,
        "sank": state.phase is Phase.LANDING and state.obeyed,
        **{name: getattr(state, name) for name in _OF_STATE},
        "standing": None if state.standing is None else state.standing.name,
        "set_aside": None if state.set_aside is None else state.set_aside.name,
        "targets_ne_m": [list(target) for target in state.targets_ne_m],
        "settings": adjustable.values_of(state.given),
        "flown_under": state.flown_under and adjustable.values_of(state.flown_under),
        "fence": None if state.fence is None else _of_fence(state.fence),
        **{name: getattr(flight, name) for name in _OF_FLIGHT},
        "leg": _of_leg(flight.leg),
        "next_leg": _of_leg(flight.next_leg),
        "route_ne_m": [list(place) for place in flight.route_ne_m],
        "speed_limit_m_s": flight.speed_limit_m_s if np.isfinite(flight.speed_limit_m_s) else None,
        "flown": [
            [stretch.control_nea_m.tolist(), stretch.from_m, stretch.until_m]
            for stretch in flight.flown
        ],
        "back": [_of_leg(leg) for leg in flight.back],
        "refusal": None if flight.refusal is None else flight.refusal.name,
        "fallen_back": None if flight.fallen_back is None else flight.fallen_back.name,
    }


def beginning(mission: Mission, resume: tuple[Values, KnownMap | None] | None) -> State:
    """The state that a mission begins with: blank, or what another companion has left."""
    if resume is None:
        return State.of(mission, blank(mission))
    values, kept = resume
    known = blank(mission, values)
    if "lost" in values:
        state, time_s = State.of(mission, known), float(values["t_s"])
        flight = replace(state.flight, plan_id=int(values["plan_id"]))
        state = replace(state, now_s=time_s, since_s=time_s, airborne=True, flight=flight)
    else:
        state = restored(mission, kept or known, values)
    return replace(state, news=". ".join(news_of(values)))


def blank(mission: Mission, values: Values | None = None) -> KnownMap:
    """What is known of the terrain before the first scan; under the settings of a checkpoint."""
    task = mission.task if values is None else _task(mission, values.get("settings"))
    return mission.known or empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)


def _task(mission: Mission, settings: Values | None) -> Task:
    """The mission's task with what was set in flight.  ValueError where that breaks a rule."""
    task = adjustable.with_values(mission.task, settings or {})
    if (error := newly_broken(mission.task, task)) is not None:
        raise ValueError(str(error))
    if task.limits.speed_m_s > mission.task.limits.speed_m_s:
        raise ValueError(f"speed {task.limits.speed_m_s:g} m/s is above the mission's")
    return task


def forgotten(
    why: str, *, system_id: int | None = None, time_s: float = 0.0, plan_id: int = 0
) -> Values:
    """What stands for the checkpoint of a flight of which none can be read.

    The vehicle may be in the air, so it is never armed: `airborne` from the beginning.
    system_id, time_s, plan_id: the vehicle, its clock and the newest plan, where they are known.
    """
    return {"lost": why, "system_id": system_id, "t_s": time_s, "plan_id": plan_id}


def without_map(values: Values, why: str) -> Values:
    """The checkpoint of a flight whose known map cannot be read."""
    return {**values, "map_lost": why}


def news_of(values: Values) -> list[str]:
    """What could not be restored, for people."""
    news = []
    if "lost" in values:
        news.append(f"taking over without memory of the flight: {values['lost']}")
    if "map_lost" in values:
        news.append(f"scanning anew: {values['map_lost']}")
    return news


def told(values: Values) -> Values:
    """The journal's entry about going on."""
    lost: Values = {key: values[key] for key in ("lost", "map_lost") if key in values}
    return {"phase": values.get("phase"), **lost}


def restored(mission: Mission, known: KnownMap, values: Values) -> State:
    """The state from which the mission goes on; one of `NOT_SUCH` if these are not such values.

    What the vehicle does now is not in it: the vehicle is prepared again.
    """
    _must_be_finite(values)
    limit, fence = values["speed_limit_m_s"], values["fence"]
    given, under = _task(mission, values.get("settings")), values.get("flown_under")
    state = State.of(mission, known)
    state = state.with_rules(given, None if fence is None else _fence(fence))
    rules = state.task
    flight = Flight(
        known=known,
        **{name: kind(values[name]) for name, kind in _OF_FLIGHT.items()},
        leg=_leg(values["leg"], rules),
        next_leg=_leg(values["next_leg"], rules),
        route_ne_m=_places(values["route_ne_m"]),
        speed_limit_m_s=np.inf if limit is None else float(limit),
        flown=tuple(
            Stretch(control_nea_m=_control(control), from_m=float(low), until_m=float(high))
            for control, low, high in values["flown"]
        ),
        back=tuple(leg for each in values["back"] if (leg := _leg(each, rules)) is not None),
        refusal=None if values.get("refusal") is None else Refusal[values["refusal"]],
        fallen_back=_reason(values["fallen_back"]),
    )
    targets_ne_m = _places(values["targets_ne_m"])
    if not 0 <= flight.target < max(len(targets_ne_m), 1):
        raise ValueError(f"target {flight.target} of {len(targets_ne_m)}")
    time_s = float(values["t_s"])
    return replace(
        state,
        now_s=time_s,
        since_s=time_s,
        landing=values["phase"] == Phase.LANDING.name,
        sank=bool(values.get("sank", False)),
        **{name: kind(values[name]) for name, kind in _OF_STATE.items()},
        standing=_reason(values["standing"]),
        set_aside=_reason(values.get("set_aside")),
        flown_under=None if under is None else _task(mission, under),
        targets_ne_m=targets_ne_m,
        flight=flight,
    )


def _must_be_finite(value: Any) -> None:
    """ValueError for a number that a vehicle cannot be sent to."""
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


def _control(values: list[list[float]]) -> np.ndarray:
    control = np.array(values, dtype=np.float64)
    if control.ndim != 2 or control.shape[1] != 3 or len(control) < 4:
        raise ValueError("control points are rows of north, east, altitude")
    return control


def _of_leg(leg: Leg | None) -> Values | None:
    if leg is None:
        return None
    return {
        "number": leg.number,
        "plan_id": leg.plan_id,
        "reaches_target": leg.reaches_target,
        "through": leg.through,
        "rules": None if leg.rules is None else leg.rules.digest,
        "control_nea_m": leg.subpath.control_nea_m.tolist(),
    }


def _leg(values: Values | None, rules: Task) -> Leg | None:
    """rules: those in force; whether it was proven under them, their digest tells."""
    if values is None:
        return None
    return Leg(
        number=int(values["number"]),
        plan_id=int(values["plan_id"]),
        subpath=Subpath(control_nea_m=_control(values["control_nea_m"])),
        reaches_target=bool(values["reaches_target"]),
        through=bool(values["through"]),
        rules=rules if values.get("rules") == rules.digest else None,
    )


def _of_fence(fence: FenceChanged) -> Values:
    return {
        "zones": _of_zones(fence.zones),
        "floor_amsl_m": fence.floor_amsl_m,
        "ceiling_amsl_m": fence.ceiling_amsl_m,
    }


def _fence(values: Values) -> FenceChanged:
    return FenceChanged(
        time_s=0.0,
        zones=tuple(_zone(each) for each in values["zones"]),
        floor_amsl_m=values["floor_amsl_m"],
        ceiling_amsl_m=values["ceiling_amsl_m"],
    )


@lru_cache(maxsize=2)
def _of_zones(zones: tuple[Zone, ...]) -> list[Values]:
    """Kept, not to be changed: it is asked for every second, and the same for a whole flight."""
    return [_of_zone(zone) for zone in zones]


def _of_zone(zone: Zone) -> Values:
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


@final
class Keeper:
    """Says when there is something to keep: once a second, and when the map has grown.

    Where nothing but the time has changed, every ten seconds: replacing a file wears out a card,
    and took a sixth of a flight in lockstep.
    """

    def __init__(self) -> None:
        self.kept_at_s = -math.inf
        self._kept: tuple[Any, ...] = ()
        self.known: KnownMap | None = None

    def due(
        self, state: State, now_s: float, *, at_once: bool = False
    ) -> tuple[Values | None, KnownMap | None]:
        """The checkpoint, if it is time for one, and the map, if it has changed since the last."""
        if state.phase not in (*IN_AIR, Phase.PREPARING, Phase.ARMING):
            return None, None
        grown = state.flight.known is not self.known
        since_s = now_s - self.kept_at_s
        if 0.0 <= since_s < PERIOD_S and not (grown or at_once):
            return None, None
        kept = (_kept_of_state(state), _kept_of_flight(state.flight))
        if kept == self._kept and 0.0 <= since_s < _LONGEST_S and not (grown or at_once):
            return None, None
        self.kept_at_s, self.known, self._kept = now_s, state.flight.known, kept
        return values_of(state), self.known if grown else None
