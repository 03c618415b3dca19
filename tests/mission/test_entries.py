"""The journal's entries: what replay and a reader of a flight are told of each event."""

import json
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from made_up import MISSION, certificate, fresh, planned, position, scan_done, status

from companion.mission import entries, events, journal
from companion.mission.events import Event, PlanReady
from companion.path.certificate import Certificate, certify
from companion.path.subpath import Pose, Subpath
from companion.planner.request import NotPlanned, PlanRequest, Refusal
from companion.world.known_map import KnownMap

STATE = fresh()
WALL_EAST_M = 1_300.0


def walled() -> KnownMap:
    """Flat ground at 0 m, known everywhere, and a wall of 4 km along a meridian."""
    blank = STATE.flight.known
    heights = np.zeros_like(blank.upper_m)
    heights[:, blank.cell_of(0.0, WALL_EAST_M)[1]] = 4_000.0
    return replace(blank, upper_m=heights)


def request(**changes: Any) -> PlanRequest:
    """From above the origin to the north-east, in a bend."""
    start = Pose(
        position_nea_m=np.array([0.0, 0.0, 3030.0]),
        tangent_nea=np.array([0.6, 0.8, 0.0]),
        curvature_nea_1_m=np.array([-8e-5, 6e-5, 0.0]),
    )
    asked = PlanRequest(
        plan_id=7,
        seed=1,
        task=MISSION.task,
        known=walled(),
        scan_nea_m=(-1_000.0, 0.0, 3030.0),
        start=start,
        from_rest=False,
        target_ne_m=(5_000.0, 5_000.0),
    )
    return replace(asked, **changes)


def proof(asked: PlanRequest, subpath: Subpath) -> Certificate:
    surroundings = asked.task.surroundings(asked.known, asked.scan_nea_m[:2], 25_000.0)
    return certify(subpath, surroundings, from_rest=False)


def told(event: Event) -> dict[str, Any]:
    """The entry, as it comes back from a file."""
    entry = entries.of_event(event, STATE)
    assert entry is not None
    back: dict[str, Any] = json.loads(json.dumps(entry))
    return back


def test_a_plan_is_told_with_its_kernel_and_its_certificate_number_by_number() -> None:
    outcome = replace(planned(request()), kernel="numba", certificate=certificate())
    entry = told(PlanReady(time_s=1.0, outcome=outcome))
    assert (entry["kind"], entry["plan_id"], entry["kernel"]) == ("plan ready", 7, "numba")
    names = {field.name for field in fields(Certificate)}
    assert set(entry["certificate"]) == names
    back = Certificate(**entry["certificate"] | {"broken": tuple(entry["certificate"]["broken"])})
    assert back == certificate()
    assert back.proven


@pytest.mark.parametrize(("end_east_m", "safe"), [(400.0, True), (3_000.0, False)])
def test_the_certificate_can_be_made_again_from_the_control_points_that_are_told(
    end_east_m: float, safe: bool
) -> None:
    """Beside the wall, or across it: the proof and its failure are both told as they were."""
    asked = request()
    control = [[0.0, 0.0, 3030.0], [2e3, 0.0, 3040.0], [5e3, 300.0, 3050.0]]
    subpath = Subpath(control_nea_m=np.array([*control, [8e3, end_east_m, 3060.0]]))
    made = proof(asked, subpath)
    assert made.proven is safe
    outcome = replace(planned(asked), subpath=subpath, certificate=made)
    entry = told(PlanReady(time_s=1.0, outcome=outcome))
    again = proof(asked, Subpath(control_nea_m=np.array(entry["control_nea_m"])))
    for name, value in entry["certificate"].items():
        expected = getattr(again, name)
        assert value == (list(expected) if name == "broken" else expected), name
    assert ("terrain clearance" in entry["certificate"]["broken"]) is not safe


def test_a_request_is_told_with_all_of_the_pose_that_the_next_leg_joins() -> None:
    asked = request(attempt=2)
    entry = json.loads(json.dumps(entries.of_request(asked, due_s=12.5)))
    start = asked.start
    assert (entry["kind"], entry["plan_id"], entry["attempt"]) == ("plan asked", 7, 2)
    assert (entry["due_s"], entry["from_rest"]) == (12.5, False)
    assert entry["start_nea_m"] == start.position_nea_m.tolist()
    assert entry["tangent_nea"] == start.tangent_nea.tolist()
    assert entry["curvature_nea_1_m"] == start.curvature_nea_1_m.tolist()
    assert entry["scan_nea_m"] == list(asked.scan_nea_m)


@pytest.mark.parametrize("stopped_after", [None, 2])
def test_whether_time_was_up_and_where_a_way_is_closed_is_told_as_the_journal_reads_it(
    stopped_after: int | None,
) -> None:
    found = replace(planned(request()), certificate=certificate(), stopped_after=stopped_after)
    closed = NotPlanned(
        plan_id=7,
        refusal=Refusal.NO_WAY,
        broken=("floor",),
        place_ne_m=(120.0, -40.0),
        stopped_after=stopped_after,
    )
    for outcome in (found, closed):
        entry = told(PlanReady(time_s=1.0, outcome=outcome))
        read = journal.entry_of({**entry, "t_s": 1.0})
        assert isinstance(read, journal.PlanReady | journal.PlanRefused)
        assert read.out_of_time == (stopped_after is not None)
        if isinstance(read, journal.PlanRefused):
            assert (read.reason, read.broken) == ("NO_WAY", ("floor",))
            assert read.place_ne_m == (120.0, -40.0)


@pytest.mark.parametrize("event", [events.Tick(time_s=1.0), status(1.0), position(1.0)])
def test_what_is_in_the_telemetry_log_is_not_told_again(event: Event) -> None:
    assert entries.of_event(event, STATE) is None
    done = entries.of_event(scan_done(1.0), STATE)
    assert done["kind"] == "scan done"


def test_a_distance_to_keep_outs_without_keep_outs_is_infinite_and_not_lost() -> None:
    subpath = Subpath(control_nea_m=np.linspace([0.0, 0.0, 3030.0], [5e3, 0.0, 3030.0], 4))
    outcome = replace(planned(request()), certificate=proof(request(), subpath))
    assert told(PlanReady(time_s=1.0, outcome=outcome))["certificate"]["keep_out_m"] == math.inf
