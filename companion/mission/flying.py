"""The phases on a path, flying and returning (design 6 and 7).

Out: follow a leg, scan, plan, go on to the next.  Back: along the flown path (`way_back`).
"""

import math

import numpy as np
from msgspec.structs import replace

from companion.mission import events, following, way_back
from companion.mission.battery import battery_runs_low, battery_warning, given_up_for_battery
from companion.mission.decisions import (
    AT_M,
    Context,
    Step,
    fault,
    give_up,
    in_words,
    is_silent,
    preceded,
    waits_for_fence,
)
from companion.mission.events import Command, Event, Mode, PlanReady, Position, Vector, say, warn
from companion.mission.following import at_rest, at_rest_at_end, hold_setpoint
from companion.mission.state import (
    Answered,
    Flight,
    OnPath,
    Planning,
    Reason,
    Scanning,
    State,
    Trigger,
    Way,
)
from companion.planner.procedure import Leg, hover_pose, is_on_circle
from companion.planner.progress import NO_PROGRESS
from companion.planner.request import NotPlanned, Planned, PlanRequest
from companion.planner.settings import Task
from companion.world.columns import distance_to_terrain_m
from companion.world.known_map import proven_range_m
from companion.world.zones import nearest

_STUCK_S = 30.0  # the reference point waits no longer for a vehicle that does not follow
_ANSWER_SLACK_S = 60.0
_DEPARTURES, _DEPARTURES_NEAR = 3, 10  # the latter where a tracking error is a few decimetres
_LEVEL_M_S = 1.0
_TURNS = 3.0
_CIRCLE_SLACK_M = 0.5  # a leg may end where its circle just keeps the clearance
_SHORT_SIGHTED = 0.8  # of R
_MORE_SCANS = 2  # from rest, if the radar has left something out


def flying(state: State, event: Event, context: Context) -> Step:
    """Follow the leg, or hold while there is none."""
    if not isinstance(event, Position):
        return on_answer(state, event, context)
    if state.flight.path is None and (step := circling_near_zone(state)) is not None:
        return step
    is_short = state.vehicle.battery_short_at_s is not None  # perhaps: it has to last a while
    if is_short and battery_runs_low(state):
        state, commands, trigger = following.stop(given_up_for_battery(state), Reason.BATTERY_LOW)
        if trigger is not None:
            return state, commands, trigger
    if state.fence_unread_s is not None:
        state, trigger = _stop_for_fence(state, context)
        if trigger is not None:
            return state, [], trigger
    state, warning = battery_warning(state, context.mission)
    fly = _hover if state.flight.path is None else _lead
    step = fly(state, event, context)
    return preceded(warning, step) if warning else step


def on_answer(state: State, event: Event, context: Context) -> Step:
    """What radar and planner have found."""
    match event:
        case events.ScanDone():
            return _on_scan(state, event, context)
        case PlanReady():
            return _on_plan(state, event)
        case events.PlanLate(plan_id=plan_id) if plan_id == state.flight.plan_id:
            # the leg is flown to its end unless the plan comes before p_prog
            return state.with_flight(shortfall=Reason.PLAN_LATE), [], None
        case _:
            return state, [], None


def returning(state: State, event: Event, context: Context) -> Step:
    """Follow the backtrack leg by leg."""
    if not isinstance(event, Position):
        return state, [], None
    state, warning = battery_warning(state, context.mission)
    state, trigger = _stop_for_fence(state, context)
    return preceded(warning, (state, [], trigger) if trigger else _lead(state, event, context))


def _stop_for_fence(state: State, context: Context) -> tuple[State, Trigger | None]:
    """Stop on the path if a changed fence is not known for too long."""
    stops = state.fence_unread_s is None or state.flight.stop is not None
    if stops or not waits_for_fence(state, context):
        return state, None
    state, _, trigger = following.stop(state, Reason.FENCE_UNREAD)
    return state, trigger


def circling_near_zone(state: State) -> Step | None:
    """What is said of a plane's circle, once where it waits for a leg; None: left to the phase."""
    flight, hover, vehicle = state.flight, state.flight.hover_nea_m, state.vehicle
    if vehicle.traits.hovers or flight.path is not None or hover is None:
        return None
    task, place = flight.loiter_checked or (None, None)
    led = vehicle.mode is Mode.GUIDED and vehicle.distrust is None and not is_silent(state)
    if (task is state.task and place == hover) or not led:
        return None
    zone, gap_m = nearest(state.task.zones, hover[0], hover[1])
    near = zone is not None and gap_m < state.task.zone_clearance_m - _CIRCLE_SLACK_M
    says = [warn(f"circling too near to zone {zone.name}")] if zone is not None and near else []
    return state.with_flight(loiter_checked=(state.task, hover)), [*says], None


