"""What `companion` answers, in this process; and what a page says."""

import contextlib
import io
import os
import re
import sys

import lxml.html
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


def words_of(page: str) -> str:
    """What a person reads on it, without its figures."""
    read = lxml.html.fromstring(page)
    for drawn in read.xpath("//style | //*[local-name() = 'svg']"):
        drawn.drop_tree()
    return " ".join(" ".join(read.itertext()).split()).replace(" : ", ": ")


def assert_it_loads_nothing(page: str) -> None:
    """It is whole, and nothing on it is run."""
    read = lxml.html.fromstring(page)
    loads = {"script", "link", "iframe", "object", "embed", "base", "form", "img"}
    assert not loads & {each.tag for each in read.iter()}
    assert not read.xpath("//@*[starts-with(name(), 'on')]")
    links = {"src", "href", "xlink:href", "action", "srcset", "data", "poster"}
    for link in (each.get(name) for each in read.iter() for name in links & {*each.keys()}):
        assert link.startswith(("#", "data:image/png;base64,"))
    assert "@import" not in page
    assert all(url.startswith("#") for url in re.findall(r"url\(([^)]*)\)", page))
    assert "default-src 'none'" in page
