"""One step of many lengths from many starts, on numpy arrays: outputs between grid points, where there is no kernel.

The functions of a step run on arrays in place of numbers, with the same bits, as numpy rounds sums, products, quotients
and square roots like Python. What branches on a number has another form here.
"""

from __future__ import annotations

import math
from functools import cache
from types import FunctionType, SimpleNamespace
from typing import TYPE_CHECKING, Any

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads import central_gravity
from rb_dynamics.loads.compiled_load import evaluated_by_numbers
from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.fixed_step_kernel import load_of, plain
from rb_dynamics.motion.method import Increment, Inertia, Method
from rb_dynamics.motion.step_checks import is_rotation, no_rotation, require_finite
from rb_dynamics.numerics.compilation import specialise
from rb_dynamics.numerics.rotation import LAST_BITS, Quaternion, renormalize
from rb_dynamics.numerics.vector import dot, multiply, norm, norm_of_arrays

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers

FEWEST = 64
"""Number of outputs from which arrays pay: a step takes them about as long as 30 steps one by one."""


def steps_from(
    method: Method, inertia: Inertia, held: HeldWrench, h: Numbers, n: int, starts: Numbers, effects: tuple[float, ...]
) -> Numbers | None:
    """Return the phases (`PHASE`, k) after n steps of h[i] s from starts[:, i] each; None if one of them is refused.

    `effects` are their numbers, without plug-ins; `method` takes arrays.
    """
    import numpy as np

    rows: Any = tuple(starts)
    with np.errstate(all="ignore"):
        try:
            q, w, high, low = _run(method, effects=bool(effects))(
                inertia, held, h, n, rows[:4], rows[4:7], rows[7:21], rows[21:], effects
            )
        except ConvergenceError:
            return None
    return np.array([*q, *w, *high, *low])


def are_finite(inertia: Inertia, phases: Numbers) -> bool:
    """Return whether all phases, (`PHASE`, k), are finite, with their energies."""
    import numpy as np

    with np.errstate(all="ignore"):
        momentum, omega = tuple(phases[10:13] + phases[24:27]), tuple(phases[4:7])
        energy = dot(momentum, momentum) / inertia.mass + dot(omega, multiply(inertia.moments, omega))
    return bool(np.isfinite(phases).all() and np.isfinite(energy).all())


@cache
def _run(method: Method, *, effects: bool) -> Any:
    """Return `fixed_step_kernel.run` of `method` on arrays."""
    return _on_arrays(plain(method, load_of(effects=effects, gradual=False)[1]))


@cache
def _on_arrays(function: Any) -> Any:
    """Return `function` for arrays: a copy that calls such copies of the functions of the package.

    A function of `_OTHERWISE` may call the one that it replaces, for single numbers.
    """
    if function in _OTHERWISE:
        return _on_arrays(_OTHERWISE[function])
    names = {name: function.__globals__[name] for name in function.__code__.co_names if name in function.__globals__}
    copies = {
        name: _on_arrays(value)
        for name, value in names.items()
        if isinstance(value, FunctionType) and value.__module__ != __name__ and _OTHERWISE.get(value) is not function
    }
    if names.get("math") is math:
        import numpy as np

        copies["math"] = SimpleNamespace(sqrt=np.sqrt)
    return specialise(function, function.__name__, **copies)


def _renormalized(q: Quaternion) -> Quaternion:
    import numpy as np

    n: Any = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    n = np.where(abs(n - 1.0) > LAST_BITS, n, 1.0)
    return (q[0] / n, q[1] / n, q[2] / n, q[3] / n)


def _are_rotations(square: Any) -> bool:
    return bool(((square > 0.5) & (square < 2.0)).all())


def _refused(_name: str, _h: float, _square: float, _rate: float) -> Increment:
    raise ConvergenceError("one of many steps is refused; alone, it says why")


def _checked_later(_name: str, _h: float, step: Increment) -> Increment:
    return step


_OTHERWISE: dict[Any, Any] = {
    evaluated: evaluated_by_numbers,
    norm: norm_of_arrays,
    renormalize: _renormalized,
    is_rotation: _are_rotations,
    no_rotation: _refused,
    require_finite: _checked_later,
    central_gravity.to_center: central_gravity.to_center_of_each,
}
