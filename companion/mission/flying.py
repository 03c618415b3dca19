"""The phases on a path: flying and returning (design 6 and 7), and shadow.

Out: follow a leg, scan, plan, go on to the next.  Back: along the flown path (`way_back`).
"""

import math
from dataclasses import replace

import numpy as np

from companion.mission import events, following, phases, way_back
from companion.mission.battery import gives_up_for_battery, warn_of_battery
from companion.mission.decisions import AT_M, Context, Turn, in_words, waits_for_fence
from companion.mission.events import Battery, Event, Landed, Mode, Position, Vector
from companion.mission.following import come_to_rest, rest_at_end, send_hold
from companion.mission.health import TRUST_S
from companion.mission.phases import OnPath, Phase, Reason, Trigger
from companion.mission.state import State, Way
from companion.planner.procedure import Leg, Reference, hover_pose, is_on_circle, may_leave
from companion.planner.progress import NO_PROGRESS
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal
from companion.planner.settings import Task
from companion.world.columns import distance_to_terrain_m
from companion.world.known_map import proven_range_m
from companion.world.zones import Zone, nearest

_STUCK_S = 30.0  # the reference point waits no longer for a vehicle that does not follow
_ANSWER_SLACK_S = 60.0
_DEPARTURES, _DEPARTURES_NEAR = 3, 10  # the latter where a tracking error is a few decimetres
_LEVEL_M_S = 1.0
_TURNS = 3.0
_CIRCLE_SLACK_M = 0.5  # a leg may end where its circle just keeps the clearance
_SHORT_SIGHTED = 0.8  # of R
_SAY_AGAIN_S = 10.0  # in shadow: scan again, until there is a leg
_ARRIVED_M = 30.0
_MORE_SCANS = 2  # from rest, if the radar has left something out


def on_path(state: State, stage: phases.Led, event: Event, turn: Turn) -> None:
    """phases.Flying and returning: follow the leg and scan at p_scan; hold while there is none."""
    if not isinstance(event, Position):
        if isinstance(event, Battery) and state.vehicle.battery_short_at_s is None:
            warn_of_battery(state, turn)
        elif isinstance(stage, phases.Flying):
            on_answer(state, stage, event, turn)
        return
    if stage.path is None and looks_at_circle(state, turn):
        return
    if state.vehicle.battery_short_at_s is not None or state.fence_unread_s is not None:
        _stop_for_others(state, stage, turn)
    if turn.trigger is not None:
        return
    if (path := stage.path) is None:
        assert isinstance(stage, phases.Flying)  # what returns has a path
        return _hover(state, stage, event, turn)
    leg, hovers, velocity = path.leg, state.vehicle.traits.hovers, event.velocity_nea_m_s
    at_m = path.reference.length_m
    if path.circling and not may_leave(leg, at_m, event.position_nea_m, velocity):
        return _circle(state, stage, event, turn)
    returns = state.flight.way is Way.BACK
    following.advance_reference(state, stage, path, event)
    if returns and path.leg is not leg:  # onto what was the next stretch
        way_back.take_next(state, path)
    if state.now_s - stage.progress_at_s > _STUCK_S:
        return turn.give_up(Reason.NOT_FOLLOWING)
    departs = following.departs(state, stage, path, event, turn)
    if departs is not None:
        return _depart(state, departs, turn)
    following.send_setpoint(state, path, event, turn)
    stops = path.next_leg is None or path.stop is not None
    if stops and following.is_stopped(state, path):
        ends = _end_of_way if returns else _at_its_end
        return ends(state, stage, path, turn)
    speed = 0.0 if hovers else math.hypot(*velocity[:2])
    if path.stop is not None or returns or not isinstance(stage, phases.Flying):
        return
    if stage.search is None and path.leg.wants_successor(path.reference, speed):
        at_m = path.reference.length_m
        start_scan(stage, path.leg.subpath.pose(at_m).point_nea_m, turn)


