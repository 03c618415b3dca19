"""The report of shadow mode: as values, and as text and tables."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from itertools import groupby
from typing import Final, Literal, final

import numpy as np
from msgspec import Struct
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from companion.telemetry.logs import HOW_TO_RECORD

_MOMENT_S: Final = 1.0  # before it let go: what the vehicle said then may be why
_NEAR_S: Final = 60.0  # after it let go for good: what the vehicle said so long belongs to it


@final
class Place(Struct, frozen=True, kw_only=True):
    """Where something happened."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


@final
class HoldReason(Struct, frozen=True, kw_only=True):
    """One reason to hold, by its name and in words, and when it became the reason."""

    at_s: float
    code: str
    text: str
    remedy: str


@final
class Hold(Struct, kw_only=True):
    """A time span in which the companion would have put the vehicle on hold."""

    let_go_s: float
    why: list[HoldReason]
    """The first is why it let go; the others came while it held."""
    place: Place | None
    in_air: bool
    trusted_s: float | None = None
    """Since when the position may be believed again; None: not to the end."""
    went_on_s: float | None = None
    """When it would have gone on; None: not to the end."""


@final
class Observed(Struct, kw_only=True):
    """Something about the vehicle's health or position that lasted from here to there."""

    kind: str
    from_s: float
    until_s: float | None = None
    """None: to the end."""
    in_air: bool = False
    worst_m: float | None = None
    """How far, where there is a distance to it."""
    place: Place | None = None


@final
class TrackDeviation(Struct, frozen=True, kw_only=True):
    """How far the flown track was from a planned subpath, over one position or more."""

    from_s: float
    until_s: float
    positions: int
    max_m: float
    max_at_s: float
    rms_m: float
    """Root mean square over the positions."""

    @staticmethod
    def of(positions: Sequence[tuple[float, float]]) -> "TrackDeviation | None":
        """Of positions: when each was, and how far off; None: there are none."""
        if not positions:
            return None
        at_s, off_m = np.array(positions).T
        farthest = int(np.argmax(off_m))
        return TrackDeviation(
            from_s=float(at_s[0]),
            until_s=float(at_s[-1]),
            positions=len(positions),
            max_m=float(off_m[farthest]),
            max_at_s=float(at_s[farthest]),
            rms_m=float(np.sqrt(np.mean(off_m**2))),
        )


@final
class PlanAttempt(Struct, kw_only=True):
    """A subpath that the companion would have planned, and how the flown track compares."""

    plan_id: int
    at_s: float
    place: Place | None
    """Where it would have begun."""
    why: str
    goes_on: bool
    """Whether it is the successor of a subpath that the vehicle follows; else it begins at rest."""
    outcome: str = "unanswered"
    """ "ready", "refused", "given up" (it held before the answer was due), or "unanswered": the log
    ended before."""
    reason: str = ""
    """Of a refusal, its name."""
    remedy: str = ""
    length_m: float | None = None
    clearance_m: float | None = None
    reaches_target: bool = False
    off: TrackDeviation | None = None
    """How far the flown track was from it."""


@final
class VehicleReport(Struct, frozen=True, kw_only=True):
    """What the vehicle did, or said, by itself."""

    at_s: float
    text: str
    """A mode, "armed", "disarmed", "in the air", "on the ground", or what it said, quoted."""

    def __str__(self) -> str:
        return f"{self.at_s:,.1f} s {self.text}"


@final
class ShadowReport(Struct, kw_only=True):
    """All of it.  Times are seconds after the log's first record unless they are said otherwise."""

    schema: Literal[1] = 1
    """Version of these fields, for readers of `--json`."""
    file: str
    system_id: int
    vehicle: str
    """The autopilot and kind, in words."""
    mission: str | None
    """Its name; None: health alone."""
    began_us: int | None = None
    """Time of the first record, microseconds since 1970."""
    length_s: float = 0.0
    in_air_s: float = 0.0
    watched_from_s: float | None = None
    """When the companion would have been ready; None: never."""
    position_rate_hz: float | None = None
    holds: list[Hold] = []
    health: list[Observed] = []
    outside: list[Observed] = []
    """Positions outside the mission's limits."""
    plans: list[PlanAttempt] = []
    own_path: TrackDeviation | None = None
    """How far the flown track was from all planned subpaths together."""
    said: list[VehicleReport] = []
    could_not: list[str] = []
    """What shadow mode could not do on this log, why, and what to do about it."""
    missing: dict[str, str] = {}
    """Messages that the log lacks, and what is impossible without each."""
    log_findings: tuple[str, ...] = ()
    notes: list[str] = []


# --- for people


def renderables(report: ShadowReport) -> list[RenderableType]:
    """The report, part by part, in the order in which a person wants to know."""
    held = "let go", "why", "position good", "goes on", "the vehicle itself"
    observed = "from", "to", "what", "where"
    planned = "at", "where", "why", "answer", "flown track off it, max / rms"
    forbidden = "where the mission does not allow it to be"
    holds = (_hold_row(hold, report) for hold in report.holds)
    return [
        *map(Text, _head(report)),
        *_table("where it would have held", held, holds),
        *_table("health", observed, map(_observed_row, report.health)),
        *_table(forbidden, observed, map(_observed_row, report.outside)),
        *_table("where it would have planned", planned, _plan_rows(report.plans)),
        *map(Text, _tail(report)),
    ]


