"""The order of layers: each part of the package imports only those before it, as the package's docstring says."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

import rb_dynamics

PACKAGE = Path(str(rb_dynamics.__file__)).parent
ORDER = re.findall(r"`(\w+)`", (rb_dynamics.__doc__ or "").partition("only those before it:")[2].partition(".\n")[0])
PARTS = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in PACKAGE.rglob("*.py")}


@cache
def imported(path: Path) -> list[str]:
    """Return the modules that a file imports: at once, later, or for type checkers only."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [f"{node.module}.{name.name}" for name in node.names]
    return found


def test_order_names_every_part_once() -> None:
    assert sorted(ORDER) == sorted(PARTS - {"__init__", "__main__"})


@pytest.mark.parametrize("part", ORDER)
def test_part_imports_only_those_before_it(part: str) -> None:
    files = [PACKAGE / f"{part}.py", *(PACKAGE / part).rglob("*.py")]
    found = {name for path in files if path.exists() for name in imported(path)}
    others = {name.split(".")[1] for name in found if name.startswith("rb_dynamics.")} - {part}

    assert others <= set(ORDER[: ORDER.index(part)])


def test_scenes_know_of_motion_only_the_names_of_methods() -> None:
    files = (PACKAGE / "scene").rglob("*.py")
    found = {name for path in files for name in imported(path)}

    motion = {name for name in found if name.startswith("rb_dynamics.motion")}
    assert motion == {"rb_dynamics.motion.METHODS", "rb_dynamics.motion.remedy"}


def test_only_the_folder_of_the_node_knows_ros() -> None:
    knowing = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if any(name.split(".")[0] == "rclpy" for name in imported(path))
    }

    assert knowing
    assert all(name.startswith("ros/") for name in knowing)
