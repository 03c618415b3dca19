"""Phases, transitions and the state of a mission.

`machine.step` copies the state, and the handlers change that copy in place; nobody else does.
"""

import dataclasses
import enum
import math
from typing import ClassVar, Final, final

from msgspec import Struct, field

from companion.mission.events import FenceChanged, Item, Landed, Mode, Setpoint, Vector
from companion.mission.mission import Mission
from companion.mission.vehicle_traits import UNKNOWN, VehicleTraits
from companion.planner.join import Offset
from companion.planner.procedure import Leg, Reference
from companion.planner.progress import NO_PROGRESS, Progress
from companion.planner.request import FlownSegment, Refusal
from companion.planner.settings import Task
from companion.world.known_map import KnownMap
from companion.world.near_map import Sight

HEARTBEAT_S = 5.0  # four or five of them missed (mavlink.md 2.1)
_GROUNDED_S = 1.5
_SUSPECT_S = 2.5  # another companion with our ids may have died meanwhile
_THERE_S = 5.0
_SECOND_S = 5.0  # who hears another so soon after it took over has not been there first

Targets = tuple[tuple[float, float], ...]
"""North and east of each."""


class Phase(enum.Enum):
    """Phase of a mission (design section 7)."""

    WAITING = "waiting"
    PREPARING = "preparing"
    READY = "ready"
    ARMING = "arming"
    TAKING_OFF = "taking off"
    FLYING = "flying"
    HOLDING = "holding"
    ARRIVED = "arrived"
    LANDING = "landing"
    RETURNING = "returning"
    HANDING_OVER = "handing over"
    SHADOW = "shadow"
    DONE = "done"
    FAULTED = "faulted"
    __hash__ = object.__hash__  # Enum's is slow, and asked for with every event


ON_GROUND = (Phase.WAITING, Phase.PREPARING, Phase.READY, Phase.ARMING)
IN_AIR = (
    Phase.TAKING_OFF,
    Phase.FLYING,
    Phase.HOLDING,
    Phase.ARRIVED,
    Phase.RETURNING,
    Phase.LANDING,
    Phase.HANDING_OVER,
)
ON_PATH = (Phase.FLYING, Phase.RETURNING)
OVER = (Phase.DONE, Phase.FAULTED)
_LED = tuple(phase for phase in IN_AIR if phase not in (Phase.HOLDING, Phase.HANDING_OVER))
_ALL = (*ON_GROUND, *IN_AIR, Phase.SHADOW)
_HELD = (Phase.ARRIVED, Phase.HOLDING, Phase.RETURNING)
_LANDS_FROM = (Phase.PREPARING, Phase.TAKING_OFF, Phase.FLYING, *_HELD, Phase.HANDING_OVER)
_HANDS_OVER = (Phase.PREPARING, *_LED, Phase.HOLDING)


