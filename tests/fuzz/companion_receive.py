"""The companion's receive path under arbitrary input: what the fuzzer and the tests call.

A flight with each kind of simulated autopilot is recorded once: what the vehicle said, and what
the companion was then, every three seconds.  An input chooses one of these moments and goes on from
there: telemetry of the recording, raw bytes, intact frames of anybody with any payload, silence,
plans, parts that die.  So the fuzzer gets past the checksums and into every phase, and one input
always does the same.
"""

import copyreg
import io
import json
import math
import pickle
import struct
import time
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import scripted_vehicle
from pymavlink.dialects.v20 import all as mavlink
from random_programs import COMMANDS, MESSAGES, VALUES, Reader, command, intact, message_numbers

from companion.config import load_mission
from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import Autopilot
from companion.mavlink.autopilots.common import Firmware
from companion.mavlink.frames import Receiver
from companion.mavlink.link import Output
from companion.mission.decisions import Context
from companion.mission.mission import EndAction, Mission
from companion.planner.request import Backtrack, NotPlanned, PlanOutcome, PlanRequest, Refusal
from companion.session import Session
from companion.telemetry.run_folder import journal_line
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

copyreg.pickle(struct.Struct, lambda each: (struct.Struct, (each.format,)))

PERSONALITIES = (
    ("ardupilot", "copter", "sitl-arducopter", False),
    ("ardupilot", "plane", "sitl-arduplane", False),
    ("px4", "copter", "sitl-px4", False),
    ("px4", "plane", "sitl-px4-plane", False),
    ("ardupilot", "copter", "sitl-arducopter", True),  # in lockstep
)
PLACE = {"latitude_deg": 47.4, "longitude_deg": 8.5}
HANDLED = message_numbers(
    """
    HEARTBEAT GLOBAL_POSITION_INT LOCAL_POSITION_NED ATTITUDE GPS_RAW_INT EKF_STATUS_REPORT
    ESTIMATOR_STATUS EXTENDED_SYS_STATE HOME_POSITION GPS_GLOBAL_ORIGIN SYS_STATUS BATTERY_STATUS
    POSITION_TARGET_LOCAL_NED POSITION_TARGET_GLOBAL_INT COMMAND_ACK COMMAND_LONG COMMAND_INT
    STATUSTEXT SYSTEM_TIME TIMESYNC PARAM_VALUE
    AUTOPILOT_VERSION MISSION_COUNT MISSION_ITEM_INT MISSION_ITEM MISSION_ACK MISSION_CURRENT
    MISSION_REQUEST_LIST TERRAIN_DATA TERRAIN_REPORT TERRAIN_REQUEST SETUP_SIGNING PING
    """
)
ORDERS = (192, 193, 21, 20, 300, 192, 512, 519, 520)
SENDERS = ((1, 1), (1, 1), (1, 1), (1, 1), (255, 190), (1, 100), (1, 195), (2, 1), (1, 191), (0, 0))
ITEM_COMMANDS = (16, 17, 19, 20, 21, 22, 82, 5000, 5001, 5002, 5003, 5004, 5100)
MODES = (0, 4, 5, 9, 10, 11, 15, 17, 4 << 16 | 3 << 24, 6 << 16, 4 << 16 | 2 << 24, 0xFFFFFFFF)
SLOWEST_S = 20.0
"""An input that takes longer is called a hang: honest ones take less than a second."""
MOST_TICKS = 300
LARGEST_SESSION = 4_000_000
"""Of a session after an input, in bytes: the known map is most of an honest one."""
_ANSWERS = {
    "MISSION_REQUEST_LIST": mavlink.MAVLINK_MSG_ID_MISSION_COUNT,
    "MISSION_REQUEST_INT": mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT,
    "PARAM_REQUEST_READ": mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
    "PARAM_SET": mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
    "TERRAIN_REQUEST": mavlink.MAVLINK_MSG_ID_TERRAIN_DATA,
    "COMMAND_LONG": mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
    "COMMAND_INT": mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
}
"""To what the companion asks."""
_OF_LISTS = ("MISSION_REQUEST_LIST", "MISSION_REQUEST_INT")
"""Those that a tick answers by itself; the vehicle's own answers are left out of the recordings."""
_LISTS = message_numbers("MISSION_COUNT MISSION_ACK MISSION_ITEM_INT")
_TICK_S, _TICK_STEPS, _MOMENT_TICKS, _LONGEST_S = 0.1, 10, 30, 240.0
_STATION = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
_VEHICLE = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
_FINITE = (
    *("SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED"),
    *("PARAM_VALUE", "PARAM_SET"),
)
"""Messages in which every number must be one: in a command, NaN means that it is left out."""


