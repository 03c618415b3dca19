"""What goes into an autopilot and what comes out: values in SI units, no bytes, no clock.

wire.py turns frames into these and these into frames; ardupilot.py is the one personality so far.
"""

from dataclasses import dataclass
from typing import Protocol, final


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Sender:
    """Who sent a message."""

    system: int
    component: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """A COMMAND_LONG or COMMAND_INT."""

    sender: Sender
    target_component: int
    number: int
    parameters: tuple[float, float, float, float, float, float, float]
    """p1 to p7; of a COMMAND_INT x and y in degrees."""
    frame: int | None = None
    """Of a COMMAND_INT."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Setpoint:
    """A SET_POSITION_TARGET_GLOBAL_INT or _LOCAL_NED, as sent: nothing is checked yet."""

    is_global: bool
    frame: int
    type_mask: int
    position: tuple[float, float, float]
    """Latitude and longitude in degrees and altitude in metres, or north, east, down in metres."""
    velocity_ned_m_s: tuple[float, float, float]
    acceleration_ned_m_s2: tuple[float, float, float]
    yaw_rad: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Ack:
    """The answer to a command."""

    to: Sender
    command: int
    result: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Text:
    """A STATUSTEXT."""

    severity: int
    text: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """Send this message every interval_us on the link that asked; 0 stops it."""

    message: int
    interval_us: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Send:
    """Send this message once."""

    message: int


Reply = Ack | Text | Interval | Send


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A point on or above the earth."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """All that telemetry is made of, at one time."""

    time_us: int
    place: Place
    """What the GPS says: here the truth."""
    velocity_ned_m_s: tuple[float, float, float]
    roll_rad: float
    pitch_rad: float
    heading_rad: float
    mode: int
    base_mode: int
    system_status: int
    landed_state: int
    health_ok: bool
    """The PREARM_CHECK bit."""
    gps_fix: bool
    ekf_flags: int
    position_ok: bool
    """The estimator has a horizontal position."""
    home: Place | None
    origin: Place | None
    """Of the estimator; its local frame is ArduPilot's flat earth about this point."""
    local_ned_m: tuple[float, float, float] | None
    target: "TargetEcho | None"
    hardware_id: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TargetEcho:
    """What the autopilot steers for, in the estimator's local frame."""

    position_ned_m: tuple[float, float, float] | None
    velocity_ned_m_s: tuple[float, float, float]
    acceleration_ned_m_s2: tuple[float, float, float]
    yaw_rad: float


class Autopilot(Protocol):
    """One personality."""

    @property
    def mode_name(self) -> str:
        """The mode it flies in."""
        ...

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        ...

    @property
    def landed(self) -> bool:
        """Whether it stands on the ground."""
        ...

    def step(self, now_us: int, dt_s: float, ground_amsl_m: float) -> list[Reply]:
        """Fly on to now_us, over ground of this height."""
        ...

    def on_command(self, command: Command) -> list[Reply]:
        """Do what is asked, or say why not."""
        ...

    def on_setpoint(self, setpoint: Setpoint) -> list[Reply]:
        """Steer for this from now on."""
        ...

    def report(self) -> Report:
        """What there is to tell."""
        ...
