"""A neural network that models an AWA-like injector. It is not the paper's surrogate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from awa_sim_node.surrogate.predictor import Surrogate

__all__ = ["Surrogate"]


def __getattr__(name: str) -> Any:
    """Import ``Surrogate`` on first use: it imports torch, which the metadata do not need."""
    if name == "Surrogate":
        from awa_sim_node.surrogate.predictor import Surrogate

        return Surrogate
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
