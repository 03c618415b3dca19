"""One run of a campaign: it is flown, judged against the true world, and becomes a row.

A run is a function of its values: wherever and however often it is flown, the row is the same
but for the columns of `store.TIMING`.
"""

import errno
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from companion.campaign import drawn_faults, families, judge
from companion.campaign.drawn_world import DrawnWorld, of_files, tables_of
from companion.campaign.file import Knowledge, Place, Run
from companion.campaign.in_process import FlightFiles, Flying, fly_here, simulator
from companion.campaign.store import Row
from companion.config import load_world, read_mission, world_table
from companion.errors import InputError
from companion.optimise.registry import OPTIMISERS
from companion.planner.offline import OfflineFlight, TerrainRadar, fly_offline
from companion.planner.request import PlanOutcome, PlanRequest
from companion.planning import OURS, planner_of
from companion.profiles import PROFILES
from companion.sources.files import RawTable, toml_text, with_settings
from companion.world.simulated import simulated_scan, true_map

_POINTS_PER_RANGE = 1_000
_OF_PLACES = ("terrain clearance", "keep-out zone", "edge of the map")
_ROOT = "runs"
_FULL = (errno.ENOSPC, errno.EDQUOT)


def fly_run(run: Run, out: Path) -> Row:
    """Fly a run; its folder, if it is kept, is in `out`.  Whatever it raises is in the row.

    OSError if there is no room for its folder: that is no result of the run.
    """
    began_s, cpu_s = time.perf_counter(), time.process_time()
    room = out / _ROOT if run.keep != "none" else Path(tempfile.gettempdir())
    room.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=".new-", dir=room))
    try:
        columns = _flown(run, folder)
        failed = not columns["arrived"] or bool(columns.get("violations"))
        if run.keep == "all" or (run.keep == "failures" and failed):
            columns["folder"] = f"{_ROOT}/{run.number:06d}"
            kept = out / columns["folder"]
            shutil.rmtree(kept, ignore_errors=True)  # of a worker that was lost
            folder.replace(kept)
            kept.chmod(0o755)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    columns |= {"took_s": time.perf_counter() - began_s, "cpu_s": time.process_time() - cpu_s}
    return row_of(run, columns)


def row_of(run: Run, columns: Row) -> Row:
    """The row of a run, with what was found of it."""
    about = {"run": run.number, "key": run.key, "seed": run.seed, "over": run.over}
    about |= run.place._asdict() | {"world": run.place.name, "planner": OURS, "knowledge": "scans"}
    flown = {"version": version("companion"), "worker": f"{platform.node()}/{os.getpid()}"}
    return about | run.factors | flown | {"took_s": 0.0, "cpu_s": 0.0, "folder": ""} | columns


def error_of(error: str) -> Row:
    """What is found of a run that raised this."""
    return {"outcome": "error", "arrived": False, "error": error}


def _flown(run: Run, folder: Path) -> Row:
    try:
        if run.over == "planner":
            return _planned(run, folder)
        files = _files(run, folder)
        flown = fly_here(files, seed=run.seed, limit_s=run.limit_s)
        drawn = of_files(str(files.world), str(files.mission))
        is_drawn = run.script is not None
        columns = judge.judged(flown, drawn, files.faults if is_drawn or files.faults else None)
        columns |= {"timeline": files.faults or None}
        return columns | ({"faults": files.drawn} if is_drawn else {})
    except Exception as error:  # noqa: BLE001 - one run does not end a campaign
        cause = error.__cause__ or error
        if isinstance(cause, OSError) and cause.errno in _FULL:
            raise OSError(cause.errno, cause.strerror, str(folder.parent)) from None
        return error_of(" ".join(f"{type(error).__name__}: {error}".split()))


# --- the planner alone


def fly_alone(
    world: DrawnWorld, planner: str = OURS, *, knowledge: Knowledge = "scans", seed: int = 1
) -> tuple[OfflineFlight, list[float]]:
    """Fly a world's mission with a planner, ours or a rival, and without a vehicle.

    -> what was flown, and the processor time of each plan.  With full knowledge all of the ground
    is on the map before it.
    """
    task, plan_s, plan = world.task, list[float](), planner_of(planner)
    blank, range_m = families.unseen(world), task.settings.scan_range_m
    if knowledge == "full":
        every = np.ones(blank.upper_m.shape, dtype=bool)
        upper_m = true_map(world.terrain, blank).upper_m
        blank = replace(blank, upper_m=upper_m, seen=every, given=every)

    def timed(request: PlanRequest) -> PlanOutcome:
        began_s = time.process_time()
        outcome = plan(request)
        plan_s.append(time.process_time() - began_s)
        return outcome

    flight = fly_offline(
        task,
        TerrainRadar(task, lambda at: simulated_scan(blank, at, range_m, world.terrain)),
        blank=blank,
        start_nea_m=world.start_nea_m,
        targets_ne_m=world.targets_ne_m,
        seed=seed,
        planner=timed,
    )
    return flight, plan_s