def _stop_for_others(state: State, stage: phases.Led, turn: Turn) -> None:
    """Stop for a battery that may not last, or a changed fence that is not known yet."""
    if state.vehicle.battery_short_at_s is not None:  # perhaps: it has to last a while
        if stage.phase is Phase.FLYING and gives_up_for_battery(state):
            following.stop(state, Reason.BATTERY_LOW, turn)
        warn_of_battery(state, turn)
    stops = stage.path is not None and stage.path.stop is not None
    if not stops and turn.trigger is None and waits_for_fence(state, turn.context):
        following.stop(state, Reason.FENCE_UNREAD, turn)


def on_answer(state: State, stage: phases.Flying, event: Event, turn: Turn) -> None:
    """What radar and planner have found."""
    match event:
        case events.ScanDone():
            return _on_scan(state, stage, event, turn)
        case events.PlanReady():
            return _on_plan(state, stage, event, turn)
        case events.PlanLate(plan_id=plan_id) if plan_id == state.flight.plan_id:
            # the leg is flown to its end unless the plan comes before p_prog
            stage.shortfall = Reason.PLAN_LATE
        case _:
            pass


def looks_at_circle(state: State, turn: Turn) -> bool:
    """Look at a plane's circle, once where it waits for a leg; False: this is not the time."""
    flight, hover, vehicle = state.flight, state.flight.hover_nea_m, state.vehicle
    if vehicle.traits.hovers or state.path is not None or hover is None:
        return False
    task, place = flight.loiter_checked or (None, None)
    led = vehicle.mode is Mode.GUIDED and vehicle.distrust is None and not state.is_silent
    if (task is state.task and place == hover) or not led:
        return False
    if (zone := zone_beside(state.task, hover)) is not None:
        turn.warn(f"circling too near to zone {zone.name}")
    flight.loiter_checked = state.task, hover
    return True


def zone_beside(task: Task, place: Vector) -> Zone | None:
    """The zone that a circle about this place comes too near to."""
    zone, gap_m = nearest(task.zones, place[0], place[1])
    return zone if gap_m < task.zone_clearance_m - _CIRCLE_SLACK_M else None


def _circle(state: State, stage: phases.Led, event: Position, turn: Turn) -> None:
    """Stay on the circle until its tangent points along the path, once in each turn."""
    limits = state.task.limits
    turn_s = 2.0 * math.pi * limits.loiter_radius_m / limits.speed_m_s
    if state.now_s - stage.progress_at_s > _TURNS * turn_s + _STUCK_S:
        return turn.give_up(Reason.NOT_FOLLOWING)
    send_hold(state, event.time_s, turn)


def _at_its_end(state: State, stage: phases.Led, path: OnPath, turn: Turn) -> None:
    """At rest at the end of the leg, or at the stop before it."""
    flight, stop = state.flight, path.stop
    if stop is None and path.leg.reaches_target:
        rest_at_end(state)
        return turn.to(Trigger.TARGET_REACHED)
    shortfall = stage.shortfall if isinstance(stage, phases.Flying) else Reason.NO_PLAN
    reason = shortfall if stop is None else stop.reason
    flight.stops += stop is None or reason in (Reason.BESIDE_PATH, Reason.NO_PLAN)
    rest_at_end(state)
    return turn.fault(reason)


def _end_of_way(state: State, stage: phases.Led, path: OnPath, turn: Turn) -> None:
    """At the end of a stretch of the way back, or at a stop before it."""
    if path.stop is not None:
        way_back.leave_path(state)
        return turn.fault(path.stop.reason)
    if not state.flight.back:
        rest_at_end(state)
        return way_back.ended(state, path.leg, turn)
    went_on = way_back.begun(state)
    if went_on is None:
        return _depart(state, Reason.OFF_PATH, turn)
    stage.path, stage.progress_at_s = went_on, state.now_s


