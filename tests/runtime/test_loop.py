"""The loop around a session, with a scripted vehicle in place of the socket."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from scripted_vehicle import MISSION, Vehicle, straight_plan
from stub_session import QueueLink, StubSession, as_any

from companion.mission.events import Outcome, PlannerDied
from companion.mission.pending_plan import PendingPlan
from companion.mission.state import Reason
from companion.planner.request import PlanOutcome, PlanRequest
from companion.runtime import loop
from companion.runtime.link import Link
from companion.runtime.planner_process import PlannerHere
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary
from companion.telemetry.run_folder import RunFolder

_MOST = 5000  # datagrams of one flight, or the test has failed


class ScriptedLink(Link):
    """Stands in for the socket: one tick of the vehicle for each receive."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle, self.count = vehicle, 0

    def receive(self, timeout_s: float) -> bytes | None:
        del timeout_s
        self.count += 1
        assert self.count < _MOST, "the flight does not end"
        return self.vehicle.tick() or None

    def clock(self) -> float:
        """A tenth of a second passes in each."""
        return 0.1 * self.count

    def send(self, frames: list[bytes]) -> None:
        for frame in frames:
            self.vehicle.hear(frame)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    with RunFolder(tmp_path / "run", mission_toml="", epoch_us=0) as folder:
        yield folder


def fly(
    link: Link, folder: RunFolder, session: Session | None = None, **keywords: Any
) -> FlightSummary:
    """Of the scripted vehicle in lockstep, or whatever else is said."""
    session = session or Session(MISSION, seed=1, lockstep=True, go=True)
    usual: dict[str, Any] = {"lockstep": True, "stop_asked": lambda: False}
    usual |= {"on_progress": lambda _: None, "planner": PlannerHere(straight_plan)}
    return loop.fly(session, link, folder, **usual | keywords)


def stream(
    session: StubSession,
    link: QueueLink,
    folder: RunFolder,
    until: Callable[[], bool],
    first: bytes = b"a word",
) -> FlightSummary:
    """first: what it hears when it has begun."""
    words = [first]

    def over() -> bool:
        if words:
            link.incoming.put(words.pop())
        return until()

    return fly(link, folder, as_any(session), lockstep=False, stop_asked=over)


def test_a_flight_in_lockstep_ends_at_its_target_and_all_is_recorded(folder: RunFolder) -> None:
    def cut(request: PlanRequest, stop: object) -> PlanOutcome:
        return replace(straight_plan(request, stop), stopped_after=2)

    link = ScriptedLink(Vehicle())
    flown = fly(link, folder, planner=PlannerHere(cut))
    assert flown.end is not None
    assert flown.end.outcome is Outcome.ARRIVED
    assert len(flown.plans) == len(flown.plans_s) == flown.out_of_time == 1
    assert flown.to_go_m == pytest.approx(0.0, abs=5.0)
    last = link.vehicle.heard[-1]
    assert (last.get_type(), last.system_status) == ("HEARTBEAT", 7)
    lines = (folder.path / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["kind"] for line in lines[-2:]] == ["end", "say"]
    log = (folder.path / "flight.tlog").read_bytes()
    for message in link.vehicle.heard:
        assert bytes(message.get_msgbuf()) in log


def test_a_vehicle_that_falls_silent_ends_it_whoever_else_speaks(folder: RunFolder) -> None:
    vehicle = Vehicle()

    class Failing(ScriptedLink):
        def receive(self, timeout_s: float) -> bytes | None:
            data = super().receive(timeout_s)
            if vehicle.north_m < 100.0:
                return data
            return vehicle.radar_heartbeat() if self.count % 10 == 0 else None

    link = Failing(vehicle)
    flown = fly(link, folder, clock=link.clock)
    assert flown.end is not None
    assert flown.end.reason == Reason.LINK_LOST.text


def test_a_silence_is_told_as_it_grows_and_ends_with_the_next_word(folder: RunFolder) -> None:
    session = StubSession()
    rig = QueueLink(time.monotonic)

    def over() -> bool:
        told_s = session.silences_s
        if told_s and told_s[-1] > 0.5 and len(session.received) == 1:
            rig.incoming.put(b"another word")
        return len(session.received) == 2 and len(told_s) > 0 and told_s[-1] < 0.4

    flown = stream(session, rig, folder, over)
    assert flown.end is not None
    first_s, *told_s = session.silences_s
    [turn] = [n for n in range(1, len(told_s)) if told_s[n] < told_s[n - 1]]
    assert first_s == 0.0  # for the first heartbeat
    assert told_s[0] >= 0.2
    assert told_s[turn - 1] >= 0.5 > told_s[turn]


class Clock:
    """Goes on by so much with each look at it."""

    def __init__(self, step_s: float = 0.1) -> None:
        self.step_s, self.now_s = step_s, 0.0

    def __call__(self) -> float:
        self.now_s += self.step_s
        assert self.now_s < 1000.0, "the flight does not end"
        return self.now_s


