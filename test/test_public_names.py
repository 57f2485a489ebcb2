"""The public names: found when they are asked for, and the same to a type checker as to Python."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rb_dynamics


def test_a_type_checker_sees_what_python_finds() -> None:
    tree = ast.parse(Path(str(rb_dynamics.__file__)).read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    seen = {
        name.asname: f"{node.module}"
        for node in imports
        if (node.module or "").startswith("rb_dynamics.")
        for name in node.names
    }
    assert seen == {name: f"rb_dynamics.{home}" for name, home in rb_dynamics._HOMES.items()}


@pytest.mark.parametrize("name", rb_dynamics.__all__)
def test_name_stands_for_what_its_module_has(name: str) -> None:
    found = getattr(rb_dynamics, name)
    assert found is getattr(sys.modules[f"rb_dynamics.{rb_dynamics._HOMES[name]}"], name)
    assert name in dir(rb_dynamics)


@pytest.mark.parametrize("name", ["simulate", "explain", "trade"])
def test_function_is_not_hidden_by_its_module(name: str) -> None:
    """Whichever is imported first."""
    code = (
        f"import rb_dynamics, rb_dynamics.{name}; from rb_dynamics.{name} import {name}; "
        f"assert rb_dynamics.{name} is {name}, rb_dynamics.{name}"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_submodule_is_found_by_its_name() -> None:
    subprocess.run([sys.executable, "-c", "import rb_dynamics; rb_dynamics.numerics.rotation.exp"], check=True)


def test_unknown_name() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = rb_dynamics.nothing
