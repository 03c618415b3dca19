"""A ground station of its own: orders go to the companion as MAVLink commands, over a link.

So a button can do what any ground station can, and nothing else; what the page shows of it is the
companion's own acknowledgement and text (docs/ground-station.md).
"""

import threading
from collections.abc import Callable
from typing import Final, final

from companion.geodesy import LocalFrame, deg_e7
from companion.mavlink.dialect import COMPANION_COMPONENT, Message, wire
from companion.mavlink.frames import Receiver
from companion.mavlink.link import ids_in_words
from companion.mission.mission import Mission
from companion.runtime.link import Link, open_link

_COMPONENT: Final = wire.MAV_COMP_ID_MISSIONPLANNER
_ANSWER_S: Final = 2.0
_SENDS: Final = 3
_POLL_S: Final = 0.2
_HEARTBEATS: Final = 5  # polls between two of them
_RESULTS: Final = {
    wire.MAV_RESULT_ACCEPTED: "accepted",
    wire.MAV_RESULT_TEMPORARILY_REJECTED: "refused for now",
    wire.MAV_RESULT_DENIED: "refused",
    wire.MAV_RESULT_UNSUPPORTED: "not supported",
}


def command(number: int, first: float = 0.0) -> Message:
    """A command for where the vehicle is; first: its first parameter."""
    return wire.MAVLink_command_long_message(0, COMPANION_COMPONENT, number, 0, first, *(0.0,) * 6)


def keep_out(place_ne_m: tuple[float, float], frame: LocalFrame, radius_m: float) -> Message:
    """A circle to keep out of from now on; of radius 0: no longer, around the place."""
    return _at(wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, place_ne_m, frame, radius_m)


def go_to(place_ne_m: tuple[float, float], frame: LocalFrame) -> Message:
    """A new target."""
    return _at(wire.MAV_CMD_DO_REPOSITION, place_ne_m, frame, -1.0)


def _at(command: int, place_ne_m: tuple[float, float], frame: LocalFrame, first: float) -> Message:
    latitude_deg, longitude_deg = frame.to_geodetic_deg(*place_ne_m)
    return wire.MAVLink_command_int_message(
        0,
        COMPANION_COMPONENT,
        wire.MAV_FRAME_GLOBAL,
        command,
        0,
        0,
        *(first, 0.0, 0.0, 0.0),
        *(deg_e7(latitude_deg), deg_e7(longitude_deg), 0.0),
    )


@final
class GroundStation:
    """Sends orders and waits for what the companion answers; a thread of its own reads."""

    def __init__(self, address: str, mission: Mission) -> None:
        """address: of a link to the companion, as of --ground.  InputError if it cannot be."""
        self._link: Link = open_link(address, "--view-control")
        system, component = mission.commanders[0] if mission.commanders else (255, 0)
        self._codec = wire.MAVLink(None, srcSystem=system, srcComponent=component or _COMPONENT)
        self._receiver = Receiver()
        self._companion: int | None = mission.system_id
        self._others: frozenset[tuple[int, int]] = frozenset()
        """Heard, and no companion."""
        self._waits = threading.Condition()
        self._acks: list[Message] = []
        self._texts: list[str] = []
        self._over = threading.Event()
        self._order = threading.Lock()
        self._thread = threading.Thread(target=self._read, name="ground station", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End it."""
        self._over.set()
        self._thread.join()
        self._link.close()

    def order(self, make: Callable[[], Message]) -> str:
        """Give an order; the answer in words.  It is sent again if none comes."""
        with self._order:
            message = make()
            self._acks.clear()
            self._texts.clear()
            for attempt in range(_SENDS):
                if self._companion is None:
                    heard = f"; heard: {ids_in_words(sorted(self._others))}" if self._others else ""
                    wanted = f"component {COMPANION_COMPONENT}"
                    return f"no companion, {wanted}, was heard on the link: nothing was sent{heard}"
                message.target_system = self._companion
                if message.get_type() == "COMMAND_LONG":
                    message.confirmation = attempt
                self._link.send([message.pack(self._codec)])
                if (answer := self._answer(message.command)) is not None:
                    return answer
            return f"no answer within {_SENDS * _ANSWER_S:g} s"

    def _answer(self, command: int) -> str | None:
        with self._waits:
            got = self._waits.wait_for(
                lambda: any(ack.command == command for ack in self._acks), timeout=_ANSWER_S
            )
            if not got:
                return None
            result = next(ack.result for ack in self._acks if ack.command == command)
            said = _RESULTS.get(result, f"result {result}")
            if result != wire.MAV_RESULT_ACCEPTED:  # the reason follows
                self._waits.wait_for(lambda: bool(self._texts), timeout=_POLL_S)
            return ": ".join([said, *self._texts[-1:]])

    def _read(self) -> None:
        """Say that we are there, and hear."""
        polls = 0
        while not self._over.is_set():
            if polls % _HEARTBEATS == 0:
                beat = wire.MAVLink_heartbeat_message(
                    wire.MAV_TYPE_GCS, wire.MAV_AUTOPILOT_INVALID, 0, 0, wire.MAV_STATE_ACTIVE, 3
                )
                self._link.send([beat.pack(self._codec)])
            polls += 1
            data = self._link.receive(_POLL_S)
            for message in self._receiver.feed(data) if data else ():
                self._hear(message)

    def _hear(self, message: Message) -> None:
        if message.get_srcComponent() != COMPANION_COMPONENT:
            self._others |= {(message.get_srcSystem(), message.get_srcComponent())}
            return
        with self._waits:
            self._companion = message.get_srcSystem()
            match message.get_type():
                case "COMMAND_ACK":
                    self._acks.append(message)
                case "STATUSTEXT":
                    self._texts.append(message.text)
                case _:
                    pass
            self._waits.notify_all()
