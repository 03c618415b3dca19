"""The journal's entries: what replay and a reader of a flight are told of each event."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_up import MISSION, fresh, position, scan_done, status
from made_up_plans import planned

from companion.mission import events, journal
from companion.mission.events import Event, PlanReady
from companion.path.certificate import Certificate, certify
from companion.path.subpath import Subpath
from companion.planner.procedure import hover_pose
from companion.planner.request import PlanRequest

STATE = fresh()
ASKED = PlanRequest(
    plan_id=7,
    seed=1,
    task=MISSION.task,
    known=STATE.flight.known,
    scan_nea_m=(-1_000.0, 0.0, 3030.0),
    start=hover_pose((0.0, 0.0, 3030.0)),
    from_rest=True,
    target_ne_m=(5_000.0, 5_000.0),
)


def told(event: Event) -> dict[str, Any]:
    """The entry, as it comes back from a file."""
    back: dict[str, Any] = json.loads(json.dumps(journal.of_event(event, STATE)))
    return back


@pytest.mark.parametrize(("height_m", "safe"), [(0.0, True), (4_000.0, False)])
def test_the_certificate_is_told_whole_and_can_be_made_again_from_the_control_points_that_are(
    height_m: float, safe: bool
) -> None:
    """The proof and its failure are told as they were, distances without an end among them."""
    ground = replace(ASKED.known, upper_m=np.full_like(ASKED.known.upper_m, height_m))
    surroundings = ASKED.task.surroundings(ground, ASKED.scan_nea_m[:2], 25_000.0)
    control = [[0.0, 0.0, 3030.0], [2e3, 0.0, 3040.0], [5e3, 300.0, 3050.0], [8e3, 400.0, 3060.0]]
    subpath = Subpath(control_nea_m=np.array(control))
    made = certify(subpath, surroundings, from_rest=False)
    assert made.proven is safe
    assert made.keep_out_m == math.inf
    outcome = replace(planned(ASKED), kernel="numba", subpath=subpath, certificate=made)
    entry = told(PlanReady(time_s=1.0, outcome=outcome))
    assert (entry["kind"], entry["plan_id"], entry["kernel"]) == ("plan ready", 7, "numba")
    values = entry["certificate"]
    back = Certificate(**values | {"broken": tuple(values["broken"])})
    again = Subpath(control_nea_m=np.array(entry["control_nea_m"]))
    assert back == certify(again, surroundings, from_rest=False)
    assert ("terrain clearance" in back.broken) is not safe


def test_what_is_in_the_telemetry_log_is_not_told_again() -> None:
    for event in (events.Tick(time_s=1.0), status(1.0), position(1.0)):
        assert journal.of_event(event, STATE) is None
    assert told(scan_done(1.0))["kind"] == "scan done"
