"""Atomic writing of files, and reading of YAML with errors of one sentence."""

from __future__ import annotations

import contextlib
import math
import os
import re
from pathlib import Path
from typing import Any

import yaml

from mobo_tuner.errors import FileError

MAX_VALUES = 100_000  # in a file, including repetitions by aliases


def replace_file(path: Path, content: bytes) -> None:
    """Write a file atomically: a reader sees either the old or the new content.

    Raises:
        OSError: If it cannot be written; the old content remains.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


def load_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML file that holds a mapping.

    Raises:
        FileError: If the file cannot be read, is not YAML, repeats a key or holds no mapping.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise FileError(f"the file '{path}' cannot be read: {reason}") from None
    except (TypeError, ValueError):
        raise FileError(f"path is {path!r:.60}; the name of a file is allowed") from None
    try:
        content = yaml.load(text, Loader=_UniqueKeyLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        what = getattr(error, "problem", None) or "cannot be parsed"
        raise FileError(f"the file '{path}' is not valid YAML{where}: {what}") from None
    except RecursionError:
        raise FileError(f"the file '{path}' is nested too deeply") from None
    except (AttributeError, ArithmeticError, TypeError, ValueError) as error:
        # A value that does not have the type of its tag, as in `!!timestamp x`.
        raise FileError(f"the file '{path}' is not valid YAML: {error}") from None
    if _count(content, {}) > MAX_VALUES:
        raise FileError(f"the file '{path}' holds more than the {MAX_VALUES} values allowed")
    if not isinstance(content, dict):
        raise FileError(f"the file '{path}' must hold a mapping of parameters")
    return content


def load_value(text: str) -> Any:
    """Return what a text stands for as a value in a YAML file; the text itself if it cannot be one."""
    try:
        return yaml.load(text, Loader=_UniqueKeyLoader)
    except (yaml.YAMLError, RecursionError, ArithmeticError, TypeError, ValueError):
        return text


def _count(value: Any, known: dict[int, float]) -> float:
    """Return the number of values with expanded aliases; infinite if a value contains itself.

    A few nested aliases can expand to more values than fit in any memory.
    """
    if not isinstance(value, dict | list | tuple | set):
        return 1.0
    if id(value) not in known:
        known[id(value)] = math.inf  # until it is known
        inside = [*value, *value.values()] if isinstance(value, dict) else value
        known[id(value)] = 1.0 + sum(_count(item, known) for item in inside)
    return known[id(value)]


class _UniqueKeyLoader(yaml.SafeLoader):
    """YAML loader that rejects repeated keys, of which PyYAML would silently drop the first.

    Numbers are those of people and of YAML 1.2: `1e-6` is one, and `1:30`, `010` and `1_000`, which YAML 1.1
    takes for 90, 8 and 1000, are texts.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            key = getattr(key_node, "value", None)
            if isinstance(key, str):
                if key in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key '{key}' stands twice", key_node.start_mark
                    )
                seen.add(key)
        return super().construct_mapping(node, deep)


_NUMBERS = {
    "int": r"[-+]?(0|[1-9][0-9]*|0x[0-9a-fA-F]+)",
    "float": r"[-+]?(([0-9]+\.[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+|\.(inf|Inf|INF))"
    r"|\.(nan|NaN|NAN)",
}
_TAG = "tag:yaml.org,2002:"
_UniqueKeyLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag.removeprefix(_TAG) not in _NUMBERS]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _name, _pattern in _NUMBERS.items():
    _UniqueKeyLoader.add_implicit_resolver(
        f"{_TAG}{_name}", re.compile(f"^({_pattern})$"), list("-+.0123456789")
    )
