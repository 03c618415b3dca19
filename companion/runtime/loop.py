"""Flies a session: the wall clock, the socket, the planner's thread, the run folder."""

import math
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import final

from companion.planner.request import Planned, PlanOutcome, PlanRequest
from companion.runtime.compiler import Planner
from companion.runtime.link import UdpLink
from companion.session import Output, Session
from companion.telemetry.flown import Flown
from companion.telemetry.run_folder import RunFolder

_POLL_S = 0.2
_LOCKSTEP_SILENCE_S = 10.0
_SETTLE_S = 3.0  # for the vehicle to confirm the mode in which it is left
_TRACK_S = 0.5
_PROGRESS_S = 0.1
_SEARCHING = 0.8  # of T: the rest is for the proof


Answer = Callable[[PlanRequest, Callable[[], bool]], PlanOutcome]
"""Answers a request; the second argument tells it when to stop searching."""


def fly(
    session: Session,
    link: UdpLink,
    folder: RunFolder,
    *,
    lockstep: bool,
    on_progress: Callable[[Flown], None],
    stop_asked: Callable[[], bool],
    planner: Answer | None = None,
) -> Flown:
    """Run a session until its mission ends; every end is a value, Flown.end.

    planner: by default the compiled one, which is loaded once a vehicle is heard.
    """
    flown = Flown(session=session)
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="planner") as worker:
        _Loop(session, link, folder, lockstep, flown, worker, planner).run(on_progress, stop_asked)
    return flown


@final
class _Loop:
    def __init__(
        self,
        session: Session,
        link: UdpLink,
        folder: RunFolder,
        lockstep: bool,
        flown: Flown,
        worker: ThreadPoolExecutor,
        planner: Answer | None,
    ) -> None:
        self._session, self._link, self._folder = session, link, folder
        self._lockstep, self._flown = lockstep, flown
        self._worker = worker
        self._planner = planner or Planner(lockstep=lockstep)
        self._pending: Future[tuple[PlanOutcome, float]] | None = None
        self._began_s = self._heard_s = time.perf_counter()
        self._track_at_s = -math.inf
        self._ended_s: float | None = None

    def run(self, on_progress: Callable[[Flown], None], stop_asked: Callable[[], bool]) -> None:
        try:
            self._run(on_progress, stop_asked)
        finally:  # whatever happened: the vehicle is not left without a word
            self._carry_out(self._session.farewell())

    def _run(self, on_progress: Callable[[Flown], None], stop_asked: Callable[[], bool]) -> None:
        shown_s, stopping = -math.inf, False
        while self._flown.end is None:
            data = self._link.receive(_POLL_S)
            now_s = time.perf_counter()
            if data is None or not self._on_data(data, now_s):
                self._on_silence(now_s - self._heard_s)
            if stop_asked() and not stopping:
                stopping = True
                self._session.stop()
            self._collect_plan(wait=False)
            out = self._session.run()
            while out.awaits_plan:
                self._carry_out(out)
                self._collect_plan(wait=True)
                out = self._session.run()
            self._carry_out(out)
            if self._flown.heard:
                self._flown.elapsed_s = time.perf_counter() - self._began_s
            if now_s - shown_s >= _PROGRESS_S:
                shown_s = now_s
                on_progress(self._flown)

    def _on_data(self, data: bytes, now_s: float) -> bool:
        """Take a datagram; whether the autopilot spoke in it."""
        if not self._session.receive(data):
            return False
        self._link.answer_to_sender()
        if not self._flown.heard:
            self._flown.heard, self._began_s = True, now_s
            if isinstance(self._planner, Planner):
                self._planner.start()
        self._heard_s = now_s
        return True

    def _on_silence(self, silent_s: float) -> None:
        if not self._lockstep or silent_s >= _LOCKSTEP_SILENCE_S:
            self._session.silence(silent_s)

    def _carry_out(self, out: Output) -> None:
        self._link.send(out.frames)
        self._folder.frames(out.record)
        self._folder.entries(out.journal)
        if out.plan is not None:
            self._flown.scans_nea_m.append(out.plan.scan_nea_m)
            self._pending = self._worker.submit(
                _timed, self._planner, out.plan, self._deadline(out.plan)
            )
        if out.end is not None:
            self._ended_s = self._ended_s or time.perf_counter()
            if out.settled or time.perf_counter() - self._ended_s > _SETTLE_S:
                self._flown.end = out.end
        here, now_s = self._session.state.vehicle.position_nea_m, self._session.now_s
        if here is not None and now_s - self._track_at_s >= _TRACK_S:
            self._track_at_s = now_s
            self._flown.track_nea_m.append(here)

    def _deadline(self, request: PlanRequest) -> Callable[[], bool]:
        """Whether to stop searching: never in lockstep, before T in real time, and at the end."""
        due_s = time.perf_counter() + _SEARCHING * request.task.settings.planning_time_s
        return lambda: (
            self._flown.end is not None or (not self._lockstep and time.perf_counter() > due_s)
        )

    def _collect_plan(self, *, wait: bool) -> None:
        """Hand over a plan that is finished; in lockstep vehicle time stands still meanwhile."""
        pending = self._pending
        if pending is None or not (wait or pending.done()):
            return
        self._pending = None
        try:
            outcome, took_s = pending.result()
        except Exception as error:  # noqa: BLE001 - whatever it is, the vehicle must be put on hold
            self._session.planner_died(f"{type(error).__name__}: {error}")
            return
        if wait:  # the vehicle was not silent: it was made to wait
            self._heard_s = time.perf_counter()
        self._flown.plans_s.append(took_s)
        if isinstance(outcome, Planned):
            self._flown.plans.append(outcome)
        self._session.deliver(outcome)


def _timed(
    planner: Answer, request: PlanRequest, stop: Callable[[], bool]
) -> tuple[PlanOutcome, float]:
    began_s = time.perf_counter()
    outcome = planner(request, stop)
    return outcome, time.perf_counter() - began_s
