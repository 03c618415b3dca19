"""Whether the battery lasts: to the target, with the reserve (design section 7)."""

import itertools
import math

from companion.mission import following
from companion.mission.decisions import Turn
from companion.mission.events import Battery, Landed
from companion.mission.mission import Mission
from companion.mission.phases import Reason
from companion.mission.state import Goal, State, Way
from companion.mission.way_back import beyond_path_m

_DRAIN_S = 60.0  # before that, what the battery has lost says nothing of what it will
_TELLING = 0.05  # nor before it has lost so much
_STEP = 0.01  # it is told in hundredths
_DETOUR = 1.1  # of the way that is known to be left
_SHORT_S = 3.0  # one word of an empty battery may be wrong
_LAST_WORD_S = 10.0  # ten times as long as between two
_TOLD_FORECAST, _TOLD_SHORT = 1, 2


def take_battery(state: State, event: Battery, mission: Mission) -> None:
    """Take one battery report."""
    vehicle, full = state.vehicle, state.vehicle.battery_full
    vehicle.battery, vehicle.battery_at_s = event.remaining, event.time_s
    in_air = vehicle.landed not in (Landed.ON_GROUND, Landed.UNKNOWN)
    if in_air and (full is None or event.remaining > full[1]):
        vehicle.battery_full = event.time_s, event.remaining
    if battery_lasts(state, mission):
        vehicle.battery_short_at_s = None
    elif vehicle.battery_short_at_s is None:
        vehicle.battery_short_at_s = event.time_s


def battery_is_short(state: State) -> bool:
    """Whether all battery reports for a while say that it will not last.

    A single report counts, too, if none follows.
    """
    vehicle, since_s = state.vehicle, state.vehicle.battery_short_at_s
    if since_s is None:
        return False
    unheard_s = state.now_s - vehicle.battery_at_s
    return vehicle.battery_at_s - since_s >= _SHORT_S or unheard_s >= _LAST_WORD_S


def battery_lasts(state: State, mission: Mission) -> bool:
    """Whether the battery reaches the target with the reserve, as far as known.

    More than the reserve must be left, and enough for the distance if the mission gives the
    endurance.  The consumption of this flight only causes a warning (`warn_of_battery`):
    simulators, and batteries that are not full, lose half of it in the first minute.
    """
    left = state.vehicle.battery
    if left is None:
        return True
    if left < mission.reserve:
        return False
    if mission.endurance_s is None:
        return True
    left_s, way_m = (left - mission.reserve) * mission.endurance_s, way_left_m(state, _DETOUR)
    return left_s >= way_m / state.task.limits.speed_m_s


def gives_up_for_battery(state: State) -> bool:
    """Whether the battery ends the mission, or a pause; then it is given up for its fallback.

    Not a mission that was already given up, nor the return in progress, which is gone on with.
    """
    flight = state.flight
    ordered = state.order in (Reason.RETURN_ASKED, Reason.LAND_ASKED)
    is_over = flight.fallen_back is not None or flight.homeward or ordered
    if not battery_is_short(state) or (is_over and state.reason is not Reason.PAUSED):
        return False
    state.goal = Goal.DOWN if state.goal is Goal.TARGETS else state.goal
    state.paused = False
    flight.battery_told = _TOLD_SHORT
    if flight.way is Way.OUT:
        flight.fallen_back = Reason.BATTERY_LOW
    return True


def warn_of_battery(state: State, turn: Turn) -> None:
    """Warn once that the battery will not last at this flight's rate, and once that it does not."""
    told_before, vehicle, warning = state.flight.battery_told, state.vehicle, 0
    if vehicle.battery_short_at_s is not None and battery_is_short(state):
        warning = _TOLD_SHORT
    elif told_before < _TOLD_FORECAST and vehicle.battery_full and vehicle.battery is not None:
        since_s, full = vehicle.battery_full
        elapsed_s, lost = state.now_s - since_s, full - vehicle.battery
        if elapsed_s >= _DRAIN_S and lost >= _TELLING:
            left_s = (vehicle.battery - turn.context.mission.reserve) * elapsed_s / (lost - _STEP)
            lasts = left_s >= way_left_m(state, _DETOUR) / state.task.limits.speed_m_s
            warning = 0 if lasts else _TOLD_FORECAST
    if warning > told_before:
        state.flight.battery_told = warning
        turn.warn(Reason.BATTERY_LOW.text)


def way_left_m(state: State, detour: float = 1.0) -> float:
    """Remaining distance: the backtrack, or the last plan's route and on from target to target.

    detour: how many times as long as that the way to the targets may become.
    """
    position, flight = state.vehicle.position_nea_m, state.flight
    if flight.way is Way.BACK:
        path = state.path
        legs = (*flight.back,) if path is None else (path.leg, path.next_leg, *flight.back)
        ahead = [leg for leg in legs if leg is not None]
        flown_m = 0.0 if path is None else path.reference.length_m
        if path is None and ahead and position is not None:  # stopped on the first of them
            flown_m = following.nearest(ahead[0], position)[1]
        return sum(leg.subpath.length_m for leg in ahead) - flown_m + beyond_path_m(state)
    if position is None or not state.targets_ne_m:
        return 0.0
    route, from_here = flight.route_ne_m, itertools.repeat(position[:2])
    if route:  # it begins where it was planned
        apart_m = list(map(math.dist, route, from_here))
        route = route[apart_m.index(min(apart_m)) :]
    places = [position[:2], *route, *state.targets_ne_m[flight.target :]]
    return sum(map(math.dist, places, places[1:])) * detour
