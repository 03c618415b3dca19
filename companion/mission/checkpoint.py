"""Checkpoint: the state that a companion restarted in flight resumes from (design 7).

Plain values, for a file: the current path, the mission's progress, the flown path and the vehicle's
fence (`Saved`).  The known map is stored beside it.  If they cannot be read, a vehicle in the air
is still taken over, without them (`without_checkpoint`).
"""

import json
import math
from operator import attrgetter
from typing import Any, Final, final

import msgspec
from msgspec import MsgspecError, Struct
from msgspec.structs import asdict

from companion.geodesy import FloatArray
from companion.mission import phases
from companion.mission.events import FenceChanged
from companion.mission.journal import filled, plain, zone_of
from companion.mission.mission import Mission
from companion.mission.phases import IN_AIR, OnPath, Phase, Reason
from companion.mission.state import Flight, Goal, State, Targets, Way
from companion.path.subpath import Subpath
from companion.planner.procedure import Leg, Reference
from companion.planner.request import FlownSegment, Refusal, control_points
from companion.planner.settings import Task
from companion.world.known_map import KnownMap, empty_map

Values = dict[str, Any]

DECODE_ERRORS = (ArithmeticError, LookupError, RecursionError, TypeError, ValueError, MsgspecError)
"""Exceptions that restoring invalid values may raise."""
PERIOD_S, LONGEST_S = 1.0, 10.0
LOST: Final = {"lost": "taking over without memory of the flight", "map_lost": "scanning anew"}
"""What could not be read, by its key in a checkpoint, and what follows."""


@final
class _Leg(Struct):
    """A `Leg`; rules: the digest of the task that it was proven under."""

    number: int
    plan_id: int
    speed_m_s: float | None
    reaches_target: bool
    through: bool
    rules: str
    control_nea_m: FloatArray
    p_prog: Reference | None = None

    @staticmethod
    def of(leg: Leg) -> "_Leg":
        """What is saved of a leg."""
        return filled(_Leg, leg, leg.subpath, rules=leg.rules.digest)

    def leg(self, task: Task) -> Leg:
        """The leg; task: the one in force: its digest tells whether it was proven under that."""
        values = asdict(self)
        values["subpath"] = Subpath(control_nea_m=values.pop("control_nea_m"))
        values["rules"] = task if self.rules == task.digest else task.unruled()
        return Leg(**values)


@final
class Saved(Struct, kw_only=True):
    """What is saved of a state, by the names that it has there; reasons by name."""

    t_s: float
    phase: str
    sank: bool
    airborne: bool
    taken: bool
    armed_by_us: bool
    targets_ne_m: Targets
    fence: FenceChanged | None
    standing: str | None
    """What was ordered last: a pause, or its goal (`Goal`)."""
    set_aside: str | None
    """Its goal, in a pause."""
    target: int
    plan_id: int
    legs_flown: int
    stops: int
    departures: int
    route_ne_m: Targets
    flown: list[tuple[FloatArray, float, float, float | None]]
    refusal: str | None
    fallen_back: str | None
    returning: bool
    homeward: bool
    leg: _Leg | None
    next_leg: _Leg | None
    joined_m: float
    back: list[_Leg]


def values_of(state: State) -> Values:
    """The state as plain values (JSON)."""
    flight, path = state.flight, state.path
    saved = filled(
        Saved,
        state,
        flight,
        t_s=state.now_s,
        phase=state.phase.name,
        sank=state.phase is Phase.LANDING and state.stage.obeyed,
        standing=Reason.PAUSED.name if state.paused else _name(state.goal.value),
        set_aside=_name(state.goal.value) if state.paused else None,
        flown=[
            (segment.control_nea_m, segment.from_m, segment.until_m, segment.speed_m_s)
            for segment in flight.flown
        ],
        refusal=_name(flight.refusal),
        fallen_back=_name(flight.fallen_back),
        leg=None if path is None else _Leg.of(path.leg),
        next_leg=None if path is None or path.next_leg is None else _Leg.of(path.next_leg),
        joined_m=0.0 if path is None else path.joined_m,
        back=[_Leg.of(leg) for leg in flight.back],
    )
    values: Values = msgspec.to_builtins(saved, enc_hook=plain)
    return values


