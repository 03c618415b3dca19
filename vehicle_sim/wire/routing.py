"""Routing: which frames are forwarded to other links, and which are for this vehicle.

ArduPilot does it as measured in ardupilot.md 3 ("Who may send") and 5, and as MAVLink_routing.cpp
says; PX4 as px4.md 2 says, and passes frames on as its mavlink_main.cpp does on links that were
started with forwarding, as those of its simulator are.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, Final, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.parameters import Firmware

Target = tuple[int | None, int | None]

_HEARTBEAT: Final = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_NEVER_FORWARDED: Final = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_RADIO,
        mavlink.MAVLINK_MSG_ID_RADIO_STATUS,
        mavlink.MAVLINK_MSG_ID_SETUP_SIGNING,
    }
)
"""Handled by the vehicle and kept off its other links."""
_COMMANDS: Final = frozenset(
    {mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT}
)
MISSION: Final = frozenset({37, 38, 39, 40, 41, 43, 44, 45, 47, 51, 73})
"""All that clients say in the mission protocol."""
_PARAMETERS: Final = frozenset({20, 21, 23})
_ADDRESSED: Final = _COMMANDS | MISSION | _PARAMETERS
"""PX4 accepts these only with its system id, not as broadcasts."""
_FOR_EVERY_COMPONENT: Final = frozenset({512, 519})
"""Commands that PX4 accepts for any component: requests for messages and versions."""
_MISSION_PLANNER: Final = 190
"""PX4 takes missions that are addressed to this component too."""
_MAX_ROUTES: Final = 20
"""MAVLINK_MAX_ROUTES of ArduPilot: who comes later is not learnt."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """What becomes of one frame."""

    links: tuple[int, ...] = ()
    """It goes on, unchanged, to these links."""
    to_autopilot: bool = False
    to_radar: bool = False


_route = cache(Route)
"""There are few different ones."""
_NOWHERE: Final = Route()
_AUTOPILOT: Final = Route(to_autopilot=True)


def targets(message: Any) -> Target:
    """Target system and component of a message; None where it has no such field."""
    return getattr(message, "target_system", None), getattr(message, "target_component", None)


@final
class Router:
    """Learns on which link each component is.

    The radar is a component of its own, on a link inside the vehicle that never needs learning;
    the lidar's driver is another, which listens to nobody.
    """

    def __init__(
        self,
        *,
        system: int,
        component: int = 1,
        radar: int | None = None,
        lidar: int | None = None,
        firmware: Firmware,
    ) -> None:
        self.enforce = False
        """MAV_OPTIONS bit 0: only the own system and the ground station may command."""
        self.ground_system = 255
        """MAV_GCS_SYSID."""
        self._system, self._component, self._radar = system, component, radar
        self._inside = {radar, lidar}
        self._firmware = firmware
        self._routes = set[tuple[int, int, int]]()
        self._links: list[int] = []

    def restart(self) -> None:
        """The autopilot boots: what it has learnt is gone."""
        self._routes.clear()
        self._links.clear()

    def heard(self, link: int) -> bool:
        """Whether any sender was heard on this link since the boot."""
        return link in self._links

    def route(self, message: Any, link: int) -> Route:
        """Where this message goes that came by this link."""
        header = message.get_header()
        source = (header.srcSystem, header.srcComponent)
        is_px4 = self._firmware == "px4"
        if source[0] == self._system and (
            source[1] in self._inside or (source[1] == self._component and not is_px4)
        ):
            return _NOWHERE  # our own, come back: ardupilot.md 3, "Who may send"
        if link not in self._links:
            self._links = sorted([*self._links, link])
        if source[0] and len(self._routes) < _MAX_ROUTES:
            self._routes.add((*source, link))
        return self._px4(message, link) if is_px4 else self._ardupilot(message, source, link)

    def _hears(self, system: int | None, component: int | None) -> bool:
        """Whether the radar is meant."""
        return (
            self._radar is not None
            and (not system or system == self._system)
            and component in (None, 0, self._radar)
        )

    # --- ArduPilot ----------------------------------------------------------------------------

    def _ardupilot(self, message: Any, source: tuple[int, int], link: int) -> Route:
        number = message.get_msgId()
        if number == _HEARTBEAT:
            known = {at for system, component, at in self._routes if (system, component) == source}
            others = tuple(at for at in self._links if at != link and at not in known)
            return _route(links=others, to_autopilot=True, to_radar=True)
        system, component = targets(message)
        if number in _NEVER_FORWARDED:
            return _AUTOPILOT if not system or system == self._system else _NOWHERE
        if system == self._system and component == self._component:
            return _route(to_autopilot=self._accepts(source))
        ours = not system or system == self._system
        anybody = not component or system != self._system
        links = self._matching(system, component, link, anybody=anybody)
        to_radar = self._hears(system, component)
        only_radar = to_radar and component == self._radar
        # what is for a component that lives nowhere else, ArduPilot takes for its own
        local = ours and (component in (None, 0, self._component) or not (links or only_radar))
        return _route(links=links, to_autopilot=local and self._accepts(source), to_radar=to_radar)

    def _matching(
        self, system: int | None, component: int | None, link: int, *, anybody: bool
    ) -> tuple[int, ...]:
        """The links, other than the source, with a target of the message.

        anybody: match the system only.
        """
        if len(self._links) < 2:
            return ()
        found = {
            at
            for its_system, its_component, at in self._routes
            if at != link
            and (not system or (its_system == system and (anybody or its_component == component)))
        }
        return tuple(sorted(found))

    def _accepts(self, source: tuple[int, int]) -> bool:
        return not self.enforce or source[0] in (self._system, self.ground_system)

    # --- PX4 ----------------------------------------------------------------------------------

    def _px4(self, message: Any, link: int) -> Route:
        system, component = targets(message)
        links: tuple[int, ...] = ()
        if (system, component) != (self._system, self._component):  # for PX4 alone
            links = self._matching(system, component, link, anybody=not component)
        return _route(
            links=links,
            to_autopilot=self._px4_takes(message, system, component),
            to_radar=self._hears(system, component),
        )

    def _px4_takes(self, message: Any, system: int | None, component: int | None) -> bool:
        number = message.get_msgId()
        if number in _COMMANDS and message.command in _FOR_EVERY_COMPONENT:
            return system in (0, self._system)
        mine = (None, 0, self._component)
        return (
            system == self._system if number in _ADDRESSED else system in (None, 0, self._system)
        ) and (component in mine or (number in MISSION and component == _MISSION_PLANNER))
