"""Links to ground stations beside a flight: heard, answered, no reason to wait or to end."""

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from stub_session import HEARTBEAT, HOLD, PATIENCE_S, SETPOINT, QueueLink, StubSession
from test_workers import Rig

from companion.runtime.link import open_links
from companion.runtime.workers import Datagram, EventQueue, GroundReader
from companion.telemetry.run_folder import RunFolder


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    with RunFolder(tmp_path / "run", mission_toml="", epoch_us=0) as folder:
        yield folder


class Dead(QueueLink):
    """A link that raises with whatever is asked of it."""

    def send(self, frames: list[bytes]) -> None:
        raise OSError(f"made up, of {len(frames)} frames")

    def answer_to(self, sender: object) -> None:
        raise OSError(f"made up, for {sender}")


def goes_on(rig: Rig) -> None:
    """The stream does, for as long as a part may stand still, and longer."""
    sent = len(rig.link.times_of(SETPOINT))
    rig.link.wait_until(lambda: len(rig.link.times_of(SETPOINT)) > sent + 20)


def test_each_is_heard_by_its_number_answered_and_sent_what_is_for_the_ground(
    folder: RunFolder,
) -> None:
    first, second = QueueLink(time.monotonic), QueueLink(time.monotonic)
    rig = Rig(folder, StubSession(), ground=[first, second])
    with rig.flying():
        second.incoming.put(b"order")
        for link in (first, second):
            link.wait_until(lambda link=link: link.times_of(HEARTBEAT) != [])
        goes_on(rig)
    assert rig.session.from_ground == [(b"order", 2)]
    assert (first.answers, second.answers) == ([], ["vehicle"])
    assert first.times_of(SETPOINT) == []


def test_one_that_fails_is_said_and_the_flight_goes_on(folder: RunFolder) -> None:
    link = Dead(time.monotonic)
    rig = Rig(folder, StubSession(), ground=[link])
    with rig.flying():
        link.incoming.put(b"order")
        goes_on(rig)
        link.incoming.put(OSError("pulled out"))
        goes_on(rig)
        assert rig.session.complaints == ["ground link 1 is lost: OSError: pulled out"]
    assert rig.link.times_of(HOLD) == []
    assert rig.session.from_ground == [(b"order", 1)]


def test_one_that_hangs_in_the_middle_of_receiving_changes_nothing(folder: RunFolder) -> None:
    link, released = QueueLink(time.monotonic), threading.Event()
    rig = Rig(folder, StubSession(), ground=[link])
    try:
        with rig.flying():
            link.incoming.put(released)
            goes_on(rig)
    finally:
        released.set()
    assert rig.link.times_of(HOLD) == []


def test_when_a_part_dies_the_ground_is_told_why(folder: RunFolder) -> None:
    link = QueueLink(time.monotonic)
    rig = Rig(folder, StubSession(), ground=[link])
    with rig.flying():
        rig.link.incoming.put(KeyError("made up"))
        end = rig.wait_for_the_end()
    assert "reader" in end.reason
    [(_, text)] = [sent for sent in link.sent if b"the reader has died" in sent[1]]
    assert [frame for _, frame in rig.link.sent].count(text) == 1
    assert len(rig.link.times_of(HOLD)) == 3


class Quiet(QueueLink):
    """A link that tells when nothing more is waiting in it."""

    def __init__(self) -> None:
        super().__init__(time.monotonic)
        self.is_empty = threading.Event()

    def receive(self, timeout_s: float) -> bytes | None:
        if (data := super().receive(timeout_s)) is None:
            self.is_empty.set()
        return data


@pytest.mark.parametrize(("size", "most"), [(10, 500), (1000, 65)])
def test_no_more_is_taken_from_one_than_a_ground_station_has_to_say(size: int, most: int) -> None:
    link, event_queue = Quiet(), EventQueue()
    reader = GroundReader(link, 1, event_queue, lambda: 100.0)
    thread = threading.Thread(target=reader.run)
    for _ in range(1200):
        link.incoming.put(bytes(size))
    thread.start()
    assert link.is_empty.wait(PATIENCE_S)
    reader.leave()
    thread.join(PATIENCE_S)
    taken = event_queue.take(0.0, most=2000)
    assert len(taken) == most
    assert all(isinstance(each, Datagram) and each.link == 1 for each in taken)


def test_a_peer_that_reads_nothing_keeps_nobody_waiting() -> None:
    """As a ground station over TCP whose computer hangs: its buffers fill up."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(1)
        address = f"tcp:127.0.0.1:{listener.getsockname()[1]}"
        with open_links([address], "--ground") as [link]:
            deadline_s = time.monotonic() + PATIENCE_S
            while link.receive(0.05) is None and time.monotonic() < deadline_s:
                if getattr(link, "_stream", None) is not None:
                    break
            peer, _ = listener.accept()
            with peer:
                began_s = time.thread_time()
                for _ in range(20_000):
                    link.send([bytes(280)])
                assert time.thread_time() - began_s < 5.0
