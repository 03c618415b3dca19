"""ArduCopter in motion: its modes, lifting off, touching the ground.

Source: ardupilot.md 2 and the recorded flights.  The autopilot steers by its estimate; only the
ground itself, and the height above it that a rangefinder would measure for landing, are true.
"""

import enum
import math
from collections.abc import Callable
from typing import final

from vehicle_sim.autopilots.ardupilot.autopilot import ArduPilot
from vehicle_sim.autopilots.ardupilot.copter_auto import Auto, Motion, Yaw, tuning_of
from vehicle_sim.autopilots.ardupilot.copter_guided import Guided, Submode
from vehicle_sim.autopilots.ardupilot.flat_earth import Vector
from vehicle_sim.dynamics.copter import Copter


class Mode(enum.IntEnum):
    """custom_mode of the heartbeat."""

    STABILIZE = 0
    ACRO = 1
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    CIRCLE = 7
    LAND = 9
    POSHOLD = 16
    BRAKE = 17
    SMARTRTL = 21


NAMES: dict[int, str] = {mode.value: mode.name for mode in Mode}
RETURNS = (Mode.RTL, Mode.SMARTRTL)
NEED_POSITION = frozenset(
    {Mode.AUTO, Mode.GUIDED, Mode.LOITER, Mode.CIRCLE, Mode.POSHOLD, Mode.BRAKE, *RETURNS}
)
NOT_ARMABLE = frozenset({Mode.AUTO, Mode.CIRCLE, Mode.LAND, Mode.BRAKE, *RETURNS})

LIFTS_AFTER_ARMING_US = 3_430_000
LIFTS_AFTER_COMMAND_US = 1_450_000
"""Spooling up: from arming and from the take-off's command to leaving the ground."""
REACHED_M, REACHED_US = 0.3, 700_000
"""The take-off is over so long after coming so near to its height."""
LANDED_AFTER_US = 1_570_000
DISARMED_AFTER_US = 505_000
"""From touching the ground to believing it, and from there to disarming."""
FAILSAFE_PAUSE_US = 4_000_000
"""LAND_WITH_DELAY_MS."""
BRAKE_M_S2 = 7.5
FALL_1_S = 4.0


