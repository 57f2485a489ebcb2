"""`rb-dynamics compile`: what is compiled ahead, and what is not a kernel."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from rb_dynamics.cli import main
from rb_dynamics.loads.plugin_load import PluginFunction, load_on_numbers
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.batch_kernel import mover
from rb_dynamics.motion.plugin_kernels import PluginKernel
from rb_dynamics.motion.propagation_kernel import NO_STRIDES
from rb_dynamics.numerics import compilation
from rb_dynamics.run.kernels_to_compile import all_kernels, usual_kernels


def test_compiles_what_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("numba")
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    # It may have been compiled in this process.
    monkeypatch.setattr(NO_STRIDES, "_compiled", None)

    assert main(["compile", "_no_strides"]) == 0
    assert compilation.is_cached("_no_strides")
    assert main(["compile", "_no_strides"]) == 0
    assert "was there" in capsys.readouterr().out
    assert main(["compile", "_nothing"]) == 2
    error = capsys.readouterr().err
    assert "found kernels ['_nothing'], expected some of _no_strides, " in error
    assert ", propagate, " in error


def test_without_names_the_usual_kernels_are_shared_out_between_processes(
    capfd: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("numba")

    assert main(["compile"]) == 0

    *lines, last = capfd.readouterr().out.splitlines()
    assert sorted(line.split()[0] for line in lines) == sorted(usual_kernels())
    assert last == f"in {compilation.cache_folder()}"
    assert all(map(compilation.is_cached, usual_kernels()))


def test_each_kernel_has_its_own_name() -> None:
    usual, every = usual_kernels(), all_kernels()
    of_many = {each.name for method in METHODS.usable() for each in mover(method).kernels if each is not None}
    assert {"lanes_rk4", "one_by_one_rk4"} <= of_many <= every.keys()

    named = {"propagate", "strides_by_own_taylor", "_run_on_numbers_dop853", "_run_on_numbers_dlm6_with_effects"}
    assert named <= usual.keys() < every.keys()
    assert all(kernel.name == name for name, kernel in every.items())


def test_functions_of_plugins_are_compiled_beside_unless_their_source_has_changed(
    tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("numba")
    (tmp_path / "own_pushes.py").write_text(
        "def pushed(n, point):\n    return (n, 0.0, 0.0), (0.0, 0.0, n * point.time)\n", encoding="utf-8"
    )
    # The other process gets the path.
    monkeypatch.syspath_prepend(tmp_path)
    pushed = importlib.import_module("own_pushes").pushed
    wanted = PluginKernel(PluginFunction("push", load_on_numbers, partial(pushed, 1.0)))
    env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(root)}
    # The folder is made by the run that asks.
    folder = tmp_path / "rb_dynamics" / compilation.cache_folder().name
    folder.mkdir(parents=True)
    asked = [
        f"{wanted.name} {wanted.order}",
        f"load_on_numbers_before {wanted.order}",
        "load_on_numbers_lost bm90aGluZw==",
    ]

    command = [sys.executable, "-m", "rb_dynamics", "compile", "--beside"]
    subprocess.run(command, input="\n".join(asked), env=env, capture_output=True, text=True, check=True)

    assert [path.stem for path in folder.glob("*.kernel")] == [wanted.name]
    (failure,) = folder.glob("*.failure")
    assert failure.stem == "load_on_numbers_lost"
    assert failure.read_text(encoding="utf-8").startswith("another process cannot import it: UnpicklingError")
