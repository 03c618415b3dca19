"""Parts by name: ours, and those that other distributions bring by their entry points."""

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar, cast, final

from companion.errors import InputError

Part = TypeVar("Part")


@final
class Parts(MutableMapping[str, Part]):
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
        self._group, self._what, self._check = group, what, check
        self._parts: dict[str, Part | str] = dict(own)

    def __getitem__(self, name: str) -> Part:
        """The part.  Raises KeyError if there is none, InputError if it is broken."""
        part = self._parts.get(name)
        if part is None:
            part = self._loaded(_found(self._group)[name])
        elif isinstance(part, str):
            part = cast("Part", EntryPoint(name, part, self._group).load())
        self._parts[name] = part
        return part

    def __setitem__(self, name: str, part: Part) -> None:
        self._parts[name] = part

    def __delitem__(self, name: str) -> None:
        del self._parts[name]

    def __contains__(self, name: object) -> bool:
        return name in self._parts or name in _found(self._group)

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*self._parts, *_found(self._group)]))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def chosen(self, name: str, field: str) -> Part:
        """The part of this name; InputError about a field if there is none, or it is broken."""
        if name not in self:
            known = ", ".join(sorted(self))
            raise InputError(field, name, f"there is no such {self._what}", f"One of: {known}.")
        return self[name]

    def _loaded(self, point: EntryPoint) -> Part:
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
def _found(group: str) -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=group)}
