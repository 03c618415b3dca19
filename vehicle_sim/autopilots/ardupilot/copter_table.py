"""ArduCopter's own parameters, its modes, and what it says while it boots."""

from typing import Final

from vehicle_sim.autopilots import Text
from vehicle_sim.autopilots.ardupilot.autopilot import Due
from vehicle_sim.autopilots.ardupilot.ekf3 import Timing
from vehicle_sim.autopilots.parameters import table
from vehicle_sim.faults import SIM_PARAMETERS

STABILIZE, ACRO, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, CIRCLE, LAND = 0, 1, 2, 3, 4, 5, 6, 7, 9
POSHOLD, BRAKE, GUIDED_NOGPS, SMART_RTL = 16, 17, 20, 21
MODES: Final = {
    STABILIZE: "STABILIZE",
    ACRO: "ACRO",
    ALT_HOLD: "ALT_HOLD",
    AUTO: "AUTO",
    GUIDED: "GUIDED",
    LOITER: "LOITER",
    RTL: "RTL",
    CIRCLE: "CIRCLE",
    LAND: "LAND",
    POSHOLD: "POSHOLD",
    BRAKE: "BRAKE",
    GUIDED_NOGPS: "GUIDED_NOGPS",
    SMART_RTL: "SMARTRTL",
}
NEED_POSITION: Final = frozenset({AUTO, GUIDED, LOITER, RTL, CIRCLE, POSHOLD, BRAKE, SMART_RTL})
NOT_ARMABLE: Final = frozenset({AUTO, RTL, CIRCLE, LAND, BRAKE, SMART_RTL})

TABLE: Final = (*table("ardupilot/shared", "ardupilot/copter"), *SIM_PARAMETERS)

TIMING: Final = Timing(
    initialised_us=4_460_000,
    attitude_us=5_900_000,
    origin_after_fix_us=10_000_000,
    using_after_fix_us=31_620_000,
    origin_texts=((193_000, "EKF3 IMU1 origin set"),),
)

_COMPASSES = (
    ("COMPASS_DEV_ID", 97539.0),
    ("COMPASS_DEV_ID2", 131874.0),
    ("COMPASS_DEV_ID3", 263178.0),
)
_GYROS = (
    ("INS_GYROFFS_X", 2.3449767468264326e-05),
    ("INS_GYROFFS_Y", 2.5720373741933145e-05),
    ("INS_GYROFFS_Z", 2.9012084269197658e-05),
    ("INS_GYR_ID", 2752772.0),
    ("INS_GYR1_CALTEMP", 25.018352508544922),
    ("INS_GYR2OFFS_X", 2.015327481785789e-05),
    ("INS_GYR2OFFS_Y", 2.7733694878406823e-05),
    ("INS_GYR2OFFS_Z", 1.705062277324032e-05),
    ("INS_GYR2_ID", 2752780.0),
    ("INS_GYR2_CALTEMP", 25.018352508544922),
    ("INS_GYR3OFFS_X", 0.0),
    ("INS_GYR3OFFS_Y", 0.0),
    ("INS_GYR3OFFS_Z", 0.0),
    ("INS_GYR3_ID", 0.0),
)
_IMUS = (
    ("INS_GYR_ID", 2752772.0),
    ("INS_ACC_ID", 2753028.0),
    ("INS_GYR2_ID", 2752780.0),
    ("INS_ACC2_ID", 2753036.0),
)


def _texts(time_us: int, *texts: str, severity: int = 6) -> list[Due]:
    return [(time_us, Text(severity=severity, text=text)) for text in texts]


def boot(pressure_pa: float) -> list[Due]:
    """What it says by itself, by the recorded flights; the pressure is that of the ground."""
    return [
        *_texts(210_000, "RCInput: decoding UDP (Pulses)", severity=7),
        (210_000, ("ESC_CALIBRATION", 0.0)),
        (210_000, ("RELAY1_FUNCTION", 1.0)),
        *((220_000, row) for row in (*_COMPASSES, ("COMPASS_EXTERNAL", 1.0), *_COMPASSES)),
        *_texts(330_000, "Calibrating barometer"),
        *((330_000, row) for row in (("CAM1_TYPE", 0.0), ("CAM2_TYPE", 0.0))),
        (330_000, ("BARO_ALT_OFFSET", 0.0)),
        *_texts(1_920_000, "Barometer 1 calibration complete", "Barometer 2 calibration complete"),
        (1_930_000, ("BARO1_GND_PRESS", pressure_pa)),
        (1_930_000, ("BARO2_GND_PRESS", pressure_pa - 0.29)),
        *((1_930_000, row) for row in _IMUS),
        *_texts(2_460_000, "ArduPilot Ready", "AHRS: DCM active"),
        *((2_460_000, row) for row in _GYROS),
        *_texts(2_740_000, "RC7: SaveWaypoint LOW"),
        (3_450_000, ("EK3_SRC1_POSXY", 3.0)),
        *_texts(4_460_000, "EKF3 IMU0 initialised", "EKF3 IMU1 initialised", "AHRS: EKF3 active"),
        *_texts(
            5_800_000, "EKF3 IMU0 tilt alignment complete", "EKF3 IMU1 tilt alignment complete"
        ),
        *_texts(
            5_900_000,
            "EKF3 IMU0 MAG0 initial yaw alignment complete",
            "EKF3 IMU1 MAG0 initial yaw alignment complete",
        ),
        *_texts(9_810_000, "GPS 1: probing for u-blox at 230400 baud"),
        *_texts(9_830_000, "GPS 1: detected u-blox"),
    ]
