"""The examples, run as a user would."""

from __future__ import annotations

import math
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from ros_harness import ROOT, Peer, running
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from rb_dynamics.formats.log_metadata import RESULT
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.study.replay import replay

pytestmark = pytest.mark.ros


def test_the_controller_turns_the_tumbling_body_to_its_target(peer: Peer) -> None:
    tumble = {"initial__angular_velocity_body": "[1.0, -0.5, 0.3]"}
    with running(ROOT / "config" / "free_flyer.yaml", **tumble) as node:
        odom = peer.listen(Odometry, "odom")
        with subprocess.Popen([sys.executable, ROOT / "examples" / "regulate.py"]) as controller:
            try:
                # It may pass its target first: a machine that is busy is a controller that is late.
                peer.until(lambda: len(odom) > 50 and all(map(at_rest, odom[-50:])), "the body held in its attitude")
            finally:
                controller.kill()
        assert node.stop() == 0, node.err


def test_the_controller_in_lockstep_flies_the_same_bits_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # By the transports that Fast DDS chooses itself, shared memory first.
    monkeypatch.delenv("FASTDDS_BUILTIN_TRANSPORTS")
    hashes = []
    for name in ("a.mcap", "b.mcap"):
        tumble = {"initial__angular_velocity_body": "[1.0, -0.5, 0.3]"}
        log = tmp_path / name
        with (
            running(ROOT / "config" / "free_flyer.yaml", lockstep=True, duration=1.0, mcap=log, **tumble) as node,
            subprocess.Popen([sys.executable, ROOT / "examples" / "regulate.py"]) as controller,
        ):
            try:
                assert node.wait() == 0, node.err
            finally:
                controller.kill()
        facts = read_bag(log).metadata[RESULT]
        assert facts["end_time_ns"] == "1000000000"
        hashes.append(facts["states_sha256"])
    assert hashes[0] == hashes[1]


def rate(message: TwistStamped) -> float:
    """Return the magnitude of the angular velocity, rad/s."""
    return math.hypot(*(getattr(message.twist.angular, axis) for axis in "xyz"))


def test_the_spacecraft_is_flown_by_its_sensors_alone(peer: Peer, tmp_path: Path) -> None:
    """Its tumble dies down, however late the two find each other, the log has what did it, and replays."""
    scene, log = ROOT / "config" / "campaigns" / "spacecraft" / "satellite.yaml", tmp_path / "flown.mcap"
    with (
        running(scene, real_time_factor=10.0, duration=600.0, start_paused=True, mcap=log) as node,
        subprocess.Popen([sys.executable, ROOT / "examples" / "spacecraft.py"]) as controller,
    ):
        try:
            twists = peer.listen(TwistStamped, "twist")
            torques = peer.listen(Float64, "wheel_x/command")
            peer.until(lambda: peer.node.count_subscribers("imu") > 0, "the controller listening")
            peer.call("rigid_body/pause", SetBool.Request(data=False))
            peer.until(lambda: len(twists) > 1 and rate(twists[-1]) < 0.7 * rate(twists[0]), "a slower tumble")
            peer.until(lambda: len(torques) > 10, "more than the first torque: held, it slows a tumble alone")
            assert node.stop() == 0, node.err
        finally:
            controller.kill()
    bag = read_bag(log)
    for name in (f"{kind}_{axis}" for kind in ("wheel", "rod") for axis in "xyz"):
        assert len(bag.scalars(f"/{name}/command")[0]) > 1
    assert replay(log).identical


