"""The flight controller: an autopilot and its protocols, between messages in and out.

What becomes of a message that comes in stands in HANDLERS, at the end; before that wire/radio.py
has found it in the bytes of a link and judged its signature and its target.  Here MAVLink's units
and scales are known, in wire/telemetry.py those of what is streamed.  What is not a finite number
passes through unharmed: the autopilots decide what to make of it.  A reboot creates a new flight
controller on the same radio.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.core import Autopilot
from vehicle_sim.autopilot.values import (
    Ack,
    Command,
    Reboot,
    Reply,
    Report,
    Sender,
    SendMessage,
    SendTelemetry,
    Setpoint,
    Text,
)
from vehicle_sim.parameters import Firmware
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.wire.frames import Prepared, make
from vehicle_sim.wire.missions import Missions, store
from vehicle_sim.wire.parameter_protocol import ParameterProtocol
from vehicle_sim.wire.proximity import DISTANCE_SENSOR, RangeSensors
from vehicle_sim.wire.radio import Radio
from vehicle_sim.wire.streams import COMMANDS as STREAM_COMMANDS
from vehicle_sim.wire.streams import Streams
from vehicle_sim.wire.telemetry import message_of

_HEARTBEAT, _POSITION, _CURRENT_MODE = 0, 33, 436
_CURRENT_MODE_US = 500_000
_SET_MODE, _DO_SET_MODE = 11, 176
_EPOCH_US = 1_795_000_000_000_000
"""UTC at the start of every run: the same seed gives the same bytes."""
_NOWHERE = 0x7FFFFFFF
"""x or y of a COMMAND_INT that gives no place."""
_LOCAL_FRAMES = frozenset({1, 2, 4, 7, 8, 9, 12, 20, 21})
"""MAV_FRAME in which x and y are 1e-4 metres."""
_TEXT_BYTES = 50
_FILE_NOT_FOUND = 10
Replies = Iterable[Reply]


@final
class FlightController:
    """One autopilot from its boot on.  Times that come in are of the simulation."""

    def __init__(
        self,
        autopilot: Autopilot,
        radio: Radio,
        *,
        boot_us: int,
        hardware_id: int,
        on_text: Callable[[Text], None],
        ranging: RangeSensors,
    ) -> None:
        self.autopilot, self.radio, self.ranging = autopilot, radio, ranging
        self.firmware = autopilot.firmware.family
        self.boot_us = self.now_us = boot_us
        self.wants_reboot = self.setpoints_ignored = False
        self.parameter_protocol = ParameterProtocol(autopilot)
        self.missions = Missions(autopilot)
        self.streams = Streams(autopilot.firmware, autopilot.parameters, radio.links, boot_us)
        self.report = Report(autopilot=autopilot, hardware_id=hardware_id)
        self.ground_stations = set[int]()
        """Links on which one was heard."""
        self._mode_told: dict[int, tuple[Any, int]] = {}
        """Newest CURRENT_MODE of each link, and when that was."""
        self._on_text, self._texts = on_text, 0
        """So many have been said: the number of one that takes several messages."""

    @property
    def since_boot_us(self) -> int:
        """The autopilot's own time."""
        return self.now_us - self.boot_us

    # --- out ----------------------------------------------------------------------------------

    def go_on(self, replies: Iterable[Reply]) -> None:
        """After a step of the autopilot: what that brings, and what the protocols have to say."""
        self.answer(replies)
        if self.parameter_protocol.busy:
            self.answer(self.parameter_protocol.step(self.now_us))
        if self.missions.busy:
            self.answer(self.missions.step(self.now_us))

    def stream(self) -> bool:
        """Queue all telemetry that is due; returns whether that included a position on link 0."""
        self._renew_report()
        due, built = self.streams.due(self.now_us), dict[int, Sequence[Any]]()
        for link, number in due:
            if number not in built:
                built[number] = self._said(number)
            if number != _CURRENT_MODE or self._is_news(built[number], link):
                self._deliver(built[number], (link,))
        return (0, _POSITION) in due

    def _is_news(self, mode: Any, link: int) -> bool:
        """CURRENT_MODE is sent at 2 Hz and at once on a change, however often it is asked for."""
        told, told_us = self._mode_told.get(link, (None, 0))
        if told == mode and self.now_us - told_us < _CURRENT_MODE_US:
            return False
        self._mode_told[link] = mode, self.now_us
        return True

    def _said(self, number: int) -> Sequence[Any]:
        """What there is to say by this number now."""
        if number in self.ranging.numbers:
            return self.ranging.messages(number, self.since_boot_us)
        if number == DISTANCE_SENSOR and self.ranging.rangefinder_off:
            return ()
        message = message_of(self.report, number)
        return () if message is None else (message,)

    def _renew_report(self) -> None:
        report, us = self.report, self.since_boot_us
        report.time_us = us
        report.unix_us = _EPOCH_US + self.now_us if self.autopilot.fix.usable else 0
        report.range_sensors = self.ranging.bits(us)

    def send_heartbeat(self) -> None:
        """Send a heartbeat now: whoever hears it may ask for more."""
        self.answer([SendTelemetry(message=_HEARTBEAT)])

    def answer(self, replies: Replies) -> None:
        """Carry out replies of the autopilot and the protocols."""
        for reply in replies:
            match reply:
                case Ack():
                    self.radio.send(ack(reply), reply.to.link)
                case Text():
                    self._say(reply)
                case SendTelemetry():
                    self._renew_report()
                    self._deliver(self._said(reply.message), self._links_to(reply.to))
                case SendMessage():
                    self._deliver((reply.message,), self._links_to(reply.to))
                case Reboot():
                    self.wants_reboot = True

    def _links_to(self, to: Sender | None) -> Iterable[int]:
        """That of one client; None: all."""
        return self.radio.links if to is None else (to.link,)

    def _deliver(self, said: Sequence[Any], links: Iterable[int]) -> None:
        for link in links:
            for message in said:
                self.radio.send(message, link)

    def _say(self, text: Text) -> None:
        """PX4 says it on links with a ground station, ArduPilot where anybody was heard."""
        self._texts = self._texts % 0xFFFF + 1
        heard_on = self.radio.router.heard_on
        links = sorted(self.ground_stations if self.firmware == "px4" else heard_on)
        self._deliver(texts(text, self._texts), links)
        self._on_text(text)

    # --- in -----------------------------------------------------------------------------------

    def receive(self, message: Any, sender: Sender, now_us: int) -> None:
        """Handle a message that is for the autopilot; one that nobody handles is passed over."""
        self.now_us = now_us
        handler = HANDLERS.get(message.get_type())
        if handler is not None:
            self.answer(handler(self, message, sender))

    def add_to_fence(self, item: PlanItem) -> None:
        """As if somebody had uploaded the fence with this item added."""
        items = (*self.autopilot.plans[PlanKind.FENCE], item)
        self.answer(store(self.autopilot, PlanKind.FENCE, items))


