"""The tuner: it proposes set-points, lets the machine evaluate them, and publishes the front."""

from __future__ import annotations

from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future

from mobo_tuner.core.problem import FIDELITY, ONE_FIDELITY, SECTIONS, Problem, ProblemError
from mobo_tuner.core.settings import method_of
from mobo_tuner.errors import UserError
from mobo_tuner.ros.parameters import (
    declare,
    given_parameters,
    refuse_unknown,
)
from mobo_tuner.ros.process import STOP_TIMEOUT, Program, exit_process, run_node
from mobo_tuner.ros.waiting import until
from mobo_tuner.ros.worker import Worker
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.gate import Gate
from mobo_tuner.tuner.health import TunerHealth
from mobo_tuner.tuner.machine_client import MachineClient
from mobo_tuner.tuner.parameters import TunerParameters, tuner_specs, with_method
from mobo_tuner.tuner.problem_parameters import ProblemParameters
from mobo_tuner.tuner.recording import Recording
from mobo_tuner.tuner.run.loop import RunLoop
from mobo_tuner.tuner.services.ask_tell import AskTell
from mobo_tuner.tuner.services.parameter_changes import ParameterChanges
from mobo_tuner.tuner.services.steering import SteeringServices
from mobo_tuner.tuner.services.tune import TuneServer
from mobo_tuner.tuner.services.working_points import WorkingPoints
from mobo_tuner.tuner.session import Session
from mobo_tuner.tuner.topics import Motion, TunerTopics
from mobo_tuner.wording import counted

STOPPED = "the tuner was asked to stop"


class Tuner:
    """Connects the parts of the tuner; nothing moves until a client requests it."""

    exit_code = None

    def __init__(self, executor: Executor) -> None:
        """Declare the parameters and serve.

        Raises:
            UserError: If the parameters do not form a problem and a suitable method.
        """
        self.node = Node("tuner", automatically_declare_parameters_from_overrides=True)
        try:
            given = given_parameters(self.node)
            if any(name.partition(".")[0] == FIDELITY for name in given):
                raise ProblemError(f"'{FIDELITY}' is given, {ONE_FIDELITY}")
            specs = tuner_specs(given)
            refuse_unknown(given, [*(spec.name for spec in specs), *SECTIONS])
            parameters = TunerParameters.from_values(with_method(declare(self.node, specs)))
            problem = ProblemParameters(self.node)
            method_of(parameters.values).check_problem(problem.problem)
        except UserError:
            self.node.destroy_node()
            raise
        self._context = context = TunerContext(
            node=self.node,
            parameters=parameters,
            worker=Worker(executor, "optimizer"),
            gate=Gate(
                MachineClient(
                    self.node,
                    silence_timeout=parameters.machine_timeout,
                    evaluation_timeout=parameters.evaluation_timeout,
                ),
                bounds=lambda: problem.problem,
                motion=Motion(self.node),
            ),
            topics=TunerTopics(self.node, problem.problem, parameters.client_timeout),
            stopping=Future(executor=executor),
        )
        self._session = session = Session()
        recording = Recording(context, session)
        loop = RunLoop(context, session, recording)
        self._changes = ParameterChanges(context, problem, session)
        self._steering = SteeringServices(context, session)
        self._working_points = WorkingPoints(context, session, loop)
        self._ask_tell = AskTell(context, session, problem)
        self._tune = TuneServer(context, session, loop, problem)
        self._health = TunerHealth(context, session, recording)
        self.node.get_logger().info(f"ready: {self._offer(problem.problem, parameters)}")

    def _offer(self, problem: Problem, parameters: TunerParameters) -> str:
        """Return what the tuner serves, for people."""
        folder = parameters.run_dir("")
        kept = f"runs are kept in {folder.absolute()}" if folder else "runs are not kept"
        objectives = counted(len(problem.objectives), "objective")
        variables = counted(len(problem.variables), "variable")
        return (
            f"{objectives} of {variables} can be tuned "
            f"by the action {self.node.resolve_topic_name('tune')}; {kept}"
        )

    async def stop(self) -> None:
        """End the current work and keep its results."""
        self._context.stopping.set_result(STOPPED)
        if self._session.run is not None:
            self._session.run.stop(STOPPED)
        self._working_points.stop(STOPPED)
        await until(self.node, lambda: not self._session.occupied, timeout=STOP_TIMEOUT)
        self._ask_tell.close()

    def close(self) -> None:
        """Release the worker and the node."""
        self._context.worker.shutdown()
        self.node.destroy_node()


def program() -> Program:
    """Return what the tuner's program says of itself."""
    return Program(
        "tuner",
        "Tunes a machine: proposes set-points, has them evaluated, learns, and reports the front.",
        tuner_specs({}),
        "The defaults of the method are those of the preset 'default' with its maximizer; see\n"
        "docs/parameters.md. The problem is given by the parameters below variables, objectives,\n"
        "constraints, observables and context, as in variables.K1.min.",
    )


def main() -> None:
    """Run the tuner node."""
    exit_process(run_node(Tuner, program()))


if __name__ == "__main__":
    main()
