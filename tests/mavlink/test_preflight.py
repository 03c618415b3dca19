"""Each check before a flight made to pass, to note and to refuse, on a simulated vehicle."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from held import FOUR, Faced, level
from random_programs import message_numbers
from renewed import replace

from companion.config import load_mission
from companion.mavlink.dialect import codec, wire
from companion.mavlink.preflight import Check, CheckStatus, checks_of, waiting_for
from companion.mavlink.signing import Signing
from companion.mission.events import Outcome
from companion.mission.state import Phase
from companion.session import Session
from companion.world.known_map import empty_map
from companion.world.near_map import NearSensor
from vehicle_sim.simulation import Simulation

NAMES = dict(
    zip(FOUR, ("sitl-arducopter", "sitl-arduplane", "sitl-px4", "sitl-px4-plane"), strict=True)
)
Change = Callable[["Pair"], None]


class Pair(Faced):
    """A session and a vehicle, and what the checks say."""

    def __init__(
        self,
        name: str = "sitl-px4",
        *,
        faults: str = "",
        parameters: dict[str, float] | None = None,
        shadow: bool = True,
        signing: Signing | None = None,
        **changes: Any,
    ) -> None:
        mission = load_mission(name)
        firmware, kind = next(key for key, value in NAMES.items() if value == name)
        where = mission.frame.latitude_deg, mission.frame.longitude_deg
        home = (*where, 584.0 if firmware == "ardupilot" else 488.0)
        world = level(firmware, kind, home)
        vehicle = replace(world.vehicle, parameters=parameters or {})
        simulated = Simulation(replace(world, vehicle=vehicle), seed=1, links=2, faults=faults)
        super().__init__(replace(mission, **changes), simulated, shadow=shadow, signing=signing)

    def looked_at(self, seconds: float = 60.0) -> "Pair":
        """As `companion preflight` does it, without its waits."""
        self.run(seconds, until=lambda: waiting_for(self.session) == "")
        self.run(3.0)
        return self

    @property
    def checks(self) -> list[Check]:
        return checks_of(self.session)

    def named(self, name: str) -> list[Check]:
        return [check for check in self.checks if check.name.split(" = ")[0] == name]

    def status(self, name: str) -> str:
        """Of the check of this name, the worst if there are several; "" without one."""
        worst = sorted((check.status for check in self.named(name)), key=list(CheckStatus).index)
        return worst[-1].value if worst else ""

    def words(self, name: str) -> str:
        return " ".join(f"{check.what}. {check.remedy}" for check in self.named(name))

    @property
    def refused(self) -> list[str]:
        return [check.name for check in self.checks if check.status is CheckStatus.REFUSED]


@pytest.fixture(scope="module", params=list(NAMES.values()))
def good(request: pytest.FixtureRequest) -> Pair:
    """A vehicle that may fly, looked at; only to be read."""
    return Pair(request.param).looked_at()


@pytest.fixture(scope="module")
def looked() -> Pair:
    """A PX4 multicopter that may fly, looked at; what is changed of it is put back."""
    return Pair().looked_at()


# --- a vehicle that may fly


def test_a_vehicle_that_may_fly_passes_and_each_line_names_what(good: Pair) -> None:
    assert good.refused == []
    passed = "vehicle, messages, fence, targets, position, take-off, place, battery, link delay"
    assert {name: good.status(name) for name in passed.split(", ")} == dict.fromkeys(
        passed.split(", "), "ok"
    )
    assert good.status("radar") == "note"
    for check in good.checks:
        assert check.name
        assert check.what
        assert "\n" not in f"{check.name}{check.what}{check.remedy}"
        assert not check.what.endswith(".")
        assert check.remedy == "" or (check.remedy.endswith(".") and check.what)
        assert ".." not in f"{check.what}. {check.remedy}"


_REQUESTS = {wire.MAV_CMD_SET_MESSAGE_INTERVAL, wire.MAV_CMD_REQUEST_MESSAGE}
_ASKS = {
    "HEARTBEAT",
    "TIMESYNC",
    "PARAM_REQUEST_READ",
    "MISSION_REQUEST_LIST",
    "MISSION_REQUEST_INT",
    "MISSION_ACK",
    "TERRAIN_REQUEST",
    "STATUSTEXT",
}


def test_it_only_asks(good: Pair) -> None:
    sent = codec(1).parse_buffer(b"".join(good.sent))
    assert len(sent) > 50
    assert {m.get_type() for m in sent} - {"COMMAND_LONG"} <= _ASKS
    assert {m.command for m in sent if m.get_type() == "COMMAND_LONG"} <= _REQUESTS
    assert "PARAM_REQUEST_READ" in {m.get_type() for m in sent}
    assert good.session.state.vehicle.armed is False


# --- link and ids


def beat(system: int, component: int, kind: int = 2, autopilot: int = 12) -> bytes:
    sender = wire.MAVLink(None, srcSystem=system, srcComponent=component)
    frame: bytes = wire.MAVLink_heartbeat_message(kind, autopilot, 81, 0, 4, 3).pack(sender)
    return frame


@pytest.mark.parametrize(
    ("wanted", "heard", "words"),
    [
        (None, [beat(1, 50)], "an autopilot as component 50 of system 1. Set the autopilot's"),
        (1, [beat(1, 50), beat(2, 1)], "an autopilot as component 50 of system 1. Set the auto"),
        (3, [beat(1, 50)], "an autopilot as component 50 of system 1. Set the autopilot's"),
        (3, [beat(2, 1), beat(1, 50)], "vehicle.system_id = 3: only system 2 was heard. Give"),
        (None, [beat(255, 190, 6, 8)], "component 190 of system 255 without an autopilot's"),
        (None, [beat(1, 154, 26, 8)], "component 154 of system 1 without an autopilot's HEART"),
        (None, [bytes(range(200))], "what comes in is no MAVLink. Check the baud rate"),
        (None, [], "none was heard. Start it, or check --connect."),
    ],
)
def test_without_a_vehicle_it_says_what_is_heard_instead_and_what_to_do(
    wanted: int | None, heard: list[bytes], words: str
) -> None:
    session = Session(
        replace(load_mission("sitl-px4"), system_id=wanted), seed=1, lockstep=False, shadow=True
    )
    for frame in 4 * heard:
        session.receive(frame, 1.0)
        session.run()
    [check] = checks_of(session)
    assert (check.name, check.status) == ("vehicle", CheckStatus.REFUSED)
    assert words in f"{check.what}. {check.remedy}"


def test_a_sensor_of_other_ids_is_told_with_those_that_are_heard(
    looked: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lidar's driver is component 191 by its default; another radar, another rangefinder."""
    lidar = wire.MAVLink(None, srcSystem=1, srcComponent=191)
    radar = wire.MAVLink(None, srcSystem=2, srcComponent=101)
    sweep = wire.MAVLink_obstacle_distance_message(0, 0, [500] * 72, 5, 20, 1600)
    for message, sender in (
        (sweep, lidar),
        (wire.MAVLink_distance_sensor_message(0, 10, 1000, 500, 0, 0, 25, 0), lidar),
        (wire.MAVLink_terrain_data_message(0, 0, 100, 0, [0] * 16), radar),
    ):
        looked.hear(message.pack(sender))
    near = NearSensor(kind="obstacle_distance", component_id=196, range_m=16.0)
    for mission, name, words in (
        (
            replace(looked.mission, near=near),
            "sensor",
            "heard: OBSTACLE_DISTANCE of component 191 of system 1; DISTANCE_SENSOR of component "
            "1 of system 1, component 191 of system 1. Write those that it is into scanner.kind",
        ),
        (
            replace(looked.mission, scanner_component_id=77),
            "radar",
            "heard: TERRAIN_DATA of component 101 of system 2. Write the one that it is into",
        ),
    ):
        monkeypatch.setattr(looked.session, "mission", mission)
        monkeypatch.setattr(looked.session, "last_scan", None)
        assert words in looked.words(name)
    monkeypatch.setattr(looked.session, "rangefinder", SimpleNamespace(heard_s=-math.inf))
    words = "of component 1: not heard; heard: DISTANCE_SENSOR of component 191 of system 1. Set"
    assert words in looked.words("rangefinder")


