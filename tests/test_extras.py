"""What only some installations have is named, with the command that installs it."""

import re
import sys
import tomllib
from pathlib import Path

import pytest

from companion import extras
from companion.errors import InputError

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("extra", extras.PACKAGES)
def test_what_is_missing_is_named_with_the_command_that_installs_it(
    extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in extras.PACKAGES[extra]:
        monkeypatch.setitem(sys.modules, package, None)  # as if it were not installed
    with pytest.raises(InputError) as refused:
        extras.need(extra, "--option")
    said = str(refused.value)
    assert said.endswith(f"pip install 'companion[{extra}]'.")
    assert all(package in said for package in extras.PACKAGES[extra])


def test_each_package_of_an_extra_is_listed_and_imported_in_one_place() -> None:
    """By one package of ours: there whoever lacks it is told so."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for extra, wanted in project["optional-dependencies"].items():
        names = {re.split(r"[\[<>=;~ ]", each)[0] for each in wanted}
        assert names <= set(extras.PACKAGES[extra])
    importers: dict[str, set[str]] = {}
    for path in (ROOT / "companion").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for name in re.findall(r"^\s*(?:import|from) (\w+)", text, re.M):
            importers.setdefault(name, set()).add(path.relative_to(ROOT).parts[1])
    for package in (each for every in extras.PACKAGES.values() for each in every):
        assert len(importers.get(package, set())) <= 1, (package, importers[package])
