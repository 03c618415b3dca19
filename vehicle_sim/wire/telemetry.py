"""What there is to say: a method for each message, called as that is, which returns its fields.

Fields that somebody reads are filled as in the recorded flights, the others are zero.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Final, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.core import Autopilot
from vehicle_sim.autopilot.values import Landed, Place, State, Status, Vector
from vehicle_sim.plans import PlanKind
from vehicle_sim.wire.frames import Prepared, make
from vehicle_sim.wire.proximity import RangeSensors

Fields = tuple[Any, ...]
"""Of a message in MAVLink's order; those at the end that are left out are zero."""

_EPOCH_US: Final = 1_795_000_000_000_000
"""UTC at the start of every run: the same seed gives the same bytes."""
_FIXED_WING: Final = 1
_NAN: Final = math.nan
_NO_VECTOR: Final = (_NAN, _NAN, _NAN)
_NO_CELL, _NO_TEMPERATURE, _NO_MISSION = 65535, 32767, 65535
_CENTIAMPERES_UNKNOWN: Final = -100
"""As PX4's simulated battery says it."""
_ARDUPILOT_SENSORS, _PX4_SENSORS = 0x4241_9C0F, 0x0200_400F
"""SYS_STATUS: gyroscopes, accelerometers, compass, pressure ...: always there and well; PX4 says so
of its control of the position only while it has one."""
_GPS_BIT, _POSITION_BIT, _PREARM_BIT = 0x20, 0x4000, 0x1000_0000
_ONLY_POSITION: Final = 0xFDF8
_LOCAL, _GLOBAL, _GLOBAL_INT, _DOWN = 1, 0, 5, 25
"""Three of MAV_FRAME, and the orientation of a sensor."""
_TAKEOFF, _MISSION, _RETURN, _LAND = 0x0204_0000, 0x0404_0000, 0x0504_0000, 0x0604_0000
_ALTITUDE, _POSITION = 0x0002_0000, 0x0003_0000
_MODES: Final = (_POSITION, _ALTITUDE, _RETURN, _MISSION, _LAND, _TAKEOFF)
_STANDARD_MODES: Final = dict(zip(_MODES, (1, 4, 5, 6, 7, 8), strict=True))
"""MAV_STANDARD_MODE by custom_mode of PX4: 7 and 8 as recorded, the others from the source."""


def whole(value: float) -> int:
    """The nearest whole number; 0 for what is not finite."""
    return round(value) if math.isfinite(value) else 0


def _e7(place: Any) -> tuple[int, int]:
    """Latitude and longitude of anything that has them, in 1e-7 degrees."""
    return whole(place.latitude_deg * 1e7), whole(place.longitude_deg * 1e7)


def _e7_mm(place: Any) -> tuple[int, int, int]:
    """Latitude, longitude and height above the sea."""
    return *_e7(place), whole(place.altitude_amsl_m * 1e3)


