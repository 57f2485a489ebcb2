"""Sensors over DDS: a controller that hears an IMU alone closes the loop in lockstep; the log replays to the bit."""

from __future__ import annotations

from pathlib import Path

import pytest
from geometry_msgs.msg import QuaternionStamped
from ros_harness import Peer, running, stamp
from sensor_msgs.msg import Imu

from rb_dynamics.formats.bag_reader import read_bag
from rb_dynamics.study.replay import replay

pytestmark = pytest.mark.ros

SCENE = """
body: {mass: 2, inertia: {diagonal: [0.1, 0.2, 0.25]}}
initial: {angular_velocity_body: [0.3, -0.2, 0.4]}
wrenches: [{topic: wrench}]
sensors:
  - {type: imu, name: imu, rate: 50.0, gyro: {noise_density: 1.0e-3}, delay: 0.005}
  - {type: star_tracker, name: tracker, rate: 5.0, noise: 1.0e-4}
seed: 2
duration: 1.0
output_rate: 20.0
"""


def test_a_controller_that_hears_sensors_alone_closes_the_loop(tmp_path: Path, peer: Peer) -> None:
    scene, log = tmp_path / "scene.yaml", tmp_path / "run.mcap"
    scene.write_text(SCENE)
    with running(scene, lockstep=True, mcap=log) as node:
        tracker, imu = peer.listen(QuaternionStamped, "tracker"), peer.listen(Imu, "imu")
        peer.wrench(stamp_ns=25_000_000)
        answered = 0
        while node.process.poll() is None and answered < 49:
            new = imu[answered:]
            peer.spin(0.0 if new else 0.005)
            for message in new:
                answered += 1
                rate = message.angular_velocity
                torque = (-0.5 * rate.x, -0.5 * rate.y, -0.5 * rate.z)
                # Once the sample after this one has come.
                peer.wrench(torque=torque, stamp_ns=stamp(message) // 20_000_000 * 20_000_000 + 45_000_000)
        assert node.wait() == 0
    assert [stamp(message) for message in imu[1:4]] == [20_000_000, 40_000_000, 60_000_000]
    assert imu[0].angular_velocity_covariance[0] == pytest.approx(1e-6 * 50.0)
    assert tracker[1].header.frame_id == "world"
    assert replay(log).identical
    rates = read_bag(log).topics["/twist"].numbers[:, 3:]
    assert abs(rates[-1]).max() < 0.2 * abs(rates[0]).max()
