"""The actions of `companion replay`, apart from the command line."""

import json
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import asdict

from companion.config import MissionFile, load_mission, read_mission
from companion.errors import FlightFailed, InputError
from companion.mavlink.link import Output
from companion.mission.mission import Mission
from companion.replay.compare import Replay, replay_of_folder, replay_of_log
from companion.replay.feed import flown_mission
from companion.replay.shadow import watch
from companion.replay.shadow_report import renderables
from companion.replay.what_if import what_if, what_if_table, with_changes
from companion.runtime.compiler import load_kernel
from companion.runtime.loop import prompt_threads
from companion.sources.files import file_of_run, writing
from companion.views.output import plain_console, table_console

_SHOWN_EVERY = 200  # inputs: to show one costs more than most of them


def same_run(folder: Path, json_file: Path | None, *, plans: bool) -> None:
    """Replay a run folder and compare.  FlightFailed if any decision differs.

    plans: compute each again.
    """
    mission_of = flown_mission(folder)
    if plans:
        _load_planner()
    _compare(replay_of_folder(folder, mission_of, plans=plans), folder, json_file)


def same_log(
    path: Path,
    mission: str | None,
    profile: str | None,
    seed: int,
    system: int | None,
    json_file: Path | None,
) -> None:
    """The same of a telemetry log, which does not say how the flight was flown."""
    if mission is None:
        rule = "a log alone does not say what the mission was"
        remedy = "Give the run folder, or --mission, or --shadow for another's flight."
        raise InputError("RUN_DIR|LOG", str(path), rule, remedy)
    _load_planner()
    flown, replays = load_mission(mission, profile), version("companion")
    replay = replay_of_log(path, flown, seed=seed, version=replays, system_id=system)
    _compare(replay, path, json_file)


def _compare(replay: Replay, flight: Path, json_file: Path | None) -> None:
    console, replayed = plain_console(soft_wrap=True, highlight=False), replay.replayed
    with plain_console(stderr=True).status("replaying") as status, prompt_threads():
        for _ in replay.steps():
            if replayed.inputs % _SHOWN_EVERY == 0:
                status.update(f"replaying {replayed.now_s:,.0f} s")
    differs = replayed.difference is not None
    if replayed.frames + replayed.entries or differs:
        console.print(str(replayed))
        _write({"identical": replayed.is_identical, **asdict(replayed)}, json_file)
    elif not replayed.damaged:  # nothing is not the same as something
        rule = "it holds nothing to compare a replay with"
        remedy = "Give the recording of a flight, whole."
        raise InputError("RUN_DIR|LOG", str(flight), rule, remedy)
    if replayed.damaged and not differs:
        rule = f"what was recorded is damaged ({replayed.damaged})"
        raise InputError("RUN_DIR", str(flight), rule, "Give a copy of it that is whole.")
    if not replayed.is_identical:
        flew, replays = replayed.flown_by, version("companion")
        remedy = f"Companion {flew} flew, and this is {replays}: another one may decide otherwise."
        raise FlightFailed("the replay did not decide as the flight did", remedy if flew else "")


def changed(
    folder: Path, settings: list[str], seed: int | None, profile: str | None, json_file: Path | None
) -> None:
    """What if: each subpath under other settings."""
    console = table_console()
    if not folder.is_dir():
        rule = "a log does not hold the states to plan from"
        raise InputError("RUN_DIR|LOG", str(folder), rule, "Give the run folder of the flight.")
    plans, flown = [], flown_mission(folder)
    file = read_mission(str(folder / "mission.toml"))
    other = file.mission(profile, settings)
    _refuse_idle(file, profile, settings, other)
    _load_planner()
    with plain_console(stderr=True).status("planning again") as status:
        for replanned in what_if(folder, flown, other, seed=seed):
            plans.append(replanned)
            status.update(f"planned again: {len(plans)}")
    console.print(what_if_table(plans))
    _write(plans, json_file)


def _refuse_idle(
    file: MissionFile, profile: str | None, settings: list[str], other: Mission
) -> None:
    """InputError about a setting without which each subpath would be planned alike."""
    for index, setting in enumerate(settings):
        try:
            without = file.mission(profile, settings[:index] + settings[index + 1 :]).task
        except InputError:  # the others need it
            continue
        if with_changes(without, without, other.task) == without:
            rule = "it changes nothing by which recorded subpaths are planned again"
            remedy = "Set limits of the vehicle, planner keys, weights or threats to other values."
            raise InputError("--set", setting, rule, remedy)


def shadow(flight: Path, mission: str | None, system: int | None, json_file: Path | None) -> None:
    """Run in shadow mode on a log, or on that of a run folder."""
    console, given = plain_console(soft_wrap=True), count()
    if flight.is_dir():
        flight = file_of_run(flight, "flight.tlog", "RUN_DIR|LOG")
    chosen = None if mission is None else load_mission(mission)
    if chosen is not None:
        _load_planner()
    with plain_console(stderr=True).status("watching") as status:

        def show(at_s: float, _: Output) -> None:
            if next(given) % _SHOWN_EVERY == 0:
                status.update(f"watching {at_s:,.0f} s")

        report = watch(flight, chosen, system_id=system, on_output=show)
    for part in renderables(report):
        console.print(part)
    _write(report, json_file)


def _load_planner() -> None:
    """Load what computes plans, and say so."""
    words = "loading the planner (the first time it is compiled: some ten seconds)"
    with plain_console(stderr=True).status(words):
        load_kernel()


def _write(values: Any, json_file: Path | None) -> None:
    if json_file is not None:
        plain = msgspec.to_builtins(values, enc_hook=str, builtin_types=(bytes,))
        with writing("--json", json_file):
            json_file.write_text(json.dumps(plain, indent=2, default=str) + "\n", encoding="utf-8")
