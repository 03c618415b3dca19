"""The recorded flights of both autopilots through the session: what it does when the GPS is lost.

The frames come in as they were recorded, with the machine flying: it takes over on a made-up path
along the recorded route, and a vehicle whose position is the recorded one takes the modes that it
is asked for.  Times are seconds after the first record; those of the faults are the recordings' own
(their README).  Watched only: replay/test_shadow.py.
"""

import functools
import math
from copy import copy
from typing import Any, NamedTuple

import missions
import numpy as np
import pytest
from held import recorded
from made_up_plans import planned
from renewed import replace

from companion.mavlink.autopilots import ARDUCOPTER, PX4_MULTICOPTER, Autopilot
from companion.mavlink.dialect import codec, wire
from companion.mavlink.frames import IGNORED_MESSAGES
from companion.mission import checkpoint
from companion.mission.events import Mode
from companion.mission.phases import Flying, OnPath
from companion.mission.state import State
from companion.path.subpath import Subpath
from companion.planner.procedure import Leg
from companion.session import Session

VEHICLE, COMPANION = (1, 1), (1, 191)


class Fault(NamedTuple):
    """A loss in a recorded flight, and the session that takes over before it."""

    name: str
    autopilot: Autopilot
    mission: str
    """About it (`missions`)."""
    home_amsl_m: float
    bad: tuple[float, float]
    """Until the position is right again: `Glitch cleared`, GPS fused again."""
    from_s: float
    end_s: float


ARDUPILOT = ("arducopter-gps-loss.tlog", ARDUCOPTER, "copter-canberra", 584.0)
PX4 = ("px4-gps-loss.tlog", PX4_MULTICOPTER, "copter-zurich", 488.0)
FAULTS = (
    Fault(*ARDUPILOT, (113.1, 148.3), 90.0, 200.0),
    Fault(*ARDUPILOT, (163.2, 188.5), 152.0, 400.0),
    Fault(*PX4, (76.3, 108.6), 50.0, 400.0),
)
SEEN_S = 2.0
"""So long after it began a fault is seen: receiver at 5 Hz, estimator at 2 Hz, and it may flicker.

ArduPilot's own estimate stays right for 10 s after the step, PX4's for some seconds.
"""
TRUSTED_AGAIN_S = 2.0
CHATTER = IGNORED_MESSAGES | {
    wire.MAVLINK_MSG_ID_ATTITUDE,
    wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    wire.MAVLINK_MSG_ID_WIND_COV,
}
"""Two thirds of the frames, which mean nothing to a companion here: left out, they cost time."""
LEADS = {"SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED"}
CHANGES = LEADS | {"PARAM_SET", "SET_MODE", "MISSION_COUNT", "MISSION_CLEAR_ALL"}
ASKS = (wire.MAV_CMD_SET_MESSAGE_INTERVAL, wire.MAV_CMD_REQUEST_MESSAGE)
"""Commands that change nothing."""


@functools.cache
def messages(name: str) -> list[tuple[float, Any]]:
    """Time since the first record, and message, of all but the chatter."""
    return list(recorded(name, CHATTER))


def on_route(fault: Fault) -> Session:
    """On a path along where the companion of the recording sent it, far from its target."""
    next_s, until_s, points = fault.from_s, fault.bad[1] + 10.0, list[tuple[float, float, float]]()
    for at_s, m in messages(fault.name):
        if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED" and next_s <= at_s <= until_s:
            next_s = at_s + 1.0
            points.append((m.x, m.y, fault.home_amsl_m - m.z))
    mission = missions.mission(fault.mission)
    subpath = Subpath(control_nea_m=np.array(points))
    leg = Leg(number=1, plan_id=1, subpath=subpath, reaches_target=False, rules=mission.task)
    state = State.of(mission, mission.known)
    flight = replace(state.flight, plan_id=1, legs_flown=1)
    state = replace(state, stage=Flying(path=OnPath(leg=leg)), airborne=True, flight=flight)
    kept = checkpoint.values_of(state), mission.known
    return Session(mission, seed=1, lockstep=False, resume=kept)


