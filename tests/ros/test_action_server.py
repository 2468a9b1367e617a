"""What every action server of the suite does with a goal, shown over real DDS within one process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from rclpy.node import Node
from rclpy.task import Future

from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint, GoToWorkingPoint, Tune
from mobo_tuner.ros.action_server import FAULT, Goal, GoalServer
from tests.support.tuner import GoalClient

CODES = ApplySetpoint.Result
Spin = Callable[..., None]


class Served:
    """A server whose goals wait until they are told how to end, and a client of it."""

    def __init__(self, node: Node, spin_until: Spin) -> None:
        self.goals: list[Goal] = []
        self.ends: list[Future] = []
        self.spin_until = spin_until
        self.server = GoalServer(node, ApplySetpoint, "apply_setpoint", self.execute)
        self.client = GoalClient(node, spin_until, ApplySetpoint, "apply_setpoint")

    async def execute(self, goal: Goal) -> ApplySetpoint.Result:
        self.goals.append(goal)
        self.ends.append(Future())
        end = self.ends[-1]
        goal.on_cancel(lambda: end.set_result(CODES(error_code=CODES.CANCELED)))
        return await end

    def send(self) -> int:
        """Send a goal; its number once it is being served."""
        count = len(self.goals)
        self.client.send(ApplySetpoint.Goal())
        self.spin_until(lambda: len(self.goals) > count, "a goal to be served")
        return count

    def outcome(self) -> tuple[int, int]:
        """Status and error code of the goal that was sent last."""
        result = self.client.wait()
        assert self.client.result is not None
        return self.client.result.result().status, result.error_code


@pytest.fixture
def served(node: Node, spin_until: Spin) -> Any:
    served = Served(node, spin_until)
    yield served
    served.server.close()


@pytest.mark.parametrize(
    ("code", "status"),
    [
        (CODES.NONE, GoalStatus.STATUS_SUCCEEDED),
        (CODES.BUSY, GoalStatus.STATUS_ABORTED),
        (CODES.CANCELED, GoalStatus.STATUS_ABORTED),  # though no client asked for it
    ],
)
def test_the_error_code_concludes_a_goal(served: Served, code: int, status: int) -> None:
    number = served.send()
    served.ends[number].set_result(CODES(error_code=code, error_msg="why"))
    assert served.outcome() == (status, code)


def test_a_cancel_interrupts_its_own_goal_only(served: Served) -> None:
    first, _ = served.send(), served.send()
    served.client.cancel()
    assert served.outcome() == (GoalStatus.STATUS_CANCELED, CODES.CANCELED)
    assert not served.goals[first].canceled
    assert not served.ends[first].done()
    served.ends[first].set_result(CODES())


def test_a_goal_that_ends_well_in_spite_of_a_cancel_has_succeeded(served: Served) -> None:
    number = served.send()
    served.goals[number].on_cancel(lambda: None)  # too late to stop
    served.client.cancel()
    served.spin_until(lambda: served.goals[number].canceled, "the cancel")
    served.ends[number].set_result(CODES())
    assert served.outcome() == (GoalStatus.STATUS_SUCCEEDED, CODES.NONE)


def test_a_cancel_that_came_first_acts_as_soon_as_there_is_something_to_interrupt(
    served: Served,
) -> None:
    number = served.send()
    served.goals[number].on_cancel(lambda: None)
    served.client.cancel()
    served.spin_until(lambda: served.goals[number].canceled, "the cancel")
    calls: list[str] = []
    served.goals[number].on_cancel(lambda: calls.append("stop"))
    assert calls == ["stop"]
    served.ends[number].set_result(CODES(error_code=CODES.CANCELED))
    assert served.outcome() == (GoalStatus.STATUS_CANCELED, CODES.CANCELED)


def test_an_unforeseen_error_aborts_the_goal_and_is_told(served: Served) -> None:
    number = served.send()
    served.ends[number].set_exception(RuntimeError("the lamp is broken"))
    assert served.outcome() == (GoalStatus.STATUS_ABORTED, FAULT)
    assert "RuntimeError: the lamp is broken" in served.client.wait().error_msg
    assert EvaluateSetpoint.Result.UNKNOWN == ApplySetpoint.Result.UNKNOWN == FAULT
    assert Tune.Result.INTERNAL == GoToWorkingPoint.Result.INTERNAL == FAULT


def test_feedback_goes_to_the_client_of_the_goal(served: Served) -> None:
    number = served.send()
    served.goals[number].publish_feedback(phase="ramping", fraction=0.5)
    served.spin_until(lambda: served.client.feedback, "feedback")
    assert (served.client.feedback[0].phase, served.client.feedback[0].fraction) == ("ramping", 0.5)
    served.ends[number].set_result(CODES())
    assert served.outcome()[1] == CODES.NONE
