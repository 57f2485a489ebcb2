"""The real node in its own process, over DDS."""

from __future__ import annotations

import contextlib
import math
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import command
from geometry_msgs.msg import (
    AccelStamped,
    InertiaStamped,
    PoseStamped,
    PoseWithCovarianceStamped,
    TwistStamped,
    TwistWithCovarianceStamped,
    Vector3,
    Vector3Stamped,
    WrenchStamped,
)
from geometry_msgs.msg import Wrench as PlainWrench
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_harness import ROOT, TRANSIENT, NodeProcess, Peer, node_arguments, running, stamp, values
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from rb_dynamics import HashSink, MemorySink, Simulation, Wrench, read_scene
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.numerics.rotation import rotate
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.replay import replay

pytestmark = pytest.mark.ros


def test_topics_types_and_frames(scene: Path, peer: Peer) -> None:
    with running(scene, publish_clock=True) as node:
        inertia = peer.listen(InertiaStamped, "inertia", TRANSIENT)
        pose, twist, odom = (
            peer.listen(kind, name)
            for kind, name in ((PoseStamped, "pose"), (TwistStamped, "twist"), (Odometry, "odom"))
        )
        angular, linear = (peer.listen(Vector3Stamped, name) for name in ("angular_momentum", "linear_momentum"))
        energies = [peer.listen(Float64, f"energy/{name}") for name in ("kinetic", "work", "defect")]
        clock = peer.listen(Clock, "/clock")
        heard = [inertia, pose, twist, odom, angular, linear, *energies, clock]
        peer.until(lambda: all(heard) and len(odom) > 3, "every topic")
        assert node.stop() == 0
    assert (pose[0].header.frame_id, twist[0].header.frame_id) == ("world", "body")
    assert (odom[0].header.frame_id, odom[0].child_frame_id, angular[0].header.frame_id) == ("world", "body", "world")
    i = inertia[0].inertia
    assert (i.m, i.ixx, i.iyy, i.izz, i.ixy) == (2.0, 1.0, 2.0, 2.5, 0.0)
    # Free motion: T and L are those of the initial state, whatever the time.
    assert energies[0][0].data == pytest.approx(0.5 * (0.09 + 2 * 0.04 + 2.5 * 0.01), rel=1e-9)
    assert angular[0].vector.y == pytest.approx(-0.4, rel=1e-12)
    by_time = {stamp(m): m for m in odom}
    same = next(m for m in pose if stamp(m) in by_time)
    assert by_time[stamp(same)].pose.pose == same.pose


