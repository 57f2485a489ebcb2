"""Floods, silence, stalls, kills, full disks: the state survives, and diagnostics report the fault."""

from __future__ import annotations

import logging
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped, WrenchStamped
from rclpy.serialization import serialize_message
from ros_harness import Peer, running, stamp, values
from std_srvs.srv import SetBool, Trigger

from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.study.replay import replay

pytestmark = pytest.mark.ros
_log = logging.getLogger(__name__)

# Publishes so many wrenches a second for so long (s), of force 1 N but the last, which is 2 N; a machine that is busy
# takes longer for the same number. Prints how many, and in how many seconds.
STORM = """
import sys, time
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import serialize_message

rate, seconds = float(sys.argv[1]), float(sys.argv[2])
rclpy.init()
node = rclpy.create_node("storm")
publisher = node.create_publisher(WrenchStamped, "wrench", 1000)
message = WrenchStamped()
message.header.frame_id = "world"
message.wrench.force.x = 1.0
data = serialize_message(message)
while not publisher.get_subscription_count():
    time.sleep(0.01)
# The reader has to know of us too.
time.sleep(0.5)
begun, sent, count = time.monotonic(), 0, round(rate * seconds)
while sent < count:
    for _ in range(min(count, int((time.monotonic() - begun) * rate)) - sent):
        publisher.publish(data)
        sent += 1
    time.sleep(0.001)
message.wrench.force.x = 2.0
publisher.publish(message)
print(sent + 1, time.monotonic() - begun, flush=True)
time.sleep(600.0)
"""
# Reads odom and says so at the first.
READER = """
import rclpy
from nav_msgs.msg import Odometry

rclpy.init()
node = rclpy.create_node("reader")
node.create_subscription(Odometry, "odom", lambda _: print("odom", flush=True), 10)
rclpy.spin(node)
"""

# Reads eight topics and says so when each has come.
READER_OF_ALL = """
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Float64

rclpy.init()
node, heard = rclpy.create_node("reader"), set()
kinds = {"odom": Odometry, "pose": PoseStamped, "twist": TwistStamped}
kinds |= dict.fromkeys(("angular_momentum", "linear_momentum"), Vector3Stamped)
kinds |= dict.fromkeys(("energy/defect", "energy/kinetic", "energy/work"), Float64)
for topic, kind in kinds.items():
    node.create_subscription(kind, topic, lambda _, topic=topic: heard.add(topic), 10)
while len(heard) < len(kinds):
    rclpy.spin_once(node)
print("all", flush=True)
rclpy.spin(node)
"""


