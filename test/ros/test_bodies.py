"""Several bodies in one process."""

from __future__ import annotations

import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
import rclpy
from command_line import called
from geometry_msgs.msg import InertiaStamped, Vector3Stamped, Wrench, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.waitable import Waitable
from ros_harness import TRANSIENT, Peer
from rosgraph_msgs.msg import Clock

from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.ros.bodies import main
from rb_dynamics.ros.node import RigidBodyNode, spin_some
from rb_dynamics.ros.start_arguments import apart
from rb_dynamics.study.replay import replay

pytestmark = pytest.mark.ros


def test_each_body_hears_its_own_commands_and_keeps_its_own_log(scene: Path, peer: Peer, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "rb_dynamics.ros.bodies", str(scene), "--count", "3", "--spacing", "[0, 2.0, 0.5]"]
    command += ["--ros-args", "-p", f"mcap:={tmp_path}/run.mcap", "-p", "output_rate:=200.0"]
    command += ["-p", f"sink:=[bag={tmp_path}/flight]"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            odometry = [peer.listen(Odometry, f"/body_{k}/odom") for k in (1, 2, 3)]
            momenta = [peer.listen(Vector3Stamped, f"/body_{k}/linear_momentum") for k in (1, 2, 3)]
            peer.wrench("/body_2/wrench", force=(1.0, 0.0, 0.0), frame_id="world")
            peer.until(lambda: all(momenta) and momenta[1][-1].vector.x > 0.1, "motion of the second")
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) == 0
        finally:
            process.kill()
    assert momenta[0][-1].vector.x == momenta[2][-1].vector.x == 0.0
    assert [each[-1].pose.pose.position.y for each in odometry] == [0.0, 2.0, 4.0]
    assert [each[-1].pose.pose.position.z for each in odometry] == [0.0, 0.5, 1.0]
    assert [each[-1].child_frame_id for each in odometry] == ["body_1", "body_2", "body_3"]
    for k in (1, 2, 3):
        bag = read_bag(tmp_path / f"run_body_{k}.mcap")
        assert bag.complete
        assert len(bag.wrenches(f"/body_{k}/wrench")) == (k == 2)
        assert read_bag(tmp_path / f"flight_body_{k}").complete


def test_bodies_of_a_scene_start_beside_the_place_that_it_gives(scene: Path, peer: Peer) -> None:
    scene.write_text(scene.read_text().replace("initial: {", "initial: {position_world: [7, 8, 9], "))
    for given, place in ((), (7.0, 8.0, 9.0)), (("-p", "initial.position_world:=[1.0, 2.0, 3.0]"), (1.0, 2.0, 3.0)):
        command = [sys.executable, "-m", "rb_dynamics.ros.bodies", str(scene), "--prefix", f"at_{place[0]:.0f}_"]
        with subprocess.Popen([*command, "--ros-args", *given]) as process:
            try:
                odometry = [peer.listen(Odometry, f"/at_{place[0]:.0f}_{k}/odom") for k in (1, 2)]
                peer.until(lambda found=odometry: all(found), "motion of both")
            finally:
                process.kill()
        first, second = (each[0].pose.pose.position for each in odometry)
        assert (first.x, first.y, first.z) == place
        assert (second.x, second.y, second.z) == (place[0], place[1] + 1.0, place[2])


def test_bodies_of_one_process_that_share_a_topic_keep_its_type(tmp_path: Path, peer: Peer) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("body: {mass: 2}\nwrenches: [{topic: /all/push}]\n")
    command = [sys.executable, "-m", "rb_dynamics.ros.bodies", str(scene), "--count", "2"]
    with subprocess.Popen(command, text=True, stderr=subprocess.PIPE) as process:
        try:
            diagnostics = peer.diagnostics()
            peer.node.create_publisher(Wrench, "/all/push", 10)
            told = "/all/push: peer publishes geometry_msgs/msg/Wrench, expected geometry_msgs/msg/WrenchStamped"
            peer.until(lambda: any(told in each.status[0].message for each in diagnostics), "the warning")
            peer.spin(1.5)
        finally:
            process.terminate()
            _, err = process.communicate()
    assert process.returncode == 0, err


