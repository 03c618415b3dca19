"""The recorded flights of both autopilots through the session: what it does when the GPS is lost.

The frames come in as they were recorded, and what the session asks for is noted, with the machine
flying: it takes over on a made-up path along the recorded route, and a vehicle whose position is
the recorded one takes the modes that it is asked for.  Times are seconds after the first record;
those of the faults are the recordings' own (their README).  Watched only: replay/test_shadow.py.
"""

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from held import recorded
from made_up import planned
from renewed import replace

from companion.config import load_mission
from companion.geodesy import FloatArray, LocalFrame
from companion.mavlink.autopilots import ARDUCOPTER, PX4_MULTICOPTER, Autopilot, autopilot_of
from companion.mavlink.dialect import codec, wire
from companion.mavlink.frames import IGNORED_MESSAGES
from companion.mission import checkpoint
from companion.mission.events import Mode
from companion.mission.mission import Mission
from companion.mission.phases import Flying, OnPath, Phase, Reason
from companion.mission.state import State
from companion.path.subpath import Subpath
from companion.planner.procedure import Leg
from companion.planner.request import PlanOutcome
from companion.session import Session
from companion.world.known_map import empty_map

COMPANION = (1, 191)
"""Of the recordings: whom the session stands for."""
ARDUPILOT, PX4 = "arducopter-gps-loss.tlog", "px4-gps-loss.tlog"
ARDUPILOT_HOME, PX4_HOME = (-35.363262, 149.165237, 584.0), (47.397742, 8.545594, 488.0)
FLIGHTS: dict[str, tuple[str, tuple[float, float, float]]] = {
    ARDUPILOT: ("sitl-arducopter", ARDUPILOT_HOME),
    PX4: ("sitl-px4", PX4_HOME),
}
"""Which bundled mission a recording is flown with, and its home."""
SEEN_S = 2.0
"""So long after it began a fault is seen: receiver at 5 Hz, estimator at 2 Hz, and it may flicker.

ArduPilot's own estimate stays right for 10 s after the step, PX4's for some seconds.
"""
BAD: dict[str, tuple[tuple[float, float], ...]] = {
    ARDUPILOT: ((113.1, 148.3), (163.2, 188.5)),
    PX4: ((76.3, 108.6),),
}
"""From the fault until the position is right again: `Glitch cleared`, GPS fused again."""
TRUSTED_AGAIN_S = 2.0
PATH_M = 1000.0
"""Of a made-up plan; nobody flies it."""
CHATTER = IGNORED_MESSAGES | {
    wire.MAVLINK_MSG_ID_ATTITUDE,
    wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    wire.MAVLINK_MSG_ID_WIND_COV,
}
"""Two thirds of the frames, which mean nothing to a companion here: left out, they cost time."""
LEADS = frozenset({"SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED"})
ACTS = (
    wire.MAV_CMD_DO_SET_MODE,
    wire.MAV_CMD_COMPONENT_ARM_DISARM,
    wire.MAV_CMD_NAV_TAKEOFF,
    wire.MAV_CMD_NAV_LAND,
    wire.MAV_CMD_DO_REPOSITION,
    wire.MAV_CMD_DO_CHANGE_SPEED,
    wire.MAV_CMD_GUIDED_CHANGE_SPEED,
)
"""Commands that move a vehicle."""


def mission_for(name: str) -> Mission:
    """A wide mission about the recording's home, with limits like those that it was flown with."""
    bundled, (latitude, longitude, home_m) = FLIGHTS[name]
    mission = load_mission(bundled)
    limits = replace(
        mission.task.limits,
        floor_amsl_m=home_m + 5.0,
        ceiling_amsl_m=home_m + 300.0,
        north_m=(-4000.0, 4000.0),
        east_m=(-4000.0, 4000.0),
        speed_m_s=max(mission.task.limits.speed_m_s, 10.0),
    )
    known = empty_map(mission.task.cell_m, limits.north_m, limits.east_m)
    return replace(
        mission,
        frame=LocalFrame(latitude_deg=latitude, longitude_deg=longitude),
        task=replace(mission.task, limits=limits, zones=()),
        targets_ne_m=((3500.0, 3500.0),),
        known=replace(known, upper_m=np.full_like(known.upper_m, home_m - 200.0)),
    )


