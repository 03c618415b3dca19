"""The autopilots' parameters: tables in `*.parm` beside them, a row a line in the wire's order."""

from importlib import resources

from vehicle_sim.parameters import Kind, Parameter

_KINDS = {"i8": Kind.INT8, "i16": Kind.INT16, "i32": Kind.INT32, "real": Kind.REAL32}


def table(*names: str) -> tuple[Parameter, ...]:
    """The rows of these files; a later one of the same name replaces the earlier one in its place.

    A line is name, default, type (a float without one), least and most.
    """
    rows: dict[str, Parameter] = {}
    for name in names:
        text = resources.files(__package__).joinpath(f"{name}.parm").read_text("utf-8")
        for line in text.splitlines():
            if not line.startswith("#"):
                key, default, *rest = line.split()
                kind, limits = _KINDS[rest[0] if rest else "real"], map(float, rest[1:])
                bounds = dict(zip(("least", "most"), limits, strict=False))
                rows[key] = Parameter(name=key, default=float(default), kind=kind, **bounds)
    return tuple(rows.values())
