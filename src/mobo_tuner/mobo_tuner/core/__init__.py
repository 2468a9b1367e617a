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
    # The optimiser takes a second to import; who only checks a problem need not wait for it.
    if name == "Optimizer":
        from mobo_tuner.core.optimizer import Optimizer

        return Optimizer
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
