"""MAVLink addressing: target of a message, who may command, replies (mavlink.md 2.1 and C11)."""

import enum
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, final

from companion.mavlink.dialect import Message
from companion.mission.events import Order

Ids = tuple[int, int]
"""System and component id."""

ALL = 0
"""The id that means every system, or every component of one."""


class Address(enum.Enum):
    """The target of a message."""

    US = "us, by system and component"
    BROADCAST = "us and others: one of its two ids is 0"
    OTHERS = "others"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """The companion's reaction to a request."""

    replies: Sequence[Message] = ()
    """To be sent now."""
    order: Order | None = None
    """The order to carry out; `order_done` returns its ACK."""
    note: dict[str, Any] | None = None
    """For the journal."""
    text: str = ""
    """Reason for a refusal, as text for the operator; empty if there is none."""


def address_of(message: Message, ours: Ids) -> Address:
    """The target of a message with target ids."""
    target = (message.target_system, message.target_component)
    if sender_of(message) == ours:  # a router that sends things back
        return Address.OTHERS
    if target == ours:
        return Address.US
    fits = all(asked in (own, ALL) for asked, own in zip(target, ours, strict=True))
    return Address.BROADCAST if fits else Address.OTHERS


def sender_of(message: Message) -> Ids:
    """Who sent it."""
    return message.get_srcSystem(), message.get_srcComponent()


def may_command(sender: Ids, commanders: Iterable[Ids]) -> bool:
    """Whether the configuration lets this sender command us; 0 stands for any id."""
    return any(
        all(allowed in (own, ALL) for allowed, own in zip(commander, sender, strict=True))
        for commander in commanders
    )


def ids_text(ids: Ids) -> str:
    """As text: 255/190."""
    return f"{ids[0]}/{ids[1]}"
