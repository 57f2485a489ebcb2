"""The node under a lifecycle, by its services over DDS."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import called
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from ros_harness import Peer, stamp

from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.ros.lifecycle import main
from rb_dynamics.study.replay import replay

pytestmark = pytest.mark.ros


def test_arguments_that_ros_does_not_know_end_with_one_message() -> None:
    refused = called(main, "--ros-args", "-p", "scene")
    assert refused.returncode == 2
    assert refused.stderr.splitlines()[-1].startswith("lifecycle: ROS 2 could not start the node")


def test_transitions_make_pause_and_end_the_node(scene: Path, peer: Peer, tmp_path: Path) -> None:
    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(peer.call("/managed/change_state", request, ChangeState).success)

    def state() -> int:
        return int(peer.call("/managed/get_state", GetState.Request(), GetState).current_state.id)

    def there() -> bool:
        return "rigid_body" in peer.node.get_node_names()

    log = tmp_path / "run.mcap"
    # Missing at first: a scene that cannot be read leaves the managed node as it was.
    late = tmp_path / "late.yaml"
    # As launch does it: one file of parameters for the managed node.
    params = tmp_path / "params.yaml"
    params.write_text(f"/managed: {{ros__parameters: {{scene: {late}, mcap: {log}}}}}\n")
    command = [sys.executable, "-m", "rb_dynamics.ros.lifecycle", "--ros-args", "-r", "__node:=managed"]
    with subprocess.Popen([*command, "--params-file", str(params)]) as process:
        try:
            assert not change(Transition.TRANSITION_CONFIGURE)
            assert state() == State.PRIMARY_STATE_UNCONFIGURED
            late.write_text(scene.read_text())
            odometry = peer.heard.setdefault("odom", [])
            peer.node.create_subscription(Odometry, "odom", odometry.append, 1000)
            assert not change(Transition.TRANSITION_ACTIVATE)
            assert change(Transition.TRANSITION_CONFIGURE)
            assert not change(Transition.TRANSITION_CONFIGURE)
            assert state() == State.PRIMARY_STATE_INACTIVE
            peer.until(lambda: bool(odometry) and there(), "the state at time 0")
            begun = stamp(odometry[-1])
            peer.spin(0.1)
            assert stamp(odometry[-1]) == begun
            assert change(Transition.TRANSITION_ACTIVATE)
            # As stamps go on, they are ROS time.
            peer.until(lambda: stamp(odometry[-1]) > begun, "motion")
            assert abs(stamp(odometry[-1]) - peer.node.get_clock().now().nanoseconds) < 5e9
            assert change(Transition.TRANSITION_DEACTIVATE)
            peer.spin(0.1)
            stood = stamp(odometry[-1])
            peer.spin(0.1)
            assert stamp(odometry[-1]) == stood
            assert change(Transition.TRANSITION_CLEANUP)
            peer.until(lambda: not there(), "the end of the node")
            assert read_bag(log).complete
            assert replay(log).identical
            # And again, from the beginning, in a log of its own.
            assert change(Transition.TRANSITION_CONFIGURE)
            assert change(Transition.TRANSITION_ACTIVATE)
            peer.until(lambda: stamp(odometry[-1]) > stood, "motion again")
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) == 0
        finally:
            process.kill()
    assert read_bag(tmp_path / "run.1.mcap").complete
    assert read_bag(log).complete
