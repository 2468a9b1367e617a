"""The choices for a Gaussian process: what is refused, and plain data and back."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings
from mobo_tuner.errors import ParameterError


@pytest.mark.parametrize(
    ("choice", "name", "value"),
    [
        ({"kernel": "cubic"}, "kernel", "'cubic'"),
        ({"training": "sgd"}, "training", "'sgd'"),
        ({"prior": "strong"}, "prior", "'strong'"),
        ({"transform": "sqrt"}, "transform", "'sqrt'"),
        ({"mean": "median"}, "mean", "'median'"),
        ({"mean": float("nan")}, "mean", "nan"),
        ({"mean": None}, "mean", "None"),
        ({"mean": lambda x: x}, "mean", "function"),
        ({"noise": -1.0}, "noise", "-1.0"),
        ({"noise": "none"}, "noise", "'none'"),
        ({"minimum_noise": 0.0}, "minimum_noise", "0.0"),
        ({"minimum_noise": 2.0}, "minimum_noise", "2.0"),
        ({"variance": 0.0}, "variance", "0.0"),
        ({"length_scales": -1.0}, "length_scales", "-1.0"),
        ({"length_scales": (1.0, float("inf"))}, "length_scales[1]", "inf"),
        ({"precision": ((1.0, 2.0),), "kernel": "rbf_full"}, "precision", "((1.0, 2.0),)"),
        ({"precision": (1.0, 2.0), "kernel": "rbf_full"}, "precision", "(1.0, 2.0)"),
        ({"precision": ((1.0, 2.0), (2.0, 1.0))}, "precision", "2.0"),
        ({"precision": ((1.0, 2.0), (2.0,))}, "precision", "(2.0,)"),
        ({"precision": (1.0,), "length_scales": 1.0}, "precision and length_scales", ""),
        ({"restarts": -1}, "restarts", "-1"),
        ({"restarts": True}, "restarts", "True"),
        ({"adam_steps": 1.5}, "adam_steps", "1.5"),
        ({"adam_rate": 0.0}, "adam_rate", "0.0"),
    ],
)
def test_refused(choice: dict[str, Any], name: str, value: str) -> None:
    with pytest.raises(ParameterError) as error:
        GaussianProcessSettings(**choice)
    assert str(error.value).startswith(name)
    assert value in str(error.value)


@pytest.mark.parametrize(
    "choice",
    [
        {},
        {"kernel": "rbf", "length_scales": (0.5, 1.0), "variance": 2.0, "noise": 0.1, "mean": 3.0},
        {"kernel": "rbf_full", "precision": ((2.0, 1.0), (1.0, 2.0)), "mean": "reference"},
    ],
)
def test_plain_data_and_back(choice: dict[str, Any]) -> None:
    settings = GaussianProcessSettings(**choice)
    values = json.loads(json.dumps(settings.to_dict()))
    assert GaussianProcessSettings.from_dict(values) == settings


def test_numbers_and_arrays_of_numpy_become_plain() -> None:
    choices: dict[str, Any] = {"precision": np.diag([1, 2]), "variance": np.float32(2.0)}
    choices["restarts"] = np.int64(3)
    settings = GaussianProcessSettings(kernel="rbf_full", **choices)
    assert settings.precision == (1.0, 0.0, 0.0, 2.0)
    assert settings.variance == 2.0
    assert type(settings.restarts) is int
    json.dumps(settings.to_dict())
