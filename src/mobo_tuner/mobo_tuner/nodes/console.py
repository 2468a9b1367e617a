"""The console: starts one run, shows how it goes, and ends with it."""

from __future__ import annotations

import sys
import time
from typing import Any

from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future

from mobo_msgs_py.action import Tune
from mobo_msgs_py.msg import Evaluation, ParetoFront, Problem, RecorderStatus, TunerStatus
from mobo_tuner.displays.console_view import make_view
from mobo_tuner.displays.progress import RunProgress
from mobo_tuner.nodes.parameters import CONSOLE
from mobo_tuner.ros.parameters import declare
from mobo_tuner.ros.process import exit_process, run_node
from mobo_tuner.ros.qos import LATCHED, STREAM
from mobo_tuner.ros.waiting import first_of, until
from mobo_tuner.runs.run_id import check_run_id, new_run_id

RECORDED_TOPICS = ("problem", "evaluation", "status", "pareto_front")
REFRESH_PERIOD = 0.2  # [s]
SILENCE_TIMEOUT = 5.0  # [s] without a status, which comes at 1 Hz, after which the tuner is lost
CANCEL_TIMEOUT = 1.5  # [s] for a canceled run to give its result; a node has 2 s to stop

EXIT_ERROR = 1
EXIT_CANCELED = 130


class ConsoleError(Exception):
    """The run failed; the message is one sentence for the user."""


