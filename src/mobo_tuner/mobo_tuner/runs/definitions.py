"""Message definitions and type hashes of the installed interface packages.

A bag contains them, so that its messages can be decoded without the packages. The text is that of the
`.msg` files, including comments and units.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MAX_TEXT = 1 << 17  # characters of a definition that is parsed


class DefinitionError(LookupError):
    """A type whose definition is not installed; the message is one sentence for the user."""


@dataclass(frozen=True)
class Definition:
    """The data of a message type in a bag.

    `text` is its `.msg` file followed by those of all types that it uses, divided as rosbag2 does;
    `type_hash` is its hash after REP 2011, ``RIHS01_...``.
    """

    text: str
    type_hash: str


def find_definition(type_name: str, prefixes: Sequence[Path] | None = None) -> Definition:
    """Return the definition of a message type such as ``std_msgs/msg/String``.

    Args:
        type_name: Name of a message type, which does not belong to a service or an action.
        prefixes: Installation prefixes in the order of their priority; None for those of
            AMENT_PREFIX_PATH and that of this Python.

    Raises:
        DefinitionError: If the type or one that it uses is not installed there, or is damaged.
    """
    prefixes = default_prefixes() if prefixes is None else prefixes
    try:
        description = json.loads(_read(type_name, ".json", prefixes))
        hashes = {item["type_name"]: item["hash_string"] for item in description["type_hashes"]}
        type_hash = hashes[type_name]
        used = [
            item["type_name"]
            for item in description["type_description_msg"]["referenced_type_descriptions"]
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise DefinitionError(
            f"the installed description of {type_name} is damaged: {error!r}"
        ) from None
    parts = [_read(type_name, ".msg", prefixes)]
    for name in used:
        package, _, short_name = name.split("/")
        parts.append(f"{'=' * 80}\nMSG: {package}/{short_name}\n{_read(name, '.msg', prefixes)}")
    return Definition("\n".join(parts), type_hash)


def same_fields(type_name: str, text: str, other: str) -> bool:
    """Return whether two definitions give a type, and the types in it, the same fields.

    Comments, blank lines, constants and the order of the types do not count. A text is not trusted: one that cannot
    be parsed is not the same.
    """
    if text == other:
        return True
    if len(text) > MAX_TEXT:
        return False
    try:
        return _fields(type_name, text) == _fields(type_name, other)
    except Exception:  # the parser raises any exception
        return False


def _fields(type_name: str, text: str) -> dict[str, list[Any]]:
    """Return the fields of a type and of all types in it."""
    from rosbags.typesys import get_types_from_msg  # a recorder does not need it

    types = get_types_from_msg(text, type_name)
    found: dict[str, list[Any]] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop()
        if name not in found:
            _, found[name] = types[name]
            waiting += [used for _, kind in found[name] for used in _names(kind)]
    return found


def _names(kind: Any) -> list[str]:
    """Return the name of a field's type if it is a message."""
    from rosbags.interfaces import Nodetype

    node, content = kind
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _names(content[0])
    return [content] if node == Nodetype.NAME else []


def default_prefixes() -> list[Path]:
    """Return the prefixes of interface packages: AMENT_PREFIX_PATH, then this Python's prefix."""
    listed = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [Path(prefix) for prefix in [*listed, sys.prefix] if prefix]


def _read(type_name: str, suffix: str, prefixes: Sequence[Path]) -> str:
    parts = type_name.split("/")
    if len(parts) == 3 and parts[1] == "msg":
        for prefix in prefixes:
            path = prefix / "share" / parts[0] / "msg" / f"{parts[2]}{suffix}"
            try:
                return path.read_text(encoding="utf-8")
            except OSError:
                continue
    raise DefinitionError(f"the definition of {type_name} is not installed")
