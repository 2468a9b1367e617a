"""Reading of YAML files, with every mistake said in one sentence."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

from mobo_tuner.core.sentence import SentenceError

MAX_VALUES = 100_000  # in a file, those that aliases repeat included


class ProblemError(SentenceError):
    """A problem that cannot be tuned; the message is one sentence for the user."""


def load_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML file that holds a mapping.

    Raises:
        ProblemError: it cannot be read, is not YAML, repeats a key or holds something else.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ProblemError(f"the file '{path}' cannot be read: {reason}") from None
    try:
        content = yaml.load(text, Loader=_UniqueKeyLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        what = getattr(error, "problem", None) or "cannot be parsed"
        raise ProblemError(f"the file '{path}' is not valid YAML{where}: {what}") from None
    except RecursionError:
        raise ProblemError(f"the file '{path}' is nested too deeply") from None
    except (AttributeError, ArithmeticError, TypeError, ValueError) as error:
        # Of a value that is none of the type it names, as in `!!timestamp x`.
        raise ProblemError(f"the file '{path}' is not valid YAML: {error}") from None
    if _count(content, {}) > MAX_VALUES:
        raise ProblemError(f"the file '{path}' holds more than the {MAX_VALUES} values allowed")
    if not isinstance(content, dict):
        raise ProblemError(f"the file '{path}' must hold a mapping of parameters")
    return content


def _count(value: Any, known: dict[int, float]) -> float:
    """Number of values within, each alias written out; infinite where one holds itself.

    A few aliases of aliases stand for more than any computer can write out.
    """
    if not isinstance(value, dict | list | tuple | set):
        return 1.0
    if id(value) not in known:
        known[id(value)] = math.inf  # until it is known
        inside = [*value, *value.values()] if isinstance(value, dict) else value
        known[id(value)] = 1.0 + sum(_count(item, known) for item in inside)
    return known[id(value)]


class _UniqueKeyLoader(yaml.SafeLoader):
    """YAML loader that refuses a key given twice, of which PyYAML would silently drop the first."""

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
