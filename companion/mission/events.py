"""The events of a mission and its commands: two closed unions.

Times are the vehicle's (seconds since its boot); positions and velocities are north, east,
up in the local frame, altitudes AMSL.
"""

import enum
from dataclasses import dataclass
from typing import final

from companion.mission.vehicle_traits import VehicleTraits
from companion.planner.request import PlanOutcome, PlanRequest
from companion.planner.settings import Task
from companion.world.known_map import Scan
from companion.world.near_map import NearMap, Sight
from companion.world.threats import Zone
from companion.world.traffic import Claim, Track

Vector = tuple[float, float, float]


class Mode(enum.Enum):
    """Flight modes that the companion distinguishes."""

    GUIDED = "guided"
    """Flies where the companion tells it (ArduPilot GUIDED, PX4 OFFBOARD)."""
    HOLD = "hold"
    """Stays, or circles, by itself (ArduCopter BRAKE, ArduPlane LOITER, PX4 AUTO.LOITER)."""
    LAND = "land"
    RETURN = "return"
    TAKE_OFF = "take off"
    OTHER = "other"


class Landed(enum.Enum):
    """Landed state of the autopilot (MAV_LANDED_STATE)."""

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
    failsafe: bool = False
    """Whether the autopilot reports a failsafe (MAV_STATE critical or emergency)."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleFound:
    """The autopilot is identified: its traits, or None if it is not supported."""

    time_s: float
    system_id: int
    traits: VehicleTraits | None
    name: str
    """Its autopilot and vehicle type, as text."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """The vehicle's reported position."""

    time_s: float
    position_nea_m: Vector
    velocity_nea_m_s: Vector
    heading_rad: float | None = None
    """Its heading in the local frame."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LandedState:
    """On the ground or in the air."""

    time_s: float
    landed: Landed


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TakeOffTaken:
    """The autopilot has accepted a take-off: it will begin."""

    time_s: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GpsFix:
    """Whether the receiver has a three-dimensional fix."""

    time_s: float
    good: bool


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Estimator:
    """Whether the autopilot's estimator reports a valid horizontal position."""

    time_s: float
    good: bool
    error_m: float | None = None
    """Horizontal accuracy, if reported."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Home:
    """The vehicle's home, whose altitude take-off heights are measured from."""

    time_s: float
    position_nea_m: Vector


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Where the autopilot's own local frame begins (GPS_GLOBAL_ORIGIN)."""

    time_s: float
    position_nea_m: Vector


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Echo:
    """The autopilot's reported target (POSITION_TARGET_*)."""

    time_s: float
    position_nea_m: Vector
    velocity_nea_m_s: Vector | None = None
    """Velocity of the target; None if not reported."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Battery:
    """What is left in the battery."""

    time_s: float
    remaining: float
    """Share of a full one, 0 to 1."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LinkDelay:
    """How long a message takes to the vehicle and back (TIMESYNC)."""

    time_s: float
    round_trip_s: float


class Item(enum.Enum):
    """Preparations that must be complete before a flight."""

    PARAMETERS = "parameters"
    PLANS = "fence, rally points and mission"
    CHECKS = "the checks before a flight"
    """On the ground only: link, radar, datum and everything else in `companion preflight`."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """One of the things to prepare is done, or refused."""

    time_s: float
    item: Item
    refusal: str = ""
    """Why the vehicle must not fly as it is: what, its value, the rule."""
    remedy: str = ""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FenceChanged:
    """The vehicle's complete fence, as of now."""

    time_s: float
    zones: tuple[Zone, ...]
    floor_amsl_m: float | None = None
    ceiling_amsl_m: float | None = None
    rally_ne_m: tuple[tuple[float, float], ...] = ()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TargetsChanged:
    """The targets of the vehicle's mission, if ours takes them from there."""

    time_s: float
    targets_ne_m: tuple[tuple[float, float], ...]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SettingsChanged:
    """Planner parameters were set: they apply from the next plan on."""

    time_s: float
    task: Task
    """As it is now, all of it."""
    what: str
    """For the journal and the operator: name = value."""