def test_lockstep_gives_the_bits_of_simulate_in_any_order(scene: Path, peer: Peer, tmp_path: Path) -> None:
    commands = [
        ("wrench", Wrench((0.1, 0.0, -0.2), (0.01, 0.02, 0.03), "body", 0)),
        ("wrench", Wrench((0.0, 0.3, 0.0), (0.0, -0.1, 0.0), "thruster", 33_333_333)),
        ("wrench", Wrench((0.0, 0.0, 0.0), (0.2, 0.0, 0.0), "world", 250_000_000)),
        ("wrench", Wrench((0.0, 0.0, 0.1), (0.0, 0.0, 0.0), "", 500_000_000)),
        ("push", Wrench((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), "world", 7)),
        ("push", Wrench((-1.0, 0.0, 0.0), (0.0, 0.0, 0.0), "world", 333_000_001)),
        ("push", Wrench(stamp_ns=500_000_000)),
    ]
    log = tmp_path / "run.mcap"
    with running(scene, lockstep=True, mcap=log) as node:
        poses = peer.listen(PoseStamped, "pose")
        # The second channel first and whole, the first one after it: no order between channels is kept. The second is
        # optional, so time would not wait for its first command.
        diagnostics = peer.diagnostics()
        peer.wrench("push", stamp_ns=0)
        peer.until(lambda: bool(diagnostics) and values(diagnostics[-1])["push: accepted"] == "1", "the first command")
        for topic, w in commands[4:] + commands[:4]:
            peer.wrench(topic, w.force, w.torque, w.frame_id, w.stamp_ns)
        peer.until(lambda: bool(poses) and stamp(poses[-1]) == 500_000_000, "the pose at the last stamp")
        peer.spin(0.3)
        assert stamp(poses[-1]) == 500_000_000, "time must stand still at the smallest of the newest stamps"
        assert node.stop() == 0
    offline = Simulation(read_scene(scene), [McapSink(tmp_path / "offline.mcap")])
    for topic, w in [("push", Wrench(stamp_ns=0)), *commands]:
        offline.post(topic, w, w.stamp_ns)
    offline.start()
    offline.advance(500_000_000)
    offline.finish()
    last = poses[-1].pose
    sample = offline.sample
    assert (last.position.x, last.position.y, last.position.z) == sample.position_world
    o = last.orientation
    assert (o.x, o.y, o.z, o.w) == sample.orientation_xyzw
    flown, computed = (read_bag(each).metadata["rb_dynamics.result"] for each in (log, tmp_path / "offline.mcap"))
    assert flown["states_sha256"] == computed["states_sha256"]
    # Though at 0 the node had looked at one channel before the other had spoken.
    assert flown["inputs_sha256"] == computed["inputs_sha256"]
    found = replay(log)
    assert found.identical
    assert {what for _, what in found.uncompared} <= {"warnings and the state of a node"}


def test_a_floating_vehicle_rights_itself_as_simulate_says(peer: Peer) -> None:
    """The shipped scene of buoyancy begins heeled by 40 degrees; half a second later less than 20 are left."""
    scene, end_ns = ROOT / "config" / "buoyancy.yaml", 500_000_000
    offline = Simulation(read_scene(scene), [memory := MemorySink()])
    offline.post("wrench", Wrench(stamp_ns=end_ns), end_ns)
    offline.start()
    offline.advance(end_ns)
    offline.finish()
    samples = {sample.time_ns: sample for sample in memory.samples}
    end = offline.sample.potential_energy
    with running(scene, lockstep=True) as node:
        odometry, potential = peer.listen(Odometry, "odom"), peer.listen(Float64, "energy/potential")
        peer.wrench(stamp_ns=end_ns)
        peer.until(lambda: bool(odometry) and stamp(odometry[-1]) == end_ns, "the state at the stamp of the command")
        peer.until(lambda: bool(potential) and potential[-1].data == end, "its potential energy")
        assert node.stop() == 0, node.err
    for heard in odometry:
        pose, sample = heard.pose.pose, samples[stamp(heard) if stamp(heard) > 1 else 0]
        position, q, rate = pose.position, pose.orientation, heard.twist.twist.angular
        assert (position.x, position.y, position.z) == sample.position_world
        assert (q.x, q.y, q.z, q.w) == sample.orientation_xyzw
        assert (rate.x, rate.y, rate.z) == sample.angular_velocity_body
    assert 0.0 < 2.0 * math.degrees(math.atan2(q.x, q.w)) < 20.0
    assert rate.x < -1.0


def test_lockstep_waits_for_a_channel_that_has_not_spoken(tmp_path: Path, peer: Peer) -> None:
    scene = tmp_path / "two.yaml"
    scene.write_text("body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\nwrenches: [{topic: a}, {topic: b}]\n")
    with running(scene, lockstep=True):
        poses = peer.listen(PoseStamped, "pose")
        peer.wrench("a", stamp_ns=100_000_000)
        peer.spin(0.5)
        assert {stamp(m) for m in poses} == {1}, "a reader is greeted with the state, never with a zero stamp"
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        diagnostics, _ = peer.diagnostics(), peer.node.create_publisher(WrenchStamped, "b", best_effort)
        peer.until(lambda: bool(diagnostics) and "no command may be lost" in diagnostics[-1].status[0].message, "QoS")
        assert "--qos-reliability reliable" in diagnostics[-1].status[0].message
        peer.wrench("b", stamp_ns=20_000_000)
        peer.until(lambda: stamp(poses[-1]) == 20_000_000, "motion")
        peer.spin(0.3)
        assert [stamp(m) for m in poses][-2:] == [10_000_000, 20_000_000]
        assert peer.call("rigid_body/step", Trigger.Request()).success
        peer.until(lambda: stamp(poses[-1]) == 30_000_000, "the pose after a step")


