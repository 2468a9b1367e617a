"""Start a run from your own program: a client of the `tune` action in plain rclpy.

It needs nothing of this project but the interface package. The tuner and a machine must be running:

    python examples/tune_client.py 20

Ctrl-C stops the run; what was reached is shown all the same.
"""

import sys
import time

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions

from mobo_msgs_py.action import Tune
from mobo_msgs_py.msg import TunerStatus

START_TIMEOUT = 30.0  # [s] for the tuner to appear
TIMEOUT = 10.0  # [s] without a word from it
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class MyProgram(Node):
    """Asks for one run, and prints every evaluation."""

    def __init__(self) -> None:
        """Look for the tuner."""
        super().__init__("my_program")
        self.client = ActionClient(self, Tune, "tune")
        # A tuner whose status is heard has discovered this program; before, its answers get lost.
        self.create_subscription(TunerStatus, "status", self.on_status, LATCHED)
        self.heard: float | None = None  # when the tuner spoke last, by `time.monotonic`
        deadline = time.monotonic() + START_TIMEOUT
        while self.heard is None or not self.client.server_is_ready():
            if time.monotonic() > deadline:
                sys.exit(f"no tuner answered on 'tune' within {START_TIMEOUT:g} s")
            rclpy.spin_once(self, timeout_sec=0.1)

    def tune(self, evaluations: int) -> Tune.Result:
        """The result of a run of so many evaluations."""
        goal = Tune.Goal(evaluations=evaluations)
        sent = self.client.send_goal_async(goal, feedback_callback=self.on_feedback)
        self.await_(sent)
        finished = sent.result().get_result_async()
        try:
            self.await_(finished)
        except KeyboardInterrupt:
            sent.result().cancel_goal_async()
            self.await_(finished)
        return finished.result().result

    def await_(self, future: rclpy.Future) -> None:
        """Spin until it is done; the tuner's status comes once a second as long as it lives."""
        while not future.done():
            rclpy.spin_once(self, timeout_sec=0.5)
            if time.monotonic() > (self.heard or 0.0) + TIMEOUT:
                sys.exit(f"the tuner has been silent for {TIMEOUT:g} s")

    def on_status(self, _: TunerStatus) -> None:
        """The tuner lives."""
        self.heard = time.monotonic()

    def on_feedback(self, message: Tune.Impl.FeedbackMessage) -> None:
        """Print an evaluation."""
        evaluation = message.feedback.evaluation
        values = ", ".join(f"{o.name} = {o.value:.4g} {o.unit}" for o in evaluation.objectives)
        print(f"{evaluation.index}: {values}; hypervolume {evaluation.hypervolume:.5g}")


def main() -> None:
    """Ask for a run and print the front at the end."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C is answered by a cancel
    program = MyProgram()
    result = program.tune(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
    print(f"{result.evaluations} evaluations, {len(result.pareto_front.points)} on the front")
    print(f"stopped by {result.stop_reason} {result.error_msg}".rstrip())
    program.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
