"""ArduCopter in motion: take-off, the modes that need no target, landing, touching the ground."""

import math
from typing import final

from vehicle_sim.autopilots import Place, Reply, TargetEcho, Text
from vehicle_sim.autopilots.facts import (
    BRAKE_JERK_M_S3,
    BRAKE_M_S2,
    CRASH_M_S,
    DISARM_US,
    REACHED_US,
    SLOW_LANDING_M,
    SPOOL_UP_US,
    YAW_RATE_RAD_S,
    Landed,
    Mode,
)
from vehicle_sim.autopilots.guided import (
    KV_1_S,
    Guided,
    Shaper,
    Submode,
    Tuning,
    climb_m_s,
)
from vehicle_sim.autopilots.setpoints import Vector, flat_earth_ned_m
from vehicle_sim.dynamics import Copter


@final
class Flight:
    """A copter that is armed or not, on the ground or not, and flies in one of the modes."""

    def __init__(self, copter: Copter, tuning: Tuning, *, heading_rad: float) -> None:
        self.copter = copter
        self.heading_rad = heading_rad
        self.mode = Mode.STABILIZE
        self.armed = False
        self.landed = True
        self.now_us = 0
        self._tuning = tuning
        self._shaper = Shaper()
        self.guided = Guided(tuning, self._shaper)
        self._takeoff_us: int | None = None
        """When the take-off that is going on was commanded."""
        self._reached_us: int | None = None
        self._touched_us: int | None = None

    @property
    def taking_off(self) -> bool:
        """Whether a take-off was commanded and is not over."""
        return self._takeoff_us is not None

    def place(self) -> Place:
        """Where the vehicle is."""
        copter = self.copter
        return Place(
            latitude_deg=copter.latitude_deg,
            longitude_deg=copter.longitude_deg,
            altitude_amsl_m=copter.altitude_amsl_m,
        )

    def change_mode(self, mode: Mode) -> None:
        """Fly in this mode from now on."""
        self.mode = mode
        self.abandon_takeoff()
        self.guided.stop()
        self._shaper.follow(self.copter)

    def disarm(self) -> None:
        """Stop the motors, wherever it is."""
        self.armed = False
        self._touched_us = None
        self.abandon_takeoff()

    def take_off(self, altitude_amsl_m: float) -> None:
        """Climb straight up to this height."""
        place = self.place()
        self.guided.stop()
        self.guided.submode = Submode.POSITION
        self.guided.hold(
            Place(
                latitude_deg=place.latitude_deg,
                longitude_deg=place.longitude_deg,
                altitude_amsl_m=altitude_amsl_m,
            )
        )
        self._takeoff_us, self._reached_us = self.now_us, None

    def abandon_takeoff(self) -> None:
        """Whatever comes next is no take-off."""
        self._takeoff_us = self._reached_us = None

    def step(self, now_us: int, dt_s: float, ground_amsl_m: float) -> list[Reply]:
        """Fly on to now_us, over ground of this height."""
        self.now_us = now_us
        if self.mode is Mode.GUIDED:
            self.guided.run(now_us, dt_s)
        if self.landed:
            self._stand(ground_amsl_m)
            return []
        self._fly(dt_s, ground_amsl_m)
        if self.copter.altitude_amsl_m > ground_amsl_m:
            return []
        return self._touch_down(ground_amsl_m)

    def _stand(self, ground_amsl_m: float) -> None:
        """On the ground: lift off when a take-off has spooled up, disarm after a landing."""
        self.copter.altitude_amsl_m = ground_amsl_m
        if self._takeoff_us is not None and self.now_us - self._takeoff_us >= SPOOL_UP_US:
            self.landed = False
        touched_us = self._touched_us
        if touched_us is not None and self.now_us - touched_us >= DISARM_US:
            self.disarm()

    def _fly(self, dt_s: float, ground_amsl_m: float) -> None:
        copter = self.copter
        if not self.armed:
            copter.fall(dt_s)
            return
        if self.mode is Mode.GUIDED:
            north, east, up = self.guided.wanted(copter, self.now_us, dt_s)
            if self._takeoff_us is not None:
                self._watch_takeoff()
        else:
            north, east, up = self._wanted_without_target(dt_s, ground_amsl_m)
        copter.advance(north, east, up, dt_s)
        self._turn(dt_s)

    def _wanted_without_target(self, dt_s: float, ground_amsl_m: float) -> Vector:
        """BRAKE, LAND and STABILIZE: acceleration north, east, up."""
        copter, tuning = self.copter, self._tuning
        most_m_s2, jerk_m_s3, climb = tuning.acceleration_m_s2, tuning.jerk_m_s3, 0.0
        if self.mode is Mode.BRAKE:
            most_m_s2, jerk_m_s3 = BRAKE_M_S2, BRAKE_JERK_M_S3
        elif self.mode is Mode.LAND:
            height_m = copter.altitude_amsl_m - ground_amsl_m - SLOW_LANDING_M
            climb = climb_m_s(-height_m, tuning, copter.limits.acceleration_vertical_m_s2)
            climb = min(climb, -tuning.land_speed_m_s)
        else:  # nobody holds the sticks: it keeps its course and sinks
            return 0.0, 0.0, KV_1_S * (-copter.limits.speed_vertical_m_s - copter.velocity_up_m_s)
        north, east = self._shaper.towards(
            copter,
            (0.0, 0.0),
            most_m_s2=min(most_m_s2, copter.limits.acceleration_m_s2),
            jerk_m_s3=jerk_m_s3,
            dt_s=dt_s,
        )
        return north, east, KV_1_S * (climb - copter.velocity_up_m_s)

    def _watch_takeoff(self) -> None:
        """The take-off is over a second after the height was reached."""
        if self._reached_us is None:
            if self.copter.altitude_amsl_m > self.guided.altitude_amsl_m - 0.3:
                self._reached_us = self.now_us
        elif self.now_us - self._reached_us >= REACHED_US:
            self._takeoff_us = None

    def _turn(self, dt_s: float) -> None:
        """Turn the nose to the commanded yaw, or along the way."""
        copter, wanted_rad = self.copter, self.heading_rad
        if self.mode is Mode.GUIDED:
            if self.guided.yaw_rad is not None:
                wanted_rad = self.guided.yaw_rad
            elif math.hypot(copter.velocity_north_m_s, copter.velocity_east_m_s) > 1.0:
                wanted_rad = math.atan2(copter.velocity_east_m_s, copter.velocity_north_m_s)
        turn_rad = math.remainder(wanted_rad - self.heading_rad, math.tau)
        most_rad = YAW_RATE_RAD_S * dt_s
        self.heading_rad += min(max(turn_rad, -most_rad), most_rad)

    def _touch_down(self, ground_amsl_m: float) -> list[Reply]:
        """Come to rest on the terrain, or in it."""
        copter = self.copter
        speed = math.hypot(
            copter.velocity_north_m_s, copter.velocity_east_m_s, copter.velocity_up_m_s
        )
        copter.stand(ground_amsl_m)
        self.landed = True
        self.abandon_takeoff()
        if speed > CRASH_M_S:
            self.disarm()
            return [Text(severity=0, text=f"Crash: Disarming: hit the ground at {speed:.0f} m/s")]
        if self.mode is Mode.LAND:
            self._touched_us = self.now_us
        return []

    def landed_state(self) -> Landed:
        """What EXTENDED_SYS_STATE says."""
        if self.landed:
            return Landed.ON_GROUND
        if self._takeoff_us is not None:
            return Landed.TAKEOFF
        return Landed.LANDING if self.mode is Mode.LAND else Landed.IN_AIR

    def echo(self, origin: Place) -> TargetEcho | None:
        """What GUIDED steers for."""
        guided = self.guided
        if self.mode is not Mode.GUIDED:
            return None
        place = Place(
            latitude_deg=guided.latitude_deg,
            longitude_deg=guided.longitude_deg,
            altitude_amsl_m=guided.altitude_amsl_m,
        )
        has_place = guided.submode in (Submode.POSITION, Submode.POSITION_VELOCITY)
        v_n, v_e, v_u = guided.velocity
        a_n, a_e, a_u = guided.acceleration
        return TargetEcho(
            position_ned_m=flat_earth_ned_m(origin, place) if has_place else None,
            velocity_ned_m_s=(v_n, v_e, -v_u),
            acceleration_ned_m_s2=(a_n, a_e, -a_u),
            yaw_rad=self.heading_rad if guided.yaw_rad is None else guided.yaw_rad,
        )