@contextmanager
def script(text: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen([sys.executable, "-c", text, *arguments], stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def momentum_per_second(momenta: list[Vector3Stamped], since_ns: int) -> float:
    """Return the force that acts, by the change of momentum over the samples from `since_ns` on."""
    first, last = next(m for m in momenta if stamp(m) >= since_ns), momenta[-1]
    return (last.vector.x - first.vector.x) / ((stamp(last) - stamp(first)) * 1e-9)


def unchanged(momenta: list[Vector3Stamped], length_ns: int) -> bool:
    """Return whether the momentum has stayed what it was `length_ns` before the newest sample, or longer."""
    last = momenta[-1]
    before = [m for m in momenta if stamp(m) <= stamp(last) - length_ns]
    return bool(before) and all(m.vector.x == last.vector.x for m in momenta[len(before) - 1 :])


def came_or_lost(diagnostics: list[DiagnosticArray]) -> int:
    """Return how many commands the newest report accounts for."""
    told = values(diagnostics[-1]) if diagnostics else {}
    return sum(int(told.get(f"wrench: {name}", "0")) for name in ("accepted", "rejected", "superseded", "lost"))


def test_a_subnormal_wrench_acts_and_harms_nothing(scene: Path, peer: Peer) -> None:
    with running(scene) as node:
        diagnostics, momenta = peer.diagnostics(), peer.listen(Vector3Stamped, "linear_momentum")
        peer.wrench(force=(5e-324, 0.0, -1e-310), torque=(1e-320, 0.0, 0.0), frame_id="world")
        peer.until(lambda: diagnostics and values(diagnostics[-1])["wrench: accepted"] == "1", "the command counted")
        count = len(momenta)
        peer.until(lambda: len(momenta) > count + 10, "motion")
        assert node.stop() == 0, node.err
    last = momenta[-1].vector
    assert all(map(math.isfinite, (last.x, last.y, last.z)))
    assert last.z < 0.0
    assert "nan" not in " ".join(values(diagnostics[-1]).values())


def test_a_wrench_that_nothing_can_follow_is_rejected_and_the_command_before_is_held(
    tmp_path: Path, peer: Peer
) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 2.5]}}\ninitial: {angular_velocity_body: [0.3, -0.2, 0.1]}\n"
        "wrenches: [{topic: wrench}, {topic: jet, max_force: 3, on_excess: clip}, {topic: push, max_force: 3}]\n"
        "solver: {method: rkmk4, step: 0.005}\n"
    )
    with running(scene, start_paused=True, mcap=tmp_path / "run.mcap") as node:
        diagnostics, momenta = peer.diagnostics(), peer.listen(Vector3Stamped, "linear_momentum")
        peer.wrench(force=(1.0, 0.0, 0.0), frame_id="world")
        peer.wrench(force=(1e308, 0.0, 0.0), frame_id="world")
        peer.wrench(force=(0.0, 1e200, 0.0))
        peer.wrench("jet", force=(30.0, 40.0, 0.0), frame_id="world")
        peer.wrench("push", force=(0.0, 40.0, 0.0), frame_id="world")

        def told(**expected: str) -> bool:
            shown = values(diagnostics[-1]) if diagnostics else {}
            return all(shown.get(name.replace("_", ": ")) == count for name, count in expected.items())

        peer.until(
            lambda: told(
                wrench_rejected="2", wrench_accepted="1", jet_clipped="1", jet_accepted="1", push_rejected="1"
            ),
            "every command counted",
        )
        # This one is seen to be too large when it is to act.
        peer.wrench(torque=(1e8, 2e8, 1e8))
        peer.until(lambda: told(wrench_accepted="1", wrench_rejected="3"), "the command taken back")
        peer.call("rigid_body/pause", SetBool.Request(data=False))
        peer.until(lambda: values(diagnostics[-1])["state"] == "running", "a node that runs")
        count = len(momenta)
        peer.until(lambda: len(momenta) > count + 10, "motion")
        assert values(diagnostics[-1])["state"] == "running"
        assert diagnostics[-1].status[0].level == b"\x01"
        assert node.stop() == 0, node.err
    assert "expected at most" in node.err
    assert "max_force = 3.0 N of the channel push" in node.err
    assert "not one step can be taken under it" in node.err
    assert momentum_per_second(momenta, stamp(momenta[-10])) == pytest.approx(1.0 + 1.8, rel=1e-9)
    assert replay(tmp_path / "run.mcap").identical


def test_bytes_that_are_no_wrench_are_rejected_and_the_next_command_acts(
    scene: Path, peer: Peer, tmp_path: Path
) -> None:
    good = WrenchStamped()
    good.header.frame_id = "world"
    data = serialize_message(good)
    # Nanoseconds beyond a second, in the last second that a stamp has.
    beyond = b"\xff\xff\xff\x7f" + b"\xff" * 4
    log = tmp_path / "run.mcap"
    with running(scene, mcap=str(log)) as node:
        diagnostics = peer.diagnostics()
        publisher = peer.node.create_publisher(WrenchStamped, "wrench", 10)
        peer.until(lambda: publisher.get_subscription_count() > 0, "the node listening")
        for bad in (data[:-8], data[:6], data.replace(b"world", b"w\xff\xfe\xffd"), data[:4] + beyond + data[12:]):
            publisher.publish(bad)
        publisher.publish(data)
        peer.until(lambda: diagnostics and values(diagnostics[-1])["wrench: accepted"] == "1", "the good one counted")
        assert values(diagnostics[-1])["wrench: rejected"] == "4"
        assert node.stop() == 0, node.err
    assert "UTF-8" in node.err
    assert "a log has stopped" not in node.err


