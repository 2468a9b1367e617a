"""Functions that a user names: `PACKAGE:FUNCTION`, or `FILE.py:FUNCTION`."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from mobo_tuner.errors import ParameterError


def load_function(place: str, name: str) -> Callable[..., Any]:
    """Return a function of a package or of a Python file.

    Args:
        place: Package, or name of a file that ends in `.py`.
        name: Name of the function.

    Raises:
        ParameterError: If it cannot be imported.
    """
    try:
        module = (
            _module_of_file(Path(place))
            if place.endswith(".py")
            else importlib.import_module(place)
        )
    except Exception as error:
        raise ParameterError(
            f"'{place}' cannot be imported: {type(error).__name__}: {error}"
        ) from error
    function = getattr(module, name, None)
    if not callable(function):
        raise ParameterError(f"'{place}' has no function '{name}'")
    found: Callable[..., Any] = function
    return found


def _module_of_file(path: Path) -> ModuleType:
    """Return the module in a Python file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ImportError("there is no such file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
