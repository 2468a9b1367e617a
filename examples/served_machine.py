"""A machine of your own with all the safety: limits, ramps, readbacks, interlock, cancel, heartbeat.

    python examples/served_machine.py

Replace the bodies of `write`, `read`, `shot` and `interlock` by calls of your control system; they may
block and may raise. Here two power supplies and a screen play the paper's toy problem, and nothing moves
while the file `no_permit` exists in the folder for temporary files. docs/own_machine.md explains the rest.
"""

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path

from rclpy.executors import Executor
from rclpy.node import Node

from mobo_tuner.machine.node import serve
from mobo_tuner.machine.ramp import RampedVariable, RampSettings
from mobo_tuner.machine.simple import SimpleMachine

NO_PERMIT = Path(tempfile.gettempdir(), "no_permit")
VARIABLES = [
    RampedVariable(name=name, minimum=-2.0, maximum=2.0, max_step=0.2, slew=4.0, tolerance=0.01)
    for name in ("x1", "x2")
]


class MyMachine(SimpleMachine):
    """Two power supplies and a screen."""

    def __init__(self, node: Node, executor: Executor) -> None:
        """Connect; nothing moves."""
        self.currents = {"x1": 0.0, "x2": 0.0}
        units = {"f1": "", "f2": ""}
        ramp = RampSettings(rate=20.0, settle_time=0.2, settle_timeout=5.0)
        super().__init__(
            node, executor, name="my machine", variables=VARIABLES, diagnostics=units, settings=ramp
        )

    def write(self, setpoint: Mapping[str, float]) -> None:
        """Set the supplies: one step of a ramp."""
        self.currents = dict(setpoint)

    def read(self) -> Mapping[str, float]:
        """Read the supplies back."""
        return self.currents

    def shot(self) -> Mapping[str, float]:
        """Look at the screen once."""
        x1, x2 = self.currents["x1"], self.currents["x2"]
        return {"f1": math.hypot(x1 - 1.0, x2 - 1.0), "f2": math.hypot(x1 + 1.0, x2 + 1.0)}

    def interlock(self) -> str:
        """Say why nothing may move; empty if all may."""
        return f"{NO_PERMIT} forbids to move" if NO_PERMIT.exists() else ""


if __name__ == "__main__":
    serve(MyMachine, "my_machine")