def _planned(run: Run, folder: Path) -> Row:
    drawn, changes = drawn_of(run.place), _of_planner(run)
    if "profile" in changes:
        changes["profile"] = PROFILES[changes["profile"]]
    settings = replace(drawn.task.settings, **changes)
    drawn = replace(drawn, task=replace(drawn.task, settings=settings))
    if run.keep != "none":
        _files(run, folder)
    planner, knowledge = run.factors.get("planner", OURS), run.factors.get("knowledge", "scans")
    flight, plan_s = fly_alone(drawn, planner, knowledge=knowledge, seed=run.seed)
    failure = flight.failure
    columns = judge.of_task(drawn, plan_s) | {
        "outcome": "failed" if failure else "arrived",
        "reason": failure.why if failure else None,
        "arrived": not failure,
        "plans": len(plan_s),
        "holds": flight.holds,
    }
    subpaths = [(leg.subpath.control_nea_m, leg.speed_m_s) for leg in flight.legs]
    if subpaths:
        track_nea_m = flight.route_nea_m(settings.scan_range_m / _POINTS_PER_RANGE)
        columns |= judge.of_track(track_nea_m, drawn)
    is_ours = planner == OURS
    bounds = None if is_ours else _OF_PLACES  # rivals turn on the spot
    return columns | judge.checked(subpaths, drawn, joined=is_ours, bounds=bounds)


def drawn_of(place: Place) -> DrawnWorld:
    """The world and mission of a place."""
    if place.family is not None:
        return families.world(place.family, place.family_seed or 0, place.family_index or 0)
    return of_files(place.world, place.mission or place.world)


def _of_planner(run: Run) -> dict[str, Any]:
    """The factors that are keys of the mission's planner, under their names there."""
    names = {"profile": "profile", "optimiser": "optimiser", "budget": "evaluations"}
    return {key: run.factors[name] for name, key in names.items() if name in run.factors}


# --- flights


def _tables(run: Run) -> tuple[RawTable, RawTable]:
    """World and mission of a run, with its factors, as their files have them."""
    place, asked = run.place, run.factors.get("vehicle")
    autopilot: Any
    autopilot, _, kind = (asked or "ardupilot").partition("-")
    if place.family is not None:
        world, mission = tables_of(drawn_of(place), autopilot)
    else:
        load_world(place.world)  # says in one line what is wrong with it
        world, mission = world_table(place.world), read_mission(place.mission or place.world).table
    if asked is not None:
        is_ideal = (world["vehicle"]["autopilot"], asked) == ("ideal", "ardupilot-copter")
        world["vehicle"] |= {"autopilot": "ideal" if is_ideal else autopilot, "kind": kind}
        mission["vehicle"] |= {"autopilot": autopilot, "kind": kind}
    mission["planner"] = mission.get("planner", {}) | _of_planner(run)
    for choice in run.choices:
        world = with_settings(world, choice.world)
        mission = with_settings(mission, choice.mission)
    return world, mission


def _files(run: Run, folder: Path) -> FlightFiles:
    """World, mission and faults of a run, as companion and vehicle read them."""
    world, mission = _tables(run)
    name, lines = "", [choice.faults.strip() for choice in run.choices]
    if run.script is not None:
        of = mission["vehicle"]
        autopilot = of.get("autopilot") or world["vehicle"]["autopilot"]
        vehicle = f"{autopilot}-{of['kind']}".replace("ideal", "ardupilot")
        name, more = drawn_faults.drawn(run.script, vehicle, of["speed_m_s"])
        lines.append(more)
    given = folder / "asked"  # mission.toml of a run folder is written by who flies
    given.mkdir()
    (folder / "world.toml").write_text(toml_text(world), encoding="utf-8")
    (given / "mission.toml").write_text(toml_text(mission), encoding="utf-8")
    return FlightFiles(
        world=folder / "world.toml",
        mission=given / "mission.toml",
        faults="\n".join(filter(None, lines)),
        folder=folder,
        drawn=name,
    )


# --- before the first one


def check_runs(runs: Sequence[Run], where: str) -> None:
    """InputError about the first run whose files, settings or faults cannot be flown by.

    One run of each kind is looked at; of a family, one world.
    """
    for planner in {run.factors.get("planner", OURS) for run in runs}:
        planner_of(planner, "factors.planner")
    for optimiser in {run.factors["optimiser"] for run in runs if "optimiser" in run.factors}:
        OPTIMISERS.chosen(optimiser, "factors.optimiser")
    kinds = dict[Any, Run]()
    for run in runs:
        names = tuple(choice.name for choice in run.choices)
        kinds.setdefault((run.place.family or run.place, names, run.factors.get("vehicle")), run)
    for run in kinds.values():
        try:
            with tempfile.TemporaryDirectory() as folder:
                if run.over == "process":
                    files = _files(run, Path(folder))
                    simulator().entries(files.faults)
                    Flying(files, seed=0, limit_s=run.limit_s).close()
                elif run.place.family is None:
                    drawn_of(run.place)
        except Exception as error:  # noqa: BLE001 - of either program, in its words
            text = " ".join(str(error).split())
            rule = f"it cannot be flown: {text.rstrip('.')}"
            raise InputError(where, run.key, rule, "Mend the campaign file.") from None