def _name(value: Reason | Refusal | None) -> str | None:
    return None if value is None else value.name


def initial_state(mission: Mission, resume: tuple[Values, KnownMap | None] | None) -> State:
    """The initial state of a mission: blank, or from a checkpoint."""
    state = State.of(mission, blank_map(mission))
    if resume is None:
        return state
    values, kept = resume
    if "lost" in values:
        state.now_s, state.airborne = float(values["t_s"]), True
        state.flight.plan_id = int(values["plan_id"])
    else:
        state = restored(mission, kept or state.flight.known, values)
    assert isinstance(state.stage, phases.Preparing)
    state.stage.since_s, state.stage.news = state.now_s, ". ".join(restore_notes(values))
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
    return [f"{text}: {values[key]}" for key, text in LOST.items() if key in values]


def restored(mission: Mission, known: KnownMap, values: Values) -> State:
    """The state to resume from; raises one of `DECODE_ERRORS` for invalid values.

    The vehicle's state is not part of it: the vehicle is prepared again.
    """
    json.dumps(values, allow_nan=False)  # ValueError: a number that is not finite
    if (fence := values.get("fence")) is not None:
        values = {**values, "fence": {"t_s": 0.0, **fence}}  # older ones have no time
    saved = msgspec.convert(values, Saved, dec_hook=_decoded)
    paused = saved.standing == Reason.PAUSED.name
    state = filled(
        State,
        saved,
        now_s=saved.t_s,
        goal=Goal(_reason(saved.set_aside if paused else saved.standing)),
        paused=paused,
        task=mission.task,
        flight=Flight(known=known),
    )
    state.take_fence(mission.task, saved.fence)
    task, leg, next_leg = state.task, saved.leg, saved.next_leg
    path = leg and OnPath(
        leg=leg.leg(task), next_leg=next_leg and next_leg.leg(task), joined_m=saved.joined_m
    )
    state.flight = filled(
        Flight,
        saved,
        known=known,
        flown=tuple(
            FlownSegment(control_nea_m=control, from_m=low_m, until_m=high_m, speed_m_s=speed_m_s)
            for control, low_m, high_m, speed_m_s in saved.flown
        ),
        refusal=None if saved.refusal is None else Refusal[saved.refusal],
        fallen_back=_reason(saved.fallen_back),
        way=Way.BACK if saved.returning else Way.HOME if saved.homeward else Way.OUT,
        back=tuple(saved_leg.leg(task) for saved_leg in saved.back) if saved.returning else (),
    )
    landing = saved.phase == Phase.LANDING.name
    state.stage = phases.Preparing(
        phase=Phase.WAITING, since_s=saved.t_s, path=path, landing=landing, sank=saved.sank
    )
    if not 0 <= saved.target < max(len(state.targets_ne_m), 1):
        raise ValueError(f"target {saved.target} of {len(state.targets_ne_m)}")
    return state


def _decoded(kind: type, values: Any) -> Any:
    """For `msgspec`: what it does not know itself."""
    return zone_of(kind, values) if isinstance(values, dict) else control_points(values)


def _reason(name: str | None) -> Reason | None:
    return None if name is None else Reason[name]


_persisted: Final = attrgetter(
    *("phase", "goal", "paused", "flight.way"),
    *(name for name in Saved.__struct_fields__ if name in State.__struct_fields__),
    *(f"flight.{name}" for name in Saved.__struct_fields__ if name in Flight.__struct_fields__),
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
        path, landing = state.path, state.phase is Phase.LANDING and state.stage.obeyed
        kept = *_persisted(state), landing, path and (path.leg, path.next_leg)
        if kept == self.kept and 0.0 <= now_s - self.kept_at_s < LONGEST_S and not must:
            return None, None
        self.kept_at_s, self.known, self.kept = now_s, state.flight.known, kept
        return values_of(state), self.known if grown else None
