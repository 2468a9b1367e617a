"""The simulated machine, without ROS: actuators, diagnostics and the physics model."""

from awa_sim_node.machine.beam import Shot, ShotStatus
from awa_sim_node.machine.behaviour import Behaviour, Mode
from awa_sim_node.machine.description import Diagnostic, ModelDescription, Variable
from awa_sim_node.machine.diagnostics import Reading
from awa_sim_node.machine.evaluation import (
    Cause,
    Evaluation,
    EvaluationFailure,
    EvaluationResult,
    Phase,
)
from awa_sim_node.machine.interlock import InterlockError
from awa_sim_node.machine.machine import MAX_SHOTS, SimulatedMachine
from awa_sim_node.machine.models import MODEL_NAMES, Model, behaviour_of, describe

__all__ = [
    "MAX_SHOTS",
    "MODEL_NAMES",
    "Behaviour",
    "Cause",
    "Diagnostic",
    "Evaluation",
    "EvaluationFailure",
    "EvaluationResult",
    "InterlockError",
    "Mode",
    "Model",
    "ModelDescription",
    "Phase",
    "Reading",
    "Shot",
    "ShotStatus",
    "SimulatedMachine",
    "Variable",
    "behaviour_of",
    "describe",
]
