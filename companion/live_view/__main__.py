"""The view of a flight that is flown: a process of its own, so that it cannot slow it down.

Its first line says where it serves, or why it does not; it ends with its standard input.
"""

import json
import os
import sys
import threading

import msgspec

from companion.errors import InputError
from companion.live_view.command import Asked
from companion.live_view.server import serve

_NICE = 5


def main() -> None:
    """Serve what the first line asks for."""
    os.nice(_NICE)
    asked = msgspec.json.decode(sys.stdin.readline(), type=Asked)
    over = threading.Event()
    said: list[object] = []

    def watch() -> None:
        sys.stdin.read()
        over.set()

    def say(line: object) -> None:
        said.append(line)
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()

    threading.Thread(target=watch, daemon=True).start()
    try:
        serve(asked, lambda address: say({"address": address}), over.is_set)
    except InputError as error:
        if said:  # nobody reads a second line
            sys.stderr.write(f"warning: no view any more: {error}\n")
        else:
            say({"error": [error.field, error.value, error.rule, error.remedy]})


if __name__ == "__main__":
    main()
