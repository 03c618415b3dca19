"""Inner loops as plain Python that numba compiles when they are first called."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

_P = ParamSpec("_P")
_R = TypeVar("_R")


def compiled(*helpers: Callable[..., Any]) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """The decorated function, compiled; `helpers`: the functions of its file that it calls.

    The first time that takes a second or two; then it is loaded from numba's cache on disk, if that
    can be written to.
    """

    def decorate(function: Callable[_P, _R]) -> Callable[_P, _R]:
        @functools.cache
        def kernel() -> Any:
            import numba  # half a second: not for those who need none
            from numba.extending import register_jitable

            for helper in helpers:
                register_jitable(helper)
            try:
                return numba.njit(cache=True)(function)
            except RuntimeError:  # nowhere to write
                return numba.njit(function)

        @functools.wraps(function)
        def call(*arguments: _P.args, **_: _P.kwargs) -> _R:
            return kernel()(*arguments)

        return call

    return decorate
