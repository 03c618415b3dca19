"""Each check before a flight made to pass, to note and to refuse, on a simulated vehicle."""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from harness import GCS
from held import FOUR, MISSIONS, Held, polygon, stored
from lidars import obstacle_distance, tell
from random_programs import message_numbers
from renewed import replace
from scripted_vehicle import straight_plan
from wires import heard

from companion.config import load_mission
from companion.mavlink.checks import CheckStatus
from companion.mavlink.dialect import codec, wire
from companion.mavlink.frames import number_of
from companion.mavlink.poses import Poses
from companion.mavlink.preflight import checks_of, waiting_for
from companion.mavlink.sensors import others_of, scanner_of
from companion.mavlink.signing import Signing
from companion.mission.events import Outcome
from companion.mission.state import Phase, Reason
from companion.session import Session
from companion.world.known_map import empty_map
from vehicle_sim.plans import PlanItem as Stored
from vehicle_sim.plans import PlanKind

COPTER, _, PX4, _ = MISSIONS
KEY = bytes(range(32))


class Pair(Held):
    """A whole session and a simulated vehicle at the two ends of a link."""

    def __init__(
        self,
        name: str = PX4,
        *,
        faults: str = "",
        parameters: dict[str, float] | None = None,
        draws: Mapping[PlanKind, Sequence[Stored]] = MappingProxyType({}),
        loses: str = "",
        signs: bool = False,
        shadow: bool = True,
        has_key: bool = False,
        **changes: Any,
    ) -> None:
        """draws: lists by kind; loses: what is lost on the way; signs: with KEY."""
        mission, way = replace(load_mission(name), **changes), FOUR[MISSIONS.index(name)]
        where = mission.frame.latitude_deg, mission.frame.longitude_deg
        home = (*where, 488.0 if "px4" in name else 584.0)
        key = Signing(key=KEY, timestamp=10**13) if has_key else None
        self.session = Session(mission, seed=1, lockstep=False, go=True, shadow=shadow, signing=key)
        self.end: Any = None
        self.frames: list[bytes] = []
        """Sent to the vehicle."""
        self._lost = message_numbers(loses)
        super().__init__(*way, place=home, faults=faults, **(parameters or {}))
        for kind, items in draws.items():
            self.plan(kind, *items)
        if signs:
            self.send(wire.MAVLink_setup_signing_message(1, 1, list(KEY), 10**13), source=GCS)

    def deliver(self, frame: bytes) -> None:
        """A plan is there as soon as it is asked for."""
        if number_of(frame) in self._lost:
            return
        self.session.receive(frame, self.now_s)
        out = self.session.run()
        self.end = self.end or out.end
        self.frames += out.frames
        for each in out.frames:
            self.simulation.receive(0, each)
        if out.plan is not None:
            self.session.deliver(straight_plan(out.plan))

    def waited(self, seconds: float, done: Callable[[], bool]) -> None:
        """It may never be so."""
        end_s = self.now_s + seconds
        while self.now_s < end_s and not done():
            self.step()

    def looked_at(self, seconds: float = 60.0) -> "Pair":
        """As `companion preflight` does it, without its waits."""
        self.waited(seconds, lambda: waiting_for(self.session) == "")
        return self.run(3.0)

    @property
    def climbs(self) -> bool:
        return self.session.state.phase in (Phase.ARMING, Phase.TAKING_OFF)


def verdict(session: Any, name: str) -> tuple[str, str]:
    """The worst status of the checks of this name, and what is said, with the remedies."""
    found = [each for each in checks_of(session) if each.name.split(" = ")[0] == name]
    worst = max((check.status for check in found), key=list(CheckStatus).index)
    return worst.value, " ".join(f"{check.what}. {check.remedy}" for check in found)


def refused(session: Any) -> list[str]:
    return [each.name for each in checks_of(session) if each.status is CheckStatus.REFUSED]


@pytest.fixture(scope="module")
def looked() -> Pair:
    """A PX4 multicopter that may fly, looked at; a lidar and a radar of other ids are heard."""
    it = Pair().looked_at()
    for name, ids in (("OBSTACLE_DISTANCE", (1, 191)), ("TERRAIN_DATA", (2, 101))):
        it.deliver(bytes(heard(name, ids).get_msgbuf()))
    return it


REQUESTS = {wire.MAV_CMD_SET_MESSAGE_INTERVAL, wire.MAV_CMD_REQUEST_MESSAGE}
ASKS = "HEARTBEAT TIMESYNC PARAM_REQUEST_READ MISSION_REQUEST_LIST MISSION_REQUEST_INT MISSION_ACK"
ASKS += " TERRAIN_REQUEST STATUSTEXT COMMAND_LONG"


