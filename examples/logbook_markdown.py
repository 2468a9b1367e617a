"""A logbook entry as Markdown: `MOBO_ON_RUN_END="python3 examples/logbook_markdown.py logbook.md" python3 mobo.py run`.

The run comes as JSON on standard input; the entry is added to the file that is named, or printed.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any


def entry(run: dict[str, Any]) -> str:
    """Return the entry of a run."""
    summary = run["summary"]
    lines = [
        f"## Run {run['run_id']}: {run['state']}",
        "",
        f"{summary.get('evaluations', 0)} evaluations, {summary.get('failed', 0)} failed, "
        f"hypervolume {summary.get('hypervolume')}. {run['reason']}".rstrip(),
        "",
    ]
    front = summary.get("pareto_front", [])
    if front:
        names = [*front[0]["objectives"]]
        lines += [f"| index | {' | '.join(names)} |", f"|{'---|' * (len(names) + 1)}"]
        for point in front[:5]:
            values = " | ".join(f"{point['objectives'][name]:.4g}" for name in names)
            lines.append(f"| {point['index']} | {values} |")
        lines.append("")
    return "\n".join([*lines, f"Report: {run['report'] or run['run_folder']}", ""])


def main() -> None:
    """Write the entry."""
    text = entry(json.load(sys.stdin))
    if sys.argv[1:]:
        with Path(sys.argv[1]).open("a", encoding="utf-8") as file:
            file.write(text + "\n")
    else:
        print(text)


if __name__ == "__main__":
    main()
