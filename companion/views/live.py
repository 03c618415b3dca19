"""A flight while it is flown: a table that is redrawn, lines in a log, or JSON for machines."""

import math
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Final, Self, final

import msgspec
from rich.console import Console, Group
from rich.live import Live
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from companion.errors import CompanionError
from companion.mission.events import End, Outcome
from companion.telemetry.flight_status import FlightBegun, FlightEnded, FlightStatus
from companion.views.output import PatientOutput
from companion.views.words import (
    at_least,
    at_most,
    clock_text,
    counted,
    metres,
    metres_at_least,
    number,
)

_SHOWN_S = 0.5  # between two pictures of a flight in which nothing happens
_CRASHED, _INTERRUPTED = 70, 130
_CELLS, _HEADING = 2, 9  # values in a row of 80 columns, and columns of what each is
_SEVERE, _NOTABLE = "bold red", "yellow"
_PHASES: Final = {
    **dict.fromkeys(("flying", "arrived", "done", "returning"), "bold green"),
    **dict.fromkeys(("holding", "handing over"), "bold yellow"),
    "faulted": _SEVERE,
}
_IN_LINE: Final = ("to go", "altitude", "last plan", "proof")
_SLOW_S, _SILENT_S = 1.0, 3.0  # of the link
_LOSSY, _LOW = 0.05, 0.1  # share of the frames; of the battery, above the reserve


@final
class Progress:
    """Shows a flight to people; a context manager that gives the terminal back.

    On a terminal a table at its foot, and above it a line for each thing that happens; anywhere
    else only lines, for each subpath too.
    """

    def __init__(self, console: Console, output: PatientOutput) -> None:
        """output: what the console writes to."""
        self._console, self._output = console, output
        self._redraws = output.isatty() and not console.is_dumb_terminal
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._shown: tuple[object, ...] = ()
        self._vehicle_text: str | None = None
        self._shown_s = -math.inf

    def show(self, status: FlightStatus) -> None:
        """Show the flight as it stands now; to be called often."""
        now_s, lines = time.monotonic(), list(self._lines(status))
        redraws = self._redraws and status.waits_for is None  # else it hides what is typed
        if redraws is not self._live.is_started:
            self._live.start() if redraws else self._live.stop()
        for line in lines:
            self._console.print(line, highlight=False, soft_wrap=not self._redraws, markup=False)
        is_due = bool(lines) or now_s - self._shown_s >= _SHOWN_S
        if redraws and is_due and not self._output.is_behind:
            self._shown_s = now_s
            self._live.update(status_table(status), refresh=True)

    def _lines(self, status: FlightStatus) -> Iterator[str]:
        """What is new, in lines that stay."""
        said_before, self._vehicle_text = self._vehicle_text, status.vehicle_text
        if self._vehicle_text not in (said_before, None):
            yield f"t {status.t_s:7.1f} s  vehicle: {self._vehicle_text}"
        shown_before, self._shown = self._shown, _news(status, legs=not self._redraws)
        if self._shown != shown_before:
            yield progress_line(status)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()


@final
class MachineLines:
    """Shows a flight to machines: JSON, an object a line (docs/reference/fly-json.md).

    A context manager: its last line says how the flight has ended, whatever has ended it.
    """

    def __init__(self, output: PatientOutput | None) -> None:
        """output: nothing else is written to it; None: nobody has asked for it."""
        self.end: End | None = None
        """Of the mission, once it is over."""
        self._output = output
        self._shown: tuple[object, ...] = ()
        self._shown_s = -math.inf

    def say(self, line: FlightBegun | FlightStatus | FlightEnded) -> None:
        """Write one line."""
        if self._output is not None:
            self._output.write(f"{msgspec.json.encode(line).decode()}\n")

    def show(self, status: FlightStatus) -> None:
        """Write how the flight stands, if something is new or it is time; to be called often.

        What a slow reader has no time for is left out.
        """
        now_s, news = time.monotonic(), (status.vehicle_text, *_news(status, legs=True))
        is_due = news != self._shown or now_s - self._shown_s >= _SHOWN_S
        if is_due and self._output is not None and not self._output.is_behind:
            self._shown, self._shown_s = news, now_s
            self.say(status)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _: object, error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        code = 0 if error is None else getattr(error, "exit_code", _CRASHED)
        if isinstance(error, KeyboardInterrupt):
            outcome, reason, code = Outcome.STOPPED, "stopped by a person", _INTERRUPTED
        elif self.end is None or isinstance(error, CompanionError):
            outcome, reason = Outcome.FAILED, f"{error}"
        else:
            outcome, reason = self.end.outcome, self.end.reason
        self.say(FlightEnded(outcome=outcome, reason=reason, exit_code=code))


# --- in words


def _news(status: FlightStatus, *, legs: bool) -> tuple[object, ...]:
    """What there is a new line for."""
    return status.phase, status.code, _notice(status), legs and status.subpaths_flown


def _notice(status: FlightStatus) -> str:
    """Why the mission holds, and the autopilot's failsafe; else the latest warning."""
    failsafe = "the autopilot is in failsafe" if status.failsafe else ""
    return status.waits_for or status.reason or failsafe or status.warning or ""


