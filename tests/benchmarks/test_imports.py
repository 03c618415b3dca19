"""Scripts find what they import where pytest's own paths are not set."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
IMPORT = """
import runpy, sys
from pathlib import Path
root, path, failed = Path.cwd(), sys.path[1:], []
ours = (str(root / "tests"), str(root / "scripts"))
for file in sorted(root.glob("scripts/benchmarks/*.py")):
    sys.path[:] = [str(file.parent), *path]
    for name, module in list(sys.modules.items()):  # as in a process of its own
        if str(getattr(module, "__file__", None)).startswith(ours):
            del sys.modules[name]
    try:
        runpy.run_path(str(file), run_name="imported")
    except ImportError as error:
        failed.append(f"{file.name}: {error}")
print(*failed, sep="; ", end="")
"""


def test_every_benchmark_finds_what_it_imports() -> None:
    found = subprocess.run(
        [sys.executable, "-c", IMPORT],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert found.stdout == ""