def test_bad_wrenches_are_rejected_counted_and_shown(scene: Path, peer: Peer) -> None:
    with running(scene, start_paused=True) as node:
        diagnostics = peer.diagnostics()
        poses = peer.listen(PoseStamped, "pose")
        peer.until(lambda: bool(poses), "the greeting")
        peer.wrench(force=(math.nan, 0.0, 0.0))
        peer.wrench(torque=(0.0, math.inf, 0.0))
        peer.wrench(force=(1.0, 0.0, 0.0), frame_id="camera")
        peer.wrench(force=(4.0, 0.0, 0.0), frame_id="world")
        peer.wrench(force=(0.0, math.nan, 0.0), frame_id="world")
        peer.wrench(frame_id="camera")
        peer.until(
            lambda: diagnostics and values(diagnostics[-1])["wrench: rejected"] == "5", "the bad commands counted"
        )
        status = diagnostics[-1].status[0]
        assert values(diagnostics[-1])["wrench: accepted"] == "1"
        assert int.from_bytes(status.level, "little") == 1
        assert "camera" in status.message
        assert "expected one of" in status.message
        peer.call("rigid_body/step", Trigger.Request())
        peer.until(lambda: stamp(poses[-1]) > 1, "a pose after a step")
        assert node.stop() == 0
    # The frame was said though the numbers had been within the second before.
    assert "camera" in node.err
    # The good command acts, F = 4 N on 2 kg for one output period; the others left no trace.
    assert poses[-1].pose.position.x == pytest.approx(0.5 * 2.0 * 0.01**2, rel=1e-12)


def test_pause_step_and_reset(scene: Path, peer: Peer, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    with running(scene, mcap=log, stamps="simulation") as node:
        poses = peer.listen(PoseStamped, "pose")
        peer.until(lambda: len(poses) > 2, "motion")
        assert not peer.call("rigid_body/step", Trigger.Request()).success
        assert peer.call("rigid_body/pause", SetBool.Request(data=True)).success
        peer.spin(0.2)
        frozen = stamp(poses[-1])
        peer.spin(0.2)
        assert stamp(poses[-1]) == frozen
        assert peer.call("rigid_body/step", Trigger.Request()).success
        peer.until(lambda: stamp(poses[-1]) == frozen + 10_000_000, "one output period more")
        answer = peer.call("rigid_body/reset", Trigger.Request())
        assert answer.success
        assert answer.message.endswith(f"; an earlier log {log} is kept as run.1.mcap")
        peer.until(lambda: stamp(poses[-1]) < frozen, "time from 0 again")
        assert node.stop() == 0
    said = node.out + node.err
    assert all(f"{what} at simulation time" in said for what in ("paused", "reset")), said
    first, newest = read_bag(log.with_stem("run.1")), read_bag(log)
    assert first.complete
    assert newest.complete
    assert first.poses("/pose")[0][-1] == frozen + 10_000_000
    assert newest.poses("/pose")[0][0] == 0


@pytest.mark.usefixtures("signals_of_a_terminal")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.slow)])
def test_a_signal_closes_the_logs_and_exits_with_0(scene: Path, peer: Peer, tmp_path: Path, number: int) -> None:
    pytest.importorskip("rerun")
    mcap, rrd = tmp_path / "deep" / "run.mcap", tmp_path / "run.rrd"
    with running(scene, mcap=mcap, rerun=rrd, stamps="simulation") as node:
        poses = peer.listen(PoseStamped, "pose")
        peer.until(lambda: len(poses) > 5, "motion")
        assert node.stop(number) == 0, node.err
    bag = read_bag(mcap)
    assert bag.complete
    assert int(bag.metadata["rb_dynamics.result"]["end_time_ns"]) >= stamp(poses[-1])
    assert rrd.stat().st_size > 0


