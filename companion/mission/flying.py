"""What happens in the phase `flying`: follow a leg, scan, plan, go on to the next (design 6)."""

import math
from dataclasses import replace

import numpy as np

from companion.mission.decisions import AT_M, Context, Step, cannot_fly, fault, give_up, is_gone
from companion.mission.events import (
    Command,
    Event,
    Plan,
    PlanLate,
    PlanReady,
    Position,
    Say,
    ScanDone,
    Setpoint,
    StartScan,
    Vector,
)
from companion.mission.state import Flight, Reason, State, Trigger
from companion.planner.procedure import (
    Leg,
    Reference,
    advance,
    allowed_speed_m_s,
    hover_pose,
    is_at_end,
    off_path_m,
)
from companion.planner.request import NotPlanned, Planned, PlanRequest
from companion.world.known_map import proven_range_m

_STUCK_S = 30.0  # the reference point waits no longer for a vehicle that does not follow
_ANSWER_SLACK_S = 60.0
_DEPARTURE = 3.0  # tracking errors off the path
_DEPARTURES = 3
_MOST_STOPS = 12  # on the way to one target, for want of a successor
_SHORT_SIGHTED = 0.8  # of R


def flying(state: State, event: Event, context: Context) -> Step:
    """Follow the leg, or wait for one; stop for whatever makes that unsafe."""
    if is_gone(event):
        return give_up(state, Reason.LINK_LOST)
    reason = cannot_fly(state, event)
    if reason is not None:
        return fault(replace(state, flight=at_rest(state.flight, None)), reason)
    match event:
        case Position():
            return on_position(state, event, context)
        case ScanDone():
            return on_scan(state, event, context)
        case PlanReady():
            return on_plan(state, event, context)
        case PlanLate():
            return on_late_plan(state, event)
        case _:
            return state, [], None


def on_position(state: State, event: Position, context: Context) -> Step:
    """Move the reference point and send it; scan when its time has come."""
    if state.flight.leg is None:
        return _hover(state, event, context)
    flight = _moved_on(state, event, context)
    if state.now_s - flight.progress_at_s > _STUCK_S:
        return give_up(state, Reason.NOT_FOLLOWING)
    leg = flight.leg
    assert leg is not None
    task = context.mission.task
    off_m = off_path_m(flight.reference, leg, np.asarray(event.position_nea_m))
    if task.settings.profile.verified and off_m > _DEPARTURE * task.limits.tracking_error_m:
        return _departed(state)
    commands: list[Command] = [_setpoint(event.time_s, leg, flight.reference, context)]
    if is_at_end(flight.reference, leg):
        if leg.reaches_target:
            return replace(state, flight=flight), commands, Trigger.TARGET_REACHED
        flight = replace(at_rest_at_end(flight), stops=flight.stops + 1)
        if flight.stops > _MOST_STOPS:
            return give_up(replace(state, flight=flight), Reason.NO_PLAN)
        return replace(state, flight=flight, reason=flight.shortfall), commands, Trigger.FAULT
    due = flight.reference.length_m >= leg.scan_at_m(task) and leg.can_be_left(task)
    if due and not flight.tried and not leg.reaches_target:
        flight, scan = _start_scan(flight, leg.subpath.pose(flight.reference.length_m).point_nea_m)
        commands.append(scan)
    return replace(state, flight=flight), commands, None


def _departed(state: State) -> Step:
    """The vehicle is not where the path was checked: hold, and plan from where it is."""
    if state.flight.departures >= _DEPARTURES:
        return give_up(state, Reason.NOT_FOLLOWING)
    flight = replace(at_rest(state.flight, None), departures=state.flight.departures + 1)
    return fault(replace(state, flight=flight), Reason.OFF_PATH)


