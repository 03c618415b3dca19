"""Text from outside, made fit to be shown: cleaned once, where it comes in.

What a vehicle, a log or a file of others says may hold escape sequences, line breaks or characters
that change the direction of writing: in a terminal they clear it, set its title or forge lines.
"""

import unicodedata
from typing import Any, Final

_SPACES: Final = frozenset("\t\n\v\f\r\x85\u2028\u2029")
_UNFIT: Final = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Categories of Unicode: controls (C0, C1, delete), formats (bidi), surrogates, separators."""
_INSTEAD: Final = "\ufffd"


def printable(text: str) -> str:
    """The text with a space for what breaks the line, and U+FFFD for what steers a terminal."""
    if text.isprintable():
        return text
    return "".join(
        " " if c in _SPACES else _INSTEAD if unicodedata.category(c) in _UNFIT else c for c in text
    )


def with_printable_texts(value: Any) -> Any:
    """Plain values (of TOML or JSON) with each text in them cleaned, keys too."""
    match value:
        case str():
            return printable(value)
        case dict():
            return {
                with_printable_texts(key): with_printable_texts(item) for key, item in value.items()
            }
        case list():
            return [with_printable_texts(item) for item in value]
        case _:
            return value
