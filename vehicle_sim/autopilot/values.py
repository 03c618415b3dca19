"""Inputs and outputs of the simulated autopilots: values in SI units, no bytes, no clock.

wire/ converts frames to these and back.  Parameters are data: *.parm.
"""

import enum
from typing import Any, NamedTuple, final

HIGHEST_M = 1e5
"""Limit of altitudes that are told, up and down: HOME_POSITION could not encode more."""
Vector = tuple[float, float, float]
Result = enum.IntEnum(
    "Result",
    "ACCEPTED TEMPORARILY_REJECTED DENIED UNSUPPORTED FAILED IN_PROGRESS CANCELLED"
    " COMMAND_LONG_ONLY COMMAND_INT_ONLY UNSUPPORTED_FRAME",
    start=0,
)
"""MAV_RESULT."""
Landed = enum.IntEnum("Landed", "UNDEFINED ON_GROUND IN_AIR TAKEOFF LANDING", start=0)
"""MAV_LANDED_STATE."""
State = enum.IntEnum("State", "UNINIT BOOT CALIBRATING STANDBY ACTIVE CRITICAL", start=0)
"""MAV_STATE: system_status of the heartbeat."""

# --- in -------------------------------------------------------------------------------------------


@final
class Sender(NamedTuple):
    """Who sent a message, and the link that it came by."""

    system: int
    component: int
    link: int = 0


@final
class Command(NamedTuple):
    """A COMMAND_LONG or COMMAND_INT that is for the autopilot.

    Message intervals and message requests (511, 512) never come here: wire/streams.py.
    """

    sender: Sender
    target_component: int
    number: int
    parameters: tuple[float, float, float, float, float, float, float]
    """p1 to p7; of a COMMAND_INT x and y in degrees."""
    frame: int | None = None
    """MAV_FRAME of a COMMAND_INT; None: a COMMAND_LONG."""


@final
class Setpoint(NamedTuple):
    """A SET_POSITION_TARGET_GLOBAL_INT or _LOCAL_NED, as sent: nothing is checked yet.

    One that is not addressed to the autopilot never comes here: wire/routing.py.  What it makes of
    them is told as one, too: POSITION_TARGET_LOCAL_NED, with NaN where nothing is wanted.
    """

    is_global: bool
    frame: int
    type_mask: int
    position: Vector
    """Latitude and longitude in degrees and altitude in metres, or north, east, down in metres."""
    velocity_ned_m_s: Vector
    acceleration_ned_m_s2: Vector
    yaw_rad: float
    yaw_rate_rad_s: float = 0.0


# --- out ------------------------------------------------------------------------------------------


@final
class Ack(NamedTuple):
    """COMMAND_ACK to the sender of a command, on the link it came by."""

    to: Sender
    command: int
    result: int


@final
class Text(NamedTuple):
    """A STATUSTEXT of this MAV_SEVERITY, to every link that gets texts."""

    severity: int
    text: str


@final
class SendTelemetry(NamedTuple):
    """Send the telemetry message of this number once; to all links if no receiver is given."""

    message: int
    to: Sender | None = None


@final
class SendMessage(NamedTuple):
    """Send this message (wire/frames.py): to one client, or to every link."""

    message: Any
    to: Sender | None = None


@final
class Reboot(NamedTuple):
    """Reboot: intervals are reset, the UDP source port changes, time_boot_ms begins at 0."""


Reply = Ack | Text | SendTelemetry | SendMessage | Reboot

# --- to tell --------------------------------------------------------------------------------------


@final
class Place(NamedTuple):
    """A point on or above the earth."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float

    def at(self, altitude_amsl_m: float) -> "Place":
        """Above or below it."""
        return Place(self.latitude_deg, self.longitude_deg, altitude_amsl_m)


def height_amsl_m(
    frame: int, z_m: float, home_amsl_m: float | None, terrain_amsl_m: float | None = 0.0
) -> float | None:
    """Height above the sea of a z in this MAV_FRAME; None: there is none in it, or no home yet.

    Without terrain data the ground is taken to be at sea level.
    """
    home, terrain = home_amsl_m, terrain_amsl_m
    from_m = {0: 0.0, 5: 0.0, 3: home, 6: home, 10: terrain, 11: terrain}.get(frame)
    return None if from_m is None else z_m + from_m


@final
class Waypoint(NamedTuple):
    """The current waypoint: POSITION_TARGET_GLOBAL_INT and NAV_CONTROLLER_OUTPUT."""

    place: Place
    distance_m: float = 0.0
    bearing_rad: float = 0.0
    altitude_error_m: float = 0.0
    cross_track_m: float = 0.0
    airspeed_error_m_s: float = 0.0
    """Wanted less measured."""


@final
class Status(NamedTuple):
    """An autopilot's status at one time.  A tuple: they are created often."""

    mode: int
    base_mode: int
    system_status: int
    """Of the heartbeat; the first is its custom_mode."""
    landed_state: int
    prearm_ok: bool
    """The PREARM_CHECK bit of SYS_STATUS."""
    waypoint: Waypoint | None = None
    intended_mode: int = 0
    """CURRENT_MODE of PX4, beside the mode itself."""
    fence: tuple[int, ...] | None = None
    """FENCE_STATUS; None: there is nothing to tell."""
