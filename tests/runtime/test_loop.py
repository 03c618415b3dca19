"""The loop around a session, with a scripted vehicle in place of the socket."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from scripted_vehicle import BRAKE, MISSION, Vehicle, straight_plan

from companion.mission.events import Outcome
from companion.mission.state import Reason
from companion.planner.request import PlanOutcome, PlanRequest
from companion.runtime import loop
from companion.runtime.link import UdpLink
from companion.session import Session
from companion.telemetry.flown import Flown
from companion.telemetry.run_folder import RunFolder

_MOST = 5000  # datagrams of one flight, or the test has failed


class ScriptedLink:
    """Stands in for the socket: one tick of the vehicle for each receive."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle, self.count = vehicle, 0
        self.silent = False

    def receive(self, timeout_s: float) -> bytes | None:
        del timeout_s
        self.count += 1
        assert self.count < _MOST, "the flight does not end"
        return None if self.silent else self.vehicle.tick() or None

    def answer_to_sender(self) -> None:
        """There is nobody else."""

    def send(self, frames: list[bytes]) -> None:
        for frame in frames:
            self.vehicle.hear(frame)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    with RunFolder(tmp_path / "run", mission_toml="", epoch_us=0) as folder:
        yield folder


def fly(link: ScriptedLink, folder: RunFolder, lockstep: bool = True, **keywords: Any) -> Flown:
    return loop.fly(
        Session(MISSION, seed=1, lockstep=lockstep),
        cast(UdpLink, link),
        folder,
        lockstep=lockstep,
        on_progress=lambda _: None,
        **{"stop_asked": lambda: False, "planner": straight_plan, **keywords},
    )


def test_a_flight_in_lockstep_ends_at_its_target(folder: RunFolder) -> None:
    link = ScriptedLink(Vehicle())
    flown = fly(link, folder)
    assert flown.end is not None
    assert flown.end.outcome is Outcome.ARRIVED
    assert len(flown.plans) == len(flown.plans_s) == 1
    assert flown.to_go_m == pytest.approx(0.0, abs=5.0)
    last = link.vehicle.heard[-1]
    assert (last.get_type(), last.system_status) == ("HEARTBEAT", 7)


def test_the_folder_holds_all_that_was_said_and_decided(folder: RunFolder) -> None:
    link = ScriptedLink(Vehicle())
    fly(link, folder)
    lines = (folder.path / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    assert json.loads(lines[-1])["kind"] == "end"
    log = (folder.path / "flight.tlog").read_bytes()
    for message in link.vehicle.heard:
        assert bytes(message.get_msgbuf()) in log


def test_a_planner_that_raises_puts_the_vehicle_on_hold_and_is_an_end_not_an_exception(
    folder: RunFolder,
) -> None:
    def broken(_: PlanRequest, _stop: object) -> PlanOutcome:
        raise ZeroDivisionError("made up")

    link = ScriptedLink(Vehicle())
    flown = fly(link, folder, planner=broken)
    assert flown.end is not None
    assert flown.end.reason == Reason.PLANNER_DIED.text
    assert link.vehicle.mode == BRAKE
    assert "ZeroDivisionError: made up" in (folder.path / "journal.jsonl").read_text("utf-8")


def test_a_stop_ends_the_flight_with_the_vehicle_on_hold(folder: RunFolder) -> None:
    link = ScriptedLink(Vehicle())
    flown = fly(link, folder, stop_asked=lambda: link.vehicle.north_m > 100.0)
    assert flown.end is not None
    assert flown.end.outcome is Outcome.STOPPED
    assert link.vehicle.mode == BRAKE


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A wall clock that the test moves."""
    made = SimpleNamespace(now_s=0.0, perf_counter=lambda: made.now_s)
    monkeypatch.setattr(loop, "time", made)
    return made


@pytest.mark.parametrize("radar_speaks", [False, True], ids=["nobody", "the radar"])
def test_a_vehicle_that_falls_silent_ends_the_flight_whoever_else_speaks(
    folder: RunFolder, clock: SimpleNamespace, radar_speaks: bool
) -> None:
    vehicle = Vehicle(lockstep=False)

    class Failing(ScriptedLink):
        def receive(self, timeout_s: float) -> bytes | None:
            data = super().receive(timeout_s)
            clock.now_s += 0.1
            if vehicle.north_m < 100.0:
                return data
            return vehicle.radar_heartbeat() if radar_speaks and self.count % 10 == 0 else None

    flown = fly(Failing(vehicle), folder, lockstep=False)
    assert flown.end is not None
    assert flown.end.reason == Reason.LINK_LOST.text


def test_no_vehicle_at_all_ends_after_ten_seconds(
    folder: RunFolder, clock: SimpleNamespace
) -> None:
    class Nobody(ScriptedLink):
        def receive(self, timeout_s: float) -> bytes | None:
            assert clock.now_s < 60.0
            clock.now_s += timeout_s
            return None

    flown = fly(Nobody(Vehicle()), folder, lockstep=False)
    assert flown.end is not None
    assert flown.end.reason == Reason.NO_VEHICLE.text
    assert 10.0 <= clock.now_s <= 14.0
    assert not flown.heard
