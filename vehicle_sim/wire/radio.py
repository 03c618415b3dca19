"""The vehicle's side of all its links: bytes in, messages for the vehicle out, and back.

Parsing, signatures, routing and sequence numbers come together here; what the messages mean does
not.  Frames for another link are forwarded unchanged.
"""

from collections import Counter
from collections.abc import Container, Iterable
from functools import partial
from typing import Any, NamedTuple, final

import numpy as np

from vehicle_sim.autopilot.values import Sender
from vehicle_sim.faults import LinkConditions
from vehicle_sim.parameters import Firmware
from vehicle_sim.wire.frames import StreamParser, framed
from vehicle_sim.wire.impairments import Impairments
from vehicle_sim.wire.routing import Router, targets
from vehicle_sim.wire.signing import Signing

Frame = tuple[int, bytes]
"""With the link that it goes by."""


@final
class Received(NamedTuple):
    """A message that is for this vehicle."""

    sender: Sender
    message: Any
    to_autopilot: bool
    to_radar: bool


@final
class Radio:
    """Frames of one vehicle on all its links."""

    def __init__(
        self,
        *,
        radar: int | None,
        drivers: set[int],
        firmware: Firmware,
        links: int,
        byte_streams: Container[int],
        forwards_all: bool,
        rng: np.random.Generator,
    ) -> None:
        self.links = range(links)
        self.signing = None if firmware == "px4" else Signing()
        self._forwards_all = forwards_all
        self._make_router = partial(Router, radar=radar, drivers=drivers)
        self._parsers = [StreamParser(datagrams=link not in byte_streams) for link in self.links]
        self._in = [Impairments[Any](rng, link=link, to_vehicle=True) for link in self.links]
        self._out = [Impairments[bytes](rng, link=link, to_vehicle=False) for link in self.links]
        self.impaired = False
        """Links are bad, or were: something may be held back."""
        self._outbox: list[Frame] = []
        self._question: list[Frame] = []
        """The newest one of lockstep."""
        self._past: list[Frame] = []
        """Such questions: they go after all else, and past what is wrong with the link."""
        self._sent = Counter[tuple[int, int, int]]()
        """Frames, by link, system and component."""

    def boot_as(self, system: int, component: int) -> None:
        """The autopilot boots with these ids: routes are forgotten; what is signed goes on."""
        self._ids = (system, component)
        self.router: Router = self._make_router(system=system, component=component)

    def begin(self) -> None:
        """Count frames from here."""
        self._sent.clear()

    def impair(self, conditions: LinkConditions) -> None:
        """From now on the links are this bad, in both directions."""
        self.impaired = conditions.any or self.impaired
        for each in (*self._in, *self._out):
            each.impair(conditions)

    # --- in -----------------------------------------------------------------------------------

    def receive(self, now_us: int, link: int, data: bytes) -> list[Received]:
        """What has just come by this link, as far as it is for this vehicle."""
        frames = self._parsers[link].feed(data)
        if not self.impaired or now_us == 0:  # hellos depend on wall time: chance leaves them be
            return self._let_in(link, frames)
        let_in = list[tuple[bytes, Any]]()
        for frame, message in frames:
            if message.get_type() == "TIMESYNC" and message.tc1 == message.ts1 != 0:
                # an answer to lockstep's question: if a bad link ate it, time would stand still
                let_in.append((frame, message))
            else:
                self._in[link].push(now_us, (frame, message))
        return self._let_in(link, [*let_in, *self._in[link].pop(now_us)])

    def late(self, now_us: int) -> list[Received]:
        """What came earlier and was held back until now."""
        return [
            received
            for link in self.links
            for received in self._let_in(link, self._in[link].pop(now_us))
        ]

    def _let_in(self, link: int, frames: Iterable[tuple[bytes, Any]]) -> list[Received]:
        """Intact frames: those that are signed as they must be go to whom they are for."""
        received = []
        for frame, message in frames:
            if self.signing is not None and not self.signing.accepts(frame, link):
                continue
            links, *to = self.router.route(message, link)
            if self._forwards_all or targets(message)[0] == self._ids[0]:
                self._outbox += [(other, frame) for other in sorted(links)]
            if any(to):
                by = message.get_header()
                sender = Sender(by.srcSystem, by.srcComponent, link)
                received.append(Received(sender, message, *to))
        return received

    # --- out ----------------------------------------------------------------------------------

    def send(
        self,
        message: Any,
        links: Iterable[int] | None = None,
        *,
        system: int | None = None,
        component: int | None = None,
    ) -> None:
        """Queue a message; of the autopilot and on every link, if nothing else is said."""
        by = (system or self._ids[0], component or self._ids[1])
        self._outbox += [
            (link, self._frame(message, link, *by))
            for link in (self.links if links is None else links)
        ]

    def ask(self, message: Any, link: int) -> None:
        """Queue a question of lockstep."""
        self._question = [(link, self._frame(message, link, *self._ids))]
        self.ask_again()

    def ask_again(self) -> None:
        """Queue the same frame again: another client may be listening now."""
        self._past += self._question

    def _frame(self, message: Any, link: int, system: int, component: int) -> bytes:
        key, signature = (link, system, component), None
        if self.signing is not None and self.signing.secret and system == self._ids[0]:
            signature = partial(self.signing.signature, link=link)
        number = self._sent[key] & 255
        self._sent[key] += 1
        return framed(message, number, system, component, signature)

    def take(self, now_us: int) -> list[Frame]:
        """What goes out now: link and frame, in order."""
        frames, self._outbox = self._outbox, []
        past, self._past = self._past, []
        if self.impaired and now_us > 0:
            for link, frame in frames:
                self._out[link].push(now_us, frame)
            frames = [(link, frame) for link in self.links for frame in self._out[link].pop(now_us)]
        return frames + past if past else frames
