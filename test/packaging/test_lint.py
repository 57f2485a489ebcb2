"""Linters, formatter, type checker, package.xml, launch file."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path


# From nothing mypy takes a minute of processor time, which a busy machine has to share.
@pytest.mark.timeout(400)
@pytest.mark.parametrize(
    "command",
    [("ruff", "check", "."), ("ruff", "format", "--check", "."), ("mypy", "--strict", "rb_dynamics")],
    ids=["ruff-check", "ruff-format", "mypy"],
)
def test_tool_is_content(root: Path, command: tuple[str, ...]) -> None:
    pytest.importorskip(command[0], reason="extra 'dev' is not installed")

    done = subprocess.run([sys.executable, "-m", *command], cwd=root, capture_output=True, text=True, check=False)

    assert done.returncode == 0, f"{' '.join(command)}:\n{done.stdout}{done.stderr}"


SOURCES = ("examples", "launch", "rb_dynamics", "setup.py")  # what is installed


@pytest.mark.slow  # half a minute; ruff checks and formats by the same rules
@pytest.mark.parametrize(
    ("linter", "options"),
    [
        ("ament_flake8", ("--config", "setup.cfg")),
        ("ament_pep257", ("--convention", "google", "--add-ignore", "D1", "D202", "D401", "D402", "D403", "--")),
    ],
)
def test_ament_linter_is_content(root: Path, linter: str, options: tuple[str, ...]) -> None:
    pytest.importorskip(f"{linter}.main", reason="extra 'dev' is not installed")
    command = f"import sys; from {linter}.main import main; sys.exit(main())"

    done = subprocess.run(
        [sys.executable, "-c", command, *options, *SOURCES], cwd=root, capture_output=True, text=True, check=False
    )

    assert done.returncode == 0, done.stdout + done.stderr


EXTRA = {"PIL", "distributed", "jinja2", "matplotlib", "mcap", "numba", "pyarrow", "rerun", "rosbags", "trimesh"}


def test_files_of_tests_are_left_out_where_what_they_import_is_missing(root: Path) -> None:
    """`colcon test` has no extras, and one file that cannot be collected keeps all others from running."""
    unasked = {}
    for path in (root / "test").rglob("*.py"):
        text = path.read_text("utf-8")
        imports = [node for node in ast.parse(text).body if isinstance(node, ast.Import | ast.ImportFrom)]
        names = {name for node in imports for name in re.findall(r"\w+", ast.unparse(node))[1:2]}
        unasked[str(path)] = names & EXTRA - set(re.findall(r'^\S.*importorskip\("(\w+)', text, re.MULTILINE))

    assert {name: packages for name, packages in unasked.items() if packages} == {}


def test_package_xml_is_valid(root: Path) -> None:
    catkin_package = pytest.importorskip("catkin_pkg.package", reason="extra 'test' is not installed")
    complaints: list[str] = []

    package = catkin_package.parse_package(str(root / "package.xml"), warnings=complaints)
    package.validate(warnings=complaints)

    assert complaints == []
    assert package.get_build_type() == "ament_python"


@pytest.mark.filterwarnings("ignore:nodes.Node.traverse:DeprecationWarning")  # catkin_pkg
def test_changelog_is_one_that_bloom_reads_after_a_release(root: Path) -> None:
    """`catkin_prepare_release` puts version and date for "Forthcoming"."""
    changelog = pytest.importorskip("catkin_pkg.changelog", reason="extra 'test' is not installed")
    text = (root / "CHANGELOG.rst").read_text("utf-8")
    assert "\nForthcoming\n-----------\n" in text
    released = text.replace("Forthcoming\n-----------", "0.12.0 (2026-01-31)\n------------------", 1)

    read = changelog.populate_changelog_from_rst(changelog.Changelog("rb_dynamics"), released)

    first, changes = read.get_content_of_version("0.12.0")
    assert str(first).startswith("First version.")
    assert len(changes.bullets) > 10


def test_launch_file_offers_its_arguments(root: Path) -> None:
    """`launch` is not on PyPI, so the file is read, not run."""
    path = root / "launch" / "rigid_body.launch.py"

    tree = ast.parse(path.read_text(encoding="utf-8"), filename=str(path))

    texts = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
    assert texts >= {"scene", "namespace", "mcap", "rerun", "real_time_factor", "lockstep", "use_sim_time"}
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert "generate_launch_description" in functions
