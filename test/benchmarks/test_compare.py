"""The comparison with other simulators runs, its references agree with 30 digits, and its C code gives our bits."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

STATES = {"tumble": ("dzhanibekov", 100.0), "boxes": ("boxes_rotation", 10.0)}


@pytest.fixture(scope="module")
def peers(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("peers.problem")


@pytest.mark.parametrize("name", STATES)
def test_reference_is_that_of_30_digits(
    peers: ModuleType, root: Path, name: str, script: Callable[[str], ModuleType]
) -> None:
    case, time = STATES[name]
    document = json.loads((root / "test" / "verification" / "data" / "free_motion.json").read_text(encoding="utf-8"))
    (state,) = (s for s in document["cases"][case]["states"] if s["t"] == time)
    w, x, y, z = map(float, state["q"])
    task = peers.problem(name)

    expected = peers.Answer.of([x, y, z, w], [0.0] * 3, [0.0] * 3)

    assert task.duration == time
    assert peers.attitude_error(script("peers.reference").reference(task), expected) < 1e-12


def test_error_is_the_angle_between_attitudes(peers: ModuleType) -> None:
    def turned(angle: float) -> object:
        return peers.Answer.of([0.0, np.sin(0.5 * angle), 0.0, np.cos(0.5 * angle)], [0.0] * 3, [0.0] * 3)

    assert peers.attitude_error(turned(0.3 + 1e-12), turned(0.3)) == pytest.approx(1e-12, rel=1e-3)
    assert peers.attitude_error(turned(0.3 + 2.0 * np.pi), turned(0.3)) < 1e-14
    assert peers.attitude_error(turned(np.nan), turned(0.3)) == np.inf


def test_every_way_of_ours_has_a_look_of_its_own(peers: ModuleType, script: Callable[[str], ModuleType]) -> None:
    pytest.importorskip("matplotlib")
    ours, found = script("peers.ours"), script("page").OURS
    assert len(set(found)) == len(found)
    for name in peers.PROBLEMS:
        assert len(ours.ways(peers.problem(name))) <= len(found), name


@pytest.mark.parametrize("bodies", [1, 64])
def test_c_takes_our_step_to_the_bit(peers: ModuleType, bodies: int, script: Callable[[str], ModuleType]) -> None:
    """The goal for the time of a step only makes sense for the same arithmetic."""
    c = script("peers.c")
    try:
        c.version()
    except FileNotFoundError as error:
        pytest.skip(str(error))
    task = peers.ensemble(bodies)

    ((_, ours), *_) = script("peers.ours").kernels(task, 0.01, 20).items()
    found = next(run for name, run in c.kernels(task, 0.01, 20).items() if name.startswith("same rounding"))

    np.testing.assert_array_equal(found()(), ours()())


def test_runs_with_scipy_alone(root: Path) -> None:
    command = [sys.executable, str(root / "benchmarks" / "compare.py"), "--quick"]
    environment = os.environ | {"PYTHONPATH": str(root), "RB_DYNAMICS_COMPILE": "never"}

    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)

    assert done.returncode == 0, done.stderr
    assert "rb_dynamics free_motion" in done.stdout or "rb_dynamics driven_motion" in done.stdout
    assert "scipy DOP853" in done.stdout
    assert "no better than" not in done.stdout
