"""The report of shadow mode: as values, and as text and tables."""

import math
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any, Final, NamedTuple, final

import msgspec
from msgspec import Struct
from msgspec.structs import asdict, replace
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from companion.telemetry.logs import Missing

SCHEMA: Final = 1
"""Of `ShadowReport.as_json`."""
_MAX_ROWS: Final = 30
_NEAR_S: Final = 60.0
_MAX_SAID: Final = 8
_MOMENT_S: Final = 1.0
_SHORT_REASONS: Final = 3


@final
class Place(Struct, frozen=True, kw_only=True):
    """Where something happened."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    north_m: float
    """Of the mission's origin; without a mission, of the first position."""
    east_m: float


@final
class HoldReason(Struct, frozen=True, kw_only=True):
    """One reason to hold, and when it became the reason."""

    at_s: float
    code: str
    """Its name: POSITION_JUMPED."""
    text: str
    remedy: str


@final
class Hold(Struct, kw_only=True):
    """A time span in which the companion would have put the vehicle on hold."""

    let_go_s: float
    vehicle_s: float
    """The same by the vehicle's clock."""
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
    """An observation about the vehicle's health or position, over a time span."""

    kind: str
    """What: "GPS fix lost", "jump", "below the floor"."""
    from_s: float
    until_s: float | None = None
    """None: to the end."""
    in_air: bool = False
    worst_m: float | None = None
    """How far, where there is a distance to it."""
    place: Place | None = None


@final
class PlanAttempt(Struct, kw_only=True):
    """A subpath that the companion would have planned, and how the flown track compares."""

    plan_id: int
    at_s: float
    vehicle_s: float
    place: Place
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
    samples: list["OffPath"] = []

    @property
    def off(self) -> "TrackDeviation | None":
        """How far the flown track was from it."""
        return TrackDeviation.of(self.samples)


class OffPath(NamedTuple):
    """How far a position is from a planned subpath."""

    at_s: float
    off_m: float
    along_m: float
    """Where the subpath is nearest to it, length along it."""


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
    from_m: float
    """Part of the subpath that it was nearest to, lengths along it."""
    until_m: float

    @staticmethod
    def of(samples: Sequence["OffPath"]) -> "TrackDeviation | None":
        """Of positions in their order; None: there are none."""
        if not samples:
            return None
        farthest = max(samples, key=lambda each: each.off_m)
        along_m = [each.along_m for each in samples]
        return TrackDeviation(
            from_s=samples[0].at_s,
            until_s=samples[-1].at_s,
            positions=len(samples),
            max_m=farthest.off_m,
            max_at_s=farthest.at_s,
            rms_m=math.sqrt(math.fsum(each.off_m**2 for each in samples) / len(samples)),
            from_m=min(along_m),
            until_m=max(along_m),
        )


@final
class VehicleReport(Struct, frozen=True, kw_only=True):
    """A report of the vehicle: a warning, a mode change."""

    at_s: float
    what: str
    """"mode", "armed", "disarmed", "in the air", "on the ground" or "says"."""
    text: str = ""


@final
class Limitation(Struct, frozen=True, kw_only=True):
    """A limitation of shadow mode on this log."""

    what: str
    because: str
    """Most often: which message is missing."""
    remedy: str
    message: str | None = None
    """Its name."""

    def __str__(self) -> str:
        return f"{self.what}: {self.because}. {self.remedy}"


