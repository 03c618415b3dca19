"""The events of a mission, derived from `Event`, and its commands, from `Command`: all are final.

Times are the vehicle's (seconds since its boot); positions and velocities are north, east,
up in the local frame, altitudes AMSL.  Those with a tag are entries of the journal as they are.
"""

import enum
import math
from abc import ABC
from typing import TYPE_CHECKING

from msgspec import Struct, field

from companion.mission.vehicle_traits import VehicleTraits
from companion.planner.request import PlanOutcome, PlanRequest
from companion.world.known_map import Scan
from companion.world.near_map import NearMap, Sight
from companion.world.zones import CircleZone, PolygonZone, Zone

if TYPE_CHECKING:
    AnyZone = Zone
else:

    class AnyZone(ABC):  # noqa: B024 - asked for nothing but whose instance a zone is
        """Both of them: `msgspec` cannot tell two dataclasses apart, `journal.entry_of` does."""

    AnyZone.register(CircleZone)
    AnyZone.register(PolygonZone)

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


class Event(Struct, frozen=True, kw_only=True):
    """What happened, and when."""

    time_s: float = field(name="t_s")
    """Vehicle time: seconds since its boot (until its clock is known, since the start)."""


class Entry(Event, frozen=True, kw_only=True, tag_field="kind"):
    """What stands in the journal, in these words (`journal`).

    Names carry units; `_nea_m` is north, east (of the mission's local frame) and altitude AMSL.
    """

    @property
    def kind(self) -> str:
        """The name of its kind in the file."""
        return str(self.__struct_config__.tag)

    @property
    def t_s(self) -> float:
        """Its time, as the file calls it."""
        return self.time_s


class Tick(Event, frozen=True, kw_only=True):
    """The vehicle's clock moved on."""


class VehicleStatus(Event, frozen=True, kw_only=True):
    """A heartbeat of the autopilot."""

    mode: Mode
    armed: bool
    failsafe: bool = False
    """Whether the autopilot reports a failsafe (MAV_STATE critical or emergency)."""


class VehicleFound(Event, frozen=True, kw_only=True):
    """The autopilot is identified: its traits, or None if it is not supported."""

    system_id: int
    traits: VehicleTraits | None
    name: str
    """Its autopilot and vehicle type, as text."""


class Position(Event, frozen=True, kw_only=True):
    """The vehicle's reported position."""

    position_nea_m: Vector
    velocity_nea_m_s: Vector
    heading_rad: float | None = None
    """Its heading in the local frame."""


class LandedState(Event, frozen=True, kw_only=True):
    """On the ground or in the air."""

    landed: Landed


class TakeOffTaken(Event, frozen=True, kw_only=True):
    """The autopilot has accepted a take-off: it will begin."""


class GpsFix(Event, frozen=True, kw_only=True):
    """Whether the receiver has a three-dimensional fix."""

    good: bool


class Estimator(Event, frozen=True, kw_only=True):
    """Whether the autopilot's estimator reports a valid horizontal position."""

    good: bool
    error_m: float | None = None
    """Horizontal accuracy, if reported."""


class Home(Event, frozen=True, kw_only=True):
    """The vehicle's home, whose altitude take-off heights are measured from."""

    position_nea_m: Vector


class Origin(Event, frozen=True, kw_only=True):
    """Where the autopilot's own local frame begins (GPS_GLOBAL_ORIGIN)."""

    position_nea_m: Vector


class Echo(Event, frozen=True, kw_only=True):
    """The autopilot's reported target (POSITION_TARGET_*)."""

    position_nea_m: Vector
    velocity_nea_m_s: Vector | None = None
    """Velocity of the target; None if not reported."""


class Battery(Event, frozen=True, kw_only=True):
    """What is left in the battery."""

    remaining: float
    """Share of a full one, 0 to 1."""


class Item(enum.Enum):
    """Preparations that must be complete before a flight."""

    PARAMETERS = "parameters"
    PLANS = "fence, rally points and mission"
    CHECKS = "the checks before a flight"
    """On the ground only: link, radar, datum and everything else in `companion preflight`."""


class Prepared(Entry, frozen=True, kw_only=True, tag="prepared"):
    """One of the preparations before a flight is complete, or refused."""

    item: Item
    """What."""
    refusal: str = ""
    """Why the flight is refused, what, its value, the rule; empty if it is not."""
    remedy: str = ""


class FenceChanged(Entry, frozen=True, kw_only=True, tag="fence"):
    """The vehicle's complete fence, as of now."""

    zones: tuple[AnyZone, ...]
    """Circles and polygons."""
    floor_amsl_m: float | None = None
    """Minimum altitude; null if the fence has none."""
    ceiling_amsl_m: float | None = None
    """Maximum altitude; null if the fence has none."""
    misread: bool = False
    """Whether the autopilot itself misreads it, so that it may act where no zone is."""


class FenceReading(Event, frozen=True, kw_only=True):
    """The vehicle's fence has changed and is being read, or it is not any more."""

    items: int
    """How many it has; 0: what counts is known again."""


class TargetsChanged(Entry, frozen=True, kw_only=True, tag="targets"):
    """The targets from now on, from the vehicle's mission."""

    targets_ne_m: tuple[tuple[float, float], ...]
    """In the order in which they are flown to."""


