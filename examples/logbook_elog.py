"""A logbook entry in an Elog server (PSI): `python3 examples/logbook_elog.py http://elog.lab.example:8080/shift`.

The form is the one that `elog` itself posts. A password, if the logbook has one, is taken from ELOG_PASSWORD.
"""

from __future__ import annotations

import json
import os
import sys
import urllib.request
import uuid

TIMEOUT = 20.0  # [s]


def form(fields: dict[str, str]) -> tuple[bytes, str]:
    """Return a form as the body of a request, and its content type."""
    boundary = uuid.uuid4().hex
    parts = [
        f'--{boundary}\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n{value}\r\n'
        for name, value in fields.items()
    ]
    body = "".join([*parts, f"--{boundary}--\r\n"]).encode()
    return body, f"multipart/form-data; boundary={boundary}"


def main() -> None:
    """Post the entry."""
    run, address = json.load(sys.stdin), sys.argv[1]
    summary = run["summary"]
    fields = {
        "cmd": "Submit",
        "exp": address.rstrip("/").rpartition("/")[2],
        "Author": os.environ.get("USER", "mobo"),
        "Type": "Tuning",
        "Subject": f"Tuning run {run['run_id']}: {run['state']}",
        "Text": f"{summary.get('evaluations', 0)} evaluations, hypervolume {summary.get('hypervolume')}, "
        f"{len(summary.get('pareto_front', []))} points on the front. {run['run_folder']}",
    }
    if password := os.environ.get("ELOG_PASSWORD"):
        fields["upwd"] = password
    body, kind = form(fields)
    request = urllib.request.Request(address, body, {"Content-Type": kind})
    with urllib.request.urlopen(request, timeout=TIMEOUT) as answer:
        print(f"{address}: {answer.status}")


if __name__ == "__main__":
    main()
