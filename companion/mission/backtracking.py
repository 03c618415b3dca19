"""Backtrack: return along the flown path, each segment proven again (design section 7)."""

from msgspec.structs import replace

from companion.mission import flying, following, joining
from companion.mission.decisions import (
    Context,
    Step,
    cannot_fly,
    fault,
    give_up,
    is_gone,
    preceded,
    waits_for_fence,
)
from companion.mission.events import Event, Plan, PlanReady, Position, StatusText
from companion.mission.home import begins_at_home, beyond_path_m, home_ne_m, is_above_home
from companion.mission.state import (
    Backtracking,
    Flight,
    Orders,
    PlanningBacktrack,
    Reason,
    ReplanHome,
    State,
    Trigger,
)
from companion.planner.procedure import Leg, Reference, hover_pose
from companion.planner.request import Backtrack, PlanRequest, Refusal
from companion.planner.rules import target_refusal

_NO_WAY_OUT = frozenset({Refusal.START_NEAR_TERRAIN, Refusal.START_NEAR_UNKNOWN})
"""From where nothing leads away nothing leads home either: only the autopilot climbs out."""


def request_backtrack(state: State, context: Context) -> Step:
    """Request the proof of the backtrack; it takes effect as soon as it is ready."""
    planning = PlanningBacktrack(state.task, since_s=state.now_s)
    flight = replace(state.flight, plan_id=state.flight.plan_id + 1, planning_backtrack=planning)
    here = state.vehicle.position_nea_m
    if here is None:
        return give_up(state, state.reason or Reason.POSITION_STALE)
    request = PlanRequest(
        plan_id=flight.plan_id,
        seed=context.seed,
        task=state.task,
        known=flight.known,
        scan_nea_m=here,
        start=hover_pose(here),
        from_rest=True,
        target_ne_m=here[:2],
        flown=flight.flown,
    )
    return replace(state, flight=flight), [Plan(request=request, due_s=state.now_s)], None


def on_backtrack_plan(state: State, event: PlanReady) -> Backtracking | None:
    """The requested backtrack; None if there is none."""
    outcome = event.outcome
    if not isinstance(outcome, Backtrack) or not outcome.subpaths:
        return None
    last = len(outcome.subpaths) - 1
    speeds_m_s = outcome.speeds_m_s or (None,) * len(outcome.subpaths)
    legs = tuple(
        Leg(
            number=number + 1,
            plan_id=outcome.plan_id,
            subpath=subpath,
            reaches_target=number == last and outcome.reaches_start,
            through=through,
            rules=state.task,
            speed_m_s=speed_m_s,
        )
        for number, (subpath, through, speed_m_s) in enumerate(
            zip(outcome.subpaths, outcome.through, speeds_m_s, strict=True)
        )
    )
    return Backtracking(legs)


def start_backtrack(state: State) -> Flight | None:
    """Begin the first remaining leg of the backtrack; None if it is too far off."""
    flight = state.flight
    here = state.vehicle.position_nea_m
    if not flight.back or here is None:
        return None
    leg, *rest = flight.back
    flight = replace(flight, leg=leg, next_leg=None, hover_nea_m=None, stop=None)
    joined = joining.joined(replace(state, flight=flight))
    if joined is None:
        return None
    at_rest = Reference(length_m=joined.reference.length_m)
    joined = replace(joined, way=Backtracking(tuple(rest)), reference=at_rest)
    return _with_next(joined)


def _with_next(flight: Flight) -> Flight:
    """The flight with the next backtrack leg ready, if it may be entered at full speed."""
    if flight.leg is None or not flight.leg.through or not flight.back:
        return flight
    following_leg, *rest = flight.back
    return replace(flight, next_leg=following_leg, way=Backtracking(tuple(rest)))


