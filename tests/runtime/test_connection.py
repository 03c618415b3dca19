"""What connection strings mean; `test_link` has those that mean nothing."""

import pytest

from companion.runtime.connection import Address, Device, parsed


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("udpin:0.0.0.0:14540", "udpin"),
        ("udp:0.0.0.0:14540", "udpin"),
        ("udpout:192.168.1.10:14550", "udpout"),
        ("tcp:vehicle.local:5760", "tcp"),
        ("tcpin:0.0.0.0:5760", "tcpin"),
    ],
)
def test_networks(text: str, kind: str) -> None:
    place = parsed(text)
    assert isinstance(place, Address)
    assert place.kind == kind
    assert text.endswith(f"{place.host}:{place.port}")


BY_PATH = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0"


@pytest.mark.parametrize(
    ("text", "name", "baud"),
    [
        ("/dev/ttyACM0", "/dev/ttyACM0", 57600),
        ("/dev/ttyAMA0,921600", "/dev/ttyAMA0", 921600),
        ("serial:/dev/ttyUSB0:921600", "/dev/ttyUSB0", 921600),
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
