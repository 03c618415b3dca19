"""The numbers and names that an autopilot has for its modes."""

from typing import Protocol

from companion.mission.events import Mode


class Modes(Protocol):
    """One value per family of autopilots, or per kind of vehicle where their numbers differ."""

    def mode_of(self, custom_mode: int) -> Mode:
        """The mode that a heartbeat reports."""
        ...

    def name_of(self, custom_mode: int) -> str:
        """The same in the autopilot's own words."""
        ...

    def numbers_of(self, mode: Mode) -> tuple[int, ...] | None:
        """What DO_SET_MODE asks for, main and sub mode where it has both; None: no such mode."""
        ...
