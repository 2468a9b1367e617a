"""Parameters: declared, described and checked in one way, from ROS or from a file before it starts.

Nothing here imports rclpy at the top, so that a parameter file can be checked before any node runs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mobo_tuner.core.problem import ProblemError

if TYPE_CHECKING:
    from rclpy.node import Node

ParameterValue = bool | int | float | str


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter of a node; its type is that of `default`.

    It is read when the node starts; only a `writable` one may be set later.
    """

    name: str
    default: ParameterValue
    description: str
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()
    writable: bool = False

    def check(self, value: object, where: str = "") -> ParameterValue:
        """The value as this parameter's type.

        Raises:
            ProblemError: it is of another type or not allowed; `where` precedes the name.
        """
        name = f"{where}{self.name}"
        if isinstance(self.default, bool) or isinstance(value, bool):
            if not (isinstance(self.default, bool) and isinstance(value, bool)):
                raise ProblemError(f"{name} must be {self.type_name}, not {value!r}")
            return value
        if isinstance(self.default, str):
            if not isinstance(value, str):
                raise ProblemError(f"{name} must be {self.type_name}, not {value!r}")
            if self.choices and value not in self.choices:
                raise ProblemError(f"{name} is {value!r}; allowed are {', '.join(self.choices)}")
            return value
        whole = isinstance(self.default, int)
        # A whole number may be too large for any comparison with a float but this one.
        if not isinstance(value, int if whole else int | float) or not abs(value) < math.inf:
            raise ProblemError(f"{name} must be {self.type_name}, not {value!r}")
        if not self.minimum <= value <= self.maximum:
            raise ProblemError(f"{name} is {value}; {self.range_text} is allowed")
        return value if whole else float(value)

    @property
    def type_name(self) -> str:
        """The parameter's type, in words."""
        names = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
        return names[type(self.default)]

    @property
    def range_text(self) -> str:
        """What is allowed, in words; empty where everything is."""
        if self.choices:
            return ", ".join(self.choices)
        low, high = (
            f"{end:.0f}" if math.isfinite(end) and end == round(end) else f"{end:g}"
            for end in (self.minimum, self.maximum)
        )
        if math.isfinite(self.minimum) and math.isfinite(self.maximum):
            return f"{low} to {high}"
        if math.isfinite(self.minimum):
            return f"at least {low}"
        return f"at most {high}" if math.isfinite(self.maximum) else ""


TUNER = (
    ParameterSpec(
        "preset",
        "default",
        "how candidates are chosen: the best recipe known, or the paper's to the letter",
        choices=("default", "paper"),
    ),
    ParameterSpec("seed", 0, "of every random choice of a run", minimum=0, maximum=2**31 - 1),
    ParameterSpec(
        "evaluations",
        60,
        "budget of a run whose goal names none; set while a run goes on, it is that run's budget",
        minimum=1,
        maximum=100_000,
        writable=True,
    ),
    ParameterSpec(
        "initial_evaluations",
        0,
        "points of the Latin-hypercube start; 0 = as many as the preset thinks fit",
        minimum=0,
        maximum=10_000,
    ),
    ParameterSpec(
        "proximal",
        False,
        "whether steps from one set-point to the next are kept short, weighed by the variables' cost",
    ),
    ParameterSpec(
        "model_input",
        "setpoint",
        "what the models learn from: where the machine was sent, or where its readbacks said it was",
        choices=("setpoint", "readback"),
    ),
    ParameterSpec(
        "shots",
        0,
        "shots to average over per evaluation; 0 = as many as the machine thinks fit",
        minimum=0,
        maximum=10_000,
    ),
    ParameterSpec(
        "runs_dir", "", "folder of the runs, where the journal is kept; empty = no journal"
    ),
    ParameterSpec(
        "discovery_timeout",
        10.0,
        "how long a goal waits for the machine to appear [s]",
        minimum=0.1,
        maximum=3600.0,
    ),
    ParameterSpec(
        "machine_timeout",
        5.0,
        "silence of the machine (no feedback, no result) after which it counts as lost [s]",
        minimum=0.5,
        maximum=3600.0,
    ),
    ParameterSpec(
        "suggestion_timeout",
        300.0,
        "longest time that one suggestion may take [s]",
        minimum=1.0,
        maximum=86_400.0,
    ),
    ParameterSpec(
        "evaluation_timeout",
        900.0,
        "longest time that one evaluation may take [s]",
        minimum=1.0,
        maximum=86_400.0,
    ),
    ParameterSpec(
        "max_consecutive_failures",
        10,
        "failed evaluations in a row after which the run ends with an error",
        minimum=1,
        maximum=100_000,
    ),
    ParameterSpec(
        "on_failure",
        "skip",
        "after a failed evaluation: try it again, learn from it and go on, or end the run",
        choices=("retry", "skip", "abort"),
    ),
    ParameterSpec(
        "max_attempts",
        3,
        "how often an evaluation is tried before it counts as failed, where on_failure is retry",
        minimum=1,
        maximum=1000,
    ),
    ParameterSpec(
        "retry_delay",
        1.0,
        "before the second attempt; it doubles with every further one, up to 60 s [s]",
        minimum=0.0,
        maximum=60.0,
    ),
    ParameterSpec(
        "machine_return_timeout",
        60.0,
        "how long a run pauses until a machine that was lost is back, before it ends with an error [s]",
        minimum=0.0,
        maximum=604_800.0,
    ),
    ParameterSpec(
        "on_abort",
        "hold",
        "where the tuner sends the machine after a cancel, a stop or an error",
        choices=("hold", "restore", "best"),
    ),
    ParameterSpec(
        "on_violation",
        "hold",
        "where the machine goes when a critical constraint is violated",
        choices=("hold", "restore", "best"),
    ),
    ParameterSpec(
        "on_client_lost",
        "hold",
        "where the machine goes when the tuner's heartbeat stops",
        choices=("hold", "restore", "best"),
    ),
    ParameterSpec(
        "pause_on_violation",
        False,
        "whether a run pauses, until someone says resume or step, after a violation",
    ),
    ParameterSpec(
        "client_timeout",
        5.0,
        "silence of the tuner's heartbeat after which the machine counts it as lost; "
        "0 = it does not watch [s]",
        minimum=0.0,
        maximum=3600.0,
    ),
)