class Trigger(enum.Enum):
    """The transition table: what has happened, in which phases it counts, and the phase after."""

    VEHICLE_FOUND = ("the vehicle's heartbeat was heard", Phase.WAITING, Phase.PREPARING)
    READY = ("all that the take-off needs is there, on the ground", Phase.PREPARING, Phase.READY)
    GO = ("somebody says go, or has (--start)", (Phase.PREPARING, Phase.READY), Phase.ARMING)
    UNREADY = ("a check fails while it waits for that", Phase.READY, Phase.PREPARING)
    IN_FLIGHT = ("ready, but in the air: it is taken over", Phase.PREPARING, Phase.HOLDING)
    TAKE_OVER = ("it still flies the path of the last companion", Phase.PREPARING, Phase.FLYING)
    WATCH = ("the vehicle is known, and only to be watched", Phase.PREPARING, Phase.SHADOW)
    ARMED = ("armed, in the mode its take-off begins with", Phase.ARMING, Phase.TAKING_OFF)
    AIRBORNE = ("at the floor of the band, in guided mode", Phase.TAKING_OFF, Phase.FLYING)
    HANDED_OVER = ("there, where its autopilot holds it", Phase.TAKING_OFF, Phase.HOLDING)
    TARGET_REACHED = ("the last leg was flown to its end", Phase.FLYING, Phase.ARRIVED)
    NEXT_TARGET = ("stopped at a target that is not the last", Phase.ARRIVED, Phase.FLYING)
    END_HOLD = ("stopped at the last target, in the hold mode", Phase.ARRIVED, Phase.DONE)
    END_LAND = (
        "at the last target, at home or where told: told to land",
        _LANDS_FROM,
        Phase.LANDING,
    )
    BACKTRACK = (
        "told to return on the flown path",
        (Phase.ARRIVED, Phase.HOLDING),
        Phase.RETURNING,
    )
    HAND_OVER = ("no way back of ours is left: its autopilot's", _HANDS_OVER, Phase.HANDING_OVER)
    HANDED_ON = ("its autopilot returns by itself", Phase.HANDING_OVER, Phase.DONE)
    LANDED = ("on the ground, disarmed", (Phase.PREPARING, Phase.LANDING), Phase.DONE)
    FAULT = ("it cannot go on; the reason says why", (Phase.ARMING, *_LED), Phase.HOLDING)
    RESUME = ("the reason for holding is gone, or another try is due", _HELD, Phase.FLYING)
    PREPARE_AGAIN = ("heard again after a silence, or rebooted", _ALL[1:], Phase.PREPARING)
    GIVE_UP = ("no way to go on: somebody else brings it down", _ALL, Phase.DONE)
    DIED = ("a part of the companion died", _ALL, Phase.FAULTED)
    STOP = ("a person asked for the end", _ALL, Phase.DONE)

    def __init__(self, when: str, origins: Phase | tuple[Phase, ...], after: Phase) -> None:
        self.when = when
        """What has happened."""
        self.origins = origins if isinstance(origins, tuple) else (origins,)
        """The phases that it ends; in any other it changes nothing."""
        self.after = after
        """The phase that it begins."""


class Hold(enum.Enum):
    """How a vehicle is held; each reason has one of them."""

    REPLAN = "by setpoints; planning is retried after a pause, a limited number of times"
    PAUSED = "by setpoints, until another order or a low battery"
    RETURN = "by setpoints, until the backtrack is proven"
    LAND = "by setpoints until it is at rest, then it lands"
    MODE = "the autopilot's hold mode, until it is at rest and its position was valid for a while"
    TAKE_OVER = "in its current mode if that stops it; then like mode"
    STREAM_LOST = (
        "the autopilot holds for lack of setpoints: a new stream returns it to guided mode"
    )
    TAKEN_OVER = "not by us: taken over by a pilot or the autopilot, until handed back"
    GROUNDED = "not by us: reported disarmed, or on the ground"
    SILENT = "not by us: the vehicle is silent"


ON_SETPOINTS = (Hold.REPLAN, Hold.PAUSED, Hold.RETURN, Hold.LAND)
"""Holds with a valid position."""


