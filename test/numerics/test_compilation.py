"""How kernels are compiled: what is optimised, and how often."""

from __future__ import annotations

import pytest

from rb_dynamics.motion import METHODS
from rb_dynamics.motion.fixed_step_kernel import Kernel
from rb_dynamics.numerics import compilation


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
