"""`Throttle`, with a simulated clock."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

from rb_dynamics.ros.health import Throttle


def test_each_reason_is_said_once_a_second_and_five_of_them() -> None:
    now = [0.0]
    throttle = Throttle(lambda: now[0])
    assert throttle.lets("wrench: rejected: force.x is nan")
    assert throttle.lets("wrench: rejected: frame camera")
    assert throttle.lets("wrench: a command came 1.5e-05 s after its stamp")
    assert not throttle.lets("wrench: a command came 0.25 s after its stamp")
    assert not throttle.lets("wrench: rejected: frame camera")
    assert sum(throttle.lets(f"wrench: rejected: frame {name}") for name in "abcdefgh") == 2
    now[0] = 1.1
    assert throttle.lets("wrench: rejected: frame camera")