class Reason(enum.Enum):
    """Why a mission holds or ends, and the remedy."""

    NO_VEHICLE = ("no vehicle was heard", "Start it, or check --connect.")
    WRONG_VEHICLE = (
        "the vehicle is none that this mission is for",
        "Check --connect, and vehicle.kind and vehicle.autopilot of the mission.",
    )
    NOT_READY = ("the vehicle did not get ready to fly", "See its messages for what it waits for.")
    REFUSED = ("the vehicle must not fly as it is set up", "Change what the last line names.")
    NO_TARGETS = ("the vehicle has no mission with waypoints", "Upload one, then start again.")
    BATTERY_SHORT = (
        "the battery does not reach the target and the reserve",
        "Charge it, or move the target.",
    )
    NOT_ARMED = ("the vehicle would not arm", "See its messages for the reason.")
    OUTSIDE = ("the vehicle stands off the map or at a zone's edge", "Check origin and area.")
    HOME_TOO_HIGH = ("home lies above the floor of the band", "Raise altitude.floor_amsl_m.")
    NO_TAKE_OFF = ("the vehicle did not reach the floor of the band", "Check its climb rate.")
    TAKING_OVER = ("taking over", "Wait: it stops first.", Hold.TAKE_OVER, False)
    TAKEN_OFF = ("taken off", "Wait: guided mode comes next.", Hold.TAKE_OVER, False)
    BROKEN_OFF = ("the take-off is broken off", "Wait: it stops first.", Hold.MODE, False)
    POSITION_STALE = ("no position for 0.5 s", "Wait for the vehicle's position to come back.")
    POSITION_FROZEN = ("the position stands still while the speed does not", "Check the GPS.")
    POSITION_JUMPED = ("the position jumped further than the vehicle can fly", "Check the GPS.")
    POSITION_ELSEWHERE = (
        "the position is not where its speeds lead",
        "Check the GPS: it is believed once it agrees, or after 60 s without another jump.",
    )
    NO_FIX = ("the GPS fix is lost", "Wait for the fix to come back.")
    ESTIMATOR = ("the autopilot does not vouch for its position", "Check the vehicle's GPS.")
    INACCURATE = (
        "the position is less accurate than the mission allows",
        "Wait, or raise vehicle.navigation_error_m.",
    )
    LINK_LOST = ("the vehicle fell silent", "Check the link and the vehicle.", Hold.SILENT)
    NOT_ALONE = (
        "another companion with our ids is on the link",
        "End one of the two; each vehicle has one, by its own system id.",
    )
    REBOOTED = ("the autopilot has rebooted", "Look at the vehicle before it flies again.")
    ARMED_ALREADY = ("somebody else has armed the vehicle", "Disarm it, then start again.")
    STREAM_LOST = (
        "the autopilot has lost the setpoints",
        "Check the link; it goes on by itself.",
        Hold.STREAM_LOST,
    )
    HEALTH_SILENT = (
        "no word of how good the position is",
        "Check the link, and who changes message rates.",
    )
    MODE_TAKEN = (
        "somebody else flies the vehicle",
        "Give it back: guided mode, or the command MISSION_START to the companion.",
        Hold.TAKEN_OVER,
    )
    FAILSAFE = (
        "the autopilot's own failsafe took the vehicle",
        "See its messages; when that is over, give it back: guided mode, or MISSION_START.",
        Hold.TAKEN_OVER,
    )
    FENCE_BREACHED = (
        "the vehicle's own fence stopped it",
        "Change its fence, or give it back (guided mode, or MISSION_START) to be led out of it.",
        Hold.TAKEN_OVER,
    )
    DISARMED = ("the vehicle disarmed", "See its messages for the reason.", Hold.GROUNDED)
    GROUNDED = ("the vehicle is on the ground", "Look at it before it flies again.", Hold.GROUNDED)
    BESIDE_PATH = (
        "the vehicle was beside its path",
        "Raise vehicle.tracking_error_m or fly slower.",
        Hold.REPLAN,
    )
    OFF_PATH = ("the vehicle left its path", "Raise vehicle.tracking_error_m or fly slower.")
    NOT_FOLLOWING = ("the vehicle does not follow its setpoints", "Check that it can fly them.")
    NOT_TAKEN = ("the autopilot does not take the setpoints", "See its messages for the reason.")
    NOT_OBEYING = ("the vehicle did not take the mode asked for", "Take over by hand.")
    SENSOR_SILENT = (
        "the sensor of near things is silent",
        "Check it, its driver and its link.",
        Hold.REPLAN,
    )
    GROUND_NEARER = (
        "the ground is nearer than the map says",
        "Check map, altitude datum and rangefinder.",
        Hold.REPLAN,
    )
    RADAR_SILENT = ("the terrain radar did not answer", "Check the radar.", Hold.REPLAN)
    NO_PLAN = ("no safe subpath was found", "Relax the mission's planner settings.", Hold.REPLAN)
    PLAN_LATE = (
        "the next subpath was not ready in time",
        "Raise planner.planning_time_s, or use a faster computer.",
        Hold.REPLAN,
    )
    NEW_THREAT = ("a new threat lies on the path", "Wait for the way round it.", Hold.REPLAN)
    FENCE_UNREAD = (
        "the vehicle's fence has changed and is being read",
        "Wait until it is read; from_vehicle.goes_on_while_reading lets it fly on.",
        Hold.REPLAN,
    )
    NEW_TARGET = ("a new target was given", "Wait for the way to it.", Hold.REPLAN, False)
    CONTINUED = ("told to go on while it still stopped", "Wait for the way on.", Hold.REPLAN, False)
    PAUSED = ("paused by a person", "Send the command to continue.", Hold.PAUSED, False)
    RETURN_ASKED = ("told to return", "Wait until it has landed.", Hold.RETURN)
    LAND_ASKED = ("told to land", "Wait until it has landed.", Hold.LAND, False)
    BATTERY_LOW = (
        "the battery will not reach the target and the reserve",
        "Bring the vehicle down.",
        Hold.RETURN,
    )
    PLANNER_DIED = (
        "a part of the companion stopped with an error",
        "Report the error in the journal.",
    )
    STOPPED = ("stopped by a person", "Start again to fly on.")

    def __init__(self, text: str, remedy: str, hold: Hold = Hold.MODE, warns: bool = True) -> None:
        self.text = text
        """What happened."""
        self.remedy = remedy
        """What to do about it."""
        self.hold = hold
        """How a vehicle is held for this reason."""
        self.warns = warns
        """Whether it is a fault."""


