"""The whole companion, without I/O: bytes and vehicle events in, bytes and journal entries out.

    session.receive(data, at_s)  bytes of a link, in any portions, and when they arrived
    session.run() -> Output      handle them: what to send, to record and to compute
    session.deliver(outcome)     the answer to Output.plan, then run() again
    session.silence(seconds)     the autopilot was not heard for so long (wall time of the runtime)
    session.part_died(part, why) a part of the runtime has died
    session.stop()               a person wants the end
    session.say_go()             a person at the terminal says go

Time is the vehicle's: the newest time_boot_ms of its autopilot (in lockstep, TIMESYNC too); until
it is known, and for what must go on in a silence, the silence itself counts.  A plan becomes an
event at the first position at or after request + T, never earlier; in lockstep run() stops before
that position until the plan is delivered (Output.awaits_plan), otherwise the plan is late.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from operator import attrgetter
from typing import Any, Final, final

from msgspec.structs import replace

from companion.mavlink.autopilot_client import AutopilotClient, AutopilotCommand
from companion.mavlink.autopilots import described
from companion.mavlink.component import COMMANDS, Component, heartbeat
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, Message, wire
from companion.mavlink.frames import Incoming, Receiver, boot_ms_of
from companion.mavlink.link import (
    TIME_ONLY_MESSAGES,
    UNDECODED_MESSAGES,
    ClockReading,
    FrameEncoder,
    Output,
    VehicleClock,
    VehicleSelector,
)
from companion.mavlink.poses import ATTITUDE, Poses
from companion.mavlink.preflight import Preflight
from companion.mavlink.sensors import Sensor, others_of, scanner_of
from companion.mavlink.signing import Signing
from companion.mavlink.statustext import StatusTexts, final_text
from companion.mission import changes, checkpoint, events, journal, machine
from companion.mission.checkpoint import PERIOD_S
from companion.mission.decisions import GONE_IN_AIR_S, GONE_S, Context
from companion.mission.events import Disarm, End, Mode, SetMode, Vector, VehicleStatus
from companion.mission.mission import Mission
from companion.mission.pending_plan import PendingPlan
from companion.mission.start import Resume, Start
from companion.mission.state import IN_AIR, Phase
from companion.mission.tables import parting
from companion.planner.request import PlanOutcome, values_of

_HEARTBEAT: Final = wire.MAVLINK_MSG_ID_HEARTBEAT
_POSITION: Final = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_TIMESYNC: Final = wire.MAVLINK_MSG_ID_TIMESYNC
_MOST_WAITING = 5000  # messages: 1.5 s of the busiest autopilot, and then the oldest go
_LOCKSTEP = 50  # TIMESYNC in 10 s, of a simulator that waits; an autopilot's own come every 10 s
_EARLY_S = 10.0
_ROUNDING_S = 1e-6  # a deadline that is looked at too early costs nothing
_AGAIN_S = 1.0
_NO_VEHICLE_S = 10.0
_SILENT_S = 3.0


_Handler = Callable[[Incoming], None]
_Reader = Callable[[Message, float], None]
_frame_of, _sender_of = attrgetter("frame"), attrgetter("system", "component")


@final
class Session:
    """Receiver, clock, protocols and mission machine of one companion."""

    def __init__(
        self,
        mission: Mission,
        *,
        seed: int,
        lockstep: bool,
        shadow: bool = False,
        signing: Signing | None = None,
        resume: Resume | None = None,
        go: bool = False,
        version: str = "0",
    ) -> None:
        """resume: from a previous companion.

        go: take off as soon as the vehicle is ready, without being told; in lockstep always.
        """
        self.mission = mission
        self.state = checkpoint.initial_state(mission, resume)
        self.clock = VehicleClock(self.state.now_s)
        self.context = Context(
            mission=mission, seed=seed, lockstep=lockstep, shadow=shadow, go=go or lockstep
        )
        self.vehicle_name = ""
        """What the vehicle says that it is."""
        self.last_scan: events.ScanDone | None = None
        self.warned: tuple[float, str] = (-math.inf, "")
        """When a person was last warned, and of what."""
        self.vehicle: AutopilotClient | None = None
        """The autopilot, once it is known."""
        self._poses = Poses(mission.frame)
        self._scanner = scanner_of(mission, self._poses)
        self.sensors: tuple[Sensor, ...] = (self._scanner, *others_of(mission, self._poses))
        self._measuring = [each for each in self.sensors if ATTITUDE in each.streams_hz]
        """Those that need poses."""
        read = (number for sensor in self.sensors for _, number in sensor.reads)
        self.receiver = Receiver(signing, UNDECODED_MESSAGES.difference(read))
        self._waiting: deque[Incoming] = deque(maxlen=_MOST_WAITING)
        """Received messages that have not been handled yet, in order."""
        self.signing = signing
        self._lockstep, self._version = lockstep, version
        before = None if resume is None else resume[0].get("system_id")
        self.selector = VehicleSelector(mission.system_id or before)
        """Which of those that are heard is the vehicle."""
        self._outbox = FrameEncoder(self.selector.system_id, signing)
        self._out = self._outbox.out
        self._texts = StatusTexts()
        self._is_scanning = False
        self._preflight = Preflight()
        self._component: Component | None = None
        self._time_asked = 0
        self._plan = PendingPlan()
        self._keeper = checkpoint.CheckpointPolicy(keeps_map=mission.near is None)
        self._end: End | None = None
        self._last_asked: tuple[SetMode | Disarm, ...] = ()
        """What the autopilot was told when the mission ended, until it has done it."""
        self._broke_off_landing = False
        """Whether it was landing for us then: what lands otherwise somebody has told to."""
        self._status: VehicleStatus | None = None
        """Its last heartbeat; at the end only one from after that."""
        self._asked_at_s = -math.inf
        """When it was asked for a mode; before there is a vehicle, when our heartbeat was sent."""
        self._handlers = self._table()
        self._clients = (self._serve_vehicle, self._beat, self._say, self._ask_again)
        self._due_s = self._looked_s = -math.inf
        """When the first of the clients is due, and when it was last looked whether one is."""
        self._silence_told_s = 0.0
        start = Start.of(self.context, resume, version=version)
        self._out.inputs.append(("start", start.values()))
        if resume is not None:
            kept = {key: resume[0][key] for key in checkpoint.LOST if key in resume[0]}
            self._note({"kind": "resumed", "phase": resume[0].get("phase"), **kept})

    def _table(self) -> dict[tuple[int, int | None], tuple[_Handler, ...]]:
        """What handles a message of our vehicle, by component and kind; None: any other kind."""
        at, any_other = AUTOPILOT_COMPONENT, self._on_autopilot
        table: dict[tuple[int, int | None], tuple[_Handler, ...]] = {
            (at, None): (any_other,),
            (at, _HEARTBEAT): (self._on_heartbeat, any_other),
            (at, _TIMESYNC): (any_other, self._on_timesync),
            (at, _POSITION): (self._on_position,),
        }
        for sensor in self.sensors:
            for (component, number), read in sensor.reads.items():
                others = table.get((component, number), (any_other,) * (component == at))
                table[component, number] = (partial(self._on_sensor, sensor, read), *others)
        return table

    @property
    def now_s(self) -> float:
        """Vehicle time."""
        return self.clock.now_s

    @property
    def frames_heard(self) -> tuple[int, int]:
        """Frames of our autopilot so far, and how many are missing between them."""
        sender = (self.selector.system_id or 0, AUTOPILOT_COMPONENT)
        return self.receiver.counted.get(sender, (0, 0, 0))[1:]

    @property
    def senders(self) -> list[tuple[int, int]]:
        """System and component of all that were heard."""
        return sorted(self.receiver.counted)

    # --- what the runtime calls

    def receive(self, data: bytes, at_s: float | None = None) -> bool:
        """Receive bytes of the link; returns whether the autopilot was heard.

        at_s: time of arrival, by any monotonic clock; the vehicle's cannot leap ahead of it.
        """
        if self.signing is not None and at_s is not None:
            self.signing.on_time(at_s)
        messages = self.receiver.read(data, at_s)
        self._waiting.extend(messages)
        self._out.inputs.append(("receive", b"".join(map(_frame_of, messages)), at_s))
        if self.signing is not None and (complaint := self.signing.complaint(self.now_s)):
            self.complain(complaint)
        ours = self.selector.system_id, AUTOPILOT_COMPONENT
        heard = ours in map(_sender_of, messages) or any(map(self.selector.may_be_ours, messages))
        if heard:
            self._silence_told_s = 0.0
        return heard

    def deliver(self, outcome: PlanOutcome) -> None:
        """The answer to the last plan request."""
        self._out.inputs.append(("deliver", values_of(outcome)))
        self._plan.deliver(outcome)

    def part_died(self, part: str, error: str) -> None:
        """The planner has failed, or another worker of the runtime has died."""
        self._out.inputs.append(("part_died", part, error))
        died = events.PlannerDied(time_s=self.now_s, error=f"{part}: {error}" if part else error)
        if part == "planner" and self._lockstep:
            self._plan.deliver(died)
        else:
            self._handle(died)

    def stop(self) -> None:
        """The operator ends the mission."""
        self._out.inputs.append(("stop",))
        self._handle(events.StopAsked(time_s=self.now_s))

    def say_go(self) -> str:
        """A person at the terminal says go; returns why not, empty if it takes off."""
        self._out.inputs.append(("say_go",))
        order = events.Order(time_s=self.now_s, kind=events.OrderKind.START, sender="terminal")
        if self.state.phase in IN_AIR or self.state.phase is Phase.ARMING:
            return f"the mission is {self.state.phase.value} already"
        if self.state.airborne:
            return "it has taken off already"
        heard = {"kind": "command", "sender": order.sender, "command": wire.MAV_CMD_MISSION_START}
        if self._judged(order) is not changes.OrderResult.ACCEPTED:
            why = changes.why_not(self.state, order)
            self._note({**heard, "result": "temporarily_rejected", "why": why})
            return why
        self._note({**heard, "order": "start"})
        self._handle(order)
        return ""

    def complain(self, text: str) -> None:
        """Send a warning of what is not in the inputs: rejected frames, a disk that has failed."""
        self._out.inputs.append(("complain", text))
        self._send_text(text, warning=True)

    def silence(self, silent_s: float) -> None:
        """The autopilot was silent for this long; called repeatedly while it lasts."""
        self._out.inputs.append(("silence", silent_s))
        more_s = max(silent_s - self._silence_told_s, 0.0)
        waiting = self.state.stage.phase is Phase.WAITING
        for limit in (_NO_VEHICLE_S,) if waiting else (_SILENT_S, GONE_S, GONE_IN_AIR_S):
            if self._silence_told_s < limit <= silent_s:
                self._handle(events.LinkLost(time_s=self.now_s, silent_s=limit))
        self._silence_told_s = silent_s
        if self.clock.on_silence(more_s, counts=not waiting) is ClockReading.LATER:
            self._handle(events.Tick(time_s=self.now_s))
        self._meet_deadlines()

    def run(self) -> Output:
        """Handle the received messages: time, sender if it has our ids, then what each means.

        As far as possible: a position that has to wait for a plan stays, and what came after it.
        """
        if self._out.inputs:  # else it changes nothing
            self._out.inputs.append(("run",))
        while self._waiting:
            heard = self._waiting.popleft()
            number, component = heard.number, heard.component
            counts = heard.message is not None or number in TIME_ONLY_MESSAGES
            if counts and (number == _HEARTBEAT or self.selector.system_id is None):
                self._select(heard)
            is_ours = counts and heard.system == self.selector.system_id
            if is_ours and component == AUTOPILOT_COMPONENT:
                if number == _POSITION and self._plan.due_s < math.inf and self._lacks_plan(heard):
                    self._waiting.appendleft(heard)
                    self._out.awaits_plan = True
                    break
                counts = self._takes_time(heard)
            self._out.record.append((self.clock.now_s, heard.frame))
            if component == COMPANION_COMPONENT:  # another process with our ids may have sent it
                twins = self._outbox.duplicates
                self._handle(twins.heard(heard.frame, self.selector.system_id, self.now_s))
            if counts and number in COMMANDS:
                self._serve(heard)
            if counts and is_ours:
                table = self._handlers
                for handle in table.get((component, number)) or table.get((component, None), ()):
                    handle(heard)
        since_s = self.clock.now_s - self._keeper.looked_at_s
        if not 0.0 <= since_s < PERIOD_S or self.state.flight.known is not self._keeper.known:
            self._keep()
        return self.take_output()

    def take_output(self) -> Output:
        """The pending output; after an error, the output until then."""
        out = self._out
        self._out = self._outbox.out = Output()
        if self._end is not None:
            out.end, out.settled = self._end, self._settled()
        return out

    def farewell(self) -> Output:
        """The last frames of a companion that ends; puts a vehicle under our control on hold."""
        self._out.inputs.append(("farewell",))
        self._send_all(self._holding())
        if self._end is None:
            self._send_all(self._texts.last("ended: the companion was stopped"))
        self._send_all([heartbeat(wire.MAV_STATE_POWEROFF)])
        self._keep(at_once=True)
        return self.take_output()

    def hold_frames(self) -> list[bytes]:
        """The frames that put a vehicle under our control on hold, unsigned: no side effects."""
        return self._outbox.encode_unsent(self._holding())

    def final_text(self, why: str) -> list[bytes]:
        """The frames of the text that the companion has ended, and why; as `hold_frames`."""
        return self._outbox.encode_unsent(final_text(f"ended, failed: {why}"))

    def signed(self, frames: list[bytes]) -> list[bytes]:
        """Those frames as they are to be sent now, by any thread: a signature ages."""
        return self._outbox.signed(frames)

    def _holding(self) -> Sequence[Message]:
        if self.vehicle is None or self.context.shadow:
            return ()
        messages: list[Message] = []
        traits = self.state.vehicle.traits
        for command in parting(self.state):
            circles = isinstance(command, SetMode) and command.at_nea_m and not traits.hovers
            if circles and not traits.holds_in_guided:
                # anywhere first: this is told once, and it may refuse to hold on its circle
                messages += self.vehicle.command_messages(SetMode(mode=Mode.HOLD), self.state)
            messages += self.vehicle.command_messages(command, self.state)
        return messages

    # --- messages

    def _select(self, heard: Incoming) -> None:
        """Select our vehicle, as long as it is not known."""
        if heard.number == _HEARTBEAT and self.selector.on_heartbeat(heard):
            assert self.selector.system_id is not None
            self._outbox.set_system_id(self.selector.system_id)
        elif name := self.selector.ambiguity:
            self._handle(
                events.VehicleFound(time_s=self.now_s, system_id=0, traits=None, name=name)
            )

    def _lacks_plan(self, heard: Incoming) -> bool:
        """Whether a position has to wait for a plan; if it does not, though one is due, say so."""
        time_s = heard.message.time_boot_ms * 1e-3
        at_s = None if self._lockstep else heard.at_s
        if not (self._plan.is_missing(time_s) and self.clock.believes(time_s, at_s)):
            return False
        if not self._lockstep and self._plan.newly_late():
            late = self.state.flight.plan_id
            self._handle(events.PlanLate(time_s=self.now_s, plan_id=late))
        return self._lockstep

    def _on_sensor(self, sensor: Sensor, read: _Reader, heard: Incoming) -> None:
        """A message that a sensor reads: what it says then, and whether its scan is over."""
        read(heard.message, self.now_s)
        self._handle(sensor.seen(self.now_s, self.state.flight.known))
        if sensor is self._scanner and self._is_scanning:
            self._scan_on()

    def _on_heartbeat(self, heard: Incoming) -> None:
        """The first heartbeat of our autopilot: select its strategy."""
        if self.vehicle is not None:
            return
        system, name = heard.system, described(heard.message)
        self.vehicle_name = name
        self.vehicle = AutopilotClient.of(heard.message, self.context)
        traits = None
        if self.vehicle is not None:
            self._component = Component(self.mission, system, self._version)
            for sensor in self.sensors:
                self.vehicle.streams.add(sensor.streams_hz)
            traits = self.vehicle.autopilot.traits
        facts: dict[str, Any] = {"system_id": system, "name": name}
        self._note({"kind": "vehicle found", **facts})
        self._handle(events.VehicleFound(time_s=self.now_s, traits=traits, **facts))

    def _on_position(self, heard: Incoming) -> None:
        """A position, which drives the mission; a due plan takes effect before it."""
        if (vehicle := self.vehicle) is None:
            return
        now_s, plan, shadow = self.clock.now_s, self._plan, self.context.shadow
        if now_s >= plan.due_s and not shadow:
            self._handle(plan.take(now_s))
        event = vehicle.on_position(heard.message, now_s)
        if event is not None and self._measuring:
            self._poses.on_position(event.time_s, event.position_nea_m)
        for sensor in self._measuring:
            self._handle(sensor.seen(now_s, self.state.flight.known))
        self._handle(event)
        if now_s >= plan.due_s and shadow:
            self._handle(plan.take(now_s))  # the position before may be a second old
        if vehicle.is_news:
            self._look_at_news(vehicle)
        if self.state.stage.phase in (Phase.PREPARING, Phase.READY):  # the checks go on
            if (centre := self._preflight.scan_position(self)) is not None:
                self.scan(centre)
            else:
                self._handle(self._preflight.judged(self))
        if self._is_scanning:
            self._scan_on()
        if not self._looked_s <= now_s < self._due_s - _ROUNDING_S:
            self._meet_deadlines()

    def _on_autopilot(self, heard: Incoming) -> None:
        """Any other message of the autopilot."""
        if (vehicle := self.vehicle) is None:
            return
        message, now_s = heard.message, self.clock.now_s
        if message is None:  # only its time is read
            vehicle.count(heard.number, now_s)
        else:
            self._send_all(vehicle.on_message(message, now_s))
            self._handle(vehicle.event_of(message, now_s))
        if vehicle.is_news or vehicle.notes:
            self._look_at_news(vehicle)
        self._meet_deadlines()
        if message is not None and (noted := vehicle.journal_entry(message)) is not None:
            self._note(noted)

    def _look_at_news(self, vehicle: AutopilotClient) -> None:
        """Handle new events of the autopilot client; its next requests may be due."""
        for event in vehicle.news(self.now_s):
            self._handle(event)
        self._due_s = -math.inf

    def _on_timesync(self, heard: Incoming) -> None:
        """A simulator in lockstep advances once its request is answered."""
        if (message := heard.message).tc1 != 0:
            return
        self._time_asked += 1
        self._send_all([wire.MAVLink_timesync_message(message.ts1, message.ts1)])
        seldom = self.vehicle is not None and not self.vehicle.autopilot.firmware.asks_time_often
        often = self._time_asked == _LOCKSTEP and self.now_s < _EARLY_S
        if seldom and often and not self._lockstep:
            self._send_text("simulator in lockstep: use --lockstep here too", warning=True)

    def _serve(self, heard: Incoming) -> None:
        """Handle a request to the companion itself."""
        if (component := self._component) is None:
            return
        self._due_s = -math.inf
        served = component.on_message(heard.message, self.now_s)
        self._send_all(served.replies)
        self._note(served.note)
        if served.text:
            self._send_text(served.text, warning=True)
        if served.order is not None:
            verdict = self._judged(served.order)
            self._send_all(component.order_done(served.order, verdict))
            if verdict is changes.OrderResult.ACCEPTED:
                self._handle(served.order)
            else:
                self._send_text(changes.why_not(self.state, served.order), warning=True)

    def _judged(self, order: events.Order) -> changes.OrderResult:
        """The result of an order; of a go, after a look at every check."""
        if order.kind is events.OrderKind.START and self.state.phase is Phase.READY:
            self._handle(events.Tick(time_s=self.now_s))
            self._handle(self._preflight.judged(self, at_once=True))
        return changes.order_result(self.state, order, go=self.context.go)

    # --- the clock

    def _takes_time(self, heard: Incoming) -> bool:
        """Take the time that a message of the autopilot tells, if any.

        False: nothing that it tells counts, as it is doubted or repeats one just before.
        """
        number, message = heard.number, heard.message
        if number == _POSITION or number == wire.MAVLINK_MSG_ID_SYSTEM_TIME:
            time_s = message.time_boot_ms * 1e-3
        elif number in TIME_ONLY_MESSAGES:
            time_ms = boot_ms_of(heard.frame)
            if not self.clock.is_newer(number, time_ms):
                return False
            time_s = time_ms * 1e-3
        elif number == _TIMESYNC and self._lockstep and message.tc1 == 0:
            time_s = message.ts1 * 1e-9
        else:
            if number == _HEARTBEAT and not self.context.shadow and self.clock.beat(message):
                self._handle(events.Tick(time_s=self.clock.going_on_s))
            return True
        before_s = self.clock.now_s
        # In lockstep the wall time at which it arrived says nothing.
        reading = self.clock.read(time_s, None if self._lockstep else heard.at_s)
        if reading is ClockReading.LATER:
            ahead_s = self.state.now_s - time_s
            if ahead_s > 0.0:  # while only heartbeats came, it was guessed
                self.state = machine.rebased(self.state, -ahead_s)
            if number != _POSITION:  # which is an event of that time itself
                self._handle(events.Tick(time_s=time_s))
        elif reading is ClockReading.FIRST:  # waits go on by the new clock
            self.state = machine.rebased(self.state, time_s - before_s)
            if self.vehicle is not None:
                self.vehicle.rebase_time(time_s - before_s)
        elif reading is ClockReading.REBOOTED:
            self._on_reboot()
        # A request that was answered late would make the vehicle wait for ever.
        return reading is not ClockReading.DOUBTED or number == _TIMESYNC

    def _on_reboot(self) -> None:
        """The autopilot has rebooted: prepare again; the known terrain is kept."""
        stage = replace(self.state.stage, since_s=self.now_s)
        self.state = replace(self.state, now_s=self.now_s, stage=stage)
        self._is_scanning, self._asked_at_s = False, -math.inf
        self._plan.forget()
        if self.vehicle is not None:
            self.vehicle.rebooted()
        self._handle(events.Rebooted(time_s=self.now_s))

    # --- deadlines

    def _meet_deadlines(self) -> None:
        """Once one of the clients is due, let each do what it has to, and say when it is next."""
        now_s, before_s = self.clock.going_on_s, self._looked_s
        self._looked_s = now_s
        if now_s < before_s or (now_s > before_s and now_s >= self._due_s - _ROUNDING_S):
            self._due_s = min([client(now_s) for client in self._clients])

    def _serve_vehicle(self, now_s: float) -> float:
        """Requests to the autopilot, and what a person should hear of it."""
        vehicle = self.vehicle
        if vehicle is None or self.state.stage.phase is Phase.WAITING:
            return math.inf
        self._send_all(vehicle.on_time(now_s))
        for texts, warning in ((vehicle.warnings, True), (vehicle.notes, False)):
            while texts:
                self._send_text(texts.pop(0), warning=warning)
        return vehicle.due_s

    def _beat(self, now_s: float) -> float:
        """Our heartbeat, and other messages of our own."""
        is_over = self._end is not None
        if (component := self._component) is not None:
            faulted = self.state.stage.phase is Phase.FAULTED or is_over
            self._send_all(component.on_time(now_s, self.state, faulted=faulted))
            return component.due_s
        if not is_over and now_s - self._asked_at_s >= _AGAIN_S:
            self._asked_at_s = now_s
            self._send_all([heartbeat(wire.MAV_STATE_STANDBY)])
        return self._asked_at_s + _AGAIN_S

    def _say(self, now_s: float) -> float:
        """The texts that wait."""
        self._send_all(self._texts.due(now_s))
        return self._texts.due_s

    def _ask_again(self, now_s: float) -> float:
        """After the end, for the mode in which the vehicle is left."""
        if self._end is None or not self._last_asked:
            return math.inf
        if now_s - self._asked_at_s >= _AGAIN_S and not self._settled():
            for command in self._last_asked:
                self._command(command)
        return self._asked_at_s + _AGAIN_S

    # --- what outlives this process

    def _keep(self, *, at_once: bool = False) -> None:
        """A checkpoint when the mission has moved on, and the map when it has grown."""
        if self._end is not None or self.context.shadow:
            return
        kept, self._out.known = self._keeper.due(self.state, self.clock.now_s, at_once=at_once)
        if kept is not None:
            self._out.checkpoint = {"system_id": self.selector.system_id, **kept}

    # --- plans and scans

    def _scan_on(self) -> None:
        """A scan that is under way: it is over, or something has to be asked for it."""
        told = self._scanner.go_on(self.now_s, self.state.vehicle.position_nea_m)
        if isinstance(told, events.ScanDone):
            self._is_scanning, self.last_scan = False, told
            self._handle(told)
        elif told is not None:
            self._send_all([told])

    def scan(self, centre_nea_m: Vector) -> None:
        """Begin a scan about a point, in any phase; its targets must be known."""
        blocks = self._scanner.begin(centre_nea_m, self.state, self.now_s)
        self._is_scanning = True
        self._note({"kind": "scan", "centre_nea_m": list(centre_nea_m), "blocks": blocks})
        self._scan_on()

    # --- events and commands

    def _handle(self, event: events.Event | None) -> None:
        """Let the mission decide on an event, if there is one, and do what it decides."""
        if event is None:
            return
        if isinstance(event, VehicleStatus):
            self._status = event
        before = self.state
        after, commands = machine.step(before, event, self.context)
        self.state, path = after, getattr(after.stage, "path", None)  # if it has one
        if type(event) is not events.Position:
            self._note(journal.of_event(event, after))
        if (
            after.stage.phase is not before.stage.phase
            or after.reason is not before.reason
            or after.flight.legs_flown != before.flight.legs_flown
            or (path is not None and path.outside_m)
        ):
            self._note(*journal.of_change(before, after))
        ends = End in map(type, commands)
        for command in commands:
            if type(command) is not events.Setpoint:
                self._carry_out(command)
            elif (vehicle := self.vehicle) is not None and not self.context.shadow:
                circle_m = after.task.limits.loiter_radius_m
                messages = vehicle.autopilot.setpoint(command, vehicle.to, circle_m)
                if messages is None:  # the wire has no numbers for it
                    self._note({"kind": "setpoint refused", "setpoint": repr(command)})
                    error = "setpoint out of range"
                    self._handle(events.PlannerDied(time_s=self.now_s, error=error))
                else:
                    self._outbox.send(messages, self.clock.now_s)
            if self._end is not None and not ends:
                return  # it was refused, and that has ended the mission: the rest counts no more
        if ends:
            asked = tuple(each for each in commands if isinstance(each, SetMode | Disarm))
            self._last_asked = asked  # nothing from before counts any more
            self._broke_off_landing = before.phase is Phase.LANDING
            self._status = None if asked else self._status
            assert self._end is not None
            held = any(
                isinstance(command, SetMode) and command.mode is Mode.HOLD for command in asked
            )
            text, messages = self._texts.end(self._end, held=held, disarmed=Disarm() in asked)
            arrived = self._end.outcome is events.Outcome.ARRIVED
            self._note({"kind": "say", "text": text, "warning": not arrived})
            self._send_all(messages)

    def _carry_out(self, command: events.Command) -> None:
        match command:
            case events.StartScan(centre_nea_m=centre):
                self.scan(centre)
            case events.Plan(request=request, due_s=due_s):
                self._plan.ask(due_s)
                self._out.plan = request
                self._note(journal.of_request(request, due_s))
            case events.StatusText(text=text, warning=warning, about=about):
                self._send_text(text, warning=warning, about=about)
            case End():
                self._note(journal.of_command(command))
                self._end = command
            case events.RequestStreams():
                if self.vehicle is not None:
                    self._send_all(self.vehicle.streams.begin(self.now_s))
            case SetMode() | Disarm() | events.SetSpeed() | events.Arm() | events.TakeOff():
                if not self.context.shadow:
                    self._command(command)
            case _:
                pass

    def _command(self, command: AutopilotCommand) -> None:
        assert self.vehicle is not None
        if isinstance(command, SetMode):
            self._asked_at_s = self.clock.going_on_s
        self._note(journal.of_command(command))
        self._send_all(self.vehicle.command_messages(command, self.state))

    def _send_text(self, text: str, *, warning: bool, about: str = "") -> None:
        self._note({"kind": "say", "text": text, "warning": warning})
        self.warned = (self.now_s, text) if warning else self.warned
        self._texts.add(text, self.clock.going_on_s, warning=warning, kind=about)

    def _settled(self) -> bool:
        """Whether the mission is over and the vehicle has done what it was told last."""
        status = self._status
        if self._silence_told_s >= _NO_VEHICLE_S or not self._last_asked:
            return True
        led_in = (Mode.GUIDED, Mode.TAKE_OFF, *(Mode.LAND,) * self._broke_off_landing)
        if status is None or status.mode in led_in:
            return False  # in any other it, or somebody, has chosen
        return not (status.armed and Disarm() in self._last_asked)

    def _send_all(self, messages: Iterable[Message]) -> None:
        self._outbox.send(messages, self.now_s)

    def _note(self, *entries: journal.Told | None) -> None:
        """Add entries to the journal; after what is noted something may be due."""
        for entry in filter(None, entries):
            self._due_s = -math.inf
            self._out.journal.append({"t_s": round(self.now_s, 6), **entry})
