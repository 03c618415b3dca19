"""The loop around a session, with a scripted vehicle in place of the socket, in made-up time."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest
from scripted_vehicle import MISSION, Vehicle, straight_plan
from stub_session import StubSession

from companion.mavlink.link import Output
from companion.mission.events import Outcome, PlannerDied
from companion.mission.pending_plan import PendingPlan
from companion.planner.request import PlanOutcome, PlanRequest
from companion.runtime import loop
from companion.runtime.link import Link, is_setpoint
from companion.runtime.planner_process import PlannerHere
from companion.session import Session
from companion.telemetry.flight_status import flight_status
from companion.telemetry.flight_summary import FlightSummary


class MadeUpLink(Link):
    """What arrives does so at its time, and waiting for it takes that time."""

    sender = "vehicle"

    def __init__(self, vehicle: Vehicle | None = None, speaks_from_s: float = 0.0) -> None:
        self.now_s, self.sent, self.answered = 0.0, list[tuple[float, bytes]](), list[object]()
        self.arrives = deque[tuple[float, bytes]]()
        self.unsent = list[Any]()
        """What is noted of frames that were not sent, to reproduce the flight."""
        self.vehicle, self._speaks_s = vehicle, speaks_from_s

    def clock(self) -> float:
        return self.now_s

    def receive(self, timeout_s: float) -> bytes | None:
        until_s = self.now_s + timeout_s
        assert until_s < 1000.0, "the flight does not end"
        if self.vehicle and not self.arrives and self._speaks_s <= until_s:
            self.arrives.append((self._speaks_s, self.vehicle.tick()))
            self._speaks_s = max(self._speaks_s, self.now_s) + 0.1
        if not self.arrives or self.arrives[0][0] > until_s:
            self.now_s = until_s
            return None
        at_s, data = self.arrives.popleft()
        self.now_s = max(self.now_s, at_s)
        return data or None

    def send(self, frames: list[bytes]) -> None:
        self.sent += [(self.now_s, frame) for frame in frames]
        for frame in frames if self.vehicle else ():
            self.vehicle.hear(frame)

    def answer_to(self, sender: object) -> None:
        self.answered.append(sender)


class SlowPlanner:
    """Is loaded at that time, and never answers."""

    def __init__(self, link: MadeUpLink, ready_s: float = 0.0) -> None:
        self.link, self.ready_s, self.waited_s = link, ready_s, 0.0

    @property
    def is_ready(self) -> bool:
        return self.link.now_s >= self.ready_s

    def answer(self, wait_s: float) -> None:
        self.link.now_s += wait_s
        self.waited_s += wait_s

    def ask(self, _request: PlanRequest) -> None:
        pass


def run(
    link: MadeUpLink,
    planner: Any,
    until: Callable[[], bool],
    session: Any = None,
    ends: Outcome = Outcome.STOPPED,
) -> FlightSummary:
    """The loop to its end, with a person who asks to stop then.

    session: by default one that flies in lockstep.
    """
    session = session or Session(MISSION, seed=1, lockstep=True)
    control = loop.Loop(session, link, planner, clock=link.clock, stop_asked=until)
    recorded = list[Output]()
    control.record = recorded.append
    control.run()
    if isinstance(session, StubSession):  # what it said is recorded as far as it was sent
        said = [frame for out in recorded for _, frame in out.record]
        assert said == [frame for _, frame in link.sent]
        link.unsent = [each for out in recorded for each in out.inputs if each[0] == "unsent"]
    assert control.flown.end is not None
    assert control.flown.end.outcome is ends
    return control.flown


def test_a_flight_in_lockstep_ends_at_its_target_with_its_plans_counted() -> None:
    """And those that were cut short; what is recorded of it: `closed_loop`."""

    def cut(request: PlanRequest, stop: object) -> PlanOutcome:
        return replace(straight_plan(request, stop), stopped_after=2)

    link = MadeUpLink(vehicle := Vehicle())
    flown = run(link, PlannerHere(cut), lambda: False, ends=Outcome.ARRIVED)
    assert len(flown.plans) == len(flown.plans_s) == flown.out_of_time == 1
    assert flown.to_go_m == pytest.approx(0.0, abs=5.0)
    last = vehicle.heard[-1]
    assert (last.get_type(), last.system_status) == ("HEARTBEAT", 7)


def test_a_silence_is_told_as_it_grows_until_the_vehicle_speaks_which_is_answered() -> None:
    """It is no matter who else speaks."""
    session, link = StubSession(), MadeUpLink()
    link.arrives.extend([(1.0, b"a word"), (1.5, b"another's"), (2.5, b"a word")])
    run(link, SlowPlanner(link), lambda: link.now_s > 2.8, session)
    first_s, *told_s = session.silences_s
    assert first_s == 0.0  # for the first heartbeat
    assert 0.2 <= min(told_s) < 0.3
    longest_s = [before for before, after in pairwise([*told_s, 0.0]) if after < before]
    assert longest_s == pytest.approx([1.0, 1.5, 0.3], abs=0.06)
    assert link.answered == ["vehicle", "vehicle"]


@pytest.mark.parametrize(("held_s", "sent_s"), [(0.4, [1.4, 1.4, 3.0]), (0.7, [3.0])])
def test_what_has_waited_for_too_long_is_neither_heard_nor_answered_by_a_setpoint(
    held_s: float, sent_s: list[float]
) -> None:
    """The companion starts, or was held up: what waited tells of where the vehicle was."""

    def held_up(number: int) -> None:
        link.now_s += held_s * (number == 1)

    session, link = StubSession(held_up), MadeUpLink()
    words = ((0.0, b"before"), (1.0, b"first"), (1.1, b"old"), (1.2, b"old"), (3.0, b"new"))
    link.arrives.extend(words)
    run(link, SlowPlanner(link), lambda: link.now_s > 3.2, session)
    assert session.received == [b"first", *[b"old"] * (len(sent_s) - 1), b"new"]
    assert [at_s for at_s, frame in link.sent if is_setpoint(frame)] == pytest.approx(sent_s)
    assert next(at_s for at_s, frame in link.sent if not is_setpoint(frame)) == 1.0 + held_s
    assert link.unsent == [("unsent", [0])]


@pytest.mark.parametrize("stopped", [False, True])
def test_while_its_planner_is_loaded_it_beats_and_hears_ctrl_c_alone(stopped: bool) -> None:
    """For as long as that takes: that no vehicle is heard of meanwhile is nobody's fault."""
    link, ready_s = MadeUpLink(Vehicle(lockstep=False)), 30.0
    session, planner = Session(MISSION, seed=1, lockstep=False), SlowPlanner(link, ready_s)
    flown = run(link, planner, lambda: link.now_s > ready_s + (-10 if stopped else 10), session)
    assert flown.heard is not stopped
    waited_s = ready_s - 10.0 * stopped
    beats_s = [at_s for at_s, frame in link.sent if frame[7:10] == bytes(3)]
    assert all(after - before < 2.0 for before, after in pairwise([0.0, *beats_s, waited_s]))


