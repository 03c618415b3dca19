"""Where programs keep what they can make again: compiled code, lists of fonts."""

import os
import stat
import tempfile
from pathlib import Path

from platformdirs import user_cache_dir


def cache_folder() -> Path | None:
    """The user's cache; where home is read-only, a private temporary folder; or None."""
    temporary = Path(tempfile.gettempdir()) / f"companion-{os.geteuid()}"
    for folder in (Path(user_cache_dir("companion")), temporary):
        if is_writable(folder) and (folder != temporary or _is_private(folder)):
            return folder
    return None


def is_writable(folder: Path) -> bool:
    """Whether files can be written into it; it is made if it is not there."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _is_private(folder: Path) -> bool:
    """Whether nobody else can have put anything there: what is cached is run."""
    about = folder.lstat()
    return (
        stat.S_ISDIR(about.st_mode)
        and about.st_uid == os.geteuid()
        and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    )
