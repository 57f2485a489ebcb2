"""Sensors and actuators over DDS: loops that hear sensors alone, in lockstep; thrusters by topics; all replay."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import QuaternionStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_harness import KEEP_ALL, Peer, running, stamp, values
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64

from rb_dynamics.formats.log_metadata import RESULT
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.study.replay import replay

pytestmark = pytest.mark.ros

SCENE = """
body: {mass: 2, inertia: {diagonal: [0.1, 0.2, 0.25]}}
initial: {angular_velocity_body: [0.3, -0.2, 0.4]}
wrenches: [{topic: wrench}]
sensors:
  - {type: imu, name: imu, rate: 50.0, gyro: {noise_density: 1.0e-3}, delay: 0.005}
  - {type: star_tracker, name: tracker, rate: 5.0, noise: 1.0e-4}
  - {type: star_tracker, name: slow, rate: 0.5}
seed: 2
duration: 1.0
output_rate: 20.0
"""


def test_a_controller_that_hears_sensors_alone_closes_the_loop(tmp_path: Path, peer: Peer) -> None:
    scene, log = tmp_path / "scene.yaml", tmp_path / "run.mcap"
    scene.write_text(SCENE)
    with running(scene, lockstep=True, mcap=log) as node:
        tracker, imu = peer.listen(QuaternionStamped, "tracker"), peer.listen(Imu, "imu")
        # The node may find these readers later, and what it sends before is lost; until a command comes, it sends none.
        peer.spin(1.0)
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
    # What is wrong with the scene is in the diagnostics, all the time.
    for _, _, ((level, _, told, _, _),) in read_bag(log).topics["/diagnostics"].decoded():
        assert level == 1
        assert "slow: the body turns by 1.1 rad from one message to the next at its initial rate" in told


WHEELS = """
body: {mass: 2, inertia: {diagonal: [0.1, 0.2, 0.25]}}
initial: {angular_velocity_body: [0.3, -0.2, 0.4]}
wrenches: [{topic: time}]
actuators:
  - {type: reaction_wheel, name: wheel_x, axis: [1, 0, 0], inertia: 1.0e-3, friction: {coulomb: 1.0e-4}}
  - {type: reaction_wheel, name: wheel_y, axis: [0, 1, 0], inertia: 1.0e-3, max_torque: 0.08}
  - {type: reaction_wheel, name: wheel_z, axis: [0, 0, 1], inertia: 1.0e-3}
sensors: [{type: imu, name: imu, rate: 50.0, gyro: {noise_density: 1.0e-3}, delay: 0.005}]
seed: 2
duration: 1.0
output_rate: 20.0
"""


def fly(scene: Path, log: Path) -> None:
    """Damp the rate by gyros and wheels; the empty wrench that moves time follows on the commands to the wheels."""
    with contextlib.closing(Peer()) as peer, running(scene, lockstep=True, mcap=log) as node:
        imu = peer.listen(Imu, "imu")
        wheels = [peer.node.create_publisher(Float64, f"wheel_{axis}/command", KEEP_ALL) for axis in "xyz"]
        peer.until(lambda: all(wheel.get_subscription_count() > 0 for wheel in wheels), "readers")
        # On a busy machine the node finds a reader later than publishers beside it: what it sends before is lost.
        peer.spin(1.0)
        peer.wrench("time", stamp_ns=5_000_000)
        for k in range(50):
            peer.until(lambda k=k: len(imu) > k, "the next message")
            rate = imu[k].angular_velocity
            for wheel, turning in zip(wheels, (rate.x, rate.y, rate.z), strict=True):
                wheel.publish(Float64(data=0.5 * turning))
            peer.wrench("time", stamp_ns=20_000_000 * k + 25_000_000)
        assert node.wait() == 0


def test_a_loop_of_gyros_and_wheels_in_lockstep_flies_the_same_bits_again(tmp_path: Path) -> None:
    scene, logs = tmp_path / "scene.yaml", [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    scene.write_text(WHEELS)
    for log in logs:
        fly(scene, log)
        assert replay(log).identical
    first, again = map(read_bag, logs)
    assert first.metadata[RESULT]["states_sha256"] == again.metadata[RESULT]["states_sha256"]
    rates = first.topics["/twist"].numbers[:, 3:]
    assert abs(rates[-1]).max() < 0.3 * abs(rates[0]).max()
    # Each acted when the message that it answers had come.
    for axis in "xyz":
        assert first.scalars(f"/wheel_{axis}/command")[0].tolist() == [5_000_000 + 20_000_000 * k for k in range(50)]


def test_actuators_are_commanded_by_topics_and_what_they_refuse_is_counted(tmp_path: Path, peer: Peer) -> None:
    scene, log = tmp_path / "scene.yaml", tmp_path / "run.mcap"
    scene.write_text("""
