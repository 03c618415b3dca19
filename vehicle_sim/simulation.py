"""One vehicle without sockets or clock: bytes in, steps of vehicle time, frames out.

Here its parts meet: the world and its faults, the vehicle, its sensors, the flight controller, the
terrain radar and the radio.
"""

import math
from collections.abc import Callable, Container, Mapping
from dataclasses import replace
from typing import final

import numpy as np

from vehicle_sim import ground_station, truth
from vehicle_sim.autopilots import Autopilot, FirmwareProfile, Sender, Text
from vehicle_sim.autopilots.factory import (
    ids_of,
    make_vehicle,
    overrides_of,
    personality_of,
    with_own_ids,
)
from vehicle_sim.conditions import conditions_of, take_one_shots
from vehicle_sim.dynamics.battery import POWER_STEP_S, Battery, PowerModule
from vehicle_sim.dynamics.contact import Crash, is_crash, speed_m_s
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.dynamics.wind import Wind
from vehicle_sim.errors import InputError
from vehicle_sim.faults import Timeline
from vehicle_sim.flight_controller import FlightController
from vehicle_sim.parameters import Parameters
from vehicle_sim.plans import Plans
from vehicle_sim.rng import generator
from vehicle_sim.sensors.gps import Gps
from vehicle_sim.sensors.lidar import Lidar, LidarTable, body_down_neu
from vehicle_sim.sensors.terrain_radar import TerrainRadar
from vehicle_sim.terrain import FloatArray
from vehicle_sim.wire import messages
from vehicle_sim.wire.lidar import LidarDriver
from vehicle_sim.wire.proximity import RPLIDAR, Proximity, RangeSensors
from vehicle_sim.wire.radar import RadarComponent
from vehicle_sim.wire.radio import Radio, Received
from vehicle_sim.world import Scanner, World

STEP_US = 10_000
_STEP_S = STEP_US * 1e-6
_LOOK_US = 100_000
"""Between looks at the ground below; also of a lockstep tick without positions."""
_POSITION = 33
_POWEROFF = 7
_WORTH_SHOWING = 4
"""MAV_SEVERITY_WARNING: texts at least this severe go to the terminal too."""
_NOT_SURVIVED = "SIM:"
"""So begins a text about something that the real autopilot does not survive."""
_DOWN_US = 1_100_000
"""Without power: until the first heartbeat after it there is a gap of 2.1 s (ardupilot.md 5)."""
_NEAR_M = 3.0
"""Nearer to a thing than this, its distance is looked at in every step."""
_ALONG_M = 0.01
_THINGS = "a tree, wall, building or wire"
_OFF_GROUND_M = 0.3
"""Above the ground by this much a plane has taken off: what comes then is a landing, or none."""
_LOW_M = 20.0
"""Nobody sinks from here to the ground within a step."""
_SLOPE_M = 0.5
"""The ground's slope is that between points so far to either side."""
_FARTHEST_DOWN_M = 655.0
_OF_OBSTACLES = ("OBSTACLE_DISTANCE", "DISTANCE_SENSOR")


