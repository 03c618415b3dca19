"""ArduPilot 4.7's profile: streamable and requestable messages, stream groups.

Source: ardupilot.md 1 and the recorded flights.
"""

from vehicle_sim.autopilots import FirmwareProfile, Result

HEARTBEAT, GPS_GLOBAL_ORIGIN, AUTOPILOT_VERSION, HOME_POSITION = 0, 49, 148, 242
TIMESYNC = 111
CUSTOM_VERSION = b"2598e9d4"

STREAMABLE = frozenset(
    {0, 1, 2, 24, 26, 27, 29, 30, 31, 32, 33, 35, 36, 42, 49, 62, 65, 74, 85, 87, 116, 124, 125}
    | {127, 129, 132, 133, 136, 137, 143, 147, 148, 152, 162, 163, 164, 165, 168, 173, 178, 193}
    | {194, 226, 235, 241, 242, 245, 246, 291, 295, 376, 435, 11020, 11030, 11039}
)
REQUESTABLE = STREAMABLE
"""ESTIMATOR_STATUS (230) and PROTOCOL_VERSION (300) fail."""

DATA_STREAMS = {
    1: (27, 26, 116, 129, 29, 137, 143),
    2: (1, 125, 152, 42, 24, 124, 62, 162, 87),
    3: (36, 65),
    6: (33, 32),
    10: (30, 164, 178, 11030),
    11: (74,),
    12: (163, 168, 2, 133, 136, 147, 193, 241, 295, 11020, 132, 173),
}
"""MAV_DATA_STREAM: RAW_SENSORS, EXTENDED_STATUS, RC_CHANNELS, POSITION, EXTRA1, EXTRA2, EXTRA3."""


def profile(*, vehicle_type: int, capabilities: int, rates_hz: dict[int, float]) -> FirmwareProfile:
    """The Style of one of ArduPilot's vehicles."""
    return FirmwareProfile(
        firmware="ardupilot",
        vehicle_type=vehicle_type,
        autopilot=3,
        capabilities=capabilities,
        software_version=67567616,
        custom_version=CUSTOM_VERSION,
        rates_hz=rates_hz,
        streamable=STREAMABLE,
        requestable=REQUESTABLE,
        not_streamable=Result.DENIED,
        text_when_not_streamable="No ap_message for mavlink id ({number})",
        bytewise_parameters=False,
        requests_mission_int=False,
        texts_need="anybody",
        signs=True,
        data_streams=DATA_STREAMS,
    )
