"""Runs as rosbag2 folders, read with rosbags and read back as one."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from rb_dynamics.errors import LogError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.recording.bag_sink import BagSink
from rb_dynamics.recording.mcap_reader import read_bag
from rb_dynamics.recording.mcap_sink import LogSettings, McapSink
from rb_dynamics.recording.recover import recover
from rb_dynamics.scene.read import parse_scene
from rb_dynamics.simulate import simulate

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
    bag = read_bag(path)
    return {name: (each.log_times, each.messages) for name, each in bag.topics.items() if name != "/inertia"}


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
    scene = parse_scene(SCENE.text, overrides={"duration": 8562165.564, "output_rate": 1e-7})
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