def _depart(state: State, reason: Reason, turn: Turn) -> None:
    """The vehicle is off the proven path: hold, and plan anew, a limited number of times."""
    flight, is_near = state.flight, state.task.settings.is_near
    if flight.departures >= (_DEPARTURES_NEAR if is_near else _DEPARTURES):
        return turn.give_up(Reason.NOT_FOLLOWING if reason is Reason.OFF_PATH else reason)
    flight.departures += 1
    way_back.leave_path(state)
    turn.fault(reason)


# --- scans and plans


def _on_scan(state: State, stage: phases.Flying, event: events.ScanDone, turn: Turn) -> None:
    """Ask for the next subpath on the map that the scan has completed."""
    flight, scanning, context = state.flight, stage.search, turn.context
    if not isinstance(scanning, phases.Scanning):
        return
    path = stage.path
    at_rest_here = path is None and not context.shadow
    if at_rest_here and event.is_partial and scanning.again < _MORE_SCANS:
        _warn_of_scan(state, event, turn)
        stage.progress_at_s = state.now_s
        start_scan(stage, scanning.from_nea_m, turn, scanning.again + 1)
        return
    stage.search = phases.Answered()
    if event.asked and not event.answered and not scanning.again:
        if context.mission.near is not None:
            return _no_successor(state, stage, Reason.SENSOR_SILENT, turn)
        if path is not None or not flight.failures:
            return _no_successor(state, stage, Reason.RADAR_SILENT, turn)
        stage.shortfall = Reason.RADAR_SILENT  # on what is known already
    elif stage.shortfall is Reason.RADAR_SILENT:
        stage.shortfall = Reason.NO_PLAN  # it answers again
    _warn_of_scan(state, event, turn)
    task, start, rest = state.task, hover_pose(scanning.from_nea_m), None
    if path is not None:
        p_prog = path.leg.leaves(path.reference)
        if p_prog != path.leg.leaving:
            path.leg = replace(path.leg, p_prog=p_prog)
        start, rest = path.leg.subpath.pose(p_prog.length_m), path.leg.rest
    flight.plan_id += 1
    request = PlanRequest(
        plan_id=flight.plan_id,
        seed=context.seed,
        task=task_ahead(state, context),
        known=flight.known,
        scan_nea_m=scanning.from_nea_m,
        start=start,
        from_rest=path is None,
        target_ne_m=state.targets_ne_m[flight.target],
        progress=flight.progress,
        rest=rest,
        attempt=flight.failures,
    )
    stage.search = phases.Planning(task)
    turn.do(events.Plan(request=request, due_s=event.time_s + request.time_s))


def _warn_of_scan(state: State, event: events.ScanDone, turn: Turn) -> None:
    """Warn of a scan that was worse than the mission expects."""
    if event.answered < event.asked:
        turn.warn(f"scan: {event.answered} of {event.asked} blocks answered", "scan")
    wanted_m = state.task.settings.scan_range_m
    seen_m = proven_range_m(state.flight.known, event.scan)
    is_first = event.scan.range_m > 0.0 and event.asked and state.flight.plan_id == 0
    if is_first and seen_m < _SHORT_SIGHTED * wanted_m:
        turn.warn(f"radar sees {seen_m / 1000:.1f} km of R = {wanted_m / 1000:.1f} km")


