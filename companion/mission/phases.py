"""The phases of a mission: what moves them on, why they hold or end, and what each of them knows.

A phase is a value with its own fields (`Stage`), which end with it.
"""

import enum
import math
from typing import final

from msgspec import Struct, field

from companion.mission.events import Vector
from companion.planner.procedure import Leg, Offset, Reference
from companion.planner.settings import Task


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
GOING_UP = (Phase.ARMING, Phase.TAKING_OFF)
ON_PATH = (Phase.FLYING, Phase.RETURNING)
LED = (*ON_PATH, Phase.ARRIVED)
IN_AIR = (Phase.TAKING_OFF, *LED, Phase.HOLDING, Phase.LANDING, Phase.HANDING_OVER)
OVER = (Phase.DONE, Phase.FAULTED)
_FOLLOWS = (Phase.TAKING_OFF, *LED, Phase.LANDING)
_ALL = (*ON_GROUND, *IN_AIR, Phase.SHADOW)
_HELD = (Phase.ARRIVED, Phase.HOLDING, Phase.RETURNING)
_LANDS_FROM = (Phase.PREPARING, Phase.TAKING_OFF, Phase.FLYING, *_HELD, Phase.HANDING_OVER)
_HANDS_OVER = (Phase.PREPARING, *_FOLLOWS, Phase.HOLDING)


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
    FAULT = ("it cannot go on; the reason says why", (Phase.ARMING, *_FOLLOWS), Phase.HOLDING)
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


class By(enum.Enum):
    """Who holds a vehicle; each reason has one of them."""

    SETPOINTS = "we do, by a stream of one setpoint: its position is valid"
    MODE = "its autopilot does, until it is at rest and its position was valid for a while"
    NOBODY = "nobody of ours: a pilot or its autopilot has it, it is silent, or on the ground"


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
    TAKING_OVER = ("taking over", "Wait: it stops first.", By.MODE, False)
    TAKEN_OFF = ("taken off", "Wait: guided mode comes next.", By.MODE, False)
    BROKEN_OFF = ("the take-off is broken off", "Wait: it stops first.", By.MODE, False)
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
    LINK_LOST = ("the vehicle fell silent", "Check the link and the vehicle.", By.NOBODY)
    NOT_ALONE = (
        "another companion with our ids is on the link",
        "End one of the two; each vehicle has one, by its own system id.",
    )
    REBOOTED = ("the autopilot has rebooted", "Look at the vehicle before it flies again.")
    ARMED_ALREADY = ("somebody else has armed the vehicle", "Disarm it, then start again.")
    STREAM_LOST = (
        "the autopilot has lost the setpoints",
        "Check the link; it goes on by itself.",
        By.MODE,
    )
    HEALTH_SILENT = (
        "no word of how good the position is",
        "Check the link, and who changes message rates.",
    )
    MODE_TAKEN = (
        "somebody else flies the vehicle",
        "Give it back: guided mode, or the command MISSION_START to the companion.",
        By.NOBODY,
    )
    FAILSAFE = (
        "the autopilot's own failsafe took the vehicle",
        "See its messages; when that is over, give it back: guided mode, or MISSION_START.",
        By.NOBODY,
    )
    FENCE_BREACHED = (
        "the vehicle's own fence stopped it",
        "Change its fence, or give it back (guided mode, or MISSION_START) to be led out of it.",
        By.NOBODY,
    )
    DISARMED = ("the vehicle disarmed", "See its messages for the reason.", By.NOBODY)
    GROUNDED = ("the vehicle is on the ground", "Look at it before it flies again.", By.NOBODY)
    BESIDE_PATH = (
        "the vehicle was beside its path",
        "Raise vehicle.tracking_error_m or fly slower.",
        By.SETPOINTS,
    )
    OFF_PATH = ("the vehicle left its path", "Raise vehicle.tracking_error_m or fly slower.")
    NOT_FOLLOWING = ("the vehicle does not follow its setpoints", "Check that it can fly them.")
    NOT_TAKEN = ("the autopilot does not take the setpoints", "See its messages for the reason.")
    NOT_OBEYING = ("the vehicle did not take the mode asked for", "Take over by hand.")
    SENSOR_SILENT = (
        "the sensor of near things is silent",
        "Check it, its driver and its link.",
        By.SETPOINTS,
    )
    GROUND_NEARER = (
        "the ground is nearer than the map says",
        "Check map, altitude datum and rangefinder.",
        By.SETPOINTS,
    )
    RADAR_SILENT = ("the terrain radar did not answer", "Check the radar.", By.SETPOINTS)
    NO_PLAN = ("no safe subpath was found", "Relax the mission's planner settings.", By.SETPOINTS)
    PLAN_LATE = (
        "the next subpath was not ready in time",
        "Raise planner.planning_time_s, or use a faster computer.",
        By.SETPOINTS,
    )
    NEW_THREAT = ("a new threat lies on the path", "Wait for the way round it.", By.SETPOINTS)
    FENCE_UNREAD = (
        "the vehicle's fence has changed and is being read",
        "Wait until it is read; from_vehicle.goes_on_while_reading lets it fly on.",
        By.SETPOINTS,
    )
    NEW_TARGET = ("a new target was given", "Wait for the way to it.", By.SETPOINTS, False)
    CONTINUED = (
        "told to go on while it still stopped",
        "Wait for the way on.",
        By.SETPOINTS,
        False,
    )
    PAUSED = ("paused by a person", "Send the command to continue.", By.SETPOINTS, False)
    RETURN_ASKED = ("told to return", "Wait until it has landed.", By.SETPOINTS)
    LAND_ASKED = ("told to land", "Wait until it has landed.", By.SETPOINTS, False)
    BATTERY_LOW = (
        "the battery will not reach the target and the reserve",
        "Bring the vehicle down.",
        By.SETPOINTS,
    )
    PLANNER_DIED = (
        "a part of the companion stopped with an error",
        "Report the error in the journal.",
    )
    STOPPED = ("stopped by a person", "Start again to fly on.")

    def __init__(self, text: str, remedy: str, by: By = By.MODE, warns: bool = True) -> None:
        self.text = text
        """What happened."""
        self.remedy = remedy
        """What to do about it."""
        self.by = by
        """Who holds a vehicle for this reason."""
        self.warns = warns
        """Whether it is a fault."""

    @property
    def asks_to_hold(self) -> bool:
        """Whether a vehicle that is held for it is asked to hold: in its mode it would not."""
        return self.by is By.MODE and self not in (*TAKES_OVER, Reason.STREAM_LOST)


