"""Derived quantities: formulas over what is measured and the variables.

A formula is evaluated by simpleeval, of which only arithmetic, comparisons, choices and the functions below are
left, and every value in it is a float: there are no texts, no lists and no attributes. What `ast` parses and is
anything else is refused when the formula is read, so that nothing is ever executed.
"""

from __future__ import annotations

import ast
import math
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.values import LARGEST, ProblemError, check_name

LONGEST = 500
"""Largest number of characters of a formula."""
DEEPEST = 40
"""Largest depth of nesting in a formula."""
FUNCTIONS: Mapping[str, Callable[..., float]] = {
    **{name: getattr(math, name) for name in ("sqrt", "exp", "log", "log10", "hypot")},
    **{name: getattr(math, name) for name in ("sin", "cos", "tan", "asin", "acos", "atan")},
    **{
        name: getattr(math, name)
        for name in ("atan2", "sinh", "cosh", "tanh", "radians", "degrees")
    },
    **{"abs": abs, "min": min, "max": max},
}
"""Functions of a formula, those of Python's `math`; angles are in radians."""
_ARGUMENTS = {"log": (1, 2), "atan2": (2, 2)} | dict.fromkeys(("hypot", "min", "max"), (2, 20))
CONSTANTS: Mapping[str, float] = {"pi": math.pi}
"""Constants of a formula; a quantity may not be called as one of them."""
_QUOTED = re.compile(r"`([^`]*)`")
_STAND_IN = "in_backticks_{}"  # in the parsed formula, for the n-th name in backticks
_SHARE = 1e-3  # of a standard deviation, the step of a difference quotient
_OPERATORS = (ast.operator, ast.unaryop, ast.boolop, ast.cmpop, ast.expr_context)
_NODES = (
    *(ast.Expression, ast.Name, ast.Constant, ast.UnaryOp, ast.BinOp, ast.BoolOp),
    *(ast.Compare, ast.IfExp, ast.Call),
)
_REFUSED = (
    *(ast.BitAnd, ast.BitOr, ast.BitXor, ast.LShift, ast.RShift, ast.Invert, ast.MatMult),
    *(ast.Is, ast.IsNot, ast.In, ast.NotIn),
)

_CHOICES = (ast.BoolOp, ast.Compare, ast.IfExp, ast.Not)
_OPERATORS_OF_ARRAYS: Mapping[type[ast.AST], Callable[..., Any]] = {
    **{ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.true_divide},
    **{ast.FloorDiv: np.floor_divide, ast.Mod: np.mod, ast.Pow: np.float_power},
    **{ast.USub: np.negative, ast.UAdd: np.positive},
}
_FUNCTIONS_OF_ARRAYS: Mapping[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in ("sqrt", "exp", "log10", "sin", "cos", "tan")},
    **{name: getattr(np, name) for name in ("sinh", "cosh", "tanh", "radians", "degrees", "abs")},
    **{"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2},
    "log": lambda value, *base: np.log(value) / (np.log(base[0]) if base else 1.0),
    "hypot": lambda *values: reduce(np.hypot, values),
    "min": lambda *values: reduce(np.minimum, values),
    "max": lambda *values: reduce(np.maximum, values),
}

Reading = tuple[float, float]


class Result(NamedTuple):
    """Value of a derived quantity and its standard deviation, NaN if unknown.

    `reason` says why it is undefined although all in its formula was measured; empty otherwise.
    """

    value: float
    stddev: float = math.nan
    reason: str = ""


