"""Generated pages are up to date, the diagram names existing files, and the site has no broken link."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

from rb_dynamics import METHODS

TENS = {2: "twenty", 3: "thirty", 4: "forty"}
UNITS = ("", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


def run(root: Path, *command: str) -> str:
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, *command], cwd=root, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.ros
def test_the_reference_is_what_the_code_says(root: Path) -> None:
    run(root, "tools/make_reference.py", "--check")


def test_the_diagram_names_what_is_there(root: Path) -> None:
    run(root, "tools/make_diagram.py", "--check")


@pytest.mark.skipif(find_spec("mkdocs") is None, reason="extra 'docs' is not installed")
def test_the_site_has_no_link_to_nowhere(root: Path, tmp_path: Path) -> None:
    run(root, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path))

    assert (tmp_path / "config" / "slew.yaml").is_file()
    assert 'href="../config/slew.yaml"' in (tmp_path / "how-to" / "bodies.html").read_text("utf-8").replace(
        "../../", "../"
    )
    assert "angular_velocity_body" in (tmp_path / "reference" / "python.html").read_text("utf-8")
    lecture = (tmp_path / "lecture.html").read_text("utf-8")
    assert lecture.count("<math") == (root / "docs" / "lecture.md").read_text("utf-8").count("$`")
    assert "$<code>" not in lecture


@pytest.mark.skipif(find_spec("mkdocs") is None, reason="extra 'docs' is not installed")
def test_a_link_to_nowhere_is_found(root: Path, tmp_path: Path) -> None:
    """By the settings of the site, of two pages instead of all."""
    settings, _, _ = (root / "mkdocs.yml").read_text("utf-8").partition("\nnav:\n")
    (tmp_path / "mkdocs.yml").write_text(settings, "utf-8")
    for folder in ("docs", "examples/plugin", "tools"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copy(root / "tools" / "site_hooks.py", tmp_path / "tools")
    links = " ".join(f"[x]({target})" for target in ("missing.md", "index.md#missing", "../examples/plugin"))
    for name, text in (("index.md", "# Home\n\n[x](limits.md#limits)\n"), ("limits.md", f"# Limits\n\n{links}\n")):
        (tmp_path / "docs" / name).write_text(text, "utf-8")

    with pytest.raises(AssertionError, match="Aborted with 3 warnings in strict mode"):
        run(tmp_path, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site"))


def test_every_page_is_in_the_navigation(root: Path) -> None:
    config = yaml.safe_load((root / "mkdocs.yml").read_text("utf-8"))
    pages = {path.relative_to(root / "docs").as_posix() for path in (root / "docs").rglob("*.md")}

    named = {page for page in re.findall(r"[\w./-]+\.md", str(config["nav"])) if (root / "docs" / page).exists()}
    assert named == pages - {"lecture.template.md"}


def test_the_page_on_methods_has_them_all(root: Path) -> None:
    text = (root / "docs" / "how-to" / "solver.md").read_text("utf-8")
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    assert {name for row in rows for name in re.findall(r"`(\w+)`", row)} == {"auto", *METHODS.own}


def test_pages_count_the_methods_right(root: Path) -> None:
    """If this fails, correct the sentence; for docs/scaling.md run `make scaling`."""
    ten, one = divmod(len(METHODS.own), 10)
    words = f"{TENS[ten]}-{UNITS[one]}".removesuffix("-")
    right = {str(len(METHODS.own)), words, words.capitalize()}
    counted = {}
    for path in (root / "README.md", *(root / "docs").rglob("*.md")):
        text = path.read_text("utf-8")
        if found := re.findall(rf"\b(\d\d|(?i:{'|'.join(TENS.values())})[\w-]*) methods\b|, of (\d+), against", text):
            counted[path.relative_to(root).as_posix()] = {number for pair in found for number in pair if number}

    assert {"README.md", "docs/scaling.md", "docs/tutorials/choose-a-method.md"} <= set(counted)
    assert {name: numbers for name, numbers in counted.items() if not numbers <= right} == {}, f"there are {words}"


@pytest.mark.parametrize(
    ("page", "title", "script"),
    [
        ("methods.md", "## ", "benchmarks/methods.py --page docs/methods.md"),
        ("scaling.md", "## A step in plain Python\n", "benchmarks/scaling.py"),
    ],
)
def test_every_method_is_in_the_measured_tables(root: Path, page: str, title: str, script: str) -> None:
    _, *sections = (root / "docs" / page).read_text("utf-8").split(title)
    # A closed form has no error to be had for a step.
    measured = {name for name, method in METHODS.own.items() if method.order is not None}
    tables = [re.findall(r"^\| `?(\w+)`? \|", section.partition("\n## ")[0], re.MULTILINE) for section in sections]
    for named in filter(None, tables):
        assert set(named) - {"method", "exact"} == measured, f"run python {script}"
    assert any(tables)
