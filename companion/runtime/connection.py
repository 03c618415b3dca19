"""Parses connection strings."""

import errno
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
_REMEDIES: Final = {
    errno.EADDRINUSE: "End the program that uses the port, or choose another port on both sides.",
    errno.EACCES: "Let this user open it: sudo usermod -aG dialout $USER, then log in again.",
    errno.ENOENT: "Plug the device in, or look for its name with ls /dev/serial/by-id.",
    errno.EAGAIN: "End the program that uses the device.",
    errno.EBUSY: "End the program that uses the device.",
}
_NETWORK: Final = re.compile(
    r"(?:udp:|(udpin|udpout|tcp):(?://)?)(\[[^\s/@\[\]]+\]|[^\s/@:\[\]]+):(\d{1,5})", re.ASCII
)
"""As MAVSDK has it, with slashes; its udp:// may mean either way."""
_SERIAL: Final = re.compile(r"(/[^,?]+)(?:,(\d{1,8}))?", re.ASCII)
_SERIAL_OF_OTHERS: Final = re.compile(r"serial:(?://)?(/[^,?]+?)(?:[,:](\d{4,8}))?", re.ASCII)
_RATE_BEHIND: Final = re.compile(r".*[ :]\d{4,8}")
"""As others write the baud rate; no path of a device ends so."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """Address of a network link."""

    text: str
    """The original text, for error messages."""
    kind: str
    """udpin, udpout or tcp."""
    host: str
    port: int

    def resolved(self) -> tuple[socket.AddressFamily, tuple[str, int]]:
        """The kind of network and the numeric address; InputError if there is no such host."""
        try:
            found = socket.getaddrinfo(self.host, self.port)
        except (OSError, UnicodeError) as error:
            raise _wrong(self.text, "no such host") from error
        family, *_, address = min(found, key=lambda each: each[0] is not socket.AF_INET)
        return family, (str(address[0]), self.port)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """Which serial port, and how fast."""

    text: str
    name: str
    baud: int = DEFAULT_BAUD


def parsed(connection: str) -> Address | Device:
    """Parse a connection string; InputError names the rule."""
    if network := _NETWORK.fullmatch(connection):
        kind, host, port = network.groups()
        if not 1 <= int(port) <= 65535:  # 0 would be one that nobody else knows
            raise _wrong(connection, "a port is a number from 1 to 65535")
        return Address(text=connection, kind=kind or "udpin", host=host.strip("[]"), port=int(port))
    others = _SERIAL_OF_OTHERS.fullmatch(connection)
    if device := others or _SERIAL.fullmatch(connection):
        name, baud = device[1], int(device[2] or DEFAULT_BAUD)
        if not others and _RATE_BEHIND.fullmatch(name):
            raise _wrong(connection, "the baud rate of a serial port comes after a comma")
        if not 1 <= baud <= _MAX_BAUD:
            raise _wrong(connection, f"a baud rate is a number from 1 to {_MAX_BAUD}")
        return Device(text=connection, name=name, baud=baud)
    raise _wrong(connection, "not a connection string (an IPv6 address stands in brackets)")


def _wrong(connection: str, rule: str) -> InputError:
    return InputError(_OPTION, connection, rule, _REMEDY)


def refused(place: Address | Device, error: OSError) -> InputError:
    """The error about a port or device that cannot be opened."""
    rule = f"it cannot be opened ({error.strerror or error})"
    remedy = _REMEDIES.get(error.errno or 0, "Give an address or a device of this computer.")
    return InputError(_OPTION, place.text, rule, remedy)