def test_as_fast_as_possible_ends_with_the_scene_and_equals_simulate(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    node = NodeProcess(
        ROOT / "config" / "dzhanibekov.yaml", real_time_factor=0, duration=3.0, solver__step=0.01, mcap=log
    )
    assert node.wait() == 0, node.err
    scene = read_scene(ROOT / "config" / "dzhanibekov.yaml", {"duration": 3.0, "solver.step": 0.01})
    offline = Simulation(scene, [states := HashSink()])
    offline.start()
    offline.advance(3_000_000_000)
    assert read_bag(log).metadata["rb_dynamics.result"]["states_sha256"] == states.hexdigest()


def test_namespace_remapping_and_scene_overrides(scene: Path, peer: Peer, tmp_path: Path) -> None:
    logs = tmp_path / "run.mcap", tmp_path / "named.mcap"
    ros_args = ("-r", "__ns:=/robot_1", "-r", "wrench:=/commands")
    with running(scene, *ros_args, start_paused=True, body__mass=4, mcap=logs[0], sink=f"mcap={logs[1]}") as node:
        inertia = peer.listen(InertiaStamped, "/robot_1/inertia", TRANSIENT)
        peer.until(lambda: bool(inertia), "the inertia")
        assert inertia[0].inertia.m == 4.0
        peer.wrench("/commands", force=(1.0, 0.0, 0.0))
        assert peer.call("/robot_1/rigid_body/step", Trigger.Request()).success
        assert node.stop() == 0
    for log in logs:
        assert {"/robot_1/pose", "/commands", "/commands/applied"} <= set(read_bag(log).topics)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"real_time_factor": -1.0}, "real_time_factor"),
        ({"real_time_factor": ".nan"}, "real_time_factor"),
        ({"lockstep": 3}, "lockstep"),
        ({"use_sim_time": 3}, "use_sim_time"),
        ({"apply_at": "whenever"}, "'arrival' or 'stamp'"),
        ({"body__mas": 1.0}, "mass"),
        ({"body__mass": -1.0}, "body.mass"),
        ({"mcap": "/proc/no/run.mcap"}, "/proc/no"),
        ({"mcap": "run.mcap", "bag": "run"}, "expected one"),
        ({"sink": "rows=run.txt"}, "found 'rows', expected one of mcap, bag, rerun"),
        ({"sink": "[mcap]"}, "expected NAME=TARGET"),
    ],
)
def test_bad_parameters_end_with_one_message(scene: Path, parameters: dict[str, object], expected: str) -> None:
    refused = command(*node_arguments(scene, **parameters))
    assert refused.returncode == 2
    assert expected in refused.stderr


@pytest.mark.parametrize(
    "wrong", [{"sink": "mcap=/proc/no/run.mcap"}, {"qos_overrides./wrench.subscription.reliability": "perhaps"}]
)
def test_a_node_that_cannot_start_leaves_no_log_half_written(
    scene: Path, tmp_path: Path, wrong: dict[str, str]
) -> None:
    log = tmp_path / "run.mcap"
    node = NodeProcess(scene, mcap=log, **wrong)
    assert node.wait() == 2
    assert "Traceback" not in node.err
    assert not log.exists() or read_bag(log).complete


