"""Fixtures of the tests that need real rclpy."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

from ros_harness import Peer

SCENE = """\
body:
  mass: 2.0
  inertia: {diagonal: [1, 2, 2.5]}
  frames: {thruster: {position: [0, 0.5, 0]}}
initial: {angular_velocity_body: [0.3, -0.2, 0.1]}
wrenches: [{topic: wrench}, {topic: push, optional: true}]
solver: {method: rkmk4, step: 0.005}
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene without an end."""
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def peer() -> Iterator[Peer]:
    peer = Peer()
    yield peer
    peer.close()