# --- values as messages ---------------------------------------------------------------------------


def ack(value: Ack) -> Prepared:
    """COMMAND_ACK, addressed to the asker."""
    to = (value.to.system, value.to.component)
    return make("COMMAND_ACK", value.command, value.result, 0, 0, *to)


def texts(value: Text, number: int) -> list[Prepared]:
    """STATUSTEXT; what does not fit into one goes on in chunks of this number, to a zero byte."""
    said, severity, size = value.text.encode("ascii", "replace"), value.severity, _TEXT_BYTES
    if len(said) <= size:
        return [make("STATUSTEXT", severity, said)]
    parts = [said[start : start + size] for start in range(0, len(said) + 1, size)]
    return [make("STATUSTEXT", severity, part, number, k) for k, part in enumerate(parts)]


# --- what becomes of each kind of message ---------------------------------------------------------


def _heartbeat(it: FlightController, message: Any, sender: Sender) -> Replies:
    if message.type == mavlink.MAV_TYPE_GCS:
        it.ground_stations.add(sender.link)
    it.autopilot.on_heartbeat(sender, message.type)
    return ()


def command(message: Any, sender: Sender) -> Command:
    """A COMMAND_LONG or COMMAND_INT."""
    if message.get_type() == "COMMAND_LONG":
        place, frame = (message.param5, message.param6, message.param7), None
    else:
        frame = message.frame
        scale = 1e4 if frame in _LOCAL_FRAMES else 1e7
        x, y = (math.nan if n == _NOWHERE else n / scale for n in (message.x, message.y))
        place = (x, y, message.z)
    return Command(
        sender=sender,
        target_component=message.target_component,
        number=message.command,
        parameters=(message.param1, message.param2, message.param3, message.param4, *place),
        frame=frame,
    )


def _command(it: FlightController, message: Any, sender: Sender) -> Replies:
    asked = command(message, sender)
    if asked.number in STREAM_COMMANDS:
        return it.streams.on_command(asked, it.now_us)
    return it.autopilot.on_command(asked)


def mode_command(message: Any, sender: Sender, firmware: Firmware) -> Command:
    """A SET_MODE, as the DO_SET_MODE that means the same.

    PX4 takes its custom_mode apart into main and sub mode.
    """
    mode = message.custom_mode
    main, sub = (mode >> 16 & 0xFF, mode >> 24 & 0xFF) if firmware == "px4" else (mode, 0)
    parameters = (float(message.base_mode), float(main), float(sub), 0.0, 0.0, 0.0, 0.0)
    return Command(sender=sender, target_component=0, number=_DO_SET_MODE, parameters=parameters)


