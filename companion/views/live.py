"""A flight while it is flown: a table that is redrawn, lines in a log, or JSON for machines."""

import math
import time
from collections import deque
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
from companion.views.words import clock_text, metres, metres_at_least, rounded_down

_SHOWN_S = 0.25  # between two pictures of a flight in which nothing happens
_LOSS_S = 10.0  # of which the share of lost frames is told
_CRASHED, _INTERRUPTED = 70, 130

_CELLS, _HEADING = 2, 9  # values in a row of 80 columns, and columns of what each is
_SEVERE, _NOTABLE = "bold red", "yellow"
_PHASES: Final = {
    **dict.fromkeys(("flying", "arrived", "done", "returning"), "bold green"),
    **dict.fromkeys(("holding", "handing over"), "bold yellow"),
    "faulted": _SEVERE,
}
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
        self._told: tuple[object, ...] = ()
        self._said: str | None = None
        self._shown_s = -math.inf
        self._frames: deque[tuple[int, int]] = deque(maxlen=round(_LOSS_S / _SHOWN_S))

    def show(self, status: FlightStatus) -> None:
        """Show the flight as it stands now; to be called often."""
        now_s, lines = time.monotonic(), list(self._lines(status))
        redraws = self._redraws and status.waits_for is None  # else it hides what is typed
        if self._redraws and redraws is not self._live.is_started:
            self._live.start() if redraws else self._live.stop()
        for line in lines:
            self._console.print(line, highlight=False, soft_wrap=not self._redraws, markup=False)
        if not lines and now_s - self._shown_s < _SHOWN_S:
            return
        self._shown_s = now_s
        self._frames.append((status.frames_heard, status.frames_lost))
        if redraws and not self._output.is_behind:
            self._live.update(status_table(status, self._lost()), refresh=True)

    def _lines(self, status: FlightStatus) -> Iterator[str]:
        """What is new, in lines that stay."""
        said, self._said = self._said, status.vehicle_text
        if self._said not in (said, None):
            yield f"t {status.t_s:7.1f} s  vehicle: {self._said}"
        told, self._told = self._told, _news(status, legs=not self._redraws)
        if self._told != told:
            yield event_line(status) if self._redraws else progress_line(status)

    def _lost(self) -> float:
        """Share of the autopilot's frames that were lost of late."""
        (heard_before, lost_before), (heard, lost) = self._frames[0], self._frames[-1]
        lately = lost - lost_before
        return lately / max(heard - heard_before + lately, 1)

    def __enter__(self) -> Self:
        if self._redraws:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._redraws:
            self._live.stop()


@final
class MachineLines:
    """Shows a flight to machines: JSON, an object a line (docs/reference/fly-json.md).

    A context manager: its last line says how the flight has ended, whatever has ended it.
    """

    def __init__(self, output: PatientOutput) -> None:
        """output: nothing else is written to it."""
        self.end: End | None = None
        """Of the mission, once it is over."""
        self._output = output
        self._told: tuple[object, ...] = ()
        self._shown_s = -math.inf

    def say(self, line: FlightBegun | FlightStatus | FlightEnded) -> None:
        """Write one line."""
        self._output.write(f"{msgspec.json.encode(line).decode()}\n")

    def show(self, status: FlightStatus) -> None:
        """Write how the flight stands, if something is new or it is time; to be called often.

        What a slow reader has no time for is left out.
        """
        now_s, news = time.monotonic(), (status.vehicle_text, *_news(status, legs=True))
        is_due = news != self._told or now_s - self._shown_s >= _SHOWN_S
        if is_due and not self._output.is_behind:
            self._told, self._shown_s = news, now_s
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


def event_line(status: FlightStatus) -> str:
    """What has just happened."""
    notice = _notice(status)
    return f"t {status.t_s:7.1f} s  {status.phase}{notice and ': '}{notice}"


def progress_line(status: FlightStatus) -> str:
    """The same with how the flight stands: for a log."""
    parts = [f"t {status.t_s:7.1f} s", f"{status.phase:<10}"]
    if status.to_go_m is not None:
        parts.append(f"to go {metres(status.to_go_m):>8}")
    if status.altitude_amsl_m is not None:
        parts.append(f"altitude {status.altitude_amsl_m:5.0f} m")
    if status.plan_cost is not None:
        parts.append(f"subpath {status.subpaths_flown:2d}")
        parts.append(f"cost {status.plan_cost:5.2f}")
        parts.append(f"clearance {_proof(status):>10}")
    if status.plan_took_s is not None:
        parts.append(f"planned in {status.plan_took_s * 1e3:4.0f} ms")
    if status.times_real_time is not None:
        parts.append(f"{status.times_real_time:4.0f}x real time")
    if notice := _notice(status):
        parts.append(f"({notice})")
    return "  ".join(parts)


