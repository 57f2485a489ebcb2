"""Bags that rosbags wrote, of what hypothesis made, as tables and recordings: every number, and where it comes from."""

from __future__ import annotations

import csv
import importlib.util
import math
import struct
import tempfile
import tracemalloc
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bag_rows import write_rows
from command_line import command
from foreign_bags import IMU, STORE, TF, header, imu, of, pose, transform, transforms, twist, write_bag
from hypothesis import given, settings
from hypothesis import strategies as st

from rb_dynamics.analysis.inspection import inspect
from rb_dynamics.analysis.read_track import TopicChoice, read_track
from rb_dynamics.cli import main
from rb_dynamics.conversion import bag_to_table
from rb_dynamics.conversion.bag_to_rerun import bag_to_rerun
from rb_dynamics.conversion.bag_to_table import FORCE, POSE_COVARIANCE, QUANTITIES, TORQUE, TWIST_COVARIANCE, table_of
from rb_dynamics.conversion.convert import to_table
from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.log_metadata import RUN
from rb_dynamics.formats.message_types import MAGNETIC_FIELD, ODOMETRY, POSE, QUATERNION
from rb_dynamics.formats.topic_messages import KEPT
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene import parse_scene
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.compare import compare

G = "geometry_msgs/msg/"
numbers = st.floats(allow_nan=False, width=64)
stamps = st.integers(0, 2**31 * 10**9 - 1)
frames = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=6)


@st.composite
def messages(draw: st.DrawFn) -> tuple[str, str, Any, list[dict[str, Any]]]:
    """Return topic, type, message, and the rows that a table has of it, without source, topic and log time."""
    kind = draw(st.sampled_from(["pose", "twist", "accel", "imu", "tf", "wrench", "value", "odom"]))
    stamp, frame, child = draw(stamps), draw(frames), draw(frames)
    values = draw(st.lists(numbers, min_size=16, max_size=16))
    told: dict[str, Any] = {"stamp_ns": stamp, "frame_id": frame}

    def put(name: str, axes: str, unit: str, begin: int) -> None:
        suffix = f"_{unit}" if unit else ""
        told.update({f"{name}_{axis}{suffix}": values[begin + k] for k, axis in enumerate(axes)})

    if kind == "pose":
        put("position", "xyz", "m", 0)
        put("orientation", "xyzw", "", 3)
        return "/pose", f"{G}PoseStamped", of("PoseStamped", header(stamp, frame), pose(values[:7])), [told]
    if kind == "twist":
        told = {}
        put("linear_velocity", "xyz", "m_s", 0)
        put("angular_velocity", "xyz", "rad_s", 3)
        return "/speed", f"{G}Twist", twist(values[:6]), [told]
    if kind == "accel":
        put("linear_acceleration", "xyz", "m_s2", 0)
        put("angular_acceleration", "xyz", "rad_s2", 3)
        parts = of("Accel", of("Vector3", *values[:3]), of("Vector3", *values[3:6]))
        return "/accel", f"{G}AccelStamped", of("AccelStamped", header(stamp, frame), parts), [told]
    if kind == "imu":
        measured = draw(st.tuples(*[st.booleans()] * 3))
        told["frame_id"] = "imu_link"
        for known, (name, axes, unit, begin) in zip(
            measured,
            [("orientation", "xyzw", "", 0), ("angular_velocity", "xyz", "rad_s", 4),
             ("linear_acceleration", "xyz", "m_s2", 7)], strict=True,
        ):  # fmt: skip
            if known:
                put(name, axes, unit, begin)
        return "/imu", IMU, imu(stamp, values[:4], values[4:7], values[7:10], measured), [told]
    if kind == "tf":
        told["child_frame_id"] = child
        put("position", "xyz", "m", 0)
        put("orientation", "xyzw", "", 3)
        return "/tf", TF, transforms([transform(stamp, frame, child, values[:7])]), [told]
    if kind == "odom":
        told["child_frame_id"] = child
        put("position", "xyz", "m", 0)
        put("orientation", "xyzw", "", 3)
        put("linear_velocity", "xyz", "m_s", 7)
        put("angular_velocity", "xyz", "rad_s", 10)
        zero = np.zeros(36)
        parts = of("PoseWithCovariance", pose(values[:7]), zero), of("TwistWithCovariance", twist(values[7:13]), zero)
        name = "nav_msgs/msg/Odometry"
        return "/odom", name, of(name, header(stamp, frame), child, *parts), [told]
    if kind == "wrench":
        put("force", "xyz", "N", 0)
        put("torque", "xyz", "N_m", 3)
        parts = of("Wrench", of("Vector3", *values[:3]), of("Vector3", *values[3:6]))
        return "/cmd", f"{G}WrenchStamped", of("WrenchStamped", header(stamp, frame), parts), [told]
    return "/value", "std_msgs/msg/Float64", of("std_msgs/msg/Float64", values[0]), [{"value": values[0]}]


