"""Packages that only some installations have: which extra brings which, and what to say without.

Whatever imports one of them calls `need` first.
"""

from importlib.util import find_spec

from companion.errors import InputError

PACKAGES = {
    "view": ("trimesh", "viser"),
    "campaign": ("dask", "distributed", "polars"),
    "compare": ("ompl",),
}
"""What each extra of pyproject.toml brings, by the names that are imported."""


def missing(extra: str) -> list[str]:
    """The packages of an extra that are not installed."""
    return [package for package in PACKAGES[extra] if find_spec(package) is None]


def need(extra: str, field: str, value: object = True) -> None:
    """InputError if an extra is not installed that this option, or this value of it, needs."""
    if absent := " and ".join(missing(extra)):
        remedy = f"In a checkout: scripts/setup.sh {extra}. Else: pip install 'companion[{extra}]'."
        raise InputError(field, value, f"not installed: {absent}", remedy)
