"""Parameters of the simulated machine's node."""

from awa_sim_node.machine import Mode, behaviour_of
from awa_sim_node.machine.models import MODEL_NAMES
from mobo_tuner.parameter_spec import AUTOSTART, ParameterSpec

AWA_SIM = (
    ParameterSpec(
        "model",
        "awa",
        "machine to simulate: the AWA injector, or the paper's toy problem",
        choices=tuple(MODEL_NAMES),
    ),
    ParameterSpec(
        "mode",
        "nominal",
        "defaults of the behaviour parameters (docs/behaviour.md): no randomness and no faults, a "
        "good day, or a bad day",
        choices=tuple(str(mode) for mode in Mode),
    ),
    ParameterSpec(
        "speed",
        100.0,
        "simulated seconds per second of wall time",
        minimum=1e-3,
        maximum=1e6,
    ),
    ParameterSpec("seed", 0, "seed of the random number generators", minimum=0, maximum=2**31 - 1),
    AUTOSTART,
    ParameterSpec(
        "stream_rate",
        5.0,
        "rate of the published readbacks, and highest rate of shots between evaluations [Hz]",
        minimum=0.1,
        maximum=1000.0,
    ),
    ParameterSpec(
        "publish_clock", False, "publish simulated time on /clock, for nodes with use_sim_time"
    ),
    ParameterSpec("publish_truth", False, "publish the true values on `truth`, for tests"),
)
"""Parameters of the node `awa_sim`, without those of the machine's behaviour."""


def behaviour_specs(model: str, mode: str) -> tuple[ParameterSpec, ...]:
    """Return the parameters of a machine's behaviour, with the mode's values as defaults.

    Args:
        model: Name of the machine's model.
        mode: Name of the mode.

    Raises:
        ValueError: If there is no such model or mode.
    """
    behaviour = behaviour_of(model, Mode(mode))
    return tuple(
        ParameterSpec(name, value, info.meaning, minimum=info.minimum, maximum=info.maximum)
        for (name, value), info in zip(
            behaviour.values.items(), behaviour.infos.values(), strict=True
        )
    )