@dataclass(slots=True)
class Replay:
    """What the session did."""

    sent: list[tuple[float, Any]] = field(default_factory=list)
    planned_s: list[float] = field(default_factory=list)
    """When a plan was asked for."""
    ends: tuple[Phase, Reason | None] = (Phase.WAITING, None)
    """In which phase, and why."""

    @property
    def leads_s(self) -> list[float]:
        """When the vehicle was sent a setpoint."""
        return [at_s for at_s, message in self.sent if message.get_type() in LEADS]

    def modes(self, autopilot: Autopilot) -> list[tuple[float, Mode]]:
        """When it was asked for which mode."""
        return [
            (at_s, asked)
            for at_s, message in self.sent
            if (asked := _mode_asked(message, autopilot)) is not None
        ]


def replayed(
    name: str,
    session: Session,
    *,
    from_s: float = 0.0,
    until_s: float = math.inf,
    obeys: bool = False,
) -> Replay:
    """The recording through a session, in real time's way.

    obeys: the heartbeats tell the mode that the session asked for, while the recorded vehicle is in
    guided mode.
    """
    replay, reader = Replay(), codec(1)
    answer: tuple[float, PlanOutcome] | None = None
    autopilot: Autopilot | None = None
    mode: Mode | None = None
    heard_s = from_s
    for at_s, message in _inbound(name):
        if not from_s <= at_s <= until_s:
            continue
        if autopilot is None and message.get_type() == "HEARTBEAT":
            autopilot = autopilot_of(message)
        frame = bytes(message.get_msgbuf())
        if obeys and autopilot is not None and mode is not None:
            frame = _in_mode(message, mode, autopilot) or frame
        if answer is not None and at_s >= answer[0]:
            session.deliver(answer[1])
            answer = None
        if session.receive(frame, at_s):
            heard_s = at_s
        else:
            session.silence(at_s - heard_s)
        out = session.run()
        for packed in out.frames:
            told = reader.decode(bytearray(packed))
            replay.sent.append((at_s, told))
            if autopilot is not None:
                mode = _mode_asked(told, autopilot) or mode
        if out.plan is not None:
            replay.planned_s.append(at_s)
            answer = (at_s + 0.5, planned(out.plan, PATH_M))
    replay.ends = session.state.phase, session.state.reason
    return replay


@functools.cache
def _read(name: str) -> list[tuple[float, Any]]:
    """Time since the first record, and message, of all but the chatter."""
    return list(recorded(name, CHATTER))


def _inbound(name: str) -> Iterator[tuple[float, Any]]:
    """What was not said by the companion of the recording."""
    for at_s, message in _read(name):
        if (message.get_srcSystem(), message.get_srcComponent()) != COMPANION:
            yield at_s, message


def _mode_asked(message: Any, autopilot: Autopilot) -> Mode | None:
    if message.get_type() != "COMMAND_LONG" or message.command != wire.MAV_CMD_DO_SET_MODE:
        return None
    number = int(message.param2)
    if autopilot.name.startswith("PX4"):
        number = number << 16 | int(message.param3) << 24
    return autopilot.modes.mode_of(number)