def told_by(row: dict[str, Any]) -> dict[str, Any]:
    """Return the cells of a row that are not empty, without provenance."""
    kept = {name: cell for name, cell in row.items() if name not in ("source", "topic", "type", "log_time_ns")}
    return {name: cell for name, cell in kept.items() if cell not in (None, "")}


def bits(row: dict[str, Any]) -> dict[str, Any]:
    # A frame without a name is an empty cell of a CSV.
    return {
        name: struct.pack("<d", cell) if isinstance(cell, float) else cell for name, cell in row.items() if cell != ""
    }


@settings(max_examples=12)
@given(found=st.lists(messages(), min_size=1, max_size=8), sqlite=st.booleans(), parquet=st.booleans())
def test_a_table_has_every_number_and_where_it_comes_from(found: Any, sqlite: bool, parquet: bool) -> None:
    tables = pytest.importorskip("pyarrow.parquet") if parquet else None
    with tempfile.TemporaryDirectory() as folder:
        bag = write_bag(Path(folder, "bag"), [(t, k, 5 * n, m) for n, (t, k, m, _) in enumerate(found)], sqlite)
        target = Path(folder, "out.parquet" if parquet else "out.csv")
        assert to_table([bag], target) == [(target, len(found), "messages")]
        if tables is not None:
            rows = tables.read_table(target).to_pylist()
        else:
            with target.open(newline="", encoding="utf-8") as file:
                rows = [{name: cell if name in TEXTS else number(name, cell) for name, cell in row.items()}
                        for row in csv.DictReader(file)]  # fmt: skip
    assert [row["log_time_ns"] for row in rows] == [5 * n for n in range(len(found))]
    for row, (topic, kind, _, (told,)) in zip(rows, found, strict=True):
        assert row["source"] == str(bag)
        pair = f"/tf {told.get('frame_id')}:{told.get('child_frame_id')}"
        assert (row["topic"], row["type"]) == ((pair, f"{G}TransformStamped") if topic == "/tf" else (topic, kind))
        assert bits(told_by(row)) == bits(told)


TEXTS = ("source", "topic", "type", "frame_id", "child_frame_id")


def number(name: str, cell: str) -> Any:
    return None if cell == "" else int(cell) if name.endswith("_ns") else float(cell)


def test_units_stand_in_the_metadata_of_parquet(tmp_path: Path, example_dir: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    assert command("convert", example_dir / "slew.mcap", tmp_path / "slew.parquet").returncode == 0
    schema = parquet.read_schema(tmp_path / "slew.parquet")
    assert schema.field("angular_velocity_x_rad_s").metadata == {b"unit": b"rad/s"}
    table = parquet.read_table(tmp_path / "slew.parquet", filters=[("topic", "==", "/truth/pose")])
    assert table.num_rows == 601
    assert not any(map(math.isnan, table["orientation_w"].to_pylist()))


def test_named_topics_alone(tmp_path: Path, example_dir: Path) -> None:
    bag, target = example_dir / "slew.mcap", tmp_path / "slew.csv"
    assert (
        command("convert", bag, target, "--twist-topic", "truth/twist", "--wrench-topic", "/wrench/body").returncode
        == 0
    )
    with target.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["topic"] for row in rows} == {"/truth/twist", "/wrench/body"}
    assert "position_x_m" not in rows[0]
    found = command("convert", bag, target, "--pose-topic", "/nowhere")
    assert found.returncode == 2
    assert "found no topic nowhere" in found.stderr
    assert "/truth/pose (geometry_msgs/msg/PoseStamped)" in found.stderr
    assert command("convert", bag, tmp_path / "scene.yaml", "--pose-topic", "/truth/pose").returncode == 2


