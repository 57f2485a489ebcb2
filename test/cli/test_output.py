"""What commands share to print and write their results."""

from __future__ import annotations

import io
from argparse import Namespace
from pathlib import Path

import pytest

from rb_dynamics.cli import output
from rb_dynamics.errors import LogError


def test_a_terminal_that_lacks_a_character_shows_its_escape(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", stream)

    output.show(Namespace(json=False), dict, lambda: "1 ± 2")

    assert stream.buffer.getvalue() == b"1 \\xb1 2\n"


def test_folders_are_made_for_files_and_not_for_viewers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    output.prepare(("pages/a.html", "rerun+http://127.0.0.1:9876/proxy", "spawn", None), "scene.yaml", None)

    assert [path.name for path in tmp_path.iterdir()] == ["pages"]


def test_an_input_is_not_written_to(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    log.touch()
    with pytest.raises(LogError, match=r"run\.mcap"):
        output.prepare([str(log)], str(log))


def test_without_a_terminal_a_line_tells_the_progress_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    times = iter([0.0, 4.0, 11.0, 15.0, 22.0, 40.0])
    monkeypatch.setattr("time.monotonic", lambda: next(times))
    with output.counting("campaign.yaml", "run", 20, 100) as tell:
        for done in (30, 40, 50, 60, 100):
            tell(done, 100)
    assert capsys.readouterr().err.splitlines() == [
        "campaign.yaml: 40 of 100 runs, 11 s passed, some 33 s left",
        "campaign.yaml: 60 of 100 runs, 22 s passed, some 22 s left",
    ]
