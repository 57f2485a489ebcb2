"""Paths of logs: input files are never replaced, and files to keep are moved to the next free number."""

from __future__ import annotations

from pathlib import Path

import pytest

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