@final
class ShadowReport(Struct, kw_only=True):
    """All of it.  Times are seconds after the log's first record unless they are said otherwise."""

    file: str
    kind: str
    """"tlog", "bin" or "ulg"."""
    system_id: int
    vehicle: str
    """The autopilot and kind, in words."""
    mission: str | None
    """Its name; None: health alone."""
    planned: bool
    """Whether plans were computed."""
    began_us: int = 0
    """Time of the first record, microseconds since 1970."""
    length_s: float = 0.0
    in_air_s: float = 0.0
    watched_from_s: float | None = None
    """When the companion would have been ready; None: never."""
    records: int = 0
    heard: int = 0
    """Records that were used."""
    position_rate_hz: float | None = None
    holds: list[Hold] = []
    health: list[Observed] = []
    outside: list[Observed] = []
    """Positions outside the mission's limits."""
    plans: list[PlanAttempt] = []
    said: list[VehicleReport] = []
    could_not: list[Limitation] = []
    missing: tuple[Missing, ...] = ()
    log_findings: tuple[str, ...] = ()
    notes: list[str] = []
    took_s: float = 0.0

    @property
    def own_path(self) -> TrackDeviation | None:
        """How far the flown track was from all planned subpaths together; None: there were none."""
        parts = [off for each in self.plans if (off := each.off) is not None]
        whole = TrackDeviation.of([each for plan in self.plans for each in plan.samples])
        flown_m = sum(part.until_m - part.from_m for part in parts)
        return None if whole is None else replace(whole, from_m=0.0, until_m=flown_m)

    @property
    def times_real_time(self) -> float:
        """How much faster than the flight it was replayed."""
        return self.length_s / self.took_s if self.took_s > 0.0 else math.inf

    def as_json(self) -> dict[str, Any]:
        """For `--json`: plain values, units in the names."""
        plans = [{**asdict(each), "off": each.off} for each in self.plans]
        for each in plans:
            del each["samples"]
        values = {**asdict(self), "plans": plans, "own_path": self.own_path}
        return msgspec.to_builtins({"schema": SCHEMA, **values})


# --- for people


def renderables(report: ShadowReport) -> list[RenderableType]:
    """The report, part by part, in the order in which a person wants to know."""
    observed = ("from", "to", "what", "where")
    tables = [
        _table(
            "where it would have held",
            ("let go", "why", "position good", "goes on", "the vehicle itself"),
            [_hold_row(hold, report) for hold in report.holds],
        ),
        _table("health", observed, [_observed_row(each) for each in report.health]),
        _table(
            "where the mission does not allow it to be",
            observed,
            [_observed_row(each) for each in report.outside],
        ),
        _table(
            "where it would have planned",
            ("at", "where", "why", "answer", "flown track off it, max / rms"),
            [_plan_row(asked) for asked in report.plans],
        ),
    ]
    shown = [table for table in tables if table.row_count]
    return [*map(Text, _head(report)), *shown, *map(Text, _tail(report))]


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """The first rows as a table."""
    table = Table(*headings, title=title, title_justify="left")
    for row in rows[:_MAX_ROWS]:
        table.add_row(*map(Text, row))
    if (more := len(rows) - _MAX_ROWS) > 0:
        table.caption = f"{more} more: --json has them"
    return table


def _head(report: ShadowReport) -> list[str]:
    air = f", {report.in_air_s:,.0f} s of it in the air" if report.in_air_s else ""
    mission = f"mission {report.mission}" + ("" if report.planned else ": nothing was planned")
    ready = "the companion would never have been ready"
    if report.watched_from_s is not None:
        ready = f"ready, with a position to be believed, at {report.watched_from_s:,.1f} s"
        if not report.holds:
            ready += "; it would never have let go: the position could always be believed"
    return [
        f"{report.file}: {report.vehicle}, system {report.system_id}; {_began(report)}"
        f"{report.length_s:,.1f} s{air}",
        "times: seconds after the log's first record; places: latitude, longitude, altitude AMSL",
        mission
        if report.mission is not None
        else "no mission was given: only the vehicle's health was looked at",
        ready,
    ]


def _began(report: ShadowReport) -> str:
    try:
        when = datetime.fromtimestamp(report.began_us * 1e-6, UTC)
    except (OverflowError, OSError, ValueError):
        return ""
    return f"{when:%Y-%m-%d %H:%M:%S}Z, " if when.year > 1970 else ""