def test_a_node_that_cannot_start_leaves_the_graph(scene: Path) -> None:
    # Another name than that of the nodes of other tests, one of which the graph may still know.
    name = "never_started"
    qos = {"qos_overrides./wrench.subscription.reliability": "perhaps"}
    wrong = node_arguments(scene, "-r", f"__node:={name}", **qos)
    # News that comes after a farewell puts a node back into the graph of who hears both: that is seldom.
    for _ in range(6):
        watcher = Peer()
        try:
            watcher.spin(0.5)
            assert command(*wrong).returncode == 2
            # Long before the 20 s after which DDS gives up a node that left without a word.
            for _ in range(30):
                watcher.spin(0.3)
                if name not in watcher.node.get_node_names():
                    return
        finally:
            watcher.close()
    raise AssertionError("the node is still in the graph")


def test_apply_at_stamp_waits_for_the_stamp_and_counts_late_ones(scene: Path, peer: Peer) -> None:
    with running(scene, start_paused=True, apply_at="stamp") as node:
        diagnostics = peer.diagnostics()
        poses = peer.listen(PoseStamped, "pose")
        peer.until(lambda: bool(poses), "the greeting")
        peer.wrench(force=(2.0, 0.0, 0.0), frame_id="world", stamp_ns=5_000_000)
        peer.until(lambda: diagnostics and values(diagnostics[-1])["wrench: accepted"] == "1", "the command counted")
        peer.call("rigid_body/step", Trigger.Request())
        peer.until(lambda: stamp(poses[-1]) > 1, "a pose")
        assert poses[-1].pose.position.x == pytest.approx(0.5 * 0.005**2, rel=1e-12)
        peer.wrench(force=(0.0, 0.0, 0.0), frame_id="world", stamp_ns=7_000_000)
        peer.until(lambda: values(diagnostics[-1])["wrench: late"] == "1", "the late command counted")
        assert node.stop() == 0


def test_twist_is_in_body_axes(scene: Path, peer: Peer) -> None:
    with running(scene) as node:
        twists, momenta, poses = (
            peer.listen(TwistStamped, "twist"),
            peer.listen(Vector3Stamped, "linear_momentum"),
            peer.listen(PoseStamped, "pose"),
        )

        def moves() -> bool:
            # Again and again: a reader that has only just been found may miss the first.
            peer.wrench(force=(3.0, -1.0, 0.5), frame_id="world")
            return bool(twists) and abs(twists[-1].twist.linear.x) > 0.05 and bool(momenta)

        peer.until(moves, "motion")
        peer.spin(0.1)
        assert node.stop() == 0
    times = {stamp(m): m for m in twists}, {stamp(m): m for m in momenta}, {stamp(m): m for m in poses}
    common = max(times[0].keys() & times[1].keys() & times[2].keys())
    t, p, o = times[0][common].twist.linear, times[1][common].vector, times[2][common].pose.orientation
    world = rotate((o.x, o.y, o.z, o.w), (t.x, t.y, t.z))
    assert [2.0 * v for v in world] == pytest.approx([p.x, p.y, p.z], rel=1e-9)


def test_commands_after_a_stall_act_in_their_order(scene: Path, peer: Peer) -> None:
    with running(scene) as node:
        momenta = peer.listen(Vector3Stamped, "linear_momentum")
        peer.wrench()
        peer.until(lambda: len(momenta) > 5, "motion")
        node.process.send_signal(signal.SIGSTOP)
        peer.spin(0.3)
        peer.wrench(force=(1.0, 0.0, 0.0), frame_id="world")
        peer.spin(0.3)
        peer.wrench(force=(0.0, 0.0, 0.0), frame_id="world")
        peer.spin(0.3)
        node.process.send_signal(signal.SIGCONT)
        peer.spin(1.0)
        first = momenta[-1].vector.x
        peer.spin(0.5)
        assert momenta[-1].vector.x == first, "the last command, no force, must be the one that is held"
        assert node.stop() == 0


def test_a_stamp_of_another_clock_does_not_deafen_the_node(scene: Path, peer: Peer) -> None:
    with running(scene, lockstep=True) as node:
        diagnostics = peer.diagnostics()
        peer.wrench(stamp_ns=1_760_000_000_000_000_000)
        peer.until(
            lambda: bool(diagnostics) and "far ahead" in diagnostics[-1].status[0].message, "a warning of the stamp"
        )
        assert node.stop() == 0


