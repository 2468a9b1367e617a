"""The optimiser as a generator of gest-api, by itself and in the loop of libEnsemble."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gest_api import Generator
from gest_api.vocs import VOCS

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.offline import MoboGenerator
from mobo_tuner.offline.vocs import problem_of, vocs_of
from tests.support.paths import ROOT

REFERENCES = {"f": 1.0, "g": 1.0}
EVERYTHING: dict[str, Any] = {
    "variables": {"x": [0.0, 1.0], "steps": {0, 2, 5}},
    "objectives": {"f": "MINIMIZE", "g": "MAXIMIZE"},
    "constraints": {"a": ["LESS_THAN", 1.0], "b": ["GREATER_THAN", 2.0], "c": ["BOUNDS", 0.0, 3.0]},
    "constants": {"charge": 40.0},
    "observables": {"seen"},
}


def vocs(**changes: Any) -> VOCS:
    return VOCS(
        **{
            "variables": {"x": [0.0, 1.0], "y": [0.0, 1.0]},
            "objectives": {"f": "MINIMIZE", "g": "MINIMIZE"},
            "constants": {"charge": 40.0},
            **changes,
        }
    )


def evaluated(point: dict[str, Any]) -> dict[str, Any]:
    """The first problem of Zitzler, Deb and Thiele with two variables."""
    h = 1.0 + 9.0 * point["y"]
    return {**point, "f": point["x"], "g": h * (1.0 - math.sqrt(point["x"] / h))}


def generator(**changes: Any) -> MoboGenerator:
    return MoboGenerator(vocs(), REFERENCES, seed=1, initial_evaluations=4, **changes)


def test_it_is_a_generator_that_gives_identifiers() -> None:
    assert issubclass(MoboGenerator, Generator)
    points = generator(batch_size=3).suggest(None)
    assert [point["_id"] for point in points] == [0, 1, 2]
    assert all(point["charge"] == 40.0 for point in points)
    assert all({"x", "y", "charge", "_id"} == {*point} for point in points)


def test_it_suggests_what_the_optimiser_asks_for() -> None:
    tuned, made = (
        Optimizer(problem_of(vocs(), REFERENCES), seed=1, initial_evaluations=4),
        generator(),
    )
    for count in (1, 3, 4):
        points = made.suggest(count)
        assert tuned.ask(count) == [{"x": p["x"], "y": p["y"]} for p in points]
        results = [evaluated(point) for point in reversed(points)]
        made.ingest(results)
        for result in results:
            tuned.tell({"x": result["x"], "y": result["y"]}, {n: result[n] for n in ("f", "g")})
    assert made.optimizer.hypervolume == tuned.hypervolume > 0.4


def test_results_come_as_numpy_scalars_in_any_order_and_from_elsewhere() -> None:
    made = generator()
    first, second = made.suggest(2)
    made.ingest([{n: np.float64(v) for n, v in evaluated(second).items()}])
    assert made.optimizer.pending == [{"x": first["x"], "y": first["y"]}]
    for nobodys in ({}, {"_id": None}, {"_id": math.nan}, {"_id": -1}):  # as tables have them
        made.ingest([evaluated({"x": 0.5, "y": 0.25}) | nobodys])
    made.ingest([{**first, "f": np.nan, "g": np.nan}])
    assert [e.failed for e in made.optimizer.dataset.evaluations] == [False] * 5 + [True]
    assert made.optimizer.pending == []


def test_a_point_that_was_evaluated_elsewhere_is_no_longer_pending() -> None:
    made = generator()
    [point] = made.suggest(1)
    made.ingest([evaluated({**point, "x": 0.5 * point["x"]})])
    assert made.optimizer.pending == []
    assert made.optimizer.dataset.evaluations[0].setpoint["x"] == 0.5 * point["x"]


@pytest.mark.parametrize(
    ("results", "name"),
    [
        ([{"_id": 7, "x": 0.1, "y": 0.1, "f": 0.0, "g": 0.0}], "_id"),
        ([{"x": 0.1, "f": 0.0, "g": 0.0}], "y"),
        ([{"x": 0.1, "y": 0.1, "f": "good", "g": 0.0}], "f"),
        ([{"x": 0.1, "y": 1e9, "f": 0.0, "g": 0.0}], "y"),
        ([{"_id": 1.5, "x": 0.1, "y": 0.1, "f": 0.0, "g": 0.0}], "_id"),
        ([{"_id": math.inf, "x": 0.1, "y": 0.1, "f": 0.0, "g": 0.0}], "_id"),
        ([None], "mapping"),
        (["abc"], "mapping"),
    ],
)
def test_what_cannot_be_ingested_is_refused_and_nothing_is_learned(
    results: list[dict[str, Any]], name: str
) -> None:
    made = generator()
    points = made.suggest(2)
    with pytest.raises(ValueError, match=name):
        made.ingest([evaluated(points[0]), *results])
    assert len(made.optimizer.dataset) == 0
    assert len(made.optimizer.pending) == 2


@pytest.mark.parametrize("results", [None, {"x": 0.1, "y": 0.1, "f": 0.0, "g": 0.0}, 3])
def test_only_a_list_of_points_can_be_ingested(results: Any) -> None:
    with pytest.raises(ProblemError, match="list"):
        generator().ingest(results)


@pytest.mark.parametrize("count", [0, True, 2.7, "3", math.nan, math.inf, []])
def test_a_number_of_points_is_a_positive_integer(count: Any) -> None:
    made = generator()
    with pytest.raises(ProblemError, match="num_points is"):
        made.suggest(count)
    assert made.suggest(np.int64(1))[0]["_id"] == 0  # type: ignore[arg-type]


@pytest.mark.parametrize("has_id", [True, False])
def test_a_point_is_ingested_once(has_id: bool) -> None:
    made = generator()
    [point] = made.suggest(1)
    made.ingest([{n: v for n, v in evaluated(point).items() if has_id or n != "_id"}])
    assert made.optimizer.pending == []
    with pytest.raises(ProblemError, match="_id is 0"):
        made.ingest([evaluated(point)])


def test_the_parts_of_derived_quantities_are_ingested() -> None:
    definition = {
        "variables": {"x": {"min": 0.0, "max": 1.0}},
        "derived": {"q": {"formula": "sqrt(a * b)"}},
        "objectives": {"q": {"reference": 3.0}, "g": {"reference": 1.0}},
        "observables": {"a": {}, "t": {}},
    }
    made = MoboGenerator(Problem.from_dict(definition))
    assert made.vocs.observable_names == ["a", "b", "t"]
    made.ingest([{"x": 0.5, "a": 4.0, "b": 1.0, "g": 0.5}])
    assert made.optimizer.hypervolume == 0.5


def test_an_observable_that_is_no_number_is_left_alone() -> None:
    made = MoboGenerator(vocs(observables={"log": "str", "turns": int, "trace": ("f8", (3,))}))
    made.ingest(
        [evaluated({"x": 0.5, "y": 0.5, "log": "no beam", "turns": 3, "trace": np.ones(3)})]
    )
    assert made.optimizer.dataset.evaluations[0].values.keys() == {"f", "g", "turns"}


@pytest.mark.parametrize("choice", [{"batch_size": 0}, {"batch_size": True}, {"preset": "best"}])
def test_a_choice_that_is_not_allowed_is_refused_by_name(choice: dict[str, Any]) -> None:
    with pytest.raises(ProblemError, match=next(iter(choice))):
        generator(**choice)


def test_a_vocs_becomes_a_problem_and_back() -> None:
    given = VOCS(**EVERYTHING)
    problem = problem_of(given, {"f": 2.0})
    steps = problem.variables[1]
    assert steps.choices == (0.0, 2.0, 5.0)
    assert problem.objectives[0].direction == "minimize"
    assert problem.objectives[0].reference == 2.0
    assert problem.objectives[1].direction == "maximize"
    limits = {c.name: (c.minimum, c.maximum) for c in problem.constraints}
    assert limits == {"a": (-math.inf, 1.0), "b": (2.0, math.inf), "c": (0.0, 3.0)}
    assert [o.name for o in problem.observables] == ["seen"]
    back = vocs_of(problem)
    for part in ("variables", "objectives", "constraints", "observables"):
        assert getattr(back, part) == getattr(given, part)


def test_a_fidelity_is_chosen_and_a_variable_of_the_vocs() -> None:
    definition = Problem.from_yaml(ROOT / "config" / "fidelity.yaml")
    made = MoboGenerator(definition, seed=1)
    assert made.vocs.variables["mesh"].values == {8.0, 12.0, 24.0}
    [point] = made.suggest(1)
    assert point["mesh"] == 8.0
    outputs = {"sigma_x": 5.0, "eps_x": 90.0, "dE": 0.4}
    made.ingest([{**point, **outputs}])
    made.ingest([{n: v for n, v in point.items() if n not in ("mesh", "_id")} | outputs])
    told = [e.setpoint["mesh"] for e in made.optimizer.dataset.evaluations]
    assert told == [8.0, 24.0]
    assert made.optimizer.pending == []
    assert [p["index"] for p in made.optimizer.pareto_front()] == [1]


def test_a_fixed_variable_is_a_constant() -> None:
    definition = {
        "variables": {"x": {"min": 0.0, "max": 1.0}, "y": {"min": 0.0, "max": 1.0, "fixed": 0.25}},
        "objectives": {name: {"reference": 1.0} for name in ("f", "g")},
    }
    made = MoboGenerator(Problem.from_dict(definition), initial_evaluations=3)
    assert made.vocs.constants["y"].value == 0.25
    [point] = made.suggest(1)
    assert point["y"] == 0.25
    del point["y"]
    made.ingest([{**point, "f": 0.5, "g": 0.5}])
    assert made.optimizer.hypervolume == 0.25


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"variables": {"x": "CONTEXTUAL"}}, "x"),
        ({"objectives": {"f": "EXPLORE"}}, "f"),
        ({"objectives": {}}, "objectives"),
        ({"variables": {"x": {"a", 1}}}, "variables.x.choices"),
        ({"constants": {"x": 0.5}}, "'x' is a constant"),
        ({"constants": {"f": 0.5}}, "'f' is a constant"),
        ({"constants": {"o": 0.5}, "observables": ["o"]}, "'o' is a constant"),
    ],
)
def test_a_vocs_that_cannot_be_tuned_is_refused_by_name(changes: dict[str, Any], name: str) -> None:
    with pytest.raises(ValueError, match=name):
        MoboGenerator(vocs(**changes))


def test_a_reference_of_no_objective_is_refused() -> None:
    with pytest.raises(ProblemError, match="'h'"):
        MoboGenerator(vocs(), {"h": 1.0})
    with pytest.raises(ProblemError, match="references"):
        MoboGenerator(vocs(), [1.0])  # type: ignore[arg-type]
    with pytest.raises(ProblemError, match="references"):
        MoboGenerator(problem_of(vocs(), REFERENCES), REFERENCES)
    with pytest.raises(ProblemError, match="VOCS"):
        MoboGenerator(None)


@pytest.mark.parametrize("name", ["awa", "toy", "shift"])
def test_every_parameter_file_is_a_vocs(name: str) -> None:
    problem = Problem.from_yaml(ROOT / "config" / f"{name}.yaml")
    given = vocs_of(problem)
    assert (*given.variable_names, *given.constant_names) == problem.variable_names
    assert tuple(given.objective_names) == problem.objective_names


def test_libensemble_runs_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulations run at the same time in its workers; every result is learned."""
    from libensemble import Ensemble
    from libensemble.alloc_funcs.start_only_persistent import only_persistent_gens
    from libensemble.specs import AllocSpecs, ExitCriteria, GenSpecs, LibeSpecs, SimSpecs

    monkeypatch.chdir(tmp_path)
    made = generator()
    ensemble = Ensemble(
        libE_specs=LibeSpecs(
            gen_on_manager=True,
            nworkers=3,
            comms="threads",
            disable_log_files=True,
            save_H_and_persis_on_abort=False,
        ),
        gen_specs=GenSpecs(generator=made, batch_size=3, vocs=vocs()),
        sim_specs=SimSpecs(simulator=evaluated, vocs=vocs()),
        alloc_specs=AllocSpecs(alloc_f=only_persistent_gens),
        exit_criteria=ExitCriteria(sim_max=15),
    )
    history, _, flag = ensemble.run()
    assert flag == 0
    done = history[history["sim_ended"]]
    assert len(done) >= 15
    told = {(e.setpoint["x"], e.setpoint["y"]) for e in made.optimizer.dataset.evaluations}
    assert told >= {(row["x"], row["y"]) for row in done[:12]}
    assert made.optimizer.hypervolume > 0.4


def test_words_of_a_discrete_variable_have_no_order() -> None:
    vocs = VOCS(variables={"x": [0.0, 1.0], "t": {"a", "b", "c"}}, objectives={"f": "MINIMIZE"})
    generator = MoboGenerator(vocs, references={"f": 3.0})
    assert generator.optimizer.problem.variables[1].choice_names == ("a", "b", "c")
    points = generator.suggest(3)
    assert {point["t"] for point in points} <= {"a", "b", "c"}
    for point in points:
        point["f"] = point["x"] + (point["t"] == "b")
    generator.ingest(points)
    assert len(generator.optimizer.dataset) == 3
    with pytest.raises(ProblemError, match="t is 'd'; allowed are a, b, c"):
        generator.ingest([{"x": 0.5, "t": "d", "f": 0.5}])
