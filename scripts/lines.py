"""Fails when a row of the budget in docs/architecture.md is exceeded, for `scripts/check`.

Lines of Python, blank ones and comments included, with the tables and templates that the programs
read; of scripts, all lines; of the pages that users read, words.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
_ROW = re.compile(r"^\| ([\w ]+) \| (`.+`) \| ([\d,]+) \|", re.MULTILINE)
_COUNTED = {".py", ".toml", ".j2", ".parm", ".table", ".boot"}
_FLOWN = re.compile(r"(mission|world)\.toml$|/missions/")
"""Missions and worlds are no code."""
_WORDS, _SCRIPTS = "pages for users", "scripts"
_FOR_ENGINEERS = {"docs/architecture.md", "docs/design.md"}


def budget_of(page: str) -> dict[str, tuple[tuple[str, ...], int]]:
    """Of each row of the table its name, where its files are, and what it may have."""
    return {
        name: (tuple(re.findall(r"`([^`]+)`", paths)), int(allowed.replace(",", "")))
        for name, paths, allowed in _ROW.findall(page)
    }


def counted(row: str, path: Path) -> int:
    """What a file adds to a row."""
    if row == _WORDS:
        return len(path.read_text(encoding="utf-8").split())
    if path.suffix not in _COUNTED and row != _SCRIPTS:
        return 0
    return len(path.read_text(encoding="utf-8").splitlines())


def row_of(name: str, budget: dict[str, tuple[tuple[str, ...], int]]) -> str | None:
    """The row with the longest path that a file's name begins with."""
    owners = [(path, row) for row, (paths, _) in budget.items() for path in paths]
    fits = [(len(path), row) for path, row in owners if name.startswith(path)]
    row = max(fits)[1] if fits else None
    is_page = name.endswith(".md") and name.count("/") < 2 and name not in _FOR_ENGINEERS
    return None if _FLOWN.search(name) or (row == _WORDS and not is_page) else row


def main() -> int:
    """Print a line for each row; 1 if one of them is exceeded."""
    budget = budget_of((ROOT / "docs/architecture.md").read_text(encoding="utf-8"))
    count = dict.fromkeys(budget, 0)
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True)
    for name in listed.stdout.decode().splitlines():
        row = row_of(name, budget)
        if row is not None and (ROOT / name).is_file():
            count[row] += counted(row, ROOT / name)
    for row, there in count.items():
        print(f"{row:20s} {there:7,d} of {budget[row][1]:7,d}")
    over = [row for row in budget if count[row] > budget[row][1]]
    for row in over:
        print(
            f"budget: {row} = {count[row]:,}: {budget[row][1]:,} are allowed"
            " (docs/architecture.md). Make what you add pay for itself,"
            " or lower another row by as much and say why.",
            file=sys.stderr,
        )
    return 1 if over else 0


if __name__ == "__main__":
    sys.exit(main())
