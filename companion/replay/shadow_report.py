"""What a shadow has seen of somebody else's flight, as values: for people and for files."""

import math
from dataclasses import asdict, dataclass
from typing import Any, Final, final

from companion.telemetry.logs import Finding, Missing

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
class Why:
    """One reason to hold, and when it became the reason."""

    at_s: float
    code: str
    """Its name: POSITION_JUMPED."""
    text: str
    remedy: str


@final
@dataclass(slots=True, kw_only=True)
class Hold:
    """A time in which the companion would have let the vehicle go into its own hold."""

    let_go_s: float
    vehicle_s: float
    """The same by the vehicle's clock."""
    why: list[Why]
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
    """Something about the vehicle's health, or where it was, for some time."""

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
class Asked:
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
    off: "Off | None" = None


@final
@dataclass(slots=True, kw_only=True)
class Off:
    """How far the flown track was from a planned subpath."""

    from_s: float
    until_s: float
    positions: int
    max_m: float
    max_at_s: float
    squares_m2: float
    """Sum over all positions."""
    from_m: float
    """Part of the subpath that it was nearest to, lengths along it."""
    until_m: float

    @property
    def rms_m(self) -> float:
        """Root mean square over the positions."""
        return math.sqrt(self.squares_m2 / self.positions) if self.positions else 0.0

    def as_json(self) -> dict[str, Any] | None:
        """For `--json`; None: it was never compared."""
        if not self.positions:
            return None
        return {
            "from_s": self.from_s,
            "until_s": self.until_s,
            "positions": self.positions,
            "max_m": self.max_m,
            "max_at_s": self.max_at_s,
            "rms_m": self.rms_m,
            "from_m": self.from_m,
            "until_m": self.until_m,
        }


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """What the vehicle said or did by itself: a warning of its own, a mode."""

    at_s: float
    what: str
    """"mode", "armed", "disarmed", "in the air", "on the ground" or "says"."""
    text: str = ""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CouldNot:
    """What the companion could not do on this log."""

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
    began_us: int
    """Time of the first record, microseconds since 1970."""
    length_s: float
    in_air_s: float
    watched_from_s: float | None
    """When the companion would have been ready; None: never."""
    records: int
    heard: int
    """Records that were of use."""
    position_rate_hz: float | None
    holds: list[Hold]
    health: list[Observed]
    outside: list[Observed]
    """Where the vehicle was when the mission does not allow that."""
    plans: list[Asked]
    said: list[Said]
    could_not: list[CouldNot]
    missing: tuple[Missing, ...]
    log_findings: tuple[Finding, ...]
    notes: list[str]
    left_out: dict[str, int]
    """How many more there were of what is kept up to a limit."""
    took_s: float = 0.0

    @property
    def own_path(self) -> Off | None:
        """How far the flown track was from all planned subpaths together; None: there were none."""
        parts = [asked.off for asked in self.plans if asked.off is not None]
        parts = [part for part in parts if part.positions]
        if not parts:
            return None
        farthest = max(parts, key=lambda each: each.max_m)
        return Off(
            from_s=parts[0].from_s,
            until_s=parts[-1].until_s,
            positions=sum(each.positions for each in parts),
            max_m=farthest.max_m,
            max_at_s=farthest.max_at_s,
            squares_m2=sum(each.squares_m2 for each in parts),
            from_m=0.0,
            until_m=sum(each.until_m - each.from_m for each in parts),
        )

    @property
    def times_real_time(self) -> float:
        """How much faster than the flight it was replayed."""
        return self.length_s / self.took_s if self.took_s > 0.0 else math.inf

    def as_json(self) -> dict[str, Any]:
        """For `--json`: plain values, units in the names."""
        own = self.own_path
        return {
            "schema": SCHEMA,
            "file": self.file,
            "kind": self.kind,
            "system_id": self.system_id,
            "vehicle": self.vehicle,
            "mission": self.mission,
            "planned": self.planned,
            "began_us": self.began_us,
            "length_s": self.length_s,
            "in_air_s": self.in_air_s,
            "watched_from_s": self.watched_from_s,
            "records": self.records,
            "heard": self.heard,
            "position_rate_hz": self.position_rate_hz,
            "holds": [asdict(each) for each in self.holds],
            "health": [asdict(each) for each in self.health],
            "outside": [asdict(each) for each in self.outside],
            "plans": [
                asdict(each) | {"off": each.off.as_json() if each.off else None}
                for each in self.plans
            ],
            "own_path": None if own is None else own.as_json(),
            "said": [asdict(each) for each in self.said],
            "could_not": [asdict(each) for each in self.could_not],
            "missing": [asdict(each) for each in self.missing],
            "log_findings": [each.as_json() for each in self.log_findings],
            "notes": self.notes,
            "left_out": self.left_out,
            "took_s": self.took_s,
        }