@final
class Vehicle(Struct, kw_only=True):
    """The vehicle's reports."""

    traits: VehicleTraits = UNKNOWN
    mode: Mode | None = None
    armed: bool = False
    status_at_s: float = -1e9
    """When its heartbeat was heard last."""
    failsafe: bool = False
    fence_breached_at_s: float = -1e9
    """When it last reported a breach of its fence."""
    landed: Landed = Landed.UNKNOWN
    landed_at_s: float = -1e9
    """Since when."""
    take_off_taken_at_s: float = -1e9
    """When it last accepted a take-off."""
    home_nea_m: Vector | None = None
    home_kept: bool = False
    """Whether its autopilot has rebooted in the air: what it calls home since then is none."""
    fix_good: bool = False
    fix_at_s: float = -1e9
    estimator_good: bool = False
    estimator_at_s: float = -1e9
    """When these were last reported."""
    estimator_failed_at_s: float = -1e9
    """When it last went bad."""
    error_m: float | None = None
    """Reported horizontal accuracy."""
    battery: float | None = None
    """Share that is left."""
    battery_at_s: float = -1e9
    """When it was last heard of."""
    battery_short_at_s: float | None = None
    """Since when all reports say that it will not last; None: it will."""
    battery_full: tuple[float, float] | None = None
    """Time of the first report in the air, and the charge then."""
    round_trip_s: float = 0.0
    """Of the link."""
    echo_nea_m: Vector | None = None
    echo_nea_m_s: Vector | None = None
    """The velocity of its target."""
    echo_at_s: float = -1e9
    position_nea_m: Vector | None = None
    velocity_nea_m_s: Vector = (0.0, 0.0, 0.0)
    heading_rad: float | None = None
    position_at_s: float = -1e9
    position_step_s: float = 0.0
    """Time between the last two positions."""
    moved_at_s: float = -1e9
    """When the horizontal position last differed from the one before."""
    jumped_at_s: float = -1e9
    """When the position last changed by more than the vehicle can fly."""
    bad_at_s: float = 0.0
    """When the position was last invalid, for any reason."""
    distrust: Reason | None = None
    """Why it is invalid now (`health.distrust`); None: it is valid."""
    last_distrust: Reason | None = None
    """Why it was invalid at `bad_at_s`; None: it never was."""
    doubted_at_s: float = -1e9
    """When it was last invalid for another reason than its place."""
    sight: Sight = Sight.NEVER_HEARD
    """Of its sensor of near things, if the mission has one."""
    sees_m: float = math.inf
    """The least range that this has told of in the air."""
    ground_above_m: float = 0.0
    """How much higher than on the map its rangefinder has seen the ground, last; 0: it is not."""
    believed_at_s: float = -1e9
    """When a valid position came that followed another valid one."""
    astray_ne_m: tuple[float, float] = (0.0, 0.0)
    """Its deviation since then from the position predicted by the reported velocities."""
    blind_s: float = 0.0
    """How long since then no source has confirmed it, until it jumped."""


@final
class Scanning(Struct, frozen=True):
    """A scan around a place was requested; a plan follows."""

    from_nea_m: Vector
    again: int = 0
    """Scans repeated from here because the answer was incomplete."""


