"""The vehicle's side of all its links: bytes in, messages for the vehicle out, and back.

Parsing, signatures, routing and sequence numbers come together here; what the messages mean does
not.  Frames for another link are forwarded unchanged.
"""

from collections.abc import Container, Iterable
from functools import partial
from typing import Any, NamedTuple, final

import numpy as np

from vehicle_sim.autopilot.values import Sender
from vehicle_sim.faults import LinkConditions
from vehicle_sim.parameters import Firmware
from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.wire.impairments import Impairments
from vehicle_sim.wire.routing import Router, targets
from vehicle_sim.wire.signing import Signing


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
        self._make_router = partial(Router, radar=radar, drivers=drivers, firmware=firmware)
        self._parsers = [StreamParser(datagrams=link not in byte_streams) for link in self.links]
        self._in = [Impairments[Any](rng, link=link, to_vehicle=True) for link in self.links]
        self._out = [Impairments[bytes](rng, link=link, to_vehicle=False) for link in self.links]
        self.impaired = False
        """Links are bad, or were: something may be held back."""
        self._outbox: list[tuple[int, bytes]] = []
        self._past: list[tuple[int, bytes]] = []
        """Questions of lockstep: they go after all else."""
        self._question: list[tuple[int, bytes]] = []
        self._packers: dict[tuple[int, int, int], Packer] = {}
        """By link, system and component."""

    def boot_as(self, system: int, component: int) -> None:
        """The autopilot boots with these ids: routes are forgotten; what is signed goes on."""
        self._ids = (system, component)
        self.router: Router = self._make_router(system=system, component=component)

    def begin(self) -> None:
        """Count frames from here."""
        self._packers.clear()

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
                self._outbox += [(other, frame) for other in links if other in self.links]
            if any(to):
                by = message.get_header()
                sender = Sender(by.srcSystem, by.srcComponent, link)
                received.append(Received(sender, message, *to))
        return received

    # --- out ----------------------------------------------------------------------------------

    def _frame(self, message: Any, *key: int) -> tuple[int, bytes]:
        """The message as the next frame on a link of a system's component."""
        link, system, component = key
        packer = self._packers.get((link, system, component))
        if packer is None:
            signing = self.signing if system == self._ids[0] else None
            packer = Packer(system, component, signing, link)
            self._packers[link, system, component] = packer
        return link, packer.frame(message)

    def send(self, message: Any, link: int, component: int | None = None) -> None:
        """Queue a message of one of the vehicle's components; None: of the autopilot."""
        system, autopilot = self._ids
        by = autopilot if component is None else component
        self._outbox.append(self._frame(message, link, system, by))

    def broadcast(self, message: Any, component: int) -> None:
        """The same, on every link."""
        self.broadcast_as(message, self._ids[0], component)

    def broadcast_as(self, message: Any, system: int, component: int) -> None:
        """Send a message in somebody's name, on every link."""
        self._outbox += [self._frame(message, link, system, component) for link in self.links]

    def ask(self, message: Any, link: int) -> None:
        """Queue a question of lockstep: after all else, and past what is wrong with the link."""
        self._question = [self._frame(message, link, *self._ids)]
        self.ask_again()

    def ask_again(self) -> None:
        """Queue the same frame again: another client may be listening now."""
        self._past += self._question

    def take(self, now_us: int) -> list[tuple[int, bytes]]:
        """What goes out now: link and frame, in order."""
        frames, self._outbox = self._outbox, []
        past, self._past = self._past, []
        if self.impaired and now_us > 0:
            for link, frame in frames:
                self._out[link].push(now_us, frame)
            frames = [(link, frame) for link in self.links for frame in self._out[link].pop(now_us)]
        return frames + past if past else frames
