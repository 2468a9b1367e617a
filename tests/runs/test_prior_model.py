"""Models of the machine that a parameter file names: functions, files of torch, and other runs."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.prior_mean import PriorMeans, SmoothPriorModel
from mobo_tuner.runs.history import INPUTS, MODEL, OUTPUTS, History
from mobo_tuner.runs.journal import read_journal
from mobo_tuner.runs.optimizer_settings import make_optimizer
from mobo_tuner.runs.prior_model import load_prior_model
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.records import StartRecord
from mobo_tuner.runs.replay import compare, restore
from mobo_tuner.runs.run_log import RunLog
from mobo_tuner.runs.saved_state import SavedState
from mobo_tuner.tuner.parameters import check_tuner
from robustness.offline_run import TOY, OfflineRun, toy, toy_optimizer

PROBLEM = Problem.from_dict(TOY)
AT = {"x1": np.array([0.5, -1.0]), "x2": np.array([1.0, 0.0])}
X = np.random.default_rng(0).uniform(-0.9, 0.9, (6, 2))
PROGRAM = """
import numpy as np
def predict(x):
    return {"f1": np.hypot(x["x1"] - 1, x["x2"] - 1), "f2": np.hypot(x["x1"] + 1, x["x2"] + 1), "g": x["x1"]}
def part(x):
    return {"f1": x["x1"]}
def hole(x):
    return {"f1": np.log(x["x1"]), "f2": 0.0, "g": 0.0}
def late(x):
    raise RuntimeError("no licence")
def charged(x):
    return {"f1": x["x2"] * x["charge"], "f2": np.zeros_like(x["x2"]), "g": 1.0}
