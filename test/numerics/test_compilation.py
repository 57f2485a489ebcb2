"""How kernels are compiled: what is optimised, and how often."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

import pytest

from rb_dynamics.motion import METHODS
from rb_dynamics.motion.fixed_step_kernel import Kernel
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.compilation import block


def test_neither_a_kernel_nor_what_it_calls_is_optimised_as_numba_does_every_function(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    codegen = pytest.importorskip("numba.core.codegen")
    optimised: list[str] = []
    optimise = codegen.JITCodeLibrary._optimize_final_module

    def counted(library: object) -> None:
        optimised.append(library.name)  # type: ignore[attr-defined]
        optimise(library)

    monkeypatch.setattr(codegen.JITCodeLibrary, "_optimize_final_module", counted)
    # A new copy of the functions, which have not been compiled in this process.
    kernel = Kernel(METHODS["rk4"])

    found = compilation._compiled(kernel._function, kernel._signature, None)

    assert not [name for name in optimised if name.endswith("_rk4")]
    assert kernel.name in found.symbol
    # Nothing of this package is left to be found elsewhere.
    assert not [name for name in found.externals if "rb_dynamics" in name]


def test_numba_does_not_wait_for_a_search_for_garbage() -> None:
    pytest.importorskip("numba")
    kernel, searches = Kernel(METHODS["rk4"]), list[str]()

    def note(phase: str, _: object) -> None:
        searches.append(phase)

    gc.callbacks.append(note)
    try:
        compilation._compiled(kernel._function, kernel._signature, None)
    finally:
        gc.callbacks.remove(note)
    # Without the pause there are hundreds; some come with the import of numba and the linking of the code.
    assert len(searches) < 50
    assert gc.isenabled()


def _by_lanes(c: Any) -> None:
    lanes = block(1, 8)
    for i in range(8):
        lanes[0, i] = c[i]
        c[i] = 2.0 * lanes[0, i]


def _one_by_one(c: Any) -> None:
    for i in range(8):
        c[i] = 2.0 * c[i]


@pytest.mark.parametrize(("function", "rounds"), [(_by_lanes, 2), (_one_by_one, 1)])
def test_a_kernel_over_lanes_is_optimised_twice_as_only_then_its_branches_are_vectorised(
    monkeypatch: pytest.MonkeyPatch, function: Callable[[Any], None], rounds: int
) -> None:
    codegen = pytest.importorskip("numba.core.codegen")
    made: list[object] = []
    of_module, by_numba = codegen.CPUCodegen._module_pass_manager, codegen.JITCodeLibrary._optimize_final_module

    def counted(self: object, **options: object) -> object:
        made.append(of_module(self, **options))
        return made[-1]

    def uncounted(library: object) -> None:
        """Optimise one of numba's own functions."""
        others = len(made)
        by_numba(library)
        del made[others:]

    monkeypatch.setattr(codegen.CPUCodegen, "_module_pass_manager", counted)
    monkeypatch.setattr(codegen.JITCodeLibrary, "_optimize_final_module", uncounted)

    compilation._compiled(function, "void(float64[::1])", None)

    assert len(made) == rounds
