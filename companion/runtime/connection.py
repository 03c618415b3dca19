"""Parses connection strings."""

import contextlib
import errno
import re
import socket
from dataclasses import dataclass
from typing import Final, Literal, final

from companion.errors import InputError

_OPTION: Final = "--connect"
DEFAULT_BAUD: Final = 57_600
_MAX_BAUD: Final = 12_000_000
_REMEDY: Final = (
    "Write udpin:127.0.0.1:14540 (wait for the vehicle), udpout:HOST:PORT, tcp:HOST:PORT (call "
    "it) or /dev/ttyACM0,57600 (serial port, baud rate)."
)
_HOST: Final = re.compile(r"[^\s/@:\[\]]+|\[[^\s/@\[\]]+\]")
_PORT: Final = re.compile(r"/.*|(\\\\\.\\)?COM[0-9]{1,3}", re.IGNORECASE)
"""A serial port: a file, or as Windows has it."""
_RATE_BEHIND: Final = re.compile(r"(.*)[ :]([0-9]{4,8})")
"""As others write the baud rate; no path of a device ends so."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """Address of a network link."""

    text: str
    """The original text, for error messages."""
    kind: Literal["udpin", "udpout", "tcp"]
    host: str
    port: int

    def resolved(self) -> tuple[socket.AddressFamily, tuple[str, int]]:
        """The kind of network and the numeric address; InputError if there is no such host."""
        try:
            with contextlib.suppress(socket.gaierror):
                return socket.AF_INET, (socket.gethostbyname(self.host), self.port)
            found = socket.getaddrinfo(self.host, self.port, socket.AF_INET6)
            return socket.AF_INET6, (str(found[0][4][0]), self.port)
        except (OSError, UnicodeError) as error:
            raise InputError(_OPTION, self.text, "no such host", _REMEDY) from error


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """Which serial port, and how fast."""

    text: str
    name: str
    baud: int = DEFAULT_BAUD


def parsed(connection: str) -> Address | Device:
    """Parse a connection string; InputError names the rule."""
    kind, _, rest = connection.partition(":")
    if kind != "udp":
        rest = rest.removeprefix("//")  # as MAVSDK has it; its udp:// may mean either way
    if kind in ("udp", "udpin", "udpout", "tcp"):
        return _address(connection, kind, rest)
    name, comma, baud = (rest if kind == "serial" else connection).partition(",")
    behind = _RATE_BEHIND.fullmatch(name)
    if behind is not None and kind == "serial" and not comma:
        name, comma, baud = behind[1], ",", behind[2]
    elif behind is not None and _PORT.fullmatch(behind[1]):
        rule = f"the baud rate of a serial port comes after a comma: {behind[1]},{behind[2]}"
        raise InputError(_OPTION, connection, rule, _REMEDY)
    if kind != "serial" and not _PORT.fullmatch(name):
        raise InputError(_OPTION, connection, "not a connection string", _REMEDY)
    if not name or "?" in name:
        raise InputError(_OPTION, connection, "no serial port is named", _REMEDY)
    if comma and not _is_number(baud, 1, _MAX_BAUD):
        rule = f"a baud rate is a number from 1 to {_MAX_BAUD}"
        raise InputError(_OPTION, connection, rule, _REMEDY)
    return Device(text=connection, name=name, baud=int(baud) if comma else DEFAULT_BAUD)


def _address(connection: str, kind: str, rest: str) -> Address:
    host, _, port = rest.rpartition(":")
    if host.count(":") > 1 and not host.startswith("["):
        rule = f"an IPv6 address stands in brackets: {kind}:[{host}]:{port}"
        raise InputError(_OPTION, connection, rule, _REMEDY)
    if not _HOST.fullmatch(host):
        raise InputError(_OPTION, connection, f"not {kind}:HOST:PORT", _REMEDY)
    if not _is_number(port, 1, 65535):  # 0 would be one that nobody else knows
        rule = "a port is a number from 1 to 65535"
        raise InputError(_OPTION, connection, rule, _REMEDY)
    kind = "udpin" if kind == "udp" else kind
    return Address(text=connection, kind=kind, host=host.strip("[]"), port=int(port))  # type: ignore[arg-type]


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
    return InputError(_OPTION, place.text, rule, remedy)
