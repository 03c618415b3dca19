"""What the terminal says of a flight while it is flown, in lines as for a log."""

from typing import Any

import pytest
from renewed import replace
from rich.console import Console

from companion.config import load_mission
from companion.mission.state import Phase, Reason, Silent, TakenOver
from companion.mission.stopped import FAILSAFE_OVER
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary
from companion.views.live import Progress, progress_line, progress_table


class Terminal:
    """A session that is told what its state is, and the lines that are printed of it."""

    def __init__(self) -> None:
        self.flown = FlightSummary(
            session=Session(load_mission("environment-1"), seed=1, lockstep=False)
        )
        self.console = Console(width=200, force_terminal=False, record=True)
        self.progress = Progress(self.console)

    def show(self, time_s: float, *, failsafe: bool = False, **changes: Any) -> list[str]:
        """The lines that this prints."""
        session = self.flown.session
        session.clock.read(time_s)
        vehicle = replace(session.state.vehicle, failsafe=failsafe)
        session.state = replace(session.state, now_s=time_s, vehicle=vehicle, **changes)
        self.progress.show(self.flown)
        return self.console.export_text().splitlines()

    def warn(self, text: str) -> None:
        self.flown.session._send_text(text, warning=True)


def test_why_it_holds_is_not_said_any_more_once_it_flies() -> None:
    terminal = Terminal()
    terminal.show(100.0, phase=Phase.FLYING, since_s=90.0, reason=None)
    terminal.warn(f"hold: {Reason.NO_FIX.text}")
    [held] = terminal.show(100.1, phase=Phase.HOLDING, since_s=100.0, reason=Reason.NO_FIX)
    assert Reason.NO_FIX.text in held
    [flies] = terminal.show(110.0, phase=Phase.FLYING, since_s=110.0, reason=None)
    assert "hold" not in flies
    assert "(" not in flies


def test_another_reason_to_hold_is_another_line() -> None:
    terminal = Terminal()
    terminal.show(100.0, phase=Phase.HOLDING, since_s=100.0, reason=Reason.ESTIMATOR)
    assert terminal.show(101.0) == []
    [line] = terminal.show(110.0, reason=Reason.POSITION_ELSEWHERE)
    assert Reason.POSITION_ELSEWHERE.text in line
    assert terminal.show(111.0) == []


def test_the_autopilots_failsafe_and_its_end_are_said() -> None:
    terminal = Terminal()
    terminal.show(100.0, phase=Phase.FLYING, since_s=90.0, reason=None)
    [begins] = terminal.show(101.0, failsafe=True)
    assert "failsafe" in begins
    [held] = terminal.show(
        102.0, failsafe=True, phase=Phase.HOLDING, since_s=102.0, reason=Reason.FAILSAFE
    )
    assert Reason.FAILSAFE.text in held
    over = terminal.show(130.0, hold=TakenOver(failsafe_over=True))
    assert FAILSAFE_OVER in over[-1]
    [silent] = terminal.show(135.0, reason=Reason.LINK_LOST, hold=Silent())
    assert Reason.LINK_LOST.text in silent
    [flies] = terminal.show(140.0, phase=Phase.FLYING, since_s=140.0, reason=None, hold=None)
    assert "failsafe" not in flies


def test_a_failsafe_that_ends_in_flight_is_a_line_without_it() -> None:
    terminal = Terminal()
    terminal.show(100.0, failsafe=True, phase=Phase.FLYING, since_s=90.0, reason=None)
    [line] = terminal.show(101.0)
    assert "failsafe" not in line


@pytest.mark.parametrize(("later_s", "stands"), [(59.0, True), (61.0, False)])
def test_a_warning_stands_for_a_minute(later_s: float, stands: bool) -> None:
    terminal = Terminal()
    terminal.show(100.0, phase=Phase.FLYING, since_s=90.0, reason=None)
    terminal.warn("scan: 3 of 9 blocks answered")
    [line] = terminal.show(100.2)
    assert line.endswith("(scan: 3 of 9 blocks answered)")
    terminal.show(100.0 + later_s)
    assert ("scan:" in progress_line(terminal.flown)) is stands
    assert (progress_table(terminal.flown).caption is not None) is stands


def test_a_vehicle_that_was_up_for_long_is_flown_at_the_pace_of_the_clock() -> None:
    terminal = Terminal()
    terminal.show(3_000.0, phase=Phase.FLYING, since_s=2_990.0, reason=None)
    terminal.flown.elapsed_s = 30.0
    terminal.show(3_030.0)
    assert "   1x real time" in progress_line(terminal.flown)