def test_a_frame_of_megabytes_is_neither_repeated_nor_logged(scene: Path, peer: Peer, tmp_path: Path) -> None:
    with running(scene, mcap=str(tmp_path / "run.mcap")) as node:
        diagnostics = peer.diagnostics()
        peer.wrench(frame_id="x" * 3_000_000)
        peer.until(lambda: diagnostics and values(diagnostics[-1])["wrench: rejected"] == "1", "the command counted")
        assert node.stop() == 0, node.err
    assert "expected one of" in diagnostics[-1].status[0].message
    assert len(diagnostics[-1].status[0].message) < 2000
    assert len(node.err) < 10_000
    assert (tmp_path / "run.mcap").stat().st_size < 3_000_000


def test_a_storm_of_commands_leaves_the_last_one_acting_and_each_accounted_for(
    scene: Path, peer: Peer, tmp_path: Path
) -> None:
    log = tmp_path / "run.mcap"
    with running(scene, mcap=log, stamps="simulation") as node:
        diagnostics, momenta = peer.diagnostics(), peer.listen(Vector3Stamped, "linear_momentum")
        with script(STORM, "20000", "0.5") as storm:
            assert storm.stdout is not None
            sent, seconds = storm.stdout.readline().split()
            assert sent == "10001"
            peer.until(lambda: came_or_lost(diagnostics) == 10_001, "every command accounted for")
            # An output period after what diagnostics saw, and more.
            begun = stamp(diagnostics[-1]) + 100_000_000
            peer.until(lambda: stamp(momenta[-1]) > begun + 500_000_000, "motion after the storm")
            assert momentum_per_second(momenta, begun) == pytest.approx(2.0, rel=1e-9)
        # The commander is dead: what it commanded last is held, as the channel has no timeout.
        begun = stamp(momenta[-1])
        peer.until(lambda: stamp(momenta[-1]) > begun + 1_500_000_000, "motion without a commander")
        assert momentum_per_second(momenta, begun) == pytest.approx(2.0, rel=1e-9)
        assert node.stop() == 0, node.err
    told = values(diagnostics[-1])
    accepted, lost = int(told["wrench: accepted"]), int(told["wrench: lost"])
    _log.info("%s commands in %s s: %d accepted, %d replaced by newer ones", sent, seconds, accepted, lost)
    assert accepted + lost == int(sent)
    assert accepted > 1000
    assert {told[f"wrench: {name}"] for name in ("rejected", "early", "late", "duplicate", "superseded")} == {"0"}
    if lost:
        assert diagnostics[-1].status[0].level == b"\x01"
        assert "commands lost in transport" in node.err
    # N s for 1 N, then 2 N: the books close, whatever was left out.
    assert float(told["linear momentum defect"].split()[0]) < 1e-9
    assert float(told["energy defect"].split()[0]) < 1e-9
    bag = read_bag(log)
    assert bag.complete
    assert len(bag.wrenches("/wrench")) == accepted


@pytest.mark.slow
def test_in_lockstep_a_command_that_was_replaced_before_it_came_stops_time(tmp_path: Path, peer: Peer) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\nwrenches: [{topic: wrench}]\n")
    with running(scene, lockstep=True) as node:
        diagnostics = peer.diagnostics()
        commander = peer.node.create_publisher(WrenchStamped, "wrench", 5)
        peer.until(lambda: commander.get_subscription_count() > 0, "a reader")
        message = WrenchStamped()
        commander.publish(message)
        peer.until(lambda: came_or_lost(diagnostics) == 1, "the first command")
        node.process.send_signal(signal.SIGSTOP)
        for nanoseconds in range(1, 8_001):
            message.header.stamp.nanosec = nanoseconds
            commander.publish(message)
        node.process.send_signal(signal.SIGCONT)
        peer.until(lambda: came_or_lost(diagnostics) == 8_001, "every command accounted for")
        assert node.stop() == 0, node.err
    assert "the motion no longer follows its commands" in diagnostics[-1].status[0].message
    assert values(diagnostics[-1])["state"] == "paused"


