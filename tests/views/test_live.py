"""What the terminal says of a flight while it is flown: a table, lines as for a log, and JSON."""

import io
import json
from typing import Any

import pytest
from renewed import replace
from rich.console import Console
from test_flight_summary import flights
from test_output import written

from companion.config import load_mission
from companion.errors import FlightFailed, InputError
from companion.mission.events import End, Outcome
from companion.mission.phases import Phase, Reason
from companion.mission.stopped import FAILSAFE_OVER
from companion.session import Session
from companion.telemetry.flight_status import FlightStatus, flight_status
from companion.telemetry.flight_summary import FlightSummary
from companion.views.live import MachineLines, Progress, status_table
from companion.views.output import PatientOutput

FLIES = {"phase": Phase.FLYING, "reason": None}
LONGEST = {
    "altitude_amsl_m": -1234.5,
    "above_ground_m": -1234.5,
    "clearance_m": 9e3,
    "looked_m": 9e3,
    "speed_m_s": 150.0,
    "course_rad": 6.0,
    "climb_m_s": -10.0,
    "safety_distance_m": 1e3,
    "to_go_m": 1.5e5,
    "time_left_s": 36e3,
    "t_s": 86400.0,
    "link_age_s": 599.9,
    "times_real_time": 187.0,
    "plan_cost": 1234.56,
    "plan_took_s": 29.999,
    "plan_clearance_m": 9e3,
}
"""The longest values that a table has to hold."""


class Terminal:
    """A session that is told what its state is, and the lines that are printed of it."""

    def __init__(self) -> None:
        session = Session(load_mission("environment-1"), seed=1, lockstep=False)
        self.flown = FlightSummary(session=session)
        self.console = Console(width=200, force_terminal=False, record=True, file=io.StringIO())
        self.progress = Progress(self.console, PatientOutput(io.StringIO()))

    def show(self, time_s: float, *, failsafe: bool = False, **changes: Any) -> list[str]:
        """The lines that this prints."""
        session = self.flown.session
        session.clock.read(time_s, time_s)  # it is heard as time goes by
        vehicle = replace(session.state.vehicle, failsafe=failsafe)
        if "phase" in changes:
            changes["since_s"] = time_s
        session.state = replace(session.state, now_s=time_s, vehicle=vehicle, **changes)
        self.progress.show(flight_status(self.flown))
        return self.console.export_text().splitlines()

    def table(self) -> str:
        """What stands in the table now."""
        self.console.print(status_table(flight_status(self.flown)))
        return self.console.export_text()

    def warn(self, text: str) -> None:
        self.flown.session._send_text(text, warning=True)


def test_each_change_is_a_line_that_says_why_it_holds_while_it_holds() -> None:
    """The autopilot's failsafe and its end, another reason, and no reason once it flies."""
    held = {"phase": Phase.HOLDING, "reason": Reason.FAILSAFE}
    over = {"why": Reason.FAILSAFE, "failsafe_over": True}
    lost = {"reason": Reason.LINK_LOST, "why": Reason.LINK_LOST}
    terminal = Terminal()
    terminal.show(100.0, **FLIES)
    for time_s, failsafe, changes, words in [
        (101.0, True, {}, "failsafe"),
        (102.0, True, held, Reason.FAILSAFE.text),
        (103.0, True, {}, None),
        (130.0, False, over, FAILSAFE_OVER),
        (135.0, False, lost, Reason.LINK_LOST.text),
        (136.0, False, {"reason": Reason.ESTIMATOR}, Reason.ESTIMATOR.text),
        (137.0, False, {}, None),
        (140.0, False, FLIES, "flying"),
        (141.0, True, {}, "failsafe"),
        (142.0, False, {}, "flying"),
    ]:
        lines = terminal.show(time_s, failsafe=failsafe, **changes)
        assert bool(lines) == (words is not None), time_s
        assert words is None or words in lines[-1]
        if words == "flying":
            assert not any(old in lines[-1] for old in ("failsafe", "hold", "("))


@pytest.mark.parametrize(("later_s", "stands"), [(59.0, True), (61.0, False)])
def test_a_warning_stands_for_a_minute_and_a_reason_to_hold_once(
    later_s: float, stands: bool
) -> None:
    terminal = Terminal()
    terminal.show(100.0, **FLIES)
    terminal.warn("scan: 3 of 9 blocks answered")
    [line] = terminal.show(100.2)
    assert line.endswith("(scan: 3 of 9 blocks answered)")
    terminal.show(100.0 + later_s)
    assert ("scan:" in terminal.table()) is stands
    terminal.warn(f"hold: {Reason.NO_FIX.text}")
    terminal.show(200.0, phase=Phase.HOLDING, reason=Reason.NO_FIX)
    assert terminal.table().count(Reason.NO_FIX.text) == 1