def _hold_row(hold: Hold, report: ShadowReport) -> list[str]:
    """When it would have held and why, and what the vehicle did and said by itself meanwhile."""
    first, *later = hold.why
    begins = {why.text: why.at_s for why in reversed(later) if why.text != first.text}
    reasons = sorted((at_s, text) for text, at_s in begins.items())[:_SHORT_REASONS]
    until_s = hold.let_go_s + _NEAR_S if hold.went_on_s is None else hold.went_on_s
    said = [
        f"{each.at_s:,.1f} s {f'“{each.text}”' if each.what == 'says' else _did(each)}"
        for each in report.said
        if hold.let_go_s - _MOMENT_S <= each.at_s <= until_s
    ]
    more = [f"{len(said) - _MAX_SAID} more"] if len(said) > _MAX_SAID else []
    return [
        f"{hold.let_go_s:,.2f} s" + ("" if hold.in_air else "\n(on the ground)"),
        "\n".join([first.text, *(f"{at_s:,.1f} s: {text}" for at_s, text in reasons),
                   f"-> {first.remedy}"]),
        _or_never(hold.trusted_s),
        _or_never(hold.went_on_s),
        "\n".join([*said[:_MAX_SAID], *more]) or "nothing",
    ]  # fmt: skip


def _did(said: VehicleReport) -> str:
    return f"{said.what} {said.text}".rstrip()


def _or_never(at_s: float | None) -> str:
    return "never" if at_s is None else f"{at_s:,.1f} s"


def _observed_row(seen: Observed) -> list[str]:
    far = "" if seen.worst_m is None else f", by {seen.worst_m:,.1f} m"
    ground = "" if seen.in_air else " (on the ground)"
    until = "the end" if seen.until_s is None else f"{seen.until_s:,.1f} s"
    return [f"{seen.from_s:,.1f} s", until, f"{seen.kind}{far}{ground}", _where(seen.place)]


def _plan_row(asked: PlanAttempt) -> list[str]:
    answer = asked.outcome
    if asked.reason:
        answer += f": {asked.reason.lower().replace('_', ' ')}"
    if asked.length_m is not None:
        answer = f"{asked.length_m:,.0f} m" + (", to the target" if asked.reaches_target else "")
    if asked.clearance_m is not None:
        answer += f", clear by {math.floor(asked.clearance_m + 1e-6):,} m"
    off = asked.off
    away = "" if off is None else f"{off.max_m:,.1f} / {off.rms_m:,.1f} m to {off.until_s:,.1f} s"
    return [f"{asked.at_s:,.1f} s", _where(asked.place), asked.why, answer, away]


def _tail(report: ShadowReport) -> list[str]:
    lines = []
    if report.plans:
        answers = Counter(asked.outcome for asked in report.plans)
        counted = ", ".join(f"{count} {name}" for name, count in answers.most_common())
        lines.append(f"{len(report.plans)} subpaths asked for: {counted}")
        refused = {asked.reason: asked.remedy for asked in report.plans if asked.reason}
        lines += [f"  {reason.lower().replace('_', ' ')}: {why}" for reason, why in refused.items()]
    if (own := report.own_path) is not None:
        lines.append(
            f"flown track off its own paths: {own.max_m:,.1f} m at most (at {own.max_at_s:,.1f} "
            f"s), {own.rms_m:,.1f} m rms, over {own.positions:,} positions and "
            f"{own.until_m:,.0f} m of path"
        )
    told = {each.message for each in report.could_not}
    missing = sorted(report.missing, key=lambda each: not each.vital)
    return [
        *lines,
        *(f"could not {each}" for each in report.could_not),
        *(f"{each}" for each in missing if each.message not in told),
        *(f"note: {note}" for note in report.notes),
        *(f"log: {finding}" for finding in report.log_findings),
        f"{report.heard:,} of {report.records:,} messages were of use; "
        f"{report.times_real_time:,.0f}x real time",
    ]


def _where(place: Place | None) -> str:
    if place is None:
        return ""
    return f"{place.latitude_deg:.5f}, {place.longitude_deg:.5f}, {place.altitude_amsl_m:,.0f} m"