def mission(name: str) -> Mission:
    """A short one with a radar, at one place for all autopilots."""
    base = load_mission(name)
    settings = replace(base.task.settings, planning_time_s=1.0, evaluations=100)
    return replace(
        base,
        frame=LocalFrame(**PLACE),
        targets_ne_m=((60.0, 20.0), (0.0, 40.0)),
        task=replace(base.task, settings=settings),
        end_action=EndAction.LAND,
        scanner_component_id=100,
        known=None,
    )


def straight_plan(request: PlanRequest) -> PlanOutcome:
    """A straight and level subpath to the target; no way back."""
    if request.flown is not None:
        return Backtrack(plan_id=request.plan_id, subpaths=(), through=(), reaches_start=False)
    return scripted_vehicle.straight_plan(request)


# --- sessions as bytes

_outside: list[Context | Autopilot | Firmware] = []
"""What stays the same for a whole mission is not in them."""


class _Pickler(pickle.Pickler):
    def persistent_id(self, obj: Any) -> int | None:
        if not isinstance(obj, Context | Autopilot | Firmware):
            return None
        if not any(obj is each for each in _outside):
            _outside.append(obj)
        return next(k for k, each in enumerate(_outside) if each is obj)


class _Unpickler(pickle.Unpickler):
    def persistent_load(self, pid: Any) -> Context | Autopilot | Firmware:
        return _outside[pid]


def saved(session: Session) -> bytes:
    """All that a session is now; its length says how much that is."""
    buffer = io.BytesIO()
    _Pickler(buffer).dump(session)
    return buffer.getvalue()


def restored(content: bytes) -> Session:
    """A session as it was."""
    session: Session = _Unpickler(io.BytesIO(content)).load()
    return session


# --- the flights


@dataclass(frozen=True, slots=True)
class Recording:
    """One flight: what came in at each tick, and what the session was before some of them."""

    heard: list[bytes]
    moments: list[tuple[int, str, bytes]]
    """Tick, phase and session, pickled: all three seconds, and where a phase begins."""


class Target:
    """A recorded flight of each personality, to go on from at any moment."""

    def __init__(self) -> None:
        self._recordings: dict[int, Recording] = {}

    def recording(self, which: int) -> Recording:
        if which not in self._recordings:
            self._recordings[which] = _flown(*PERSONALITIES[which])
        return self._recordings[which]

    def prepare(self) -> None:
        """Fly and record before the first input."""
        for which in range(len(PERSONALITIES)):
            self.recording(which)

    def play(self, data: bytes) -> None:
        """Let one input run; an exception, a hang or nonsense that is sent is a finding."""
        reader = Reader(data)
        recording = self.recording(reader.byte() % len(PERSONALITIES))
        start_s = time.perf_counter()
        tick, _, session = recording.moments[reader.byte() % len(recording.moments)]
        run = Run(restored(session), recording.heard[tick:])
        while reader.left:
            run.step(reader)
        run.end()
        took_s = time.perf_counter() - start_s
        if took_s > SLOWEST_S:
            raise TimeoutError(f"{took_s:.1f} s for {len(data)} bytes")


def _flown(autopilot: Any, kind: Any, name: str, lockstep: bool) -> Recording:
    """Fly the mission with the simulator as the other end."""
    flown = mission(name)
    home_m = flown.task.limits.floor_amsl_m - 26.0  # below the band, as all these missions have it
    world = flat_world(
        kind, autopilot, **PLACE, altitude_amsl_m=home_m, heading_deg=0.0, scan_range_m=1_000.0
    )
    vehicle, session = Simulation(world), Session(flown, seed=1, lockstep=lockstep, go=True)
    run, recording = Run(session, [], vehicle), Recording([], [])
    while len(recording.heard) * _TICK_S < _LONGEST_S:
        for _ in range(_TICK_STEPS):
            vehicle.step()
        if lockstep:
            vehicle.ask_for_sync()
        frames = [frame for _, frame in vehicle.take_frames()]
        phase = session.state.phase.value
        if len(recording.heard) % _MOMENT_TICKS == 0 or phase != recording.moments[-1][1]:
            recording.moments.append((len(recording.heard), phase, saved(session)))
        recording.heard.append(b"".join(frame for frame in frames if frame[7] not in _LISTS))
        run.receive(b"".join(frames), len(recording.heard) * _TICK_S)
        if run.is_over:
            break
    return recording


