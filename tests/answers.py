"""What `companion` answers, in this process."""

import contextlib
import io
import os
import sys

import pytest

from companion.cli import main


def answered(*arguments: object) -> tuple[object, str, str]:
    """Exit code, and what is printed and said of errors, in this process: there are many."""
    shown, said = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(shown),
        contextlib.redirect_stderr(said),
    ):
        patch.setattr(sys, "argv", ["companion", *map(str, arguments)])
        patch.setenv("NUMBA_CACHE_DIR", os.environ.get("NUMBA_CACHE_DIR", ""))
        with pytest.raises(SystemExit) as ended:
            main()
    return ended.value.code, shown.getvalue(), said.getvalue()
