"""The journal's entries: what replay and a reader of a flight are told of each event."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_up import MISSION, certificate, fresh, planned, position, scan_done, status

from companion.mission import events, journal
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


ASKED = PlanRequest(
    plan_id=7,
    seed=1,
    task=MISSION.task,
    known=walled(),
    scan_nea_m=(-1_000.0, 0.0, 3030.0),
    start=Pose(
        position_nea_m=np.array([0.0, 0.0, 3030.0]),
        tangent_nea=np.array([0.6, 0.8, 0.0]),
        curvature_nea_1_m=np.array([-8e-5, 6e-5, 0.0]),
    ),
    from_rest=False,
    target_ne_m=(5_000.0, 5_000.0),
    attempt=2,
)
"""From above the origin to the north-east, in a bend."""


def proof(subpath: Subpath) -> Certificate:
    surroundings = ASKED.task.surroundings(ASKED.known, ASKED.scan_nea_m[:2], 25_000.0)
    return certify(subpath, surroundings, from_rest=False)


def told(event: Event) -> dict[str, Any]:
    """The entry, as it comes back from a file."""
    back: dict[str, Any] = json.loads(json.dumps(journal.of_event(event, STATE)))
    return back


@pytest.mark.parametrize(("end_east_m", "safe"), [(400.0, True), (3_000.0, False)])
def test_the_certificate_is_told_whole_and_can_be_made_again_from_the_control_points_that_are(
    end_east_m: float, safe: bool
) -> None:
    """Beside the wall, or across it: the proof and its failure are both told as they were.

    A distance to keep-outs without keep-outs is infinite, and not lost.
    """
    control = [[0.0, 0.0, 3030.0], [2e3, 0.0, 3040.0], [5e3, 300.0, 3050.0]]
    subpath = Subpath(control_nea_m=np.array([*control, [8e3, end_east_m, 3060.0]]))
    made = proof(subpath)
    assert made.proven is safe
    assert made.keep_out_m == math.inf
    outcome = replace(planned(ASKED), kernel="numba", subpath=subpath, certificate=made)
    entry = told(PlanReady(time_s=1.0, outcome=outcome))
    assert (entry["kind"], entry["plan_id"], entry["kernel"]) == ("plan ready", 7, "numba")
    values = entry["certificate"]
    back = Certificate(**values | {"broken": tuple(values["broken"])})
    assert back == proof(Subpath(control_nea_m=np.array(entry["control_nea_m"])))
    assert ("terrain clearance" in back.broken) is not safe


@pytest.mark.parametrize("stopped_after", [None, 2])
def test_whether_time_was_up_and_where_a_way_is_closed_is_told_as_the_journal_reads_it(
    stopped_after: int | None,
) -> None:
    found = replace(planned(ASKED), certificate=certificate(), stopped_after=stopped_after)
    closed = NotPlanned(
        plan_id=7,
        refusal=Refusal.NO_WAY,
        broken=("floor",),
        place_ne_m=(120.0, -40.0),
        stopped_after=stopped_after,
    )
    ready, refused = (
        journal.entry_of({**told(PlanReady(time_s=1.0, outcome=each)), "t_s": 1.0})
        for each in (found, closed)
    )
    assert isinstance(ready, journal.PlanReady)
    assert isinstance(refused, journal.PlanRefused)
    assert ready.out_of_time == refused.out_of_time == (stopped_after is not None)
    assert (refused.reason, refused.broken) == ("NO_WAY", ("floor",))
    assert refused.place_ne_m == (120.0, -40.0)


@pytest.mark.parametrize("event", [events.Tick(time_s=1.0), status(1.0), position(1.0)])
def test_what_is_in_the_telemetry_log_is_not_told_again(event: Event) -> None:
    assert journal.of_event(event, STATE) is None
    assert told(scan_done(1.0))["kind"] == "scan done"