def progress_line(status: FlightStatus) -> str:
    """What has just happened, and how the flight stands."""
    texts = {heading: text for heading, text, _ in _values(status)}
    parts = [f"t {status.t_s:7.1f} s", f"{status.phase:<10}"]
    parts += (
        f"{heading} {texts[heading]}" for heading in _IN_LINE if texts.get(heading, "-") != "-"
    )
    if notice := _notice(status):
        parts.append(f"({notice})")
    return "  ".join(parts)


def status_table(status: FlightStatus) -> Group:
    """All that a person flies by, in a terminal of 80 columns or more."""
    title = Text.assemble(
        (status.phase.upper(), _PHASES.get(status.phase, "bold")),
        f"  to target {status.target} of {status.targets}" if status.targets else "",
        f", subpath {status.subpaths_flown}" if status.subpaths_flown else "",
    )
    table = Table.grid(padding=(0, 1, 0, 0), expand=True)
    for _ in range(_CELLS):
        table.add_column(style="dim", width=_HEADING, no_wrap=True)
        table.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    cells = list[str | Text]()
    for heading, text, style in _values(status):
        # what is wrong can be told without colours
        cells += [heading, Text(f"! {text}" if style else text, style)]
    for first in range(0, len(cells), 2 * _CELLS):
        table.add_row(*cells[first : first + 2 * _CELLS])
    return Group(Rule(title, style="dim", align="left"), table, *_notes(status))


def _values(status: FlightStatus) -> Iterator[tuple[str, str, str]]:
    """Heading, at most 9 characters, text, at most 28, and style; the most important first."""
    to_go_m, altitude_m, off_m = status.to_go_m, status.altitude_amsl_m, status.off_path_m
    left = "" if status.time_left_s is None else f", in {clock_text(status.time_left_s)}"
    yield "to go", "-" if to_go_m is None else f"{metres(to_go_m)}{left}", ""
    above = "" if status.above_ground_m is None else f", {status.above_ground_m:.0f} m AGL"
    yield "altitude", "-" if altitude_m is None else f"{altitude_m:.0f} m AMSL{above}", ""
    course_rad = status.course_rad
    course = "" if course_rad is None else f" to {round(math.degrees(course_rad)) % 360:03d}"
    speed = number(status.speed_m_s, 0 if status.speed_m_s > 99.0 else 1)
    yield "speed", f"{speed} m/s{course}, climb {status.climb_m_s:+.1f}", ""
    clear_m, least_m = status.clearance_m, status.safety_distance_m
    if clear_m is None:
        yield "clearance", "-", ""
    else:
        more = "> " if clear_m >= status.looked_m else ""
        is_near = clear_m < least_m and status.subpaths_flown > 0
        text = f"{more}{metres_at_least(clear_m)} (d_s {metres(least_m)})"
        yield "clearance", text, _SEVERE if is_near else ""
    yield "off path", "-" if off_m is None else f"{off_m:.1f} m", ""
    share, reserve = status.battery_left, status.battery_reserve
    if share is None:
        yield "battery", "not told", ""
    else:
        style = _SEVERE if share <= reserve else _NOTABLE if share <= reserve + _LOW else ""
        yield "battery", f"{at_least(100.0 * share)}% (reserve {100.0 * reserve:g}%)", style
    age_s, lost = status.link_age_s, status.frames_lost
    if age_s is None:
        yield "link", "nothing heard", _NOTABLE
    else:
        share = lost / max(status.frames_heard + lost, 1)
        is_bad = age_s > _SLOW_S or share > _LOSSY
        style = _SEVERE if age_s > _SILENT_S else _NOTABLE if is_bad else ""
        yield "link", f"{age_s:.1f} s old, {at_most(100.0 * share)}% lost", style
    mode = f"{status.mode or '-'}, {'armed' if status.armed else 'disarmed'}"
    yield "mode", *((f"{mode}, FAILSAFE", _SEVERE) if status.failsafe else (mode, ""))
    took_s, cost = status.plan_took_s, status.plan_cost
    took = "-" if took_s is None else f"took {1e3 * took_s:.0f} ms"
    yield "last plan", took if cost is None else f"cost {cost:.2f}, {took}", ""
    proven_m, failures = status.plan_clearance_m, status.plans_failed
    if failures:
        yield "proof", f"failed {counted(failures, 'time')}", _NOTABLE
    elif cost is not None:
        proof = "not proven" if proven_m is None else metres_at_least(proven_m)
        yield "proof", f"{proof} to terrain", _SEVERE if proven_m is None else ""
    pace = status.times_real_time
    yield "time", f"{status.t_s:.0f} s{'' if pace is None else f', {pace:.0f}x real time'}", ""


def _notes(status: FlightStatus) -> Iterator[Text]:
    """What does not fit into a cell: it is wrapped."""
    reason, warning = status.reason, status.warning
    if reason is not None:
        yield Text(f"! {reason}. {status.remedy or ''}", _NOTABLE)
    elif status.refusal is not None and status.plans_failed:
        yield Text(f"! {status.refusal}", _NOTABLE)
    if warning is not None and (reason is None or not (reason in warning or warning in reason)):
        yield Text(f"! {warning}", _NOTABLE)
    age_s = status.position_age_s
    if age_s is not None and age_s > _SLOW_S:
        yield Text(f"! position and speed are {age_s:.0f} s old", _SEVERE)