@final
class Planning(Struct, frozen=True):
    """The newest plan was requested, or a backtrack as such."""

    rules: Task
    """The task of the request."""
    since_s: float = 0.0


@final
class Answered(Struct, frozen=True):
    """The answer is there: a successor, or this leg is flown to its end."""


Search = Scanning | Planning | Answered
"""Progress of the search for the next leg."""


class Way(enum.Enum):
    """Where a flight goes."""

    OUT = "to the targets"
    BACK = "along the flown path"
    HOME = "home, planned to like a target: the flown path does not lead there, or is too far away"


@final
class Stop(Struct, frozen=True):
    """Where to stop before the end of the leg."""

    at_m: float
    """Length along the leg."""
    reason: Reason


@final
class OnPath(Struct, kw_only=True):
    """The leg that is flown, and where on it the vehicle is led."""

    leg: Leg
    reference: Reference = field(default_factory=Reference)
    next_leg: Leg | None = None
    joined_m: float = 0.0
    """Length along the leg at which it was begun."""
    circling: bool = False
    """Whether a plane still loiters at its start."""
    offset: Offset | None = None
    """Between the path and where the vehicle is led: after a restart it decays."""
    stop: Stop | None = None
    outside_since_s: float = math.inf
    """Since when the vehicle has been outside of the tube that was proven; inf: it is inside."""
    outside_m: float = 0.0
    """How far outside it was then."""


@final
class Flight(Struct, kw_only=True):
    """How far the mission has come, whatever the phase."""

    known: KnownMap
    target: int = 0
    hover_nea_m: Vector | None = None
    """Where to hold while there is no leg."""
    loiter_checked: tuple[Task, Vector] | None = None
    """Rules and hold position of the last look at the zones about a plane's circle."""
    plan_id: int = 0
    """Of the newest plan request."""
    route_ne_m: tuple[tuple[float, float], ...] = ()
    """The route to the target of the newest plan."""
    progress: Progress = NO_PROGRESS
    """Towards the target, as of that plan."""
    refusal: Refusal | None = None
    """Why there is no plan, in the planner's own words."""
    broken: tuple[str, ...] = ()
    """Which bounds the best candidate of the newest plan broke, if there is none."""
    failures: int = 0
    """Failed attempts in a row, from rest."""
    legs_flown: int = 0
    stops: int = 0
    """How often the vehicle has stopped at the end of a leg that was not the last."""
    departures: int = 0
    """How often the vehicle was told to hold for having left its path, or not followed it."""
    troubles: int = 0
    """Holds for its position or another fault since the last completed leg."""
    sent: Setpoint | None = None
    """The last setpoint."""
    sent_at_s: float = -1e9
    flown: tuple[FlownSegment, ...] = ()
    """The flown path, for the backtrack."""
    way: Way = Way.OUT
    back: tuple[Leg, ...] = ()
    """What is left of the backtrack, beside the legs that are flown."""
    battery_told: int = 0
    """Battery warnings sent: 1, it will not last at this rate; 2, it does not last."""
    fallen_back: Reason | None = None
    """Why the mission was given up for its fallback; None: it was not."""
    refused_modes: frozenset[Mode] = frozenset()
    """Modes requested to bring the vehicle down that it did not take."""

    @property
    def returning(self) -> bool:
        """Whether it follows the backtrack."""
        return self.way is Way.BACK

    @property
    def homeward(self) -> bool:
        """Whether a path home is planned."""
        return self.way is Way.HOME


# --- the phases: what lives only in one of them ends with it


class Stage(Struct, kw_only=True):
    """A phase, with what each of them knows."""

    phase: ClassVar[Phase]
    since_s: float = 0.0
    """When it began."""
    asked_at_s: float = -1e9
    """When the vehicle was last asked for something."""
    asks: int = 0
    """How often."""


class Inherited(Stage, kw_only=True):
    """Before control: what was left by the previous companion, or before a reboot."""

    path: OnPath | None = None
    """The path that it flew."""
    landing: bool = False
    """Whether the vehicle was being landed."""
    sank: bool = False
    """Whether it had taken the land mode then: leaving it was a pilot's decision."""


@final
class Waiting(Inherited, kw_only=True):
    """For a vehicle."""

    phase = Phase.WAITING
    news: str = ""
    """Text to send once there is one: what could not be restored."""


