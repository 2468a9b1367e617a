"""The simulated machine, without ROS: actuators, diagnostics, and the physics behind them."""

from awa_sim_node.machine.description import Diagnostic, MachineDescription, Variable
from awa_sim_node.machine.diagnostics import Reading
from awa_sim_node.machine.evaluation import Evaluation, EvaluationResult, Phase
from awa_sim_node.machine.machine import MAX_SHOTS, Mode, SimulatedMachine
from awa_sim_node.machine.models import MODEL_NAMES, Model, describe

__all__ = [
    "MAX_SHOTS",
    "MODEL_NAMES",
    "Diagnostic",
    "Evaluation",
    "EvaluationResult",
    "MachineDescription",
    "Mode",
    "Model",
    "Phase",
    "Reading",
    "SimulatedMachine",
    "Variable",
    "describe",
]
