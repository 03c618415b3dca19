"""What the protocols of wire/ answer, beyond what autopilots do: messages to clients, and news."""

from dataclasses import dataclass
from typing import Any, final

from vehicle_sim.autopilots import Command, Reply, Sender
from vehicle_sim.plans import PlanKind


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Deliver:
    """A message for one client on its link, or for every link if nobody is named."""

    message: Any
    to: Sender | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterSet:
    """A client has set this parameter: the autopilot is to be told (Autopilot.on_parameter)."""

    name: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlanReplaced:
    """A client has replaced this list: the autopilot is to be told (Autopilot.on_plan)."""

    kind: PlanKind


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Unacknowledged:
    """A message that asks for the same as this command: do it, and send no COMMAND_ACK."""

    command: Command


Answer = Reply | Deliver | ParameterSet | PlanReplaced | Unacknowledged
