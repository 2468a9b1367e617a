"""Paths to fields: what is one, what is none, and that any text is either."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mobo_tuner.bridge.field_path import Element, Field, FieldPath, Selection, parse_field_path


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        ("data", [Field("data")]),
        ("header.stamp", [Field("header"), Field("stamp")]),
        ("position[2]", [Field("position"), Element(2)]),
        ("position[name=Q1]", [Field("position"), Selection("name", "Q1")]),
        (
            "values[name=a b/c.d].value",
            [Field("values"), Selection("name", "a b/c.d"), Field("value")],
        ),
        (
            "a[0].b[9999].c",
            [Field("a"), Element(0), Field("b"), Element(9999), Field("c")],
        ),
    ],
)
def test_a_path_is_parsed_and_printed_alike(text: str, steps: list[object]) -> None:
    path = parse_field_path(text)
    assert list(path.steps) == steps
    assert str(path) == text


@pytest.mark.parametrize(
    "text",
    [
        "", ".", "a.", ".a", "a..b", "a b", "a[", "a[]", "a[-1]", "a[1", "a[1]]", "a[1][2]", "a[=x]",
        "a[x=]", "a[10000]", "[1]", "1a", "_a", "__class__", "a.__init__", "a()", "a[1]b", "ä", "a\n",
        "a." * 300 + "a",
    ],
)  # fmt: skip
def test_what_is_no_path_is_refused_in_one_sentence(text: str) -> None:
    with pytest.raises(ValueError, match=re.escape("is not a path to a field")):
        parse_field_path(text)


NAMES = st.from_regex(r"[A-Za-z][A-Za-z0-9_]*", fullmatch=True)
ELEMENTS = st.one_of(
    st.builds(Element, st.integers(0, 9999)),
    st.builds(Selection, NAMES, st.text(min_size=1).filter(lambda t: not set(t) & set("[]"))),
)
PARTS = st.lists(st.tuples(NAMES, st.none() | ELEMENTS), min_size=1, max_size=5)


@given(PARTS)
def test_every_path_survives_being_printed(parts: list[tuple[str, object]]) -> None:
    steps = [step for name, element in parts for step in (Field(name), element) if step is not None]
    path = FieldPath(tuple(steps))  # type: ignore[arg-type]
    if len(str(path)) <= 500:
        assert parse_field_path(str(path)) == path


@given(st.text(alphabet="ab_[]=.09 \nä") | st.text())
def test_any_text_is_a_path_or_a_value_error(text: str) -> None:
    try:
        path = parse_field_path(text)
    except ValueError:
        return
    assert str(path) == text or re.search(r"\[0\d", text)  # leading zeros of an index are dropped
