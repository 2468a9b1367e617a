"""Send the simulated machine random and malformed goals, set-points, parameters and transitions.

Every malformed goal is a valid one with one fault, so that the expected error is known. Prints the
number of requests of each kind and every wrong answer; exits with 1 if there is one.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from std_msgs.msg import Float64

from awa_sim_node.machine import Mode, behaviour_of, describe
from launcher.ros_domain import RosDomain
from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from robustness.machine_process import MachineProcess

RESULT = EvaluateSetpoint.Result
PARAMETERS = {"model": "awa", "mode": "nominal", "speed": 1e5, "seed": 1}
_VARIABLES = describe("awa").variables
_DIAGNOSTICS = tuple(diagnostic.name for diagnostic in describe("awa").diagnostics)
_NAMES = ("", "K3", "k1", "K1 ", "K1/setpoint", "µ\U0001f600", "x" * 5000, "'; --", "\n")
_SPECIAL = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0, 0.0)
GOOD = {RESULT.NONE, RESULT.INVALID_MEASUREMENT}  # a nominal machine also has faults


@dataclass
class Report:
    """Results of the fuzzing.

    Attributes:
        sent: Number of requests of each kind.
        wrong: One sentence per wrong answer.
    """

    sent: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    @property
    def total(self) -> int:
        """Number of all requests."""
        return self.sent.total()


class Fuzzer:
    """A fuzzer of one machine.

    Args:
        machine: Machine under test.
        seed: Seed of the random requests.
    """

    def __init__(self, machine: MachineProcess, seed: int) -> None:
        self._machine = machine
        self._rng = np.random.default_rng(seed)
        self._index = 0
        self._setpoints = {
            v.name: machine.publisher(Float64, f"{v.name}/setpoint") for v in _VARIABLES
        }
        self.report = Report()

    def run(self, count: int) -> Report:
        """Send `count` requests of all kinds, then check that the machine still works."""
        kinds: list[tuple[Callable[[], None], float]] = [
            (self._malformed_evaluation, 0.5),
            (self._good_evaluation, 0.1),
            (self._malformed_move, 0.1),
            (self._two_at_once, 0.05),
            (self._canceled, 0.05),
            (self._device, 0.1),
            (self._parameter, 0.08),
            (self._transition, 0.02),
        ]
        weights = np.array([weight for _, weight in kinds])
        for choice in self._rng.choice(len(kinds), count, p=weights / weights.sum()):
            kinds[choice][0]()
        self._good_evaluation()
        if "Traceback" in self._machine.log:
            self.report.wrong.append("the machine printed a traceback")
        return self.report

    def _judge(self, kind: str, result: Any, allowed: set[int]) -> None:
        self.report.sent[kind] += 1
        code, text = int(result.error_code), str(result.error_msg)
        if code not in allowed:
            self.report.wrong.append(f"{kind}: {code} ({text}), not one of {sorted(allowed)}")
        elif (code == RESULT.NONE) is not (text == ""):
            self.report.wrong.append(f"{kind}: {code} with the message {text!r}")

    def _evaluate(self, kind: str, goal: EvaluateSetpoint.Goal, allowed: set[int]) -> None:
        self._judge(kind, self._machine.result(self._machine.send(goal)), allowed)

    def _goal(self) -> EvaluateSetpoint.Goal:
        self._index += 1
        return EvaluateSetpoint.Goal(
            run_id="fuzz", index=self._index, setpoint=self._point(), shots=1
        )

    def _point(self) -> list[msg.NamedValue]:
        """Return a valid set-point in random order."""
        named = [
            msg.NamedValue(
                name=v.name,
                value=float(self._rng.uniform(v.minimum, v.maximum)),
                stddev=float(self._rng.choice(_SPECIAL)),
                unit=str(self._rng.choice(["", v.unit])),
            )
            for v in _VARIABLES
        ]
        self._rng.shuffle(named)
        return named

    def _bad_point(self) -> tuple[str, list[msg.NamedValue]]:
        """Return the kind of fault and a set-point with it."""
        point = self._point()
        item = point[self._rng.integers(len(point))]
        kinds = ("missing", "empty", "repeated", "unknown", "not finite", "outside", "unit", "long")
        kind = str(self._rng.choice(kinds))
        if kind == "missing":
            point.remove(item)
        elif kind == "empty":
            point = []
        elif kind == "repeated":
            point.append(msg.NamedValue(name=item.name, value=item.value))
        elif kind == "unknown":
            name = str(self._rng.choice(_NAMES))
            point.append(msg.NamedValue(name=name, value=float(self._rng.choice(_SPECIAL))))
        elif kind == "not finite":
            item.value = float(self._rng.choice([math.nan, math.inf, -math.inf]))
        elif kind == "outside":
            item.value = float(self._rng.choice([-1.0, 1.0]) * 10.0 ** self._rng.uniform(3, 308))
        elif kind == "unit":
            item.unit = str(self._rng.choice(["mA", "V", "%n", "°"]))
        else:
            point *= 500
        return kind, point

    def _malformed_evaluation(self) -> None:
        goal, allowed = self._goal(), {RESULT.INVALID_SETPOINT}
        fields = ("setpoint", "shots", "old", "critical", "timeout", "if_lost", "if_violated")
        kind = str(self._rng.choice(fields))
        if kind == "setpoint":
            what, goal.setpoint = self._bad_point()
            kind = f"set-point: {what}"
        elif kind == "shots":
            goal.shots = int(self._rng.integers(10_001, 65_536))
        elif kind == "old":
            # The index of the run's last finished evaluation, or an earlier one.
            self._evaluate("good", goal, GOOD)
            goal = self._goal()
            goal.index = int(self._rng.integers(0, self._index))
            allowed = {RESULT.UNKNOWN}
        elif kind == "critical":
            goal.critical, allowed = self._critical()
        elif kind == "timeout":
            goal.client_timeout = float(self._rng.choice([math.nan, math.inf, -math.inf, -1e-3]))
        elif kind == "if_lost":
            _, goal.if_client_lost = self._bad_point()
            if not goal.if_client_lost:  # empty is allowed: hold
                allowed = GOOD
        else:
            _, goal.if_violated = self._bad_point()
            if not goal.if_violated:
                allowed = GOOD
        self._evaluate(kind, goal, allowed)

    def _critical(self) -> tuple[list[msg.Constraint], set[int]]:
        name = str(self._rng.choice(_DIAGNOSTICS))
        kind = int(self._rng.integers(4))
        if kind == 0:
            unknown = str(self._rng.choice(_NAMES))
            limits = [msg.Constraint(name=unknown, min=0.0, max=1.0)]
        elif kind == 1:
            limits = [msg.Constraint(name=name, min=math.nan, max=1.0)]
        elif kind == 2:
            limits = [msg.Constraint(name=name, min=1.0, max=-1.0)]
        else:
            # A limit that every valid shot violates.
            return [msg.Constraint(name=name, min=-2e9, max=-1e9)], {
                RESULT.VIOLATION,
                RESULT.INVALID_MEASUREMENT,
            }
        return limits, {RESULT.INVALID_SETPOINT}

    def _good_evaluation(self) -> None:
        self._evaluate("good", self._goal(), GOOD)

    def _malformed_move(self) -> None:
        kind, point = self._bad_point()
        result = self._machine.result(self._machine.send(ApplySetpoint.Goal(setpoint=point)))
        # An empty set-point only asks for the readbacks.
        self._judge(f"move: {kind}", result, {RESULT.INVALID_SETPOINT if point else RESULT.NONE})

    def _two_at_once(self) -> None:
        """Send a move during a long evaluation."""
        goal = self._goal()
        goal.shots = 10_000
        handle = self._machine.send(goal)
        move = self._machine.send(ApplySetpoint.Goal(setpoint=self._point()))
        self._judge("busy", self._machine.result(move), {RESULT.BUSY})
        handle.cancel_goal_async()
        self._judge("canceled", self._machine.result(handle), {RESULT.CANCELED})

    def _canceled(self) -> None:
        goal = self._goal()
        handle = self._machine.send(goal)
        handle.cancel_goal_async()
        self._judge("canceled at once", self._machine.result(handle), GOOD | {RESULT.CANCELED})

    def _device(self) -> None:
        """Publish an invalid value on a set-point topic."""
        name = str(self._rng.choice(list(self._setpoints)))
        values = [math.nan, math.inf, -math.inf, 1e308, -1e308, 1e9]
        self._setpoints[name].publish(Float64(data=float(self._rng.choice(values))))
        self.report.sent["device"] += 1

    def _parameter(self) -> None:
        """Set a parameter at run time, when all are read-only, and check the same value at start."""
        behaviour = behaviour_of("awa", Mode(str(self._rng.choice(list(Mode)))))
        name = str(self._rng.choice([*behaviour.values, *_NAMES, "speed", "seed", "mode"]))
        value = float(self._rng.choice([*_SPECIAL, -1.0, 1e12]))
        request = SetParameters.Request(
            parameters=[
                Parameter(
                    name=name,
                    value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value),
                )
            ]
        )
        for answer in self._machine.call("set_parameters", request).results:
            if answer.successful or not answer.reason:
                self.report.wrong.append(
                    f"parameter {name!r} = {value} was accepted, or refused without a reason"
                )
        self.report.sent["parameter"] += 1
        try:
            changed = behaviour.changed({name: value}).values[name]
        except ValueError as error:
            if "\n" in str(error) or not str(error):
                self.report.wrong.append(f"parameter {name!r} = {value}: {error}")
        else:
            info = behaviour.infos[name]
            if not info.minimum <= changed <= info.maximum:
                self.report.wrong.append(f"parameter {name!r} = {value} was accepted at start")

    def _transition(self) -> None:
        """Request a transition that an active node does not allow."""
        unknown = (
            Transition.TRANSITION_CONFIGURE,
            Transition.TRANSITION_ACTIVATE,
            Transition.TRANSITION_CLEANUP,
            200,
        )
        request = ChangeState.Request(transition=Transition(id=int(self._rng.choice(unknown))))
        self.report.sent["transition"] += 1
        if self._machine.call("change_state", request).success:
            self.report.wrong.append(f"transition {request.transition.id} succeeded")


def main() -> int:
    """Fuzz the machine, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="number of requests")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random requests")
    options = parser.parse_args()
    with RosDomain() as domain, MachineProcess(domain.environment, PARAMETERS) as machine:
        report = Fuzzer(machine, options.seed).run(options.count)
        print(f"{report.total} sent, {len(report.wrong)} wrong answers")
        print(f"the machine used {machine.cpu_seconds:.0f} s and {machine.memory:.0f} MB")
    for kind, number in sorted(report.sent.items()):
        print(f"{number:6d}  {kind}")
    for sentence in report.wrong[:50]:
        print(sentence)
    return 1 if report.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
