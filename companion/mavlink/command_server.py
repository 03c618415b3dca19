"""Commands that people give to the companion: COMMAND_LONG and COMMAND_INT, and their ACKs.

Each command addressed to us, by system and component, is answered once (mavlink.md 2.5).  Of what
is broadcast only questions are answered: MISSION_START or RETURN_TO_LAUNCH to everybody is for the
autopilot, which obeys it too.  Orders are taken from the senders that the configuration names, and
from nobody else; questions from everybody.  Nothing that we are told takes long, so there is
nothing that COMMAND_CANCEL could cancel.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, final

from companion.geodesy import LocalFrame
from companion.mavlink.addressing import Address, Ids, address_of, may_command, sender_of, written
from companion.mavlink.commands import Command, Commands, Meaning, Result, command_of
from companion.mavlink.dialect import Message, wire
from companion.mavlink.presence import Presence
from companion.mission.events import Order
from companion.path.limits import Limits

_SAME_S = 5.0  # a command that comes again within this time may be the same one
_MOST_SENDERS = 64


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What follows from one message."""

    replies: tuple[Message, ...] = ()
    """To be sent now."""
    order: Order | None = None
    """To be obeyed; its ACK is what `CommandServer.order_done` gives."""
    note: dict[str, Any] | None = None
    """For the journal."""
    text: str = ""
    """Why it was refused, for people; empty if there is nothing to say."""


@final
@dataclass(slots=True, kw_only=True)
class _Given:
    """An order that somebody has given."""

    sender: Ids
    command: Command
    order: Order
    result: Result = Result.IN_PROGRESS


@final
class CommandServer:
    """Answers commands; what flies is decided by the mission machine.  Pure: time is an argument.

        answer = server.on_message(message, now_s)
        if answer.order is not None:            # give it to the machine, then
            send(server.order_done(answer.order, accepted))

    ours: our ids; commanders: who may give orders (0: any id); limits: the mission's own.
    """

    def __init__(
        self,
        *,
        ours: Ids,
        commanders: Iterable[Ids],
        frame: LocalFrame,
        limits: Limits,
        presence: Presence,
    ) -> None:
        self.ours = ours
        self._commanders = tuple(commanders)
        self._commands = Commands(frame=frame, limits=limits, presence=presence)
        self._last: dict[Ids, _Given] = {}
        """The last order of each sender, the newest at the end."""

    def on_message(self, message: Message, now_s: float) -> Answer:
        """Answer a command; any other message, and one that is not for us, gives nothing."""
        command = command_of(message)
        if command is None:
            return Answer()
        match address_of(message, self.ours):
            case Address.US:
                return self._for_us(command, now_s)
            case Address.EVERYBODY:
                return self._for_everybody(command)
            case Address.OTHERS:
                return Answer()

    def order_done(
        self, order: Order, accepted: bool, *, invalid: bool = False
    ) -> tuple[Message, ...]:
        """The ACK of an order that the machine has taken, or not.

        invalid: it could never be obeyed as it is (DENIED); otherwise it may be tried again later.
        Empty for an order that is not waiting for its ACK.
        """
        for given in self._last.values():
            if given.order is order and given.result is Result.IN_PROGRESS:
                refused = Result.DENIED if invalid else Result.TEMPORARILY_REJECTED
                given.result = Result.ACCEPTED if accepted else refused
                return (_ack(given.command.number, given.result, given.sender),)
        return ()

    def _for_us(self, command: Command, now_s: float) -> Answer:
        sender = sender_of(command.message)
        before = self._last.get(sender)
        if before is not None and _is_repeated(command, before, now_s):
            return Answer(replies=(_ack(command.number, before.result, sender),))
        meaning = self._meaning(command, sender)
        note = {"kind": "command", "sender": written(sender), "command": command.number}
        if meaning.order is None:
            ack = _ack(command.number, meaning.result, sender)
            note |= {"result": meaning.result.name.lower(), "why": meaning.text}
            return Answer(replies=(ack, *meaning.replies), note=note, text=meaning.text)
        order = Order(
            time_s=now_s,
            kind=meaning.order,
            target_ne_m=meaning.target_ne_m,
            speed_m_s=meaning.speed_m_s,
            sender=written(sender),
        )
        self._remember(_Given(sender=sender, command=command, order=order))
        return Answer(order=order, note={**note, "order": order.kind.name.lower()})

    def _for_everybody(self, command: Command) -> Answer:
        """Of what is broadcast, the questions that we have an answer to; never an order."""
        meaning = self._commands.answer_to(command)
        if meaning is None or meaning.result is not Result.ACCEPTED:
            return Answer()
        ack = _ack(command.number, meaning.result, sender_of(command.message))
        return Answer(replies=(ack, *meaning.replies))

    def _remember(self, given: _Given) -> None:
        self._last.pop(given.sender, None)
        self._last[given.sender] = given
        if len(self._last) > _MOST_SENDERS:
            del self._last[next(iter(self._last))]

    def _meaning(self, command: Command, sender: Ids) -> Meaning:
        answer = self._commands.answer_to(command)
        if answer is not None:
            return answer
        if self._commands.is_order(command) and not may_command(sender, self._commanders):
            who = f"{written(sender)} may not command: see link.commanders"
            return Meaning(Result.DENIED, who)
        return self._commands.meaning_of(command)


def _is_repeated(command: Command, before: _Given, now_s: float) -> bool:
    """Whether a command is the sender's last order sent again because its ACK was lost.

    A COMMAND_LONG says so itself.  A COMMAND_INT cannot: it is taken for the same one if that was
    accepted just before; one that was refused may be tried again.
    """
    age_s = now_s - before.order.time_s
    if command.values != before.command.values or not 0.0 <= age_s <= _SAME_S:
        return False
    if command.confirmation is not None:
        return command.confirmation > 0
    return before.result in (Result.ACCEPTED, Result.IN_PROGRESS)


def _ack(command: int, result: Result, to: Ids) -> Message:
    return wire.MAVLink_command_ack_message(command, int(result), 0, 0, *to)
