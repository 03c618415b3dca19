"""The state of a mission: its phase, the vehicle, and how far it has come.

`machine.step` copies the state, and the handlers change that copy in place; nobody else does.
"""

import dataclasses
import enum
import math
from typing import final

from msgspec import Struct, field

from companion.mission.events import Echo, FenceChanged, Item, Landed, Mode, Setpoint, Vector
from companion.mission.mission import Mission
from companion.mission.phases import IN_AIR as IN_AIR  # for those who read the state
from companion.mission.phases import By, Holding, Led, OnPath, Preparing, Stage
from companion.mission.phases import Phase as Phase
from companion.mission.phases import Reason as Reason
from companion.mission.vehicle_traits import UNKNOWN, VehicleTraits
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
    echo: Echo | None = None
    """Its target, as last told."""
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


class Way(enum.Enum):
    """Where a flight goes."""

    OUT = "to the targets"
    BACK = "along the flown path"
    HOME = "home, planned to like a target: the flown path does not lead there, or is too far away"


@final
class Flight(Struct, kw_only=True):
    """How far the mission has come, whatever the phase."""

    known: KnownMap
    target: int = 0
    hover_nea_m: Vector | None = None
    """Where to hold while there is no leg."""
    circle_nea_m: Vector | None = None
    """The circle, which is proven, that a plane was led on before others held it."""
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


class Goal(enum.Enum):
    """What the flight is for; it outlasts holds, restarts and reboots.

    Its value is what the vehicle is held for until it is on its way there.
    """

    TARGETS = None
    HOME = Reason.RETURN_ASKED
    LAND = Reason.LAND_ASKED
    DOWN = Reason.BATTERY_LOW
    """By the mission's fallback."""


@final
class State(Struct, kw_only=True):
    """The complete state of the mission machine."""

    stage: Stage = field(default_factory=lambda: Preparing(phase=Phase.WAITING))
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
    goal: Goal = Goal.TARGETS
    paused: bool = False
    """Whether a person has paused it, wherever it goes."""
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

    def because(self, reason: Reason | None) -> None:
        """Hold or end for this reason from now on: what was said of another is not true of it."""
        if reason is not self.reason:
            self.detail = self.remedy = ""
        self.reason = reason

    @property
    def phase(self) -> Phase:
        """The phase by its name."""
        return self.stage.phase

    @property
    def held_for(self) -> Reason | None:
        """Why it is held; None: it is not."""
        return self.stage.why if isinstance(self.stage, Holding) else None

    @property
    def held_by(self) -> By | None:
        """Who holds it; None: it is not held."""
        return self.stage.why.by if isinstance(self.stage, Holding) else None

    @property
    def order(self) -> Reason | None:
        """What it has to be held for yet, whatever else it is held for: a pause, or its goal."""
        if self.paused:
            return Reason.PAUSED
        goes_back = self.goal is not Goal.LAND and self.flight.way is not Way.OUT
        return None if goes_back else self.goal.value

    @property
    def path(self) -> OnPath | None:
        """The path that is flown, or was; None: there is none, or no phase that has one."""
        return self.stage.path if isinstance(self.stage, Led | Preparing) else None

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
