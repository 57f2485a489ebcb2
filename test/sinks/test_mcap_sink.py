"""The MCAP log, read back with rosbags and with the reader of the mcap package."""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import math
import os
import random
import struct
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import LogError
from rb_dynamics.formats.mcap_writer import CHUNK_BYTES
from rb_dynamics.formats.message_definitions import TYPE_HASHES
from rb_dynamics.loads.wrench import Wrench, WrenchFrames
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.messages import COMMAND_DEPTH, sample_depth
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.sink import AppliedWrench, Event, RejectedWrench, RunInfo, Status
from rb_dynamics.scene.model import Channel, Scene, Solver
from rb_dynamics.scene.read import parse_scene
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink
from rb_dynamics.sinks.memory_sink import MemorySink
from rb_dynamics.sinks.state_hash import StateHash
from rb_dynamics.study.replay import replay

pytest.importorskip("mcap")

from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

INERTIA = ((0.2975, 0.0021, -0.0008), (0.0021, 0.2930, 0.0013), (-0.0008, 0.0013, 0.3104))

TYPES = {
    "/pose": "geometry_msgs/msg/PoseStamped",
    "/twist": "geometry_msgs/msg/TwistStamped",
    "/odom": "nav_msgs/msg/Odometry",
    "/angular_momentum": "geometry_msgs/msg/Vector3Stamped",
    "/linear_momentum": "geometry_msgs/msg/Vector3Stamped",
    "/energy/kinetic": "std_msgs/msg/Float64",
    "/energy/work": "std_msgs/msg/Float64",
    "/energy/defect": "std_msgs/msg/Float64",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/inertia": "geometry_msgs/msg/InertiaStamped",
    "/wrench": "geometry_msgs/msg/WrenchStamped",
    "/wrench/applied": "geometry_msgs/msg/WrenchStamped",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


def make_run(*topics: str) -> RunInfo:
    scene = Scene(
        body=RigidBody.from_matrix(16.8, INERTIA, (0.1, -0.2, 0.3)),
        frames=WrenchFrames("inertial", "satellite"),
        initial=State(),
        channels=tuple(map(Channel, topics or ("wrench",))),
        text="body: {mass: 16.8}  # Größe\n",
    )
    return RunInfo(scene, "rk4", {"seed": "", "platform": "here", "scene_file": "gr\udcfcn.yaml"})


def make_samples(count: int, step_ns: int = 10_000_000) -> list[Sample]:
    source = random.Random(5)

    def numbers(length: int) -> Any:
        return tuple(source.uniform(-10.0, 10.0) for _ in range(length))

    def attitude() -> Any:
        four = numbers(4)
        return tuple(component / math.hypot(*four) for component in four)

    return [
        Sample(
            time_ns=i * step_ns,
            position_world=numbers(3),
            orientation_xyzw=attitude(),
            linear_velocity_world=numbers(3),
            angular_velocity_body=numbers(3),
            angular_momentum_world=numbers(3),
            linear_momentum_world=numbers(3),
            kinetic_energy=numbers(1)[0],
            work=numbers(1)[0],
            energy_defect=numbers(1)[0],
            angular_momentum_defect_world=numbers(3),
            linear_momentum_defect_world=numbers(3),
        )
        for i in range(count)
    ]


def write(path: Path, events: Iterable[Event], run: RunInfo | None = None, **arguments: Any) -> Path:
    sink = McapSink(path, **arguments)
    sink.open(run or make_run())
    for event in events:
        sink.write(event)
    sink.close({"steps": "7"})
    return path


class Rosbags:
    """Every message of a file as rosbags understands it, by the definitions in the file itself."""

    def __init__(self, path: Path) -> None:
        from rosbags.highlevel import AnyReader

        self.times: dict[str, list[int]] = {}
        self.messages: dict[str, list[Any]] = {}
        with AnyReader([path]) as reader:
            self.connections = {each.topic: each for each in reader.connections}
            for connection, time_ns, data in reader.messages():
                self.times.setdefault(connection.topic, []).append(time_ns)
                self.messages.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))


def triple(vector: Any) -> tuple[float, float, float]:
    return (vector.x, vector.y, vector.z)


def stamp(message: Any) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def raw_messages(path: Path) -> list[tuple[str, Message]]:
    with path.open("rb") as file:
        return [(channel.topic, each) for _, channel, each in make_reader(file, validate_crcs=True).iter_messages()]


