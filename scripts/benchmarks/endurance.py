"""A day of flying, with faults: does the companion's process grow?

    scripts/bench endurance [--hours 24] [--vehicle px4-copter] [--seed 1] [--json FILE]

Companion and vehicle in one process and in steps (`pair`), back and forth between two targets, a
fault every two minutes.  When a mission ends (a fault ended it, or the battery), the same process
begins the next one, as a service would.  Resident memory and open file handles, by the hour.  What
the allocator keeps in reserve comes and goes by 30 MB: after the first hour and at the end it is
given back, and what is left then is in use.
The bar: from the first hour to the last, what is in use grows by less than 10 MB and no handle is
added.
"""

import contextlib
import ctypes
import functools
import gc
import os
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import final

import numpy as np
import pair_worlds
import running
from faults import WORLDS
from faults_trials import trials
from pair import Flown, Pair
from rich.console import Console

from companion.runtime.compiler import load_kernel

_EVERY_S = 120.0
_LOOK_H = 0.5
_SETTLES_H = 1.0
_MISSION_S = 4.0 * 3600.0
_TARGETS = 400
_GROWTH_MB = 10.0
_FAULTS = ("gps_off", "gps_noise", "wind", "link_off", "link_loss", "link_delay", "radar_off",
           "radar_loss", "setpoints_ignored", "link_corruption", "plans late")  # fmt: skip


def resident_mb() -> float:
    """Of this process, now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def in_use_mb() -> float:
    """Of this process, once garbage and glibc's reserve were given back to the system."""
    gc.collect()
    with contextlib.suppress(AttributeError):  # another C library keeps its own
        ctypes.CDLL(None).malloc_trim(0)
    return resident_mb()


def handles() -> int:
    """Open file descriptors of this process."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def forget(flown: Flown) -> None:
    """What a runtime would have written to disk by now."""
    for kept in (flown.sent, flown.received_s, flown.journal, flown.samples, flown.done):
        kept.clear()


@final
@dataclass(slots=True)
class Diary:
    """What the process takes up, every half an hour of flight."""

    console: Console
    settles_h: float
    flown_s: float = 0.0
    missions: int = 0
    settled_mb: float | None = None
    """In use after the first hour."""
    rows: list[tuple[float, float, int, int]] = field(default_factory=list)
    """Hours, megabytes, handles, missions."""

    def note(self, pair: Pair) -> None:
        """Forget what has been flown, and look."""
        forget(pair.flown)
        pair.simulation.take_truth()
        pair.simulation.take_notices()
        hour = (self.flown_s + pair.now_s) / 3600.0
        if not self.rows or hour >= self.rows[-1][0] + _LOOK_H:
            gc.collect()
            self.rows.append((hour, resident_mb(), handles(), self.missions))
            self.console.print("after {:5.1f} h: {:6.1f} MB, {} handles, {} missions".format(
                *self.rows[-1]))  # fmt: skip
            if self.settled_mb is None and hour >= self.settles_h:
                self.settled_mb = in_use_mb()


def fly(hours: float, vehicle: str, seed: int, console: Console) -> Diary:
    """Mission after mission in this process."""
    kernel, rng = load_kernel(), np.random.default_rng(seed)
    diary = Diary(console, min(_SETTLES_H, hours / 4))
    rows_of = {trial.name: trial for trial in trials()}
    while diary.flown_s < 3600.0 * hours:
        scene = pair_worlds.scene_of(vehicle, diary.missions % WORLDS)
        there = scene.mission.targets_ne_m[-1]
        scene = scene.through(*(there, (0.0, 0.0)) * (_TARGETS // 2))
        pair = Pair(scene, seed=seed * 1000 + diary.missions, kernel=kernel)
        for k in range(1, round(_MISSION_S / _EVERY_S)):
            for after_s, happening in rows_of[str(rng.choice(_FAULTS))].draw(rng, scene):
                pair.at(k * _EVERY_S + after_s, happening)
        pair.each_minute = functools.partial(diary.note, pair)
        left_s = 3600.0 * hours - diary.flown_s
        pair.fly(limit_s=min(left_s + 60.0, _MISSION_S))
        diary.flown_s += pair.now_s
        diary.missions += 1
    return diary


def main() -> int:
    """Fly; 1 if it grows."""
    options, console = running.begin(__doc__, hours=24.0, vehicle="px4-copter", seed=1)
    began_s = time.perf_counter()
    diary = fly(options.hours, options.vehicle, options.seed, console)
    took_s = time.perf_counter() - began_s
    settled = [row for row in diary.rows if row[0] >= diary.settles_h]
    before_mb, now_mb = diary.settled_mb or 0.0, in_use_mb()
    growth_mb = now_mb - before_mb
    more = settled[-1][2] - settled[0][2]
    least_mb, most_mb = (pick(row[1] for row in settled) for pick in (min, max))
    console.print(
        f"{diary.flown_s / 3600:.1f} h in {took_s / 60:.1f} min "
        f"({diary.flown_s / took_s:.0f} x real time), {diary.missions} missions: "
        f"{before_mb:.1f} MB in use after {diary.settles_h:g} h, {now_mb:.1f} MB at the end "
        f"({least_mb:.0f} to {most_mb:.0f} MB resident), {more:+d} handles"
    )
    running.store(options.json, diary.rows)
    return running.ended(console, kept=growth_mb <= _GROWTH_MB and more <= 0)


if __name__ == "__main__":
    sys.exit(main())
