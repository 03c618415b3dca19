"""The way back: along the flown path, each stretch of it proven again; else home by a plan."""

from msgspec.structs import replace

from companion.mission import events, following, joining
from companion.mission.decisions import Context, Step, give_up, preceded
from companion.mission.events import PlanReady, say, warn
from companion.mission.following import at_rest, at_rest_at_end
from companion.mission.home import begins_at_home, beyond_path_m, home_ne_m, is_above_home
from companion.mission.state import (
    Flight,
    OnPath,
    Orders,
    PlanningBacktrack,
    Reason,
    State,
    Trigger,
    Way,
)
from companion.planner.procedure import Leg, Reference, hover_pose
from companion.planner.progress import NO_PROGRESS
from companion.planner.request import Backtrack, PlanRequest, Refusal
from companion.planner.rules import target_refusal
from companion.planner.settings import Task

_NO_WAY_OUT = frozenset({Refusal.START_NEAR_TERRAIN, Refusal.START_NEAR_UNKNOWN})
"""From where nothing leads away nothing leads home either: only the autopilot climbs out."""


def request(state: State, context: Context) -> Step:
    """Request the proof of the backtrack; it takes effect as soon as it is ready."""
    here, flight = state.vehicle.position_nea_m, state.flight
    if here is None:
        return give_up(state, state.reason or Reason.POSITION_STALE)
    request = PlanRequest(
        plan_id=flight.plan_id + 1,
        seed=context.seed,
        task=state.task,
        known=flight.known,
        scan_nea_m=here,
        start=hover_pose(here),
        from_rest=True,
        target_ne_m=here[:2],
        flown=flight.flown,
    )
    planning = PlanningBacktrack(state.task, since_s=state.now_s)
    state = state.with_flight(plan_id=request.plan_id, planning_backtrack=planning)
    return state, [events.Plan(request=request, due_s=state.now_s)], None


def on_plan(state: State, event: PlanReady, context: Context) -> Step:
    """Take the backtrack; if it failed, plan a path home, or give up."""
    flight, asked = state.flight, state.flight.planning_backtrack
    if asked is None or event.outcome.plan_id != flight.plan_id:
        return state, [], None
    if asked.rules is not state.task:  # it was proven under other rules
        return request(state, context)
    back = _way_of(event.outcome, state.task) if isinstance(event.outcome, Backtrack) else ()
    after = state.with_flight(way=Way.BACK, back=back, planning_backtrack=None)
    if begun(after) is not None:
        return after, [], Trigger.BACKTRACK
    reason = state.reason or Reason.NO_PLAN
    text = f"{reason.text}: no way back is proven, planning one home"
    return home_by_plan(state, text, reason, warning=True)


def _way_of(outcome: Backtrack, rules: Task) -> tuple[Leg, ...]:
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


def begun(state: State) -> Flight | None:
    """On the first remaining leg of the backtrack; None: none is left, or it is too far off."""
    flight, before = state.flight, state.flight.path
    if not flight.back or state.vehicle.position_nea_m is None:
        return None
    leg, *rest = flight.back
    onto = OnPath(leg=leg) if before is None else replace(before, leg=leg, next_leg=None, stop=None)
    went_on = joining.joined(replace(state, flight=replace(flight, hover_nea_m=None)), onto)
    if went_on is None or went_on.path is None:
        return None
    at_rest = Reference(length_m=went_on.path.reference.length_m)
    path = replace(went_on.path, reference=at_rest)
    return with_next(replace(went_on, back=tuple(rest)), path)[0]


def with_next(flight: Flight, path: OnPath) -> tuple[Flight, OnPath]:
    """On this path, with the next backtrack leg ready if it may be entered at full speed."""
    if path.leg.through and flight.back:
        next_leg, *rest = flight.back
        path, flight = replace(path, next_leg=next_leg), replace(flight, back=tuple(rest))
    return replace(flight, path=path), path


def ended(state: State, last: Leg) -> Step:
    """At rest at the end of the backtrack: land there, or plan the rest of the way home."""
    there = last.reaches_target
    if there and begins_at_home(state):
        return state, [], Trigger.END_LAND if state.vehicle.traits.lands else Trigger.HAND_OVER
    left_m = beyond_path_m(state)
    text = f"returning: planning {left_m:.0f} m on to home" if there else "returning another way"
    return home_by_plan(state, text, state.flight.fallen_back or Reason.NO_PLAN)


def stopped(state: State) -> State:
    """At rest, with the current backtrack leg still to be flown."""
    flight = state.flight
    hover = None if flight.stop is None else at_rest_at_end(flight).hover_nea_m
    return replace(state, flight=at_rest(following.requeue_backtrack(flight), hover))


def home_by_plan(state: State, text: str, reason: Reason, *, warning: bool = False) -> Step:
    """Go home by a planned path; where none can be asked for, by the autopilot's own return.

    text, warning: what is said before; reason: why the flight is given up in the second case.
    """
    if is_above_home(state) and state.vehicle.traits.lands:
        return state, [say("returning: above home, landing", "end")], Trigger.END_LAND
    if state.reason is Reason.NO_PLAN and state.flight.refusal in _NO_WAY_OUT:
        return give_up(state, reason)
    place = home_ne_m(state)
    if place is None:
        return preceded([warn("home is not known")], give_up(state, reason))
    why = target_refusal(state.task, place).replace("the target:", "home:")
    if why or state.flight.homeward:
        return preceded([warn(why)] if why else [], give_up(state, reason))
    state = replace(state, targets_ne_m=(place,), orders=Orders()).with_flight(
        way=Way.HOME,
        back=(),
        target=0,
        route_ne_m=(),
        progress=NO_PROGRESS,
        stops=0,
        failures=0,
        planning_backtrack=None,
        search=None,
    )
    return state, [say(text, "end", warning=warning)], Trigger.RESUME