def test_samples_come_back_exactly(tmp_path: Path) -> None:
    from scipy.spatial.transform import Rotation

    samples = make_samples(40)
    bag = Rosbags(write(tmp_path / "run.mcap", samples))
    times = [sample.time_ns for sample in samples]
    for topic in list(TYPES)[:8]:
        assert bag.times[topic] == times
    rows = zip(*(bag.messages[topic] for topic in list(TYPES)[:8]), strict=True)
    for sample, (pose, twist, odom, angular, linear, kinetic, work, defect) in zip(samples, rows, strict=True):
        assert [stamp(each) for each in (pose, twist, odom, angular, linear)] == [sample.time_ns] * 5
        assert [each.header.frame_id for each in (pose, odom, angular, linear)] == ["inertial"] * 4
        assert (twist.header.frame_id, odom.child_frame_id) == ("satellite", "satellite")
        for stated in (pose.pose, odom.pose.pose):
            assert triple(stated.position) == sample.position_world
            assert (*triple(stated.orientation), stated.orientation.w) == sample.orientation_xyzw
        expected = Rotation.from_quat(sample.orientation_xyzw).inv().apply(sample.linear_velocity_world)
        for stated in (twist.twist, odom.twist.twist):
            assert triple(stated.angular) == sample.angular_velocity_body
            assert triple(stated.linear) == pytest.approx(expected, rel=1e-13, abs=1e-13)
        assert not odom.pose.covariance.any()
        assert not odom.twist.covariance.any()
        assert triple(angular.vector) == sample.angular_momentum_world
        assert triple(linear.vector) == sample.linear_momentum_world
        assert (kinetic.data, work.data, defect.data) == (sample.kinetic_energy, sample.work, sample.energy_defect)


def test_inertia_is_about_the_centre_of_mass_with_the_entries_of_the_matrix(tmp_path: Path) -> None:
    bag = Rosbags(write(tmp_path / "run.mcap", []))
    (message,) = bag.messages["/inertia"]
    content = message.inertia
    assert message.header.frame_id == "satellite"
    assert (content.m, triple(content.com)) == (16.8, (0.1, -0.2, 0.3))
    assert (content.ixx, content.ixy, content.ixz) == INERTIA[0]
    assert (content.iyy, content.iyz, content.izz) == (INERTIA[1][1], INERTIA[1][2], INERTIA[2][2])


def test_every_channel_is_declared_even_without_messages(tmp_path: Path) -> None:
    bag = Rosbags(write(tmp_path / "run.mcap", []))
    assert {topic: each.msgtype for topic, each in bag.connections.items()} == TYPES
    assert list(bag.messages) == ["/inertia"]


