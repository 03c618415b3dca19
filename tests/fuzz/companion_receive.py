"""The companion's receive path under arbitrary input: what the fuzzer and the tests call.

It flies each kind of simulated autopilot once; every ten seconds and where a phase begins, both
ends are kept.  An input chooses one of these moments, and both fly on from there: with raw bytes,
intact frames of anybody with any payload, the vehicle's own with other values, other plans in it,
silence, parts that die.  So the fuzzer gets past the checksums and into every phase, and one input
always does the same.
"""

import copy
import copyreg
import io
import json
import math
import pickle
import struct
import time
from dataclasses import replace
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import all as mavlink
from random_programs import (
    COMMANDS,
    FAULTS,
    MESSAGES,
    PLACE,
    VALUES,
    Reader,
    any_frame,
    command,
    intact,
    message_numbers,
    plan_items,
)
from scripted_vehicle import straight_plan

from companion.config import load_mission
from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import Autopilot
from companion.mavlink.autopilots.common import Firmware
from companion.mavlink.frames import Receiver
from companion.mavlink.link import Output
from companion.mission.decisions import Context
from companion.mission.mission import EndAction, Mission
from companion.planner.request import Backtrack, NotPlanned, PlanRequest, Refusal
from companion.session import Session
from companion.telemetry.run_folder import journal_line
from vehicle_sim.parameters import Parameter
from vehicle_sim.plans import PlanKind
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

copyreg.pickle(struct.Struct, lambda each: (struct.Struct, (each.format,)))
copyreg.pickle(Parameter, lambda row: row.name)  # never changes: copies share it

PERSONALITIES = (
    ("ardupilot", "copter", "sitl-arducopter", False),
    ("ardupilot", "plane", "sitl-arduplane", False),
    ("px4", "copter", "sitl-px4", False),
    ("px4", "plane", "sitl-px4-plane", False),
    ("ardupilot", "copter", "sitl-arducopter", True),  # in lockstep
)
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
SLOWEST_S = 20.0
"""An input that takes longer is called a hang: honest ones take less than a second."""
MOST_TICKS = 300
LARGEST_SESSION = 4_000_000
"""Of a session after an input, in bytes: the known map is most of an honest one."""
_TICK_S, _TICK_STEPS, _MOMENT_TICKS, _LONGEST_S = 0.1, 10, 100, 240.0
_STATION = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
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


# --- sessions as bytes

_outside = dict[int, Context | Autopilot | Firmware]()
"""What stays the same for a whole mission is not in them: by id."""


class _Pickler(pickle.Pickler):
    def persistent_id(self, obj: Any) -> int | None:
        if not isinstance(obj, Context | Autopilot | Firmware):
            return None
        _outside[id(obj)] = obj
        return id(obj)


class _Unpickler(pickle.Unpickler):
    def persistent_load(self, pid: Any) -> Context | Autopilot | Firmware:
        return _outside[pid]


def saved(session: Session) -> bytes:
    """All that a session is now; its length says how much that is."""
    buffer = io.BytesIO()
    _Pickler(buffer).dump(session)
    return buffer.getvalue()


# --- the flights


class Moment(NamedTuple):
    """Of a flight."""

    phase: str
    session: bytes
    vehicle: Simulation

    def again(self) -> "Run":
        """Both go on from there."""
        return Run(_Unpickler(io.BytesIO(self.session)).load(), copy.deepcopy(self.vehicle))


class Target:
    """A flight of each personality, to go on from at any moment."""

    def __init__(self) -> None:
        self._moments: dict[int, list[Moment]] = {}

    def moments(self, which: int) -> list[Moment]:
        if which not in self._moments:
            self._moments[which] = _flown(*PERSONALITIES[which])
        return self._moments[which]

    def play(self, data: bytes) -> None:
        """Let one input run; an exception, a hang or nonsense that is sent is a finding."""
        reader = Reader(data)
        moments = self.moments(reader.byte() % len(PERSONALITIES))
        start_s = time.perf_counter()
        run = moments[reader.byte() % len(moments)].again()
        while reader.left:
            run.step(reader)
        run.end()
        took_s = time.perf_counter() - start_s
        if took_s > SLOWEST_S:
            raise TimeoutError(f"{took_s:.1f} s for {len(data)} bytes")