# --- what happens


class Run:
    """One session, from one moment on; told to a vehicle, if there is one."""

    def __init__(
        self, session: Session, telemetry: list[bytes], vehicle: Simulation | None = None
    ) -> None:
        self.session, self._vehicle = session, vehicle
        self.is_over = False
        self._telemetry = iter(telemetry)
        self._at_s = 1000.0
        self._asked: PlanRequest | None = None
        self._questions = deque[Any](maxlen=20)
        """What the companion has asked the vehicle for lately."""
        self._lists: dict[int, list[dict[str, float]]] = {}
        """What the autopilot holds from now on: mission, fence and rally points."""
        self._silent_s = 0.0
        self._ticks = 0

    def step(self, reader: Reader) -> None:
        """One thing that happens."""
        match reader.byte() % 12:
            case 0:
                self.receive(reader.bytes(reader.byte()))
            case 1 | 2 as long:
                for _ in range(1 + reader.byte() % (10, 80)[long - 1]):
                    self.tick()
            case 3:
                number = MESSAGES[(reader.byte() << 8 | reader.byte()) % len(MESSAGES)]
                self.receive(self.frame(number, reader))
            case 4:
                numbers = ORDERS if reader.byte() % 4 else COMMANDS
                self.receive(command(reader, numbers, _STATION, (1, 195)))
            case 5:
                self.other(reader)
            case 6:
                self.receive(_heartbeat(reader))
            case 7:
                for _ in range(1 + reader.byte() % 60):
                    asked, self._questions = list(self._questions), deque[Any](maxlen=20)
                    for question in asked[:4]:
                        self.receive(_answer(question, self._lists, reader))
                    self.tick()
            case 8:
                self._lists[reader.byte() % 3] = _list(reader)
            case _:
                self.receive(self.frame(HANDLED[reader.byte() % len(HANDLED)], reader))

    def other(self, reader: Reader) -> None:
        """What does not come by the link."""
        session = self.session
        match reader.byte() % 6:
            case 0:
                self._silent_s += VALUES[reader.byte() % 11] % 40.0
                session.silence(self._silent_s)
            case 1 if self._asked is not None:
                refusal = list(Refusal)[reader.byte() % 8]
                session.deliver(NotPlanned(plan_id=self._asked.plan_id, refusal=refusal))
                self._asked = None
            case 2:
                session.part_died(("planner", "reader")[reader.byte() % 2], "it was fuzzed")
            case 3:
                session.stop()
            case 4:
                session.complain("no space left on device")
            case _:
                assert all(len(frame) <= 305 for frame in session.hold_frames())
        self.run()

    def tick(self) -> None:
        """A tenth of a second of the recording, and the plan that is due."""
        self._ticks += 1
        if self._ticks > MOST_TICKS:
            return
        heard = next(self._telemetry, None)
        self._at_s += _TICK_S
        if heard is not None:
            self.receive(heard)
        of_lists = [each for each in self._questions if each.get_type() in _OF_LISTS]
        for question in of_lists:
            self._questions.remove(question)
            self.receive(_answer(question, self._lists, Reader(b"")))
        if self._asked is not None:
            self._plan()
            self.run()

    def receive(self, data: bytes, at_s: float | None = None) -> None:
        if self.session.receive(data, self._at_s if at_s is None else at_s):
            self._silent_s = 0.0
        self.run()

    def run(self) -> None:
        for _ in range(4):
            out = self.session.run()
            self._asked = out.plan or self._asked
            self._questions += [each for each in _check(out) if each.get_type() in _ANSWERS]
            for frame in out.frames if self._vehicle is not None else ():
                self._vehicle.receive(0, frame)
            self.is_over = out.end is not None and out.settled
            waits = out.awaits_plan or self._vehicle is not None
            if not waits or self._asked is None:
                break
            self._plan()

    def _plan(self) -> None:
        asked, self._asked = self._asked, None
        assert asked is not None
        self.session.deliver(straight_plan(asked))

    def frame(self, number: int, reader: Reader) -> bytes:
        """Of anybody, with any payload; often at this time, and with numbers that nobody sends."""
        kind: Any = mavlink.mavlink_map[number]
        size = kind.unpacker.size
        payload, how = reader.bytes(reader.byte() % (size + 1)).ljust(size, b"\0"), reader.byte()
        values: dict[str, float] = {}
        if how & 1:
            names = zip(kind.fieldnames, kind.fieldtypes, strict=True)
            values = {name: reader.value() for name, form in names if form == "float"}
        if how & 2:
            now_ms = max(round(self.session.now_s * 1e3), 0)
            values["time_boot_ms"] = (now_ms + reader.byte()) % 2**32
        sender, target = SENDERS[reader.byte() % len(SENDERS)], (1, 195) if how & 12 else None
        return intact(number, payload, sender, target=target, values=values)

    def end(self) -> None:
        for _ in range(5):
            self.tick()
        size = len(saved(self.session))
        assert size < LARGEST_SESSION, f"the session has grown to {size} bytes"
        _check(self.session.farewell())


