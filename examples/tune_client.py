"""Start a run from your own program: a client of the `tune` action in plain rclpy.

It needs nothing of this project but the interface package. The tuner and a machine must be running:

    python examples/tune_client.py 20
"""

import sys

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node

from mobo_msgs_py.action import Tune


def main() -> None:
    """Ask for a run, print every evaluation and the front at the end."""
    rclpy.init()
    node = Node("my_program")
    client = ActionClient(node, Tune, "tune")
    if not client.wait_for_server(timeout_sec=10.0):
        sys.exit("no tuner answered on 'tune' within 10 s")

    def on_feedback(message: Tune.Impl.FeedbackMessage) -> None:
        evaluation = message.feedback.evaluation
        values = ", ".join(f"{o.name} = {o.value:.4g} {o.unit}" for o in evaluation.objectives)
        print(f"{evaluation.index}: {values}; hypervolume {evaluation.hypervolume:.5g}")

    goal = Tune.Goal(evaluations=int(sys.argv[1]) if len(sys.argv) > 1 else 20)
    sent = client.send_goal_async(goal, feedback_callback=on_feedback)
    rclpy.spin_until_future_complete(node, sent, timeout_sec=10.0)
    finished = sent.result().get_result_async()
    try:
        rclpy.spin_until_future_complete(node, finished)
    except KeyboardInterrupt:
        sent.result().cancel_goal_async()
        rclpy.spin_until_future_complete(node, finished, timeout_sec=2.0)
    result = finished.result().result
    print(f"{result.evaluations} evaluations, {len(result.pareto_front.points)} on the front")
    print(f"stopped by {result.stop_reason} {result.error_msg}")
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