def shown(status: FlightStatus, width: int, **options: Any) -> str:
    """The table as it stands in a terminal of so many columns."""
    file = io.StringIO()
    Console(width=width, file=file, legacy_windows=False, **options).print(status_table(status))
    return file.getvalue()


@pytest.fixture(scope="module")
def statuses() -> list[FlightStatus]:
    """All kinds of things that happen, the last with the longest values."""
    names = ("copter-loses-gps", "plane-meets-new-fence")
    all_of_them = (flown for name in names for flown, _ in flights(name))
    found = [flight_status(flown) for number, flown in enumerate(all_of_them) if number % 7 == 0]
    return [*found, replace(found[-1], **LONGEST)]


@pytest.mark.parametrize("width", [80, 200])
def test_it_is_whole_in_a_terminal_of_this_width(statuses: list[FlightStatus], width: int) -> None:
    assert {"flying", "holding"} <= {status.phase for status in statuses}
    for status in statuses:
        text = shown(status, width)
        assert "…" not in text, text
        lines = text.splitlines()
        assert max(map(len, lines)) <= width
        assert len(lines) <= 14
        flat = " ".join(text.split())
        assert status.phase.upper() in flat
        if status.altitude_amsl_m is not None:
            assert f"{status.altitude_amsl_m:.0f} m AMSL" in flat
        if status.reason is not None and status.remedy is not None:
            assert f"{status.reason}. {status.remedy}" in flat


def test_what_is_wrong_is_told_without_colours_too(statuses: list[FlightStatus]) -> None:
    wrong = {"clearance_m": 3.0, "battery_left": 0.1, "link_age_s": 4.0, "position_age_s": 4.0}
    bad = replace(statuses[-1], **wrong)
    plain = shown(bad, 80)
    assert "\x1b" not in plain
    assert plain.count("!") >= 4
    assert "\x1b[1;31m" in shown(bad, 80, force_terminal=True, color_system="standard")


def test_what_is_near_is_wrong_in_flight_alone_and_a_reason_is_told_once(
    statuses: list[FlightStatus],
) -> None:
    quiet = replace(statuses[-1], reason=None, warning=None, refusal=None, plans_failed=0)
    for flown in (0, 1):
        near = shown(replace(quiet, clearance_m=3.0, subpaths_flown=flown), 200)
        assert ("! 3.00 m (d_s" in near) is (flown > 0)
    for failures in (0, 2):
        refused = shown(replace(quiet, refusal="out of time", plans_failed=failures), 200)
        assert ("! out of time" in refused) is (failures > 0)
        assert ("! failed 2 times" in refused) is (failures > 0)
    for warning, count in (("hold: no fix", 1), ("no", 1), ("low battery", 2)):
        told = shown(replace(quiet, reason="no fix", remedy="Wait", warning=warning), 200)
        assert "! no fix. Wait" in told
        assert sum(line.startswith("! ") for line in told.splitlines()[-count:]) == count
        assert (f"! {warning}" in told.replace("! no fix. Wait", "")) is (count > 1)


ENDS: dict[str, tuple[str | None, BaseException | None, tuple[str, str, int]]] = {
    "arrived": ("ARRIVED", None, ("arrived", "there", 0)),
    "failed": ("FAILED", FlightFailed("silent", "Look."), ("failed", "silent. Look.", 1)),
    "wrong input": (None, InputError("a", 1, "no", "Give 2."), ("failed", "a = 1: no. Give 2.", 2)),
    "crashed": (None, ZeroDivisionError("division"), ("failed", "division", 70)),
    "stopped again": ("STOPPED", KeyboardInterrupt(), ("stopped", "stopped by a person", 130)),
}


@pytest.mark.parametrize("how", ENDS)
def test_a_line_of_json_is_for_news_and_the_last_is_how_it_ended(how: str) -> None:
    outcome, error, expected = ENDS[how]
    status, buffer = flight_status(Terminal().flown), io.StringIO()
    with PatientOutput(buffer) as output:
        lines = MachineLines(output)
        for _ in range(3):
            lines.show(status)
            written(output)
        lines.show(replace(status, phase="holding"))
        if outcome is not None:
            lines.end = End(outcome=Outcome[outcome], reason="there", remedy="")
        lines.__exit__(None, error, None)
    *told, last = map(json.loads, buffer.getvalue().splitlines())
    assert [line["phase"] for line in told] == [status.phase, "holding"]
    assert (last["outcome"], last["reason"], last["exit_code"]) == expected
