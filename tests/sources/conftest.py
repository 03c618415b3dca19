"""A folder with the files that missions of these tests name."""

import json
import shutil
from pathlib import Path

import pytest
from documents import collection, feature, terrain


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("files")
    terrain(path / "dem.tif")
    for name in ("no-terrain.tif", "N46E008.hgt"):
        (path / name).write_bytes(bytes(100))
    shutil.copytree(Path(__file__).parent / "missions", path, dirs_exist_ok=True)
    wood = [[8.01, 47.01], [8.02, 47.01], [8.02, 47.015], [8.01, 47.01]]
    zones = collection(feature("Polygon", [wood, wood], name="wood"))  # with a hole
    (path / "threats.geojson").write_text(json.dumps(zones), encoding="utf-8")
    return path
