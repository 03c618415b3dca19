"""Thousands of missions from one file, on all cores or on a cluster, and what came of each."""

from importlib import resources


def bundled_campaigns() -> list[str]:
    """The names of the campaigns that come with the package."""
    folder = resources.files("companion") / "campaign" / "bundled"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir())
