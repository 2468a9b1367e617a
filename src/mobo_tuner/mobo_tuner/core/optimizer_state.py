"""The state of an optimiser as data for JSON, and its file."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.problem import ProblemError
from mobo_tuner.errors import UserError

STATE_VERSION = 3


class Told(NamedTuple):
    """Arguments with which `Optimizer.tell` was called."""

    setpoint: Mapping[str, float]
    outputs: Mapping[str, tuple[float, float]]
    readbacks: Mapping[str, float]
    failed: bool | None
    time: float | None


def evaluations_state(data: Dataset) -> list[dict[str, Any]]:
    """Return the evaluations of a dataset as they were told, as data for strict JSON: None where there is no number."""
    return [
        {
            "setpoint": dict(e.setpoint),
            "outputs": {n: [_strict(v), _strict(e.stddevs[n])] for n, v in e.values.items()},
            "readbacks": dict(e.readbacks),
            "failed": e.reported_failed,
            "time": e.time,
        }
        for e in data.evaluations
    ]


def told_evaluations(state: Mapping[str, Any]) -> Iterator[Told]:
    """Yield the evaluations of a state as they were told."""
    for evaluation in state["evaluations"]:
        yield Told(
            evaluation["setpoint"],
            {n: (_number(v), _number(s)) for n, (v, s) in evaluation["outputs"].items()},
            evaluation.get("readbacks", {}),
            evaluation.get("failed"),
            evaluation.get("time"),
        )


def _strict(value: float) -> float | None:
    """Return a number for strict JSON; None if it is not finite."""
    return value if math.isfinite(value) else None


def _number(value: float | None) -> float:
    """Return a number of strict JSON; NaN for None."""
    return math.nan if value is None else value


@contextmanager
def reading_state(state: object) -> Iterator[None]:
    """Check the version of a state, and turn what goes wrong in reading it into one sentence.

    Raises:
        ProblemError: If the state is of another version, incomplete or damaged.
    """
    version = state.get("version") if isinstance(state, Mapping) else None
    if not isinstance(version, int) or version != STATE_VERSION:
        raise ProblemError(f"the state is of version {version!r}; {STATE_VERSION} is allowed")
    try:
        yield
    except UserError:
        raise
    except KeyError as error:
        raise ProblemError(f"the state lacks {error}") from None
    except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError) as error:
        raise ProblemError(f"the state is not one that get_state gave: {error}") from None


def write_state(path: str | Path, state: Mapping[str, Any]) -> None:
    """Write a state to a JSON file, which replaces an older one only when it is complete.

    Raises:
        ProblemError: If the file cannot be written.
    """
    text = json.dumps(state, allow_nan=False)
    with _reaching(path, "written"):
        partial = Path(path).with_name(f"{Path(path).name}.partial")
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)


def read_state(path: str | Path) -> dict[str, Any]:
    """Read the state in a JSON file; its content is not checked.

    Raises:
        ProblemError: If the file cannot be read or does not contain a state.
    """
    with _reaching(path, "read"):
        content = Path(path).read_bytes()
    try:
        state = json.loads(content)
    except (ValueError, RecursionError):
        raise ProblemError(f"the file '{path}' is not JSON") from None
    if not isinstance(state, dict):
        raise ProblemError(f"the file '{path}' holds no state of an optimiser")
    return state


@contextmanager
def _reaching(path: object, what: str) -> Iterator[None]:
    """Turn what is wrong with a file, or with its name, into one sentence."""
    try:
        yield
    except (TypeError, ValueError):
        raise ProblemError(f"path is {path!r:.60}; the name of a file is allowed") from None
    except OSError as error:
        raise ProblemError(f"the file '{path}' cannot be {what}: {error.strerror}") from None
