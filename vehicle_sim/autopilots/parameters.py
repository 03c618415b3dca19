"""The autopilots' parameters: tables in `*.parm` beside them, a row a line in the wire's order."""

from collections.abc import Iterator
from importlib import resources

from vehicle_sim.parameters import Kind, Parameter

_KINDS = {"i8": Kind.INT8, "i16": Kind.INT16, "i32": Kind.INT32, "real": Kind.REAL32}


def lines_of(name: str, splits: int = -1) -> Iterator[list[str]]:
    """The words of each line of a table beside this module, split so often at most."""
    text = resources.files(__package__).joinpath(name).read_text("utf-8")
    for line in text.splitlines():
        if not line.startswith("#"):
            yield line.split(maxsplit=splits)


def table(*names: str) -> tuple[Parameter, ...]:
    """The rows of these files; a later one of the same name replaces the earlier one in its place.

    A line is name, default, type (a float without one), least and most.
    """
    rows: dict[str, Parameter] = {}
    for name in names:
        for key, default, *rest in lines_of(f"{name}.parm"):
            kind, limits = _KINDS[rest[0] if rest else "real"], map(float, rest[1:])
            bounds = dict(zip(("least", "most"), limits, strict=False))
            rows[key] = Parameter(name=key, default=float(default), kind=kind, **bounds)
    return tuple(rows.values())
