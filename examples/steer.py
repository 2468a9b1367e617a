"""Steer a tuner from the shell, in plain rclpy: where there is no `ros2` command, and as a pattern for panels.

It needs nothing of this project but the interface package, and the run's ROS domain in the environment:

    python examples/steer.py status
    python examples/steer.py pause              # resume, step, skip, stop
    python examples/steer.py set variables.K1.max=520 evaluations=80
    python examples/steer.py queue K1=475 K2=230 phi1=-5 phi2=-5 G1=67.5 G2=20
    python examples/steer.py points --predict   # the front, as measured and as the models predict it
    python examples/steer.py go 17 --hold 20    # to a point of the front, and hold it
    python examples/steer.py best eps_x=1 dE=100
    python examples/steer.py go 17 --run 20261124-101500-awa    # of an earlier run

It exits with 0 where the tuner agreed, and otherwise with 1 and its reason.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from mobo_msgs_py.action import GoToWorkingPoint
from mobo_msgs_py.msg import NamedValue, ParetoFront, TunerStatus
from mobo_msgs_py.srv import ListWorkingPoints, QueueSetpoint

TRIGGERS = {
    "pause": "pause",
    "resume": "resume",
    "step": "step",
    "skip": "skip",
    "stop": "stop_after_this",
}
TIMEOUT = 10.0  # [s] without a word from the tuner
PREDICTION_TIMEOUT = 300.0  # [s]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Panel(Node):
    """Asks the tuner for one thing at a time; what it refuses ends the program."""

    def __init__(self) -> None:
        """Make the clients, and look for the tuner."""
        super().__init__("steer")
        self.triggers = {name: self.create_client(Trigger, name) for name in TRIGGERS.values()}
        self.queuer = self.create_client(QueueSetpoint, "queue_setpoint")
        self.setter = self.create_client(SetParametersAtomically, "tuner/set_parameters_atomically")
        self.lister = self.create_client(ListWorkingPoints, "list_working_points")
        self.mover = ActionClient(self, GoToWorkingPoint, "go_to_working_point")
        # Made last: a tuner whose status is heard has discovered all clients of this program.
        self.create_subscription(TunerStatus, "status", self.on_status, LATCHED)
        self.last: TunerStatus | None = None
        self.heard = time.monotonic()
        self.wait(lambda: self.last is not None, TIMEOUT)

    def on_status(self, status: TunerStatus) -> None:
        """The tuner lives."""
        self.last, self.heard = status, time.monotonic()

    def wait(self, condition: Callable[[], bool], timeout: float) -> None:
        """Spin until a condition holds, for as long as the tuner says something."""
        deadline = time.monotonic() + timeout
        while not condition():
            rclpy.spin_once(self, timeout_sec=0.2)
            if time.monotonic() > self.heard + TIMEOUT:
                sys.exit(
                    f"no tuner was heard on 'status' for {TIMEOUT:g} s: is ROS_DOMAIN_ID right?"
                )
            if time.monotonic() > deadline:
                sys.exit(f"the tuner did not answer within {timeout:g} s")

    def call(self, client: Any, request: Any, timeout: float = TIMEOUT) -> Any:
        """The answer of a service."""
        self.wait(client.service_is_ready, timeout)
        answer = client.call_async(request)
        self.wait(answer.done, timeout)
        return answer.result()

    def status(self) -> str:
        """What the tuner is doing."""
        last = self.last
        assert last is not None
        states = ("idle", "waiting", "suggesting", "evaluating", "canceling", "paused", "moving")
        text = f"{states[last.state]} {last.phase}".rstrip()
        if last.run_id:
            text += f"; run {last.run_id}: {last.evaluations} of {last.budget} evaluations"
            text += f", {last.feasible} feasible, {last.failed} failed"
            text += f", hypervolume {last.hypervolume:.6g}"
        return text + (f"; {last.message}" if last.message else "")

    def trigger(self, name: str) -> str:
        """Pause, resume, step, skip or stop."""
        return self.agreed(self.call(self.triggers[name], Trigger.Request()))

    def queue(self, setpoint: dict[str, float]) -> str:
        """Have a set-point evaluated next."""
        request = QueueSetpoint.Request(setpoint=named(setpoint))
        answer = self.call(self.queuer, request)
        self.agreed(answer)
        return f"in the queue: {answer.waiting}"

    def set(self, values: dict[str, Any]) -> str:
        """Set parameters: all of them or none."""
        parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        result = self.call(self.setter, request).result
        if "undeclared" in result.reason:
            sys.exit(f"refused: the tuner does not know all of {', '.join(values)}")
        if not result.successful:
            sys.exit(f"refused: {result.reason}")
        return f"set: {', '.join(values)}; it holds from the next evaluation on"

    def points(self, run_id: str, predict: bool) -> str:
        """The working points there are."""
        request = ListWorkingPoints.Request(run_id=run_id, predict=predict)
        answer = self.call(self.lister, request, PREDICTION_TIMEOUT)
        self.agreed(answer)
        text = table(answer.measured, "measured")
        return f"{text}\n\n{table(answer.predicted, 'predicted')}" if predict else text

    def go(self, goal: GoToWorkingPoint.Goal) -> str:
        """Go to a working point; Ctrl-C stops the machine where it is."""
        self.wait(self.mover.server_is_ready, TIMEOUT)
        sent = self.mover.send_goal_async(goal, feedback_callback=self.on_feedback)
        self.wait(sent.done, TIMEOUT)
        finished = sent.result().get_result_async()
        try:
            self.wait(finished.done, float("inf"))
        except KeyboardInterrupt:
            sent.result().cancel_goal_async()
            self.wait(finished.done, TIMEOUT)
        result = finished.result().result
        if result.error_code != GoToWorkingPoint.Result.NONE:
            sys.exit(f"refused: {result.error_msg}")
        where = ", ".join(f"{v.name} = {v.value:.6g} {v.unit}".rstrip() for v in result.readbacks)
        held = f", held with {result.evaluations} evaluations" if goal.hold_evaluations else ""
        return f"at point {result.point.index}{held}: {where}"

    def on_feedback(self, message: GoToWorkingPoint.Impl.FeedbackMessage) -> None:
        """Show how the machine is getting on."""
        feedback = message.feedback
        print(f"{feedback.phase}, {feedback.evaluations} evaluations", file=sys.stderr)

    def agreed(self, answer: Any) -> str:
        """The message of an answer that is a success."""
        if not answer.success:
            sys.exit(f"refused: {answer.message}")
        return str(answer.message)


def named(values: dict[str, float]) -> list[NamedValue]:
    """As messages."""
    return [NamedValue(name=name, value=float(value)) for name, value in values.items()]


def table(front: ParetoFront, title: str) -> str:
    """A front, one point a line; a predicted one has no index, for nobody was there."""
    lines = [f"{len(front.points)} points, {title}; hypervolume {front.hypervolume:.6g}"]
    rows = [["index", *(f"{o.name} {o.unit}".strip() for o in front.reference_point)]]
    for point in front.points:
        index = str(point.index) if title == "measured" else "-"
        rows.append([index, *(f"{o.value:.4g}" for o in point.objectives)])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines += ["  ".join(map(str.rjust, row, widths)) for row in rows]
    return "\n".join(lines)


def pair(text: str) -> tuple[str, Any]:
    """Of NAME=VALUE; the value is a number, true, false, a list of numbers, or text."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def number(text: str) -> tuple[str, float]:
    """Of NAME=NUMBER."""
    name, value = pair(text)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise argparse.ArgumentTypeError(f"{value!r} in {text!r} is not a number")
    return name, float(value)


