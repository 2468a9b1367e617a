"""A tuner that only pretends: the real action and topics, evaluations out of thin air."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from mobo_msgs_py.action import Tune
from mobo_msgs_py.msg import (
    Evaluation,
    NamedValue,
    Objective,
    ParetoFront,
    ParetoPoint,
    Problem,
    TunerStatus,
)
from mobo_tuner.ros.qos import KEPT, LATCHED
from mobo_tuner.ros.waiting import first_of


@dataclass
class Behaviour:
    """What the double does with a goal.

    It stops after `fail_after` evaluations with an error, falls silent after `silent_after`, and
    publishes evaluations on the topic, in the feedback, or both. After a cancel the machine is on
    its way for `return_seconds`, unless `skip` stops it.
    """

    seconds: float = 0.05  # per evaluation
    accepts: bool = True
    fail_after: int = -1
    silent_after: int = -1
    heeds_cancel: bool = True
    return_seconds: float = 0.0
    publishes_topic: bool = True
    publishes_feedback: bool = True


class TunerDouble:
    """Serves the `tune` action on a node that the test spins."""

    def __init__(self, node: Node, behaviour: Behaviour) -> None:
        self._node = node
        self._behaviour = behaviour
        self.goals: list[Tune.Goal] = []
        self.cancels = 0
        self.skips = 0
        self._status = TunerStatus()
        self._silent = False
        self._problem = node.create_publisher(Problem, "problem", LATCHED)
        self._evaluation = node.create_publisher(Evaluation, "evaluation", KEPT)
        self._status_publisher = node.create_publisher(TunerStatus, "status", LATCHED)
        self._front = node.create_publisher(ParetoFront, "pareto_front", LATCHED)
        node.create_timer(1.0, self.publish_status)
        self._skip: Future = Future(executor=node.executor)
        self._service = node.create_service(Trigger, "skip", self._on_skip)
        self._server = ActionServer(
            node,
            Tune,
            "tune",
            execute_callback=self._execute,
            goal_callback=lambda _: (
                GoalResponse.ACCEPT if behaviour.accepts else GoalResponse.REJECT
            ),
            cancel_callback=self._cancel,
            result_timeout=10,
        )

    def publish_status(self) -> None:
        """Publish the status, unless the double has fallen silent."""
        if not self._silent:
            self._status_publisher.publish(self._status)

    def close(self) -> None:
        """Take the action away; the node takes the rest."""
        self._server.destroy()
        self._node.destroy_service(self._service)

    def _on_skip(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.skips += 1
        self._skip.set_result(None)
        response.success = True
        return response

    def _cancel(self, _: ServerGoalHandle) -> CancelResponse:
        self.cancels += 1
        return CancelResponse.ACCEPT

    async def _execute(self, goal_handle: ServerGoalHandle) -> Tune.Result:
        goal = goal_handle.request
        self.goals.append(goal)
        behaviour = self._behaviour
        budget = goal.evaluations or 4
        self._status = TunerStatus(
            state=TunerStatus.EVALUATING,
            run_id=goal.run_id,
            budget=budget,
            phase="settling",
            fraction=0.4,
        )
        self.publish_status()
        objectives = [
            Objective(name="eps_x", unit="mm mrad", reference=40.0),
            Objective(name="yield", direction=Objective.MAXIMIZE, reference=0.0),
        ]
        self._problem.publish(Problem(run_id=goal.run_id, objectives=objectives))
        result = Tune.Result(run_id=goal.run_id, stop_reason="budget")
        result.pareto_front.run_id = goal.run_id
        for index in range(budget):
            if behaviour.fail_after == index:
                result.stop_reason = "error"
                result.error_code = Tune.Result.MACHINE_LOST
                result.error_msg = "the machine is gone"
                break
            self._silent = self._silent or behaviour.silent_after == index
            never: Future = Future(executor=self._node.executor)
            await first_of(self._node, never, timeout=3600.0 if self._silent else behaviour.seconds)
            if goal_handle.is_cancel_requested and behaviour.heeds_cancel:
                await self._return(behaviour.return_seconds)
                result.stop_reason = "canceled"
                result.error_code = Tune.Result.CANCELED
                result.error_msg = "the run was stopped: a client canceled it"
                break
            evaluation = make_evaluation(goal.run_id, index)
            if behaviour.publishes_topic:
                self._evaluation.publish(evaluation)
            if behaviour.publishes_feedback:
                goal_handle.publish_feedback(
                    Tune.Feedback(evaluation=evaluation, evaluations=index + 1, budget=budget)
                )
            result.evaluations = index + 1
            result.pareto_front.points.append(ParetoPoint(index=index))
            result.pareto_front.hypervolume = evaluation.hypervolume
        if result.error_code == Tune.Result.NONE:
            goal_handle.succeed()
        elif result.error_code == Tune.Result.CANCELED:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return result

    async def _return(self, duration: float) -> None:
        """Move the machine after a cancel."""
        if duration == 0.0:
            return
        self._status.state, self._status.phase = TunerStatus.MOVING, "ramping"
        self.publish_status()
        await first_of(self._node, self._skip, timeout=duration)


def make_evaluation(run_id: str, index: int) -> Evaluation:
    """Evaluation 1 fails, evaluation 2 is infeasible, the others get better and better."""
    valid = index != 1
    value = 30.0 - index if valid else math.nan
    measured = [
        NamedValue(name="eps_x", value=value, stddev=0.25, unit="mm mrad"),
        NamedValue(name="yield", value=0.5 + 0.01 * index, stddev=math.nan),
    ]
    return Evaluation(
        run_id=run_id,
        index=index,
        diagnostics=measured,
        objectives=measured,
        valid=valid,
        feasible=valid and index != 2,
        hypervolume=100.0 + index,
        error_msg="" if valid else "the beam was lost",
        suggest_seconds=0.25,
    )
