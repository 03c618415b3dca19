"""Plays a log to a ground station: frames as they were recorded, at their times, at any speed.

The time of each frame follows from the log's time alone, so that delays do not accumulate.  What
the ground station answers is read and dropped.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Final, final

from msgspec import Struct
from msgspec.structs import replace
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from companion.errors import InputError
from companion.mavlink.dialect import COMPANION_COMPONENT
from companion.mavlink.frames import sender_of
from companion.mavlink.link import ids_in_words
from companion.runtime.connection import Address, parsed
from companion.runtime.link import Link, open_link
from companion.runtime.watchdog import Clock
from companion.telemetry.logs import Record, open_log
from companion.views.output import plain_console

_SLOWEST, _FASTEST = 0.1, 1000.0
_MAX_GAP_US: Final = 10_000_000
"""A gap in the log that is longer is played as one of this length."""
_MAX_BYTES_S: Final = 500_000.0
"""UDP loses what the other side does not read in time, and a ground station parses no faster."""
_BATCH_BYTES: Final = 8192
_TOGETHER_S: Final = 0.001
"""Frames that are due within this go together: a receiver's buffer holds few small datagrams."""
_POLL_S: Final = 0.1
_SHOWN_GAPS: Final = 5


@final
class PlaybackSettings(Struct, frozen=True, kw_only=True):
    """What of a log to play, and how fast."""

    speed: float = 1.0
    """Factor of real time."""
    from_s: float = 0.0
    """The first frame is the first one at or after this, seconds from the log's beginning."""
    until_s: float = math.inf
    """The last frame is the last one before this."""
    only_vehicle: int | None = None
    """System id whose frames alone are sent, without those of its companion; None: both ways."""

    def __post_init__(self) -> None:
        """Raises InputError if it is too fast or too slow."""
        if not _SLOWEST <= self.speed <= _FASTEST:
            rule = f"it must be from {_SLOWEST:g} to {_FASTEST:g}"
            raise InputError("--speed", self.speed, rule, "Leave it out for real time.")


@final
class PlaybackStats(Struct, kw_only=True):
    """Statistics of what was sent, updated while playing."""

    frames: int = 0
    bytes: int = 0
    at_s: float = 0.0
    """Time of the log, from its beginning."""
    wall_s: float = 0.0
    gaps: list[tuple[float, float]] = []
    """Gaps that were shortened: time of the log at which they begin, and their length."""

    @property
    def words(self) -> list[str]:
        """Notes for the operator, a line each."""
        lines = [
            f"at {at_s:.1f} s: a gap of {length_s:.1f} s was shortened"
            for at_s, length_s in self.gaps[:_SHOWN_GAPS]
        ]
        if len(self.gaps) > _SHOWN_GAPS:
            lines.append(f"{len(self.gaps) - _SHOWN_GAPS} more gaps were shortened")
        return lines


@final
class Player:
    """Sends records over a link when they are due."""

    def __init__(
        self, link: Link, clock: Clock, on_progress: Callable[[PlaybackStats], None]
    ) -> None:
        """clock: seconds that only rise; on_progress is called between frames."""
        self._link, self._clock, self._on_progress = link, clock, on_progress

    def wait_for_somebody(self) -> None:
        """Wait for the first datagram of the other side, which tells its address."""
        while self._link.receive(_POLL_S) is None:
            self._on_progress(PlaybackStats())
        self._link.answer_to(self._link.sender)

    def play(self, records: Iterable[Record], playing: PlaybackSettings) -> PlaybackStats:
        """Play records to their end.  Raises what reading them raises."""
        played, began_s, free_s = PlaybackStats(), self._clock(), -math.inf
        batch: list[bytes] = []
        batch_bytes = 0
        for offset_us, frame in _timed(records, playing, played):
            due_s = max(began_s + offset_us * 1e-6 / playing.speed, free_s)
            free_s = due_s + len(frame) / _MAX_BYTES_S
            is_later = due_s > self._clock() + _TOGETHER_S
            if batch and (is_later or batch_bytes + len(frame) > _BATCH_BYTES):
                self._send(batch, played, began_s)
                batch, batch_bytes = [], 0
            if is_later:
                self._wait_until(due_s)
            batch.append(frame)
            batch_bytes += len(frame)
        self._send(batch, played, began_s)
        return played

    def _send(self, batch: list[bytes], played: PlaybackStats, began_s: float) -> None:
        self._link.send(batch)
        played.frames += len(batch)
        played.bytes += sum(map(len, batch))
        played.wall_s = self._clock() - began_s
        self._on_progress(played)

    def _wait_until(self, due_s: float) -> None:
        """Wait, and drain what the other side sends meanwhile."""
        while (wait_s := due_s - self._clock()) > 0.0:
            self._link.receive(min(wait_s, _POLL_S))


