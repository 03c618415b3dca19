"""Companions that cross one point, in process: the real sessions, with lost messages."""

import crossing
import pytest

from companion.sources.mission_file import mission_of
from companion.sources.mission_schema import MissionTable
from companion.sources.schema import validated


@pytest.mark.parametrize("seed", [1, 5])
def test_two_that_meet_head_on_keep_apart_and_arrive(seed: int) -> None:
    trial = crossing.fly(2, 0, 0.1, seed)
    assert trial["arrived"] == 2
    assert trial["kept"] >= 1.0
    texts = [text for each in trial["texts"].values() for text in each]
    assert any("giving way to others in the air: system" in text for text in texts)


def test_it_waits_for_aircraft_says_so_once_and_goes_on() -> None:
    trial = crossing.fly(1, 3, 0.1, 3)
    assert trial["arrived"] == 1
    assert trial["clear_m"] > crossing.SEPARATION_M
    assert sum("giving way" in text for text in trial["texts"][1]) == 1


def test_alone_in_the_air_it_flies_as_without_the_rules(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = crossing.fly(1, 0, 0.0, 1)
    monkeypatch.delitem(crossing._TABLE, "traffic")
    unwatched = crossing.fly(1, 0, 0.0, 1)
    assert watched["times_s"][0] - unwatched["times_s"][0] <= 1.5  # the second of the first claim


def test_who_claims_plans_earlier_by_two_seconds_and_what_it_brakes_in() -> None:
    scans_m = []
    for claims in (True, False):
        table = crossing._TABLE | {"traffic": {"claims": claims}}
        task = mission_of(validated(MissionTable, table, "a"), None, "a").task
        scans_m.append(task.scan_distance_m)
    assert scans_m[0] - scans_m[1] == pytest.approx(2.0 * 8.0 + 8.0**2 / (2.0 * 2.5))
