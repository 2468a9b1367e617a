"""An optimiser that is saved and restored continues with the same suggestions; a bad state is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem, ProblemError
from tests.core.toy_runs import TOY, tune, with_changes


@pytest.mark.parametrize("told", [0, 3, 7, 12])
def test_a_restored_optimizer_asks_what_the_original_would_have_asked(
    told: int, tmp_path: Path
) -> None:
    problem = with_changes(constraints={"g": {"max": 0.5}})
    original = Optimizer(problem, seed=6, initial_evaluations=5, refit_every=4)
    tune(original, told)
    original.save(tmp_path / "state.json")
    restored = Optimizer.load(tmp_path / "state.json")
    assert restored.hypervolume == original.hypervolume
    assert restored.settings == original.settings
    assert tune(restored, 5) == tune(original, 5)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("[]", "holds no state"),
        ('{"version": 99}', "the state is of version 99"),
        ('{"version": 3}', "the state lacks 'problem'"),
    ],
)
def test_a_bad_state_is_refused_in_one_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "state.json"
    path.write_text(text)
    with pytest.raises(ProblemError, match=sentence):
        Optimizer.load(path)
    with pytest.raises(ProblemError, match="cannot be read"):
        Optimizer.load(tmp_path / "absent.json")


def test_the_state_is_strict_json() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), initial_evaluations=3, proximal=np.eye(2))
    tune(optimizer, 5)
    optimizer.tell(optimizer.ask(), {"f1": 1.0})
    optimizer.tell(optimizer.ask(), {"f1": math.inf, "f2": (2.0, 0.1)})
    optimizer.tell(optimizer.ask(), {}, failed=True)
    state = json.loads(json.dumps(optimizer.get_state(), allow_nan=False))
    assert Optimizer.from_state(state).ask() == optimizer.ask()


def _paths(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items: list[tuple[Any, Any]] = []
    if isinstance(value, dict):
        items = list(value.items())
    elif isinstance(value, list):
        items = list(enumerate(value))
    return [path] * bool(path) + [p for k, v in items for p in _paths(v, (*path, k))]


def test_a_damaged_state_is_refused_or_goes_on() -> None:
    problem = {
        "variables": {"x": {"min": 0.0, "max": 1.0}},
        "objectives": {"f": {"reference": 3.0}},
    }
    told = Optimizer(Problem.from_dict(problem), initial_evaluations=1)
    for x in (0.5, None, None):
        told.tell(told.ask() if x is None else {"x": x}, {"f": 1.0})
    whole = json.dumps(told.get_state())
    refused = 0
    for path in [p for p in _paths(json.loads(whole)) if "settings" not in p[:-1]]:
        damages: tuple[Any, ...] = (None, "text", -1, [], {}, 1e300)
        for damage in damages:
            state = json.loads(whole)
            part = state
            for key in path[:-1]:
                part = part[key]
            part[path[-1]] = damage
            try:
                restored = Optimizer.from_state(state)
                assert math.isfinite(restored.ask()["x"]), (path, damage)
            except ProblemError:
                refused += 1
    assert refused > 200
    with pytest.raises(ProblemError):
        Optimizer.from_state([])  # type: ignore[arg-type]
    for part in (
        {"settings": {**told.settings.to_dict(), "new": 1}},
        {"evaluations": [{"x": 0.5}]},
    ):
        with pytest.raises(ProblemError):
            Optimizer.from_state(json.loads(whole) | part)


@pytest.mark.parametrize("withdrawn", ["never", "before", "after", "for a while", "all"])
def test_an_inferred_reference_point_is_that_of_what_was_not_withdrawn(withdrawn: str) -> None:
    problem = with_changes(objectives={"f1": {}, "f2": {"direction": "maximize"}})
    original = Optimizer(problem, seed=6, initial_evaluations=4)
    for i in range(7):
        x = original.ask()
        wild = 9.0 if i == 1 else sum(x.values())
        original.tell(x, {"f1": wild, "f2": -wild})
        if i == {"before": 2, "for a while": 2, "after": 5}.get(withdrawn):
            original.forget(1)
        if i == 5 and withdrawn == "for a while":
            original.unforget(1)
    if withdrawn == "all":
        for i in range(7):
            original.forget(i)
        assert not original.problem.has_references
        assert original.hypervolume == original.hypervolume_measured == 0.0
    else:
        is_wild = max(np.abs(original.problem.reference_point)) > 8.0
        assert is_wild == (withdrawn in ("never", "for a while"))
    restored = Optimizer.from_state(json.loads(json.dumps(original.get_state())))
    assert restored.problem == original.problem == original.with_problem(problem).problem
    assert restored.hypervolume == original.hypervolume
    assert restored.ask() == original.ask()
