"""The companion as a MAVLink component: heartbeat and commands.

Sans-IO.
"""

from collections.abc import Sequence
from typing import final

from companion.mavlink.addressing import Reply
from companion.mavlink.commands import CommandServer
from companion.mavlink.dialect import COMPANION_COMPONENT, Message, wire
from companion.mavlink.own_messages import OwnMessages
from companion.mission.changes import OrderResult
from companion.mission.events import Order
from companion.mission.mission import Mission
from companion.mission.state import Phase, State


@final
class Component:
    """Commands and heartbeat of one companion."""

    def __init__(self, mission: Mission, system_id: int, version: str) -> None:
        ours = (system_id, COMPANION_COMPONENT)
        self._presence = OwnMessages(version)
        self._commands = CommandServer(
            ours=ours,
            commanders=mission.commanders,
            frame=mission.frame,
            limits=mission.task.limits,
            own_messages=self._presence,
        )

    def on_message(self, message: Message, now_s: float) -> Reply:
        """Handle a command of any sender; it may be addressed to another component."""
        return self._commands.on_message(message, now_s)

    def order_done(self, order: Order, verdict: OrderResult) -> Sequence[Message]:
        """The acknowledgement of an order, once its result is known."""
        return self._commands.order_done(order, verdict)

    @property
    def due_s(self) -> float:
        """When `on_time` must be called next, at the latest."""
        return self._presence.due_s

    def on_time(self, now_s: float, state: State, *, faulted: bool) -> list[Message]:
        """The messages that are due; no heartbeat while faulted or done."""
        return self._presence.on_time(now_s, None if faulted else system_status(state))


def system_status(state: State) -> int:
    """MAV_STATE: critical while it holds because of a fault."""
    if state.phase is Phase.WAITING:
        return int(wire.MAV_STATE_BOOT)
    if state.phase is Phase.HOLDING:
        warns = state.reason is None or state.reason.warns
        return int(wire.MAV_STATE_CRITICAL if warns else wire.MAV_STATE_ACTIVE)
    on_ground = state.phase in (Phase.PREPARING, Phase.READY, Phase.ARMING, Phase.SHADOW)
    return int(wire.MAV_STATE_STANDBY if on_ground else wire.MAV_STATE_ACTIVE)