@pytest.mark.parametrize("name", MISSIONS)
def test_a_vehicle_that_may_fly_is_only_asked_and_passes(name: str) -> None:
    good = Pair(name).looked_at()
    sent = codec(1).parse_buffer(b"".join(good.frames))
    assert {"PARAM_REQUEST_READ"} < {m.get_type() for m in sent} <= set(ASKS.split())
    assert {m.command for m in sent if m.get_type() == "COMMAND_LONG"} <= REQUESTS
    assert good.session.state.vehicle.armed is False
    assert refused(good.session) == []
    passed = "vehicle, companion, messages, fence, targets, position, take-off, place, battery"
    assert {verdict(good.session, check)[0] for check in passed.split(", ")} == {"ok"}
    assert verdict(good.session, "radar")[0] == "note"
    for check in checks_of(good.session):
        line = f"{check.name}: {check.what}. {check.remedy}"
        assert re.fullmatch(r"[^\n:]+: [^\n]+[^.]\. ([A-Z][^\n]*\.)?", line), line


def beat(system: int, component: int, kind: int = 2, autopilot: int = 12) -> bytes:
    message = heard("HEARTBEAT", (system, component), type=kind, autopilot=autopilot)
    return bytes(message.get_msgbuf())


@pytest.mark.parametrize(
    ("wanted", "heard", "words"),
    [
        (1, [beat(1, 50), beat(2, 1)], "an autopilot as component 50 of system 1. Set the auto"),
        (3, [beat(2, 1), beat(1, 50)], "vehicle.system_id = 3: only system 2 was heard. Give"),
        (None, [beat(1, 1), beat(9, 1)], "systems 1, 9 were heard. Choose one with --system."),
        (None, [beat(255, 190, 6, 8)], "component 190 of system 255 without an autopilot's"),
        (None, [bytes(range(200))], "what comes in is no MAVLink. Check the baud rate"),
        (None, [], "no vehicle was heard. Start it, or check --connect."),
    ],
)
def test_without_a_vehicle_it_says_why(wanted: int | None, heard: list[bytes], words: str) -> None:
    mission = replace(load_mission(PX4), system_id=wanted)
    session = Session(mission, seed=1, lockstep=False, shadow=True)
    for frame in 4 * heard:
        session.receive(frame, 1.0)
        session.run()
    assert refused(session) == ["vehicle"]
    assert words in verdict(session, "vehicle")[1]


MISSION = load_mission(PX4)
UNKNOWN = empty_map(50.0, (-1000.0, 1000.0), (-1000.0, 1000.0))
SEEN = replace(UNKNOWN, seen=np.ones(UNKNOWN.seen.shape, dtype=bool))
LEVEL, HIGHER = (  # where the vehicle stands at 488 m: the second has another datum
    {"mission": replace(MISSION, known=replace(SEEN, upper_m=np.full(SEEN.seen.shape, ground_m)))}
    for ground_m in (486.0, 560.0)
)
HIGH = dict.fromkeys(("state.vehicle.position_nea_m", "state.vehicle.home_nea_m"), (0, 0, 700.0))
NO_HOME = {"state.vehicle.home_nea_m": None}
NO_FENCE = {"vehicle.own_fence.fence": None}


def sensors(name: str, sees_cm: tuple[int, int] | None = None, **changes: Any) -> dict[str, Any]:
    """What makes those of a mission once they are needed, as maps may be large: not heard yet.

    sees_cm: between which the lidar has told that it sees, where R is 16 m.
    """

    def made() -> Any:
        mission = replace(load_mission(name), **changes)
        poses = Poses(mission.frame)
        scanner = scanner_of(mission, poses)
        if sees_cm is not None:
            told = obstacle_distance(1.0, min_distance=sees_cm[0], reach_cm=sees_cm[1])
            tell(scanner, told, 1.0)
        return scanner, *others_of(mission, poses)

    return {"sensors": made}


