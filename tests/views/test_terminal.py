"""Missions, plans and flights in words and tables, on a terminal and for machines.

Nothing looks safer, or better known, than it is; and whoever prints never waits and never fails.
"""

import io
import json
import math
import os
from typing import Any

import made_up
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import certificate
from planning import ask
from renewed import replace
from rich.console import Console
from test_flight_summary import flights

from companion.config import load_mission
from companion.errors import FlightFailed, InputError
from companion.mission.events import End, Outcome
from companion.mission.mission import Mission
from companion.mission.phases import Phase, Reason
from companion.mission.stopped import FAILSAFE_OVER
from companion.path.certificate import Certificate
from companion.planner.request import Planned
from companion.session import Session
from companion.telemetry.flight_status import FlightStatus, flight_status
from companion.telemetry.flight_summary import FlightSummary
from companion.views.live import MachineLines, Progress, status_table
from companion.views.output import PatientOutput
from companion.views.text import clearance_text, flight_table, mission_summary, plans_table
from companion.views.words import at_least, at_most, counted, metres_at_least, number
from companion.world.known_map import empty_map

HILLS = load_mission("environment-1")
PROVEN = replace(certificate(), clearance_m=612.4, turn_radius_m=math.inf, radar_m=250.0)
SOUTH = "3,000 m south, 2,000 m west of the origin (3,606 m straight from there)"


def printed(what: Any, width: int = 200, **options: Any) -> str:
    """As it stands in a terminal of so many columns."""
    file = io.StringIO()
    Console(width=width, file=file, legacy_windows=False, **options).print(what)
    return file.getvalue()


def on_one_line(text: str) -> str:
    return " ".join(text.split())


# --- in words


def known_but_for(cells: int) -> Mission:
    """Of ten thousand."""
    known = empty_map(50.0, (0.0, 5_000.0), (0.0, 5_000.0))
    upper_m = np.full(known.upper_m.shape, 100.0)
    upper_m.flat[:cells] = np.inf
    return replace(load_mission("sitl-arducopter"), known=replace(known, upper_m=upper_m))


@pytest.mark.parametrize(
    ("mission", "words"),
    [
        (HILLS, "100.0 km north, 100.0 km east"),
        (replace(HILLS, targets_ne_m=((-3_000.0, -2_000.0),)), SOUTH),
        (HILLS, "proven safe before it is flown"),
        (load_mission("environment-1", "paper"), "flown unproven"),
        (replace(HILLS, scanner_complete=False), "nothing bounds"),
        (known_but_for(0), "Terrain of 100.0% of the map"),
        (known_but_for(1), "Terrain of 99.9% of the map"),
        (known_but_for(9_999), "Terrain of 0.0% of the map"),
    ],
)
def test_a_mission_in_words_says_where_it_goes_and_what_is_known_and_proven(
    mission: Mission, words: str
) -> None:
    assert words in on_one_line(mission_summary(mission))
    assert "nothing bounds" not in mission_summary(HILLS)


@given(st.floats(0.0, 30_000.0))
def test_no_clearance_looks_larger_than_it_is_nor_much_smaller(clear_m: float) -> None:
    for said in (
        clearance_text(replace(PROVEN, clearance_m=clear_m)),
        metres_at_least(clear_m),
        f"{at_least(clear_m, 1)} m",
    ):
        number, unit = said.replace(",", "").split()
        told_m = float(number) * {"m": 1.0, "km": 1000.0}[unit]
        assert 0.98 * clear_m - 0.1 <= told_m <= clear_m + 1e-5
        assert told_m == pytest.approx(clear_m, rel=0.02, abs=1.0)


def test_what_is_not_known_or_has_no_bound_is_a_dash_and_one_thing_is_no_several() -> None:
    assert " ".join(map(number, (None, math.inf, math.nan, -0.2, 1234.6))) == "– – – 0 1,235"
    assert [at_most(each) for each in (0.0, 0.1, 99.0)] == ["0", "1", "99"]
    assert [counted(each, "radar") for each in (0, 1, 2)] == ["0 radars", "1 radar", "2 radars"]


# --- a flight that is over


def planned(proof: Certificate, cost: float) -> Planned:
    """A straight plan, 15 km long."""
    limits = HILLS.task.limits
    unknown = empty_map(HILLS.task.cell_m, limits.north_m, limits.east_m)
    request = ask(HILLS.task, unknown, (0.0, 0.0, 3030.0), target_ne_m=(9_000.0, 12_000.0))
    return replace(made_up.planned(request, 15_000.0), certificate=proof, cost=cost)


def ended(mission: Mission, outcome: Outcome, *plans: Planned, **more: Any) -> str:
    """Its table."""
    flight = FlightSummary(session=Session(mission, seed=1, lockstep=True), **more)
    flight.plans += plans
    flight.end = End(outcome=outcome, reason="", remedy="")
    return on_one_line(printed(flight_table(flight)))


