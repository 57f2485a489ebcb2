"""Paths of logs: input files are never replaced, and files to keep are moved to the next free number."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import command

from rb_dynamics.cli import main
from rb_dynamics.errors import LogError
from rb_dynamics.formats.output_file import OutputFile, move_aside, require_apart, require_other


def test_an_earlier_file_is_replaced_but_not_where_the_new_one_cannot_be_opened(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_text("an earlier one")
    file = OutputFile(path)
    file.write(b"new")
    file.close()
    assert path.read_bytes() == b"new"
    with pytest.raises(LogError, match=r"cannot write .*run\.mcap"):
        OutputFile(path / "run.mcap")
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("earlier", [False, True])
def test_of_two_that_write_one_file_at_once_one_is_whole(tmp_path: Path, whole: bool, earlier: bool) -> None:
    """Each wrote into the file of the other, and both said that all was well."""
    path = tmp_path / "run.csv"
    if earlier:
        path.write_text("an earlier one")
    with contextlib.ExitStack() as stack:
        files = [
            stack.enter_context(OutputFile.whole(path) if whole else contextlib.closing(OutputFile(path)))
            for _ in range(2)
        ]
        for _ in range(3):
            for file, data in zip(files, (b"first", b"2nd"), strict=True):
                file.write(data)
    assert path.read_bytes() in (b"first" * 3, b"2nd" * 3)
    assert [each.name for each in tmp_path.iterdir()] == ["run.csv"]


def test_what_a_killed_writer_left_is_removed_and_what_is_in_use_is_not(tmp_path: Path) -> None:
    path = tmp_path / "run[1].csv"
    writes = "import sys, time; from pathlib import Path; from rb_dynamics.formats.output_file import OutputFile\n"
    writes += "with OutputFile.whole(Path(sys.argv[1])) as file: print(flush=True); time.sleep(600)"

    def begun(target: Path) -> tuple[subprocess.Popen[str], Path]:
        before = set(tmp_path.iterdir())
        process = subprocess.Popen([sys.executable, "-c", writes, target], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        assert process.stdout.readline() == "\n"
        (part,) = {*tmp_path.iterdir()} - before
        return process, part

    living, in_use = begun(path)
    killed, left = begun(path)
    killed_too, of_another = begun(tmp_path / "run.csv")
    for process in (killed, killed_too):
        process.kill()
        process.communicate()
    # The number of the process counts on another machine, or has no meaning.
    start, number = left.name.split(f".{killed.pid}.")[0], killed.pid
    elsewhere = left.with_name(left.name.replace(start, f"{start[:-12]}{'0' * 12}"))
    unknown = left.with_name(left.name.replace(f".{number}.", ".x."))
    for each in (elsewhere, unknown):
        each.write_text("of others")
    try:
        with OutputFile.whole(path) as file:
            file.write(b"new")
        assert {*tmp_path.iterdir()} == {path, in_use, of_another, elsewhere, unknown}
    finally:
        living.kill()
        living.communicate()


def test_the_target_of_a_link_is_replaced(tmp_path: Path) -> None:
    link, target = tmp_path / "link.mcap", tmp_path / "run.mcap"
    link.symlink_to(target)
    for data in (b"first", b"second"):
        with contextlib.closing(OutputFile(link)) as file:
            file.write(data)
        assert (link.is_symlink(), target.read_bytes()) == (True, data)


def test_what_is_read_is_refused_under_any_name(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag_0.mcap").write_text("a bag")
    (tmp_path / "other").symlink_to(bag / "bag_0.mcap")
    for target in (bag, bag / "bag_0.mcap", tmp_path / "other", tmp_path, bag / ".." / "bag"):
        with pytest.raises(LogError, match=r"is, or holds, what is read \(.*bag\); give another name"):
            require_other(target, bag, tmp_path / "absent")
    for target in (bag / "new.csv", tmp_path / "new", tmp_path / "bag2"):
        require_other(target, bag)


def test_standard_deviations_are_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.yaml").write_text("body: {mass: 1}\nduration: 1\n")
    sigmas = tmp_path / "sigmas.yaml"
    sigmas.write_text("mass: 0.1\n")
    for option in ("--html", "--mcap"):
        arguments = ["simulate", str(tmp_path / "s.yaml"), "--covariance", str(sigmas), option, str(sigmas)]
        assert main(arguments) == 2
        assert "is, or holds, what is read" in capsys.readouterr().err
    assert sigmas.read_text() == "mass: 0.1\n"


def test_earlier_logs_are_kept_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    assert move_aside(path) is None
    for text in ("first", "second", "third"):
        path.write_text(text)
        move_aside(path)
    assert {each.name: each.read_text() for each in tmp_path.iterdir()} == {
        "run.1.mcap": "first",
        "run.2.mcap": "second",
        "run.3.mcap": "third",
    }


def test_the_folder_of_a_bag_is_kept_and_any_other_left_alone(tmp_path: Path) -> None:
    bag = tmp_path / "flight.v2"
    bag.mkdir()
    assert move_aside(bag) is None
    (bag / "notes.txt").write_text("mine")
    assert move_aside(bag) is None
    (bag / "flight.v2_0.mcap").write_text("a bag")
    # It would be moved with the rest.
    assert move_aside(bag) is None
    (bag / "notes.txt").unlink()
    assert move_aside(bag) == tmp_path / "flight.v2.1"
    assert not bag.exists()


@pytest.mark.parametrize("other", ["q", "./q", "link/q", "sub/../q"])
def test_two_outputs_on_one_path_are_refused_however_it_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], other: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(tmp_path)
    (tmp_path / "sub").mkdir()
    (tmp_path / "s.yaml").write_text("body: {mass: 1}\nduration: 1\n")
    assert main(["simulate", "s.yaml", "--mcap", "q", "--html", other]) == 2
    assert "more than once, expected a file of its own for each output" in capsys.readouterr().err
    assert not (tmp_path / "q").exists()
    require_apart(["q", "sub/q"])


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["convert", "run.mcap", "out.csv"], "out.csv"),
        (["convert", "run.mcap", "out.parquet"], "out.parquet"),
        (["convert", "run.mcap", "out.rrd"], "out.rrd"),
        (["convert", "run.mcap", "out.rrd", "--pose-topic", "pose"], "out.rrd"),
        (["convert", "run.mcap", "out.mcap"], "out.mcap"),
        (["convert", "run.mcap", "out.yaml"], "out.yaml"),
        (["recover", "run.mcap", "out.mcap"], "out.mcap"),
        (["inspect", "run.mcap", "--html", "out.html"], "out.html"),
        (["compare", "run.mcap", "run.mcap", "--rerun", "out.rrd"], "out.rrd"),
        (
            ["identify", "scene.yaml", "run.mcap", "--fit", "inertia_ratios", "--starts", "1", "--out", "out.yaml"],
            "out.yaml",
        ),
    ],
)
def test_where_a_disk_is_full_no_torso_is_left_and_an_earlier_file_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], name: str
) -> None:
    resource = pytest.importorskip("resource")
    monkeypatch.chdir(tmp_path)
    body = "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}"
    Path("scene.yaml").write_text(f"{body}\nduration: 2\ninitial: {{angular_velocity_body: [1, 2, 3]}}\n")
    assert command("simulate", "scene.yaml", "--mcap", "run.mcap").returncode == 0
    Path(name).write_text("an earlier one")
    before, (soft, hard) = sorted(tmp_path.iterdir()), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (64, hard))
    try:
        done = command(*words)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert done.returncode == 2
    assert name in done.stderr
    assert "File too large" in done.stderr
    assert Path(name).read_text() == "an earlier one"
    assert sorted(tmp_path.iterdir()) == before
    assert command(*words).returncode == 0
    assert Path(name).stat().st_size > 64


def test_a_link_stays_one_and_what_is_no_file_is_written_itself(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "there" / "file")
    for _ in range(2):
        with OutputFile.whole(tmp_path / "out") as file:
            file.write(b"new")
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "there" / "file").read_bytes() == b"new"
    with OutputFile.whole(Path("/dev/null")) as file:
        file.write(b"new")
    assert not Path("/dev/null").is_file()
