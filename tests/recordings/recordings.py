"""The recorded flights, for those who read files: each is unpacked once in a checkout."""

import lzma
import os
import tempfile
from pathlib import Path

FOLDER = Path(__file__).parent
NAMES = tuple(sorted(path.stem for path in FOLDER.glob("*.xz")))
"""Of all of them: what README.md tells of."""
_UNPACKED = FOLDER / ".unpacked"


def recording(name: str) -> Path:
    """The flight in the file of this name, unpacked."""
    packed, path = FOLDER / f"{name}.xz", _UNPACKED / name
    if not path.exists() or path.stat().st_mtime_ns != packed.stat().st_mtime_ns:
        _unpack(packed, path)
    return path


def _unpack(packed: Path, path: Path) -> None:
    """Whole or not at all: other processes do the same at the same time, and read what is there."""
    _UNPACKED.mkdir(exist_ok=True)
    stamp = packed.stat()
    with tempfile.NamedTemporaryFile(dir=_UNPACKED, delete=False) as file:
        file.write(lzma.decompress(packed.read_bytes()))
    os.utime(file.name, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    Path(file.name).replace(path)
