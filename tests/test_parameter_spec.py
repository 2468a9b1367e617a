"""What a parameter may be: every combination of types, the range, and the words for them."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from types import NoneType
from typing import Any

import numpy as np
import pytest

from mobo_tuner.errors import ParameterError
from mobo_tuner.parameter_spec import (
    ParameterSpec,
    check_fields,
    parameter,
    specs_of,
    unknown,
)

WHOLE = ParameterSpec("p", 3, "", minimum=1, maximum=9)
NUMBER = ParameterSpec("p", 1.0, "", minimum=0.0)
FLAG = ParameterSpec("p", False, "")
NAME = ParameterSpec("p", "a", "", choices=("a", "b"))
TEXT = ParameterSpec("p", "", "")
EITHER = ParameterSpec("p", "a", "", choices=("a",), types=(str, float), maximum=5.0)
MANY = ParameterSpec("p", None, "", types=(float, tuple, NoneType), minimum=0.0, matrix=True)


@pytest.mark.parametrize(
    ("spec", "value", "expected"),
    [
        (WHOLE, 9, 9),
        (WHOLE, np.int64(2), 2),
        (NUMBER, 3, 3.0),
        (NUMBER, np.float32(0.5), 0.5),
        (FLAG, True, True),
        (FLAG, np.bool_(True), True),
        (NAME, "b", "b"),
        (TEXT, "anything", "anything"),
        (TEXT, "null", "null"),
        (EITHER, "a", "a"),
        (EITHER, 5, 5.0),
        (MANY, None, None),
        (MANY, "null", None),
        (MANY, 2, 2.0),
        (MANY, [1, 2.5], (1.0, 2.5)),
        (MANY, array("d", [1.0, 2.0]), (1.0, 2.0)),
        (MANY, array("q", [1, 2]), (1.0, 2.0)),
        (MANY, np.array([[1, 2], [3, 4]]), (1.0, 2.0, 3.0, 4.0)),
        (MANY, ((1.0, 2.0), [3.0, 4.0]), (1.0, 2.0, 3.0, 4.0)),
    ],
)
def test_a_value_becomes_one_of_the_types(spec: ParameterSpec, value: Any, expected: Any) -> None:
    checked = spec.check(value)
    assert checked == expected
    assert type(checked) is type(expected)
    assert spec.check(checked) == checked


@pytest.mark.parametrize(
    ("spec", "value", "words"),
    [
        (WHOLE, 0, "p is 0; 1 to 9 is allowed"),
        (WHOLE, 2.0, "an integer"),
        (WHOLE, True, "an integer"),
        (WHOLE, "2", "an integer"),
        (WHOLE, None, "an integer"),
        (WHOLE, 10**400, "an integer"),
        (NUMBER, -1, "at least 0"),
        (NUMBER, "1", "a number"),
        (NUMBER, "null", "a number"),
        (NUMBER, float("nan"), "a finite number"),
        (NUMBER, float("inf"), "a finite number"),
        (NUMBER, 10**400, "a number"),
        (NUMBER, [1.0], "a number"),
        (FLAG, 1, "true or false"),
        (FLAG, "true", "true or false"),
        (NAME, "c", "allowed are a, b"),
        (NAME, 1, "text"),
        (NAME, True, "text"),
        (EITHER, "c", "allowed are a, a number"),
        (EITHER, 6.0, "at most 5"),
        (EITHER, None, "a number or a name"),
        (EITHER, True, "a number or a name"),
        (EITHER, [1.0], "a number or a name"),
        (MANY, True, "a number, a list of numbers or null"),
        (MANY, "x", "a number, a list of numbers or null"),
        (MANY, [], "at least one number"),
        (MANY, [True], "must hold numbers, not True"),
        (MANY, ["1"], "must hold numbers, not '1'"),
        (MANY, [1.0, -1.0], "p[1] is -1.0; at least 0"),
        (MANY, [1.0, float("nan")], "p[1] must be a finite number"),
        (MANY, [[1.0], [2.0]], "a square matrix"),
        (MANY, [[1.0, 2.0], 3.0], "a square matrix"),
        (MANY, {"a": 1.0}, "a number, a list of numbers or null"),
    ],
)
def test_a_value_that_is_not_allowed_is_named(spec: ParameterSpec, value: Any, words: str) -> None:
    with pytest.raises(ParameterError) as error:
        spec.check(value, "node.")
    assert str(error.value).startswith("node.p")
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_dataclass_tells_types_and_limits_of_its_fields() -> None:
    @dataclass(frozen=True)
    class Settings:
        count: int = parameter(2, "Number of things.", minimum=1)
        mean: str | float = parameter("auto", "A mean.", choices=("auto",))
        weights: tuple[float, ...] | None = parameter(None, "Weights.")
        plain: float = 1.0

        def __post_init__(self) -> None:
            check_fields(self)

    # The class stands in a function: its annotations are resolved all the same.
    count, mean, weights, plain = specs_of(Settings, "of.")
    assert (count.name, count.types, count.minimum) == ("of.count", (int,), 1)
    assert (mean.types, mean.choices) == ((str, float), ("auto",))
    assert weights.types == (tuple, NoneType)
    assert (plain.types, plain.description) == ((float,), "")
    assert Settings(weights=[1, 2], plain=3).weights == (1.0, 2.0)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="count is 0"):
        Settings(count=0)


def test_an_unknown_name_comes_with_the_nearest_known_one() -> None:
    assert unknown("on_abrt", ("on_abort", "seed"), "tuner").endswith("did you mean 'on_abort'?")
    assert unknown("xyz", ("on_abort", "seed"), "tuner").endswith("allowed are on_abort, seed")
