"""Figure convergence: hypervolume in seven objectives against evaluations, by every method, and projected fronts."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.campaign import PlannedRun, Record, Results, Size
from experiments.paper.experiment import (
    Experiment,
    Row,
    draw_curves,
    draw_front,
    mean_and_spread,
    projected_front,
    with_spread,
)
from experiments.paper.injector import (
    PICTURED,
    evolve,
    iterate_networks,
    reached,
    search_randomly,
    tune,
    tune_perfectly,
)
from mobo_tuner.core.arrays import FloatArray

NSGA2_EVALUATIONS = 17_500
METHODS = {
    "paper": ("UCB-HVI", "tab:blue"),
    "default": ("default", "tab:green"),
    "perfect": ("perfect knowledge", "black"),
    "inn": ("I-NN, measured", "tab:orange"),
    "nsga2": ("NSGA-II", "tab:red"),
    "random": ("random", "tab:gray"),
}
BEFORE, AFTER = 200, 500  # evaluations between which the front's growth is looked at


def plan(size: Size) -> list[PlannedRun]:
    """Return the runs of every method, the fast ones first."""
    n, seeds = size.number(500, 24), size.seeds_of(10)
    serial = {"evaluations": size.number(500, 40)}
    total = {"evaluations": size.number(NSGA2_EVALUATIONS, 60), "plotted": size.number(500, 40)}
    quick = {"quick": True} if size.quick else {}
    runs = [PlannedRun("random", s, search_randomly, serial, uses_core=False) for s in seeds]
    runs += [PlannedRun("nsga2", s, evolve, total, uses_core=False) for s in seeds]
    perfect = {"evaluations": size.number(150, 4)}
    for s in seeds:  # seed by seed, so that what is finished can be compared
        runs.append(PlannedRun("default", s, tune, {"evaluations": n, "preset": "default"}))
        runs.append(PlannedRun("inn", s, iterate_networks, serial, uses_core=False))
        runs.append(PlannedRun("perfect", s, tune_perfectly, perfect))
        runs.append(PlannedRun("paper", s, tune, {"evaluations": n, "preset": "paper"} | quick))
    return runs


def nsga2_target(results: Results) -> float:
    """Return the mean hypervolume of NSGA-II after all its evaluations; NaN if there is none."""
    last = [record["later"][-1][1] for record in results.records("nsga2")]
    return float(np.mean(last)) if last else np.nan


def compare(results: Results) -> list[Row]:
    """Return hypervolumes, evaluations to reach that of NSGA-II, factors, and shares on the front."""
    rows = []
    for n in (20, 60, 100, 200, 500):
        parts = [
            f"{title} {with_spread(curves[:, n - 1], 1)}"
            for label, (title, _) in METHODS.items()
            if (curves := results.curves(label)).size and curves.shape[1] >= n
        ]
        claim = "UCB-HVI above I-NN above NSGA-II (figure only)" if n == 500 else "–"
        if parts:
            rows.append(Row(f"hypervolume after {n} evaluations", claim, "; ".join(parts)))
    target = nsga2_target(results)
    if np.isfinite(target):
        every = [record["later"][-1] for record in results.records("nsga2")]
        total = every[0][0]
        final = mean_and_spread(np.array([value for _, value, _ in every]))
        claim = "what UCB-HVI has after 500"
        rows.append(Row(f"NSGA-II after {total} evaluations", claim, final))
        for label in ("paper", "default", "perfect", "inn"):
            rows += _needed(results.records(label), METHODS[label][0], target, total)
    for label in ("paper", "default", "inn", "nsga2"):
        if not (records := results.records(label)):
            continue
        claims = {"paper": "the large majority", "nsga2": "“only a small fraction”"}
        values = results.values(label, "on_front")
        rows.append(
            Row(
                f"{METHODS[label][0]}: share of all {len(records[0]['hypervolumes'])} evaluations on the front",
                claims.get(label, "–"),
                mean_and_spread(values),
            )
        )
    for label in ("paper", "default"):
        if results.records(label):
            rows.append(
                Row(
                    f"{METHODS[label][0]}: share of the front after {BEFORE} that is on it at the end",
                    "“most of the points”" if label == "paper" else "–",
                    mean_and_spread(results.values(label, "kept")),
                )
            )
    if predictions := [r["predicted"][-1][1] for r in results.records("inn")]:
        rows.append(
            Row(
                "I-NN: predicted hypervolume at the end, and measured",
                "predicted only (figure)",
                f"{np.mean(predictions):.1f}, {results.curves('inn')[:, -1].mean():.1f}",
            )
        )
    return rows


def _needed(records: list[Record], title: str, target: float, total: int) -> list[Row]:
    """Return the line that says when a method has the hypervolume of NSGA-II, if it has runs."""
    counts = [reached(record, target) for record in records]
    if not counts:
        return []
    found = [count for count in counts if count is not None]
    text = ", ".join(
        str(count or f"> {len(r['hypervolumes'])}")
        for count, r in zip(counts, records, strict=True)
    )
    if found and len(found) == len(counts):
        text += f"; factor {total / np.mean(found):.0f}"
    claim = "500; factor 35" if title == "UCB-HVI" else "–"
    return [Row(f"{title}: evaluations to reach that, by run", claim, text)]


def draw(results: Results) -> Figure:
    """Draw the curves, the projected fronts of all methods, and those of one run as it goes on."""
    figure = Figure(figsize=(11.0, 9.0))
    panels = figure.subplot_mosaic([["a", "a"], ["b", "c"]], height_ratios=[1.15, 1.0])
    _draw_hypervolumes(panels["a"], results)

    axes = panels["b"]
    axes.set(title=f"(b) fronts after {BEFORE} evaluations", xlabel="dE", ylabel=r"$\varepsilon_x$")
    for label in ("nsga2", "inn", "default", "paper"):
        if record := results.runs.get(label, {}).get(PICTURED):
            points = _projected(record)[:BEFORE]
            draw_front(
                axes, points, METHODS[label][1], METHODS[label][0].removesuffix(", measured")
            )
    axes.legend()
    _draw_growth(panels["c"], results)
    return figure


def _draw_hypervolumes(axes: Axes, results: Results) -> None:
    for label, (title, color) in METHODS.items():
        line = {"linestyle": "--"} if label == "perfect" else {}
        draw_curves(axes, results.curves(label), title, color, **line)
    if records := results.records("inn"):
        n = [count for count, _ in records[0]["predicted"]]
        values = np.array([[value for _, value in record["predicted"]] for record in records])
        axes.errorbar(
            n,
            values.mean(axis=0),
            values.std(axis=0),
            color="tab:orange",
            fmt="o",
            markersize=3,
            capsize=2,
            label="I-NN, predicted by its network",
        )
    if np.isfinite(target := nsga2_target(results)):
        total = results.records("nsga2")[0]["later"][-1][0]
        label = f"NSGA-II after {total} evaluations"
        axes.axhline(target, color="tab:red", linestyle=":", label=label)
    axes.set(title="(a) hypervolume in [-1, 1]$^7$, reference point 1; shading: one sigma")
    axes.set(xlabel="evaluations", ylabel=r"$\mathcal{H}$", ylim=(20.0, None))
    axes.set_xlim(0, max((c.shape[1] for c in map(results.curves, METHODS) if c.size), default=1))
    axes.legend(loc="lower right", ncols=2)


def _draw_growth(axes: Axes, results: Results) -> None:
    label = "paper" if PICTURED in results.runs.get("paper", {}) else "default"
    axes.set(title=f"(c) {METHODS[label][0]} as it goes on", xlabel="dE", ylabel=r"$\varepsilon_x$")
    if PICTURED not in results.runs.get(label, {}):
        return
    points = _projected(results.runs[label][PICTURED])
    insets = (axes.inset_axes((0.42, 0.52, 0.26, 0.42)), axes.inset_axes((0.71, 0.52, 0.27, 0.42)))
    for view in (axes, *insets):
        for n, color in ((100, "lightblue"), (BEFORE, "tab:blue"), (AFTER, "darkblue")):
            edge = {"markeredgecolor": "tab:orange"} if n == AFTER else {}
            draw_front(view, points[:n], color, f"{n} evaluations", **edge)
    axes.legend(loc="lower left")
    for view, title, at in zip(insets, ("(i)", "(ii)"), _places(points), strict=True):
        width = 0.12 * np.ptp(projected_front(points), axis=0) + 1e-6
        view.set(
            xlim=(at[0] - width[0], at[0] + width[0]), ylim=(at[1] - width[1], at[1] + width[1])
        )
        view.set(xticks=[], yticks=[])
        view.set_title(title, fontsize=8, pad=2.0)
        axes.indicate_inset_zoom(view, edgecolor="gray")


def _places(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where a new point fills a gap of the front most, and where one dominates old points most.

    Args:
        points: All evaluations in two objectives `(n, 2)`.
    """
    old, new = projected_front(points[:BEFORE]), projected_front(points)
    filling, dominating = new[0], new[0]
    most = [-1.0, -1.0]
    for point in new:
        dominated = old[(old >= point).all(axis=1) & (old > point).any(axis=1)]
        if len(dominated):
            gain = float(np.prod(dominated - point, axis=1).max())
            if gain > most[1]:
                most[1], dominating = gain, point
        elif not (old == point).all(axis=1).any():
            gain = float(np.abs(old - point).max(axis=1).min())
            if gain > most[0]:
                most[0], filling = gain, point
    return filling, dominating


def _projected(record: Record) -> FloatArray:
    """Return the evaluations of a record in dE and eps_x, scaled to [-1, 1], `(n, 2)`."""
    return np.stack([record["dE"], record["eps_x"]], axis=1)


EXPERIMENT = Experiment(
    "AWA: hypervolume against evaluations of all methods, and projected fronts",
    plan,
    compare,
    draw,
)
