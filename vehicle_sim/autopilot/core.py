"""The engine: what every autopilot does, from step to step and from message to message.

A `Firmware` is a value: all that differs as data.  Two families answer and decide (ardupilot.py,
px4.py); a kind of vehicle is a class of one of them that says how it is flown.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, final

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot import values
from vehicle_sim.autopilot.earth import Frame
from vehicle_sim.autopilot.estimator import Estimator, Timing
from vehicle_sim.autopilot.legs import RETURN, Does, Leg, Route
from vehicle_sim.autopilot.values import Command, Place, Reply, Result, Sender
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.dynamics.battery import Battery
from vehicle_sim.parameters import Parameter, Parameters
from vehicle_sim.plans import PlanKind, Plans
from vehicle_sim.sensors.gps import Fix

HEARTBEAT, GPS_GLOBAL_ORIGIN, AUTOPILOT_VERSION, HOME_POSITION = 0, 49, 148, 242
_DO_SET_MODE: Final = 176
_FORCE, _FORCE_ARM = 21196.0, 2989.0
"""Second parameter of COMPONENT_ARM_DISARM: without asking; and of arming alone."""
_CHECK_US: Final = 100_000  # what need not be looked at in every step is looked at so often
_MAX_RAD_S: Final = 10.0
"""Beyond what a gyroscope is told to feel: a heading that is set anew jumps."""
_GROUND_STATION: Final = 6  # MAV_TYPE
Handler = Callable[[Command], Result]
_GET_HOME_POSITION: Final = 410
_TELLS: Final = {_GET_HOME_POSITION: HOME_POSITION, 519: 300, 520: AUTOPILOT_VERSION}
"""Old commands that ask for one message."""


@final
@dataclass(frozen=True, slots=True)
class Mode:
    """A flight mode."""

    name: str
    number: int
    """custom_mode of the heartbeat."""
    flies: str
    """How: of a copter the method that does; of a plane a name for what it does."""
    needs_position: bool = True
    armable: bool = True
    base: int = 0
    """base_mode of the heartbeat, but for the bit that says whether it is armed."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Firmware:
    """All that differs between autopilots as data; times in seconds since boot."""

    family: Literal["ardupilot", "px4"]
    vehicle_type: int
    autopilot: int
    """MAV_TYPE and MAV_AUTOPILOT."""
    capabilities: int
    software_version: int
    custom_version: bytes
    rates_hz: Mapping[int, float]
    """Default rates of a new link, by message number."""
    first_heartbeat_us: int
    """Since boot; then at its rate."""
    streamable: frozenset[int]
    requestable: frozenset[int]
    """What SET_MESSAGE_INTERVAL and REQUEST_MESSAGE accept."""
    data_streams: Mapping[int, Sequence[int]] = field(default_factory=dict)
    """REQUEST_DATA_STREAM: group -> message numbers."""
    table: tuple[Parameter, ...]
    modes: tuple[Mode, ...]
    """The first one of them is that which it boots in."""
    orders: Mapping[int, str]
    """The modes that commands ask for, by MAV_CMD."""
    pilot: str
    missions: str
    """Modes that a pilot holds the vehicle in, and of a mission."""
    first_item: int
    """Of a mission: ArduPilot keeps home as item 0."""
    timing: Timing
    frame: Callable[[Place], Frame]
    ids: tuple[str, ...]
    """Parameters of its system id, and of its component id if that is not 1."""
    ready_s: float = 0.0
    """It has booted: heartbeats of an ArduPilot say so."""
    prearm_s: float
    """From here on it may be armed."""
    first_check_s: float = 0.1
    believes_landing_s: float
    """From touching the ground to believing it."""
    refused: Result
    """The answer to what cannot be done now."""
    arms: str
    disarms: str
    cannot_arm: str
    """Texts; with a gap for what it is disarmed by, or why it cannot be armed."""


@final
class Boot(NamedTuple):
    """What an autopilot boots with.  InputError names a parameter that it does not have."""

    firmware: Firmware
    vehicle: Vehicle
    parameters: Mapping[str, float]
    plans: Plans
    rng: np.random.Generator