def test_several_vehicles_and_none_chosen() -> None:
    other = wire.MAVLink(None, srcSystem=9, srcComponent=1)
    it = Pair()
    for _ in range(5):
        it.run(0.9)
        it.hear(wire.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(other))
    assert it.refused == ["vehicle"]
    assert "systems 1, 9 were heard. Choose one with --system." in it.words("vehicle")
    chosen = Pair(system_id=1)
    chosen.hear(wire.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(other))
    chosen.looked_at()
    assert chosen.status("vehicle") == "ok"
    assert "also heard: 9" in chosen.words("vehicle")


def seen(part: str, check: str, status: str, **changes: Any) -> tuple[str, str, str, Any]:
    """A row: what is otherwise of this part of a session, and what one check says of it."""
    return part, check, status, changes


HIGH = (0.0, 0.0, 700.0)


@pytest.mark.parametrize(
    ("part", "check", "status", "changes"),
    [
        seen("link", "link delay", "ok", round_trip_s=0.1),
        seen("link", "link delay", "refused", round_trip_s=0.8),
        seen("link", "link delay", "note", round_trip_s=None),
        seen("vehicle", "place", "refused", position_nea_m=(5000.0, 0.0, 488.0)),
        seen("vehicle", "take-off", "refused", position_nea_m=HIGH, home_nea_m=HIGH),
        seen("vehicle", "battery", "ok", battery=0.9),
        seen("vehicle", "battery", "refused", battery=0.1),
        seen("vehicle", "battery", "note", battery=None),
        seen("mission", "battery", "ok", endurance_s=1200.0),
        seen("mission", "battery", "refused", endurance_s=60.0),
    ],
)
def test_what_is_said_of_what_is_seen(
    looked: Pair,
    monkeypatch: pytest.MonkeyPatch,
    part: str,
    check: str,
    status: str,
    changes: dict[str, Any],
) -> None:
    session = looked.session
    if part == "link":
        monkeypatch.setattr(session.vehicle, *next(iter(changes.items())))
    elif part == "mission":
        monkeypatch.setattr(session, "mission", replace(session.mission, **changes))
    else:
        vehicle = replace(session.state.vehicle, **changes)
        monkeypatch.setattr(session, "state", replace(session.state, vehicle=vehicle))
    assert looked.status(check) == status
    if check == "take-off":
        assert "altitude.floor_amsl_m" in looked.words(check)
    if check == "battery" and changes.get("battery"):
        assert "not given" in looked.words(check)  # how long it lasts


