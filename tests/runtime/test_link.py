"""Connection strings, and datagrams over real sockets on the loopback."""

import contextlib
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st
from programs import free_port

from companion.errors import InputError
from companion.runtime.connection import Connection, parsed
from companion.runtime.link import datagrams, open_link

PATIENCE_S = 10.0
BY_PATH = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0"
MEANT: dict[str, tuple[str, str, int]] = {
    "udpin:0.0.0.0:14540": ("udpin", "0.0.0.0", 14540),
    "udpin://0.0.0.0:14540": ("udpin", "0.0.0.0", 14540),
    "udp:0.0.0.0:14540": ("udpin", "0.0.0.0", 14540),  # as pymavlink has it
    "udpout:192.168.1.10:14550": ("udpout", "192.168.1.10", 14550),
    "tcp://vehicle.local:5760": ("tcp", "vehicle.local", 5760),
    "tcp:[fe80::1]:14540": ("tcp", "fe80::1", 14540),
    "/dev/ttyACM0": ("serial", "/dev/ttyACM0", 57600),
    "/dev/ttyAMA0,921600": ("serial", "/dev/ttyAMA0", 921600),
    "serial:/dev/ttyUSB0": ("serial", "/dev/ttyUSB0", 57600),
    "serial:///dev/ttyUSB0:921600": ("serial", "/dev/ttyUSB0", 921600),
    f"{BY_PATH},115200": ("serial", BY_PATH, 115200),
    f"serial:{BY_PATH}": ("serial", BY_PATH, 57600),
}
"""Kind, host or device, port or baud rate."""
NONSENSE = (
    *("", "udpin", "udpin:127.0.0.1", "udpin::14540", "udpin:[::1]", "udpin:::1:14540"),
    *(f"udpin:127.0.0.1:{port}" for port in ("x", "-1", "65536", "14540:1", " 1", "1e4", "0")),
    *("udpin:127.0.0.1:" + "9" * 5000, "tcpin:127.0.0.1:5760", "UDPIN:127.0.0.1:14540"),
    *("127.0.0.1:14540", "mission.tlog", "ttyACM0,57600", "serial:", "COM3,57600"),
    *(f"/dev/ttyACM0,{baud}" for baud in ("", "fast", "0000", "57600,1", "99999999")),
    *("udpin:a..b:14540", f"udpin:{'a' * 64}.example:14540"),  # there can be no such host
    # as MAVSDK, MAVROS, mavp2p and MAVProxy have it: some of them listen where others call
    *("serial:///dev/ttyACM0?baud=57600", "serial-hwfc:/dev/ttyACM0:921600", "udpin://:14540"),
    *("udp://0.0.0.0:14540", "udp://:14540@127.0.0.1:14557", "tcpout://127.0.0.1:5760"),
)
IN_BRACKETS = tuple(f"{kind}:fe80::1:14540" for kind in ("udpin", "udpout", "tcp"))


@pytest.mark.parametrize("text", MEANT)
def test_networks_and_serial_ports_are_written_as_other_programs_write_them(text: str) -> None:
    assert parsed(text) == Connection(text, *MEANT[text])
    assert parsed("tcp:[fe80::1]:14540").resolved()[0] is socket.AF_INET6


@pytest.mark.parametrize("text", [*NONSENSE, *IN_BRACKETS])
def test_what_means_nothing_is_an_input_error_of_one_line_with_a_remedy(text: str) -> None:
    with pytest.raises(InputError) as caught:
        open_link(text)
    message = str(caught.value)
    assert message.startswith(f"--connect = {text!r}: "[:200])
    assert "\n" not in message
    assert "Write udpin:127.0.0.1:14540 (" in message
    assert "stands in brackets" in message or text not in IN_BRACKETS


def test_datagrams_arrive_whole_in_order_and_answers_go_to_who_was_chosen_last() -> None:
    """What is sent before anybody was heard is dropped; the port is given back.

    The source port of a rebooted vehicle is another one; a stranger does not take its place.
    """
    port = free_port()
    for _ in range(2):
        with contextlib.ExitStack() as stack:
            link, vehicle, later = (
                stack.enter_context(open_link(f"{kind}:127.0.0.1:{port}"))
                for kind in ("udpin", "udpout", "udpout")
            )
            assert link.receive(0.0) is None  # nothing heard is no error
            link.send([b"lost"])
            for number in range(100):
                vehicle.send([b"to %d" % number])
            got = [link.receive(PATIENCE_S) for _ in range(100)]
            assert got == [b"to %d" % number for number in range(100)]
            link.answer_to(link.sender)
            later.send([b"after"])
            assert link.receive(PATIENCE_S) == b"after"
            link.send([b"answer"])
            assert vehicle.receive(PATIENCE_S) == b"answer"
            link.answer_to(link.sender)
            link.send([b"another"])
            assert later.receive(PATIENCE_S) == b"another"
            assert vehicle.receive(0.0) is None


@given(st.lists(st.sampled_from([1, 20, 280, 700, 1399, 1400, 2000])))
def test_frames_are_batched_into_as_few_datagrams_as_hold_1400_bytes(sizes: list[int]) -> None:
    """In order and whole; each as full as it can be."""
    frames = [bytes([number % 256]) * size for number, size in enumerate(sizes)]
    expected = list[bytes]()
    for frame in frames:
        if not expected or len(expected[-1]) + len(frame) > 1400:
            expected.append(b"")
        expected[-1] += frame
    assert [*datagrams(frames)] == expected


def test_a_vehicle_that_is_not_there_or_a_network_that_refuses_is_no_error() -> None:
    """In flight nothing unwinds the stack: sending to a broadcast address is not permitted."""
    for place in (f"127.0.0.1:{free_port()}", "255.255.255.255:14550"):
        with open_link(f"udpout:{place}") as link:
            for _ in range(3):
                link.send([b"anybody?"])
                assert link.receive(0.02) is None


def test_a_port_in_use_or_of_another_computer_is_an_input_error_with_its_remedy() -> None:
    text, in_use = f"udpin:127.0.0.1:{free_port()}", r"in use.*choose another port"
    with open_link(text), pytest.raises(InputError, match=in_use) as caught:
        open_link(text)
    assert str(caught.value).startswith(f"--connect = {text!r}: ")
    with pytest.raises(InputError, match="cannot be opened"):
        open_link("udpin:192.0.2.1:14540")
