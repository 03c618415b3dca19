"""Parses connection strings."""

import contextlib
import errno
import re
import socket
from dataclasses import dataclass
from typing import Literal, final

from companion.errors import InputError

_OPTION = "--connect"
DEFAULT_BAUD = 57_600
_MAX_BAUD = 12_000_000
_REMEDY = (
    "Write udpin:127.0.0.1:14540 (wait for the vehicle), udpout:HOST:PORT, tcp:HOST:PORT (call "
    "it) or /dev/ttyACM0,57600 (serial port, baud rate)."
)
_WINDOWS_PORT = re.compile(r"(\\\\\.\\)?COM[0-9]{1,3}", re.IGNORECASE)
_DEVICE = r"(?:/dev/|tty|cu\.)[^,;@?\s]*?|(?:\\\\\.\\)?COM[0-9]{1,3}"
_DEVICE_AND_RATE = re.compile(
    rf"({_DEVICE})(?:[:;@ ]+([0-9]{{3,8}}))?(?:\?.*?baud=([0-9]+))?(?:[:,?].*)?",
    re.IGNORECASE,
)
"""A device, as others have it, and its rate behind a colon."""
_ADDRESS = re.compile(
    r"(?P<kind>[a-z][a-z0-9-]*):(?://)?(?:(?P<bound>[^@]*)@)?(?P<host>\[[^\]]*\]|[^:/?@]*)"
    r"(?::(?P<port>[0-9]{1,5}))?/?(?:\?.*)?",
    re.IGNORECASE,
)
"""As URLs of MAVSDK and MAVROS, and as mavp2p has them."""
_KINDS = {
    "udpin": ("udpin", "udps", "udpserver"),
    "udpout": ("udpout", "udpc", "udpclient", "udpcl", "udpbcast", "udpb", "udp-b", "udp-pb"),
    "tcp": ("tcp", "tcpout", "tcpc", "tcpclient"),
    "udp": ("udp",),
}
"""What is called so here, and by others; their udp may mean either way."""


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
    if rest.startswith("//") and kind in ("udpin", "udpout", "tcp", "serial"):
        rest = rest[2:]  # as MAVSDK has it; its udp:// may mean either way
    if kind in ("udp", "udpin", "udpout", "tcp"):
        return _address(connection, kind, rest)
    if kind == "serial" and "?" in rest:
        raise _otherwise(connection, "not a serial port")
    if kind == "serial":
        mark = "," if "," in rest else ":"
        name, _, baud = rest.rpartition(mark)
        if mark == ":" and not baud.isdecimal():  # a device by its path may have colons
            name, baud = rest, str(DEFAULT_BAUD)
        return _device(connection, name, baud)
    name, comma, baud = connection.partition(",")
    colon = _DEVICE_AND_RATE.fullmatch(name)
    if colon is not None and colon[2] is not None:
        raise _otherwise(connection)
    if name.startswith("/") or _WINDOWS_PORT.fullmatch(name):
        return _device(connection, name, baud if comma else str(DEFAULT_BAUD))
    raise _otherwise(connection, "not a connection string")


def _otherwise(connection: str, rule: str = "") -> InputError:
    """The error about a string that others would take, with what it is here; else the rule."""
    return InputError(_OPTION, connection, _here(connection) or rule, _REMEDY)


def _here(connection: str) -> str:
    """How others' notation is written here, as a rule; empty: it is nobody's."""
    kind, _, rest = connection.partition(":")
    device = rest.removeprefix("//") if kind.lower().startswith("serial") else connection
    if (serial_port := _DEVICE_AND_RATE.fullmatch(device.strip())) is not None:
        name, rate = serial_port[1], serial_port[2] or serial_port[3]
        name = f"/dev/{name}" if name.startswith(("tty", "cu.")) else name
        if rate is None:
            return f"a serial port is written {name}, or with its baud rate {name},{DEFAULT_BAUD}"
        return f"the baud rate of a serial port comes after a comma: {name},{rate}"
    for text in (connection, f"udp:{connection}"):
        if (found := _ADDRESS.fullmatch(text)) is not None:
            bound, host, port = found["bound"], found["host"], found["port"]
            kinds = [here for here, names in _KINDS.items() if found["kind"].lower() in names]
            if bound is not None:  # MAVROS: where it listens, @, whom it calls
                own_host, _, own_port = bound.rpartition(":")
                listens = own_port.isdecimal()
                kinds = ["udpin"] if listens else ["udpout"]
                host, port = (own_host, own_port) if listens else (host, port)
            elif port is None and host.isdecimal():
                host, port = "", host
            if kinds and port is not None:
                return _address_here(kinds[0], host, port)
    return ""


def _address_here(kind: str, host: str, port: str) -> str:
    """As `_here`, of an address."""
    if host in ("", "0.0.0.0", "[::]") and kind in ("udp", "udpin"):
        kind, host = "udpin" if kind == "udp" else kind, host or "0.0.0.0"
    where = f"{host or 'HOST'}:{port}"
    if kind == "udp":
        return f"udpin:{where} waits for the vehicle there, udpout:{where} calls it"
    return f"here that is written {kind}:{where}"


def _address(connection: str, kind: str, rest: str) -> Address:
    host, colon, port = rest.rpartition(":")
    brackets = host.startswith("[") and host.endswith("]")
    if ":" in host and not brackets and host.count(":") > 1 and "/" not in host:
        rule = f"an IPv6 address stands in brackets: {kind}:[{host}]:{port}"
        raise InputError(_OPTION, connection, rule, _REMEDY)
    if not host or not colon or "/" in rest or "@" in rest or (":" in host and not brackets):
        raise _otherwise(connection, f"not {kind}:HOST:PORT")
    host = host.strip("[]")
    kind = "udpin" if kind == "udp" else kind
    if not _is_number(port, 1, 65535):  # 0 would be one that nobody else knows
        rule = "a port is a number from 1 to 65535"
        raise InputError(_OPTION, connection, rule, _REMEDY)
    return Address(text=connection, kind=kind, host=host, port=int(port))  # type: ignore[arg-type]


def _device(connection: str, name: str, baud: str) -> Device:
    if not name:
        raise InputError(_OPTION, connection, "no device is named", _REMEDY)
    if not _is_number(baud, 1, _MAX_BAUD):
        rule = f"a baud rate is a number from 1 to {_MAX_BAUD}"
        raise InputError(_OPTION, connection, rule, _REMEDY)
    return Device(text=connection, name=name, baud=int(baud))


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