def test_a_vehicle_that_falls_silent_is_not_one_that_may_fly() -> None:
    it = Pair().looked_at()
    for silent_s in np.arange(0.1, 40.0, 0.1):
        it.session.silence(float(silent_s))
    assert it.refused
    assert "fell silent" in it.words("link")


def upload(it: Pair, kind: int, *items: tuple[int, float, float, float]) -> None:
    """By a ground station: command, parameter, north and east in metres."""
    station = it.station
    station(wire.MAVLink_mission_count_message(1, 1, len(items), kind))
    for seq, (command, value, north_m, east_m) in enumerate(items):
        it.run(0.3)
        latitude, longitude = it.mission.frame.to_geodetic_deg(north_m, east_m)
        place = (round(latitude * 1e7), round(longitude * 1e7), 20.0)
        numbers = (seq, 3, command, 0, 1, value, 0.0, 0.0, 0.0, *place, kind)
        station(wire.MAVLink_mission_item_int_message(1, 1, *numbers))
    it.run(0.5)


@pytest.mark.parametrize(("ground_m", "verdict"), [(486.0, "ok"), (560.0, "refused")])
def test_a_terrain_with_another_datum(ground_m: float, verdict: str) -> None:
    limits = load_mission("sitl-px4").task.limits
    known = empty_map(load_mission("sitl-px4").task.cell_m, limits.north_m, limits.east_m)
    filled = np.full(known.upper_m.shape, ground_m)
    known = replace(known, upper_m=filled, seen=np.ones(known.seen.shape, dtype=bool))
    it = Pair(known=known).looked_at()
    assert it.status("datum") == verdict


KEY = bytes(range(32))


def test_a_key_and_a_vehicle_that_does_not_sign() -> None:
    it = Pair(signing=Signing(key=KEY, timestamp=10**13, link_id=0))
    it.run(10.0)
    assert it.refused == ["vehicle"]
    assert "not signed with this key. Set the same key up" in it.words("vehicle")


# --- what `fly` refuses is refused here, and the other way round


def hides(*kinds: str) -> Change:
    def change(it: Pair) -> None:
        it.loses = message_numbers(" ".join(kinds))

    return change


def draws(*items: tuple[int, float, float, float], kind: int = 1) -> Change:
    return lambda it: upload(it, kind, *items)