def test_wrenches_as_received_and_as_applied(tmp_path: Path) -> None:
    command = Wrench((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), "thruster_1", 90_000_000)
    early = Wrench((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), "", -5)
    path = write(
        tmp_path / "run.mcap",
        [
            AppliedWrench(100_000_000, "wrench", command, "satellite", (7.0, 8.0, 9.0), (0.5, 0.25, 0.125)),
            AppliedWrench(200_000_000, "wrench", None, "satellite", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
            AppliedWrench(300_000_000, "wrench", early, "satellite", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ],
    )
    bag = Rosbags(path)
    first, second = bag.messages["/wrench"]
    assert (first.header.frame_id, stamp(first)) == ("thruster_1", 90_000_000)
    assert (triple(first.wrench.force), triple(first.wrench.torque)) == (command.force, command.torque)
    assert (second.header.frame_id, stamp(second)) == ("", -5)
    applied = bag.messages["/wrench/applied"]
    assert [stamp(each) for each in applied] == [100_000_000, 200_000_000, 300_000_000]
    assert {each.header.frame_id for each in applied} == {"satellite"}
    assert (triple(applied[0].wrench.force), triple(applied[0].wrench.torque)) == ((7, 8, 9), (0.5, 0.25, 0.125))
    assert triple(applied[1].wrench.force) == (0, 0, 0)
    times = [(each.log_time, each.publish_time) for topic, each in raw_messages(path) if topic == "/wrench"]
    assert times == [(100_000_000, 100_000_000), (300_000_000, 300_000_000)]


def test_what_was_rejected_was_received_all_the_same(tmp_path: Path) -> None:
    command = Wrench((math.nan, 0.0, 0.0), (0.0, 0.0, 0.0), "nowhere", 7)
    bag = Rosbags(write(tmp_path / "run.mcap", [RejectedWrench(9, "wrench", command, "not finite")]))
    (message,) = bag.messages["/wrench"]
    assert (message.header.frame_id, stamp(message)) == ("nowhere", 7)
    assert math.isnan(message.wrench.force.x)
    assert "/wrench/applied" not in bag.messages


def test_what_is_beyond_double_precision_is_rejected_and_logged_as_infinite(tmp_path: Path) -> None:
    scene = parse_scene("body: {mass: 1, inertia: {diagonal: [1, 2, 2.5]}}\nwrenches: [{topic: push}]\nduration: 1")
    path = tmp_path / "run.mcap"
    run = simulate(scene, [("push", Wrench((10**400, 0, -(10**309))))], [McapSink(path)])

    assert "wrench force is (inf, 0.0, -inf), expected three components (N): three finite numbers" in run.rejected[0]
    [received] = [m for topic, m in raw_messages(path) if topic.endswith("/push")]
    assert struct.unpack_from("<3d", received.data, len(received.data) - 48) == (math.inf, 0.0, -math.inf)


def test_status_is_a_diagnostic_array(tmp_path: Path) -> None:
    status = Status(5, 1, "log is slow: \udcff", {"dropped": "3", "": ""})
    (message,) = Rosbags(write(tmp_path / "run.mcap", [status])).messages["/diagnostics"]
    (entry,) = message.status
    assert stamp(message) == 5
    assert (entry.level, entry.name, entry.hardware_id) == (1, "rb_dynamics", "satellite")
    assert entry.message == "log is slow: ?"
    assert [(pair.key, pair.value) for pair in entry.values] == [("dropped", "3"), ("", "")]


def test_container_says_what_ros_expects(tmp_path: Path) -> None:
    from rosbags.rosbag2.metadata import dump_qos_v9

    path = write(tmp_path / "run.mcap", make_samples(3))
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        assert reader.get_header().library.startswith("rb_dynamics ")
        summary = reader.get_summary()
        metadata = {each.name: each.metadata for each in reader.iter_metadata()}
        attachments = [(each.name, each.media_type, each.data) for each in reader.iter_attachments()]
    assert summary is not None
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (schema.name, schema.encoding, channel.message_encoding) == (TYPES[channel.topic], "ros2msg", "cdr")
        assert channel.metadata["topic_type_hash"] == TYPE_HASHES[schema.name]
    for topic, connection in Rosbags(path).connections.items():
        written = next(each for each in summary.channels.values() if each.topic == topic).metadata[
            "offered_qos_profiles"
        ]
        assert dump_qos_v9(connection.ext.offered_qos_profiles) == yaml.safe_load(written)
        (profile,) = yaml.safe_load(written)
        assert profile["durability"] == ("transient_local" if topic == "/inertia" else "volatile")
        latest_only, commands = topic in ("/inertia", "/diagnostics"), TYPES[topic].endswith("WrenchStamped")
        assert profile["depth"] == (1 if latest_only else COMMAND_DEPTH if commands else sample_depth(make_run().scene))

        assert (profile["history"], profile["reliability"]) == ("keep_last", "reliable")
        for duration in ("deadline", "lifespan", "liveliness_lease_duration"):
            # What rmw calls infinite: 2^63 - 1 ns.
            assert profile[duration]["sec"] * 10**9 + profile[duration]["nsec"] == 2**63 - 1
    assert metadata["rb_dynamics"] == {"method": "rk4", "seed": "", "platform": "here", "scene_file": "gr?n.yaml"}
    assert metadata["rb_dynamics.result"]["steps"] == "7"
    assert attachments == [("scene.yaml", "application/yaml", make_run().scene.text.encode())]


@pytest.mark.parametrize(
    ("rate", "step", "depth"), [(1e2, None, 50), (1.0, None, 10), (1e4, None, 1000), (0.0, 0.01, 50)]
)
def test_half_a_second_of_samples_waits_for_a_busy_reader(rate: float, step: float | None, depth: int) -> None:
    scene = dataclasses.replace(make_run().scene, output_rate=rate, solver=Solver(step=step))
    assert sample_depth(scene) == depth


def test_hash_of_the_states_is_over_all_numbers_in_order(tmp_path: Path) -> None:
    def hashed(samples: list[Sample]) -> tuple[str, str]:
        states, expected = StateHash(), hashlib.sha256()
        for sample in samples:
            states.update(sample)
            expected.update(struct.pack("<q", sample.time_ns))
            for name in Sample.__slots__[1:]:
                if getattr(sample, name) is not None:
                    expected.update(np.atleast_1d(getattr(sample, name)).astype("<f8").tobytes())
        return states.hexdigest(), expected.hexdigest()

    samples = make_samples(5)
    found, expected = hashed(samples)
    bag = read_bag(write(tmp_path / "run.mcap", samples))
    assert bag.metadata["rb_dynamics.result"]["states_sha256"] == found == expected
    found, expected = hashed([dataclasses.replace(sample, potential_energy=-3.7) for sample in samples])
    assert found == expected


def test_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    names, by_size = ("one.mcap", "two.mcap"), LogSettings(flush_s=0.0)
    one, two = (write(tmp_path / name, make_samples(500), settings=by_size).read_bytes() for name in names)
    assert one == two


@pytest.mark.parametrize("namespace", ["sat_1", "/sat_1", "/sat_1/"])
def test_names_with_namespace_and_remapping(tmp_path: Path, namespace: str) -> None:
    remap = {"pose": "/truth/pose", "thrust": "/control/thrust", "/ground/push/applied": "/elsewhere"}
    run = make_run("thrust", "wheel", "/ground/push")
    bag = Rosbags(write(tmp_path / "run.mcap", [], run, namespace=namespace, remap=remap))
    assert set(bag.connections) >= {
        "/truth/pose",
        "/sat_1/twist",
        "/sat_1/energy/work",
        "/control/thrust",
        "/control/thrust/applied",
        "/sat_1/wheel",
        "/sat_1/wheel/applied",
        "/ground/push",
        "/elsewhere",
        "/diagnostics",
    }


@pytest.mark.parametrize("remap", [{"a": "/pose"}, {"b": "/a/applied"}])
def test_channels_of_one_name_are_refused_before_the_file_is_touched(tmp_path: Path, remap: dict[str, str]) -> None:
    path = tmp_path / "run.mcap"
    path.write_text("an earlier log")
    with pytest.raises(LogError, match="twice"):
        McapSink(path, remap=remap).open(make_run("a", "b"))
    assert path.read_text() == "an earlier log"


def test_nothing_is_touched_before_open(tmp_path: Path) -> None:
    McapSink(tmp_path / "a" / "run.mcap").close({})
    assert not list(tmp_path.iterdir())


def test_folders_are_made_and_an_earlier_file_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "run.mcap"
    write(path, make_samples(2000))
    write(path, make_samples(2))
    assert read_bag(path).topics["/pose"].count == 2


def test_a_directory_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"cannot write .*directory"):
        McapSink(tmp_path).open(make_run())


def test_a_path_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match=r"cannot write .*run\.mcap"):
        McapSink(tmp_path / "file" / "run.mcap").open(make_run())