class Flown:
    """The recording through a session, in real time's way: what the session did, and when.

    The heartbeats tell the mode that it asked for, while the recorded vehicle is in guided mode.
    """

    def __init__(self, fault: Fault) -> None:
        self.leads_s: list[float] = []
        """When the vehicle was sent a setpoint."""
        self.modes: list[tuple[float, Mode]] = []
        """Those that it asked for."""
        self.planned_s: list[float] = []
        self.to_another: list[Any] = []
        """Sent while the heartbeats of the recording told another mode, after guided mode."""
        session, mode_of = on_route(fault), fault.autopilot.modes.mode_of
        reader, vehicle = codec(1), codec(1)
        vehicle.srcComponent = VEHICLE[1]
        heard_s, answer_s, guided, by_another = fault.from_s, math.inf, False, False
        asked, plan = None, None
        for at_s, message in messages(fault.name):
            sender = message.get_srcSystem(), message.get_srcComponent()
            if at_s > fault.end_s or sender == COMPANION:
                continue
            frame, was_by_another = bytes(message.get_msgbuf()), by_another
            if message.get_type() == "HEARTBEAT" and sender == VEHICLE:
                is_guided = mode_of(message.custom_mode) is Mode.GUIDED
                guided |= is_guided
                by_another = guided and not is_guided
                if asked is not None and is_guided:
                    answers, vehicle.seq = copy(message), message.get_seq()
                    answers.custom_mode = asked
                    frame = bytes(answers.pack(vehicle))
            if at_s < fault.from_s:
                continue
            if plan is not None and at_s >= answer_s:
                session.deliver(planned(plan, 1000.0))  # which nobody flies
                plan = None
            if session.receive(frame, at_s):
                heard_s = at_s
            else:
                session.silence(at_s - heard_s)
            out = session.run()
            for told in (reader.decode(bytearray(packed)) for packed in out.frames):
                self.leads_s += [at_s] * (told.get_type() in LEADS)
                self.to_another += [told] * (by_another and was_by_another)
                if getattr(told, "command", None) == wire.MAV_CMD_DO_SET_MODE:
                    main, sub = int(told.param2), int(told.param3)
                    asked = main << 16 | sub << 24 if fault.autopilot is PX4_MULTICOPTER else main
                    self.modes.append((at_s, mode_of(asked)))
            if out.plan is not None:
                self.planned_s.append(at_s)
                plan, answer_s = out.plan, at_s + 0.5


@pytest.mark.parametrize("fault", FAULTS, ids=lambda each: f"{each.name[:4]} {each.bad[0]:.0f} s")
def test_nothing_is_begun_at_a_wrong_position_or_in_anothers_mode(fault: Fault) -> None:
    """It lets go, and asks for hold.

    ArduPilot's glitch: 2 s after it was cleared guided mode is asked for, and then a plan.
    """
    it, (bad_s, right_s) = Flown(fault), fault.bad
    before = [at_s for at_s in it.leads_s if at_s < bad_s]
    assert len(before) > 5.0 * (bad_s - fault.from_s - 5.0)  # it took over, and did fly
    let_go_s = max(at_s for at_s in it.leads_s if at_s < right_s)
    assert let_go_s < bad_s + SEEN_S
    asked_s, asked = next(each for each in it.modes if each[0] > bad_s)
    assert asked is Mode.HOLD
    assert let_go_s < asked_s < let_go_s + 0.5
    for since_s, until_s in (each.bad for each in FAULTS if each.name == fault.name):
        begun_s = (*it.leads_s, *it.planned_s)
        assert not [at_s for at_s in begun_s if since_s + SEEN_S < at_s < until_s]
    again = [at_s for at_s in it.leads_s if at_s > right_s]
    assert min(again, default=math.inf) > right_s + TRUSTED_AGAIN_S
    assert it.to_another
    for message in it.to_another:
        kind, command = message.get_type(), getattr(message, "command", ASKS[0])
        assert kind not in CHANGES, message
        assert not kind.startswith("COMMAND_") or command in ASKS, message
    if fault is FAULTS[0]:
        guided_s = min(at_s for at_s, mode in it.modes if mode is Mode.GUIDED)
        assert right_s + TRUSTED_AGAIN_S < guided_s < right_s + TRUSTED_AGAIN_S + 1.0
        assert min(it.planned_s) > guided_s