def run(link: Link, clock: Clock, planner: Any, until: Callable[[], bool], lockstep: bool) -> Any:
    """The loop to its end, with a person who asks to stop then; what was flown."""
    session = Session(MISSION, seed=1, lockstep=lockstep, go=lockstep)
    control = loop.Loop(session, link, planner, lockstep=lockstep, clock=clock, stop_asked=until)
    control.run()
    assert control.flown.end is not None
    return control.flown


@pytest.mark.parametrize("stopped", [False, True])
def test_while_its_planner_is_loaded_it_beats_and_hears_ctrl_c_alone(stopped: bool) -> None:
    """For as long as that takes: that no vehicle is heard of meanwhile is nobody's fault."""
    vehicle, waits_s, clock = Vehicle(), 30.0, Clock()
    link = QueueLink(lambda: clock.now_s)

    class Loading:
        """A planner that is ready after a while; meanwhile the vehicle speaks."""

        @property
        def is_ready(self) -> bool:
            link.incoming.put(vehicle.tick())
            return clock.now_s > waits_s

        def answer(self, _wait_s: float) -> None:
            pass

    def stop_asked() -> bool:
        link.incoming.put(vehicle.tick())
        return clock.now_s > waits_s + (-10.0 if stopped else 10.0)

    flown = run(link, clock, Loading(), stop_asked, lockstep=False)
    assert flown.heard is not stopped
    assert flown.end.outcome is Outcome.STOPPED
    waited_s = waits_s - 10.0 * stopped
    beats_s = [at_s for at_s, frame in link.sent if frame[7:10] == bytes(3) and at_s < waited_s]
    assert beats_s[-1] > waited_s - 2.0
    assert beats_s[0] < 1.0
    assert max(after - before for before, after in pairwise(beats_s)) < 2.0


def test_in_lockstep_a_person_ends_the_wait_for_a_plan_that_does_not_come() -> None:
    waits_s = list[float]()
    planner = SimpleNamespace(is_ready=True, answer=waits_s.append, ask=lambda _request: None)
    link = ScriptedLink(Vehicle())
    flown = run(link, Clock(), planner, lambda: sum(waits_s) > 1.0, lockstep=True)
    assert flown.end.outcome is Outcome.STOPPED


def test_in_lockstep_the_death_of_a_planner_outlasts_a_question_that_it_is_asked_then() -> None:
    pending, died = PendingPlan(), PlannerDied(time_s=3.0, error="made up")
    pending.ask(5.0)
    pending.deliver(died)
    pending.ask(9.0)
    assert not pending.is_missing(10.0)
    assert pending.take(0.0) is died  # whatever the clock: its autopilot may have rebooted


@pytest.mark.parametrize(("starts_s", "heard"), [(6.0, True), (11.0, False)])
def test_in_lockstep_a_vehicle_may_come_ten_seconds_late(starts_s: float, heard: bool) -> None:
    """Simulator and planner are both compiled the first time, one beside the other."""
    clock, ready_s = Clock(0.05), 33.0

    class Loading:
        is_ready = property(lambda _: clock.now_s > ready_s)

        def answer(self, _wait_s: float) -> None:
            pass

    class Late(ScriptedLink):
        def receive(self, timeout_s: float) -> bytes | None:
            speaks = clock.now_s > ready_s + starts_s
            return super().receive(timeout_s) if speaks else None

    link = Late(Vehicle())
    flown = run(link, clock, Loading(), lambda: clock.now_s > ready_s + 20.0, lockstep=True)
    assert flown.heard is heard


def test_who_spoke_for_the_vehicle_is_answered(folder: RunFolder) -> None:
    session, link = StubSession(), QueueLink(time.monotonic)
    link.sender = ("10.0.0.7", 14551)
    stream(session, link, folder, lambda: bool(link.answers))
    assert link.answers == [("10.0.0.7", 14551)]


def test_a_word_from_the_past_is_not_taken_for_news(folder: RunFolder) -> None:
    """The companion starts, or was held up: what waited tells of where the vehicle was."""

    def held_up(_session: StubSession, number: int) -> None:
        if number == 1:
            for _ in range(5):
                link.incoming.put(b"old")
            threading.Event().wait(0.7)

    def over() -> bool:
        if session.received == [b"first"] and link.incoming.empty():
            link.incoming.put(b"new")
        return b"new" in session.received

    session, link = StubSession(held_up), QueueLink(time.monotonic)
    link.incoming.put(b"before it starts")
    stream(session, link, folder, over, first=b"first")
    assert session.received == [b"first", b"new"]


def test_what_must_outlive_the_process_is_kept_now_and_at_the_end(folder: RunFolder) -> None:
    kept: list[float] = []
    link = ScriptedLink(Vehicle())
    fly(link, folder, clock=link.clock, persist=lambda: kept.append(link.clock()))
    assert kept[0] == pytest.approx(30.0, abs=1.0)
    assert all(after - before >= 30.0 for before, after in pairwise(kept[:-1]))
    assert kept[-1] == link.clock()
