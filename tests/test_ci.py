"""A clone is set up by `scripts/setup.sh` with what its user needs, and nothing is missing."""

import re
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PINS = ROOT / "requirements"
WITHOUT_DEVELOPERS = """
import sys
class Refuses:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Refuses())
{compiles}
import {modules}
"""


@pytest.mark.parametrize(
    ("wanted", "modules"),
    [
        ("fly", "companion.cli, vehicle_sim.server"),
        ("view", "companion.live_view.page"),
        ("campaign", "companion.campaign.store, distributed, polars"),
        ("compare", "ompl"),
    ],
)
def test_a_clone_is_set_up_with_what_its_user_needs(wanted: str, modules: str) -> None:
    pins = {
        name: set(re.findall(r"^([\w.-]+)==", (PINS / f"{name}.txt").read_text("utf-8"), re.M))
        for name in ("dev", wanted)
    }
    only = pins["dev"] - pins[wanted]
    assert {"pytest", "hatchling"} <= only
    assert "viser" in only or wanted == "view"
    names = {
        module
        for module, distributions in packages_distributions().items()
        if {each.lower().replace("_", "-") for each in distributions} <= only
    }
    assert "pytest" in names
    setup = (ROOT / "scripts" / "setup.sh").read_text(encoding="utf-8")
    [compiles] = re.findall(r"^compiles='(.*?)\n[^\n]*load_proof\(\)'$", setup, re.M | re.S)
    program = WITHOUT_DEVELOPERS.format(names=names, compiles=compiles, modules=modules)
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, timeout=120)