def test_a_timeout_ends_the_command_of_a_commander_that_died(tmp_path: Path, peer: Peer) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\nwrenches: [{topic: wrench, timeout: 0.2}]\n")
    with running(scene) as node:
        momenta = peer.listen(Vector3Stamped, "linear_momentum")
        with script(STORM, "100", "0.5"):
            peer.until(lambda: bool(momenta) and momenta[-1].vector.x > 0.0, "the command acting")
        # On a busy machine what was sent long ago is still to be read.
        peer.until(lambda: unchanged(momenta, 300_000_000), "the end of the command")
        assert node.stop() == 0, node.err


def test_a_reader_that_stalls_holds_up_nobody(scene: Path, peer: Peer) -> None:
    # In ROS time a lag that is dropped leaves stamps out.
    with running(scene, output_rate=200.0, stamps="simulation") as node, script(READER) as reader:
        diagnostics, momenta = peer.diagnostics(), peer.listen(Vector3Stamped, "linear_momentum")
        assert reader.stdout is not None
        reader.stdout.readline()
        peer.until(lambda: bool(momenta), "motion")
        reader.send_signal(signal.SIGSTOP)
        first, count = stamp(momenta[-1]), len(momenta)
        peer.spin(1.5)
        expected = round((stamp(momenta[-1]) - first) / 5_000_000)  # the start is stamped 1 ns
        assert expected > 100
        assert len(momenta) - count == expected
        reader.send_signal(signal.SIGCONT)
        assert node.stop() == 0, node.err
    assert values(diagnostics[-1])["state"] == "running"


def test_a_reader_of_all_topics_that_stalls_holds_up_no_end_of_a_run(scene: Path, peer: Peer) -> None:
    """Its answers were waited for at each topic in turn, before the logs were closed: 3 s at 16 topics."""
    with running(scene) as node, script(READER_OF_ALL) as reader:
        assert reader.stdout is not None
        reader.stdout.readline()
        peer.call("/rigid_body/pause", SetBool.Request(data=False))
        reader.send_signal(signal.SIGSTOP)
        peer.spin(0.5)
        begun = time.monotonic()
        assert peer.call("/rigid_body/reset", Trigger.Request()).success
        assert time.monotonic() - begun < 1.0
        reader.send_signal(signal.SIGCONT)
        assert node.stop() == 0, node.err


def test_a_stopped_process_goes_on_from_where_it_was(scene: Path, peer: Peer) -> None:
    with running(scene) as node:
        diagnostics, momenta = peer.diagnostics(), peer.listen(Vector3Stamped, "angular_momentum")
        peer.until(lambda: len(momenta) > 10, "motion")
        node.process.send_signal(signal.SIGSTOP)
        peer.spin(2.0)
        before = momenta[-1]
        node.process.send_signal(signal.SIGCONT)
        told = len(diagnostics)
        peer.until(lambda: len(diagnostics) > told + 1 and stamp(momenta[-1]) > stamp(before), "motion")
        assert node.stop() == 0, node.err
    # The books are continuous; the time that passed meanwhile is given up, and said.
    assert momenta[-1].vector.y == pytest.approx(before.vector.y, rel=1e-12)
    assert int(values(diagnostics[-1])["overruns"]) >= 1
    assert float(values(diagnostics[-1])["time dropped"].split()[0]) > 1.5
    assert "fell behind" in diagnostics[-1].status[0].message


