"""`rb-dynamics compile`: what is compiled ahead, and what is not a kernel."""

from __future__ import annotations

from pathlib import Path

import pytest

from rb_dynamics.cli import main
from rb_dynamics.motion.kernels_to_compile import all_kernels, usual_kernels
from rb_dynamics.motion.propagation_kernel import NO_STRIDES
from rb_dynamics.numerics import compilation


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
    assert "found kernels ['_nothing'], expected some of _no_strides, propagate" in capsys.readouterr().err


def test_each_kernel_has_its_own_name() -> None:
    usual, every = usual_kernels(), all_kernels()

    named = {"propagate", "strides_by_own_taylor", "_run_on_numbers_dop853", "_run_on_numbers_dlm6_with_effects"}
    assert named <= usual.keys() < every.keys()
    assert all(kernel.name == name for name, kernel in every.items())
