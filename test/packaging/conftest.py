"""A copy of the source tree, so that builds leave no files in the original."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

FOLDERS = ("config", "examples", "launch", "rb_dynamics", "resource")
FILES = (
    "CHANGELOG.rst",
    "CONTRIBUTING.md",
    "LICENSE",
    "MANIFEST.in",
    "Makefile",
    "README.md",
    "package.xml",
    "pyproject.toml",
    "setup.cfg",
    "setup.py",
)


@pytest.fixture(scope="session")
def source(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a fresh copy of the sources of the package."""
    copy = tmp_path_factory.mktemp("workspace") / "src" / "rb_dynamics"
    copy.mkdir(parents=True)
    for folder in FOLDERS:
        shutil.copytree(root / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for file in FILES:
        shutil.copy(root / file, copy)
    return copy