def _timed(
    records: Iterable[Record], playing: PlaybackSettings, played: PlaybackStats
) -> Iterator[tuple[int, bytes]]:
    """The frames to send, and when: microseconds of play, at real time, from the first of them."""
    first_us: int | None = None
    before_us = offset_us = 0
    begun = False
    for record in records:
        if first_us is None:
            first_us = before_us = record.time_us
        step_us, before_us = record.time_us - before_us, record.time_us
        at_s = (record.time_us - first_us) * 1e-6
        if at_s < playing.from_s:
            continue
        if at_s >= playing.until_s:
            return
        if begun:
            if step_us > _MAX_GAP_US:
                played.gaps.append((at_s - step_us * 1e-6, step_us * 1e-6))
            offset_us += min(step_us, _MAX_GAP_US)
        begun, played.at_s = True, at_s
        if playing.only_vehicle is None or _is_of(record.frame, playing.only_vehicle):
            yield offset_us, record.frame


def _is_of(frame: bytes, vehicle: int) -> bool:
    """Whether a frame is a vehicle's own: its companion has the same system id."""
    system, component = sender_of(frame)
    return system == vehicle and component != COMPANION_COMPONENT


# --- the command


def play_file(
    file: Path,
    connect: str,
    playing: PlaybackSettings,
    *,
    system_id: int | None = None,
    only_vehicle: bool = False,
) -> PlaybackStats:
    """Play a log over the link that a connection string names, with a bar and a word at the end.

    system_id: of several vehicles in the log, the one that is played.  Raises InputError about the
    log or the link.
    """
    log = open_log(file, system_id=system_id)
    if only_vehicle:
        if log.system_id is None:
            rule = "the log has no autopilot in it"
            if log.elsewhere:
                rule += f" as component 1, only as {ids_in_words(sorted(log.elsewhere))}"
            raise InputError("--only-vehicle", True, rule, "Play it both ways.")
        playing = replace(playing, only_vehicle=log.system_id)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    place = parsed(connect)
    errors = plain_console(stderr=True)
    bars = Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal)
    with open_link(connect) as link, bars:
        bar = bars.add_task("waiting for a ground station", total=log.size_bytes)

        def show(played: PlaybackStats) -> None:
            if played.frames:
                words = f"playing {played.at_s:.0f} s"
                bars.update(bar, completed=log.read_bytes, description=words)

        player = Player(link, time.monotonic, show)
        if isinstance(place, Address) and place.kind != "udpout":
            player.wait_for_somebody()
        played = player.play(log.records(), playing)
    if not played.frames:
        rule = "no frame of the log lies there"
        raise InputError("--from", playing.from_s, rule, "Give a time within the log.")
    notes = [f"{file.name}: {finding}" for finding in log.findings] + played.words
    console = plain_console(soft_wrap=True)
    for note in notes:
        console.out(f"note: {note}", highlight=False)
    took = f"{played.frames} frames in {played.wall_s:.1f} s"
    console.out(f"{took}, up to {played.at_s:.1f} s of the log", highlight=False)
    return played
