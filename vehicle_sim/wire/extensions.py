"""Messages with fields that the installed dialect does not know yet.

Fields that were added to a message later stand at the end of its payload and are not in its
checksum's extra byte, so a client that does not know them reads the rest.
"""

import struct
from typing import Any


def extended(base: Any, **fields: str) -> Any:
    """A message class with these fields too: name -> format of struct ("B", "H", "I").

    The class itself if it has them already.  Fields are given to it by name, all of them.
    """
    if set(fields) <= set(base.fieldnames):
        return base
    form = struct.Struct(base.unpacker.format + "".join(fields.values()))
    types = {"B": "uint8_t", "H": "uint16_t", "I": "uint32_t"}
    count = len(fields)

    class Extended(base):  # type: ignore[misc]
        fieldnames = (*base.fieldnames, *fields)
        ordered_fieldnames = (*base.ordered_fieldnames, *fields)
        fieldtypes = (*base.fieldtypes, *(types[code] for code in fields.values()))
        orders = (*base.orders, *range(len(base.orders), len(base.orders) + count))
        lengths = (*base.lengths, *[1] * count)
        array_lengths = (*base.array_lengths, *[0] * count)
        unpacker = form

        def __init__(self, **values: int) -> None:
            super().__init__(**{k: v for k, v in values.items() if k not in fields})
            self._fieldnames = list(self.fieldnames)
            for name in fields:
                setattr(self, name, values[name])

        def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
            values = (getattr(self, name) for name in self.ordered_fieldnames)
            packed: bytes = self._pack(
                mav, self.crc_extra, self.unpacker.pack(*values), force_mavlink1=force_mavlink1
            )
            return packed

    return Extended
