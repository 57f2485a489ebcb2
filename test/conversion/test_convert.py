"""Logs as tables and recordings, and tables of wrenches as bags, without loss of digits."""

from __future__ import annotations

import csv
import math
import shutil
from collections import Counter
from pathlib import Path

import pytest
from command_line import command

from rb_dynamics import Setpoint, Wrench, parse_scene, simulate
from rb_dynamics.conversion.convert import log_to_rerun, log_to_scene, table_to_bag, to_table
from rb_dynamics.errors import LogError
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.wrench_bags import read_wrenches
from rb_dynamics.scene.read import read_scene
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink
from rb_dynamics.sinks.memory_sink import MemorySink
from rb_dynamics.sinks.state_hash import HashSink
from rb_dynamics.study.replay import replay

SCENE = parse_scene(
    "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}, center_of_mass: [0.1, 0, 0.2]}\n"
    "initial: {angular_velocity_body: [0.1, 2, 0.1], linear_velocity_world: [1, 2, 3]}\n"
    "wrenches: [{topic: push}, {topic: a/turn}]\n"
    "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}]\nduration: 2\noutput_rate: 30\n"
)
COMMANDS = [
    ("push", Wrench((1.0, 2.0, 1 / 3), (0.1, 0.0, -0.1), "world", 0)),
    ("a/turn", Wrench((0.0, -0.0, 1e-300), (0.3, 0.2, 0.1), "", 333_333_333)),
    ("push", Wrench((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "body", 1_999_999_999)),
]
HEAD = "time_s,force_x,force_y,force_z,torque_x,torque_y,torque_z"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    simulate(SCENE, COMMANDS, [McapSink(tmp_path / "run.mcap")])
    return tmp_path / "run.mcap"


def check(columns: dict[str, list[float]]) -> None:
    """Compare the columns of a table with the run."""
    memory = MemorySink()
    simulate(SCENE, COMMANDS, [memory])
    assert columns["time_ns"] == memory.time_ns.tolist()
    for name in ("position_world", "angular_velocity_body", "angular_momentum_world", "linear_momentum_world"):
        rows = list(zip(*(columns[f"{name}_{axis}"] for axis in "xyz"), strict=True))
        assert rows == [tuple(row) for row in getattr(memory, name).tolist()]
    for name in ("kinetic_energy", "work", "energy_defect", "potential_energy"):
        assert columns[name] == getattr(memory, name).tolist()


def test_csv_has_every_digit(tmp_path: Path, log: Path) -> None:
    written = to_table([log], tmp_path / "run.csv")
    assert written == [(tmp_path / "run.csv", 61, "samples"), (tmp_path / "run.wrenches.csv", 3, "commands")]
    with (tmp_path / "run.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    check({name: [int(row[name]) if name == "time_ns" else float(row[name]) for row in rows] for name in rows[0]})


def test_parquet_has_the_same_numbers(tmp_path: Path, log: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    written = to_table([log], tmp_path / "run.parquet")
    assert [each.rows for each in written] == [61, 3]
    check(parquet.read_table(tmp_path / "run.parquet").to_pydict())
    commands = parquet.read_table(tmp_path / "run.wrenches.parquet").to_pydict()
    assert commands["topic"] == ["push", "a/turn", "push"]
    assert commands["force_z"] == [1 / 3, 1e-300, 0.0]


def test_sensors_and_wheels_that_samples_leave_out_are_named(
    tmp_path: Path, example_dir: Path, caplog: pytest.LogCaptureFixture
) -> None:
    log, table = tmp_path / "run.mcap", tmp_path / "run.csv"
    scene = read_scene(example_dir.parent / "config" / "wheels.yaml", {"duration": 1.0})
    simulate(scene, [], [McapSink(log)])
    to_table([log], table)
    assert "/tracker (geometry_msgs/msg/QuaternionStamped, 5 messages)" in caplog.text
    assert "in no table, inspect shows them: /wheels (sensor_msgs/msg/JointState, 11 messages)" in caplog.text
    with pytest.raises(LogError, match=r"nothing to convert, .*; those are .*/tracker .*: name one of these") as caught:
        to_table([log], table, ["/wheels"])
    assert "JointState" not in str(caught.value)
    (written,) = to_table([log], table, ["/tracker"])
    assert written.rows == 5


def test_the_acceleration_is_converted_too(tmp_path: Path) -> None:
    simulate(SCENE, COMMANDS, [McapSink(tmp_path / "run.mcap", settings=LogSettings(accel=True))])
    to_table([tmp_path / "run.mcap"], tmp_path / "run.csv")
    with (tmp_path / "run.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    topic = read_bag(tmp_path / "run.mcap").topics["/accel"]
    columns = [f"{kind}_acceleration_body_{axis}" for kind in ("linear", "angular") for axis in "xyz"]
    assert [[float(row[name]) for name in columns] for row in rows] == topic.numbers.tolist()


def test_several_runs_are_one_table_with_a_column_for_the_run(tmp_path: Path, log: Path) -> None:
    pytest.importorskip("pyarrow")
    import pyarrow.compute as pc
    from pyarrow import dataset, parquet

    other = tmp_path / "free.mcap"
    simulate(parse_scene("body: {mass: 1}\nduration: 1\noutput_rate: 10\n"), (), [McapSink(other)])
    written = to_table([log, other], tmp_path / "all.parquet")
    assert [each.rows for each in written] == [61 + 11, 3]
    table = dataset.dataset(tmp_path / "all.parquet").to_table(filter=pc.field("run") == str(other))
    assert table.num_rows == 11
    # This run has no potential.
    assert set(table["potential_energy"].to_pylist()) == {None}
    check(dataset.dataset(tmp_path / "all.parquet").to_table(filter=pc.field("run") == str(log)).to_pydict())
    schema = parquet.read_schema(tmp_path / "all.parquet")
    assert schema.field("angular_momentum_world_x").metadata == {b"unit": b"kg m^2/s"}
    assert set(parquet.read_table(tmp_path / "all.wrenches.parquet")["run"].to_pylist()) == {str(log)}


def test_one_bad_log_of_several_is_left_out_and_said(tmp_path: Path, log: Path) -> None:
    (tmp_path / "bad.mcap").write_bytes(b"no log")
    target = tmp_path / "all.csv"
    found = command("convert", log, tmp_path / "bad.mcap", target)
    assert found.returncode == 1
    assert "left out:" in found.stderr
    assert "bad.mcap" in found.stderr
    assert len(target.read_text().splitlines()) == 62
    assert command("convert", tmp_path / "bad.mcap", target).returncode == 2
    assert command("convert", tmp_path / "bad.mcap", tmp_path / "bad.mcap", target).returncode == 2
    assert command("convert", log, log, tmp_path / "all.rrd").returncode == 2


def test_wrenches_go_to_csv_and_back_to_the_same_run(tmp_path: Path, log: Path) -> None:
    to_table([log], tmp_path / "run.csv")
    assert table_to_bag(tmp_path / "run.wrenches.csv", tmp_path / "back.mcap") == 3
    commands = read_wrenches(tmp_path / "back.mcap", ["push", "a/turn"])
    assert commands == COMMANDS
    once, again = HashSink(), HashSink()
    simulate(SCENE, COMMANDS, [once])
    simulate(SCENE, commands, [again])
    assert once.hexdigest() == again.hexdigest()
    bag = read_bag(tmp_path / "back.mcap")
    assert bag.complete
    assert "reliable" in bag.topics["/push"].qos


def test_commands_of_an_earlier_log_do_not_stay_beside_the_samples_of_another(tmp_path: Path, log: Path) -> None:
    simulate(parse_scene("body: {mass: 1}\nduration: 1\noutput_rate: 10\n"), (), [McapSink(tmp_path / "free.mcap")])
    to_table([log], tmp_path / "run.csv")
    assert [each.rows for each in to_table([tmp_path / "free.mcap"], tmp_path / "run.csv")] == [11, 0]
    assert len((tmp_path / "run.wrenches.csv").read_text().splitlines()) == 1


@pytest.mark.parametrize("ending", ["csv", "rrd", "mcap"])
def test_a_part_of_the_time_in_which_nothing_was_recorded_is_refused(tmp_path: Path, log: Path, ending: str) -> None:
    found = command("convert", log, tmp_path / f"part.{ending}", "--from", "70")
    assert found.returncode == 2
    assert "found nothing from 70 s, expected a part of the recording, which goes from 0 to 2 s" in found.stderr
    assert not (tmp_path / f"part.{ending}").exists()


def test_commands_of_several_runs_are_not_those_of_one(tmp_path: Path, log: Path) -> None:
    """Both begin at time 0: each was taken to supersede the other."""
    other = tmp_path / "other.mcap"
    shutil.copyfile(log, other)
    table = to_table([log, other], tmp_path / "both.csv")[1].path
    with pytest.raises(LogError, match=r"line \d+, run: found .*other.mcap, expected one run, "):
        table_to_bag(table, tmp_path / "both.mcap")


def test_rows_of_a_table_stand_in_the_bag_in_the_order_of_time(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A run refused such a bag: the commands of a topic seemed to begin again."""
    table, bag = tmp_path / "jets.csv", tmp_path / "jets.mcap"
    table.write_text("time_s,topic,command\n0,a/command,1\n2,a/command,0\n1,b/command,1\n3,b/command,0\n")
    table_to_bag(table, bag)
    assert not caplog.text, "topics may follow each other"
    assert [message.log_time // 10**9 for message in open_source(bag).messages()] == [0, 1, 2, 3]
    table.write_text("time_s,topic,command\n2,a/command,1\n0,a/command,0\n")
    table_to_bag(table, bag)
    assert "jets.csv, line 3" in caplog.text
    assert [message.log_time // 10**9 for message in open_source(bag).messages()] == [0, 2]


def test_a_table_of_others_in_seconds(tmp_path: Path) -> None:
    table = tmp_path / "thrust.csv"
    table.write_text(HEAD + "\n100000000.000000001,1,2,3,4,5,6e-1\n0.5,0,0,0,0,0,0\n", encoding="utf-8-sig")
    table_to_bag(table, tmp_path / "thrust.mcap")
    first, second = (wrench for _, wrench in read_wrenches(tmp_path / "thrust.mcap", ["wrench"]))
    assert (first.stamp_ns, second.stamp_ns) == (500_000_000, 100_000_000_000_000_001)
    assert second.torque == (4.0, 5.0, 0.6)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", r"the columns are \[\], expected time_ns or time_s, and of wrenches force_x"),
        ("time_s,speed\n", "and of wrenches .*, of commands to actuators topic and command;"),
        (HEAD + "\n1,0,0,0,0,0,0\n2,0,0,x,0,0,0\n", "line 3, force_z: found 'x', expected a number"),
        (HEAD + "\n", "found no rows below the columns, expected commands"),
        (HEAD.replace("_s", "_ns", 1) + "\n1.5,0,0,0,0,0,0\n", "line 2, time_ns: found '1.5', expected a whole number"),
        (HEAD + "\nsoon,0,0,0,0,0,0\n", "line 2, time_s: found 'soon'"),
        (HEAD + "\n1e99999999,0,0,0,0,0,0\n", "line 2, time_s: found '1e99999999', expected a number"),
        (HEAD + "\n1e-99999999,0,0,0,0,0,0\n", "line 2, time_s: found '1e-99999999', expected a number"),
        (HEAD + "\n1_0,0,0,0,0,0,0\n", "line 2, time_s: found '1_0', expected a number"),
        (HEAD + "\n1/3,0,0,0,0,0,0\n", "line 2, time_s: found '1/3', expected a number"),
        (HEAD + "\n\u0663,0,0,0,0,0,0\n", "line 2, time_s: found '\u0663', expected a number"),
        (HEAD + "\n1,1_0,0,0,0,0,0\n", "line 2, force_x: found '1_0', expected a number"),
        (HEAD + "\n2147483648,0,0,0,0,0,0\n", r"line 2, time_s: found '2147483648', expected a time from 0 to 2\^31 s"),
        (HEAD + "\n-1,0,0,0,0,0,0\n", "expected a time from 0 to"),
        (HEAD + "\n1,0,0\n", "line 2: found fewer cells than the 7 columns"),
        (HEAD + ",topic\n1,0,0,0,0,0,0\n", "line 2: found fewer cells than the 8 columns"),
        (HEAD + "\n1,5,0,0,0,0,0,0\n", "line 2: found more cells than the 7 columns, .* with a decimal point"),
        *(
            (f"{HEAD},topic\n1,0,0,0,0,0,0,{name}\n", "line 2, topic: found .*, expected a ROS topic name; use letters")
            for name in ("wheel 1", "1st", "a//b", "a__b", "//a", "a/", "jet-1", "~/w", "ü", "/")
        ),
        (HEAD + ",force_x\n1,0,0,0,0,0,0,0\n", "there are several columns force_x, expected one"),
        (HEAD + ",time_ns\n1,0,0,0,0,0,0,0\n", "there are several columns time_ns, time_s, expected one"),
    ],
)
def test_a_table_that_cannot_be_read_names_line_and_column(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(LogError, match=says):
        table_to_bag(tmp_path / "table.csv", tmp_path / "bag.mcap")
    assert not (tmp_path / "bag.mcap").exists()


def test_a_table_with_numbers_that_no_run_takes_says_how_many_and_where(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    table = tmp_path / "thrust.csv"
    table.write_text(HEAD + "\n1,0,0,0,0,0,0\n2,0,nan,inf,0,0,0\n3,0,0,0,0,0,-inf\n")
    assert table_to_bag(table, tmp_path / "thrust.mcap") == 3
    said = f"which a run rejects: 2; the first: {table}, line 3, force_y: nan"
    assert [said in each.message for each in caplog.records] == [True]


def test_the_scene_comes_out_as_it_was_run(tmp_path: Path, log: Path, example_dir: Path) -> None:
    scene = tmp_path / "new" / "scene.yaml"
    log_to_scene(log, scene)
    assert scene.read_text() == SCENE.text
    with pytest.raises(LogError, match=r"slew\.mcap has no scene\.yaml attached"):
        log_to_scene(example_dir / "slew.mcap", scene)
    assert scene.read_text() == SCENE.text


def test_rerun_gets_every_sample(tmp_path: Path, log: Path) -> None:
    pytest.importorskip("rerun")
    assert log_to_rerun(log, tmp_path / "run.rrd") == 61
    assert (tmp_path / "run.rrd").stat().st_size > 10_000


def test_an_earlier_table_is_replaced_and_never_the_log(tmp_path: Path, log: Path, example_dir: Path) -> None:
    table = tmp_path / "run.csv"
    table.write_text("an earlier one")
    with pytest.raises(LogError, match="one kind for one table"):
        to_table([log, example_dir / "slew.mcap"], table)
    assert table.read_text() == "an earlier one"
    to_table([log], table)
    assert table.read_text().startswith("time_ns,")
    (tmp_path / "alias.csv").symlink_to(log)
    with pytest.raises(LogError, match="what is read"):
        to_table([log], tmp_path / "alias.csv")
    assert replay(log).identical


def test_commands_to_actuators_go_to_a_table_and_back_to_the_same_run(tmp_path: Path) -> None:
    scene, log, again = (tmp_path / name for name in ("scene.yaml", "run.mcap", "again.mcap"))
    scene.write_text(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}, frames: {jet: {position: [0, 0.1, 0]}}}\n"
        "actuators:\n"
        "  - {type: reaction_wheel, name: wheel, axis: [1, 0, 0], inertia: 1.0e-3, command: torque, max_torque: 1}\n"
        "  - {type: thruster, name: jet, frame: jet, force: 0.5, command: on_time}\n"
        "duration: 2\noutput_rate: 10\n"
    )
    given = [("wheel", 0.1 / 3.0, 0), ("jet", 0.7, 10**9), ("wheel", -0.2, 1_300_000_001)]
    commands = [(f"{name}/command", Setpoint(value, at)) for name, value, at in given]
    simulate(scene, commands, [McapSink(log)])

    table, back = tmp_path / "run.actuators.csv", tmp_path / "back.mcap"
    assert to_table([log], tmp_path / "run.csv")[1:] == [(table, 3, "commands to actuators")]
    with table.open(newline="") as file:
        rows = [(row["topic"], float(row["command"]), row["unit"]) for row in csv.DictReader(file)]
    units = {"wheel": "N m", "jet": "s"}
    assert rows == [(f"{name}/command", value, units[name]) for name, value, _ in given]

    assert table_to_bag(table, back) == 3
    assert command("simulate", scene, "--wrench", back, "--mcap", again).returncode == 0
    states = [read_bag(each).metadata["rb_dynamics.result"]["states_sha256"] for each in (log, again)]
    assert states[0] == states[1]
    table.write_text("time_ns,command\n0,1\n")
    with pytest.raises(LogError, match="line 2, topic: found '', expected a ROS topic name"):
        table_to_bag(table, back)


def test_rerun_gets_all_that_acts(tmp_path: Path) -> None:
    """As `simulate --rerun` has it, but for wheels and sensors: forces of thrusters were lost without a word."""
    pytest.importorskip("rerun")
    from rerun_runs import Rrd

    from rb_dynamics.sinks.rerun_sink import RerunSink

    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}, frames: {j: {position: [0, 0.1, 0]}}}\n"
        "wrenches: [{topic: push}]\n"
        "effects: [{type: scheduled_wrench, schedule: [{time: 0.5, torque: [0, 1, 0]}]}]\n"
        "actuators:\n"
        "  - {type: thruster, name: jet, frame: j, force: 0.5, command: level}\n"
        "  - {type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.01, max_torque: 0.1}\n"
        "duration: 2\noutput_rate: 30\n"
    )
    commands = [
        ("push", Wrench((1.0, 0.0, 0.0), (0.0, 0.0, 0.1), "body", 0)),
        ("jet/command", Setpoint(1.0, 400_000_000)),
        ("wheel/command", Setpoint(0.05, 600_000_000)),
        ("jet/command", Setpoint(0.0, 1_500_000_000)),
    ]
    log, direct, converted = (tmp_path / name for name in ("run.mcap", "direct.rrd", "converted.rrd"))
    simulate(scene, commands, [McapSink(log), RerunSink(direct)])
    log_to_rerun(log, converted)
    one, other = Rrd(direct), Rrd(converted)

    missing = {key for key in one.rows if key[1] == "Scalars:scalars"} - set(other.rows)
    assert missing == {("/wheels", "Scalars:scalars")}
    acting = ("force/jet/body", "torque/jet/body", "force/push/body", "torque/effects/0/body")
    for entity in (*acting, "position"):
        assert other.times(entity) == one.times(entity)
        assert other.values(entity).tolist() == one.values(entity).tolist()
    arrow = ("world/center_of_mass/force", "Arrows3D:vectors")
    assert other.values(*arrow).tolist() == one.values(*arrow).tolist()


def test_a_wrench_that_lags_is_marked_once_for_each_command(tmp_path):
    pytest.importorskip("rerun")
    from rerun_runs import Rrd

    from rb_dynamics.sinks.rerun_sink import RerunSink

    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push, lag: 0.3, delay: 0.1}]\n"
        "duration: 2\noutput_rate: 30\n"
    )
    pushes = [
        Wrench((force, 0.0, 0.0), (0.0, 0.0, 0.0), "body", time_ns) for force, time_ns in ((1.0, 0), (2.0, 10**9))
    ]
    commands = [("push", push) for push in pushes]
    log, direct, converted = (tmp_path / name for name in ("run.mcap", "direct.rrd", "converted.rrd"))
    simulate(scene, commands, [McapSink(log), RerunSink(direct)])
    log_to_rerun(log, converted)
    one, other = Rrd(direct), Rrd(converted)
    marks = "world/path/commands", "Points3D:positions"
    assert len(one.values(*marks)) == 2
    assert other.values(*marks).tolist() == one.values(*marks).tolist()


def test_a_recording_of_a_bag_keeps_what_is_finite_and_one_kind_of_times(tmp_path):
    pytest.importorskip("rerun")
    from bag_rows import write_rows
    from rerun.chunk import RrdReader

    from rb_dynamics.formats import cdr
    from rb_dynamics.formats.message_types import POSE, WRENCH

    dated = 1_700_000_000_000_000_000
    at = [dated + i * 10**7 for i in range(50)]
    poses = [(math.nan if i == 3 else 0.1 * i, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0) for i in range(50)]
    rows = [("/pose", POSE, time, cdr.encode(POSE, 0, "world", pose)) for time, pose in zip(at, poses, strict=True)]
    rows += [("/push", WRENCH, time, cdr.encode(WRENCH, time, "body", (1.0, *[0.0] * 5))) for time in at]
    bag, target = write_rows(tmp_path / "bag.mcap", sorted(rows, key=lambda row: row[2])), tmp_path / "bag.rrd"
    assert command("convert", bag, target).returncode == 0
    chunks = [chunk for chunk in RrdReader(target).stream().to_chunks() if not chunk.is_static]
    rows: Counter[str] = Counter()
    for chunk in chunks:
        rows[chunk.entity_path] += chunk.num_rows
    assert rows == {
        "/pose/position": 49,
        "/pose/orientation": 50,
        "/pose/body": 49,
        "/push/force": 50,
        "/push/torque": 50,
    }
    kinds = {str(chunk.to_record_batch().schema.field("stamp").type) for chunk in chunks}
    assert len(kinds) == 1
