"""Parts by name: ours, and those that other distributions bring by their entry points."""

from collections import UserDict
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar, final

from companion.errors import InputError

Part = TypeVar("Part")


@final
class Parts(UserDict[str, Part]):
    """Parts by name: our own, and those of the entry points of a group.

    Own names win; their parts may be told as an entry point tells them ("module:name").  What is
    told so is imported when it is first taken out; of another distribution it is refused in one
    line, with the distribution's name, if it cannot be or is not of the right shape.
    """

    def __init__(
        self,
        group: str,
        own: Mapping[str, Part | str],
        *,
        what: str,
        check: Callable[[Part], str | None],
    ) -> None:
        """check: what is wrong with a part, in a few words; None: nothing.  what: as people say."""
        super().__init__({name: part for name, part in own.items() if not isinstance(part, str)})
        self._group, self._what, self._check = group, what, check
        self._own = {
            name: EntryPoint(name, part, group)
            for name, part in own.items()
            if isinstance(part, str)
        }

    def __missing__(self, name: str) -> Part:
        """Load it.  Raises KeyError if there is none, InputError if it is broken."""
        if name in self._own:
            part: Part = self._own[name].load()
        else:
            part = self._checked(_points_of(self._group)[name])
        self.data[name] = part
        return part

    def __contains__(self, name: object) -> bool:
        return name in (*self._own, *self.data, *_points_of(self._group))

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*self._own, *self.data, *_points_of(self._group)]))

    def __len__(self) -> int:
        return len([*iter(self)])

    def chosen(self, name: str, field: str) -> Part:
        """The part of this name; InputError about a field if there is none, or it is broken."""
        if name not in self:
            known = ", ".join(sorted(self))
            raise InputError(field, name, f"there is no such {self._what}", f"One of: {known}.")
        return self[name]

    def _checked(self, point: EntryPoint) -> Part:
        whose = point.dist.name if point.dist is not None else "an unknown distribution"
        try:
            part: Part = point.load()
            wrong = self._check(part)
        except Exception as error:  # noqa: BLE001 - code of others may raise anything
            wrong = " ".join(f"{type(error).__name__}: {error}".split())
        if wrong is not None:
            rule = f"the {self._what} of the distribution {whose} does not work ({wrong})"
            remedy = f"Correct {point.value}, or uninstall {whose}."
            raise InputError(self._what, point.name, rule, remedy)
        return part


@lru_cache
def _points_of(group: str) -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=group)}