TAKES_OVER = (Reason.TAKING_OVER, Reason.TAKEN_OFF)
"""Held in the mode that it is in, if that stops it."""
TAKEN = (Reason.MODE_TAKEN, Reason.FAILSAFE, Reason.FENCE_BREACHED)
"""A pilot or the autopilot has it, until it is handed back."""
ORDERED = (Reason.PAUSED, Reason.RETURN_ASKED, Reason.LAND_ASKED, Reason.BATTERY_LOW)
"""What a person has ordered, or the battery has: it outlasts other holds."""


# --- a path, and the search for its next leg


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


# --- the phases: what lives only in one of them ends with it


class Stage(Struct, kw_only=True):
    """A phase, with what each of them knows; some know more."""

    phase: Phase
    since_s: float = 0.0
    """When it began."""
    progress_at_s: float = 0.0
    """When it last came on: the reference point moved, the vehicle sank, a wait for a leg began."""
    asked_at_s: float = -1e9
    """When the vehicle was last asked for something."""
    asks: int = 0
    """How often."""
    obeyed: bool = False
    """Whether it took the mode that this phase requests, or needs none."""


@final
class Preparing(Stage, kw_only=True):
    """Waits for a vehicle, or prepares one, on the ground or in the air.

    With what was left by the previous companion, or before a reboot.
    """

    phase: Phase = Phase.PREPARING
    path: OnPath | None = None
    """The path that it flew."""
    landing: bool = False
    """Whether the vehicle was being landed."""
    sank: bool = False
    """Whether it had taken the land mode then: leaving it was a pilot's decision."""
    news: str = ""
    """Text to send once there is a vehicle: what could not be restored."""
    unready: str = ""
    """Why it is not ready any more, having waited for a go; empty: it has not."""


class Led(Stage, kw_only=True):
    """On a path: along the flown one back, or as `Flying`."""

    phase: Phase = Phase.RETURNING
    path: OnPath | None = None
    """None: there is no leg, it waits for one."""
    echoed_at_s: float = 0.0
    """When the reported target last agreed with the setpoint."""


@final
class Flying(Led, kw_only=True):
    """To the targets, or home by a plan; in the phase `shadow` as if it were."""

    phase: Phase = Phase.FLYING
    search: Search | None = None
    shortfall: Reason = Reason.NO_PLAN
    """Why this leg has no successor (yet)."""


class Stopped(Stage, kw_only=True):
    """At rest: at a target, or as `Holding`."""

    phase: Phase = Phase.ARRIVED
    backtrack: Planning | None = None
    """The request for the way back."""


@final
class Holding(Stopped, kw_only=True):
    """Held: why, by whom (`Reason.by`), and what was said to who has it."""

    phase: Phase = Phase.HOLDING
    why: Reason
    released_at_s: float = -1e9
    """When the operator last ordered to continue."""
    failsafe_over: bool = False
    """Whether the end of the failsafe that took the vehicle was reported."""
    seen: Reason | None = None
    """What was seen to be wrong when a failsafe took it."""
