"""Logs from the command line: overwritten, split, stopped by a full disk, recovered, replayed under other names."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from campaigns import write as write_campaign
from command_line import command
from edited_logs import edited

from rb_dynamics.analysis.identification.flights import read_flight
from rb_dynamics.cli import main
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.scene import read_scene

SCENE = (
    "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0.1, 2, 0.1]}\n"
    "wrenches: [{topic: wrench}]\nduration: 10\noutput_rate: 200\n"
)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE)
    return path


def test_a_script_runs_twice_and_never_replaces_what_it_reads(scene: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    assert command("simulate", scene, "--mcap", log, "--verify").returncode == 0
    assert command("simulate", scene, "--mcap", log, "--duration", "1").returncode == 0
    assert read_bag(log).poses("/pose")[0][-1] == 10**9
    before = log.read_bytes()
    for arguments in (
        ("simulate", scene, "--wrench", log, "--mcap", log),
        ("simulate", scene, "--wrench", log, "--bag", tmp_path),
        ("simulate", scene, "--rerun", scene),
        ("inspect", log, "--html", log),
        ("recover", log, log),
    ):
        refused = command(*arguments)
        assert refused.returncode == 2
        assert "what is read" in refused.stderr
    assert log.read_bytes() == before
    assert scene.read_text() == SCENE


def test_a_full_disk_stops_the_log_and_not_the_run(scene: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    words = " ".join(f"'{each}'" for each in (sys.executable, "-m", "rb_dynamics", "simulate", scene, "--mcap", log))
    # 400 KiB: room for whole chunks, compressed or not.
    line = f"ulimit -f 800; exec {words} --json"
    limited = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
    assert limited.returncode == 1, limited.stderr
    assert "warning: a log has stopped, the run continues without it" in limited.stderr
    assert "Traceback" not in limited.stderr
    assert json.loads(limited.stdout)["time_ns"] == 10**10
    bag = read_bag(log)
    assert not bag.complete
    assert 0 < bag.topics["/pose"].count < 2001
    inspected = command("inspect", log)
    assert inspected.returncode == 1
    assert "cut off" in inspected.stdout


@pytest.mark.parametrize("recovered", [False, True])
def test_whatever_goes_on_with_a_log_that_was_cut_off_says_so(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], recovered: bool
) -> None:
    log, cut, target = tmp_path / "run.mcap", tmp_path / "cut.mcap", tmp_path / "out"
    assert main(["simulate", str(scene), "--mcap", str(log)]) == 0
    cut.write_bytes(log.read_bytes()[: len(log.read_bytes()) // 2])
    if recovered:
        assert main(["recover", str(cut), str(tmp_path / "saved.mcap")]) == 0
        cut = tmp_path / "saved.mcap"
    capsys.readouterr()
    for code, *arguments in (
        (1, "convert", cut, target.with_suffix(".csv")),
        (1, "convert", log, cut, target.with_suffix(".csv")),
        (0, "convert", cut, target.with_suffix(".mcap")),
        (0, "convert", cut, target.with_suffix(".yaml"), "--at", "0.5"),
    ):
        assert main([*map(str, arguments)]) == code, arguments
        assert f"{cut} was cut off: what is missing is lost" in capsys.readouterr().err, arguments
    assert main(["compare", str(log), str(cut)]) == 0
    assert f"note      {cut}: cut off at t = " in capsys.readouterr().out
    assert any(note.startswith("cut off at t = ") for note in read_flight(cut, read_scene(scene)).notes)
    flown = read_flight(str(log), read_scene(scene), [str(cut)])
    assert f"{cut} was cut off: what is missing is lost" in flown.notes


def test_a_log_that_cannot_be_begun_is_bad_input(scene: Path, tmp_path: Path) -> None:
    result = command("simulate", scene, "--mcap", tmp_path / "scene.yaml" / "run.mcap")
    assert result.returncode == 2
    assert "cannot write" in result.stderr
    assert result.stdout == ""


@pytest.mark.parametrize(
    "arguments",
    [
        ["demo", "--out", "file/out"],
        ["campaign", "campaign.yaml", "--out", "file/rows.parquet"],
        ["campaign", "campaign.yaml", "--html", "file/page.html"],
        ["campaign", "campaign.yaml", "--rerun", "0", "--mcap", "file/run.mcap"],
        ["trade", "scene.yaml", "--html", "file/page.html"],
        ["simulate", "scene.yaml", "--html", "file/page.html"],
    ],
)
def test_a_folder_that_cannot_be_made_is_said_before_the_work(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if arguments[0] == "campaign":
        pytest.importorskip("pyarrow")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("in the way")
    write_campaign(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert f"cannot write {arguments[-1]}" in said.err  # demo: a file in it
    assert "cannot be made (" in said.err
    assert said.out == ""
    assert sorted(tmp_path.iterdir()) == before


def test_a_bag_drives_a_channel_of_another_name(scene: Path, tmp_path: Path, example_dir: Path) -> None:
    split = ("--bag", tmp_path / "flown", "--max-bag-duration", "4", "--max-bag-size", "1000000")
    drive = ("--wrench", example_dir / "slew.mcap", "--topic", "/wrench/body=wrench")
    first = command("simulate", scene, *drive, *split, "--json")
    assert first.returncode == 0, first.stderr
    assert len(list((tmp_path / "flown").glob("*.mcap"))) == 3
    again = command("simulate", scene, "--wrench", tmp_path / "flown", "--json")
    one, two = json.loads(first.stdout), json.loads(again.stdout)
    assert one["orientation_xyzw"] == two["orientation_xyzw"]
    assert one["work"] == two["work"] != 0.0
    explained = command("explain", scene, *drive, "--json")
    assert explained.returncode == 0, explained.stderr
    assert not any("probe" in remark for remark in json.loads(explained.stdout)["remarks"])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--max-bag-size", "9", "--mcap", "run.mcap"], "found --max-bag-size without --bag"),
        (["--mcap", "run.mcap", "--bag", "run"], "not allowed with"),
        (["--flush", "-1"], "0 or more"),
        (["--accel"], "found --accel without a log"),
        (["--mcap", "."], "it is a folder, expected the name of a file"),
        (["--wrench", "BAG", "--topic", "a"], "expected TOPIC=CHANNEL"),
    ],
)
def test_nonsense_is_answered(scene: Path, example_dir: Path, arguments: list[str], says: str) -> None:
    result = command("simulate", scene, *[str(example_dir / "slew.mcap") if a == "BAG" else a for a in arguments])
    assert result.returncode == 2
    assert says in result.stderr


def test_recover_of_nothing_is_a_failure(scene: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    command("simulate", scene, "--mcap", log)
    log.write_bytes(log.read_bytes()[:60])
    result = command("recover", log, tmp_path / "saved.mcap")
    assert result.returncode == 2
    assert "found no whole message in" in result.stderr


def test_recover_gives_a_whole_file(scene: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    command("simulate", scene, "--mcap", log)
    log.write_bytes(log.read_bytes()[:-3000])
    result = command("recover", log, tmp_path / "whole.mcap")
    assert result.returncode == 0, result.stderr
    assert "the file was cut off\n" in result.stdout
    assert "from t = 0 to " in result.stdout
    assert command("recover", log, tmp_path / "whole.mcap").returncode == 0
    whole, cut = (read_bag(path).topics for path in (tmp_path / "whole.mcap", log))
    assert whole.keys() == cut.keys()
    for name, topic in whole.items():
        assert (topic.log_times.tolist(), topic.messages, topic.texts) == (
            cut[name].log_times.tolist(),
            cut[name].messages,
            cut[name].texts,
        )
        assert topic.numbers.tobytes() == cut[name].numbers.tobytes()


def test_recover_counts_from_the_first_message(tmp_path: Path) -> None:
    """Times count from the first message, as in `inspect`, since stamps of the epoch tell a reader nothing."""
    rows = "".join(f"{1_700_000_000_123_456_789 + k * 500_000_000},1,0,0,0,0,0\n" for k in range(5000))
    (tmp_path / "commands.csv").write_text("time_ns,force_x,force_y,force_z,torque_x,torque_y,torque_z\n" + rows)
    assert command("convert", tmp_path / "commands.csv", tmp_path / "commands.mcap").returncode == 0
    result = command("recover", tmp_path / "commands.mcap", tmp_path / "saved.mcap")
    assert "saved.mcap: 5000 messages from t = 0 to 2499.5 s; the file was whole" in result.stdout
    assert "saved.mcap; t counts from the first message, log time 1700000000.123456789 s" in result.stdout

    data = bytearray((tmp_path / "commands.mcap").read_bytes())
    begin = data.index(b"\x28\xb5\x2f\xfd", len(data) // 2)  # of what is compressed: not the first chunk
    data[begin + 4 : begin + 24] = bytes(20)
    (tmp_path / "commands.mcap").write_bytes(data)
    result = command("recover", tmp_path / "commands.mcap", tmp_path / "saved.mcap")
    lost = re.search(r"missing: t = ([\d.]+) to ([\d.]+) s", result.stdout)
    assert lost is not None
    assert 0.0 < float(lost[1]) < float(lost[2]) <= 2499.5
    assert "t counts from the first message, log time 1700000000.123456789 s" in result.stdout


def test_replay_is_the_same_to_the_last_bit_or_fails(scene: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    command("simulate", scene, "--bag", tmp_path / "run", "--duration", "1")
    result = command("replay", tmp_path / "run")
    assert result.returncode == 0, result.stderr
    assert "replayed 201 samples" in result.stdout
    assert result.stdout.endswith("\nthe same to the last bit\n")

    command("simulate", scene, "--mcap", log, "--duration", "1")
    (tmp_path / "cut.mcap").write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    last = command("replay", tmp_path / "cut.mcap").stdout.splitlines()[-1]
    assert last.startswith("what is left is the same to the last bit, but ")
    assert "prove" in last

    # The log of another body with the scene of this one.
    other = tmp_path / "other.yaml"
    other.write_text(SCENE.replace("mass: 2", "mass: 3").replace("[1, 2, 3]", "[1, 2, 2]"))
    command("simulate", other, "--mcap", log)
    said = bytes(read_bag(log).attachments["scene.yaml"])
    mixed = edited(log, tmp_path / "mixed.mcap", scene=said.replace(b"[1, 2, 2]", b"[1, 2, 3]"))
    result = command("replay", mixed)
    assert result.returncode == 1
    assert "first difference at" in result.stdout
    assert "NOT the same bits" in result.stdout


def test_convert_goes_by_the_endings(scene: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    command("simulate", scene, "--mcap", log)
    result = command("convert", log, tmp_path / "run.csv")
    assert result.returncode == 0, result.stderr
    assert "run.csv: 2001 samples" in result.stdout
    refused = command("convert", log, tmp_path / "run.xlsx")
    assert refused.returncode == 2
    assert "expected a log to .rrd, .csv, .parquet or .yaml" in refused.stderr


def test_the_scene_of_a_log_is_taken_out_and_run_again(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, again = str(tmp_path / "run.mcap"), str(tmp_path / "again.yaml")
    assert main(["simulate", str(scene), "--set", "duration=0.2", "--mcap", log]) == 0
    assert main(["convert", log, again]) == 0
    assert f"wrote {again}: the scene of {log}" in capsys.readouterr().out
    assert main(["simulate", again]) == 0
    assert "after 0.2 s" in capsys.readouterr().out


def test_recover_names_a_file_that_is_missing(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, saved = tmp_path / "bag", str(tmp_path / "saved")
    split = ["--bag", str(folder), "--max-bag-duration", "0.1"]
    assert main(["simulate", str(scene), "--set", "duration=0.3", *split]) == 0
    (folder / "bag_1.mcap").unlink()
    assert main(["recover", str(folder), saved]) == 1
    assert "\nbag_1.mcap is missing\n" in capsys.readouterr().out
    (folder / "bag_2.mcap").unlink()
    assert main(["recover", str(folder), saved]) == 0
    assert "the next file, bag_1.mcap, is missing" in capsys.readouterr().out


@pytest.mark.parametrize("ending", ["mcap", "bag", "rrd", "html", "csv", "parquet", "r.mcap"])
def test_missing_folders_are_made_and_a_file_in_the_way_is_named(
    tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if ending in ("html", "parquet"):
        pytest.importorskip({"html": "matplotlib", "parquet": "pyarrow"}[ending])
    log, blocked = tmp_path / "log.mcap", tmp_path / "blocked"
    fly = ["simulate", "config/dzhanibekov.yaml", "--set", "duration=0.1"]
    assert main([*fly, "--mcap", str(log)]) == 0
    blocked.write_text("a file")
    for folder, code in ((tmp_path / "new" / "folder", 0), (blocked, 2)):
        target = str(folder / f"run.{ending}")
        option = {"mcap": "--mcap", "bag": "--bag", "rrd": "--rerun", "html": "--html"}.get(ending)
        command = [*fly, option, target] if option else ["convert", str(log), target]
        assert main(["recover", str(log), target] if ending == "r.mcap" else command) == code
    assert f"the folder {blocked}" in capsys.readouterr().err
