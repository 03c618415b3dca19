"""Which parameters the simulator's code names: those that it does not name do nothing.

python tests/vehicle_sim/parameter_names.py writes vehicle_sim/autopilots/without_effect.table.
"""

import ast
import textwrap
from collections.abc import Iterator
from pathlib import Path

import vehicle_sim
from vehicle_sim.autopilots.ardupilot.arducopter import ArduCopter
from vehicle_sim.autopilots.ardupilot.arduplane import ArduPlane
from vehicle_sim.autopilots.px4.autopilot import parameter_rows
from vehicle_sim.autopilots.px4.fixed_wing import Px4FixedWing
from vehicle_sim.autopilots.px4.multicopter import Px4Multicopter
from vehicle_sim.flight_controller import _STREAM_PARAMETERS

_FOLDER = Path(vehicle_sim.__file__).parent
TABLE = _FOLDER / "autopilots" / "without_effect.table"
_HEAD = """# Parameters that clients ask for and that have no effect here; made by
# tests/vehicle_sim/parameter_names.py.
"""
_PUT_TOGETHER = {
    *(
        f"MAV{n}_{part}"
        for n in (1, 2)
        for part in _STREAM_PARAMETERS.values()
        if part != "RAW_CTRL"
    ),
    *(f"BATT_{level}_{unit}" for level in ("LOW", "CRT") for unit in ("VOLT", "MAH")),
    *(f"RNGFND1_{end}" for end in ("MIN", "MAX")),
}
"""Names that the code puts together; ArduPilot's group RAW_CTRL has no messages."""


def words() -> Iterator[str]:
    """Of every string of the code that is no docstring."""
    for path in _FOLDER.rglob("*.py"):
        tree = ast.parse(path.read_text("utf-8"))
        docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
            if is_text and id(node) not in docs:
                yield from str(node.value).split()


def without_effect() -> set[str]:
    """All but the SIM_ parameters, which faults are made of."""
    known = set(words()) | _PUT_TOGETHER
    px4 = (parameter_rows(*each.TABLES) for each in (Px4Multicopter, Px4FixedWing))
    rows = {row.name for table in (ArduCopter.TABLE, ArduPlane.TABLE, *px4) for row in table}
    return {name for name in rows - known if not name.startswith("SIM_")}


if __name__ == "__main__":
    names = " ".join(sorted(without_effect()))
    TABLE.write_text(_HEAD + textwrap.fill(names, 190) + "\n", "utf-8")