def _lead(state: State, event: Position, context: Context) -> Step:
    """Advance the reference point and send it; on the way out scan at p_scan."""
    path = state.flight.path
    assert path is not None
    if path.circling and following.still_loiters(state, path, event):
        return _circle(state, event, context)
    leg, returns = path.leg, state.flight.way is Way.BACK
    flight = following.advance_reference(state, path, event)
    path = flight.path
    assert path is not None
    if returns and path.leg is not leg:  # onto what was the next stretch
        flight, path = way_back.with_next(flight, path)
    if state.now_s - flight.progress_at_s > _STUCK_S:
        return give_up(state, Reason.NOT_FOLLOWING)
    says: list[Command] = []
    if path.outside_m or not following.is_on_path(state, flight, path, event):
        flight, says, departs = _kept_to_path(state, flight, event)
        if departs is not None:
            if returns:
                return on_departure(state, way_back.stopped(state).flight, departs)
            return on_departure(replace(state, flight=flight), at_rest(flight, None), departs)
        path = flight.path
        assert path is not None
    flight, commands = following.setpoint(state, flight, path, event, context)
    commands, state = [*says, *commands], replace(state, flight=flight)
    stops = path.next_leg is None or path.stop is not None
    if stops and following.is_stopped(state, path):
        return preceded(commands, _end_of_way(state, path) if returns else _at_its_end(state, path))
    at_m, task = path.reference.length_m, state.task
    speed = 0.0 if state.vehicle.traits.hovers else math.hypot(*event.velocity_nea_m_s[:2])
    looks = flight.search is None and path.stop is None and not returns
    if looks and path.leg.wants_successor(at_m, task, speed):
        flight, scan = start_scan(flight, path.leg.subpath.pose(at_m).point_nea_m)
        return replace(state, flight=flight), [*commands, *scan], None
    return state, commands, None


def _kept_to_path(
    state: State, flight: Flight, event: Position
) -> tuple[Flight, list[Command], Reason | None]:
    """Look whether the vehicle is on its path and follows; a reason: the leg cannot go on."""
    if following.is_not_taken(state):
        return flight, [], Reason.NOT_TAKEN
    flight, departs = following.left_path(state, flight, event)
    path, before = flight.path, state.flight.path
    assert path is not None
    if departs is not None or not path.outside_m or (before is not None and before.outside_m):
        return flight, [], departs
    text = f"beside its path, {path.outside_m:.2g} m more than its tracking error"
    return flight, [say(text, "path", warning=path.stop is not None)], None


def _circle(state: State, event: Position, context: Context) -> Step:
    """Stay on the circle until its tangent points along the path, once in each turn."""
    limits = state.task.limits
    turn_s = 2.0 * math.pi * limits.loiter_radius_m / limits.speed_m_s
    if state.now_s - state.flight.progress_at_s > _TURNS * turn_s + _STUCK_S:
        return give_up(state, Reason.NOT_FOLLOWING)
    flight, stay = hold_setpoint(state, event.time_s, context)
    return replace(state, flight=flight), stay, None


def _at_its_end(state: State, path: OnPath) -> Step:
    """At rest at the end of the leg, or at the stop before it."""
    flight, stop = state.flight, path.stop
    if stop is None and path.leg.reaches_target:
        return state, [], Trigger.TARGET_REACHED
    reason = flight.shortfall if stop is None else stop.reason
    counts = stop is None or reason is Reason.BESIDE_PATH
    flight = replace(at_rest_at_end(flight), stops=flight.stops + counts)
    return fault(replace(state, flight=flight), reason)


def _end_of_way(state: State, path: OnPath) -> Step:
    """At the end of a stretch of the way back, or at a stop before it."""
    if path.stop is not None:
        return fault(way_back.stopped(state), path.stop.reason)
    if state.flight.back:
        went_on = way_back.begun(state)
        if went_on is None:
            return on_departure(state, way_back.stopped(state).flight)
        return replace(state, flight=went_on), [], None
    return way_back.ended(replace(state, flight=at_rest_at_end(state.flight)), path.leg)


def on_departure(state: State, stopped: Flight, reason: Reason = Reason.OFF_PATH) -> Step:
    """The vehicle is off the proven path: hold, and replan from there, a limited number of times.

    stopped: its flight at rest.
    """
    departures, is_near = state.flight.departures, state.task.settings.is_near
    if departures >= (_DEPARTURES_NEAR if is_near else _DEPARTURES):
        return give_up(state, Reason.NOT_FOLLOWING if reason is Reason.OFF_PATH else reason)
    return fault(replace(state, flight=replace(stopped, departures=departures + 1)), reason)


# --- scans and plans


