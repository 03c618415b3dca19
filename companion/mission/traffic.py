"""Right of way: how far and how fast a vehicle may go for others in the air (docs/decisions/0023).

`observe` decides it at each position; following, the hold and the next plan keep to it.
"""

import dataclasses
import functools
import math
from dataclasses import dataclass
from typing import final

import numpy as np
from msgspec.structs import replace

from companion.geodesy import FloatArray
from companion.mission.decisions import Context, with_hold_reason
from companion.mission.events import ClaimWay, Command, OthersHeard, StatusText, Vector
from companion.mission.state import (
    ON_PATH,
    HoldMode,
    OnSetpoints,
    Phase,
    Reason,
    Replan,
    State,
    Traffic,
)
from companion.planner.procedure import Reference, advance
from companion.planner.settings import Task
from companion.world.clearance import distance_to_terrain_m
from companion.world.traffic import (
    CLAIM_S,
    STRAIGHT_M,
    Claim,
    Separation,
    Track,
    free_pieces,
    keeps_apart,
    straight_until,
)

_CLAIM_PERIOD_S = 0.2
_AHEAD_S = 9.0  # of flight, and the braking distance: how long a claim is at most
_PIECES = 48
_SPEEDS = (1.0, 0.75, 0.5, 0.25, 0.0)
_SHARES = (1.0, 0.5, 0.25)  # of the separation, if no speed keeps it all
_LAW_STEP_S = 0.5
_SLACK_S = 0.5  # in which a plane is told to loiter at the end of what it may enter
_STILL_M_S = 0.05
_PATIENCE_S, _LAST_PATIENCE_S = 20.0, 40.0
_KNOT_S = 60.0  # without any way on: then others need this vehicle's level
_AGAIN_S, _NO_LEVEL_S = 10.0, 5.0
_THERE_M, _CIRCLES_THERE_M = 1.0, 5.0
_LEVELS = 32  # of the band, that are looked at
_FREE_M = 5.0  # by more than that a level is free when it is chosen: it stays so for a while
_TURN_S = 20.0  # half of it a plane claims its way, half of it others may go where that leads
_GOLDEN = 0.618034  # of a time: any of several, each as often


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Scene:
    """Where the vehicle is, the way ahead, and who may be in it."""

    now_s: float
    ours: int
    here: FloatArray
    points: FloatArray  # (N, 3): here, the reference point, then along the path
    ahead_m: FloatArray  # (N,): from the reference point
    claims: tuple[tuple[Claim, float], ...]
    """Those that lie near the way ahead, with how far they may have grown since they were heard."""
    tracks: tuple[Track, ...]
    there_m: float
    """Nearer than that to a level it is there."""
    bent_m: float
    """How far the path may be from the chord that is claimed."""
    apart: Separation
    """Of claims."""
    past: Separation
    """Of a claim from where the vehicle is known to be: only the other's path bends."""
    clear: Separation
    """Of tracks."""

    def free(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Which pieces no claim comes near to, and which none that goes before this system.

        A way that nowhere leads nearer to a claim than to the separation and what the other's path
        bends is free of it all along: two that stopped for each other part again.
        """
        every = np.ones(len(points) - 1, dtype=bool)
        before = every.copy()
        for claim, grown_m in self.claims:
            if free_pieces(points, claim, self.past, grown_m).all():
                continue
            free = free_pieces(points, claim, self.apart, grown_m)
            every &= free
            if claim.system < self.ours and not grown_m:
                before &= free
        return every, before

    def is_claimed(self, height_m: float) -> bool:
        """Whether one that goes before this system is to come near to a height where it stands."""
        place = np.array([self.here[0], self.here[1], height_m])
        near = dataclasses.replace(self.apart, vertical_m=self.past.vertical_m)
        return any(
            claim.system < self.ours and not grown_m and _is_near(place, claim, near)
            for claim, grown_m in self.claims
        )


def heard(state: State, event: OthersHeard) -> State:
    """What is known of others has changed."""
    if (traffic := state.traffic) is None:
        return state
    traffic = replace(traffic, ours=event.ours, tracks=event.tracks, claims=event.claims)
    return replace(state, traffic=traffic)


def _is_near(place: FloatArray, claim: Claim, apart: Separation, grown_m: float = 0.0) -> bool:
    """Whether a claim comes too near to a place."""
    return not free_pieces(np.stack([place, place]), claim, apart, grown_m).all()


def observe(state: State, context: Context) -> tuple[State, list[Command]]:
    """At each position: how far and fast it may go, whether to leave the path, and its claim."""
    traffic, here = state.traffic, _place(state)
    if traffic is None or here is None:
        return state, []
    if not (state.phase in ON_PATH or isinstance(state.hold, OnSetpoints)):
        traffic = Traffic(
            rules=traffic.rules,
            ours=traffic.ours,
            tracks=traffic.tracks,
            claims=traffic.claims,
            claimed_at_s=traffic.claimed_at_s,
        )
        return _with_claim(replace(state, traffic=traffic), here, _column(state, here, context))
    traffic = _moved(state, traffic)
    scene = _scene(state, traffic, np.asarray(here))
    leg = state.flight.leg
    if leg is not None and traffic.rules.claims:
        traffic = _claimed(state, traffic, scene)
    elif leg is not None:
        traffic = replace(traffic, committed_m=math.inf)
    speed_m_s, forced = _fastest(state, traffic.rules.horizon_s, scene)
    still = leg is None or state.flight.reference.speed_m_s <= _STILL_M_S
    forced = forced or (still and scene.is_claimed(here[2]))
    flies = state.task.limits
    needed_m = flies.lead_m + _SLACK_S * flies.speed_m_s
    needed_m = min(needed_m, float(scene.ahead_m[-1])) - _THERE_M
    traffic = replace(
        traffic,
        speed_m_s=speed_m_s,
        forced_since_s=min(traffic.forced_since_s, state.now_s) if forced and still else math.inf,
        moved_at_s=traffic.moved_at_s if still and leg is not None else state.now_s,
        waits=not flies.hovers
        and leg is not None
        and (speed_m_s == 0.0 or entered_m(traffic) < needed_m),
    )
    state = _with_level(replace(state, traffic=traffic), scene)
    state, says = _told(state, scene)
    state, claims = _with_claim(state, here, _end_of_claim(state, scene))
    return state, [*says, *claims]


def _place(state: State) -> Vector | None:
    """Where it is; of a plane that is on its circle the middle of that, at its own height."""
    here, flight, task = state.vehicle.position_nea_m, state.flight, state.task
    middle = flight.hover_nea_m
    if here is None or middle is None or not (flight.leg is None or flight.circling):
        return here
    on_circle = math.dist(here[:2], middle[:2]) <= task.limits.loiter_radius_m + task.error_m
    return here if task.limits.hovers or not on_circle else (middle[0], middle[1], here[2])


def _with_claim(state: State, here: Vector, end: Vector | None) -> tuple[State, list[Command]]:
    """Send the claim, if there is one and it is time to."""
    traffic = state.traffic
    assert traffic is not None
    due = state.now_s - traffic.claimed_at_s >= _CLAIM_PERIOD_S - 0.05
    if end is None or not traffic.rules.claims or not due:
        return state, []
    sent = ClaimWay(time_s=state.now_s, begin_nea_m=here, end_nea_m=end)
    return replace(state, traffic=replace(traffic, claimed_at_s=state.now_s)), [sent]


def _column(state: State, here: Vector, context: Context) -> Vector | None:
    """The other end of the claim while the autopilot takes off, lands or holds; None: no claim."""
    home = state.vehicle.home_nea_m
    if not state.airborne:
        return None
    if state.phase is Phase.TAKING_OFF:
        return here[0], here[1], context.mission.task.take_off_amsl_m
    if state.phase is Phase.LANDING and home is not None:
        return here[0], here[1], min(home[2], here[2])
    stays = state.phase is Phase.ARRIVED or isinstance(state.hold, HoldMode)
    return here if stays else None


# --- the way ahead


def _moved(state: State, traffic: Traffic) -> Traffic:
    """Count what the reference point has moved; without a leg, or on a new one, from nothing."""
    flight, (old, old_next) = state.flight, traffic.legs
    leg, at_m = flight.leg, flight.reference.length_m
    brakes_m = state.task.limits.stopping_m(flight.reference.speed_m_s)
    before_m, traffic = traffic.at_m, replace(traffic, legs=(leg, flight.next_leg), at_m=at_m)
    if leg is not None and leg is old:
        moved_m = at_m - before_m
    elif leg is not None and old is not None and leg is old_next:
        moved_m = old.successor_at_m(state.task) - before_m + at_m
    else:  # what a vehicle cannot stop before that is led back to a path is its own
        floor_m = traffic.floor_m if leg is None else None
        return replace(traffic, flown_m=0.0, asked=(), committed_m=brakes_m, floor_m=floor_m)
    flown_m, kept_m = traffic.flown_m + max(moved_m, 0.0), math.inf
    if leg is old and flight.next_leg is not old_next:  # another way beyond p_prog
        kept_m = flown_m + max(leg.successor_at_m(state.task) - at_m, brakes_m)
    return replace(
        traffic,
        flown_m=flown_m,
        asked=tuple((since_s, min(end_m, kept_m)) for since_s, end_m in traffic.asked),
        committed_m=max(min(traffic.committed_m, kept_m), flown_m),
    )


def _longest_m(task: Task) -> float:
    """How long a claim is at most."""
    limits = task.limits
    return _AHEAD_S * limits.speed_m_s + limits.stopping_m(limits.speed_m_s) + limits.lead_m


def _scene(state: State, traffic: Traffic, here: FloatArray) -> _Scene:
    rules, limits, now_s = traffic.rules, state.task.limits, state.now_s
    longest_m = _longest_m(state.task)
    ahead_m, path = _path_ahead(state, here, longest_m)
    error_m = state.task.error_m
    wide_m = error_m + limits.loiter_radius_m  # a plane may be beside its way by its circle
    bent_m = STRAIGHT_M
    if not limits.hovers:  # it needs a claim as long as its lead, in a turn too
        bent_m = (limits.lead_m + 2.0 * limits.speed_m_s) ** 2 / (8.0 * limits.turn_radius_m)
    fastest_m_s = math.hypot(limits.speed_m_s, limits.climb_rate_m_s)
    claims = traffic.claims if rules.claims else ()
    grown = tuple((claim, claim.grown_m(now_s, fastest_m_s, longest_m)) for claim in claims)
    agreed = {claim.system for claim, grown_m in grown if not grown_m}
    apart = Separation(
        horizontal_m=rules.separation_m + 2.0 * wide_m + 4.0 * bent_m,
        vertical_m=rules.vertical_separation_m + 2.0 * error_m + 4.0 * bent_m,
    )
    points = np.concatenate([here[None], path])
    box = points[:, :2].min(axis=0).tolist(), points[:, :2].max(axis=0).tolist()
    return _Scene(
        now_s=now_s,
        ours=traffic.ours,
        here=here,
        points=points,
        ahead_m=np.concatenate([[0.0], ahead_m]),
        claims=tuple(
            (claim, grown_m)
            for claim, grown_m in grown
            if claim.comes_near(*box, apart.horizontal_m + grown_m)
        ),
        tracks=tuple(
            track
            for track in traffic.tracks
            if track.system not in agreed
            and track.reach_s(here.tolist(), limits.speed_m_s, now_s) < rules.horizon_s
        ),
        there_m=_THERE_M if limits.hovers else _CIRCLES_THERE_M,
        bent_m=bent_m,
        apart=apart,
        past=Separation(
            horizontal_m=apart.horizontal_m - 2.0 * bent_m,
            vertical_m=apart.vertical_m - 2.0 * bent_m,
        ),
        clear=Separation(
            horizontal_m=rules.separation_m + wide_m,
            vertical_m=rules.vertical_separation_m + error_m,
        ),
    )


def _path_ahead(state: State, here: FloatArray, longest_m: float) -> tuple[FloatArray, FloatArray]:
    """Lengths from the reference point on, and the points of the path there.  (N,), (N, 3)."""
    flight = state.flight
    leg, at_m = flight.leg, flight.reference.length_m
    if leg is None:
        return np.zeros(1), np.asarray(flight.hover_nea_m or here)[None]
    over_m, beyond_m = leg.subpath.length_m, 0.0
    if flight.stop is not None:
        over_m = min(over_m, flight.stop.at_m)
    elif flight.next_leg is not None:
        over_m = leg.successor_at_m(state.task)
        beyond_m = flight.next_leg.subpath.length_m
    left_m = max(min(over_m - at_m + beyond_m, longest_m), 0.0)
    ahead_m = np.linspace(0.0, left_m, _PIECES + 1)
    points = leg.subpath.points_nea_m(np.minimum(at_m + ahead_m, over_m))
    if flight.next_leg is not None and beyond_m:
        onto = at_m + ahead_m > over_m
        points[onto] = flight.next_leg.subpath.points_nea_m(at_m + ahead_m[onto] - over_m)
    return ahead_m, points


# --- claims


def _claimed(state: State, traffic: Traffic, scene: _Scene) -> Traffic:
    """Claim the way ahead; enter what has been claimed for long enough, and nobody else claims.

    A copter leaves to those before it all but what it needs to stop; a plane that has waited for
    long leaves now and then what it cannot enter to all, one of whom may stand in another's way.
    """
    now_s, flown_m, ahead_m = scene.now_s, traffic.flown_m, scene.ahead_m
    nobodys_m, mine_m = (flown_m + _first_m(free, ahead_m) for free in scene.free(scene.points))
    committed_m, limits = traffic.committed_m, state.task.limits
    if limits.hovers:
        stops_m = flown_m + limits.stopping_m(state.flight.reference.speed_m_s) + _THERE_M
        committed_m = min(committed_m, max(mine_m, stops_m))
    most_m = max(mine_m, committed_m)
    waited_s = now_s - traffic.moved_at_s
    if not limits.hovers and waited_s > _LAST_PATIENCE_S:
        turn = (now_s / _TURN_S + _GOLDEN * traffic.ours) % 1.0
        most_m = committed_m if turn < 0.5 else most_m
    asked = [(since_s, min(end_m, most_m)) for since_s, end_m in traffic.asked]
    from_path = int(scene.bent_m > STRAIGHT_M)  # a plane may be beside it
    last = straight_until(scene.points[from_path:], scene.bent_m) + from_path
    wanted_m = min(flown_m + float(ahead_m[last]), most_m)
    ripe_m = max((end_m for since_s, end_m in asked if now_s - since_s >= CLAIM_S), default=0.0)
    committed_m = max(committed_m, min(ripe_m, nobodys_m))
    asked = [(s, m) for s, m in asked if now_s - s < CLAIM_S or m == ripe_m]
    if not asked or wanted_m > asked[-1][1]:
        asked.append((now_s, wanted_m))
    return replace(traffic, asked=tuple(asked), committed_m=committed_m, taken_m=nobodys_m)


def _first_m(free: FloatArray, ahead_m: FloatArray) -> float:
    """Length ahead at which the first piece that is not free begins; (0: from here to the path)."""
    taken = np.flatnonzero(np.logical_not(free[1:]))
    return float(ahead_m[-1] if not len(taken) else ahead_m[taken[0] + 1])


def _end_of_claim(state: State, scene: _Scene) -> Vector:
    """The end of the stretch that is claimed now."""
    traffic, flight = state.traffic, state.flight
    assert traffic is not None
    if traffic.level_m is not None:
        return float(scene.here[0]), float(scene.here[1]), traffic.level_m
    if flight.leg is None:
        place = scene.points[-1]
    else:
        end_m = max([traffic.committed_m, *(end_m for _, end_m in traffic.asked)])
        left_m = end_m - traffic.flown_m
        place = np.array(
            [np.interp(left_m, scene.ahead_m[1:], axis) for axis in scene.points[1:].T]
        )
    return float(place[0]), float(place[1]), float(place[2])


# --- tracks


def _fastest(state: State, horizon_s: float, scene: _Scene) -> tuple[float, bool]:
    """The largest speed that keeps clear of all tracks, or the most of it; whether none does."""
    if not scene.tracks:
        return math.inf, False
    limits = state.task.limits
    slack_m = 0.1 + (limits.speed_m_s * _LAW_STEP_S) ** 2 / (8.0 * limits.turn_radius_m)
    if state.flight.leg is None:
        times = np.arange(scene.now_s, scene.now_s + horizon_s + _LAW_STEP_S, _LAW_STEP_S)
        points = np.broadcast_to(scene.points[-1], (len(times), 3))
        return math.inf, not keeps_apart(points, times, scene.tracks, scene.clear, slack_m)
    law = functools.cache(lambda speed_m_s: _time_law(state, speed_m_s, horizon_s))
    for kept in _SHARES:
        for share in _SPEEDS if limits.hovers else _SPEEDS[:1]:
            speed_m_s = share * limits.speed_m_s
            if keeps_apart(*law(speed_m_s), scene.tracks, scene.clear, slack_m, kept):
                return (math.inf if share == kept == 1.0 else speed_m_s), kept < 1.0
    return 0.0, True


def _time_law(state: State, speed_m_s: float, horizon_s: float) -> tuple[FloatArray, FloatArray]:
    """Where the reference point will be, at no more than this speed.  -> (N, 3), (N,)."""
    flight, limits, task = state.flight, state.task.limits, state.task
    leg, next_leg, reference = flight.leg, flight.next_leg, flight.reference
    assert leg is not None
    count = math.ceil(horizon_s / _LAW_STEP_S)
    points = [leg.subpath.pose(reference.length_m).position_nea_m]
    for _ in range(count):
        if limits.hovers:
            reference = advance(
                reference,
                leg,
                _LAW_STEP_S,
                points[-1],
                limits,
                goes_on=next_leg is not None,
                until_m=None if flight.stop is None else flight.stop.at_m,
                slows_to_m_s=leg.slows_to_m_s(task),
                speed_limit_m_s=min(speed_m_s, flight.speed_limit_m_s),
            )
        else:
            length_m = min(reference.length_m + speed_m_s * _LAW_STEP_S, leg.subpath.length_m)
            reference = Reference(length_m=length_m, speed_m_s=speed_m_s)
        if next_leg is not None and reference.length_m >= (over := leg.successor_at_m(task)):
            reference = dataclasses.replace(reference, length_m=reference.length_m - over)
            leg, next_leg = next_leg, None
        points.append(leg.subpath.pose(reference.length_m).position_nea_m)
    return np.array(points), state.now_s + _LAW_STEP_S * np.arange(count + 1, dtype=np.float64)


# --- out of the way


def _with_level(state: State, scene: _Scene) -> State:
    """Choose a level to go to, note that the vehicle is there, or stop on the way to it."""
    traffic, hover, height_m = state.traffic, state.flight.hover_nea_m, float(scene.here[2])
    assert traffic is not None
    may = state.phase in ON_PATH or isinstance(state.hold, Replan)
    if state.flight.returning and not state.task.limits.hovers:
        may = False  # a plane's way back leads along what it has flown, at those heights
    if (level_m := traffic.level_m) is not None:
        done = abs(height_m - level_m) < scene.there_m
        if may and not done and _is_free(state, scene, level_m):
            climbs = traffic.climbs or state.now_s - traffic.level_since_s >= CLAIM_S
            return replace(state, traffic=replace(traffic, climbs=climbs))
        floor_m = level_m if done else traffic.floor_m
        ended = replace(traffic, level_m=None, climbs=False, floor_m=floor_m)
        state = replace(state, traffic=ended)
        if done or hover is None or not traffic.climbs:
            return state
        flight = replace(state.flight, hover_nea_m=(hover[0], hover[1], height_m))
        return replace(state, flight=flight)
    forced = math.isfinite(traffic.forced_since_s)
    if not (may and (forced or _is_stuck(state, scene))):
        return state
    level_m = next(
        (
            each
            for each in _levels(state, scene)
            if _leads_on(state, scene, each, forced=forced)
            and _is_free(state, scene, each, _FREE_M)
        ),
        None,
    )
    knot = state.task.limits.hovers and state.now_s - traffic.moved_at_s > _KNOT_S
    if level_m is None and knot:
        free = [
            each
            for each in _levels(state, scene)
            if abs(each - float(scene.here[2])) >= scene.apart.vertical_m
            and _is_free(state, scene, each, _FREE_M)
        ]
        level_m = free[int(_GOLDEN * state.now_s % 1.0 * len(free))] if free else None
    if level_m is None:
        return state
    return replace(state, traffic=replace(traffic, level_m=level_m, level_since_s=state.now_s))


def _leads_on(state: State, scene: _Scene, level_m: float, *, forced: bool) -> bool:
    """Whether a level is out of the way, or without force one on which the way is free."""
    height_m = float(scene.here[2])
    if forced and scene.is_claimed(height_m):
        return not scene.is_claimed(level_m)
    if forced:  # of tracks only those count that are here when it could be there
        return not _is_clear(state, scene, height_m, level_m)
    there = scene.points.copy()
    there[:, 2] = level_m
    return bool(scene.free(there)[0].all())


def _is_stuck(state: State, scene: _Scene) -> bool:
    """Whether it has been kept from going on for too long; the others had their time before."""
    traffic, flight = state.traffic, state.flight
    assert traffic is not None
    if flight.leg is None or flight.stop is not None:
        return False
    near = any(claim.system < traffic.ours for claim, _ in scene.claims)
    waited_s = state.now_s - traffic.moved_at_s
    first = near or traffic.speed_m_s == 0.0
    return waited_s > (_PATIENCE_S if first else _LAST_PATIENCE_S)


def _levels(state: State, scene: _Scene) -> list[float]:
    """Levels in the band, the nearest first; of planes few, that are apart and the same for all."""
    low_m, high_m = state.task.band_amsl_m
    height_m = float(scene.here[2])
    if state.task.limits.hovers:
        step_m = max((high_m - low_m) / _LEVELS, 2.0 * _THERE_M)
        levels, least_m = np.arange(low_m, high_m, step_m), _THERE_M
    else:
        high_m -= scene.there_m
        apart_m = scene.past.vertical_m
        levels = np.linspace(low_m, high_m, 1 + max(int((high_m - low_m) / apart_m), 0))
        least_m = 0.5 * apart_m
    away = (each for each in levels.tolist() if abs(each - height_m) > least_m)
    return sorted(away, key=lambda level_m: (abs(level_m - height_m), -level_m))


def _is_free(state: State, scene: _Scene, level_m: float, slack_m: float = 0.0) -> bool:
    """Whether the vehicle may go to a level: nobody else is there, or on the way to it.

    Through what is claimed about the vehicle itself it may go if none of that lies so far above (or
    below) that the other could have entered it, over the vehicle's head (docs/decisions/0023).
    """
    here = scene.here
    column = np.linspace(here, [here[0], here[1], level_m], 9)
    committed = state.traffic is not None and state.traffic.climbs
    for claim, grown_m in () if committed else scene.claims:
        if free_pieces(column, claim, scene.past, grown_m).all():
            continue
        ahead = math.copysign(1.0, level_m - float(here[2]))
        ends_m = (ahead * (end[2] - here[2]) for end in (claim.begin_nea_m, claim.end_nea_m))
        beyond = max(ends_m) >= scene.past.vertical_m - 2.0 * scene.bent_m
        if grown_m or beyond or not _is_near(here, claim, scene.past):
            return False
        if _is_near(column[-1], claim, scene.past):
            return False
    if not _is_clear(state, scene, level_m, level_m, slack_m):
        return False
    required_m = state.task.required_clearance_m
    known = state.flight.known.grown(state.task.limits.loiter_radius_m)
    return level_m > here[2] or (distance_to_terrain_m(known, column[-1], required_m) >= required_m)


def _is_clear(
    state: State, scene: _Scene, at_m: float, level_m: float, slack_m: float = 0.0
) -> bool:
    """Whether no track comes near to a height, from when the vehicle could be at a level."""
    assert state.traffic is not None
    north, east, height_m = scene.here.tolist()
    climb_s = abs(level_m - height_m) / state.task.limits.climb_rate_m_s + CLAIM_S
    until_s = max(state.traffic.rules.horizon_s, climb_s + _LAW_STEP_S)
    times = scene.now_s + np.arange(climb_s, until_s + _LAW_STEP_S, _LAW_STEP_S)
    points = np.broadcast_to([north, east, at_m], (len(times), 3))
    return keeps_apart(points, times, scene.tracks, scene.clear, slack_m)


# --- for the phases


def entered_m(traffic: Traffic) -> float:
    """How far ahead of the reference point the path may be entered."""
    return max(traffic.committed_m - traffic.flown_m, 0.0)


def limits(state: State, until_m: float | None, speed_m_s: float) -> tuple[float | None, float]:
    """Where to stop on the leg, and how fast to fly, for others in the air as well."""
    flight, traffic = state.flight, state.traffic
    if traffic is None or flight.leg is None:
        return until_m, speed_m_s
    left_m = entered_m(traffic)
    at_m = flight.reference.length_m + left_m
    if at_m < flight.leg.subpath.length_m:  # else on the next one
        until_m = at_m if until_m is None else min(until_m, at_m)
    speed_m_s = min(speed_m_s, traffic.speed_m_s, state.task.limits.braked_m_s(left_m))
    return until_m, speed_m_s


def is_held_back(state: State) -> bool:
    """Whether it stands for others in the air: it is not stuck."""
    traffic = state.traffic
    if traffic is None or state.flight.leg is None:
        return False
    return traffic.waits or min(entered_m(traffic), traffic.speed_m_s) < _THERE_M


def settled_m(state: State) -> float:
    """How far ahead the path may not change any more: it would be entered without a claim."""
    traffic, flight = state.traffic, state.flight
    if traffic is None or not traffic.rules.claims:
        return 0.0
    return state.task.limits.stopping_m(flight.reference.speed_m_s)


def plan_floor(state: State, task: Task) -> Task:
    """The task of a plan from rest: no lower than the level that the vehicle went to."""
    traffic, flight = state.traffic, state.flight
    if traffic is None or traffic.floor_m is None or flight.leg is not None or flight.failures:
        return task
    return task.no_lower_than(traffic.floor_m - _THERE_M)


def hold(state: State) -> tuple[State, list[Command]]:
    """While it holds: to the level that was chosen, once the way there is its own."""
    traffic, hover = state.traffic, state.flight.hover_nea_m
    if traffic is None or traffic.level_m is None or not isinstance(state.hold, Replan):
        return state, []
    says: list[Command] = []
    if state.reason is not Reason.TRAFFIC:
        state = with_hold_reason(state, Reason.TRAFFIC)
        says = [StatusText(text=f"hold: {Reason.TRAFFIC.text}", about="phase")]
    if traffic.climbs and hover is not None:
        flight = replace(state.flight, hover_nea_m=(hover[0], hover[1], traffic.level_m))
        state = replace(state, flight=flight)
    return state, says


def keeps_holding(state: State) -> bool:
    """Whether to wait where it is, or for the level that it goes to."""
    return state.traffic is not None and state.traffic.level_m is not None


def _told(state: State, scene: _Scene) -> tuple[State, list[Command]]:
    """Say once why it slows down or stands."""
    traffic, flight = state.traffic, state.flight
    assert traffic is not None
    ahead_m = traffic.flown_m + float(scene.ahead_m[-1])
    slow = flight.reference.speed_m_s < 0.5 * state.task.limits.speed_m_s
    waits = flight.leg is not None and (slow or traffic.waits) and traffic.taken_m < ahead_m
    reason = None
    if traffic.level_m is None and state.now_s - traffic.forced_since_s > _NO_LEVEL_S:
        reason = Reason.NO_LEVEL
    elif waits or traffic.speed_m_s < math.inf:
        reason = Reason.GIVING_WAY
    if reason is None:
        return state, []
    fresh = state.now_s - traffic.told_at_s > _AGAIN_S
    fresh = fresh or (reason is Reason.NO_LEVEL and traffic.told is not reason)
    told = reason if fresh else traffic.told
    traffic = replace(traffic, told=told, told_at_s=state.now_s)
    text = f"{reason.text}{_who(scene)}"
    return replace(state, traffic=traffic), [StatusText(text=text)] if fresh else []


def _who(scene: _Scene) -> str:
    """The one in the way, as a detail of the reason."""
    for claim, grown_m in scene.claims:
        if not free_pieces(scene.points, claim, scene.apart, grown_m).all():
            return f": system {claim.system}"
    nearest = min(
        scene.tracks,
        key=lambda track: track.reach_s(scene.here.tolist(), 0.0, scene.now_s),
        default=None,
    )
    return "" if nearest is None else f": {nearest.name}"