def _on_plan(state: State, stage: phases.Flying, event: events.PlanReady, turn: Turn) -> None:
    """Accept the next subpath, or note why there is none."""
    flight, outcome, planning = state.flight, event.outcome, stage.search
    if outcome.plan_id != flight.plan_id or not isinstance(planning, phases.Planning):
        return None  # the answer to a question that is no longer asked
    if planning.rules is not state.task:  # the rules have changed: it is asked for again
        stage.search = None
        return
    stage.search = phases.Answered()
    verified = state.task.settings.profile.verified
    if not isinstance(outcome, Planned) or (verified and not outcome.certificate.proven):
        was, flight.refusal = flight.refusal, None
        if isinstance(outcome, NotPlanned):
            flight.refusal, flight.broken = outcome.refusal, outcome.broken
            if outcome.refusal is not was and outcome.place_ne_m is not None:  # proven, and news
                north, east = (along_m / 1000.0 for along_m in outcome.place_ne_m)
                turn.warn(f"no way: closed {north:.1f} km N, {east:.1f} km E of origin")
            is_led = stage.path is not None and not turn.context.shadow
            if is_led and outcome.refusal is Refusal.BETTER_TO_TURN:
                return following.stop(state, Reason.NO_PLAN, turn)
        silent = stage.shortfall is Reason.RADAR_SILENT
        return _no_successor(state, stage, Reason.RADAR_SILENT if silent else Reason.NO_PLAN, turn)
    if (path := stage.path) is not None:
        soonest_m = path.reference.length_m + following.lead_m(state)
        if soonest_m > path.leg.successor_at_m:
            return _no_successor(state, stage, Reason.PLAN_LATE, turn)
        if path.stop is not None:
            return None  # it was asked for a way that the vehicle no longer goes
    margin_m = min(outcome.certificate.clearance_m, outcome.certificate.keep_out_m)
    number = flight.legs_flown + 1
    _accept(state, stage, outcome)
    margin_m = float(np.floor(margin_m))  # said is no more than is proven
    turn.say(f"subpath {number}: {margin_m:.0f} m clear, cost {outcome.cost:.2f}", "plan")


def _accept(state: State, stage: phases.Flying, planned: Planned) -> None:
    """Fly it next, or at once if there is no leg."""
    flight, hovers, reaches = state.flight, state.vehicle.traits.hovers, planned.reaches_target
    leg = Leg.of(planned, flight.legs_flown + 1, state.task)
    flight.route_ne_m = () if reaches else planned.route_ne_m or flight.route_ne_m
    flight.progress = NO_PROGRESS if reaches else planned.progress
    if not flight.homeward:  # else it is why it goes home
        flight.refusal = None
    if stage.path is not None:
        stage.path.next_leg = leg
        return
    stage.path = OnPath(leg=leg, circling=not hovers)
    if stage.shortfall is not Reason.RADAR_SILENT or flight.homeward:
        flight.failures = 0  # blind, about what is known, it could fly for ever
    stage.search, stage.shortfall = None, Reason.NO_PLAN
    flight.legs_flown += 1


def _no_successor(state: State, stage: phases.Flying, reason: Reason, turn: Turn) -> None:
    """Without a successor a leg is flown to its end; without a leg the vehicle holds now."""
    flight = state.flight
    stage.shortfall = reason
    if stage.path is not None:
        if state.task.settings.is_near:
            stage.search = None  # it is asked for again, as long as this leg can be left
        else:
            turn.warn(in_words(state, reason))
        return
    come_to_rest(state, flight.hover_nea_m)
    flight.failures += 1
    return turn.fault(reason)


def start_scan(stage: phases.Flying, centre_nea_m: Vector, turn: Turn, again: int = 0) -> None:
    """Start a scan around a point."""
    stage.search = phases.Scanning(centre_nea_m, again)
    turn.do(events.StartScan(centre_nea_m=centre_nea_m))


# --- waiting for a leg


def _hover(state: State, stage: phases.Flying, event: Position, turn: Turn) -> None:
    """Hold while waiting for a leg: here, or straight above at the take-off height."""
    flight, settings = state.flight, state.task.settings
    hover = flight.hover_nea_m or _waiting_place(state, event, turn.context)
    # no lower than the next leg begins: it may have been paused on its way up
    lowest_m, _ = task_ahead(state, turn.context).band_amsl_m
    flight.hover_nea_m = hover = hover[0], hover[1], max(hover[2], lowest_m)
    target = state.targets_ne_m[flight.target]
    if math.dist(hover[:2], target) < AT_M and not flight.returning:
        return turn.to(Trigger.TARGET_REACHED)
    looks = stage.search is None and _is_there(state, event, hover)
    moves = stage.search is None and abs(event.velocity_nea_m_s[2]) > 0.1  # on its way up or down
    if looks or moves:
        stage.progress_at_s = state.now_s
    waited_s = state.now_s - stage.progress_at_s
    if waited_s > settings.scan_time_s + settings.planning_time_s + _ANSWER_SLACK_S:
        return _no_successor(state, stage, Reason.PLAN_LATE, turn)
    send_hold(state, event.time_s, turn)
    if looks:
        start_scan(stage, hover, turn)


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


