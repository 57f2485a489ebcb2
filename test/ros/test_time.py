"""Time over DDS: stamps, /clock as publisher and follower, commands by stamp."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command_line import command
from geometry_msgs.msg import InertiaStamped, PoseStamped
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from ros_harness import TRANSIENT, Peer, node_arguments, running, stamp, values
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from rb_dynamics.errors import SceneError
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.ros.node import RigidBodyNode
from rb_dynamics.study.replay import replay

pytestmark = pytest.mark.ros

MS, SECOND = 1_000_000, 1_000_000_000
MOVING = """\
body: {mass: 2.0, inertia: {diagonal: [1, 2, 2.5]}}
initial: {linear_velocity_world: [1, 0, 0]}
wrenches: [{topic: wrench}]
"""


@pytest.fixture
def moving(tmp_path: Path) -> Path:
    path = tmp_path / "moving.yaml"
    path.write_text(MOVING)
    return path


class ClockHand:
    """A publisher of /clock controlled by the test."""

    def __init__(self, peer: Peer) -> None:
        self.peer, self.publisher = peer, peer.node.create_publisher(Clock, "/clock", 10)
        peer.until(lambda: self.publisher.get_subscription_count() > 0, "a reader of /clock")
        # The reader may learn of the publisher a moment later, and /clock is best effort.
        peer.spin(0.5)

    def show(self, time_ns: int) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(time_ns, SECOND)
        self.publisher.publish(message)

    def run(self, begin_ns: int, end_ns: int) -> None:
        for time_ns in range(begin_ns, end_ns + 1, 20 * MS):
            self.show(time_ns)
            self.peer.spin(0.002)


def times(clock: list[Clock]) -> list[int]:
    return [m.clock.sec * SECOND + m.clock.nanosec for m in clock]


def test_no_stamp_is_ever_zero(scene: Path, peer: Peer) -> None:
    with running(scene, start_paused=True, publish_clock=True) as node:
        poses, odometry, diagnostics = (
            peer.listen(PoseStamped, "pose"),
            peer.listen(Odometry, "odom"),
            peer.diagnostics(),
        )
        inertia, clock = peer.listen(InertiaStamped, "inertia", TRANSIENT), peer.listen(Clock, "/clock")
        heard = [poses, odometry, diagnostics, inertia, clock]
        peer.until(lambda: all(heard), "every topic while time stands at 0")
        assert node.stop() == 0
    assert stamp(poses[0]) == stamp(odometry[0]) == stamp(inertia[0]) == 1
    assert clock[0].clock.nanosec == 1
    assert all(stamp(message) for message in [*poses, *odometry, *diagnostics, *inertia])


def test_the_clock_is_that_of_the_steps(scene: Path, peer: Peer) -> None:
    with running(scene, start_paused=True, publish_clock=True) as node:
        clock, poses = peer.listen(Clock, "/clock"), peer.listen(PoseStamped, "pose")
        peer.until(lambda: clock and poses, "the greeting")
        for _ in range(3):
            peer.call("rigid_body/step", Trigger.Request())
        peer.until(lambda: times(clock)[-1] == 30 * MS and stamp(poses[-1]) == 30 * MS, "three steps")
        assert node.stop() == 0
    # A reader that joins at the very beginning may be told the first time twice.
    assert sorted(set(times(clock))) == times(clock)[-4:] == [1, 10 * MS, 20 * MS, 30 * MS]
    assert [stamp(m) for m in poses][-4:] == [1, 10 * MS, 20 * MS, 30 * MS]


def test_two_clocks_are_one_too_many(scene: Path, peer: Peer) -> None:
    peer.node.create_publisher(Clock, "/clock", 10)
    with running(scene, publish_clock=True) as node:
        diagnostics = peer.diagnostics()
        peer.until(lambda: "another publisher" in diagnostics[-1].status[0].message if diagnostics else False, "a word")
        assert node.stop() == 0


def test_a_follower_goes_as_the_clock_goes(moving: Path, peer: Peer) -> None:
    with running(moving, use_sim_time=True) as node:
        poses, diagnostics = peer.listen(PoseStamped, "pose"), peer.diagnostics()
        clock = ClockHand(peer)
        peer.until(lambda: bool(diagnostics), "diagnostics")
        assert values(diagnostics[-1])["clock"] == "waiting for its first message"
        assert poses == []
        clock.run(100 * SECOND, 100 * SECOND + 400 * MS)
        peer.until(lambda: bool(poses) and stamp(poses[-1]) == 100 * SECOND + 400 * MS, "motion to the clock's end")
        # One metre per second since the clock began.
        assert poses[-1].pose.position.x == pytest.approx(0.4, rel=1e-12)
        peer.until(lambda: values(diagnostics[-1])["clock: pauses"] == "1", "the pause counted")
        assert stamp(poses[-1]) == 100 * SECOND + 400 * MS
        clock.run(50 * SECOND, 50 * SECOND + 200 * MS)
        peer.until(
            lambda: 0 <= stamp(poses[-1]) - 50 * SECOND >= 190 * MS and stamp(poses[-1]) < 51 * SECOND, "the new time"
        )
        # The jump back moves the stamps, and the body goes on.
        assert poses[-1].pose.position.x == pytest.approx(0.4 + (stamp(poses[-1]) - 50 * SECOND) / SECOND, abs=1e-9)
        peer.until(lambda: values(diagnostics[-1])["clock: jumps back"] == "1", "the jump counted")
        assert node.stop() == 0


def test_a_clock_of_negative_time_is_rejected_and_counted(moving: Path, peer: Peer) -> None:
    with running(moving, use_sim_time=True) as node:
        poses, diagnostics = peer.listen(PoseStamped, "pose"), peer.diagnostics()
        clock = ClockHand(peer)
        peer.until(lambda: bool(diagnostics), "diagnostics")
        clock.show(-5 * SECOND)
        peer.until(lambda: values(diagnostics[-1])["clock: rejected"] == "1", "the message counted")
        assert diagnostics[-1].status[0].level == b"\x01"
        clock.run(100 * SECOND, 100 * SECOND + 200 * MS)
        peer.until(lambda: bool(poses) and stamp(poses[-1]) == 100 * SECOND + 200 * MS, "motion")
        assert node.stop() == 0, node.err


def test_what_our_own_pause_leaves_out_is_not_made_up_for(moving: Path, peer: Peer) -> None:
    with running(moving, use_sim_time=True) as node:
        poses, diagnostics = peer.listen(PoseStamped, "pose"), peer.diagnostics()
        clock = ClockHand(peer)
        # The poses of a clock that stands still come once: they must not come before there is a reader.
        peer.until(lambda: bool(diagnostics), "diagnostics")
        clock.run(10 * SECOND, 10 * SECOND + 100 * MS)
        peer.until(lambda: bool(poses) and stamp(poses[-1]) == 10 * SECOND + 100 * MS, "motion")
        assert peer.call("rigid_body/pause", SetBool.Request(data=True)).success
        clock.run(10 * SECOND + 100 * MS, 15 * SECOND)
        assert peer.call("rigid_body/pause", SetBool.Request(data=False)).success
        clock.run(15 * SECOND, 15 * SECOND + 100 * MS)
        peer.until(lambda: stamp(poses[-1]) >= 15 * SECOND + 80 * MS, "motion again")
        assert poses[-1].pose.position.x < 0.25
        assert node.stop() == 0


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"publish_clock": True}, "wait for its own clock"),
        ({"lockstep": True}, "commands move time"),
        ({"real_time_factor": 2.0}, "sets the pace"),
    ],
)
def test_there_is_one_master_of_time(scene: Path, parameters: dict[str, object], expected: str) -> None:
    refused = command(*node_arguments(scene, use_sim_time=True, **parameters))
    assert refused.returncode == 2
    assert expected in refused.stderr


def test_in_real_time_stamps_are_ros_time_and_commands_stamped_in_it_act_at_their_stamps(
    moving: Path, peer: Peer, tmp_path: Path
) -> None:
    log, now = tmp_path / "run.mcap", peer.node.get_clock().now
    begun = now().nanoseconds
    with running(moving, apply_at="stamp", mcap=log, log_latency=True, deadline=0.01) as node:
        poses, inertia = peer.listen(PoseStamped, "pose"), peer.listen(InertiaStamped, "inertia", TRANSIENT)
        diagnostics = peer.diagnostics()
        peer.until(lambda: bool(poses and inertia and diagnostics), "motion")
        assert begun < stamp(poses[-1]) < now().nanoseconds
        assert begun < stamp(inertia[0]) < now().nanoseconds
        assert values(diagnostics[0])["stamps"] == "ROS time"
        begin = now().nanoseconds + 6 * SECOND // 10
        acts = [begin, begin + SECOND // 4]
        peer.wrench(force=(2.0, 0.0, 0.0), frame_id="world", stamp_ns=acts[0])
        peer.wrench(stamp_ns=acts[1])
        peer.until(lambda: stamp(poses[-1]) > acts[1], "the end of the push")
        # Each was sent more than 10 ms before its stamp.
        peer.until(lambda: values(diagnostics[-1])["wrench: missed"] == "2", "the missed deadlines counted")
        assert peer.call("rigid_body/pause", SetBool.Request(data=True)).success
        peer.spin(0.3)
        resumed = now().nanoseconds
        assert stamp(poses[-1]) < resumed
        assert peer.call("rigid_body/pause", SetBool.Request(data=False)).success
        peer.until(lambda: stamp(poses[-1]) > resumed, "stamps that are ROS time again")
        assert node.stop() == 0
    bag = read_bag(log)
    times, rows = bag.poses("/pose")
    assert times[0] == 0
    # That of the time after the pause.
    assert stamp(poses[-1]) - int(bag.metadata["rb_dynamics.epoch"]["epoch_ns"]) in times
    (first, _), (last, _) = bag.wrenches("/wrench")
    assert last - first == SECOND // 4
    assert [wrench.stamp_ns for _, wrench in bag.wrenches("/wrench")] == acts
    # 1 m/s^2 from one stamp to the other, beside 1 m/s from the start.
    moved = rows[-1, 0] - times[-1] / SECOND
    assert moved == pytest.approx(0.25 * (0.125 + (times[-1] - last) / SECOND), rel=1e-9)
    assert replay(log).identical
    # When each was sent, came and acted; acting at the stamp is as punctual as the machine.
    sent, rows = bag.vectors("/wrench/latency")
    assert all(begun < each < act for each, act in zip(sent, acts, strict=True))
    assert (rows[:, 0] > 0.0).all()
    for each, act, (transport, waiting, number) in zip(sent, acts, rows, strict=True):
        assert (act - each) / SECOND == pytest.approx(transport + waiting, abs=0.5)
        assert number > 0
    looked = command("inspect", str(log))
    assert looked.returncode == 0, looked.stdout
    assert re.search(r"^LATENCY .* largest \[ms\]$", looked.stdout, re.MULTILINE)
    assert "t = 0 is ROS time" in looked.stdout
    assert re.search(r"/wrench, from sending to acting; 0 sequence numbers are missing:\n .*#", looked.stdout)


@pytest.mark.parametrize(
    ("stamps", "beside"),
    [
        *(("ros", {name: value}) for name, value in (("lockstep", True), ("publish_clock", True))),
        *(("ros", {"real_time_factor": 0.0}), ("simulation", {"use_sim_time": True}), ("wall", {})),
    ],
)
def test_stamps_that_cannot_be_are_refused(moving: Path, peer: Peer, stamps: str, beside: dict[str, object]) -> None:
    given = {"scene": str(moving), "stamps": stamps, **beside}
    with pytest.raises(SceneError, match=f"parameter stamps: found '{stamps}'"):
        RigidBodyNode(context=peer.context, parameter_overrides=[Parameter(k, value=v) for k, v in given.items()])


def test_a_factor_makes_time_pass_faster(scene: Path, peer: Peer) -> None:
    with running(scene, real_time_factor=20.0, output_rate=10.0) as node:
        poses = peer.listen(PoseStamped, "pose")
        peer.until(lambda: len(poses) > 1, "motion")
        begun = stamp(poses[-1])
        peer.spin(1.0)
        # Slowness can only make it less: a wide bound, and yet no real time.
        assert stamp(poses[-1]) - begun > 3 * SECOND
        assert node.stop() == 0


def test_commands_by_stamp_early_late_twice_and_out_of_order(scene: Path, peer: Peer) -> None:
    with running(scene, start_paused=True, apply_at="stamp") as node:
        poses, diagnostics = peer.listen(PoseStamped, "pose"), peer.diagnostics()
        peer.until(lambda: bool(poses), "the greeting")

        def step(count: int) -> None:
            for _ in range(count):
                assert peer.call("rigid_body/step", Trigger.Request()).success
            peer.until(lambda: stamp(poses[-1]) % (10 * MS) == 0, "motion")

        def push(force: float, at_ms: int) -> None:
            peer.wrench(force=(force, 0.0, 0.0), frame_id="world", stamp_ns=at_ms * MS)

        def counted(name: str, number: int) -> None:
            peer.until(
                lambda: diagnostics and values(diagnostics[-1])[f"wrench: {name}"] == str(number), f"{name} counted"
            )

        push(2.0, 60)
        push(4.0, 40)
        push(6.0, 40)
        counted("accepted", 3)
        counted("early", 2)
        counted("duplicate", 1)
        step(2)
        peer.until(lambda: stamp(poses[-1]) == 20 * MS, "20 ms")
        push(8.0, 10)
        counted("late", 1)
        step(6)
        peer.until(lambda: stamp(poses[-1]) == 80 * MS, "80 ms")
        push(100.0, 50)
        counted("superseded", 1)
        step(1)
        peer.until(lambda: stamp(poses[-1]) == 90 * MS, "90 ms")
        assert node.stop() == 0
    # Two integrations of F(t) / 2 kg: 8 N in (20, 40) ms, 6 N in (40, 60) ms, 2 N from 60 ms on.
    v1, v2 = 4 * 0.02, 4 * 0.02 + 3 * 0.02
    expected = 2 * 0.02**2 + v1 * 0.02 + 1.5 * 0.02**2 + v2 * 0.03 + 0.5 * 0.03**2
    assert poses[-1].pose.position.x == pytest.approx(expected, rel=1e-11)
