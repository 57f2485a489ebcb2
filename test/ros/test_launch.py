"""The launch files, run by launch itself if installed, from a prefix like that of a colcon workspace."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

pytest.importorskip("launch_ros", reason="launch_ros is not installed: it is not on PyPI")

from geometry_msgs.msg import InertiaStamped, PoseWithCovarianceStamped, TwistWithCovarianceStamped
from launch.launch_description_sources import get_launch_description_from_python_launch_file
from nav_msgs.msg import Odometry
from ros_harness import ROOT, TRANSIENT, Peer
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from rb_dynamics.logs.bag_reader import read_bag

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("signals_of_a_terminal")]

# What `ros2 launch` does with a launch file and NAME:=VALUE.
LAUNCH = """
import sys
from launch import LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource

arguments = [tuple(each.split(":=", 1)) for each in sys.argv[2:]]
service = LaunchService()
service.include_launch_description(
    IncludeLaunchDescription(AnyLaunchDescriptionSource(sys.argv[1]), launch_arguments=arguments)
)
sys.exit(service.run())
"""
NODE = f"""\
#!/bin/sh
exec {sys.executable} -c 'import sys; from rb_dynamics.ros.node import main; sys.exit(main())' "$@"
"""
# In the place of RViz: writes down what it was started with.
RVIZ = '#!/bin/sh\necho "$@" > "$0.arguments"\n'


def install(prefix: Path, package: str, executable: str, script: str) -> None:
    (prefix / "lib" / package).mkdir(parents=True)
    path = prefix / "lib" / package / executable
    path.write_text(script)
    path.chmod(0o755)
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True, exist_ok=True)
    (index / package).touch()


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An install prefix with the package that launch finds."""
    path = tmp_path / "prefix"
    install(path, "rb_dynamics", "rigid_body", NODE)
    for folder in ("config", "launch"):
        shutil.copytree(ROOT / folder, path / "share" / "rb_dynamics" / folder)
    monkeypatch.setenv(
        "AMENT_PREFIX_PATH", os.pathsep.join(filter(None, [str(path), os.environ.get("AMENT_PREFIX_PATH")]))
    )
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros"))
    return path