def test_a_killed_node_leaves_a_log_that_opens(scene: Path, peer: Peer, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    with running(scene, mcap=log, stamps="simulation") as node:
        momenta = peer.listen(Vector3Stamped, "angular_momentum")
        peer.until(lambda: bool(momenta) and stamp(momenta[-1]) > 2_000_000_000, "two seconds of motion")
        heard = stamp(momenta[-1])
        assert node.stop(signal.SIGKILL) == -signal.SIGKILL
    bag = read_bag(log)
    assert not bag.complete
    times, _ = bag.poses("/pose")
    # Half a second, and as much again for a machine that is busy.
    assert times[-1] > heard - 1_000_000_000


def test_a_full_disk_stops_the_log_and_not_the_body(scene: Path, peer: Peer, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    with running(scene, mcap=log, stamps="simulation") as node:
        diagnostics, momenta = peer.diagnostics(), peer.listen(Vector3Stamped, "angular_momentum")
        # The index takes the room of what was logged last, four flushes at most.
        peer.until(lambda: bool(momenta) and stamp(momenta[-1]) > 4_000_000_000, "four seconds of motion")
        room = log.stat().st_size + 20_000
        resource.prlimit(node.process.pid, resource.RLIMIT_FSIZE, (room, room))
        peer.until(
            lambda: bool(diagnostics) and "a log has stopped" in diagnostics[-1].status[0].message,
            "the failure in diagnostics",
        )
        count = len(momenta)
        peer.until(lambda: len(momenta) > count + 10, "motion without a log")
        assert node.stop() == 0, node.err
    assert diagnostics[-1].status[0].level == b"\x02"
    assert log.stat().st_size <= room
    assert len(read_bag(log).poses("/pose")[0]) > 10


@pytest.mark.parametrize("kind", ["mcap", pytest.param("bag", marks=pytest.mark.slow)])
def test_a_log_that_is_removed_is_missed(scene: Path, peer: Peer, tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "logs"
    log = folder / "run.mcap"
    with running(scene, **{kind: log}) as node:
        diagnostics, momenta = peer.diagnostics(), peer.listen(Vector3Stamped, "angular_momentum")
        peer.until(lambda: len(momenta) > 10, "motion")
        shutil.rmtree(folder)
        peer.until(
            lambda: bool(diagnostics) and "was deleted" in diagnostics[-1].status[0].message,
            "the failure in diagnostics",
        )
        count, told = len(momenta), len(diagnostics)
        peer.until(lambda: len(momenta) > count + 10 and len(diagnostics) > told + 1, "motion without a log")
        assert "was deleted" in diagnostics[-1].status[0].message
        assert peer.call("rigid_body/reset", Trigger.Request()).success
        told = len(diagnostics)
        peer.until(lambda: len(diagnostics) > told + 1, "a new log")
        assert diagnostics[-1].status[0].level < b"\x02", diagnostics[-1].status[0].message
        assert node.stop() == 0, node.err
    assert node.err.count("was deleted") == 1
    assert read_bag(log).complete


def test_a_log_that_cannot_be_opened_at_a_reset_was_not_removed(scene: Path, peer: Peer, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    with running(scene, mcap=folder / "run.mcap") as node:
        diagnostics = peer.diagnostics()
        peer.call("rigid_body/pause", SetBool.Request(data=True))
        folder.rename(tmp_path / "elsewhere")
        folder.write_text("a file now")
        answer = peer.call("rigid_body/reset", Trigger.Request())
        assert not answer.success
        assert "a log has stopped" in answer.message
        told = len(diagnostics)
        peer.until(lambda: len(diagnostics) > told + 2, "diagnostics")
        assert "a log has stopped" in diagnostics[-1].status[0].message
        assert node.stop() == 0, node.err


def test_a_scene_that_changes_on_disk_changes_nothing_until_the_next_start(scene: Path, peer: Peer) -> None:
    with running(scene, stamps="simulation") as node:
        momenta = peer.listen(Vector3Stamped, "angular_momentum")
        peer.until(lambda: len(momenta) > 10, "motion")
        scene.write_text("no scene any more: [")
        before = stamp(momenta[-1])
        assert peer.call("rigid_body/reset", Trigger.Request()).success
        peer.until(lambda: stamp(momenta[-1]) < before, "a new run")
        assert momenta[-1].vector.y == pytest.approx(-0.4, rel=1e-12)
        scene.unlink()
        count = len(momenta)
        peer.until(lambda: len(momenta) > count + 10, "motion without a scene file")
        assert node.stop() == 0, node.err


# Starts and stops the whole node so many times in one process; prints its memory (kB) and open files ever and anon.
CYCLES = """
import os, sys
from pathlib import Path
from rb_dynamics.ros.node import spin

scene, log, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
for cycle in range(count + 1):
    spin(["--ros-args", "--log-level", "error", "-p", f"scene:={scene}", "-p", "real_time_factor:=0.0",
          "-p", f"mcap:={log}"])
    os.unlink(log)
    if cycle % (count // 10) == 0:
        status = Path("/proc/self/status").read_text()
        memory = next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS"))
        threads = len(os.listdir("/proc/self/task"))
        print(memory, len(os.listdir("/proc/self/fd")), threads, flush=True)
"""


def start_and_stop(tmp_path: Path, cycles: int) -> list[list[int]]:
    scene = tmp_path / "scene.yaml"
    scene.write_text("body: {mass: 1, inertia: {diagonal: [1, 2, 2.5]}}\nwrenches: [{topic: wrench}]\nduration: 0.02\n")
    result = subprocess.run(
        [sys.executable, "-c", CYCLES, str(scene), str(tmp_path / "run.mcap"), str(cycles)],
        capture_output=True,
        text=True,
        check=True,
    )
    return [[int(number) for number in line.split()] for line in result.stdout.splitlines()]


def test_ten_starts_and_stops_leave_no_file_and_no_thread_open(tmp_path: Path) -> None:
    seen = start_and_stop(tmp_path, 10)
    assert len({(files, threads) for _, files, threads in seen[3:]}) == 1


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_thousand_starts_and_stops_leak_nothing(tmp_path: Path) -> None:
    seen = start_and_stop(tmp_path, 1000)
    assert len({(files, threads) for _, files, threads in seen[1:]}) == 1
    # kB for each cycle, once everything has been used.
    assert (seen[-1][0] - seen[1][0]) / 900 < 2.0


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_a_soak_keeps_its_memory_and_its_books(scene: Path, peer: Peer, tmp_path: Path) -> None:
    """Half an hour at 200 Hz with a bag, readers and 50 commands a second; RB_DYNAMICS_SOAK_S makes it shorter.

    A bag in pieces, as for a week: the index of a file stays in memory until its end.

    `--log-cli-level=INFO` shows the memory.
    """
    seconds = float(os.environ.get("RB_DYNAMICS_SOAK_S", "1800"))
    log = tmp_path / "flight"
    with running(scene, output_rate=200.0, bag=log, max_bag_duration=60.0) as node:
        diagnostics, momenta = peer.diagnostics(), peer.listen(Vector3Stamped, "angular_momentum")
        begun, memories, sent = time.monotonic(), [], 0
        while (passed := time.monotonic() - begun) < seconds:
            peer.wrench(torque=(0.1 * math.sin(passed), 0.1 * math.cos(passed), 0.0))
            sent += 1
            peer.spin(0.02)
            if len(memories) < passed / seconds * 20:
                memories.append(memory(node.process.pid))
            del momenta[:-1], diagnostics[:-1]
        peer.until(lambda: int(values(diagnostics[-1])["wrench: accepted"]) == sent, "every command counted")
        told = values(diagnostics[-1])
        assert node.stop() == 0, node.err
    _log.info("%d commands in %g s; memory over that time, kB: %s", sent, seconds, memories)
    assert (told["wrench: lost"], told["wrench: rejected"]) == ("0", "0")
    assert float(told["energy defect"].split()[0]) < 1e-9
    # kB; the first tenth is for what is allocated once.
    assert max(memories[2:]) - memories[2] < 2000
    assert read_bag(log).complete


def memory(pid: int) -> int:
    """Return the resident memory of a process, kB."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")))
