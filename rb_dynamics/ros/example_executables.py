"""The examples as executables: `regulate`, `command` and `control`, by `ros2 run rb_dynamics` and in pip's `bin`.

They are the scripts in `examples/`, run as they are.
"""

from __future__ import annotations

import runpy
import sys

from rb_dynamics.scene.shipped import shipped


def regulate() -> None:
    """Run `examples/regulate.py`, which holds an attitude."""
    _run("regulate")


def command() -> None:
    """Run `examples/command.py`, which turns the body for a second."""
    _run("command")


def control() -> None:
    """Run `examples/control.py`, which pauses, steps or resets the node."""
    _run("control")


def _run(name: str) -> None:
    path = str(shipped(f"examples/{name}.py"))
    sys.argv[0] = name
    runpy.run_path(path, run_name="__main__")
