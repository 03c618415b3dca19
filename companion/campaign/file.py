"""Campaign files: which missions are flown, how often, and what differs; a list of runs of them.

A campaign is data: places (worlds with their missions), factors that are combined, each with each,
and how many seeds of every combination.
"""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeVar, final

from pydantic import Field

from companion.campaign import bundled_campaigns, drawn_faults
from companion.campaign.drawn_faults import FaultScript
from companion.campaign.families import FAMILIES, SPREAD
from companion.config import bundled
from companion.errors import InputError
from companion.planner.rules import Broken
from companion.profiles import PROFILES
from companion.ranges import Positive
from companion.sources.files import answer, read_text, toml_table
from companion.sources.tables import Table, validated
from companion.sources.zones import Name

Over = Literal["process", "planner"]
Knowledge = Literal["scans", "full"]
"""Of the ground before the flight, for the planner alone: none, or all of it."""
Keep = Literal["all", "failures", "none"]
Vehicle = Literal["ardupilot-copter", "ardupilot-plane", "px4-copter", "px4-plane"]

_NONE: Final = "none"
_MOST_RUNS: Final = 1_000_000
_CHOSEN: Final = ("sensor", "faults", "wind", "noise")
"""Factors whose values are names of choices."""
_OF_FLIGHTS: Final = ("vehicle", *_CHOSEN)
_OF_PLANNERS: Final = ("planner", "knowledge")
_LEAVE_OUT: Final = "Leave it out."
_Count = Annotated[int, Field(ge=1, le=1_000_000)]
_Seed = Annotated[int, Field(ge=0, le=2**31)]
_Value = TypeVar("_Value")
_Some = Annotated[list[_Value], Field(min_length=1)]
_Budget = Annotated[int, Field(ge=60, le=200_000)]


class Place(NamedTuple):
    """One world and its mission: the columns of a row that say what is flown."""

    world: str
    """A bundled name, a path, or the name of a drawn one."""
    mission: str | None = None
    family: str | None = None
    family_seed: int | None = None
    family_index: int | None = None

    @property
    def name(self) -> str:
        """Of its world: a file's is that of its folder."""
        path = Path(self.world)
        return path.parent.name or path.stem

    @property
    def label(self) -> str:
        """In the keys of runs."""
        drawn = f"{self.family}-{self.family_seed}/{self.family_index}"
        return self.name if self.family is None else drawn


class PlaceTable(Table):
    """A world and the mission in it, or some worlds of a random family."""

    world: str | None = None
    mission: str | None = None
    """Left out: the bundled one of that name, or mission.toml beside the world."""
    family: Literal[(*FAMILIES, SPREAD)] | None = None  # type: ignore[valid-type]
    seed: _Seed = 0
    """Of the family: which worlds are drawn."""
    count: _Count = 1
    """The first so many of them."""
    indices: _Some[Annotated[int, Field(ge=0, le=10_000_000)]] | None = None
    """These, in place of the first."""
    vehicle: Vehicle | None = None
    """The only one that flies there, where there is no factor `vehicle`."""

    def broken(self) -> Iterator[Broken]:
        """A world or a family, and only keys that have an effect then."""
        if (self.world is None) == (self.family is None):
            rule = "a place has either a world or a family"
            yield "world", self.world, rule, "Leave out the other."
        idle = {"mission"} if self.family is not None else {"seed", "count", "indices"}
        idle |= {"count"} if self.indices is not None else set()
        for key in sorted(idle & self.model_fields_set):
            yield key, getattr(self, key), "it has no effect beside the others", _LEAVE_OUT

    def places(self, folder: Path) -> list[Place]:
        """One for each world; folder: what paths are relative to."""
        if self.family is not None:
            drawn = f"{self.family}-{self.seed}"
            indices = self.indices or range(self.count)
            return [Place(f"{drawn}-{k}", None, self.family, self.seed, k) for k in indices]
        world = mission = str(self.world)
        if world not in bundled():
            path = folder / world
            world, mission = str(path), str(path.with_name("mission.toml"))
        if self.mission is not None:
            mission = self.mission if self.mission in bundled() else str(folder / self.mission)
        return [Place(world, mission)]


class FactorsTable(Table):
    """What is combined, each with each; what is left out is as the mission has it."""

    vehicle: _Some[Vehicle] | None = None
    profile: _Some[Literal[tuple(PROFILES)]] | None = None  # type: ignore[valid-type]
    optimiser: _Some[Name] | None = None
    budget: _Some[_Budget] | None = None
    planner: _Some[Name] | None = None
    knowledge: _Some[Knowledge] | None = None
    sensor: _Some[Name] | None = None
    faults: _Some[Name] | None = None
    wind: _Some[Name] | None = None
    noise: _Some[Name] | None = None


class FaultsTable(Table):
    """Fault scripts of a random family; each is one more value of the factor `faults`."""

    family: Literal[drawn_faults.FAMILIES]  # type: ignore[valid-type]
    seed: _Seed = 0
    count: _Count = 1


class ChoiceTable(Table):
    """What a name among sensors, faults, winds or noises stands for."""

    name: Name
    faults: str = ""
    """Lines of the simulator's timeline."""
    world: list[str] = Field(default=[])
    """Other values of keys of the world file: "scanner.range_m=8000"."""
    mission: list[str] = Field(default=[])


