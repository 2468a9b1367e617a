"""Figure constrain_comparison: dE < 0.52 MeV as a preference, as a constraint, and not at all."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.campaign import PlannedRun, Results, Size
from experiments.paper.experiment import Experiment, Row, draw_front, mean_and_spread, runs
from experiments.paper.injector import INITIAL, LIMIT, PICTURED, scaled_limit, tune

CASES = {
    "nothing": ("(a) no limit", "tab:gray"),
    "preference": (f"(b) preference dE < {LIMIT} MeV", "tab:blue"),
    "constraint": (f"(c) constraint dE < {LIMIT} MeV", "tab:orange"),
}
PRESETS = {"paper": "UCB-HVI", "default": "default"}


def plan(size: Size) -> list[PlannedRun]:
    """Return runs of 300 evaluations for each case with the paper's and the default settings."""
    n = size.number(300, 24)
    quick = {"quick": True} if size.quick else {}
    return [
        PlannedRun(
            f"{preset} {case}",
            seed,
            tune,
            {"evaluations": n, "preset": preset, "case": case}
            | (quick if preset == "paper" else {}),
        )
        for seed in size.seeds_of(10)
        for preset in ("default", "paper")
        for case in CASES
    ]


def compare(results: Results) -> list[Row]:
    """Return shares of violating evaluations and the areas below projected fronts."""
    rows = []
    shares = {
        "nothing": "most (figure only)",
        "preference": "“almost no points”",
        "constraint": "more than with the preference",
    }
    areas = {
        "area_dE_eps_x": ("dE-eps_x front within the limit", "preference better than no limit"),
        "area_sigma_x_eps_x": (
            "sigma_x-eps_x front",
            "constraint better than preference, no limit better than both",
        ),
    }
    for preset, title in PRESETS.items():
        for case, claim in shares.items():
            records = results.records(f"{preset} {case}")
            if not records:
                continue
            late = np.array([_share(r["violating"][INITIAL[preset] :]) for r in records])
            half = np.array([_share(r["violating"][len(r["violating"]) // 2 :]) for r in records])
            rows.append(
                Row(
                    f"{title}, {case}: suggestions that violate dE < {LIMIT} MeV",
                    claim if preset == "paper" else "–",
                    f"{100 * late.mean():.1f} %, in the second half {100 * half.mean():.1f} % "
                    f"({runs(len(records))})",
                )
            )
        for name, (front, claim) in areas.items():
            parts = [
                f"{case} {mean_and_spread(results.values(f'{preset} {case}', name), 3)}"
                for case in CASES
                if results.records(f"{preset} {case}")
            ]
            if parts:
                claim = claim if preset == "paper" else "–"
                rows.append(Row(f"{title}: area of the {front}", claim, "; ".join(parts)))
    return rows


def _share(violating: str) -> float:
    """Return the share of evaluations that violate the limit."""
    return violating.count("1") / max(len(violating), 1)


def draw(results: Results) -> Figure:
    """Draw all evaluations of one run of each case in dE and eps_x, and the sigma_x-eps_x fronts."""
    figure = Figure(figsize=(10.0, 8.0))
    panels = figure.subplots(2, 2).ravel()
    preset = "paper" if PICTURED in results.runs.get("paper constraint", {}) else "default"
    for axes, (case, (title, color)) in zip(panels, CASES.items(), strict=False):
        axes.set(title=title, xlabel="dE", ylabel=r"$\varepsilon_x$", xlim=(-1.05, 1.05))
        axes.set_ylim(-1.05, 1.05)
        if record := results.runs.get(f"{preset} {case}", {}).get(PICTURED):
            axes.scatter(record["dE"], record["eps_x"], s=9, color=color)
            points = np.stack([record["dE"], record["eps_x"]], axis=1)
            draw_front(axes, points, "black", "front", linewidth=1.0)
            fronts = np.stack([record["sigma_x"], record["eps_x"]], axis=1)
            draw_front(panels[3], fronts, color, case)
        if case != "nothing":
            axes.axvline(scaled_limit(), color="black", linestyle=":")
    panels[3].set(title="(d) fronts", xlabel=r"$\sigma_x$", ylabel=r"$\varepsilon_x$")
    panels[3].legend()
    figure.suptitle(f"{PRESETS[preset]}, one run each, objectives scaled to [-1, 1]", fontsize=10)
    return figure


EXPERIMENT = Experiment(
    "AWA: preference, constraint and no limit on dE",
    plan,
    compare,
    draw,
)
