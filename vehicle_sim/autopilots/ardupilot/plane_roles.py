"""What the parts of ArduPlane need of each other: flight of the autopilot, mission of flight."""

from typing import Protocol

from vehicle_sim.autopilots import Estimate, Place
from vehicle_sim.autopilots.ardupilot.ekf3 import Ekf3
from vehicle_sim.autopilots.ardupilot.plane_navigation import Navigation
from vehicle_sim.parameters import Parameters
from vehicle_sim.plans import Plans


class Autopilot(Protocol):
    """What flight needs of ArduPlane."""

    now_us: int
    mode: int
    armed: bool
    landed: bool
    home: Place | None
    mission_current: int
    parameters: Parameters
    plans: Plans
    estimate: Estimate
    ekf: Ekf3

    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT."""
        ...

    def reached(self, number: int) -> None:
        """MISSION_ITEM_REACHED."""
        ...

    def set_mode(self, mode: int) -> bool:
        """Fly in this mode from now on."""
        ...

    def disarm(self) -> None:
        """Stop the motor."""
        ...


class Pilot(Protocol):
    """What the mission needs of the plane."""

    mission_current: int
    navigation: Navigation

    @property
    def now_us(self) -> int:
        """Vehicle time since boot."""
        ...

    @property
    def home(self) -> Place | None:
        """Where it returns to."""
        ...

    @property
    def heading_rad(self) -> float:
        """Where the nose points."""
        ...

    @property
    def pitch_rad(self) -> float:
        """Nose up."""
        ...

    @property
    def course_rad(self) -> float:
        """Where it moves over the ground."""
        ...

    def here(self) -> Place:
        """Where it believes to be."""
        ...

    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT."""
        ...

    def reached(self, number: int) -> None:
        """MISSION_ITEM_REACHED."""
        ...

    def change_speed(self, kind: float, speed_m_s: float) -> bool:
        """DO_CHANGE_SPEED."""
        ...

    def return_home(self) -> None:
        """Fly the way RTL does."""
        ...
