"""Home, as the vehicle has it, and whether the flown path begins there (design section 7)."""

import math

from companion.mission.state import State

_AT_M = 5.0
"""As near as a copter holds in wind (`decisions.AT_M`)."""
_CIRCLES = 1.5
"""Loiter radii: a plane lands on a circle about where it is told to (px4.md 10)."""

Place = tuple[float, float]


def home_ne_m(state: State) -> Place | None:
    """Where home is, north and east; None: nobody has said.

    If the vehicle has not said, it is where its own take-off began the path, never the origin.
    """
    if (home := state.vehicle.home_nea_m) is not None:
        return home[:2]
    return _path_begins_ne_m(state) if state.armed_by_us else None


def is_above_home(state: State) -> bool:
    """Whether a copter is above its home."""
    home, here = state.vehicle.home_nea_m, state.vehicle.position_nea_m
    if home is None or here is None or not state.vehicle.traits.hovers:
        return False
    return math.dist(home[:2], here[:2]) < max(_AT_M, state.task.limits.tracking_error_m)


def beyond_path_m(state: State) -> float:
    """How far it is home from where the flown path begins; 0: that is at home, or home unknown.

    Not where the companion took over in flight, or was started again without memory.  An autopilot
    that has no mode to land goes home by itself from where its own take-off ended.
    """
    home, begins, traits = home_ne_m(state), _path_begins_ne_m(state), state.vehicle.traits
    if home is None or begins is None or (state.armed_by_us and not traits.lands):
        return 0.0
    limits, off_m = state.task.limits, math.dist(home, begins)
    near_m = max(_AT_M, limits.tracking_error_m)
    if not traits.hovers:
        near_m = max(near_m, _CIRCLES * limits.loiter_radius_m)
    return off_m if off_m > near_m else 0.0


def begins_at_home(state: State) -> bool:
    """Whether the flown path is known to begin at home."""
    return home_ne_m(state) is not None and beyond_path_m(state) == 0.0


def _path_begins_ne_m(state: State) -> Place | None:
    """Where the flown path begins; None: nothing was flown."""
    if not state.flight.flown:
        return None
    north, east, _ = state.flight.flown[0].control_nea_m[0]
    return float(north), float(east)
