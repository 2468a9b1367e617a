"""The definition of a problem with every kind of quantity."""

from __future__ import annotations

import copy
from typing import Any

MAPPING: dict[str, Any] = {
    "variables": {
        "K1": {"min": 400.0, "max": 550, "unit": "A", "cost": 2.0},
        "phi": {"min": -10, "max": 0},
    },
    "objectives": {
        "eps_x": {"direction": "minimize", "reference": 150.0, "unit": "mm mrad"},
        "energy": {"direction": "maximize", "reference": 12.0, "truncation": [10.0, 20.0]},
    },
    "constraints": {
        "dE": {"max": 0.52, "critical": True},
        "transmission": {"min": 0.98, "max": 1.1},
    },
    "observables": {"charge": {"unit": "nC"}},
}


def changed(path: str, value: Any) -> dict[str, Any]:
    """The mapping with one value replaced, added, or removed where it is `...`."""
    mapping = copy.deepcopy(MAPPING)
    *parents, leaf = path.split(".")
    branch = mapping
    for key in parents:
        branch = branch[key]
    if value is ...:
        del branch[leaf]
    else:
        branch[leaf] = value
    return mapping