@final
class Simulation:
    """One vehicle, its autopilot, its radar and its links.

    What comes in by a link of `byte_streams` may be cut anywhere, as TCP does; a datagram may not.
    Of several vehicles on the same links one `forwards_all` between them, the others only what is
    for their own system.
    ``faults`` is the text of a timeline.  InputError for a parameter that the autopilot does not
    have, and for a fault that does not exist.
    """

    def __init__(
        self,
        world: World,
        *,
        seed: int = 0,
        links: int = 1,
        byte_streams: Container[int] = (),
        forwards_all: bool = True,
        faults: str = "",
    ) -> None:
        world = replace(world, vehicle=with_own_ids(world.vehicle))
        vehicle = world.vehicle
        self.now_us = 0
        """Since the start; the autopilot counts from its own boot."""
        self.companion: Sender | None = None
        """The first one on link 0 whose heartbeat was heard."""
        self.companion_ended = False
        self._question_ns = -1
        self.answered_ns = -1
        """Time of the newest lockstep question that was answered."""
        self.mistaken_ns = -1
        """The same, of the newest one that was answered with another tc1 than ts1."""
        self.not_survived: str | None = None
        """What came in that the real autopilot does not survive: the first of it."""
        self.on_message: Callable[[str], None] | None = None
        """Told the name of each message that comes in for the autopilot."""
        self._world, self._frame, self._seed = world, world.frame, seed
        self._terrain = world.truth()
        self._ground_amsl_m = self._terrain.height_at_amsl_m(vehicle.north_m, vehicle.east_m)
        self._scene = world.scene(self._terrain)
        self.nearest_m = self._near_m = math.inf
        """To a tree, wall, building or wire: the least of the whole flight; and the least since
        the last line of truth."""
        self._unwatched_m = 0.0
        self.crash: Crash | None = None
        """The first contact that nobody survives, with the ground or with a thing."""
        self._touches_ground, self._touches_thing, self._took_off = True, False, False
        place = self._frame.to_geographic(vehicle.north_m, vehicle.east_m)
        self._vehicle = make_vehicle(vehicle, *place, self._ground_amsl_m)
        self._plans = Plans()
        self._battery = Battery()
        self._personality = personality_of(vehicle)
        self._power = PowerModule(self._battery, self._personality.battery)
        self._wind = Wind(generator(seed, "wind"))
        self._notices: list[str] = []
        self._truth: list[str] = [truth.header(world, seed)]
        self._hardware_id = int(generator(seed, "hardware id").integers(1, 2**63))
        self._boots, self._port_change = 0, False
        reads_lidar = any(each.output == "autopilot" for each in world.lidars)
        given = {"PRX1_TYPE": RPLIDAR} if reads_lidar else {}
        autopilot = self._make_autopilot(given | overrides_of(vehicle))
        self._ids = ids_of(self._personality, autopilot.parameters)
        self._radio = self._make_radio(autopilot.profile, links, byte_streams, forwards_all)
        self._scanner = None if world.scanner is None else self._make_scanner(world.scanner)
        names = ("lidar", "second lidar")
        self._lidars = [self._make_lidar(*each) for each in zip(world.lidars, names, strict=False)]
        self._timeline = self._read_faults(faults)
        self._down_until_us, self._since_power_s = 0, 0.0
        self._boot(autopilot)
        self._shown = (self.mode_name, False)
        self._local_m = (vehicle.north_m, vehicle.east_m)
        self._rise_m_s = 0.0
        """How fast the ground below rises, as the vehicle moves over it."""
        self._measured_us, self._passed_ne = 0, (0.0, 0.0)
        self._look_down()
        self._must_stand_free()

    @property
    def plans(self) -> Plans:
        """Mission, fence and rally points as the autopilot stores them."""
        return self._plans

    def _read_faults(self, text: str) -> Timeline:
        firmware, latitude_deg = self._world.vehicle.autopilot, self._world.origin.latitude_deg
        return Timeline.parse(text, name="faults", firmware=firmware, latitude_deg=latitude_deg)

    def _must_stand_free(self) -> None:
        if self.nearest_m == 0.0:
            at = (self._world.vehicle.north_m, self._world.vehicle.east_m)
            rule = "stands inside a tree, wall, building or wire"
            raise InputError("vehicle.north_m, east_m", at, rule, "Move it, or clear the place.")

    def _make_radio(
        self, profile: FirmwareProfile, links: int, byte_streams: Container[int], forwards_all: bool
    ) -> Radio:
        world = self._world
        lidar = world.lidar
        system, component = self._ids
        for name, beside in (("scanner", world.scanner), ("lidar", lidar)):
            if beside is not None and beside.component_id == component:
                rule = "is the autopilot's own"
                raise InputError(f"{name}.component_id", component, rule, "Give another one.")
        return Radio(
            system=system,
            component=component,
            radar_component=None if world.scanner is None else world.scanner.component_id,
            lidar_component=lidar.component_id if lidar and lidar.output != "autopilot" else None,
            profile=profile,
            links=links,
            byte_streams=byte_streams,
            forwards_all=forwards_all,
            rng=generator(self._seed, "links"),
        )

    def _make_scanner(self, scanner: Scanner) -> RadarComponent:
        radar = TerrainRadar(self._terrain, self._frame, range_m=scanner.range_m)
        rng = generator(self._seed, "radar")
        return RadarComponent(radar, rng, self._radio, scanner.component_id)

    def _make_lidar(self, settings: LidarTable, name: str) -> tuple[Lidar, LidarDriver | None]:
        lidar = Lidar(self._scene, settings, generator(self._seed, name))
        if settings.output == "autopilot":
            return lidar, None
        rng = generator(self._seed, f"{name} driver")
        return lidar, LidarDriver(lidar, settings, rng, self._radio)

    def _make_autopilot(self, overrides: Mapping[str, float]) -> Autopilot:
        self._boots += 1
        rng, make = generator(self._seed, f"autopilot {self._boots}"), self._personality.autopilot
        autopilot = make(self._vehicle, overrides, self._plans, rng=rng)
        autopilot.battery = self._battery
        return autopilot

    def _boot(self, autopilot: Autopilot) -> None:
        """The flight controller and its receiver start, now."""
        self._controller = FlightController(
            autopilot,
            self._radio,
            self._battery,
            boot_us=self.now_us,
            hardware_id=self._hardware_id,
            on_text=self._on_text,
            ranging=self._make_ranging(autopilot.parameters),
        )
        rng = generator(self._seed, f"gps {self._boots}")
        self._gps = Gps(self._personality.receiver, rng)
        self._parameters = autopilot.parameters
        self._refresh()

    def _make_ranging(self, parameters: Parameters) -> RangeSensors | None:
        if "PRX1_TYPE" not in parameters:
            return None
        lidars, kind = self._world.lidars, int(parameters["PRX1_TYPE"])
        limits_m = (lidars[-1].min_m, lidars[-1].range_m) if lidars else (0.0, 0.0)
        return RangeSensors(parameters, Proximity(kind, *limits_m), self._range_down_m)

    def _place_nea_m(self) -> FloatArray:
        vehicle = self._vehicle
        local_m = self._frame.to_local(vehicle.latitude_deg, vehicle.longitude_deg)
        return np.array([*local_m, vehicle.altitude_amsl_m])

    def _range_down_m(self) -> float:
        """Along the body's downward axis, to whatever is there."""
        down = body_down_neu(self._vehicle)
        met_m = self._scene.ray_lengths_m(self._place_nea_m(), down[None], _FARTHEST_DOWN_M)
        return min(float(met_m[0]), _FARTHEST_DOWN_M)

    # --- to look at ---------------------------------------------------------------------------

    @property
    def ground_amsl_m(self) -> float:
        """Height of the ground below, as of the last look."""
        return self._ground_amsl_m

    @property
    def vehicle(self) -> Copter | Plane:
        """The truth: where it really is, and how it moves."""
        return self._vehicle

    @property
    def parameters(self) -> Parameters:
        """The autopilot's; a reboot makes new ones."""
        return self._parameters

    @property
    def mode_name(self) -> str:
        """The autopilot's mode."""
        return self._controller.autopilot.mode_name

    @property
    def _is_down(self) -> bool:
        """The autopilot has no power: it reboots."""
        return self.now_us < self._down_until_us

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        return self._controller.autopilot.armed and not self._is_down

    @property
    def landed(self) -> bool:
        """Whether it stands on the ground."""
        return self._touches_ground if self._is_down else self._controller.autopilot.landed

    @property
    def armable(self) -> bool:
        """Whether the autopilot is healthy and has a position to fly by."""
        autopilot = self._controller.autopilot
        return not self._is_down and autopilot.status().prearm_ok and autopilot.estimate.position_ok

    def outcome(self) -> str:
        """Where it is and what it does, in a few words."""
        north_m, east_m = self._local_m
        armed = "armed" if self.armed else "disarmed"
        where = "on the ground" if self.landed else "in the air"
        return (
            f"{round(north_m)} m north, {round(east_m)} m east, "
            f"{self._vehicle.altitude_amsl_m:.0f} m AMSL, {self.mode_name}, {armed}, {where}"
            + (
                ""
                if self.crash is None
                else f"; it hit {self.crash.into} at "
                f"{self.crash.speed_m_s:.1f} m/s, {self.crash.t_s:.1f} s"
            )
        )

    # --- out ----------------------------------------------------------------------------------

    def take_frames(self) -> list[tuple[int, bytes]]:
        """What is to be sent now: link and frame, in order."""
        return self._radio.take(self.now_us)

    def take_truth(self) -> list[str]:
        """New lines of the truth file."""
        lines, self._truth = self._truth, []
        return lines

    def take_notices(self) -> list[str]:
        """What a person watching would want to know."""
        notices, self._notices = self._notices, []
        return notices

    def take_port_change(self) -> bool:
        """Whether the autopilot has rebooted, so that it sends from another port now."""
        changed, self._port_change = self._port_change, False
        return changed

    def send_heartbeat(self) -> None:
        """Send all heartbeats now: time stands still until somebody answers."""
        self._controller.send_heartbeat()
        if self._scanner is not None:
            self._scanner.send_heartbeat()
        for _, driver in self._lidars:
            if driver is not None:
                driver.send_heartbeat()

    def begin(self) -> None:
        """Reset the frame counters: the number of heartbeats before depends on wall time."""
        self._radio.begin()

    def ask_for_sync(self, number: int = 0) -> int:
        """Queue the question that ends a lockstep tick; the answer carries its time (ns).

        As all that an autopilot says it counts from the boot.  Of vehicles on the same link each
        has its own number, so that their questions differ.
        """
        question_ns = max(self.now_us - self._controller.boot_us, 1) * 1000 + number
        self._question_ns = question_ns
        self._radio.send_last(messages.time_sync(0, question_ns), 0)
        return question_ns

    def ask_again(self) -> None:
        """Queue the last question once more, to the byte."""
        self._radio.send_last_again()

    def reopen(self, link: int) -> None:
        """Another client has connected to this link."""
        self._radio.reopen(link)

    @property
    def system_id(self) -> int:
        """Of the vehicle."""
        return self._ids[0]

    # --- what may go wrong --------------------------------------------------------------------

    def add_fault(self, line: str) -> None:
        """A fault from now on: a line of the timeline without its time ("for 3 s: gps_off")."""
        self._timeline.add(line, self.now_us)

    def set_parameter(self, name: str, value: float) -> None:
        """As PARAM_SET does it; KeyError if the autopilot has no such parameter."""
        self._parameters[name] = value
        if self._is_down:
            return
        self._controller.answer(self._controller.autopilot.on_parameter(name))

    def _refresh(self) -> None:
        """A parameter has changed: so may the weather have, and the links."""
        parameters = self._parameters
        one_shots = take_one_shots(parameters)
        self._conditions = conditions_of(parameters)
        self._seen_version = parameters.version
        self._controller.setpoints_ignored = self._conditions.setpoints_ignored
        self._controller.rangefinder_off = self._conditions.rangefinder_off
        self._radio.impair(self._conditions.link)
        if "MAV_OPTIONS" in parameters:
            self._radio.router.enforce = bool(int(parameters["MAV_OPTIONS"]) & 1)
            self._radio.router.ground_system = int(parameters["MAV_GCS_SYSID"])
        controller = self._controller
        for name, values in one_shots:
            match name:
                case "estimator_reset":
                    controller.answer(controller.autopilot.reset_estimate(*values))
                case "origin_move":
                    controller.answer(controller.autopilot.move_origin(*values))
                case "pilot":
                    controller.answer(controller.autopilot.pilot_takes())
                case "reboot":
                    self._go_down()
                case "ground_fence":
                    controller.add_to_fence(ground_station.new_fence(self._vehicle, *values))
                case "ground_command" | "ground_target":
                    self._ground_station_says(name, values)

    def _ground_station_says(self, name: str, values: tuple[float, ...]) -> None:
        component = 0 if self.companion is None else self.companion.component
        if name == "ground_target":
            to = (self.system_id, component, self._vehicle)
            to_autopilot, message = False, ground_station.new_target(*to, values)
        else:
            to_autopilot, message = ground_station.command(self.system_id, component, values)
        if to_autopilot:
            self._controller.receive(message, ground_station.STATION, self.now_us)
        else:
            self._radio.send_as(
                message, ground_station.STATION.system, ground_station.STATION.component
            )

    # --- time ---------------------------------------------------------------------------------

    def step(self) -> bool:
        """Fly for one step, queue what is due, and tell whether a lockstep tick is complete."""
        self.now_us = now_us = self.now_us + STEP_US
        if now_us >= self._timeline.next_us:
            for name, value in self._timeline.step(now_us, self._parameters):
                self.set_parameter(name, value)
        if self._parameters.version != self._seen_version:
            self._refresh()
        if self._radio.impaired:
            for received in self._radio.late(now_us):
                self._receive(received)
        looks = now_us % _LOOK_US == 0
        if looks:
            self._look_down()
        if now_us < self._down_until_us:
            complete = self._stay_down()
            for lidar, driver in self._lidars:
                self._step_lidar(lidar, driver)
            self._step_beside(complete)
            return complete
        controller, conditions, vehicle = self._controller, self._conditions, self._vehicle
        wind, gps = self._wind, self._gps
        if not wind.still or conditions.wind is not wind.conditions:
            wind.step(_STEP_S, vehicle, conditions.wind, self._ground_amsl_m)
        if now_us - controller.boot_us >= gps.due_us:
            gps.step(now_us - controller.boot_us, vehicle, conditions.gps)
        controller.now_us, controller.report.fix = now_us, gps.fix
        above_m, way = vehicle.altitude_amsl_m - self._ground_amsl_m, (0.0, 0.0, 0.0)
        if above_m < _LOW_M:
            way = self._way_m_s
            slow = above_m >= speed_m_s(way) * _LOOK_US * 1e-6
            if not (self._touches_ground or slow or looks):
                self._measure_ground()
        since_boot_us, ground_amsl_m = now_us - controller.boot_us, self._ground_amsl_m
        replies = controller.autopilot.step(since_boot_us, _STEP_S, ground_amsl_m, gps.fix)
        if replies or controller.transfers:
            controller.go_on(replies)
        self._since_power_s += _STEP_S
        if self._since_power_s >= POWER_STEP_S - 1e-9:
            armed, drained_s = controller.autopilot.armed, self._since_power_s
            self._power.step(drained_s, vehicle, armed, conditions.battery)
            self._since_power_s = 0.0
        if controller.wants_reboot:
            self._go_down()
        if above_m < _LOW_M:
            self._watch_ground(way)
        if not self._scene.empty:
            self._watch_near()
        for lidar, driver in self._lidars:
            self._step_lidar(lidar, driver)
        if controller.ranging is not None and controller.ranging.proximity.kind:
            controller.ranging.proximity.step(since_boot_us)
        complete = now_us >= controller.streams.soonest_us and controller.stream(now_us)
        if looks and not complete:  # without positions there are ticks all the same
            complete = controller.streams.interval_us(0, _POSITION) is None
        self._step_beside(complete)
        return complete

    def _step_beside(self, complete: bool) -> None:
        """What has its own power and its own computer: the radar."""
        now_us = self.now_us
        if self._scanner is not None and now_us >= self._scanner.due_us:
            self._scanner.step(now_us, self._vehicle, self._conditions.radar, tick=complete)

    def _step_lidar(self, lidar: Lidar, driver: LidarDriver | None) -> None:
        """Measure; what the autopilot gets of it, it gets at once."""
        controller = self._controller
        wrong, since_boot_us = self._conditions.lidar, self.now_us - controller.boot_us
        north_m, east_m, _ = self._place_nea_m()
        fired = lidar.step(self.now_us, self._vehicle, (north_m, east_m), wrong)
        hears = controller.ranging is not None and not self._is_down
        proximity = controller.ranging.proximity if controller.ranging and hears else None
        if driver is None:
            if proximity is not None and not wrong.silent:
                angles_rad, distances_m = lidar.angles_rad[fired], lidar.distances_m[fired]
                proximity.on_beams(angles_rad, distances_m, since_boot_us)
            return
        for message in driver.step(self.now_us, controller.boot_us, wrong):
            if proximity is not None and message.get_type() == "OBSTACLE_DISTANCE":
                proximity.on_obstacle_distance(message, since_boot_us)
            if wrong.mirrored and self.companion is not None:
                self._radio.send_as(message, self.companion.system, self.companion.component)

    def _watch_near(self) -> None:
        """How near it has come to anything; whoever touches something crashes."""
        way = self._way_m_s
        step_m = speed_m_s(way) * _STEP_S
        self._unwatched_m -= step_m
        if self._unwatched_m > 0.0:
            return
        here = self._place_nea_m()
        near_m = float(self._scene.distance_m(here)[0])
        self._unwatched_m = near_m - _NEAR_M
        if 0.0 < near_m < step_m:  # it may have flown through
            share = np.linspace(0.0, 1.0, math.ceil(step_m / _ALONG_M) + 1)[:, None]
            near_m = float(self._scene.distance_m(here - share * _STEP_S * np.array(way)).min())
        self._near_m = min(self._near_m, near_m)
        touches, self._touches_thing = self._touches_thing, near_m == 0.0
        if self._touches_thing and not touches and any(way):
            if self._touches_ground:
                self._vehicle.stand(self._ground_amsl_m)
            else:
                self._vehicle.hit()
            self._crashes(way, _THINGS)

    def _watch_ground(self, way: tuple[float, float, float]) -> None:
        """Whether it touches the ground, and survives that; its velocity before this step."""
        vehicle, touched = self._vehicle, self._touches_ground
        above_m = vehicle.altitude_amsl_m - self._ground_amsl_m
        self._touches_ground = above_m <= 0.0
        if not self._touches_ground:
            self._took_off = self._took_off or above_m > _OFF_GROUND_M
            return
        if touched and (self._measured_us != self.now_us or not any(way)):
            return
        if touched:  # it rolls: along the ground, as that was
            way = (way[0], way[1], self._rise_before_m_s)
        lands, self._took_off = self._took_off, False
        if self._is_crash(way, lands=lands):
            vehicle.stand(self._ground_amsl_m)
            self._crashes(way, "the ground")

    def _is_crash(self, way: tuple[float, float, float], *, lands: bool) -> bool:
        """By the slope about here, or by that of the way here, whichever is worse: a step up."""
        rolls = self._world.vehicle.kind == "plane"
        (north_m, east_m), height_m = self._local_m, self._terrain.height_at_amsl_m
        north = height_m(north_m + _SLOPE_M, east_m) - height_m(north_m - _SLOPE_M, east_m)
        east = height_m(north_m, east_m + _SLOPE_M) - height_m(north_m, east_m - _SLOPE_M)
        about = (north / (2.0 * _SLOPE_M), east / (2.0 * _SLOPE_M))
        slopes = (about, self._passed_ne)
        return any(is_crash(way, each, rolls=rolls, lands=lands) for each in slopes)

    def _crashes(self, way: tuple[float, float, float], into: str) -> None:
        speed = speed_m_s(way)
        self._notice(f"it hits {into} at {speed:.1f} m/s")
        if self.crash is None:
            north_m, east_m, altitude_m = self._place_nea_m().tolist()
            self.crash = Crash(self.now_us * 1e-6, north_m, east_m, altitude_m, speed, into)
        if not self._is_down:
            self._controller.answer(self._controller.autopilot.crash())

    @property
    def _way_m_s(self) -> tuple[float, float, float]:
        """Velocity to the north, east and up."""
        vehicle = self._vehicle
        return vehicle.velocity_north_m_s, vehicle.velocity_east_m_s, vehicle.velocity_up_m_s

    def _measure_ground(self) -> None:
        """Where it is in the world, and how high the ground is there."""
        vehicle = self._vehicle
        (before_n, before_e), before_m = self._local_m, self._ground_amsl_m
        self._local_m = self._frame.to_local(vehicle.latitude_deg, vehicle.longitude_deg)
        self._ground_amsl_m = self._terrain.height_at_amsl_m(*self._local_m)
        north_m, east_m = self._local_m[0] - before_n, self._local_m[1] - before_e
        passed_m, rise_m = math.hypot(north_m, east_m), self._ground_amsl_m - before_m
        self._passed_ne = (0.0, 0.0)
        if passed_m > 1e-3:
            slope = rise_m / passed_m
            self._passed_ne = (slope * north_m / passed_m, slope * east_m / passed_m)
        lasted_s = (self.now_us - self._measured_us) * 1e-6
        self._rise_before_m_s, self._measured_us = self._rise_m_s, self.now_us
        self._rise_m_s = rise_m / lasted_s if lasted_s > 0.0 else 0.0

    def _look_down(self) -> None:
        """Where it is in the world, how high the ground is there; one line of truth."""
        vehicle = self._vehicle
        self._measure_ground()
        near_m = None
        if not self._scene.empty:
            here = (*self._local_m, vehicle.altitude_amsl_m)
            near_m = min(self._near_m, float(self._scene.distance_m(np.array(here))[0]))
            self.nearest_m, self._near_m = min(self.nearest_m, near_m), math.inf
        line = truth.line(
            self.now_us,
            self._local_m,
            vehicle,
            (self.mode_name, self.armed, self.landed),
            near_m,
            self.crash,
        )
        self._truth.append(line)
        shown = (self.mode_name, self.armed)
        if shown != self._shown:
            self._shown = shown
            self._notice(f"{shown[0]}, {'armed' if shown[1] else 'disarmed'}")

    def _notice(self, what: str) -> None:
        self._notices.append(f"{self.now_us * 1e-6:9.1f} s  {what}")

    def _on_text(self, text: Text) -> None:
        if text.severity <= _WORTH_SHOWING:
            self._notice(text.text)
        if text.text.startswith(_NOT_SURVIVED) and self.not_survived is None:
            self.not_survived = text.text

    def _go_down(self) -> None:
        """The flight controller loses power."""
        self._notice("the autopilot reboots")
        self._down_until_us = self.now_us + _DOWN_US
        self._radio.restart()

    def _stay_down(self) -> bool:
        """One step without an autopilot: in the air it falls, and is back when it lies."""
        vehicle, way = self._vehicle, self._way_m_s
        if vehicle.altitude_amsl_m > self._ground_amsl_m:
            vehicle.fall(_STEP_S)
            self._down_until_us = max(self._down_until_us, self.now_us + 2 * STEP_US)
        self._watch_ground(way)
        if not self._scene.empty:
            self._watch_near()
        if vehicle.altitude_amsl_m <= self._ground_amsl_m:
            vehicle.stand(self._ground_amsl_m)
        if self.now_us + STEP_US >= self._down_until_us:
            autopilot = self._make_autopilot(self._parameters.values())
            self._ids = ids_of(self._personality, autopilot.parameters)
            self._radio.boot_as(*self._ids)
            self._boot(autopilot)
            self._port_change = True
        return self.now_us % _LOOK_US == 0

    # --- in -----------------------------------------------------------------------------------

    def receive(self, link: int, data: bytes) -> None:
        """Handle everything in this datagram or piece of stream, at the present vehicle time."""
        for received in self._radio.receive(self.now_us, link, data):
            self._receive(received)

    def _receive(self, received: Received) -> None:
        message = received.message
        sender = messages.sender(message, received.link)
        if received.to_radar and self._scanner is not None:
            self._scanner.receive(message, sender)
        kind = message.get_type()
        if kind == "TIMESYNC" and message.ts1 == self._question_ns and sender.link == 0:
            if message.tc1 == message.ts1:
                self.answered_ns = message.ts1
            elif message.tc1 != 0:
                self.mistaken_ns = message.ts1
        if not received.to_autopilot or self._is_down:
            return
        if kind == "HEARTBEAT" and sender.link == 0:
            self._meet(sender, message.system_status)
        if self._conditions.lidar.mirrored and kind in _OF_OBSTACLES:
            self._radio.send_back(received)
        self._controller.receive(message, sender, self.now_us)
        if self.on_message is not None:
            self.on_message(kind)

    def _meet(self, sender: Sender, system_status: int) -> None:
        if self.companion is None:
            self.companion = sender
            self._notice(f"heard {sender.system}/{sender.component}")
        if sender == self.companion and system_status == _POWEROFF:
            self.companion_ended = True
