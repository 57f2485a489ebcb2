"""The public names: found on access, and the same for type checkers as for Python."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rb_dynamics


def test_a_type_checker_sees_what_python_finds() -> None:
    tree = ast.parse(Path(str(rb_dynamics.__file__)).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert [(node.module, node.names[0].asname) for node in imports] == [
        (rb_dynamics._HOMES[name], name) for name in rb_dynamics.__all__
    ]


@pytest.mark.parametrize("name", rb_dynamics.__all__)
def test_name_stands_for_what_its_module_has(name: str) -> None:
    found = getattr(rb_dynamics, name)
    assert found is getattr(sys.modules[rb_dynamics._HOMES[name]], name)
    assert name in dir(rb_dynamics)


def test_submodule_is_found_by_its_name() -> None:
    subprocess.run([sys.executable, "-c", "import rb_dynamics; rb_dynamics.scene.read_scene"], check=True)


def test_unknown_name() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = rb_dynamics.nothing
