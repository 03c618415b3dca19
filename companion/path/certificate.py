"""The certificate: the proof that a subpath is safe to fly, along all of it (design 5.2, 5.3).

Nothing is sampled.  Bounds hold for every point of the curve and, by the dead-man reach, for every
straight stretch that the vehicle covers if the companion dies on the way.  A plane, which cannot
stop, holds on a circle about a point of the curve: its bounds hold for the circles about them all.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from companion import jit
from companion.path.proof import ROUNDING, ROUNDING_M, Bounds, Surroundings, prove
from companion.path.subpath import Subpath, cubics_of

_SANE_M = 1e8  # no control point is farther out than this: the arithmetic of the proof stays finite
_SET_BY = {
    "terrain clearance": "planner.safety_distance_m",
    "keep-out zone": "planner.safety_distance_m",
    "dead-man reach": "vehicle.speed_m_s",
    "turn radius": "vehicle.turn_radius_m",
    "climb angle": "vehicle.climb_angle_deg",
    "dive angle": "vehicle.dive_angle_deg",
    "floor of the band": "altitude.floor_amsl_m",
    "ceiling of the band": "altitude.ceiling_amsl_m",
    "edge of the map": "[area]",
}
"""The bounds, and what a mission sets of each."""


def bounds_text(broken: tuple[str, ...]) -> str:
    """Bounds, each with what a mission sets of it."""
    return ", ".join(f"{name} ({_SET_BY[name]})" if name in _SET_BY else name for name in broken)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """What is guaranteed along a whole subpath, and what is not.

    Distances are lower bounds, and refined only as far as they matter: `clearance_m` and
    `keep_out_m` up to twice the required clearance and to 1 % of it (`keep_out_m` is inf without
    zones), `dead_man_m` up to the contact margin and a quarter of the clearance, to 2 % of it.  Of
    a bound that is broken the number says how far it is known to hold, less finely.
    """

    clearance_m: float
    """Least distance to the known terrain: columns as high as their cells, in three dimensions.

    Of a plane the distance of its circle about each point; `keep_out_m` likewise."""
    keep_out_m: float
    """Least horizontal distance to zones, negative where they forbid to be; inf without zones."""
    dead_man_m: float
    """Least distance of the dead-man stretches to terrain and zones; not above 0 inside.

    Of a plane, that of its circles."""
    required_clearance_m: float
    """What `clearance_m` and `keep_out_m` have to be."""
    required_contact_m: float
    """What `dead_man_m` has to be."""
    speed_m_s: float
    """It is proven for this speed, and for none above."""
    turn_radius_m: float
    """The ground track is nowhere tighter; inf where it is straight."""
    climb_angle_rad: float
    """The curve is nowhere steeper upwards."""
    dive_angle_rad: float
    """Nor downwards."""
    lowest_amsl_m: float
    """Nowhere lower."""
    highest_amsl_m: float
    """Nowhere higher."""
    off_map_m: float
    """How far it leaves the map at most; 0: never."""
    radar_m: float
    """At most so much of the curve lies within radar ranges (a cost, not a bound)."""
    detection: float
    """At most this probability of detection (eq. 3), anywhere."""
    pieces: int
    """How many pieces the proof took."""
    broken: tuple[str, ...]
    """The bounds that could not be proven, in words."""

    @property
    def proven(self) -> bool:
        """Whether the subpath is safe to fly."""
        return not self.broken


def certify(subpath: Subpath, around: Surroundings, *, from_rest: bool) -> Certificate:
    """Prove a subpath, its tail included, against its surroundings.

    from_rest: the vehicle hovers at its start, and is the slower there.  A curve that is not
    finite is never proven, and no error.
    """
    control, bounds = subpath.control_nea_m, Bounds._make([math.nan] * 11 + [0])
    if np.all(np.abs(control) < _SANE_M):
        bounds = jit.compiled(prove)(cubics_of(control), around, from_rest)
    motion, steeper = around.motion, 1.0 + 2.0 * ROUNDING
    kept = (
        bounds.clearance_m >= around.clearance_m - ROUNDING_M,
        bounds.keep_out_m >= around.clearance_m - ROUNDING_M,
        bounds.dead_man_m >= around.contact_m - ROUNDING_M,
        bounds.turn_radius_m * steeper >= motion.turn_radius_m,
        math.tan(bounds.climb_angle_rad) <= math.tan(motion.climb_angle_rad) * steeper,
        math.tan(bounds.dive_angle_rad) <= math.tan(motion.dive_angle_rad) * steeper,
        bounds.lowest_amsl_m >= around.lowest_nea_m[2] - ROUNDING_M,
        bounds.highest_amsl_m <= around.highest_nea_m[2] + ROUNDING_M,
        bounds.off_map_m <= ROUNDING_M,
    )
    return Certificate(
        **bounds._asdict(),
        required_clearance_m=around.clearance_m,
        required_contact_m=around.contact_m,
        speed_m_s=motion.speed_m_s,
        broken=tuple(name for name, is_kept in zip(_SET_BY, kept, strict=True) if not is_kept),
    )
