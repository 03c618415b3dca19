"""How a vehicle moves: what the proof, the reference point and the monitor all take it to do.

A copter is sent a reference point that moves along the path.  When the companion ends, the
autopilot moves that point straight on for the dead-man time, then stops: so everything is told of
the point, and the vehicle is within `tube_m` of it across the path, beyond an end and along it, of
where the point has been.  A plane is sent a point ahead of it, and circles where it is sent last.

Plain scalar functions beside the record: the proof and the search compile them as they are.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, final

from companion.path.limits import Limits

_JERKS_1_S = 4.0  # its jerk for each m/s2 of acceleration: ArduCopter's `parameters_for`, `kills`
SLOWEST = 0.25  # of V: no bend is flown more slowly, so none is so tight as to ask for that
RISES = 0.4  # of its acceleration ahead: ArduCopter's defaults are 1 of 2.5 m/s2, PX4's are more
_LAG_S = 1.0  # of flight at full speed: behind a point that gains speed it is up to 0.6 s late


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Handling:
    """How an autopilot flies a stream of setpoints, as measured: of copters."""

    name: str
    eased: float
    """Of the mission's acceleration: what the reference point gains speed with.  Behind a point
    that uses all of it a vehicle falls back while its own acceleration builds up, and then flies
    up to 1.2 V to catch up."""
    settling_s: float
    """The reference point flies what is left of a leg, beyond its braking distance, in no less time
    than this: it brakes softly from and to low speeds, and the vehicle, whose speed follows that of
    the point later, does not fly past the end."""
    lag_s: float = 0.0
    """How much later than the point the vehicle slows down: it counts as dead-man time, too."""
    steady_m: float  # how far it is from a straight path at a steady speed, in wind and gusts
    turning_s2: float  # how far it is beside a bent path, metres for each m/s2 across
    leading_s2: float = 0.0
    """How far inside of a bend its setpoints are, metres for each m/s2 across, as it is flown out
    of turns by as much.  When they end it flies on as far inside."""
    turns_with_grid: bool = False
    """Whether it stops along a straight line of its own map's grid, though its speed is of true
    north there: the convergence of meridians turns it aside."""
    beside_m: float = 0.0
    """Of a plane: how much farther than the mission states its circle may reach from its last point
    when the setpoints end."""


COPTER = Handling(
    name="copter",
    eased=0.5,
    settling_s=1.0,
    lag_s=0.4,
    steady_m=0.2,
    turning_s2=0.85,
    turns_with_grid=True,
)
"""Where the autopilot is not known, the widest: as a PX4 multicopter is flown.

turning_s2: docs/lab/tracking.md, 0.43 m at 0.5 m/s2, 1.26 m at 1.3, 1.51 m at 2; lag_s: it is
up to 1.3 m/s faster than a point that brakes with 1.5 m/s2 (`scripts/bench kills`)."""
PLANE = Handling(name="plane", eased=1.0, settling_s=0.0, steady_m=0.0, turning_s2=0.0)
"""Its circle is proven about each point of the path, and its tracking is the mission's."""


class Envelope(NamedTuple):
    """The motion of a vehicle on a leg."""

    speed_m_s: float  # V: the reference point is nowhere faster
    braking_m_s2: float  # what the autopilot brakes with by itself, the point at high speed, too
    gaining_m_s2: float  # what the reference point gains speed with
    settling_s: float
    dead_man_s: float  # how long it flies on straight after the last setpoint, before it brakes
    overrun_m: float  # how far beyond the end of a leg it may come if the companion ends meanwhile
    climb_rate_m_s: float
    climb_angle_rad: float
    dive_angle_rad: float
    turn_radius_m: float
    lateral_m_s2: float  # the point takes no turn harder, so that the vehicle stays in its tube
    vertical_m_s2: float  # nor any bend upwards or downwards
    tube_m: float  # how far it may be from where it was told to be: across the path, past its end
    aside_m: float  # how far beside a straight dead-man stretch it may end, beyond its tube
    lag_m: float  # how far behind the point it may be: that waits for it when it is farther
    navigation_m: float  # how wrong its position may be
    lead_m: float  # of a plane: how far ahead along the path the point lies that it is sent to
    loiter_m: float  # of a plane: how far from its last point it may circle; 0: it hovers

    @property
    def error_m(self) -> float:
        """How far the vehicle may truly be from its path."""
        return self.tube_m + self.navigation_m

    @property
    def contact_m(self) -> float:
        """How far the vehicle may truly be from the stretch that it flies without setpoints."""
        return self.error_m + self.aside_m


