"""Logs of a killed writer: everything written is there, and recovered copies open in other readers."""

from __future__ import annotations

import itertools
import json
import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from log_killer import samples

from rb_dynamics.errors import LogError
from rb_dynamics.formats.mcap_records import McapFile
from rb_dynamics.formats.recovery import recover
from rb_dynamics.logs.bag_reader import read_bag

pytest.importorskip("mcap")
pytest.importorskip("rosbags")
if not hasattr(os, "fork"):
    pytest.skip("this system has no SIGKILL to send", allow_module_level=True)

from mcap.exceptions import McapError
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader, AnyReaderError

KILLER = Path(__file__).resolve().parent.parent / "support" / "log_killer.py"


def killed(folder: Path, kills: int, *times: float) -> list[dict[str, Any]]:
    arguments = [sys.executable, str(KILLER), str(folder), str(kills), *map(str, times)]
    result = subprocess.run(arguments, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in result.stdout.splitlines()]


def check(each: dict[str, Any], folder: Path) -> int:
    """Check the log of a killed writer; return its number of samples."""
    path, copy = Path(each["path"]), folder / f"recovered_{Path(each['path']).name}"
    if not each["opened"]:
        return 0
    before = path.read_bytes()
    # Only a copy opens elsewhere: docs/logs.md says so.
    with path.open("rb") as file, pytest.raises(McapError):
        make_reader(file).get_summary()
    with pytest.raises(AnyReaderError), AnyReader([path]):
        pass
    (saved,) = recover(path, copy)
    assert path.read_bytes() == before
    assert not saved.damage
    bag, cut_off = read_bag(copy), read_bag(path)
    assert not bag.complete
    assert bag.attachments["scene.yaml"]
    positions = bag.poses("/pose")[1][:, :3].tolist()
    assert positions == cut_off.poses("/pose")[1][:, :3].tolist()
    assert positions == [list(sample.position_world) for sample in itertools.islice(samples(), len(positions))]
    # Chunks are whole, and a sample never lies in two of them.
    assert {bag.topics[name].count for name in ("/pose", "/twist", "/odom", "/energy/defect")} == {len(positions)}
    total = sum(topic.count for topic in bag.topics.values())
    with copy.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == total
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == total
    with AnyReader([copy]) as bags:
        assert sum(1 for _ in bags.messages()) == total
    # A sample may reach the file after it was last counted.
    assert len(positions) <= each["written"] + 1
    return len(positions)


def test_a_log_killed_at_any_moment_opens_with_what_was_written(tmp_path: Path) -> None:
    results = killed(tmp_path, 12, 0.01, 0.0, 0.1)
    found = [check(each, tmp_path) for each in results]
    assert len(found) == 12
    assert sum(each["opened"] for each in results) >= 6
    assert max(found) > 10


@pytest.mark.slow
def test_sixty_kills_lose_no_more_than_the_last_moments(tmp_path: Path) -> None:
    results = killed(tmp_path, 60, 0.5, 0.0, 1.2)
    lost = [max(0, each["old"] - check(each, tmp_path)) for each in results]
    assert sum(each["opened"] for each in results) >= 50
    # Of samples older than 0.5 s at the kill, at most those that a busy machine kept waiting.
    assert sum(count > 0 for count in lost) <= 6
    assert sum(lost) < 0.01 * sum(each["written"] for each in results)


def test_a_whole_file_is_copied_and_called_whole(tmp_path: Path, example_dir: Path) -> None:
    (saved,) = recover(example_dir / "slew.mcap", tmp_path / "copy.mcap")
    assert saved.complete
    one, two = McapFile(example_dir / "slew.mcap"), McapFile(tmp_path / "copy.mcap")
    assert list(one.messages()) == list(two.messages())
    assert two.complete
    assert (one.metadata, one.attachments) == (two.metadata, two.attachments)


def test_what_is_damaged_within_is_left_out_and_named(tmp_path: Path) -> None:
    (each,) = killed(tmp_path, 1, 0.01, 0.5, 0.5)
    path = Path(each["path"])
    data = bytearray(path.read_bytes())
    # The third chunk from the end: opcode 6, its length, then times, sizes and checksum.
    starts = chunk_starts(bytes(data))
    data[starts[-3] + 60] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(LogError, match="rb-dynamics recover"):
        read_bag(path)
    (saved,) = recover(path, tmp_path / "copy.mcap")
    assert len(saved.damage) == 1
    assert "rb-dynamics recover" not in saved.damage[0]
    kept = read_bag(tmp_path / "copy.mcap").poses("/pose")[1][:, 0].tolist()
    assert kept == sorted(kept)
    assert 0 < len(kept) < each["written"]
    told = read_bag(tmp_path / "copy.mcap").metadata["rb_dynamics.interrupted"]
    ((begin_ns, end_ns),) = saved.missing
    assert told["missing_ns"] == f"{begin_ns} {end_ns}"
    assert saved.state == told["reason"] == "cut off and damaged"
    times, _ = read_bag(tmp_path / "copy.mcap").poses("/pose")
    # At either end a part of the messages of that time may be lost.
    assert not ((times > begin_ns) & (times < end_ns)).any()
    assert times[0] < begin_ns < end_ns < times[-1]


def chunk_starts(data: bytes) -> list[int]:
    starts, place = [], 8
    while place + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, place)
        if opcode == 6 and place + 9 + length <= len(data):
            starts.append(place)
        place += 9 + length
    return starts


def test_the_file_itself_is_never_written(tmp_path: Path, example_dir: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes((example_dir / "slew.mcap").read_bytes())
    with pytest.raises(LogError, match=r"what is read .*; give another name"):
        recover(path, path)
    with pytest.raises(LogError, match="what is read"):
        recover(tmp_path, tmp_path)
    assert path.read_bytes() == (example_dir / "slew.mcap").read_bytes()


def test_an_earlier_copy_is_replaced_and_not_by_what_is_no_log(tmp_path: Path, example_dir: Path) -> None:
    copy = tmp_path / "copy.mcap"
    copy.write_text("an earlier one")
    (tmp_path / "notes.mcap").write_text("not a log at all")
    with pytest.raises(LogError, match="does not begin like an MCAP file"):
        recover(tmp_path / "notes.mcap", copy)
    assert copy.read_text() == "an earlier one"
    recover(example_dir / "slew.mcap", copy)
    assert list(McapFile(copy).messages()) == list(McapFile(example_dir / "slew.mcap").messages())


def test_what_is_no_log_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "notes.mcap").write_text("not a log at all")
    with pytest.raises(LogError, match="does not begin like an MCAP file"):
        recover(tmp_path / "notes.mcap", tmp_path / "copy.mcap")
    assert not (tmp_path / "copy.mcap").exists()
