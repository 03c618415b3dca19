"""The flight controller: an autopilot and its protocols, between messages in and out.

It connects the radio, which handles frames, and the autopilot, which flies.  A reboot creates a new
one on the same radio.
"""

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any, final

from vehicle_sim.autopilots import (
    Ack,
    Autopilot,
    Event,
    Reboot,
    Reply,
    Report,
    Sender,
    SendMessage,
    SendParameter,
    SendTelemetry,
    Text,
)
from vehicle_sim.dynamics.battery import Battery
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.sensors.gps import Fix
from vehicle_sim.wire import ftp, messages, telemetry_ardupilot, telemetry_px4
from vehicle_sim.wire.missions import ArduPilotMissions, Px4Missions, store
from vehicle_sim.wire.parameter_protocol import ParameterProtocol
from vehicle_sim.wire.proximity import DISTANCE_SENSOR, RANGEFINDER, RangeSensors
from vehicle_sim.wire.radio import Radio
from vehicle_sim.wire.streams import COMMANDS as STREAM_COMMANDS
from vehicle_sim.wire.streams import Streams

_HEARTBEAT, _POSITION, _CURRENT_MODE = 0, 33, 436
_CURRENT_MODE_US = 500_000
_GROUND_STATION = 6
_SET_MODE = 11
_EPOCH_US = 1_795_000_000_000_000
"""UTC at the start of every run: the same seed gives the same bytes."""
_STREAM_PARAMETERS = {
    1: "RAW_SENS",
    2: "EXT_STAT",
    3: "RC_CHAN",
    4: "RAW_CTRL",
    6: "POSITION",
    10: "EXTRA1",
    11: "EXTRA2",
    12: "EXTRA3",
}
_MISSIONS: dict[str, type[ArduPilotMissions | Px4Missions]] = {
    "ardupilot": ArduPilotMissions,
    "px4": Px4Missions,
}
_TELEMETRY = {"ardupilot": telemetry_ardupilot.MESSAGES, "px4": telemetry_px4.MESSAGES}


