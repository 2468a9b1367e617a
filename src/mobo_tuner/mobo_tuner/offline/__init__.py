"""The optimiser without a machine: for simulations, in the loops of other programs."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mobo_tuner.offline.generator import MoboGenerator

__all__ = ["MoboGenerator"]


def __getattr__(name: str) -> object:
    # The check of a parameter file needs the parameters alone, without gest-api.
    if name == "MoboGenerator":
        from mobo_tuner.offline.generator import MoboGenerator

        return MoboGenerator
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
