"""Runs the preflight checks on a vehicle, which is never armed."""

import time
from collections.abc import Callable
from typing import Final, final

from companion.mavlink.preflight import waiting_for
from companion.mission.state import Phase
from companion.runtime.link import Link
from companion.session import Session

_POLL_S: Final = 0.1
_DEADLINE_S: Final = 60.0
_SILENT_S: Final = 10.0
_MIN_S: Final = 1.5  # after everything was answered: one link delay more is measured
_MAX_S: Final = 5.0  # for rates and delays that do not come
_SCAN_S: Final = 20.0


def run_preflight(
    session: Session,
    link: Link,
    *,
    stop_asked: Callable[[], bool],
    on_progress: Callable[[str], None] = lambda _: None,
) -> None:
    """Run a session in shadow mode until everything was answered, or timed out.

    on_progress: called with what is waited for, as text, when that changes.
    """
    began_s = heard_s = time.monotonic()
    looker = _PreflightRun(session)
    said = ""
    while not stop_asked():
        data, now_s = link.receive(_POLL_S), time.monotonic()
        if data is not None and session.receive(data, now_s):
            heard_s = now_s
            link.answer_to(link.sender)
        else:
            session.silence(now_s - heard_s)
        link.send(session.run().frames)
        if now_s - heard_s > _SILENT_S or now_s - began_s > _DEADLINE_S:
            return
        if session.state.phase is Phase.DONE or looker.is_done(now_s):
            return
        waiting = waiting_for(session)
        if waiting != said:
            said = waiting
            on_progress(said)


@final
class _PreflightRun:
    """Decides when the preflight is complete; starts one radar scan."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._looked_s: float | None = None
        self._ready_s: float | None = None

    def is_done(self, now_s: float) -> bool:
        session = self._session
        state, vehicle = session.state, session.vehicle
        if self._looked_s is None and state.vehicle.position_nea_m and state.targets_ne_m:
            self._looked_s = now_s
            session.scan_now()
        if vehicle is None or waiting_for(session):
            return False
        if self._ready_s is None:
            self._ready_s = now_s
        waited_s = now_s - self._ready_s
        looks = self._looked_s is not None and session.last_scan is None
        if looks and self._looked_s is not None and now_s - self._looked_s < _SCAN_S:
            return False
        settled = not vehicle.streams.missing and vehicle.round_trip_s is not None
        return waited_s > (_MIN_S if settled else _MAX_S)
