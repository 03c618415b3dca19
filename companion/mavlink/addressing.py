"""Who a message is for, whose word counts (mavlink.md 2.1 and C11), and what it is answered."""

import enum
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, final

from companion.mavlink.dialect import Message
from companion.mission.events import Order
from companion.planner.settings import Task

Ids = tuple[int, int]
"""System and component id."""

ALL = 0
"""The id that means every system, or every component of one."""


class Address(enum.Enum):
    """Whom a message is for."""

    US = "us, by system and component"
    EVERYBODY = "us and others: one of its two ids is 0"
    OTHERS = "others"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What follows from a message that asks something of the companion."""

    replies: Sequence[Message] = ()
    """To be sent now."""
    is_for_all: bool = False
    """Whether everybody is to hear them, not only who has asked."""
    order: Order | None = None
    """To be obeyed; its ACK is what `order_done` gives."""
    note: dict[str, Any] | None = None
    """For the journal."""
    text: str = ""
    """Why it was refused, for people; empty if there is nothing to say."""
    changed: str = ""
    """What of the planner's settings was changed, to `task`: name = value."""
    task: Task | None = None


def address_of(message: Message, ours: Ids) -> Address:
    """Whom a message with target ids is for; our own messages come from no one else."""
    target = (message.target_system, message.target_component)
    if sender_of(message) == ours:  # a router that sends things back
        return Address.OTHERS
    if target == ours:
        return Address.US
    fits = all(asked in (own, ALL) for asked, own in zip(target, ours, strict=True))
    return Address.EVERYBODY if fits else Address.OTHERS


def sender_of(message: Message) -> Ids:
    """Who sent it."""
    return message.get_srcSystem(), message.get_srcComponent()


def may_command(sender: Ids, commanders: Iterable[Ids]) -> bool:
    """Whether the configuration lets this sender command us; 0 stands for any id."""
    return any(
        all(allowed in (own, ALL) for allowed, own in zip(commander, sender, strict=True))
        for commander in commanders
    )


def written(ids: Ids) -> str:
    """As people write it: 255/190."""
    return f"{ids[0]}/{ids[1]}"