wrong = 3
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Python file, networks of torch, and a run of twelve evaluations."""
    made = tmp_path_factory.mktemp("models")
    (made / "toy.py").write_text(PROGRAM)
    (made / "broken.py").write_text("import nothing_like_it")
    (made / "text.pt").write_text("not a network")
    network = torch.nn.Sequential(torch.nn.Linear(2, 8), torch.nn.Tanh(), torch.nn.Linear(8, 3))
    network = network.double()
    with warnings.catch_warnings():  # torch.jit is deprecated, but its files are still there
        warnings.simplefilter("ignore")
        torch.jit.save(torch.jit.script(network), str(made / "network.pt"))
    points = {0: torch.export.Dim("points")}
    exported = torch.export.export(network, (torch.zeros(5, 2).double(),), dynamic_shapes=(points,))
    torch.export.save(exported, made / "network.pt2")
    run = OfflineRun(made / "run", toy_optimizer(1), toy, 1, events=False)
    for _ in range(12):
        run.step()
    run.log.close()
    return made


def load(folder: Path, name: str, **settings: str) -> Any:
    keys = {"inputs": INPUTS, "outputs": OUTPUTS}
    given = {keys[n]: value for n, value in settings.items()}
    return load_prior_model(PROBLEM, {MODEL: str(folder / name), **given})


def test_a_function_of_a_file_or_a_package_predicts(folder: Path) -> None:
    predicted = load(folder, "toy.py:predict").predict(AT)
    expected = [list(toy({n: float(v[i]) for n, v in AT.items()}).values()) for i in range(2)]
    np.testing.assert_allclose(predicted, expected)
    assert load(folder, "toy.py:part", outputs="f1").outputs == ("f1",)
    charged = load(folder, "toy.py:charged", inputs="charge=3.0").predict(AT)
    np.testing.assert_allclose(charged, [[3.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    of_package = f"{__name__}:none_at_all"
    with pytest.raises(ProblemError, match="no function 'none_at_all'"):
        load_prior_model(PROBLEM, {MODEL: of_package})
    assert load_prior_model(PROBLEM, {MODEL: ""}) is None


@pytest.mark.parametrize("name", ["network.pt", "network.pt2", "run"])
def test_gradients_of_networks_and_runs_are_those_of_finite_differences(
    folder: Path, name: str
) -> None:
    model = load(folder, name)
    assert isinstance(model, SmoothPriorModel)

    class Values:
        """The same model without its gradients."""

        outputs = model.outputs

        def predict(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
            return np.asarray(model.predict(columns))

    exact, numerical = PriorMeans(PROBLEM, model), PriorMeans(PROBLEM, Values())
    np.testing.assert_allclose(exact.gradients(X), numerical.gradients(X), atol=1e-5)
    np.testing.assert_allclose(exact.values(X), numerical.values(X), rtol=1e-9)


def test_a_run_predicts_what_its_models_do(folder: Path) -> None:
    model = load(folder, "run")
    alike = Optimizer(PROBLEM, seed=1)
    for evaluation in RecordedRun.load(folder / "run").optimizer.dataset.evaluations:
        alike.tell(evaluation.setpoint, evaluation.values)
    processes = alike.archive.extended_models.by_output
    for j, name in enumerate(model.outputs):
        predicted = model.predict(PROBLEM.columns(X))[:, j]
        np.testing.assert_allclose(predicted, processes[name].predict(X)[0], atol=0.02)
    other = Problem.from_dict({**TOY, "variables": {"x1": {"min": -1.0, "max": 1.0}}})
    with pytest.raises(ProblemError, match="the variable 'x2'"):
        load_prior_model(other, {MODEL: str(folder / "run")})
    more = Problem.from_dict({**TOY, "constraints": {"h": {"max": 1.0}}})
    with pytest.raises(ProblemError, match="no model of 'h'"):
        load_prior_model(more, {MODEL: str(folder / "run")})


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("none.pt", {}, "no such file or folder"),
        ("broken.py:f", {}, "ModuleNotFoundError"),
        ("none.py:f", {}, "there is no such file"),
        ("toy.py:wrong", {}, "no function 'wrong'"),
        ("toy.py:part", {}, "does not predict 'f2'"),
        ("toy.py:hole", {}, "'f1' is not a finite number"),
        ("toy.py:late", {}, "RuntimeError: no licence"),
        ("toy.py", {}, "a file of torch"),
        ("text.pt", {}, "torch cannot read it"),
        ("network.pt", {"outputs": "f1, f2"}, "2 outputs for each point"),
        ("network.pt", {"inputs": "x2"}, "network.pt"),
        ("network.pt", {"outputs": "f1 f1 g"}, "'f1'; each of f1, f2, g"),
        ("network.pt", {"inputs": "x1 x3"}, "names 'x3'"),
        ("network.pt", {"inputs": "x1 x3=a"}, "NAME=NUMBER"),
        ("network.pt", {"inputs": "x1 x3=inf"}, "NAME=NUMBER"),
        ("run", {"inputs": "x1"}, "the inputs of a run"),
    ],
)
def test_a_model_that_cannot_be_used_is_refused_in_a_sentence(
    folder: Path, name: str, settings: dict[str, str], words: str
) -> None:
    with pytest.raises(ProblemError, match=words) as error:
        load(folder, name, **settings)
    assert str(error.value).startswith(f"{MODEL} is '{folder / name}'")
    assert "\n" not in str(error.value)


def test_a_run_with_a_model_is_resumed_and_replayed_with_it_and_read_without(folder: Path) -> None:
    model = str(folder / "toy.py:predict")
    settings = check_tuner({"seed": 4, "prior_mean": {"model": model, "outputs": "f1 f2"}})
    settings = {**settings, "budget": 60}
    optimizer = make_optimizer(PROBLEM, settings, load_prior_model(PROBLEM, settings))
    run = OfflineRun(folder / "informed", optimizer, toy, 2, events=False)
    run.run.log = RunLog(folder / "with", StartRecord("with", 0.0, PROBLEM, settings))
    run.run.run_id = "with"
    assert optimizer.initial_evaluations == 2
    for _ in range(5):
        run.step()
    asked = run.ask()
    run.log.close()
    history = History.from_records(read_journal(folder / "with"))
    saved = SavedState.read(folder / "with")
    assert saved is not None
    assert restore(history, saved).ask() == restore(history).ask() == asked
    assert not any(each.differs for each in compare(history))
    (folder / "toy.py").rename(folder / "away.py")
    try:
        with pytest.raises(ProblemError, match=MODEL):
            restore(history, saved)
        assert len(RecordedRun.load(folder / "with").evaluations) == 5
    finally:
        (folder / "away.py").rename(folder / "toy.py")
    assert isinstance(optimizer, Optimizer)