def _check(out: Output) -> list[Any]:
    """What is sent: whole frames with numbers in them, and a journal that can be read again."""
    receiver, sent = Receiver(), []
    for frame in out.frames:
        [message] = receiver.feed(frame)
        sent.append(message)
        assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 195)
        for value in (getattr(message, name) for name in message.fieldnames):
            assert not isinstance(value, float) or not math.isinf(value), message
            if message.get_type() in _FINITE and isinstance(value, float):
                assert math.isfinite(value), message
        if message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT":
            assert (message.lat_int, message.lon_int) != (0, 0)
            assert math.hypot(message.vx, message.vy, message.vz) <= 1000.0
    for time_s, frame in out.record:
        assert math.isfinite(time_s)
        assert frame[0] == 0xFE or not frame[2] & 1
    for entry in out.journal:
        json.loads(journal_line(entry))
    if out.checkpoint is not None:
        json.dumps(out.checkpoint, allow_nan=False)
    return sent


# --- what comes in


def _heartbeat(reader: Reader) -> bytes:
    """The autopilot's, in any mode."""
    mode, how = MODES[reader.byte() % len(MODES)], reader.byte()
    kind, autopilot = ((2, 3), (1, 3), (2, 12), (1, 12))[how % 4]
    armed, status = 1 | (128 if how & 4 else 0), reader.byte() % 9
    message = mavlink.MAVLink_heartbeat_message(kind, autopilot, armed, mode, status, 3)
    return bytes(message.pack(_VEHICLE))


def _list(reader: Reader) -> list[dict[str, float]]:
    """Items that autopilots hold: shapes of a fence, places to fly to, or anything."""
    items: list[dict[str, float]] = []
    for _ in range(reader.byte() % 4):
        number = ITEM_COMMANDS[reader.byte() % len(ITEM_COMMANDS)]
        corners = 3 + reader.byte() % 4 if number in (5001, 5002) else 1
        size = float(corners) if corners > 1 else (20.0, 60.0, 300.0, *VALUES)[reader.byte() % 25]
        for _ in range(corners):
            frame, up_m = (3, 3, 6, 0, 5, 10)[reader.byte() % 6], (0.0, 20.0, *VALUES)
            x, y = (round(deg * 1e7) + (reader.byte() - 128) * 250 for deg in PLACE.values())
            item = {"command": number, "frame": frame, "param1": size, "x": x, "y": y}
            items.append(item | {"z": up_m[reader.byte() % 24]})
    return items


def _answer(question: Any, lists: dict[int, list[dict[str, float]]], reader: Reader) -> bytes:
    """What the autopilot or the radar answers, with numbers that nobody should send in it."""
    kind_asked = question.get_type()
    number = _ANSWERS[kind_asked]
    kind: Any = mavlink.mavlink_map[number]
    asked = {name: getattr(question, name) for name in question.fieldnames}
    values = {name: asked[name] for name in kind.fieldnames if name in asked}
    size = kind.unpacker.size
    payload, sender = b"", (1, 1)
    match kind_asked:
        case "MISSION_REQUEST_LIST":
            values["count"] = len(lists.get(question.mission_type, ()))
        case "MISSION_REQUEST_INT":
            items = lists.get(question.mission_type, [])
            values |= items[question.seq] if question.seq < len(items) else {}
        case "PARAM_REQUEST_READ" | "PARAM_SET":
            name = question.param_id.encode().ljust(16, b"\0")
            payload = bytes(8) + name + bytes([(9, 6, 4, 2, 9, 9)[reader.byte() % 6]])
            values = {"param_value": (0.0, *VALUES)[reader.byte() % 23]}
        case "TERRAIN_REQUEST":
            payload = bytes(10) + bytes(reader.byte() for _ in range(8)) * 4 + bytes(1)
            values, sender = values | {"gridbit": reader.byte() % 56}, (1, 100)
        case _:
            values |= {"command": question.command, "result": reader.byte() % 10}
    return intact(number, payload.ljust(size, b"\0"), sender, target=(1, 195), values=values)
