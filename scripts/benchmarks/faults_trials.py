"""What is made to happen: every fault of the simulator's catalogue, and what else design 7 names.

A trial is drawn for one scene with one generator: what happens, when, how strongly, how long.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from pair import Happening, Pair
from pair_worlds import Scene

from companion.world.threats import CircleZone
from vehicle_sim.faults.catalogue import FAULTS

Rng = np.random.Generator
Draw = Callable[[Rng, Scene], list[tuple[float, Happening]]]

_SIDES = ("north", "east", "south", "west")
_ON = " on link 0"
_WAYS = ("", " to_vehicle", " from_vehicle")
_GUIDED = {("ardupilot", "copter"): (4, 0), ("ardupilot", "plane"): (15, 0)}
_RETURN = {("ardupilot", "copter"): (6, 0), ("ardupilot", "plane"): (11, 0)}
_PAUSE_CONTINUE, _CHANGE_SPEED, _FENCE_ENABLE = 193, 178, 207


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One row of the table."""

    name: str
    draw: Draw
    applies: Callable[[Scene], bool] = lambda _: True
    limit_s: float = 300.0


def does(what: str, act: Callable[[Pair], None]) -> Happening:
    """Note that it happens, and make it happen."""

    def happen(pair: Pair) -> None:
        pair.note(what)
        act(pair)

    return happen


def fault(line: str) -> Happening:
    """One of the simulator's, from now on."""
    return does(line, lambda pair: pair.simulation.add_fault(line))


def says(what: str, command: int, *parameters: float) -> Happening:
    """A command of the ground station to the companion."""
    return does(what, lambda pair: pair.station.command(command, *parameters))


def thinks(what: str, **values: Any) -> Happening:
    """The companion, if there is one, has these attributes from now on."""

    def change(pair: Pair) -> None:
        for name, value in values.items():
            if pair.brain is not None:
                setattr(pair.brain, name, value)

    return does(what, change)


def when(rng: Rng, scene: Scene) -> float:
    """A moment of the mission."""
    return float(rng.uniform(2.0, 75.0 if scene.kind == "copter" else 100.0))


