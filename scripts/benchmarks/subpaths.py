"""Subpath problems for the search: what the planner had to solve in complete missions.

Missions are flown once (`record`), and of each some plans are kept in best_known.json, as what
they were asked: where was scanned, where the subpath begins, the target. The scenes are made from
that again, by the planner's own code, so a fingerprint of each objective stands beside its best
known value: a value found for another objective is not used. Both objectives, `flight` and the
paper's, are of the same questions.
"""

import hashlib
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from companion.campaign import drawn_world, families
from companion.campaign.drawn_world import DrawnWorld
from companion.geodesy import FloatArray, wrap_rad
from companion.jit import compiled
from companion.objective import Scene
from companion.paper import terms
from companion.paper.plan import scene_of
from companion.path.subpath import Pose
from companion.planner import kernels, searches
from companion.planner.field import cost_to_go
from companion.planner.offline import fly_offline
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome, PlanRequest
from companion.planner.seeds import seeds_of, ways_of
from companion.profiles import PAPER
from companion.world.known_map import empty_map
from companion.world.simulated_scan import simulated_scan, true_map

FILE = Path(__file__).with_name("best_known.json")
WORLDS = (
    "environment-1",
    "environment-2",
    *(f"dense-{k}" for k in range(1, 21)),
    *(f"sparse-{k}" for k in range(1, 7)),
)
_EACH = 5  # plans of a mission
_SEED = 7
_PROBES = 16


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """One search that the planner makes."""

    name: str
    scene: Scene | terms.Scene
    """Of objective `flight`, or of the paper's."""
    seeds: FloatArray  # (K, D): its warm starts
    for_tuning: bool
    """Whether the settings of the search were chosen by it: every other mission."""

    @property
    def dimensions(self) -> int:
        """D."""
        return self.seeds.shape[1]

    def costs(self, x: FloatArray) -> FloatArray:
        """Costs of candidates, (P, D) -> (P,)."""
        if isinstance(self.scene, Scene):
            return compiled(kernels.costs)(np.ascontiguousarray(x), self.scene)
        return terms.cost(x, self.scene)

    def fingerprint(self) -> str:
        """A hash of the objective: of its values at random points, to six digits."""
        x = np.random.default_rng(0).random((_PROBES, self.dimensions))
        values = " ".join(f"{value:.6g}" for value in self.costs(x))
        return hashlib.sha256(values.encode()).hexdigest()[:16]


def world_of(name: str) -> DrawnWorld:
    """A bundled environment, or a world of a family: `dense-7`."""
    family, _, index = name.rpartition("-")
    if family in families.FAMILIES:
        return families.world(family, 0, int(index))
    return drawn_world.bundled(name)


def load() -> dict[str, Any]:
    """The file: `missions`, as recorded, and `best`, by problem."""
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


def store(data: dict[str, Any]) -> None:
    """Write the file: a line for the scans and the plans of each mission, and each best value."""
    text = ",\n".join(
        f'"{name}": {{\n '
        + ",\n ".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in part.items())
        + "\n}"
        for name, part in data.items()
    )
    FILE.write_text("{" + text + "}\n", encoding="utf-8")


def record() -> dict[str, Any]:
    """Fly every mission and keep what some of its plans were asked; no best values yet."""
    scans, plans = {}, dict[str, list[dict[str, Any]]]()
    for name in WORLDS:
        world = world_of(name)
        asked: list[PlanRequest] = []

        def ask(request: PlanRequest, asked: list[PlanRequest] = asked) -> PlanOutcome:
            asked.append(request)
            return plan(request)

        limits = world.task.limits
        blank = empty_map(world.task.cell_m, limits.north_m, limits.east_m)
        fly_offline(
            world.task,
            blank=blank,
            truth=true_map(world.terrain, blank),
            start_nea_m=world.start_nea_m,
            targets_ne_m=world.targets_ne_m,
            seed=_SEED,
            planner=ask,
        )
        scans[name] = [list(request.scan_nea_m) for request in asked]
        chosen = np.unique(np.linspace(0, len(asked) - 1, _EACH).round().astype(int)).tolist()
        plans[name] = [
            _asked(k, asked[k], points)
            for k in chosen
            for points in (5, 6)[: 1 + (k == chosen[1])]  # the planner's second try has six points
        ]
    return {"scans": scans, "plans": plans, "best": {}}


