"""All that can happen to a mission, and all that it can ask for.  Two closed unions.

Times are the vehicle's (seconds since its boot); positions and velocities are north, east,
up in the local frame, altitudes AMSL.
"""

import enum
from dataclasses import dataclass
from typing import final

from companion.planner.request import PlanOutcome, PlanRequest
from companion.world.known_map import Scan

Vector = tuple[float, float, float]


class Mode(enum.Enum):
    """Flight modes, as far as the companion tells them apart."""

    GUIDED = "guided"
    HOLD = "hold"
    LAND = "land"
    OTHER = "other"


class Landed(enum.Enum):
    """Where the autopilot thinks it is (MAV_LANDED_STATE)."""

    UNKNOWN = "unknown"
    ON_GROUND = "on ground"
    IN_AIR = "in air"
    TAKING_OFF = "taking off"
    LANDING = "landing"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Tick:
    """The vehicle's clock moved on."""

    time_s: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleStatus:
    """A heartbeat of the autopilot."""

    time_s: float
    mode: Mode
    armed: bool
    fits: bool = True
    """Whether it is the kind of vehicle that the mission is for."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """Where the vehicle says it is."""

    time_s: float
    position_nea_m: Vector
    velocity_nea_m_s: Vector


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LandedState:
    """On the ground or in the air."""

    time_s: float
    landed: Landed


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GpsFix:
    """Whether the receiver has a three-dimensional fix."""

    time_s: float
    good: bool


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Estimator:
    """Whether the autopilot's estimator vouches for the horizontal position."""

    time_s: float
    good: bool


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Home:
    """The vehicle's home altitude, which take-off heights are measured from."""

    time_s: float
    altitude_amsl_m: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ScanDone:
    """The radar has answered as far as it will; cells answered of cells asked for."""

    time_s: float
    scan: Scan
    asked: int
    answered: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlanReady:
    """The answer to a plan request, at the time when it was due or later."""

    time_s: float
    outcome: PlanOutcome


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlanLate:
    """A plan was due and is still being computed (real time only)."""

    time_s: float
    plan_id: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlannerDied:
    """The planner raised an exception: nothing will be planned any more."""

    time_s: float
    error: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LinkLost:
    """Nothing has been heard of the vehicle for a while."""

    time_s: float
    silent_s: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StopAsked:
    """A person wants the mission to end now."""

    time_s: float


Event = (
    Tick
    | VehicleStatus
    | Position
    | LandedState
    | GpsFix
    | Estimator
    | Home
    | ScanDone
    | PlanReady
    | PlanLate
    | PlannerDied
    | LinkLost
    | StopAsked
)


class Outcome(enum.Enum):
    """How a mission ends."""

    ARRIVED = "arrived"
    FAILED = "failed"
    STOPPED = "stopped"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RequestStreams:
    """Ask the autopilot for the messages that the mission needs."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SetMode:
    """Ask for a flight mode."""

    mode: Mode


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """Ask the autopilot to arm."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TakeOff:
    """Ask for a climb to a height above home."""

    above_home_m: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StartScan:
    """Ask the radar what is within range of a point."""

    centre_nea_m: Vector


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Have the next subpath computed; the answer counts from due_s on."""

    request: PlanRequest
    due_s: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Setpoint:
    """Be here now, at this velocity, with the nose along yaw."""

    time_s: float
    position_nea_m: Vector
    velocity_nea_m_s: Vector
    yaw_rad: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Say:
    """A short text for whoever watches the vehicle."""

    text: str
    warning: bool = False


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class End:
    """The mission is over."""

    outcome: Outcome
    reason: str
    remedy: str


Command = RequestStreams | SetMode | Arm | TakeOff | StartScan | Plan | Setpoint | Say | End
