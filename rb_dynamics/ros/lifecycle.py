"""The node under a lifecycle, as the supervisor of a bringup manages it: configure, activate, deactivate, clean up.

A managed node of its own beside the node `rigid_body`, which it makes and ends; docs/ros.md lists what each transition
does.
"""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Sequence

import rclpy
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from rb_dynamics.errors import RigidBodyError
from rb_dynamics.ros.node import RigidBodyNode, told_by_ros
from rb_dynamics.run.stop_signals import stop_signals

_DONE, _FAILED = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class LifecycleBody(LifecycleNode):
    """A managed node that makes a `RigidBodyNode` and lets its time run, in the single-threaded executor it is in."""

    def __init__(self) -> None:
        """Begin unconfigured."""
        super().__init__("rigid_body_lifecycle")
        self._body: RigidBodyNode | None = None
        # In rclpy a transition that the state does not have is an exception, without an answer, which ends the process.
        service = next(each for each in self.services if each.srv_type is ChangeState)
        change = service.callback

        def refuse(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            try:
                return change(request, response)
            except RuntimeError:
                asked = request.transition.label or request.transition.id
                self.get_logger().warning(f"found no transition {asked} from the present state; nothing changes")
                response.success = False
                return response

        service.callback = refuse

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Read the scene and open the logs; the node is there, and paused."""
        try:
            # Name and parameters that launch gives to the process are those of the managed node: the name stays there.
            # rclpy has no public way to see an override that is not declared.
            given = list(self._parameter_overrides.values())
            self._body = RigidBodyNode(cli_args=["--ros-args", "-r", "__node:=rigid_body"], parameter_overrides=given)
        except RigidBodyError as error:
            self.get_logger().error(str(error))
            return _FAILED
        self._body.runner.pause(True)
        self._body.run_by_timer()
        self.executor.add_node(self._body)
        return _DONE

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Let time run."""
        return self._pause(False)

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Pause."""
        return self._pause(True)

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Close the logs and end the node."""
        return self.end()

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Close the logs and end the node, in any state."""
        return self.end()

    def end(self) -> TransitionCallbackReturn:
        """Close the logs and end the node, if it is there."""
        body, self._body = self._body, None
        if body is not None:
            if not body.runner.done:
                body.finish()
            self.executor.remove_node(body)
            body.destroy_node()
        return _DONE

    def _pause(self, paused: bool) -> TransitionCallbackReturn:
        assert self._body is not None
        self._body.runner.pause(paused)
        return _DONE


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run rb_dynamics lifecycle`: waits for transitions until a signal stops it."""
    stop: list[int] = []
    with stop_signals(stop.append, signal.SIGINT), contextlib.ExitStack() as stack:
        try:
            with told_by_ros():
                rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
                stack.callback(rclpy.try_shutdown)
                node = LifecycleBody()
        except RigidBodyError as error:
            sys.stderr.write(f"lifecycle: {error}\n")
            return 2
        executor = SingleThreadedExecutor()
        for last_first in (node.destroy_node, executor.shutdown, node.end):
            stack.callback(last_first)
        executor.add_node(node)
        while not stop:
            executor.spin_once(timeout_sec=0.1)
    return 0


if __name__ == "__main__":
    sys.exit(main())