@final
class Flight:
    """A copter on the ground or not, flown in one of the modes."""

    def __init__(self, host: ArduPilot, copter: Copter) -> None:
        self.host = host
        self.copter = copter
        motion = self.motion = Motion(host, copter)
        self.control = motion.control
        self.guided = Guided(self.control, host.parameters["GUID_TIMEOUT"])
        self.yaw = Yaw()
        self.auto = Auto(motion, self.guided)
        self.on_ground = True
        self.armed_us = 0
        self._reached_us: int | None = None
        self._touched_us: int | None = None
        self._landed_us: int | None = None
        self._looks_ahead = False
        self._runs: dict[int, Callable[[float], Vector]] = {
            Mode.GUIDED: self._run_guided,
            Mode.AUTO: self.auto.run,
            Mode.RTL: motion.run_return,
            Mode.SMARTRTL: motion.run_return,
            Mode.LAND: motion.run_landing,
            Mode.BRAKE: self._run_brake,
            Mode.CIRCLE: self._run_loiter,
            Mode.LOITER: self._run_loiter,
            Mode.POSHOLD: self._run_loiter,
            Mode.ALT_HOLD: self._run_altitude_hold,
            Mode.STABILIZE: self._fall,
            Mode.ACRO: self._fall,
        }

    def read_parameters(self) -> None:
        """All of them are read live, the speeds of a submode when it begins."""
        self.control.tuning = tuning_of(self.host.parameters, self.copter)
        self.guided.set_timeout(self.host.parameters["GUID_TIMEOUT"])
        self._set_looks_ahead()

    # --- changing ------------------------------------------------------------------------------

    def begin(self, mode: int) -> None:
        """Fly in this mode from now on."""
        self.abandon_takeoff()
        self.guided.paused = False
        self._set_looks_ahead()
        self.yaw.look_ahead()
        self.guided.stop()
        if mode == Mode.LAND:
            self.motion.lands_with_position = self.host.ekf.position_ok
        elif mode in RETURNS:
            self.motion.begin_return(climb=mode == Mode.RTL)
        elif mode == Mode.AUTO:
            self.auto.begin()

    def take_off(self, altitude_amsl_m: float) -> None:
        """Climb straight up to this height."""
        here = self.host.estimate.place
        self.guided.take_off(here.at(altitude_amsl_m))
        self.motion.takeoff_us, self._reached_us = self.host.now_us, None

    def abandon_takeoff(self) -> None:
        """Abandon the take-off."""
        self.motion.takeoff_us = self._reached_us = None

    @property
    def landing(self) -> bool:
        """Whether it comes down to land."""
        mode = self.host.mode
        if mode in RETURNS:
            return self.motion.returned
        return mode == Mode.LAND or (mode == Mode.AUTO and self.auto.landing)

    # --- each step ----------------------------------------------------------------------------

    def step(self, dt_s: float, ground_amsl_m: float) -> None:
        """Fly on, over ground of this height."""
        host, copter, guided = self.host, self.copter, self.guided
        self.motion.ground_amsl_m = ground_amsl_m
        if host.mode == Mode.GUIDED and not guided.paused:
            guided.run(host.now_us, dt_s)
        if self.on_ground:
            self._stand(ground_amsl_m)
            return
        if not host.armed:
            copter.fall(dt_s)
        else:
            north, east, up = self._runs[host.mode](dt_s)
            copter.advance(north, east, up, dt_s)
            control = self.control
            if guided.tracker is None:
                way = (control.velocity_north, control.velocity_east)
            else:
                way = (copter.velocity_north_m_s, copter.velocity_east_m_s)
            copter.heading_rad = self.yaw.turned(
                copter.heading_rad, way, control.tuning.speed_m_s, dt_s, ahead=self._looks_ahead
            )
        if copter.altitude_amsl_m <= ground_amsl_m:
            self._touch_down(ground_amsl_m)

    def _set_looks_ahead(self) -> None:
        """WP_YAW_BEHAVIOR 2: ahead except in RTL."""
        behaviour, mode = int(self.host.parameters["WP_YAW_BEHAVIOR"]), self.host.mode
        if mode in RETURNS:
            self._looks_ahead = behaviour in (1, 3)
        else:
            self._looks_ahead = behaviour != 0 and mode in (Mode.GUIDED, Mode.AUTO)

    def _stand(self, ground_amsl_m: float) -> None:
        """On the ground: lift off when a take-off has spooled up, disarm after a landing."""
        host, now_us = self.host, self.host.now_us
        self.copter.altitude_amsl_m = ground_amsl_m
        if host.mode == Mode.AUTO and host.armed:
            self.auto.on_ground()
        spun_up = now_us - self.armed_us >= LIFTS_AFTER_ARMING_US
        if self.motion.takeoff_us is not None and host.armed:
            since_us = now_us - self.motion.takeoff_us
            if since_us >= LIFTS_AFTER_COMMAND_US and spun_up:
                self._lift_off()
                return
        if self._touched_us is not None and now_us - self._touched_us >= LANDED_AFTER_US:
            self._touched_us = None
            self._landed_us = now_us
            host.landed = True
            self.guided.stop()
        if self._landed_us is not None and host.armed:
            waits_us = host.parameters["DISARM_DELAY"] * 1e6
            if self.landing:
                waits_us = DISARMED_AFTER_US
            if waits_us > 0.0 and now_us - self._landed_us >= waits_us:
                host.disarm()

    def _lift_off(self) -> None:
        self.on_ground = self.host.landed = False
        self._landed_us = self._touched_us = None
        self.control.rest()
        self.control.start()

    def standing(self) -> None:
        """The motors have been armed on the ground: they will not idle for ever."""
        self.armed_us = self.host.now_us
        self._landed_us = self.host.now_us if self.on_ground else None

    def _touch_down(self, ground_amsl_m: float) -> None:
        """Come to rest on the terrain, or in it."""
        self.copter.stand(ground_amsl_m)
        self.on_ground = True
        self.abandon_takeoff()
        self.control.rest()
        self._touched_us = self.host.now_us

    def crash(self) -> None:
        """Who lies on the ground need not wait to believe it."""
        if self.on_ground:
            self._touched_us = None
            self.host.landed = True

    # --- modes ----------------------------------------------------------------------------------

    def _run_guided(self, dt_s: float) -> Vector:
        if self.motion.takeoff_us is not None:
            self._watch_takeoff()
        if not self.host.ekf.aiding:
            return self.motion.level_out(0.0, dt_s)
        return self.guided.wanted(self.host.now_us, dt_s)

    def _watch_takeoff(self) -> None:
        """The take-off is over some time after the height was nearly reached."""
        if self._reached_us is None:
            if self.host.estimate.altitude_amsl_m > self.guided.altitude_amsl_m - REACHED_M:
                self._reached_us = self.host.now_us
        elif self.host.now_us - self._reached_us >= REACHED_US:
            self.motion.takeoff_us = self._reached_us = None
            self.host.took_off()

    def _run_brake(self, dt_s: float) -> Vector:
        copter, e = self.copter, self.host.estimate
        most = min(BRAKE_M_S2, copter.limits.acceleration_m_s2)
        speed = math.hypot(e.velocity_north_m_s, e.velocity_east_m_s)
        control = self.control
        if speed < 0.5:
            return self.motion.stop_level(0.0, dt_s)
        control.start_level()
        control.towards_climb(0.0, 0.0, dt_s)
        drag, share = copter.drag_1_s, min(most, 4.0 * speed) / speed
        north = (drag - share) * e.velocity_north_m_s
        east = (drag - share) * e.velocity_east_m_s
        control.follow(north, east)
        return north, east, control.wanted_up()

    def _run_loiter(self, dt_s: float) -> Vector:
        return self.motion.stop_level(-self._pilot_down_m_s(), dt_s)

    def _run_altitude_hold(self, dt_s: float) -> Vector:
        return self.motion.level_out(-self._pilot_down_m_s(), dt_s)

    def _pilot_down_m_s(self) -> float:
        """The stick is at its lower end."""
        parameters = self.host.parameters
        return (parameters["PILOT_SPEED_DN"] or parameters["PILOT_SPEED_UP"]) / 100.0

    def _fall(self, dt_s: float) -> Vector:
        """No stick input: the motors idle."""
        copter = self.copter
        north, east, _ = self.control.levelled(dt_s)
        most = copter.limits.speed_vertical_m_s
        return north, east, FALL_1_S * (-most - copter.velocity_up_m_s)

    @property
    def taking_off(self) -> bool:
        """Whether a take-off is going on, in GUIDED or AUTO."""
        in_auto = self.host.mode == Mode.AUTO and self.auto.taking_off
        return self.motion.takeoff_us is not None or in_auto

    @property
    def holds_place(self) -> bool:
        """Whether GUIDED's target has a place."""
        return self.guided.submode not in (Submode.VELOCITY, Submode.ACCELERATION)