def _in_mode(message: Any, mode: Mode, autopilot: Autopilot) -> bytes | None:
    """A heartbeat of the autopilot in guided mode, as if it were in this one."""
    ours = (message.get_srcSystem(), message.get_srcComponent()) == (1, 1)
    if not ours or message.get_type() != "HEARTBEAT":
        return None
    if autopilot.modes.mode_of(message.custom_mode) is not Mode.GUIDED:
        return None
    numbers = {Mode.GUIDED: 4, Mode.HOLD: 17, Mode.LAND: 9}
    if autopilot.name.startswith("PX4"):
        numbers = {Mode.GUIDED: 0x00060000, Mode.HOLD: 0x03040000, Mode.LAND: 0x06040000}
    made = wire.MAVLink_heartbeat_message(
        message.type,
        message.autopilot,
        message.base_mode,
        numbers[mode],
        message.system_status,
        message.mavlink_version,
    )
    packer = codec(1)
    packer.srcComponent = 1
    packer.seq = message.get_seq()
    return bytes(made.pack(packer))


def route(name: str, mission: Mission, from_s: float, until_s: float) -> FloatArray:
    """(N, 3): where the companion of the recording sent the vehicle, about one point a second."""
    home = FLIGHTS[name][1]
    origin = next((m for _, m in _read(name) if m.get_type() == "GPS_GLOBAL_ORIGIN"), None)
    place, height = home[:2], home[2]
    if origin is not None:
        place, height = (origin.latitude * 1e-7, origin.longitude * 1e-7), origin.altitude * 1e-3
    north, east = mission.frame.to_local_m(*place)
    points, next_s = list[tuple[float, float, float]](), from_s
    for at_s, message in _read(name):
        if at_s > until_s:
            break
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED" and at_s >= next_s:
            next_s = at_s + 1.0
            points.append((north + message.x, east + message.y, height - message.z))
    return np.array(points)


def on_route(name: str, from_s: float, until_s: float) -> Session:
    """A session that takes over in flight, on a path along the recorded route."""
    mission = mission_for(name)
    known = mission.known
    assert known is not None
    leg = Leg(
        number=1,
        plan_id=1,
        subpath=Subpath(control_nea_m=route(name, mission, from_s, until_s)),
        reaches_target=False,
    )
    state = State.of(mission, known)
    flight = replace(state.flight, plan_id=1, legs_flown=1)
    state = replace(state, stage=Flying(path=OnPath(leg=leg)), airborne=True, flight=flight)
    left = checkpoint.values_of(state)
    return Session(mission, seed=1, lockstep=False, resume=(left, known))


TAKES_OVER: dict[str, tuple[tuple[float, float, float], ...]] = {
    ARDUPILOT: ((90.0, 155.0, 200.0), (152.0, 200.0, 400.0)),
    PX4: ((50.0, 120.0, 400.0),),
}
"""For each fault: when the session with the made-up path begins, how far the path goes, the end."""
FLOWN = [
    pytest.param(name, times, bad, obeys, id=f"{name[:4]} {bad[0]:.0f} s{' obeys' * obeys}")
    for name in BAD
    for times, bad in zip(TAKES_OVER[name], BAD[name], strict=True)
    for obeys in (False, True)
]


@functools.cache
def flown(name: str, from_s: float, until_s: float, end_s: float, obeys: bool) -> Replay:
    session = on_route(name, from_s, until_s)
    return replayed(name, session, from_s=from_s, until_s=end_s, obeys=obeys)


def acts(message: Any) -> bool:
    """Whether a message moves a vehicle, or changes it."""
    kind = message.get_type()
    if kind in ("COMMAND_LONG", "COMMAND_INT"):
        return message.command in ACTS
    return kind in LEADS or kind in ("PARAM_SET", "SET_MODE", "MISSION_COUNT", "MISSION_CLEAR_ALL")


def is_bad(name: str, at_s: float) -> bool:
    """Whether the position is wrong at this time, or has had time to be found out."""
    return any(since_s + SEEN_S < at_s < until_s for since_s, until_s in BAD[name])


