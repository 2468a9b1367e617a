"""The interlock: persistent beam loss stops the machine until the interlock is cleared."""

from __future__ import annotations

from dataclasses import dataclass

from awa_sim_node.machine.parameter import ParameterGroup, parameter


class InterlockError(RuntimeError):
    """The machine refuses to move because its interlock is raised."""


@dataclass(frozen=True)
class InterlockParameters(ParameterGroup):
    """Parameters of the interlock."""

    shots: int = parameter(
        "number of consecutive shots with beam loss that raises the interlock; 0 = never",
        0,
        1_000_000,
    )


class Interlock:
    """An interlock that too many consecutive shots with beam loss raise, until it is cleared."""

    def __init__(self, parameters: InterlockParameters) -> None:
        """Start with the interlock cleared.

        Args:
            parameters: Parameters of the interlock.
        """
        self._limit = parameters.shots
        self._lossy = 0
        self._reason = ""

    @property
    def raised(self) -> bool:
        """Whether the machine refuses to move."""
        return bool(self._reason)

    @property
    def reason(self) -> str:
        """Reason why the interlock is raised, in one sentence; empty if it is not."""
        return self._reason

    def see(self, lost: bool) -> None:
        """Count one shot.

        Args:
            lost: Whether the shot lost beam.
        """
        self._lossy = self._lossy + 1 if lost else 0
        if self._limit and self._lossy >= self._limit and not self.raised:
            self._reason = (
                f"the interlock is raised: {self._lossy} consecutive shots lost beam; clear the "
                "interlock to move the machine again"
            )

    def clear(self) -> None:
        """Allow motion again and restart the count at zero."""
        self._lossy = 0
        self._reason = ""

    def check(self) -> None:
        """Check that the machine may move.

        Raises:
            InterlockError: If the interlock is raised.
        """
        if self.raised:
            raise InterlockError(self._reason)
