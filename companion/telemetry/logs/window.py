"""A file of any size through a window of bounded size."""

import io
from pathlib import Path
from typing import Final, Self, final

_CHUNK: Final = 1 << 20


@final
class Window:
    """The part of a file that is being looked at: `data`, whose first byte is number `base`.

    A file that cannot be read on (`failed`) ends there.
    """

    def __init__(self, path: Path, chunk: int = _CHUNK) -> None:
        """chunk: bytes that are read at a time."""
        self.data = b""
        self.base = 0
        self.ended = False
        """Whether `data` reaches to the end of the file."""
        self.failed = False
        self._chunk = chunk
        self._file: io.FileIO | None = None
        try:
            self._file = path.open("rb", buffering=0)
        except OSError:  # it was there when the log was opened
            self.ended = self.failed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()

    def more(self, at: int) -> bool:
        """Forget what is before that index, and read on; False if the file has ended.

        What was index `at` of `data` is index 0 from now on, if anything was read.
        """
        if self.ended or self._file is None:
            return False
        try:
            new = self._file.read(self._chunk)
        except OSError:
            self.failed, new = True, b""
        if not new:
            self.ended = True
            return False
        self.data, self.base = self.data[at:] + new, self.base + at
        return True