def not_guided(name: str) -> list[tuple[float, float]]:
    """From when to when the heartbeats of the recording tell another mode, after it was guided."""
    autopilot, spans, since_s, began = None, list[tuple[float, float]](), None, False
    for at_s, message in _inbound(name):
        ours = (message.get_srcSystem(), message.get_srcComponent()) == (1, 1)
        if not ours or message.get_type() != "HEARTBEAT":
            continue
        autopilot = autopilot or autopilot_of(message)
        guided = autopilot.modes.mode_of(message.custom_mode) is Mode.GUIDED
        began = began or guided
        if began and not guided and since_s is None:
            since_s = at_s
        elif guided and since_s is not None:
            spans.append((since_s, at_s))
            since_s = None
    return spans if since_s is None else [*spans, (since_s, math.inf)]


def strategy(name: str) -> Autopilot:
    return ARDUCOPTER if name == ARDUPILOT else PX4_MULTICOPTER


@pytest.mark.parametrize(("name", "times", "bad", "obeys"), FLOWN)
def test_it_lets_go_asks_for_hold_and_begins_nothing_at_a_wrong_position_or_in_anothers_mode(
    name: str, times: tuple[float, float, float], bad: tuple[float, float], obeys: bool
) -> None:
    replay, fault_s = flown(name, *times, obeys), bad[0]
    before = [at_s for at_s in replay.leads_s if at_s < fault_s]
    assert len(before) > 5.0 * (fault_s - times[0] - 5.0)  # it took over, and did fly
    let_go_s = max(at_s for at_s in replay.leads_s if at_s < bad[1])
    assert let_go_s < fault_s + SEEN_S
    asked_s, asked = next(each for each in replay.modes(strategy(name)) if each[0] > fault_s)
    assert asked is Mode.HOLD
    assert let_go_s < asked_s < let_go_s + 0.5
    assert not [at_s for at_s in (*replay.leads_s, *replay.planned_s) if is_bad(name, at_s)]
    again = [at_s for at_s in replay.leads_s if at_s > bad[1]]
    assert min(again, default=math.inf) > bad[1] + TRUSTED_AGAIN_S
    taken = [(max(a, times[0]), min(b, times[2])) for a, b in not_guided(name)]
    assert any(since_s < until_s for since_s, until_s in taken)
    acted = [at_s for at_s, message in replay.sent if acts(message)]
    assert not [at_s for at_s in acted if any(a < at_s < b for a, b in taken)]


def test_the_made_up_vehicle_that_obeys_is_flown_on_with_once_its_position_is_right() -> None:
    """ArduPilot's glitch: 2 s after it was cleared guided mode is asked for, and a plan."""
    replay = flown(ARDUPILOT, *TAKES_OVER[ARDUPILOT][0], True)
    right_s = BAD[ARDUPILOT][0][1]
    guided_s = [at_s for at_s, mode in replay.modes(ARDUCOPTER) if mode is Mode.GUIDED]
    assert right_s + TRUSTED_AGAIN_S < min(guided_s) < right_s + TRUSTED_AGAIN_S + 1.0
    assert min(replay.planned_s) > min(guided_s)


@pytest.mark.parametrize("obeys", [False, True])
def test_it_never_begins_again_from_the_ground(obeys: bool) -> None:
    """ArduPilot's recording lands at 321.8 s, PX4's at about 197 s, and disarms."""
    for name in BAD:
        replay = flown(name, *TAKES_OVER[name][-1], obeys)
        phase, reason = replay.ends
        assert phase is Phase.DONE
        assert reason in (Reason.GROUNDED, Reason.DISARMED)
        landed_s = 321.8 if name == ARDUPILOT else 195.0
        led = [at_s for at_s, message in replay.sent if message.get_type() in LEADS]
        assert max(led) < landed_s
        started = (wire.MAV_CMD_COMPONENT_ARM_DISARM, wire.MAV_CMD_NAV_TAKEOFF)
        commands = [m.command for _, m in replay.sent if m.get_type() == "COMMAND_LONG"]
        assert not set(commands) & set(started)