@final
class Preparing(Inherited, kw_only=True):
    """On the ground or in the air."""

    phase = Phase.PREPARING
    unready: str = ""
    """Why it is not ready any more, having waited for a go; empty: it has not."""


@final
class Ready(Stage, kw_only=True):
    """Waits for a go."""

    phase = Phase.READY


@final
class Arming(Stage, kw_only=True):
    """And the mode that the take-off begins with."""

    phase = Phase.ARMING
    obeyed: bool = False
    """Whether the vehicle took that mode."""


@final
class TakingOff(Stage, kw_only=True):
    """By the autopilot's own take-off."""

    phase = Phase.TAKING_OFF


class Led(Stage, kw_only=True):
    """Along a path."""

    path: OnPath | None = None
    """None: there is no leg, it waits for one."""
    progress_at_s: float = 0.0
    """When the reference point last moved, or the wait for a leg began."""
    echoed_at_s: float = 0.0
    """When the reported target last agreed with the setpoint."""


class Flying(Led, kw_only=True):
    """To the targets, or home by a plan."""

    phase = Phase.FLYING
    search: Search | None = None
    shortfall: Reason = Reason.NO_PLAN
    """Why this leg has no successor (yet)."""


@final
class Shadow(Flying, kw_only=True):
    """As if it led the vehicle."""

    phase = Phase.SHADOW


@final
class Returning(Led, kw_only=True):
    """Along the flown path."""

    phase = Phase.RETURNING


@final
class Holding(Stage, kw_only=True):
    """For the state's reason."""

    phase = Phase.HOLDING
    how: Hold
    obeyed: bool = False
    """Whether the vehicle took the hold mode, or needs none."""
    backtrack: Planning | None = None
    """The request for the way back."""
    released_at_s: float = -1e9
    """When the operator last ordered to continue."""
    failsafe_over: bool = False
    """Whether the end of the failsafe that took the vehicle was reported."""
    why: Reason | None = None
    """What was seen to be wrong when a failsafe took it."""


@final
class Arrived(Stage, kw_only=True):
    """At a target."""

    phase = Phase.ARRIVED
    backtrack: Planning | None = None
    """The request for the way back."""


@final
class Landing(Stage, kw_only=True):
    """In the autopilot's own land mode."""

    phase = Phase.LANDING
    obeyed: bool = False
    """Whether the vehicle took it."""
    sinks_at_s: float = 0.0
    """When it last sank."""


@final
class HandingOver(Stage, kw_only=True):
    """To the autopilot's own return."""

    phase = Phase.HANDING_OVER


@final
class Done(Stage, kw_only=True):
    """It has ended."""

    phase = Phase.DONE


@final
class Faulted(Stage, kw_only=True):
    """A part of the companion has died."""

    phase = Phase.FAULTED


STAGES: Final[dict[Phase, type[Stage]]] = {
    each.phase: each
    for each in (
        *(Waiting, Preparing, Ready, Arming, TakingOff, Flying, Returning, Holding),
        *(Arrived, Landing, HandingOver, Shadow, Done, Faulted),
    )
}


@final
class Orders(Struct, frozen=True):
    """Orders of the operator, or of the battery, which outlast other holds."""

    active: Reason | None = None
    """PAUSED, RETURN_ASKED, LAND_ASKED or BATTERY_LOW."""
    suspended: Reason | None = None
    """The order suspended by a pause: RETURN_ASKED or LAND_ASKED."""

    def paused(self) -> "Orders":
        """With a pause."""
        return self if self.active is Reason.PAUSED else Orders(Reason.PAUSED, self.active)

    def continued(self) -> "Orders":
        """Without a pause."""
        return Orders(self.suspended) if self.active is Reason.PAUSED else self


