"""Every mistake in a goal is found before anything moves, and named in one sentence."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.machine.goal_checks import check_evaluation

VARIABLES = [
    msg.Variable(name="K1", unit="A", min=0.0, max=10.0),
    msg.Variable(name="phi", unit="", min=-1.0, max=1.0),
]
DIAGNOSTICS = [msg.Observable(name="eps", unit="mm"), msg.Observable(name="E", unit="")]


def point(unit: str = "", **values: float) -> list[msg.NamedValue]:
    return [msg.NamedValue(name=name, value=value, unit=unit) for name, value in values.items()]


def check(**fields: Any) -> dict[str, float]:
    goal = EvaluateSetpoint.Goal(**{"run_id": "r", "setpoint": point(phi=0.5, K1=3.0), **fields})
    return check_evaluation(goal, VARIABLES, DIAGNOSTICS, max_shots=100)


def test_a_good_goal_is_returned_in_the_machines_order() -> None:
    limit = msg.Constraint(name="eps", unit="mm", min=-math.inf, max=3.0)
    values = check(
        critical=[limit], shots=100, client_timeout=3.0, if_violated=point(K1=0.0, phi=-1.0)
    )
    assert list(values.items()) == [("K1", 3.0), ("phi", 0.5)]


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"setpoint": []}, "set-point lacks 'K1'; it must name all of the variables K1, phi"),
        ({"setpoint": point(K1=1.0)}, "set-point lacks 'phi'"),
        ({"setpoint": point(K1=1.0, phi=0.0, K9=0.0)}, "set-point names 'K9'"),
        ({"setpoint": point(K1=1.0, phi=0.0) * 2}, "set-point names a variable twice: 'K1'"),
        ({"setpoint": point(K1=10.1, phi=0.0)}, "K1 = 10.1 A is outside"),
        ({"setpoint": point(K1=math.nan, phi=0.0)}, "K1 = nan A is outside"),
        ({"setpoint": point(K1=1.0, phi=-math.inf)}, "phi = -inf is outside"),
        ({"setpoint": point("mA", K1=1.0, phi=0.0)}, "K1 is in 'mA'; the machine's unit is 'A'"),
        ({"setpoint": point("A", K1=1.0, phi=0.0)}, "phi is in 'A'; the machine's unit is none"),
        ({"if_client_lost": point(K1=1.0)}, "if_client_lost lacks 'phi'"),
        ({"if_violated": point(K1=11.0, phi=0.0)}, "if_violated K1 = 11 A is outside"),
        ({"shots": 101}, "shots = 101 must be from 0 to 100"),
        ({"critical": [msg.Constraint(name="q", max=1.0)]}, "critical names 'q'"),
        ({"critical": [msg.Constraint(name="E", max=1.0)] * 2}, "names a diagnostic twice: 'E'"),
        ({"critical": [msg.Constraint(name="E", max=math.nan)]}, "min must not be above max"),
        ({"critical": [msg.Constraint(name="E", min=1.0)]}, "min must not be above max"),
        ({"critical": [msg.Constraint(name="eps", unit="m")]}, "critical eps is in 'm'"),
        ({"client_timeout": -1.0}, "client_timeout = -1"),
        ({"client_timeout": math.nan}, "client_timeout = nan"),
        ({"client_timeout": 1.0, "run_id": ""}, "run_id is empty"),
    ],
)
def test_a_mistake_is_named(fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=re.escape(sentence)):
        check(**fields)


names = st.sampled_from(["K1", "phi", "K2", "", "🙂"])
numbers = st.floats(allow_nan=True, allow_infinity=True)


@given(
    st.lists(st.builds(msg.NamedValue, name=names, value=numbers), max_size=4),
    st.lists(st.builds(msg.NamedValue, name=names, value=numbers), max_size=3),
    st.lists(
        st.builds(msg.Constraint, name=st.sampled_from(["eps", "E", "q"]), min=numbers, max=numbers)
    ),
    st.integers(0, 65535),
    numbers,
)
def test_whatever_passes_is_within_the_limits(
    setpoint: list[Any], fallback: list[Any], critical: list[Any], shots: int, timeout: float
) -> None:
    try:
        values = check(
            setpoint=setpoint,
            if_violated=fallback,
            critical=critical,
            shots=shots,
            client_timeout=timeout,
        )
    except ValueError:
        return
    for variable in VARIABLES:
        assert variable.min <= values[variable.name] <= variable.max
    assert shots <= 100
    assert timeout >= 0.0


LONG = "x" * 100_000


@pytest.mark.parametrize(
    "fields",
    [
        {"setpoint": [*point(K1=1.0, phi=0.0), msg.NamedValue(name=LONG)]},
        {"setpoint": point(LONG, K1=1.0, phi=0.0)},
        {"critical": [msg.Constraint(name=LONG, max=1.0)]},
        {"critical": [msg.Constraint(name=LONG, max=1.0)] * 2},
    ],
)
def test_a_long_text_is_not_quoted_whole(fields: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="'xxx") as caught:
        check(**fields)
    assert len(str(caught.value)) < 300
