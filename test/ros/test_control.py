"""Control over DDS: state and mass properties from outside, parameters, incompatible QoS."""

from __future__ import annotations

import re
import signal
from pathlib import Path
from typing import Any

import pytest
import rclpy
from command_line import command
from geometry_msgs.msg import InertiaStamped, PoseStamped, Wrench, WrenchStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import LoggerLevel
from rcl_interfaces.srv import GetParameters, SetLoggerLevels, SetParametersAtomically
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_harness import TRANSIENT, Peer, node_arguments, running, stamp, values
from std_srvs.srv import SetBool, Trigger

from rb_dynamics.errors import SceneError
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.ros.node import RigidBodyNode
from rb_dynamics.study.replay import replay

pytestmark = pytest.mark.ros


def set_together(peer: Peer, **parameters: Any) -> tuple[bool, str]:
    """Set parameters of the node as one change; `__` in a name stands for a dot."""
    request = SetParametersAtomically.Request(
        parameters=[
            Parameter(name.replace("__", "."), value=value).to_parameter_msg() for name, value in parameters.items()
        ]
    )
    result = peer.call("rigid_body/set_parameters_atomically", request, SetParametersAtomically).result
    return result.successful, result.reason


def test_mass_properties_change_together_and_only_while_paused(scene: Path, peer: Peer, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    with running(scene, mcap=log) as node:
        inertia, poses = peer.listen(InertiaStamped, "inertia", TRANSIENT), peer.listen(PoseStamped, "pose")
        peer.until(lambda: inertia and len(poses) > 3, "motion")
        done, reason = set_together(peer, body__mass=3.0)
        assert (done, "only be changed while paused" in reason) == (False, True), reason
        peer.call("rigid_body/pause", SetBool.Request(data=True))
        # One of the two is bad, so none is taken.
        done, reason = set_together(peer, body__mass=3.0, body__inertia__diagonal=[1.0, 1.0, 3.0])
        assert (done, "inertia" in reason) == (False, True), reason
        answer = peer.call("rigid_body/get_parameters", GetParameters.Request(names=["body.mass"]), GetParameters)
        assert answer.values[0].double_value == 2.0
        assert len(inertia) == 1
        paused_at = stamp(poses[-1])
        assert set_together(peer, body__mass=3, body__inertia__diagonal=[2.0, 3.0, 4.0]) == (True, "")
        peer.until(lambda: len(inertia) == 2, "the new inertia")
        assert (inertia[1].inertia.m, inertia[1].inertia.izz) == (3.0, 4.0)
        assert stamp(inertia[1]) >= paused_at, "stamps go on"
        peer.call("rigid_body/pause", SetBool.Request(data=False))
        peer.until(lambda: stamp(poses[-1]) > paused_at + 50_000_000, "motion again")
        # Only what is worse than INFO from here on.
        quiet = SetLoggerLevels.Request(levels=[LoggerLevel(name="rigid_body", level=30)])
        assert peer.call("rigid_body/set_logger_levels", quiet, SetLoggerLevels).results[0].successful
        assert set_together(peer, real_time_factor=2.0) == (True, "")
        assert node.stop() == 0
    said = node.out + node.err
    assert re.search(r"parameters set at .*: body.mass = 3, body.inertia.diagonal = \[2.0, 3.0, 4.0\]", said), said
    assert "goes on at" in said
    assert "real_time_factor" not in said
    again = read_bag(log.with_stem("run.1"))
    assert again.complete
    assert read_bag(log).complete


def test_a_parameter_that_cannot_be_set_is_answered_with_what_can(scene: Path, peer: Peer) -> None:
    with running(scene, start_paused=True) as node:
        for together, expected in (
            ({"real_time_facto": 2.0}, "did you mean real_time_factor?"),
            ({"body.mas": 2.0}, "mass"),
            ({"lockstep": True}, "read-only"),
            ({"use_sim_time": True}, "start it anew"),
            ({"real_time_factor": -1.0}, "0 (no limit) or more"),
            ({"real_time_factor": 1e308}, "1e+09"),
            ({"real_time_factor": 1e-310}, "1e-09"),
            ({"solver.accuracy": 1e-6, "output_rate": 0.0}, "pace"),
        ):
            done, reason = set_together(peer, **together)
            assert not done, together
            assert expected in reason
        assert node.stop() == 0


def test_of_states_that_come_at_once_the_newest_good_one_acts_and_the_others_are_counted(
    scene: Path, peer: Peer, tmp_path: Path
) -> None:
    with running(scene, start_paused=True, mcap=tmp_path / "run.mcap") as node:
        diagnostics, poses = peer.diagnostics(), peer.listen(PoseStamped, "pose")
        states = peer.node.create_publisher(Odometry, "rigid_body/set_state", 100)
        peer.until(lambda: poses and states.get_subscription_count() > 0, "the node")
        node.process.send_signal(signal.SIGSTOP)
        message = Odometry()
        message.pose.pose.orientation.w = 1.0
        for x in range(1, 51):
            message.pose.pose.position.x = float(x)
            states.publish(message)
        message.header.frame_id = "nowhere"
        states.publish(message)
        node.process.send_signal(signal.SIGCONT)
        names = [f"~/set_state: {name}" for name in ("accepted", "rejected", "left out")]
        peer.until(
            lambda: diagnostics and sum(int(values(diagnostics[-1]).get(name, "0")) for name in names) == 51,
            "every state accounted for",
        )
        peer.until(lambda: poses[-1].pose.position.x == 50.0, "the newest good state")
        assert node.stop() == 0
    told = values(diagnostics[-1])
    assert int(told[names[1]]) == 1
    assert int(told[names[2]]) > 0
    assert len(list(tmp_path.glob("run*.mcap"))) == 1


@pytest.mark.parametrize(
    ("parameter", "expected"),
    [
        ("real_time_facto", "did you mean real_time_factor?"),
        ("lockstp", "did you mean lockstep?"),
        ("bdy.mass", "body"),
        ("state.position_world", "found an unknown name"),
    ],
)
def test_a_misspelt_parameter_at_the_start_is_answered_with_what_is_known(
    scene: Path, parameter: str, expected: str
) -> None:
    refused = command(*node_arguments(scene, "-p", f"{parameter}:=2.0"))
    assert refused.returncode == 2
    assert expected in refused.stderr
    assert "use_sim_time" in refused.stderr


def test_parameters_for_all_nodes_of_a_bringup_are_warned_of_and_our_own_are_checked(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bringup.yaml"
    foreign = "{gains: {p: 1.0, d: 2.0}, qos_overrides: {/scan: {subscription: {depth: 3}}}, body.mass: 4.0}"
    shared = f"/**: {{ros__parameters: {foreign}}}\nother: {{ros__parameters: {{lockstp: true}}}}\n"
    arguments = ["--ros-args", "--params-file", str(file), "-p", f"scene:={scene}"]

    def started(text: str, *more: str, command_line: bool = True) -> RigidBodyNode:
        file.write_text(text)
        monkeypatch.setattr("sys.argv", ["rigid_body", *arguments, *more] if command_line else ["rigid_body"])
        rclpy.init(context=(context := Context()), args=[*arguments, *more] if command_line else [])
        try:
            node = RigidBodyNode(context=context, cli_args=None if command_line else [*arguments, *more])
            node.destroy_node()
            return node
        finally:
            context.try_shutdown()

    assert started(shared).runner.scene.body.mass == 4.0
    said = capfd.readouterr().err
    assert "(/**) are ignored: gains.d, gains.p\n" in said
    assert "scan" not in said
    assert started(shared, command_line=False).runner.scene.body.mass == 4.0
    for own, more in (("{rigid_body: {ros__parameters: {lockstp: true}}}", ()), (shared, ("-p", "gains.p:=2.0"))):
        with pytest.raises(SceneError, match=r"lockstp: found|gains.p: found") as raised:
            started(own, *more)
        assert str(raised.value).endswith("; lockstp is set in " + str(file)) == (not more)
    for name, value in (("body.masss", 2.0), ("initial.angular_velocity_body", [1.0, 2.0]), ("duration", -1.0)):
        with pytest.raises(SceneError, match=rf"{name}: found .*; {name} is set in .*bringup\.yaml$"):
            started(f"/**: {{ros__parameters: {{{name}: {value}}}}}\n")


def test_a_state_from_outside(scene: Path, peer: Peer) -> None:
    with running(scene, start_paused=True) as node:
        odometry, diagnostics = peer.listen(Odometry, "odom"), peer.diagnostics()
        peer.until(lambda: bool(odometry), "the greeting")
        publisher = peer.node.create_publisher(Odometry, "rigid_body/set_state", 10)
        peer.until(lambda: publisher.get_subscription_count() > 0, "a reader of set_state")
        wanted = Odometry()
        wanted.header.frame_id, wanted.child_frame_id = "world", "body"
        wanted.pose.pose.position.y = 7.0
        wanted.pose.pose.orientation.z = wanted.pose.pose.orientation.w = 0.5**0.5
        wanted.twist.twist.linear.x, wanted.twist.twist.angular.z = 3.0, -0.25
        publisher.publish(wanted)
        peer.until(lambda: odometry[-1].pose.pose.position.y == 7.0, "the new state")
        assert odometry[-1].twist.twist.linear.x == pytest.approx(3.0, rel=1e-15)
        assert odometry[-1].twist.twist.angular.z == -0.25
        peer.call("rigid_body/step", Trigger.Request())
        peer.until(lambda: odometry[-1].pose.pose.position.y > 7.0, "motion")
        # The body's x axis points along the world's y axis.
        assert odometry[-1].pose.pose.position.y == pytest.approx(7.03, rel=1e-12)
        wanted.header.frame_id = "map"
        publisher.publish(wanted)
        peer.until(lambda: "'map'" in diagnostics[-1].status[0].message if diagnostics else False, "the refusal")
        assert node.stop() == 0


def test_motion_capture_moves_the_body_within_one_run_that_replays(tmp_path: Path, peer: Peer) -> None:
    scene, log = tmp_path / "scene.yaml", tmp_path / "run"
    scene.write_text(
        "body: {mass: 2.0, inertia: {diagonal: [1, 2, 2.5]}, center_of_mass: [0.1, 0, 0]}\n"
        "effects: [{type: scheduled_wrench, schedule: [{time: 0.01, torque: [0, 0, 0.2]}]}]\n"
    )
    with running(scene, bag=log, max_bag_duration=0.4) as node:
        odometry, diagnostics = peer.listen(Odometry, "odom"), peer.diagnostics()
        publisher = peer.node.create_publisher(Odometry, "rigid_body/set_state", 10)
        peer.until(lambda: odometry and diagnostics and publisher.get_subscription_count() > 0, "the node")
        wanted = Odometry()
        wanted.pose.pose.orientation.z, wanted.pose.pose.orientation.w = 0.6, 0.8
        wanted.twist.twist.angular.x = 0.1
        for number in range(100):
            wanted.pose.pose.position.x = number / 100
            publisher.publish(wanted)
            peer.spin(0.005)
        peer.until(lambda: odometry[-1].pose.pose.position.x == pytest.approx(0.99, abs=1e-3), "the last state")
        # With an answer: parameters, together, at any time; what is not set stays.
        spin, tilted = [0.0, 1.0, 0.01], [0.0, 0.0, 1.0, 0.0]
        assert set_together(peer, state__angular_velocity_body=spin, state__orientation=tilted) == (True, "")
        peer.until(lambda: odometry[-1].twist.twist.angular.y == pytest.approx(1.0, abs=0.1), "the spin")
        assert odometry[-1].pose.pose.position.x == pytest.approx(0.99, abs=0.2)
        for wrong, expected in (
            ([1, 1], "state.orientation"),
            ([0.0, 0.0, 0.0, 2.0], "divide it by its norm"),
            # What `ros2 param set` makes of a value without brackets.
            ("0, 0, 0, 1", "is '0, 0, 0, 1', expected"),
            (1.0, "write four numbers"),
            ([True] * 4, "write four numbers"),
            (["0"] * 4, "write four numbers"),
        ):
            done, reason = set_together(peer, state__orientation=wrong)
            assert (done, expected in reason) == (False, True), reason
        assert node.stop() == 0
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["run"]
    bag = read_bag(log)
    told = values(diagnostics[-1])
    assert bag.topics["/set_state"].count >= int(told["~/set_state: accepted"]) > 10
    assert abs(bag.scalars("/energy/defect")[1]).max() < 1e-12
    found = replay(log)
    assert found.identical, found
    assert found.samples > 50
    looked = command("inspect", str(log))
    assert looked.returncode == 0, looked.stdout
    assert "the body was moved from outside" in " ".join(looked.stdout.split())


@pytest.mark.parametrize(
    ("text", "bad"),
    [
        pytest.param(
            "initial: {position_world: [7e6, 0, 0]}\neffects: [{type: central_gravity, gravitational_parameter: 4e14}]",
            ([0.0, 0.0, 0.0], [0.1, 0.0, 0.0]),
            marks=pytest.mark.slow,
        ),
        (
            "effects: [{type: linear_drag, translation: 0.1, rotation: 0.001}]\nduration: 600\n",
            ([7e6, 0.0, 0.0], [1e6, 0.0, 0.0]),
        ),
        ("duration: 600\n", ([7e6, 0.0, 0.0], [1e6, 0.0, 0.0])),
    ],
    ids=["at the centre", "too fast", "too fast in free motion"],
)
def test_a_state_that_nothing_follows_is_rejected_and_the_next_one_acts(
    tmp_path: Path, peer: Peer, text: str, bad: tuple[list[float], list[float]]
) -> None:
    scene, log = tmp_path / "scene.yaml", tmp_path / "run.mcap"
    scene.write_text(f"body: {{mass: 10, inertia: {{diagonal: [0.05, 0.12, 0.14]}}}}\nwrenches: []\n{text}")
    with running(scene, mcap=log) as node:
        odometry, diagnostics = peer.listen(Odometry, "odom"), peer.diagnostics()
        publisher = peer.node.create_publisher(Odometry, "rigid_body/set_state", 10)
        peer.until(lambda: odometry and diagnostics and publisher.get_subscription_count() > 0, "the node")
        wanted = Odometry()
        wanted.pose.pose.orientation.w = 1.0
        wanted.pose.pose.position.x, wanted.twist.twist.angular.x = bad[0][0], bad[1][0]
        publisher.publish(wanted)
        peer.until(lambda: values(diagnostics[-1]).get("~/set_state: rejected") == "1", "the rejection")
        assert values(diagnostics[-1])["state"] == "running"
        assert "~/set_state: rejected: the motion cannot continue from there" in diagnostics[-1].status[0].message
        told = set_together(peer, state__position_world=bad[0], state__angular_velocity_body=bad[1])
        assert (told[0], "the motion cannot continue from there" in told[1]) == (False, True), told
        count = len(odometry)
        peer.until(lambda: len(odometry) > count + 10, "motion")
        wanted.pose.pose.position.x, wanted.twist.twist.angular.x = 7e6, 0.5
        publisher.publish(wanted)
        peer.until(lambda: odometry[-1].twist.twist.angular.x == pytest.approx(0.5, rel=0.1), "the good state")
        assert set_together(peer, state__angular_velocity_body=[0.7, 0.0, 0.0]) == (True, "")
        peer.until(lambda: odometry[-1].twist.twist.angular.x == pytest.approx(0.7, rel=0.1), "the spin")
        assert peer.call("rigid_body/pause", SetBool.Request(data=True)).success
        answer = peer.call("rigid_body/step", Trigger.Request())
        assert (answer.success, answer.message) == (True, "one output period more")
        assert node.stop() == 0
    assert "[ERROR]" not in node.err
    assert read_bag(log).topics["/set_state"].count == 2
    assert replay(log).identical


def test_a_step_that_cannot_be_taken_is_answered_with_the_reason(scene: Path, peer: Peer) -> None:
    with running(scene, start_paused=True) as node:
        diagnostics = peer.diagnostics()
        peer.wrench(torque=(9e5, 9e5, 0.0))
        peer.until(lambda: diagnostics and values(diagnostics[-1])["wrench: accepted"] == "1", "the command")
        for _ in range(2):
            answer = peer.call("rigid_body/step", Trigger.Request())
            assert not answer.success
            assert "because the motion cannot be continued: rkmk4: a step" in answer.message
        assert node.stop() == 0
    assert node.err.count("the motion cannot be continued") == 1, node.err


def test_the_last_step_of_a_run_is_answered(scene: Path, peer: Peer) -> None:
    scene.write_text(f"{scene.read_text()}duration: 0.01\n")
    with running(scene, start_paused=True) as node:
        assert peer.call("rigid_body/step", Trigger.Request()).success
        assert node.wait() == 0


def test_a_last_step_that_takes_many_bursts_is_answered(scene: Path, peer: Peer) -> None:
    scene.write_text(f"{scene.read_text().replace('0.005', '0.000001')}duration: 0.01\n")
    with running(scene, start_paused=True) as node:
        assert peer.call("rigid_body/step", Trigger.Request()).success
        assert node.wait() == 0


def test_a_best_effort_commander_is_heard_beside_a_reliable_one_each_command_once(scene: Path, peer: Peer) -> None:
    with running(scene) as node:
        diagnostics = peer.diagnostics()
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        peer.wrench()
        publisher = peer.node.create_publisher(WrenchStamped, "wrench", best_effort)
        sent = 1
        while not publisher.get_subscription_count():
            # What comes while the reader is replaced is taken once.
            peer.wrench()
            sent += 1
            peer.spin(0.01)
        peer.spin(0.1)
        publisher.publish(WrenchStamped())
        peer.wrench()
        expected = {"wrench: accepted": str(sent + 2), "wrench: lost": "0"}
        peer.until(lambda: bool(diagnostics) and expected.items() <= values(diagnostics[-1]).items(), f"{expected}")
        assert "wrench: incompatible QoS" not in values(diagnostics[-1])
        # Of QoS alone: a busy machine may have made it fall behind, which is a warning of its own.
        assert "QoS" not in diagnostics[-1].status[0].message
        peer.node.create_subscription(PoseStamped, "pose", lambda _: None, TRANSIENT)
        peer.until(
            lambda: values(diagnostics[-1]).get("pose: incompatible QoS") == "1", "the reader's mismatch counted"
        )
        assert node.stop() == 0
    assert "a publisher offers BEST_EFFORT: its commands are received" in node.out + node.err


def test_a_commander_of_another_type_soon_after_a_best_effort_one_is_heard(scene: Path, peer: Peer) -> None:
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    commander = Peer()
    with running(scene) as node:
        diagnostics = peer.diagnostics()
        stamped = peer.node.create_publisher(WrenchStamped, "wrench", best_effort)
        peer.until(lambda: stamped.get_subscription_count() == 1, "a reader")
        # The reader that it replaces is still there.
        plain = commander.node.create_publisher(Wrench, "wrench", best_effort)
        peer.node.destroy_publisher(stamped)

        def heard() -> bool:
            plain.publish(Wrench())
            return bool(diagnostics) and int(values(diagnostics[-1])["wrench: accepted"]) > 0

        peer.until(heard, "a command")
        assert node.stop() == 0
    commander.close()
