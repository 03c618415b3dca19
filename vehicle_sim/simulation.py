"""One vehicle without sockets or clock: bytes in, steps of vehicle time, frames out.

Here its parts meet: the world and its faults, the vehicle, its sensors, the flight controller, the
terrain radar and the radio.
"""

from collections.abc import Callable, Container, Mapping
from typing import Any, Final, final

from vehicle_sim import ground_station, truth
from vehicle_sim.autopilot.core import Boot
from vehicle_sim.autopilot.factory import ids_of, make_vehicle, overrides_of, personality_of
from vehicle_sim.autopilot.values import Sender, Text
from vehicle_sim.dynamics.battery import POWER_STEP_S, Battery
from vehicle_sim.dynamics.contact import LOOK_US, Contact, Crash
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.dynamics.wind import Wind
from vehicle_sim.errors import InputError
from vehicle_sim.faults import Happening, Timeline, conditions_of
from vehicle_sim.flight_controller import FlightController
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.parameters import Parameters
from vehicle_sim.plans import Plans
from vehicle_sim.rng import generator
from vehicle_sim.sensors.gps import Gps
from vehicle_sim.sensors.lidar import Lidar, body_axes_neu
from vehicle_sim.sensors.terrain_radar import TerrainRadar
from vehicle_sim.wire.components import LidarDriver, RadarComponent
from vehicle_sim.wire.frames import make
from vehicle_sim.wire.proximity import RPLIDAR, RangeSensors
from vehicle_sim.wire.radio import Radio
from vehicle_sim.wire.routing import Route, Router
from vehicle_sim.wire.signing import Signing
from vehicle_sim.world import World

