"""The flight controller: an autopilot and its protocols, between messages in and out.

What becomes of a message that comes in stands in `handlers`; before that wire/radio.py has found it
in the bytes of a link and judged its signature and its target.  Here MAVLink's units and scales are
known, in wire/telemetry.py those of what is streamed.  What is not a finite number passes through
unharmed: the autopilots decide what to make of it.  A reboot creates a new flight controller on the
same radio.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot import values
from vehicle_sim.autopilot.core import Autopilot
from vehicle_sim.autopilot.values import Ack, Command, Reply, Sender, SendMessage, Text
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.wire.frames import Prepared, make
from vehicle_sim.wire.missions import Missions, store
from vehicle_sim.wire.parameter_protocol import ParameterProtocol
from vehicle_sim.wire.proximity import RangeSensors
from vehicle_sim.wire.radio import Radio
from vehicle_sim.wire.streams import Streams
from vehicle_sim.wire.telemetry import Telemetry

_HEARTBEAT, _POSITION, _CURRENT_MODE = 0, 33, 436
_CURRENT_MODE_US = 500_000
_DO_SET_MODE: Final = 176
_NOWHERE = 0x7FFFFFFF
"""x or y of a COMMAND_INT that gives no place."""
_TEXT_BYTES = 50
_FTP_ENDS, _FTP_ACK, _FTP_NAK, _FTP_NOT_FOUND = range(3), 128, 129, 10
"""Opcodes: nothing, and the end of one session or all; two answers; and why one is refused."""
Replies = Iterable[Reply]
Handler = Callable[[Any, Sender, int], Replies]
"""Of a message, by whom, and the time."""


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
        self.boot_us = self.now_us = boot_us
        self.wants_reboot = self.setpoints_ignored = False
        self.parameters = ParameterProtocol(autopilot)
        self.missions = Missions(autopilot)
        self.streams = Streams(autopilot.firmware, radio.links, boot_us)
        self.telemetry = Telemetry(autopilot, ranging, hardware_id, boot_us)
        self._ground_stations = set[int]()
        """Links on which one was heard."""
        self._mode_told: dict[int, tuple[Any, int]] = {}
        """Newest CURRENT_MODE of each link, and when that was."""
        self._on_text = on_text
        self.handlers: dict[str, Handler] = {
            "HEARTBEAT": self._heartbeat,
            **dict.fromkeys(("COMMAND_LONG", "COMMAND_INT"), self._command),
            "SET_MODE": self._set_mode,
            "SET_POSITION_TARGET_GLOBAL_INT": self._setpoint,
            "SET_POSITION_TARGET_LOCAL_NED": self._setpoint,
            **dict.fromkeys(ParameterProtocol.MESSAGES, self.parameters.on_message),
            **dict.fromkeys(Missions.MESSAGES, self.missions.on_message),
            "REQUEST_DATA_STREAM": self.streams.on_data_stream,
            "TIMESYNC": self._time_sync,
            "SETUP_SIGNING": self._setup_signing,
            "FILE_TRANSFER_PROTOCOL": no_file,
        }

    # --- out ----------------------------------------------------------------------------------

    def stream(self) -> bool:
        """Queue all telemetry that is due; returns whether that included a position on link 0."""
        self.telemetry.now(self.now_us)
        due, built = self.streams.due(self.now_us), dict[int, Sequence[Any]]()
        for link, number in due:
            if number not in built:
                built[number] = self.telemetry.messages(number)
            if number != _CURRENT_MODE or self._is_news(built[number], link):
                self._send(built[number], (link,))
        return (0, _POSITION) in due

    def _is_news(self, mode: Any, link: int) -> bool:
        """CURRENT_MODE is sent at 2 Hz and at once on a change, however often it is asked for."""
        mode_told, told_us = self._mode_told.get(link, (None, 0))
        if mode_told == mode and self.now_us - told_us < _CURRENT_MODE_US:
            return False
        self._mode_told[link] = mode, self.now_us
        return True

    def send_heartbeat(self) -> None:
        """Send a heartbeat now: whoever hears it may ask for more."""
        self.answer([values.SendTelemetry(_HEARTBEAT)])

    def answer(self, replies: Replies) -> None:
        """Carry out replies of the autopilot and the protocols."""
        for reply in replies:
            match reply:
                case Ack(to, command, result):
                    answer = make("COMMAND_ACK", command, result, 0, 0, to.system, to.component)
                    self.radio.send(answer, (to.link,))
                case Text():
                    self._say(reply)
                case values.SendTelemetry(number, to):
                    self.telemetry.now(self.now_us)
                    self._send(self.telemetry.messages(number), None if to is None else (to.link,))
                case SendMessage(message, to):
                    self.radio.send(message, None if to is None else (to.link,))
                case values.Reboot():
                    self.wants_reboot = True

    def _send(self, messages: Iterable[Any], links: Iterable[int] | None) -> None:
        for message in messages:
            self.radio.send(message, links)

    def _say(self, text: Text) -> None:
        """PX4 says it on links with a ground station, ArduPilot where anybody was heard."""
        heard_on = self.radio.router.heard_on
        links = self._ground_stations if self.autopilot.is_px4 else heard_on
        self._send(texts(text, self.now_us // 1000 % 0xFFFF + 1), sorted(links))
        self._on_text(text)

    # --- in -----------------------------------------------------------------------------------

    def receive(self, message: Any, sender: Sender, now_us: int) -> None:
        """Handle a message that is for the autopilot; one that nobody handles is passed over."""
        self.now_us = now_us
        handler = self.handlers.get(message.get_type())
        if handler is not None:
            self.answer(handler(message, sender, now_us))

    def add_to_fence(self, item: PlanItem) -> None:
        """As if somebody had uploaded the fence with this item added."""
        items = (*self.autopilot.plans[PlanKind.FENCE], item)
        self.answer(store(self.autopilot, PlanKind.FENCE, items))

    def _heartbeat(self, message: Any, sender: Sender, _: int) -> Replies:
        if message.type == mavlink.MAV_TYPE_GCS:
            self._ground_stations.add(sender.link)
        self.autopilot.on_heartbeat(sender, message.type)
        return ()

    def _command(self, message: Any, sender: Sender, now_us: int) -> Replies:
        asked = command(message, sender)
        if asked.number in Streams.COMMANDS:
            return self.streams.on_command(asked, now_us)
        return self.autopilot.on_command(asked)

    def _set_mode(self, message: Any, sender: Sender, _: int) -> Replies:
        """SET_MODE: the same as DO_SET_MODE, which has PX4's main and sub mode apart."""
        main, sub = message.custom_mode, 0
        if self.autopilot.is_px4:
            main, sub = main >> 16 & 0xFF, main >> 24
        wanted = (float(message.base_mode), float(main), float(sub), 0.0, 0.0, 0.0, 0.0)
        return self.autopilot.on_command(Command(sender, 0, _DO_SET_MODE, wanted))

    def _setpoint(self, message: Any, _sender: Sender, _: int) -> Replies:
        """SET_POSITION_TARGET_GLOBAL_INT or _LOCAL_NED."""
        if self.setpoints_ignored:
            return ()
        is_global, m = message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT", message
        position = (m.lat_int / 1e7, m.lon_int / 1e7, m.alt) if is_global else (m.x, m.y, m.z)
        velocity, acceleration = (m.vx, m.vy, m.vz), (m.afx, m.afy, m.afz)
        vectors = (position, velocity, acceleration)
        return self.autopilot.on_setpoint(
            values.Setpoint(is_global, m.coordinate_frame, m.type_mask, *vectors, m.yaw, m.yaw_rate)
        )

    def _time_sync(self, message: Any, sender: Sender, now_us: int) -> Replies:
        """A question has a tc1 of 0."""
        if message.tc1 == 0:
            since_boot_ns = (now_us - self.boot_us) * 1000
            yield SendMessage(make("TIMESYNC", since_boot_ns, message.ts1), sender)

    def _setup_signing(self, message: Any, _sender: Sender, _: int) -> Replies:
        signing = self.radio.signing
        return () if signing is None else signing.setup(message, armed=self.autopilot.armed)