class OrderKind(enum.Enum):
    """Orders from a ground station in flight."""

    START = "start, or take over and go on"
    PAUSE = "pause"
    CONTINUE = "continue"
    REPOSITION = "go to a new target"
    SPEED = "change the speed"
    RETURN = "return"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A command to the companion from an authorised sender."""

    time_s: float
    kind: OrderKind
    target_ne_m: tuple[float, float] | None = None
    speed_m_s: float | None = None
    sender: str = ""
    """System and component, for the journal: "255/190"."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Rebooted:
    """The autopilot's clock has begun again."""

    time_s: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NearSeen:
    """The sensor of near things has looked around, or its silence means something else now."""

    time_s: float
    sight: Sight
    near: NearMap
    """As it is now: it changes with the next sweep, so it is not kept."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GroundSeen:
    """The downward rangefinder does not agree with the known map, or does again."""

    time_s: float
    above_m: float
    """So much higher is the ground than the map says, with several readings; 0: it agrees."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ScanDone:
    """The radar has answered as far as it will; cells answered of cells asked for."""

    time_s: float
    scan: Scan
    asked: int
    answered: int

    @property
    def is_partial(self) -> bool:
        """Whether the radar has answered, and left something out."""
        return 0 < self.answered < self.asked


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
    """A part of the companion (planner, reader, writer) has died: nothing is sent any more."""

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
class FenceBreach:
    """The autopilot says that the vehicle is where its own fence forbids it to be."""

    time_s: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class DuplicateId:
    """Another sender with the companion's ids was heard."""

    time_s: float
    certain: bool
    """Whether it has gone on for long enough to exclude frames left by a dead companion."""
    news: bool = False
    """Whether it is the first such event of this certainty."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class OthersHeard:
    """All that is known of others in the air, before a position."""

    time_s: float
    ours: int
    """Our system id."""
    tracks: tuple[Track, ...]
    claims: tuple[Claim, ...]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StopAsked:
    """The operator ends the mission now."""

    time_s: float


Event = (
    Tick
    | VehicleFound
    | VehicleStatus
    | Position
    | LandedState
    | TakeOffTaken
    | GpsFix
    | Estimator
    | Home
    | Origin
    | Echo
    | Battery
    | LinkDelay
    | Prepared
    | FenceChanged
    | TargetsChanged
    | SettingsChanged
    | Order
    | Rebooted
    | ScanDone
    | NearSeen
    | GroundSeen
    | PlanReady
    | PlanLate
    | PlannerDied
    | LinkLost
    | FenceBreach
    | DuplicateId
    | OthersHeard
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
    """Request the message streams that the mission needs."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SetMode:
    """Ask for a flight mode."""

    mode: Mode
    at_nea_m: Vector | None = None
    """Where to hold, for autopilots that support it."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """Ask the autopilot to arm."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TakeOff:
    """Ask for a climb, from where the vehicle stands, by its autopilot's own take-off."""

    above_home_m: float
    altitude_amsl_m: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SetSpeed:
    """Send the mission's speed to an autopilot that controls its own speed."""

    speed_m_s: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StartScan:
    """Ask the radar what is within range of a point."""

    centre_nea_m: Vector


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Compute the next subpath; the answer takes effect at due_s."""

    request: PlanRequest
    due_s: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Setpoint:
    """Position and velocity for now, with this yaw."""

    time_s: float
    position_nea_m: Vector
    velocity_nea_m_s: Vector
    yaw_rad: float
    stay: bool = False
    """Hold here: a plane loiters; for multicopters the velocity is zero."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ClaimWay:
    """Tell other vehicles of ours which straight stretch this one keeps to."""

    time_s: float
    begin_nea_m: Vector
    end_nea_m: Vector


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StatusText:
    """A short text to ground stations and the terminal."""

    text: str
    warning: bool = False
    about: str = ""
    """Topic: a newer text replaces a queued one of the same topic."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class End:
    """The mission is over."""

    outcome: Outcome
    reason: str
    remedy: str


Command = (
    RequestStreams
    | SetMode
    | Arm
    | TakeOff
    | SetSpeed
    | StartScan
    | Plan
    | Setpoint
    | ClaimWay
    | StatusText
    | End
)