@pytest.mark.usefixtures("signals_of_a_terminal")
@pytest.mark.parametrize("name", ["regulate.py", "command.py"])
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_an_example_that_waits_for_a_node_ends_quietly(peer: Peer, name: str, how: signal.Signals) -> None:
    with subprocess.Popen(
        [sys.executable, ROOT / "examples" / name], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as example:
        try:
            assert example.stdout is not None
            if name == "command.py":
                assert "no node on /wrench yet; start: rb-dynamics node" in example.stdout.readline()
            else:
                peer.until(lambda: peer.node.count_subscribers("odom") > 0, "the controller listening")
                time.sleep(1.0)  # until it spins
            example.send_signal(how)
            assert "Traceback" not in example.communicate(timeout=10.0)[1]
            assert name == "command.py" or example.returncode == 0
        finally:
            example.kill()


def test_control_pauses_steps_and_resets(scene: Path, peer: Peer) -> None:
    def control(word: str, *more: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(ROOT / "examples" / "control.py"), word, *more]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60.0)

    ros_args = ("-r", "__ns:=/robot_1")
    with running(scene, *ros_args) as node:
        step = peer.node.create_client(Trigger, "/robot_1/rigid_body/step")
        peer.until(step.service_is_ready, "the service")
        said = [control(word, "--ros-args", *ros_args) for word in ("step", "pause", "step", "go", "reset")]
        assert node.stop() == 0
    assert [(each.returncode, each.stdout.strip()) for each in said] == [
        (1, ""),
        (0, "paused"),
        (0, "one output period more"),
        (0, "running"),
        (0, "simulation time 0 s, initial state, commands cleared"),
    ]
    assert "only while paused" in said[0].stderr
    refused = control("jump")
    assert refused.returncode == 2
    assert "invalid choice: 'jump' (choose from" in refused.stderr


@pytest.mark.parametrize("name", ["command.py", "control.py"])
def test_an_example_says_what_it_is_before_it_starts(name: str) -> None:
    command = [sys.executable, str(ROOT / "examples" / name), "--help", "--ros-args", "-r", "__ns:=/robot_1"]
    said = subprocess.run(command, capture_output=True, text=True, check=False, timeout=30.0)
    assert said.returncode == 0, said.stderr
    assert f"usage: {name}" in said.stdout
    # As `ros2 run rb_dynamics NAME` and pip's bin/NAME start it.
    function = f"import rb_dynamics.ros.example_executables as examples; examples.{Path(name).stem}()"
    installed = subprocess.run(
        [sys.executable, "-c", function, "--help"], capture_output=True, text=True, check=False, timeout=30.0
    )
    assert f"usage: {Path(name).stem}" in installed.stdout, installed.stderr
    assert "from Python" in said.stdout or "from rclpy" in said.stdout


@pytest.mark.usefixtures("signals_of_a_terminal")
def test_control_that_waits_for_a_node_is_interrupted_quietly(peer: Peer) -> None:
    command = [sys.executable, str(ROOT / "examples" / "control.py"), "pause"]
    waiting = peer.node.count_clients
    # On a busy machine its 5 s of patience may be over before we see it waiting: then there is nothing to interrupt.
    for _ in range(5):
        peer.until(lambda: waiting("rigid_body/pause") == 0, "an earlier client gone")
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as control:
            try:
                peer.until(lambda: waiting("rigid_body/pause") > 0 or control.poll() is not None, "the client waiting")
                interrupted = control.poll() is None
                control.send_signal(signal.SIGINT)
                said = control.communicate(timeout=10.0)[1]
            finally:
                control.kill()
        if interrupted:
            break
    assert interrupted
    assert "Traceback" not in said
    assert control.returncode == 130


def test_the_tutorial_shows_the_controller_as_it_is() -> None:
    page = ROOT / "docs" / "tutorials" / "attitude-loop.md"
    (shown,) = re.findall(r"```py\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert shown in (ROOT / "examples" / "regulate.py").read_text(encoding="utf-8")


def at_rest(odom: Odometry) -> bool:
    q, rate = odom.pose.pose.orientation, odom.twist.twist.angular
    # Half a degree from (1, 1, 1, 1) / 2.
    near = abs(q.x + q.y + q.z + q.w) / 2 > 1.0 - 1e-5
    return near and max(abs(rate.x), abs(rate.y), abs(rate.z)) < 5e-3
