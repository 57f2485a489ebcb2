"""Modules imported at the start of each command, which determine its start-up time; no time is measured."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from bag_rows import write_rows

from rb_dynamics.formats import cdr
from rb_dynamics.formats.message_types import WRENCH

OPTIONAL = {"mcap", "numba", "rclpy", "rerun", "tqdm", "matplotlib", "trimesh"}
SLOW = {"numpy", "scipy", "importlib.metadata", "email", *OPTIONAL}

LOADED_BY = """
import sys
before = set(sys.modules)
from rb_dynamics.cli import main
try:
    code = main(sys.argv[1:])
except SystemExit as end:
    code = end.code
assert not code, code
print("LOADED", *sorted(set(sys.modules) - before))
"""


def loaded(root: Path, *arguments: str) -> set[str]:
    """Return the modules that a command imports, without those of the bare interpreter."""
    command = [sys.executable, "-c", LOADED_BY, *arguments]
    result = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    return set(result.stdout.rpartition("LOADED")[2].split())


def test_help_imports_neither_libraries_nor_the_simulation(root: Path) -> None:
    found = loaded(root, "--help")
    assert "rb_dynamics.cli" in found
    assert not found & {*SLOW, "yaml", "dataclasses"}
    allowed = {
        "errors",
        "numerics",
        "numerics.number_parsing",
        "numerics.command_line_numbers",
        "run",
        "run.stop_signals",
    }
    ours = {name.removeprefix("rb_dynamics.") for name in found if name.startswith("rb_dynamics.")}
    assert {name for name in ours if not name.startswith("cli")} <= allowed


def test_simulate_imports_what_it_runs(root: Path) -> None:
    found = loaded(root, "simulate", "config/slew.yaml", "--duration", "1")
    assert {"rb_dynamics.run.simulation", "yaml"} <= found
    unused = {"rb_dynamics.study", "rb_dynamics.sinks.mcap_sink", "rb_dynamics.report"}
    assert not found & {*SLOW, *unused}


def test_simulate_with_commands_imports_no_masked_arrays_sensors_or_spelling(root: Path, tmp_path: Path) -> None:
    at = [k * 10**9 for k in range(1, 9)]
    rows = [("/wrench/body", WRENCH, ns, cdr.encode(WRENCH, ns, "body", (0.1,) + (0.0,) * 5)) for ns in at]
    bag = write_rows(tmp_path / "commands.mcap", rows)
    found = loaded(root, "simulate", "config/slew.yaml", "--wrench", str(bag))
    assert "rb_dynamics.logs.stray_stamps" in found
    assert not found & {"numpy.ma", "difflib", "rb_dynamics.sensors.imu"}


def test_a_command_seldom_looks_for_garbage(root: Path) -> None:
    code = f"import gc\n{LOADED_BY}\nprint(gc.get_threshold()[0])"
    command = [sys.executable, "-c", code, "body", "config/slew.yaml"]
    result = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    assert int(result.stdout.split()[-1]) >= 100_000


@pytest.mark.parametrize(("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_linear_algebra_has_one_thread_unless_told_otherwise(given: dict[str, str], threads: str) -> None:
    """Two threads took twice the processor time for an inspection, and no less time."""
    name = "OPENBLAS_NUM_THREADS"
    code = f"import os; from rb_dynamics.cli import main; main(['compile', '_nothing']); print(os.environ[{name!r}])"
    env = {key: value for key, value in os.environ.items() if key != name} | given
    result = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert result.stdout.split() == [threads]


def test_the_library_imports_nothing_before_it_is_used() -> None:
    code = "import sys, rb_dynamics; print(*(name for name in sys.modules if name.startswith('rb_dynamics')))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["rb_dynamics"]