def command(message: Any, sender: Sender) -> Command:
    """A COMMAND_LONG or COMMAND_INT."""
    m = message
    if m.get_type() == "COMMAND_LONG":
        place, frame = (m.param5, m.param6, m.param7), None
    else:
        x, y = (math.nan if n == _NOWHERE else n / 1e7 for n in (m.x, m.y))
        place, frame = (x, y, m.z), m.frame
    parameters = (m.param1, m.param2, m.param3, m.param4, *place)
    return Command(sender, m.target_component, m.command, parameters, frame)


def texts(value: Text, number: int) -> list[Prepared]:
    """STATUSTEXT; what does not fit into one goes on in chunks of this number, to a zero byte."""
    text, severity, size = value.text.encode("ascii", "replace"), value.severity, _TEXT_BYTES
    if len(text) <= size:
        return [make("STATUSTEXT", severity, text)]
    parts = [text[start : start + size] for start in range(0, len(text) + 1, size)]
    return [make("STATUSTEXT", severity, part, number, k) for k, part in enumerate(parts)]


def no_file(message: Any, sender: Sender, _: int) -> Replies:
    """FILE_TRANSFER_PROTOCOL: there are none; no answer to an answer of theirs.

    So clients that look for files first (parameters, component metadata) go on at once with the
    plain protocols.  Layout of the payload: mavlink.io, services/ftp.
    """
    payload = bytearray(message.payload)
    number, asked = int.from_bytes(payload[:2], "little") + 1, payload[3]
    if asked not in (_FTP_ACK, _FTP_NAK):
        payload[:2] = (number & 0xFFFF).to_bytes(2, "little")
        payload[3:6] = (_FTP_ACK, 0, asked) if asked in _FTP_ENDS else (_FTP_NAK, 1, asked)
        payload[12] = 0 if asked in _FTP_ENDS else _FTP_NOT_FOUND
        to = (0, sender.system, sender.component)
        yield SendMessage(make("FILE_TRANSFER_PROTOCOL", *to, list(payload)), sender)
