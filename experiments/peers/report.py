"""Tables and the picture of the comparison, from the results alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.campaign import Results
from experiments.peers.hard import HARD
from experiments.peers.problems import HELD_OUT

TITLES = {
    "default": ("default", "tab:green"),
    "paper": ("`paper`", "tab:blue"),
    "xopt": ("Xopt MOBO", "tab:purple"),
    "botorch": ("BoTorch qLogNEHVI", "tab:orange"),
    "nsga2": ("pymoo NSGA-II", "tab:red"),
    "random": ("random", "tab:gray"),
    "perfect": ("perfect knowledge", "black"),
}
PEERS = ("xopt", "botorch", "nsga2", "random")
KINDS = ("held-out", "hard", "others")
LEVEL = 0.005  # of the hypervolume: less is a tie
_LEAST_COMPARED = 20  # evaluations of a run that was stopped


def kind_of(problem: str) -> str:
    """Return one of `KINDS`: held out, made so that starts get stuck, or another one."""
    return "held-out" if problem in HELD_OUT else "hard" if problem in HARD else "others"


def label(method: str, noise: float) -> str:
    """Return the label of the runs of a method with a noise."""
    return method if noise == 0.0 else f"{method}, {100 * noise:g} % noise"


class Duel(NamedTuple):
    """Default against a peer on one problem and seed.

    Attributes:
        problem: Problem.
        seed: Seed of the starts.
        early: Ratio of the hypervolumes after 30 evaluations, or at the end if there are fewer.
        late: Ratio of the hypervolumes at the end.
        lowest: Lowest ratio of the hypervolumes from evaluation 20 on.
        needed: Evaluations that ours needs for the peer's last hypervolume, as a share of those that the peer needed;
            infinite if ours does not reach it.
    """

    problem: str
    seed: int
    early: float
    late: float
    lowest: float
    needed: float


def duels(all_results: Mapping[str, Results], peer: str, noise: float) -> list[Duel]:
    """Return the duels of the default strategy with a peer, as far as both have come.

    A run that was stopped before evaluation 20 is left out.
    """
    found = []
    for problem, results in all_results.items():
        ours, theirs = (results.runs.get(label(m, noise), {}) for m in ("default", peer))
        for seed in sorted(ours.keys() & theirs.keys()):
            if theirs[seed].get("stopped", _LEAST_COMPARED) < _LEAST_COMPARED:
                continue
            a, b = (np.array(runs[seed]["hypervolumes"]) for runs in (ours, theirs))
            n = min(len(a), len(b))
            a, b = a[:n], b[:n]
            last = b[-1]
            reach = [np.flatnonzero(curve >= last * (1.0 - 1e-9)) for curve in (a, b)]
            needed = (reach[0][0] + 1) / (reach[1][0] + 1) if len(reach[0]) else np.inf
            early = min(30, n) - 1
            ratios = [
                _ratio(ours_then, theirs_then) for ours_then, theirs_then in zip(a, b, strict=True)
            ]
            lowest = min(ratios[min(20, n) - 1 :])
            found.append(Duel(problem, seed, ratios[early], ratios[-1], lowest, needed))
    return found


def _ratio(a: float, b: float) -> float:
    return 1.0 if a == b else float(a / b) if b > 0.0 else np.inf


def summary(all_results: Mapping[str, Results], noise: float) -> list[str]:
    """Return the table of the default strategy against each peer, by the kind of the problems."""
    lines = [
        "| default against | problems | duels | ahead or level after 30, at the end | ahead at the end | "
        "evaluations needed (median ratio) | worst at the end |",
        "|---|---|---|---|---|---|---|",
    ]
    for peer in PEERS:
        every = duels(all_results, peer, noise)
        for name in KINDS:
            fought = [duel for duel in every if kind_of(duel.problem) == name]
            if not fought:
                continue
            early, late = (np.array([getattr(d, n) for d in fought]) for n in ("early", "late"))
            worst = fought[int(late.argmin())]
            lines.append(
                f"| {TITLES[peer][0]} | {name}, {len({d.problem for d in fought})} | {len(fought)} "
                f"| {np.mean(early >= 1.0 - LEVEL):.0%}, {np.mean(late >= 1.0 - LEVEL):.0%} "
                f"| {np.mean(late > 1.0 + LEVEL):.0%} "
                f"| {_needed(float(np.median([d.needed for d in fought])))} "
                f"| {worst.late:.3f} ({worst.problem}) |"
            )
    return lines


def _needed(ratio: float) -> str:
    return "not reached" if np.isinf(ratio) else f"{ratio:.2f}"


def starts(all_results: Mapping[str, Results], noise: float) -> list[str]:
    """Return the table of every start of the default strategy, as a share of each peer."""
    lines = [
        "| problem | seed | " + " | ".join(TITLES[peer][0] for peer in PEERS) + " |",
        "|---|---" + "|---" * len(PEERS) + "|",
    ]
    cells: dict[tuple[str, int], dict[str, str]] = {}
    for peer in PEERS:
        for duel in duels(all_results, peer, noise):
            shares = ", ".join(f"{share:.2f}" for share in (duel.early, duel.late, duel.lowest))
            cells.setdefault((duel.problem, duel.seed), {})[peer] = shares
    order = list(all_results)
    for problem, seed in sorted(cells, key=lambda key: (order.index(key[0]), key[1])):
        row = [cells[problem, seed].get(peer, "–") for peer in PEERS]
        lines.append(f"| {problem} | {seed} | " + " | ".join(row) + " |")
    return lines


def details(all_results: Mapping[str, Results], noise: float) -> list[str]:
    """Return the table of every problem and method."""
    lines = [
        "| problem | method | seeds | after 30 | at the end | worst seed | suggestion [s] | stopped | commit |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for problem, results in all_results.items():
        best = max(
            (
                float(np.median(curves[:, -1]))
                for method in TITLES
                if method != "perfect" and (curves := results.curves(label(method, noise))).size
            ),
            default=0.0,
        )
        for method, (title, _) in TITLES.items():
            records = results.records(label(method, noise))
            if not records or best <= 0.0:
                continue
            whole = [r for r in records if "stopped" not in r]
            stopped = [f"{r['stopped']}" for r in records if "stopped" in r]
            ends = np.array([r["hypervolumes"][-1] for r in whole]) / best
            early = np.array([r["hypervolumes"][:30][-1] for r in whole]) / best
            n = max((len(r["hypervolumes"]) for r in whole), default=0)
            cells = (
                [f"{np.median(early):.3f}", f"{np.median(ends):.3f} ({n})", f"{ends.min():.3f}"]
                if len(whole)
                else ["–"] * 3
            )
            times = [r["suggestion"] for r in records if "suggestion" in r]
            cells.append(f"{max(np.median(times), 0.001):.2g}" if times else "–")
            cells.append(f"after {', '.join(stopped)}" if stopped else "")
            cells.append(", ".join(results.commits(label(method, noise))))
            lines.append(f"| {problem} | {title} | {len(records)} | " + " | ".join(cells) + " |")
    return lines


def draw(all_results: Mapping[str, Results], noise: float) -> Figure:
    """Draw the hypervolume against evaluations of every problem but the hard ones: medians and quartiles."""
    shown = {
        name: results
        for name, results in all_results.items()
        if name not in HARD and any(label(method, noise) in results.runs for method in TITLES)
    }
    columns = 4
    rows = max(-(-len(shown) // columns), 1)
    figure = Figure(figsize=(12.0, 2.6 * rows + 0.6))
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    lines = {}
    for axes, (problem, results) in zip(panels, shown.items(), strict=False):
        axes.set_title(problem + (" (held out)" if problem in HELD_OUT else ""), fontsize=9)
        for method, (title, color) in TITLES.items():
            curves = results.curves(label(method, noise))
            if not curves.size:
                continue
            n = np.arange(1, curves.shape[1] + 1)
            low, middle, high = np.quantile(curves, [0.25, 0.5, 0.75], axis=0)
            style = "--" if method == "perfect" else "-"
            (lines[title.strip("`")],) = axes.plot(n, middle, style, color=color, linewidth=1.3)
            axes.fill_between(n, low, high, color=color, alpha=0.2, linewidth=0.0)
    for axes in panels[len(shown) :]:
        axes.set_visible(False)
    figure.supxlabel("evaluations", fontsize=9)
    figure.supylabel("hypervolume", fontsize=9)
    figure.legend(lines.values(), lines.keys(), loc="outside upper center", ncols=len(TITLES))
    return figure
