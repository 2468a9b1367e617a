"""The objectives that conflict most against SciPy, and the page, which does without compiled code."""

from __future__ import annotations

import itertools
import subprocess
import sys

import numpy as np
from scipy.stats import spearmanr

from mobo_tuner.core.conflict import conflicting_pair


def test_the_pair_that_conflicts_most_against_scipy() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        front = rng.normal(size=(30, 4)) @ rng.normal(size=(4, 5))
        pairs = list(itertools.combinations(range(5), 2))
        correlations = [spearmanr(front[:, i], front[:, j])[0] for i, j in pairs]
        assert conflicting_pair(front) == pairs[int(np.argmin(correlations))]
    front[:, 0] = np.nan
    assert 0 not in conflicting_pair(front)
    assert conflicting_pair(front[:2]) == (0, 1)


def test_the_page_imports_no_compiled_code() -> None:
    program = "import sys, mobo_tuner.page.view; print(*({'numba', 'scipy', 'matplotlib'} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120.0, check=True
    )
    assert done.stdout.split() == []
