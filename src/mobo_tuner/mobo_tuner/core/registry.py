"""Registries: what can be chosen by name in a parameter file, such as a kernel.

A class of the project enters a registry by the decorator `register`. An installed package adds its
own by an entry point of the registry's group, so that what a file names is never more than what
somebody installed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from functools import cached_property
from importlib.metadata import EntryPoints, entry_points
from typing import Any, Generic, TypeVar

from mobo_tuner.errors import ParameterError

T = TypeVar("T")
C = TypeVar("C")


class Registry(Collection[str], Generic[T]):
    """The classes of one kind, each by its name.

    Args:
        choice: Choice of the optimiser that names one of them.
        group: Group of the entry points by which installed packages add theirs.
        base: Class that each of them extends.
    """

    def __init__(self, choice: str, group: str, base: Callable[..., T]) -> None:
        self.group = group
        self._choice = choice
        self._base: Any = base
        self._classes: dict[str, type[T]] = {}

    def register(self, name: str) -> Callable[[type[C]], type[C]]:
        """Return a decorator that enters a class by a name."""

        def enter(found: type[C]) -> type[C]:
            self._classes[name] = self._checked(name, found)
            return found

        return enter

    def find(self, name: str) -> type[T]:
        """Return the class of a name.

        Raises:
            ParameterError: If there is none, or that of an installed package cannot be loaded.
        """
        if name not in self._classes:
            if name not in self._added.names:
                raise ParameterError(f"{self._choice} is {name!r}; allowed are {', '.join(self)}")
            try:
                loaded = self._added[name].load()
            except Exception as error:  # whatever the module of another package raises
                reason = f"{type(error).__name__}: {error}"
                raise ParameterError(
                    f"{self._choice} is {name!r}, which cannot be loaded: {reason}"
                ) from None
            self._classes[name] = self._checked(name, loaded)
        return self._classes[name]

    def _checked(self, name: str, found: Any) -> type[T]:
        if not isinstance(found, type) or not issubclass(found, self._base):
            raise ParameterError(
                f"{self._choice} is {name!r}, which must be a {self._base.__name__}, not {found!r}"
            )
        checked: type[T] = found
        return checked

    @cached_property
    def _added(self) -> EntryPoints:
        """Entry points of installed packages."""
        return entry_points(group=self.group)

    def __contains__(self, name: object) -> bool:
        """Whether a class has this name."""
        return name in self._classes or name in self._added.names

    def __iter__(self) -> Iterator[str]:
        """Names of the project's classes, then of those that installed packages add."""
        return iter([*self._classes, *sorted(self._added.names - self._classes.keys())])

    def __len__(self) -> int:
        """Number of names."""
        return len(self._classes.keys() | self._added.names)

    def __bool__(self) -> bool:
        """Whether it restricts anything: always, without a look at the installed packages."""
        return True
