"""What never happens, whatever happens: 60,000 events of random programs, 1,200,000 with `--all`.

`wild` makes the programs, and `watch` checks each step of them by the laws that it lists.
"""

import pytest
from watch import Watch
from wild import Wild

from companion.mavlink.autopilots import ALL
from companion.mission.phases import Phase

SHARDS, EVENTS = 60, 20_000
LONGEST = 6_000
"""Events of one program."""


def shard(number: int, events: int = EVENTS) -> list[Watch]:
    """Programs one after the other until so many events were seen."""
    seen, watches, seed = 0, [], number * 10_000
    while seen < events:
        program = Wild(seed)
        try:
            program.run(LONGEST)
        except AssertionError as error:
            error.add_note(f"Wild({seed}).run({LONGEST}), at event {len(program.steps)}")
            raise
        seen, seed = seen + len(program.steps), seed + 1
        watches.append(program.watch)
    return watches


@pytest.mark.sample(20)
@pytest.mark.parametrize("number", range(SHARDS))
def test_nothing_happens_that_must_never_happen(number: int) -> None:
    watches = shard(number)
    assert sum(watch.setpoints for watch in watches) > 0


@pytest.mark.nightly
def test_the_programs_are_of_all_drivings_come_to_every_phase_and_have_orders_to_keep() -> None:
    watches = shard(SHARDS + 5, 400_000)
    assert {watch.traits.name for watch in watches} == {each.traits.name for each in ALL}
    assert {watch.context.shadow for watch in watches} == {True, False}
    assert sum(watch.kept > 0 for watch in watches) > 10
    assert set().union(*(watch.phases for watch in watches)) == set(Phase)
