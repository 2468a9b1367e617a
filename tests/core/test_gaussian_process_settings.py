import json

import pytest

from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"kernel": "cubic"}, "kernel must be one of rbf_isotropic, rbf, rbf_full, matern52"),
        ({"training": "sgd"}, "training must be one of lbfgs, adam"),
        ({"prior": "strong"}, "prior must be one of"),
        ({"transform": "sqrt"}, "transform must be one of"),
        ({"mean": "median"}, "mean must be"),
        ({"mean": float("nan")}, "mean must be a finite number"),
        ({"mean": None}, "mean must be a finite number"),
        ({"mean": lambda x: x, "transform": "log"}, "transform must be 'none'"),
        ({"mean_gradient": lambda x: x}, "mean_gradient needs a mean function"),
        ({"noise": -1.0}, "noise must be a finite number of at least 0"),
        ({"noise": "none"}, "noise must be"),
        ({"minimum_noise": 0.0}, "minimum_noise must be"),
        ({"minimum_noise": 2.0}, "at most 1, got 2"),
        ({"variance": 0.0}, "variance must be"),
        ({"length_scales": -1.0}, "length_scales must be"),
        ({"length_scales": (1.0, float("inf"))}, "length_scales must be"),
        ({"length_scales": (1.0, 2.0), "kernel": "rbf_isotropic"}, "one number, got 2"),
        ({"precision": ((1.0,),)}, "precision needs kernel 'rbf_full'"),
        ({"precision": ((1.0, 2.0),), "kernel": "rbf_full"}, "positive definite"),
        ({"precision": ((1.0, 2.0), (2.0, 1.0)), "kernel": "rbf_full"}, "positive definite"),
        ({"precision": ((1.0, 2.0), (2.0,)), "kernel": "rbf_full"}, "positive definite"),
        ({"restarts": -1}, "restarts must be a whole number"),
        ({"restarts": True}, "restarts must be a whole number"),
        ({"adam_steps": 1.5}, "adam_steps must be a whole number"),
        ({"adam_rate": 0.0}, "adam_rate must be"),
    ],
)
def test_refused(choice, message):
    with pytest.raises(ValueError, match=message):
        GaussianProcessSettings(**choice)


@pytest.mark.parametrize(
    "choice",
    [
        {},
        {"kernel": "rbf", "length_scales": (0.5, 1.0), "variance": 2.0, "noise": 0.1, "mean": 3.0},
        {"kernel": "rbf_full", "precision": ((2.0, 1.0), (1.0, 2.0)), "mean": "reference"},
    ],
)
def test_plain_data_and_back(choice):
    settings = GaussianProcessSettings(**choice)
    values = json.loads(json.dumps(settings.to_dict()))
    assert GaussianProcessSettings.from_dict(values) == settings


def test_mean_function_must_be_given_again():
    def mean(x):
        return x[:, 0]

    settings = GaussianProcessSettings(mean=mean)
    values = json.loads(json.dumps(settings.to_dict()))
    assert GaussianProcessSettings.from_dict(values, mean) == settings
    with pytest.raises(ValueError, match="mean must be given"):
        GaussianProcessSettings.from_dict(values)
