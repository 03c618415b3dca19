"""The sensors of a vehicle beside those of its autopilot: what each of them says of itself.

Each is a class, with all that the companion knows of it; session, streams, preflight and mission
file ask for no more.  Sans-IO; times are those of the vehicle.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Final, Protocol

from companion.mavlink.checks import Check
from companion.mavlink.dialect import Message
from companion.mavlink.near_sensing import NearScanner
from companion.mavlink.poses import Poses, Reads
from companion.mavlink.rangefinder import Rangefinder
from companion.mavlink.terrain_download import TerrainRadar
from companion.mission.events import Event, ScanDone, Vector
from companion.mission.mission import Mission
from companion.mission.state import State
from companion.world.known_map import KnownMap


class Sensor(Protocol):
    """One sensor: made of the mission, and of the poses that all of them share."""

    @property
    def reads(self) -> Reads:
        """Component and kind of its messages; of one that needs poses, those of `Poses` too."""

    @property
    def streams_hz(self) -> Mapping[int, float]:
        """What the autopilot has to send for it, and how often; it may have nothing to say."""

    def seen(self, now_s: float, known: KnownMap, /) -> Event | None:
        """What is new: after each of its messages; if it needs poses, before a position is told."""

    def checks(self, state: State, scan: ScanDone | None, heard: str, /) -> Iterator[Check]:
        """Whether it works and fits the mission, before a flight.

        scan: the newest; heard: all that are heard, in words: it may only have another id.
        """


class Scanner(Sensor, Protocol):
    """A sensor that looks ahead when the mission asks for it, and is waited for."""

    def begin(self, centre_nea_m: Vector, state: State, now_s: float, /) -> int:
        """A scan about a point: how many blocks are asked for."""

    def go_on(self, now_s: float, here_nea_m: Vector | None, /) -> ScanDone | Message | None:
        """What it has shown, once it is over; until then, what has to be sent for it now."""


SENSORS: Final[dict[str, Callable[[Mission, Poses], Sensor]]] = {"rangefinder_error_m": Rangefinder}
"""By the field of `Mission` that says that it has one, which is a key of [vehicle] in its file.

What looks ahead has a table of its own there, [scanner].
"""


def scanner_of(mission: Mission, poses: Poses) -> Scanner:
    """What looks ahead; without anything it is a radar that shows nothing."""
    return TerrainRadar(mission) if mission.near is None else NearScanner(mission, poses)


def others_of(mission: Mission, poses: Poses) -> list[Sensor]:
    """All others that it has."""
    has = [make for field, make in SENSORS.items() if getattr(mission, field) is not None]
    return [make(mission, poses) for make in has]
