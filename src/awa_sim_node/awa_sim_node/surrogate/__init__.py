"""A neural network that models an AWA-like injector. It is not the paper's surrogate."""

from awa_sim_node.surrogate.predictor import Surrogate, predict

__all__ = ["Surrogate", "predict"]
