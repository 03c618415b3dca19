"""A link to ground stations beside the vehicle's: the companion is there, and no vehicle is."""

from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import MISSION, Pair, Vehicle, messages

from companion.mavlink.link import Output
from companion.mission.state import Phase, Reason
from companion.replay.session_inputs import feed, session_of, start_of
from companion.session import Session

PERSON, STRANGER = (255, 190), (77, 1)


class Beside(Pair):
    """A pair with ground stations on links of their own."""

    def __init__(self, *, has_ground: bool = True) -> None:
        session = Session(MISSION, seed=1, lockstep=True, has_ground=has_ground)
        super().__init__(session, Vehicle(lockstep=True))
        self.to_ground: list[bytes] = []

    def take(self, out: Output) -> Output:
        self.to_ground += out.to_ground
        return super().take(out)

    def hear(self, message: Any, sender: tuple[int, int] = PERSON, link: int = 1) -> None:
        codec = wire.MAVLink(None, srcSystem=sender[0], srcComponent=sender[1])
        self.session.receive(message.pack(codec), 1.0, link)
        self.take(self.session.run())

    def order(self, number: int, *values: float, **keywords: Any) -> None:
        padded = [*values, *[0.0] * (7 - len(values))]
        self.hear(wire.MAVLink_command_long_message(1, 195, number, 0, *padded), **keywords)


def flying(**keywords: Any) -> Beside:
    it = Beside(**keywords)
    it.run_until(lambda it: it.session.state.flight.leg is not None)
    return it


def of(kind: str, frames: list[bytes]) -> list[Any]:
    return [message for message in messages(frames) if message.get_type() == kind]


def test_it_says_there_what_it_says_to_everybody_and_nothing_that_is_for_the_vehicle() -> None:
    it = flying()
    for kind in ("HEARTBEAT", "STATUSTEXT"):
        assert of(kind, it.to_ground)
        there, here = (of(kind, frames) for frames in (it.to_ground, it.frames))
        assert [m.to_dict() for m in there] == [m.to_dict() for m in here]
    assert {m.get_type() for m in messages(it.to_ground)} == {"HEARTBEAT", "STATUSTEXT"}


def test_its_frames_there_count_on_by_themselves() -> None:
    numbers = [message.get_seq() for message in messages(flying().to_ground)]
    assert numbers == [number % 256 for number in range(len(numbers))]


def test_an_order_is_obeyed_and_answered_where_it_came_from() -> None:
    it = flying()
    here = len(it.frames)
    it.order(wire.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
    [ack] = of("COMMAND_ACK", it.to_ground)
    assert (ack.command, ack.result) == (wire.MAV_CMD_DO_PAUSE_CONTINUE, 0)
    assert (ack.target_system, ack.target_component) == PERSON
    assert of("COMMAND_ACK", it.frames[here:]) == []
    it.run_until(lambda it: it.session.state.phase is Phase.HOLDING)
    assert it.session.state.reason is Reason.PAUSED


def test_who_may_not_command_may_not_there_either() -> None:
    it = flying()
    before = it.session.state.flight
    it.order(wire.MAV_CMD_DO_PAUSE_CONTINUE, 0.0, sender=STRANGER)
    [ack] = of("COMMAND_ACK", it.to_ground)
    assert ack.result == wire.MAV_RESULT_DENIED
    assert it.session.state.flight is before


def test_no_word_of_a_vehicle_counts_there() -> None:
    """Whoever routes the vehicle's own messages there, or makes some up."""
    it = flying()
    before = it.session.state
    for message in (
        wire.MAVLink_heartbeat_message(2, 3, 0, 5, 3, 3),
        wire.MAVLink_global_position_int_message(9_000_000, 0, 0, 0, 0, 0, 0, 0, 0),
        wire.MAVLink_timesync_message(0, 9_000_000_000_000),
        wire.MAVLink_terrain_data_message(0, 0, 100, 0, [0] * 16),
    ):
        it.hear(message, sender=(1, 1))
    assert it.session.state is before
    assert it.session.now_s < 9_000.0


def test_a_second_companion_is_noticed_there_too() -> None:
    it = flying()
    for _ in range(40):
        it.hear(wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), sender=(1, 195))
        it.tick()
    assert it.session.warned[1].startswith(Reason.NOT_ALONE.text)


def test_garbage_there_is_passed_over_and_cuts_no_message_of_the_vehicle() -> None:
    it, quiet = flying(), flying()
    for _ in range(50):
        it.session.receive(bytes(range(256)), 1.0, 1)
        it.tick()
        quiet.tick()
    assert it.frames == quiet.frames


def test_a_flight_from_before_there_were_such_links_is_told_again_as_it_was() -> None:
    it = flying(has_ground=False)
    (name, values), *others = it.inputs
    values.pop("has_ground")
    session = session_of(start_of((name, values)), lambda _start: replace(MISSION))
    outs = [out for told in others if (out := feed(session, told)) is not None]
    assert [frame for out in outs for frame in out.frames] == it.frames
    assert it.to_ground == []