def replan_home(state: State) -> State | None:
    """Plan a path home, which becomes the only target; None if that cannot be one."""
    place = home_ne_m(state)
    if place is None or target_refusal(state.task, place):
        return None
    flight = replace(
        state.flight,
        way=ReplanHome(),
        target=0,
        route_ne_m=(),
        stops=0,
        failures=0,
        planning_backtrack=None,
        search=None,
    )
    return replace(state, targets_ne_m=(place,), flight=flight, orders=Orders())


def home_by_plan(state: State, text: str, reason: Reason, *, warning: bool = False) -> Step:
    """Go home by a planned path; where none can be asked for, by the autopilot's own return.

    text, warning: what is said before; reason: why the flight is given up in the second case.
    """
    if is_above_home(state) and state.vehicle.traits.lands:
        says = StatusText(text="returning: above home, landing", about="end")
        return state, [says], Trigger.END_LAND
    stuck = state.reason is Reason.NO_PLAN and state.flight.refusal in _NO_WAY_OUT
    planned = None if state.flight.homeward or stuck else replan_home(state)
    if planned is not None:
        return planned, [StatusText(text=text, warning=warning, about="end")], Trigger.RESUME
    place, why = home_ne_m(state), "" if stuck else "home is not known"
    if place is not None and not stuck:
        why = target_refusal(state.task, place).replace("the target:", "home:")
    return preceded([StatusText(text=why, warning=True)] if why else [], give_up(state, reason))


def returning(state: State, event: Event, context: Context) -> Step:
    """Follow the backtrack leg by leg; stop if that becomes unsafe."""
    if is_gone(state, event, context):
        return give_up(state, Reason.LINK_LOST)
    reason = cannot_fly(state, event)
    if reason is not None:
        return fault(_stopped(state), reason)
    if not isinstance(event, Position):
        return state, [], None
    state, warning = flying.battery_warning(state, context)
    return preceded(warning, _on_position(state, event, context))


def _on_position(state: State, event: Position, context: Context) -> Step:
    if state.flight.stop is None and waits_for_fence(state, context):
        state, commands, trigger = following.stop(state, Reason.FENCE_UNREAD)
        if trigger is not None:
            return state, commands, trigger
    if state.flight.circling and following.still_loiters(state, event):
        return flying.circle(state, event, context)
    flight = following.advance_reference(state, event)
    if flight.leg is not state.flight.leg:  # through the join, onto what was the next stretch
        flight = _with_next(flight)
    if state.now_s - flight.progress_at_s > flying.STUCK_S:
        return give_up(state, Reason.NOT_FOLLOWING)
    flight, says, departs = flying.kept_to_path(state, flight, event)
    if departs is not None:
        return flying.on_departure(state, _stopped(state).flight, departs)
    flight, commands = following.setpoint(state, flight, event, context)
    commands = [*says, *commands]
    state = replace(state, flight=flight)
    if not following.is_stopped(state, flight):
        return state, commands, None
    if (stop := flight.stop) is not None:
        return replace(_stopped(state), reason=stop.reason), commands, Trigger.FAULT
    if flight.back and flight.leg is not None:
        went_on = start_backtrack(state)
        if went_on is None:
            return preceded(commands, flying.on_departure(state, _stopped(state).flight))
        return replace(state, flight=went_on), commands, None
    there = flight.leg is not None and flight.leg.reaches_target
    state = replace(state, flight=following.at_rest_at_end(flight))
    if not there or not begins_at_home(state):  # from here home is planned to
        reason = flight.fallen_back or Reason.NO_PLAN
        left_m = beyond_path_m(state)
        text = (
            f"returning: planning {left_m:.0f} m on to home" if there else "returning another way"
        )
        return preceded(commands, home_by_plan(state, text, reason))
    lands = state.vehicle.traits.lands
    return state, commands, Trigger.END_LAND if lands else Trigger.HAND_OVER


def _stopped(state: State) -> State:
    """At rest, with the current backtrack leg still to be flown."""
    flight = state.flight
    hover = None if flight.stop is None else following.at_rest_at_end(flight).hover_nea_m
    return replace(state, flight=following.at_rest(following.requeue_backtrack(flight), hover))