def test_a_node_runs_beside_others_in_an_executor_of_ones_own(scene: Path, peer: Peer, tmp_path: Path) -> None:
    log, heard = tmp_path / "run.mcap", list[Odometry]()
    given = {"scene": str(scene), "mcap": str(log), "duration": 1.5, "stamps": "simulation"}
    body = RigidBodyNode(context=peer.context, parameter_overrides=[Parameter(k, value=v) for k, v in given.items()])
    # Heard and commanded by another node of the same executor.
    commands = peer.node.create_publisher(WrenchStamped, "wrench", 10)

    def regulate(odom: Odometry) -> None:
        heard.append(odom)
        command = WrenchStamped()
        command.header.frame_id = "world"
        command.wrench.force.x = 1.0
        commands.publish(command)

    peer.node.create_subscription(Odometry, "odom", regulate, 10)
    peer.executor.add_node(body)
    body.run_by_timer()
    peer.until(lambda: body.runner.done, "the end of the scene")
    assert not body.runner.reset()
    peer.until(lambda: body.runner.done, "the end after a reset")
    body.destroy_node()
    assert read_bag(log.with_name("run.1.mcap")).complete
    assert heard[-1].twist.twist.linear.x > 0.0
    bag = read_bag(log)
    assert bag.complete
    assert bag.metadata["rb_dynamics.result"]["end_time_ns"] == "1500000000"
    assert len(bag.wrenches("/wrench")) > 1
    assert replay(log).identical


def test_a_commander_of_wrench_is_heard_when_another_comes_just_then(scene: Path, peer: Peer) -> None:
    commander = Peer()
    body = RigidBodyNode(context=peer.context, parameter_overrides=[Parameter("scene", value=str(scene))])
    executor = SingleThreadedExecutor(context=peer.context)
    executor.add_node(body)
    body.runner.start()
    commands = commander.node.create_publisher(Wrench, "wrench", 10)
    commander.node.create_publisher(Odometry, "rigid_body/set_state", 10)
    commander.until(lambda: body.count_publishers("wrench") == 1, "a commander")

    # At the event of the other publisher the executor holds all readers that it waited for.
    entity: object = None
    while not isinstance(entity, Waitable):
        task, entity, _ = executor.wait_for_ready_callbacks(timeout_sec=10.0)
        task()
    body.tick()
    commander.until(lambda: commands.get_subscription_count() == 1, "a reader of Wrench")
    executor.shutdown()
    body.destroy_node()
    commander.close()


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        ("out/run.mcap", "out/run_b.mcap"),
        (["bag=out/flight/", "rerun=run.rrd"], ["bag=out/flight_b", "rerun=run_b.rrd"]),
        ("store=tcp://host:9/run", "store=tcp://host:9/run_b"),
    ],
)
def test_targets_of_logs_are_kept_apart(target: object, expected: object) -> None:
    assert apart(target, "b") == expected


def test_bodies_of_a_file_have_their_own_scenes_and_values_and_one_clock(
    scene: Path, peer: Peer, tmp_path: Path
) -> None:
    file = tmp_path / "bodies.yaml"
    log = tmp_path / "chaser.mcap"
    chaser = f"{{scene: scene.yaml, initial: {{position_world: [0, 1.5, 2]}}, body.mass: 3, mcap: {log}}}"
    file.write_text(f"bodies:\n  target: {{scene: scene.yaml, duration: 200.0}}\n  chaser: {chaser}\n")
    command = [sys.executable, "-m", "rb_dynamics.ros.bodies", str(file), "--ros-args", "-p", "publish_clock:=true"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            inertia = peer.listen(InertiaStamped, "/chaser/inertia", TRANSIENT)
            odometry, clock = peer.listen(Odometry, "/chaser/odom"), peer.listen(Clock, "/clock")
            peer.until(lambda: bool(odometry and inertia and clock), "motion")
            assert peer.node.count_publishers("/clock") == 1
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) == 0
        finally:
            process.kill()
    position = odometry[-1].pose.pose.position
    assert (position.x, position.y, position.z, inertia[0].inertia.m) == (0.0, 1.5, 2.0, 3.0)
    # Simulation time, as that of the clock.
    assert odometry[-1].header.stamp.sec < 1000
    assert read_bag(log).complete


