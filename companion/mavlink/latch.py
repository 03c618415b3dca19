"""Which vehicle is ours: the one that the mission names, or the only one that is heard."""

from typing import final

from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire

_HEARTBEATS = 3  # of one system, and of no other, at one a second: then it is the vehicle
_ENOUGH = 10  # of any: then it will not become clear by itself
_NO_AUTOPILOTS = (wire.MAV_TYPE_GCS, wire.MAV_TYPE_ONBOARD_CONTROLLER)


@final
class Latch:
    """Counts the heartbeats of autopilots until it is clear whose companion we are.

    Their number stands for time: replayed, the same messages latch the same vehicle.
    """

    def __init__(self, system_id: int | None) -> None:
        self.system_id = system_id
        """Of our vehicle; None: not known yet."""
        self.others: set[int] = set()
        """Systems with an autopilot that are not ours, or may not be."""
        self._heard: dict[int, int] = {}

    @property
    def ambiguity(self) -> str:
        """What to say once several autopilots have been heard for a while; empty: it is clear."""
        if self.system_id is not None or sum(self._heard.values()) < _ENOUGH:
            return ""
        names = ", ".join(str(system) for system in sorted(self.others))
        return f"systems {names} are heard, choose one with --system"

    def is_ours(self, message: Message) -> bool:
        """Whether our autopilot sent this; as long as none is ours: whether any did."""
        if self.system_id is None:
            return is_an_autopilots(message)
        of_system = message.get_srcSystem() == self.system_id
        return of_system and message.get_srcComponent() == AUTOPILOT_COMPONENT

    def on_message(self, message: Message) -> bool:
        """Whether it has become clear with this message."""
        system = message.get_srcSystem()
        if not is_an_autopilots(message) or system == self.system_id:
            return False
        self.others.add(system)
        if self.system_id is not None:
            return False
        self._heard[system] = self._heard.get(system, 0) + 1
        if len(self._heard) > 1 or self._heard[system] < _HEARTBEATS:
            return False
        self.system_id = system
        self.others.clear()
        return True


def is_an_autopilots(message: Message) -> bool:
    """Whether this is the heartbeat of an autopilot: others are forwarded onto the link too."""
    if message.get_type() != "HEARTBEAT" or message.get_srcComponent() != AUTOPILOT_COMPONENT:
        return False
    flies = message.type not in _NO_AUTOPILOTS
    return bool(flies and message.autopilot != wire.MAV_AUTOPILOT_INVALID)
