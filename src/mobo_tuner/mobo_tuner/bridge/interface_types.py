"""Types of any installed package by their name, and their fields by paths.

Only names of the form ``package/msg/Type`` (or srv, action) are loaded, and nothing is evaluated.
"""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

from mobo_tuner.bridge.field_path import Element, Field, FieldPath, Selection, Step

_TYPE_NAME = re.compile(r"[a-z][a-z0-9_]*/(msg|srv|action)/[A-Z][A-Za-z0-9]*")
_INTEGER = re.compile(r"(?P<unsigned>u?)int(?P<bits>8|16|32|64)")
_FLOATS = ("float", "double")
_BOOLEAN = "boolean"
_LARGEST_FLOAT32 = 3.4028234e38


class FieldError(ValueError):
    """A field that does not exist or has the wrong type; the message is one sentence."""


def load_type(type_name: str) -> Any:
    """Return the Python class of a type such as ``std_msgs/msg/Float64``.

    Raises:
        FieldError: If the name is not a type's name, or the type is not installed.
    """
    if not _TYPE_NAME.fullmatch(type_name):
        raise FieldError(f"{type_name!r} is not a type's name, such as std_msgs/msg/Float64")
    package, kind, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError):
        raise FieldError(f"the type {type_name} is not installed") from None


def check_readable(message_type: Any, path: FieldPath) -> None:
    """Check that a path leads to a number, a boolean or a string.

    Raises:
        FieldError: If it does not.
    """
    slot = _leaf(message_type, path)
    if not (isinstance(slot, AbstractString) or _is_number(slot) or _is_boolean(slot)):
        raise FieldError(
            f"{path} is {_describe(slot)}; a number, a boolean or a string is required"
        )


def check_boolean(message_type: Any, path: FieldPath) -> None:
    """Check that a path leads to a boolean.

    Raises:
        FieldError: If it does not.
    """
    slot = _leaf(message_type, path)
    if not _is_boolean(slot):
        raise FieldError(f"{path} is {_describe(slot)}; a boolean is required")


def check_time(message_type: Any, path: FieldPath) -> None:
    """Check that a path leads to a time.

    Raises:
        FieldError: If it does not.
    """
    slot = _leaf(message_type, path)
    if _describe(slot) != "builtin_interfaces/msg/Time":
        raise FieldError(f"{path} is {_describe(slot)}; builtin_interfaces/msg/Time is required")


def read(message: Any, path: FieldPath) -> Any:
    """Return the value at a path.

    Raises:
        FieldError: If an array has no such element.
    """
    parent, value = None, message
    for step in path.steps:
        if isinstance(step, Field):
            parent, value = value, getattr(value, step.name)
        else:
            position = _position(value, parent, step)
            if position is None or position >= len(value):
                raise FieldError(f"the message has no {path}")
            value = value[position]
    return value


def write(message: Any, path: FieldPath, number: float | str) -> None:
    """Write a number or a word at a path; arrays grow as needed, and a selected element receives its name.

    Raises:
        FieldError: If the path does not lead to a number or a text, or the value does not fit the field.
    """
    _leaf(type(message), path)
    _write(message, path.steps, number, path)


def fill(message: Any, content: Mapping[str, Any]) -> None:
    """Write the content of a file into a message: nested mappings, lists and plain values.

    Raises:
        FieldError: If a field does not exist, or a value does not fit it.
    """
    for name, value in content.items():
        setattr(message, name, _build(_slot(type(message), name), value, name))


def _write(message: Any, steps: Sequence[Step], number: float | str, path: FieldPath) -> None:
    field, rest = steps[0], steps[1:]
    assert isinstance(field, Field)
    slot = _slot(type(message), field.name)
    if not rest:
        setattr(message, field.name, _encode(slot, number, path))
        return
    if isinstance(rest[0], Field):
        _write(getattr(message, field.name), rest, number, path)
        return
    items = list(getattr(message, field.name))
    position = _position(items, message, rest[0])
    if position is None:
        assert isinstance(rest[0], Selection)
        position = _append(items, message, slot, rest[0])
    size = slot.size if isinstance(slot, Array) else getattr(slot, "maximum_size", math.inf)
    if position >= size:
        raise FieldError(f"{path} is beyond the array, which has room for {size} elements")
    while len(items) <= position:
        items.append(_blank(slot.value_type))
    if rest[1:]:
        _write(items[position], rest[1:], number, path)
    else:
        items[position] = _encode(slot.value_type, number, path)
    setattr(message, field.name, items)


def _append(items: list[Any], message: Any, slot: Any, selection: Selection) -> int:
    """Append the element of a selection and return its index."""
    if isinstance(slot.value_type, NamespacedType):
        items.append(_blank(slot.value_type))
        setattr(items[-1], selection.key, selection.text)
        return len(items) - 1
    texts = [*getattr(message, selection.key), selection.text]
    setattr(message, selection.key, texts)
    return len(texts) - 1


def _position(items: Sequence[Any], parent: Any, step: Step) -> int | None:
    """Return the index of a step's element; None if no element has that name."""
    if isinstance(step, Element):
        return step.index
    assert isinstance(step, Selection)
    if len(items) > 0 and hasattr(items[0], step.key):
        texts = [getattr(item, step.key) for item in items]
    else:
        texts = list(getattr(parent, step.key, ()))
    return texts.index(step.text) if step.text in texts else None


