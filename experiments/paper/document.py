"""Pictures and tables of docs/paper.md: the paper's claims beside the results in experiments/results/paper."""

from __future__ import annotations

import re
from collections.abc import Mapping

from experiments.campaign import RESULTS, ROOT, Results
from experiments.paper.experiment import Experiment

DOCUMENT = ROOT / "docs" / "paper.md"
_TABLE = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def part(name: str, experiment: Experiment, results: Results) -> str:
    """Return picture and table of an experiment, and a line that says how its numbers were made."""
    lines = ["", f"![{experiment.caption}](images/paper_{name}.png)", ""]
    lines += ["| | the paper | here |", "|---|---|---|"]
    lines += [
        f"| {row.quantity} | {row.paper} | {row.ours} |" for row in experiment.compare(results)
    ]
    about, versions = results.about, results.about["versions"]
    packages = ", ".join(f"{name} {number}" for name, number in versions.items())
    runs = "; ".join(
        f"{label} {len(records)} × {sum(r['seconds'] for r in records.values()) / len(records):.0f} s"
        f" ({', '.join(results.commits(label))})"
        for label, records in sorted(results.runs.items())
    )
    lines += [
        "",
        f"`python -m experiments.paper {name}`, last on {about['date']}. Runs × CPU time of each (commit): "
        f"{runs}. {packages}.",
        "",
    ]
    return "\n".join(lines) + "\n"


def with_tables(text: str, experiments: Mapping[str, Experiment]) -> str:
    """Return the document's text with all pictures and tables as the results say.

    Args:
        text: Text, in which each table lies between two comments.
        experiments: Experiments by name.
    """

    def current(match: re.Match[str]) -> str:
        name = match[2]
        results = Results(RESULTS / "paper" / f"{name}.json")
        inside = (
            part(name, experiments[name], results) if results.runs else "\nNot computed yet.\n\n"
        )
        return match[1] + inside + match[3]

    return _TABLE.sub(current, text)
