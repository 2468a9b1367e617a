"""The optimiser: numpy and numba, no ROS.

Everything inside works on set-points scaled to ``[-1, 1]`` and on minimised objectives; the
:class:`Problem` translates from and to physical units.
"""

from typing import TYPE_CHECKING

from mobo_tuner.core.problem import Problem, ProblemError

if TYPE_CHECKING:
    from mobo_tuner.core.optimizer import Optimizer

__all__ = ["Optimizer", "Problem", "ProblemError"]


def __getattr__(name: str) -> object:
    # Importing the optimiser takes a second, which a check of a problem does not need.
    if name == "Optimizer":
        from mobo_tuner.core.optimizer import Optimizer

        return Optimizer
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
