"""What the page shows of a flight that was recorded, without a browser."""

import math
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rich
import viser
from recorded import flown, mission_file, record

from companion.config import load_mission
from companion.errors import InputError
from companion.live_view.command import Asked
from companion.live_view.ground import (
    PROVEN,
    UNKNOWN,
    Ground,
    Replica,
    ground_of,
    last_ground,
)
from companion.live_view.page import Page
from companion.live_view.panel import charts_of, near_ground
from companion.live_view.recording import Recording
from companion.live_view.server import serve
from companion.session import Session
from companion.telemetry.inputs import HEADER, packed
from companion.world.known_map import packed_map

_PIECES = 5
_PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Session]:
    """A flight with its inputs, paused once, and the session that has flown it."""
    folder = tmp_path_factory.mktemp("recorded")
    file = mission_file(folder)
    it = flown(file)
    record(folder / "run", it, file.read_text(encoding="utf-8"))
    (folder / "run" / "inputs.msgpack").write_bytes(b"".join(packed([HEADER, *it.inputs])))
    return folder / "run", it.session


def test_a_flight_that_grows_is_read_like_one_that_is_over(
    run_dir: tuple[Path, Session], tmp_path: Path
) -> None:
    """In pieces that end anywhere, as another process sees files that are written."""
    folder, _ = run_dir
    with Recording(folder) as whole:
        whole.read()
    names = ("flight.tlog", "journal.jsonl", "inputs.msgpack")
    data = {name: (folder / name).read_bytes() for name in names}
    (tmp_path / "mission.toml").write_bytes((folder / "mission.toml").read_bytes())
    for name in names:
        (tmp_path / name).touch()
    replica = Replica(tmp_path)
    with Recording(tmp_path) as growing:
        for piece in range(_PIECES + 1):
            for name in names:
                (tmp_path / name).write_bytes(data[name][: len(data[name]) * piece // _PIECES])
            growing.read()
            while replica.advance(_PATIENCE_S):
                pass
    assert growing.events == whole.events
    assert np.array_equal(growing.flight.times_s, whole.flight.times_s)
    assert np.array_equal(growing.flight.places_nea_m, whole.flight.places_nea_m)
    at_once = Replica(folder)
    while at_once.advance(_PATIENCE_S):
        pass
    assert replica.ended is None
    assert np.array_equal(replica.samples, at_once.samples, equal_nan=True)
    for time_s in whole.flight.times_s[:: len(whole.flight.times_s) // 50]:
        (number, ground), (other, same) = (
            each.ground_at(whole.flight, float(time_s)) for each in (replica, at_once)
        )
        assert number == other
        assert (ground and ground.height_m.tobytes()) == (same and same.height_m.tobytes())


def test_the_ground_is_what_the_flight_knew(run_dir: tuple[Path, Session]) -> None:
    folder, session = run_dir
    replica = Replica(folder)
    while replica.advance(_PATIENCE_S):
        pass
    with Recording(folder) as recording:
        recording.read()
    known, flight = session.state.flight.known, recording.flight
    (_, first), (_, last) = (replica.ground_at(flight, at_s) for at_s in (0.0, math.inf))
    assert first is not None
    assert last is not None
    assert (first.kind == UNKNOWN).all()
    aside = replace(known, upper_m=np.roll(known.upper_m, 1, 0), seen=np.roll(known.seen, 1, 0))
    drawn_aside = ground_of(aside, (0.0, 0.0), session.mission)
    for each, drawn in ((known, last), (aside, drawn_aside)):
        rows, columns = drawn.kind.shape  # drawn by blocks of 2 x 2 cells, by the least sure
        proven = each.surveyed.reshape(rows, 2, columns, 2).all((1, 3))
        assert proven.any()
        assert np.array_equal(drawn.kind == PROVEN, proven)
        highest_m = each.upper_m.reshape(rows, 2, columns, 2).max((1, 3))
        assert drawn.height_m[proven] == pytest.approx(highest_m[proven])
    assert (drawn_aside.kind == PROVEN).sum() < (last.kind == PROVEN).sum()


def test_what_was_known_in_the_end_is_there_before_the_flight_is_replayed(
    run_dir: tuple[Path, Session], tmp_path: Path
) -> None:
    folder, session = run_dir
    assert last_ground(tmp_path, session.mission) is None
    shutil.copytree(folder, tmp_path / "run")
    (tmp_path / "run" / "known.npz").write_bytes(packed_map(session.state.flight.known))
    shown = list[Ground]()
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        with Recording(tmp_path / "run") as recording:
            recording.read()
            page = Page(server, recording)
            page._time_s = recording.ends_s
            said = page._show_ground(SimpleNamespace(show_ground=shown.append), 0.0)  # type: ignore[arg-type]
    finally:
        server.stop()
    assert said.endswith("shown as at the end")
    [ground] = shown
    whole = ground_of(session.state.flight.known, (0.0, 0.0), session.mission)
    assert np.array_equal(ground.kind == PROVEN, whole.kind == PROVEN)


def test_trees_hide_no_vehicle_that_flies_between_them() -> None:
    """A flat beam does not see how high they are: so high as paths may be is all that matters."""
    mission = load_mission("forest")
    known = Session(mission, seed=1, lockstep=True).state.flight.known
    upper_m, seen = known.upper_m.copy(), known.seen.copy()
    upper_m[:, :80], seen[:, :100] = 400.5, True
    upper_m[:, 80:100] = 430.0
    ground = ground_of(replace(known, upper_m=upper_m, seen=seen), (0.0, 0.0), mission)
    drawn_m = ground.height_m[ground.kind == PROVEN]
    assert set(np.unique(drawn_m)) == {400.5, mission.task.limits.ceiling_amsl_m}
    assert (ground.kind == UNKNOWN).sum() + len(drawn_m) == ground.kind.size


def test_charts_tell_the_known_ground_and_the_way_off_the_path(
    run_dir: tuple[Path, Session],
) -> None:
    folder, _ = run_dir
    replica = Replica(folder)
    while replica.advance(_PATIENCE_S):
        pass
    with Recording(folder) as recording:
        recording.read()
        height, aside = charts_of(recording, replica)
        phases = [recording.flight.decided_at(float(t)).phase for t in aside[0]]
        clear_m, under_m = near_ground(recording, replica, height[0])
    down = np.array([phase in ("landing", "done") for phase in phases])
    assert down.any()
    assert np.isnan(aside[1][down]).all()
    told = np.isfinite(clear_m)
    assert told.any()
    assert np.array_equal(height[2], under_m, equal_nan=True)
    assert (clear_m[told] <= (height[1] - height[2])[told] + 1e-6).all()  # straight down is one way
    assert np.nanmax(aside[1]) < recording.flight.mission.task.limits.tracking_error_m


# --- the page


@pytest.fixture(scope="module")
def shown(run_dir: tuple[Path, Session]) -> Iterator[tuple[viser.ViserServer, Page]]:
    rich.get_console().quiet = True
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    with Recording(run_dir[0]) as recording:
        recording.read()
        page = Page(server, recording)
        for second in range(40):  # of its clock: until all is read
            page.step(float(second), 1.0)
        yield server, page
    server.stop()


def test_all_of_a_flight_is_in_the_scene(shown: tuple[viser.ViserServer, Page]) -> None:
    server, _ = shown
    names = set(server.scene._handle_from_node_name)
    for name in ("/vehicle", "/track", "/unknown", "/guessed/ground", "/targets/1", "/plan/p_scan"):
        assert name in names
    assert {
        "/plan/p_prog",
        "/plan/leg",
        "/plan/control",
        "/plan/guide",
        "/scan/reach/ring",
    } <= names
    assert [name for name in names if re.fullmatch(r"/proven/\d+_\d+", name)]
    labels = {
        handle.text  # type: ignore[attr-defined]
        for name, handle in server.scene._handle_from_node_name.items()
        if name.endswith("/label")
    }
    assert {"target", 'keep-out tower <&> "mast"', "keep-out village", "keep-in county"} <= labels


def test_the_scene_follows_the_time(shown: tuple[viser.ViserServer, Page]) -> None:
    """Before the first plan there is none in it."""
    server, page = shown
    for now_s, there in ((90.0, False), (91.0, True)):
        page.jump("newest") if there else page.go_to(0.0)
        page.step(now_s, 0.1)
        names = set(server.scene._handle_from_node_name)
        assert ({"/plan/leg", "/plan/guide", "/scan/reach/ring"} <= names) is there
        assert ("/plan/control" in names) is there


def test_the_panel_follows_the_time(shown: tuple[viser.ViserServer, Page]) -> None:
    server, page = shown
    page.go_to(0.0)
    page.step(100.0, 0.1)
    began, place = page.status, server.scene.get_handle_by_name("/vehicle").position.copy()  # type: ignore[union-attr]
    page.jump("next hold")
    page.step(101.0, 0.1)
    assert page.status != began
    assert "paused by a person" in page.status
    assert not np.allclose(server.scene.get_handle_by_name("/vehicle").position, place)  # type: ignore[union-attr]


def test_the_time_that_somebody_moves_to_holds_though_the_page_moves_on(
    shown: tuple[viser.ViserServer, Page],
) -> None:
    _, page = shown
    page.jump("newest")
    page.step(102.0, 0.1)
    slider = page._slider
    newest_s, slider.value = slider.value, 7.0  # as viser has it, once a browser has said so
    page._when_moved(SimpleNamespace(client=object(), target=slider))
    slider.value = newest_s  # a step was under way
    page._wait(0.0)
    page.step(103.0, 0.1)
    assert slider.value == 7.0


def test_while_the_ground_is_read_browsers_are_not_sent_each_state_of_it(
    run_dir: tuple[Path, Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    """They draw slower than it is read, and would be behind for minutes."""
    sent = list[Ground]()
    show = "companion.live_view.scene.Scene.show_ground"
    monkeypatch.setattr(show, lambda _, ground: sent.append(ground))
    monkeypatch.setattr("companion.live_view.page._REPLAY_S", 1e-6)  # a few inputs in a period
    server, now_s = viser.ViserServer(host="127.0.0.1", port=0, verbose=False), 0.0
    with Recording(run_dir[0]) as recording:
        recording.read()
        page = Page(server, recording)
        while not now_s or "read until" in page.status:
            page.step(now_s, 0.1)
            now_s += 0.01
        assert page.replica is not None
        _, newest = page.replica.ground_at(recording.flight, math.inf)
    server.stop()
    assert newest is not None
    assert 2 <= len(sent) <= now_s / 2.0 + 2.0
    assert np.array_equal(sent[-1].kind, newest.kind)


def test_a_folder_without_a_flight_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="it holds no mission"):
        serve(Asked(path=str(tmp_path), port=0), lambda _: None, lambda: True)
