"""Lines of Python by package, beside the budget of docs/architecture.md, for `scripts/check`."""

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
_PRODUCT = ("companion", "vehicle_sim")
_ROW = re.compile(r"^\| `([a-z_/, `]+)` \| ([\d,]+) \|$", re.MULTILINE)


def main() -> None:
    """A line for each row of the table; what stands in a row of its own counts there only."""
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    budget = {
        tuple(re.findall(r"[a-z_/]+", names)): int(lines.replace(",", ""))
        for names, lines in _ROW.findall(page)
    }
    owner = sorted(((path, row) for row in budget for path in row), reverse=True)
    count = dict.fromkeys(budget, 0)
    listed = subprocess.run(
        ["git", "ls-files", "*.py"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    for name in listed.stdout.splitlines():
        row = next((row for path, row in owner if name.startswith(path)), None)
        if row is not None and (ROOT / name).exists():
            count[row] += len((ROOT / name).read_text(encoding="utf-8").splitlines())
    for row, lines in count.items():
        print(f"{', '.join(row):60s} {lines:7,d} of {budget[row]:7,d}")
    product = sum(n for row, n in count.items() if row[0].startswith(_PRODUCT))
    allowed = sum(n for row, n in budget.items() if row[0].startswith(_PRODUCT))
    print(f"{'the product':60s} {product:7,d} of {allowed:7,d}")


if __name__ == "__main__":
    main()
