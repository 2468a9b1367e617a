"""Controls that have never heard of this project, to show what the bridge is for. Plain rclpy, standard types.

    python examples/foreign_machine.py
    machine_bridge --ros-args -p mapping:=config/bridge_foreign.yaml

Two power supplies take and give arrays (sensor_msgs/JointState, in mA), a ladder (std_msgs/String) moves one of its
targets into the beam, a camera is fired by a Trigger, and what it saw is asked of a slow service
(rcl_interfaces/GetParameters). A permit says whether anything may move. The beam is the paper's toy problem, so that
config/toy.yaml tunes it; config/laboratory.yaml also moves the ladder.

The parameter `fault` makes it misbehave: ros2 param set /foreign_machine fault offset
"""

import math
import time

import rclpy
from rcl_interfaces.msg import (
    ParameterDescriptor,
    ParameterType,
    ParameterValue,
    SetParametersResult,
)
from rcl_interfaces.srv import GetParameters
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

SUPPLIES = ("Q1", "Q2")
TARGETS = {"none": 0.0, "foil": 0.3, "mesh": 0.8}  # what each adds to the beam
SPEED = 10_000.0  # of a supply's current [mA/s]
PERIOD = 0.02  # of the supplies' control loop [s]
EXPOSURE = 0.1  # that the camera takes to tell what it saw [s]
FAULTS = (
    "none",
    "offset",  # the supplies read 500 mA too much
    "nan",  # they read nothing
    "frozen",  # they repeat their last reading, its stamp included
    "doubled",  # they say everything twice
    "late",  # what they say is 5 s old
    "deaf",  # they do not hear commands
    "silent",  # they say nothing
    "unlit",  # the camera sees nothing: NaN
    "jammed",  # the camera's Trigger fails
    "slow",  # the camera takes its time
    "no_permit",  # nothing may move
)


class ForeignMachine(Node):
    """Two supplies, a ladder, a camera and a permit."""

    def __init__(self) -> None:
        """Switch everything on, at 0 mA."""
        super().__init__("foreign_machine")
        self.current = dict.fromkeys(SUPPLIES, 0.0)  # [mA]
        self.target = dict(self.current)
        self.ladder = "none"
        self.picture: dict[str, float] = {}
        self.fault = "none"
        self.frozen: JointState | None = None
        self.state = self.create_publisher(JointState, "supplies/state", 10)
        self.permit = self.create_publisher(Bool, "permit", 10)
        self.create_subscription(JointState, "supplies/command", self.command, 10)
        self.ladder_state = self.create_publisher(String, "ladder/state", 10)
        self.create_subscription(String, "ladder/command", self.move_ladder, 10)
        self.create_timer(PERIOD, self.step)
        self.create_timer(0.1, self.tell_permit)
        group = ReentrantCallbackGroup()  # so that looking keeps nobody from firing
        self.create_service(Trigger, "camera/fire", self.fire, callback_group=group)
        self.create_service(GetParameters, "camera/look", self.look, callback_group=group)
        description = f"one of {', '.join(FAULTS)}"
        self.add_on_set_parameters_callback(self.set_fault)  # first: it hears of the start, too
        self.declare_parameter("fault", "none", ParameterDescriptor(description=description))

    def command(self, message: JointState) -> None:
        """New currents for some supplies."""
        for name, position in zip(message.name, message.position, strict=False):
            if name in self.target and self.fault != "deaf":
                self.target[name] = position

    def move_ladder(self, message: String) -> None:
        """Move another target into the beam."""
        if message.data in TARGETS and self.fault != "deaf":
            self.ladder = message.data

    def step(self) -> None:
        """Let the currents follow, and tell them."""
        for name, target in self.target.items():
            change = target - self.current[name]
            self.current[name] += math.copysign(min(abs(change), SPEED * PERIOD), change)
        if self.fault == "silent":
            return
        self.ladder_state.publish(String(data=self.ladder))
        message = JointState(name=list(SUPPLIES), position=list(self.current.values()))
        message.header.stamp = self.get_clock().now().to_msg()
        if self.fault == "offset":
            message.position = [value + 500.0 for value in self.current.values()]
        elif self.fault == "nan":
            message.position = [math.nan] * len(SUPPLIES)
        elif self.fault == "frozen":
            message = self.frozen or message
        elif self.fault == "late":
            message.header.stamp.sec -= 5
        self.frozen = message
        for _ in range(2 if self.fault == "doubled" else 1):
            self.state.publish(message)

    def tell_permit(self) -> None:
        """Say whether anything may move."""
        self.permit.publish(Bool(data=self.fault != "no_permit"))

    def fire(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Take a picture."""
        response.success = self.fault != "jammed"
        response.message = "" if response.success else "the shutter is jammed"
        x1, x2 = (0.001 * self.current[name] for name in SUPPLIES)
        more = TARGETS[self.ladder]
        self.picture = {
            "f1": math.hypot(x1 - 1.0, x2 - 1.0) + more,
            "f2": math.hypot(x1 + 1.0, x2 + 1.0) + more,
        }
        if self.fault == "unlit":
            self.picture = dict.fromkeys(self.picture, math.nan)
        return response

    def look(
        self, request: GetParameters.Request, response: GetParameters.Response
    ) -> GetParameters.Response:
        """Tell what the last picture shows."""
        time.sleep(3.0 if self.fault == "slow" else EXPOSURE)  # the camera exposes
        response.values = [
            ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=self.picture[name])
            for name in request.names
            if name in self.picture
        ]
        return response

    def set_fault(self, parameters: list[Parameter]) -> SetParametersResult:
        """Begin to misbehave, or stop it."""
        for parameter in parameters:
            if parameter.name == "fault" and parameter.value not in FAULTS:
                return SetParametersResult(successful=False, reason=f"not one of {FAULTS}")
            if parameter.name == "fault":
                self.fault = parameter.value
        return SetParametersResult(successful=True)


def main() -> None:
    """Serve until stopped."""
    rclpy.init()
    node = ForeignMachine()
    executor = MultiThreadedExecutor(num_threads=4)  # so that the slow service keeps nobody waiting
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