def _set_mode(it: FlightController, message: Any, sender: Sender) -> Replies:
    """ArduPilot answers with a COMMAND_ACK of the message's own number."""
    for reply in it.autopilot.on_command(mode_command(message, sender, it.firmware)):
        if isinstance(reply, Ack) and it.firmware == "ardupilot":
            yield reply._replace(command=_SET_MODE)
        else:
            yield reply


def _setpoint(it: FlightController, message: Any, _: Sender) -> Replies:
    """SET_POSITION_TARGET_GLOBAL_INT or _LOCAL_NED."""
    if it.setpoints_ignored:
        return ()
    is_global = message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
    if is_global:
        position = (message.lat_int / 1e7, message.lon_int / 1e7, message.alt)
    else:
        position = (message.x, message.y, message.z)
    setpoint = Setpoint(
        is_global=is_global,
        frame=message.coordinate_frame,
        type_mask=message.type_mask,
        position=position,
        velocity_ned_m_s=(message.vx, message.vy, message.vz),
        acceleration_ned_m_s2=(message.afx, message.afy, message.afz),
        yaw_rad=message.yaw,
        yaw_rate_rad_s=message.yaw_rate,
    )
    return it.autopilot.on_setpoint(setpoint)


def _time_sync(it: FlightController, message: Any, sender: Sender) -> Replies:
    """A question has a tc1 of 0."""
    if message.tc1 == 0:
        now_ns, to = it.since_boot_us * 1000, (sender.system, sender.component)
        yield SendMessage(message=make("TIMESYNC", now_ns, message.ts1, *to), to=sender)


def _setup_signing(it: FlightController, message: Any, _: Sender) -> Replies:
    signing = it.radio.signing
    return () if signing is None else signing.setup(message, armed=it.autopilot.armed)


def _files(_: FlightController, message: Any, sender: Sender) -> Replies:
    """FILE_TRANSFER_PROTOCOL: there are none; no answer to an answer of theirs.

    So clients that look for files first (parameters, component metadata) go on at once with the
    plain protocols.  Layout of the payload: mavlink.io, services/ftp.
    """
    low, high, session, opcode, *_rest = message.payload
    done, refused = mavlink.MAV_FTP_OPCODE_ACK, mavlink.MAV_FTP_OPCODE_NAK
    if opcode not in (done, refused):
        ends = (0, mavlink.MAV_FTP_OPCODE_TERMINATESESSION, mavlink.MAV_FTP_OPCODE_RESETSESSION)
        answer, size, reason = (done, 0, 0) if opcode in ends else (refused, 1, _FILE_NOT_FOUND)
        number = ((low + high * 256 + 1) & 0xFFFF).to_bytes(2, "little")
        payload = [*number, session, answer, size, opcode, *bytes(6), reason, *bytes(238)]
        to = (0, sender.system, sender.component)
        yield SendMessage(message=make("FILE_TRANSFER_PROTOCOL", *to, payload), to=sender)


def _parameters(it: FlightController, message: Any, sender: Sender) -> Replies:
    return it.parameter_protocol.on_message(message, sender, it.now_us)


def _missions(it: FlightController, message: Any, sender: Sender) -> Replies:
    return it.missions.on_message(message, sender, it.now_us)


def _data_stream(it: FlightController, message: Any, sender: Sender) -> Replies:
    it.streams.on_data_stream(message, sender.link, it.now_us)
    return ()


HANDLERS: Final[dict[str, Callable[[FlightController, Any, Sender], Replies]]] = {
    "HEARTBEAT": _heartbeat,
    **dict.fromkeys(("COMMAND_LONG", "COMMAND_INT"), _command),
    "SET_MODE": _set_mode,
    "SET_POSITION_TARGET_GLOBAL_INT": _setpoint,
    "SET_POSITION_TARGET_LOCAL_NED": _setpoint,
    **dict.fromkeys(("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"), _parameters),
    **dict.fromkeys(("MISSION_COUNT", "MISSION_ITEM", "MISSION_ITEM_INT"), _missions),
    **dict.fromkeys(("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_REQUEST_LIST"), _missions),
    **dict.fromkeys(("MISSION_CLEAR_ALL", "MISSION_SET_CURRENT"), _missions),
    "REQUEST_DATA_STREAM": _data_stream,
    "TIMESYNC": _time_sync,
    "SETUP_SIGNING": _setup_signing,
    "FILE_TRANSFER_PROTOCOL": _files,
}
"""Who handles which message."""