def test_a_burst_of_commands_is_taken_whole(scene: Path, peer: Peer) -> None:
    count = 3000
    with running(scene, lockstep=True, output_rate=1.0) as node:
        diagnostics = peer.diagnostics()
        for k in range(count):
            peer.wrench(force=(1.0, 0.0, 0.0), frame_id="world", stamp_ns=k * 1_000_000)
        peer.until(
            lambda: bool(diagnostics) and values(diagnostics[-1])["wrench: accepted"] == str(count), "every command"
        )
        assert values(diagnostics[-1])["wrench: late"] == "0"
        assert node.stop() == 0


def test_a_later_node_keeps_the_logs_of_the_earlier_one(scene: Path, tmp_path: Path) -> None:
    bag, rrd = tmp_path / "flight", tmp_path / "run.rrd"
    for duration in (0.5, 1.0):
        node = NodeProcess(
            scene,
            bag=bag,
            rerun=rrd,
            real_time_factor=0,
            duration=duration,
            max_bag_duration=0.4,
            flush=0.1,
            verify=True,
            publish_accel=True,
        )
        assert node.wait() == 0, node.err
    assert f"an earlier log {bag} is kept as flight.1" in node.err
    assert (tmp_path / "run.1.rrd").stat().st_size > 0
    earlier, newest = read_bag(bag.with_name("flight.1")), read_bag(bag)
    assert [each.poses("/pose")[0][-1] for each in (earlier, newest)] == [500_000_000, 1_000_000_000]
    assert len(list(bag.glob("*.mcap"))) == 3
    assert newest.topics["/accel"].count == newest.topics["/tf"].count == newest.topics["/pose"].count


def test_no_log_replaces_the_scene_or_a_folder_of_other_files(scene: Path, tmp_path: Path) -> None:
    """The scene was moved aside, and so was the whole folder."""
    text = scene.read_text()
    node = NodeProcess(scene, mcap=scene)
    assert node.wait() != 0
    assert f"cannot write {scene}: it is, or holds, what is read" in node.err
    assert scene.read_text() == text
    folder = tmp_path / "flight"
    folder.mkdir()
    for name in ("flight_0.mcap", "notes.txt"):
        (folder / name).write_text(name)
    node = NodeProcess(scene, bag=folder, real_time_factor=0, duration=0.5)
    node.wait()
    assert f"{folder} holds notes.txt, expected a new or empty folder" in node.err
    assert sorted(each.name for each in folder.iterdir()) == ["flight_0.mcap", "notes.txt"]


def test_the_sink_of_a_plug_in_is_told_the_run(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # What pip would install.
    facts = tmp_path / "rb_dynamics_example-0.1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: rb-dynamics-example\nVersion: 0.1.0\n")
    (facts / "entry_points.txt").write_text("[rb_dynamics.sinks]\nlines = rb_dynamics_example.lines:Lines\n")
    paths = (str(tmp_path), str(ROOT / "examples" / "plugin"), os.environ.get("PYTHONPATH", ""))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    sinks = f"[lines={tmp_path}/run.txt, mcap={tmp_path}/run.mcap]"
    for duration in (1.0, 2.0):
        node = NodeProcess(scene, real_time_factor=0, duration=duration, sink=sinks)
        assert node.wait() == 0, node.err
    assert "run.txt is kept as run.1.txt" in node.err
    lines = (tmp_path / "run.txt").read_text().splitlines()[1:]
    assert [line.split()[0] for line in lines] == ["0", "1", "2"]
    assert read_bag(tmp_path / "run.mcap").complete


