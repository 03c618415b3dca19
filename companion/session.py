"""The whole companion, without I/O: bytes and vehicle events in, bytes and journal entries out.

    session.receive(data)       bytes of the link, in any portions
    session.run() -> Output     handle them: what to send, to record and to compute
    session.deliver(outcome)    the answer to Output.plan, then run() again
    session.silence(seconds)    the autopilot was not heard for so long (wall time of the runtime)
    session.stop()              a person wants the end

Time is the vehicle's: the newest time_boot_ms of its autopilot (in lockstep, TIMESYNC too); until
it is known, and for what must go on in a silence, the silence itself counts.  A plan becomes an
event at the first position at or after request + T, never earlier; in lockstep run() stops before
that position until the plan is delivered (Output.awaits_plan), otherwise the plan is late.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any, final

from companion.mavlink.autopilots import ARDUCOPTER, Autopilot
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, codec, wire
from companion.mavlink.terrain_download import TerrainDownload
from companion.mavlink.translate import (
    command_long,
    event_of,
    heartbeat_message,
    mode_message,
    setpoint_message,
)
from companion.mission import entries, machine
from companion.mission.decisions import Context
from companion.mission.events import (
    Arm,
    Command,
    End,
    Event,
    LinkLost,
    Mode,
    Plan,
    PlanLate,
    PlannerDied,
    PlanReady,
    Position,
    RequestStreams,
    Say,
    ScanDone,
    SetMode,
    Setpoint,
    StartScan,
    StopAsked,
    TakeOff,
    Tick,
    VehicleStatus,
)
from companion.mission.mission import Mission
from companion.mission.state import Flight, Phase, State
from companion.planner.request import PlanOutcome, PlanRequest
from companion.world.known_map import empty_map

Entry = dict[str, Any]

_HEARTBEAT_S = 1.0
_STREAM_MISSING_S = 2.0
_MODE_AGAIN_S = 1.0
_LOCKSTEP_TIMESYNCS = 50  # in 10 s; an autopilot's own come every 10 s
_REBOOT_S = 2.0  # a clock that falls by more has begun again
_NO_VEHICLE_S = 10.0
_SILENT_S = 3.0
_GONE_S = 10.0


@final
@dataclass(slots=True, kw_only=True)
class Output:
    """What one run() asks of the outside."""

    frames: list[bytes] = field(default_factory=list)
    """To be sent, in order."""
    record: list[tuple[float, bytes]] = field(default_factory=list)
    """Vehicle time and frame, both directions, for the telemetry log."""
    journal: list[Entry] = field(default_factory=list)
    plan: PlanRequest | None = None
    """To be computed and delivered."""
    awaits_plan: bool = False
    end: End | None = None
    """Set once the mission is over."""
    settled: bool = False
    """Whether the vehicle is in the mode that it was last asked for, or gone."""


@final
class Session:
    """Parser, clock, protocols and mission machine of one companion."""

    def __init__(
        self,
        mission: Mission,
        *,
        seed: int,
        lockstep: bool,
        autopilot: Autopilot = ARDUCOPTER,
    ) -> None:
        limits = mission.task.limits
        self.mission = mission
        self.state = State(
            flight=Flight(known=empty_map(mission.task.cell_m, limits.north_m, limits.east_m))
        )
        self.now_s = 0.0
        self.other_systems: set[int] = set()
        """System ids of autopilots that were heard and are not the mission's vehicle."""
        self.warning = ""
        """What a person was last warned of."""
        self._timesyncs = 0
        self._context = Context(mission=mission, seed=seed)
        self._lockstep = lockstep
        self._autopilot = autopilot
        self._codec = codec(mission.system_id)
        self._inbox: deque[Message] = deque()
        self._out = Output()
        self._download: TerrainDownload | None = None
        self._plan_due_s = math.inf
        self._plan: PlanOutcome | PlannerDied | None = None
        self._late_told = False
        self._heartbeat_at_s = -math.inf
        self._heard: dict[int, float] = {}
        self._streams: dict[int, float] = {}
        self._streams_at_s = -math.inf
        self._end: End | None = None
        self._confirming: Mode | None = None
        self._mode: Mode | None = None
        self._mode_asked_at_s = -math.inf
        self._silence_told_s = 0.0
        self._idle_s = 0.0
        self._clocked = False

    # --- what the runtime calls

    def receive(self, data: bytes) -> bool:
        """Bytes of the link, garbage passed over; whether the autopilot was among the speakers."""
        heard = False
        for message in self._codec.parse_buffer(data) or ():
            if message.get_type() != "BAD_DATA":
                self._inbox.append(message)
                heard = heard or self._is_autopilot(message)
        if heard:
            self._silence_told_s = 0.0
        return heard

    def deliver(self, outcome: PlanOutcome) -> None:
        """The answer to the last plan request."""
        self._plan = outcome

    def planner_died(self, error: str) -> None:
        """The planner raised instead of answering."""
        self._plan = PlannerDied(time_s=self.now_s, error=error)
        self._plan_due_s = min(self._plan_due_s, self.now_s)

    def stop(self) -> None:
        """A person wants the mission to end."""
        self._handle(StopAsked(time_s=self.now_s))

    def silence(self, silent_s: float) -> None:
        """The autopilot was not heard for so long; called again and again while it lasts."""
        more_s = max(silent_s - self._silence_told_s, 0.0)
        waiting = self.state.phase is Phase.WAITING
        for limit in (_NO_VEHICLE_S,) if waiting else (_SILENT_S, _GONE_S):
            if self._silence_told_s < limit <= silent_s:
                self._handle(LinkLost(time_s=self.now_s, silent_s=limit))
        self._silence_told_s = silent_s
        if self._clocked or waiting:
            self._idle_s += more_s
        else:
            self._advance(self.now_s + more_s)
        self._housekeeping()

    def run(self) -> Output:
        """Handle what was received, as far as it goes."""
        while self._inbox:
            if self._must_wait_for_plan(self._inbox[0]):
                self._out.awaits_plan = True
                break
            self._on_message(self._inbox.popleft())
        out, self._out = self._out, Output()
        out.end, out.settled = self._end, self._settled()
        return out

    def farewell(self) -> Output:
        """The last frames of a companion that ends; a vehicle that flies for us is told to hold."""
        flies = self.state.phase in (Phase.TAKING_OFF, Phase.FLYING, Phase.HOLDING, Phase.ARRIVED)
        if flies and self._mode is Mode.GUIDED:
            self._ask_mode(Mode.HOLD)
        self._send(heartbeat_message(wire.MAV_STATE_POWEROFF))
        out, self._out = self._out, Output()
        return out

    # --- messages

    def _is_autopilot(self, message: Message) -> bool:
        ours = message.get_srcSystem() == self.mission.system_id
        return ours and message.get_srcComponent() == AUTOPILOT_COMPONENT

    def _on_message(self, message: Message) -> None:
        component = message.get_srcComponent()
        ours = message.get_srcSystem() == self.mission.system_id
        if self._is_autopilot(message):
            time_ms = getattr(message, "time_boot_ms", None)
            if time_ms is not None:
                self._clock(time_ms * 1e-3)
            elif self._lockstep and message.get_type() == "TIMESYNC" and message.tc1 == 0:
                self._clock(message.ts1 * 1e-9)
        self._out.record.append((self.now_s, bytes(message.get_msgbuf())))
        if not ours:
            if component == AUTOPILOT_COMPONENT and message.get_type() == "HEARTBEAT":
                self.other_systems.add(message.get_srcSystem())
            return
        if component == AUTOPILOT_COMPONENT:
            self._from_autopilot(message)
        elif component == self.mission.scanner_component_id and self._download is not None:
            here = self.state.vehicle.position_nea_m
            is_terrain = message.get_type() in ("TERRAIN_DATA", "TERRAIN_REPORT")
            if is_terrain and here is not None:
                self._download.on_message(message, here)
                self._scan_on()

    def _from_autopilot(self, message: Message) -> None:
        self._heard[message.get_msgId()] = self.now_s
        if message.get_type() == "GLOBAL_POSITION_INT":
            self._take_plan()
        event = event_of(message, self.now_s, self.mission.frame, self._autopilot)
        if event is not None:
            self._handle(event)
        if isinstance(event, Position):
            self._scan_on()
        self._housekeeping()
        if message.get_type() == "TIMESYNC" and message.tc1 == 0:
            self._on_timesync(message)
        elif message.get_type() == "STATUSTEXT":
            self._note("vehicle says", text=message.text)
        elif message.get_type() == "COMMAND_ACK":
            self._note("acknowledged", command=message.command, result=message.result)

    def _on_timesync(self, message: Message) -> None:
        """Answer; one with every position is a simulator that waits for the answers."""
        self._send(wire.MAVLink_timesync_message(message.ts1, message.ts1))
        self._timesyncs += 1
        if self._timesyncs == _LOCKSTEP_TIMESYNCS and not self._lockstep and self.now_s < 10.0:
            self._say("simulator in lockstep: use --lockstep here too", warning=True)

    def _clock(self, time_s: float) -> None:
        """The vehicle's clock says so."""
        if not self._clocked:  # waits go on by the new clock
            shift_s = time_s - self.now_s
            self._clocked, self.now_s = True, time_s
            self.state = self.state.by_another_clock(shift_s)
            self._heartbeat_at_s += shift_s
            self._streams_at_s += shift_s
        elif time_s < self.now_s - _REBOOT_S:
            self._begin_again(time_s)
        self._advance(time_s)

    def _advance(self, time_s: float) -> None:
        if time_s > self.now_s:
            self.now_s, self._idle_s = time_s, 0.0
            self._handle(Tick(time_s=time_s))

    def _begin_again(self, time_s: float) -> None:
        """The autopilot has rebooted: prepare again; what is known of the terrain stays known."""
        self._note("vehicle rebooted", time_s=time_s)
        self.now_s = time_s
        self.state = State(
            now_s=time_s, since_s=time_s, flight=Flight(known=self.state.flight.known)
        )
        self._download, self._plan, self._plan_due_s = None, None, math.inf
        self._heard, self._streams = {}, {}
        self._heartbeat_at_s = self._streams_at_s = self._mode_asked_at_s = -math.inf

    def _housekeeping(self) -> None:
        """What goes on whatever happens: heartbeat, streams that are missing, the last mode."""
        now_s = self.now_s + self._idle_s
        if now_s - self._heartbeat_at_s >= _HEARTBEAT_S and self._end is None:
            self._heartbeat_at_s = now_s
            if self.state.phase is not Phase.FAULTED:
                self._send(heartbeat_message(_system_status(self.state.phase)))
        if self._streams and now_s - self._streams_at_s >= _STREAM_MISSING_S:
            self._request_streams()
        left = self._confirming if self._end is not None and not self._settled() else None
        if left is not None and now_s - self._mode_asked_at_s >= _MODE_AGAIN_S:
            self._ask_mode(left)

    def _ask_mode(self, mode: Mode) -> None:
        self._confirming, self._mode_asked_at_s = mode, self.now_s + self._idle_s
        self._note("set mode", mode=mode.value)
        self._send(mode_message(self.mission.system_id, mode, self._autopilot))

    def _request_streams(self) -> None:
        """Ask for every stream that has not been heard lately (a first request may get lost)."""
        self._streams_at_s = self.now_s + self._idle_s
        for message_id, rate_hz in self._streams.items():
            silent_s = self.now_s - self._heard.get(message_id, -math.inf)
            if silent_s > max(_STREAM_MISSING_S, 3.0 / rate_hz):
                interval_us = 1e6 / rate_hz
                self._send(
                    command_long(
                        self.mission.system_id,
                        wire.MAV_CMD_SET_MESSAGE_INTERVAL,
                        message_id,
                        interval_us,
                    )
                )

    # --- plans and scans

    def _must_wait_for_plan(self, message: Message) -> bool:
        if self._plan is not None or message.get_type() != "GLOBAL_POSITION_INT":
            return False
        due = message.time_boot_ms * 1e-3 >= self._plan_due_s
        if due and not self._lockstep and not self._late_told:
            self._late_told = True
            self._handle(PlanLate(time_s=self.now_s, plan_id=self.state.flight.plan_id))
        return due and self._lockstep

    def _take_plan(self) -> None:
        """Turn a delivered plan into an event once it is due."""
        if self._plan is None or self.now_s < self._plan_due_s:
            return
        outcome, self._plan, self._plan_due_s = self._plan, None, math.inf
        if isinstance(outcome, PlannerDied):
            self._handle(outcome)
        else:
            self._handle(PlanReady(time_s=self.now_s, outcome=outcome))

    def _scan_on(self) -> None:
        download = self._download
        if download is None:
            return
        if download.is_over(self.now_s):
            self._download = None
            self._handle(
                ScanDone(
                    time_s=self.now_s,
                    scan=download.scan(),
                    asked=download.asked,
                    answered=download.answered,
                )
            )
            return
        request = download.on_time(self.now_s)
        if request is not None:
            self._send(request)

    # --- events and commands

    def _handle(self, event: Event) -> None:
        before = self.state
        if isinstance(event, VehicleStatus):
            self._mode = event.mode
        self.state, commands = machine.step(before, event, self._context)
        if (noted := entries.of_event(event, self.state)) is not None:
            self._note(**noted)
        if self.state.phase is not before.phase:
            reason = self.state.reason
            self._note(
                "phase",
                phase=self.state.phase.value,
                was=before.phase.value,
                reason=None if reason is None else reason.text,
            )
        if self.state.flight.legs_flown != before.flight.legs_flown:
            self._note("leg", number=self.state.flight.legs_flown)
        for command in commands:
            self._carry_out(command)

    def _carry_out(self, command: Command) -> None:
        system = self.mission.system_id
        match command:
            case Setpoint():
                self._send_setpoint(command)
            case RequestStreams():
                position = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
                self._streams = {
                    position: self.mission.position_rate_hz,
                    **self._autopilot.streams_hz,
                }
                self._request_streams()
            case SetMode(mode=mode):
                self._ask_mode(mode)
            case Arm():
                self._note("arm")
                self._send(command_long(system, wire.MAV_CMD_COMPONENT_ARM_DISARM, 1.0))
            case TakeOff(above_home_m=height):
                self._note("take off", above_home_m=height)
                self._send(command_long(system, wire.MAV_CMD_NAV_TAKEOFF, *([0.0] * 6), height))
            case StartScan(centre_nea_m=centre):
                self._start_scan(centre)
            case Plan(request=request, due_s=due_s):
                self._plan, self._plan_due_s, self._late_told = None, due_s, False
                self._out.plan = request
                self._note(**entries.of_request(request, due_s))
            case Say(text=text, warning=warning):
                self._say(text, warning=warning)
            case End():
                self._finish(command)

    def _send_setpoint(self, setpoint: Setpoint) -> None:
        message = setpoint_message(setpoint, self.mission.frame, self.mission.system_id)
        if message is None:
            self._note("setpoint refused", setpoint=repr(setpoint))
            self._handle(PlannerDied(time_s=self.now_s, error="setpoint out of range"))
        else:
            self._send(message)

    def _start_scan(self, centre_nea_m: tuple[float, float, float]) -> None:
        task = self.mission.task
        tick_s = 1.0 / self.mission.position_rate_hz
        self._download = TerrainDownload(
            self.state.flight.known,
            centre_ne_m=centre_nea_m[:2],
            towards_ne_m=self.mission.targets_ne_m[self.state.flight.target],
            range_m=task.settings.scan_range_m,
            deadline_s=self.now_s + task.settings.scan_time_s,
            drift_m=2.0 * tick_s * task.limits.speed_m_s,
            frame=self.mission.frame,
        )
        self._note("scan", centre_nea_m=list(centre_nea_m), blocks=self._download.asked)
        self._scan_on()

    def _say(self, text: str, *, warning: bool) -> None:
        self._note("say", text=text, warning=warning)
        self.warning = text if warning else self.warning
        severity = wire.MAV_SEVERITY_WARNING if warning else wire.MAV_SEVERITY_INFO
        self._send(wire.MAVLink_statustext_message(severity, text.encode()[:50]))

    def _finish(self, end: End) -> None:
        self._note("end", outcome=end.outcome.value, reason=end.reason)
        self._end = end

    def _settled(self) -> bool:
        """Whether the mission is over and the vehicle is in the mode that it was left in."""
        gone = self._silence_told_s >= _GONE_S
        return gone or self._confirming is None or self._mode is self._confirming

    def _send(self, message: Message) -> None:
        frame = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        self._out.frames.append(frame)
        self._out.record.append((self.now_s, frame))

    # --- journal

    def _note(self, kind: str, **values: Any) -> None:
        self._out.journal.append({"t_s": round(self.now_s, 6), "kind": kind, **values})


def _system_status(phase: Phase) -> int:
    if phase is Phase.HOLDING:
        return int(wire.MAV_STATE_CRITICAL)
    flying = phase in (Phase.TAKING_OFF, Phase.FLYING, Phase.ARRIVED, Phase.LANDING)
    return int(wire.MAV_STATE_ACTIVE if flying else wire.MAV_STATE_STANDBY)
