"""Runs the preflight checks on a vehicle, which is never armed."""

import math
import time
from collections.abc import Iterator
from typing import Final

from companion.mavlink.preflight import waiting_for
from companion.mission.state import Phase
from companion.runtime.link import Link
from companion.runtime.loop import Loop
from companion.session import Session

_DEADLINE_S: Final = 60.0
_SILENT_S: Final = 10.0
_MIN_S: Final = 1.5  # after everything was answered: what is said late counts too
_MAX_S: Final = 5.0  # for messages that do not come
_SCAN_S: Final = 20.0


def preflight(session: Session, link: Link) -> Iterator[str]:
    """Run a session in shadow mode, with one radar scan, until all is answered, or timed out.

    In each turn it says what is waited for, as text.
    """
    loop = Loop(session, link, clock=time.monotonic)
    until_s, scanned_s, answered_s = loop.clock() + _DEADLINE_S, math.inf, math.inf
    for _ in loop.turns():
        now_s, state, vehicle = loop.clock(), session.state, session.vehicle
        if now_s - loop.heard_s > _SILENT_S or now_s > until_s or state.phase is Phase.DONE:
            return
        position = state.vehicle.position_nea_m
        if scanned_s == math.inf and position is not None and state.targets_ne_m:
            scanned_s = now_s
            session.scan(position)
        waiting = waiting_for(session)
        if vehicle is not None and not waiting:
            answered_s = min(answered_s, now_s)
            settled = not vehicle.streams.missing
            scans = session.last_scan is None and 0.0 <= now_s - scanned_s < _SCAN_S
            if not scans and now_s - answered_s > (_MIN_S if settled else _MAX_S):
                return
        yield waiting