def test_a_reset_whose_log_cannot_be_opened_is_answered_and_survived(scene: Path, peer: Peer, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    with running(scene, mcap=folder / "run.mcap") as node:
        poses = peer.listen(PoseStamped, "pose")
        peer.until(lambda: len(poses) > 3, "motion")
        (folder / "run.mcap").rename(tmp_path / "run.mcap")
        folder.rmdir()
        folder.write_text("no folder any more")
        answer = peer.call("rigid_body/reset", Trigger.Request())
        assert not answer.success
        assert "log" in answer.message
        count = len(poses)
        peer.until(lambda: len(poses) > count + 3, "motion after the reset")
        assert node.stop() == 0, node.err
    assert read_bag(tmp_path / "run.mcap").complete


@pytest.mark.parametrize("ros_args", [("-p", "foo"), ("-r", "__ns:=bad-ns"), ("-r", "wrench:=/pose")])
def test_bad_ros_arguments_end_with_one_message(scene: Path, ros_args: tuple[str, ...]) -> None:
    refused = command(*node_arguments(scene, *ros_args))
    assert refused.returncode == 2
    assert "ROS 2 could not start the node" in refused.stderr


def test_a_scene_with_an_odd_name_is_found(tmp_path: Path) -> None:
    scene = tmp_path / "it's #1.yaml"
    scene.write_text("body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\nduration: 0.1\n")
    node = NodeProcess(scene, real_time_factor=0)
    assert node.wait() == 0, node.err


def test_the_example_commander_turns_the_body(peer: Peer) -> None:
    with running(ROOT / "config" / "free_flyer.yaml") as node:
        commander = subprocess.run(
            [sys.executable, ROOT / "examples" / "command.py"], capture_output=True, text=True, timeout=60, check=False
        )
        assert commander.returncode == 0, commander.stderr
        assert node.stop() == 0
    time, rate = map(float, re.findall(r"[\d.]+\d", commander.stdout))
    # On a busy machine the command acts later than the stamp from which the commander counts.
    assert 0.5 * time * 0.01 / 0.31 < rate < 1.05 * time * 0.01 / 0.31


def test_what_is_published_where_asked_and_what_is_heard_without_a_stamp(scene: Path, peer: Peer) -> None:
    asked = {"publish_accel": True, "publish_pose_with_covariance": True, "publish_twist_with_covariance": True}
    with running(scene, start_paused=True, pose_covariance="[1.0, 2.0, 3.0, 4.0, 5.0, 0.5]", **asked) as node:
        accelerations, diagnostics = peer.listen(AccelStamped, "accel"), peer.diagnostics()
        poses = peer.listen(PoseWithCovarianceStamped, "pose_with_covariance")
        twists = peer.listen(TwistWithCovarianceStamped, "twist_with_covariance")
        odometry = peer.listen(Odometry, "odom")
        peer.wrench(force=(3.0, 0.0, 0.0), torque=(0.0, 0.0, 0.5))
        peer.until(lambda: diagnostics and values(diagnostics[-1])["wrench: accepted"] == "1", "the command counted")
        peer.call("rigid_body/step", Trigger.Request())
        peer.until(lambda: bool(accelerations) and stamp(accelerations[-1]) > 1, "an acceleration after a step")
        # Without a stamp, on another channel.
        publisher = peer.node.create_publisher(PlainWrench, "push", 10)
        peer.until(lambda: publisher.get_subscription_count() > 0, "a reader of Wrench")
        publisher.publish(PlainWrench(force=Vector3(y=-4.0)))
        peer.until(lambda: values(diagnostics[-1])["push: accepted"] == "1", "the command counted")
        with contextlib.closing(Peer()) as other:
            other.node.create_publisher(PoseStamped, "push", 10)
            peer.until(lambda: "peer publishes geometry_msgs" in diagnostics[-1].status[0].message, "the other type")
        before = accelerations[-1]
        peer.call("rigid_body/step", Trigger.Request())
        peer.until(lambda: accelerations[-1] is not before, "another step")
        assert accelerations[-1].accel.linear.y == -2.0
        peer.until(lambda: stamp(poses[-1]) == stamp(twists[-1]) == stamp(odometry[-1]), "one sample on all topics")
        assert node.stop() == 0
    assert list(poses[-1].pose.covariance[::7]) == [1.0, 2.0, 3.0, 4.0, 5.0, 0.5]
    assert (poses[-1].header.frame_id, twists[-1].header.frame_id) == ("world", "body")
    assert set(twists[-1].twist.covariance) == {0.0, 1e-12}
    assert (odometry[-1].pose, odometry[-1].twist) == (poses[-1].pose, twists[-1].twist)
    accel = before
    assert accel.header.frame_id == "body"
    assert accel.accel.linear.x == 1.5
    # I3 w3' = N3 + (I1 - I2) w1 w2, and w1 w2 has not changed much in 10 ms.
    assert accel.accel.angular.z == pytest.approx((0.5 + (1 - 2) * 0.3 * -0.2) / 2.5, rel=2e-3)


def test_a_controller_and_a_filter_of_others_get_what_they_ask_for(scene: Path, peer: Peer) -> None:
    """The topics of vortex-auv's LQR (types, QoS, stamps, frame), and the conditions of robot_localization.

    Sources: velocity_controller_lqr_node.py; odometryCallback, loadParams and copyCovariance in ros_filter.cpp.
    """
    names = {"pose": "truth/pose", "twist": "truth/twist", "wrench": "wrench_input"}
    names |= {"pose_with_covariance": "pose", "twist_with_covariance": "twist"}
    remaps = [word for name, other in names.items() for word in ("-r", f"{name}:={other}")]
    asked = {"body__frame": "base_link", "publish_pose_with_covariance": True, "publish_twist_with_covariance": True}
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    now = peer.node.get_clock().now
    # Before the node: on a busy machine its first message is older than what we do next.
    begun = now().nanoseconds
    with running(scene, "-r", "__ns:=/orca", *remaps, **asked) as node:
        diagnostics = peer.diagnostics()
        commands = peer.node.create_publisher(WrenchStamped, "/orca/wrench_input", best_effort)

        def regulate(twist: TwistWithCovarianceStamped) -> None:
            rate, command = twist.twist.twist.angular, WrenchStamped()
            command.header.frame_id, command.header.stamp = "base_link", now().to_msg()
            command.wrench.torque = Vector3(x=-9.0 * rate.x, y=-9.0 * rate.y, z=-9.0 * rate.z)
            commands.publish(command)

        peer.node.create_subscription(TwistWithCovarianceStamped, "/orca/twist", regulate, best_effort)
        poses = peer.listen(PoseWithCovarianceStamped, "/orca/pose", best_effort)
        odometry = peer.listen(Odometry, "/orca/odom", best_effort)

        def turns() -> float:
            rate = odometry[-1].twist.twist.angular
            return abs(rate.x) + abs(rate.y) + abs(rate.z)

        peer.until(lambda: bool(poses and odometry) and turns() < 0.05, "the body at rest")
        peer.until(lambda: bool(diagnostics) and int(values(diagnostics[-1])["wrench: accepted"]) > 20, "the count")
        assert values(diagnostics[-1])["wrench: rejected"] == "0"
        assert node.stop() == 0, node.err
    ended = now().nanoseconds
    for message in odometry:
        # Else the filter looks for transforms that nobody has, and drops what it cannot transform.
        assert (message.header.frame_id, message.child_frame_id) == ("world", "base_link")
        assert {*message.pose.covariance[::7], *message.twist.covariance[::7]} == {1e-12}
        q = message.pose.pose.orientation
        assert abs(q.x**2 + q.y**2 + q.z**2 + q.w**2 - 1.0) < 1e-12
    stamps = [stamp(message) for message in odometry]
    # What is not newer than the last is ignored; what is not in ROS time, always.
    assert stamps == sorted(set(stamps))
    assert begun < stamps[0] < stamps[-1] < ended
