"""The examples in the docstrings of public modules run and show what they claim."""

from __future__ import annotations

import doctest
import importlib

import numpy as np
import pytest

MODULES = (
    "awa_sim_node.surrogate.predictor",
    "mobo_tuner.core.derived",
    "mobo_tuner.core.hypervolume",
    "mobo_tuner.core.pareto",
    "mobo_tuner.core.problem",
    "mobo_tuner.names",
    "mobo_tuner.wording",
)


@pytest.mark.parametrize("name", MODULES)
def test_examples_show_what_they_claim(name: str) -> None:
    module = importlib.import_module(name)
    with np.printoptions(precision=8, suppress=False):
        result = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 0, f"{name} has no example"
    assert result.failed == 0
