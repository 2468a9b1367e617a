"""Health of the simulated machine's own parts, for `/diagnostics`."""

from __future__ import annotations

from awa_sim_node.machine import SimulatedMachine
from mobo_tuner.ros.diagnostics import OK, STALE, WARN, Health

_NO_MACHINE = Health(STALE, "no machine is connected")


def beam_health(machine: SimulatedMachine | None) -> Health:
    """Return whether there is beam."""
    if machine is None:
        return _NO_MACHINE
    values = {"trips": machine.trips, "mode": machine.mode, "interlock": bool(machine.interlock)}
    if machine.tripped:
        return Health(WARN, "the gun has tripped; there is no beam", values)
    return Health(OK, "beam is there", values)


def actuators_health(machine: SimulatedMachine | None, seconds: float, trouble: str = "") -> Health:
    """Return whether the actuators move, and where they are and should be.

    Args:
        machine: Machine that is connected; None if there is none.
        seconds: Simulated time since the node was started [s].
        trouble: Why that time stands still; empty if it does not.
    """
    if machine is None:
        return _NO_MACHINE
    setpoint, readbacks = machine.setpoint, machine.readbacks()
    values = {name: f"{readbacks[name]:g} (set {setpoint[name]:g})" for name in setpoint}
    values["simulated time [s]"] = f"{seconds:.1f}"
    if trouble:
        return Health(WARN, trouble, values)
    return Health(OK, "settled" if machine.settled else "moving", values)
