"""Every test that a page names exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))


@pytest.fixture(scope="module")
def known() -> set[str]:
    """The names of all files and functions of tests."""
    files = list((ROOT / "test").rglob("test_*.py"))
    functions = (re.findall(r"def (test_\w+)", file.read_text(encoding="utf-8")) for file in files)
    return {file.name for file in files}.union(*functions)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_tests_that_a_page_names_are_there(page: Path, known: set[str]) -> None:
    named = set(re.findall(r"\btest_\w+(?:\.py)?", page.read_text(encoding="utf-8")))
    assert named <= known


def test_the_search_finds_them(known: set[str]) -> None:
    assert "test_names_of_tests.py" in known
    assert "test_no_stamp_is_ever_zero" in known
