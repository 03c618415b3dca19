"""What drivers of lidars and rangefinders send, and the attitude beside it."""

from collections.abc import Sequence
from typing import Any

from wires import over_the_wire, wire


def attitude(
    time_s: float, roll_rad: float = 0.0, pitch_rad: float = 0.0, yaw_rad: float = 0.0
) -> Any:
    at_ms = round(1e3 * time_s)
    return wire.MAVLink_attitude_message(at_ms, roll_rad, pitch_rad, yaw_rad, 0, 0, 0)


def obstacle_distance(
    time_s: float,
    distances_cm: Sequence[int] = (),
    *,
    reach_cm: int = 2000,
    source: tuple[int, int] = (1, 196),
    **fields: Any,
) -> Any:
    """72 sectors of 5 degrees, from the nose: these, and in the others nothing."""
    values = {
        "time_usec": round(time_s * 1e6),
        "sensor_type": 0,
        "distances": [*distances_cm, *[reach_cm + 1] * (72 - len(distances_cm))],
        "increment": 5,
        "min_distance": 20,
        "max_distance": reach_cm,
        "increment_f": 0.0,
        "angle_offset": 0.0,
        "frame": wire.MAV_FRAME_BODY_FRD,
    }
    return over_the_wire(wire.MAVLink_obstacle_distance_message(**{**values, **fields}), source)


def beam(time_s: float, cm: int = 700, *, source: tuple[int, int] = (1, 1), **fields: Any) -> Any:
    """DISTANCE_SENSOR: by default the sector ahead, as ArduPilot tells of its proximity."""
    values = {
        "time_boot_ms": round(1e3 * time_s),
        "min_distance": 20,
        "max_distance": 1600,
        "current_distance": cm,
        "type": 0,
        "id": 10,
        "orientation": 0,
        "covariance": 0,
    }
    return over_the_wire(wire.MAVLink_distance_sensor_message(**{**values, **fields}), source)


def health(bit: int, *, well: bool) -> Any:
    """SYS_STATUS of a sensor that is there and enabled."""
    return wire.MAVLink_sys_status_message(bit, bit, bit * well, *[0] * 10)