def _on_scan(state: State, event: events.ScanDone, context: Context) -> Step:
    """Ask for the next subpath on the map that the scan has completed."""
    flight, scanning = state.flight, state.flight.search
    if not isinstance(scanning, Scanning):
        return state, [], None
    scanned_from = scanning.from_nea_m
    says = _scan_warnings(state, event)
    path = flight.path
    at_rest_here = path is None and not context.shadow
    if at_rest_here and event.is_partial and scanning.again < _MORE_SCANS:
        flight = replace(flight, progress_at_s=state.now_s)
        flight, scan = start_scan(flight, scanned_from, scanning.again + 1)
        return replace(state, flight=flight), [*says, *scan], None
    flight = replace(flight, search=Answered())
    if event.asked and not event.answered and not scanning.again:
        if context.mission.near is not None:
            return _no_successor(replace(state, flight=flight), Reason.SENSOR_SILENT)
        if path is not None or not flight.failures:
            return _no_successor(replace(state, flight=flight), Reason.RADAR_SILENT)
        flight = replace(flight, shortfall=Reason.RADAR_SILENT)  # on what is known already
    elif flight.shortfall is Reason.RADAR_SILENT:
        flight = replace(flight, shortfall=Reason.NO_PLAN)  # it answers again
    task, start, rest = state.task, hover_pose(scanned_from), None
    if path is not None:
        start, rest = path.leg.subpath.pose(path.leg.successor_at_m(task)), path.leg.rest(task)
    request = PlanRequest(
        plan_id=flight.plan_id + 1,
        seed=context.seed,
        task=task_ahead(state, context),
        known=flight.known,
        scan_nea_m=scanned_from,
        start=start,
        from_rest=path is None,
        target_ne_m=state.targets_ne_m[flight.target],
        progress=flight.progress,
        rest=rest,
        attempt=flight.failures,
    )
    flight = replace(flight, plan_id=request.plan_id, search=Planning(task))
    plan = events.Plan(request=request, due_s=event.time_s + request.time_s)
    return replace(state, flight=flight), [*says, plan], None


def _scan_warnings(state: State, event: events.ScanDone) -> list[Command]:
    """Warnings about a scan that was worse than the mission expects."""
    says: list[Command] = []
    if event.answered < event.asked:
        says.append(warn(f"scan: {event.answered} of {event.asked} blocks answered", "scan"))
    wanted_m = state.task.settings.scan_range_m
    seen_m = proven_range_m(state.flight.known, event.scan)
    is_first = event.scan.range_m > 0.0 and event.asked and state.flight.plan_id == 0
    if is_first and seen_m < _SHORT_SIGHTED * wanted_m:
        says.append(warn(f"radar sees {seen_m / 1000:.1f} km of R = {wanted_m / 1000:.1f} km"))
    return says


def _on_plan(state: State, event: PlanReady) -> Step:
    """Accept the next subpath, or note why there is none."""
    flight, outcome, planning = state.flight, event.outcome, state.flight.search
    if outcome.plan_id != flight.plan_id or not isinstance(planning, Planning):
        return state, [], None  # the answer to a question that is no longer asked
    if planning.rules is not state.task:  # the rules have changed: it is asked for again
        return state.with_flight(search=None), [], None
    state = state.with_flight(search=Answered())
    verified = state.task.settings.profile.verified
    if not isinstance(outcome, Planned) or (verified and not outcome.certificate.proven):
        says: list[Command] = []
        state = state.with_flight(refusal=None)
        if isinstance(outcome, NotPlanned):
            state = state.with_flight(refusal=outcome.refusal, broken=outcome.broken)
            says = _closed(outcome) if outcome.refusal is not flight.refusal else []
        silent = flight.shortfall is Reason.RADAR_SILENT
        return preceded(
            says, _no_successor(state, Reason.RADAR_SILENT if silent else Reason.NO_PLAN)
        )
    if (path := flight.path) is not None:
        soonest_m = path.reference.length_m + following.lead_m(state, path.reference)
        if soonest_m > path.leg.successor_at_m(state.task):
            return _no_successor(state, Reason.PLAN_LATE)
        if path.stop is not None:
            return state, [], None  # it was asked for a way that the vehicle no longer goes
    flight = _accepted(state, outcome)
    number = flight.legs_flown + (path is not None)
    margin_m = min(outcome.certificate.clearance_m, outcome.certificate.keep_out_m)
    text = f"subpath {number}: {margin_m:.0f} m clear, cost {outcome.cost:.2f}"
    return replace(state, flight=flight), [say(text, "plan")], None


def _closed(outcome: NotPlanned) -> list[Command]:
    """A text if it is proven that the target cannot be reached."""
    if outcome.place_ne_m is None:
        return []
    north, east = (each / 1000.0 for each in outcome.place_ne_m)
    return [warn(f"no way: closed {north:.1f} km N, {east:.1f} km E of origin")]


