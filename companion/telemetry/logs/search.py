"""Finds the next intact MAVLink frame of a file, or entry of a log."""

import re
from collections.abc import Callable

from companion.mavlink.frames import LONGEST, find_marker, intact_end
from companion.telemetry.logs.window import Window

STAMP_BYTES = 8


def find_intact(window: Window, byte: int) -> tuple[int, int] | None:
    """Where the next one begins and ends, at or after a byte of the file; None: there is no more.

    All three count from the beginning of the file.  The window moves, and keeps the frame and a
    time stamp before it.  Time is linear in the bytes.
    """
    at = byte - window.base
    while True:
        data = window.data
        found = find_marker(data, at)
        if found is None:
            kept = max(len(data) - STAMP_BYTES, at - STAMP_BYTES, 0)
            at = len(data) - kept
            if not window.more(kept):
                return None
            continue
        at = found.start()
        if at + LONGEST > len(data) and not window.ended:
            kept = max(at - STAMP_BYTES, 0)
            if window.more(kept):
                at -= kept
            continue
        end = intact_end(data, at)
        if end:
            return window.base + at, window.base + end
        at += 1


def first_frame(data: bytes) -> int | None:
    """Where the first intact one begins in these bytes; None: there is none, or not all of it."""
    at = 0
    while (found := find_marker(data, at)) is not None:
        if intact_end(data, found.start()):
            return found.start()
        at = found.start() + 1
    return None


def find_entry(
    window: Window,
    at: int,
    find_head: Callable[[bytes, int], "re.Match[bytes] | None"],
    ahead: int,
    is_one: Callable[[bytes, int], bool],
) -> int:
    """Where in the window the next one begins, at or after an index; the end of the file if none.

    find_head: what one may begin with, three bytes at most; is_one: whether one does begin there,
    with so many bytes `ahead` to look at unless the file ends.  The window moves.
    """
    while True:
        data = window.data
        found = find_head(data, at)
        begin = len(data) if found is None else found.start()
        if begin + ahead > len(data) and not window.ended:
            if window.more(min(begin, len(data) - 2)):  # a part of a head may stand at the end
                at = 0
        elif found is None or is_one(data, begin):
            return begin
        else:
            at = begin + 1
