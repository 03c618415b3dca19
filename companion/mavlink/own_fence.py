"""The vehicle's own fence, as its list, parameters and home change: drawn, in force, and told."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import final

from msgspec import structs

from companion.mavlink import fence
from companion.mavlink.autopilots import Autopilot
from companion.mavlink.plan_client import FENCE, PlanClient
from companion.mission.events import FenceChanged, FenceReading, Vector
from companion.mission.mission import Mission


@final
class OwnFence:
    """Follows the fence of one vehicle.  Until all of a new one is known the old stays in force."""

    def __init__(self, mission: Mission, autopilot: Autopilot, plans: PlanClient) -> None:
        self.fence: fence.Fence | None = None
        """As it stands, once it was read."""
        self.notes: list[str] = []
        """What a person should hear of, since last looked at."""
        self.warnings: list[str] = []
        """The same, of what is grave."""
        self._mission, self._autopilot, self._plans = mission, autopilot, plans
        self._drawing_of: tuple[int, float] | None = None
        self._drawing: Iterator[fence.Fence | None] | None = None
        self._drawn: fence.Fence | None = None
        """The newest list, once all of it is drawn."""
        self._made_of: object = None
        self._told: FenceChanged | None = None
        self._said: tuple[str, ...] = ()
        self._reading = 0

    @property
    def is_drawing(self) -> bool:
        """Whether it goes on with the next message."""
        return self._drawing is not None

    @property
    def needs_home(self) -> bool:
        """Whether a part of it is missing until home is known."""
        return self.fence is not None and self.fence.needs_home

    def rebooted(self) -> None:
        """The autopilot has rebooted: what is read again is held against the mission again."""
        self._reading, self._made_of = 0, None
        if self._told is not None and self._told.zones:
            self.notes.append(f"fence: read again, {len(self._told.zones)} zones stay in force")

    def reading(self, now_s: float) -> list[FenceReading]:
        """Whether one that has changed is being read, and drawn, by now."""
        items = self._plans.changing.get(FENCE, 0)
        if not items and self.is_drawing:
            items = self._reading
        if items == self._reading:
            return []
        self._reading = items
        return [FenceReading(time_s=now_s, items=items)]

    def update(
        self,
        parameters: Mapping[str, float],
        home_nea_m: Vector | None,
        here_ne_m: tuple[float, float] | None,
        now_s: float,
    ) -> tuple[list[FenceChanged], str] | None:
        """What is new, and why the mission conflicts with it; None while it is drawn.

        here_ne_m: where the vehicle is, as in `fence.in_force`.
        """
        mission, plan = self._mission, self._plans.plans[FENCE]
        settings = self._autopilot.firmware.fence(parameters)
        if (plan.version, settings.margin_m) != self._drawing_of:
            self._drawing_of = (plan.version, settings.margin_m)
            self._drawing = fence.drawn(plan.items, mission.frame, settings.margin_m)
        if self._drawing is not None:
            if (drawn := next(self._drawing)) is None:
                return None
            self._drawn, self._drawing = drawn, None
        made_of = self._drawing_of, settings, home_nea_m
        if made_of == self._made_of or self._drawn is None:
            return [], ""
        self._made_of = made_of
        misread = self._autopilot.firmware.misread(plan.items, self._autopilot.name)
        whole = self.fence = fence.in_force(
            replace(self._drawn, misread=misread),
            settings,
            home_nea_m=home_nea_m,
            here_ne_m=here_ne_m,
        )
        told = [] if whole.needs_home else self._news(whole.changed(now_s))
        self.notes += [each for each in whole.notes if each not in self._said]
        self.warnings += [misread] if misread and misread not in self._said else []
        self._said = (*whole.notes, misread)
        against = fence.conflicts(whole, mission.task, mission.targets_ne_m)
        return told, against[0] if against else ""

    def _news(self, event: FenceChanged) -> list[FenceChanged]:
        same = structs.replace(event, time_s=0.0)
        before, self._told = self._told, same
        return [] if same == before else [event]
