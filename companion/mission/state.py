"""Phases, what moves a mission from one to the next, and everything that it remembers."""

import enum
from dataclasses import dataclass, field, replace
from typing import final

from companion.mission.events import Landed, Mode, Vector
from companion.planner.procedure import Leg, Reference
from companion.world.known_map import KnownMap


class Phase(enum.Enum):
    """Where a mission stands (design section 7)."""

    WAITING = "waiting"
    PREPARING = "preparing"
    ARMING = "arming"
    TAKING_OFF = "taking off"
    FLYING = "flying"
    HOLDING = "holding"
    ARRIVED = "arrived"
    LANDING = "landing"
    RETURNING = "returning"
    SHADOW = "shadow"
    DONE = "done"
    FAULTED = "faulted"


class Trigger(enum.Enum):
    """What moves a mission on."""

    VEHICLE_FOUND = "the vehicle's heartbeat was heard"
    READY = "position, home and streams are there, on the ground"
    ARMED = "armed in guided mode"
    AIRBORNE = "at the floor of the band, in the air"
    TARGET_REACHED = "the last leg was flown to its end"
    NEXT_TARGET = "stopped at a target that is not the last"
    END_HOLD = "stopped at the last target, in the hold mode"
    END_LAND = "stopped at the last target, told to land"
    LANDED = "on the ground, disarmed"
    FAULT = "the flight cannot go on as it is; the reason says why"
    RESUME = "the reason for holding is gone, or another try is due"
    GIVE_UP = "no way to go on; the vehicle holds"
    DIED = "the planner died"
    STOP = "a person asked for the end"


ON_GROUND = (Phase.WAITING, Phase.PREPARING, Phase.ARMING)
IN_AIR = (Phase.TAKING_OFF, Phase.FLYING, Phase.HOLDING, Phase.ARRIVED, Phase.LANDING)

MOVES: dict[tuple[Phase, Trigger], Phase] = {
    (Phase.WAITING, Trigger.VEHICLE_FOUND): Phase.PREPARING,
    (Phase.PREPARING, Trigger.READY): Phase.ARMING,
    (Phase.ARMING, Trigger.ARMED): Phase.TAKING_OFF,
    (Phase.TAKING_OFF, Trigger.AIRBORNE): Phase.FLYING,
    (Phase.FLYING, Trigger.TARGET_REACHED): Phase.ARRIVED,
    (Phase.ARRIVED, Trigger.NEXT_TARGET): Phase.FLYING,
    (Phase.ARRIVED, Trigger.END_HOLD): Phase.DONE,
    (Phase.ARRIVED, Trigger.END_LAND): Phase.LANDING,
    (Phase.LANDING, Trigger.LANDED): Phase.DONE,
    (Phase.TAKING_OFF, Trigger.FAULT): Phase.HOLDING,
    (Phase.FLYING, Trigger.FAULT): Phase.HOLDING,
    (Phase.ARRIVED, Trigger.FAULT): Phase.HOLDING,
    (Phase.LANDING, Trigger.FAULT): Phase.HOLDING,
    (Phase.HOLDING, Trigger.RESUME): Phase.FLYING,
    **{(phase, Trigger.GIVE_UP): Phase.DONE for phase in (*ON_GROUND, *IN_AIR)},
    **{(phase, Trigger.STOP): Phase.DONE for phase in (*ON_GROUND, *IN_AIR)},
    **{(phase, Trigger.DIED): Phase.FAULTED for phase in IN_AIR},
}
"""The transition table.  What is absent changes nothing."""


