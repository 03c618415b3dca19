"""What the page shows of a flight that was recorded, without a browser."""

import math
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rich
import viser
from pymavlink.dialects.v20 import all as wire

from companion.live_view.ground import PROVEN, UNKNOWN, Ground, Replica, ground_of
from companion.live_view.page import Page
from companion.live_view.recording import Recording
from companion.live_view.scene import Scene
from companion.live_view.shapes import WIDTH
from companion.replay.feed import flown_mission, outputs

GROWING = ("flight.tlog", "journal.jsonl", "inputs.msgpack")
PIECES = 5


@pytest.fixture
def recording(run_dir: Path) -> Recording:
    """What was recorded, all of it."""
    return Recording(run_dir)


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    rich.get_console().quiet = True
    found = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield found
    found.stop()


def advanced(replica: Replica) -> Replica:
    """Once it has replayed all inputs that there are."""
    while replica.advance(60.0):
        pass
    return replica


def ground_at(replica: Replica, recording: Recording, time_s: float) -> Ground | None:
    """What was known of the ground at a time of the flight."""
    number = replica.number_at(recording.flight, time_s)
    return None if number < 0 else ground_of(*replica.known(number), recording.flight.mission)


def test_a_flight_that_grows_is_read_like_one_that_is_over(
    recording: Recording, tmp_path: Path
) -> None:
    """In pieces that end anywhere, as another process sees files that are written."""
    data = {name: (recording.path / name).read_bytes() for name in GROWING}
    shutil.copy(recording.path / "mission.toml", tmp_path)
    for name in GROWING:
        (tmp_path / name).touch()
    replica, at_once = Replica(tmp_path), advanced(Replica(recording.path))
    growing = Recording(tmp_path)
    for piece in range(PIECES + 1):
        for name in GROWING:
            (tmp_path / name).write_bytes(data[name][: len(data[name]) * piece // PIECES])
        growing.read()
        advanced(replica)
    assert growing.events == recording.events
    for name in ("times_s", "places_nea_m"):
        assert np.array_equal(getattr(growing.flight, name), getattr(recording.flight, name))
    assert replica.ended is None
    times_s = recording.flight.times_s
    for time_s in times_s[:: len(times_s) // 50].tolist():
        ground, same = (
            ground_at(*each, time_s) for each in ((replica, growing), (at_once, recording))
        )
        assert (ground and ground.height_m.tobytes()) == (same and same.height_m.tobytes())


def test_the_ground_is_what_the_flight_knew(run_dir: Path, recording: Recording) -> None:
    """Drawn by blocks of 2 x 2 cells, by the least sure of them."""
    *_, (_, session, _) = outputs(run_dir, flown_mission(run_dir))
    replica = advanced(Replica(run_dir))
    first, last = (ground_at(replica, recording, at_s) for at_s in (0.0, math.inf))
    assert (first.kind == UNKNOWN).all()
    known = session.state.flight.known
    aside = replace(known, upper_m=np.roll(known.upper_m, 1, 0), seen=np.roll(known.seen, 1, 0))
    less = ground_of(aside, (0.0, 0.0), session.mission)
    for each, ground in ((known, last), (aside, less)):
        rows, columns = ground.kind.shape
        proven = each.surveyed.reshape(rows, 2, columns, 2).all((1, 3))
        assert proven.any()
        assert np.array_equal(ground.kind == PROVEN, proven)
        highest_m = each.upper_m.reshape(rows, 2, columns, 2).max((1, 3))
        assert ground.height_m[proven] == pytest.approx(highest_m[proven])
    assert (less.kind == PROVEN).sum() < (last.kind == PROVEN).sum()


def test_the_scene_and_the_panel_follow_the_time(
    server: viser.ViserServer, recording: Recording
) -> None:
    """Once all is read, all of the flight is in it; before the first plan there is none."""
    page, handles = Page(server, recording), server.scene._handle_from_node_name
    for second in range(40):  # of its clock: until all is read
        page.step(float(second), 1.0)
    of_world = {"/vehicle", "/track", "/unknown", "/ground/guessed", "/decided/target_1"}
    names = ("p_scan", "p_prog", "leg", "control", "guide", "reach")
    of_plan = {f"/decided/{name}" for name in names}
    assert of_world | of_plan | {"/ground/proven"} <= handles.keys()
    labels = {handles[name].text for name in handles if name.endswith("/label")}
    assert {"target", 'keep-out tower <&> "mast"', "keep-out village", "keep-in county"} <= labels
    held = next(each for each in page._recording.events if "paused by" in each.text)
    seen = []
    for now_s, time_s in ((90.0, 0.0), (91.0, None), (92.0, 0.0), (93.0, held.time_s)):
        page.go_to(time_s)
        page.step(now_s, 0.1)
        place = tuple(server.scene.get_handle_by_name("/vehicle").position)
        seen.append((of_plan & handles.keys(), page.status, place))
    began, newest, again, held_then = seen
    assert "/decided/leg" not in began[0]
    assert newest[0] >= {f"/decided/{name}" for name in ("leg", "guide", "reach", "control")}
    assert again == began
    assert "paused by a person" in held_then[1]
    assert held_then[1:] != began[1:]
    assert held_then[2] != began[2]
    page._slider.value, page._shown = 5.0, ()  # moved just now, and more of the ground is read
    page.step(94.0, 0.1)
    assert page._slider.value == 5.0


def test_what_a_lidar_passed_over_is_shown_for_a_second(
    server: viser.ViserServer, recording: Recording
) -> None:
    """72 sectors of 5 degrees and 50 m, one of which says nothing; a driver sends them."""
    told = [65_535, *[5_000] * 71]
    message = wire.MAVLink_obstacle_distance_message(0, 0, told, 5, 20, 16_000, 5.0, 0.0, 12)
    frame = bytes(message.pack(wire.MAVLink(None, srcSystem=1, srcComponent=196)))
    flight = recording.flight
    flight.look(int(flight.track.time_us[-1]) - 900_000, frame)
    scene = Scene(server, flight)
    scene.show(recording.ends_s)
    beams = np.asarray(server.scene.get_handle_by_name("/sweep").points, dtype=float)
    away = np.linalg.norm(beams[:, 1] - beams[:, 0], axis=1)
    assert len(beams) == 71
    assert away == pytest.approx(50.0 * WIDTH / scene.area.width_m, rel=1e-3)
    at_rad = flight.heading_rad(len(flight.times_s) - 1) + math.radians(5.0)  # the second sector
    ahead = np.array([math.sin(at_rad), math.cos(at_rad)])
    assert (beams[0, 1] - beams[0, 0])[:2] / away[0] == pytest.approx(ahead, abs=1e-2)
    scene.show(recording.ends_s - 1.0)
    assert not np.any(server.scene.get_handle_by_name("/sweep").points)
