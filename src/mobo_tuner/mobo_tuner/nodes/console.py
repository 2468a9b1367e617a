"""The console: it starts one run, shows its progress, and ends with it."""

from __future__ import annotations

import contextlib
import sys
import threading
import time

from rclpy.executors import Executor
from rclpy.node import Node

from mobo_msgs_py.msg import RecorderStatus
from mobo_tuner.client import ErrorCode, RunResult, TunerClient, TunerError
from mobo_tuner.displays.console_view import make_view
from mobo_tuner.errors import UserError
from mobo_tuner.nodes.parameters import CONSOLE
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.parameters import declare, refuse_undeclared, take_given
from mobo_tuner.ros.process import Program, exit_process, run_node
from mobo_tuner.ros.waiting import until
from mobo_tuner.runs.run_id import check_run_id, new_run_id
from mobo_tuner.wording import counted

RECORDED_TOPICS = ("problem", "run_records", "evaluation", "status", "pareto_front")
POLL_PERIOD = 0.05  # [s]
CANCEL_TIMEOUT = 1.5  # [s] for a canceled run to give its result; a node has 2 s to stop

EXIT_ERROR = 1
EXIT_CANCELED = 130
PROGRAM = Program("console", "Starts one run of the tuner, shows it, and ends with it.", CONSOLE)


class Console:
    """The client of one run.

    Its exit status is 0 if the run reached its budget or goal, 130 if it was canceled, and 1 after an
    error, which it prints on standard error. A thread follows the run, and this node's executor serves
    that thread.
    """

    def __init__(self, executor: Executor) -> None:
        """Start waiting for the tuner and the recorder; the goal is sent when both are ready.

        Raises:
            ValueError: If a parameter is not allowed.
        """
        self.exit_code: int | None = None
        self.node = Node("console", automatically_declare_parameters_from_overrides=True)
        given = take_given(self.node)
        self._executor = executor
        parameters = declare(self.node, CONSOLE)
        refuse_undeclared(self.node, given)
        run_id = str(parameters["run_id"])
        self._run_id = check_run_id(run_id) if run_id else new_run_id("run")
        self._evaluations = int(parameters["evaluations"])
        self._resume_from = str(parameters["resume_from"])
        self._ready_timeout = float(parameters["ready_timeout"])
        self._wait_for_recorder = bool(parameters["wait_for_recorder"])
        self._recorder: RecorderStatus | None = None
        self._interrupted = False
        self._client = TunerClient(node=self.node, executor=executor, timeout=self._ready_timeout)
        self._view = make_view(self._run_id, self._evaluations)
        interfaces.RECORDER_STATUS.subscription(self.node, self._on_recorder)
        threading.Thread(target=self._run, name="run", daemon=True).start()

    def interrupt(self) -> None:
        """Cancel the run, and wait for the machine if it then moves to its fallback."""
        self._interrupted = True
        self._client.cancel()
        self._executor.create_task(self._await_fallback)

    async def stop(self) -> None:
        """Cancel the run and wait briefly for its result; the machine does not move to its fallback."""
        if self.exit_code is not None:
            return
        self._interrupted = True
        self._client.cancel()
        if self._is_moving:
            threading.Thread(target=self._stop_fallback, name="stop", daemon=True).start()
        if not await self._ends_soon():
            self._give_up()

    async def _await_fallback(self) -> None:
        """Wait for the end of a canceled run, and of the move that may follow."""
        hint = "press Ctrl-C again to stop the machine where it is"
        while not await self._ends_soon():
            if not self._is_moving:
                self._give_up()
                return
            if hint:
                self._view.hint(hint)
                hint = ""

    async def _ends_soon(self) -> bool:
        return await until(self.node, lambda: self.exit_code is not None, timeout=CANCEL_TIMEOUT)

    def _give_up(self) -> None:
        self._conclude(f"canceled, but the tuner did not answer within {CANCEL_TIMEOUT:g} s")
        self.exit_code = EXIT_CANCELED

    @property
    def _is_moving(self) -> bool:
        """Whether the tuner moves the machine, as it does after a cancel."""
        return self._view.progress.status.state == "moving"

    def _stop_fallback(self) -> None:
        """Stop the machine where it is."""
        with contextlib.suppress(TunerError):
            self._client.skip()

    def close(self) -> None:
        """Release the terminal and the node."""
        self._view.close()
        self.node.destroy_node()

    def _run(self) -> None:
        """Carry out the run from readiness to its end."""
        try:
            self.exit_code = self._judge(self._tune())
        except Exception as error:
            self._view.close()
            if isinstance(error, TunerError) and error.code == ErrorCode.CANCELED:
                self.exit_code = EXIT_CANCELED
                return
            known = isinstance(error, UserError)
            print(str(error) if known else f"{type(error).__name__}: {error}", file=sys.stderr)
            self.exit_code = EXIT_ERROR

    def _tune(self) -> RunResult:
        deadline = time.monotonic() + self._ready_timeout
        self._view.stage("waiting for the tuner")
        self._client.connect()
        if self._wait_for_recorder:
            self._view.stage("waiting for the recorder")
            while self._recorder_trouble():
                if self._interrupted:
                    raise TunerError(ErrorCode.CANCELED, "it was canceled before it began")
                if time.monotonic() > deadline:
                    raise UserError(self._recorder_trouble())
                time.sleep(POLL_PERIOD)
        self._view.stage("")
        return self._client.tune(
            run_id=self._run_id,
            evaluations=self._evaluations,
            resume_from=self._resume_from,
            **self._view.callbacks,
        )

    def _recorder_trouble(self) -> str:
        """Return the reason why the recorder would not record the run; empty if it would."""
        status = self._recorder
        if status is None:
            return f"no recorder was found within {self._ready_timeout:g} s"
        if not status.recording:
            return f"the recorder does not record: {status.message}"
        names = [self.node.resolve_topic_name(topic) for topic in RECORDED_TOPICS]
        missing = ", ".join(name for name in names if name not in status.topics)
        if missing:
            return f"the recorder did not take up {missing} within {self._ready_timeout:g} s"
        return ""

    def _judge(self, result: RunResult) -> int:
        """Print how the run ended; return the exit status.

        Raises:
            TunerError: If it ended with an error.
        """
        reached = (
            f"{counted(result.evaluations, 'evaluation')}, hypervolume {result.front.hypervolume:.6g}, "
            f"{len(result.front.points)} on the Pareto front"
        )
        self._view.front(result.front)
        if result.error is None:
            self._conclude(f"run {result.run_id} is finished ({result.stop_reason}): {reached}")
            return 0
        if result.error.code == ErrorCode.CANCELED:
            # The reason also says where the machine was left.
            self._conclude(f"{result.error}\nrun {result.run_id} was canceled: {reached}")
            return EXIT_CANCELED
        if result.evaluations:
            self._conclude(f"run {result.run_id} ended with an error: {reached}")
        raise result.error

    def _conclude(self, text: str) -> None:
        self._view.close()
        with contextlib.suppress(OSError):  # the terminal may be closed
            print(text, flush=True)

    def _on_recorder(self, status: RecorderStatus) -> None:
        self._recorder = status


def main() -> None:
    """Run the console until the run ends."""
    exit_process(run_node(Console, PROGRAM, on_interrupt=Console.interrupt))


if __name__ == "__main__":
    main()
