"""What drivers of lidars and rangefinders send, and the attitude beside it."""

from collections.abc import Sequence
from typing import Any

from wires import heard, wire


def attitude(
    time_s: float, roll_rad: float = 0.0, pitch_rad: float = 0.0, yaw_rad: float = 0.0
) -> Any:
    turned = {"roll": roll_rad, "pitch": pitch_rad, "yaw": yaw_rad}
    return heard("ATTITUDE", time_boot_ms=round(1e3 * time_s), **turned)


def obstacle_distance(
    time_s: float,
    distances_cm: Sequence[int] = (),
    *,
    reach_cm: int = 2000,
    source: tuple[int, int] = (1, 196),
    **fields: Any,
) -> Any:
    """72 sectors of 5 degrees, from the nose: these, and in the others nothing."""
    sectors = [*distances_cm, *[reach_cm + 1] * (72 - len(distances_cm))]
    values = {"time_usec": round(time_s * 1e6), "min_distance": 20, "max_distance": reach_cm}
    values |= {"distances": sectors, "increment": 5, "frame": wire.MAV_FRAME_BODY_FRD}
    return heard("OBSTACLE_DISTANCE", source, **{**values, **fields})


def beam(time_s: float, cm: int = 700, *, source: tuple[int, int] = (1, 1), **fields: Any) -> Any:
    """DISTANCE_SENSOR: by default the sector ahead, as ArduPilot tells of its proximity."""
    values = {"time_boot_ms": round(1e3 * time_s), "current_distance": cm, "id": 10}
    values |= {"min_distance": 20, "max_distance": 1600}
    return heard("DISTANCE_SENSOR", source, **{**values, **fields})


def tell(sensor: Any, message: Any, now_s: float) -> None:
    """As the session does: what a sensor does not read it is not told."""
    read = sensor.reads.get((message.get_srcComponent(), message.get_msgId()))
    if read is not None:
        read(message, now_s)


def health(*, well: bool) -> Any:
    """SYS_STATUS of an autopilot whose lidar is there and enabled."""
    bit, of = wire.MAV_SYS_STATUS_SENSOR_PROXIMITY, "onboard_control_sensors"
    return heard("SYS_STATUS", **{f"{of}_enabled": bit, f"{of}_health": bit * well})
