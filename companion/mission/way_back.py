"""The way back: along the flown path, each stretch of it proven again; else home by a plan."""

import math
from copy import copy

from companion.mission import following, phases
from companion.mission.decisions import AT_M, Turn
from companion.mission.events import Plan, PlanReady
from companion.mission.phases import OnPath, Reason, Trigger
from companion.mission.state import State, Targets, Way
from companion.planner.procedure import Leg, Reference, hover_pose
from companion.planner.progress import NO_PROGRESS
from companion.planner.request import Backtrack, PlanRequest, Refusal
from companion.planner.rules import target_refusal
from companion.planner.settings import Task

_NO_WAY_OUT = frozenset({Refusal.START_NEAR_TERRAIN, Refusal.START_NEAR_UNKNOWN})
"""From where nothing leads away nothing leads home either: only the autopilot climbs out."""
_CIRCLES = 1.5  # loiter radii: a plane lands on a circle about where it is told to (px4.md 10)


def request(state: State, turn: Turn) -> None:
    """Request the proof of the backtrack; it takes effect as soon as it is ready."""
    position, flight, stage = state.vehicle.position_nea_m, state.flight, state.stage
    assert isinstance(stage, phases.Stopped)
    if position is None:
        return turn.give_up(state.reason or Reason.POSITION_STALE)
    flight.plan_id += 1
    stage.backtrack = phases.Planning(state.task, since_s=state.now_s)
    request = PlanRequest(
        plan_id=flight.plan_id,
        seed=turn.context.seed,
        task=state.task,
        known=flight.known,
        scan_nea_m=position,
        start=hover_pose(position),
        from_rest=True,
        target_ne_m=position[:2],
        flown=flight.flown,
    )
    turn.do(Plan(request=request, due_s=state.now_s))


def on_plan(state: State, event: PlanReady, turn: Turn) -> None:
    """Take the backtrack; if it failed, plan a path home, or give up."""
    flight, stage, outcome = state.flight, state.stage, event.outcome
    asked = stage.backtrack if isinstance(stage, phases.Stopped) else None
    if asked is None or outcome.plan_id != flight.plan_id:
        return
    if asked.rules is not state.task:  # it was proven under other rules
        return request(state, turn)
    was = flight.way, flight.back
    back = way_of(outcome, state.task) if isinstance(outcome, Backtrack) else ()
    flight.way, flight.back = Way.BACK, back
    if (path := begun(state)) is not None:
        return turn.to(Trigger.BACKTRACK, phases.Led(path=path))
    flight.way, flight.back = was
    reason = state.reason or Reason.NO_PLAN
    text = f"{reason.text}: no way back is proven, planning one home"
    return home_by_plan(state, turn, text, reason, warning=True)


def way_of(outcome: Backtrack, rules: Task) -> tuple[Leg, ...]:
    """The legs of a backtrack."""
    last = len(outcome.subpaths) - 1
    speeds_m_s = outcome.speeds_m_s or (None,) * len(outcome.subpaths)
    stretches = zip(outcome.subpaths, outcome.through, speeds_m_s, strict=True)
    return tuple(
        Leg(
            number=number + 1,
            plan_id=outcome.plan_id,
            subpath=subpath,
            reaches_target=number == last and outcome.reaches_start,
            through=through,
            rules=rules,
            speed_m_s=speed_m_s,
        )
        for number, (subpath, through, speed_m_s) in enumerate(stretches)
    )


def begun(state: State) -> OnPath | None:
    """On the first remaining leg of the backtrack.

    None: none is left, or it is too far off; nothing has changed then.
    """
    flight = state.flight
    if not flight.back or state.vehicle.position_nea_m is None:
        return None
    leg, *rest = flight.back
    begins = OnPath(leg=leg) if state.path is None else copy(state.path)
    begins.leg, begins.next_leg, begins.stop = leg, None, None
    path = following.joined(state, begins)
    if path is None:
        return None
    flight.back = tuple(rest)
    path.reference = Reference(length_m=path.reference.length_m)
    take_next(state, path)
    return path


def take_next(state: State, path: OnPath) -> None:
    """Have the next backtrack leg ready if it may be entered at full speed."""
    flight = state.flight
    if path.leg.through and flight.back:
        path.next_leg, *rest = flight.back
        flight.back = tuple(rest)