def test_in_lockstep_a_person_ends_the_wait_for_a_plan_that_does_not_come() -> None:
    planner = SlowPlanner(link := MadeUpLink(Vehicle()))
    run(link, planner, lambda: planner.waited_s > 1.0)


def test_in_lockstep_the_death_of_a_planner_outlasts_a_question_that_it_is_asked_then() -> None:
    pending, died = PendingPlan(), PlannerDied(time_s=3.0, error="made up")
    pending.ask(5.0)
    pending.deliver(died)
    pending.ask(9.0)
    assert not pending.is_missing(10.0)
    assert pending.take(0.0) is died  # whatever the clock: its autopilot may have rebooted


@pytest.mark.parametrize(("late_s", "ends"), [(9.0, Outcome.STOPPED), (11.0, Outcome.FAILED)])
def test_in_lockstep_a_vehicle_may_come_ten_seconds_late(late_s: float, ends: Outcome) -> None:
    """Simulator and planner are both compiled the first time, one beside the other."""
    link = MadeUpLink(Vehicle(), speaks_from_s=33.0 + late_s)
    flown = run(link, SlowPlanner(link, 33.0), lambda: link.now_s > 53.0, ends=ends)
    assert flown.heard is (ends is Outcome.STOPPED)


@pytest.mark.parametrize("here", [True, False])
def test_the_loop_asks_who_is_there(here: bool) -> None:
    """Somebody says go again and again, and hears why not."""
    vehicle, heard = Vehicle(lockstep=False), list[str]()
    link = MadeUpLink(vehicle)
    person: Any = SimpleNamespace(hears=heard.append, says_go=lambda: True) if here else None
    control = loop.Loop(
        Session(MISSION, seed=1, lockstep=False),
        link,
        PlannerHere(straight_plan),
        clock=link.clock,
        stop_asked=lambda: vehicle.armed or vehicle.time_ms > 60_000,
        person=person,
    )
    waits_for = [flight_status(control.flown).waits_for or "" for _ in control.turns()]
    assert vehicle.armed is here
    assert any("no terminal is here" in why for why in waits_for) is not here
    if here:
        at = heard.index("go: it takes off")
        assert all("not ready" in why or "no vehicle" in why for why in heard[:at])
        assert at > 0
        assert "already" in heard[at + 1]
