"""The rates of logs."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import pytest

pytest.importorskip("rerun")
pytest.importorskip("mcap")


def test_the_rate_of_each_way_is_printed(
    script: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = script("recording")
    for name, value in (("SAMPLES", 150), ("WRITTEN", 100), ("REPEATS", 1), ("BATCH_ROWS", 64)):
        monkeypatch.setattr(recording, name, value)
    recording.main()
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("writer", "mcap", "sink", "columns", "scalars"))
