"""MAVSDK imports an exported .plan as one of QGroundControl's, and takes it to a vehicle."""

import ast
import json
import re
from pathlib import Path
from typing import Any

import pytest
from programs import free_port
from pymavlink.dialects.v20 import all as wire
from recorded import run_folder

from companion.replay.exporting import recorded
from companion.telemetry.export.plan import write_plan


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    flight, _ = recorded(run_folder(folder))
    write_plan(flight, folder / "flight.plan", "flown")
    return folder / "flight.plan"


@pytest.mark.parametrize(
    "environment", ["mavsdk", pytest.param("mavsdk-3", marks=pytest.mark.nightly)]
)
def test_mavsdk_finds_all_of_it_and_a_vehicle_takes_it(
    environment: str, plan_file: Path, fly: Any, client: Any
) -> None:
    port = free_port()
    url = f"udpin://127.0.0.1:{port}"
    other = client(environment, "mavsdk_plan.py", url, free_port(), plan_file)
    fly("--autopilot", "px4", "--connect", f"udpout:127.0.0.1:{port}", speedup=10)
    assert other.wait(60.0) == 0, other.transcript
    said = dict(re.findall(r"^(\w+): (\[.*\])$", other.transcript, re.MULTILINE))
    found = {name: ast.literal_eval(text) for name, text in said.items()}
    plan = json.loads(plan_file.read_text(encoding="utf-8"))
    items = plan["mission"]["items"]
    assert [each[0] for each in found["mission"]] == [item["command"] for item in items]
    for (_, frame, x, y, z), item in zip(found["mission"], items, strict=True):
        assert frame in (wire.MAV_FRAME_GLOBAL, wire.MAV_FRAME_GLOBAL_INT)
        latitude, longitude, altitude_m = item["params"][4:]
        assert (x, y) == pytest.approx((latitude * 1e7, longitude * 1e7), abs=1.0)
        assert z == pytest.approx(altitude_m, abs=0.001)
    without_frame = {
        name: [(c, *rest) for c, _, *rest in found[name]] for name in ("downloaded", "mission")
    }
    assert without_frame["downloaded"] == without_frame["mission"]
    fence = [each[0] for each in found["geofence"]]
    assert fence.count(wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION) == 3
    assert fence.count(wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION) == 4
    assert fence.count(wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION) == 1
    assert [wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, 400.0] in [list(r) for r in found["radii"]]
    [rally] = plan["rallyPoints"]["points"]
    [(_, _, x, y, z)] = found["rally"]
    assert (x, y, z) == pytest.approx((rally[0] * 1e7, rally[1] * 1e7, rally[2]), abs=1.0)
    assert "session complete" in other.transcript
