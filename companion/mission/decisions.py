"""Common parts of the phase handlers: the turn, requests, giving up, faults.

A handler changes the state of its turn in place, and tells the turn what to command and what has
happened; those that take a turn may end it.
"""

import math
from dataclasses import dataclass, field
from typing import final

from companion.mission import phases
from companion.mission.events import Command, StatusText
from companion.mission.health import astray_m, may_differ_m
from companion.mission.mission import Mission
from companion.mission.phases import TAKEN, Reason, Trigger
from companion.mission.state import State, Way
from companion.path.certificate import bounds_text
from companion.planner.request import Refusal

ASK_AGAIN_S = 1.0
GONE_S = 30.0
GONE_IN_AIR_S = 600.0
_STOPPED_M_S = 0.5
AT_M = 5.0
LANDING_ABORTED = "landing broken off: MISSION_START to the companion lands it"
_FENCE_READ_S = 3.0  # for a changed fence; a few items are read in less, also by a slow radio
_FENCE_GIVEN_UP_S = 300.0  # twice what 5,010 items took; who does not answer is asked for ever
_ACTS_S = 15.0  # EKF failsafes come 1 to 10 s after the first doubt (ardupilot.md 5; px4.md 8)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """The constants of a mission."""

    mission: Mission
    seed: int
    lockstep: bool = False
    """A simulator waits for each answer: a long silence means that it has ended."""
    shadow: bool = False
    """Watch only: plan and report, never command."""
    go: bool = False
    """Somebody has said go beforehand (--start): it takes off as soon as it is ready."""


@final
@dataclass(slots=True)
class Turn:
    """One event being handled: the state, which handlers change in place, and what follows."""

    state: State
    context: Context
    commands: list[Command] = field(default_factory=list)
    """In the order in which they are carried out."""
    trigger: Trigger | None = None
    """What has happened; None: the phase goes on."""
    stage: phases.Stage | None = None
    """The phase after it, where that begins with something known."""
    is_left: bool = False
    """Whether the phase decides although the event has a handler of its own."""

    def to(self, trigger: Trigger, stage: phases.Stage | None = None) -> None:
        """The phase is over; stage: the next one, unless it begins with nothing known."""
        self.trigger, self.stage = trigger, stage

    def give_up(self, reason: Reason, detail: str = "", remedy: str = "") -> None:
        """End the mission; a vehicle in the air is left in its hold mode, or in RTL."""
        state = self.state
        if not detail:
            detail, remedy = reason_text(state, reason)
        state.reason, state.detail, state.remedy = reason, detail, remedy
        self.to(Trigger.GIVE_UP)

    def fault(self, reason: Reason) -> None:
        """Stop and hold for a reason."""
        self.state.reason = reason
        self.to(Trigger.FAULT)

    def ask(self, *commands: Command) -> None:
        """Send requests, once a second."""
        now_s, stage = self.state.now_s, self.state.stage
        if now_s - stage.asked_at_s >= ASK_AGAIN_S:
            stage.asked_at_s, stage.asks = now_s, stage.asks + 1
            self.commands += commands

    def do(self, *commands: Command) -> None:
        """These come next."""
        self.commands += commands

    def say(self, text: str, about: str = "", *, warning: bool = False) -> None:
        """A text for people; about: its topic."""
        self.commands.append(StatusText(text=text, warning=warning, about=about))

    def warn(self, text: str, about: str = "") -> None:
        """A text that is a warning."""
        self.say(text, about, warning=True)

    def hold(self, reason: Reason) -> None:
        """Held for this reason from now on, which is said."""
        text = in_words(self.state, reason)
        text = text if reason is Reason.TAKEN_OFF else f"hold: {text}"
        hold_for(self.state, reason)
        self.say(text, "phase", warning=reason.warns)


def reason_text(state: State, reason: Reason) -> tuple[str, str]:
    """Detail and remedy of a reason; for plans the planner's own."""
    if reason is Reason.POSITION_ELSEWHERE:
        off_m, allowed_m = astray_m(state.vehicle), may_differ_m(state.vehicle, state.task.limits)
        return f": {_metres(off_m)} off, {_metres(allowed_m)} allowed", reason.remedy
    refusal = state.flight.refusal
    if reason is not Reason.NO_PLAN or refusal is None:
        return "", reason.remedy
    why, _, remedy = refusal.value.partition("; ")
    broken = f"it broke {bounds_text(state.flight.broken)}" if state.flight.broken else ""
    why = "" if refusal is Refusal.NOTHING_SAFE else why  # else it is said twice
    detail = "".join(f": {part}" for part in (why, broken) if part)
    return detail, f"{remedy[:1].upper()}{remedy[1:]}."


def in_words(state: State, reason: Reason) -> str:
    """A reason with its detail."""
    return f"{reason.text}{reason_text(state, reason)[0]}"


def _metres(length_m: float) -> str:
    """With a decimal where that tells."""
    return f"{length_m:.1f} m" if length_m < 9.95 else f"{length_m:.0f} m"


def longest_silence_s(state: State, context: Context) -> float:
    """How long to wait for a silent vehicle: longer in the air, as it may come back unattended."""
    return GONE_IN_AIR_S if state.airborne and not context.lockstep else GONE_S


def waits_for_fence(state: State, context: Context) -> bool:
    """Whether nothing is flown on until the changed fence is known; not by a low battery.

    What goes back waits no longer than until the reading is given up.
    """
    since_s, flight = state.fence_unread_s, state.flight
    if since_s is None or context.mission.goes_on_while_reading:
        return False
    goes_back = flight.way is not Way.OUT or state.order is Reason.RETURN_ASKED
    if goes_back and fence_is_given_up(state):
        return False
    low = Reason.BATTERY_LOW in (state.reason, state.order, flight.fallen_back)
    return not low and state.now_s - since_s > _FENCE_READ_S


def fence_is_given_up(state: State) -> bool:
    """Whether reading the changed fence has lasted for too long: it may never end."""
    since_s = state.fence_unread_s
    return since_s is not None and state.now_s - since_s > _FENCE_GIVEN_UP_S


def abort_landing(state: State, turn: Turn) -> None:
    """It has left the land mode: not landed again without an order, for which it waits."""
    state.paused = True
    turn.warn(LANDING_ABORTED)


def seen_cause(state: State) -> Reason | None:
    """What was seen to be wrong of late, on which an autopilot's failsafe may have acted."""
    vehicle = state.vehicle
    if vehicle.distrust is not None or state.now_s - vehicle.bad_at_s < _ACTS_S:
        return vehicle.distrust or vehicle.last_distrust
    if state.now_s - vehicle.estimator_failed_at_s < _ACTS_S:
        return Reason.ESTIMATOR
    return None if vehicle.battery_short_at_s is None else Reason.BATTERY_LOW


def hold_for(state: State, reason: Reason) -> None:
    """Held for this reason from now on; what is known of who has it is kept as long as he has."""
    held = state.stage
    if not (isinstance(held, phases.Holding) and held.why in TAKEN and reason in TAKEN):
        seen = seen_cause(state) if reason is Reason.FAILSAFE else None
        held = phases.Holding(why=reason, seen=seen)
    held.why = reason
    held.since_s, held.asked_at_s, held.asks = state.now_s, -1e9, 0
    state.stage = held
    state.because(reason)


def is_at_rest(state: State) -> bool:
    """Whether the vehicle is at rest, or loitering if it is a plane."""
    speed_m_s = math.hypot(*state.vehicle.velocity_nea_m_s)
    return not state.vehicle.traits.hovers or speed_m_s < _STOPPED_M_S