@final
class FlightController:
    """One autopilot from its boot on.  Times that come in are of the simulation."""

    def __init__(
        self,
        autopilot: Autopilot,
        radio: Radio,
        battery: Battery,
        *,
        boot_us: int,
        hardware_id: int,
        on_text: Callable[[Text], None],
        ranging: RangeSensors | None = None,
    ) -> None:
        profile = autopilot.profile
        self.autopilot = autopilot
        self.parameters = autopilot.parameters
        self.boot_us = boot_us
        self.wants_reboot = False
        self.setpoints_ignored = self.rangefinder_off = False
        self.ranging = ranging
        """None: PX4, which has no proximity sensors here."""
        self._radio, self._on_text = radio, on_text
        self.now_us = boot_us
        self._messages = _TELEMETRY[profile.firmware]
        self._parameter_protocol = ParameterProtocol(autopilot)
        self._mission_protocol = _MISSIONS[profile.firmware](autopilot)
        self.transfers = False
        """Parameters or a plan may be on their way."""
        self._ground_stations = set[int]()
        self._told: dict[int, tuple[int, int | None, int]] = {}
        """Newest CURRENT_MODE of each link: mode, intended mode and when."""
        self.streams = Streams(profile)
        for link in radio.links:
            self.streams.open(link, boot_us)
        self.report = Report(
            autopilot=autopilot, fix=Fix(), battery=battery, hardware_id=hardware_id
        )

    # --- time ---------------------------------------------------------------------------------

    def go_on(self, replies: Iterable[Reply]) -> None:
        """After a step of the autopilot: what that brings, and what the protocols have to say."""
        self.answer(replies)
        if self.transfers:
            parameters, missions = self._parameter_protocol, self._mission_protocol
            if parameters.busy:
                self.answer(parameters.step(self.now_us))
            if missions.busy:
                self.answer(missions.step(self.now_us))
            self.transfers = parameters.busy or missions.busy

    def stream(self, now_us: int) -> bool:
        """Queue all telemetry that is due; returns whether that included a position on link 0."""
        self._renew_report()
        positioned, built = False, dict[int, Any]()
        for link, number in self.streams.due(now_us):
            if number == _POSITION and link == 0:
                positioned = True
            if number in (DISTANCE_SENSOR, RANGEFINDER):
                for message in self._ranges(number, link):
                    self._radio.send(message, link)
                continue
            message = built.get(number)
            if message is None:
                build = self._messages.get(number)
                message = built[number] = build(self.report) if build else None
            if message is not None and (
                number != _CURRENT_MODE or not self._told_already(link, now_us)
            ):
                self._radio.send(message, link)
        return positioned

    def _ranges(self, number: int, link: int) -> list[Any]:
        """What range sensors say on this link now; of PX4 only the one that looks down."""
        if self.ranging is not None:
            self.ranging.rangefinder_off = self.rangefinder_off
            return self.ranging.messages(number, link, self.now_us - self.boot_us)
        build = None if self.rangefinder_off else self._messages.get(number)
        message = build(self.report) if build else None
        return [] if message is None else [message]

    def _told_already(self, link: int, now_us: int) -> bool:
        """CURRENT_MODE is sent at 2 Hz and at once on a change, however often it is asked for."""
        status = self.report.status
        mode, intended, told_us = self._told.get(link, (-1, None, 0))
        if (mode, intended) == (status.mode, status.intended_mode) and (
            now_us - told_us < _CURRENT_MODE_US
        ):
            return True
        self._told[link] = (status.mode, status.intended_mode, now_us)
        return False

    def send_heartbeat(self) -> None:
        """Send a heartbeat now."""
        self._send(_HEARTBEAT, None)

    def _renew_report(self) -> None:
        report, now_us = self.report, self.now_us
        report.renew(now_us - self.boot_us, _EPOCH_US + now_us if report.fix.usable else 0)
        if self.ranging is not None:
            report.range_sensors = self.ranging.bits(now_us - self.boot_us)

    # --- out ----------------------------------------------------------------------------------

    def answer(self, replies: Iterable[Reply]) -> None:
        """Carry out replies of the autopilot and the protocols."""
        for reply in replies:
            match reply:
                case Ack():
                    self._radio.send(messages.ack(reply), reply.to.link)
                case Text():
                    self._say(reply)
                case SendTelemetry():
                    self._send(reply.message, reply.to)
                case SendMessage():
                    self._deliver(reply.message, reply.to)
                case SendParameter():
                    self._say_parameter(reply.name)
                case Event():
                    boot_ms = (self.now_us - self.boot_us) // 1000
                    sequence = (self.report.event_sequence + 1) % 65536
                    self.report.event_sequence = sequence
                    self._radio.broadcast(messages.event(reply, sequence, boot_ms))
                case Reboot():
                    self.wants_reboot = True

    def _send(self, number: int, to: Sender | None) -> None:
        """Send the message of this number, if it has data."""
        if number in (DISTANCE_SENSOR, RANGEFINDER):
            for link in self._radio.links if to is None else (to.link,):
                for message in self._ranges(number, link):
                    self._radio.send(message, link)
            return
        build = self._messages.get(number)
        if build is None:
            return
        self._renew_report()
        message = build(self.report)
        if message is not None:
            self._deliver(message, to)

    def _deliver(self, message: Any, to: Sender | None) -> None:
        if to is None:
            self._radio.broadcast(message)
        else:
            self._radio.send(message, to.link)

    def _say_parameter(self, name: str) -> None:
        """ArduPilot sends it to links on which a sender was heard."""
        to_all = self.autopilot.profile.firmware == "px4"
        for link in self._radio.links:
            if to_all or self._radio.router.heard(link):
                self._radio.send(self._parameter_protocol.value(name), link)

    def _say(self, text: Text) -> None:
        """PX4 says it on links with a ground station, ArduPilot where anybody was heard."""
        is_px4 = self.autopilot.profile.firmware == "px4"
        for link in self._radio.links:
            if link in self._ground_stations if is_px4 else self._radio.router.heard(link):
                self._radio.send(messages.text(text), link)
        self._on_text(text)

    # --- in -----------------------------------------------------------------------------------

    def add_to_fence(self, item: PlanItem) -> None:
        """As if somebody had uploaded the fence with this item added."""
        items = (*self.autopilot.plans[PlanKind.FENCE], item)
        self.answer(store(self.autopilot, PlanKind.FENCE, items))

    def receive(self, message: Any, sender: Sender, now_us: int) -> None:
        """Handle a message that is for the autopilot."""
        self.now_us = now_us
        handle = _HANDLERS.get(message.get_type())
        if handle is not None:
            handle(self, message, sender)

    def _on_heartbeat(self, message: Any, sender: Sender) -> None:
        if message.type == _GROUND_STATION:
            self._ground_stations.add(sender.link)
        self.answer(self.autopilot.on_heartbeat(sender, message.type))

    def _on_time_sync(self, message: Any, sender: Sender) -> None:
        if message.tc1 == 0:
            boot_ns = (self.now_us - self.boot_us) * 1000
            answer = messages.time_sync(boot_ns, message.ts1, sender)
            self._radio.send(answer, sender.link)

    def _on_setpoint(self, message: Any, _: Sender) -> None:
        if not self.setpoints_ignored:
            self.answer(self.autopilot.on_setpoint(messages.setpoint(message)))

    def _on_attitude(self, message: Any, _: Sender) -> None:
        if not self.setpoints_ignored:
            self.answer(self.autopilot.on_attitude(messages.attitude_target(message)))

    def _on_obstacle_distance(self, message: Any, _: Sender) -> None:
        if self.ranging is not None:
            self.ranging.proximity.on_obstacle_distance(message, self.now_us - self.boot_us)

    def _on_command(self, message: Any, sender: Sender) -> None:
        command = messages.command(message, sender)
        if command.number in STREAM_COMMANDS:
            self.answer(self.streams.on_command(command, self.now_us))
        else:
            self.answer(self.autopilot.on_command(command))

    def _on_set_mode(self, message: Any, sender: Sender) -> None:
        firmware = self.autopilot.profile.firmware
        command = messages.mode_command(message, sender, firmware)
        replies = self.autopilot.on_command(command)
        if firmware == "ardupilot":
            replies = [
                dataclasses.replace(each, command=_SET_MODE) if isinstance(each, Ack) else each
                for each in replies
            ]
        self.answer(replies)

    def _on_data_stream(self, message: Any, sender: Sender) -> None:
        self.streams.on_data_stream(message, sender.link, self.now_us)
        rate_hz = message.req_message_rate if message.start_stop else 0
        for group, part in _STREAM_PARAMETERS.items():  # ArduPilot keeps it as a parameter
            name = f"MAV{sender.link + 1}_{part}"
            if message.req_stream_id in (0, group) and name in self.parameters:
                self.parameters[name] = rate_hz

    def _on_parameter(self, message: Any, sender: Sender) -> None:
        self.transfers = True
        self.answer(self._parameter_protocol.on_message(message, sender, self.now_us))

    def _on_mission(self, message: Any, sender: Sender) -> None:
        self.transfers = True
        self.answer(self._mission_protocol.on_message(message, sender, self.now_us))

    def _on_manual_control(self, message: Any, sender: Sender) -> None:
        self.answer(self.autopilot.on_manual_control(messages.manual_control(message, sender)))

    def _on_ping(self, message: Any, sender: Sender) -> None:
        if self.autopilot.profile.firmware == "px4" and message.target_system == 0:
            self._radio.send(messages.pong(message, sender), sender.link)

    def _on_terrain_check(self, message: Any, sender: Sender) -> None:
        """ArduPilot: there is no terrain data here either."""
        if self.autopilot.profile.firmware == "ardupilot":
            self._radio.send(messages.no_terrain(message), sender.link)

    def _on_setup_signing(self, message: Any, _: Sender) -> None:
        if self._radio.signing is not None:
            refused = self._radio.signing.setup(message, armed=self.autopilot.armed)
            self.answer([] if refused is None else [refused])

    def _on_file_transfer(self, message: Any, sender: Sender) -> None:
        answer = ftp.answer(message, sender)
        self.answer([] if answer is None else [answer])


