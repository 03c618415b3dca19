"""The vehicle's side of all its links: bytes in, messages for the vehicle out, and back.

Parsing, signatures, routing and sequence numbers come together here; what the messages mean does
not.  Frames for another link are forwarded unchanged.
"""

from collections.abc import Container, Iterable
from typing import Any, NamedTuple, final

import numpy as np

from vehicle_sim.autopilots import FirmwareProfile
from vehicle_sim.conditions import LinkConditions
from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.wire.impairments import Impairments
from vehicle_sim.wire.messages import AUTOPILOT_COMPONENT
from vehicle_sim.wire.routing import Router, targets
from vehicle_sim.wire.signing import Signing

_TIMESYNC = 111


@final
class Received(NamedTuple):
    """A message that is for this vehicle."""

    link: int
    message: Any
    to_autopilot: bool
    to_radar: bool


@final
class Radio:
    """Frames of one vehicle on all its links."""

    def __init__(
        self,
        *,
        system: int,
        component: int = AUTOPILOT_COMPONENT,
        radar_component: int | None,
        lidar_component: int | None = None,
        profile: FirmwareProfile,
        links: int,
        byte_streams: Container[int],
        forwards_all: bool,
        rng: np.random.Generator,
    ) -> None:
        self.links = range(links)
        self.signing = None if profile.firmware == "px4" else Signing(links=links)
        self._firmware = profile.firmware
        self._beside = (radar_component, lidar_component)
        self._address(system, component)
        self._parsers = [StreamParser(datagrams=link not in byte_streams) for link in self.links]
        self._in = [Impairments(rng, link=link, to_vehicle=True) for link in self.links]
        self._out = [Impairments(rng, link=link, to_vehicle=False) for link in self.links]
        self._after = [StreamParser(datagrams=True) for _ in self.links]
        """Of what comes out of the impairments."""
        self.impaired = False
        """Links are bad, or were: something may be held back."""
        self._outbox: list[tuple[int, bytes]] = []
        self._past: list[tuple[int, bytes]] = []
        self._question: tuple[int, bytes] | None = None
        self._forwards_all = forwards_all

    def _address(self, system: int, component: int) -> None:
        """As whom the vehicle speaks, and what is for it."""
        radar, lidar = self._beside
        self._system, self._component = system, component
        self.router = Router(
            system=system, component=component, radar=radar, lidar=lidar, firmware=self._firmware
        )
        self._packers: dict[tuple[int, ...], Packer] = {
            (link, each): Packer(system, each)
            for link in self.links
            for each in (component, radar, lidar)
            if each is not None
        }
        if self.signing is not None:
            for key, packer in self._packers.items():
                packer.signer = self.signing.signer(key[0])

    def boot_as(self, system: int, component: int) -> None:
        """The autopilot has booted with these ids, and its radar and lidar with it."""
        if (system, component) != (self._system, self._component):
            self._address(system, component)

    def restart(self) -> None:
        """The autopilot boots: routes are forgotten; the signing key is not."""
        self.router.restart()
        if self.signing is not None:
            self.signing.restart()

    def begin(self) -> None:
        """Count frames from here."""
        for packer in self._packers.values():
            packer.restart()

    def impair(self, conditions: LinkConditions) -> None:
        """From now on the links are this bad, in both directions."""
        self.impaired = conditions.any or self.impaired
        for each in (*self._in, *self._out):
            each.conditions = conditions

    # --- in -----------------------------------------------------------------------------------

    def receive(self, now_us: int, link: int, data: bytes) -> list[Received]:
        """What has just come by this link, as far as it is for this vehicle."""
        frames = self._parsers[link].feed(data)
        if not self.impaired or now_us == 0:  # hellos depend on wall time: chance leaves them be
            return self._let_in(now_us, link, frames)
        received = []
        for frame, message in frames:
            if _keeps_time(message):
                received += self._let_in(now_us, link, [(frame, message)])
            else:
                self._in[link].push(now_us, frame)
        return received + self._late(now_us, link)

    def late(self, now_us: int) -> list[Received]:
        """What came earlier and was held back until now."""
        return [each for link in self.links for each in self._late(now_us, link)]

    def _late(self, now_us: int, link: int) -> list[Received]:
        frames = b"".join(self._in[link].pop(now_us))
        return self._let_in(now_us, link, self._after[link].feed(frames)) if frames else []

    def _let_in(
        self, now_us: int, link: int, frames: Iterable[tuple[bytes, Any]]
    ) -> list[Received]:
        """Intact frames: those that are signed as they must be go to whom they are for."""
        received = []
        for frame, message in frames:
            if self.signing is not None and not self.signing.accepts(frame, link, now_us):
                continue
            route = self.router.route(message, link)
            if self._forwards_all or targets(message)[0] == self._system:
                self._outbox += [(other, frame) for other in route.links if other in self.links]
            if route.to_autopilot or route.to_radar:
                to = (route.to_autopilot, route.to_radar)
                received.append(Received(link, message, *to))
        return received

    # --- out ----------------------------------------------------------------------------------

    def send(self, message: Any, link: int, component: int | None = None) -> None:
        """Queue a message of one of the vehicle's components; None: of the autopilot."""
        by = self._component if component is None else component
        self._outbox.append((link, self._packers[link, by].frame(message)))

    def send_back(self, received: Received) -> None:
        """Send a client its own frame."""
        self._outbox.append((received.link, bytes(received.message.get_msgbuf())))

    def send_as(self, message: Any, system: int, component: int) -> None:
        """Send a message in somebody else's name, on every link."""
        for link in self.links:
            key = (link, system, component)
            packer = self._packers.setdefault(key, Packer(system, component))
            self._outbox.append((link, packer.frame(message)))

    def broadcast(self, message: Any, component: int | None = None) -> None:
        """The same, on every link."""
        for link in self.links:
            self.send(message, link, component)

    def send_last(self, message: Any, link: int) -> None:
        """Queue a question of lockstep: after all else, and past what is wrong with the link."""
        self._question = (link, self._packers[link, self._component].frame(message))
        self._past.append(self._question)

    def send_last_again(self) -> None:
        """Send the same frame again: another client may be listening now."""
        if self._question is not None:
            self._past.append(self._question)

    def reopen(self, link: int) -> None:
        """Another client has connected: what the last one began to say is not continued."""
        self._parsers[link].forget()

    def take(self, now_us: int) -> list[tuple[int, bytes]]:
        """What goes out now: link and frame, in order."""
        frames, self._outbox = self._outbox, []
        past, self._past = self._past, []
        if self.impaired and now_us > 0:
            for link, frame in frames:
                self._out[link].push(now_us, frame)
            frames = [(link, frame) for link in self.links for frame in self._out[link].pop(now_us)]
        return frames + past if past else frames


def _keeps_time(message: Any) -> bool:
    """The answer to a question of lockstep: if a bad link ate it, time would stand still."""
    return message.id == _TIMESYNC and message.tc1 == message.ts1 != 0