class OrderKind(enum.Enum):
    """Orders from a ground station in flight."""

    START = "start, or take over and go on"
    PAUSE = "pause"
    CONTINUE = "continue"
    REPOSITION = "go to a new target"
    RETURN = "return"
    LAND = "land where it is"


class Order(Event, frozen=True, kw_only=True):
    """A command to the companion from an authorised sender."""

    kind: OrderKind
    target_ne_m: tuple[float, float] | None = None
    """Where to (REPOSITION)."""
    sender: str = ""
    """System and component, for the journal: "255/190"."""


class Rebooted(Entry, frozen=True, kw_only=True, tag="vehicle rebooted"):
    """The autopilot's clock has begun again, and with it `t_s`."""


class NearSeen(Event, frozen=True, kw_only=True):
    """The sensor of near things has looked around, or its silence means something else now."""

    sight: Sight
    near: NearMap
    """As it is now: it changes with the next sweep, so it is not kept."""
    sees_m: float = math.inf
    """How far the sensor says it sees; inf: it did not say."""


class GroundSeen(Event, frozen=True, kw_only=True):
    """The downward rangefinder does not agree with the known map, or does again."""

    above_m: float
    """So much higher is the ground than the map says, with several readings; 0: it agrees."""


class ScanDone(Event, frozen=True, kw_only=True):
    """The radar has answered as far as it will; cells answered of cells asked for."""

    scan: Scan
    asked: int
    answered: int

    @property
    def is_partial(self) -> bool:
        """Whether the radar has answered, and left something out."""
        return 0 < self.answered < self.asked


class PlanReady(Event, frozen=True, kw_only=True):
    """The answer to a plan request, at the time when it was due or later."""

    outcome: PlanOutcome


class PlanLate(Entry, frozen=True, kw_only=True, tag="plan late"):
    """A plan was due and not ready (real time only)."""

    plan_id: int
    """Of the request."""


class PlannerDied(Entry, frozen=True, kw_only=True, tag="part died", omit_defaults=True):
    """A part of the companion has died; may be noted twice, by session and watchdog."""

    error: str
    """What it died of."""
    part: str | None = None
    """Its name; by the watchdog only."""
    hold_frames: int | None = None
    """Number of frames sent to hold the vehicle; by the watchdog only."""


class LinkLost(Entry, frozen=True, kw_only=True, tag="link lost"):
    """The vehicle was silent for a while."""

    silent_s: float
    """For how long."""


class FenceBreach(Event, frozen=True, kw_only=True):
    """The autopilot says that the vehicle is where its own fence forbids it to be."""


class DuplicateId(Event, frozen=True, kw_only=True):
    """Another sender with the companion's ids was heard."""

    certain: bool
    """Whether it has gone on for long enough to exclude frames left by a dead companion."""
    news: bool = False
    """Whether it is the first such event of this certainty."""


class StopAsked(Entry, frozen=True, kw_only=True, tag="stop asked"):
    """The operator has ended the mission."""


class Outcome(enum.Enum):
    """How a mission ends."""

    ARRIVED = "arrived"
    FAILED = "failed"
    STOPPED = "stopped"


class Command(Entry, frozen=True, kw_only=True):
    """What is to be done: by the vehicle, the radar, the planner, or for people."""

    time_s: float = field(name="t_s", default=0.0)
    """When it was asked, as it stands in the journal."""


class RequestStreams(Command, frozen=True, kw_only=True):
    """Request the message streams that the mission needs."""


class SetMode(Command, frozen=True, kw_only=True, tag="set mode", omit_defaults=True):
    """A mode change was requested from the autopilot."""

    mode: Mode
    """The companion's name of it."""
    at_nea_m: Vector | None = None
    """Where to hold, for autopilots that support it; left out: where it is."""


class Arm(Command, frozen=True, kw_only=True, tag="arm"):
    """Arming was requested from the autopilot."""


class Disarm(Command, frozen=True, kw_only=True, tag="disarm"):
    """Disarming was requested from the autopilot, which refuses in the air."""


class TakeOff(Command, frozen=True, kw_only=True, tag="take off"):
    """A take-off was requested from the autopilot: a climb from where the vehicle stands."""

    above_home_m: float
    """To this height."""
    altitude_amsl_m: float = 0.0


class SetSpeed(Command, frozen=True, kw_only=True):
    """Send the mission's speed to an autopilot that controls its own speed."""

    speed_m_s: float


class StartScan(Command, frozen=True, kw_only=True):
    """Ask the radar what is within range of a point."""

    centre_nea_m: Vector


class Plan(Command, frozen=True, kw_only=True):
    """Compute the next subpath; the answer takes effect at due_s."""

    request: PlanRequest
    due_s: float


class Setpoint(Command, frozen=True, kw_only=True):
    """Position and velocity for now, with this yaw."""

    position_nea_m: Vector
    velocity_nea_m_s: Vector
    yaw_rad: float
    stay: bool = False
    """Hold here: a plane loiters; for multicopters the velocity is zero."""


class StatusText(Command, frozen=True, kw_only=True, tag="say"):
    """A text to ground stations and the terminal."""

    text: str
    """In words."""
    warning: bool = False
    """Whether it is a warning."""
    about: str = ""
    """Topic: a newer text replaces a queued one of the same topic."""


class End(Command, frozen=True, kw_only=True, tag="end"):
    """The mission is over."""

    outcome: Outcome
    """How it has ended."""
    reason: str
    """Why."""
    remedy: str = ""
