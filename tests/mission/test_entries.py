"""The journal's entries: what replay and a reader of a flight are told of each event."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up import Craft, position, scan_done, tell
from made_up_plans import planned

from companion.mission import events, journal
from companion.mission.phases import Phase
from companion.path.certificate import Certificate, certify
from companion.path.subpath import Subpath


@pytest.mark.parametrize(("height_m", "safe"), [(0.0, True), (4_000.0, False)])
def test_a_certificate_can_be_made_again_from_what_is_told(height_m: float, safe: bool) -> None:
    """The proof and its failure are told as they were, distances without an end among them."""
    craft = Craft().run_until(lambda craft: craft.sent(events.Plan))
    [asked] = (plan.request for plan in craft.sent(events.Plan))
    ground = replace(asked.known, upper_m=np.full_like(asked.known.upper_m, height_m))
    surroundings = asked.task.surroundings(ground, (-1_000.0, 0.0), 25_000.0)
    control = [[0.0, 0.0, 3030.0], [2e3, 0.0, 3040.0], [5e3, 300.0, 3050.0], [8e3, 400.0, 3060.0]]
    subpath = Subpath(control_nea_m=np.array(control))
    made = certify(subpath, surroundings, from_rest=False)
    assert (made.proven, made.keep_out_m) == (safe, math.inf)
    outcome = replace(planned(asked), kernel="numba", subpath=subpath, certificate=made)
    told = journal.of_event(events.PlanReady(time_s=1.0, outcome=outcome), craft.state)
    entry = json.loads(json.dumps(told))  # as it comes back from a file
    assert (entry["kind"], entry["plan_id"], entry["kernel"]) == ("plan ready", 1, "numba")
    values = entry["certificate"]
    back = Certificate(**values | {"broken": tuple(values["broken"])})
    again = Subpath(control_nea_m=np.array(entry["control_nea_m"]))
    assert back == certify(again, surroundings, from_rest=False)
    assert ("terrain clearance" in back.broken) is not safe


def test_what_is_in_the_telemetry_log_is_not_told_again() -> None:
    state = Craft().state
    status = events.VehicleStatus(time_s=1.0, mode=events.Mode.GUIDED, armed=True)
    for event in (events.Tick(time_s=1.0), status, position(1.0)):
        assert journal.of_event(event, state) is None
    told = journal.of_event(scan_done(1.0), state)
    assert told["kind"] == "scan done"


def test_a_stop_on_the_path_is_told_as_it_begins_and_once() -> None:
    """Not only when it stands: a reader asks then why it has slowed down."""
    craft = Craft().fly_to(Phase.FLYING)
    craft.run_until(lambda it: it.state.leg is not None).run_for(20.0)
    tell(craft, events.OrderKind.PAUSE)
    craft.fly_to(Phase.HOLDING)
    told = [
        (entry["kind"], entry["code"])
        for before, _, after, _ in craft.steps
        for entry in journal.of_change(before, after)
        if "code" in entry and after.now_s > 20.0
    ]
    assert told[-2:] == [("stops on path", "PAUSED"), ("phase", "PAUSED")]
    assert told.count(("stops on path", "PAUSED")) == 1


def test_what_is_noted_by_the_name_of_its_kind_is_declared() -> None:
    """Else readers pass over it, and the page of the journal does not know it."""
    ours = Path(journal.__file__).parents[1]
    written = [ours / "session.py", *(ours / "mavlink").glob("*.py"), *ours.glob("runtime/*.py")]
    source = "".join(path.read_text(encoding="utf-8") for path in written)
    named = set(re.findall(r'"kind": "([^"]+)"', source))
    assert {"say", "scan", "acknowledged", "part died"} <= named <= journal.KINDS.keys()
