"""The whole companion, without I/O: bytes and vehicle events in, bytes and journal entries out.

    session.receive(data, at_s)  bytes of a link, in any portions, and when they arrived
    session.run() -> Output      handle them: what to send, to record and to compute
    session.deliver(outcome)     the answer to Output.plan, then run() again
    session.silence(seconds)     the autopilot was not heard for so long (wall time of the runtime)
    session.part_died(part, why) a part of the runtime has died
    session.stop()               a person wants the end

Time is the vehicle's: the newest time_boot_ms of its autopilot (in lockstep, TIMESYNC too); until
it is known, and for what must go on in a silence, the silence itself counts.  A plan becomes an
event at the first position at or after request + T, never earlier; in lockstep run() stops before
that position until the plan is delivered (Output.awaits_plan), otherwise the plan is late.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, final

from companion.mavlink.autopilots import described
from companion.mavlink.citizen import SERVED, Citizen
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mavlink.inbox import VEHICLE, Inbox
from companion.mavlink.latch import Latch
from companion.mavlink.needless import Unread
from companion.mavlink.outbox import Outbox, Output
from companion.mavlink.preflight import Preflight
from companion.mavlink.presence import heartbeat
from companion.mavlink.scanning import Scanning
from companion.mavlink.signing import Signing
from companion.mavlink.statustext import StatusTexts, last_words, severity_of
from companion.mavlink.time_answers import TimeAnswers
from companion.mavlink.vehicle import Told, VehicleSide
from companion.mavlink.vehicle_clock import MERE_CLOCKS, Reading, VehicleClock
from companion.mavlink.vehicle_clock import MESSAGES as CLOCKS
from companion.mission import changes, checkpoint, entries, events, machine
from companion.mission.decisions import GONE_IN_AIR_S, GONE_S, Context, is_led
from companion.mission.events import End, Mode, SetMode, Vector
from companion.mission.mission import Mission
from companion.mission.pending_plan import PendingPlan
from companion.mission.renewed import replace
from companion.mission.start import Resume, Start
from companion.mission.state import Phase
from companion.planner import outcomes
from companion.planner.request import PlanOutcome

_TIMED = frozenset({*CLOCKS, "TIMESYNC", "HEARTBEAT"})
_MODE_AGAIN_S = 1.0
_NO_VEHICLE_S = 10.0
_SILENT_S = 3.0


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
        has_ground: bool = False,
        version: str = "0",
    ) -> None:
        """resume: what one before it has left; has_ground: has links to ground stations."""
        self.mission = mission
        self.state = checkpoint.beginning(mission, resume)
        self.clock = VehicleClock(self.state.now_s)
        self.context = Context(mission=mission, seed=seed, lockstep=lockstep, shadow=shadow)
        self.found = ""
        """What the vehicle says that it is."""
        self.last_scan: events.ScanDone | None = None
        self.warned: tuple[float, str] = (-math.inf, "")
        """When a person was last warned, and of what."""
        self.vehicle: VehicleSide | None = None
        """The autopilot, once it is known."""
        self._inbox = Inbox(signing)
        self.receiver = self._inbox.receivers[VEHICLE]
        self.signing = signing
        self._lockstep, self._version = lockstep, version
        before = None if resume is None else resume[0].get("system_id")
        self.latch = Latch(mission.system_id or before)
        """Which of those that are heard is the vehicle."""
        self._outbox = Outbox(self.latch.system_id, signing, has_ground=has_ground)
        self._texts = StatusTexts()
        self._scanning = Scanning(mission)
        self._preflight = Preflight()
        self._citizen: Citizen | None = None
        self._out = Output()
        self._times = TimeAnswers()
        self._plan = PendingPlan()
        self._keeper = checkpoint.Keeper()
        self._end: End | None = None
        self._confirming: SetMode | None = None
        self._mode: Mode | None = None
        self._mode_asked_at_s = self._kept_house_s = -math.inf
        self._silence_told_s = 0.0
        self._at_s: float | None = None
        start = Start.of(self.context, resume, version=version, has_ground=has_ground)
        self._told("start", start.values())
        if resume is not None:
            self._note("resumed", **checkpoint.told(resume[0]))

    @property
    def now_s(self) -> float:
        """Vehicle time."""
        return self.clock.now_s

    # --- what the runtime calls

    def receive(self, data: bytes, at_s: float | None = None, link: int = VEHICLE) -> bool:
        """Bytes of a link, garbage passed over; whether anybody spoke whom it is there for.

        That is the autopilot; over links to ground stations (1 and up), anybody.  at_s: when they
        arrived, by any clock that only rises: round trips are measured by it.
        """
        self._at_s = at_s
        if self.signing is not None and at_s is not None:
            self.signing.on_time(at_s)
        messages = self._inbox.feed(data, at_s, link)
        frames = b"".join(bytes(each.get_msgbuf()) for each in messages)
        self._told("receive", frames, at_s, *([] if link == VEHICLE else [link]))
        if self.signing is not None and (complaint := self.signing.complaint(self.now_s)):
            self.complain(complaint)
        if link != VEHICLE:
            return bool(messages)
        if heard := any(map(self.latch.is_ours, messages)):
            self._silence_told_s = 0.0
        return heard

    def deliver(self, outcome: PlanOutcome) -> None:
        """The answer to the last plan request."""
        self._told("deliver", outcomes.values_of(outcome))
        self._plan.deliver(outcome, self.now_s)

    def part_died(self, part: str, error: str) -> None:
        """The planner raised instead of answering, or another part of the runtime has died."""
        self._told("part_died", part, error)
        died = events.PlannerDied(time_s=self.now_s, error=f"{part}: {error}" if part else error)
        if part == "planner" and self._lockstep:
            self._plan.deliver(died, self.now_s)
        else:
            self._handle(died)

    def recording_stopped(self, why: str) -> None:
        """The disk has failed: the flight goes on, and people are told."""
        self._told("recording_stopped", why)
        self._say(f"not recorded any more: {why}", warning=True)

    def stop(self) -> None:
        """A person wants the mission to end."""
        self._told("stop")
        self._handle(events.StopAsked(time_s=self.now_s))

    def complain(self, text: str) -> None:
        """Frames were refused: they are not among what was received."""
        self._told("complain", text)
        self._say(text, warning=True)

    def silence(self, silent_s: float) -> None:
        """The autopilot was not heard for so long; called again and again while it lasts."""
        self._told("silence", silent_s)
        more_s = max(silent_s - self._silence_told_s, 0.0)
        waiting = self.state.phase is Phase.WAITING
        for limit in (_NO_VEHICLE_S,) if waiting else (_SILENT_S, GONE_S, GONE_IN_AIR_S):
            if self._silence_told_s < limit <= silent_s:
                self._handle(events.LinkLost(time_s=self.now_s, silent_s=limit))
        self._silence_told_s = silent_s
        if self.clock.be_silent(more_s, counts=not waiting) is Reading.LATER:
            self._handle(events.Tick(time_s=self.now_s))
        self._housekeeping()

    def run(self) -> Output:
        """Handle what was received, as far as it goes."""
        if self._out.inputs:  # else it changes nothing
            self._told("run")
        if dropped := self._inbox.dropped():
            self._note("messages dropped", count=dropped)
        while (heard := self._inbox.first()) is not None:
            if heard.link == VEHICLE and self._must_wait_for_plan(heard.message):
                self._out.awaits_plan = True
                break
            self._on_message(*self._inbox.take())
        self._keep()
        return self.taken()

    def taken(self) -> Output:
        """What the outside is to do now; after an error, what had come of it until then."""
        out, self._out = self._out, Output()
        self._outbox.take_into(out)
        out.end, out.settled = self._end, self._settled()
        return out

    def farewell(self) -> Output:
        """The last frames of a companion that ends; a vehicle that flies for us is told to hold."""
        self._told("farewell")
        self._send_all(self._holding())
        if self._end is None:
            self._tell_all(self._texts.last("ended: the companion was stopped"))
        self._tell_all([heartbeat(wire.MAV_STATE_POWEROFF)])
        self._keep(at_once=True)
        return self.taken()

    def look_around(self) -> None:
        """Have the radar look, whatever the mission is doing (before a flight)."""
        here = self.state.vehicle.position_nea_m
        if here is not None and self.state.targets_ne_m:
            self._start_scan(here)

    def hold_frames(self) -> list[bytes]:
        """What puts a vehicle that flies for us on hold; nothing else.  Changes nothing."""
        return self._outbox.spare(self._holding())

    def last_words(self, why: str) -> list[bytes]:
        """What says that the companion has ended, and why; nothing else.  Changes nothing."""
        return self._outbox.spare(last_words(f"ended, failed: {why}"))

    def _holding(self) -> Sequence[Message]:
        if self.vehicle is None or self.context.shadow or not is_led(self.state):
            return ()
        return self.vehicle.told(SetMode(mode=Mode.HOLD), self.state) or ()

    # --- messages

    def _on_message(self, message: Message, at_s: float | None, link: int) -> None:
        """Over a link to ground stations what is asked of us counts, and no word of a vehicle."""
        kind, needed = message.get_type(), not isinstance(message, Unread)
        if needed and link == VEHICLE:
            if kind in MERE_CLOCKS and self.latch.is_ours(message):
                needed = self.clock.is_told_by(message)
            if needed:
                self._read_time(message, kind)
        if (namesake := self._outbox.note_received(message, self.now_s)) is not None:
            self._handle(namesake)
        if not needed:
            return
        if kind in SERVED:
            self._serve(message, link)
        if link == VEHICLE and message.get_srcSystem() == self.latch.system_id:
            component = message.get_srcComponent()
            if component == AUTOPILOT_COMPONENT:
                self._from_autopilot(message, kind, at_s)
            elif component == self.mission.scanner_component_id:
                self._scanning.on_message(message, self.state.vehicle.position_nea_m)
                self._scan_on()

    def _read_time(self, message: Message, kind: str) -> None:
        """Whose it is, and how late."""
        if kind == "HEARTBEAT" and self.latch.on_message(message):
            assert self.latch.system_id is not None
            self._outbox.speak_as(self.latch.system_id)
        elif name := self.latch.ambiguity:
            found = events.VehicleFound(time_s=self.now_s, system_id=0, driving=None, name=name)
            self._handle(found)
        if kind not in _TIMED or not self.latch.is_ours(message):
            return
        if kind in CLOCKS:
            self._on_time(message.time_boot_ms * 1e-3, ticks=kind != "GLOBAL_POSITION_INT")
        elif kind == "HEARTBEAT":
            if not self.context.shadow and self.clock.beat(message):
                self._handle(events.Tick(time_s=self.clock.going_on_s))
        elif self._lockstep and message.tc1 == 0:
            self._on_time(message.ts1 * 1e-9)

    def _from_autopilot(self, message: Message, kind: str, at_s: float | None) -> None:
        if self.vehicle is None and kind == "HEARTBEAT":
            self._find(message)
        if self.vehicle is None:
            return self._answer_time(message)
        vehicle, now_s = self.vehicle, self.now_s
        due = kind == "GLOBAL_POSITION_INT"
        if due and not self.context.shadow and (answer := self._plan.take(now_s)) is not None:
            self._handle(answer)
        self._send_all(vehicle.on_message(message, now_s))
        if (event := vehicle.event_of(message, now_s)) is not None:
            self._handle(event)
        if due and self.context.shadow and (answer := self._plan.take(now_s)) is not None:
            self._handle(answer)  # the position before may be a second old
        if kind == "TIMESYNC" and message.tc1 != 0 and at_s is not None:
            delay = vehicle.on_answered_time(message, now_s, at_s)
            if delay is not None:
                self._handle(delay)
        for event in vehicle.events(now_s):
            self._handle(event)
        if due:
            self._check()
            self._scan_on()
        self._housekeeping()
        if (noted := vehicle.entry_of(message)) is not None:
            self._note(**noted)
        return self._answer_time(message) if kind == "TIMESYNC" else None

    def _find(self, message: Message) -> None:
        """The first heartbeat of our autopilot: which one it is decides how it is flown."""
        system, name = message.get_srcSystem(), described(message)
        self.found = name
        self.vehicle = VehicleSide.found(message, self.context)
        driving = None
        if self.vehicle is not None:
            self._citizen = Citizen(self.mission, system, self.state.task, self._version)
            driving = self.vehicle.autopilot.driving
        found: dict[str, Any] = {"system_id": system, "name": name}
        self._note("vehicle found", **found)
        self._handle(events.VehicleFound(time_s=self.now_s, driving=driving, **found))

    def _answer_time(self, message: Message) -> None:
        """Answer a TIMESYNC, last of all: a simulator in lockstep goes on then."""
        if (answer := self._times.of(message)) is None:
            return
        self._send_all([answer])
        seldom = self.vehicle is not None and not self.vehicle.asks_time_often
        if seldom and not self._lockstep and self._times.look_like_lockstep(self.now_s):
            self._say("simulator in lockstep: use --lockstep here too", warning=True)

    def _serve(self, message: Message, link: int) -> None:
        """What others ask of the companion itself."""
        if (citizen := self._citizen) is None:
            return
        served = citizen.on_message(message, self.now_s)
        reply = self._send_all if link == VEHICLE else self._outbox.tell_ground
        (self._tell_all if served.is_for_all else reply)(served.replies)
        if served.note is not None:
            self._note(**served.note)
        if served.text:
            self._say(served.text, warning=True)
        if served.order is not None:
            verdict = changes.verdict(self.state, served.order)
            reply(citizen.order_done(served.order, verdict))
            if verdict is changes.Verdict.ACCEPTED:
                self._handle(served.order)
            else:
                self._say(changes.why_not(self.state, served.order), warning=True)
        if served.changed is not None:
            task = replace(served.task, zones=self.state.given.zones)
            self._handle(events.SettingsChanged(time_s=self.now_s, task=task, what=served.changed))

    # --- the clock

    def _on_time(self, time_s: float, *, ticks: bool = True) -> None:
        """The vehicle's clock says so; ticks: unless an event of the same time follows anyway."""
        before_s = self.now_s
        reading = self.clock.read(time_s)
        if reading is Reading.FIRST:  # waits go on by the new clock
            self.state = self.state.by_another_clock(time_s - before_s)
            if self.vehicle is not None:
                self.vehicle.by_another_clock(time_s - before_s)
        elif reading is Reading.REBOOTED:
            self._begin_again()
        elif reading is Reading.LATER:
            ahead_s = self.state.now_s - time_s
            if ahead_s > 0.0:  # while only heartbeats came, it was guessed
                self.state = self.state.by_another_clock(-ahead_s)
            if ticks:
                self._handle(events.Tick(time_s=time_s))

    def _begin_again(self) -> None:
        """The autopilot has rebooted: prepare again; what is known of the terrain stays known."""
        self.state = replace(self.state, now_s=self.now_s, since_s=self.now_s)
        self._scanning.stop()
        self._plan.forget()
        self._mode_asked_at_s = -math.inf
        if self.vehicle is not None:
            self.vehicle.rebooted()
        self._handle(events.Rebooted(time_s=self.now_s))

    def _housekeeping(self) -> None:
        """What goes on whatever happens: heartbeat, texts, what is missing, the last mode."""
        now_s = self.clock.going_on_s
        if now_s == self._kept_house_s:
            return  # for a message of the same time
        self._kept_house_s = now_s
        if self.vehicle is not None and self.state.phase is not Phase.WAITING:
            self._send_all(self.vehicle.on_time(now_s, self._at_s))
            while self.vehicle.notes:
                self._say(self.vehicle.notes.pop(0), warning=False)
        if self._citizen is not None:
            faulted = self.state.phase is Phase.FAULTED or self._end is not None
            self._tell_all(self._citizen.on_time(now_s, self.state, faulted=faulted))
        elif self._end is None and now_s - self._mode_asked_at_s >= _MODE_AGAIN_S:
            self._mode_asked_at_s = now_s  # nobody is known yet: only that we are here
            self._tell_all([heartbeat(wire.MAV_STATE_STANDBY)])
        self._tell_all(self._texts.due(now_s))
        left = self._confirming if self._end is not None and not self._settled() else None
        if left is not None and now_s - self._mode_asked_at_s >= _MODE_AGAIN_S:
            self._command(left)

    def _keep(self, *, at_once: bool = False) -> None:
        """A checkpoint when the mission has moved on, and the map when it has grown."""
        if self._end is not None or self.context.shadow:
            return
        kept, self._out.known = self._keeper.due(self.state, self.now_s, at_once=at_once)
        if kept is not None:
            self._out.checkpoint = {"system_id": self.latch.system_id, **kept}

    # --- plans and scans

    def _must_wait_for_plan(self, message: Message) -> bool:
        if message.get_type() != "GLOBAL_POSITION_INT" or not self.latch.is_ours(message):
            return False
        if not self._plan.is_missing(message.time_boot_ms * 1e-3):
            return False
        if not self._lockstep and self._plan.tell_late():
            self._handle(events.PlanLate(time_s=self.now_s, plan_id=self.state.flight.plan_id))
        return self._lockstep

    def _scan_on(self) -> None:
        if (done := self._scanning.done(self.now_s)) is not None:
            self.last_scan = done
            self._handle(done)
        elif (request := self._scanning.on_time(self.now_s)) is not None:
            self._send_all([request])

    def _start_scan(self, centre_nea_m: Vector) -> None:
        blocks = self._scanning.begin(centre_nea_m, self.state, self.now_s)
        self._note("scan", centre_nea_m=list(centre_nea_m), blocks=blocks)
        self._scan_on()

    def _check(self) -> None:
        """On the ground: what a flight depends on is asked and checked before it is armed."""
        if (here := self._preflight.looks_from(self)) is not None:
            self._start_scan(here)
        elif (judged := self._preflight.judged(self)) is not None:
            self._handle(judged)

    # --- events and commands

    def _handle(self, event: events.Event) -> None:
        before = self.state
        if isinstance(event, events.VehicleStatus):
            self._mode = event.mode
        self.state, commands = machine.step(before, event, self.context)
        if (noted := entries.of_event(event, self.state)) is not None:
            self._note(**noted)
        for moved in entries.of_change(before, self.state):
            self._note(**moved)
        ends = any(isinstance(command, End) for command in commands)
        for command in commands:
            self._carry_out(command)
            if self._end is not None and not ends:
                return  # it was refused, and that has ended the mission: the rest counts no more
        if ends:
            modes = [command for command in commands if isinstance(command, SetMode)]
            self._confirming = modes[-1] if modes else None  # nothing from before counts any more
            assert self._end is not None
            self._say_end(self._end, held=any(each.mode is Mode.HOLD for each in modes))

    def _carry_out(self, command: events.Command) -> None:
        match command:
            case events.StartScan(centre_nea_m=centre):
                self._start_scan(centre)
            case events.Plan(request=request, due_s=due_s):
                self._plan.ask(due_s)
                self._out.plan = request
                self._note(**entries.of_request(request, due_s))
            case events.Say(text=text, warning=warning, about=about):
                self._say(text, warning=warning, about=about)
            case End():
                self._note("end", outcome=command.outcome.value, reason=command.reason)
                self._end = command
            case events.RequestStreams():
                if self.vehicle is not None:
                    self._send_all(self.vehicle.begin(self.now_s))
            case (
                SetMode() | events.SetSpeed() | events.Arm() | events.TakeOff() | events.Setpoint()
            ):
                if not self.context.shadow:
                    self._command(command)

    def _command(self, command: Told) -> None:
        """What the autopilot is told to do."""
        assert self.vehicle is not None
        if isinstance(command, SetMode):
            self._confirming, self._mode_asked_at_s = command, self.clock.going_on_s
        if (noted := entries.of_command(command)) is not None:
            self._note(**noted)
        if (messages := self.vehicle.told(command, self.state)) is None:
            self._note("setpoint refused", setpoint=repr(command))
            self._handle(events.PlannerDied(time_s=self.now_s, error="setpoint out of range"))
        else:
            self._send_all(messages)

    def _say(self, text: str, *, warning: bool, about: str = "") -> None:
        self._note("say", text=text, warning=warning)
        self.warned = (self.now_s, text) if warning else self.warned
        self._texts.say(text, severity_of(warning=warning), self.clock.going_on_s, about)

    def _say_end(self, end: End, *, held: bool) -> None:
        """The last text, at once: what comes after it is no more than a heartbeat's end."""
        text, messages = self._texts.end(end, held=held)
        self._note("say", text=text, warning=end.outcome is not events.Outcome.ARRIVED)
        self._tell_all(messages)

    def _settled(self) -> bool:
        """Whether the mission is over and the vehicle is in the mode that it was left in."""
        gone = self._silence_told_s >= _NO_VEHICLE_S
        ours = self._mode in (Mode.GUIDED, Mode.TAKE_OFF)  # else it, or somebody, has chosen
        return gone or self._confirming is None or not ours

    def _told(self, *what: Any) -> None:
        """Keep what the session was told."""
        self._out.inputs.append(what)

    def _send_all(self, messages: Iterable[Message]) -> None:
        self._outbox.send(messages, self.now_s)

    def _tell_all(self, messages: Iterable[Message]) -> None:
        self._outbox.send(messages, self.now_s, to_ground=True)

    def _note(self, kind: str, **values: Any) -> None:
        self._out.journal.append({"t_s": round(self.now_s, 6), "kind": kind, **values})
