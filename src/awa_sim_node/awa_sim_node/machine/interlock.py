"""The interlock: lasting beam loss stops everything until somebody clears it."""

from __future__ import annotations

from dataclasses import dataclass

from awa_sim_node.machine.parameter import ParameterGroup, parameter


class InterlockError(RuntimeError):
    """The machine refuses to move because its interlock is raised."""


@dataclass(frozen=True)
class InterlockParameters(ParameterGroup):
    """When the interlock is raised."""

    shots: int = parameter(
        "shots with beam loss in a row that raise the interlock; 0 = none do", 0, 1_000_000
    )


class Interlock:
    """Counts shots with beam loss, and stays raised once there were too many in a row."""

    def __init__(self, parameters: InterlockParameters) -> None:
        """Start with the interlock cleared."""
        self._limit = parameters.shots
        self._lossy = 0
        self._reason = ""

    @property
    def raised(self) -> bool:
        """Whether the machine refuses to move."""
        return bool(self._reason)

    @property
    def reason(self) -> str:
        """Why it is raised, in one sentence; empty where it is not."""
        return self._reason

    def see(self, lost: bool) -> None:
        """Take note of one shot."""
        self._lossy = self._lossy + 1 if lost else 0
        if self._limit and self._lossy >= self._limit and not self.raised:
            self._reason = (
                f"the interlock is raised: {self._lossy} shots in a row lost beam; clear it before "
                "the machine moves again"
            )

    def clear(self) -> None:
        """Allow the machine to move again, and count from zero."""
        self._lossy = 0
        self._reason = ""

    def check(self) -> None:
        """Raise InterlockError if the interlock is raised."""
        if self.raised:
            raise InterlockError(self._reason)