def armed(it: Pair) -> None:
    """By somebody else, before the companion is there."""
    arm = wire.MAV_CMD_COMPONENT_ARM_DISARM
    it.run(60.0, until=lambda: bool(it.session.state.vehicle.estimator_good))
    numbers = (1, 1, arm, 0, 1.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    it.station(wire.MAVLink_command_long_message(*numbers))
    it.run(2.0)


def signs(it: Pair) -> None:
    it.station(wire.MAVLink_setup_signing_message(1, 1, list(KEY), 10**13))


class Setup(NamedTuple):
    """A vehicle or mission that is not as it comes, and what one of the checks says of it."""

    keywords: dict[str, Any]
    change: Change = lambda _: None
    check: str = ""
    status: str = ""
    words: tuple[str, ...] = ()


UNSAFE = {"parameters": {"COM_OBL_RC_ACT": 0.0}}
"""PX4 without a remote control that sinks when the stream stops (px4.md 6)."""
ON_TARGET = draws((5004, 60.0, 600.0, 100.0))
NO_TARGETS: dict[str, Any] = {"targets_from_vehicle": True, "targets_ne_m": ()}
NO_CHANGE: Change = lambda _: None  # noqa: E731
OTHERS = ("vehicle", "refused", ("PX4", "vehicle.kind"))
_CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
SETUPS = {
    "nothing heard": Setup({}, hides("HEARTBEAT"), "vehicle", "refused", ("none was heard",)),
    "another kind": Setup({"task": load_mission(NAMES["px4", "plane"]).task}, NO_CHANGE, *OTHERS),
    "another autopilot": Setup({"autopilot": "ardupilot"}, NO_CHANGE, *OTHERS),
    "parameter to be set": Setup(UNSAFE, NO_CHANGE, "COM_OBL_RC_ACT", "note"),
    "parameter refused": Setup(
        {**UNSAFE, "sets_parameters": False},
        NO_CHANGE,
        *("COM_OBL_RC_ACT", "refused", ("Set it to",)),
    ),
    "no parameters": Setup({}, hides("PARAM_VALUE"), "parameters", "refused", ("not read: ",)),
    "no plans": Setup(
        {}, hides("MISSION_COUNT", "MISSION_ACK"), "fence", "refused", ("not read: ",)
    ),
    "no landed state": Setup(
        {}, hides("EXTENDED_SYS_STATE"), "messages", "refused", ("EXTENDED_SYS_STATE",)
    ),
    "no position": Setup({}, hides("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")),
    "no GPS": Setup({"faults": "at 0 s: gps_off"}, NO_CHANGE, "position", "refused"),
    "fence on a target": Setup(
        {},
        ON_TARGET,
        *("fence", "refused", ("target 1: ", "Move the target, or change the fence.")),
    ),
    "fence left out": Setup({"fence_from_vehicle": False}, ON_TARGET, "fence", "note"),
    "fence with no end": Setup(
        {},
        draws((5004, float("inf"), 300.0, 500.0)),
        *("fence", "refused", ("a circle needs a radius",)),
    ),
    "polygon after a circle": Setup(
        {},
        draws(
            (5004, 20.0, 300.0, -300.0),
            *((5002, 3.0, 400.0 + 30.0 * north, -300.0 + 30.0 * east) for north, east in _CORNERS),
        ),
        *("fence", "note", ("exclusion 2 after exclusion 1", "Upload polygons before circles.")),
    ),
    "no targets": Setup(NO_TARGETS, NO_CHANGE, "targets", "refused"),
    "targets of its own": Setup(
        NO_TARGETS,
        draws((16, 0.0, 300.0, 100.0), (16, 0.0, 500.0, 300.0), kind=0),
        *("targets", "ok", ("2 targets",)),
    ),
    "battery too short": Setup({"endurance_s": 30.0}, NO_CHANGE, "battery", "refused"),
    "armed already": Setup({}, armed, "armed", "refused", ("somebody else",)),
    "no radar": Setup(
        {"scanner_component_id": 77}, NO_CHANGE, "radar", "refused", ("component 77",)
    ),
    "signed, and no key": Setup(
        {"name": "sitl-arducopter"}, signs, "signing", "refused", ("--signing-key",)
    ),
}


def climbs(it: Pair) -> bool:
    return it.session.state.phase in (Phase.ARMING, Phase.TAKING_OFF)


@pytest.mark.parametrize("setup", SETUPS)
def test_what_fly_refuses_is_refused_here_and_the_other_way_round(setup: str) -> None:
    keywords, change, check, verdict, words = SETUPS[setup]
    looked = Pair(**keywords)
    change(looked)
    looked.looked_at(9.0)
    if check:
        assert looked.status(check) == verdict
        assert all(word in looked.words(check) for word in words), looked.words(check)
    flown = Pair(**keywords, shadow=False)
    if change is not armed:
        change(flown)
    else:  # it must not be the companion itself that arms
        flown.session, session = Pair(**keywords, shadow=True).session, flown.session
        change(flown)
        flown.session = session
    flown.run(12.0, until=lambda: flown.end is not None or climbs(flown))
    goes = climbs(flown)
    if not goes and flown.session.vehicle is not None:  # its patience is over now, not in 120 s
        state = flown.session.state
        flown.session.state = replace(state, since_s=state.now_s - 1e3)
        flown.run(1.5)
        assert flown.end.outcome is Outcome.FAILED
    refused = set(looked.refused)
    assert bool(refused) == (not goes), (refused, flown.end)
