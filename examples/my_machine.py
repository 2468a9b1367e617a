"""A machine of your own: what a node must offer so that the tuner can tune it, in plain rclpy.

It needs nothing of this project but the interface package, and plays the paper's toy problem:

    python examples/my_machine.py

Replace `measure` by what moves your machine and reads its diagnostics. A real machine takes its time: run
it in a thread or a coroutine, send feedback at least once a second, and stop when a cancel is requested.
"""

import math
import time

import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_msgs_py.msg import NamedValue, Observable, Variable
from mobo_msgs_py.srv import DescribeMachine

LIMITS = {"x1": (-2.0, 2.0), "x2": (-2.0, 2.0)}
DIAGNOSTICS = ("f1", "f2")
Result = EvaluateSetpoint.Result


def measure(x: dict[str, float]) -> dict[str, float]:
    """Go to a set-point and measure there."""
    return {
        "f1": math.hypot(x["x1"] - 1.0, x["x2"] - 1.0),
        "f2": math.hypot(x["x1"] + 1.0, x["x2"] + 1.0),
    }


class MyMachine(Node):
    """Describes itself and evaluates set-points."""

    def __init__(self) -> None:
        """Offer the service and the action; nothing moves."""
        super().__init__("my_machine")
        self.create_service(DescribeMachine, "describe_machine", self.describe)
        self.server = ActionServer(
            self,
            EvaluateSetpoint,
            "evaluate_setpoint",
            self.evaluate,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=10,
        )

    def describe(
        self, _: DescribeMachine.Request, response: DescribeMachine.Response
    ) -> DescribeMachine.Response:
        """Say what may be changed within which limits, and what is measured."""
        response.name = "my machine"
        response.variables = [
            Variable(name=n, min=low, max=high) for n, (low, high) in LIMITS.items()
        ]
        response.diagnostics = [Observable(name=n) for n in DIAGNOSTICS]
        return response

    def evaluate(self, goal_handle: ServerGoalHandle) -> EvaluateSetpoint.Result:
        """Check everything, then move and measure."""
        started = time.perf_counter()
        goal = goal_handle.request
        result = Result(run_id=goal.run_id, index=goal.index, attempt=goal.attempt)
        x = {item.name: item.value for item in goal.setpoint}
        inside = x.keys() == LIMITS.keys() and all(
            low <= x[name] <= high for name, (low, high) in LIMITS.items()
        )
        if inside:
            result.diagnostics = [NamedValue(name=n, value=v) for n, v in measure(x).items()]
            result.readbacks = list(goal.setpoint)
            goal_handle.succeed()
        else:
            result.error_code = Result.INVALID_SETPOINT
            result.error_msg = f"set-point {x} is not within the limits {LIMITS}"
            goal_handle.abort()
        result.stamp = self.get_clock().now().to_msg()
        result.machine_seconds = time.perf_counter() - started
        return result


def main() -> None:
    """Serve until stopped."""
    rclpy.init()
    node = MyMachine()
    node.create_timer(0.25, lambda: None)  # so that a signal is noticed at once
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
