"""ArduPilot's messages about sensors and the board: what the recordings show, and little physics.

Sensors that nothing here models (magnetometer, temperatures) carry the values of a vehicle at
rest.  telemetry_ardupilot.py says the rest.
"""

import math
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Report
from vehicle_sim.wire.frames import bounded, degrees_e7
from vehicle_sim.wire.telemetry import INT16, Builder, boot_ms

_GRAVITY_M_S2 = 9.80665
_PLANE = 1
_ESC_US = 5_500_000


def indicated_m_s(report: Report) -> float:
    """A plane says its indicated airspeed."""
    airspeed_m_s = report.status.airspeed_m_s
    return report.vehicle.airspeed_m_s if airspeed_m_s is None else airspeed_m_s


def _specific_force(report: Report) -> tuple[float, float, float]:
    """What accelerometers measure at rest at this attitude: forward, right, down in m/s2."""
    vehicle = report.vehicle
    roll, pitch = vehicle.roll_rad, vehicle.pitch_rad
    lift = _GRAVITY_M_S2 + vehicle.acceleration_up_m_s2
    return 0.0, 0.0, -lift / max(math.cos(roll) * math.cos(pitch), 0.1)


def _milli_g(report: Report) -> tuple[int, int, int]:
    x, y, z = _specific_force(report)
    scale = 1000.0 / _GRAVITY_M_S2
    return bounded(x * scale, INT16), bounded(y * scale, INT16), bounded(z * scale, INT16)


def _raw_imu(report: Report) -> Any:
    x, y, z = _milli_g(report)
    return mavlink.MAVLink_raw_imu_message(
        time_usec=report.time_us,
        xacc=x,
        yacc=y,
        zacc=z,
        xgyro=0,
        ygyro=0,
        zgyro=0,
        xmag=232,
        ymag=52,
        zmag=-528,
        id=0,
        temperature=2512,
    )


def _scaled_imu(report: Report) -> Any:
    x, y, z = _milli_g(report)
    return mavlink.MAVLink_scaled_imu_message(
        boot_ms(report), x, y, z, 0, 0, 0, 232, 52, -528, temperature=2512
    )


def _scaled_imu2(report: Report) -> Any:
    x, y, z = _milli_g(report)
    return mavlink.MAVLink_scaled_imu2_message(
        boot_ms(report), x, y, z, 0, 0, 0, 232, 52, -528, temperature=2512
    )


def _scaled_imu3(report: Report) -> Any:
    return mavlink.MAVLink_scaled_imu3_message(
        boot_ms(report), 0, 0, 0, 0, 0, 0, 232, 52, -528, temperature=0
    )


def _pressure_hpa(report: Report) -> float:
    """International standard atmosphere at the estimated height."""
    return 1013.25 * (1.0 - 2.25577e-5 * min(report.estimate.altitude_amsl_m, 4e4)) ** 5.25588


def _scaled_pressure(report: Report) -> Any:
    airspeed = indicated_m_s(report)
    plane = report.style.vehicle_type == _PLANE
    return mavlink.MAVLink_scaled_pressure_message(
        time_boot_ms=boot_ms(report),
        press_abs=_pressure_hpa(report),
        press_diff=0.005 * airspeed * airspeed if plane else 0.0,
        temperature=2540,
        temperature_press_diff=0,
    )


def _scaled_pressure2(report: Report) -> Any:
    return mavlink.MAVLink_scaled_pressure2_message(
        time_boot_ms=boot_ms(report),
        press_abs=_pressure_hpa(report) - 0.012,
        press_diff=0.0,
        temperature=2540,
        temperature_press_diff=0,
    )


def _rc_channels(report: Report) -> Any:
    """SITL's: sticks centred, throttle down."""
    sticks = [1500, 1500, 1000, 1500, 1800, 1000, 1000, 1800]
    return mavlink.MAVLink_rc_channels_message(boot_ms(report), 8, *sticks, *[0] * 10, rssi=255)


def _servo_output(report: Report) -> Any:
    throttle = round(1000.0 + 1000.0 * min(max(report.vehicle.throttle, 0.0), 1.0))
    if report.style.vehicle_type == _PLANE:
        outputs = [1500, 1500, throttle, 1500] if report.status.base_mode & 0x80 else [0] * 4
    else:
        outputs = [throttle] * 4
    return mavlink.MAVLink_servo_output_raw_message(
        report.time_us & 0xFFFFFFFF, 0, *outputs, 0, 0, 0, 0, *[0] * 8
    )


def _power_status(report: Report) -> Any:
    del report
    return mavlink.MAVLink_power_status_message(Vcc=5000, Vservo=0, flags=0)


def _meminfo(report: Report) -> Any:
    del report
    return mavlink.MAVLink_meminfo_message(brkval=0, freemem=65535, freemem32=524288)


