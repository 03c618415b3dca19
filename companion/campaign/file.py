"""Campaign files: which missions are flown, how often, and what differs; a list of runs of them.

A campaign is data: places (worlds with their missions), factors that are combined, each with each,
and how many seeds of every combination.
"""

import difflib
import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, final

from pydantic import Field

from companion.campaign import bundled_campaigns, drawn_faults
from companion.campaign.alone import Knowledge
from companion.campaign.drawn_faults import FaultScript
from companion.campaign.families import FAMILIES, SPREAD
from companion.config import bundled
from companion.errors import InputError
from companion.optimise.registry import OPTIMISERS
from companion.paper.rivals.routes import PLANNERS
from companion.planning import OURS
from companion.profiles import PROFILES
from companion.ranges import Positive
from companion.sources.files import answer, read_text, toml_table
from companion.sources.mission_schema import Name
from companion.sources.recognised import refuse_other
from companion.sources.schema import Table, validated

Over = Literal["process", "planner"]
Keep = Literal["all", "failures", "none"]
Vehicle = Literal["ardupilot-copter", "ardupilot-plane", "px4-copter", "px4-plane"]

_NONE = "none"
_MOST_RUNS = 1_000_000
_OF_VEHICLES = ("vehicle", "sensor", "faults", "wind", "noise")
_CHOSEN = ("sensor", "faults", "wind", "noise")
_Index = Annotated[int, Field(ge=0, le=10_000_000)]
_Seed = Annotated[int, Field(ge=0, le=2**31)]
_Choices = Annotated[list[Name], Field(min_length=1)]


class PlaceTable(Table):
    """A world and the mission in it, or some worlds of a random family."""

    world: str | None = None
    mission: str | None = None
    """Left out: the bundled one of that name, or mission.toml beside the world."""
    family: Literal[(*FAMILIES, SPREAD)] | None = None  # type: ignore[valid-type]
    seed: _Seed = 0
    """Of the family: which worlds are drawn."""
    first: _Index = 0
    count: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    indices: Annotated[list[_Index], Field(min_length=1)] | None = None
    """In place of `first` and `count`."""
    vehicle: Vehicle | None = None
    """The only one that flies there, where there is no factor `vehicle`."""


class FactorsTable(Table):
    """What is combined, each with each; what is left out is as the mission has it."""

    vehicle: Annotated[list[Vehicle], Field(min_length=1)] | None = None
    profile: Annotated[list[Literal[tuple(PROFILES)]], Field(min_length=1)] | None = None  # type: ignore[valid-type]
    optimiser: _Choices | None = None
    budget: (
        Annotated[list[Annotated[int, Field(ge=60, le=200_000)]], Field(min_length=1)] | None
    ) = None
    planner: _Choices | None = None
    knowledge: Annotated[list[Knowledge], Field(min_length=1)] | None = None
    sensor: _Choices | None = None
    faults: _Choices | None = None
    wind: _Choices | None = None
    noise: _Choices | None = None