body: {mass: 2, frames: {jet: {position: [0, 0, 0], orientation: {x: 0, y: 0, z: 0, w: 1}}}}
wrenches: []
actuators: [{type: thruster, name: jet, frame: jet, force: 2.0, minimum_on: 0.01}]
""")
    with running(scene, mcap=log) as node:
        diagnostics = peer.diagnostics()
        publisher = peer.node.create_publisher(Float64, "jet/command", 10)
        peer.until(lambda: publisher.get_subscription_count() > 0, "a reader")
        peer.spin(0.3)
        for value in (0.05, 0.001):
            publisher.publish(Float64(data=value))
            peer.spin(0.3)
        peer.until(lambda: diagnostics and values(diagnostics[-1]).get("jet/command: rejected") == "1", "a count")
        assert values(diagnostics[-1])["jet/command: accepted"] == "1"
        assert node.stop() == 0
    assert replay(log).identical
    bag = read_bag(log)
    opened, closed = bag.topics["/jet/applied"].log_times
    assert closed - opened == 50_000_000
    assert bag.topics["/linear_momentum"].numbers[-1, 0] == pytest.approx(0.1, rel=1e-14)


def test_a_best_effort_publisher_that_is_not_heard_is_an_error_that_names_the_remedy(
    tmp_path: Path, peer: Peer
) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("""
body: {mass: 2, frames: {jet: {position: [0, 0, 0], orientation: {x: 0, y: 0, z: 0, w: 1}}}}
wrenches: []
actuators: [{type: thruster, name: jet, frame: jet, force: 2.0}]
""")
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    commands = peer.node.create_publisher(Float64, "jet/command", best_effort)
    peer.node.create_publisher(Odometry, "rigid_body/set_state", best_effort)
    diagnostics = peer.heard["/diagnostics"] = []
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", diagnostics.append, KEEP_ALL)
    counts = {"jet/command: incompatible QoS": "1", "~/set_state: incompatible QoS": "1"}
    with running(scene) as node:
        peer.until(lambda: diagnostics and counts.items() <= values(diagnostics[-1]).items(), "both to be counted")
        assert diagnostics[-1].status[0].level == DiagnosticStatus.ERROR
        node.stop()
    assert "~/set_state: a publisher's QoS is incompatible, expected RELIABLE" in node.err
    name, _, value = node.err.partition("start this node with -p ")[2].split()[0].partition(":=")
    with running(scene, "-p", f"{name}:={value}"):
        peer.until(lambda: commands.get_subscription_count() == 1, "the reader to match")


@pytest.mark.parametrize(
    ("solver", "command", "why"),
    [("{accuracy: 1e-9}", 1e12, "expected at most"), ("{method: dop853, step: 0.01}", 1e6, "not one step")],
)
def test_a_command_that_no_wheel_can_follow_is_rejected_and_the_body_moves_on(
    tmp_path: Path, peer: Peer, solver: str, command: float, why: str
) -> None:
    scene, log = tmp_path / "scene.yaml", tmp_path / "run.mcap"
    scene.write_text(f"""
body: {{mass: 10, inertia: {{diagonal: [0.05, 0.12, 0.14]}}}}
wrenches: []
solver: {solver}
actuators: [{{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 1.0e-4}}]
""")
    with running(scene, mcap=log) as node:
        diagnostics = peer.diagnostics()
        publisher = peer.node.create_publisher(Float64, "wheel/command", 10)
        peer.until(lambda: publisher.get_subscription_count() > 0, "a reader")
        for value in (1e-3, command):
            publisher.publish(Float64(data=value))
            peer.spin(0.3)
        peer.until(lambda: diagnostics and values(diagnostics[-1]).get("wheel/command: rejected") == "1", "a count")
        assert values(diagnostics[-1])["wheel/command: accepted"] == "1"
        assert re.search(f"wheel/command: rejected: .*{why}", diagnostics[-1].status[0].message)
        assert node.stop() == 0
    assert replay(log).identical
    # Ten outputs in a tenth of a second under the torque of the first command, of which the wheel takes its share.
    rates = read_bag(log).topics["/twist"].numbers[-11:, 5]
    assert rates[-1] - rates[0] == pytest.approx(-0.1 * 1e-3 / (0.14 - 1e-4), rel=1e-9)