def _hover(state: State, event: Position, context: Context) -> Step:
    """Hold while waiting for a leg: here, or straight above at the take-off height."""
    flight, settings = state.flight, state.task.settings
    here = flight.hover_nea_m or _waiting_place(state, event, context)
    if (task := task_ahead(state, context)) is not state.task:  # no lower than the next leg begins
        here = here[0], here[1], max(here[2], task.band_amsl_m[0])
    flight = replace(flight, hover_nea_m=here)
    target = state.targets_ne_m[flight.target]
    if math.dist(here[:2], target) < AT_M and not flight.returning:
        return replace(state, flight=flight), [], Trigger.TARGET_REACHED
    commands: list[Command] = []
    if flight.search is None and not _is_there(state, event, here):
        if abs(event.velocity_nea_m_s[2]) > 0.1:  # on its way up or down
            flight = replace(flight, progress_at_s=state.now_s)
    elif flight.search is None:
        flight, commands = start_scan(replace(flight, progress_at_s=state.now_s), here)
    flight, stay = hold_setpoint(replace(state, flight=flight), event.time_s, context)
    state = replace(state, flight=flight)
    waited_s = state.now_s - flight.progress_at_s
    if waited_s > settings.scan_time_s + settings.planning_time_s + _ANSWER_SLACK_S:
        return _no_successor(state, Reason.PLAN_LATE)
    return state, [*stay, *commands], None


def _waiting_place(state: State, event: Position, context: Context) -> Vector:
    """Where to wait for a leg: here, within the altitude band if the descent is clear."""
    north, east, altitude = event.position_nea_m
    lowest_m = task_ahead(state, context).take_off_amsl_m
    height_m = max(min(altitude, state.task.band_amsl_m[1]), lowest_m)
    required_m = state.task.required_clearance_m
    down = np.array([north, east, height_m])
    if height_m < altitude:
        clear_m = distance_to_terrain_m(state.flight.known, down, required_m)
        height_m = altitude if clear_m < required_m else height_m
    return north, east, height_m


def task_ahead(state: State, context: Context) -> Task:
    """The task on the way to the target: no lower than the mission's altitude for it."""
    mission, flight = context.mission, state.flight
    if not flight.homeward and state.targets_ne_m == mission.targets_ne_m:
        return mission.task_to(flight.target, state.task)
    return state.task


def _is_there(state: State, event: Position, here: Vector) -> bool:
    """Whether the vehicle holds at the commanded place, or loiters there.

    No leg is planned for a plane that has not reached its circle yet, nor for a copter that is not
    within the tube that the leg begins with.
    """
    if state.vehicle.traits.hovers:
        return math.dist(here, event.position_nea_m) <= min(AT_M, state.task.envelope.tube_m)
    error_m = max(AT_M, state.task.limits.tracking_error_m)
    level = abs(event.velocity_nea_m_s[2]) < _LEVEL_M_S
    near = is_on_circle(here, event.position_nea_m, state.task.limits)
    return near and level and abs(here[2] - event.position_nea_m[2]) <= error_m


def _accepted(state: State, planned: Planned) -> Flight:
    flight, hovers = state.flight, state.vehicle.traits.hovers
    leg = Leg.of(planned, flight.legs_flown + 1, state.task)
    flight = replace(
        flight,
        route_ne_m=() if planned.reaches_target else planned.route_ne_m or flight.route_ne_m,
        progress=NO_PROGRESS if planned.reaches_target else planned.progress,
        refusal=flight.refusal if flight.homeward else None,  # why it goes home
    )
    if flight.path is not None:
        return replace(flight, path=replace(flight.path, next_leg=leg))
    blind = flight.shortfall is Reason.RADAR_SILENT and not flight.homeward
    return replace(
        flight,
        path=OnPath(leg=leg, circling=not hovers and not planned.is_escape),  # then at once
        search=None,
        failures=flight.failures if blind else 0,  # about what is known it could fly for ever
        shortfall=Reason.NO_PLAN,
        legs_flown=flight.legs_flown + 1,
    )


def _no_successor(state: State, reason: Reason) -> Step:
    """Without a successor a leg is flown to its end; without a leg the vehicle holds now."""
    flight = replace(state.flight, shortfall=reason)
    if flight.path is not None:
        state = replace(state, flight=flight)
        return state, [warn(in_words(state, reason))], None
    flight = replace(at_rest(flight, flight.hover_nea_m), failures=flight.failures + 1)
    return fault(replace(state, flight=flight), reason)


def start_scan(
    flight: Flight, centre_nea_m: Vector, again: int = 0
) -> tuple[Flight, list[Command]]:
    """Start a scan around a point."""
    flight = replace(flight, search=Scanning(centre_nea_m, again))
    return flight, [events.StartScan(centre_nea_m=centre_nea_m)]
