"""Finds the next intact MAVLink frame of a file."""

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
