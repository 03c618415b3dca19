"""The ground as it was known: a session that is fed the recorded inputs knows what the flight knew.

It decides nothing and sends nothing: the answers of the planner are taken as recorded, so it runs
at hundreds of times real time, behind a flight as well as after it.
"""

import pickle
import time
import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple, final

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from companion.errors import InputError
from companion.mission.mission import Mission
from companion.replay.feed import RUNTIME_RECORDS, DamagedInputError, Feeder, flown_mission
from companion.session import Session
from companion.sources.files import answer
from companion.telemetry.export.shapes import highest
from companion.telemetry.flight import Flight
from companion.telemetry.inputs import FILE, InputsFile
from companion.world.guess import guessed_m
from companion.world.known_map import KnownMap

UNKNOWN, GUESSED, PROVEN = range(3)
_BEGUN_AGAIN_S: Final = 2.0
_CONTINUED: Final = 0.25
"""Of R beyond what was seen: farther away, a guess is a plain (decision 0021)."""
_MOST_CELLS: Final = 240
"""Along a side, of what is drawn; 480 are one frame a second without a graphics processor."""
_STEPS: Final = 50  # inputs between two looks at the clock


class Ground(NamedTuple):
    """The terrain, as it is known or guessed.  Rows to the north, columns to the east."""

    cell_m: float
    north_min_m: float
    east_min_m: float
    height_m: NDArray[np.float32]
    """(rows, columns), AMSL; of unknown cells, nothing."""
    kind: NDArray[np.uint8]
    """(rows, columns): UNKNOWN, GUESSED or PROVEN."""


def ground_of(known: KnownMap, here_ne_m: tuple[float, float], mission: Mission) -> Ground:
    """A known map as it is drawn: what is no terrain but a sight line counts as guessed.

    Of near things nothing is guessed; they are drawn as high as the highest path.
    """
    range_m, firm = mission.task.settings.scan_range_m, known.surveyed & np.isfinite(known.upper_m)
    if mission.near is not None:
        highest_m = mission.task.limits.ceiling_amsl_m
        height_m = np.where(firm, np.minimum(known.upper_m, highest_m), -np.inf)
    else:
        height_m = guessed_m(known, here_ne_m, range_m)
    if known.guess_m is None:
        away = scipy.ndimage.distance_transform_edt(~firm) if firm.any() else np.inf
        is_far = away > _CONTINUED * range_m / known.cell_m
        height_m[is_far & ~np.isfinite(known.upper_m)] = -np.inf
    kind = np.where(np.isfinite(height_m), np.uint8(GUESSED), np.uint8(UNKNOWN))
    kind[firm] = PROVEN
    step = -(-max(kind.shape) // _MOST_CELLS)
    if step > 1:  # of each block the highest, and the least sure: no more is proven than is
        height_m, kind = highest(height_m, step), PROVEN - highest(PROVEN - kind, step)
    return Ground(
        cell_m=known.cell_m * step,
        north_min_m=known.north_min_m,
        east_min_m=known.east_min_m,
        height_m=np.where(kind == UNKNOWN, 0.0, height_m).astype(np.float32),
        kind=kind,
    )


@final
class Replica:
    """The session of a flight once more, as far as its inputs are recorded."""

    def __init__(self, folder: Path) -> None:
        """Nothing is read yet.  A folder without inputs never has any ground."""
        self._folder = folder
        self._known: KnownMap | None = None
        self._steps = self._replayed()
        self.ended: str | None = None
        """Why nothing follows from more inputs."""
        self.now: tuple[int, float] = (0, 0.0)
        """Boot and vehicle time that it has come to."""
        self._maps: list[tuple[int, float, bytes]] = []
        """Boot, vehicle time, and what was known from then on, packed: an hour has thousands."""

    def advance(self, seconds: float, clock: Callable[[], float] = time.thread_time) -> bool:
        """Go on for so long, of processor time; whether there is more to read at once."""
        until_s, more = clock() + seconds, True
        while more and clock() < until_s:
            try:
                more = next(self._steps, False)
            except (DamagedInputError, InputError) as error:
                self.ended = str(error)
            except Exception as error:  # noqa: BLE001 - the session's own, as in the flight
                self.ended = f"{type(error).__name__}: {error}"
        return more

    def number_at(self, flight: Flight, time_s: float) -> int:
        """The number of the newest map at a time of the flight; -1: there is none yet."""
        times_s = [flight.time_of(boot, t_s) for boot, t_s, _ in self._maps]
        return bisect_right(times_s, time_s) - 1

    def known(self, number: int) -> tuple[KnownMap, tuple[float, float]]:
        """A map by its number, and north and east of the vehicle then."""
        known, here_ne_m = pickle.loads(zlib.decompress(self._maps[number][2]))
        newest = self._known or known
        return replace(known, given=newest.given, guess_m=newest.guess_m), here_ne_m

    def _replayed(self) -> Iterator[bool]:
        """Take a few inputs at a time: whether there were any."""
        file = self._folder / FILE
        while not answer(lambda: file.stat().st_size > 0):
            yield False  # it has not begun yet
        feeder, inputs = Feeder(flown_mission(self._folder)), InputsFile(file)
        while True:
            calls = list(islice(inputs, _STEPS))
            for call in calls:
                feeder.take(call)
                if call[0] != "start" and call[0] not in RUNTIME_RECORDS:
                    self._note(feeder.session)
            yield bool(calls)

    def _note(self, session: Session) -> None:
        """Keep what is known, if that is new."""
        (boot, before_s), state = self.now, session.state
        self.now = boot + (session.now_s < before_s - _BEGUN_AGAIN_S), session.now_s
        known, position = state.flight.known, state.vehicle.position_nea_m
        if known is not self._known:
            self._known = known
            alone = replace(known, given=None, guess_m=None)  # these are always the same
            now = alone, (0.0, 0.0) if position is None else position[:2]
            self._maps.append((*self.now, zlib.compress(pickle.dumps(now), 1)))
