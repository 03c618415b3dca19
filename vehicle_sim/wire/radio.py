"""The vehicle's side of all its links: bytes in, messages for the vehicle out, and back.

Parsing, signatures, routing and sequence numbers come together here; what the messages mean does
not.  Frames for another link are forwarded unchanged.
"""

from collections import Counter
from collections.abc import Callable, Container, Iterable
from functools import partial
from typing import Any, final

import numpy as np

from vehicle_sim.autopilot.values import Sender
from vehicle_sim.faults import LinkConditions
from vehicle_sim.wire.frames import StreamParser, framed
from vehicle_sim.wire.impairments import Impairments
from vehicle_sim.wire.routing import Route, Router
from vehicle_sim.wire.signing import Signing

Ids = tuple[int, int]
"""Of a system and a component."""
Links = Iterable[int] | None
Frame = tuple[int, bytes]
"""With the link that it goes by."""


@final
class Radio:
    """Frames of one vehicle on all its links.

    signing: none of PX4, which never signs and takes everything.  receive: what is done with a
    message that is for this vehicle.
    """

    def __init__(
        self,
        router: Router,
        signing: Signing | None,
        receive: Callable[[Sender, Any, Route], None],
        *,
        links: int,
        byte_streams: Container[int],
        rng: np.random.Generator,
    ) -> None:
        self.links = range(links)
        self.router, self.signing, self._receive = router, signing, receive
        self._parsers = [StreamParser(datagrams=link not in byte_streams) for link in self.links]
        self._in = Impairments[tuple[bytes, Any]](rng, to_vehicle=True)
        self._out = Impairments[bytes](rng, to_vehicle=False)
        self.impaired = False
        """Links are bad, or were: something may be held back."""
        self._outbox: list[Frame] = []
        self._question: list[Frame] = []
        """The newest one of lockstep."""
        self._past: list[Frame] = []
        """Such questions: they go after all else, and past what is wrong with the link."""
        self._sent = Counter[tuple[int, Ids]]()
        """Frames, by link and source."""

    def begin(self) -> None:
        """Count frames from here."""
        self._sent.clear()

    def impair(self, conditions: LinkConditions) -> None:
        """From now on the links are this bad, in both directions."""
        self.impaired = conditions.any or self.impaired
        self._in.impair(conditions)
        self._out.impair(conditions)

    # --- in -----------------------------------------------------------------------------------

    def receive(self, now_us: int, link: int, data: bytes) -> None:
        """Handle what has just come by this link.

        Nothing is wrong with hellos, which depend on wall time, nor with the answer to lockstep's
        question: if a bad link ate it, time would stand still.
        """
        for frame, message in self._parsers[link].feed(data):
            answers = message.get_type() == "TIMESYNC" and message.tc1 == message.ts1 != 0
            if answers or not self.impaired or now_us == 0:
                self._let_in(link, frame, message)
            else:
                self._in.push(now_us, link, (frame, message))
        if self.impaired:
            self.late(now_us)

    def late(self, now_us: int) -> None:
        """Handle what came earlier and was held back until now."""
        for link, (frame, message) in self._in.pop(now_us):
            self._let_in(link, frame, message)

    def _let_in(self, link: int, frame: bytes, message: Any) -> None:
        """One that is signed as it must be goes to whom it is for."""
        if self.signing is not None and not self.signing.accepts(frame, link):
            return
        by = message.get_header()
        sender = Sender(by.srcSystem, by.srcComponent, link)
        route = self.router.route(message, sender)
        self._outbox += [(other, frame) for other in sorted(route.links)]
        if route.to_autopilot or route.to_radar:
            self._receive(sender, message, route)

    # --- out ----------------------------------------------------------------------------------

    def send(self, message: Any, links: Links = None, source: Ids | None = None) -> None:
        """Queue a message; of the autopilot and on every link, if nothing else is said."""
        for link in self.links if links is None else links:
            self._outbox.append((link, self._frame(message, link, source or self.router.ids)))

    def ask(self, message: Any, link: int) -> None:
        """Queue a question of lockstep."""
        self._question = [(link, self._frame(message, link, self.router.ids))]
        self.ask_again()

    def ask_again(self) -> None:
        """Queue the same frame again: another client may be listening now."""
        self._past += self._question

    def _frame(self, message: Any, link: int, source: Ids) -> bytes:
        signing, signature, number = self.signing, None, self._sent[link, source] & 255
        if signing is not None and signing.secret and source[0] == self.router.ids[0]:
            signature = partial(signing.signature, link=link)
        self._sent[link, source] += 1
        return framed(message, number, *source, signature)

    def take(self, now_us: int) -> list[Frame]:
        """What goes out now: link and frame, in order."""
        frames, self._outbox = self._outbox, []
        past, self._past = self._past, []
        if self.impaired and now_us > 0:
            for link, frame in frames:
                self._out.push(now_us, link, frame)
            frames = self._out.pop(now_us)
        return frames + past if past else frames
