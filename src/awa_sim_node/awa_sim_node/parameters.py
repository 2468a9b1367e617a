"""Parameters of the simulated machine's node."""

from awa_sim_node.machine import Mode, behaviour_of
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
        "how well it behaves: without chance and faults, as on a good day, or as on a bad one; "
        "the default of every parameter of its behaviour, which docs/behaviour.md lists",
        choices=tuple(str(mode) for mode in Mode),
    ),
    ParameterSpec(
        "speed",
        100.0,
        "simulated seconds per second of wall time",
        minimum=1e-3,
        maximum=1e6,
    ),
    ParameterSpec("seed", 0, "of all chance", minimum=0, maximum=2**31 - 1),
    ParameterSpec("autostart", True, "configure and activate at the start, without being told to"),
    ParameterSpec(
        "stream_rate",
        5.0,
        "how often readbacks are published, and at most shots between evaluations [Hz]",
        minimum=0.1,
        maximum=1000.0,
    ),
    ParameterSpec(
        "publish_clock", False, "publish simulated time on /clock, for nodes with use_sim_time"
    ),
    ParameterSpec("publish_truth", False, "publish the true values on `truth`, for tests"),
)
"""Of the node `awa_sim`, besides those of the machine's behaviour."""


def behaviour_specs(model: str, mode: str) -> tuple[ParameterSpec, ...]:
    """The parameters of a machine's behaviour, with the mode's values as defaults.

    Raises:
        ValueError: there is no such model or mode.
    """
    behaviour = behaviour_of(model, Mode(mode))
    return tuple(
        ParameterSpec(name, value, info.meaning, minimum=info.minimum, maximum=info.maximum)
        for (name, value), info in zip(
            behaviour.values.items(), behaviour.infos.values(), strict=True
        )
    )
