"""The optimiser without a machine: for simulations, in the loops of other programs."""

from mobo_tuner.offline.generator import MoboGenerator

__all__ = ["MoboGenerator"]
