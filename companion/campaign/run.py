"""One run of a campaign: it is flown, judged against the true world, and becomes a row.

A run is a function of its values: wherever and however often it is flown, the row is the same
but for the columns of `row.TIMING`.
"""

import errno
import math
import os
import platform
import resource
import shutil
import tempfile
import time
from collections.abc import Container, Iterable, Sequence
from dataclasses import replace
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from companion.campaign import (
    alone,
    drawn_faults,
    families,
    in_process,
    judge,
    truth,
)  # fmt: skip
from companion.campaign.drawn_files import write
from companion.campaign.drawn_world import DrawnWorld, judgeable
from companion.campaign.file import Place, Run
from companion.campaign.flight import Flight, FlightFiles, crash_of, in_the_air
from companion.campaign.row import Row
from companion.config import folder_of, load_mission, load_world, mission_text, world_table
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.library import route_terms
from companion.planner.settings import Task
from companion.planning import OURS
from companion.profiles import PROFILES
from companion.sources.files import toml_table, toml_text, with_settings

_SPACING_M = 1.0
"""Between the points of a subpath at which it is checked, as far as that makes a few thousand."""
_MOST_POINTS = 20_000
_OF_SHAPE = ("turn radius", "climb angle", "dive angle")
_OF_PLACES = ("terrain clearance", "keep-out zone", "edge of the map")
_TOUCHED = "flown: touched something"
_FACTORS = ("vehicle", "sensor", "faults", "wind", "noise", "planner", "knowledge")
_OF_PLACE = ("mission", "family", "family_seed", "family_index")
_ROOT = "runs"
_FULL = (errno.ENOSPC, errno.EDQUOT)


def fly_run(run: Run, out: Path) -> Row:
    """Fly a run; its folder, if it is kept, is in `out`.  Whatever it raises is in the row.

    OSError if there is no room for its folder: that is no result of the run.
    """
    began_s, cpu_s = time.perf_counter(), _cpu_s()
    kept = run.keep != "none"
    room = out / _ROOT if kept else Path(tempfile.gettempdir())
    room.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=".new-", dir=room))
    try:
        found = _flown(run, folder)
    except Exception as error:  # noqa: BLE001 - one run does not end a campaign
        cause = error.__cause__ or error
        if isinstance(cause, OSError) and cause.errno in _FULL:
            shutil.rmtree(folder, ignore_errors=True)
            raise OSError(cause.errno, cause.strerror, str(room)) from None
        text = " ".join(f"{type(error).__name__}: {error}".split())
        found = {"outcome": "error", "arrived": False, "error": text}
    failed = not found["arrived"] or bool(found.get("violations"))
    name = ""
    if run.keep == "all" or (run.keep == "failures" and failed):
        name = f"{_ROOT}/{run.number:06d}"
        shutil.rmtree(out / name, ignore_errors=True)  # of a worker that was lost
        folder.replace(out / name)
        folder = out / name
        folder.chmod(0o755)
    else:
        shutil.rmtree(folder, ignore_errors=True)
    return _row(
        run, found, folder=name, took_s=time.perf_counter() - began_s, cpu_s=_cpu_s() - cpu_s
    )


def lost_run(run: Run, error: str) -> Row:
    """The row of a run of which nothing came back."""
    found = {"outcome": "error", "arrived": False, "error": error}
    return _row(run, found, folder="", took_s=0.0, cpu_s=0.0)


def _row(run: Run, found: dict[str, Any], *, folder: str, took_s: float, cpu_s: float) -> Row:
    place = run.place
    asked = {
        "profile": run.profile or "",
        "optimiser": run.optimiser or "",
        "budget": run.budget or 0,
    }
    of_place = {name: getattr(place, name) for name in _OF_PLACE}
    return Row(
        run=run.number,
        key=run.key,
        seed=run.seed,
        world=Path(place.world).parent.name if place.world.endswith(".toml") else place.world,
        over=run.over,
        folder=folder,
        version=version("companion"),
        took_s=took_s,
        cpu_s=cpu_s,
        worker=f"{platform.node()}/{os.getpid()}",
        **({factor: getattr(run, factor) for factor in _FACTORS} | of_place | asked | found),
    )


