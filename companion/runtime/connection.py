"""Parses connection strings."""

import re
import socket
from dataclasses import dataclass
from typing import Final, final

from companion.errors import InputError

_OPTION: Final = "--connect"
DEFAULT_BAUD: Final = 57_600
_MAX_BAUD: Final = 12_000_000
_REMEDY: Final = (
    "Write udpin:127.0.0.1:14540 (wait for the vehicle), udpout:HOST:PORT, tcp:HOST:PORT (call "
    "it) or /dev/ttyACM0,57600 (serial port, baud rate)."
)
_NOT_OPENED: Final = (
    "Give an address or a device of this computer; end the program that uses it, or choose another "
    "port; plug a device in, and let this user open it: sudo usermod -aG dialout $USER."
)
_NETWORK: Final = re.compile(
    r"(?:udp:|(udpin|udpout|tcp):(?://)?)(\[[^\s/@\[\]]+\]|[^\s/@:\[\]]+):(\d{1,5})", re.ASCII
)
"""As MAVSDK has it, with slashes; its udp:// may mean either way."""
_SERIAL: Final = re.compile(r"(?:serial:(?://)?)?(/[^,?]+?)(?:[,:](\d{4,8}))?", re.ASCII)
"""As pymavlink and as MAVSDK have it."""


@final
@dataclass(frozen=True, slots=True)
class Connection:
    """A connection string in its parts."""

    text: str
    """All of it, for error messages."""
    kind: str
    """udpin, udpout, tcp or serial."""
    name: str
    """The host, or the device."""
    number: int
    """The port, or the baud rate."""

    def resolved(self) -> tuple[socket.AddressFamily, tuple[str, int]]:
        """The kind of network and the numeric address; InputError if there is no such host."""
        try:
            addresses = socket.getaddrinfo(self.name, self.number)
        except (OSError, UnicodeError) as error:
            raise _wrong(self.text, "no such host") from error
        family, *_, address = min(addresses, key=lambda entry: entry[0] is not socket.AF_INET)
        return family, (str(address[0]), self.number)

    def refused(self, error: Exception) -> InputError:
        """The error about a port or device that cannot be opened."""
        rule = f"it cannot be opened ({getattr(error, 'strerror', None) or error})"
        return InputError(_OPTION, self.text, rule, _NOT_OPENED)


def parsed(text: str) -> Connection:
    """Parse a connection string; InputError names the rule."""
    if network := _NETWORK.fullmatch(text):
        kind, host, port = network.groups()
        if not 1 <= int(port) <= 65535:  # 0 would be one that nobody else knows
            raise _wrong(text, "a port is a number from 1 to 65535")
        return Connection(text, kind or "udpin", host.strip("[]"), int(port))
    if device := _SERIAL.fullmatch(text):
        name, baud = device[1], int(device[2] or DEFAULT_BAUD)
        if not 1 <= baud <= _MAX_BAUD:
            raise _wrong(text, f"a baud rate is a number from 1 to {_MAX_BAUD}")
        return Connection(text, "serial", name, baud)
    raise _wrong(text, "not a connection string (an IPv6 address stands in brackets)")


def _wrong(text: str, rule: str) -> InputError:
    return InputError(_OPTION, text, rule, _REMEDY)
