"""How PX4 speaks on its onboard link: rates, what can be streamed and asked for (px4.md 2)."""

from typing import Final

from vehicle_sim.autopilots import Result, Style

CAPABILITIES: Final = 0xE8FF
SOFTWARE_VERSION: Final = 0x01110040
CUSTOM_VERSION: Final = bytes((0, 0, 0, 178, 57, 165, 123, 187))

_ON_EVENT: Final = (42, 46, 49, 77, 148, 300, 410, 411)
RATES_HZ: Final = {
    0: 1.0,
    1: 5.0,
    2: 1.0,
    4: 1.0,
    8: 1.0,
    24: 8.0,
    29: 1.0,
    30: 100.0,
    31: 50.0,
    32: 30.0,
    33: 50.0,
    36: 10.0,
    42: 1.0,
    74: 10.0,
    83: 10.0,
    85: 10.0,
    87: 10.0,
    105: 50.0,
    111: 10.0,
    132: 10.0,
    141: 10.0,
    147: 0.5,
    230: 1.0,
    241: 0.5,
    242: 0.5,
    245: 5.0,
    331: 30.0,
    380: 0.5,
    411: 0.33,
    436: 0.5,
    441: 1.0,
    12901: 1.0,
    12904: 1.0,
}
"""What a fresh onboard link gets, by message number, in Hz of vehicle time."""
FIXED_WING_RATES_HZ: Final = RATES_HZ | {231: 10.0, 360: 5.0}
"""WIND_COV as well, and ORBIT_EXECUTION_STATUS while it circles."""
_NOT_STREAMABLE: Final = frozenset({0, 42})
"""Sent by other parts of PX4: SET_MESSAGE_INTERVAL fails, as for unknown messages."""


def style(*, vehicle_type: int, rates_hz: dict[int, float]) -> Style:
    """The firmware's, for a vehicle of this MAV_TYPE."""
    every = frozenset(rates_hz) | {40, 62, 65, 77, 148, 230, 231, 300}
    return Style(
        firmware="px4",
        vehicle_type=vehicle_type,
        autopilot=12,
        capabilities=CAPABILITIES,
        software_version=SOFTWARE_VERSION,
        custom_version=CUSTOM_VERSION,
        rates_hz=rates_hz,
        streamable=(every | {49, 410}) - _NOT_STREAMABLE - {148, 300},
        requestable=every | frozenset(_ON_EVENT),
        not_streamable=Result.FAILED,
        bytewise_parameters=True,
        requests_mission_int=True,
        texts_need="ground station",
        signs=False,
    )
