"""Health of the tuner for `/diagnostics`, and whether another tuner disturbs it."""

from __future__ import annotations

from mobo_msgs_py.msg import TunerStatus
from mobo_tuner.ros.diagnostics import (
    ERROR,
    OK,
    PERIOD,
    STALE,
    WARN,
    Diagnostics,
    Health,
    Publishers,
)
from mobo_tuner.ros.waiting import STEADY_CLOCK
from mobo_tuner.runs.records import StopReason
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.recording import Recording
from mobo_tuner.tuner.session import Session
from mobo_tuner.wording import counted

_STATES = {
    getattr(TunerStatus, name): name.lower()
    for name in ("IDLE", "WAITING", "SUGGESTING", "EVALUATING", "CANCELING", "PAUSED", "MOVING")
}


class TunerHealth:
    """Publishes how the run and the connection to the machine are.

    A second tuner of the same namespace or for the same machine is named on `/diagnostics`, once in
    the log, and in the status of an idle tuner. The other tuner says the same of this one.

    Args:
        context: The tuner's node and what works in it.
        session: Session that knows the active run.
        recording: Whether runs are recorded.
    """

    def __init__(self, context: TunerContext, session: Session, recording: Recording) -> None:
        self._context = context
        self._session = session
        self._recording = recording
        self._topics = {name: Publishers(context.node, name) for name in ("heartbeat", "status")}
        self._rival = ""  # sentence about other tuners; empty if there is none
        parts = {"run": self._run, "machine": self._machine}
        self._diagnostics = Diagnostics(context.node, "", parts)
        self._timer = context.node.create_timer(PERIOD, self._look_around, clock=STEADY_CLOCK)

    def _look_around(self) -> None:
        """Look for other tuners."""
        node = self._context.node
        found = {topic: publishers.others() for topic, publishers in self._topics.items()}
        names = sorted({name for others in found.values() for name in others})
        rival = ""
        if names:
            paths = " and ".join(
                node.resolve_topic_name(t) for t, others in found.items() if others
            )
            who = (
                f"another tuner, {names[0]}, also publishes"
                if len(names) == 1
                else f"other tuners, {', '.join(names)}, also publish"
            )
            rival = f"{who} {paths}; let only one of them run"
        before, self._rival = self._rival, rival
        if rival and rival != before:
            self._context.log.warning(rival)
        status = self._context.status
        said = status.message.message
        if status.message.state == TunerStatus.IDLE and said != rival and said in ("", before):
            status.set(message=rival)

    def _run(self) -> Health:
        status, run = self._context.status.message, self._session.run
        folder = self._context.parameters.run_dir("")
        values = {
            "state": _STATES[status.state],
            "run": status.run_id or "none",
            "evaluations": f"{status.evaluations} of {status.budget}",
            "feasible": status.feasible,
            "failed": status.failed,
            "hypervolume": f"{status.hypervolume:.6g}",
            "runs are kept in": folder.absolute() if folder else "nothing",
            "recorder": status.recorder or "none",
            "free disk space [GB]": f"{status.free_space / 1e9:.1f}",
        }
        if run is None and status.stop_reason == StopReason.ERROR:
            return Health(ERROR, f"the last run ended with an error: {status.message}", values)
        if self._rival:
            return Health(WARN, self._rival, values)
        if run is not None and (trouble := run.log.trouble or self._recording.trouble):
            return Health(WARN, trouble, values)
        if status.state == TunerStatus.WAITING and status.message:
            return Health(WARN, status.message, values)
        if run is not None and run.consecutive_failures:
            text = f"the last {counted(run.consecutive_failures, 'evaluation')} failed"
            return Health(WARN, text, values)
        return Health(OK, status.message or _STATES[status.state], values)

    def _machine(self) -> Health:
        gate = self._context.gate
        values = {"evaluate_setpoint": gate.action_name}
        if gate.is_open:
            return Health(OK, "a machine serves the tuner", values)
        return Health(STALE, f"no machine serves {gate.action_name}", values)
