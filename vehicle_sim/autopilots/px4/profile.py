"""PX4's profile on its onboard link: rates, streamable and requestable messages (px4.md 2)."""

from typing import Final

from vehicle_sim.autopilots import FirmwareProfile, Result

CAPABILITIES: Final = 0xE8FF
SOFTWARE_VERSION: Final = 0x01110040
CUSTOM_VERSION: Final = bytes((0, 0, 0, 178, 57, 165, 123, 187))

_ON_EVENT: Final = (42, 46, 49, 77, 148, 300, 410, 411)
_BY_RATE: Final = {
    0.33: (411,),
    0.5: (147, 241, 242, 380, 436),
    1.0: (0, 2, 4, 8, 29, 42, 230, 441, 12901, 12904),
    5.0: (1, 245),
    8.0: (24,),
    10.0: (36, 74, 83, 85, 87, 111, 132, 141),
    30.0: (32, 331),
    50.0: (31, 33, 105),
    100.0: (30,),
}
RATES_HZ: Final = dict(sorted((n, hz) for hz, ns in _BY_RATE.items() for n in ns))
"""What a fresh onboard link gets, by message number, in Hz of vehicle time."""
FIXED_WING_RATES_HZ: Final = RATES_HZ | {231: 10.0, 360: 5.0}
"""WIND_COV as well, and ORBIT_EXECUTION_STATUS while it circles."""
_NOT_STREAMABLE: Final = frozenset({0, 42})
"""Sent by other parts of PX4: SET_MESSAGE_INTERVAL fails, as for unknown messages."""


def profile(*, vehicle_type: int, rates_hz: dict[int, float]) -> FirmwareProfile:
    """The firmware's, for a vehicle of this MAV_TYPE."""
    every = frozenset(rates_hz) | {40, 62, 65, 77, 148, 230, 231, 300}
    return FirmwareProfile(
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
