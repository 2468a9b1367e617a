"""Ids of runs, which only have characters that are safe in names of folders."""

from __future__ import annotations

import re
import secrets
from datetime import datetime

_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")


def check_run_id(run_id: str) -> str:
    """Check a run id and return it.

    Raises:
        ValueError: If it is not allowed as the name of a folder.
    """
    if not _PATTERN.fullmatch(run_id):
        raise ValueError(
            f"run_id is {run_id[:120]!r}; letters, digits, '_', '.' and '-' are allowed, "
            "a letter or digit first, 100 characters at most"
        )
    return run_id


def new_run_id(label: str) -> str:
    """Return a new run id that starts with the local time, so that runs are sorted by age."""
    return f"{datetime.now():%Y%m%d-%H%M%S}-{label}-{secrets.token_hex(4)}"