def status_table(status: FlightStatus, lost: float) -> Group:
    """All that a person flies by, in a terminal of 80 columns or more.

    lost: share of the autopilot's frames that were lost of late.
    """
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
    for heading, text, style in _values(status, lost):
        cells += [heading, Text(text, style)]
    for first in range(0, len(cells), 2 * _CELLS):
        table.add_row(*cells[first : first + 2 * _CELLS])
    head = Rule(title, style="dim", align="left")
    return Group(head, table, *_notes(status))


_Value = tuple[str, str, str]
"""Heading, at most 9 characters; text, at most 28; style."""


def _values(status: FlightStatus, lost: float) -> Iterator[_Value]:
    """The most important first."""
    to_go = "-" if status.to_go_m is None else metres(status.to_go_m)
    if status.to_go_m is not None and status.time_left_s is not None:
        to_go += f", in {clock_text(round(status.time_left_s))}"
    yield "to go", to_go, ""
    altitude = "-" if status.altitude_amsl_m is None else f"{status.altitude_amsl_m:.0f} m AMSL"
    if status.altitude_amsl_m is not None and status.above_ground_m is not None:
        altitude += f", {status.above_ground_m:.0f} m AGL"
    yield "altitude", altitude, ""
    course = ""
    if status.course_rad is not None:
        course = f" to {round(math.degrees(status.course_rad)) % 360:03d}"
    speed = f"{status.speed_m_s:.{0 if status.speed_m_s > 99.0 else 1}f} m/s"
    yield "speed", f"{speed}{course}, climb {status.climb_m_s:+.1f}", ""
    clear_m, least_m = status.clearance_m, status.safety_distance_m
    if clear_m is None:
        yield "clearance", "-", ""
    else:
        more = "> " if clear_m >= status.looked_m else ""
        text = f"{more}{metres_at_least(clear_m)} (d_s {metres(least_m)})"
        near = clear_m < least_m and status.subpaths_flown > 0
        yield "clearance", *_marked(text, _SEVERE if near else "")
    off_m = status.off_path_m
    is_off = off_m is not None and off_m > status.tracking_error_m
    yield "off path", "-" if off_m is None else f"{off_m:.1f} m", _NOTABLE if is_off else ""
    left, reserve = status.battery_left, status.battery_reserve
    if left is None:
        yield "battery", "not told", ""
    else:
        style = _SEVERE if left <= reserve else _NOTABLE if left <= reserve + _LOW else ""
        text = f"{rounded_down(100.0 * left):.0f}% (reserve {100.0 * reserve:g}%)"
        yield "battery", *_marked(text, style)
    yield _link(status, lost)
    mode = f"{status.mode or '-'}, {'armed' if status.armed else 'disarmed'}"
    yield "mode", *((f"{mode}, FAILSAFE", _SEVERE) if status.failsafe else (mode, ""))
    plan = "-" if status.plan_took_s is None else f"took {status.plan_took_s * 1e3:.0f} ms"
    if status.plan_cost is not None:
        plan = f"cost {status.plan_cost:.2f}, {plan}"
    yield "last plan", plan, ""
    if status.plans_failed:
        yield "proof", *_marked(f"failed {status.plans_failed} times", _NOTABLE)
    elif status.plan_cost is not None:
        yield "proof", f"{_proof(status)} to terrain", _SEVERE if status.plan_broken else ""
    pace = status.times_real_time
    yield "time", f"{status.t_s:.0f} s{'' if pace is None else f', {pace:.0f}x real time'}", ""


def _link(status: FlightStatus, lost: float) -> _Value:
    age_s, trip_s = status.link_age_s, status.link_round_trip_s
    if age_s is None:
        return "link", "nothing heard", _NOTABLE
    trip = "" if trip_s is None or age_s > _SLOW_S else f", {trip_s * 1e3:.0f} ms"
    style = _SEVERE if age_s > _SILENT_S else _NOTABLE if age_s > _SLOW_S or lost > _LOSSY else ""
    text = f"{age_s:.1f} s old, {math.ceil(100.0 * lost - 1e-6)}% lost{trip}"
    return "link", *_marked(text, style)


def _marked(text: str, style: str) -> tuple[str, str]:
    """What is wrong can be told without colours."""
    return (f"! {text}" if style else text), style


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


def _proof(status: FlightStatus) -> str:
    """The clearance that is proven for the newest plan."""
    clear_m = status.plan_clearance_m
    return "not proven" if status.plan_broken or clear_m is None else metres_at_least(clear_m)