class Console:
    """The client of one run.

    It ends of itself: with status 0 when the run met its budget or goal, 130 when it was canceled,
    and 1 after an error, which it names on standard error.
    """

    def __init__(self, executor: Executor) -> None:
        """Look for the tuner and the recorder; the goal goes out when both are ready.

        Raises:
            ValueError: a parameter is not allowed.
        """
        self.exit_code: int | None = None
        self.node = Node("console")
        parameters = declare(self.node, CONSOLE)
        run_id = str(parameters["run_id"])
        self._goal = Tune.Goal(
            run_id=check_run_id(run_id) if run_id else new_run_id("run"),
            evaluations=parameters["evaluations"],
            resume_from=parameters["resume_from"],
        )
        self._ready_timeout = float(parameters["ready_timeout"])
        self._wait_for_recorder = bool(parameters["wait_for_recorder"])
        self._interrupt: Future = Future(executor=executor)
        self._progress = RunProgress(self._goal.run_id, self._goal.evaluations)
        self._view = make_view(self._progress)
        self._recorder: RecorderStatus | None = None
        self._last_status = time.monotonic()
        self._heard = False  # of the tuner
        self._client = ActionClient(self.node, Tune, "tune")
        for topic, kind, callback, qos in (
            ("problem", Problem, self._progress.set_problem, LATCHED),
            ("pareto_front", ParetoFront, self._progress.set_front, LATCHED),
            ("status", TunerStatus, self._on_status, LATCHED),
            ("evaluation", Evaluation, self._on_evaluation, STREAM),
            ("recorder_status", RecorderStatus, self._on_recorder, LATCHED),
        ):
            self.node.create_subscription(kind, topic, callback, qos)
        self.node.create_timer(REFRESH_PERIOD, self._view.refresh)
        self._task = executor.create_task(self._run)

    async def stop(self) -> None:
        """Cancel the run and wait a moment for what it reached."""
        if not self._interrupt.done():
            self._interrupt.set_result(None)
        if not await until(self.node, self._task.done, timeout=CANCEL_TIMEOUT):
            self._conclude(f"canceled, but the tuner did not answer within {CANCEL_TIMEOUT:g} s")
            self.exit_code = EXIT_CANCELED

    def close(self) -> None:
        """Release the terminal and the node."""
        self._view.close()
        self.node.destroy_node()

    async def _run(self) -> None:
        """One run, from readiness to its end."""
        try:
            await self._ready()
            self.exit_code = EXIT_CANCELED if self._interrupt.done() else await self._tune()
        except Exception as error:
            known = isinstance(error, ConsoleError)
            self._view.close()
            print(str(error) if known else f"{type(error).__name__}: {error}", file=sys.stderr)
            self.exit_code = EXIT_ERROR

    async def _ready(self) -> None:
        """Wait for the tuner and the recorder.

        Raises:
            ConsoleError: one of them was not ready in time.
        """
        deadline = time.monotonic() + self._ready_timeout
        self._view.stage("waiting for the tuner")
        if not await self._holds(self._tuner_ready, deadline):
            raise ConsoleError(f"no tuner was found within {self._ready_timeout:g} s")
        if self._wait_for_recorder:
            self._view.stage("waiting for the recorder")
            if not await self._holds(self._recorder_ready, deadline):
                raise ConsoleError(self._recorder_trouble())
        self._view.stage("")

    async def _holds(self, condition: Any, deadline: float) -> bool:
        """Wait for a condition; an interrupt ends the wait as if it held."""
        timeout = max(deadline - time.monotonic(), 0.0)
        held = await until(self.node, condition, self._interrupt, timeout=timeout)
        return held or self._interrupt.done()

    def _tuner_ready(self) -> bool:
        """Whether a goal can be sent and its answer will come.

        The tuner drops its answer to a client that it has not discovered. It discovers this node's
        endpoints in the order in which they were made: once its status comes it knows the client.
        """
        return self._heard and self._client.server_is_ready()

    def _recorder_ready(self) -> bool:
        return (
            self._recorder is not None
            and self._recorder.recording
            and not self._unrecorded(self._recorder)
        )

    def _unrecorded(self, status: RecorderStatus) -> list[str]:
        names = [self.node.resolve_topic_name(topic) for topic in RECORDED_TOPICS]
        return [name for name in names if name not in status.topics]

    def _recorder_trouble(self) -> str:
        status = self._recorder
        if status is None:
            return f"no recorder was found within {self._ready_timeout:g} s"
        if not status.recording:
            return f"the recorder does not record: {status.message}"
        missing = ", ".join(self._unrecorded(status))
        return f"the recorder did not take up {missing} within {self._ready_timeout:g} s"

    async def _tune(self) -> int:
        """Send the goal and follow the run; return the exit status.

        Raises:
            ConsoleError: the run failed or the tuner is gone.
        """
        sent = self._client.send_goal_async(self._goal, feedback_callback=self._on_feedback)
        if await first_of(self.node, sent, timeout=self._ready_timeout) is None:
            raise ConsoleError(f"the tuner left the goal unanswered for {self._ready_timeout:g} s")
        handle: ClientGoalHandle = sent.result()
        if not handle.accepted:
            raise ConsoleError("the tuner refused the goal")
        self._progress.started = self._last_status = time.monotonic()
        finished = handle.get_result_async()
        while await first_of(self.node, finished, self._interrupt, timeout=REFRESH_PERIOD) is None:
            if time.monotonic() - self._last_status > SILENCE_TIMEOUT:
                raise ConsoleError(
                    f"the tuner has been silent for {SILENCE_TIMEOUT:g} s: it is gone"
                )
        if not finished.done():
            handle.cancel_goal_async()
        return self._judge((await finished).result)

    def _judge(self, result: Tune.Result) -> int:
        """Say how the run ended; return the exit status.

        Raises:
            ConsoleError: it ended with an error.
        """
        reached = (
            f"{result.evaluations} evaluations, hypervolume {result.pareto_front.hypervolume:.6g}, "
            f"{len(result.pareto_front.points)} on the Pareto front"
        )
        self._progress.set_front(result.pareto_front)
        if result.error_code == Tune.Result.NONE:
            self._conclude(f"run {result.run_id} is finished ({result.stop_reason}): {reached}")
            return 0
        if result.error_code == Tune.Result.CANCELED:
            # The reason says where the machine was left, too.
            self._conclude(f"{result.error_msg}\nrun {result.run_id} was canceled: {reached}")
            return EXIT_CANCELED
        if result.evaluations:
            self._conclude(f"run {result.run_id} broke off: {reached}")
        raise ConsoleError(result.error_msg)

    def _conclude(self, text: str) -> None:
        self._view.close()
        print(text, flush=True)

    def _on_status(self, status: TunerStatus) -> None:
        self._heard = True
        self._last_status = time.monotonic()
        self._progress.set_status(status)

    def _on_evaluation(self, evaluation: Evaluation) -> None:
        if self._progress.add(evaluation):
            self._view.evaluation(evaluation)

    def _on_feedback(self, feedback: Any) -> None:
        """The same evaluation on another way, should the topic not be matched in time."""
        self._progress.budget = feedback.feedback.budget
        self._on_evaluation(feedback.feedback.evaluation)

    def _on_recorder(self, status: RecorderStatus) -> None:
        self._recorder = status


def main() -> None:
    """Run the console until the run ends."""
    exit_process(run_node(Console))


if __name__ == "__main__":
    main()
