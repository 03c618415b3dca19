"""Entries of ArduPilot's .bin as the MAVLink messages that it would have sent with them.

What each message is made of: docs/reference/log-messages.md.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, final

from companion.mavlink.dialect import Message, wire
from companion.telemetry.logs.translated import (
    Pace,
    Row,
    Told,
    battery,
    boot_ms,
    system_time,
    whole,
)

_SECOND_US: Final = 1_000_000
_FAST_US: Final = 19_000
"""Positions and attitudes: 50 a second are enough."""
_ESTIMATOR_US: Final = 95_000
_FRESH_US: Final = 1_000_000
"""A velocity of longer ago is not that of the position."""
_GPS: Final = -1
"""In place of an estimator's core."""
_ARMED, _DISARMED, _AUTO_ARMED = 10, 11, 15
_LANDED, _NOT_LANDED = 18, 28
"""EV.Id."""
_FAILSAFES: Final = frozenset({5, 6, 8, 17, 20, 23, 31})
"""ERR.Subsys of what makes ArduPilot say CRITICAL: radio, battery, ground station, estimator, ADSB,
terrain, dead reckoning."""
_MODE_FLAGS: Final = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | wire.MAV_MODE_FLAG_STABILIZE_ENABLED
_NO_HEADING: Final = 65535
_EKF2: Final = ("NKF1", "NKF4")
_FLAGS: Final = (
    *((1 << bit, 1 << bit) for bit in range(6)),
    (1 << 6, wire.EKF_POS_VERT_AGL),
    (1 << 7, wire.EKF_CONST_POS_MODE),
    (1 << 8, wire.EKF_PRED_POS_HORIZ_REL),
    (1 << 9, wire.EKF_PRED_POS_HORIZ_ABS),
    (1 << 14, wire.EKF_GPS_GLITCHING),
)
"""Bits of the filter status (XKF4.SS), and what EKF_STATUS_REPORT has for them."""
_INITIALISED: Final = 1 << 16
_OLD_STATUS: Final = 1 << 16
"""A filter status of 16 bits does not say whether it is initialised."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """What is known of the whole log beforehand."""

    mav_type: int | None
    has_position: bool
    has_velocity: bool
    has_ekf3: bool
    """Then what EKF2 says is not what is flown by."""
    parameters: int
    """How many there are."""


@final
class ArduPilotRows:
    """See `translated.Translator`."""

    def __init__(self, vehicle: Vehicle, epoch_us: int | None) -> None:
        self._vehicle, self._epoch_us = vehicle, epoch_us
        self._pace = Pace()
        self._mode: int | None = None
        self._armed, self._landed = False, wire.MAV_LANDED_STATE_UNDEFINED
        self._failsafes: set[int] = set()
        self._velocities: dict[int, tuple[int, float, float, float]] = {}
        """By estimator core: when, and north, east, down, m/s."""
        self._core = 0
        self._yaw_deg: float | None = None
        self._gyro = (math.nan, math.nan, math.nan)
        self._home_alt_m: float | None = None
        self._accuracy: Mapping[str, Any] = {}
        self._capacity_mah = 0.0
        self._load = 0
        self._told = Told(vehicle.parameters)

    def on_row(self, row: Row, boot_us: int) -> list[Message]:
        """What one entry makes it say."""
        if self._vehicle.has_ekf3 and row.name in _EKF2:
            return []
        said = _HANDLERS[row.name](self, row.values, boot_us)
        if self._pace.is_due("heartbeat", boot_us, _SECOND_US):
            said += [*self._heartbeat(), *self._ground(), system_time(self._epoch_us, boot_us)]
        return said

    # --- its state

    def _heartbeat(self) -> list[Message]:
        if self._mode is None or self._vehicle.mav_type is None:
            return []
        flags = _MODE_FLAGS | (wire.MAV_MODE_FLAG_SAFETY_ARMED if self._armed else 0)
        status = wire.MAV_STATE_ACTIVE
        if not self._armed or self._landed == wire.MAV_LANDED_STATE_ON_GROUND:
            status = wire.MAV_STATE_STANDBY
        if self._failsafes:
            status = wire.MAV_STATE_CRITICAL
        return [
            wire.MAVLink_heartbeat_message(
                self._vehicle.mav_type,
                wire.MAV_AUTOPILOT_ARDUPILOTMEGA,
                flags,
                self._mode,
                status,
                3,
            )
        ]

    def _ground(self) -> list[Message]:
        if self._landed == wire.MAV_LANDED_STATE_UNDEFINED:
            return []
        return [
            wire.MAVLink_extended_sys_state_message(wire.MAV_VTOL_STATE_UNDEFINED, self._landed)
        ]

    def _on_mode(self, values: Mapping[str, Any], _: int) -> list[Message]:
        self._mode = int(values["ModeNum"] if "ModeNum" in values else values["Mode"])
        return self._heartbeat()

    def _on_arm(self, values: Mapping[str, Any], _: int) -> list[Message]:
        return self._set_armed(bool(values["ArmState"]))

    def _set_armed(self, armed: bool) -> list[Message]:
        if armed == self._armed:
            return []
        self._armed = armed
        return self._heartbeat()

    def _on_event(self, values: Mapping[str, Any], _: int) -> list[Message]:
        match values["Id"]:
            case event if event in (_ARMED, _AUTO_ARMED):
                return self._set_armed(True)
            case event if event == _DISARMED:
                return self._set_armed(False)
            case event if event == _LANDED:
                return self._set_landed(wire.MAV_LANDED_STATE_ON_GROUND)
            case event if event == _NOT_LANDED:
                return self._set_landed(wire.MAV_LANDED_STATE_IN_AIR)
        return []

    def _set_landed(self, landed: int) -> list[Message]:
        if landed == self._landed:
            return []
        self._landed = landed
        return self._ground()

    def _on_plane(self, values: Mapping[str, Any], _: int) -> list[Message]:
        """STAT, of a plane."""
        flies = bool(values["isFlying"])
        landed = wire.MAV_LANDED_STATE_IN_AIR if flies else wire.MAV_LANDED_STATE_ON_GROUND
        return [*self._set_armed(bool(values["Armed"])), *self._set_landed(landed)]

    def _on_error(self, values: Mapping[str, Any], _: int) -> list[Message]:
        subsystem = values["Subsys"]
        if subsystem not in _FAILSAFES:
            return []
        before = bool(self._failsafes)
        (self._failsafes.add if values["ECode"] else self._failsafes.discard)(subsystem)
        return self._heartbeat() if bool(self._failsafes) != before else []

    # --- where it is

    def _on_estimate(self, values: Mapping[str, Any], boot_us: int) -> list[Message]:
        velocity = (values["VN"], values["VE"], values["VD"])
        self._velocities[values.get("C", 0)] = (boot_us, *velocity)
        return []

    def _on_attitude(self, values: Mapping[str, Any], boot_us: int) -> list[Message]:
        self._yaw_deg = values["Yaw"]
        if not self._pace.is_due("ATTITUDE", boot_us, _FAST_US):
            return []
        roll, pitch, yaw = (math.radians(values[each]) for each in ("Roll", "Pitch", "Yaw"))
        turned = math.remainder(yaw, math.tau)
        return [wire.MAVLink_attitude_message(boot_ms(boot_us), roll, pitch, turned, *self._gyro)]

    def _on_gyro(self, values: Mapping[str, Any], _: int) -> list[Message]:
        if values.get("I", 0) == 0:
            self._gyro = (values["GyrX"], values["GyrY"], values["GyrZ"])
        return []

    def _on_position(self, values: Mapping[str, Any], boot_us: int) -> list[Message]:
        velocity = self._velocities.get(self._core if self._vehicle.has_velocity else _GPS)
        if velocity is None or boot_us - velocity[0] > _FRESH_US:
            return []
        above_m = values.get("RelHomeAlt", 0.0)
        return self._position(values, above_m, velocity[1:], boot_us)

    def _position(
        self,
        values: Mapping[str, Any],
        above_home_m: float,
        velocity: tuple[float, ...],
        boot_us: int,
    ) -> list[Message]:
        if not self._pace.is_due("position", boot_us, _FAST_US):
            return []
        heading = _NO_HEADING if self._yaw_deg is None else round(self._yaw_deg * 100) % 36000
        return [
            wire.MAVLink_global_position_int_message(
                boot_ms(boot_us),
                values["Lat"],
                values["Lng"],
                round(values["Alt"] * 1e3),
                round(above_home_m * 1e3),
                *(round(each * 100) for each in velocity),
                heading,
            )
        ]

    def _on_origin(self, values: Mapping[str, Any], boot_us: int) -> list[Message]:
        place = (values["Lat"], values["Lng"], round(values["Alt"] * 1e3))
        if values["Type"] == 0:
            return [wire.MAVLink_gps_global_origin_message(*place, boot_us)]
        if values["Type"] != 1:
            return []
        self._home_alt_m = values["Alt"]
        q = [1.0, 0.0, 0.0, 0.0]
        return [wire.MAVLink_home_position_message(*place, 0, 0, 0, q, 0, 0, 0, boot_us)]

    # --- how well it knows

    def _on_gps(self, values: Mapping[str, Any], boot_us: int) -> list[Message]:
        if values.get("I", 0) != 0:
            return []
        speed, course = values["Spd"], values["GCrs"]
        accuracy, said = self._accuracy, list[Message]()
        ellipsoid_m = accuracy.get("AEl", accuracy.get("AE"))
        said.append(
            wire.MAVLink_gps_raw_int_message(
                boot_us,
                values["Status"],
                values["Lat"],
                values["Lng"],
                round(values["Alt"] * 1e3),
                whole(values["HDop"] * 100, 0, 65535),
                whole(accuracy["VDop"] * 100, 0, 65535) if "VDop" in accuracy else 65535,
                whole(speed * 100, 0, 65535),
                round(course * 100) % 36000,
                values["NSats"],
                alt_ellipsoid=0 if ellipsoid_m is None else round(ellipsoid_m * 1e3),
                h_acc=whole(accuracy.get("HAcc", 0.0) * 1e3, 0, 0xFFFFFFFF),
                v_acc=whole(accuracy.get("VAcc", 0.0) * 1e3, 0, 0xFFFFFFFF),
                vel_acc=whole(accuracy.get("SAcc", 0.0) * 1e3, 0, 0xFFFFFFFF),
            )
        )
        if values["Status"] < wire.GPS_FIX_TYPE_3D_FIX:
            return said
        angle = math.radians(course)
        velocity = (speed * math.cos(angle), speed * math.sin(angle), values.get("VZ", 0.0))
        self._velocities[_GPS] = (boot_us, *velocity)
        if not self._vehicle.has_position:
            above_m = values.get("RelAlt", values.get("RAlt", 0.0))  # until 3.3
            if self._home_alt_m is not None:
                above_m = values["Alt"] - self._home_alt_m
            said += self._position(values, above_m, velocity, boot_us)
        return said

    def _on_accuracy(self, values: Mapping[str, Any], _: int) -> list[Message]:
        if values.get("I", 0) == 0:
            self._accuracy = values
        return []

    def _on_filter(self, values: Mapping[str, Any], boot_us: int) -> list[Message]:
        """XKF4: of the primary core."""
        core, primary = values.get("C", 0), values.get("PI", 0)
        self._core = max(primary, 0)
        if core != self._core or not self._pace.is_due("filter", boot_us, _ESTIMATOR_US):
            return []
        status = values["SS"]
        flags = sum(flag for bit, flag in _FLAGS if status & bit)
        ready = status & _INITIALISED if status >= _OLD_STATUS else status & wire.EKF_ATTITUDE
        if not ready:
            flags |= wire.EKF_UNINITIALIZED
        variances = (values["SV"], values["SP"], values["SH"], values["SM"])
        return [
            wire.MAVLink_ekf_status_report_message(
                flags, *variances, 0.0, airspeed_variance=values["SVT"]
            )
        ]

    # --- the rest

    def _on_battery(self, values: Mapping[str, Any], boot_us: int) -> list[Message]:
        if values.get("Inst", values.get("Instance", values.get("I", 0))) != 0:
            return []
        if not self._pace.is_due("battery", boot_us, _SECOND_US // 2):
            return []
        used_mah = values.get("CurrTot", 0.0)
        percent = values.get("RemPct")
        if percent is None:
            full = self._capacity_mah
            percent = whole(100 * (full - used_mah) / full, 0, 100) if full > 0 else -1
        elif not 0 <= percent <= 100:
            percent = -1
        centi_a = whole(values.get("Curr", 0.0) * 100, -1, 32767)
        used = whole(used_mah, -1, 1 << 30)
        return battery(values["Volt"], centi_a, used, percent, load=self._load)

    def _on_load(self, values: Mapping[str, Any], _: int) -> list[Message]:
        self._load = whole(values.get("Load", 0), 0, 1000)
        return []

    def _on_parameter(self, values: Mapping[str, Any], _: int) -> list[Message]:
        name, value = values["Name"], values["Value"]
        if name == "BATT_CAPACITY" and math.isfinite(value):
            self._capacity_mah = value
        return self._told.parameter(name, value)

    def _on_text(self, values: Mapping[str, Any], _: int) -> list[Message]:
        return self._told.text(values["Message"], wire.MAV_SEVERITY_INFO)


_HANDLERS: Final[Mapping[str, Callable[[ArduPilotRows, Mapping[str, Any], int], list[Message]]]] = {
    "ARM": ArduPilotRows._on_arm,
    "ATT": ArduPilotRows._on_attitude,
    "BAT": ArduPilotRows._on_battery,
    "ERR": ArduPilotRows._on_error,
    "EV": ArduPilotRows._on_event,
    "GPA": ArduPilotRows._on_accuracy,
    "GPS": ArduPilotRows._on_gps,
    "IMU": ArduPilotRows._on_gyro,
    "MODE": ArduPilotRows._on_mode,
    "MSG": ArduPilotRows._on_text,
    "NKF1": ArduPilotRows._on_estimate,
    "NKF4": ArduPilotRows._on_filter,
    "ORGN": ArduPilotRows._on_origin,
    "PARM": ArduPilotRows._on_parameter,
    "PM": ArduPilotRows._on_load,
    "POS": ArduPilotRows._on_position,
    "STAT": ArduPilotRows._on_plane,
    "VER": lambda *_: [],  # it tells beforehand
    "XKF1": ArduPilotRows._on_estimate,
    "XKF4": ArduPilotRows._on_filter,
}
ROWS: Final = frozenset(_HANDLERS)