def test_a_flight_is_as_near_to_the_terrain_as_its_nearest_leg_and_costs_the_sum_of_all() -> None:
    near, far = planned(PROVEN, 3.25), planned(replace(PROVEN, clearance_m=1_040.0), 3.5)
    for order in ((near, far), (far, near)):
        table = ended(HILLS, Outcome.ARRIVED, *order)
        assert "1,040 m" not in table
        for words in ("612 m", "6.8", "500 m", "arrived"):  # 3.25 + 3.5; 250 m in range, twice
            assert words in table
    unproven = replace(near, certificate=replace(PROVEN, broken=("turn radius",)))
    rows = printed(plans_table((near, unproven))).splitlines()
    first, second = (line for line in rows if "15.0 km" in line)
    assert all(words in first for words in ("612 m", "straight"))
    assert "not proven" in second
    plane, copter = load_mission("sitl-arduplane"), load_mission("sitl-arducopter")
    passed = "passed the target at │ 12.3 m"
    assert passed in ended(plane, Outcome.ARRIVED, passed_m=12.34)
    assert passed not in ended(plane, Outcome.FAILED, passed_m=12.34)
    assert passed not in ended(copter, Outcome.ARRIVED, passed_m=12.34)


# --- while it is flown

FLIES = {"phase": Phase.FLYING, "reason": None}
LONGEST = {"altitude_amsl_m": -1234.5, "above_ground_m": -1234.5, "clearance_m": 9e3}
LONGEST |= {"looked_m": 9e3, "speed_m_s": 150.0, "course_rad": 6.0, "climb_m_s": -10.0}
LONGEST |= {"safety_distance_m": 1e3, "to_go_m": 1.5e5, "time_left_s": 36e3, "t_s": 86400.0}
LONGEST |= {"link_age_s": 599.9, "times_real_time": 187.0, "plan_cost": 1234.56}
LONGEST |= {"plan_took_s": 29.999, "plan_clearance_m": 9e3}
"""The longest values that a table has to hold."""


class Terminal:
    """A session that is told what its state is, and the lines that are printed of it."""

    def __init__(self) -> None:
        self.flown = FlightSummary(session=Session(HILLS, seed=1, lockstep=False))
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


def test_each_change_is_a_line_that_says_why_it_holds_while_it_holds() -> None:
    """The autopilot's failsafe and its end, another reason, no reason once it flies, a warning."""
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
    terminal.show(200.0)  # a warning stands for a minute
    terminal.flown.session._send_text("scan: 3 of 9 blocks answered", warning=True)
    assert terminal.show(200.2)[-1].endswith("(scan: 3 of 9 blocks answered)")
    for time_s, stands in ((259.0, True), (261.0, False)):
        terminal.show(time_s)
        table = printed(status_table(flight_status(terminal.flown)))
        assert ("scan:" in table) is stands


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
        text = printed(status_table(status), width)
        lines, flat = text.splitlines(), on_one_line(text)
        assert "…" not in text, text
        assert max(map(len, lines)) <= width
        assert len(lines) <= 14
        assert status.phase.upper() in flat
        if status.altitude_amsl_m is not None:
            assert f"{status.altitude_amsl_m:.0f} m AMSL" in flat
        if status.reason is not None and status.remedy is not None:
            assert f"{status.reason}. {status.remedy}" in flat


def test_what_is_wrong_is_told_without_colours_too_and_a_reason_once(
    statuses: list[FlightStatus],
) -> None:
    """What is near is wrong in flight alone."""
    wrong = {"clearance_m": 3.0, "battery_left": 0.1, "link_age_s": 4.0, "position_age_s": 4.0}
    bad = status_table(replace(statuses[-1], **wrong))
    assert "\x1b" not in printed(bad, 80)
    assert printed(bad, 80).count("!") >= 4
    assert "\x1b[1;31m" in printed(bad, 80, force_terminal=True, color_system="standard")
    quiet = replace(statuses[-1], reason=None, warning=None, refusal=None, plans_failed=0)

    def told(**changes: Any) -> str:
        return printed(status_table(replace(quiet, **changes)))

    for flown in (0, 1):
        assert ("! 3.00 m (d_s" in told(clearance_m=3.0, subpaths_flown=flown)) is (flown > 0)
    for failures in (0, 2):
        refused = told(refusal="out of time", plans_failed=failures)
        assert ("! out of time" in refused) is ("! failed 2 times" in refused) is (failures > 0)
    for warning, count in (("hold: no fix", 1), ("no", 1), ("low battery", 2)):
        lines = told(reason="no fix", remedy="Wait", warning=warning).splitlines()
        assert "! no fix. Wait" in [line.rstrip() for line in lines[-count:]]
        assert (f"! {warning}" in [line.rstrip() for line in lines]) is (count > 1)


# --- whoever reads it

LONG = "0123456789abcde\n" * 64  # 1 KiB


def written(output: PatientOutput) -> None:
    """Wait until the reader has taken all."""
    while output.is_behind:
        os.sched_yield()


def test_a_reader_that_does_not_read_holds_up_nobody_and_one_that_leaves_is_not_missed() -> None:
    """What it gets comes in its order."""
    reader, writer = os.pipe()
    with os.fdopen(writer, "w", encoding="utf-8") as stream, PatientOutput(stream) as output:
        for _ in range(5000):
            output.write(LONG)
        assert output.is_behind
        assert os.read(reader, 1 << 20).startswith(LONG.encode())
        os.close(reader)
        for _ in range(100):
            output.write(LONG)
        written(output)


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
