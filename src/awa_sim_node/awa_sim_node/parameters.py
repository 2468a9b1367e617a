"""Parameters of the simulated machine's node."""

from awa_sim_node.machine import Mode
from awa_sim_node.machine.models import MODEL_NAMES
from mobo_tuner.ros.parameters import ParameterSpec

AWA_SIM = (
    ParameterSpec(
        "model",
        "awa",
        "which machine is simulated: the AWA injector, or the paper's toy problem",
        choices=tuple(MODEL_NAMES),
    ),
    ParameterSpec(
        "mode",
        "nominal",
        "how well it behaves: without noise, or as on a good day",
        choices=tuple(str(mode) for mode in Mode),
    ),
    ParameterSpec(
        "speed",
        100.0,
        "simulated seconds per second of wall time",
        minimum=1e-3,
        maximum=1e6,
    ),
    ParameterSpec("seed", 0, "of all noise", minimum=0, maximum=2**31 - 1),
)
"""Of the node `awa_sim`."""
