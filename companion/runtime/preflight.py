"""Runs the preflight checks on a vehicle, which is never armed."""

import math
import time
from collections.abc import Callable
from typing import Final

from companion.mavlink.preflight import waiting_for
from companion.mission.state import Phase
from companion.runtime.link import Link
from companion.session import Session

_POLL_S: Final = 0.1
_DEADLINE_S: Final = 60.0
_SILENT_S: Final = 10.0
_MIN_S: Final = 1.5  # after everything was answered: what is said late counts too
_MAX_S: Final = 5.0  # for messages that do not come
_SCAN_S: Final = 20.0


def run_preflight(
    session: Session,
    link: Link,
    *,
    stop_asked: Callable[[], bool],
    on_progress: Callable[[str], None] = lambda _: None,
) -> None:
    """Run a session in shadow mode, with one radar scan, until all is answered, or timed out.

    on_progress: called with what is waited for, as text, when that changes.
    """
    began_s = heard_s = time.monotonic()
    scanned_s = answered_s = math.inf
    last_shown = ""
    while not stop_asked():
        data, now_s = link.receive(_POLL_S), time.monotonic()
        if data is not None and session.receive(data, now_s):
            heard_s = now_s
            link.answer_to(link.sender)
        else:
            session.silence(now_s - heard_s)
        link.send(session.run().frames)
        state, vehicle = session.state, session.vehicle
        is_over = now_s - heard_s > _SILENT_S or now_s - began_s > _DEADLINE_S
        if is_over or state.phase is Phase.DONE:
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
        if waiting != last_shown:
            last_shown = waiting
            on_progress(last_shown)