STEP_US: Final = 10_000
_STEP_S: Final = STEP_US * 1e-6
_POSITION: Final = 33
_POWEROFF: Final = 7
_WORTH_SHOWING: Final = 4
"""MAV_SEVERITY_WARNING: texts at least this severe go to the terminal too."""
_NOT_SURVIVED: Final = "SIM:"
"""So begins a text about something that the real autopilot does not survive."""
_DOWN_US: Final = 1_100_000
"""Without power: until the first heartbeat after it there is a gap of 2.1 s (ardupilot.md 5)."""
_FARTHEST_DOWN_M: Final = 655.0


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
        table, scene = world.vehicle, world.scene()
        terrain = scene.terrain
        self._world, self._seed, self._personality = world, seed, personality_of(table)
        self.now_us = 0
        """Since the start; the autopilot counts from its own boot."""
        self.companion: Sender | None = None
        """The first one on link 0 whose heartbeat was heard."""
        self.companion_ended = False
        self._question_ns = -1
        """Time of lockstep's question until it is answered."""
        self.not_survived: str | None = None
        """What came in that the real autopilot does not survive: the first of it."""
        self.on_message: Callable[[str], None] | None = None
        """Told the name of each message that comes in for the autopilot."""
        self.crash: Crash | None = None
        """The first contact that nobody survives, with the ground or with a thing."""
        self._notices, self._truth = list[str](), [truth.header(world, seed)]

        place = world.frame.to_geographic(table.north_m, table.east_m)
        ground_amsl_m = terrain.height_at_amsl_m(table.north_m, table.east_m)
        self.vehicle: Copter | Plane = make_vehicle(table, *place, ground_amsl_m)
        """The truth: where it really is, and how it moves."""
        rolls = table.kind == "plane"
        self.contact = Contact(
            self.vehicle, scene, world.frame, rolls=rolls, on_crash=self._on_crash
        )
        """Where it is in the world, and how near to the ground and to things."""
        self._wind = Wind(generator(seed, "wind"))
        self._battery = Battery(model=self._personality.battery)
        self.plans = Plans()
        """Mission, fence and rally points as the autopilot stores them."""
        self._timeline = Timeline(faults, name="faults")
        self._boots = self._down_until_us = 0
        self._hardware_id = int(generator(seed, "hardware id").integers(1, 2**63))
        scanner, lidars = world.scanner, world.lidars
        self._radio = Radio(
            Router(scanner.component_id if scanner else None, forwards_all=forwards_all),
            None if self._personality.firmware.family == "px4" else Signing(),
            self._receive,
            links=links,
            byte_streams=byte_streams,
            rng=generator(seed, "links"),
        )
        self._scanner: RadarComponent | None = None
        if scanner:
            radar = TerrainRadar(terrain, world.frame, range_m=scanner.range_m)
            rng = generator(seed, "radar")
            self._scanner = RadarComponent(radar, rng, self._radio, scanner.component_id)
        self._lidars = list[tuple[Lidar, LidarDriver | None]]()
        for fitted, name in zip(lidars, ("lidar", "second lidar"), strict=False):
            lidar, driver = Lidar(scene, fitted, generator(seed, name)), None
            if fitted.output == "driver":
                driver = LidarDriver(lidar, fitted, generator(seed, f"{name} driver"), self._radio)
            self._lidars.append((lidar, driver))
        own_lidar = {"PRX1_TYPE": RPLIDAR} if any(d is None for _, d in self._lidars) else {}
        self._boot(own_lidar | overrides_of(table))
        self._shown = (self.mode_name, False)
        self._look()
        if self.contact.nearest_m == 0.0:
            rule = "stands inside a tree, wall, building or wire"
            at = (table.north_m, table.east_m)
            raise InputError("vehicle.north_m, east_m", at, rule, "Move it, or clear the place.")

    def _boot(self, overrides: Mapping[str, float]) -> None:
        """The flight controller and its receiver start, now, with these parameters."""
        self._boots += 1
        rng = generator(self._seed, f"autopilot {self._boots}")
        boot = Boot(self._personality.firmware, self.vehicle, overrides, self.plans, rng)
        autopilot = self._personality.make(boot)
        autopilot.battery = self._battery
        self.parameters: Parameters = autopilot.parameters
        """The autopilot's; a reboot makes new ones."""
        self._radio.router.boot_as(*ids_of(self._personality, self.parameters))
        own = [lidar for lidar in self._world.lidars if lidar.output == "autopilot"]
        limits_m = (own[0].min_m, own[0].range_m) if own else (0.0, 0.0)
        self._controller = FlightController(
            autopilot,
            self._radio,
            boot_us=self.now_us,
            hardware_id=self._hardware_id,
            on_text=self._on_text,
            ranging=RangeSensors(self.parameters, limits_m, self._range_down_m),
        )
        self._gps = Gps(self._personality.receiver, generator(self._seed, f"gps {self._boots}"))
        self._refresh()

    def warm_up(self) -> None:
        """Look once with every sensor, so that nobody waits for a compiler in flight."""
        vehicle = self.vehicle
        self._range_down_m()
        if self._scanner is not None:
            at = {"latitude_deg": vehicle.latitude_deg, "longitude_deg": vehicle.longitude_deg}
            self._scanner.radar.answer(LocalFrame(**at), 1, 1, vehicle)

    # --- to look at ---------------------------------------------------------------------------

    def _range_down_m(self) -> float:
        """Along the body's downward axis, to whatever is there."""
        down, scene = body_axes_neu(self.vehicle)[2:], self.contact.scene
        met_m = scene.ray_lengths_m(self.contact.place_nea_m(), down, _FARTHEST_DOWN_M)
        return min(float(met_m[0]), _FARTHEST_DOWN_M)

    @property
    def mode_name(self) -> str:
        """The autopilot's mode."""
        return self._controller.autopilot.mode.name

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
        return self.vehicle.stands if self._is_down else self._controller.autopilot.landed

    @property
    def armable(self) -> bool:
        """Whether the autopilot is healthy and has a position to fly by."""
        autopilot = self._controller.autopilot
        return not self._is_down and autopilot.status().prearm_ok and autopilot.estimate.position_ok

    def outcome(self) -> str:
        """Where it is and what it does, in a few words."""
        (north_m, east_m), crash = self.contact.local_m, self.crash
        words = (
            f"{round(north_m)} m north, {round(east_m)} m east, "
            f"{self.vehicle.altitude_amsl_m:.0f} m AMSL, {self.mode_name}, "
            f"{'armed' if self.armed else 'disarmed'}, "
            f"{'on the ground' if self.landed else 'in the air'}"
        )
        if crash is None:
            return words
        return f"{words}; it hit {crash.into} at {crash.speed_m_s:.1f} m/s, {crash.t_s:.1f} s"

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

    def send_heartbeat(self) -> None:
        """Send all heartbeats now: time stands still until somebody answers."""
        for part in (self._controller, self._scanner, *(driver for _, driver in self._lidars)):
            if part is not None:
                part.send_heartbeat()

    def begin(self) -> None:
        """Reset the frame counters: the number of heartbeats before depends on wall time."""
        self._radio.begin()

    def ask_for_sync(self, number: int = 0) -> int:
        """Queue the question that ends a lockstep tick; the answer carries its time (ns).

        As all that an autopilot says it counts from the boot.  Of vehicles on the same link each
        has its own number, so that their questions differ.
        """
        self._question_ns = max(self.now_us - self._controller.boot_us, 1) * 1000 + number
        self._radio.ask(make("TIMESYNC", 0, self._question_ns), 0)
        return self._question_ns

    @property
    def waits(self) -> bool:
        """Lockstep: no companion was heard yet, or the last question is not answered."""
        return self.companion is None or (self._question_ns > 0 and not self.companion_ended)

    def ask_again(self) -> None:
        """Queue what it waits for once more: heartbeats, or the last question to the byte."""
        if self.companion is None:
            self.send_heartbeat()
        self._radio.ask_again()

    def _notice(self, what: str) -> None:
        self._notices.append(f"{self.now_us * 1e-6:9.1f} s  {what}")

    def _on_text(self, text: Text) -> None:
        if text.severity <= _WORTH_SHOWING:
            self._notice(text.text)
        if text.text.startswith(_NOT_SURVIVED):
            self.not_survived = self.not_survived or text.text

    def _on_crash(self, crash: Crash) -> None:
        self._notice(f"it hits {crash.into} at {crash.speed_m_s:.1f} m/s")
        self.crash = self.crash or crash
        if not self._is_down:
            self._controller.answer(self._controller.autopilot.crash())

    def _look(self) -> None:
        """Where it is in the world, how high the ground is there; one line of truth."""
        near_m = self.contact.look(self.now_us)
        mode, armed = shown = self.mode_name, self.armed
        state, local_m = (mode, armed, self.landed), self.contact.local_m
        estimate, believed = self._controller.autopilot.estimate, None
        if estimate.position_ok and not self._is_down:
            at_ne_m = self._world.frame.to_local(estimate.latitude_deg, estimate.longitude_deg)
            believed = (*at_ne_m, estimate.altitude_amsl_m)
        line = truth.line(self.now_us, local_m, self.vehicle, state, near_m, believed, self.crash)
        self._truth.append(line)
        if shown != self._shown:
            self._shown = shown
            self._notice(f"{mode}, {'armed' if armed else 'disarmed'}")

    # --- what may go wrong --------------------------------------------------------------------

    def add_fault(self, line: str) -> None:
        """A fault from now on: a line of the timeline without its time ("for 3 s: gps_off")."""
        self._timeline.add(line, self.now_us)

    def set_parameter(self, name: str, value: float) -> None:
        """As PARAM_SET does it; KeyError if the autopilot has no such parameter."""
        self.parameters[name] = value

    def _refresh(self) -> None:
        """A parameter or a fault is another one: so may the weather be, and the links."""
        parameters, controller = self.parameters, self._controller
        self._seen_version = parameters.version
        self._conditions = now = conditions_of(parameters, self._timeline.lasting)
        controller.setpoints_ignored = now.autopilot.setpoints_ignored
        controller.ranging.rangefinder_off = now.autopilot.rangefinder_off
        self._radio.impair(now.link)

    def _happens(self, happening: Happening) -> None:
        """A fault that happens once."""
        controller, autopilot = self._controller, self._controller.autopilot
        match happening.name:
            case "estimator_reset":
                autopilot.estimate.shift(*happening.by_m[:2])
            case "origin_move":
                controller.answer(autopilot.move_origin(*happening.by_m))
            case "pilot":
                autopilot.set_mode(autopilot.firmware.pilot)
            case "reboot":
                self._go_down()
            case "ground_fence":
                controller.add_to_fence(ground_station.new_fence(happening, self.vehicle))
            case _ if happening.to_autopilot:
                order = ground_station.order(happening, self.vehicle, *self._radio.router.ids)
                controller.receive(order, ground_station.STATION, self.now_us)
            case _:
                to = self._radio.router.ids[0], self.companion.component if self.companion else 0
                order = ground_station.order(happening, self.vehicle, *to)
                self._radio.send(order, source=ground_station.STATION[:2])

    # --- time ---------------------------------------------------------------------------------

    def step(self) -> bool:
        """Fly for one step, queue what is due, and tell whether a lockstep tick is complete."""
        self.now_us = now_us = self.now_us + STEP_US
        if now_us >= self._timeline.next_us:
            happening = self._timeline.step(now_us)
            self._refresh()
            for event in happening:
                self._happens(event)
        elif self.parameters.version != self._seen_version:
            self._refresh()
        if self._radio.impaired:
            self._radio.late(now_us)
        looks, contact = now_us % LOOK_US == 0, self.contact
        if looks:
            self._look()
        contact.prepare(now_us)
        if now_us < self._down_until_us:
            complete = looks
            self._fall()
        else:
            self._fly(now_us, looks)
            contact.settle(now_us, _STEP_S)
            complete = False
        for lidar, driver in self._lidars:
            self._step_lidar(lidar, driver)
        if now_us >= self._down_until_us:
            streams = self._controller.streams
            complete = now_us >= streams.soonest_us and self._controller.stream()
            if looks and not complete:  # without positions there are ticks all the same
                complete = not streams.interval_us(0, _POSITION)
        # the radar has its own power and its own computer
        if self._scanner is not None and now_us >= self._scanner.due_us:
            self._scanner.step(now_us, self.vehicle, self._conditions.radar, tick=complete)
        return complete

    def _fly(self, now_us: int, looks: bool) -> None:
        """One step of the air, the receiver, the autopilot and what it drives."""
        controller, conditions, vehicle = self._controller, self._conditions, self.vehicle
        wind, gps, ground_amsl_m = self._wind, self._gps, self.contact.ground_amsl_m
        if not wind.still or conditions.wind is not wind.conditions:
            wind.step(_STEP_S, vehicle, conditions.wind, ground_amsl_m)
        since_boot_us = now_us - controller.boot_us
        if since_boot_us >= gps.due_us:
            gps.step(since_boot_us, vehicle, conditions.gps)
        controller.now_us = now_us
        replies = controller.autopilot.step(since_boot_us, _STEP_S, ground_amsl_m, gps.fix)
        controller.answer(replies)
        if looks:
            controller.answer(controller.missions.step(now_us))
            armed = controller.autopilot.armed
            self._battery.step(POWER_STEP_S, vehicle, armed, conditions.battery)
        if controller.wants_reboot:
            self._go_down()

    def _step_lidar(self, lidar: Lidar, driver: LidarDriver | None) -> None:
        """Measure; what the autopilot gets of it, it gets at once."""
        controller = self._controller
        wrong, since_boot_us = self._conditions.lidar, self.now_us - controller.boot_us
        north_m, east_m, _ = self.contact.place_nea_m()
        fired = lidar.step(self.now_us, self.vehicle, (north_m, east_m), wrong)
        if driver is not None:
            driver.step(self.now_us, controller.boot_us, wrong)
        elif controller.ranging.has_lidar and not (self._is_down or wrong.silent):
            angles_rad, distances_m = lidar.angles_rad[fired], lidar.distances_m[fired]
            controller.ranging.on_beams(angles_rad, distances_m, since_boot_us)

    def _go_down(self) -> None:
        """The flight controller loses power."""
        self._notice("the autopilot reboots")
        self._down_until_us = self.now_us + _DOWN_US

    def _fall(self) -> None:
        """One step without an autopilot: in the air it falls, and is back when it lies."""
        vehicle, contact = self.vehicle, self.contact
        if vehicle.altitude_amsl_m > contact.ground_amsl_m:
            vehicle.fall(_STEP_S)
            self._down_until_us = max(self._down_until_us, self.now_us + 2 * STEP_US)
        contact.settle(self.now_us, _STEP_S)
        if vehicle.altitude_amsl_m <= contact.ground_amsl_m:
            vehicle.stand(contact.ground_amsl_m)
        if self.now_us + STEP_US >= self._down_until_us:
            self._boot(self.parameters)

    # --- in -----------------------------------------------------------------------------------

    def receive(self, link: int, data: bytes) -> None:
        """Handle everything in this datagram or piece of stream, at the present vehicle time."""
        self._radio.receive(self.now_us, link, data)

    def _receive(self, sender: Sender, message: Any, route: Route) -> None:
        if route.to_radar and self._scanner is not None:
            self._scanner.receive(message, sender)
        kind = message.get_type()
        answers = kind == "TIMESYNC" and message.tc1 == message.ts1 == self._question_ns
        if answers and sender.link == 0:
            self._question_ns = -1
        if not route.to_autopilot or self._is_down:
            return
        if kind == "HEARTBEAT" and sender.link == 0:
            if self.companion is None:
                self.companion = sender
                self._notice(f"heard {sender.system}/{sender.component}")
            if sender == self.companion and message.system_status == _POWEROFF:
                self.companion_ended = True
        self._controller.receive(message, sender, self.now_us)
        if self.on_message is not None:
            self.on_message(kind)
