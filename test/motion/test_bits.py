"""The bits of a run do not depend on the version of Python.

From 3.12 on `sum` of floats is compensated, and `math.hypot` was rewritten more than once. Code that affects the
bits of a body or a step uses neither, but explicit sums, `math.fsum` or `vector.norm`.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import rb_dynamics

ROOT = Path(rb_dynamics.__file__).parent
MODULES = [
    *(ROOT / "numerics" / f"{name}.py" for name in ("vector", "rotation", "sincos", "elliptic", "nanoseconds")),
    *(ROOT / "body" / f"{name}.py" for name in ("principal_axes", "rigid_body", "state", "particles", "shapes")),
    ROOT / "study" / "campaign" / "scenes.py",
    *sorted((ROOT / "loads").glob("*.py")),
    *sorted((ROOT / "motion").glob("*.py")),
]
DEPENDS_ON_THE_VERSION = {"sum", "hypot", "dist", "sumprod"}


def found_in(source: str) -> set[str]:
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, (ast.Name, ast.Attribute))]
    return {node.id if isinstance(node, ast.Name) else node.attr for node in nodes} & DEPENDS_ON_THE_VERSION


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_nothing_that_makes_a_motion_uses_what_other_versions_of_python_round_differently(path: Path) -> None:
    assert found_in(path.read_text(encoding="utf-8")) == set()


def test_the_search_finds_what_it_looks_for() -> None:
    assert found_in("a = sum(x) + math.hypot(*y)\nb = list(map(sum, z))") == {"sum", "hypot"}
