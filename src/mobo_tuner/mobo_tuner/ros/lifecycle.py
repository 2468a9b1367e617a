"""Lifecycle nodes that survive transitions that their state does not allow."""

from __future__ import annotations

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode


def refuse_unknown_transitions(node: LifecycleNode) -> None:
    """Make `change_state` answer that a transition failed if the node's state does not allow it.

    rclpy raises an error in the service's callback instead, which ends the node's process. Neither
    the error's class nor the service is part of rclpy's documented interface: if either changes,
    `tests/ros/test_lifecycle.py` fails.
    """
    service = next(s for s in node.services if s.srv_type is ChangeState)
    change_state = service.callback

    def guarded(
        request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            return change_state(request, response)
        except rclpy_implementation.RCLError:
            transition = request.transition.label or request.transition.id
            node.get_logger().warning(f"the transition {transition} is not possible in this state")
            response.success = False
            return response

    service.callback = guarded