def ended(state: State, last: Leg, turn: Turn) -> None:
    """At rest at the end of the backtrack: land there, or plan the rest of the way home."""
    there = last.reaches_target
    if there and begins_at_home(state):
        return turn.to(Trigger.END_LAND if state.vehicle.traits.lands else Trigger.HAND_OVER)
    left_m = beyond_path_m(state)
    text = f"returning: planning {left_m:.0f} m on to home" if there else "returning another way"
    return home_by_plan(state, turn, text, state.flight.fallen_back or Reason.NO_PLAN)


def leave_path(state: State) -> None:
    """At rest off the path; of the way back with its current leg still to be flown."""
    path, hover = state.path, None
    if path is not None and state.flight.returning:
        hover = None if path.stop is None else following.end_of(path)
        following.requeue_backtrack(state, path.leg, path.next_leg)
    following.come_to_rest(state, hover)


def home_by_plan(
    state: State, turn: Turn, text: str, reason: Reason, *, warning: bool = False
) -> None:
    """Go home by a planned path; where none can be asked for, by the autopilot's own return.

    text, warning: what is said before; reason: why the flight is given up in the second case.
    """
    flight = state.flight
    if is_above_home(state) and state.vehicle.traits.lands:
        turn.say("returning: above home, landing", "end")
        return turn.to(Trigger.END_LAND)
    if state.reason is Reason.NO_PLAN and flight.refusal in _NO_WAY_OUT:
        return turn.give_up(reason)
    place = home_ne_m(state)
    why = "home is not known"
    if place is not None:
        why = target_refusal(state.task, place).replace("the target:", "home:")
    if place is None or why or flight.homeward:
        if why:
            turn.warn(why)
        return turn.give_up(reason)
    set_targets(state, (place,), Way.HOME)
    turn.say(text, "end", warning=warning)
    return turn.to(Trigger.RESUME)


def set_targets(state: State, targets_ne_m: Targets, way: Way) -> None:
    """To these targets from now on, without what was known of the way to others."""
    state.targets_ne_m, flight, stage = targets_ne_m, state.flight, state.stage
    flight.target = flight.stops = flight.failures = 0
    flight.route_ne_m, flight.progress = (), NO_PROGRESS
    flight.way, flight.back = way, ()
    if isinstance(stage, phases.Stopped):
        stage.backtrack = None


# --- home, as the vehicle has it, and whether the flown path begins there


def home_ne_m(state: State) -> tuple[float, float] | None:
    """Where home is, north and east; None: nobody has said.

    If the vehicle has not said, it is where its own take-off began the path, never the origin.
    """
    if (home := state.vehicle.home_nea_m) is not None:
        return home[:2]
    return _path_begins_ne_m(state) if state.armed_by_us else None


def is_above_home(state: State) -> bool:
    """Whether a copter is above its home."""
    home, position = state.vehicle.home_nea_m, state.vehicle.position_nea_m
    if home is None or position is None or not state.vehicle.traits.hovers:
        return False
    return math.dist(home[:2], position[:2]) < max(AT_M, state.task.limits.tracking_error_m)


def beyond_path_m(state: State) -> float:
    """How far it is home from where the flown path begins; 0: that is at home, or home unknown.

    Not where the companion took over in flight, or was started again without memory.  An autopilot
    that has no mode to land goes home by itself from where its own take-off ended.
    """
    home, begins, traits = home_ne_m(state), _path_begins_ne_m(state), state.vehicle.traits
    if home is None or begins is None or (state.armed_by_us and not traits.lands):
        return 0.0
    limits, off_m = state.task.limits, math.dist(home, begins)
    near_m = max(AT_M, limits.tracking_error_m)
    if not traits.hovers:
        near_m = max(near_m, _CIRCLES * limits.loiter_radius_m)
    return off_m if off_m > near_m else 0.0


def begins_at_home(state: State) -> bool:
    """Whether the flown path is known to begin at home."""
    return home_ne_m(state) is not None and beyond_path_m(state) == 0.0


def _path_begins_ne_m(state: State) -> tuple[float, float] | None:
    """Where the flown path begins; None: nothing was flown."""
    if not state.flight.flown:
        return None
    north, east, _ = state.flight.flown[0].control_nea_m[0]
    return float(north), float(east)
