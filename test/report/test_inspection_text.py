"""The summary on a terminal: aligned, within 100 columns, and free of control characters from a log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import Range, summarize
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.report.inspection_text import WIDTH, as_text, smallest

POSE = "geometry_msgs/msg/PoseStamped"


def text_of(log: Path) -> str:
    return as_text(summarize(read_track(read_bag(log))))


def test_lines_fit_and_columns_align(flight: Any) -> None:
    lines = text_of(flight.log).splitlines()
    assert max(map(len, lines)) <= WIDTH
    start = next(i for i, line in enumerate(lines) if line.startswith("TOPIC"))
    rows = [line for line in lines[start : lines.index("", start)] if " 151 " in line]
    assert len({line.index(" 151 ") for line in rows}) == 1
    assert len(rows) == 9
    assert "…" not in "".join(lines)


def test_it_says_what_happened(flight: Any) -> None:
    text = text_of(flight.log)
    flat = " ".join(text.split())
    assert "log of rb_dynamics" in flat
    assert "; t is simulation time " in flat
    assert f"{flight.result.sample.work:.7g}" in flat
    assert "all 13 checks passed" in flat
    assert "body: 4 kg, centre of mass at (0.1, -0.2, 0.05) m, principal moments 0." in flat
    assert "effects: none" in flat
    assert "which for a momentum is the larger of its maximum and the sum of its impulses" in flat


def test_it_says_from_which_stamp_the_t_of_a_recording_counts(bagger: Any) -> None:
    poses = [("/pose", POSE, k, (k, "world", (0.0,) * 6 + (1.0,))) for k in (13_070_000_000, 13_570_000_000)]
    flat = " ".join(text_of(bagger(poses)).split())
    assert "; t counts from the start, at header.stamp 13.070000000 s " in flat
    assert "Rates and gaps in this table are by log time, when a message was recorded" in flat


def test_a_balance_that_is_known_for_a_part_of_the_run_passes_no_check_without_saying_so(flown: Any) -> None:
    """A torque in body axes that changes between any two samples: its impulse is hardly known while it acts."""
    again = [Wrench((0.0, 0.0, 0.0), (0.01, 0.0, 0.0), "body", k * 20_000_000 + 500_007_000) for k in range(110)]
    summary = summarize(read_track(read_bag(flown([("thrust", wrench) for wrench in again]).log)), bound=1e-8)
    check = next(check for check in summary.checks if check.name == "angular momentum balance")
    assert 0.0 < check.share < 0.5
    share = f"{100.0 * check.share:.3g} %"
    flat = " ".join(as_text(summary).split())
    assert f"{check.detail}" in flat
    assert check.detail.endswith(f"; known for {share} of the time")
    assert flat.endswith(f"checks passed, the angular momentum balance over {share} of the run")


def test_a_long_name_stands_on_a_line_of_its_own(bagger: Any) -> None:
    topic = "/a_vehicle_with_a_long_name/effects/uniform_gravity/applied"
    wrench = (0, "world", (0.0, 0.0, -9.8, 0.0, 0.0, 0.0))
    lines = text_of(bagger([(topic, "geometry_msgs/msg/WrenchStamped", 0, wrench)])).splitlines()
    table = lines[next(k for k, line in enumerate(lines) if line.startswith("WRENCH CHANNEL")) :]
    assert table[1] == f"  {topic.removesuffix('/applied')}"
    assert table[2].split() == ["world", "-", "1", "-", "-", "9.8", "0"]
    assert "…" not in "".join(lines)


def test_hostile_names_do_no_harm(bagger: Any) -> None:
    topic = "/\x1b[2J" + 50 * "long/" + "\r\n\x07pose"
    rows = [(topic, POSE, k, (k, "world", (0.0,) * 6 + (1.0,))) for k in range(5)]
    text = text_of(bagger(rows))
    assert not {"\x1b", "\r", "\x07"} & set(text)
    assert max(map(len, text.splitlines())) <= WIDTH


def test_frames_that_do_not_fit_are_told_in_full_and_the_empty_one_in_quotes(bagger: Any, flown: Any) -> None:
    frames = ("", "base_link", "wrold", "world")
    sent = [("thrust", Wrench(torque=(0.1, 0.0, 0.0), frame_id=f, stamp_ns=k)) for k, f in enumerate(frames)]
    lines = text_of(flown(sent).log).splitlines()
    rows = [line.split() for line in lines if line.startswith("  /thrust ")]
    assert rows[-2][:6] == ["/thrust", "below", "4", "2", "1", "2"]
    assert '  Frames of /thrust: "", base_link, world, wrold.' in lines
    rows = [("/cmd", "geometry_msgs/msg/WrenchStamped", k, (k, f, (0.1,) * 6)) for k, f in enumerate(frames)]
    assert '(frames: "", base_link, world, wrold)' in " ".join(text_of(bagger(rows)).split())


@pytest.mark.parametrize(
    ("low", "high", "shown"), [(1.0, 2.0, "1"), (2.0, 2.0 + 4e-9, "4e-09 less"), (2.0, 2.0, "the same")]
)
def test_the_smallest_value_is_told_apart_from_the_largest(low: float, high: float, shown: str) -> None:
    assert smallest(Range("speed", "m/s", low, 0.0, high, 1.0), 8) == shown