class Autopilot:
    """One vehicle's autopilot.

    It steers the vehicle by its estimate, and reads the true position only through the GPS fix;
    only the ground is true.
    """

    # How it is flown, by a kind of vehicle (arducopter.py, px4plane.py and the like): in each step
    # `steer` while armed, then `stand` or `move`.
    begin: Callable[[], None]  # fly the mode from now on; again, if it was commanded again
    begin_leg: Callable[[float | None], None]  # of the mission, at this new speed; or none any more
    read_parameters: Callable[[], None]  # some parameter has changed; and before the first step
    wants_up: Callable[[], bool]  # it takes off: what presses it to the ground ends nothing then
    lifts_off: Callable[[], bool]  # whether it leaves the ground with this step
    move: Callable[[], None]  # in the air, armed
    touch_down: Callable[[], None]  # it comes to the ground with this step
    disarms_after_s: Callable[[], float | None]  # since it landed or was armed; None: never
    waypoint: Callable[[], values.Waypoint | None]  # the place that it goes to
    is_there: Callable[[Leg], bool]  # whether it has come to where a leg ends
    look: Callable[[], None] | None = None  # in every step, before the checks
    lies_below_m_s = math.inf  # speed on the ground at which it may be taken to have landed

    # How it decides, by a family (ardupilot.py, px4.py).
    check: Callable[[], None]  # ten times a second: whatever may end the flight
    set_mode: Callable[[str], bool]  # fly in this mode from now on, if it can be
    refusal: Callable[[], str | None]  # why it may not be armed now
    on_armed: Callable[[], None]  # the motors turn
    on_disarmed: Callable[[], None]  # they have stopped
    on_setpoint: Callable[[values.Setpoint], Sequence[Reply]]
    status: Callable[[], values.Status]  # what else there is to tell

    def __init__(self, boot: Boot) -> None:
        self.firmware = firmware = boot.firmware
        self.vehicle, self.plans, self.is_px4 = boot.vehicle, boot.plans, firmware.family == "px4"
        self.parameters = Parameters(firmware.table, boot.parameters)
        self.battery, self.fix = Battery(), Fix()
        """What the power module and the receiver say; the simulation puts its own here."""
        self.estimate = Estimator(boot.vehicle, firmware.timing, boot.rng)
        self.frame = firmware.frame(self.estimate.place)
        """Its local frame: about the origin, once there is one."""
        self.modes = {mode.name: mode for mode in firmware.modes}
        self.mode = firmware.modes[0]
        self.route = Route(firmware.first_item)
        self.home: Place | None = None
        self.now_s, self.step_s, self.ground_m = 0.0, 0.01, boot.vehicle.altitude_amsl_m
        self.armed = False
        self.landed = True
        """It believes to be on the ground."""
        self.armed_s, self.station_s = 0.0, -math.inf
        """When it was armed, and when a ground station was heard."""
        self.touched_s: float | None = None
        self.landed_s: float | None = None
        self._replies: list[Reply] = []
        self._version = -1
        self._check_us = round(firmware.first_check_s * 1e6)
        self._before_rad = (0.0, 0.0, boot.vehicle.heading_rad)  # attitude before the last step
        self.handlers: dict[int, Handler] = {
            224: self._set_mission_current,
            246: self._reboot,
            400: self._arm_or_disarm,
            179: self._set_home,
            **dict.fromkeys(_TELLS, self._tell),
        }
        """What answers which MAV_CMD; families and kinds add theirs."""

    # --- what not every one does --------------------------------------------------------------

    def steer(self) -> None:
        """Look where to go, on the ground too."""

    def stand(self) -> None:
        """On the ground; a plane may roll."""
        self.vehicle.stand(self.ground_m)

    def target_echo(self) -> values.Setpoint | None:
        """Its target, if that is told."""
        return None

    def airspeed_m_s(self) -> float:
        """As it measures it."""
        return self.vehicle.airspeed_m_s

    def on_plan(self, kind: PlanKind) -> Sequence[Reply]:  # noqa: ARG002 - lists are read live
        """A list was replaced by a client."""
        return ()

    # --- saying -------------------------------------------------------------------------------

    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT."""
        self._replies.append(values.Text(severity=severity, text=text))

    def send(self, *messages: int) -> None:
        """Send these telemetry messages once, to all links."""
        self._replies.extend(values.SendTelemetry(message=message) for message in messages)

    def taken(self) -> Sequence[Reply]:
        """What there is to say, once."""
        replies, self._replies = self._replies, []
        return replies

    # --- each step ----------------------------------------------------------------------------

    def step(self, now_us: int, dt_s: float, ground_amsl_m: float, fix: Fix) -> Sequence[Reply]:
        """Fly on to now_us, over ground of this height, with the newest GPS fix."""
        self.now_s, self.step_s = now_us * 1e-6, dt_s
        self.ground_m, self.fix = ground_amsl_m, fix
        estimate, vehicle = self.estimate, self.vehicle
        self._before_rad = vehicle.roll_rad, vehicle.pitch_rad, vehicle.heading_rad
        had_origin = estimate.origin is not None
        estimate.step(self.now_s, dt_s, fix)
        if estimate.origin is not None and not had_origin:
            self.frame = self.firmware.frame(estimate.origin)
            self.home = self.home or estimate.origin
            self.send(GPS_GLOBAL_ORIGIN, *(() if self.is_px4 else (HOME_POSITION,)))
        if self.parameters.version != self._version:
            self._version = self.parameters.version
            self.read_parameters()
        if self.look is not None:
            self.look()
        if now_us >= self._check_us:
            self._check_us = now_us + _CHECK_US
            self.check()
        if self.armed:
            self.steer()
        if vehicle.stands and self.armed and self.lifts_off():
            vehicle.stands, self.touched_s = False, None
        if vehicle.stands:
            self.stand()
            self._wait_on_ground()
        else:  # the simulation judges its contacts
            if self.armed:
                self.move()
            else:
                vehicle.fall(dt_s)
            if vehicle.altitude_amsl_m <= ground_amsl_m:
                self._come_to_ground()
        estimate.follow()
        return self.taken() if self._replies else ()

    def _come_to_ground(self) -> None:
        vehicle = self.vehicle
        if self.armed and self.wants_up():  # the ground carries it until it rises
            vehicle.altitude_amsl_m = self.ground_m
            vehicle.velocity_up_m_s = max(vehicle.velocity_up_m_s, 0.0)
        else:
            self.touched_s = self.now_s
            self.touch_down()

    def take_to_the_air(self) -> None:
        """It believes to fly."""
        self.landed, self.landed_s = False, None

    def _wait_on_ground(self) -> None:
        """Believe the landing after a while, and disarm."""
        rolls = abs(self.vehicle.velocity_m_s) > self.lies_below_m_s
        if self.armed and (self.wants_up() or rolls):
            self.touched_s = None
        elif not self.landed:
            self.touched_s = self.now_s if self.touched_s is None else self.touched_s
            waited_s = self.now_s - self.touched_s
            if not self.armed or waited_s >= self.firmware.believes_landing_s:
                self.landed, self.landed_s = True, self.now_s
        if self.armed and self.landed and (wait_s := self.disarms_after_s()) is not None:
            since_s = self.armed_s if self.landed_s is None else self.landed_s
            if self.now_s - since_s >= wait_s:
                self.disarm("auto preflight disarming" if self.landed_s is None else "landing")

    @property
    def height_m(self) -> float:
        """Above the ground, by a distance sensor."""
        return max(self.vehicle.altitude_amsl_m - self.ground_m, 0.0)

    @property
    def rates_rad_s(self) -> tuple[float, ...]:
        """Of roll, pitch and heading, as gyroscopes feel them: a point mass has none."""
        now_rad = self.vehicle.roll_rad, self.vehicle.pitch_rad, self.vehicle.heading_rad
        pairs = zip(self._before_rad, now_rad, strict=True)
        turned = (math.remainder(now - was, math.tau) for was, now in pairs)
        return tuple(min(max(t / self.step_s, -_MAX_RAD_S), _MAX_RAD_S) for t in turned)

    def local_ned_m(self) -> values.Vector | None:
        """Position in the estimator's frame; ArduPilot tells it while it uses GPS."""
        known = self.is_px4 or (self.estimate.origin is not None and self.estimate.aiding)
        return self.frame.ned_m(self.estimate) if known else None

    # --- modes and arming ---------------------------------------------------------------------

    def done(self, it_is: object) -> Result:
        """The answer to what either is done now or cannot be."""
        return Result.ACCEPTED if it_is else self.firmware.refused

    def arm(self, *, forced: bool = False) -> Result:
        """Start the motors, or say why not; home is here then."""
        if self.armed:
            return Result.ACCEPTED
        why = None if forced else self.refusal()
        if why is not None:
            self.say(2, self.firmware.cannot_arm.format(why))
            return self.firmware.refused
        self.armed, self.armed_s, self.landed_s = True, self.now_s, None
        if self.estimate.position_ok:
            self.home = self.estimate.place
        self.say(6, self.firmware.arms)
        self.on_armed()
        return Result.ACCEPTED

    def disarm(self, by: str = "external command") -> None:
        """Stop the motors, wherever it is."""
        if self.armed:
            self.armed = False
            self.say(6, self.firmware.disarms.format(by))
            self.on_disarmed()

    def _arm_or_disarm(self, command: Command) -> Result:
        wanted, force = command.parameters[:2]
        if wanted not in (0.0, 1.0):
            return Result.UNSUPPORTED
        if wanted == 1.0:
            return self.arm(forced=force in (_FORCE, _FORCE_ARM))
        if self.armed and not self.landed and force != _FORCE:
            return self.firmware.refused
        self.disarm()
        return Result.ACCEPTED

    def crash(self) -> Sequence[Reply]:
        """It has hit something; who lies on the ground need not wait to believe it."""
        self.landed = self.landed or self.vehicle.stands
        self.disarm("failure detector")
        return self.taken()

    # --- missions -----------------------------------------------------------------------------

    def seek(self, number: int) -> None:
        """Fly the mission from this item on; what is above terrain is above the ground below."""
        items, place = self.plans[PlanKind.MISSION], self.estimate.place
        about = (place, self.home or place, self.ground_m)
        self.begin_leg(self.route.seek(items, number, about, self.now_s))

    def is_at(self, does: Does) -> bool:
        """Whether it flies a leg of this kind."""
        return self.route.leg is not None and self.route.leg.does is does

    def follow_route(self) -> None:
        """Wait where the leg ends, then fly the next: of the mission, or of whatever it flies.

        PX4 tells of an item that it has come to, ArduPilot when it goes on.
        """
        route, leg, arrives = self.route, self.route.leg, self.route.arrived_s is None
        if leg is None or (arrives and not self.is_there(leg)):
            return
        route.arrived_s = self.now_s if route.arrived_s is None else route.arrived_s
        leaves = self.now_s - route.arrived_s >= leg.hold_s and leg.does is not Does.LAND
        is_item = leg.command not in (0, RETURN)
        if is_item and (arrives if self.is_px4 else leaves):
            self.reached(route.current)
        if leaves and is_item:
            self.seek(route.current + 1)
        elif leaves:
            route.go_on(self.now_s)

    def jump(self, to: float) -> bool:
        """Make this the current item, in a mission fly it; tells whether there is such an item."""
        if not 0.0 <= to < max(len(self.plans[PlanKind.MISSION]), 1):  # nor is NaN
            return False
        self.route.rewind(int(to))
        if self.mode.name == self.firmware.missions:
            self.seek(max(int(to), self.firmware.first_item))
        return True

    def _set_mission_current(self, command: Command) -> Result:
        """MISSION_SET_CURRENT comes here too."""
        return self.done(self.jump(command.parameters[0]))

    def reached(self, number: int) -> None:
        """Send MISSION_ITEM_REACHED to all links."""
        message = mavlink.MAVLink_mission_item_reached_message(seq=number)
        self._replies.append(values.SendMessage(message=message))

    def mission_state(self) -> int:
        """MISSION_STATE: 1 no mission, 2 not started, 3 active, 4 paused, 5 complete."""
        route, flies = self.route, self.mode.name == self.firmware.missions
        if len(self.plans[PlanKind.MISSION]) <= self.firmware.first_item:
            return 1
        if route.complete or flies:
            return 5 if route.complete else 3
        return 4 if route.current and self.is_px4 else 2

    # --- commands -----------------------------------------------------------------------------

    def on_command(self, command: Command) -> Sequence[Reply]:
        """Handle a command; returns the replies.

        PX4 answers for whatever component it is; it accepts DO_SET_MODE whatever that asks for,
        and lets the real result follow (px4.md 1, item 1).
        """
        number, result = command.number, Result.UNSUPPORTED
        if self.is_px4 or command.target_component in (0, 1):
            if (mode := self.firmware.orders.get(number)) is not None:
                result = self.done(self.set_mode(mode))
            elif (handler := self.handlers.get(number)) is not None:
                result = handler(command)
        ack = values.Ack(to=command.sender, command=number, result=result)
        if number != _DO_SET_MODE or not self.is_px4:
            return [ack, *self.taken()]
        self._replies.insert(0, ack)
        return [ack._replace(result=Result.ACCEPTED)]

    def on_heartbeat(self, sender: Sender, vehicle_type: int) -> None:
        """A ground station's counts: to ArduPilot the one of its parameter, to PX4 any."""
        is_station = vehicle_type == _GROUND_STATION
        if not self.is_px4:
            is_station = sender.system == self.parameters["MAV_GCS_SYSID"]
        self.station_s = self.now_s if is_station else self.station_s

    def place_of(self, command: Command) -> Place | None:
        """Where p5 to p7 are; of a COMMAND_LONG above sea level as in frame 0."""
        latitude_deg, longitude_deg, altitude_m = command.parameters[4:]
        home_m = None if self.home is None else self.home.altitude_amsl_m
        height_m = values.height_amsl_m(command.frame or 0, altitude_m, home_m)
        known = abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0  # NaN is not
        if not known or height_m is None or not abs(height_m) <= values.HIGHEST_M:
            return None
        return Place(latitude_deg, longitude_deg, height_m)

    def _set_home(self, command: Command) -> Result:
        """DO_SET_HOME: here if p1 is 1, and to ArduPilot if no place is given; 0, 0 is none."""
        p, place = command.parameters, self.estimate.place if self.estimate.position_ok else None
        if p[0] != 1.0 and (self.is_px4 or any(p[4:])):
            place = self.place_of(command) if any(p[4:6]) else None
        if place is None or self.estimate.origin is None:
            return self.firmware.refused
        self.home = place
        self.send(HOME_POSITION)
        return Result.ACCEPTED

    def _tell(self, command: Command) -> Result:
        """An old command that asks for one message; of home, once there is one."""
        if command.number == _GET_HOME_POSITION and self.home is None:
            return self.firmware.refused
        self._replies.append(values.SendTelemetry(_TELLS[command.number], command.sender))
        return Result.ACCEPTED

    def _reboot(self, command: Command) -> Result:
        """PREFLIGHT_REBOOT_SHUTDOWN: only while disarmed."""
        if self.armed:
            return self.firmware.refused
        if command.parameters[0] not in (1.0, 3.0):
            return Result.UNSUPPORTED
        self._replies.append(values.Reboot())
        return Result.ACCEPTED

    # --- faults -------------------------------------------------------------------------------

    def move_origin(self, north_m: float, east_m: float, up_m: float) -> Sequence[Reply]:
        """The origin moves: local positions change, global ones do not."""
        if self.estimate.origin is not None:
            self.estimate.origin = origin = self.frame.place(north_m, east_m, -up_m)
            self.frame = self.firmware.frame(origin)
            self.send(GPS_GLOBAL_ORIGIN)
        return self.taken()