def on_scan(state: State, event: ScanDone, context: Context) -> Step:
    """Ask for the next subpath on the map that the scan has completed."""
    flight = state.flight
    scanned_from = flight.scanning_from_nea_m
    if scanned_from is None:
        return state, [], None
    flight = replace(flight, scanning_from_nea_m=None)
    if event.asked and not event.answered:
        return _no_successor(replace(state, flight=flight), Reason.RADAR_SILENT)
    task = context.mission.task
    leg = flight.leg
    start = hover_pose(scanned_from)
    if leg is not None:
        start = leg.subpath.pose(leg.successor_at_m(task))
    request = PlanRequest(
        plan_id=flight.plan_id + 1,
        seed=context.seed,
        task=task,
        known=flight.known,
        scan_nea_m=scanned_from,
        start=start,
        from_rest=leg is None,
        target_ne_m=context.mission.targets_ne_m[flight.target],
        route_ne_m=flight.route_ne_m,
        stops=flight.stops,
        attempt=flight.failures,
    )
    flight = replace(flight, plan_id=request.plan_id, planning=True)
    due_s = event.time_s + task.settings.planning_time_s
    says = _scan_warnings(flight, event, context)
    return replace(state, flight=flight), [*says, Plan(request=request, due_s=due_s)], None


def _scan_warnings(flight: Flight, event: ScanDone, context: Context) -> list[Command]:
    """What a person should know of a scan that was worse than the mission expects."""
    says: list[Command] = []
    if event.answered < event.asked:
        text = f"scan: {event.answered} of {event.asked} blocks answered"
        says.append(Say(text=text, warning=True))
    wanted_m = context.mission.task.settings.scan_range_m
    seen_m = proven_range_m(flight.known, event.scan)
    if flight.plan_id == 1 and seen_m < _SHORT_SIGHTED * wanted_m:
        text = f"radar sees {seen_m / 1000:.1f} km of R = {wanted_m / 1000:.1f} km"
        says.append(Say(text=text, warning=True))
    return says


def on_plan(state: State, event: PlanReady, context: Context) -> Step:
    """Take the next subpath, or note why there is none."""
    flight, outcome = state.flight, event.outcome
    if outcome.plan_id != flight.plan_id or not flight.planning:
        return state, [], None  # the answer to a question that is no longer asked
    state = replace(state, flight=replace(flight, planning=False))
    verified = context.mission.task.settings.profile.verified
    if isinstance(outcome, NotPlanned) or (verified and not outcome.certificate.proven):
        return _no_successor(state, Reason.NO_PLAN)
    leg = flight.leg
    late = leg is not None and flight.reference.length_m > leg.successor_at_m(context.mission.task)
    if late:
        return _no_successor(state, Reason.PLAN_LATE)
    flight = _accepted(state.flight, outcome)
    text = f"subpath {flight.legs_flown + (flight.next_leg is not None)}: cost {outcome.cost:.2f}"
    return replace(state, flight=flight), [Say(text=text)], None


def on_late_plan(state: State, event: PlanLate) -> Step:
    """Note it: the leg is flown to its end unless the plan comes before p_prog."""
    if event.plan_id == state.flight.plan_id:
        state = replace(state, flight=replace(state.flight, shortfall=Reason.PLAN_LATE))
    return state, [], None


def at_rest(flight: Flight, hover_nea_m: Vector | None) -> Flight:
    """The flight without a leg: it begins again from where the vehicle stops."""
    return replace(
        flight,
        leg=None,
        next_leg=None,
        reference=Reference(),
        hover_nea_m=hover_nea_m,
        scanning_from_nea_m=None,
        planning=False,
        tried=False,
    )


def at_rest_at_end(flight: Flight) -> Flight:
    """The flight at rest at the end of its leg, or where it hovers already."""
    leg = flight.leg
    if leg is None:
        return at_rest(flight, flight.hover_nea_m)
    return at_rest(flight, leg.subpath.pose(leg.subpath.length_m).point_nea_m)


def hold_setpoint(state: State, time_s: float, context: Context) -> list[Command]:
    """Stay where the flight came to rest: a position and an explicit velocity of zero."""
    here = state.flight.hover_nea_m
    if here is None:
        return []
    target = context.mission.targets_ne_m[state.flight.target]
    yaw = math.atan2(target[1] - here[1], target[0] - here[0])
    still = (0.0, 0.0, 0.0)
    return [Setpoint(time_s=time_s, position_nea_m=here, velocity_nea_m_s=still, yaw_rad=yaw)]


