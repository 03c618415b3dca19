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
    with pytest.raises(InputError, match="stands in brackets"):
        parsed(f"{kind}:fe80::1:14540")


@pytest.mark.parametrize("text", ["/dev/ttyACM0:57600", "/dev/ttyACM0 115200"])
def test_a_baud_rate_comes_after_a_comma(text: str) -> None:
    here = text.replace(":", ",").replace(" ", ",")
    with pytest.raises(InputError, match="comes after a comma"):
        parsed(text)
    assert isinstance(parsed(here), Device)


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
    ],
)
def test_serial_ports(text: str, name: str, baud: int) -> None:
    assert parsed(text) == Device(text=text, name=name, baud=baud)