def count(text: str) -> int:
    """A whole number, as messages take it."""
    if not (text.isdecimal() and int(text) < 2**32):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 0")
    return int(text)


def arguments() -> argparse.Namespace:
    """Of the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    for name in ("status", *TRIGGERS):
        verbs.add_parser(name)
    verbs.add_parser("set").add_argument("values", nargs="+", type=pair, metavar="NAME=VALUE")
    verbs.add_parser("queue").add_argument("values", nargs="+", type=number, metavar="NAME=NUMBER")
    points, go, best = (verbs.add_parser(name) for name in ("points", "go", "best"))
    points.add_argument("--predict", action="store_true")
    go.add_argument("index", type=count)
    best.add_argument("values", nargs="+", type=number, metavar="OBJECTIVE=WEIGHT")
    for verb in (go, best):
        verb.add_argument("--hold", type=count, default=0, metavar="EVALUATIONS")
        verb.add_argument("--radius", type=float, default=0.0)
    for verb in (points, go, best):
        verb.add_argument("--run", default="", metavar="ID")
    return parser.parse_args()


def main() -> None:
    """Do one thing and say what came of it."""
    options = arguments()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C is answered by a cancel
    try:
        print(answer(Panel(), options))
    except KeyboardInterrupt:
        sys.exit("stopped")
    finally:
        rclpy.try_shutdown()


def answer(panel: Panel, options: argparse.Namespace) -> str:
    """Do what the command line says; what came of it."""
    if options.verb == "status":
        return panel.status()
    if options.verb in TRIGGERS:
        return panel.trigger(TRIGGERS[options.verb])
    if options.verb == "set":
        return panel.set(dict(options.values))
    if options.verb == "queue":
        return panel.queue(dict(options.values))
    if options.verb == "points":
        return panel.points(options.run, options.predict)
    goal = GoToWorkingPoint.Goal(run_id=options.run, radius=options.radius)
    goal.hold_evaluations = options.hold
    if options.verb == "go":
        goal.choice, goal.index = goal.BY_INDEX, options.index
    else:
        goal.choice, goal.weights = goal.BY_WEIGHTS, named(dict(options.values))
    return panel.go(goal)


if __name__ == "__main__":
    main()
