from pathlib import Path

import pytest
from recorded import run_folder


@pytest.fixture(scope="session")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a short flight; only to be read."""
    return run_folder(tmp_path_factory.mktemp("recorded"))
