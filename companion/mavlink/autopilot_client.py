"""Client of one autopilot: its protocols besides setpoints, and decoding of its messages.

Streams, parameters, its mission, fence and rally points.  Sans-IO: messages in,
messages and events out.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any, Final, final

from companion.mavlink import parameter_client, plan_client
from companion.mavlink.autopilots import Autopilot, autopilot_of
from companion.mavlink.autopilots.messages import To, command_long, position
from companion.mavlink.dialect import EventMessage, Message, wire
from companion.mavlink.fence import OwnFence
from companion.mavlink.mission_items import targets_of
from companion.mavlink.parameter_client import ParameterClient
from companion.mavlink.plan_client import MISSION, PlanClient
from companion.mavlink.poses import ATTITUDE
from companion.mavlink.rules import Finding, findings_of
from companion.mission import events
from companion.mission.decisions import Context
from companion.mission.mission import Mission
from companion.mission.state import State

_POSITION: Final = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_TELL_SPEED_S = 1.0
_NOT_YET = (wire.MAV_RESULT_TEMPORARILY_REJECTED, wire.MAV_RESULT_IN_PROGRESS)
_MAX_SETS = 3  # of one parameter: a client that sets it back so often means it
_HOME_MOVED_M = 5.0
_LOOK_S = 2.0
_ENOUGH = 0.5  # of what was asked for: the rest may have been lost
_QUIET_S = 10.0  # between requests of what may well have nothing to say


AutopilotCommand = events.SetMode | events.SetSpeed | events.Arm | events.Disarm | events.TakeOff
"""Commands to an autopilot, besides setpoints."""


@final
class StreamRequests:
    """Requests the message streams that a flight needs, and repeats the requests.

    A request may get lost (ardupilot.md 0: one in the first 60 ms after boot is acknowledged and
    dropped), a reboot clears them all, and ACKs are not reliable (mavlink.md C3): only the arrival
    of the message counts.
    """

    def __init__(self, mission: Mission, system_id: int, autopilot: Autopilot) -> None:
        self._system_id, self._once = system_id, autopilot.requested_once
        self._wanted_hz = {_POSITION: mission.position_rate_hz, **autopilot.streams_hz}
        self._quiet = autopilot.intermittent
        self.begun = False
        """Whether they have been requested."""
        self.forget()

    def add(self, streams_hz: Mapping[int, float]) -> None:
        """Those of a sensor, which may well have nothing to say; but for attitudes."""
        self._quiet |= streams_hz.keys() - {ATTITUDE}
        for number, rate_hz in streams_hz.items():
            self._wanted_hz[number] = max(rate_hz, self._wanted_hz.get(number, 0.0))

    def forget(self) -> None:
        """The autopilot has rebooted: all requests are void."""
        self.count = Counter[int]()
        """How often each message was received since the autopilot booted; counted by the caller."""
        self._before = Counter[int]()
        """The same when it was last looked at."""
        self._asked_s: dict[int, float] = {}
        self._looked_s = -math.inf

    def begin(self, now_s: float) -> list[Message]:
        """Request everything that is not streamed by default."""
        self.begun = True
        return self._request(self._wanted_hz, now_s)

    def rebase_time(self, shift_s: float) -> None:
        """Shift all stored times by this much: the clock was replaced."""
        self._looked_s += shift_s
        self._asked_s = {key: at_s + shift_s for key, at_s in self._asked_s.items()}

    @property
    def due_s(self) -> float:
        """When they are looked at again, at the latest."""
        return self._looked_s + _LOOK_S if self.begun else math.inf

    def on_time(self, now_s: float) -> list[Message]:
        """Requests for messages that are missing or too slow, every two seconds."""
        since_s = now_s - self._looked_s
        if not self.begun or since_s < _LOOK_S:
            return []
        late = [number for number in self._wanted_hz if self._is_late(number, since_s, now_s)]
        return self._request(late, now_s)

    @property
    def missing(self) -> list[str]:
        """Names of requested messages that never came."""
        lacking = self._wanted_hz.keys() - self.count.keys() - self._quiet
        return [wire.mavlink_map[number].msgname for number in self._wanted_hz if number in lacking]

    def _is_late(self, number: int, since_s: float, now_s: float) -> bool:
        """Whether too few have come, and enough time has passed since it was asked for."""
        expected = _ENOUGH * self._wanted_hz[number] * min(since_s, _LOOK_S)
        came = self.count[number] - self._before[number]
        again_s = _QUIET_S if number in self._quiet else _LOOK_S
        asked_s = self._asked_s.get(number, -math.inf)
        return came < max(expected, 1.0) and now_s - asked_s >= again_s

    def _request(self, numbers: Iterable[int], now_s: float) -> list[Message]:
        """Streams, and whatever is never streamed and has not come yet."""
        self._looked_s, self._before = now_s, Counter(self.count)
        self._asked_s |= dict.fromkeys(numbers, now_s)
        rates = [(number, 1e6 / self._wanted_hz[number]) for number in numbers]
        once = [number for number in self._once if number not in self.count]
        to, interval = self._system_id, wire.MAV_CMD_SET_MESSAGE_INTERVAL
        return [
            *(command_long(to, interval, number, every_us) for number, every_us in rates),
            *(command_long(to, wire.MAV_CMD_REQUEST_MESSAGE, number) for number in once),
        ]


@final
class AutopilotClient:
    """The protocols of one autopilot: streams, parameters, plans."""

    def __init__(self, context: Context, system_id: int, autopilot: Autopilot) -> None:
        """context: in shadow it only reports what parameters to set."""
        self._mission = mission = context.mission
        self._sets_parameters = not context.shadow
        self.system_id, self.autopilot, self.to = system_id, autopilot, To(system_id, mission.frame)
        self.streams = StreamRequests(mission, system_id, autopilot)
        wanted = [rule.names for rule in autopilot.rules if rule.matters(mission)]
        bytewise = autopilot.firmware.is_bytewise
        self.parameters = ParameterClient(system_id, wanted, bytewise=bytewise)
        self.plans = PlanClient(system_id)
        self._reads = dict.fromkeys(parameter_client.MESSAGES, self.parameters.on_message)
        self._reads |= dict.fromkeys(plan_client.MESSAGES, self.plans.on_message)
        self.is_news = True
        """Whether something was read since the parameters and lists were last looked at."""
        self.findings: list[Finding] = []
        """Of the parameters, as they were judged last."""
        self.origin_nea_m: events.Vector | None = None
        self.last_text: tuple[float, str] = (-math.inf, "")
        """When it last sent a text, and what."""
        self.here_ne_m: tuple[float, float] | None = None
        self.own_fence = OwnFence(mission, autopilot, self.plans)
        self.notes, self.warnings = self.own_fence.notes, self.own_fence.warnings
        """What a person should hear of, since last looked at; warnings: of what is grave.  The
        fence says what it has to say into the same lists."""
        self._home_nea_m: events.Vector | None = None
        self._breaches = self._targets_version = 0
        self._judged = -1
        self._sets = Counter[str]()
        """How often each parameter was set."""
        self._refusal_told = ""
        self._plans_told = False
        self._speed: list[Message] = []
        """What tells it how fast to fly, until it has said that it will."""
        self._speed_told_s = -1e9

    @staticmethod
    def of(heartbeat: Message, context: Context) -> "AutopilotClient | None":
        """The client for the sender of this heartbeat; None if the mission is not for it."""
        mission, autopilot = context.mission, autopilot_of(heartbeat)
        if autopilot is None or autopilot.traits.kind != mission.kind:
            return None
        if mission.autopilot not in (None, autopilot.firmware.name):
            return None
        return AutopilotClient(context, heartbeat.get_srcSystem(), autopilot)

    def rebase_time(self, shift_s: float) -> None:
        """Shift all stored times by this much: the clock was replaced."""
        self._speed_told_s += shift_s
        for client in (self.streams, self.parameters, self.plans):
            client.rebase_time(shift_s)

    def rebooted(self) -> None:
        """The autopilot has rebooted: request everything again."""
        self.streams.forget()
        self.parameters.restart()
        self.plans.refresh()
        self.own_fence.rebooted()
        self._plans_told = False
        self.origin_nea_m = self._home_nea_m = None
        self._sets.clear()
        self._refusal_told = ""
        self._speed = []

    # --- in

    def on_message(self, message: Message, now_s: float) -> list[Message]:
        """Handle a message of the autopilot; returns the replies."""
        self.count(number := message.get_msgId(), now_s)
        if (read := self._reads.get(number)) is None:
            return []
        self.is_news = True
        return read(message, now_s)

    def count(self, number: int, now_s: float) -> None:
        """It has sent a message of this kind."""
        self.streams.count[number] += 1
        self.parameters.heard_s = now_s

    def on_position(self, message: Message, now_s: float) -> events.Position | None:
        """Decode GLOBAL_POSITION_INT: a fast path of `on_message` and `event_of`."""
        self.streams.count[_POSITION] += 1
        self.parameters.heard_s = now_s
        event = position(message, now_s, self._mission.frame)
        if event is not None:
            self.here_ne_m = event.position_nea_m[:2]
        return event

    def event_of(self, message: Message, now_s: float) -> events.Event | None:
        """The mission event of one of its messages; None if there is none."""
        firmware, breached = self.autopilot.firmware, False
        match message.get_msgId():
            case wire.MAVLINK_MSG_ID_COMMAND_ACK:
                return self._on_command_ack(message.command, message.result, now_s)
            case wire.MAVLINK_MSG_ID_STATUSTEXT:
                self.last_text = now_s, message.text
                breached = firmware.breached.search(message.text) is not None
            case EventMessage.id:  # PX4 says no text to a companion, but this
                breached = message.id_of_event & 0xFFFFFF in firmware.breach_events
            case wire.MAVLINK_MSG_ID_FENCE_STATUS:
                before, self._breaches = self._breaches, message.breach_count
                breached = bool(message.breach_status) and message.breach_count != before
            case _:
                frame, origin = self._mission.frame, self.origin_nea_m
                event = self.autopilot.event_of(message, now_s, frame, origin)
                self._remember(event)
                return event
        return events.FenceBreach(time_s=now_s) if breached else None

    def _on_command_ack(self, command: int, result: int, now_s: float) -> events.Event | None:
        """ACK of a speed change: turns and stopping distance are proven for that speed."""
        asked = any(command == request.command for request in self._speed)
        if asked and result not in _NOT_YET:
            self._speed = []
            if result != wire.MAV_RESULT_ACCEPTED:
                self.notes.append("the autopilot does not take the mission's speed")
        if (command, result) == (wire.MAV_CMD_NAV_TAKEOFF, wire.MAV_RESULT_ACCEPTED):
            return events.TakeOffTaken(time_s=now_s)
        return None

    def _remember(self, event: events.Event | None) -> None:
        match event:
            case events.VehicleStatus(mode=mode) if mode is not events.Mode.GUIDED:
                self._speed = []  # it, or another controller, decides now
            case events.Home(position_nea_m=home) if _moved(self._home_nea_m, home):
                self._home_nea_m, self.is_news = home, True
            case events.Origin(position_nea_m=origin):
                if self.origin_nea_m is not None and _moved(self.origin_nea_m, origin):
                    self.notes.append("the autopilot's origin has moved")
                self.origin_nea_m = origin
            case _:
                pass

    def journal_entry(self, message: Message) -> dict[str, Any] | None:
        """The journal entry of a message, besides that of its event; None if there is none."""
        number = message.get_msgId()
        if number == wire.MAVLINK_MSG_ID_STATUSTEXT:
            return {"kind": "vehicle says", "text": message.text}
        if number != wire.MAVLINK_MSG_ID_COMMAND_ACK:
            return None
        refused = message.result != wire.MAV_RESULT_ACCEPTED
        tells = refused and self.autopilot.acknowledges_setpoints  # one that is taken is no news
        if message.command == wire.MAV_CMD_DO_REPOSITION and not tells:
            return None
        return {"kind": "acknowledged", "command": message.command, "result": message.result}

    # --- out

    def command_messages(self, command: AutopilotCommand, state: State) -> list[Message]:
        """The messages of a command."""
        autopilot, arms = self.autopilot, wire.MAV_CMD_COMPONENT_ARM_DISARM
        match command:
            case events.SetMode():
                return autopilot.set_mode(command, self.to)
            case events.SetSpeed(speed_m_s=speed):
                self._speed = autopilot.set_speed(speed, self.system_id)
                self._speed_told_s = state.now_s
                return self._speed
            case events.Arm():  # without force: its own checks stay on
                return [command_long(self.system_id, arms, 1.0)]
            case events.Disarm():  # without force: in the air it refuses
                return [command_long(self.system_id, arms, 0.0)]
            case events.TakeOff():
                position, heading_rad = state.vehicle.position_nea_m, state.vehicle.heading_rad
                if position is None:
                    return []
                return autopilot.take_off(command, position, heading_rad or 0.0, self.to)

    @property
    def due_s(self) -> float:
        """When `on_time` has something to do, at the latest; -inf: at any time."""
        if not self.streams.begun:
            return math.inf
        if self.notes or self.warnings or not self.parameters.is_done:
            return -math.inf
        speed_s = self._speed_told_s + _TELL_SPEED_S if self._speed else math.inf
        return min(speed_s, self.streams.due_s, self.plans.due_s)

    def on_time(self, now_s: float) -> list[Message]:
        """The messages that are due."""
        if not self.streams.begun:
            return []
        asked = self.streams.on_time(now_s)
        if self._speed and now_s - self._speed_told_s >= _TELL_SPEED_S:
            self._speed_told_s = now_s
            asked += self._speed
        self.is_news = self.is_news or not self.parameters.is_done  # it may give one up
        asked += self.parameters.on_time(now_s)
        asked += self.plans.on_time(now_s)
        return asked

    def news(self, now_s: float) -> list[events.Event]:
        """New events since the last call."""
        if not (self.streams.begun and self.is_news):
            return []
        fresh = [*self._checked_parameters(now_s), *self._read_plans(now_s)]
        if self._mission.fence_from_vehicle and self._plans_told:
            fresh += self.own_fence.reading(now_s)
        self.is_news = self.own_fence.is_drawing  # some of a fence with each message
        return fresh

    def _checked_parameters(self, now_s: float) -> list[events.Event]:
        client = self.parameters
        if not client.is_done or client.version == self._judged:
            return []
        self._judged = client.version
        home = None if self._home_nea_m is None else self._home_nea_m[2]
        self.findings = findings_of(self.autopilot.rules, client.values, self._mission, home)
        if self._sets_parameters and self._set(self.findings):
            return []  # they are judged again once they are read back
        sets = self._sets_parameters
        refused = [finding for finding in self.findings if finding.set_to is None or sets]
        refusal = self._in_words(refused[0]) if refused else ""
        again, self._refusal_told = refusal == self._refusal_told != "", refusal
        prepared = events.Prepared(time_s=now_s, item=events.Item.PARAMETERS, refusal=refusal)
        return [] if again else [prepared]

    def _set(self, findings: list[Finding]) -> bool:
        """Set parameters as the checks demand, with a text for each; whether there was any.

        A parameter that another client keeps setting back is refused instead.
        """
        client, any_set = self.parameters, False
        for finding in findings:
            name, times = finding.name, self._sets[finding.name]
            if finding.set_to is None or name in client.failed_sets or times >= _MAX_SETS:
                continue
            client.set(name, finding.set_to)
            self._sets[name] += 1
            any_set = True
            if times == 0:
                self.notes.append(f"set {name} to {finding.set_to:g}")
        return any_set

    def _in_words(self, finding: Finding) -> str:
        """Text of a result that prevents the flight."""
        named = f"{finding.name} = {finding.value:g}" if finding.set_to is not None else ""
        if named and (why := self.parameters.failed_sets.get(finding.name)):
            return f"{named}: {why}. Set it to {finding.set_to:g} by hand: {finding.rule}"
        if named and self._sets[finding.name] >= _MAX_SETS:
            return f"{named}: somebody keeps setting it back. End that: {finding.rule}"
        return str(finding)

    def _read_plans(self, now_s: float) -> list[events.Event]:
        plans, mission, own = self.plans, self._mission, self.own_fence
        if not plans.is_done or not self.parameters.is_done:
            return []
        fresh, refusal = list[events.Event](), ""
        if mission.fence_from_vehicle:
            values, home, place_ne_m = self.parameters.values, self._home_nea_m, self.here_ne_m
            news = own.update(values, home, place_ne_m, now_s)
            if news is None:
                return []
            changed, refusal = news
            fresh += changed
        plan = plans.plans[MISSION]
        if mission.targets_from_vehicle and plan.version != self._targets_version:
            self._targets_version = plan.version
            home_first = self.autopilot.firmware.home_first
            route = targets_of(plan.items, mission.frame, home_first=home_first)
            self.notes += route.notes
            if route.end_action not in (None, mission.end_action):
                words = f"its mission ends with {route.end_action.value}"
                self.notes.append(f"{words}; what counts is end.action: {mission.end_action.value}")
            fresh.append(events.TargetsChanged(time_s=now_s, targets_ne_m=route.targets_ne_m))
        if refusal or not self._plans_told:
            self._plans_told = True
            fresh.append(events.Prepared(time_s=now_s, item=events.Item.PLANS, refusal=refusal))
        return fresh


def _moved(one: events.Vector | None, other: events.Vector) -> bool:
    """Whether a place is not yet known, or not where it was."""
    return one is None or max(abs(a - b) for a, b in zip(one, other, strict=True)) > _HOME_MOVED_M
