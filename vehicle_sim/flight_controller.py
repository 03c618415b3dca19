"""The flight controller: an autopilot and its protocols, between messages in and out.

It connects the radio, which handles frames, and the autopilot, which flies.  A reboot creates a new
one on the same radio.
"""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, final

from vehicle_sim.autopilots import (
    Ack,
    Autopilot,
    Reboot,
    Reply,
    Report,
    Sender,
    SendMessage,
    SendTelemetry,
    Text,
)
from vehicle_sim.dynamics.battery import Battery
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.sensors.gps import Fix
from vehicle_sim.wire import ftp, messages, telemetry_ardupilot, telemetry_px4
from vehicle_sim.wire.missions import Missions, store
from vehicle_sim.wire.parameter_protocol import ParameterProtocol
from vehicle_sim.wire.proximity import DISTANCE_SENSOR, RANGEFINDER, RangeSensors
from vehicle_sim.wire.radio import Radio
from vehicle_sim.wire.routing import MISSION
from vehicle_sim.wire.streams import COMMANDS as STREAM_COMMANDS
from vehicle_sim.wire.streams import Streams

_HEARTBEAT, _POSITION, _CURRENT_MODE = 0, 33, 436
_RANGES = (DISTANCE_SENSOR, RANGEFINDER)
_CURRENT_MODE_US = 500_000
_FIXED_WING, _GROUND_STATION = 1, 6
_SET_MODE = 11
_EPOCH_US = 1_795_000_000_000_000
"""UTC at the start of every run: the same seed gives the same bytes."""
_STREAM_PARAMETERS = {
    2: "EXT_STAT",
    6: "POSITION",
    10: "EXTRA1",
    11: "EXTRA2",
    12: "EXTRA3",
}


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
        self._is_px4 = is_px4 = profile.firmware == "px4"
        self._messages = (telemetry_px4 if is_px4 else telemetry_ardupilot).MESSAGES
        self._parameter_protocol = ParameterProtocol(autopilot)
        self._mission_protocol = Missions(autopilot)
        self.transfers = False
        """Parameters or a plan may be on their way."""
        self._ground_stations = set[int]()
        self._texts = 0
        """So many have been said: the number of one that takes several messages."""
        self._told: dict[int, tuple[int, int | None, int]] = {}
        """Newest CURRENT_MODE of each link: mode, intended mode and when."""
        self.streams = Streams(profile)
        for link in radio.links:
            for group, name in self._rates_of(link):
                if self.parameters[name] != self.parameters.row(name).default:
                    self.streams.set_default(link, group, self.parameters[name])
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
            self.answer(parameters.step(self.now_us))
            self.answer(missions.step(self.now_us))
            self.transfers = parameters.busy or missions.busy

    def stream(self, now_us: int) -> bool:
        """Queue all telemetry that is due; returns whether that included a position on link 0."""
        self._renew_report()
        positioned, built = False, dict[int, Sequence[Any]]()
        for link, number in self.streams.due(now_us):
            if number == _POSITION and link == 0:
                positioned = True
            said = built.get(number)
            if said is None or number in _RANGES:
                said = built[number] = self._said(number, link)
            if number != _CURRENT_MODE or (said and not self._told_already(link, now_us)):
                for message in said:
                    self._radio.send(message, link)
        return positioned

    def _said(self, number: int, link: int) -> Sequence[Any]:
        """What there is to say by this number on this link now."""
        if number in _RANGES:
            if self.ranging is not None:
                self.ranging.rangefinder_off = self.rangefinder_off
                return self.ranging.messages(number, link, self.now_us - self.boot_us)
            if self.rangefinder_off:  # of PX4 there is only the one that looks down
                return ()
        build = self._messages.get(number)
        message = build(self.report) if build else None
        return () if message is None else (message,)

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
        """Send a heartbeat now: whoever hears it may ask for more."""
        self.streams.begin()
        self._send(_HEARTBEAT, None)

    def _renew_report(self) -> None:
        report, now_us = self.report, self.now_us
        report.renew(now_us - self.boot_us, _EPOCH_US + now_us if report.fix.usable else 0)
        if self.ranging is not None:
            report.range_sensors = self.ranging.bits(now_us - self.boot_us)

    # --- out ----------------------------------------------------------------------------------

    def answer(self, replies: Iterable[Reply | None]) -> None:
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
                case Reboot():
                    self.wants_reboot = True
                case None:
                    pass

    def _send(self, number: int, to: Sender | None) -> None:
        """Send the message of this number, if it has data."""
        if number not in _RANGES:
            self._renew_report()
        for link in self._radio.links if to is None else (to.link,):
            for message in self._said(number, link):
                self._radio.send(message, link)

    def _deliver(self, message: Any, to: Sender | None) -> None:
        if to is None:
            self._radio.broadcast(message)
        else:
            self._radio.send(message, to.link)

    def _say(self, text: Text) -> None:
        """PX4 says it on links with a ground station, ArduPilot where anybody was heard."""
        self._texts = self._texts % 0xFFFF + 1
        for link in self._radio.links:
            if link in self._ground_stations if self._is_px4 else self._radio.router.heard(link):
                for message in messages.texts(text, self._texts):
                    self._radio.send(message, link)
        self._on_text(text)

    # --- in -----------------------------------------------------------------------------------

    def add_to_fence(self, item: PlanItem) -> None:
        """As if somebody had uploaded the fence with this item added."""
        items = (*self.autopilot.plans[PlanKind.FENCE], item)
        self.answer(store(self.autopilot, PlanKind.FENCE, items))

    def receive(self, message: Any, sender: Sender, now_us: int) -> None:
        """Handle a message that is for the autopilot."""
        self.now_us = now_us
        self.answer(self._replies(message, sender, message.get_type()))

    def _replies(self, message: Any, sender: Sender, name: str) -> Iterable[Reply | None]:
        autopilot, is_px4 = self.autopilot, self._is_px4
        since_boot_us = self.now_us - self.boot_us
        match name:
            case "HEARTBEAT":
                if message.type == _GROUND_STATION:
                    self._ground_stations.add(sender.link)
                return autopilot.on_heartbeat(sender, message.type)
            case "SET_POSITION_TARGET_GLOBAL_INT" | "SET_POSITION_TARGET_LOCAL_NED":
                setpoint = messages.setpoint(message)
                return () if self.setpoints_ignored else autopilot.on_setpoint(setpoint)
            case "TIMESYNC" if message.tc1 == 0:
                said = messages.time_sync(since_boot_us * 1000, message.ts1, sender)
                return (SendMessage(message=said, to=sender),)
            case "OBSTACLE_DISTANCE" if self.ranging is not None:
                self.ranging.proximity.on_obstacle_distance(message, since_boot_us)
            case "COMMAND_LONG" | "COMMAND_INT":
                command = messages.command(message, sender)
                if command.number in STREAM_COMMANDS:
                    return self.streams.on_command(command, self.now_us)
                return autopilot.on_command(command)
            case "SET_MODE":
                command = messages.mode_command(message, sender, autopilot.profile.firmware)
                replies = autopilot.on_command(command)
                return replies if is_px4 else map(_as_set_mode, replies)
            case "REQUEST_DATA_STREAM":
                self._on_data_stream(message, sender.link)
            case "PARAM_REQUEST_READ" | "PARAM_REQUEST_LIST" | "PARAM_SET":
                self.transfers = True
                return self._parameter_protocol.on_message(message, sender, self.now_us)
            case _ if message.get_msgId() in MISSION:
                self.transfers = True
                return self._mission_protocol.on_message(message, sender, self.now_us)
            case "SETUP_SIGNING" if self._radio.signing is not None:
                return (self._radio.signing.setup(message, armed=autopilot.armed),)
            case "FILE_TRANSFER_PROTOCOL":
                return (ftp.answer(message, sender),)
            case _:
                pass
        return ()

    def _on_data_stream(self, message: Any, link: int) -> None:
        """ArduPilot keeps the rate as a parameter; a plane over a reboot too.

        Source: GCS_MAVLINK::handle_request_data_stream, persist_streamrates().
        """
        self.streams.on_data_stream(message, link, self.now_us)
        rate_hz = message.req_message_rate if message.start_stop else 0
        parameters, persists = self.parameters, self.autopilot.profile.vehicle_type == _FIXED_WING
        for group, name in self._rates_of(link):
            if message.req_stream_id in (0, group):
                (parameters.__setitem__ if persists else parameters.set_until_reboot)(name, rate_hz)

    def _rates_of(self, link: int) -> list[tuple[int, str]]:
        """Groups of REQUEST_DATA_STREAM, and the parameter that has the default rate of each."""
        names = ((g, f"MAV{link + 1}_{part}") for g, part in _STREAM_PARAMETERS.items())
        return [(group, name) for group, name in names if name in self.parameters]


def _as_set_mode(reply: Reply) -> Reply:
    """ArduPilot answers a SET_MODE with a COMMAND_ACK of the message's own number."""
    return dataclasses.replace(reply, command=_SET_MODE) if isinstance(reply, Ack) else reply
