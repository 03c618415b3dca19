"""The progress of a flight, in the terminal: one line that is redrawn, or lines in a log."""

import contextlib
from typing import Self, final

from rich.console import Console, JustifyMethod
from rich.live import Live
from rich.table import Table
from rich.text import Text

from companion.mission.decisions import reason_text
from companion.mission.state import IN_AIR, Reason, TakenOver
from companion.mission.stopped import FAILSAFE_OVER
from companion.telemetry.flight_summary import FlightSummary
from companion.views.text import clearance_text

_STANDS_S = 60.0  # a warning


@final
class Progress:
    """Shows a flight while it is flown; a context manager that gives the terminal back."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._redraws = console.is_terminal and not console.is_dumb_terminal
        self._broken = False
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._told: tuple[object, ...] = ()

    def show(self, flown: FlightSummary) -> None:
        """Draw the flight as it stands now."""
        if self._broken:
            return
        try:
            self._show(flown)
        except OSError:  # the terminal is gone; the flight goes on
            self._broken = True

    def _show(self, flown: FlightSummary) -> None:
        state = flown.session.state
        if self._redraws:
            self._live.update(progress_table(flown), refresh=True)
        elif self._told != (tells := (state.phase, state.flight.legs_flown, *_news(flown))):
            self._told = tells
            self._console.print(progress_line(flown), highlight=False, soft_wrap=True, markup=False)

    def __enter__(self) -> Self:
        if self._redraws:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._redraws and not self._broken:
            with contextlib.suppress(OSError):
                self._live.stop()


def progress_table(flown: FlightSummary) -> Table:
    """A heading and a line: fits into 80 columns."""
    state = flown.session.state
    table = Table(box=None, padding=(0, 1), pad_edge=False, caption_justify="left")
    values = {"phase": state.phase.value, "time": f"{flown.session.now_s:.0f} s"}
    values["to go"] = "" if flown.to_go_m is None else f"{flown.to_go_m / 1000:.1f} km"
    values |= dict.fromkeys(("subpath", "cost", "clearance", "planned in"), "")
    if flown.plans:
        values["subpath"] = f"{state.flight.legs_flown}"
        values["cost"] = f"{flown.plans[-1].cost:.2f}"
        values["clearance"] = clearance_text(flown.plans[-1].certificate)
        values["planned in"] = f"{flown.plans_s[-1] * 1e3:.0f} ms"
    values["real time"] = f"{flown.times_real_time:.0f}x"
    for heading, width in zip(values, (10, 7, 8, 7, 5, 9, 10, 9), strict=True):
        justify: JustifyMethod = "left" if heading == "phase" else "right"
        table.add_column(heading, header_style="dim", min_width=width, justify=justify)
    table.add_row(*values.values())
    if notice := _notice(flown):
        table.caption = Text(notice)
    return table


def progress_line(flown: FlightSummary) -> str:
    """Phase, time, distance to go, subpath, its cost and clearance, planning time, speed-up."""
    session = flown.session
    state = session.state
    parts = [f"{state.phase.value:<10}", f"t {session.now_s:7.1f} s"]
    if flown.to_go_m is not None:
        parts.append(f"to go {flown.to_go_m / 1000:6.1f} km")
    if flown.plans:
        newest = flown.plans[-1]
        parts.append(f"subpath {state.flight.legs_flown:2d}")
        parts.append(f"cost {newest.cost:5.2f}")
        parts.append(f"clearance {clearance_text(newest.certificate):>9}")
    if flown.plans_s:
        parts.append(f"planned in {flown.plans_s[-1] * 1e3:4.0f} ms")
    if session.now_s > 0.0:
        parts.append(f"{flown.times_real_time:4.0f}x real time")
    if notice := _notice(flown):
        parts.append(f"({notice})")
    return "  ".join(parts)


def _notice(flown: FlightSummary) -> str:
    """Why the mission holds, and the autopilot's failsafe; else the latest warning."""
    state, (reason, over, failsafe, warning) = flown.session.state, _news(flown)
    if over:
        return FAILSAFE_OVER
    if reason is not None:
        return f"{reason.text}{reason_text(state, reason)[0]}"
    return "the autopilot is in failsafe" if failsafe else warning


def _news(flown: FlightSummary) -> tuple[Reason | None, bool, bool, str]:
    """What a notice is about: the reason to hold, the autopilot's failsafe, and a warning.

    A warning is old once the mission has moved on, or it has stood for a while.
    """
    state, (warned_at_s, warning) = flown.session.state, flown.session.warned
    said_in_phase = warned_at_s >= state.since_s
    stands = said_in_phase and 0.0 <= flown.session.now_s - warned_at_s < _STANDS_S
    failsafe = state.vehicle.failsafe and state.phase in IN_AIR
    told = isinstance(state.hold, TakenOver) and state.hold.failsafe_over
    over = told and state.reason is Reason.FAILSAFE
    return state.reason, over, failsafe, warning if stands else ""
