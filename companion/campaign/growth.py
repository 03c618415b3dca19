"""What this process takes up in a flight of hours."""

import ctypes
import gc
import math
import os
from contextlib import suppress
from pathlib import Path
from typing import final

_SETTLES_S, _LOOKS_S = 3_600.0, 600.0


@final
class Growth:
    """Memory and handles of this process, and by how much they grew after its first hour."""

    def __init__(self) -> None:
        self._settled: tuple[float, int] | None = None
        self._looked_s = -math.inf
        self.now_mb = self.grown_mb = 0.0
        self.more_handles = 0

    @property
    def is_known(self) -> bool:
        """Whether it was long enough."""
        return self._settled is not None

    def look(self, now_s: float) -> None:
        """Once a minute of the flight; what is found counts until the next look."""
        if now_s < _SETTLES_S or now_s - self._looked_s < _LOOKS_S:
            return
        self._looked_s = now_s
        self.now_mb, handles = _in_use_mb(), _handles()
        self._settled = self._settled or (self.now_mb, handles)
        self.grown_mb = self.now_mb - self._settled[0]
        self.more_handles = handles - self._settled[1]


def _in_use_mb() -> float:
    """Resident once garbage and the allocator's reserve, some 30 MB, were given back."""
    gc.collect()
    with suppress(AttributeError, OSError):  # another C library than glibc
        ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _handles() -> int:
    """Open file descriptors of this process."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())
