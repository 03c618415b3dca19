"""The whole vehicle without sockets or clock: datagrams in, steps of vehicle time, frames out."""

import math
from typing import assert_never, final

from vehicle_sim import telemetry, truth, wire
from vehicle_sim.autopilots import Ack, Command, Interval, Reply, Report, Sender, Setpoint, Text
from vehicle_sim.autopilots.ardupilot import ArduCopter
from vehicle_sim.autopilots.guided import Tuning
from vehicle_sim.chance import generator
from vehicle_sim.dynamics import Copter, Limits
from vehicle_sim.sensors import ScanRequest, TerrainRadar, Viewpoint
from vehicle_sim.world import Vehicle, World

STEP_US = 10_000
_STEP_S = STEP_US * 1e-6
_HEARTBEAT, _POSITION = 0, 33
_HEARTBEAT_US = 1_000_000
_POWEROFF = 7
_UNSUPPORTED = 3
_WORTH_SHOWING = 4
"""MAV_SEVERITY_WARNING: texts at least this severe go to the terminal too."""


@final
class Simulation:
    """One vehicle, its autopilot, its radar and its link."""

    def __init__(self, world: World, *, seed: int = 0) -> None:
        vehicle = world.vehicle
        self.now_us = 0
        self.companion: Sender | None = None
        """The first one whose heartbeat was heard."""
        self.companion_ended = False
        self.answered_ns = -1
        """Vehicle time of the newest lockstep question that was answered."""
        self._frame = world.frame
        self._terrain = world.truth()
        self._ground_amsl_m = self._terrain.height_at_amsl_m(vehicle.north_m, vehicle.east_m)
        latitude_deg, longitude_deg = self._frame.to_geographic(vehicle.north_m, vehicle.east_m)
        self._copter = Copter(
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            altitude_amsl_m=self._ground_amsl_m,
            limits=_limits(vehicle),
        )
        self._autopilot = ArduCopter(
            self._copter,
            _tuning(vehicle),
            heading_rad=math.radians(vehicle.heading_deg),
            hardware_id=int(generator(seed, "hardware id").integers(1, 2**63)),
        )
        self._radar_component = world.scanner.component_id
        self._radar = TerrainRadar(self._terrain, self._frame, range_m=world.scanner.range_m)
        self._scan: ScanRequest | None = None
        self._parser = wire.Parser(vehicle.system_id, world.scanner.component_id)
        self._autopilot_packer = wire.Packer(vehicle.system_id, wire.AUTOPILOT_COMPONENT)
        self._radar_packer = wire.Packer(vehicle.system_id, world.scanner.component_id)
        self._streams: dict[int, tuple[int, int]] = {_HEARTBEAT: (_HEARTBEAT_US, _HEARTBEAT_US)}
        """Of this link: interval and next time, by message number, both in microseconds."""
        self._radar_beat_us = _HEARTBEAT_US
        self._soonest_us = _HEARTBEAT_US
        self._outbox: list[bytes] = []
        self._notices: list[str] = []
        self._shown = (self._autopilot.mode_name, False)
        self._truth: list[str] = [truth.header(world, seed)]
        self._look_down()

    # --- out ----------------------------------------------------------------------------------

    def take_frames(self) -> list[bytes]:
        """What is to be sent now, in order."""
        frames, self._outbox = self._outbox, []
        return frames

    def take_truth(self) -> list[str]:
        """New lines of the truth file."""
        lines, self._truth = self._truth, []
        return lines

    def take_notices(self) -> list[str]:
        """What a person watching would want to know."""
        notices, self._notices = self._notices, []
        return notices

    def outcome(self) -> str:
        """Where it is and what it does, in a few words."""
        north_m, east_m = self._local_m
        copter, autopilot = self._copter, self._autopilot
        armed = "armed" if autopilot.armed else "disarmed"
        where = "on the ground" if autopilot.landed else "in the air"
        return (
            f"north {round(north_m):,} m, east {round(east_m):,} m, "
            f"{round(copter.altitude_amsl_m):,} m AMSL, "
            f"{autopilot.mode_name}, {armed}, {where}"
        )

    # --- time ---------------------------------------------------------------------------------

    def say_hello(self) -> None:
        """Both heartbeats, out of turn."""
        report = self._autopilot.report()
        self._outbox.append(self._autopilot_packer.frame(telemetry.heartbeat(report)))
        self._outbox.append(self._radar_packer.frame(wire.radar_heartbeat()))

    def begin(self) -> None:
        """Count frames from here: how often hello was said depends on wall time."""
        self._autopilot_packer.restart()
        self._radar_packer.restart()

    def step(self) -> bool:
        """Fly for one step, queue what is due, and tell whether a tick is complete."""
        self.now_us = now_us = self.now_us + STEP_US
        for reply in self._autopilot.step(now_us, _STEP_S, self._ground_amsl_m):
            self._reply(reply)
        if now_us % truth.INTERVAL_US == 0:
            self._look_down()
        positioned = self._stream() if now_us >= self._soonest_us else False
        complete = positioned if _POSITION in self._streams else now_us % truth.INTERVAL_US == 0
        if complete and self._scan is not None:
            self._answer_scan(self._scan)
        return complete

    def ask_for_sync(self) -> int:
        """Queue the question that ends a tick; the answer carries this time in nanoseconds."""
        now_ns = self.now_us * 1000
        self._outbox.append(self._autopilot_packer.frame(wire.time_sync(0, now_ns)))
        return now_ns

    def _look_down(self) -> None:
        """Where it is in the world, how high the ground is there; one line of truth."""
        copter = self._copter
        self._local_m = self._frame.to_local(copter.latitude_deg, copter.longitude_deg)
        self._ground_amsl_m = self._terrain.height_at_amsl_m(*self._local_m)
        self._truth.append(truth.line(self.now_us, self._local_m, copter, self._autopilot))
        shown = (self._autopilot.mode_name, self._autopilot.armed)
        if shown != self._shown:
            self._shown = shown
            self._notice(f"{shown[0]}, {'armed' if shown[1] else 'disarmed'}")

    def _notice(self, what: str) -> None:
        self._notices.append(f"{self.now_us * 1e-6:9.1f} s  {what}")

    def _stream(self) -> bool:
        """Queue all telemetry that is due; tell whether a position was."""
        now_us, report, positioned = self.now_us, self._autopilot.report(), False
        for number, (interval_us, due_us) in self._streams.items():
            if due_us > now_us:
                continue
            self._send(number, report)
            positioned = positioned or number == _POSITION
            missed = (now_us - due_us) // interval_us
            self._streams[number] = (interval_us, due_us + (missed + 1) * interval_us)
        if self._radar_beat_us <= now_us:
            self._outbox.append(self._radar_packer.frame(wire.radar_heartbeat()))
            self._radar_beat_us += _HEARTBEAT_US
        self._find_soonest()
        return positioned

    def _find_soonest(self) -> None:
        due = [due_us for _, due_us in self._streams.values()]
        self._soonest_us = min([self._radar_beat_us, *due])

    def _send(self, number: int, report: Report) -> None:
        message = telemetry.MESSAGES[number](report)
        if message is not None:
            self._outbox.append(self._autopilot_packer.frame(message))

    def _answer_scan(self, request: ScanRequest) -> None:
        """All blocks, then the report that says that this was all."""
        self._scan = None
        copter, radar = self._copter, self._radar
        view = Viewpoint(
            latitude_deg=copter.latitude_deg,
            longitude_deg=copter.longitude_deg,
            altitude_amsl_m=copter.altitude_amsl_m,
        )
        blocks = radar.answer(request, view)
        pack = self._radar_packer.frame
        self._outbox += [pack(wire.terrain_data(request, block)) for block in blocks]
        ground_amsl_m = radar.height_amsl_m(request.latitude_deg, request.longitude_deg)
        report = wire.terrain_report(
            request,
            ground_amsl_m=ground_amsl_m,
            above_ground_m=copter.altitude_amsl_m - ground_amsl_m,
            blocks=len(blocks),
        )
        self._outbox.append(pack(report))

    # --- in -----------------------------------------------------------------------------------

    def receive(self, datagram: bytes) -> None:
        """Handle everything in this datagram, at the present vehicle time."""
        for item in self._parser.parse(datagram):
            match item:
                case Setpoint():
                    self._reply_all(self._autopilot.on_setpoint(item))
                case wire.TimeSync():
                    self._on_time_sync(item)
                case wire.Heartbeat():
                    self._on_heartbeat(item)
                case Command():
                    self._on_command(item)
                case ScanRequest():
                    self._scan = item
                case _:
                    assert_never(item)

    def _on_time_sync(self, item: wire.TimeSync) -> None:
        if item.tc1_ns == 0:
            answer = wire.time_sync(self.now_us * 1000, item.ts1_ns)
            self._outbox.append(self._autopilot_packer.frame(answer))
        elif item.tc1_ns == item.ts1_ns:
            self.answered_ns = item.ts1_ns

    def _on_heartbeat(self, item: wire.Heartbeat) -> None:
        if self.companion is None:
            self.companion = item.sender
            self._notice(f"heard {item.sender.system}/{item.sender.component}")
        if item.sender == self.companion and item.system_status == _POWEROFF:
            self.companion_ended = True

    def _on_command(self, item: Command) -> None:
        if item.target_component == self._radar_component:
            refusal = Ack(to=item.sender, command=item.number, result=_UNSUPPORTED)
            self._outbox.append(self._radar_packer.frame(wire.ack(refusal)))
        else:
            self._reply_all(self._autopilot.on_command(item))

    def _reply_all(self, replies: list[Reply]) -> None:
        for reply in replies:
            self._reply(reply)

    def _reply(self, reply: Reply) -> None:
        match reply:
            case Ack():
                self._outbox.append(self._autopilot_packer.frame(wire.ack(reply)))
            case Text():
                if self.companion is not None:  # ArduPilot is silent until somebody was heard
                    self._outbox.append(self._autopilot_packer.frame(wire.text(reply)))
                if reply.severity <= _WORTH_SHOWING:
                    self._notice(reply.text)
            case Interval(message=number, interval_us=0):
                self._streams.pop(number, None)
                self._find_soonest()
            case Interval(message=number, interval_us=interval_us):
                self._streams[number] = (interval_us, self.now_us + interval_us)
                self._streams = dict(sorted(self._streams.items()))
                self._find_soonest()
            case _:
                self._send(reply.message, self._autopilot.report())


