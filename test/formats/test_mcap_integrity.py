"""Our files pass the checks of the package mcap, and damaged ones fail."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from rb_dynamics.cli import main
from rb_dynamics.errors import LogError, MissingExtraError
from rb_dynamics.formats.channel_metadata import log_channel
from rb_dynamics.formats.mcap_integrity import verify, verify_bag
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.formats.recovery import recover
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene import parse_scene
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink
from rb_dynamics.sinks.rosbag2_sink import BagSink

pytest.importorskip("mcap")

SCENE = parse_scene(
    """
body: {mass: 1.0, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.1, 2, 0.1]}
wrenches: [{topic: wrench}]
solver: {method: rk4, step: 0.01}
duration: 3.0
""",
    "spin.yaml",
)
COMMANDS = [("wrench", Wrench(torque=(0.1, 0.0, 0.0), frame_id="body", stamp_ns=k * 500_000_000)) for k in range(5)]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    simulate(SCENE, COMMANDS, [McapSink(path, settings=LogSettings(verify=True))])
    return path


def test_all_that_is_written_reads_back(tmp_path: Path, log: Path) -> None:
    simulate(SCENE, COMMANDS, [BagSink(tmp_path / "bag", max_duration_s=1.0)])
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[:-2000])
    recover(cut, tmp_path / "saved.mcap")
    table = tmp_path / "wrenches.csv"
    table.write_text("time_s,force_x,force_y,force_z,torque_x,torque_y,torque_z\n0,1,0,0,0,0,0\n1,0,0,0,0,0,0\n")
    assert main(["convert", str(table), str(tmp_path / "wrenches.mcap")]) == 0

    for name in ("run.mcap", "bag", "saved.mcap", "wrenches.mcap"):
        bag = read_bag(tmp_path / name)
        assert verify_bag(tmp_path / name) == sum(topic.count for topic in bag.topics.values()) > 0


@pytest.mark.parametrize("fact", ["message_count", "nanoseconds_since_epoch", "nanoseconds"])
def test_metadata_that_say_other_than_the_files(tmp_path: Path, fact: str) -> None:
    simulate(SCENE, COMMANDS, [BagSink(tmp_path / "bag", max_duration_s=1.0)])
    told = tmp_path / "bag" / "metadata.yaml"
    verify_bag(tmp_path / "bag")
    told.write_text(re.sub(rf" {fact}: [0-9]+", f" {fact}: 7", told.read_text()))
    with pytest.raises(LogError, match=r"metadata\.yaml says 7 "):
        verify_bag(tmp_path / "bag")
    told.unlink()
    verify_bag(tmp_path / "bag")


def test_a_file_that_holds_other_than_was_written(log: Path) -> None:
    counts = {name: topic.count for name, topic in read_bag(log).topics.items()}

    assert verify(log, counts) == sum(counts.values())
    with pytest.raises(LogError, match="other was written: /pose: 301 of 302 messages"):
        verify(log, {**counts, "/pose": 302})


def place_of_chunk(data: bytes) -> int:
    start = data.index(b"zstd")
    return start + 100


def place_of_scene(data: bytes) -> int:
    return data.index(b"angular_velocity_body")


def place_of_summary(data: bytes) -> int:
    return data.rindex(b"scene.yaml")


def place_of_index(data: bytes) -> int:
    """Of the first message of the first channel that has one, after opcode, length, channel, size and its time."""
    return behind_chunk(data) + 9 + 2 + 4 + 8


def behind_chunk(data: bytes) -> int:
    """Where the first index of messages begins."""
    start = data.index(b"zstd") - 4 - 8 - 8 - 8 - 4 - 8 - 1
    assert data[start] == 6
    behind = start + 9 + int.from_bytes(data[start + 1 : start + 9], "little")
    assert data[behind] == 7
    return behind


@pytest.mark.parametrize(
    ("place", "fault"),
    [
        (place_of_index, "the index of messages leads elsewhere in 1 of [0-9]+ chunks"),
        (place_of_chunk, "crc|zstd|Zstd"),
        (place_of_scene, "the checksum of the attachment scene.yaml does not fit"),
        (place_of_summary, "the checksum of its summary does not fit"),
    ],
)
def test_one_bit_that_is_another(log: Path, place: Callable[[bytes], int], fault: str) -> None:
    data = bytearray(log.read_bytes())
    data[place(bytes(data))] ^= 1
    log.write_bytes(data)

    with pytest.raises(LogError, match=fault):
        verify(log)


def test_a_summary_without_checksum_that_leads_elsewhere(log: Path) -> None:
    data = bytearray(log.read_bytes())
    data[-12:-8] = bytes(4)
    log.write_bytes(data)
    assert verify(log)

    data[data.rindex(behind_chunk(bytes(data)).to_bytes(8, "little"))] ^= 1
    log.write_bytes(data)
    with pytest.raises(LogError, match=r"its summary leads elsewhere than to 1 of [0-9]+ indexes of messages"):
        verify(log)


def test_a_file_without_its_end(log: Path) -> None:
    log.write_bytes(log.read_bytes()[:-9])

    with pytest.raises(LogError, match=r"run\.mcap does not read back as it should: the package mcap cannot read it"):
        verify(log)


def written(path: Path, library: str, *times: int, lie: Callable[[McapWriter], None] = lambda _: None) -> Path:
    file = OutputFile(path)
    writer = McapWriter(file, library)
    writer.begin()
    channel = writer.add_channel(log_channel("/a", "std_msgs/msg/Float64", ""))
    for time_ns in times:
        writer.add_messages([channel], [b"12345678"], time_ns, time_ns)
    writer.end_chunk()
    lie(writer)
    writer.finish()
    file.close()
    return path


def test_the_order_of_a_log_of_ours_only(tmp_path: Path) -> None:
    assert verify(written(tmp_path / "a.mcap", "rb_dynamics 1", 1, 2, 2)) == 3
    assert verify(written(tmp_path / "b.mcap", "another", 2, 1)) == 2
    with pytest.raises(LogError, match="a log time is before the one in front of it"):
        verify(written(tmp_path / "c.mcap", "rb_dynamics 1", 2, 1))


def test_copies_whose_log_times_go_back_like_those_of_the_bag(tmp_path: Path) -> None:
    bag = written(tmp_path / "bag.mcap", "another", 2, 1, 3)
    recover(bag, tmp_path / "saved.mcap")
    assert verify(tmp_path / "saved.mcap") == 3
    assert main(["convert", str(bag), str(tmp_path / "copy.mcap")]) == 0
    assert verify(tmp_path / "copy.mcap") == 3


def test_statistics_and_an_index_that_lie(tmp_path: Path) -> None:
    def count(writer: McapWriter) -> None:
        writer.counts[1] += 1

    def end(writer: McapWriter) -> None:
        writer._written.end_time += 1

    def chunks(writer: McapWriter) -> None:
        writer._written.chunks *= 2

    with pytest.raises(LogError, match="its statistics say otherwise: /a: 2 of 3 messages"):
        verify(written(tmp_path / "a.mcap", "", 1, 2, lie=count))
    with pytest.raises(LogError, match="2 ns, the last log time, and its summary says 3"):
        verify(written(tmp_path / "a.mcap", "", 1, 2, lie=end))
    with pytest.raises(LogError, match="its index leads elsewhere: /a: 2 of 4 messages"):
        verify(written(tmp_path / "a.mcap", "", 1, 2, lie=chunks))


def test_without_the_package_nothing_is_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    path = tmp_path / "run.mcap"

    with pytest.raises(MissingExtraError, match="'mcap', which is not installed; install the extra 'log'"):
        simulate(SCENE, COMMANDS, [McapSink(path, settings=LogSettings(verify=True))])
    assert not path.exists()


def test_inspect_verifies(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(log), "--verify"]) == 0
    assert "verified with the package mcap: " in capsys.readouterr().out
    data = bytearray(log.read_bytes())
    # No reader here looks at it.
    data[place_of_summary(bytes(data))] ^= 1
    log.write_bytes(data)
    assert main(["inspect", str(log), "--verify"]) == 1
    assert "the checksum of its summary does not fit" in capsys.readouterr().err
