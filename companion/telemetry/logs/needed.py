"""The messages that the companion needs, and where it stands how to get them recorded."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, Literal, final

from companion.mavlink.autopilots import ALL
from companion.mavlink.dialect import wire

Kind = Literal["tlog", "bin", "ulg"]
_ESTIMATOR: Final = "whether its estimator may be believed"
_VITAL: Final = {
    "HEARTBEAT": "which autopilot it is, its mode and whether it is armed",
    "GLOBAL_POSITION_INT": "where the vehicle is: nothing is planned",
    "GPS_RAW_INT": "whether its GPS has a fix",
    "EKF_STATUS_REPORT": _ESTIMATOR,
    "ESTIMATOR_STATUS": _ESTIMATOR,
}
"""What is impossible without a message; without these it does not fly."""
_USEFUL: Final = {
    "EXTENDED_SYS_STATE": "whether it stands on the ground",
    "HOME_POSITION": "where home is, and how high",
    "GPS_GLOBAL_ORIGIN": "what its local frame is measured from",
    "SYS_STATUS or BATTERY_STATUS": "how much battery is left",
    "PARAM_VALUE": "its parameters: they are not judged",
    "STATUSTEXT": "what it said",
}
_REMEDY: Final = "What to record, and how: docs/logs.md"


@final
@dataclass(frozen=True, slots=True)
class Missing:
    """A message that the companion needs and a log lacks."""

    message: str
    """Its MAVLink name; of several that serve alike, joined by "or"."""
    without: str
    """What is impossible without it."""
    vital: bool
    """Whether the companion needs it to fly."""
    remedy: str = _REMEDY

    def __str__(self) -> str:
        return f"{self.message} is missing: {self.without}. {self.remedy}"


def missing_of(autopilot: int | None, heard: Collection[str]) -> tuple[Missing, ...]:
    """What of all that is missing from a log.

    autopilot: MAV_AUTOPILOT, None if it is not known; heard: MAVLink names that the log has.
    """
    ways = [each for each in ALL if autopilot in (None, each.firmware.number)]
    decoded = {wire.mavlink_map[number].msgname for each in ways for number in each.decoders}
    return tuple(
        Missing(message, without, message in _VITAL)
        for message, without in (_VITAL | _USEFUL).items()
        if not any(each in heard for each in message.split(" or "))
        and (without is not _ESTIMATOR or message in decoded)
    )
