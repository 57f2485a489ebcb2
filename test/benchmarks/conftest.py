"""Import path for the scripts in benchmarks/, which is not a package."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def script(root: Path) -> Callable[[str], ModuleType]:
    """Return a function that imports a module of that folder by name, like a script run there."""

    def imported(name: str) -> ModuleType:
        sys.path.insert(0, str(root / "benchmarks"))
        try:
            return import_module(name)
        finally:
            sys.path.remove(str(root / "benchmarks"))

    return imported
