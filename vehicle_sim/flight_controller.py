"""The flight controller: an autopilot and its protocols, between messages in and out.

It connects the radio, which handles frames, and the autopilot, which flies.  A reboot creates a new
one on the same radio.
"""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, final

from vehicle_sim.autopilot.core import Autopilot
from vehicle_sim.autopilot.values import (
    Ack,
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
from vehicle_sim.wire import messages, telemetry
from vehicle_sim.wire.missions import Missions, store
from vehicle_sim.wire.parameter_protocol import ParameterProtocol
from vehicle_sim.wire.proximity import DISTANCE_SENSOR, RangeSensors
from vehicle_sim.wire.radio import Radio
from vehicle_sim.wire.routing import MISSION
from vehicle_sim.wire.streams import COMMANDS as STREAM_COMMANDS
from vehicle_sim.wire.streams import Streams

_HEARTBEAT, _POSITION, _CURRENT_MODE = 0, 33, 436
_CURRENT_MODE_US = 500_000
_GROUND_STATION = 6
_SET_MODE = 11
_EPOCH_US = 1_795_000_000_000_000
"""UTC at the start of every run: the same seed gives the same bytes."""


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
        ranging: RangeSensors,
    ) -> None:
        profile = autopilot.profile
        self.autopilot = autopilot
        self.parameters = autopilot.parameters
        self.boot_us = boot_us
        self.wants_reboot = False
        self.setpoints_ignored = False
        self.ranging = ranging
        self._radio, self._on_text = radio, on_text
        self.now_us = boot_us
        self._firmware = profile.firmware
        self._builders = telemetry.MESSAGES[profile.firmware]
        self._parameter_protocol = ParameterProtocol(autopilot)
        self._mission_protocol = Missions(autopilot)
        self.transfers = False
        """Parameters or a plan may be on their way."""
        self._ground_stations = set[int]()
        self._texts = 0
        """So many have been said: the number of one that takes several messages."""
        self._mode_told: dict[int, tuple[Any, int]] = {}
        """Newest CURRENT_MODE of each link, and when that was."""
        self.streams = Streams(profile, self.parameters)
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
            if said is None:
                said = built[number] = self._said(number)
            if number != _CURRENT_MODE or self._is_news(said, link, now_us):
                for message in said:
                    self._radio.send(message, link)
        return positioned

    def _said(self, number: int) -> Sequence[Any]:
        """What there is to say by this number now."""
        if number in self.ranging.numbers:
            return self.ranging.messages(number, self.now_us - self.boot_us)
        if number == DISTANCE_SENSOR and self.ranging.rangefinder_off:
            return ()
        build = self._builders.get(number)
        message = build(self.report) if build else None
        return () if message is None else (message,)

    def _is_news(self, mode: Any, link: int, now_us: int) -> bool:
        """CURRENT_MODE is sent at 2 Hz and at once on a change, however often it is asked for."""
        told, told_us = self._mode_told.get(link, (None, 0))
        if told == mode and now_us - told_us < _CURRENT_MODE_US:
            return False
        self._mode_told[link] = (mode, now_us)
        return True

    def send_heartbeat(self) -> None:
        """Send a heartbeat now: whoever hears it may ask for more."""
        self.streams.begin()
        self._send(_HEARTBEAT, None)

    def _renew_report(self) -> None:
        report, now_us = self.report, self.now_us
        report.renew(now_us - self.boot_us, _EPOCH_US + now_us if report.fix.usable else 0)
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
                    self._deliver((reply.message,), reply.to)
                case Reboot():
                    self.wants_reboot = True
                case None:
                    pass

    def _send(self, number: int, to: Sender | None) -> None:
        """Send the message of this number, if it has data."""
        self._renew_report()
        self._deliver(self._said(number), to)

    def _deliver(self, said: Sequence[Any], to: Sender | None) -> None:
        for link in self._radio.links if to is None else (to.link,):
            for message in said:
                self._radio.send(message, link)

    def _say(self, text: Text) -> None:
        """PX4 says it on links with a ground station, ArduPilot where anybody was heard."""
        self._texts, is_px4 = self._texts % 0xFFFF + 1, self._firmware == "px4"
        for link in self._radio.links:
            if link in self._ground_stations if is_px4 else self._radio.router.heard(link):
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
        self.answer(self._replies(message, sender, now_us - self.boot_us))

    def _replies(self, message: Any, sender: Sender, us: int) -> Iterable[Reply | None]:
        """What becomes of each kind of message, so many us after the boot."""
        autopilot, firmware, signing = self.autopilot, self._firmware, self._radio.signing
        match message.get_type():
            case "HEARTBEAT":
                if message.type == _GROUND_STATION:
                    self._ground_stations.add(sender.link)
                return autopilot.on_heartbeat(sender, message.type)
            case "SET_POSITION_TARGET_GLOBAL_INT" | "SET_POSITION_TARGET_LOCAL_NED":
                setpoint = messages.setpoint(message)
                return () if self.setpoints_ignored else autopilot.on_setpoint(setpoint)
            case "TIMESYNC" if message.tc1 == 0:
                said = messages.time_sync(us * 1000, message.ts1, sender)
                return (SendMessage(message=said, to=sender),)
            case "OBSTACLE_DISTANCE":
                self.ranging.proximity.on_obstacle_distance(message, us)
            case "COMMAND_LONG" | "COMMAND_INT":
                command = messages.command(message, sender)
                if command.number in STREAM_COMMANDS:
                    return self.streams.on_command(command, self.now_us)
                return autopilot.on_command(command)
            case "SET_MODE":
                replies = autopilot.on_command(messages.mode_command(message, sender, firmware))
                return replies if firmware == "px4" else map(_as_set_mode, replies)
            case "REQUEST_DATA_STREAM":
                self.streams.on_data_stream(message, sender.link, self.now_us)
            case "PARAM_REQUEST_READ" | "PARAM_REQUEST_LIST" | "PARAM_SET":
                self.transfers = True
                return self._parameter_protocol.on_message(message, sender, self.now_us)
            case name if name in MISSION:
                self.transfers = True
                return self._mission_protocol.on_message(message, sender, self.now_us)
            case "SETUP_SIGNING" if signing is not None:
                return (signing.setup(message, armed=autopilot.armed),)
            case "FILE_TRANSFER_PROTOCOL":
                answer = messages.no_files(message, sender)
                return () if answer is None else (SendMessage(message=answer, to=sender),)
            case _:
                pass
        return ()


def _as_set_mode(reply: Reply) -> Reply:
    """ArduPilot answers a SET_MODE with a COMMAND_ACK of the message's own number."""
    return dataclasses.replace(reply, command=_SET_MODE) if isinstance(reply, Ack) else reply
