"""The journal's entries: what replay and a reader of a flight are told of each event."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from made_up import Craft, position, scan_done, tell
from made_up_plans import certificate, planned

from companion.mission import events, journal
from companion.mission.phases import Phase
from companion.path.certificate import Certificate
from companion.path.subpath import Subpath


def test_a_certificate_can_be_made_again_from_what_is_told() -> None:
    """The path is told to the last bit, and what was proven of it, distances without an end too."""
    craft = Craft().run_until(lambda craft: craft.sent(events.Plan))
    control = np.array([0.0, 0.0, 3030.0]) + np.outer([0.0, 1.0, 2.0, 3.0], [1e3, 1e3 / 3.0, 0.1])
    made = certificate(broken=("terrain clearance",))
    outcome = planned(craft.sent(events.Plan)[0].request)
    outcome = replace(outcome, subpath=Subpath(control_nea_m=control), certificate=made)
    told = journal.of_event(events.PlanReady(time_s=1.0, outcome=outcome), craft.state)
    entry = json.loads(json.dumps(told))  # as it comes back from a file
    assert (entry["kind"], entry["plan_id"], entry["kernel"]) == ("plan ready", 1, "made up")
    assert entry["control_nea_m"] == control.tolist()
    values = entry["certificate"]
    assert Certificate(**values | {"broken": tuple(values["broken"])}) == made


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
