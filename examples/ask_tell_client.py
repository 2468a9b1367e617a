"""Own the loop: ask the tuner where to measure, measure by yourself, tell it what came out, in plain rclpy.

It needs nothing of this project but the interface package, and no machine node: this program is the machine, and
plays the paper's toy problem. The tuner must be running:

    python examples/ask_tell_client.py 20
"""

import math
import sys
import time
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from mobo_msgs_py.msg import NamedValue, TunerStatus
from mobo_msgs_py.srv import Ask, ListWorkingPoints, Tell

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def measure(x: dict[str, float]) -> dict[str, float]:
    """Go to a set-point and measure there; put in your own machine."""
    return {
        "f1": math.hypot(x["x1"] - 1.0, x["x2"] - 1.0),
        "f2": math.hypot(x["x1"] + 1.0, x["x2"] + 1.0),
    }


class MyLoop(Node):
    """Calls the tuner's services, one at a time."""

    def __init__(self) -> None:
        """Look for the services."""
        super().__init__("my_loop")
        self.ask = self.create_client(Ask, "ask")
        self.tell = self.create_client(Tell, "tell")
        self.working_points = self.create_client(ListWorkingPoints, "list_working_points")
        # A tuner whose status is heard has discovered this program; before, its answers get lost.
        statuses: list[TunerStatus] = []
        self.create_subscription(TunerStatus, "status", statuses.append, LATCHED)
        deadline = time.monotonic() + 30.0
        while not (statuses and self.ask.service_is_ready() and self.tell.service_is_ready()):
            if time.monotonic() > deadline:
                sys.exit("no tuner answered on 'ask' and 'tell' within 30 s")
            rclpy.spin_once(self, timeout_sec=0.1)

    def call(self, client: Any, request: Any) -> Any:
        """The answer to a request, which must be a success."""
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self, future, timeout_sec=300.0)
        if not future.done():
            sys.exit(f"the tuner did not answer on '{client.srv_name}' within 300 s")
        response = future.result()
        if not response.success:
            sys.exit(f"the tuner refused: {response.message}")
        return response


def main() -> None:
    """Ask, measure and tell, and print the front at the end."""
    rclpy.init()
    loop = MyLoop()
    for _ in range(int(sys.argv[1]) if len(sys.argv) > 1 else 20):
        asked = loop.call(loop.ask, Ask.Request())
        values = measure({item.name: item.value for item in asked.setpoint})
        diagnostics = [NamedValue(name=n, value=v, stddev=math.nan) for n, v in values.items()]
        answer = Tell.Request(run_id=asked.run_id, index=asked.index)
        answer.setpoint, answer.diagnostics = asked.setpoint, diagnostics
        told = loop.call(loop.tell, answer)
        print(f"{told.evaluation.index}: hypervolume {told.evaluation.hypervolume:.5g}")
    front = loop.call(loop.working_points, ListWorkingPoints.Request()).measured
    for point in front.points:
        print(", ".join(f"{o.name} = {o.value:.4g} {o.unit}".rstrip() for o in point.objectives))
    loop.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