def _cpu_s() -> float:
    ours, children = (
        resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return ours.ru_utime + ours.ru_stime + children.ru_utime + children.ru_stime


def _flown(run: Run, folder: Path) -> dict[str, Any]:
    if run.over == "planner":
        return _planned(run, folder)
    files = _files(run, folder)
    recorded = run.keep != "none" or run.with_faults
    flown = in_process.fly_here(files, seed=run.seed, limit_s=run.limit_s, recorded=recorded)
    found = _judged(flown, files, with_faults=run.with_faults)
    found |= {"timeline": files.faults or None}
    return found | ({"faults": files.drawn} if run.script is not None else {})


# --- the planner alone


def _planned(run: Run, folder: Path) -> dict[str, Any]:
    drawn = _with_factors(drawn_of(run.place), run)
    if run.keep != "none":
        write(drawn, folder)
    knowledge: Any = run.knowledge
    flown = alone.fly(drawn, run.planner, knowledge=knowledge, seed=run.seed)
    found = _of_task(drawn.task) | {
        "outcome": "arrived" if flown.arrived else "failed",
        "reason": flown.why or None,
        "arrived": flown.arrived,
        "plans": len(flown.plan_s),
        "holds": flown.holds,
        "plan_ms_median": 1e3 * float(np.median(flown.plan_s)) if flown.plan_s else None,
        "plan_ms_p99": 1e3 * float(np.quantile(flown.plan_s, 0.99)) if flown.plan_s else None,
        "straight_m": _straight_m(drawn.start_nea_m, drawn.targets_ne_m),
    }
    subpaths = flown.subpaths_nea_m
    if subpaths:
        found |= {"subpaths": len(subpaths)} | _of_track(flown.points_nea_m, drawn)
    bounds = None if run.planner == OURS else _OF_PLACES  # rivals turn on the spot
    return found | _checked(subpaths, drawn, joined=run.planner == OURS, bounds=bounds)


def drawn_of(place: Place) -> DrawnWorld:
    """The world and mission of a place."""
    if place.family is not None:
        return families.world(place.family, place.family_seed or 0, place.family_index or 0)
    return _as_drawn(place.world, place.mission or place.world)


def _as_drawn(world: str, mission: str) -> DrawnWorld:
    """World and mission of files, as the judge takes them."""
    place, read = load_world(world), load_mission(mission)
    return DrawnWorld(
        name=place.name,
        terrain=judgeable(place.terrain, read.task.limits),
        task=read.task,
        start_nea_m=(*place.start_ne_m, read.task.take_off_amsl_m),
        targets_ne_m=read.targets_ne_m,
    )


def _with_factors(drawn: DrawnWorld, run: Run) -> DrawnWorld:
    changes: dict[str, Any] = {"optimiser": run.optimiser, "evaluations": run.budget}
    changes["profile"] = None if run.profile is None else PROFILES[run.profile]
    settings = replace(drawn.task.settings, **{k: v for k, v in changes.items() if v is not None})
    return replace(drawn, task=replace(drawn.task, settings=settings))


# --- flights


def _files(run: Run, folder: Path) -> FlightFiles:
    """World and mission of a run, with its factors, as companion and vehicle read them."""
    place = run.place
    if place.family is not None:
        autopilot: Any = (run.vehicle or "ardupilot").partition("-")[0]
        write(drawn_of(place), folder, autopilot)
        world_name, mission_name = str(folder / "world.toml"), str(folder / "mission.toml")
    else:
        world_name, mission_name = place.world, place.mission or place.world
    load_world(world_name)  # says in one line what is wrong with it
    world, mission = world_table(world_name), toml_table(mission_text(mission_name), mission_name)
    for table, name in ((world, world_name), (mission, mission_name)):
        terrain = table.get("terrain")
        if isinstance(terrain, dict) and "file" in terrain:  # wherever the files are copied to
            file = folder_of(name).absolute() / terrain["file"]
            table["terrain"] = terrain | {"file": str(file)}
    if run.vehicle is not None:
        autopilot, kind = run.vehicle.split("-")
        is_ideal = (world["vehicle"]["autopilot"], run.vehicle) == ("ideal", "ardupilot-copter")
        for table, name in ((world, "ideal" if is_ideal else autopilot), (mission, autopilot)):
            table["vehicle"] = table["vehicle"] | {"autopilot": name, "kind": kind}
    planner = {"profile": run.profile, "optimiser": run.optimiser, "evaluations": run.budget}
    given = {k: v for k, v in planner.items() if v is not None}
    mission["planner"] = mission.get("planner", {}) | given
    world = with_settings(world, run.world_settings)
    mission = with_settings(mission, run.mission_settings)
    name, timeline = "", run.timeline
    if run.script is not None:
        of = mission["vehicle"]
        autopilot = of.get("autopilot") or world["vehicle"]["autopilot"]
        vehicle = f"{autopilot}-{of['kind']}".replace("ideal", "ardupilot")
        subject = drawn_faults.Subject(vehicle=vehicle, speed_m_s=of["speed_m_s"])
        name, more = drawn_faults.drawn(run.script, subject)
        timeline = "\n".join(filter(None, (timeline, more)))
    asked = folder / "asked"  # mission.toml of a run folder is written by who flies
    asked.mkdir()
    (folder / "mission.toml").unlink(missing_ok=True)
    (folder / "world.toml").write_text(toml_text(world), encoding="utf-8")
    (asked / "mission.toml").write_text(toml_text(mission), encoding="utf-8")
    return FlightFiles(
        world=folder / "world.toml",
        mission=asked / "mission.toml",
        faults=timeline,
        folder=folder,
        drawn=name,
    )


def _judged(flown: Flight, files: FlightFiles, *, with_faults: bool) -> dict[str, Any]:
    """What a flight came to, from its journal and the truth."""
    found, crash = _judged_way(flown, files, with_faults=with_faults), crash_of(flown)
    if with_faults or crash is None or found.get("violated") == _TOUCHED:
        return found
    hit = f"flown: hit {crash['into']} at {crash['speed_m_s']:.1f} m/s"
    violated = "; ".join(filter(None, [found.get("violated"), hit]))
    return found | {"violations": (found.get("violations") or 0) + 1, "violated": violated}


def _judged_way(flown: Flight, files: FlightFiles, *, with_faults: bool) -> dict[str, Any]:
    """All of it but a crash; of flights with faults that too."""
    drawn = _as_drawn(str(files.world), str(files.mission))
    kinds = [entry["kind"] for entry in flown.journal]
    ends = [entry for entry in flown.journal if entry["kind"] == "end"]
    outcome = ends[-1]["outcome"] if ends else "not ended"
    reason = ends[-1]["reason"] if ends else "the companion has not said how it ended"
    plans_ms = 1e3 * np.array(flown.plans_s)
    times_s, track = in_the_air(flown)
    found = _of_task(flown.mission.task) | {
        "outcome": outcome,
        "reason": None if outcome == "arrived" else reason,
        "arrived": outcome == "arrived",
        "plans": kinds.count("plan ready") + kinds.count("plan refused"),
        "subpaths": kinds.count("leg"),
        "holds": sum(
            entry.get("phase") == "holding" and entry["code"] not in ("TAKING_OVER", "TAKEN_OFF")
            for entry in flown.journal
        ),
        "straight_m": _straight_m(drawn.start_nea_m, drawn.targets_ne_m),
        "plan_ms_median": float(np.median(plans_ms)) if len(plans_ms) else None,
        "plan_ms_p99": float(np.quantile(plans_ms, 0.99)) if len(plans_ms) else None,
    }
    if len(track) >= 2:
        found |= _of_track(track, drawn) | {"flight_s": float(times_s[-1] - times_s[0])}
    if with_faults:
        return found | _with_faults(flown, drawn, files.faults)
    if len(track) < 2:
        return found
    if flown.mission.near is not None:
        return found | _near(flown, times_s)
    subpaths = [np.array(e["control_nea_m"]) for e in flown.journal if e["kind"] == "plan ready"]
    clearance_m = _clearance_m(track, drawn)
    least = int(np.argmin(clearance_m))
    checked = _checked(subpaths, drawn)
    if clearance_m[least] < drawn.task.settings.safety_distance_m:
        checked["violations"] += 1
        checked["violated"] = "; ".join([*filter(None, [checked["violated"]]), "flown: terrain"])
    return (
        found
        | checked
        | {
            "clearance_least_m": float(clearance_m[least]),
            "clearance_least_t_s": float(times_s[least]),
        }
    )


def _with_faults(flown: Flight, drawn: DrawnWorld, timeline: str) -> dict[str, Any]:
    """By the judge of faults; of subpaths planned in a wrong place only the shape is looked at."""
    verdict = judge.judged(flown, drawn, timeline)
    bounds = _OF_SHAPE if verdict.pop("is_distorted") else None
    subpaths = [np.array(e["control_nea_m"]) for e in flown.journal if e["kind"] == "plan ready"]
    if flown.mission.near is None:
        checked = _checked(subpaths, drawn, bounds=bounds)
    else:  # whether it touched anything, the judge of faults knows
        checked = {"violations": 0, "violated": None}
        times_s, track = in_the_air(flown)
        if len(track) >= 2:
            checked = _near(flown, times_s) | checked
    known = [*verdict.pop("violated"), *filter(None, [checked["violated"]])]
    checked["violations"] += len(known) - bool(checked["violated"])
    if verdict["ending"] == "arrived":
        verdict["reason"] = None
    return checked | verdict | {"violated": "; ".join(known) or None}


def _near(flown: Flight, times_s: FloatArray) -> dict[str, Any]:
    """Among trees and walls: what counts is how near the vehicle came to any."""
    rows = [row for row in flown.truth if times_s[0] <= row["t_s"] <= times_s[-1]]
    near = min(rows, key=lambda row: row.get("near_m", math.inf))
    touched = near.get("near_m", math.inf) <= 0.0
    return {
        "clearance_least_m": near.get("near_m"),
        "clearance_least_t_s": near["t_s"],
        "violations": int(touched),
        "violated": _TOUCHED if touched else None,
    }


# --- the judge


def _of_task(task: Task) -> dict[str, Any]:
    settings = task.settings
    return {
        "profile": settings.profile.name,
        "optimiser": settings.optimiser or settings.profile.optimiser,
        "budget": settings.evaluations,
    }


def _straight_m(start: Sequence[float], targets: Iterable[Sequence[float]]) -> float:
    return sum(math.dist(a, b) for a, b in pairwise([start[:2], *targets]))


def _of_track(track_nea_m: FloatArray, drawn: DrawnWorld) -> dict[str, Any]:
    """Length, cost and radars along what was flown."""
    length_m = float(np.linalg.norm(np.diff(track_nea_m, axis=0), axis=-1).sum())
    terms = route_terms(track_nea_m, drawn.task)
    return {
        "length_m": length_m,
        "cost": sum(terms.values()),
        "radar_m": truth.radar_m(track_nea_m, drawn.task.radars, length_m),
        **{f"cost_{name}": value for name, value in terms.items()},
    }


def _clearance_m(points_nea_m: FloatArray, drawn: DrawnWorld) -> FloatArray:
    return truth.terrain_distance_m(
        points_nea_m, drawn.terrain, 2.0 * drawn.task.required_clearance_m
    )


def _checked(
    subpaths: Sequence[FloatArray],
    drawn: DrawnWorld,
    *,
    joined: bool = False,
    bounds: Container[str] | None = None,
) -> dict[str, Any]:
    """Every metre of every subpath, its tail included, against the true world.

    joined: each begins on the one before, or at its end, from rest.  bounds: only these.
    """
    task = drawn.task
    violated, least_m = list[str](), math.inf
    bad = 0
    for number, control_nea_m in enumerate(subpaths, 1):
        long_m = float(np.linalg.norm(np.diff(control_nea_m, axis=0), axis=-1).sum())
        curve = truth.sampled(control_nea_m, max(_SPACING_M, long_m / _MOST_POINTS))
        measures = truth.measure(
            curve,
            terrain=drawn.terrain,
            limits=task.limits,
            radars=task.radars,
            zones=task.zones,
            required_clearance_m=task.required_clearance_m,
        )
        broken = measures.violations(task.limits, task.required_clearance_m, task.error_m)
        if joined and number > 1 and not truth.goes_over(subpaths[number - 2], control_nea_m, task):
            broken = (*broken, "join")
        broken = tuple(name for name in broken if bounds is None or name in bounds)
        bad += bool(broken)
        violated += [f"leg {number}: {name}" for name in broken]
        least_m = min(least_m, measures.clearance_m)
    return {
        "subpaths_checked": len(subpaths),
        "violations": bad,
        "violated": "; ".join(violated) or None,
        "clearance_least_m": least_m if subpaths else None,
    }


# --- before the first one


def check_runs(runs: Sequence[Run], where: str) -> None:
    """InputError about the first run whose files, settings or faults cannot be flown by.

    One run of each kind is looked at; of a family, one world.
    """
    kinds = dict[Any, Run]()
    for run in runs:
        place = run.place.family or (run.place.world, run.place.mission)
        settings = (run.world_settings, run.mission_settings, run.vehicle, run.timeline)
        kinds.setdefault((place, settings), run)
    for run in kinds.values():
        try:
            with tempfile.TemporaryDirectory() as folder:
                if run.over != "planner":
                    in_process.check(_files(run, Path(folder)))
                elif run.place.family is None:
                    drawn_of(run.place)
        except Exception as error:  # noqa: BLE001 - of either program, in its words
            text = " ".join(str(error).split())
            rule = f"it cannot be flown: {text.rstrip('.')}"
            raise InputError(where, run.key, rule, "Mend the campaign file.") from None
