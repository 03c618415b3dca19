"""PX4's failsafes: which mode is flown instead of the wanted one, and why (px4.md 6 to 8).

A failsafe that follows from a state (no setpoints, no position) ends with it; one that an incident
has triggered (fence, lost ground station, battery) stays until another mode is commanded.
"""

import enum
from typing import Final, final

from vehicle_sim.autopilots.px4.modes import MANUAL_MODES, NEED_POSITION, Mode


class Action(enum.IntEnum):
    """failsafe_action_t: the worse, the greater."""

    NONE = 0
    WARN = 1
    POSITION = 2
    ALTITUDE = 3
    STABILIZED = 4
    HOLD = 5
    RETURN = 6
    LAND = 7
    DESCEND = 8
    DISARM = 9
    TERMINATE = 10


MODES: Final = {
    Action.POSITION: Mode.POSCTL,
    Action.ALTITUDE: Mode.ALTCTL,
    Action.STABILIZED: Mode.STABILIZED,
    Action.HOLD: Mode.LOITER,
    Action.RETURN: Mode.RTL,
    Action.LAND: Mode.LAND,
    Action.DESCEND: Mode.DESCEND,
    Action.TERMINATE: Mode.DESCEND,
}
"""What an action flies; TERMINATE stops the motors as well."""

OFFBOARD_LOSS: Final = {
    0: Action.POSITION,
    1: Action.ALTITUDE,
    2: Action.STABILIZED,
    3: Action.RETURN,
    4: Action.LAND,
    5: Action.HOLD,
    6: Action.TERMINATE,
    7: Action.DISARM,
}
"""COM_OBL_RC_ACT."""
FENCE: Final = {
    0: Action.NONE,
    1: Action.WARN,
    2: Action.HOLD,
    3: Action.RETURN,
    4: Action.TERMINATE,
    5: Action.LAND,
}
"""GF_ACTION."""
LINK_LOSS: Final = {
    0: Action.NONE,
    1: Action.HOLD,
    2: Action.RETURN,
    3: Action.LAND,
    5: Action.TERMINATE,
    6: Action.DISARM,
}
"""NAV_DLL_ACT."""


class Cause(enum.Enum):
    """Incidents whose action stays when they are over."""

    FENCE = enum.auto()
    GROUND_STATION_LOST = enum.auto()
    BATTERY = enum.auto()


def battery_action(remaining: float, thresholds: tuple[float, float], choice: int) -> Action:
    """COM_LOW_BAT_ACT: 0 warn, 2 land, 3 return, then land when critical turns into emergency.

    thresholds: BAT_CRIT_THR and BAT_EMERGEN_THR.
    """
    critical, emergency = thresholds
    if remaining > critical:
        return Action.NONE
    if choice == 2:
        return Action.LAND
    if choice == 3:
        return Action.LAND if remaining <= emergency else Action.RETURN
    return Action.WARN


def can_run(mode: Mode, *, position_ok: bool, offboard_ok: bool) -> bool:
    """Whether the mode has what it needs; a pilot is not among it: what lacks one sinks."""
    if mode is Mode.OFFBOARD:
        return offboard_ok
    return position_ok or mode not in NEED_POSITION


def possible(action: Action, *, position_ok: bool, precise: bool) -> Action:
    """The action, or the next one that can be done; landing needs less of a position than others.

    The real one landed for 0.2 s on its way from Descend back to OFFBOARD (px4-gps-loss.tlog).
    """
    if action in (Action.HOLD, Action.RETURN, Action.LAND) and not position_ok:
        return Action.DESCEND
    if action in (Action.HOLD, Action.RETURN) and not precise:
        return Action.LAND
    if action is Action.POSITION and not precise:
        return Action.ALTITUDE
    return action


@final
class Incidents:
    """What has happened and is still acted upon.  Mutable."""

    def __init__(self) -> None:
        self._actions: dict[Cause, Action] = {}
        self._active: set[Cause] = set()

    def note(self, cause: Cause, action: Action) -> bool:
        """The state of a cause now (NONE: it is well); tells whether it has just begun."""
        if action <= Action.NONE:
            self._active.discard(cause)
            return False
        begun = cause not in self._active
        worse = action > self._actions.get(cause, Action.NONE) and cause in self._actions
        self._active.add(cause)
        if begun or worse:
            self._actions[cause] = action
        return begun or worse

    def worst(self) -> Action:
        """What they ask for."""
        return max(self._actions.values(), default=Action.NONE)

    def forgive(self) -> None:
        """A mode was commanded: what has happened so far is no reason any more."""
        self._actions.clear()

    def forget(self) -> None:
        """Disarmed."""
        self._actions.clear()
        self._active.clear()


def instead_of(
    intended: Mode,
    incidents: Action,
    *,
    offboard_loss: Action,
    offboard_signal: bool,
    position_ok: bool,
    precise: bool,
) -> Action:
    """The failsafe action now, NONE while the intended mode can be flown."""
    action = incidents if incidents > Action.WARN else Action.NONE
    if intended is Mode.OFFBOARD:
        if not offboard_signal or not precise:
            action = max(action, offboard_loss)
    elif not position_ok and intended in NEED_POSITION:
        fallback = Action.ALTITUDE if intended in MANUAL_MODES else Action.DESCEND
        action = max(action, fallback)
    if intended in (Mode.LAND, Mode.RTL) and action is Action.RETURN and position_ok:
        return Action.NONE
    return possible(action, position_ok=position_ok, precise=precise)


_GROUND_STATION, _ONBOARD_CONTROLLER = 6, 18


@final
class Stations:
    """Whom PX4 hears: ground stations and companions.  Mutable."""

    def __init__(self) -> None:
        self._ground_station_us: int | None = None
        self._companion_us: int | None = None

    def hear(self, vehicle_type: int, now_us: int, *, ours: bool) -> None:
        """A heartbeat of another component, of this system or another."""
        if vehicle_type == _GROUND_STATION:
            self._ground_station_us = now_us
        elif vehicle_type == _ONBOARD_CONTROLLER and ours:
            self._companion_us = now_us

    def misses_companion(self, now_us: int, loss_s: float) -> bool:
        """A companion has gone silent; told once each time."""
        heard_us = self._companion_us
        lost = heard_us is not None and now_us - heard_us > loss_s * 1e6
        if lost:
            self._companion_us = None
        return lost

    def ground_station_lost(self, now_us: int, loss_s: float) -> bool:
        """There was one, and it has gone silent."""
        heard_us = self._ground_station_us
        return heard_us is not None and now_us - heard_us > loss_s * 1e6