@dataclass(frozen=True)
class Derived:
    """A quantity that is computed from measured ones and variables.

    Attributes:
        name: Name.
        formula: Formula in Python's notation, over the names of diagnostics and variables. A name that is not an
            identifier of Python stands in backticks: "sqrt(`BPM:X` ** 2 + `BPM:Y` ** 2)".
        unit: Unit.

    Example:
        >>> area = Derived("area", "pi * a * b")
        >>> area.names
        ('a', 'b')
        >>> result = area.of({"a": (2.0, 0.1), "b": (3.0, 0.0)})
        >>> f"{result.value:.3f} +- {result.stddev:.3f}"
        '18.850 +- 0.942'

    Raises:
        ProblemError: If the formula is not one.
    """

    name: str
    formula: str
    unit: str = ""

    def __post_init__(self) -> None:
        if not self.names:
            raise ProblemError(f"{self._where} is {self.formula!r:.60}, which uses no quantity")

    @property
    def _where(self) -> str:
        return f"derived.{self.name}.formula"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the quantities in the formula, in order."""
        called = {id(node.func) for node in ast.walk(self._tree) if isinstance(node, ast.Call)}
        used = [
            (node.lineno, node.col_offset, node.id)
            for node in ast.walk(self._tree)
            if isinstance(node, ast.Name) and id(node) not in called and node.id not in CONSTANTS
        ]
        return tuple(dict.fromkeys(self._quoted.get(name, name) for *_, name in sorted(used)))

    @cached_property
    def _quoted(self) -> dict[str, str]:
        """The names in backticks, by what stands for them in the parsed formula."""
        names = dict.fromkeys(_QUOTED.findall(self.formula))
        return {_STAND_IN.format(number): name for number, name in enumerate(names)}

    def of(self, readings: Mapping[str, Reading]) -> Result:
        """Return the quantity for readings, each a mean and a standard deviation.

        Standard deviations are propagated to first order, as if the readings were independent. The
        quantity is not measured if one in its formula is not, or the formula is undefined there.

        Args:
            readings: Mean and standard deviation of the quantities by name; NaN = unknown.
        """
        unknown = (math.nan, math.nan)
        known = {name: readings.get(name, unknown) for name in self.names}
        means = {name: float(mean) for name, (mean, _) in known.items()}
        if not all(map(math.isfinite, means.values())):
            return Result(math.nan)
        value, reason = self._evaluate(means)
        if reason:
            where = ", ".join(f"{name} = {mean:g}" for name, mean in means.items())
            return Result(math.nan, reason=f"{self.name} = {self.formula} is {reason} at {where}")
        squares = [self._contribution(means, name, known[name][1], value) for name in self.names]
        return Result(value, math.sqrt(math.fsum(square**2 for square in squares)))

    @cached_property
    def has_choices(self) -> bool:
        """Whether the formula has a comparison, a choice or an "and" or "or", so that it may jump."""
        return any(isinstance(node, _CHOICES) for node in ast.walk(self._tree))

    def over(self, columns: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the quantity for many readings at once; NaN where it is undefined.

        Args:
            columns: Readings of the quantities by name, all of one shape.

        Returns:
            The quantity, in their shape.

        Raises:
            ValueError: If the formula has choices.
        """
        from simpleeval import SimpleEval

        if self.has_choices:
            raise ValueError(f"{self._where} has a choice: it is evaluated one by one")
        known = {**columns, **{i: columns[n] for i, n in self._quoted.items()}}
        evaluator = SimpleEval(_OPERATORS_OF_ARRAYS, _FUNCTIONS_OF_ARRAYS, {**CONSTANTS, **known})
        handlers: Mapping[Any, Callable[[ast.AST], Any]] = evaluator.nodes
        evaluator.nodes = {kind: handlers[kind] for kind in _NODES if kind is not ast.Expression}
        evaluator.nodes[ast.Constant] = _as_float(handlers[ast.Constant])
        with np.errstate(all="ignore"):
            values = evaluator.eval(self.formula, previously_parsed=self._tree.body)
        values = np.broadcast_to(values, next(iter(columns.values())).shape)
        return np.where(np.abs(values) <= LARGEST, values, np.nan)

    def _contribution(
        self, means: Mapping[str, float], name: str, stddev: float, value: float
    ) -> float:
        """Return the standard deviation that the one of a reading causes; NaN if it is unknown."""
        if not stddev > 0.0:  # 0, or NaN
            return stddev
        step = _SHARE * stddev
        ends = []
        for move in (-step, step):
            end, reason = self._evaluate({**means, name: means[name] + move})
            ends.append((0.0, value) if reason else (move, end))
        (low, at_low), (high, at_high) = ends
        return math.nan if low == high else (at_high - at_low) / (high - low) * stddev

    def _evaluate(self, means: Mapping[str, float]) -> tuple[float, str]:
        """Return the value of the formula, and why it is undefined, empty if it is not."""
        from simpleeval import InvalidExpression, SimpleEval  # only problems with formulas need it

        known = {**means, **{i: means[n] for i, n in self._quoted.items() if n in means}}
        evaluator = SimpleEval(functions=dict(FUNCTIONS), names={**CONSTANTS, **known})
        handlers: Mapping[Any, Callable[[ast.AST], Any]] = evaluator.nodes
        evaluator.nodes = {
            kind: _as_float(handlers[kind]) for kind in _NODES if kind is not ast.Expression
        }
        try:
            value = float(evaluator.eval(self.formula, previously_parsed=self._tree.body))
        except TypeError:  # of float, for a complex number
            return math.nan, "not a real number"
        except (ArithmeticError, InvalidExpression, ValueError) as error:
            return math.nan, f"undefined ({error})"
        if not abs(value) <= LARGEST:
            return math.nan, f"{value:g}"
        return value, ""

    @cached_property
    def _tree(self) -> ast.Expression:
        """The formula, parsed and checked."""
        text = self.formula
        if not isinstance(text, str) or not text.strip():
            raise ProblemError(
                f"{self._where} is {text!r:.60}; a text such as 'sqrt(a * b)' is allowed"
            )
        if len(text) > LONGEST:
            raise ProblemError(
                f"{self._where} has {len(text)} characters; at most {LONGEST} are allowed"
            )
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of the parser, about what is refused below
                tree = ast.parse(self._plain(text.strip()), mode="eval")
        except (MemoryError, RecursionError, SyntaxError, ValueError):
            raise ProblemError(
                f"{self._where} is {text!r:.60}, which is not a formula; allowed are numbers, names, "
                "+ - * / // % **, comparisons, and, or, not, 'a if b else c' and functions"
            ) from None
        self._check(tree, 0)
        return tree

    def _plain(self, text: str) -> str:
        """Return the formula with an identifier of Python in place of each name in backticks."""
        if _STAND_IN.format("") in text:
            raise ProblemError(
                f"{self._where} is {text!r:.60}, with a name that begins with {_STAND_IN.format('')}; another "
                "one is allowed"
            )
        stand_ins = {name: identifier for identifier, name in self._quoted.items()}
        for name in stand_ins:
            check_name(self._where, name)
        return _QUOTED.sub(lambda found: f" {stand_ins[found[1]]} ", text).strip()

    def _check(self, node: ast.AST, depth: int) -> None:
        """Check that a part of the formula is nothing but arithmetic.

        Raises:
            ProblemError: If it is something else.
        """
        if depth > DEEPEST:
            raise ProblemError(
                f"{self._where} is nested more than {DEEPEST} deep, which is not allowed"
            )
        if isinstance(node, _REFUSED) or not isinstance(node, (*_NODES, *_OPERATORS)):
            raise ProblemError(
                f"{self._where} is {self.formula!r:.60}, with a {type(node).__name__}; only numbers, "
                "names, arithmetic, comparisons and functions are allowed"
            )
        if isinstance(node, ast.Constant):
            self._check_number(node.value)
        elif isinstance(node, ast.Call):
            self._check_call(node)
        for part in ast.iter_child_nodes(node):
            self._check(part, depth + 1)

    def _check_number(self, value: object) -> None:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not abs(value) <= LARGEST:  # type: ignore[arg-type]
            raise ProblemError(
                f"{self._where} has {value!r:.40}; numbers of at most {LARGEST:g} are allowed"
            )

    def _check_call(self, node: ast.Call) -> None:
        name = node.func.id if isinstance(node.func, ast.Name) else "a function without a name"
        if name not in FUNCTIONS:
            raise ProblemError(
                f"{self._where} calls {name:.40}; allowed are {', '.join(FUNCTIONS)}. What is taken of "
                "the shots of a diagnostic, such as a percentile, is said where it is measured: its statistic"
            )
        least, most = _ARGUMENTS.get(name, (1, 1))
        if node.keywords or not least <= len(node.args) <= most:
            count = f"{least}" if least == most else f"{least} to {most}"
            raise ProblemError(
                f"{self._where} calls {name} with {len(node.args) + len(node.keywords)} values; "
                f"{count} without names are allowed"
            )


def _as_float(handler: Callable[[ast.AST], Any]) -> Callable[[ast.AST], float]:
    """Return what evaluates a part of a formula to a float; a complex number raises TypeError."""

    def evaluate(node: ast.AST) -> float:
        return float(handler(node))

    return evaluate
