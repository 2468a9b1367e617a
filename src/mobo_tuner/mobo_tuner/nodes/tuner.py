"""The tuner: proposes set-points, has the machine evaluate them, learns, and reports the front."""

from __future__ import annotations

from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future

from mobo_tuner.core.problem import SECTIONS
from mobo_tuner.core.settings import method_of
from mobo_tuner.errors import UserError
from mobo_tuner.ros.parameters import (
    declare,
    given_parameters,
    refuse_unknown,
)
from mobo_tuner.ros.process import STOP_TIMEOUT, exit_process, run_node
from mobo_tuner.ros.waiting import until
from mobo_tuner.ros.worker import Worker
from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.heartbeat import Heartbeat
from mobo_tuner.tuner.machine_client import MachineClient
from mobo_tuner.tuner.parameters import tuner_specs, with_method
from mobo_tuner.tuner.problem_parameters import ProblemParameters
from mobo_tuner.tuner.run.keeper import RunKeeper
from mobo_tuner.tuner.services.ask_tell import AskTell
from mobo_tuner.tuner.services.parameter_changes import Changes
from mobo_tuner.tuner.services.steering import SteeringServices
from mobo_tuner.tuner.services.tune import TuneServer
from mobo_tuner.tuner.services.working_points import WorkingPoints
from mobo_tuner.tuner.session import Session
from mobo_tuner.tuner.status import Status
from mobo_tuner.tuner.topics import TunerPublishers

STOPPED = "the tuner was asked to stop"


class Tuner:
    """Puts the parts of the tuner together; nothing moves before someone asks for it."""

    exit_code = None

    def __init__(self, executor: Executor) -> None:
        """Declare the parameters and serve.

        Raises:
            UserError: If the parameters do not make up a problem and a method that suits it.
        """
        self.node = Node("tuner", automatically_declare_parameters_from_overrides=True)
        try:
            given = given_parameters(self.node)
            specs = tuner_specs(given)
            refuse_unknown(given, [*(spec.name for spec in specs), *SECTIONS])
            parameters = with_method(declare(self.node, specs))
            problem = ProblemParameters(self.node)
            method_of(parameters).check_problem(problem.problem)
        except UserError:
            self.node.destroy_node()
            raise
        publishers = TunerPublishers(self.node, problem.problem)
        self._parts = TunerParts(
            node=self.node,
            parameters=parameters,
            worker=Worker(executor, "optimizer"),
            machine=MachineClient(
                self.node,
                silence_timeout=parameters["machine_timeout"],
                evaluation_timeout=parameters["evaluation_timeout"],
            ),
            publishers=publishers,
            status=Status(self.node, publishers),
            heartbeat=Heartbeat(self.node, parameters["client_timeout"]),
            stopping=Future(executor=executor),
        )
        self._session = session = Session()
        changes = Changes(self._parts, problem, session.current)
        keeper = RunKeeper(self._parts, session)
        self._steering = SteeringServices(self._parts, session.current)
        self._working_points = WorkingPoints(self._parts, session, keeper)
        self._ask_tell = AskTell(self._parts, session, lambda: changes.problem)
        self._tune = TuneServer(self._parts, session, keeper, lambda: changes.problem)

    async def stop(self) -> None:
        """End what goes on, with what it has."""
        self._parts.stopping.set_result(STOPPED)
        if self._session.run is not None:
            self._session.run.stop(STOPPED)
        self._working_points.stop(STOPPED)
        await until(self.node, lambda: not self._session.occupied, timeout=STOP_TIMEOUT)
        self._ask_tell.close()

    def close(self) -> None:
        """Release the worker and the node."""
        self._parts.worker.shutdown()
        self.node.destroy_node()


def main() -> None:
    """Run the tuner node."""
    exit_process(run_node(Tuner))


if __name__ == "__main__":
    main()
