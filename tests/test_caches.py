"""What is kept to be quick is kept where only its user can write."""

import os
import tempfile
from pathlib import Path

import pytest

from companion import caches
from companion.caches import cache_folder


def test_it_is_the_users_cache_or_a_private_folder_or_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not one that others own, can write to or have put there: what is cached is run."""
    users, nowhere, temporary = tmp_path / "users", tmp_path / "file", tmp_path / "tmp"
    nowhere.touch()  # not even root can write below it
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.setattr(caches, "user_cache_dir", lambda name: str(users / name))
    private = temporary / f"companion-{os.geteuid()}"
    assert cache_folder() == users / "companion"
    assert not private.exists()
    monkeypatch.setattr(caches, "user_cache_dir", lambda name: str(nowhere / name))  # read-only
    for _ in range(2):
        assert cache_folder() == private
        assert private.stat().st_mode & 0o077 == 0
    private.rmdir()
    users.chmod(0o700)
    private.symlink_to(users)
    assert cache_folder() is None
    private.unlink()
    private.mkdir()
    private.chmod(0o777)
    assert cache_folder() is None
    private.with_name("companion-4711").mkdir(mode=0o700)
    monkeypatch.setattr(os, "geteuid", lambda: 4711)
    assert cache_folder() is None
    monkeypatch.setattr(tempfile, "tempdir", str(nowhere))
    assert cache_folder() is None
