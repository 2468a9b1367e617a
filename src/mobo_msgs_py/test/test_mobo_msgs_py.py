"""The interfaces as Python types, for `colcon test`."""

from pathlib import Path

import pytest

import mobo_msgs_py.action
import mobo_msgs_py.msg
import mobo_msgs_py.srv

PACKAGE = Path(__file__).parents[1]


@pytest.mark.parametrize("kind", ["action", "msg", "srv"])
def test_every_interface_has_its_type(kind: str) -> None:
    names = [path.stem for path in (PACKAGE / kind).glob(f"*.{kind}")]
    assert names
    for name in names:
        assert hasattr(getattr(mobo_msgs_py, kind), name)


def test_the_constants_are_on_the_types() -> None:
    assert mobo_msgs_py.msg.TunerStatus.IDLE == 0
    assert mobo_msgs_py.action.EvaluateSetpoint.Result.NONE == 0
    assert mobo_msgs_py.action.Tune.Result.STOP_REASON_BUDGET == "budget"
