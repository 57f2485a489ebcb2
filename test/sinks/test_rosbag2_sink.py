"""Runs as rosbag2 folders, read with rosbags and read back as one."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from rb_dynamics.analysis.bag_selection import part_of
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import summarize
from rb_dynamics.errors import LogError
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.mcap_integrity import verify_bag
from rb_dynamics.formats.output_file import move_aside
from rb_dynamics.formats.recovery import recover
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.wrench_bags import RecordedWrenches
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.read import parse_scene
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink
from rb_dynamics.sinks.rosbag2_sink import BagSink
from rb_dynamics.study.compare import compare

pytest.importorskip("rosbags")

from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import dump_qos_v9

SCENE = parse_scene(
    "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0.1, 2, 0.1]}\n"
    "wrenches: [{topic: wrench}]\nduration: 10\noutput_rate: 20\n"
)
COMMANDS = [
    ("wrench", Wrench((1.0, 0.0, 0.0), (0.0, 0.1, 0.0), "body", 500_000_000)),
    ("wrench", Wrench((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "world", 7_000_000_000)),
]


def topics(path: Path) -> dict[str, tuple[list[int], list[bytes]]]:
    """Return times and bytes of every topic but the inertia, which each file begins with."""
    found: dict[str, tuple[list[int], list[bytes]]] = {}
    for message in open_source(path).messages():
        if message.channel.topic != "/inertia":
            times, contents = found.setdefault(message.channel.topic, ([], []))
            times.append(message.log_time)
            contents.append(message.data)
    return found


def test_a_split_bag_holds_what_one_file_holds(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "spin"
    simulate(SCENE, COMMANDS, [McapSink(tmp_path / "one.mcap"), BagSink(folder, max_duration_s=3.0)])
    names = [f"spin_{number}.mcap" for number in range(4)]
    assert sorted(path.name for path in folder.iterdir()) == ["metadata.yaml", *names]
    assert topics(folder) == topics(tmp_path / "one.mcap")
    one, split = read_bag(tmp_path / "one.mcap"), read_bag(folder)
    assert split.complete
    assert split.metadata["rb_dynamics.result"] == one.metadata["rb_dynamics.result"]
    firsts = [read_bag(folder / f"spin_{number}.mcap") for number in range(4)]
    assert [bag.poses("/pose")[0][0] for bag in firsts] == [0, 3_000_000_000, 6_000_000_000, 9_000_000_000]
    assert firsts[1].metadata["rb_dynamics.result"]["continues_in"] == "spin_2.mcap"
    assert all(bag.attachments == one.attachments for bag in firsts)


def test_the_last_sample_has_no_file_of_its_own(tmp_path: Path) -> None:
    folder = tmp_path / "spin"
    simulate(SCENE, COMMANDS, [BagSink(folder, max_duration_s=2.5)])
    assert len(list(folder.glob("*.mcap"))) == 4
    ends = [read_bag(folder / f"spin_{number}.mcap").topics["/pose"].log_times[-1] for number in range(4)]
    assert ends == [2_450_000_000, 4_950_000_000, 7_450_000_000, 10_000_000_000]


def test_the_end_is_that_of_the_run_to_the_nanosecond(tmp_path: Path) -> None:
    """8562165.564 * 1e9 is a nanosecond less in double precision."""
    scene = parse_scene(SCENE.text, overrides={"duration": 8562165.564, "output_rate": 1e-7, "solver.accuracy": 1e-6})
    simulate(scene, [], [BagSink(tmp_path / "long", max_duration_s=1e6)])
    assert len(list((tmp_path / "long").glob("*.mcap"))) == 1


def test_metadata_is_what_rosbag2_wants_to_know(tmp_path: Path) -> None:
    folder = tmp_path / "spin"
    simulate(SCENE, COMMANDS, [BagSink(folder, max_duration_s=4.0, settings=LogSettings(verify=True))])
    facts = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (facts["version"], facts["storage_identifier"]) == (9, "mcap")
    assert facts["relative_file_paths"] == ["spin_0.mcap", "spin_1.mcap", "spin_2.mcap"]
    with Reader(folder) as reader:
        found = list(reader.messages())
        assert reader.message_count == len(found)
        assert (reader.start_time, reader.end_time) == (0, 10_000_000_001)
        counts = {connection.topic: 0 for connection in reader.connections}
        for connection, _, _ in found:
            counts[connection.topic] += 1
        assert counts == {connection.topic: connection.msgcount for connection in reader.connections}
        qos = {each.topic: dump_qos_v9(each.ext.offered_qos_profiles) for each in reader.connections}
    assert qos["/inertia"][0]["durability"] == "transient_local"
    for file in facts["files"]:
        with Reader(folder / file["path"]) as reader:
            assert reader.message_count == file["message_count"]
            assert reader.start_time == file["starting_time"]["nanoseconds_since_epoch"]
            assert reader.duration == file["duration"]["nanoseconds"] + 1


def test_a_file_that_is_large_enough_is_followed_by_the_next(tmp_path: Path) -> None:
    scene = parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 10\noutput_rate: 400\n")
    simulate(scene, sinks=[BagSink(tmp_path / "spin", max_bytes=100_000)])
    sizes = [file.stat().st_size for file in (tmp_path / "spin").glob("*.mcap")]
    assert len(sizes) > 2
    assert max(sizes) < 400_000
    assert read_bag(tmp_path / "spin").topics["/pose"].count == 4001


def test_an_earlier_bag_is_replaced_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "spin"
    simulate(SCENE, (), [BagSink(folder, max_duration_s=2.0)])
    simulate(SCENE, (), [BagSink(folder)])
    assert sorted(path.name for path in folder.iterdir()) == ["metadata.yaml", "spin_0.mcap"]
    assert read_bag(folder).topics["/pose"].count == 201
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(LogError, match=r"spin holds notes\.txt, expected a new or empty folder"):
        simulate(SCENE, (), [BagSink(folder)])
    assert read_bag(folder).topics["/pose"].count == 201
    with pytest.raises(LogError, match="it is a file, expected a folder"):
        simulate(SCENE, (), [BagSink(folder / "notes.txt")])


def test_a_folder_into_which_another_process_records_is_refused_until_it_ends(tmp_path: Path) -> None:
    """The files were those of one, and metadata.yaml that of the other."""
    folder = tmp_path / "spin"
    script = (
        "import sys, time; from rb_dynamics import parse_scene, simulate; "
        "from rb_dynamics.sinks.rosbag2_sink import BagSink\n"
        "class Wait:\n"
        "    def open(self, run): print(flush=True); time.sleep(600)\n"
        "    def write(self, event): pass\n    def close(self, result): pass\n"
        f"simulate(parse_scene({SCENE.text!r}), [], [BagSink(sys.argv[1]), Wait()])"
    )
    with subprocess.Popen([sys.executable, "-c", script, folder], stdout=subprocess.PIPE, text=True) as first:
        try:
            assert first.stdout is not None
            assert first.stdout.readline() == "\n"
            for act in (lambda: simulate(SCENE, [], [BagSink(folder)]), lambda: move_aside(folder)):
                with pytest.raises(LogError, match=r"cannot write .*spin: another run still records into it"):
                    act()
            assert [each.name for each in folder.iterdir()] == ["spin_0.mcap"]
        finally:
            first.kill()
    simulate(SCENE, [], [BagSink(folder)])
    assert read_bag(folder).complete
    # A sink that was not closed holds its folder only while there is one.
    sink = BagSink(folder)
    (folder / "notes.txt").touch()
    with pytest.raises(LogError, match=r"holds notes\.txt"):
        simulate(SCENE, [], [sink])
    (folder / "notes.txt").unlink()
    simulate(SCENE, [], [BagSink(folder)])


def test_a_bag_whose_last_file_was_cut_off_is_recovered_as_a_whole(tmp_path: Path) -> None:
    folder = tmp_path / "spin"
    simulate(SCENE, COMMANDS, [BagSink(folder, max_duration_s=3.0)])
    (folder / "metadata.yaml").unlink()
    last = folder / "spin_3.mcap"
    last.write_bytes(last.read_bytes()[:-500])
    assert not read_bag(folder).complete
    saved = recover(folder, tmp_path / "saved")
    assert [each.complete for each in saved] == [True, True, True, False]
    assert topics(tmp_path / "saved") == topics(folder)
    with Reader(tmp_path / "saved") as reader:
        assert reader.message_count == sum(1 for _ in reader.messages())


@pytest.fixture
def split(tmp_path: Path) -> Path:
    """Return a bag of four files, each but the last naming the next one, as a killed run leaves it."""
    folder = tmp_path / "spin"
    # Often enough that a file is of several chunks.
    scene = parse_scene(
        SCENE.text.replace("output_rate: 20", "output_rate: 200").replace("duration: 10", "duration: 12")
    )
    simulate(scene, COMMANDS, [BagSink(folder, max_duration_s=3.0, settings=LogSettings(flush_s=0.0))])
    (folder / "metadata.yaml").unlink()
    return folder


def told(folder: Path) -> tuple[str, list[str]]:
    """Return the reported gaps of a bag and the names of its failed checks."""
    summary = summarize(read_track(read_bag(folder)))
    return summary.lacks, [check.name for check in summary.checks if not check.passed]


@pytest.mark.parametrize("left", [0.6, 0.0], ids=["cut", "empty"])
def test_the_result_of_an_earlier_file_is_no_end(split: Path, tmp_path: Path, left: float) -> None:
    assert told(split) == ("", [])
    last = split / "spin_3.mcap"
    last.write_bytes(last.read_bytes()[: int(left * last.stat().st_size)])
    until = read_bag(split).poses("/pose")[0][-1] * 1e-9
    assert until == pytest.approx(8.995) if not left else 9.0 < until < 12.0
    lacks = f"cut off at t = {until:.9g} of 12 s"
    assert told(split) == (lacks, ["file is whole", "recording has all its parts"])
    recover(split, tmp_path / "saved")
    assert told(tmp_path / "saved") == (lacks, ["recording has all its parts"])


def test_a_damaged_piece_does_not_hide_that_the_end_is_cut(split: Path, tmp_path: Path) -> None:
    middle, last = split / "spin_1.mcap", split / "spin_3.mcap"
    data = bytearray(middle.read_bytes())
    data[data.index(b"zstd", 30_000) + 100] ^= 255
    middle.write_bytes(data)
    last.write_bytes(last.read_bytes()[: last.stat().st_size * 6 // 10])
    assert recover(split, tmp_path / "saved")[1].state == "damaged"
    lacks, failed = told(tmp_path / "saved")
    assert lacks.startswith("cut off at t = ")
    assert "of 12 s; a piece is missing from t = 3" in lacks
    assert "recording has all its parts" in failed


@pytest.mark.parametrize(
    ("kept", "lacks"),
    [
        ("0", "cut off at t = 2.995 of 12 s (the next file, spin_1.mcap, is missing)"),
        ("12", "cut off at t = 5.995 of 9 s (the next file, spin_3.mcap, is missing); the first 3 s are missing"),
        ("3", "the first 9 s are missing"),
        ("013", "a piece is missing from t = 5.995 to 9 s; spin_2.mcap is missing"),
    ],
)
def test_files_that_are_not_there_are_named(split: Path, tmp_path: Path, kept: str, lacks: str) -> None:
    for number in {*"0123"} - {*kept}:
        (split / f"spin_{number}.mcap").unlink()
    bag = read_bag(split)
    assert bag.whole
    assert bag.ended is ("3" in kept)
    for folder in (split, tmp_path / "saved"):
        recover(split, tmp_path / "saved")
        assert told(folder)[0] == lacks
        assert "recording has all its parts" in told(folder)[1]


def test_a_file_alone_is_not_the_recording(split: Path) -> None:
    assert told(split / "spin_0.mcap")[1] == ["recording has all its parts"]
    assert not read_bag(split / "spin_0.mcap").complete


@pytest.mark.parametrize("later", [1, 2])
def test_what_is_held_from_a_file_that_is_not_there_is_not_known(split: Path, tmp_path: Path, later: int) -> None:
    """From 0.5 to 7 s a command is held: taken for zero, it would be missed in the balances of momentum."""
    file, lacks = split / f"spin_{later}.mcap", ["recording has all its parts"]
    track = read_track(read_bag(file))
    part = read_track(part_of(track, (3.0 * later + 0.5, None)))
    for found in (track, part):
        assert [check.name for check in summarize(found).checks if not check.passed] == lacks
    simulate(SCENE, COMMANDS, [McapSink(tmp_path / "whole.mcap")])
    assert not compare(tmp_path / "whole.mcap", file).commands


def test_a_file_within_that_was_cut_is_a_missing_piece_and_no_end(split: Path, tmp_path: Path) -> None:
    middle = split / "spin_1.mcap"
    middle.write_bytes(middle.read_bytes()[: middle.stat().st_size * 6 // 10])
    recover(split, tmp_path / "saved")
    for folder in (split, tmp_path / "saved"):
        lacks, failed = told(folder)
        assert lacks.startswith("a piece is missing from t = ")
        assert lacks.endswith(" to 6 s")
        assert "recording has all its parts" in failed


def test_a_copy_under_another_name_of_the_folder_is_the_same_bag(split: Path, tmp_path: Path) -> None:
    assert told(split.rename(tmp_path / "renamed")) == ("", [])


def test_commands_of_a_bag_that_lacks_files_come_with_a_warning(split: Path, caplog: pytest.LogCaptureFixture) -> None:
    (split / "spin_1.mcap").unlink()
    assert len(RecordedWrenches([split], ["wrench"])) == 2
    assert "spin is without spin_1.mcap; the 2 commands in it are used" in caplog.text


def test_a_bag_that_filled_the_disk_lasts_as_long_as_what_is_in_it(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, hard))
    try:
        with pytest.raises(LogError, match="cannot go on writing"):
            simulate(replace(SCENE, duration=100.0), sinks=[BagSink(tmp_path / "run")])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    verify_bag(tmp_path / "run")