class FaultsTable(Table):
    """Fault scripts of a random family; each is one more value of the factor `faults`."""

    family: Literal[drawn_faults.FAMILIES]  # type: ignore[valid-type]
    seed: _Seed = 0
    first: _Index = 0
    count: Annotated[int, Field(ge=1, le=1_000_000)] = 1


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
    seeds: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    first_seed: _Seed = 1
    limit_s: Positive = 7200.0
    """Of vehicle time: a flight that is longer is stopped."""
    places: Annotated[list[PlaceTable], Field(min_length=1)]
    factors: FactorsTable = FactorsTable()
    faults: list[FaultsTable] = Field(default=[])
    choices: list[ChoiceTable] = Field(default=[])


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """One world and its mission."""

    label: str
    world: str
    """A bundled name, a path, or the name of a drawn one."""
    mission: str | None = None
    family: str | None = None
    family_seed: int | None = None
    family_index: int | None = None
    vehicle: str | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One run, all that it depends on; None: as the mission has it."""

    number: int
    key: str
    seed: int
    place: Place
    over: Over
    keep: Keep
    limit_s: float
    vehicle: str | None = None
    profile: str | None = None
    optimiser: str | None = None
    budget: int | None = None
    planner: str = OURS
    knowledge: str = "scans"
    sensor: str | None = None
    faults: str | None = None
    wind: str | None = None
    noise: str | None = None
    timeline: str = ""
    script: FaultScript | None = None
    """Drawn when vehicle and mission are known, and added to the timeline."""
    world_settings: tuple[str, ...] = ()
    mission_settings: tuple[str, ...] = ()

    @property
    def with_faults(self) -> bool:
        """Whether something may go wrong in it."""
        return self.script is not None or bool(self.timeline)


def load_campaign(name_or_path: str) -> tuple[CampaignTable, str, Path]:
    """A bundled campaign or a file -> campaign, text, the folder that its paths are of."""
    path, names = Path(name_or_path), ", ".join(bundled_campaigns())
    if name_or_path in bundled_campaigns():
        path = Path(str(resources.files("companion"))) / "campaign/bundled" / f"{name_or_path}.toml"
    elif not answer(path.exists):
        rule = "no such file, and no bundled campaign"
        raise InputError("CAMPAIGN", name_or_path, rule, f"Give a file, or one of: {names}.")
    refuse_other(path, "CAMPAIGN")
    text = read_text(path, "CAMPAIGN", f"Give a campaign file, or one of: {names}.")
    table = toml_table(text, name_or_path)
    campaign = validated(CampaignTable, table, name_or_path)
    _check(campaign, name_or_path)
    return campaign, text, path.absolute().parent


def _check(campaign: CampaignTable, where: str) -> None:
    """What one table alone cannot know."""
    factors = campaign.factors
    for name in factors.optimiser or ():
        if name not in OPTIMISERS:
            remedy = f"One of: {', '.join(OPTIMISERS)}."
            raise InputError(f"{where}: factors.optimiser", name, "there is none", remedy)
    for name in factors.planner or ():
        if name != OURS and name not in PLANNERS:
            remedy = f"One of: {OURS}, {', '.join(PLANNERS)}."
            raise InputError(f"{where}: factors.planner", name, "there is none", remedy)
    known = [choice.name for choice in campaign.choices]
    for factor in _CHOSEN:
        for name in getattr(factors, factor) or ():
            if name not in (_NONE, *known):
                near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
                remedy = f"Did you mean {near[0]}?" if near else "Add it to [[choices]]."
                rule = "no choice has this name"
                raise InputError(f"{where}: factors.{factor}", name, rule, remedy)
    for k, place in enumerate(campaign.places):
        if (place.world is None) == (place.family is None):
            rule = "a place has either a world or a family"
            raise InputError(f"{where}: places[{k}]", place.world, rule, "Leave out the other.")
        _check_place(place, f"{where}: places[{k}]")
    _check_choices(campaign, where)


def _check_place(place: PlaceTable, field: str) -> None:
    """Every key of a place has an effect."""
    without = {"mission": "a family draws its own missions"}
    if place.family is None:
        rule = "it is of a family: which worlds are drawn"
        without = dict.fromkeys(("seed", "first", "count", "indices"), rule)
    elif place.indices is not None:
        without |= dict.fromkeys(("first", "count"), "indices says which worlds are drawn")
    _refuse_given(place, without, field)


def _refuse_given(place: PlaceTable, without: dict[str, str], field: str) -> None:
    for key, rule in without.items():
        if key in place.model_fields_set:
            raise InputError(f"{field}.{key}", getattr(place, key), rule, "Leave it out.")


def _check_choices(campaign: CampaignTable, where: str) -> None:
    """Every choice is one of some factor, and no other has its name."""
    asked = {name for factor in _CHOSEN for name in getattr(campaign.factors, factor) or ()}
    names = [choice.name for choice in campaign.choices]
    for k, name in enumerate(names):
        field = f"{where}: choices[{k}].name"
        if name in names[:k] or name == _NONE:
            rule = "another choice has this name" if name != _NONE else "it stands for no choice"
            raise InputError(field, name, rule, "Give it another name.")
        if name not in asked:
            rule = f"no factor ({', '.join(_CHOSEN)}) asks for it"
            raise InputError(field, name, rule, "Name it in [factors], or leave it out.")


def check_over(campaign: CampaignTable, over: Over, where: str) -> None:
    """InputError if its factors do not go with how it is flown."""
    if over == "planner" and "limit_s" in campaign.model_fields_set:
        rule = "the planner alone has no vehicle, nor its time"
        raise InputError(f"{where}: limit_s", campaign.limit_s, rule, "Leave it out.")
    for k, place in enumerate(campaign.places):
        without = {}
        if campaign.factors.vehicle:
            without["vehicle"] = "the factor vehicle says which vehicles fly, at all places"
        if over == "planner":
            without["vehicle"] = "the planner alone has no vehicle"
        _refuse_given(place, without, f"{where}: places[{k}]")
    if "elevation" in (campaign.factors.knowledge or ()) and campaign.factors.planner:
        rule, remedy = "only ours reads an elevation file", "Leave out factors.planner."
        raise InputError(f"{where}: factors.knowledge", "elevation", rule, remedy)
    for factor in _OF_VEHICLES:
        asked = getattr(campaign.factors, factor) or (factor == "faults" and campaign.faults)
        if over == "planner" and asked:
            rule = "the planner alone has no vehicle"
            remedy = 'Leave it out, or fly: over = "process".'
            raise InputError(f"{where}: factors.{factor}", over, rule, remedy)
    for factor in ("optimiser", "profile"):
        if getattr(campaign.factors, factor) and OURS not in (campaign.factors.planner or [OURS]):
            rule, remedy = "rivals have none", f"Leave it out, or add {OURS!r} to the planners."
            raise InputError(f"{where}: factors.{factor}", campaign.factors.planner, rule, remedy)
    for factor, ours in (("planner", [OURS]), ("knowledge", ["scans"])):
        if over != "planner" and (getattr(campaign.factors, factor) or ours) != ours:
            rule = "rivals and full knowledge are of the planner alone"
            raise InputError(f"{where}: factors.{factor}", over, rule, 'Write over = "planner".')


def runs_of(campaign: CampaignTable, folder: Path, over: Over, keep: Keep) -> list[Run]:
    """Every run, in the order in which they are flown; folder: what its paths are relative to.

    All seeds of a combination follow each other last, so that the first runs already show each
    combination once.
    """
    places = [place for table in campaign.places for place in _places(table, folder)]
    factors = {
        name: getattr(campaign.factors, name) or [None] for name in FactorsTable.model_fields
    }
    scripts = [
        FaultScript(family=table.family, seed=table.seed, index=index)
        for table in campaign.faults
        for index in range(table.first, table.first + table.count)
    ]
    if scripts:
        factors["faults"] = [*(campaign.factors.faults or ()), *scripts]
    combinations = list(itertools.product(places, *factors.values()))
    if campaign.seeds * len(combinations) > _MOST_RUNS:
        rule = f"that makes more than {_MOST_RUNS:,} runs"
        raise InputError("seeds", campaign.seeds, rule, "Ask for fewer.")
    choices = {choice.name: choice for choice in campaign.choices}
    found: list[Run] = []
    for seed in range(campaign.first_seed, campaign.first_seed + campaign.seeds):
        for place, *values in combinations:
            given: dict[str, Any] = {k: str(v) if isinstance(v, FaultScript) else v
                     for k, v in zip(factors, values, strict=True) if v is not None}  # fmt: skip
            chosen = [choices[v] for k, v in given.items() if k in _CHOSEN and v in choices]
            if place.vehicle is not None:
                given.setdefault("vehicle", place.vehicle)
            names = [place.label, *map(str, given.values()), f"seed-{seed}"]
            found.append(
                Run(
                    number=len(found),
                    key="/".join(names),
                    seed=seed,
                    place=place,
                    over=over,
                    keep=keep,
                    limit_s=campaign.limit_s,
                    timeline="\n".join(each.faults.strip() for each in chosen if each.faults),
                    world_settings=_joined(each.world for each in chosen),
                    script=next((v for v in values if isinstance(v, FaultScript)), None),
                    mission_settings=_joined(each.mission for each in chosen),
                    **given,
                )
            )
    return found


def _joined(lists: Iterable[list[str]]) -> tuple[str, ...]:
    return tuple(itertools.chain.from_iterable(lists))


def _places(table: PlaceTable, folder: Path) -> list[Place]:
    if table.family is not None:
        return [
            Place(
                label=f"{table.family}-{table.seed}/{index}",
                world=f"{table.family}-{table.seed}-{index}",
                family=table.family,
                family_seed=table.seed,
                family_index=index,
                vehicle=table.vehicle,
            )
            for index in table.indices or range(table.first, table.first + table.count)
        ]
    world, mission = str(table.world), table.mission
    if world not in bundled():
        path = folder / world
        world, mission = str(path), mission or str(path.with_name("mission.toml"))
    if mission is not None and mission not in bundled():
        mission = str(folder / mission)
    label = world if world in bundled() else Path(world).parent.name or Path(world).stem
    return [Place(label=label, world=world, mission=mission or world, vehicle=table.vehicle)]