def _asked(number: int, request: PlanRequest, points: int) -> dict[str, Any]:
    start = request.start
    parts = start.position_nea_m, start.tangent_nea, start.curvature_nea_1_m
    return {
        "scan": number,
        "points": points,
        "start": [part.tolist() for part in parts],
        "from_rest": request.from_rest,
        "target_ne_m": list(request.target_ne_m),
        "route_ne_m": [list(place) for place in request.route_ne_m],
    }


def problems(data: dict[str, Any], objective: str) -> list[Problem]:
    """The problems of the file, as the planner poses them today; objective: flight or paper."""
    result = []
    for number, (name, scans) in enumerate(data["scans"].items()):
        world = world_of(name)
        limits = world.task.limits
        known = empty_map(world.task.cell_m, limits.north_m, limits.east_m)
        truth = true_map(world.terrain, known)
        for scan, at in enumerate(scans):
            scan_nea_m = (float(at[0]), float(at[1]), float(at[2]))
            seen = simulated_scan(truth, scan_nea_m, world.task.settings.scan_range_m)
            known = known.with_scan(seen)
            for each in (each for each in data["plans"][name] if each["scan"] == scan):
                position, tangent, curvature = map(np.array, each["start"])
                request = PlanRequest(
                    plan_id=scan + 1,
                    seed=_SEED,
                    task=world.task,
                    known=known,
                    scan_nea_m=scan_nea_m,
                    start=Pose(
                        position_nea_m=position, tangent_nea=tangent, curvature_nea_1_m=curvature
                    ),
                    from_rest=each["from_rest"],
                    target_ne_m=(each["target_ne_m"][0], each["target_ne_m"][1]),
                    route_ne_m=tuple((place[0], place[1]) for place in each["route_ne_m"]),
                )
                if objective == "paper":
                    result += _as_published(request, name, for_tuning=number % 2 == 1)
                    continue
                field = cost_to_go(
                    known, world.task, scan_nea_m[:2], request.target_ne_m, request.route_ne_m
                )
                scene = searches.scene_of(request, field).with_points(each["points"])
                result.append(
                    Problem(
                        name=f"{name}/{scan + 1}" + "+" * (each["points"] - 5),
                        scene=scene,
                        seeds=seeds_of(scene, ways_of(scene, field.route_ne_m, known.cell_m, None)),
                        for_tuning=number % 2 == 1,
                    )
                )
    return result


def _as_published(request: PlanRequest, world: str, *, for_tuning: bool) -> list[Problem]:
    """The same question with the paper's four points, ten samples and tangent guide."""
    settings = replace(request.task.settings, profile=PAPER)
    scene = scene_of(replace(request, task=replace(request.task, settings=settings)))
    north, east, _ = scene.start.tangent_nea
    guide = 0.5 + wrap_rad(scene.guide_rad - math.atan2(east, north)) / math.pi
    seeds = [
        (0.5, 0.5, 0.5 * (0.5 + end), z, end, z)  # ahead, towards the guide, to both sides of it
        for end in np.clip([0.5, guide, guide - 0.2, guide + 0.2], 0.0, 1.0)
        for z in (0.0, 0.3, 0.7)
    ]
    name = f"{world}/{request.plan_id}, paper"
    return [Problem(name=name, scene=scene, seeds=np.array(seeds), for_tuning=for_tuning)]


def best_known(data: dict[str, Any], problem: Problem) -> float:
    """The lowest cost that was ever found for this objective; infinite if none is on file."""
    kept = data["best"].get(problem.name)
    if kept is None or kept["objective"] != problem.fingerprint():
        return math.inf
    return float(kept["cost"])


def keep_best(data: dict[str, Any], problem: Problem, cost: float, x: FloatArray) -> None:
    """Put a cost on file if none is as low."""
    if cost < best_known(data, problem):
        data["best"][problem.name] = {
            "cost": cost,
            "objective": problem.fingerprint(),
            "x": np.round(x, 9).tolist(),
        }