def damaged_bag(path: Path, bad: Sequence[int], count: int = 60) -> Path:
    """Return a bag of poses with covariances and transforms, of which the messages `bad` of each topic are cut."""
    kind, spread = f"{G}PoseWithCovarianceStamped", (0.0,) * 36
    rows = []
    for k in range(count):
        row = (0.1 * k, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        moved = STORE.serialize_cdr(transforms([transform(k, "map", "base", row)]), TF)
        for topic, name, data in (("/pose", kind, cdr.encode(kind, k, "map", row, spread)), ("/tf", TF, moved)):
            rows.append((topic, name, k, bytes(data)[:50] if k in bad else bytes(data)))
    return write_rows(path, rows, chunk_size=2000)


@pytest.mark.parametrize("bad", [(0,), (7, 8, 9, 10, 11, 12, 13, 14, 15), (59,)])
def test_damaged_messages_are_left_out_and_named(tmp_path: Path, bad: tuple[int, ...]) -> None:
    """As `inspect` does, in every format, whatever their number in a chunk of the file."""
    bag, target = damaged_bag(tmp_path / "bag.mcap", bad), tmp_path / "out.csv"
    left = f"{len(bad)} of 60 messages are cut short or damaged, the first is number {bad[0] + 1}\n"
    found = command("convert", bag, target, "--covariances")
    assert found.returncode == 1
    for topic in ("/pose", "/tf"):
        assert f"rb-dynamics: left out: {bag}: topic {topic}: {left}" in found.stderr
    with target.open(newline="") as file:
        rows = list(csv.DictReader(file))
    good = [k for k in range(60) if k not in bad]
    for topic in ("/pose", "/tf map:base"):
        shown = [(int(row["stamp_ns"]), float(row["position_x_m"])) for row in rows if row["topic"] == topic]
        assert shown == [(k, 0.1 * k) for k in good]
    found = command("convert", bag, target, "--frames", "map:base")
    assert (found.returncode, found.stderr) == (1, f"rb-dynamics: left out: {bag}: topic /tf: {left}")
    assert len(target.read_text().splitlines()) == 1 + len(good)
    found = command("convert", bag, target, "--pose-topic", "/pose", "--from", "0", "--to", "3e-9")
    assert found.returncode == (bad[0] <= 3)
    with pytest.raises(LogError, match="ends after 50 bytes"):
        to_table([bag], target)
    found = command("inspect", bag)
    assert [f"{topic} is whole: " in found.stdout for topic in ("/pose", "/tf")] == [True, True]
    assert found.stdout.count(left) == 2
    if importlib.util.find_spec("rerun"):
        found = command("convert", bag, tmp_path / "out.rrd")
        assert (found.returncode, found.stdout) == (1, f"wrote {tmp_path / 'out.rrd'}: {2 * len(good)} rows\n")
        assert left in found.stderr
    bag.write_bytes(bag.read_bytes()[:-4])
    found = command("convert", bag, target, "--frames", "map:base")
    assert (found.returncode, f"{bag} was cut off: what is missing is lost" in found.stderr) == (1, True)


def test_a_bag_of_which_no_message_can_be_read_is_refused(tmp_path: Path) -> None:
    bag, target = damaged_bag(tmp_path / "bad.mcap", range(60)), tmp_path / "out.csv"
    found = command("convert", bag, target)
    assert found.returncode == 2
    assert "ends after 50 bytes" in found.stderr
    good = damaged_bag(tmp_path / "good.mcap", ())
    found = command("convert", good, bag, target)
    assert (found.returncode, len(target.read_text().splitlines())) == (1, 121)
    assert "left out: topic /" in found.stderr


def test_each_covariance_has_its_unit() -> None:
    units = {column.name: column.unit for each in (POSE_COVARIANCE, TWIST_COVARIANCE) for column in each.columns}
    assert [units[f"pose_covariance_{pair}"] for pair in ("x_z", "x_rz", "ry_y", "rx_rx")] == [
        "m^2", "m rad", "m rad", "rad^2",
    ]  # fmt: skip
    assert [units[f"twist_covariance_{pair}"] for pair in ("x_z", "x_rz", "rx_rx")] == [
        "m^2/s^2", "m rad/s^2", "rad^2/s^2",
    ]  # fmt: skip


@pytest.mark.parametrize("sqlite", [False, True])
def test_covariances_have_a_column_for_each_element(tmp_path: Path, sqlite: bool) -> None:
    spread, name = np.arange(72.0).reshape(2, 36), "nav_msgs/msg/Odometry"
    still = pose([0.0, 0, 0, 0, 0, 0, 1]), twist(np.zeros(6))
    parts = of("PoseWithCovariance", still[0], spread[0]), of("TwistWithCovariance", still[1], spread[1])
    gyro = imu(3, [0.0, 0, 0, 1], [1.0, 2, 3], [0.0, 0, 9], (False, True, True))
    rows = [("/odom", name, 1, of(name, header(1, "odom"), "base", *parts)), ("/imu", IMU, 3, gyro)]
    bag, target = write_bag(tmp_path / "bag", rows, sqlite), tmp_path / "all.csv"
    assert command("convert", bag, target, "--covariances").returncode == 0
    with target.open(newline="") as file:
        odom, sensed = csv.DictReader(file)
    six = ("x", "y", "z", "rx", "ry", "rz")
    for kind, numbers in zip(("pose", "twist"), spread, strict=True):
        cells = [odom[f"{kind}_covariance_{row}_{column}"] for row in six for column in six]
        assert [float(cell) for cell in cells] == numbers.tolist()
    assert odom["orientation_covariance_x_x_rad2"] == sensed["orientation_covariance_x_x_rad2"] == ""
    assert sensed["pose_covariance_x_x"] == ""
    told = [float(sensed[f"angular_velocity_covariance_{axis}_{axis}_rad2_s2"]) for axis in "xyz"]
    assert told == [0.01, 0.0, 0.0]
    assert command("convert", bag, tmp_path / "plain.csv").returncode == 0
    assert "_covariance_x" not in (tmp_path / "plain.csv").read_text()


def test_the_pose_of_one_frame_in_another(tmp_path: Path) -> None:
    """Through all transforms between them: here a turn of 90 degrees about z, then a step of 2 m along the new x."""
    half = math.sqrt(0.5)
    rows = [
        ("/tf", TF, t, transforms([transform(t, "map", "base", [0.1 * k, 0.0, 0.0, 0.0, 0.0, half, half])]))
        for k, t in enumerate(range(10**9, 6 * 10**9, 10**9))
    ]
    rows.append(("/tf_static", TF, 0, transforms([transform(0, "base", "camera", [2.0, 0, 0, 0, 0, 0, 1.0])])))
    bag, target = write_bag(tmp_path / "bag", rows), tmp_path / "poses.csv"
    assert command("convert", bag, target, "--frames", "map:camera", "--from", "1").returncode == 0
    with target.open(newline="") as file:
        found = list(csv.DictReader(file))
    assert [int(row["stamp_ns"]) for row in found] == [k * 10**9 for k in range(2, 6)]
    assert {(row["frame_id"], row["child_frame_id"], row["log_time_ns"]) for row in found} == {("map", "camera", "")}
    assert {row["topic"] for row in found} == {"/tf map:base, /tf_static base:camera"}
    for k, row in enumerate(found, 1):
        place = [float(row[f"position_{axis}_m"]) for axis in "xyz"]
        assert place == pytest.approx([0.1 * k, 2.0, 0.0], abs=1e-15)
    refused = command("convert", bag, target, "--frames", "map:nowhere")
    assert refused.returncode == 2
    assert "nowhere" in refused.stderr
    without = write_bag(tmp_path / "without", [("/value", "std_msgs/msg/Float64", 1, of("std_msgs/msg/Float64", 1.0))])
    refused = command("convert", without, target, "--frames", "map:camera")
    assert "it has none at all: name a topic of a pose" in refused.stderr
    assert command("convert", bag, tmp_path / "a.rrd", "--frames", "map:camera").returncode == 2


def test_bags_become_one_file_and_a_log_becomes_a_bag(tmp_path: Path, example_dir: Path) -> None:
    log = tmp_path / "run.mcap"
    scene = parse_scene("body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\nduration: 0.1\n")
    simulate(scene, (), [McapSink(log)])
    bag, target = example_dir / "slew.mcap", tmp_path / "part.mcap"
    found = command("convert", bag, target, "--from", "10", "--to", "20")
    assert (found.returncode, found.stdout) == (0, f"wrote {target}: 406 messages\n")
    refused = command("convert", log, tmp_path / "samples.csv", "--covariances")
    assert refused.returncode == 2
    assert "samples have no covariances" in refused.stderr
    found = command("convert", bag, log, tmp_path / "both.mcap")
    assert found.returncode == 0
    assert "no run: replay needs the log itself" in found.stderr
    both = open_source(tmp_path / "both.mcap")
    assert sum(1 for _ in both.messages()) == sum(1 for each in (bag, log) for _ in open_source(each).messages())
    # Nothing takes it for a run; the scene is there all the same.
    assert (RUN in both.metadata, list(both.attachments)) == (False, ["run.scene.yaml"])


def test_logs_of_two_bodies_become_one_bag_if_their_topics_differ(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [tmp_path / "a.mcap", tmp_path / "b.mcap", tmp_path / "c.mcap"]
    for log, name, frame in zip(logs, "abb", ("body", "other", "body"), strict=True):
        body = f"{{frame: {frame}, mass: 1, inertia: {{diagonal: [1, 2, 3]}}}}"
        text = (
            f"body: {body}\ninitial: {{angular_velocity_body: [0.1, 1, 0]}}\nwrenches: [{{topic: push}}]\nduration: 1"
        )
        push = "push", Wrench((1.0 if name == "a" else 2.0, 0.0, 0.0), stamp_ns=10**8)
        simulate(parse_scene(text), [push], [McapSink(log, namespace=name)])
    target = tmp_path / "all.mcap"
    main(["convert", *map(str, logs[:2]), str(target)])
    assert capsys.readouterr().err.count("note: ") == 1
    # What acted on one body is not what acted on the other.
    track = read_track(read_bag(target), choice=TopicChoice("/b/pose", "/b/twist"))
    assert [each.topic for each in track.acting] == ["/b/push/applied"]
    assert not compare(target, logs[1], topics=TopicChoice("/b/pose", "/b/twist")).first_ns
    main(["convert", str(logs[0]), str(logs[2]), str(target)])
    assert "both move the frame body on /tf" in capsys.readouterr().err
    assert main(["convert", *map(str, logs), str(target)]) == 2
    said = capsys.readouterr().err
    assert "are two runs, both with /b/pose" in said
    # A part keeps the mass properties, which were said once, and is whole all the same.
    main(["convert", str(logs[0]), str(target), "--from", "0.2", "--to", "0.7"])
    assert read_track(read_bag(target)).body is not None
    assert all(each.passed for each in inspect(target).summary.checks if "is whole" in each.name)


def test_a_recording_of_a_bag(tmp_path: Path, example_dir: Path) -> None:
    pytest.importorskip("rerun")
    assert bag_to_rerun(example_dir / "slew.mcap", tmp_path / "slew.rrd") == 2402
    assert (tmp_path / "slew.rrd").stat().st_size > 100_000


def test_a_bag_without_quantities_is_refused_with_its_topics(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [("/chatter", "std_msgs/msg/String", 1, of("std_msgs/msg/String", "hello"))])
    for name in ("bag.csv", "bag.rrd"):
        found = command("convert", bag, tmp_path / name)
        assert found.returncode == 2
        assert "nothing to convert" in found.stderr
        assert "/chatter (std_msgs/msg/String)" in found.stderr


def test_memory_does_not_grow_with_the_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bag_to_table, "_ROWS", 1000)
    peaks = []
    for count in (20_000, 40_000):
        bag = wrench_log(tmp_path / f"{count}.mcap", count)
        tracemalloc.start()
        try:
            rows = sum(len(block[0] or ()) for block in table_of([bag], [FORCE, TORQUE]))
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
        assert rows == count
    assert peaks[1] < 1.2 * peaks[0]


def wrench_log(path: Path, count: int) -> Path:
    """Return a bag of so many wrenches, of 100 bytes each."""
    from rb_dynamics.formats import cdr
    from rb_dynamics.formats.channel_metadata import log_channel
    from rb_dynamics.formats.mcap_writer import McapWriter
    from rb_dynamics.formats.message_types import WRENCH
    from rb_dynamics.formats.output_file import OutputFile

    file = OutputFile(path)
    writer = McapWriter(file, "test")
    writer.begin()
    channel = writer.add_channel(log_channel("/w", WRENCH, ""))
    for k, row in enumerate(np.random.default_rng(1).standard_normal((count, 6)).tolist()):
        writer.add_messages((channel,), (cdr.encode(WRENCH, k, "body", row),), k, k)
    writer.finish()
    file.close()
    return path


def test_every_type_that_is_kept_has_quantities() -> None:
    assert {*QUANTITIES} == {*KEPT, QUATERNION, MAGNETIC_FIELD}


def test_the_messages_of_attitude_sensors_come_out_and_types_that_are_not_known_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = [
        ("/star", QUATERNION, 5, cdr.encode(QUATERNION, 3, "body", (0.0, 0.6, 0.0, 0.8))),
        ("/field", MAGNETIC_FIELD, 6, cdr.encode(MAGNETIC_FIELD, 4, "body", (1e-5, 2e-5, 3e-5), (0.0,) * 9)),
        ("/poses", "geometry_msgs/msg/PoseArray", 7, b""),
        ("/poses", "geometry_msgs/msg/PoseArray", 8, b""),
    ]
    bag, table = write_rows(tmp_path / "a.mcap", rows), tmp_path / "a.csv"
    (written,) = to_table([bag], table)
    star, field = csv.DictReader(table.read_text().splitlines())
    assert written.rows == 2
    assert [float(star[f"orientation_{axis}"]) for axis in "xyzw"] == [0.0, 0.6, 0.0, 0.8]
    assert (star["stamp_ns"], star["frame_id"]) == ("3", "body")
    assert [float(field[f"magnetic_field_{axis}_T"]) for axis in "xyz"] == [1e-5, 2e-5, 3e-5]
    assert "/poses (geometry_msgs/msg/PoseArray, 2 messages)" in caplog.text
    caplog.clear()
    to_table([bag], table, ["star"])
    assert not caplog.text


def test_a_topic_of_two_types_has_the_quantities_of_both_in_any_order_of_the_bags(tmp_path: Path) -> None:
    motion = (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
    odometry = cdr.encode(
        ODOMETRY, 1, "world", "body", motion, (0.0,) * 36, (4.0, 5.0, 6.0, 7.0, 8.0, 9.0), (0.0,) * 36
    )
    rows = ("/odom", ODOMETRY, 1, odometry), ("/odom", POSE, 2, cdr.encode(POSE, 2, "world", motion))
    bags = [write_rows(tmp_path / f"{k}.mcap", [row]) for k, row in enumerate(rows)]
    for paths in (bags, bags[::-1]):
        to_table(paths, tmp_path / "a.csv")
        table = csv.DictReader((tmp_path / "a.csv").read_text().splitlines())
        (found,) = (row for row in table if row["type"] == ODOMETRY)
        assert [float(found[f"angular_velocity_{axis}_rad_s"]) for axis in "xyz"] == [7.0, 8.0, 9.0]
