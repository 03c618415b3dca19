"""Third-party notices, from the metadata of what is installed, for `scripts/notices`."""

import sys
import tomllib
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
_HEAD = """# Third-party notices

The project is licensed under the [Apache licence 2.0](LICENSE). It contains no code of others.
These packages are installed with it, by the extras of the last column, each under its own licence,
the text of which lies beside the package (`NAME.dist-info`). Written by `scripts/notices`.

| package | licence | with |
|---|---|---|
"""


def needed(requirements: list[str]) -> dict[str, Distribution]:
    """What these requirements bring on this machine, by name, with all that they need in turn."""
    found = dict[str, Distribution]()
    wanted = [Requirement(each) for each in requirements]
    while wanted:
        requirement = wanted.pop()
        name = canonicalize_name(requirement.name)
        extras = requirement.extras or {""}
        if name in found and extras == {""}:
            continue
        found[name] = distribution(name)
        for each in map(Requirement, found[name].requires or ()):
            if each.marker is None or any(each.marker.evaluate({"extra": e}) for e in extras):
                wanted.append(each)
    return found


def licence(package: Distribution) -> str:
    """As its authors declare it: by an expression, by a classifier, or by a word."""
    about = package.metadata
    classified = [
        each.rpartition(" :: ")[2]
        for each in about.get_all("Classifier") or ()
        if each.startswith("License :: ") and not each.endswith(":: OSI Approved")
    ]
    words = (about.get("License") or "").strip().splitlines()
    return about.get("License-Expression") or ", ".join(classified) or (words or ["not stated"])[0]


def main() -> None:
    """Print the page."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    parts = {"always": project["dependencies"], **project["optional-dependencies"]}
    rows: dict[str, tuple[str, list[str]]] = {}
    for part, requirements in parts.items():
        for name, package in needed(requirements).items():
            rows.setdefault(name, (licence(package), []))[1].append(part)
    sys.stdout.write(_HEAD)
    for name, (terms, users) in sorted(rows.items()):
        extras = "" if "always" in users else ", ".join(users)
        sys.stdout.write(f"| {name} | {terms} | {extras} |\n")


if __name__ == "__main__":
    main()
