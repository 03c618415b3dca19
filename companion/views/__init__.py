"""Figures, texts and the progress display of a flight."""

import os
from pathlib import Path

from platformdirs import user_cache_dir

from companion.caches import cache_folder

# Before matplotlib is loaded: where home is read-only, it warns of every start being slow.
_folder = cache_folder()
if _folder is not None and _folder != Path(user_cache_dir("companion")):
    os.environ.setdefault("MPLCONFIGDIR", str(_folder / "matplotlib"))