def _table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[Table]:
    """The table, unless it has no row."""
    table = Table(*headings, title=title, title_justify="left")
    for row in rows:
        table.add_row(*map(Text, row))
    if table.row_count:
        yield table


def _head(report: ShadowReport) -> Iterator[str]:
    air = f", {report.in_air_s:,.0f} s of it in the air" if report.in_air_s else ""
    began = datetime.fromtimestamp((report.began_us or 0) * 1e-6, UTC)
    date = f"{began:%Y-%m-%d %H:%M:%S}Z, " if began.year > 1970 else ""
    yield (
        f"{report.file}: {report.vehicle}, system {report.system_id}; {date}"
        f"{report.length_s:,.1f} s{air}"
    )
    yield "times: seconds after the log's first record; places: latitude, longitude, altitude AMSL"
    none = "no mission was given: only the vehicle's health was looked at"
    yield none if report.mission is None else f"mission {report.mission}"
    if report.watched_from_s is None:
        yield "the companion would never have been ready"
        return
    always = "; it would never have let go: the position could always be believed"
    ready = f"ready, with a position to be believed, at {report.watched_from_s:,.1f} s"
    yield ready if report.holds else ready + always


def _hold_row(hold: Hold, report: ShadowReport) -> list[str]:
    """When it would have held and why, and what the vehicle did and said by itself meanwhile."""
    first, reasons = hold.why[0], dict[str, str]()
    for why in hold.why:
        reasons.setdefault(why.text, f"{why.at_s:,.1f} s: {why.text}")
    _, *later = reasons.values()
    from_s, until_s = hold.let_go_s - _MOMENT_S, hold.went_on_s or hold.let_go_s + _NEAR_S
    did = [str(said) for said in report.said if from_s <= said.at_s <= until_s]
    ground = "" if hold.in_air else "\n(on the ground)"
    why_text = "\n".join([first.text, *later, f"-> {first.remedy}"])
    let_go, good, on = f"{hold.let_go_s:,.2f} s{ground}", _at(hold.trusted_s), _at(hold.went_on_s)
    return [let_go, why_text, good, on, "\n".join(did) or "nothing"]


def _observed_row(seen: Observed) -> list[str]:
    far = "" if seen.worst_m is None else f", by {seen.worst_m:,.1f} m"
    ground = "" if seen.in_air else " (on the ground)"
    what, until = f"{seen.kind}{far}{ground}", _at(seen.until_s, "the end")
    return [_at(seen.from_s), until, what, _where(seen.place)]


def _plan_rows(plans: Sequence[PlanAttempt]) -> Iterator[list[str]]:
    """A row for each plan; what is refused again and again has one."""
    for refusal, alike in groupby(plans, key=lambda asked: (asked.reason, asked.why)):
        first, *others = map(_plan_row, alike)
        if refusal[0] and others:
            first[0] += f" to {others[-1][0]}, {1 + len(others)} times"
            others = []
        yield from (first, *others)


def _plan_row(asked: PlanAttempt) -> list[str]:
    answer, off = asked.outcome, asked.off
    if asked.reason:
        answer += f": {_words(asked.reason)}"
    if asked.length_m is not None:
        answer = f"{asked.length_m:,.0f} m" + (", to the target" if asked.reaches_target else "")
    if asked.clearance_m is not None:
        answer += f", clear by {math.floor(asked.clearance_m + 1e-6):,} m"
    away = "" if off is None else f"{off.max_m:,.1f} / {off.rms_m:,.1f} m to {_at(off.until_s)}"
    return [_at(asked.at_s), _where(asked.place), asked.why, answer, away]


def _tail(report: ShadowReport) -> Iterator[str]:
    if report.plans:
        answers = Counter(asked.outcome for asked in report.plans).most_common()
        counted = ", ".join(f"{count} {name}" for name, count in answers)
        yield f"{len(report.plans)} subpaths asked for: {counted}"
        refused = {asked.reason: asked.remedy for asked in report.plans if asked.reason}
        yield from (f"  {_words(reason)}: {remedy}" for reason, remedy in refused.items())
    if (own := report.own_path) is not None:
        most = f"{own.max_m:,.1f} m at most (at {_at(own.max_at_s)}), {own.rms_m:,.1f} m rms"
        yield f"flown track off its own paths: {most}, over {own.positions:,} positions"
    yield from (f"could not {reason}" for reason in report.could_not)
    reasons = " ".join(report.could_not)
    for message, without in report.missing.items():
        if message not in reasons:
            yield f"{message} is missing: {without}. {HOW_TO_RECORD}"
    yield from (f"note: {note}" for note in report.notes)
    yield from (f"log: {finding}" for finding in report.log_findings)


def _at(at_s: float | None, never: str = "never") -> str:
    return never if at_s is None else f"{at_s:,.1f} s"


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


def _where(place: Place | None) -> str:
    if place is None:
        return ""
    return f"{place.latitude_deg:.5f}, {place.longitude_deg:.5f}, {place.altitude_amsl_m:,.0f} m"
