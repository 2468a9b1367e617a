"""Figure localized_comparison: K1 over 300 evaluations, its steps, and hypervolumes with and without the factor."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.campaign import PlannedRun, Record, Results, Size
from experiments.paper.experiment import Experiment, Row, draw_curves, runs
from experiments.paper.injector import INITIAL, PICTURED, tune, tune_perfectly
from mobo_tuner.core.arrays import FloatArray

# The paper gives Sigma = 0.25 I. As a precision, which its text says, that hardly matters; as a covariance it is 4 I.
PRECISIONS = {"proximal": 4.0, "proximal 0.25": 0.25}
CASES = {
    "ucb_hvi": ("UCB-HVI", "tab:blue"),
    "proximal": (r"P-UCB-HVI, $\Lambda = 4I$", "tab:orange"),
    "proximal 0.25": (r"P-UCB-HVI, $\Lambda = 0.25I$", "tab:purple"),
    "default": ("default", "tab:green"),
    "default proximal": (r"default, $\Lambda = 4I$", "tab:olive"),
    "perfect": ("perfect knowledge", "black"),
}


def plan(size: Size) -> list[PlannedRun]:
    """Return 10 runs of 300 evaluations for each case."""
    n = size.number(300, 24)
    quick = {"quick": True} if size.quick else {}
    runs = []
    for seed in size.seeds_of(10):
        for label, precision in (("default", None), ("default proximal", PRECISIONS["proximal"])):
            arguments = {"evaluations": n, "preset": "default", "proximal": precision}
            runs.append(PlannedRun(label, seed, tune, arguments))
        limit = {"evaluations": size.number(150, 4)}
        runs.append(PlannedRun("perfect", seed, tune_perfectly, limit))
        for label, precision in (("ucb_hvi", None), *PRECISIONS.items()):
            arguments = {"evaluations": n, "preset": "paper", "proximal": precision}
            runs.append(PlannedRun(label, seed, tune, arguments | quick))
    return runs


def _steps(results: Results, label: str) -> FloatArray:
    """Return the changes of K1, which spans 2, at every suggestion of all runs."""
    return np.concatenate([_changes(record, label) for record in results.records(label)])


def _changes(record: Record, label: str) -> FloatArray:
    """Return the changes of K1 at every suggestion of a run."""
    first = INITIAL["default" if label.startswith("default") else "paper"]
    return np.abs(np.diff(record["K1"][first - 1 :]))


def compare(results: Results) -> list[Row]:
    """Return lengths of steps and hypervolumes without and with the factor, of the seeds that have both."""
    rows = []
    for biased in ("proximal", "proximal 0.25", "default proximal"):
        plain = "default" if biased.startswith("default") else "ucb_hvi"
        both = sorted(set(results.runs.get(plain, {})) & set(results.runs.get(biased, {})))
        if not both:
            continue
        pairs = [(results.runs[plain][s], results.runs[biased][s]) for s in both]
        steps = np.array([[r["step"] for r in pair] for pair in pairs])
        volumes = np.array([[r["hypervolumes"][-1] for r in pair] for pair in pairs])
        large = [float((_steps(results, label) > 0.5).mean()) for label in (plain, biased)]
        title = CASES[biased][0].replace("$", "").replace(r"\Lambda", "Λ")
        ratio = steps[:, 1].mean() / steps[:, 0].mean()
        kept = volumes[:, 1] / volumes[:, 0]
        claims = (
            "frequency and amplitude of large jumps decrease",
            "speed “only minimally” reduced",
        )
        if biased != "proximal":
            claims = ("–", "–")
        rows.append(
            Row(
                f"{title}: mean step without, with the factor; steps of K1 above a quarter of its range",
                claims[0],
                f"{steps[:, 0].mean():.2f}, {steps[:, 1].mean():.2f}: × {ratio:.2f}; "
                f"{100 * large[0]:.0f} %, {100 * large[1]:.0f} % ({runs(len(both))})",
            )
        )
        rows.append(
            Row(
                f"{title}: hypervolume after {len(pairs[0][0]['hypervolumes'])} without, with the factor",
                claims[1],
                f"{volumes[:, 0].mean():.2f}, {volumes[:, 1].mean():.2f}: {100 * kept.mean():.1f} % "
                f"(worst run {100 * kept.min():.1f})",
            )
        )
    return rows


def draw(results: Results) -> Figure:
    """Draw K1 and its steps of one run without and with the factor, and the hypervolumes of all runs."""
    figure = Figure(figsize=(9.0, 9.0))
    panels = figure.subplot_mosaic(
        [["a", "a", "a", "b"], ["c", "c", "c", "d"], ["e", "e", "e", "e"]]
    )
    pair = ("ucb_hvi", "proximal")
    if PICTURED not in results.runs.get("proximal", {}):
        pair = ("default", "default proximal")
    bins = [0.1 * i for i in range(21)]
    for label, path, steps, letter in zip(pair, "ac", "bd", "ab", strict=True):
        if record := results.runs.get(label, {}).get(PICTURED):
            title, color = CASES[label]
            n = np.arange(1, len(record["K1"]) + 1)
            panels[path].plot(n, record["K1"], color=color, linewidth=0.8)
            panels[path].set(title=f"({letter}) {title}", ylabel="$K_1$", xlabel="evaluations")
            panels[path].set(ylim=(-1.05, 1.05))
            panels[steps].hist(_changes(record, label), bins, color=color)
            panels[steps].set(xlabel=r"$|\Delta K_1|$", xlim=(0.0, 2.0))
    for label, (title, color) in CASES.items():
        line = {"linestyle": "--"} if label == "perfect" else {}
        draw_curves(panels["e"], results.curves(label), title, color, **line)
    panels["e"].set(title="(c) hypervolume; shading: one sigma", xlabel="evaluations")
    panels["e"].set(ylabel=r"$\mathcal{H}$", ylim=(20.0, None))
    panels["e"].legend(loc="lower right", ncols=2)
    return figure


EXPERIMENT = Experiment(
    "AWA: K1 and its steps with and without the proximal factor, and hypervolumes",
    plan,
    compare,
    draw,
)
