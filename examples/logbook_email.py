"""A logbook entry as the text of an e-mail, which is printed: `python3 examples/logbook_email.py shift@lab.example`.

To send it, as a command of `mobo.py`, which starts no shell:
`sh -c "python3 examples/logbook_email.py ADDRESS | sendmail -t"`.
"""

from __future__ import annotations

import json
import sys
from email.message import EmailMessage


def main() -> None:
    """Print the message."""
    run = json.load(sys.stdin)
    summary = run["summary"]
    message = EmailMessage()
    message["To"] = sys.argv[1] if sys.argv[1:] else "shift@localhost"
    message["Subject"] = f"Tuning run {run['run_id']}: {run['state']}"
    message.set_content(
        f"Evaluations: {summary.get('evaluations', 0)}, failed: {summary.get('failed', 0)}\n"
        f"Hypervolume: {summary.get('hypervolume')}\n"
        f"Points on the front: {len(summary.get('pareto_front', []))}\n"
        f"Stop reason: {summary.get('stop_reason', 'unknown')} {run['reason']}\n"
        f"Report: {run['report'] or run['run_folder']}\n"
    )
    print(message)


if __name__ == "__main__":
    main()