class Reason(enum.Enum):
    """Why a mission holds or ends, and the one next action to take."""

    NO_VEHICLE = ("no vehicle was heard", "Start it, or check --connect.")
    WRONG_VEHICLE = ("the vehicle is not an ArduPilot copter", "Check --connect and the vehicle.")
    NOT_READY = ("the vehicle did not get ready to fly", "See its messages for what it waits for.")
    ALREADY_FLYING = ("the vehicle is already in the air", "Land it, then start again.")
    NOT_ARMED = ("the vehicle would not arm in guided mode", "See its messages for the reason.")
    OUTSIDE = ("the vehicle stands off the map or at a keep-out", "Check origin and area.")
    HOME_TOO_HIGH = ("home lies above the floor of the band", "Raise altitude.floor_amsl_m.")
    NO_TAKE_OFF = ("the vehicle did not reach the floor of the band", "Check its climb rate.")
    POSITION_STALE = ("no position for 0.5 s", "Wait for the vehicle's position to come back.")
    POSITION_FROZEN = ("the position stands still while the speed does not", "Check the GPS.")
    POSITION_JUMPED = ("the position jumped further than the vehicle can fly", "Check the GPS.")
    NO_FIX = ("the GPS fix is lost", "Wait for the fix to come back.")
    ESTIMATOR = ("the autopilot does not vouch for its position", "Check the vehicle's GPS.")
    LINK_LOST = ("the vehicle fell silent", "Check the link and the vehicle.")
    MODE_TAKEN = ("somebody else changed the flight mode", "Select guided mode to go on.")
    DISARMED = ("the vehicle disarmed", "See its messages for the reason.")
    GROUNDED = ("the vehicle is on the ground", "Look at it before it flies again.")
    OFF_PATH = ("the vehicle left its path", "Raise vehicle.tracking_error_m or fly slower.")
    NOT_FOLLOWING = ("the vehicle does not follow its setpoints", "Check that it can fly them.")
    NOT_OBEYING = ("the vehicle did not take the mode asked for", "Take over by hand.")
    RADAR_SILENT = ("the terrain radar did not answer", "Check the radar.")
    NO_PLAN = ("no safe subpath was found", "Relax the mission's planner settings.")
    PLAN_LATE = ("the next subpath was not ready in time", "Raise planner.planning_time_s.")
    PLANNER_DIED = ("the planner stopped with an error", "Report the error in the journal.")
    STOPPED = ("stopped by a person", "Start again to fly on.")

    @property
    def text(self) -> str:
        """What happened."""
        return self.value[0]

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return self.value[1]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """What the vehicle has said of itself."""

    mode: Mode | None = None
    armed: bool = False
    landed: Landed = Landed.UNKNOWN
    home_amsl_m: float | None = None
    fix_good: bool = False
    estimator_good: bool = False
    position_nea_m: Vector | None = None
    velocity_nea_m_s: Vector = (0.0, 0.0, 0.0)
    position_at_s: float = -1e9
    position_step_s: float = 0.0
    """Time between the last two positions."""
    moved_at_s: float = -1e9
    """When the horizontal position last differed from the one before."""
    jumped_at_s: float = -1e9
    """When the position last changed by more than the vehicle can fly."""
    bad_at_s: float = 0.0
    """When the position was last not to be believed, whatever the reason."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """How far the online procedure has come."""

    known: KnownMap
    target: int = 0
    leg: Leg | None = None
    reference: Reference = field(default_factory=Reference)
    next_leg: Leg | None = None
    hover_nea_m: Vector | None = None
    """Where to stay while there is no leg."""
    scanning_from_nea_m: Vector | None = None
    plan_id: int = 0
    """Of the newest plan request."""
    route_ne_m: tuple[tuple[float, float], ...] = ()
    """The way to the target that the newest plan had in mind."""
    planning: bool = False
    tried: bool = False
    """Whether this leg's successor has been scanned or planned for."""
    shortfall: Reason = Reason.NO_PLAN
    """Why this leg has no successor (yet)."""
    failures: int = 0
    """Attempts in a row, from rest, that gave no leg."""
    legs_flown: int = 0
    stops: int = 0
    """How often the vehicle has stopped at the end of a leg that was not the last."""
    departures: int = 0
    """How often the vehicle has left its path."""
    progress_at_s: float = 0.0
    """When the reference point last moved, or the wait for a leg began."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """Everything that the next decision depends on."""

    phase: Phase = Phase.WAITING
    since_s: float = 0.0
    """When the phase began."""
    now_s: float = 0.0
    asked_at_s: float = -1e9
    """When the vehicle was last asked for what this phase waits for."""
    obeyed: bool = False
    """Whether the vehicle took the mode that this phase asked for."""
    reason: Reason | None = None
    vehicle: Vehicle = field(default_factory=Vehicle)
    flight: Flight

    def by_another_clock(self, shift_s: float) -> "State":
        """The same state, with its times on a clock that shows shift_s more."""
        return replace(
            self,
            now_s=self.now_s + shift_s,
            since_s=self.since_s + shift_s,
            asked_at_s=self.asked_at_s + shift_s,
            vehicle=replace(self.vehicle, bad_at_s=self.vehicle.bad_at_s + shift_s),
        )
