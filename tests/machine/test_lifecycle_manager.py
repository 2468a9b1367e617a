"""Machines' nodes under a manager that speaks the protocol of `nav2_lifecycle_manager`, without bonds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node

from tests.support.processes import NodeStarter
from tests.support.simulator import Services
from tests.support.tuner import CONFIG

# Where each transition leads.
STATES = {
    Transition.TRANSITION_CONFIGURE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_ACTIVATE: State.PRIMARY_STATE_ACTIVE,
    Transition.TRANSITION_DEACTIVATE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_CLEANUP: State.PRIMARY_STATE_UNCONFIGURED,
    Transition.TRANSITION_UNCONFIGURED_SHUTDOWN: State.PRIMARY_STATE_FINALIZED,
}


class Manager:
    """Brings all its nodes through one transition after the other, in order, or in reverse order down."""

    def __init__(self, services: Services, names: Sequence[str]) -> None:
        self._services = services
        self._names = names

    def startup(self) -> None:
        self._all(Transition.TRANSITION_CONFIGURE)
        self._all(Transition.TRANSITION_ACTIVATE)

    def pause(self) -> None:
        self._all(Transition.TRANSITION_DEACTIVATE, reverse=True)

    def resume(self) -> None:
        self._all(Transition.TRANSITION_ACTIVATE)

    def reset(self) -> None:
        self._all(Transition.TRANSITION_DEACTIVATE, reverse=True)
        self._all(Transition.TRANSITION_CLEANUP, reverse=True)

    def shutdown(self) -> None:
        self.reset()
        self._all(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, reverse=True)

    def states(self) -> set[int]:
        return {self._state(name) for name in self._names}

    def _all(self, transition: int, reverse: bool = False) -> None:
        for name in reversed(self._names) if reverse else self._names:
            request = ChangeState.Request(transition=Transition(id=transition))
            assert self._services.call(ChangeState, f"{name}/change_state", request).success, name
            assert self._state(name) == STATES[transition], name

    def _state(self, name: str) -> int:
        return int(self._services.call(GetState, f"{name}/get_state").current_state.id)


def test_a_lifecycle_manager_starts_pauses_resets_and_shuts_down_machines(
    start_node: NodeStarter, node: Node, spin_until: Callable[..., None]
) -> None:
    toy = ["--ros-args", "--params-file", str(CONFIG / "toy.yaml"), "-p", "autostart:=false"]
    mapping = ["--ros-args", "-p", f"mapping:={CONFIG / 'bridge_foreign.yaml'}"]
    elsewhere = ["-r", "__ns:=/bridge"]  # two machines of one namespace would be one too many
    start_node("-m", "awa_sim_node.node", *toy)
    bridge = ["mobo_tuner.nodes.machine_bridge", *mapping, *elsewhere, "-p", "autostart:=false"]
    start_node("-m", *bridge)
    manager = Manager(Services(node, spin_until), ("awa_sim", "bridge/machine_bridge"))
    assert manager.states() == {State.PRIMARY_STATE_UNCONFIGURED}
    manager.startup()
    manager.pause()
    manager.resume()
    manager.reset()
    manager.startup()
    manager.shutdown()
