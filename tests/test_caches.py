"""What is kept to be quick is kept where only its user can write."""

import os
import tempfile
from pathlib import Path

import pytest

from companion import caches
from companion.caches import cache_folder


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the private folder would be, for a user whose home is read-only."""
    (tmp_path / "file").touch()  # not even root can write below it
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(caches, "user_cache_dir", lambda name: str(tmp_path / "file" / name))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    return tmp_path / "tmp" / f"companion-{os.geteuid()}"


def test_the_users_cache_comes_first(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    users = temporary.parent / "users"
    monkeypatch.setattr(caches, "user_cache_dir", lambda name: str(users / name))
    assert cache_folder() == users / "companion"
    assert not temporary.exists()


def test_where_home_is_read_only_a_private_folder_takes_its_place(temporary: Path) -> None:
    assert cache_folder() == temporary
    assert temporary.stat().st_mode & 0o077 == 0
    assert cache_folder() == temporary  # and again


def test_a_folder_that_is_not_ours_alone_is_not_used(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = temporary.parent / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    temporary.symlink_to(elsewhere)
    assert cache_folder() is None
    temporary.unlink()
    temporary.mkdir()
    temporary.chmod(0o777)  # others can write there
    assert cache_folder() is None
    temporary.with_name("companion-4711").mkdir(mode=0o700)
    monkeypatch.setattr(os, "geteuid", lambda: 4711)  # it is somebody else's
    assert cache_folder() is None
    monkeypatch.setattr(tempfile, "tempdir", str(temporary.parents[1] / "file"))
    assert cache_folder() is None
