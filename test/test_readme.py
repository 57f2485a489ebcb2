"""What the README and docs/logs.md show works as it is written."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from rb_dynamics import parse_scene

ROOT = Path(__file__).resolve().parent.parent
README, LOGS = (ROOT / "README.md").read_text(encoding="utf-8"), (ROOT / "docs" / "logs.md").read_text(encoding="utf-8")


def blocks(language: str, text: str = README) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


OFFLINE = [
    pytest.param(line.removeprefix(".venv/bin/rb-dynamics "), marks=[pytest.mark.slow] if "--video" in line else [])
    for block in blocks("sh") + blocks("sh", LOGS)
    for line in block.splitlines()
    if line.startswith(".venv/bin/rb-dynamics ") and not line.startswith(".venv/bin/rb-dynamics node")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, root: Path) -> Path:
    """A folder like the source tree, in which the commands may leave their files."""
    folder = tmp_path_factory.mktemp("readme")
    for name in ("config", "examples"):
        (folder / name).symlink_to(root / name)
    return folder


def test_there_are_commands() -> None:
    assert len(OFFLINE) >= 6


@pytest.mark.parametrize("line", OFFLINE)
def test_offline_command(line: str, folder: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "rb_dynamics", *line.split()], cwd=folder, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout


@pytest.mark.parametrize("code", blocks("python"))
def test_python_block(code: str, folder: Path) -> None:
    result = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize("text", blocks("yaml"))
def test_scene_block(text: str) -> None:
    assert parse_scene(text).body.mass == 16.8


def test_every_link_leads_somewhere(root: Path) -> None:
    for folder, text in ((root, README), (root / "docs", LOGS)):
        targets = re.findall(r"\]\(([^)#]+)\)", text)
        assert targets
        assert [target for target in targets if not (folder / target).exists()] == []