def _limits(vehicle: Vehicle) -> Limits:
    return Limits(
        speed_m_s=vehicle.speed_max_m_s,
        acceleration_m_s2=vehicle.acceleration_max_m_s2,
        speed_vertical_m_s=vehicle.speed_vertical_max_m_s,
        acceleration_vertical_m_s2=vehicle.acceleration_vertical_max_m_s2,
    )


def _tuning(vehicle: Vehicle) -> Tuning:
    """ArduPilot's parameters in SI units."""
    parameters, fastest_m_s = vehicle.parameters, vehicle.speed_vertical_max_m_s
    up_cm_s, down_cm_s = parameters.WPNAV_SPEED_UP, parameters.WPNAV_SPEED_DN
    return Tuning(
        timeout_s=parameters.GUID_TIMEOUT,
        speed_m_s=parameters.WPNAV_SPEED / 100.0,
        acceleration_m_s2=parameters.WPNAV_ACCEL / 100.0,
        jerk_m_s3=parameters.PSC_JERK_XY,
        speed_up_m_s=fastest_m_s if up_cm_s is None else min(up_cm_s / 100.0, fastest_m_s),
        speed_down_m_s=fastest_m_s if down_cm_s is None else min(down_cm_s / 100.0, fastest_m_s),
        land_speed_m_s=parameters.LAND_SPEED / 100.0,
    )
