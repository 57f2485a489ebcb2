"""The examples, as a user runs them."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from nav_msgs.msg import Odometry
from ros_harness import ROOT, Peer, running

pytestmark = pytest.mark.ros


def test_the_controller_turns_the_tumbling_body_to_its_target(peer: Peer) -> None:
    tumble = {"initial__angular_velocity_body": "[1.0, -0.5, 0.3]"}
    with running(ROOT / "config" / "free_flyer.yaml", **tumble) as node:
        odom = peer.listen(Odometry, "odom")
        with subprocess.Popen([sys.executable, ROOT / "examples" / "regulate.py"]) as controller:
            try:
                peer.until(lambda: bool(odom) and at_rest(odom[-1]), "the body at rest in its target attitude")
                count = len(odom)
                peer.until(lambda: len(odom) > count + 50, "the body held there")
                assert all(map(at_rest, odom[count:]))
            finally:
                controller.kill()
        assert node.stop() == 0


def test_the_tutorial_shows_the_controller_as_it_is() -> None:
    page = ROOT / "docs" / "tutorials" / "attitude-loop.md"
    (shown,) = re.findall(r"```py\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert shown in (ROOT / "examples" / "regulate.py").read_text(encoding="utf-8")


def at_rest(odom: Odometry) -> bool:
    q, rate = odom.pose.pose.orientation, odom.twist.twist.angular
    # Half a degree from (1, 1, 1, 1) / 2.
    near = abs(q.x + q.y + q.z + q.w) / 2 > 1.0 - 1e-5
    return near and max(abs(rate.x), abs(rate.y), abs(rate.z)) < 5e-3
