"""Health of a machine and its node, for `/diagnostics`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from rclpy.node import Node

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.machine.backend import Failure, MachineBackend
from mobo_tuner.machine.server import MachineServer
from mobo_tuner.ros.diagnostics import ERROR, OK, STALE, WARN, Health, Publishers

_Result = EvaluateSetpoint.Result
_LEVELS = {_Result.INTERLOCK: ERROR, _Result.MACHINE_LOST: STALE, _Result.NOT_ACTIVE: WARN}


def machine_parts(
    node: Node, backend: MachineBackend, server: MachineServer
) -> Mapping[str, Callable[[], Health]]:
    """Return the parts of a machine's node: the machine, its variables and those of its backend."""
    tuners = Publishers(node, server.heartbeat_name)
    machines = Publishers(node, server.evaluations_name)

    def machine() -> Health:
        return _machine_health(backend, server, len(tuners.names()), len(machines.others()))

    def variables() -> Health:
        return _variables_health(backend)

    return {"machine": machine, "variables": variables, **backend.parts()}


def _machine_health(
    backend: MachineBackend, server: MachineServer, tuners: int, rivals: int
) -> Health:
    """Return whether the machine may move, how its last evaluation ended, and whether it is served twice.

    Args:
        backend: Machine.
        server: Its server.
        tuners: Number of tuners that send a heartbeat to it.
        rivals: Number of other nodes that serve a machine under the same names.
    """
    values = {
        "evaluations": server.evaluations,
        "failed evaluations": server.failures,
        "last failure": server.last_failure.message if server.last_failure else "none",
        "doing": server.phase or "nothing",
    }
    refusal = None if server.busy else backend.refusal()
    if backend.inactive:
        refusal = Failure(_Result.NOT_ACTIVE, backend.inactive)
    if refusal is not None and refusal.code in _LEVELS:
        return Health(_LEVELS[refusal.code], refusal.message, values)
    if rivals > 0:
        text = f"{rivals} more serve {server.describe_name}; a tuner needs exactly one machine"
        return Health(WARN, text, values)
    if tuners > 1:
        text = f"{tuners} tuners send {server.heartbeat_name}; a machine serves one at a time"
        return Health(WARN, text, values)
    if server.last_failed and server.last_failure is not None:
        text = f"the last evaluation failed: {server.last_failure.message}"
        return Health(WARN, text, values)
    return Health(OK, server.phase or "ready", values)


def _variables_health(backend: MachineBackend) -> Health:
    """Return where each variable is."""
    values, unknown = {}, []
    for readback in backend.readbacks():
        known = math.isfinite(readback.value)
        values[readback.name] = (
            f"{readback.value:g} {readback.unit}".strip() if known else "unknown"
        )
        if not known:
            unknown.append(readback.name)
    if unknown:
        return Health(STALE, f"the readback is unknown of {', '.join(unknown)}", values)
    return Health(OK, f"readbacks known: {len(values)}", values)
