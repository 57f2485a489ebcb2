"""`Registry`: methods, effects or sinks by name, our own and those of plug-ins (entry points of installed packages).

Plug-ins are looked up only when a name is not our own, or when all names are listed, so that they do not slow a start.
A plug-in that cannot be loaded is an error where it is named, and is skipped where all are listed.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

from rb_dynamics.errors import PluginError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")
_log = logging.getLogger(__name__)


class Registry(Mapping[str, T]):
    """A mapping from names to objects of one kind; our own come first and cannot be replaced.

    Attributes:
        own: the objects of this package by name.
    """

    def __init__(self, kind: str, own: Mapping[str, T], fault: Callable[[str, object], str]) -> None:
        """Start with our own objects.

        Args:
            kind: what they are, in the singular; plug-ins declare theirs in the group `rb_dynamics.<kind>s`.
            own: ours by name.
            fault: given a name and the object of a plug-in, returns why it is not valid; "" if it is.
        """
        self.own: Mapping[str, T] = MappingProxyType(dict(own))
        self._kind, self._fault = kind, fault
        self._loaded: dict[str, T] = {}

    def __getitem__(self, name: str) -> T:
        """Return the object of this name.

        Raises:
            KeyError: there is none.
            PluginError: a plug-in declares it, but cannot be loaded.
        """
        if name in self.own:
            return self.own[name]
        if name not in self._loaded:
            self._loaded[name] = self._load(name, self._plugins[name])
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        """Return whether there is an object of this name, without loading it."""
        return name in self.own or name in self._plugins

    def __iter__(self) -> Iterator[str]:
        """Yield all names, our own first."""
        yield from self.own
        yield from (name for name in sorted(self._plugins) if name not in self.own)

    def __len__(self) -> int:
        """Return how many names there are."""
        return sum(1 for _ in self)

    def origin(self, name: str) -> str:
        """Return name and version of the package that `name` was loaded from; "" for our own."""
        return _package(self._plugins[name][0]) if name in self._loaded else ""

    def usable(self) -> Iterator[T]:
        """Yield all objects that can be loaded; warn of the others."""
        for name in self:
            try:
                found = self[name]
            except PluginError as error:
                _log.warning("%s", error)
            else:
                yield found

    @cached_property
    def _plugins(self) -> dict[str, list[EntryPoint]]:
        from importlib.metadata import entry_points

        found: dict[str, list[EntryPoint]] = {}
        for point in entry_points(group=f"rb_dynamics.{self._kind}s"):
            found.setdefault(point.name, []).append(point)
        return found

    def _load(self, name: str, points: list[EntryPoint]) -> T:
        where = " and ".join(f"{point.value} of the package {_package(point)}" for point in points)
        if len(points) > 1:
            raise PluginError(
                f"{self._kind} {name}: found {where}, expected one plug-in of that name; uninstall the others"
            )
        try:
            found: T = points[0].load()
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            raise PluginError(
                f"{self._kind} {name}: cannot be loaded from {where}: {type(error).__name__}: {error}; "
                "mend, update or uninstall that package"
            ) from error
        if fault := self._fault(name, found):
            raise PluginError(f"{self._kind} {name}: {where} is {fault}; mend, update or uninstall that package")
        return found


def _package(point: EntryPoint) -> str:
    return "?" if point.dist is None else f"{point.dist.name} {point.dist.version}"