@pytest.mark.parametrize(
    ("text", "arguments", "expected"),
    [
        ("bodies: 5", (), "expected bodies by name"),
        ("bodies: {a: {scene: }}", (), "bodies.a: found a parameter without a value"),
        ("bodies: {a: {mass: 1.0}}", ("--count", "3"), "--count: found it together with a file of bodies"),
        ("bodies: {a: {scene: none.yaml}}", (), "none.yaml"),
    ],
)
def test_a_file_of_bodies_that_is_none_is_refused(
    tmp_path: Path, text: str, arguments: tuple[str, ...], expected: str
) -> None:
    file = tmp_path / "bodies.yaml"
    file.write_text(text)
    result = called(main, file, *arguments)
    assert result.returncode == 2
    assert expected in result.stderr.splitlines()[-1]


def test_a_body_that_cannot_start_ends_them_all_with_one_message(tmp_path: Path) -> None:
    result = called(main, tmp_path / "none.yaml")
    assert result.returncode == 2
    assert "none.yaml" in result.stderr


@pytest.mark.parametrize("wrong", ["log", "argument"])
def test_a_later_body_that_cannot_start_leaves_the_log_of_the_first_whole(
    scene: Path, tmp_path: Path, wrong: str
) -> None:
    arguments = [scene, "--ros-args", "-p", f"mcap:={tmp_path}/r.mcap"]
    if wrong == "log":
        (tmp_path / "r_body_2.mcap" / "full").mkdir(parents=True)
        expected = "r_body_2.mcap: it is a folder"
    else:
        arguments += ["-p", "qos_overrides./body_2/wrench.subscription.reliability:=perhaps"]
        expected = "perhaps"
    result = called(main, *arguments)
    assert result.returncode == 2
    assert expected in result.stderr.splitlines()[-1]
    bag = read_bag(tmp_path / "r_body_1.mcap")
    assert bag.complete
    assert bag.metadata["rb_dynamics.result"]["end_time_ns"] == "0"


@pytest.mark.parametrize("name", ["__ns:=/fleet", "__node:=one"])
def test_bodies_that_would_all_have_one_name_are_refused(scene: Path, name: str) -> None:
    result = called(main, scene, "--ros-args", "-r", name)
    assert result.returncode == 2
    assert "expected one for each; leave out -r __ns and __node" in result.stderr.splitlines()[-1]


def test_a_turn_answers_more_than_one_of_many_that_wait() -> None:
    context = Context()
    rclpy.init(context=context, args=[])
    executor = SingleThreadedExecutor(context=context)
    called: list[int] = []
    try:
        nodes = [Node(f"node_{k}", context=context) for k in range(8)]
        for k, node in enumerate(nodes):
            executor.add_node(node)
            node.create_guard_condition(partial(called.append, k)).trigger()
        turns = 0
        while len(called) < len(nodes):
            spin_some(executor)
            turns += 1
        assert turns < len(nodes)
        assert sorted(called) == list(range(8))
        spin_some(executor)
        assert len(called) == 8
    finally:
        executor.shutdown()
        rclpy.shutdown(context=context)


def test_no_bodies_are_a_mistake(scene: Path) -> None:
    result = called(main, scene, "--count", "0")
    assert result.returncode == 2
    assert "1 or more" in result.stderr
