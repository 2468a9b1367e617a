"""The plots of a report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from mobo_tuner.core.pareto import is_nondominated
from mobo_tuner.core.problem import Array, Objective, Problem, Variable
from mobo_tuner.core.units import product_of_units, spans_decades
from mobo_tuner.runs.recorded_run import BoolArray, RecordedRun
from mobo_tuner.runs.report.figures import staircase
from mobo_tuner.runs.report.models import ModelFacts
from mobo_tuner.runs.report.summary import Recommendation
from mobo_tuner.runs.report.svg import Axis, ParallelAxes, Plot

INDEX = "index of the evaluation"
LARGE, MIDDLE = (520, 340), (520, 270)
SMALL, SQUARE = (330, 220), (330, 300)
_MOST_LINES = 300  # of parallel coordinates, beside the front
_MOST_AXES = 40


def convergence(run: RecordedRun) -> Plot:
    """Return the hypervolume over the evaluations, with failures, changes and a resumption marked."""
    unit = product_of_units([o.unit for o in run.problem.objectives])
    x = run.indices
    top = np.nanmax([0.0, *run.hypervolumes, *run.hypervolumes_measured])
    plot = Plot(
        _indices(run),
        Axis(0.0, 1.08 * float(top) or 1.0),
        f"hypervolume [{unit}]" if unit else "hypervolume",
        size=MIDDLE,
        left=64,
    )
    if run.initial.any():
        plot.band(-0.5, float(x[run.initial].max()) + 0.5, "initial")
    for change in run.history.changes:
        plot.upright(change.index - 0.5, "k-d dashed", "problem or budget changed")
    resumed = run.history.start.resumed_from or {}
    if isinstance(resumed.get("evaluations"), int):
        plot.upright(resumed["evaluations"] - 0.5, "k-c dotted", "resumed")
    if run.is_noisy:
        plot.line(x, run.hypervolumes_measured, "k-e dashed", "of the readings", step=True)
    plot.line(x, run.hypervolumes, "k-a", "of the models' means" if run.is_noisy else "", step=True)
    kinds = (
        (run.valid & run.cheaper, "k-f", "lower fidelity", "square"),
        (run.infeasible, "k-b", "infeasible", "cross"),
        (run.failed, "k-bad thick", "failed", "cross"),
        (_by_operators(run), "k-c", "operator's set-point", "triangle"),
    )
    for rows, css, legend, shape in kinds:
        plot.marks(x[rows], run.hypervolumes[rows], css, legend, shape=shape)
    return plot


def fronts(run: RecordedRun, recommended: Sequence[Recommendation]) -> list[Plot]:
    """Return the front in the plane of each pair of objectives; over the evaluations if there is one."""
    if len(run.problem.objectives) == 1:
        return [_best_value(run)]
    size = LARGE if len(run.problem.objectives) == 2 else SMALL
    pairs = combinations(range(len(run.problem.objectives)), 2)
    return [_front_of_pair(run, pair, recommended, size) for pair in pairs]


def parallel_coordinates(run: RecordedRun, recommended: Sequence[Recommendation]) -> ParallelAxes:
    """Return objectives and variables that are not fixed, of the front and of other feasible evaluations."""
    problem = run.problem
    free = [(j, v) for j, v in enumerate(problem.variables) if v.fixed is None]
    columns = [_ranks(v, run.setpoints[:, j]) for j, v in free]
    setpoints = np.column_stack([np.empty((len(run.indices), 0)), *columns])
    values = np.hstack([run.objectives, setpoints])
    front = np.hstack([run.front_objectives, setpoints[run.front]])
    others = np.setdiff1d(np.flatnonzero(run.feasible), run.front)
    labels = [label(o) for o in problem.objectives]
    axes = [
        Axis.around(column, text, margin=0.0, log=spans_decades(column))
        for column, text in zip(
            _front_or(front, values[run.feasible], values).T, labels, strict=False
        )
    ]
    axes += [
        Axis(
            v.rank(v.minimum),
            v.rank(v.maximum),
            f"{v.name} [{v.unit}]" if v.unit else v.name,
            named=_choices(v),
            log=v.scale == "log",
        )
        for _, v in free
    ]
    plot = ParallelAxes(axes[:_MOST_AXES])
    plot.lines(values[others[-_MOST_LINES:], :_MOST_AXES], "k-faint")
    front = front[:, :_MOST_AXES]
    plot.lines(front, "k-a thin", [point_title(run, row) for row in range(len(front))])
    for recommendation, css in zip(
        recommended[:2], ("k-b thick", "k-d thick dashed"), strict=False
    ):
        rows = [recommendation.row]
        plot.lines(front[rows], css, [point_title(run, row) for row in rows])
    return plot


def trajectories(run: RecordedRun) -> list[Plot]:
    """Return every variable over the evaluations, between its bounds as they were then."""
    plots = []
    for j, variable in enumerate(run.problem.variables):
        name = variable.name
        bounds = np.array(
            [
                (v.minimum, v.maximum)
                for problem in _problems(run)
                for v in problem.variables
                if v.name == name
            ]
        ).reshape(-1, 2)
        values, bounds = _ranks(variable, run.setpoints[:, j]), _ranks(variable, bounds)
        ends = _ranks(variable, np.array([variable.minimum, variable.maximum]))
        shown = [*values, *([*bounds.ravel(), *ends] if variable.fixed is None else [])]
        plot = Plot(
            _indices(run),
            replace(
                Axis.around(
                    shown,
                    f"[{variable.unit}]" if variable.unit else "",
                    log=variable.scale == "log",
                ),
                named=_choices(variable),
            ),
            name,
            SMALL,
        )
        for column in bounds.T if variable.fixed is None else ():
            plot.line(run.indices, column, "k-e dashed thin", "bounds", step=True)
        plot.line(run.indices, values, "k-faint")
        _kinds(plot, run, values)
        plots.append(plot)
    return plots


def _choices(variable: Variable) -> list[tuple[float, str]]:
    """Return places and names of the choices of a variable, if they have names."""
    return [(float(i), name) for i, name in enumerate(variable.choice_names)]


def _ranks(variable: Variable, values: Array) -> Array:
    """Return where values of a variable are shown, any shape."""
    return np.array([variable.rank(v) for v in values.ravel()]).reshape(values.shape)


def constraints(run: RecordedRun) -> list[Plot]:
    """Return every constrained diagnostic over the evaluations, with its limits."""
    plots = []
    for constraint in run.problem.constraints:
        values, stddevs = run.readings(constraint.name)
        values = np.where(run.valid, values, np.nan)
        limits = [v for v in (constraint.minimum, constraint.maximum) if np.isfinite(v)]
        unit = constraint.unit or run.problem.units.get(constraint.name, "")
        plot = Plot(
            _indices(run),
            _axis(values, limits, f"[{unit}]" if unit else "", margin=0.08),
            constraint.name,
            SMALL,
        )
        plot.spans(run.indices, values - stddevs, values + stddevs, "k-e thin")
        for limit in limits:
            plot.level(limit, "k-bad", "limit")
        _kinds(plot, run, values)
        plots.append(plot)
    return plots


def contexts(run: RecordedRun) -> list[Plot]:
    """Return every context over the evaluations; a gap is where it was not measured."""
    plots = []
    for context in run.problem.context:
        values, stddevs = run.readings(context.name)
        text = f"[{context.unit}]" if context.unit else ""
        axis = Axis.around(values, text, margin=0.08, log=spans_decades(values))
        plot = Plot(_indices(run), axis, context.name, SMALL)
        plot.line(run.indices, values, "k-faint")
        plot.spans(run.indices, values - stddevs, values + stddevs, "k-e thin")
        plot.marks(run.indices, values, "k-a")
        plots.append(plot)
    return plots


def quality(facts: Sequence[ModelFacts]) -> list[Plot]:
    """Return predicted against measured of each output, each reading predicted from all others."""
    plots = []
    for fact in facts:
        unit = f" [{fact.unit}]" if fact.unit else ""
        both = np.concatenate([fact.measured, fact.predicted])
        across = _axis(both, (), f"measured{unit}", share=2.0)
        plot = Plot(across, replace(across, label="predicted"), fact.name, size=SQUARE)
        low, high = across.low, across.high
        plot.line([low, high], [low, high], "k-e dashed thin")
        ends = (fact.predicted - fact.stddevs, fact.predicted + fact.stddevs)
        plot.spans(fact.measured, *ends, "k-faint")
        plot.marks(fact.measured, fact.predicted, "k-a")
        plots.append(plot)
    return plots


def label(objective: Objective) -> str:
    """Return name and unit of an objective, and that it is maximised if it is."""
    name = f"{objective.name} (max)" if objective.direction == "maximize" else objective.name
    return f"{name} [{objective.unit}]" if objective.unit else name


def point_title(run: RecordedRun, row: int, names: Sequence[str] = ()) -> str:
    """Return what a point of the front says of itself: all of it, or only some objectives."""
    point, units = run.pareto_front[row], run.problem.units
    shown: Mapping[str, float] = point["objectives"] | ({} if names else point["setpoint"])
    texts = [
        f"{name} = {run.problem.shown(name, value, 4)} {units.get(name, '')}".rstrip()
        for name, value in shown.items()
        if not names or name in names
    ]
    return f"evaluation {point['index']}: {', '.join(texts)}"


def _front_of_pair(
    run: RecordedRun,
    pair: tuple[int, int],
    recommended: Sequence[Recommendation],
    size: tuple[int, int],
) -> Plot:
    columns = list(pair)
    across, up = (run.problem.objectives[j] for j in columns)
    signs, reference = run.signs[columns], run.problem.reference_point[columns]
    xy, front = run.objectives[:, columns], run.front_objectives[:, columns]
    two = len(run.problem.objectives) == 2
    needed = np.vstack([front, *([signs * reference] if two else [])])
    x, y = (_axis(xy[run.valid, j], needed[:, j], label(o)) for j, o in enumerate((across, up)))
    plot = Plot(x, y, "", size)
    for objective, draw in ((across, plot.upright), (up, plot.level)):
        draw(objective.reference, "k-e dashed thin", "reference")
        for constraint in run.problem.constraints:
            if constraint.name == objective.name:
                draw(constraint.minimum, "k-bad thin", "limit")
                draw(constraint.maximum, "k-bad thin", "limit")
    for rows, css, legend, shape in _outside_the_front(run):
        plot.marks(xy[rows, 0], xy[rows, 1], css, legend, shape=shape)
    plot.marks(xy[run.feasible, 0], xy[run.feasible, 1], "k-faint", "feasible")
    if len(front):
        projected = front[is_nondominated(front * signs)]
        steps = staircase(projected * signs, reference) * signs
        plot.line(steps[:, 0], steps[:, 1], "k-a thin", "front" if two else "front of these two")
        titles = [
            point_title(run, row, () if two else (across.name, up.name))
            for row in range(len(front))
        ]
        stddevs = np.array([[p["stddevs"][o.name] for o in (across, up)] for p in run.pareto_front])
        if two:
            plot.spans(
                front[:, 0], front[:, 1] - stddevs[:, 1], front[:, 1] + stddevs[:, 1], "k-a thin"
            )
        plot.marks(front[:, 0], front[:, 1], "k-a", "" if two else "front of all", titles=titles)
        best = front[[r.row for r in recommended if r.reasons[0] in ("balanced", "knee")]]
        plot.marks(best[:, 0], best[:, 1], "k-d", "balanced, knee", shape="diamond")
    return plot


def _best_value(run: RecordedRun) -> Plot:
    (objective,) = run.problem.objectives
    values = np.where(run.valid, run.objectives[:, 0], np.nan)
    needed = [objective.reference, *run.front_objectives[:, 0]]
    plot = Plot(_indices(run), _axis(values, needed, label(objective)), size=MIDDLE)
    plot.level(objective.reference, "k-e dashed thin", "reference")
    feasible = np.where(run.feasible, objective.sign * values, np.inf)
    best = np.minimum.accumulate(feasible) if len(feasible) else feasible
    best = np.where(np.isfinite(best), objective.sign * best, np.nan)
    plot.line(run.indices, best, "k-a", "best so far", step=True)
    _kinds(plot, run, values)
    return plot


def _kinds(plot: Plot, run: RecordedRun, values: Array) -> None:
    """Draw values over the evaluations, each kind by a mark of its own."""
    on_front = np.isin(run.indices, run.front)
    for rows, css, legend, shape in (
        *_outside_the_front(run),
        (run.feasible & ~on_front, "k-faint", "feasible", "dot"),
        (on_front, "k-a", "on the front", "dot"),
        (run.failed, "k-bad", "failed", "cross"),
    ):
        plot.marks(run.indices[rows], values[rows], css, legend, shape=shape)


def _outside_the_front(run: RecordedRun) -> list[tuple[BoolArray, str, str, str]]:
    """Return which measured evaluations can never be on the front, each kind with style, legend and shape."""
    return [
        (run.valid & run.cheaper, "k-f thin", "lower fidelity", "square"),
        (run.infeasible, "k-b thin", "infeasible", "cross"),
    ]


def _by_operators(run: RecordedRun) -> Array:
    return np.array([e.source == "operator" for e in run.evaluations], dtype=bool)


def _problems(run: RecordedRun) -> Iterator[Problem]:
    """Yield the problem that was in force at each evaluation."""
    changes = {change.index: change.problem for change in run.history.changes}
    problem = run.history.problem
    for index in range(len(run.evaluations)):
        problem = changes.get(index, problem)
        yield problem


def _indices(run: RecordedRun) -> Axis:
    return Axis(-0.5, max(len(run.indices) - 0.5, 1.0), INDEX, integer=True)


def _front_or(*choices: Array) -> Array:
    """Return the first of some arrays that has a finite row, or the last."""
    return next((c for c in choices if np.isfinite(c).all(axis=1).any()), choices[-1])


def _axis(
    values: Array,
    needed: Sequence[float] | Array,
    text: str,
    *,
    margin: float = 0.05,
    share: float = 10.0,
) -> Axis:
    """Return an axis for measured values, logarithmic if they span decades; see `_bulk`."""
    if spans_decades(values) and all(v > 0.0 for v in needed if np.isfinite(v)):
        low, high = _bulk(np.log10(values), np.log10(needed), share)
        return Axis.around([10.0**low, 10.0**high], text, margin=margin, log=True)
    return Axis.around(_bulk(values, needed, share), text, margin=margin)


def _bulk(
    values: Array, needed: Sequence[float] | Array, share: float = 10.0
) -> tuple[float, float]:
    """Return ends that show what is needed and all values but for the extreme ones.

    Args:
        values: Values, NaN if not measured.
        needed: Values that must be shown.
        share: Share of the values at either end that may be left out [%], if they are far away.
    """
    known = values[np.isfinite(values)]
    must = np.asarray([v for v in needed if np.isfinite(v)], dtype=float)
    if not len(known) and not len(must):
        return 0.0, 1.0
    if len(known):
        low, high = np.percentile(known, [share, 100.0 - share])
        width = 1.5 * (high - low)
        near = known[(known >= low - width) & (known <= high + width)]
        must = np.concatenate([must, near if len(near) else known])
    return float(must.min()), float(must.max())