@pytest.mark.parametrize(
    ("changes", "check", "status", "words"),
    [
        ({"state.vehicle.position_nea_m": (5000.0, 0.0, 488.0)}, "place", "refused", ""),
        (HIGH, "take-off", "refused", "floor"),
        ({"state.vehicle.armed": True}, "armed", "refused", "somebody else"),
        ({"state.reason": Reason.LINK_LOST}, "link", "refused", "fell silent"),
        ({"state.targets_ne_m": ((100.0, 0.0),)}, "targets", "ok", "1 target. "),
        ({"state.vehicle.battery": 0.9}, "battery", "ok", "endurance_s is not given"),
        ({"state.vehicle.battery": 0.1}, "battery", "refused", "endurance_s is not given"),
        ({"state.vehicle.battery": None}, "battery", "note", ""),
        ({"mission": replace(MISSION, endurance_s=1200.0)}, "battery", "ok", ""),
        ({"mission": replace(MISSION, endurance_s=60.0)}, "battery", "refused", ""),
        (HIGHER, "datum", "refused", ""),
        (LEVEL, "datum", "ok", ""),
        (sensors("forest"), "sensor", "refused", "component 191 of system 1"),
        (sensors("forest"), "sensor range", "note", "R = 16 m is believed"),
        (sensors("forest", (20, 1599)), "sensor range", "ok", ""),  # a driver has cut it off
        (sensors("forest", (20, 1200)), "sensor range", "refused", "planner.scan_range_m to 12 or"),
        (sensors("forest", (70, 4000)), "sensor range", "note", "Raise scanner.blind_m to 0.7"),
        (sensors(PX4, scanner_component_id=77), "radar", "refused", "component 101 of system 2."),
        (sensors(PX4, rangefinder_error_m=1.0), "rangefinder", "refused", "component 1: not heard"),
        ({"state.duplicate_id": True}, "companion", "refused", f"1/195: {Reason.NOT_ALONE.text}"),
        (NO_FENCE, "fence", "refused", "it is being read. Wait for it."),
        (NO_FENCE | NO_HOME, "fence", "refused", "about home, which is not known. Wait for it."),
    ],
)
def test_what_is_seen(
    looked: Pair, monkeypatch: pytest.MonkeyPatch, changes: Any, check: str, status: str, words: str
) -> None:
    """changes: what of the session is another, however deep."""
    monkeypatch.setattr(looked.session, "last_scan", None)
    for path, value in changes.items():
        *way, name = path.split(".")
        whole = reduce(getattr, way, looked.session)
        monkeypatch.setattr(whole, name, value() if callable(value) else value)
    told, said = verdict(looked.session, check)
    assert told == status
    assert words in said


ON_TARGET = {PlanKind.FENCE: [stored(5004, 60.0, 600.0, 100.0)]}
AFTER_A_CIRCLE = {PlanKind.FENCE: [stored(5004, 20.0, 300.0, -300.0), *polygon(3, size_m=30.0)]}
WAYPOINTS = {PlanKind.MISSION: [stored(16, 0.0, 300.0, 100.0), stored(16, 0.0, 500.0, 300.0)]}
UNSAFE = {"parameters": {"COM_OBL_RC_ACT": 0.0}}
"""PX4 without a remote control that sinks when the stream stops (px4.md 6)."""
THEIRS = {"targets_from_vehicle": True, "targets_ne_m": ()}
SIGNS = {"name": COPTER, "signs": True}
NO_POSITION = {"loses": "GLOBAL_POSITION_INT LOCAL_POSITION_NED"}
SETUPS: dict[str, tuple[str, str, str, Any]] = {  # what one of the checks says of a vehicle
    "another autopilot": ("vehicle", "refused", "vehicle.kind", {"autopilot": "ardupilot"}),
    "parameter to be set": ("COM_OBL_RC_ACT", "note", "", UNSAFE),
    "not set": ("COM_OBL_RC_ACT", "refused", "Set it to", UNSAFE | {"sets_parameters": False}),
    "no parameters": ("parameters", "refused", "not read: ", {"loses": "PARAM_VALUE"}),
    "no plans": ("fence", "refused", "not read: ", {"loses": "MISSION_COUNT MISSION_ACK"}),
    "no position": ("messages", "refused", "GLOBAL_POSITION_INT asked", NO_POSITION),
    "no GPS": ("position", "refused", "", {"faults": "at 0 s: gps_off"}),
    "fence on a target": ("fence", "refused", "or change the fence.", {"draws": ON_TARGET}),
    "left out": ("fence", "note", "", {"draws": ON_TARGET, "fence_from_vehicle": False}),
    "misread": ("fence", "note", "polygons before circles.", {"draws": AFTER_A_CIRCLE}),
    "no targets": ("targets", "refused", "", THEIRS),
    "targets of its own": ("targets", "ok", "2 targets", THEIRS | {"draws": WAYPOINTS}),
    "no radar": ("radar", "refused", "component 77", {"scanner_component_id": 77}),
    "signed, with its key": ("vehicle", "ok", "", SIGNS | {"has_key": True}),
    "not signed": ("vehicle", "refused", "key. Set the same key up", {"has_key": True}),
    "signed, and no key": ("signing", "refused", "--signing-key", SIGNS),
}


@pytest.mark.parametrize("setup", SETUPS)
def test_what_fly_refuses_is_refused_here_and_the_other_way_round(setup: str) -> None:
    check, status, words, keywords = SETUPS[setup]
    looked, flown = Pair(**keywords), Pair(**keywords, shadow=False)
    told, said = verdict(looked.looked_at(9.0).session, check)
    assert told == status
    assert words in said
    flown.waited(12.0, lambda: flown.end is not None or flown.climbs)
    goes = flown.climbs
    if not goes and flown.session.vehicle is not None:  # its patience is over now, not in 120 s
        state = flown.session.state
        flown.session.state = replace(state, since_s=state.now_s - 1e3)
        flown.run(1.5)
        assert flown.end.outcome is Outcome.FAILED
    assert bool(refused(looked.session)) == (not goes), flown.end