_Handler = Callable[[FlightController, Any, Sender], None]
_MISSION_MESSAGES = (
    "MISSION_COUNT",
    "MISSION_ITEM",
    "MISSION_ITEM_INT",
    "MISSION_REQUEST",
    "MISSION_REQUEST_INT",
    "MISSION_REQUEST_LIST",
    "MISSION_REQUEST_PARTIAL_LIST",
    "MISSION_WRITE_PARTIAL_LIST",
    "MISSION_SET_CURRENT",
    "MISSION_CLEAR_ALL",
    "MISSION_ACK",
)
_HANDLERS: dict[str, _Handler] = {
    "HEARTBEAT": FlightController._on_heartbeat,
    "TIMESYNC": FlightController._on_time_sync,
    "SET_POSITION_TARGET_GLOBAL_INT": FlightController._on_setpoint,
    "SET_POSITION_TARGET_LOCAL_NED": FlightController._on_setpoint,
    "OBSTACLE_DISTANCE": FlightController._on_obstacle_distance,
    "SET_ATTITUDE_TARGET": FlightController._on_attitude,
    "COMMAND_LONG": FlightController._on_command,
    "COMMAND_INT": FlightController._on_command,
    "SET_MODE": FlightController._on_set_mode,
    "REQUEST_DATA_STREAM": FlightController._on_data_stream,
    "PARAM_REQUEST_READ": FlightController._on_parameter,
    "PARAM_REQUEST_LIST": FlightController._on_parameter,
    "PARAM_SET": FlightController._on_parameter,
    "MANUAL_CONTROL": FlightController._on_manual_control,
    "PING": FlightController._on_ping,
    "TERRAIN_CHECK": FlightController._on_terrain_check,
    "SETUP_SIGNING": FlightController._on_setup_signing,
    "FILE_TRANSFER_PROTOCOL": FlightController._on_file_transfer,
    **dict.fromkeys(_MISSION_MESSAGES, FlightController._on_mission),
}
