"""Changes of the problem and the budget by setting parameters while the node runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

from mobo_tuner.core import Problem
from mobo_tuner.core.settings import COSTS
from mobo_tuner.errors import ParameterError, UserError
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.messages import machine_facts
from mobo_tuner.tuner.parameters import TUNER
from mobo_tuner.tuner.problem_parameters import ProblemParameters
from mobo_tuner.tuner.run.run import Run
from mobo_tuner.tuner.run.steering import Change
from mobo_tuner.tuner.session import Session

_WRITABLE = {spec.name: spec for spec in TUNER if spec.writable}


class ParameterChanges:
    """Checks what is set as a whole, and hands it to the active run.

    The run applies it before its next evaluation; without a run it is for the next one.

    Args:
        context: The tuner's node and what works in it.
        parameters: Parameters of the problem.
        session: Session with the active run.
    """

    def __init__(
        self, context: TunerContext, parameters: ProblemParameters, session: Session
    ) -> None:
        self._context = context
        self._parameters = parameters
        self._session = session
        context.node.add_on_set_parameters_callback(self._check)
        context.node.add_post_set_parameters_callback(self._accept)

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        problem_changes, own_changes = self._sorted(parameters)
        run = self._session.run
        try:
            for name, value in own_changes.items():
                _WRITABLE[name].check(value)
            budget = own_changes.get("evaluations")
            if run is not None and run.changeable and budget is not None and budget <= run.index:
                raise ParameterError(
                    f"evaluations is {budget}; more than the {run.index} that are finished are "
                    "allowed, and 'stop' ends the run"
                )
            if problem_changes:
                self._check_problem(self._parameters.with_changes(problem_changes))
            self._check_effect(problem_changes)
        except UserError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _check_effect(self, changes: Mapping[str, Any]) -> None:
        """Check that what is set has an effect.

        Raises:
            ParameterError: If it has none.
        """
        costs = [
            name for name in changes if name.startswith("variables.") and name.endswith("cost")
        ]
        proximal = self._context.parameters.values["proximal"]
        if costs and proximal != COSTS:
            raise ParameterError(
                f"{costs[0]} has no effect: proximal is {'null' if proximal is None else proximal}; "
                f"only with 'proximal: {COSTS}' in the tuner's section of the file do costs count"
            )

    def _check_problem(self, problem: Problem) -> None:
        run = self._session.run
        if run is None:
            return
        if run.machine is not None:
            machine_facts(run.machine).check(problem)
        if run.changeable:
            check_reach(run, problem)

    def _accept(self, parameters: Sequence[Parameter]) -> None:
        problem_changes, own_changes = self._sorted(parameters)
        if not problem_changes and not own_changes:
            return
        if problem_changes:
            self._parameters.accept(problem_changes)
        self._context.parameters.update(own_changes)
        run = self._session.run
        if run is None or not run.changeable or run.steering.over:
            return
        if not problem_changes and "evaluations" not in own_changes:
            return
        pending = run.steering.change
        budget = pending.budget if pending else run.budget
        run.steering.change = Change(
            self._parameters.problem, own_changes.get("evaluations", budget)
        )
        run.steering.notify()

    def _sorted(
        self, parameters: Sequence[Parameter]
    ) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        """Return what concerns the problem, and what concerns the node itself."""
        values = {parameter.name: parameter.value for parameter in parameters}
        problem = {name: value for name, value in values.items() if self._parameters.owns(name)}
        own = {name: value for name, value in values.items() if name in _WRITABLE}
        return problem, own


def check_reach(run: Run, problem: Problem) -> None:
    """Check that the evaluations of a run are near enough to new bounds for the models.

    Raises:
        ProblemError: If one is too far away.
    """
    for _, record in run.records:
        problem.normalize(record.setpoint)