@final
class State(Struct, kw_only=True):
    """The complete state of the mission machine."""

    stage: Stage = field(default_factory=Waiting)
    """The phase, and what lives only in it."""
    now_s: float = 0.0
    armed_by_us: bool = False
    """Whether the companion requested the arming."""
    in_control_since_s: float = math.inf
    """Since when this companion has had control in the air; long ago if it has taken off."""
    duplicate_id_at_s: float = -1e9
    """When another sender with our ids was last heard."""
    duplicate_id: bool = False
    """Whether that is certain."""
    airborne: bool = False
    """Whether the vehicle has been in the air since the start: then it is never armed again."""
    prepared: frozenset[Item] = frozenset()
    orders: Orders = Orders()
    taken: bool = False
    """Whether a pilot or the autopilot has taken over, and has not handed back yet."""
    reason: Reason | None = None
    detail: str = ""
    """Detail of the reason."""
    remedy: str = ""
    fence: FenceChanged | None = None
    fence_unread_s: float | None = None
    """Since when a fence that has changed is being read; None: it is known."""
    task: Task
    """The task for planning: the mission's with the vehicle's fence."""
    targets_ne_m: Targets
    vehicle: Vehicle = field(default_factory=Vehicle)
    flight: Flight

    @property
    def phase(self) -> Phase:
        """The phase by its name."""
        return self.stage.phase

    @property
    def hold(self) -> Hold | None:
        """How it is held, in the phase `holding`."""
        return self.stage.how if isinstance(self.stage, Holding) else None

    @property
    def path(self) -> OnPath | None:
        """The path that is flown, or was; None: there is none, or no phase that has one."""
        return self.stage.path if isinstance(self.stage, Led | Inherited) else None

    @property
    def leg(self) -> Leg | None:
        """The leg that is flown."""
        path = self.path
        return None if path is None else path.leg

    @property
    def reference(self) -> Reference:
        """Where on the leg the vehicle is led."""
        path = self.path
        return Reference() if path is None else path.reference

    @property
    def unready(self) -> str:
        """Why it is not ready any more, having waited for a go; empty: it has not, or is."""
        return self.stage.unready if isinstance(self.stage, Preparing) else ""

    @staticmethod
    def of(mission: Mission, known: KnownMap) -> "State":
        """A mission that has not begun."""
        return State(
            task=mission.task, targets_ne_m=mission.targets_ne_m, flight=Flight(known=known)
        )

    @property
    def in_phase_s(self) -> float:
        """How long this phase has lasted."""
        return self.now_s - self.stage.since_s

    @property
    def is_silent(self) -> bool:
        """Whether there are no heartbeats: then it is unknown who controls the vehicle."""
        return self.now_s - self.vehicle.status_at_s > HEARTBEAT_S

    @property
    def is_grounded(self) -> bool:
        """True after 1.5 s of ON_GROUND: single reports are unreliable."""
        vehicle = self.vehicle
        on_ground = vehicle.landed is Landed.ON_GROUND
        return on_ground and self.now_s - vehicle.landed_at_s > _GROUNDED_S

    @property
    def is_duplicate_suspected(self) -> bool:
        """Whether another sender with our ids was heard lately, maybe frames left by a dead one."""
        return 0.0 <= self.now_s - self.duplicate_id_at_s < _SUSPECT_S

    @property
    def is_second_companion(self) -> bool:
        """Whether there certainly is another companion, and this one has not had control before."""
        is_there = self.duplicate_id and 0.0 <= self.now_s - self.duplicate_id_at_s < _THERE_S
        just_now = 0.0 <= self.now_s - self.in_control_since_s < _SECOND_S
        return is_there and (just_now or not self.has_had_control)

    @property
    def has_had_control(self) -> bool:
        """Whether this companion has had control of the vehicle in the air."""
        return self.in_control_since_s < math.inf

    def take_fence(self, task: Task, fence: FenceChanged | None) -> None:
        """From now on within another fence; task: the mission's.

        `task` stays the old one if they are equal.
        """
        if fence is not None:
            limits, (floor, ceiling) = task.limits, (fence.floor_amsl_m, fence.ceiling_amsl_m)
            limits = dataclasses.replace(
                limits,
                floor_amsl_m=max(limits.floor_amsl_m, -math.inf if floor is None else floor),
                ceiling_amsl_m=min(limits.ceiling_amsl_m, math.inf if ceiling is None else ceiling),
            )
            task = dataclasses.replace(task, limits=limits, zones=(*task.zones, *fence.zones))
        self.fence, self.task = fence, self.task if task == self.task else task