def _leaf(message_type: Any, path: FieldPath) -> Any:
    """Return the type at the end of a path.

    Raises:
        FieldError: If the path does not fit the type.
    """
    parent, slot = message_type, None
    for step in path.steps:
        if isinstance(step, Field):
            if slot is not None:
                if not isinstance(slot, NamespacedType):
                    raise FieldError(f"{path}: {_describe(slot)} has no field '{step.name}'")
                parent = _class(slot)
            slot = _slot(parent, step.name)
            continue
        if not isinstance(slot, AbstractNestedType):
            raise FieldError(f"{path}: {_describe(slot)} is not an array")
        if isinstance(step, Element) and isinstance(slot, Array) and step.index >= slot.size:
            raise FieldError(f"{path}: the array has {slot.size} elements, counted from 0")
        if isinstance(step, Selection):
            _check_selection(parent, slot, step, path)
        slot = slot.value_type
    return slot


def _check_selection(parent: Any, slot: Any, step: Selection, path: FieldPath) -> None:
    if isinstance(slot.value_type, NamespacedType):
        key = _slot(_class(slot.value_type), step.key)
    else:
        array = _slot(parent, step.key)
        key = array.value_type if isinstance(array, AbstractNestedType) else None
    if not isinstance(key, AbstractString):
        raise FieldError(f"{path}: '{step.key}' is not an array of strings to select by")


def _slot(message_type: Any, name: str) -> Any:
    slots = dict(
        zip(message_type.get_fields_and_field_types(), message_type.SLOT_TYPES, strict=False)
    )
    if name not in slots:
        raise FieldError(
            f"{message_type.__name__} has no field {name!r}; it has {', '.join(slots) or 'none'}"
        )
    return slots[name]


def _class(slot: NamespacedType) -> Any:
    return getattr(importlib.import_module(".".join(slot.namespaces)), slot.name)


def _blank(slot: Any) -> Any:
    if isinstance(slot, NamespacedType):
        return _class(slot)()
    if isinstance(slot, AbstractString):
        return ""
    return False if _is_boolean(slot) else 0.0 if slot.typename in _FLOATS else 0


def _encode(slot: Any, number: float | str, path: FieldPath | str) -> Any:
    """Return a number or a word in the type of a field; numbers for integers are rounded."""
    if isinstance(number, str):
        if not isinstance(slot, AbstractString):
            raise FieldError(f"{path} is {_describe(slot)}, not a text")
        return _build(slot, number, str(path))
    if not _is_number(slot):
        raise FieldError(f"{path} is {_describe(slot)}, not a number")
    if not math.isfinite(number):
        raise FieldError(f"{path} would be {number}, which is not finite")
    if slot.typename in _FLOATS:
        if slot.typename == "float" and abs(number) > _LARGEST_FLOAT32:
            raise FieldError(f"{path} would be {number:g}, which is too large for a float32")
        return float(number)
    match = _INTEGER.fullmatch(slot.typename)
    assert match is not None
    bits = int(match["bits"])
    low, high = (0, 2**bits - 1) if match["unsigned"] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    whole = round(number)
    if not low <= whole <= high:
        raise FieldError(f"{path} would be {whole}; {slot.typename} takes {low} to {high}")
    return whole


def _build(slot: Any, value: Any, where: str) -> Any:
    """Return a value of a file in the type of a field."""
    if isinstance(slot, NamespacedType) and isinstance(value, Mapping):
        message = _class(slot)()
        fill(message, value)
        return message
    if isinstance(slot, AbstractNestedType) and isinstance(value, list):
        size = len(value)
        if (isinstance(slot, Array) and size != slot.size) or (
            isinstance(slot, BoundedSequence) and size > slot.maximum_size
        ):
            raise FieldError(f"{where} has {size} elements; it is {_describe(slot)}")
        return [_build(slot.value_type, item, f"{where}[{n}]") for n, item in enumerate(value)]
    if isinstance(slot, AbstractString) and isinstance(value, str):
        if len(value.encode()) > getattr(slot, "maximum_size", math.inf):
            raise FieldError(f"{where} is longer than {slot.maximum_size} characters")
        return value
    if _is_boolean(slot) and isinstance(value, bool):
        return value
    if _is_number(slot) and isinstance(value, int | float) and not isinstance(value, bool):
        if slot.typename not in _FLOATS and not isinstance(value, int):
            raise FieldError(f"{where} is {value!r}; it must be an integer")
        return _encode(slot, value, where)
    raise FieldError(f"{where} is {type(value).__name__}; it must be {_describe(slot)}")


def _is_number(slot: Any) -> bool:
    return isinstance(slot, BasicType) and (
        slot.typename in _FLOATS or _INTEGER.fullmatch(slot.typename) is not None
    )


def _is_boolean(slot: Any) -> bool:
    return isinstance(slot, BasicType) and slot.typename == _BOOLEAN


def _describe(slot: Any) -> str:
    if isinstance(slot, NamespacedType):
        return "/".join((*slot.namespaces, slot.name))
    if isinstance(slot, AbstractString):
        return "text"
    if isinstance(slot, Array):
        return f"an array of {slot.size} {_describe(slot.value_type)}"
    if isinstance(slot, AbstractNestedType):
        return f"an array of {_describe(slot.value_type)}"
    return str(getattr(slot, "typename", "nothing"))
