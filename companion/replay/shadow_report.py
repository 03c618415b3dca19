"""The report of shadow mode, as values."""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final, final

import msgspec

from companion.telemetry.logs import LogAnomaly, Missing
from companion.world.near_map import Sight

SCHEMA: Final = 1
"""Of `ShadowReport.as_json`."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where something happened."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    north_m: float
    """Of the mission's origin; without a mission, of the first position."""
    east_m: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class HoldReason:
    """One reason to hold, and when it became the reason."""

    at_s: float
    code: str
    """Its name: POSITION_JUMPED."""
    text: str
    remedy: str


@final
@dataclass(slots=True, kw_only=True)
class Hold:
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
@dataclass(slots=True, kw_only=True)
class Observed:
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
@dataclass(slots=True, kw_only=True)
class PlanAttempt:
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
    """ "ready", "refused", "late", "given up" (it held before the answer was due), or
    "unanswered": the log ended before."""
    reason: str = ""
    """Of a refusal, its name."""
    remedy: str = ""
    length_m: float | None = None
    clearance_m: float | None = None
    reaches_target: bool = False
    off: "TrackDeviation | None" = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TrackDeviation:
    """How far the flown track was from a planned subpath, over one position or more."""

    from_s: float
    until_s: float
    positions: int = 1
    max_m: float
    max_at_s: float
    rms_m: float
    """Root mean square over the positions."""
    from_m: float
    """Part of the subpath that it was nearest to, lengths along it."""
    until_m: float

    @staticmethod
    def of_all(parts: Iterable["TrackDeviation | None"]) -> "TrackDeviation | None":
        """Of one part after the other; None: there were none."""
        there = [part for part in parts if part is not None]
        if not there:
            return None
        farthest = max(there, key=lambda each: each.max_m)
        positions = sum(each.positions for each in there)
        return TrackDeviation(
            from_s=there[0].from_s,
            until_s=there[-1].until_s,
            positions=positions,
            max_m=farthest.max_m,
            max_at_s=farthest.max_at_s,
            rms_m=math.sqrt(sum(each.positions * each.rms_m**2 for each in there) / positions),
            from_m=min(each.from_m for each in there),
            until_m=max(each.until_m for each in there),
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleReport:
    """A report of the vehicle: a warning, a mode change."""

    at_s: float
    what: str
    """"mode", "armed", "disarmed", "in the air", "on the ground" or "says"."""
    text: str = ""


@final
@dataclass(slots=True, kw_only=True)
class NearThings:
    """What one sensor has seen in a flight."""

    sensor: str
    """Its message and component."""
    range_m: float
    sweeps: int = 0
    seconds: dict[str, float] = field(default_factory=lambda: {each.name: 0.0 for each in Sight})
    """How long it saw something, or what its silence was, by `Sight`."""
    free_m2: float = 0.0
    """Area that beams have passed all over."""
    occupied_m2: float = 0.0
    """Area where something stood, or may have stood, as far as it was told."""
    refused: dict[str, int] = field(default_factory=dict)
    """How often something was not believed, by the reason."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Limitation:
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
@dataclass(slots=True, kw_only=True)
class ShadowReport:
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
    holds: list[Hold] = field(default_factory=list)
    health: list[Observed] = field(default_factory=list)
    outside: list[Observed] = field(default_factory=list)
    """Positions outside the mission's limits."""
    plans: list[PlanAttempt] = field(default_factory=list)
    said: list[VehicleReport] = field(default_factory=list)
    could_not: list[Limitation] = field(default_factory=list)
    missing: tuple[Missing, ...] = ()
    log_findings: tuple[LogAnomaly, ...] = ()
    near_things: list[NearThings] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)
    """Number of dropped items of limited lists."""
    took_s: float = 0.0

    @property
    def own_path(self) -> TrackDeviation | None:
        """How far the flown track was from all planned subpaths together; None: there were none."""
        parts = [each.off for each in self.plans if each.off is not None]
        flown_m = sum(part.until_m - part.from_m for part in parts)
        whole = TrackDeviation.of_all(parts)
        return None if whole is None else replace(whole, from_m=0.0, until_m=flown_m)

    @property
    def times_real_time(self) -> float:
        """How much faster than the flight it was replayed."""
        return self.length_s / self.took_s if self.took_s > 0.0 else math.inf

    def as_json(self) -> dict[str, Any]:
        """For `--json`: plain values, units in the names."""
        values: dict[str, Any] = {"schema": SCHEMA, "own_path": self.own_path}
        values |= {each.name: getattr(self, each.name) for each in fields(self)}
        values["log_findings"] = [each.as_json() for each in self.log_findings]
        return msgspec.to_builtins(values)
