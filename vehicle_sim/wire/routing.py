"""Routing: which frames are forwarded to other links, and which are for this vehicle.

Measured in ardupilot.md 3 ("Who may send") and 5, and in px4.md 2; PX4 forwards between links that
were started with forwarding, as those of its simulator are.
"""

from collections.abc import Iterable
from typing import Any, Final, NamedTuple, final

_NEVER_FORWARDED: Final = frozenset({"RADIO", "RADIO_STATUS", "SETUP_SIGNING"})
"""Handled by the vehicle and kept off its other links."""
_MAX_ROUTES: Final = 20
"""MAVLINK_MAX_ROUTES of ArduPilot: who comes later is not learnt."""


@final
class Route(NamedTuple):
    """What becomes of one frame."""

    links: set[int]
    """It goes on, unchanged, to these links."""
    to_autopilot: bool
    to_radar: bool


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
    ) -> None:
        self._system, self._component, self._radar = system, component, radar
        self._inside = {component, radar, *drivers}
        """Whose frames, if they come back, are passed over."""
        self._routes = set[tuple[int, int, int]]()
        """System, component and link of everybody who was heard."""
        self.heard_on = set[int]()
        """Links on which any sender was heard."""

    def route(self, message: Any, link: int) -> Route:
        """Where this message goes that came by this link."""
        header, (system, component) = message.get_header(), targets(message)
        source = (header.srcSystem, header.srcComponent)
        if source[0] == self._system and source[1] in self._inside:
            return Route(set(), to_autopilot=False, to_radar=False)
        self.heard_on.add(link)
        if source[0] and len(self._routes) < _MAX_ROUTES:
            self._routes.add((*source, link))
        links = set[int]()
        if message.get_type() not in _NEVER_FORWARDED:
            links = self._links_to(system, component) - {link}
        ours = not system or system == self._system
        to_autopilot = ours and component in (None, 0, self._component)
        to_radar = ours and self._radar is not None and component in (None, 0, self._radar)
        return Route(links, to_autopilot, to_radar)

    def _links_to(self, system: int | None, component: int | None) -> set[int]:
        """The links with this target; of another system any component will do."""
        if (system, component) == (self._system, self._component):
            return set()
        if not system:
            return set(self.heard_on)
        anybody = not component or system != self._system
        return {
            at
            for its_system, its_component, at in self._routes
            if its_system == system and (anybody or its_component == component)
        }
