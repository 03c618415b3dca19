"""Vehicle traits: what the mission has to know of an autopilot and vehicle type (design section 4).

One value per autopilot and vehicle type, defined in `companion.mavlink.autopilots` beside the
message encoding.
"""

import enum
from dataclasses import dataclass, field
from typing import Final, final

from companion.path.envelope import COPTER, Handling
from companion.path.limits import VehicleKind


class TakeoffSequence(enum.Enum):
    """The take-off sequence of an autopilot."""

    GUIDED_THEN_CLIMB = "guided mode, arm, then the command to climb"
    MODE_THEN_ARM = "the take-off mode, then arm"
    CLIMB_THEN_ARM = "the command to climb, then arm"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleTraits:
    """Traits of one autopilot and vehicle type."""

    name: str
    """Display name: ArduCopter, ArduPlane, PX4 multicopter, PX4 fixed wing."""
    kind: VehicleKind
    """What flies: a copter hovers, a plane holds by loitering."""
    take_off: TakeoffSequence
    handling: Handling = COPTER
    """How it flies a stream of setpoints."""
    lead_s: float = 0.0
    """How far ahead of the reference point the setpoint lies."""
    setpoint_period_s: float = 0.0
    """Least time between two setpoints; 0: one for each position."""
    needs_setpoints_before_offboard: bool = False
    """Whether guided mode needs a running setpoint stream (OFFBOARD)."""
    holds_in_guided: bool = False
    """Whether it holds at its last setpoint in guided mode indefinitely."""
    lands: bool = True
    """Whether it has a mode to land in place."""

    hovers: bool = field(init=False)
    """Whether it can hover: asked for several times with each position."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "hovers", self.kind == "copter")


UNKNOWN: Final = VehicleTraits(name="", kind="copter", take_off=TakeoffSequence.GUIDED_THEN_CLIMB)
"""Before there is a vehicle."""