def _is_there(state: State, event: Position, place: Vector) -> bool:
    """Whether the vehicle holds at the commanded place, or loiters there.

    No leg is planned for a plane that has not reached its circle yet, nor for a copter that is not
    within the tube that the leg begins with.
    """
    if state.vehicle.traits.hovers:
        return math.dist(place, event.position_nea_m) <= min(AT_M, state.task.envelope.tube_m)
    error_m = max(AT_M, state.task.limits.tracking_error_m)
    level = abs(event.velocity_nea_m_s[2]) < _LEVEL_M_S
    near = is_on_circle(place, event.position_nea_m, state.task.limits)
    return near and level and abs(place[2] - event.position_nea_m[2]) <= error_m


# --- the phase `shadow`: plan for the vehicle and report, never command
#
# A leg is planned from where the vehicle is, as if it were to fly it; as long as it does, the
# successors follow as in flight.  When it does not, the next leg begins where it went.


def shadow(state: State, stage: phases.Flying, event: Event, turn: Turn) -> None:
    """What would be done now."""
    reason = state.vehicle.distrust
    if reason is None and state.now_s - state.vehicle.bad_at_s < TRUST_S:
        reason = state.reason  # good again, but not for long enough to go on
    if reason is not state.reason:
        state.because(reason)
        come_to_rest(state)
        if reason is None:
            turn.say("shadow: would go on")
        else:
            turn.warn(f"shadow: would hold: {in_words(state, reason)}")
    elif reason is not None or state.vehicle.landed is Landed.ON_GROUND or not state.targets_ne_m:
        pass
    elif isinstance(event, Position):
        _watch(state, stage, event, turn)
    else:
        on_answer(state, stage, event, turn)


def _watch(state: State, stage: phases.Flying, event: Position, turn: Turn) -> None:
    """Follow the vehicle along the leg that was planned, or plan one from where it is."""
    flight, position, path = state.flight, event.position_nea_m, stage.path
    error_m = state.task.limits.tracking_error_m
    target = state.targets_ne_m[flight.target]
    if math.dist(position[:2], target) < max(_ARRIVED_M, error_m):
        come_to_rest(state)
        if flight.target + 1 < len(state.targets_ne_m):
            flight.target += 1
            turn.say("shadow: target reached")
    elif path is not None:
        off_m, at_m = following.nearest(path.leg, position)
        if off_m > 3.0 * error_m:
            turn.say(f"shadow: the vehicle is {off_m:.0f} m off the path")
            come_to_rest(state)
        else:
            _watch_leg(state, stage, path, at_m, turn)
    elif stage.search is None or state.now_s - stage.progress_at_s >= _SAY_AGAIN_S:
        stage.progress_at_s = state.now_s  # every few seconds until there is a leg
        start_scan(stage, position, turn)


def _watch_leg(state: State, stage: phases.Flying, path: OnPath, at_m: float, turn: Turn) -> None:
    """The vehicle is on the leg: scan at p_scan, go over at p_prog."""
    leg, length_m = path.leg, max(path.reference.length_m, at_m)
    speed_m_s = math.hypot(*state.vehicle.velocity_nea_m_s)
    path.reference = Reference(length_m=length_m, speed_m_s=speed_m_s)
    if path.next_leg is not None and length_m >= leg.successor_at_m:
        following.switch_to_next_leg(state, path)
    elif leg.subpath.length_m - length_m < 1.0:
        come_to_rest(state)
    elif stage.search is None and leg.wants_successor(path.reference):
        start_scan(stage, leg.subpath.pose(length_m).point_nea_m, turn)
