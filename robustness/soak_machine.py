"""Evaluate thousands of set-points on the simulated machine, and check for leaks and lost answers.

Prints the machine's memory, open files and threads after a warm-up and at the end. Exits with 1 if
the memory grew by more than 5 %, or an answer was lost or belongs to another evaluation.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64

from awa_sim_node.machine import describe
from launcher.ros_domain import RosDomain
from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.ros.qos import STREAM
from robustness.machine_process import MachineProcess

PARAMETERS = {"model": "awa", "mode": "nominal", "speed": 1e5, "seed": 1}
GROWTH = 0.05  # allowed growth of the memory, as a fraction
RESULT = EvaluateSetpoint.Result


class Soak:
    """Random evaluations and their counts.

    Args:
        machine: Machine under test.
        seed: Seed of the set-points.
    """

    def __init__(self, machine: MachineProcess, seed: int) -> None:
        self._machine = machine
        self._rng = np.random.default_rng(seed)
        self._variables = describe("awa").variables
        self.shots = 0
        self.measured = 0  # the machine's own count
        self.beam = 0  # messages on the topic of one diagnostic
        self.failures = 0
        self.wrong = 0
        machine.node.create_subscription(Float64, "beam/charge", self._hear_beam, STREAM)
        machine.node.create_subscription(
            DiagnosticArray, "/diagnostics", self._hear_diagnostics, STREAM
        )

    def evaluate(self, index: int) -> None:
        """Evaluate one random set-point with five shots."""
        point = [
            msg.NamedValue(name=v.name, value=float(self._rng.uniform(v.minimum, v.maximum)))
            for v in self._variables
        ]
        goal = EvaluateSetpoint.Goal(run_id="soak", index=index, setpoint=point, shots=5)
        result = self._machine.result(self._machine.send(goal))
        self.shots += result.shots
        self.failures += result.error_code != RESULT.NONE
        self.wrong += (result.run_id, result.index) != ("soak", index)
        self.wrong += result.error_code not in (RESULT.NONE, RESULT.INVALID_MEASUREMENT)

    def settle(self, measured: int) -> None:
        """Wait until the machine's own count is at least `measured`."""
        self._machine.spin_until(lambda: self.measured >= measured, "the machine's own count")

    def _hear_beam(self, _: Float64) -> None:
        self.beam += 1

    def _hear_diagnostics(self, message: DiagnosticArray) -> None:
        values = {v.key: v.value for status in message.status for v in status.values}
        self.measured = int(values["measurements"])


def main() -> int:
    """Run the soak test, and print its results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--evaluations", type=int, default=5000, help="number of evaluations after the warm-up"
    )
    parser.add_argument(
        "--warm-up", type=int, default=500, help="number of evaluations in the warm-up"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the set-points")
    options = parser.parse_args()
    with RosDomain() as domain, MachineProcess(domain.environment, PARAMETERS) as machine:
        soak = Soak(machine, options.seed)
        print("evaluations  memory [MB]  open files  threads  seconds each")

        def line(index: int, began: float, count: int) -> None:
            each = (time.monotonic() - began) / count
            print(
                f"{index:11d}  {machine.memory:11.1f}  {machine.open_files:10d}  "
                f"{machine.threads:7d}  {each:12.4f}",
                flush=True,
            )

        total = options.warm_up + options.evaluations
        step = max(1, options.evaluations // 10)
        began, memory = time.monotonic(), 0.0
        for index in range(total):
            soak.evaluate(index)
            if index + 1 == options.warm_up:
                memory = machine.memory
                line(index + 1, began, options.warm_up)
                began = time.monotonic()
            elif index + 1 > options.warm_up and (index + 1 - options.warm_up) % step == 0:
                line(index + 1, began, step)
                began = time.monotonic()
        soak.settle(total)
        growth = machine.memory / memory - 1.0
        tracebacks = machine.log.count("Traceback")
        cpu = machine.cpu_seconds / total
    print(f"memory grew by {100.0 * growth:.2f} % after the warm-up")
    print(
        f"{total} evaluations sent, {soak.measured} measured by the machine's own count, "
        f"{soak.failures} of them failed, {soak.wrong} answers wrong, {tracebacks} tracebacks"
    )
    print(
        f"{soak.shots} shots in the results, {soak.beam} messages on beam/charge (at least as many)"
    )
    print(f"{1000.0 * cpu:.1f} ms of the machine's CPU time per evaluation")
    good = (
        growth <= GROWTH
        and soak.measured == total
        and soak.wrong == 0
        and tracebacks == 0
        and soak.beam >= soak.shots
    )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
