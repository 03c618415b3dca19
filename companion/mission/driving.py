"""How a kind of vehicle is driven, as far as the mission has to know (design section 4).

One value per autopilot and vehicle kind.  How it is said, and what it is worth, stands in
`companion.mavlink.autopilots`, where these values are made.
"""

import enum
from dataclasses import dataclass
from typing import Final, final


class TakeOffWay(enum.Enum):
    """The order in which an autopilot wants to be sent up."""

    GUIDED_THEN_CLIMB = "guided mode, arm, then the command to climb"
    MODE_THEN_ARM = "the take-off mode, then arm"
    CLIMB_THEN_ARM = "the command to climb, then arm"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Driving:
    """What the mission has to know of one autopilot and kind of vehicle."""

    name: str
    """For people: ArduCopter, ArduPlane, PX4 multicopter, PX4 fixed wing."""
    hovers: bool
    """Whether it can stand still in the air; what cannot holds on circles."""
    take_off: TakeOffWay
    lead_s: float = 0.0
    """How far ahead of where the vehicle ought to be the point lies that it is sent to."""
    setpoint_period_s: float = 0.0
    """Least time between two setpoints; 0: one for each position."""
    streams_first: bool = False
    """Whether guided mode is only taken while setpoints are coming in already."""
    holds_in_guided: bool = False
    """Whether it stays at its last point, in guided mode, for as long as nobody says otherwise."""
    echoes: bool = True
    """Whether it tells, in guided mode, where it is being sent (POSITION_TARGET_*)."""
    lands: bool = True
    """Whether it can be told to land where it is."""


UNKNOWN: Final = Driving(name="", hovers=True, take_off=TakeOffWay.GUIDED_THEN_CLIMB)
"""Before there is a vehicle."""