class Launch:
    """A launch file that runs."""

    def __init__(self, prefix: Path, file: str, *arguments: str) -> None:
        self._path = prefix / "said.txt"
        with self._path.open("w") as said:
            self.process = subprocess.Popen(
                [sys.executable, "-c", LAUNCH, str(prefix / "share" / "rb_dynamics" / "launch" / file), *arguments],
                stdout=said,
                stderr=subprocess.STDOUT,
                cwd=ROOT,
            )

    @property
    def said(self) -> str:
        return self._path.read_text()

    def stop(self) -> int:
        """Interrupt as Ctrl-C does, and return the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(30)


@contextmanager
def launched(prefix: Path, file: str, *arguments: str) -> Iterator[Launch]:
    launch = Launch(prefix, file, *arguments)
    try:
        yield launch
    finally:
        if launch.process.poll() is None:
            launch.stop()


def test_the_arguments_reach_the_node_and_ctrl_c_closes_the_log(scene: Path, peer: Peer, prefix: Path) -> None:
    log, params = prefix / "run.mcap", prefix / "bringup.yaml"
    # What is given goes before the file; the rest of it holds.
    params.write_text("/**: {ros__parameters: {output_rate: 5.0, publish_accel: true, controller.gain: 2.0}}\n")
    with launched(
        prefix,
        "rigid_body.launch.py",
        f"scene:={scene}",
        "namespace:=robot_1",
        "output_rate:=20",
        "overrides:={body.mass: 17, initial.position_world: [0, 1, 2.5]}",
        f"mcap:={log}",
        "publish_clock:=true",
        "launch-prefix:=nice -n 5",
        "name:=ship",
        f"params_file:={params}",
    ) as launch:
        odometry = peer.listen(Odometry, "/robot_1/odom")
        inertia, clock = peer.listen(InertiaStamped, "/robot_1/inertia", TRANSIENT), peer.listen(Clock, "/clock")
        peer.until(lambda: peer.node.count_publishers("/robot_1/accel") > 0, "what the file asks for")
        assert "/robot_1/ship/pause" in dict(peer.node.get_service_names_and_types())
        peer.until(lambda: len(odometry) > 5 and bool(inertia) and bool(clock), "motion")
        (pid,) = re.findall(r"process started with pid \[(\d+)\]", launch.said)
        assert os.getpriority(os.PRIO_PROCESS, int(pid)) == 5 + os.getpriority(os.PRIO_PROCESS, 0)
        assert launch.stop() == 0, launch.said
    assert "process has finished cleanly" in launch.said
    assert inertia[0].inertia.m == 17.0
    position = odometry[0].pose.pose.position
    assert (position.x, position.y, position.z) == (0.0, 1.0, 2.5)
    bag = read_bag(log)
    assert bag.complete
    times, _ = bag.poses("/robot_1/pose")
    assert times[1] - times[0] == 50_000_000


def test_the_clock_of_another_is_followed(scene: Path, peer: Peer, prefix: Path) -> None:
    ticks = peer.node.create_publisher(Clock, "/clock", 1)
    tick = Clock()
    tick.clock.sec = 100
    with launched(prefix, "rigid_body.launch.py", f"scene:={scene}", "use_sim_time:=true") as launch:
        odometry = peer.listen(Odometry, "/odom")

        def moved() -> bool:
            tick.clock.nanosec += 1_000_000
            ticks.publish(tick)
            return len(odometry) > 2

        peer.until(moved, "motion by the clock")
        assert launch.stop() == 0, launch.said
    assert odometry[-1].header.stamp.sec == 100


def test_bodies_of_a_file_have_the_time_of_the_first(scene: Path, peer: Peer, prefix: Path) -> None:
    file = prefix / "bodies.yaml"
    chaser = f"{{scene: {scene}, initial: {{position_world: [0, 1.5, 2]}}, body.mass: 3}}"
    file.write_text(f"bodies:\n  target: {{scene: {scene}}}\n  chaser: {chaser}\n")
    with launched(prefix, "bodies.launch.py", f"scene:={file}", "publish_clock:=true") as launch:
        inertia = peer.listen(InertiaStamped, "/chaser/inertia", TRANSIENT)
        odometry = [peer.listen(Odometry, f"/{name}/odom") for name in ("target", "chaser")]
        peer.until(lambda: all(odometry) and bool(inertia), "motion of both")
        assert peer.call("/target/rigid_body/pause", SetBool.Request(data=True)).success
        peer.spin(0.3)
        stood = odometry[1][-1].header.stamp
        peer.spin(0.2)
        assert odometry[1][-1].header.stamp == stood
        assert launch.stop() == 0, launch.said
    position = odometry[1][0].pose.pose.position
    assert (position.x, position.y, position.z) == (0.0, 1.5, 2.0)
    assert inertia[0].inertia.m == 3.0
    assert odometry[1][0].child_frame_id == "chaser"


@pytest.mark.parametrize("namespace", ["", "fleet"])
def test_bodies_have_namespaces_frames_and_logs_of_their_own(
    scene: Path, peer: Peer, prefix: Path, namespace: str
) -> None:
    arguments = (f"scene:={scene}", "count:=2", "spacing:=[0, 3.0, 0.5]", "prefix:=robot_", f"namespace:={namespace}")
    logs = (f"mcap:={prefix}/run.mcap", f"overrides:={{body.mass: 4.0, sink: [bag={prefix}/flight]}}")
    root = f"/{namespace}" if namespace else ""
    with launched(prefix, "bodies.launch.py", *arguments, *logs) as launch:
        odometry = [peer.listen(Odometry, f"{root}/robot_{k}/odom") for k in (1, 2)]
        peer.until(lambda: all(odometry), "motion of both")
        assert launch.stop() == 0, launch.said
    assert launch.said.count("process has finished cleanly") == 2
    assert [each[0].pose.pose.position.y for each in odometry] == [0.0, 3.0]
    assert odometry[1][0].pose.pose.position.z == 0.5
    assert [each[0].child_frame_id for each in odometry] == ["robot_1", "robot_2"]
    for k in (1, 2):
        for log in ("run_robot_{}.mcap", "flight_robot_{}"):
            bag = read_bag(prefix / log.format(k))
            assert bag.complete
            assert f"{root}/robot_{k}/pose" in bag.topics


@pytest.mark.parametrize("namespace", ["", "robot_1"])
def test_rviz_opens_the_layout_on_the_topics_of_the_node(scene: Path, prefix: Path, namespace: str) -> None:
    install(prefix, "rviz2", "rviz2", RVIZ)
    arguments = (f"scene:={scene}", "rviz:=true", f"namespace:={namespace}", "overrides:={duration: 0.1}")
    with launched(prefix, "rigid_body.launch.py", *arguments) as launch:
        assert launch.process.wait(60) == 0
    said = (prefix / "lib" / "rviz2" / "rviz2.arguments").read_text()
    layout = prefix / "share" / "rb_dynamics" / "config" / "rigid_body.rviz"
    assert f"-d {layout} " in said
    drawn = {
        display["Topic"]["Value"]
        for display in yaml.safe_load(layout.read_text())["Visualization Manager"]["Displays"]
        if "Topic" in display
    }
    assert set(re.findall(r"-r (/\w+):=\w+", said)) == drawn
    assert all(f"-r {topic}:={topic[1:]}" in said for topic in drawn)
    assert f"__ns:=/{namespace}" in said


@pytest.mark.parametrize(
    ("file", "argument", "expected"),
    [
        ("rigid_body", "lockstep:=yes", "argument lockstep: found 'yes', expected true or false"),
        ("rigid_body", "output_rate:=fast", "argument output_rate: found 'fast', expected a number"),
        ("rigid_body", "overrides:=5", "argument overrides: found '5', expected values by name"),
        ("rigid_body", "overrides:={body.mass: 1", "argument overrides: found"),
        ("rigid_body", "rviz:=true", "rviz2"),
        ("bodies", "count:=two", "argument count: found 'two', expected a whole number"),
        ("bodies", "spacing:=[1, 2]", "argument spacing: found '[1, 2]', expected metres along y"),
        ("bodies", "count:=0", "argument count: found 0, expected a number of bodies, 1 or more"),
        ("bodies", "overrides:=5", "argument overrides: found '5', expected values by name"),
    ],
)
def test_a_bad_argument_is_named_and_nothing_is_left_behind(
    scene: Path, prefix: Path, file: str, argument: str, expected: str
) -> None:
    with launched(prefix, f"{file}.launch.py", f"scene:={scene}", argument) as launch:
        assert launch.process.wait(60) == 1
    assert expected in launch.said
    assert "process started" not in launch.said


@pytest.mark.parametrize("file", ["rigid_body", "bodies"])
def test_every_argument_says_what_it_is_and_the_scene_is_required(file: str) -> None:
    description = get_launch_description_from_python_launch_file(str(ROOT / "launch" / f"{file}.launch.py"))
    arguments = description.get_launch_arguments()
    assert [each.name for each in arguments if each.default_value is None] == ["scene"]
    assert all(each.description for each in arguments)


def test_the_launch_file_of_the_docs_puts_the_node_in_the_place_of_a_vehicle(peer: Peer, prefix: Path) -> None:
    (text,) = re.findall(r"```python\n(from launch import.*?)```", (ROOT / "docs" / "ros.md").read_text(), re.DOTALL)
    (prefix / "share" / "rb_dynamics" / "launch" / "vehicle.launch.py").write_text(text)
    with launched(prefix, "vehicle.launch.py") as launch:
        poses = peer.listen(PoseWithCovarianceStamped, "/orca/pose")
        twists = peer.listen(TwistWithCovarianceStamped, "/orca/twist")
        peer.until(lambda: bool(poses and twists), "motion")
        assert peer.node.count_subscribers("/orca/wrench_input") == 1
        assert launch.stop() == 0, launch.said
    assert twists[0].header.frame_id == "base_link"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("ros2") is None, reason="ros2 is not installed: it is not on PyPI")
def test_what_is_checked_in_a_jazzy_holds(prefix: Path) -> None:
    done = subprocess.run(
        ["bash", str(ROOT / "tools" / "check_in_jazzy.sh")], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FAILED" not in done.stdout
    assert "ok      a BEST_EFFORT commander that stamps with now() turns the body" in done.stdout
