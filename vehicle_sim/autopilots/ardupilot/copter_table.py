"""ArduCopter's own parameters, its modes, and what it says while it boots."""

from typing import Final

from vehicle_sim.autopilots import Text
from vehicle_sim.autopilots.ardupilot.ekf3 import Timing
from vehicle_sim.autopilots.ardupilot.firmware import Due
from vehicle_sim.autopilots.ardupilot.parameters import SHARED, parameter_table
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

TABLE: Final = (
    *SHARED,
    *parameter_table("""
ANGLE_MAX 3000 i16
ACRO_RP_RATE 360
ACRO_Y_RATE 202.5
ATC_ACCEL_P_MAX 110000
ATC_ACCEL_R_MAX 110000
ATC_ACCEL_Y_MAX 27000
ATC_ANG_PIT_P 4.5
ATC_ANG_RLL_P 4.5
ATC_ANG_YAW_P 4.5
ATC_INPUT_TC 0.15
ATC_RATE_FF_ENAB 1 i8
ATC_RAT_PIT_P 0.135
ATC_RAT_RLL_P 0.135
ATC_RAT_YAW_P 0.18
ATC_SLEW_YAW 6000
AUTO_OPTIONS 0 i32
CIRCLE_RADIUS 1000
CIRCLE_RATE 20
CIRCLE_OPTIONS 1 i16
DISARM_DELAY 10 i8
ESC_CALIBRATION 0 i8
FRAME_CLASS 1 i8
FRAME_TYPE 0 i8
FS_CRASH_CHECK 1 i8
FS_EKF_ACTION 1 i8
FS_EKF_THRESH 0.8
FS_GCS_ENABLE 0 i8
FS_GCS_TIMEOUT 5
FS_OPTIONS 16 i32
FS_THR_ENABLE 1 i8
FS_THR_VALUE 975 i16
FS_VIBE_ENABLE 1 i8
GPS_GLITCH_RAD 200 i16
GND_EFFECT_COMP 1 i8
GUID_OPTIONS 0 i32
GUID_TIMEOUT 3
INITIAL_MODE 0 i8
LAND_ALT_LOW 1000
LAND_REPOSITION 1 i8
LAND_SPEED 50 i16
LAND_SPEED_HIGH 0 i16
LOIT_ACC_MAX 500
LOIT_ANG_MAX 0
LOIT_BRK_ACCEL 250
LOIT_BRK_DELAY 1
LOIT_BRK_JERK 500
LOIT_SPEED 1250
MOT_BAT_VOLT_MAX 12.8
MOT_BAT_VOLT_MIN 9.6
MOT_HOVER_LEARN 2 i8
MOT_PWM_MAX 0 i16
MOT_PWM_MIN 0 i16
MOT_SAFE_DISARM 0 i8
MOT_SPIN_ARM 0.1
MOT_SPIN_MIN 0.15
MOT_SPOOL_TIME 0.5
MOT_THST_EXPO 0.65
MOT_THST_HOVER 0.39
PHLD_BRAKE_ANGLE 3000 i16
PHLD_BRAKE_RATE 8 i16
PILOT_ACCEL_Z 250 i16
PILOT_SPEED_DN 0 i16
PILOT_SPEED_UP 250 i16
PILOT_TKOFF_ALT 0
PILOT_Y_RATE 202.5
PSC_ACCZ_P 0.3
PSC_ANGLE_MAX 0
PSC_JERK_XY 5
PSC_JERK_Z 5
PSC_POSXY_P 1
PSC_POSZ_P 1
PSC_VELXY_D 0.25
PSC_VELXY_I 1
PSC_VELXY_IMAX 1000
PSC_VELXY_P 2
PSC_VELZ_P 5
RTL_ALT 1500 i32
RTL_ALT_FINAL 0 i16
RTL_ALT_TYPE 0 i8
RTL_CLIMB_MIN 0 i16
RTL_CONE_SLOPE 3
RTL_LOIT_TIME 5000 i32
RTL_OPTIONS 0 i32
RTL_SPEED 0 i16
SIMPLE 0 i8
SRTL_ACCURACY 2
SRTL_POINTS 300 i16
SUPER_SIMPLE 0 i8
SURFTRAK_MODE 1 i8
THR_DZ 100 i16
TKOFF_SLEW_TIME 2
WPNAV_ACCEL 250
WPNAV_ACCEL_C 0
WPNAV_ACCEL_Z 100
WPNAV_JERK 1
WPNAV_RADIUS 200
WPNAV_RFND_USE 1 i8
WPNAV_SPEED 1000
WPNAV_SPEED_DN 150
WPNAV_SPEED_UP 250
WP_NAVALT_MIN 0
WP_YAW_BEHAVIOR 2 i8
"""),
    *SIM_PARAMETERS,
)

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