def test_open_leaves_a_readable_file_with_all_channels(tmp_path: Path) -> None:
    sink = McapSink(tmp_path / "run.mcap")
    sink.open(make_run())
    bag = read_bag(tmp_path / "run.mcap")
    sink.close({})
    assert not bag.complete
    assert {name: topic.type_name for name, topic in bag.topics.items()} == TYPES
    assert bag.topics["/inertia"].count == 1
    assert bag.metadata["rb_dynamics"]["method"] == "rk4"
    assert bag.attachments["scene.yaml"] == make_run().scene.text.encode()


def test_without_close_at_most_a_chunk_is_missing_and_flush_saves_that(tmp_path: Path) -> None:
    samples = make_samples(1000)
    sink = McapSink(tmp_path / "run.mcap", settings=LogSettings(flush_s=0.0))
    sink.open(make_run())
    for sample in samples:
        sink.write(sample)
    there = read_bag(tmp_path / "run.mcap").topics["/pose"].count
    bytes_per_sample = 2200
    assert 0 < len(samples) - there <= CHUNK_BYTES / bytes_per_sample + 60
    sink.flush()
    assert read_bag(tmp_path / "run.mcap").topics["/pose"].count == len(samples)
    sink.close({})


def test_what_waits_for_its_chunk_is_flushed_though_nothing_more_is_written(tmp_path: Path) -> None:
    sink = McapSink(tmp_path / "run.mcap", settings=LogSettings(flush_s=0.01))
    sink.open(make_run())
    sink.write(make_samples(1)[0])
    give_up = time.monotonic() + 30.0
    while not read_bag(tmp_path / "run.mcap").topics["/pose"].count and time.monotonic() < give_up:
        time.sleep(0.01)
    assert read_bag(tmp_path / "run.mcap").topics["/pose"].count == 1
    sink.close({})


