"""A lifecycle node outlives a transition that its state does not allow."""

from __future__ import annotations

from collections.abc import Callable

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node

from mobo_tuner.ros.lifecycle import refuse_unknown_transitions


def test_a_transition_that_is_not_possible_is_answered_and_the_node_lives(
    node: Node, executor: SingleThreadedExecutor, spin_until: Callable[..., None]
) -> None:
    alive = LifecycleNode("alive", context=node.context)
    refuse_unknown_transitions(alive)
    executor.add_node(alive)
    client = node.create_client(ChangeState, "alive/change_state")
    spin_until(client.service_is_ready, "the service")

    def change(number: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=number))
        answer = client.call_async(request)
        spin_until(answer.done, "the answer")
        return bool(answer.result().success)

    assert not change(Transition.TRANSITION_ACTIVATE)
    assert not change(77)
    assert change(Transition.TRANSITION_CONFIGURE)
    assert change(Transition.TRANSITION_ACTIVATE)
    assert alive.trigger_deactivate() is TransitionCallbackReturn.SUCCESS
    executor.remove_node(alive)
    alive.destroy_node()
