"""What connection strings mean, and those that mean nothing."""

import pytest

from companion.errors import InputError
from companion.runtime.connection import Connection, parsed
from companion.runtime.link import open_link

BY_PATH = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0"


BY_PATH = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0"
MEANT: dict[str, tuple[str, str, int]] = {
    "udpin:0.0.0.0:14540": ("udpin", "0.0.0.0", 14540),
    "udpin://0.0.0.0:14540": ("udpin", "0.0.0.0", 14540),
    "udp:0.0.0.0:14540": ("udpin", "0.0.0.0", 14540),  # as pymavlink has it
    "udpout:192.168.1.10:14550": ("udpout", "192.168.1.10", 14550),
    "tcp:vehicle.local:5760": ("tcp", "vehicle.local", 5760),
    "tcp://vehicle.local:5760": ("tcp", "vehicle.local", 5760),
    "udpin:[fe80::1]:14540": ("udpin", "fe80::1", 14540),
    "tcp:[fe80::1]:14540": ("tcp", "fe80::1", 14540),
    "/dev/ttyACM0": ("serial", "/dev/ttyACM0", 57600),
    "/dev/ttyAMA0,921600": ("serial", "/dev/ttyAMA0", 921600),
    "/dev/ttyACM0:57600": ("serial", "/dev/ttyACM0", 57600),
    "serial:/dev/ttyUSB0": ("serial", "/dev/ttyUSB0", 57600),
    "serial:/dev/ttyUSB0:921600": ("serial", "/dev/ttyUSB0", 921600),
    "serial:///dev/ttyUSB0:921600": ("serial", "/dev/ttyUSB0", 921600),
    "serial:/dev/ttyUSB0,115200": ("serial", "/dev/ttyUSB0", 115200),
    BY_PATH: ("serial", BY_PATH, 57600),
    f"{BY_PATH},115200": ("serial", BY_PATH, 115200),
    f"serial:{BY_PATH}": ("serial", BY_PATH, 57600),
    f"serial:{BY_PATH}:115200": ("serial", BY_PATH, 115200),
}
"""Kind, host or device, port or baud rate."""


@pytest.mark.parametrize("text", MEANT)
def test_networks_and_serial_ports_are_written_as_other_programs_write_them(text: str) -> None:
    assert parsed(text) == Connection(text, *MEANT[text])


NONSENSE = (
    *("", "udpin", "udpin:127.0.0.1", "udpin::14540", "udpin:[::1]", "udpin:::1:14540"),
    *(f"udpin:127.0.0.1:{port}" for port in ("", "x", "-1", "65536", "14540:1", " 1", "1e4", "0")),
    *("udpin:127.0.0.1:" + "9" * 5000, "udpout:127.0.0.1:0", "tcp:127.0.0.1:0", "tcp:127.0.0.1"),
    *("tcp:127.0.0.1:5760:1", "tcpin:127.0.0.1:5760", "udp:127.0.0.1", "UDPIN:127.0.0.1:14540"),
    *("udpbcast:192.168.0.255:14550", "127.0.0.1:14540", "mission.tlog", "ttyACM0,57600"),
    *(f"/dev/ttyACM0,{baud}" for baud in ("", "fast", "0", "57600,1", "99999999")),
    *("serial:", "serial:,57600", "COM", "COM3,", "COM3,-1", "com3;57600"),
    *("udpin:a..b:14540", f"udpin:{'a' * 64}.example:14540"),  # there can be no such host
    # as MAVSDK, MAVROS, mavp2p and MAVProxy have it: some of them listen where others call
    *("serial:///dev/ttyACM0?baud=57600", "serial-hwfc:/dev/ttyACM0:921600", "udpin://:14540"),
    *("udpin:14540", ":14540", "udp://0.0.0.0:14540", "udp://:14540@127.0.0.1:14557"),
    *("udps:0.0.0.0:14550", "tcpout://127.0.0.1:5760"),
)
IN_BRACKETS = tuple(f"{kind}:fe80::1:14540" for kind in ("udpin", "udpout", "tcp"))


@pytest.mark.parametrize("text", [*NONSENSE, *IN_BRACKETS])
def test_what_means_nothing_is_an_input_error_of_one_line_with_a_remedy(text: str) -> None:
    with pytest.raises(InputError) as caught:
        open_link(text)
    message = str(caught.value)
    assert message.startswith(f"--connect = {text!r}: "[:200])
    assert "\n" not in message
    assert "Write udpin:127.0.0.1:14540 (" in message or text in IN_BRACKETS
    assert "stands in brackets" in message or text in NONSENSE
