"""Changes of the problem and the budget by setting parameters while the node runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

from mobo_tuner.core import Problem, ProblemError
from mobo_tuner.errors import UserError
from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.messages import machine_facts
from mobo_tuner.tuner.parameters import TUNER
from mobo_tuner.tuner.problem_parameters import ProblemParameters
from mobo_tuner.tuner.run.run import Run
from mobo_tuner.tuner.run.steering import Change

_WRITABLE = {spec.name: spec for spec in TUNER if spec.writable}


class Changes:
    """Checks what is set as a whole, and hands it to the run that goes on.

    A run takes it up before its next evaluation; without a run it is for those to come.

    Args:
        parts: of the tuner's node.
        parameters: of the problem.
        current: gives the run that goes on, if any.
    """

    def __init__(
        self,
        parts: TunerParts,
        parameters: ProblemParameters,
        current: Callable[[], Run | None],
    ) -> None:
        self._parts = parts
        self._parameters = parameters
        self._current = current
        parts.node.add_on_set_parameters_callback(self._check)
        parts.node.add_post_set_parameters_callback(self._accept)

    @property
    def problem(self) -> Problem:
        """As it is set now."""
        return self._parameters.problem

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        problem_changes, own_changes = self._sorted(parameters)
        run = self._current()
        try:
            for name, value in own_changes.items():
                _WRITABLE[name].check(value)
            budget = own_changes.get("evaluations")
            if run is not None and run.changeable and budget is not None and budget <= run.index:
                raise ProblemError(
                    f"evaluations is {budget}; more than the {run.index} that are finished are "
                    "allowed, and stop_after_this ends a run"
                )
            if problem_changes:
                problem = self._parameters.with_changes(problem_changes)
                if run is not None and run.machine is not None:
                    problem.check_machine(*machine_facts(run.machine))
        except UserError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _accept(self, parameters: Sequence[Parameter]) -> None:
        problem_changes, own_changes = self._sorted(parameters)
        if not problem_changes and not own_changes:
            return
        if problem_changes:
            self._parameters.accept(problem_changes)
        self._parts.parameters.update(own_changes)
        run = self._current()
        if run is None or not run.changeable:
            return
        pending = run.steering.change
        budget = pending.budget if pending else run.budget
        run.steering.change = Change(self.problem, own_changes.get("evaluations", budget))
        run.steering.notify()

    def _sorted(
        self, parameters: Sequence[Parameter]
    ) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        """What concerns the problem, and what the node itself."""
        values = {parameter.name: parameter.value for parameter in parameters}
        problem = {name: value for name, value in values.items() if self._parameters.owns(name)}
        own = {name: value for name, value in values.items() if name in _WRITABLE}
        return problem, own
