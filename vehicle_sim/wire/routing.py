"""Routing: which frames are forwarded to other links, and which are for this vehicle.

Measured in ardupilot.md 3 ("Who may send") and 5, and in px4.md 2; PX4 forwards between links that
were started with forwarding, as those of its simulator are.
"""

from collections.abc import Iterable
from typing import Any, Final, NamedTuple, final

from vehicle_sim.parameters import Firmware

_NEVER_FORWARDED: Final = frozenset({"RADIO", "RADIO_STATUS", "SETUP_SIGNING"})
"""Handled by the vehicle and kept off its other links."""
_ADDRESSED: Final = ("COMMAND_", "MISSION_", "PARAM_")
"""PX4 accepts what begins so only with its system id, not as broadcasts."""
_FOR_EVERY_COMPONENT: Final = frozenset({512, 519})
"""Commands that PX4 accepts for any component: requests for messages and versions."""
_MAX_ROUTES: Final = 20
"""MAVLINK_MAX_ROUTES of ArduPilot: who comes later is not learnt."""


@final
class Route(NamedTuple):
    """What becomes of one frame."""

    links: tuple[int, ...] = ()
    """It goes on, unchanged, to these links."""
    to_autopilot: bool = False
    to_radar: bool = False


def targets(message: Any) -> tuple[int | None, int | None]:
    """Target system and component of a message; None where it has no such field."""
    return getattr(message, "target_system", None), getattr(message, "target_component", None)


@final
class Router:
    """Learns on which link each component is, from the boot of the autopilot on.

    The radar is a component of its own, on a link inside the vehicle that never needs learning;
    drivers of lidars are others, which listen to nobody.
    """

    def __init__(
        self,
        *,
        system: int,
        component: int = 1,
        radar: int | None = None,
        drivers: Iterable[int] = (),
        firmware: Firmware,
    ) -> None:
        self.commanders: frozenset[int] | None = None
        """The systems that may command, if not all may (MAV_OPTIONS bit 0)."""
        self._system, self._component, self._radar = system, component, radar
        self._is_px4 = firmware == "px4"
        self._inside = {radar, *drivers} | (set() if self._is_px4 else {component})
        """Whose frames, if they come back, are passed over: ardupilot.md 3, "Who may send"."""
        self._routes = set[tuple[int, int, int]]()
        """System, component and link of everybody who was heard."""
        self.heard_on = set[int]()
        """Links on which any sender was heard."""

    def route(self, message: Any, link: int) -> Route:
        """Where this message goes that came by this link."""
        header, name = message.get_header(), message.get_type()
        source = (header.srcSystem, header.srcComponent)
        if source[0] == self._system and source[1] in self._inside:
            return Route()
        self.heard_on.add(link)
        if source[0] and len(self._routes) < _MAX_ROUTES:
            self._routes.add((*source, link))
        system, component = targets(message)
        ours = not system or system == self._system
        links = self._onwards(name, source, system, component) - {link}
        to_radar = self._radar is not None and ours and component in (None, 0, self._radar)
        if self._is_px4:
            to_autopilot = self._px4_takes(message, name, system, component)
        else:
            # what is for a component that lives nowhere else, ArduPilot takes for its own
            elsewhere = links or (to_radar and component == self._radar)
            to_autopilot = ours and (component in (None, 0, self._component) or not elsewhere)
            if name != "HEARTBEAT" and self.commanders is not None:
                to_autopilot = to_autopilot and source[0] in self.commanders
        return Route(tuple(sorted(links)), to_autopilot, to_radar)

    def _onwards(
        self, name: str, source: tuple[int, int], system: int | None, component: int | None
    ) -> set[int]:
        """The links with a target of a message; of another system any component will do."""
        if (system, component) == (self._system, self._component) or name in _NEVER_FORWARDED:
            return set()
        if name == "HEARTBEAT":
            return self.heard_on - {at for *who, at in self._routes if tuple(who) == source}
        if not system:
            return set(self.heard_on)
        anybody = not component or system != self._system
        return {
            at
            for its_system, its_component, at in self._routes
            if its_system == system and (anybody or its_component == component)
        }

    def _px4_takes(
        self, message: Any, name: str, system: int | None, component: int | None
    ) -> bool:
        if name.startswith("COMMAND_") and message.command in _FOR_EVERY_COMPONENT:
            return system in (0, self._system)
        if system != self._system and (system or name.startswith(_ADDRESSED)):
            return False
        return component in (None, 0, self._component)
