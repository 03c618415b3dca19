"""What a replay has found: as values, and as text."""

import traceback
from pathlib import Path
from typing import Any, Final, final

from msgspec import Struct
from msgspec.structs import asdict

from companion.replay.differences import Difference

_BEGUN_AGAIN_S: Final = 10.0  # earlier: the autopilot has rebooted, or another one was taken
_MAX_PLANS: Final = 5


@final
class RecordedError(Struct, frozen=True, kw_only=True):
    """An error raised by a session, or by the control loop around it."""

    call: str
    """Of the session, or another; "" if it did not come out of one."""
    error: str
    place: str = ""
    """In the code, if it was raised here."""

    @staticmethod
    def of(call: str, error: Exception) -> "RecordedError":
        """An error that a session has raised just now."""
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).stem}.{last.name}, line {last.lineno}"
        return RecordedError(call=call, error=f"{type(error).__name__}: {error}", place=place)

    def __str__(self) -> str:
        return self.error if not self.place else f"{self.error} ({self.place})"


@final
class PlanDiffers(Struct, frozen=True, kw_only=True):
    """A plan that differs from the recorded one."""

    plan_id: int
    t_s: float
    field: str
    recorded: Any
    computed: Any
    words: str
    """How far apart the two are."""
    kernels: tuple[str, str]
    """What computed the recorded one, and this one."""

    @property
    def is_excused(self) -> bool:
        """Whether the kernels differ, so that the last bits may."""
        return self.kernels[0] != self.kernels[1]

    def __str__(self) -> str:
        by = f" ({self.kernels[0]}, now {self.kernels[1]})" if self.is_excused else ""
        first = f"first {self.field}: recorded {self.recorded!r}, computed {self.computed!r}"
        return f"t {self.t_s:.3f} s: plan {self.plan_id}{by}: {self.words}; {first}"


@final
class Replayed(Struct, kw_only=True):
    """The result of a replay so far."""

    difference: Difference | None = None
    """The first one."""
    plans_differ: list[PlanDiffers] = []
    starts: int = 0
    """How often the companion was started."""
    inputs: int = 0
    frames: int = 0
    """Frames, both ways, that were the same."""
    entries: int = 0
    unrecorded: int = 0
    """Frames and entries after the end of the recording."""
    torn: str = ""
    """Why it ended before the end of the file."""
    plans: int = 0
    plans_computed: int = 0
    ended_by: RecordedError | None = None
    """The error that ended the flight's control loop, if any."""
    damaged: str = ""
    """What in the recording is not a valid input; nothing after it was replayed."""
    now_s: float = 0.0
    flown_s: float = 0.0
    """Duration replayed, vehicle time; continues across reboots."""
    took_s: float = 0.0
    _newest_s: float | None = None

    def go_on_to(self, now_s: float) -> None:
        """Advance to this vehicle time."""
        self.now_s = now_s
        if self._newest_s is None:
            self._newest_s = now_s if now_s > 0.0 else None
        elif now_s > self._newest_s:
            self.flown_s += now_s - self._newest_s
            self._newest_s = now_s
        elif now_s < self._newest_s - _BEGUN_AGAIN_S:
            self._newest_s = now_s

    @property
    def compared(self) -> int:
        """How many frames and entries were the same."""
        return self.frames + self.entries

    @property
    def is_identical(self) -> bool:
        """Whether all decisions and plans equal the recorded ones, and there were any."""
        same = self.difference is None and all(each.is_excused for each in self.plans_differ)
        return same and self.compared > 0 and not self.damaged


def replay_text(found: Replayed) -> list[str]:
    """Report of a replay, line by line."""
    speed = f", {found.flown_s / found.took_s:,.0f}x real time" if found.took_s > 0.0 else ""
    lines = []
    if found.difference is not None:
        lines += [f"first difference at {found.difference}"]
    counted = f"{found.frames:,} frames, {found.entries:,} journal entries"
    if found.plans_computed:
        same = found.plans_computed - len(found.plans_differ)
        counted += f", {same} of {found.plans_computed} plans computed again"
    elif found.plans:
        counted += f"; {found.plans} plans taken as recorded"
    lines.append(f"the same: {counted} ({found.flown_s:,.1f} s of flight{speed})")
    if found.compared and not found.frames:
        lines.append("no frame was compared: flight.tlog holds none")
    if found.starts > 1:
        lines.append(f"the companion was started {found.starts} times")
    lines += [str(each) for each in found.plans_differ[:_MAX_PLANS]]
    if (more := len(found.plans_differ) - _MAX_PLANS) > 0:
        lines.append(f"{more} more plans differ")
    if found.unrecorded:
        lines.append(f"{found.unrecorded} frames and entries came after the end of the recording")
    if found.ended_by is not None:
        lines.append(f"the flight ended with an error of the companion's: {found.ended_by}")
    if found.torn:
        lines.append(f"the recording ends early: {found.torn}")
    if found.damaged:
        lines.append(f"the recording is damaged from there on: {found.damaged}")
    return [*lines, _verdict(found)]


def _verdict(found: Replayed) -> str:
    if found.is_identical:
        return "identical"
    if found.difference is not None or not all(each.is_excused for each in found.plans_differ):
        return "not identical"
    return "identical up to there" if found.compared else "nothing was compared"


def replay_json(found: Replayed) -> dict[str, Any]:
    """Report of a replay for a JSON file."""
    values = {"identical": found.is_identical, "ended_by": None, **asdict(found)}
    del values["_newest_s"]
    if found.ended_by is not None:
        values["ended_by"] = found.ended_by.error
    return values
