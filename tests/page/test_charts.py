"""The plots as data: what is on them for few and many points, failures, and none feasible."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest

from mobo_tuner.client import Evaluation, Front, Point
from mobo_tuner.core.problem import Problem
from mobo_tuner.page import chart_parts, charts, model_charts, traces
from mobo_tuner.page.board import RunBoard

COLOURS = [chart_parts.DARK, chart_parts.LIGHT]


def make_problem(objectives: int, **further: Any) -> Problem:
    names = [f"f{i}" for i in range(objectives)]
    return Problem.from_dict(
        {
            "variables": {"x": {"min": 0.0, "max": 1.0, "unit": "A"}, "y": {"min": 0, "max": 2}},
            "objectives": {name: {"reference": 2.0, **further} for name in names},
            "constraints": {"g": {"max": 0.5}},
            "observables": {"charge": {"unit": "nC"}},
        }
    )


def make_evaluation(index: int, objectives: int, kind: str = "feasible") -> Evaluation:
    values = {f"f{i}": (index % 7) / 7.0 + i / 10.0 for i in range(objectives)}
    if kind == "failed":
        values = dict.fromkeys(values, math.nan)
    diagnostics = {name: (value, 0.1) for name, value in values.items()}
    diagnostics["g"] = ({"failed": math.nan, "infeasible": 0.9}.get(kind, 0.2), math.nan)
    return Evaluation(
        index=index,
        source="model",
        attempts=1,
        stamp=0.0,
        setpoint={"x": (index % 11) / 11.0, "y": 1.0},
        readbacks={},
        diagnostics=diagnostics,
        valid=kind != "failed",
        feasible=kind == "feasible",
        non_dominated=False,
        hypervolume=float(index),
        hypervolume_measured=float(index),
        error_code=0,
        error_msg="",
        suggest_seconds=0.1,
        machine_seconds=1.0,
        total_seconds=1.1,
        run_id="run",
        objectives=values,
        units={},
    )


def make_run(
    problem: Problem, count: int, kinds: tuple[str, ...] = ("feasible",), points: int = 0
) -> RunBoard:
    """A run whose first evaluations are on the front."""
    run = RunBoard("run")
    run.set_problem(problem)
    objectives = len(problem.objectives)
    for index in range(count):
        run.add(make_evaluation(index, objectives, kinds[index % len(kinds)]))
    found = [
        Point(e.index, e.setpoint, e.objectives, dict.fromkeys(e.objectives, 0.1))
        for e in run.evaluations[:points]
    ]
    run.front = Front("run", tuple(found), 1.0, 1.0, {}, {})
    return run


def series(options: chart_parts.Options, name: str) -> list[Any]:
    [found] = [s["data"] for s in options["series"] if s.get("name") == name]
    return list(found)


def every_plot(run: RunBoard, colours: chart_parts.Colours) -> list[chart_parts.Options]:
    assert run.problem is not None
    names = run.problem.objective_names
    return [
        charts.front(run, names[0], names[-1], 0, colours),
        charts.hypervolume(run, colours),
        charts.parallel(run, 0, colours),
        *(traces.variable(run, v, colours) for v in run.problem.variables),
        *(traces.diagnostic(run, name, "", colours) for name in (*names, "g", "charge")),
    ]


@pytest.mark.parametrize("objectives", [2, 7])
@pytest.mark.parametrize("count", [0, 1, 5000])
@pytest.mark.parametrize(
    "kinds", [("feasible",), ("feasible", "failed", "infeasible"), ("failed",), ("infeasible",)]
)
def test_every_plot_is_strict_json_of_a_bounded_size(
    objectives: int, count: int, kinds: tuple[str, ...]
) -> None:
    run = make_run(
        make_problem(objectives), count, kinds, points=3 if kinds[0] == "feasible" else 0
    )
    for colours in COLOURS:
        for options in every_plot(run, colours):
            assert len(json.dumps(options, allow_nan=False)) < 200_000


def test_a_plot_has_the_same_series_whatever_was_found() -> None:
    problem = make_problem(2)
    empty = every_plot(make_run(problem, 0), chart_parts.DARK)
    full = every_plot(make_run(problem, 50, ("feasible", "failed"), points=5), chart_parts.DARK)
    for first, second in zip(empty, full, strict=True):
        assert len(first["series"]) == len(second["series"])


def test_the_front_shows_each_evaluation_once_where_it_belongs() -> None:
    run = make_run(make_problem(2), 9, ("feasible", "infeasible", "failed"), points=2)
    options = charts.front(run, "f0", "f1", 1, chart_parts.DARK)
    assert [p["value"][2] for p in series(options, "front")] == [0, 1]
    assert [p["value"][2] for p in series(options, "feasible")] == [3, 6]
    assert [p["value"][2] for p in series(options, "infeasible")] == [4, 7]
    assert series(options, "failed") == []  # they have no place among the objectives
    assert [p["value"][2] for p in series(options, "chosen")] == [1]
    assert "x 0.0000 A" in series(options, "front")[0]["name"]


def test_a_point_of_the_models_is_told_from_a_measured_one() -> None:
    run = make_run(make_problem(2), 3, points=1)
    guessed = Point(2, {"x": 0.5, "y": 1.0}, {"f0": 0.1, "f1": 0.2}, {}, predicted=("f1",))
    assert run.front is not None
    run.front = Front("run", (*run.front.points, guessed), 1.0, 1.0, {}, {})
    options = charts.front(run, "f0", "f1", None, chart_parts.DARK)
    assert [p["value"][2] for p in series(options, "model")] == [2]


def test_the_reference_point_and_the_truncation_box_are_drawn() -> None:
    problem = make_problem(2, truncation=[0.5, 2.0])
    options = charts.front(make_run(problem, 3, points=1), "f0", "f1", None, chart_parts.DARK)
    [front] = [s for s in options["series"] if s["name"] == "front"]
    assert front["markLine"]["data"] == [{"xAxis": 2.0}, {"yAxis": 2.0}]
    assert front["markArea"]["data"] == [
        [{"xAxis": 0.5, "yAxis": 0.5}, {"xAxis": 2.0, "yAxis": 2.0}]
    ]
    assert options["xAxis"][0]["max"] > 2.0


def test_many_points_are_thinned_out_and_the_last_one_stays() -> None:
    options = charts.hypervolume(make_run(make_problem(2), 5000), chart_parts.DARK)
    shown = series(options, "hypervolume")
    assert len(shown) <= chart_parts.MAX_POINTS
    assert shown[-1] == [5000, 4999.0]


def test_the_limits_of_a_diagnostic_and_its_error_bars_are_drawn() -> None:
    run = make_run(make_problem(2), 2)
    options = traces.diagnostic(run, "g", "", chart_parts.DARK)
    [points] = [s for s in options["series"] if s["name"] == "feasible"]
    assert points["markLine"]["data"] == [{"yAxis": 0.5}]
    [bar, _] = series(traces.diagnostic(run, "f0", "", chart_parts.DARK), "standard deviation")
    assert bar[3:] == pytest.approx([-0.1, 0.1])


@pytest.mark.parametrize("objectives", [2, 7])
def test_a_problem_that_changed_during_the_run_is_drawn_with_what_was_measured(
    objectives: int,
) -> None:
    run = make_run(make_problem(objectives), 12, ("feasible", "failed", "infeasible"), points=4)
    content = make_problem(objectives + 1).to_dict()
    content["variables"] = {
        "x": {"min": 0.2, "max": 0.4},
        "z": {"min": 0.0, "max": 1.0, "unit": "A"},
    }
    content["constraints"] = {"g": {"min": 0.1, "max": 0.3}, "h": {"max": 1.0}}
    run.problem = Problem.from_dict(content)
    added = f"f{objectives}"
    for colours in COLOURS:
        plots = [*every_plot(run, colours), charts.front(run, "f0", added, 0, colours)]
        json.dumps(plots, allow_nan=False)
    assert series(charts.front(run, "f0", added, 0, chart_parts.DARK), "feasible") == []
    [*_, variable] = run.problem.variables
    assert series(traces.variable(run, variable, chart_parts.DARK), "set-point") == []
    drawn = traces.diagnostic(run, "g", "", chart_parts.DARK)
    assert drawn["title"]["text"] == "g, 0.1 to 0.3"


def test_a_resumed_run_continues_the_indices_of_the_earlier_one() -> None:
    problem = make_problem(2)
    run = make_run(problem, 5)
    for index in (3, 4, 5, 6):  # the first two come once more
        run.add(make_evaluation(index, 2))
    drawn = series(charts.hypervolume(run, chart_parts.DARK), "hypervolume")
    assert [x for x, _ in drawn] == [1, 2, 3, 4, 5, 6, 7]
    shown = series(traces.variable(run, problem.variables[0], chart_parts.DARK), "set-point")
    assert [point["value"][0] for point in shown] == [*range(7)]


def test_the_legend_names_what_is_there_and_one_evaluation_is_seen() -> None:
    run = make_run(make_problem(2), 1)
    assert charts.front(run, "f0", "f1", None, chart_parts.DARK)["legend"]["data"] == [
        "front",
        "feasible",
        "last",
    ]
    assert {s["symbol"] for s in charts.hypervolume(run, chart_parts.DARK)["series"]} == {"circle"}


def test_a_chosen_point_that_left_the_front_stays_chosen() -> None:
    run = make_run(make_problem(2), 6, ("feasible", "infeasible"), points=1)
    ring = series(charts.front(run, "f0", "f1", 4, chart_parts.DARK), "chosen")
    assert [point["value"][2] for point in ring] == [4]
    assert (run.is_on_front(0), run.is_on_front(4)) == (True, False)
    point = run.point(4)
    assert point is not None
    assert point.setpoint == run.evaluations[4].setpoint
    assert run.point(5) is None  # infeasible
    assert run.point(None) is run.point(99) is None


def test_choices_without_an_order_are_drawn_side_by_side_whatever_stands_for_them() -> None:
    problem = Problem.from_dict(
        {
            "variables": {
                "filter": {"choices": ["foil", "mesh", "none"], "values": [0.0, 1.0, 1000.0]},
                "gain": {"min": 1.0, "max": 100.0, "scale": "log"},
                "spare": {"fixed": 3.0},
            },
            "objectives": {"f0": {"reference": 2.0}, "f1": {"reference": 2.0}},
        }
    )
    run = RunBoard("run")
    run.problem = problem
    setpoints = [{"filter": f, "gain": 10.0, "spare": 3.0} for f in (1000.0, 0.0, 1.0)]
    for index, setpoint in enumerate(setpoints):
        run.add(replace(make_evaluation(index, 2), setpoint=setpoint))
    places = [Point(i, s, {"f0": 1.0, "f1": 1.0}, {}) for i, s in enumerate(setpoints)]
    run.front = Front("run", tuple(places), 1.0, 1.0, {}, {})
    plot = traces.variable(run, problem.variables[0], COLOURS[0])
    assert [point["value"][1] for point in series(plot, "set-point")] == [2.0, 0.0, 1.0]
    coordinates = charts.parallel(run, None, COLOURS[0])
    assert [axis["id"] for axis in coordinates["parallelAxis"]] == ["f0", "f1", "filter", "gain"]
    assert coordinates["parallelAxis"][3]["type"] == "log"
    assert [line["value"][2] for line in coordinates["series"][0]["data"]] == [2.0, 0.0, 1.0]
    content = {
        "setpoint": setpoints[0],
        "slices": {
            "filter": {
                "values": [0.0, 1.0, 1000.0],
                "means": {"f0": [1.0, 2.0, 3.0]},
                "stddevs": {"f0": [0.1, 0.2, 0.3]},
                "acquisition": [0.0, 1.0, 0.5],
            }
        },
    }
    slices = model_charts.model_slice(content, problem.variables[0], "f0", COLOURS[0])
    assert "line" not in {part["type"] for part in slices["series"] if part["data"]}
    assert series(slices, "mean") == [[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]]
    json.dumps([plot, coordinates, slices], allow_nan=False)


def test_the_models_say_for_which_contexts_they_speak() -> None:
    problem = Problem.from_dict(
        make_problem(2).to_dict() | {"context": {"hall": {"unit": "degC"}, "flow": {}}}
    )
    content = {"contexts": {"hall": 22.456, "flow": None}}
    assert model_charts.at_contexts(content, problem) == ", for the last reading of hall 22.46 degC"
    assert model_charts.at_contexts({}, problem) == ""


def test_objectives_that_span_decades_have_logarithmic_axes() -> None:
    run = RunBoard("run")
    run.problem = make_problem(2)
    for index in range(12):
        values = {"f0": 10.0 ** (index - 8), "f1": 1.0}
        diagnostics = {name: (value, 1e-5) for name, value in values.items()}
        made = make_evaluation(index, 2)
        run.add(replace(made, objectives=values, diagnostics=diagnostics))
    found = [Point(e.index, e.setpoint, e.objectives, {}) for e in run.evaluations]
    run.front = Front("run", tuple(found), 1.0, 1.0, {}, {})
    front = charts.front(run, "f0", "f1", None, chart_parts.DARK)
    assert (front["xAxis"][0]["type"], front["yAxis"][0]["type"]) == ("log", "value")
    assert front["xAxis"][0]["min"] == pytest.approx(1e-8)
    parallel = charts.parallel(run, None, chart_parts.DARK)["parallelAxis"]
    assert [axis.get("type") for axis in parallel[:2]] == ["log", None]
    trace = traces.diagnostic(run, "f0", "", chart_parts.DARK)
    assert trace["yAxis"][0]["type"] == "log"
    assert all(bar[3] > 0.0 for bar in series(trace, "standard deviation"))


def test_a_problem_that_was_changed_judges_all_evaluations_again() -> None:
    problem = make_problem(2)
    run = make_run(problem, 6, ("feasible", "infeasible", "failed"))
    assert [*run.is_feasible] == [True, False, False] * 2
    assert (run.changes, run.without_gain) == ([], 0)
    wider = replace(problem, constraints=(replace(problem.constraints[0], maximum=1.0),))
    run.set_problem(wider)
    assert [*run.is_feasible] == [True, True, False] * 2
    assert run.progress.feasible == 4
    point = run.point(1)
    assert point is not None
    assert point.index == 1
    assert run.point(2) is None
    plot = charts.front(run, "f0", "f1", None, chart_parts.DARK)
    assert [p["value"][2] for p in series(plot, "feasible")] == [0, 1, 3, 4]
    trace = traces.diagnostic(run, "g", "", chart_parts.DARK)
    assert [p["value"][0] for p in series(trace, "feasible")] == [0, 1, 3, 4]
    run.set_problem(wider)  # as it is: a tuner tells it again after a change of the budget
    assert run.changes == [6]
    run.add(replace(make_evaluation(6, 2), hypervolume=0.5))  # of another front than before
    assert run.without_gain == 0
    marked = charts.hypervolume(run, chart_parts.DARK)["series"][1]["markLine"]["data"]
    assert marked == [{"xAxis": 6}]


def test_limits_of_an_objective_are_straight_lines() -> None:
    problem = make_problem(2)
    limited = replace(problem.constraints[0], name="f1")
    run = make_run(replace(problem, constraints=(limited,)), 2)
    plot = charts.front(run, "f0", "f1", None, chart_parts.DARK)
    [lines] = [s["markLine"]["data"] for s in plot["series"] if s["name"] == "front"]
    assert [next(iter(line.items())) for line in lines] == [
        ("xAxis", 2.0),
        ("yAxis", 2.0),
        ("yAxis", 0.5),
    ]


def test_a_variable_is_shown_between_its_bounds_and_where_it_was_before_they_changed() -> None:
    problem = make_problem(2)
    run = make_run(problem, 1)
    [axis] = traces.variable(run, problem.variables[0], chart_parts.DARK)["yAxis"]
    assert (axis["min"], axis["max"]) == (0.0, 1.0)
    narrower = replace(problem.variables[0], maximum=0.5)
    run = make_run(replace(problem, variables=(narrower, problem.variables[1])), 11, points=11)
    [axis] = traces.variable(run, narrower, chart_parts.DARK)["yAxis"]
    assert axis["max"] == pytest.approx(10.0 / 11.0)
    parallel = charts.parallel(run, None, chart_parts.DARK)["parallelAxis"][2]
    assert (parallel["id"], parallel["max"]) == ("x", axis["max"])
    assert parallel["axisLabel"]["customValues"] == [0.0, 0.25, 0.5]