RECORDER = (
    ParameterSpec("bag_path", "", "folder of the bag; must not exist yet"),
    ParameterSpec(
        "discovery_period",
        0.2,
        "how often new topics are looked for [s]",
        minimum=0.05,
        maximum=60.0,
    ),
)

CONSOLE = (
    ParameterSpec("run_id", "", "names the run; empty = the time gives the name"),
    ParameterSpec(
        "evaluations", 0, "budget of the run; 0 = as the tuner is set", minimum=0, maximum=100_000
    ),
    ParameterSpec(
        "resume_from",
        "",
        "id of an earlier run whose evaluations this one begins with; empty = none",
    ),
    ParameterSpec("wait_for_recorder", True, "begin only when a recorder records the run"),
    ParameterSpec(
        "ready_timeout",
        30.0,
        "how long to wait for the tuner and the recorder [s]",
        minimum=0.1,
        maximum=3600.0,
    ),
)

MACHINE_BRIDGE = (
    ParameterSpec("mapping", "", "the mapping file: which topic, service or action is what"),
)


def check_section(
    where: str, section: Mapping[str, Any], specs: Sequence[ParameterSpec]
) -> dict[str, ParameterValue]:
    """Check one node's parameters as they stand in a file; defaults fill what is not given.

    Raises:
        ProblemError: a parameter is unknown, of the wrong type or not allowed.
    """
    known = {spec.name: spec for spec in specs}
    for name in section:
        if name not in known and name != "use_sim_time":
            raise ProblemError(f"'{name}' is unknown in {where}; allowed are {', '.join(known)}")
    return {
        spec.name: spec.check(section.get(spec.name, spec.default), f"{where}.") for spec in specs
    }


def declare(node: Node, specs: Sequence[ParameterSpec]) -> dict[str, Any]:
    """Declare parameters with description and range, and return their values.

    Raises:
        ProblemError: a value is of the wrong type or not allowed.
    """
    from rcl_interfaces.msg import ParameterDescriptor

    values = {}
    for spec in specs:
        descriptor = ParameterDescriptor(
            name=spec.name,
            description=spec.description,
            additional_constraints=spec.range_text,
            read_only=not spec.writable,
            dynamic_typing=True,  # so that `speed: 100` may stand for 100.0; checked below
        )
        if node.has_parameter(spec.name):
            value = node.get_parameter(spec.name).value
            node.set_descriptor(spec.name, descriptor)
        else:
            value = node.declare_parameter(spec.name, spec.default, descriptor).value
        values[spec.name] = spec.check(value)
    return values