@final
class Telemetry:
    """One autopilot's, from its boot on; what it refers to is read when something is said.

    None instead of fields: there is nothing to say now.
    """

    def __init__(
        self, autopilot: Autopilot, ranging: RangeSensors, hardware_id: int, boot_us: int
    ) -> None:
        self._autopilot, self._ranging, self._hardware_id = autopilot, ranging, hardware_id
        self._estimate, self._firmware = autopilot.estimate, autopilot.firmware
        self._vehicle = autopilot.vehicle
        """For attitude and airspeed only: position and velocity are the estimate's."""
        self._is_px4 = autopilot.is_px4
        self._is_plane = autopilot.firmware.vehicle_type == _FIXED_WING
        self._boot_us = boot_us
        self.now(boot_us)

    def now(self, now_us: int) -> None:
        """What is told from here on is of this time of the simulation."""
        self._time_us = now_us - self._boot_us
        vars(self).pop("_status", None)

    def messages(self, number: int) -> Sequence[Prepared]:
        """All messages of this number that there are now."""
        if number in self._ranging.numbers:
            return self._ranging.messages(number, self._time_us)
        name = _NAMES.get(number)
        fields = None if name is None else getattr(self, f"_{name}")()
        return () if name is None or fields is None else (make(name, *fields),)

    # --- what several of them tell ------------------------------------------------------------

    @cached_property
    def _status(self) -> Status:
        """Computed when a message first needs it: most, like ATTITUDE, do not."""
        return self._autopilot.status()

    def _boot_ms(self) -> int:
        return self._time_us // 1000 & 0xFFFFFFFF

    def _heading_cdeg(self) -> int:
        """Where the nose points, 0 to 35999."""
        return round(math.degrees(self._vehicle.heading_rad) * 100.0) % 36000

    def _angles_rad(self) -> Vector:
        """Roll, pitch and yaw, this from -pi to pi."""
        vehicle = self._vehicle
        return vehicle.roll_rad, vehicle.pitch_rad, math.remainder(vehicle.heading_rad, math.tau)

    def _quaternion(self) -> tuple[float, float, float, float]:
        """Attitude, scalar first: as if it yawed, then pitched, then rolled."""
        roll, pitch, yaw = (angle_rad / 2.0 for angle_rad in self._angles_rad())
        turn = complex(math.cos(yaw), math.sin(yaw))
        level = turn * complex(math.cos(roll) * math.cos(pitch), -math.sin(roll) * math.sin(pitch))
        bent = turn * complex(math.sin(roll) * math.cos(pitch), math.cos(roll) * math.sin(pitch))
        return level.real, bent.real, bent.imag, level.imag

    def _velocity_ned_m_s(self) -> Vector:
        """The estimate's."""
        level = self._estimate.velocity_m_s
        return level.real, level.imag, -self._estimate.velocity_up_m_s

    def _altitude_amsl_m(self) -> float:
        """ArduPilot's stands still with the position; the height above home does not."""
        frozen_m = self._estimate.frozen_altitude_amsl_m
        return self._estimate.altitude_amsl_m if frozen_m is None else frozen_m

    def _above_m(self, place: Place | None) -> float:
        """Height above it; NaN if it is not known."""
        return _NAN if place is None else self._estimate.altitude_amsl_m - place.altitude_amsl_m

    def _gauge(self) -> tuple[int, int, int]:
        """Of the battery: millivolts, centiamperes and per cent."""
        battery = self._autopilot.battery
        amperes = _CENTIAMPERES_UNKNOWN if self._is_px4 else whole(battery.current_a * 100.0)
        left = math.floor(min(max(battery.remaining, 0.0), 1.0) * 100.0 + 1e-9)
        return whole(battery.voltage_v * 1e3), amperes, left

    # --- what and how it is -------------------------------------------------------------------

    def _heartbeat(self) -> Fields:
        firmware, status = self._firmware, self._status
        modes = (status.base_mode, status.mode, status.system_status)
        return firmware.vehicle_type, firmware.autopilot, *modes, 3

    def _current_mode(self) -> Fields:
        status = self._status
        fails = status.system_status == State.CRITICAL
        standard = 0 if fails else _STANDARD_MODES.get(status.mode, 0)
        return standard, status.mode, status.intended_mode

    def _extended_sys_state(self) -> Fields:
        vtol = 0 if self._is_px4 or self._is_plane else mavlink.MAV_VTOL_STATE_MC
        return vtol, self._status.landed_state

    def _system_time(self) -> Fields:
        unix_us = _EPOCH_US + self._boot_us + self._time_us
        return unix_us if self._autopilot.fix.usable else 0, self._boot_ms()

    def _timesync(self) -> Fields:
        """A question; the last digit tells ArduPilot's from those of others."""
        return 0, self._time_us * 1000 + (0 if self._is_px4 else 1)

    def _autopilot_version(self) -> Fields:
        version, custom = self._firmware.software_version, list(self._firmware.custom_version)
        head = (self._firmware.capabilities, version)
        if self._is_px4:
            return *head, version, 101854463, 1, custom, custom, [0] * 8, 0, 0, self._hardware_id
        uid = list(self._hardware_id.to_bytes(18, "little"))
        return *head, 0, 0, 0, custom, [0] * 8, [0] * 8, 0, 0, 0, uid

    def _sys_status(self) -> Fields:
        there, lost = self._ranging.bits(self._time_us)
        there |= _PREARM_BIT | (_GPS_BIT if self._autopilot.fix.fix_type > 0 else 0)
        there |= _PX4_SENSORS if self._is_px4 else _ARDUPILOT_SENSORS
        lost |= 0 if self._status.prearm_ok else _PREARM_BIT
        lost |= 0 if self._estimate.position_ok else _POSITION_BIT
        rest = (*[0] * 8, 1) if self._is_px4 else ()
        return there, there, there & ~lost, 0, *self._gauge(), *rest

    def _battery_status(self) -> Fields:
        volts, amperes, left = self._gauge()
        consumed, cells = whole(self._autopilot.battery.consumed_mah), [volts, *[_NO_CELL] * 9]
        kind = (0, 1, 1) if self._is_px4 else (0, 0, 0)
        return *kind, _NO_TEMPERATURE, cells, amperes, consumed, 0, left, 0, 1

    # --- where it is --------------------------------------------------------------------------

    def _attitude(self) -> Fields:
        return self._boot_ms(), *self._angles_rad(), *self._autopilot.rates_rad_s

    def _attitude_quaternion(self) -> Fields:
        return self._boot_ms(), *self._quaternion(), *self._autopilot.rates_rad_s

    def _local_position_ned(self) -> Fields | None:
        here_m = self._autopilot.local_ned_m()
        return here_m and (self._boot_ms(), *here_m, *self._velocity_ned_m_s())

    def _odometry(self) -> Fields | None:
        here_m, frames = self._autopilot.local_ned_m(), (_LOCAL, _LOCAL)
        attitude, rates_rad_s = list(self._quaternion()), self._autopilot.rates_rad_s
        moving = (attitude, *self._velocity_ned_m_s(), *rates_rad_s)
        rest = ([_NAN] * 21, [_NAN] * 21, 0, mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT)
        return here_m and (self._time_us, *frames, *here_m, *moving, *rest)

    def _global_position_int(self) -> Fields | None:
        """Of PX4 once it has an origin."""
        if self._is_px4 and self._estimate.origin is None:
            return None
        heights_m = self._altitude_amsl_m(), self._above_m(self._autopilot.home)
        mm = (whole(value * 1e3) for value in heights_m)
        cm_s = (whole(value * 100.0) for value in self._velocity_ned_m_s())
        return self._boot_ms(), *_e7(self._estimate), *mm, *cm_s, self._heading_cdeg()

    def _gps_raw_int(self) -> Fields | None:
        """Before the receiver speaks PX4 says nothing."""
        fix = self._autopilot.fix
        if self._is_px4 and not fix.time_us:
            return None
        north, east = fix.velocity_north_m_s, fix.velocity_east_m_s
        dilutions = (*fix.quality[:2], math.hypot(north, east))
        course_cdeg = round(math.degrees(math.atan2(east, north)) * 100.0) % 36000
        hundredths = (whole(value * 100.0) for value in dilutions)
        mm = (whole(value * 1e3) for value in (fix.altitude_amsl_m, *fix.quality[2:]))
        solution = (fix.fix_type, *_e7_mm(fix), *hundredths, course_cdeg)
        return fix.time_us, *solution, fix.satellites, *mm

    def _vfr_hud(self) -> Fields:
        """A plane says its indicated airspeed, a copter of PX4 none."""
        says = self._is_plane or not self._is_px4
        airspeed_m_s = self._autopilot.airspeed_m_s() if says else _NAN
        north, east, down = self._velocity_ned_m_s()
        throttle = round(min(max(self._vehicle.throttle, 0.0), 1.0) * 100.0)
        where = (self._heading_cdeg() // 100, throttle, self._altitude_amsl_m())
        return airspeed_m_s, math.hypot(north, east), *where, -down

    def _altitude(self) -> Fields:
        """Above the sea by pressure and by estimate, the origin, home; the ground's; above that."""
        local_m, amsl_m = self._above_m(self._estimate.origin), self._estimate.altitude_amsl_m
        above_m = self._autopilot.height_m
        heights_m = (amsl_m, local_m, self._above_m(self._autopilot.home), local_m - above_m)
        return self._time_us, self._vehicle.altitude_amsl_m, *heights_m, above_m

    def _distance_sensor(self) -> Fields | None:
        """PX4's; of ArduPilot's proximity.py says more."""
        if self._ranging.rangefinder_off:
            return None
        range_cm = min(round(self._autopilot.height_m * 100.0), 10000)
        return self._boot_ms(), 0, 10000, range_cm, 0, 0, _DOWN

    def _ekf_status_report(self) -> Fields:
        estimate = self._estimate
        return estimate.flags, estimate.velocity_variance, estimate.horizontal_variance

    def _estimator_status(self) -> Fields:
        accuracy_m = self._estimate.horizontal_accuracy_m
        return self._time_us, *self._ekf_status_report(), *[0.0] * 4, accuracy_m

    def _gps_global_origin(self) -> Fields | None:
        origin = self._estimate.origin
        return origin and (*_e7_mm(origin), self._time_us)

    def _home_position(self) -> Fields | None:
        """As if at the origin, but for its height; ArduPilot knows no attitude of the surface."""
        home, origin, ned_m = self._autopilot.home, self._estimate.origin, _NO_VECTOR
        if home is None or (self._is_px4 and origin is None):
            return None
        if origin is not None:
            ned_m = (0.0, 0.0, origin.altitude_amsl_m - home.altitude_amsl_m)
        q = [1.0, 0.0, 0.0, 0.0] if self._is_px4 else [_NAN] * 4
        return *_e7_mm(home), *ned_m, q, 0.0, 0.0, 0.0, self._time_us

    def _simstate(self) -> Fields:
        """The truth: SITL says it too."""
        return *[0.0] * 9, *_e7(self._vehicle)

    def _wind(self) -> Fields:
        """The air as it is, as a direction that it comes from."""
        north, east = self._vehicle.wind_m_s.real, self._vehicle.wind_m_s.imag
        return math.degrees(math.atan2(-east, -north)), math.hypot(north, east)

    def _wind_cov(self) -> Fields | None:
        """Of a plane, once in the air."""
        if not self._is_plane or self._status.landed_state == Landed.ON_GROUND:
            return None
        wind = (self._vehicle.wind_m_s.real, self._vehicle.wind_m_s.imag)
        return self._time_us, *wind, 0.0, 0.0, 0.0, self._estimate.altitude_amsl_m

    # --- where it flies to --------------------------------------------------------------------

    def _position_target_local_ned(self) -> Fields | None:
        target = self._autopilot.target_echo()
        if target is None:
            return None
        _, frame, mask, position, velocity, acceleration, *yaw = target
        return self._boot_ms(), frame, mask, *position, *velocity, *acceleration, *yaw

    def _position_target_global_int(self) -> Fields | None:
        """The navigator's place; PX4 adds what else the controller aims at."""
        waypoint, target = self._status.waypoint, self._autopilot.target_echo()
        if waypoint is None:
            return None
        place, height_m = _e7(waypoint.place), waypoint.place.altitude_amsl_m
        if not self._is_px4:
            return self._boot_ms(), _GLOBAL, _ONLY_POSITION, *place, height_m
        height_m = 0.0 if self._status.mode == _LAND and not self._is_plane else height_m
        aim: Fields = (_NAN,) * 8
        if target is not None:
            *_, velocity, acceleration, yaw_rad, yaw_rate_rad_s = target
            aim = (*velocity, *acceleration, yaw_rad, yaw_rate_rad_s)
        return self._boot_ms(), _GLOBAL_INT, 0, *place, height_m, *aim

    def _nav_controller_output(self) -> Fields | None:
        """ArduPilot's; a copter has a target everywhere."""
        waypoint, attitude_deg = self._status.waypoint, map(math.degrees, self._angles_rad()[:2])
        if self._is_px4 or waypoint is None:
            return None if self._is_plane or self._is_px4 else tuple(attitude_deg)
        bearing_deg = round(math.degrees(math.remainder(waypoint.bearing_rad, math.tau)))
        ways = (bearing_deg, bearing_deg, whole(waypoint.distance_m))
        errors = (waypoint.altitude_error_m, waypoint.airspeed_error_m_s * 100.0)
        return *attitude_deg, *ways, *errors, waypoint.cross_track_m

    def _mission_current(self) -> Fields:
        """Mode of PX4: 1 while the navigator lands, takes off or flies the mission, else 2."""
        status, autopilot = self._status, self._autopilot
        total = max(len(autopilot.plans[PlanKind.MISSION]) - self._firmware.first_item, 0)
        total = (total or _NO_MISSION) if self._is_px4 else total
        flies = status.waypoint is not None and status.mode in (_LAND, _TAKEOFF, _MISSION)
        mode = (1 if flies else 2) if self._is_px4 else 0
        return autopilot.route.current, total, autopilot.mission_state(), mode

    def _fence_status(self) -> Fields | None:
        return self._status.fence


_NAMES: Final = {
    number: name
    for number, kind in mavlink.mavlink_map.items()
    if hasattr(Telemetry, f"_{(name := kind.msgname.lower())}")
}
"""Of the messages that there is a method for, by number."""
