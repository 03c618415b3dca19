"""Routing: which frames are forwarded to other links, and which are for this vehicle.

Measured in ardupilot.md 3 ("Who may send") and 5, and in px4.md 2; PX4 forwards between links that
were started with forwarding, as those of its simulator are.
"""

from typing import Any, Final, NamedTuple, final

from vehicle_sim.autopilot.values import Sender

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


@final
class Router:
    """Learns on which link each component is, from the boot of the autopilot on.

    The radar is a component of its own, on a link inside the vehicle that never needs learning.  Of
    several vehicles on the same links one `forwards_all` between them, the others only what is for
    their own system.
    """

    def __init__(self, radar: int | None, *, forwards_all: bool = True) -> None:
        self._radar, self._forwards_all = radar, forwards_all
        self.boot_as(1, 1)

    def boot_as(self, system: int, component: int) -> None:
        """The autopilot boots with these ids: nobody has been heard yet."""
        self.ids = (system, component)
        self._routes = set[Sender]()
        self.heard_on = set[int]()
        """Links on which any sender was heard."""

    def route(self, message: Any, sender: Sender) -> Route:
        """Where this message goes."""
        if sender[:2] == self.ids:
            return Route(set(), to_autopilot=False, to_radar=False)  # its own frame comes back
        self.heard_on.add(sender.link)
        if sender.system and len(self._routes) < _MAX_ROUTES:
            self._routes.add(sender)
        system: int | None = getattr(message, "target_system", None)
        component: int | None = getattr(message, "target_component", None)
        links, is_for_us = set[int](), not system or system == self.ids[0]
        forwards = self._forwards_all or system == self.ids[0]
        if forwards and message.get_type() not in _NEVER_FORWARDED:
            links = self._links_to(system, component) - {sender.link}
            if message.get_type() == "HEARTBEAT":  # of who is on two links it would go round
                links -= {route.link for route in self._routes if route[:2] == sender[:2]}
        to_autopilot = is_for_us and component in (None, 0, self.ids[1])
        to_radar = is_for_us and self._radar is not None and component in (None, 0, self._radar)
        return Route(links, to_autopilot, to_radar)

    def _links_to(self, system: int | None, component: int | None) -> set[int]:
        """The links with this target; of another system any component will do."""
        if (system, component) == self.ids:
            return set()
        if not system:
            return set(self.heard_on)
        anybody = not component or system != self.ids[0]
        return {
            route.link
            for route in self._routes
            if route.system == system and (anybody or route.component == component)
        }
