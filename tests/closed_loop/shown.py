"""The flight of the hills once more, on a terminal, with JSON to a pipe, and on a full disk."""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import threading
from pathlib import Path

from flights import _ENVIRONMENT, BAD_LINK, flown_as, simulator, warm_up
from programs import ROOT, free_port

WIDTH = 80
MOST_BYTES = 900_000
"""The operating system refuses more than so many bytes of any file of the companion's."""
_FLY = (
    f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({MOST_BYTES},) * 2)\n"
    "from companion.cli import main\nmain()"
)
_ENDS_S = 400.0


class Shown:
    """A flight of the hills that is shown on a terminal, and as JSON to a pipe."""

    def __init__(self, folder: Path) -> None:
        world, mission, *options = flown_as("hills")
        port, out = free_port(), os.pipe()
        fcntl.fcntl(out[1], fcntl.F_SETPIPE_SZ, 4096)
        us, them = pty.openpty()
        fcntl.ioctl(them, termios.TIOCSWINSZ, struct.pack("HHHH", 24, WIDTH, 0, 0))
        how = ("--lockstep", "--json", "--connect", f"udpin:127.0.0.1:{port}", "--out", folder)
        warm_up()
        self.folder = folder
        self.process = subprocess.Popen(
            [*(sys.executable, "-c", _FLY, "fly", mission), *options, *how],
            stdin=them,
            stdout=out[1],
            stderr=them,
            cwd=ROOT,
            env={**_ENVIRONMENT, "TERM": "xterm-256color", "COLUMNS": f"{WIDTH}"},
        )
        os.close(them)
        os.close(out[1])
        self.screen, self.json = b"", b""
        ends = ((self._watch, us), (self._read, out[0]))
        threads = [threading.Thread(target=each, args=(end,)) for each, end in ends]
        for thread in threads:
            thread.start()
        try:
            where = ("--connect", f"udpout:127.0.0.1:{port}", "--lockstep", *BAD_LINK)
            vehicle = simulator(world, folder.parent / "truth", *where)
            self.code = self.process.wait(_ENDS_S)
            vehicle.wait()
        finally:
            self.process.kill()
        for thread in threads:
            thread.join()

    @property
    def text(self) -> str:
        """What was written on the terminal, without colours and moves of the cursor."""
        return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", self.screen.decode())

    def _watch(self, terminal: int) -> None:
        try:
            while part := os.read(terminal, 65536):
                self.screen += part
        except OSError:  # Linux's end of a terminal
            os.close(terminal)

    def _read(self, pipe: int) -> None:
        while part := os.read(pipe, 65536):
            self.json += part
        os.close(pipe)
