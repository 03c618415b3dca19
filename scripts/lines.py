"""Fails when a row of the budget in docs/architecture.md is exceeded, for `scripts/check`.

Lines of Python, blank ones and comments included, with the tables and templates that the programs
read; of scripts, all lines; of the pages that users read, words.  A file counts in the row with the
longest path that its name begins with.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
_ROW = re.compile(r"^\| ([\w ]+) \| (`.+`) \| ([\d,]+) \|", re.MULTILINE)
_COUNTED = (".py", ".toml", ".j2", ".parm", ".table", ".boot")
_NO_CODE = re.compile(r"(mission|world)\.toml$|/missions/")
_PAGE = re.compile(r"(?!docs/(architecture|decisions|design)\.md)([^/]+/)?[^/]+\.md")
"""Those for users: no lab notes and references, and none for engineers."""
_WORDS, _SCRIPTS = "pages for users", "scripts"


def main() -> int:
    """Print a line for each row; 1 if one of them is exceeded."""
    rows = _ROW.findall((ROOT / "docs/architecture.md").read_text(encoding="utf-8"))
    owners = {path: row for row, paths, _ in rows for path in re.findall(r"`([^`]+)`", paths)}
    count = dict.fromkeys((row for row, _, _ in rows), 0)
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True)
    for name in listed.stdout.decode().splitlines():
        row = owners.get(max(filter(name.startswith, owners), key=len, default=""))
        if row is None or _NO_CODE.search(name) or not (ROOT / name).is_file():
            continue
        if row == _WORDS and _PAGE.fullmatch(name):
            count[row] += len((ROOT / name).read_text(encoding="utf-8").split())
        elif row == _SCRIPTS or (row != _WORDS and name.endswith(_COUNTED)):
            count[row] += len((ROOT / name).read_text(encoding="utf-8").splitlines())
    over = False
    for row, _, figure in rows:
        allowed = int(figure.replace(",", ""))
        print(f"{row:20s} {count[row]:7,d} of {allowed:7,d}")
        if count[row] > allowed:
            over = True
            print(
                f"budget: {row} = {count[row]:,}: {allowed:,} are allowed"
                " (docs/architecture.md). Make what you add pay for itself,"
                " or lower another row by as much and say why.",
                file=sys.stderr,
            )
    return int(over)


if __name__ == "__main__":
    sys.exit(main())