def _line(form: Callable[[Rng, Scene], str], lasts_s: tuple[float, float] | None) -> Draw:
    """A fault of the catalogue for so long."""

    def draw(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
        at_s, line = when(rng, scene), form(rng, scene)
        if lasts_s is not None:
            line = f"for {rng.uniform(*lasts_s):.2f} s: {line}"
        return [(at_s, fault(line))]

    return draw


def _side(rng: Rng) -> str:
    return str(rng.choice(_SIDES))


def _way(rng: Rng) -> str:
    return str(rng.choice(_WAYS)) + _ON


def _wind(rng: Rng, scene: Scene) -> str:
    speed = rng.uniform(3.0, 9.0 if scene.kind == "copter" else 7.0)
    return (
        f"wind {speed:.1f} m/s from {rng.uniform(0, 360):.0f} deg "
        f"turbulence {rng.uniform(0, 1.5):.1f} m/s rising {rng.uniform(-5, 5):.0f} deg"
    )


def _noise(rng: Rng, _: Scene) -> str:
    return f"radar_noise {rng.uniform(0.5, 8):.1f} m" + str(rng.choice(["", " either_way"]))


_CATALOGUE: dict[str, tuple[Callable[[Rng, Scene], str], tuple[float, float] | None]] = {
    "gps_off": (lambda *_: "gps_off", (0.5, 25.0)),
    "gps_glitch": (lambda r, _: f"gps_glitch {r.uniform(3, 90):.0f} m {_side(r)}", (1.0, 30.0)),
    "gps_drift": (lambda r, _: f"gps_drift {r.uniform(0.3, 4):.1f} m/s {_side(r)}", (5.0, 30.0)),
    "gps_jam": (lambda *_: "gps_jam", (1.0, 15.0)),
    "gps_noise": (lambda r, _: f"gps_noise {r.uniform(0.3, 3):.1f} m", (10.0, 60.0)),
    "gps_delay": (lambda r, _: f"gps_delay {r.uniform(100, 600):.0f} ms", (10.0, 60.0)),
    "gps_satellites": (lambda r, _: f"gps_satellites {r.integers(0, 9)}", (1.0, 25.0)),
    "wind": (_wind, None),
    "turbulence": (lambda r, _: f"turbulence {r.uniform(0.5, 2.5):.1f} m/s", None),
    "battery": (lambda r, _: f"battery {r.uniform(3, 40):.0f} %", None),
    "battery_voltage": (lambda r, _: f"battery_voltage {r.uniform(9.5, 12):.1f} V", None),
    "link_off": (lambda r, _: "link_off" + _way(r), (0.2, 25.0)),
    "link_loss": (lambda r, _: f"link_loss {r.uniform(3, 60):.0f} %" + _way(r), (10.0, 60.0)),
    "link_delay": (
        lambda r, _: (
            f"link_delay {r.uniform(20, 700):.0f} ms jitter {r.uniform(0, 200):.0f} ms" + _way(r)
        ),
        (5.0, 60.0),
    ),
    "link_duplication": (lambda r, _: f"link_duplication {r.uniform(5, 80):.0f} %{_ON}", None),
    "link_reordering": (lambda r, _: f"link_reordering {r.uniform(5, 60):.0f} %{_ON}", None),
    "link_corruption": (lambda r, _: f"link_corruption {r.uniform(1, 40):.0f} %" + _way(r), None),
    "radar_off": (lambda *_: "radar_off", (2.0, 40.0)),
    "radar_blind": (lambda *_: "radar_blind", (2.0, 40.0)),
    "radar_drop": (lambda r, _: f"radar_drop {r.uniform(2, 50):.0f} %", None),
    "radar_loss": (lambda r, _: f"radar_loss {r.uniform(2, 70):.0f} %", None),
    "radar_noise": (_noise, None),
    "radar_delay": (lambda r, _: f"radar_delay {r.uniform(50, 1500):.0f} ms", (5.0, 60.0)),
    "radar_rate": (lambda r, _: f"radar_rate {r.uniform(0.5, 8):.1f} Hz", (5.0, 60.0)),
    "setpoints_ignored": (lambda *_: "setpoints_ignored", (0.5, 15.0)),
    "estimator_reset": (
        lambda r, _: f"estimator_reset {r.uniform(1, 50):.0f} m {_side(r)}",
        None,
    ),
    "origin_move": (
        lambda r, _: (
            f"origin_move {r.uniform(2, 60):.0f} m {_side(r)} {r.uniform(1, 15):.0f} m "
            + str(r.choice(["up", "down"]))
        ),
        None,
    ),
    "pilot": (lambda *_: "pilot", None),
    "reboot": (lambda *_: "reboot", None),
    "set": (lambda r, _: f"set SIM_GPS1_NUMSATS {r.integers(3, 9)}", (2.0, 25.0)),
}
"""By name: the line, and how long it lasts (None: for good, or once)."""


# --- what is no fault of the vehicle


def _new_fence_ahead(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    size = 1.0 if scene.kind == "copter" else 3.5
    ahead_m, radius_m = size * rng.uniform(60.0, 180.0), size * rng.uniform(15.0, 35.0)

    def happen(pair: Pair) -> None:
        leg, flight = None, None
        if pair.brain is not None:
            flight = pair.brain.session.state.flight
            leg = flight.leg
        if leg is None or flight is None:
            north_m, east_m = pair.where()[:2]
            bearing = math.radians(pair.scene.world.vehicle.heading_deg)
            place = (north_m + ahead_m * math.cos(bearing), east_m + ahead_m * math.sin(bearing))
        else:
            along = min(flight.reference.length_m + ahead_m, leg.subpath.length_m)
            place = tuple(leg.subpath.pose(along).position_nea_m[:2])
        pair.note(f"new fence {ahead_m:.0f} m ahead, radius {radius_m:.0f} m")
        pair.upload((*scene.fence, _circle(place, radius_m)))

    return [(when(rng, scene), happen)]


def _new_fence_around(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    radius_m = rng.uniform(15.0, 35.0) * (1.0 if scene.kind == "copter" else 3.5)
    aside = rng.uniform(-0.7, 0.7, 2) * radius_m

    def draws(pair: Pair) -> None:
        north_m, east_m = pair.where()[:2]
        place = (north_m + float(aside[0]), east_m + float(aside[1]))
        pair.upload((*scene.fence, _circle(place, radius_m)))

    what = f"new fence around the vehicle, radius {radius_m:.0f} m"
    return [(when(rng, scene), does(what, draws))]


def _own_fence_and_back(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    """The autopilot itself stops at the new fence; a person leaves it to the companion again."""
    (at_s, draws), *_ = _new_fence_around(rng, scene)

    def happen(pair: Pair) -> None:
        if scene.autopilot == "ardupilot":  # PX4 keeps to a fence as soon as there is one
            pair.station.command(_FENCE_ENABLE, 1.0, component=1)
        draws(pair)

    give_back = says("given back by command", _PAUSE_CONTINUE, 1.0)
    return [(at_s, happen), (at_s + rng.uniform(8.0, 30.0), give_back)]


def _circle(place: tuple[float, ...], radius_m: float) -> CircleZone:
    return CircleZone(
        name="new fence", north_m=float(place[0]), east_m=float(place[1]), radius_m=radius_m
    )


def _pilot_and_back(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    at_s, mode = when(rng, scene), _GUIDED.get((scene.autopilot, scene.kind))
    by_mode = mode is not None and rng.random() < 0.5

    give_back = says("given back by command", _PAUSE_CONTINUE, 1.0)
    if by_mode and mode is not None:
        give_back = does("given back by mode", lambda pair: pair.station.set_mode(*mode))
    return [(at_s, fault("pilot")), (at_s + rng.uniform(2.0, 6.0), give_back)]


def _station_returns(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    mode = _RETURN.get((scene.autopilot, scene.kind), (4, 5))
    selects = does("the ground station selects return", lambda pair: pair.station.set_mode(*mode))
    return [(when(rng, scene), selects)]


def _pause_and_continue(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    at_s = when(rng, scene)
    goes_on = says("continue", _PAUSE_CONTINUE, 1.0)
    return [(at_s, says("pause", _PAUSE_CONTINUE, 0.0)), (at_s + rng.uniform(1.0, 15.0), goes_on)]


def _reposition(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    target = np.array(scene.mission.targets_ne_m[-1])
    aside = rng.normal(0.0, 0.12 * float(np.linalg.norm(target)), 2)
    place = rng.uniform(0.3, 1.0) * target + aside

    def orders(pair: Pair) -> None:
        pair.flown.target_ne_m = (float(place[0]), float(place[1]))
        pair.station.reposition(pair.flown.target_ne_m, 0.5 * sum(scene.mission.task.band_amsl_m))

    return [(when(rng, scene), does("reposition", orders))]


def _change_speed(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    speed = rng.uniform(0.4, 1.3) * scene.mission.task.limits.speed_m_s
    slower = says(f"speed {speed:.1f} m/s", _CHANGE_SPEED, 1.0, speed, -1.0)
    return [(when(rng, scene), slower)]


def _plan_late(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    at_s = when(rng, scene)
    takes_s = scene.mission.task.settings.planning_time_s + rng.uniform(0.1, 12.0)
    late = thinks(f"plans take {takes_s:.1f} s", plan_s=takes_s)
    quick = thinks("plans are quick again", plan_s=0.02)
    return [(at_s, late), (at_s + rng.uniform(10.0, 60.0), quick)]


def _planner_dies(rng: Rng, _: Scene) -> list[tuple[float, Happening]]:
    dies = thinks("the next plan kills the planner", planner_dies=True)
    return [(float(rng.uniform(0.0, 40.0)), dies)]


def _killed(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    at_s, away_s = when(rng, scene), float(rng.uniform(0.3, 8.0))
    what = f"the companion is killed, and is back after {away_s:.1f} s"
    return [(at_s, does(what, lambda pair: pair.kill(away_s)))]


def _link_lost(rng: Rng, scene: Scene) -> list[tuple[float, Happening]]:
    return [(when(rng, scene), fault(f"for {rng.uniform(30, 60):.0f} s: link_off{_ON}"))]


def is_near(fault_name: str) -> bool:
    """Whether it is a fault of a lidar or a rangefinder, which these vehicles do not have."""
    return fault_name.startswith(("lidar_", "rangefinder_"))


def trials() -> tuple[Trial, ...]:
    """All rows, in the order of the table."""
    missing = {row.name for row in FAULTS if not is_near(row.name)} - _CATALOGUE.keys()
    assert not missing, f"no trial of {missing}"
    rows = [
        Trial(
            name=row.name,
            draw=_line(*_CATALOGUE[row.name]),
            applies=_only(row.only),
            limit_s=200.0 if row.name in ("pilot", "reboot") else 300.0,
        )
        for row in FAULTS
        if not is_near(row.name)
    ]
    others: dict[str, Draw] = {
        "nothing": lambda *_: [],
        "pilot, and back": _pilot_and_back,
        "station selects return": _station_returns,
        "new fence ahead": _new_fence_ahead,
        "new fence around it": _new_fence_around,
        "pause and continue": _pause_and_continue,
        "reposition": _reposition,
        "change of speed": _change_speed,
        "plans late": _plan_late,
        "planner dies": _planner_dies,
        "companion killed, restarted": _killed,
        "link lost for long": _link_lost,
    }
    own_fence = Trial(
        name="stopped by its own fence, and back",
        draw=_own_fence_and_back,
        # ArduCopter's fence has a height and a circle about home as well
        applies=lambda scene: (scene.autopilot, scene.kind) != ("ardupilot", "copter"),
    )
    return (*rows, *(Trial(name=name, draw=draw) for name, draw in others.items()), own_fence)


def _only(firmware: str | None) -> Callable[[Scene], bool]:
    return lambda scene: firmware is None or scene.autopilot == firmware
