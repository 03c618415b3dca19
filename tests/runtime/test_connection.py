"""What connection strings mean; `test_link` has those that mean nothing."""

from dataclasses import replace

import pytest

from companion.errors import InputError
from companion.runtime.connection import Address, Device, parsed


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("udpin:0.0.0.0:14540", "udpin"),
        ("udp:0.0.0.0:14540", "udpin"),
        ("udpout:192.168.1.10:14550", "udpout"),
        ("tcp:vehicle.local:5760", "tcp"),
    ],
)
def test_networks(text: str, kind: str) -> None:
    place = parsed(text)
    assert isinstance(place, Address)
    assert place.kind == kind
    assert text.endswith(f"{place.host}:{place.port}")
    if not text.startswith("udp:"):  # which others use for either way
        assert replace(place, text="") == replace(parsed(text.replace(":", "://", 1)), text="")


@pytest.mark.parametrize("kind", ["udpin", "udpout", "tcp"])
def test_an_ipv6_address_stands_in_brackets(kind: str) -> None:
    place = parsed(f"{kind}:[fe80::1]:14540")
    assert isinstance(place, Address)
    assert (place.kind, place.host, place.port) == (kind, "fe80::1", 14540)
    with pytest.raises(InputError, match=rf"in brackets: {kind}:\[fe80::1\]:14540"):
        parsed(f"{kind}:fe80::1:14540")


@pytest.mark.parametrize(
    ("text", "here"),
    [
        ("/dev/ttyACM0:57600", "after a comma: /dev/ttyACM0,57600"),
        ("/dev/serial/by-id/usb-x-if00:921600", "after a comma: /dev/serial/by-id/usb-x-if00,"),
        ("COM3:57600", "after a comma: COM3,57600"),
        ("ttyUSB0:57600", "after a comma: /dev/ttyUSB0,57600"),
        ("ttyUSB0,57600", "a serial port is written /dev/ttyUSB0, or with its"),
        ("/dev/ttyACM0 115200", "after a comma: /dev/ttyACM0,115200"),
        ("serial:///dev/ttyACM0:57600?ids=1,240", "after a comma: /dev/ttyACM0,57600"),
        ("serial:///dev/ttyACM0?baud=57600", "after a comma: /dev/ttyACM0,57600"),
        ("serial-hwfc:///dev/ttyACM0:921600", "after a comma: /dev/ttyACM0,921600"),
        ("udpin://:14540", "written udpin:0.0.0.0:14540"),
        ("udpin:14540", "written udpin:0.0.0.0:14540"),
        (":14540", "written udpin:0.0.0.0:14540"),
        ("udp://0.0.0.0:14540", "written udpin:0.0.0.0:14540"),
        ("udp://127.0.0.1:14540", "udpin:127.0.0.1:14540 waits for the vehicle there, udpout:127."),
        ("127.0.0.1:14540", "udpin:127.0.0.1:14540 waits for the vehicle there, udpout:127."),
        ("localhost:14540", "udpin:localhost:14540 waits for the vehicle there, udpout:local"),
        ("udp://:14540@127.0.0.1:14557", "written udpin:0.0.0.0:14540"),
        ("udp://@192.168.1.2:14550", "written udpout:192.168.1.2:14550"),
        ("udps:0.0.0.0:14550", "written udpin:0.0.0.0:14550"),
        ("udpc:10.0.0.1:14550", "written udpout:10.0.0.1:14550"),
        ("tcpout://127.0.0.1:5760", "written tcp:127.0.0.1:5760"),
        ("tcpc:127.0.0.1:5760", "written tcp:127.0.0.1:5760"),
        ("UDPIN:127.0.0.1:14540", "written udpin:127.0.0.1:14540"),
    ],
)
def test_what_others_write_is_told_as_it_is_written_here(text: str, here: str) -> None:
    """MAVSDK, MAVROS, mavp2p, MAVProxy, DroneKit; and what is told means something."""
    with pytest.raises(InputError) as caught:
        parsed(text)
    said = str(caught.value)
    assert here in said
    assert "Write udpin:127.0.0.1:14540 (" in said
    for word in said.partition("': ")[2].partition(". Write")[0].split():
        if word.startswith(("udp", "tcp", "/dev/", "COM")):
            parsed(word.rstrip(","))


BY_PATH = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0"


@pytest.mark.parametrize(
    ("text", "name", "baud"),
    [
        ("/dev/ttyACM0", "/dev/ttyACM0", 57600),
        ("/dev/ttyAMA0,921600", "/dev/ttyAMA0", 921600),
        ("serial:/dev/ttyUSB0:921600", "/dev/ttyUSB0", 921600),
        ("serial:///dev/ttyUSB0:921600", "/dev/ttyUSB0", 921600),
        ("serial:/dev/ttyUSB0", "/dev/ttyUSB0", 57600),
        ("serial:/dev/ttyUSB0,115200", "/dev/ttyUSB0", 115200),
        (BY_PATH, BY_PATH, 57600),
        (f"{BY_PATH},115200", BY_PATH, 115200),
        (f"serial:{BY_PATH}", BY_PATH, 57600),
        (f"serial:{BY_PATH}:115200", BY_PATH, 115200),
        ("COM3", "COM3", 57600),
        ("COM3,57600", "COM3", 57600),
        ("serial:COM14:115200", "COM14", 115200),
        (r"\\.\COM14,115200", r"\\.\COM14", 115200),
    ],
)
def test_serial_ports(text: str, name: str, baud: int) -> None:
    assert parsed(text) == Device(text=text, name=name, baud=baud)