def test_a_flush_after_the_end_does_nothing(tmp_path: Path) -> None:
    path, states = tmp_path / "run.mcap", StateHash()
    sink = McapSink(path, states=states)
    sink.open(make_run())
    for sample in make_samples(3):
        sink.write(sample)
    sink.close({})
    before = path.read_bytes()
    states.update(make_samples(1)[0])
    sink.flush()
    assert path.read_bytes() == before


def test_a_full_disk_at_open_is_a_clear_error() -> None:
    full = Path("/dev/full")
    if not full.is_char_device():
        pytest.skip("this system has no /dev/full")
    sink = McapSink(full)
    with pytest.raises(LogError, match="No space left on device"):
        sink.open(make_run())
    sink.close({})


@pytest.fixture
def small_files() -> Iterator[int]:
    """Limit the size of files of this process; yield the limit."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    limit = 3 * CHUNK_BYTES
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    yield limit
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_disk_that_fills_up_leaves_what_was_written(tmp_path: Path, small_files: int) -> None:
    path = tmp_path / "run.mcap"
    sink = McapSink(path)
    sink.open(make_run())
    samples = make_samples(3000)

    def write_all() -> None:
        for sample in samples:
            sink.write(sample)

    with pytest.raises(LogError, match=r"run\.mcap: " + os.strerror(errno.EFBIG)):
        write_all()
    with pytest.raises(LogError, match=os.strerror(errno.EFBIG)):
        sink.flush()
    sink.close({})
    bag = read_bag(path)
    assert not bag.complete
    reason = bag.metadata["rb_dynamics.interrupted"]["reason"]
    # Readers go on from "the file was", and look for "cut off" to know that the end is missing.
    assert reason.startswith("cut off: cannot go on writing")
    assert os.strerror(errno.EFBIG) in reason
    assert "rb_dynamics.result" not in bag.metadata
    # Finished, with an index that counts what is there: it opens everywhere as it is.
    assert len(Rosbags(path).messages["/pose"]) == bag.topics["/pose"].count
    with path.open("rb") as file:
        statistics = make_reader(file).get_summary().statistics  # type: ignore[union-attr]
    assert statistics.message_count == sum(topic.count for topic in bag.topics.values())
    count = bag.topics["/pose"].count
    assert 100 < count < len(samples)
    np.testing.assert_array_equal(bag.poses("/pose")[1][:, :3], [each.position_world for each in samples[:count]])
    assert path.stat().st_size <= small_files


def test_a_time_that_no_stamp_can_hold_is_refused(tmp_path: Path) -> None:
    sink = McapSink(tmp_path / "run.mcap")
    sink.open(make_run())
    (sample,) = make_samples(1)
    with pytest.raises(LogError, match="2147483648000000000 ns"):
        sink.write(Sample(2**31 * 10**9, *(getattr(sample, name) for name in Sample.__slots__[1:])))
    sink.close({})


@pytest.mark.parametrize("installed", [True, False])
def test_zstd_where_it_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, installed: bool) -> None:
    if not installed:
        monkeypatch.setitem(sys.modules, "zstandard", None)
    path = write(tmp_path / "run.mcap", make_samples(10))
    monkeypatch.undo()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert {index.compression for index in summary.chunk_indexes} == {"zstd" if installed else ""}
    assert len(Rosbags(path).messages["/pose"]) == 10


def test_checksums_hold_and_log_times_never_decrease(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", make_samples(300))
    with path.open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    times = [each.log_time for each in records if isinstance(each, Message)]
    assert len(times) == 1 + 9 * 300
    assert times == sorted(times)


def test_viewers_find_the_body_in_space_and_the_acceleration_where_asked(tmp_path: Path) -> None:
    scene = parse_scene(
        "world_frame: inertial\n"
        "body:\n  {frame: sat, mass: 2, inertia: {diagonal: [1, 2, 3]}, center_of_mass: [0.1, 0, 0],\n"
        "   frames: {thruster: {position: [0, 0.5, 0.2], orientation: {x: 0, y: 0, z: 1, w: 0}}}}\n"
        "initial: {angular_velocity_body: [0.1, 2, 0.1]}\nduration: 1\noutput_rate: 10\n"
    )
    path = tmp_path / "run.mcap"
    simulate(scene, sinks=[McapSink(path, namespace="/a", settings=LogSettings(accel=True))])
    messages = Rosbags(path).messages
    for pose, transforms in zip(messages["/a/pose"], messages["/tf"], strict=True):
        (each,) = transforms.transforms
        assert (each.header.frame_id, each.child_frame_id, stamp(each)) == ("inertial", "sat", stamp(pose))
        assert each.transform.rotation == pose.pose.orientation
        where = each.transform.translation
        assert (where.x, where.y, where.z) == (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z)
    (fixed,) = messages["/tf_static"]
    (thruster,) = fixed.transforms
    assert (thruster.header.frame_id, thruster.child_frame_id) == ("sat", "thruster")
    assert (thruster.transform.translation.z, thruster.transform.rotation.z) == (0.2, 1.0)
    # At the start w = (0.1, 2, 0.1): Euler's equations and r'' = dw x r + w x (w x r) of the origin, r = -c.
    acceleration = messages["/a/accel"][0].accel
    assert acceleration.angular.x == pytest.approx(-0.2, rel=1e-14)
    assert acceleration.linear.x == pytest.approx(0.1 * (2.0**2 + 0.1**2), rel=1e-14)
    assert replay(path).identical


def test_the_loader_of_rerun_shows_all_of_it(tmp_path: Path) -> None:
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun-sdk cannot read MCAP from Python")
    if not hasattr(chunk, "McapReader"):
        pytest.skip("this rerun-sdk cannot read MCAP from Python")
    path, memory = write(tmp_path / "run.mcap", make_samples(20)), make_samples(20)
    found: dict[tuple[str, str], list[Any]] = {}
    for each in chunk.McapReader(path).stream().to_chunks():
        batch = each.to_record_batch()
        for name in batch.schema.names:
            rows = [row for row in batch.column(name).to_pylist() if row is not None]
            found.setdefault((each.entity_path, name), []).extend(rows)
    twists = [row["twist"] for (row,) in found["/twist", "geometry_msgs.msg.TwistStamped:message"]]
    assert [twist["angular"]["y"] for twist in twists] == [sample.angular_velocity_body[1] for sample in memory]
    # What has a place in space is shown there, in single precision.
    for topic, name in (("/pose", "InstancePoses3D:translations"), ("/tf", "Transform3D:translation")):
        places = [np.float32(sample.position_world).tolist() for sample in memory]
        assert [place for (place,) in found[topic, name]] == places
    told = {name for name, topic in read_bag(path).topics.items() if topic.count}
    assert {topic for topic, name in found if name == "McapChannel:topic"} == told
    assert found["/__mcap_attachments", "media_type"] == [["application/yaml"]]
    assert ("/__mcap_metadata", "rb_dynamics.result") in found


def test_effects_are_in_the_log(tmp_path: Path) -> None:
    """Potential energy has a topic, held effects are applied wrenches, and the others are listed by name."""
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 1\noutput_rate: 10\neffects: "
        "[{type: uniform_gravity, acceleration_world: [0, 0, -9]}, {type: linear_drag, translation: 0.1}]"
    )
    path, memory = tmp_path / "run.mcap", MemorySink()
    simulate(scene, sinks=[McapSink(path), memory])

    bag = read_bag(path)
    assert bag.scalars("/energy/potential")[1].tolist() == memory.potential_energy.tolist()
    ((_, wrench),) = bag.wrenches("/effects/uniform_gravity/applied")
    assert (wrench.force, wrench.frame_id) == ((0.0, 0.0, -18.0), "world")
    assert "/effects/uniform_gravity" not in bag.topics
    assert bag.metadata["rb_dynamics"]["effects"] == "uniform_gravity, linear_drag"
    assert bag.metadata["rb_dynamics"]["effects_not_logged_as_wrench"] == "linear_drag"
