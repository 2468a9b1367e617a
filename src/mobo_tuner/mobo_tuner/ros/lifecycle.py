"""A lifecycle node that outlives whatever transition it is asked for."""

from __future__ import annotations

from lifecycle_msgs.srv import ChangeState
from rclpy._rclpy_pybind11 import RCLError
from rclpy.lifecycle import LifecycleNode


def refuse_unknown_transitions(node: LifecycleNode) -> None:
    """Have `change_state` answer that a transition failed where the node's state does not know it.

    rclpy raises an error in the service's callback instead, which ends the node's process.
    """
    service = next(s for s in node.services if s.srv_type is ChangeState)
    change_state = service.callback

    def guarded(
        request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            return change_state(request, response)
        except RCLError:
            asked = request.transition.label or request.transition.id
            node.get_logger().warning(f"the transition {asked} is not possible in this state")
            response.success = False
            return response

    service.callback = guarded
