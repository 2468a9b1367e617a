"""Fuzz the formulas of derived quantities: each must be evaluated to a number, or refused with one line.

    python -m robustness.fuzz_formulas --formulas 100000

Formulas are drawn from arithmetic, from what attacks on evaluators are made of, from altered ones and from characters.
What is evaluated is evaluated for several readings at once, too, with the same result. A hook of Python's auditing
counts everything that a formula might have executed, imported or opened; the time of each is measured.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mobo_tuner.core.derived import CONSTANTS, FUNCTIONS, LONGEST, Derived
from mobo_tuner.core.problem import ProblemError

READINGS = {"a": (4.0, 0.1), "b": (-9.0, 0.2), "c": (0.0, 0.0), "d": (1e30, math.nan)}
LONGEST_SECONDS = 0.5  # for one formula; a busy computer may interrupt it
LONGEST_ERROR = 600  # characters
_WATCHED = (
    "exec",
    "import",
    "open",
    "os.",
    "subprocess.",
    "socket.",
    "ctypes.",
    "marshal.",
    "pickle.",
)
_OPERATORS = ("+", "-", "*", "/", "//", "%", "**", "<", "<=", ">", ">=", "==", "!=", "and", "or")
_NUMBERS = ("0", "1", "2", "0.5", "1e38", "1e-300", "9" * 30, "3.7", "1_000")
_ATTACKS = (
    "__import__('os').system('true')",
    "().__class__.__base__.__subclasses__()",
    "a.__class__",
    "'{0.__class__}'.format(a)",
    "f'{a.__class__}'",
    "[a for a in range(10**9)]",
    "(lambda: (yield))()",
    "eval('1')",
    "exec('import os')",
    "open('/etc/passwd')",
    "print.__self__",
    "sqrt.__self__.exec",
    "9**9**9**9**9",
    "1 << 10**9",
    "'a' * 10**9",
    "(a := 10**9)",
    "{**a}",
    "a[0]",
    "await a",
    "...",
    "None",
    "True",
    "0x" + "f" * 300,
    "1j",
    "b'x'",
    "*a",
    "a if",
    "\x00",
    "a\n+b",
    "ａ",  # noqa: RUF001  a letter that Python reads as 'a'
    "import os",
    "del a",
    "not not not a",
    "max(*[a, b])",
    "min(a, key=b)",
)
_CHARACTERS = "ab01.+-*/%()<>=!,'\"[]{}:;_ \\\t\n#@&|^~`$?éλ𝒂"


@dataclass
class Watch:
    """What Python's auditing reports while it is on."""

    on: bool = False
    seen: list[str] = field(default_factory=list)
    _hooked: bool = False

    def hook(self) -> None:
        """Add the hook, once; it cannot be removed."""
        if not self._hooked:
            self._hooked = True
            sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.on and event.startswith(_WATCHED):
            self.seen.append(f"{event} {arguments!r:.80}")


_WATCH = Watch()


def formula(rng: np.random.Generator, depth: int = 0) -> str:
    """Return a random formula, most of them good."""
    kind = rng.integers(12)
    if depth > 3 or kind < 3:
        return str(rng.choice([*READINGS, *READINGS, *_NUMBERS, *CONSTANTS]))
    parts = [formula(rng, depth + 1) for _ in range(3)]
    if kind < 7:
        return f"{parts[0]} {rng.choice(_OPERATORS)} {parts[1]}"
    if kind == 7:
        return f"({parts[0]})"
    if kind == 8:
        return f"{rng.choice(['-', '+', 'not '])}{parts[0]}"
    if kind == 9:
        return f"({parts[0]} if {parts[1]} else {parts[2]})"
    name = str(rng.choice(list(FUNCTIONS)))
    usual = 2 if name in ("hypot", "atan2", "min", "max") else 1
    count = usual if rng.random() < 0.9 else int(rng.integers(4))
    return f"{name}({', '.join(parts[:count])})"


def altered(text: str, rng: np.random.Generator) -> str:
    """Return a formula with some characters replaced, removed, added, or a piece of it repeated."""
    characters = list(text)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(characters) + 1))
        characters[at : at + int(rng.integers(2))] = str(rng.choice(list(_CHARACTERS)))
    text = "".join(characters)
    if rng.random() < 0.1:
        start = int(rng.integers(len(text) + 1))
        text = text[:start] + text[start : start + 3] * int(rng.integers(1, 200)) + text[start:]
    return text


def draw(rng: np.random.Generator) -> str:
    """Return what somebody may give as a formula."""
    kind = rng.random()
    if kind < 0.4:
        return formula(rng)
    if kind < 0.6:
        return altered(formula(rng), rng)
    if kind < 0.8:
        attack = str(rng.choice(_ATTACKS))
        return altered(attack, rng) if rng.random() < 0.5 else attack
    if kind < 0.9:
        return formula(rng).replace("a", f"({rng.choice(_ATTACKS)})", 1)
    return "".join(rng.choice(list(_CHARACTERS), rng.integers(LONGEST + 50)))


@dataclass
class Report:
    """Number of formulas by what became of them, everything wrong, and the longest time [s]."""

    counts: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    longest: float = 0.0


def try_formula(text: str) -> str:
    """Evaluate a formula; return what became of it.

    Raises:
        AssertionError: If the result or the refusal is not as it should be.
    """
    try:
        derived = Derived("q", text)
    except ProblemError as error:
        if "\n" in str(error) or len(str(error)) > LONGEST_ERROR:
            raise AssertionError(str(error)) from None
        return "refused"
    result = derived.of(READINGS)
    assert type(result.value) is float, result
    assert math.isfinite(result.value) or result.reason or set(derived.names) - set(READINGS)
    assert not result.stddev < 0.0, result
    assert "\n" not in result.reason.replace(text, ""), result
    if math.isfinite(result.value) and not derived.has_choices:
        many = derived.over({name: np.full(3, READINGS[name][0]) for name in derived.names})
        by_rounding = (
            "%" in text or "//" in text
        )  # the last digit decides on which side a quotient is
        assert by_rounding or np.allclose(many, result.value, rtol=1e-9, atol=1e-300), (
            many,
            result,
        )
    return "evaluated" if math.isfinite(result.value) else "not measured"


def search(count: int, seed: int) -> Report:
    """Try random formulas."""
    rng = np.random.default_rng(seed)
    report = Report()
    try_formula("sqrt(ａ)")  # imports what it needs, also what Python's parser does  # noqa: RUF001
    _WATCH.hook()
    for _ in range(count):
        text = draw(rng)
        _WATCH.seen.clear()
        started = time.perf_counter()
        _WATCH.on = True
        try:
            kind = try_formula(text)
        except Exception as error:  # anything but a refusal is what is sought
            kind = "wrong"
            report.wrong.append(f"{text!r}: {error!r}")
        finally:
            _WATCH.on = False
        seconds = time.perf_counter() - started
        report.counts[kind] += 1
        report.longest = max(report.longest, seconds)
        if _WATCH.seen:
            report.wrong.append(f"{text!r} executed {_WATCH.seen}")
        if seconds > LONGEST_SECONDS:
            report.wrong.append(f"{text!r} took {seconds:.2f} s")
    return report


def main() -> int:
    """Try as many formulas as the command line says; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--formulas", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    report = search(options.formulas, options.seed)
    for line in report.wrong:
        print(line, file=sys.stderr)
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(report.counts.items()))
    print(f"{kinds}; nothing executed, longest {1e3 * report.longest:.0f} ms")
    return 1 if report.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