def _hw_status(report: Report) -> Any:
    del report
    return mavlink.MAVLink_hwstatus_message(Vcc=5000, I2Cerr=0)


def _mcu_status(report: Report) -> Any:
    del report
    return mavlink.MAVLink_mcu_status_message(0, 2500, 3300, 3300, 3300)


def _ahrs(report: Report) -> Any:
    del report
    return mavlink.MAVLink_ahrs_message(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def _ahrs2(report: Report) -> Any:
    estimate, vehicle = report.estimate, report.vehicle
    return mavlink.MAVLink_ahrs2_message(
        roll=vehicle.roll_rad,
        pitch=vehicle.pitch_rad,
        yaw=math.remainder(vehicle.heading_rad, math.tau),
        altitude=estimate.altitude_amsl_m,
        lat=degrees_e7(estimate.latitude_deg),
        lng=degrees_e7(estimate.longitude_deg),
    )


def _simstate(report: Report) -> Any:
    """The truth: SITL says it too."""
    vehicle = report.vehicle
    x, y, z = _specific_force(report)
    return mavlink.MAVLink_simstate_message(
        roll=vehicle.roll_rad,
        pitch=vehicle.pitch_rad,
        yaw=math.remainder(vehicle.heading_rad, math.tau),
        xacc=x,
        yacc=y,
        zacc=z,
        xgyro=0.0,
        ygyro=0.0,
        zgyro=0.0,
        lat=degrees_e7(vehicle.latitude_deg),
        lng=degrees_e7(vehicle.longitude_deg),
    )


def _vibration(report: Report) -> Any:
    return mavlink.MAVLink_vibration_message(report.time_us, 0.02, 0.02, 0.02, 0, 0, 0)


def _airspeed(report: Report) -> Any | None:
    """Of planes."""
    if report.style.vehicle_type != _PLANE:
        return None
    airspeed = indicated_m_s(report)
    return mavlink.MAVLink_airspeed_message(
        id=0,
        airspeed=airspeed,
        temperature=INT16,
        raw_press=0.5 * airspeed * airspeed,
        flags=2,
    )


def _aoa_ssa(report: Report) -> Any | None:
    if report.style.vehicle_type != _PLANE:
        return None
    return mavlink.MAVLink_aoa_ssa_message(time_usec=report.time_us, AOA=0.0, SSA=0.0)


def _esc_telemetry(report: Report) -> Any | None:
    """One motor of a plane, on the third output; four of a copter."""
    if report.time_us < _ESC_US:
        return None
    turning = round(7000.0 * min(max(report.vehicle.throttle, 0.0), 1.0))
    used = (0, 0, 1, 0) if report.style.vehicle_type == _PLANE else (1, 1, 1, 1)
    count = max(report.time_us - _ESC_US, 0) // 20_000 & 0xFFFF
    return mavlink.MAVLink_esc_telemetry_1_to_4_message(
        temperature=bytes(32 * u for u in used),
        voltage=[1679 * u for u in used],
        current=[80 * u for u in used],
        totalcurrent=list(used),
        rpm=[turning * u for u in used],
        count=[count * u for u in used],
    )


def _available_modes(report: Report) -> Any:
    status = report.status
    return mavlink.MAVLink_available_modes_message(1, 1, 0, status.mode, 0, b"")


SENSOR_MESSAGES: dict[int, Builder] = {
    mavlink.MAVLINK_MSG_ID_RAW_IMU: _raw_imu,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: _scaled_imu,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU2: _scaled_imu2,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU3: _scaled_imu3,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: _scaled_pressure,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2: _scaled_pressure2,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: _rc_channels,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: _servo_output,
    mavlink.MAVLINK_MSG_ID_POWER_STATUS: _power_status,
    mavlink.MAVLINK_MSG_ID_MEMINFO: _meminfo,
    mavlink.MAVLINK_MSG_ID_HWSTATUS: _hw_status,
    mavlink.MAVLINK_MSG_ID_MCU_STATUS: _mcu_status,
    mavlink.MAVLINK_MSG_ID_AHRS: _ahrs,
    mavlink.MAVLINK_MSG_ID_AHRS2: _ahrs2,
    mavlink.MAVLINK_MSG_ID_SIMSTATE: _simstate,
    mavlink.MAVLINK_MSG_ID_VIBRATION: _vibration,
    mavlink.MAVLINK_MSG_ID_AIRSPEED: _airspeed,
    mavlink.MAVLINK_MSG_ID_AOA_SSA: _aoa_ssa,
    mavlink.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4: _esc_telemetry,
    mavlink.MAVLINK_MSG_ID_AVAILABLE_MODES: _available_modes,
}
"""By message number."""
