"""Registries of classes that a parameter file chooses by name, such as kernels.

A class of the project is added by the decorator `register`, a class of an installed package by an
entry point of the registry's group. So a file can only name installed classes.
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
    """The classes of one kind by name.

    Args:
        choice: Setting of the optimiser that selects one of the classes.
        group: Group of the entry points with which installed packages add classes.
        base: Base class of all classes.
    """

    def __init__(self, choice: str, group: str, base: Callable[..., T]) -> None:
        self.group = group
        self._choice = choice
        self._base: Any = base
        self._classes: dict[str, type[T]] = {}

    def register(self, name: str) -> Callable[[type[C]], type[C]]:
        """Return a decorator that adds a class under a name."""

        def enter(found: type[C]) -> type[C]:
            self._classes[name] = self._checked(name, found)
            return found

        return enter

    def find(self, name: str) -> type[T]:
        """Return the class with a name.

        Raises:
            ParameterError: If there is no such class, or that of an installed package cannot be
                loaded.
        """
        if name not in self._classes:
            if name not in self._added.names:
                raise ParameterError(f"{self._choice} is {name!r}; allowed are {', '.join(self)}")
            try:
                loaded = self._added[name].load()
            except Exception as error:  # the module of another package may raise any exception
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
        """Return whether a class has this name."""
        return name in self._classes or name in self._added.names

    def __iter__(self) -> Iterator[str]:
        """Return the names of the project's classes, then of those that installed packages add."""
        return iter([*self._classes, *sorted(self._added.names - self._classes.keys())])

    def __len__(self) -> int:
        """Return the number of names."""
        return len(self._classes.keys() | self._added.names)

    def __bool__(self) -> bool:
        """Return True: a registry always restricts a choice; installed packages are not searched."""
        return True