def _hover(state: State, event: Position, context: Context) -> Step:
    """Wait for a leg where the vehicle is, or straight above at the height of the take-off."""
    flight, settings = state.flight, context.mission.task.settings
    if flight.hover_nea_m is None:
        north, east, altitude = event.position_nea_m
        height = max(altitude, context.mission.take_off_amsl_m)
        flight = replace(flight, hover_nea_m=(north, east, height))
    here = flight.hover_nea_m
    assert here is not None
    if math.dist(here[:2], context.mission.targets_ne_m[flight.target]) < AT_M:
        return replace(state, flight=flight), [], Trigger.TARGET_REACHED
    commands: list[Command] = []
    if math.dist(here, event.position_nea_m) > AT_M and not flight.tried:
        flight = replace(flight, progress_at_s=_later(state, event, flight))
    elif not flight.tried:
        flight, scan = _start_scan(replace(flight, progress_at_s=state.now_s), here)
        commands.append(scan)
    state = replace(state, flight=flight)
    waited_s = state.now_s - flight.progress_at_s
    if waited_s > settings.scan_time_s + settings.planning_time_s + _ANSWER_SLACK_S:
        return _no_successor(state, Reason.PLAN_LATE)
    return state, [*hold_setpoint(state, event.time_s, context), *commands], None


def _later(state: State, event: Position, flight: Flight) -> float:
    """When the climb to the hover last went on: now, while the vehicle moves."""
    return state.now_s if abs(event.velocity_nea_m_s[2]) > 0.1 else flight.progress_at_s


def _moved_on(state: State, event: Position, context: Context) -> Flight:
    """The reference point one position later; at p_prog it goes over to the next leg."""
    task, flight = context.mission.task, state.flight
    leg = flight.leg
    assert leg is not None
    reference = advance(
        flight.reference,
        leg,
        state.vehicle.position_step_s,
        np.asarray(event.position_nea_m),
        task.limits,
        goes_on=flight.next_leg is not None,
    )
    if reference.length_m > flight.reference.length_m:
        flight = replace(flight, progress_at_s=state.now_s)
    over = reference.length_m - leg.successor_at_m(task)
    if flight.next_leg is None or over < 0.0:
        return replace(flight, reference=reference)
    return replace(
        flight,
        leg=flight.next_leg,
        next_leg=None,
        reference=replace(reference, length_m=over),
        tried=False,
        shortfall=Reason.NO_PLAN,
        legs_flown=flight.legs_flown + 1,
    )


def _accepted(flight: Flight, planned: Planned) -> Flight:
    leg = Leg.of(planned, flight.legs_flown + 1)
    flight = replace(flight, route_ne_m=() if planned.reaches_target else planned.route_ne_m)
    if flight.leg is not None:
        return replace(flight, next_leg=leg)
    return replace(
        flight,
        leg=leg,
        reference=Reference(),
        tried=False,
        failures=0,
        shortfall=Reason.NO_PLAN,
        legs_flown=flight.legs_flown + 1,
    )


def _no_successor(state: State, reason: Reason) -> Step:
    """A leg in flight is flown to its end; without one the vehicle holds now."""
    flight = replace(state.flight, shortfall=reason)
    if flight.leg is not None:
        return replace(state, flight=flight), [Say(text=reason.text, warning=True)], None
    flight = replace(at_rest(flight, flight.hover_nea_m), failures=flight.failures + 1)
    return replace(state, flight=flight, reason=reason), [], Trigger.FAULT


def _start_scan(flight: Flight, centre_nea_m: Vector) -> tuple[Flight, StartScan]:
    flight = replace(flight, tried=True, scanning_from_nea_m=centre_nea_m)
    return flight, StartScan(centre_nea_m=centre_nea_m)


def _setpoint(time_s: float, leg: Leg, reference: Reference, context: Context) -> Setpoint:
    pose = leg.subpath.pose(reference.length_m)
    speed = min(reference.speed_m_s, allowed_speed_m_s(pose, context.mission.task.limits))
    velocity = speed * pose.tangent_nea
    return Setpoint(
        time_s=time_s,
        position_nea_m=pose.point_nea_m,
        velocity_nea_m_s=(float(velocity[0]), float(velocity[1]), float(velocity[2])),
        yaw_rad=math.atan2(pose.tangent_nea[1], pose.tangent_nea[0]),
    )
