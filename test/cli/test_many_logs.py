"""`inspect` and `replay` of many logs: a line for each, whatever is wrong with one of them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command_line import command
from deadly_work import deadly
from edited_logs import edited

from rb_dynamics import LogError, parse_scene, simulate
from rb_dynamics.cli.many_logs import ERROR, PASSED, each_of, logs_of
from rb_dynamics.sinks.mcap_sink import McapSink

SCENE = "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0, 2, 0.1]}\nduration: 1\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder of a good log, a damaged one, one that contradicts itself, and a bag of another program."""
    for name in ("a", "b"):
        simulate(parse_scene(SCENE), (), [McapSink(tmp_path / "runs" / f"{name}.mcap")])
    (tmp_path / "runs" / "bad.mcap").write_text("no log")
    return tmp_path / "runs"


def test_a_line_for_each_and_one_bad_file_stops_no_other(folder: Path) -> None:
    found = command("inspect", folder / "a.mcap", folder / "bad.mcap", folder / "b.mcap", "--jobs", "1")
    assert found.returncode == 1
    verdicts = [line.split()[0] for line in found.stdout.splitlines()[1:4]]
    assert verdicts == ["passed", "error", "passed"]
    assert found.stdout.splitlines()[-1] == "3 logs: 2 passed, 1 error"
    assert command("inspect", folder / "a.mcap", folder / "b.mcap", "--jobs", "1").returncode == 0
    assert command("inspect", folder / "bad.mcap", folder / "bad.mcap", folder / "none.mcap").returncode == 2


def test_json_is_a_list_of_what_one_log_gives(folder: Path) -> None:
    alone = json.loads(command("inspect", folder / "a.mcap", "--json").stdout)
    found = command("inspect", folder, "--json", "--jobs", "1")
    assert found.returncode == 1
    rows = json.loads(found.stdout)
    assert [Path(row["path"]).name for row in rows] == ["a.mcap", "b.mcap", "bad.mcap"]
    assert rows[0] == alone
    assert rows[2]["passed"] is False
    assert "does not begin like an MCAP file" in rows[2]["error"]


def test_replay_says_the_same_of_many_as_of_one(folder: Path) -> None:
    alone = command("replay", folder / "a.mcap", "--json")
    assert alone.returncode == 0
    rows = json.loads(command("replay", str(folder / "[ab].mcap"), "--json", "--jobs", "1").stdout)
    assert rows[0] == json.loads(alone.stdout)
    assert rows[0]["identical"]
    assert rows[0]["verdict"] == "the same to the last bit"


def test_a_log_that_differs_fails_alone(folder: Path) -> None:
    edited(folder / "a.mcap", folder / "c.mcap", lambda m: m if m.log_time != 500_000_000 else None)
    found = command("replay", folder / "a.mcap", folder / "c.mcap", "--jobs", "1", "--html", folder / "page.html")
    assert found.returncode == 1
    assert [line.split()[0] for line in found.stdout.splitlines()[1:3]] == ["passed", "FAILED"]
    page = (folder / "page.html").read_text()
    assert page.index("c.mcap") < page.index("a.mcap")


def test_which_logs_are_meant(folder: Path, example_dir: Path) -> None:
    one = str(folder / "a.mcap")
    assert logs_of([one]) is None
    assert logs_of([one, one]) == [one]
    bag = folder / "sub" / "flight"
    bag.mkdir(parents=True)
    for k in range(2):
        shutil.copy(one, bag / f"flight_{k}.mcap")
    # Files of one bag differ in their numbers alone.
    assert logs_of([str(bag)]) is None
    names = ["a.mcap", "b.mcap", "bad.mcap", "sub/flight"]
    assert logs_of([str(folder)]) == [str(folder / name) for name in names]
    assert logs_of([str(folder / "?.mcap"), str(example_dir / "slew.mcap")]) == [
        str(folder / "a.mcap"), str(folder / "b.mcap"), str(example_dir / "slew.mcap"),
    ]  # fmt: skip
    with pytest.raises(LogError, match="found no file that fits"):
        logs_of([str(folder / "*.bag")])
    assert logs_of([str(folder / "none.mcap")]) is None


def test_what_one_log_alone_can_have(folder: Path) -> None:
    logs = folder / "a.mcap", folder / "b.mcap"
    assert "--video for 2 logs" in command("inspect", *logs, "--video", folder / "a.gif").stderr
    # An ending that is none is refused before the log is read, which may take minutes.
    refused = command("inspect", logs[0], "--video", folder / "a.xyz")
    assert "ends in .mp4 or .gif" in refused.stderr
    assert refused.stdout == ""
    assert "2 logs with --into ros" in command("replay", *logs, "--into", "ros").stderr
    assert "it is, or holds, what is read" in command("inspect", *logs, "--html", folder / "b.mcap").stderr


def test_a_process_that_dies_takes_its_log_alone_with_it() -> None:
    rows = list(each_of(["a", "b", "c", "d"], deadly, jobs=2))
    assert [(row.path, row.verdict) for row in rows] == [("a", PASSED), ("b", ERROR), ("c", ERROR), ("d", PASSED)]
    assert "was killed" in rows[1].detail
    assert rows[2].detail == "MemoryError: too large"
