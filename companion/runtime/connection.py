"""Parses connection strings."""

import errno
import re
import socket
from dataclasses import dataclass
from typing import Literal, final

from companion.errors import InputError

DEFAULT_BAUD = 57_600
_MAX_BAUD = 12_000_000
_REMEDY = (
    "Write udpin:127.0.0.1:14540 (wait for the vehicle), udpout:HOST:PORT, tcp:HOST:PORT (call "
    "it), tcpin:HOST:PORT or /dev/ttyACM0,57600 (serial port, baud rate)."
)
_WINDOWS_PORT = re.compile(r"(\\\\\.\\)?COM[0-9]{1,3}", re.IGNORECASE)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """Address of a network link."""

    text: str
    """The original text, for error messages."""
    kind: Literal["udpin", "udpout", "tcp", "tcpin"]
    host: str
    port: int
    option: str = "--connect"
    """Command line option, for error messages."""

    def resolved(self) -> tuple[str, int]:
        """The numeric address; InputError if there is no such host."""
        try:
            return socket.gethostbyname(self.host), self.port
        except (OSError, UnicodeError) as error:
            raise InputError(self.option, self.text, "no such host", _REMEDY) from error


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """Which serial port, and how fast."""

    text: str
    name: str
    baud: int = DEFAULT_BAUD
    option: str = "--connect"


def parsed(connection: str, option: str = "--connect") -> Address | Device:
    """Parse a connection string; InputError names the option and the rule."""
    kind, _, rest = connection.partition(":")
    if kind in ("udp", "udpin", "udpout", "tcp", "tcpin"):
        return _address(option, connection, kind, rest)
    if kind == "serial":
        mark = "," if "," in rest else ":"
        name, _, baud = rest.rpartition(mark)
        if mark == ":" and not baud.isdecimal():  # a device by its path may have colons
            name, baud = rest, str(DEFAULT_BAUD)
        return _device(option, connection, name, baud)
    name, comma, baud = connection.partition(",")
    if name.startswith("/") or _WINDOWS_PORT.fullmatch(name):
        return _device(option, connection, name, baud if comma else str(DEFAULT_BAUD))
    raise InputError(option, connection, "not a connection string", _REMEDY)


def _address(option: str, connection: str, kind: str, rest: str) -> Address:
    host, colon, port = rest.partition(":")
    if not host or not colon or ":" in port:
        raise InputError(option, connection, f"not {kind}:HOST:PORT", _REMEDY)
    kind = "udpin" if kind == "udp" else kind
    if not _is_number(port, 1, 65535):  # 0 would be one that nobody else knows
        rule = "a port is a number from 1 to 65535"
        raise InputError(option, connection, rule, _REMEDY)
    return Address(text=connection, kind=kind, host=host, port=int(port), option=option)  # type: ignore[arg-type]


def _device(option: str, connection: str, name: str, baud: str) -> Device:
    if not name:
        raise InputError(option, connection, "no device is named", _REMEDY)
    if not _is_number(baud, 1, _MAX_BAUD):
        rule = f"a baud rate is a number from 1 to {_MAX_BAUD}"
        raise InputError(option, connection, rule, _REMEDY)
    return Device(text=connection, name=name, baud=int(baud), option=option)


def _is_number(text: str, lowest: int, highest: int) -> bool:
    plain = text.isascii() and text.isdecimal() and len(text) <= 8
    return plain and lowest <= int(text) <= highest


def refused(place: Address | Device, error: OSError) -> InputError:
    """The error about a port or device that cannot be opened."""
    remedies = {
        errno.EADDRINUSE: "End the program that uses the port, or choose another port on both "
        "sides.",
        errno.EACCES: "Let this user open it: sudo usermod -aG dialout $USER, then log in again.",
        errno.ENOENT: "Plug the device in, or look for its name with ls /dev/serial/by-id.",
        errno.EAGAIN: "End the program that uses the device.",
        errno.EBUSY: "End the program that uses the device.",
    }
    rule = f"it cannot be opened ({error.strerror or error})"
    remedy = remedies.get(error.errno or 0, "Give an address or a device of this computer.")
    return InputError(place.option, place.text, rule, remedy)