def _flown(autopilot: Any, kind: Any, name: str, lockstep: bool) -> list[Moment]:
    """Fly the mission."""
    flown, moments = mission(name), list[Moment]()
    home_m = flown.task.limits.floor_amsl_m - 26.0  # below the band, as all these missions have it
    world = flat_world(
        kind, autopilot, **PLACE, altitude_amsl_m=home_m, heading_deg=0.0, scan_range_m=1_000.0
    )
    run = Run(Session(flown, seed=1, lockstep=lockstep, go=True), Simulation(world))
    for tick in range(round(_LONGEST_S / _TICK_S)):
        phase = run.session.state.phase.value
        if tick % _MOMENT_TICKS == 0 or phase != moments[-1].phase:
            run.vehicle.take_truth()
            run.vehicle.take_notices()
            moments.append(Moment(phase, saved(run.session), copy.deepcopy(run.vehicle)))
        run.ticks = 0
        run.tick()
        if run.is_over:
            break
    return moments


# --- what happens


class Run:
    """A session and its vehicle, from one moment on."""

    def __init__(self, session: Session, vehicle: Simulation) -> None:
        self.session, self.vehicle = session, vehicle
        self.ticks, self.is_over = 0, False
        self._silent_s = 0.0
        self._asked: PlanRequest | None = None

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
                self.vehicle.add_fault(FAULTS[reader.byte() % len(FAULTS)])
            case 7:
                for _ in range(1 + reader.byte() % 60):
                    self.tick(reader)
            case 8:
                self.vehicle.plans[PlanKind(reader.byte() % 3)] = plan_items(reader)
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

    def heard(self, reader: Reader | None = None) -> bytes:
        """What the vehicle says in the next tenth of a second; some of it with other values."""
        for _ in range(_TICK_STEPS):
            self.vehicle.step()
        if self.session._lockstep:
            self.vehicle.ask_for_sync()
        frames = [frame for _, frame in self.vehicle.take_frames()]
        for k in range(len(frames)) if reader is not None else ():
            if reader.left and reader.byte() % 4 == 0:
                frames[k] = _other_values(frames[k], reader)
        return b"".join(frames)

    def tick(self, reader: Reader | None = None) -> None:
        """That, and the plan that is due."""
        self.ticks += 1
        if self.ticks > MOST_TICKS:
            return
        self.receive(self.heard(reader))
        if self._asked is not None:
            self._plan()
            self.run()

    def receive(self, data: bytes) -> None:
        if self.session.receive(data, 1000.0 + 1e-6 * self.vehicle.now_us):
            self._silent_s = 0.0
        self.run()

    def run(self) -> None:
        for _ in range(4):
            out = self.session.run()
            check(out)
            for frame in out.frames:
                self.vehicle.receive(0, frame)
            self.is_over = out.end is not None and out.settled
            self._asked = out.plan or self._asked
            if self._asked is None or not out.awaits_plan:
                break
            self._plan()

    def _plan(self) -> None:
        """A straight and level subpath to the target; no way back."""
        asked, self._asked = self._asked, None
        assert asked is not None
        back = Backtrack(plan_id=asked.plan_id, subpaths=(), through=(), reaches_start=False)
        self.session.deliver(straight_plan(asked) if asked.flown is None else back)

    def frame(self, number: int, reader: Reader) -> bytes:
        """Of anybody, with any payload."""
        return any_frame(number, reader, SENDERS, (1, 195), now_s=self.session.now_s)

    def end(self) -> None:
        for _ in range(5):
            self.tick()
        size = len(saved(self.session))
        assert size < LARGEST_SESSION, f"the session has grown to {size} bytes"
        check(self.session.farewell())


def check(out: Output) -> None:
    """What is sent: whole frames with numbers in them, and a journal that can be read again."""
    receiver = Receiver()
    for frame in out.frames:
        [message] = receiver.feed(frame)
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


def _other_values(frame: bytes, reader: Reader) -> bytes:
    """The same message with another byte, and with a number that nobody should send."""
    kind: Any = mavlink.mavlink_map[int.from_bytes(frame[7:10], "little")]
    size = kind.unpacker.size
    payload = bytearray(frame[10 : 10 + frame[1]].ljust(size, b"\0"))
    payload[reader.byte() % size] = reader.byte()
    fields = zip(kind.fieldnames, kind.fieldtypes, strict=True)
    numbers = [name for name, form in fields if form == "float"]
    values = {numbers[reader.byte() % len(numbers)]: reader.value()} if numbers else {}
    sender = frame[5], frame[6]
    return intact(kind.id, bytes(payload), sender, target=None, values=values)
