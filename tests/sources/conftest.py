"""A folder with the files that missions of these tests name."""

import json
import shutil
from pathlib import Path

import pytest
from documents import terrain, threats


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("files")
    terrain(path / "dem.tif")
    (path / "no-terrain.tif").write_bytes(bytes(100))
    shutil.copy(Path(__file__).parent / "missions" / "fenced.plan", path)
    (path / "threats.geojson").write_text(json.dumps(threats()), encoding="utf-8")
    return path
