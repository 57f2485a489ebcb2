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