class CampaignTable(Table):
    """A campaign file."""

    schema_: Annotated[Literal[1], Field(alias="schema")]
    name: Name
    over: Over = "process"
    keep: Keep = "failures"
    seeds: _Count = 1
    first_seed: _Seed = 1
    limit_s: Positive = 7200.0
    """Of vehicle time: a flight that is longer is stopped."""
    places: _Some[PlaceTable]
    factors: FactorsTable = FactorsTable()
    faults: list[FaultsTable] = Field(default=[])
    choices: list[ChoiceTable] = Field(default=[])

    def broken(self) -> Iterator[Broken]:
        """Every choice is known, and everything that is said has an effect."""
        names = [choice.name for choice in self.choices]
        asked = {key: getattr(self.factors, key) or () for key in _CHOSEN}
        for key, name in ((factor, name) for factor in _CHOSEN for name in asked[factor]):
            if name not in (_NONE, *names):
                remedy = f"Add it. There are: {', '.join([_NONE, *names])}."
                yield f"factors.{key}", name, "there is none of this name among choices", remedy
        for k, name in enumerate(names):
            if name in (_NONE, *names[:k]):
                yield f"choices[{k}].name", name, "it stands for another already", "Rename it."
            if name not in itertools.chain(*asked.values()):
                rule = f"no factor ({', '.join(_CHOSEN)}) asks for it"
                yield f"choices[{k}].name", name, rule, _LEAVE_OUT
        yield from self._idle()

    def _idle(self) -> Iterator[Broken]:
        """What is of flights beside a planner alone, or of that beside flights."""
        alone = self.over == "planner"
        rule = "the planner alone has no vehicle" if alone else "it is of the planner alone"
        for key in self.model_fields_set & {"limit_s", "faults"} if alone else ():
            yield key, getattr(self, key), rule, _LEAVE_OUT
        for key in _OF_FLIGHTS if alone else _OF_PLANNERS:
            if (values := getattr(self.factors, key)) is not None:
                yield f"factors.{key}", values, rule, _LEAVE_OUT
        rule = rule if alone else "the factor vehicle says which fly, at all places"
        for k, place in enumerate(self.places if alone or self.factors.vehicle else ()):
            if place.vehicle is not None:
                yield f"places[{k}].vehicle", place.vehicle, rule, _LEAVE_OUT


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One run, all that it depends on."""

    number: int
    key: str
    seed: int
    place: Place
    over: Over
    keep: Keep
    limit_s: float
    factors: dict[str, Any]
    """One value of each factor that is given; what is left out is as the mission has it."""
    script: FaultScript | None = None
    """Drawn when vehicle and mission are known."""
    choices: tuple[ChoiceTable, ...] = ()


def load_campaign(
    name_or_path: str, options: Mapping[str, Any] | None = None
) -> tuple[CampaignTable, str, Path]:
    """A bundled campaign or a file -> campaign, text, the folder that its paths are of.

    options: what stands in place of the file's keys.
    """
    path, names = Path(name_or_path), ", ".join(bundled_campaigns())
    if name_or_path in bundled_campaigns():
        path = Path(str(resources.files("companion"))) / "campaign/bundled" / f"{name_or_path}.toml"
    elif not answer(path.exists):
        rule = "no such file, and no bundled campaign"
        raise InputError("CAMPAIGN", name_or_path, rule, f"Give a file, or one of: {names}.")
    text = read_text(path, "CAMPAIGN", f"Give a campaign file, or one of: {names}.")
    table = {**toml_table(text, name_or_path), **(options or {})}
    return validated(CampaignTable, table, name_or_path), text, path.absolute().parent


def runs_of(campaign: CampaignTable, folder: Path) -> list[Run]:
    """Every run, in the order in which they are flown; folder: what its paths are relative to.

    All seeds of a combination follow each other last, so that the first runs already show each
    combination once.
    """
    places = [(place, each.vehicle) for each in campaign.places for place in each.places(folder)]
    factors: dict[str, list[Any]] = {name: values or [None] for name, values in campaign.factors}
    scripts = [
        FaultScript(family=table.family, seed=table.seed, index=index)
        for table in campaign.faults
        for index in range(table.count)
    ]
    if scripts:
        factors["faults"] = [*(campaign.factors.faults or ()), *scripts]
    if campaign.seeds * len(places) * math.prod(map(len, factors.values())) > _MOST_RUNS:
        rule = f"that makes more than {_MOST_RUNS:,} runs"
        raise InputError("seeds", campaign.seeds, rule, "Ask for fewer.")
    seeds, runs = range(campaign.first_seed, campaign.first_seed + campaign.seeds), list[Run]()
    for seed, (place, vehicle), *values in itertools.product(seeds, places, *factors.values()):
        given = {k: v for k, v in zip(factors, values, strict=True) if v is not None}
        script = given.get("faults")
        given |= {"faults": str(script)} if isinstance(script, FaultScript) else {}
        given |= {"vehicle": vehicle} if vehicle is not None else {}
        run = Run(
            number=len(runs),
            key="/".join([place.label, *map(str, given.values()), f"seed-{seed}"]),
            seed=seed,
            place=place,
            over=campaign.over,
            keep=campaign.keep,
            limit_s=campaign.limit_s,
            factors=given,
            script=script if isinstance(script, FaultScript) else None,
            choices=tuple(c for k in _CHOSEN for c in campaign.choices if c.name == given.get(k)),
        )
        runs.append(run)
    return runs