def envelope_of(limits: Limits, handling: Handling, convergence_rad: float = 0.0) -> Envelope:
    """That of a mission.  Where it states less of a tube than was measured, the measured one.

    convergence_rad: by how much true north turns on the map, at most.
    """
    tube_m = max(limits.tracking_error_m, handling.steady_m)
    lateral = math.inf
    if handling.turning_s2 > 0.0:
        lateral = max(tube_m - handling.steady_m, 0.5 * tube_m) / handling.turning_s2
    if handling.leading_s2 > 0.0:
        lateral = min(lateral, tube_m / handling.leading_s2)
    motion = Envelope(
        speed_m_s=float(limits.speed_m_s),
        braking_m_s2=float(limits.acceleration_m_s2),
        gaining_m_s2=handling.eased * limits.acceleration_m_s2,
        settling_s=handling.settling_s,
        dead_man_s=limits.dead_man_s + handling.lag_s,
        overrun_m=float(limits.overrun_m),
        climb_rate_m_s=float(limits.climb_rate_m_s),
        climb_angle_rad=float(limits.climb_angle_rad),
        dive_angle_rad=float(limits.dive_angle_rad),
        turn_radius_m=float(max(limits.turn_radius_m, (SLOWEST * limits.speed_m_s) ** 2 / lateral)),
        lateral_m_s2=lateral,
        vertical_m_s2=RISES * limits.acceleration_m_s2 if limits.hovers else math.inf,
        tube_m=float(tube_m),
        aside_m=0.0,
        lag_m=float(max(_LAG_S * limits.speed_m_s, 2.0 * tube_m)),
        navigation_m=float(limits.navigation_error_m),
        lead_m=0.0 if limits.hovers else limits.speed_m_s * limits.lead_s,
        loiter_m=0.0 if limits.hovers else limits.loiter_radius_m + handling.beside_m,
    )
    if not limits.hovers:
        return motion
    turn_m_s2 = min(lateral, limits.speed_m_s**2 / limits.turn_radius_m)
    unwound_s = turn_m_s2 / (_JERKS_1_S * limits.acceleration_m_s2)
    turned_rad = 0.5 * turn_m_s2 * unwound_s / limits.speed_m_s  # the acceleration falls evenly
    turned_rad += convergence_rad * handling.turns_with_grid
    turned_m = turned_rad * flown_on_m(motion, motion.speed_m_s)
    inside_m = handling.leading_s2 * turn_m_s2 + handling.steady_m - tube_m
    return motion._replace(aside_m=turned_m + max(inside_m, 0.0))


def flown_on_m(it: Envelope, speed: float) -> float:
    """How far it comes when the setpoints end: it flies on, then brakes; a plane to its point."""
    if it.loiter_m > 0.0:
        return it.lead_m
    return speed * it.dead_man_s + speed * speed / (2.0 * it.braking_m_s2)


def slowed_m_s(room_m: float, braking_m_s2: float, delay_s: float) -> float:
    """The speed v with v delay + v^2 / 2a = room: the fastest that stops within it."""
    delay = braking_m_s2 * delay_s
    return math.sqrt(delay * delay + 2.0 * braking_m_s2 * max(room_m, 0.0)) - delay


def ending_m_s(it: Envelope, left_m: float) -> float:
    """The fastest that the reference point is so far before the end of a leg, where it stops."""
    eased = slowed_m_s(left_m, it.braking_m_s2, it.settling_s)
    alone = slowed_m_s(left_m + it.overrun_m, it.braking_m_s2, it.dead_man_s)
    return min(min(it.speed_m_s, eased), alone)


def rising_m_s(it: Envelope, flown_m: float) -> float:
    """The fastest that it is so far from where it has set out from rest."""
    return min(it.speed_m_s, math.sqrt(2.0 * it.gaining_m_s2 * max(flown_m, 0.0)))


def stopping_m(it: Envelope, speed: float) -> float:
    """How far the reference point moves while it stops, because it is told to."""
    if it.loiter_m > 0.0:
        return 0.0
    return speed * it.settling_s + speed * speed / (2.0 * it.braking_m_s2)


def slowing_m(it: Envelope, speed: float) -> float:
    """How far before the end of a leg it begins to slow down for it: `ending_m_s`, solved for."""
    return max(stopping_m(it, speed), flown_on_m(it, speed) - it.overrun_m)


def beyond_m(it: Envelope) -> float:
    """How far past the end of a leg any straight dead-man stretch ends: one from V."""
    return min(it.overrun_m, it.speed_m_s * max(it.dead_man_s - it.settling_s, 0.0))
