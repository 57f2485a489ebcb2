"""Kernels: many steps of one length under a held wrench, without a call from Python to the next step.

The same function in plain Python and, where numba is installed (extra `fast`) and it is worth it, compiled; the bits
are the same. What is worth it: the steps taken and to be taken in plain Python cost about what compilation does, a few
seconds, or, if the kernel is in the cache, what loading it does, half a second. The environment variable
`RB_DYNAMICS_COMPILE` says otherwise: `never`, or `always`, at the first step; `auto` is as if it were not there.

Never knows a load that varies, and never refuses a step: what is not finite spreads to the end, and who finds it there
takes the steps again in plain Python, which says why.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

from rb_dynamics.compiled import available, compile_kernel, is_cached, specialise
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Method
from rb_dynamics.motion.phase import Phase, Sums, grown
from rb_dynamics.rotation import Quaternion
from rb_dynamics.vector import Vector, scale

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Numbers = npt.NDArray[np.float64]

LONGEST_STRETCH = 10_000
"""Steps that are taken at once: more save nothing, and are lost where one of them is refused."""

WORTH_COMPILING = 100_000
"""Steps that take as long in plain Python as compiling their kernel: 3 s."""

WORTH_LOADING = 20_000
"""The same for a kernel that is in the cache, with the import of numba: 0.5 s."""

_SIGNATURE = "void(float64[::1], float64, int64, float64[::1])"
_log = logging.getLogger(__name__)


def run(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    n: int,
    orientation: Quaternion,
    angular_velocity: Vector,
    high: Sums,
    low: Sums,
) -> tuple[Quaternion, Vector, Sums, Sums]:
    """Return attitude, angular velocity and books (see `Phase`) after n steps of h s under `held`, in principal axes.

    Raises:
        ConvergenceError: a step cannot be solved; compiled, it leaves NaN instead.
    """
    for _ in range(n):
        momentum = (high[3] + low[3], high[4] + low[4], high[5] + low[5])
        velocity = scale(1.0 / inertia.mass, momentum)
        step = _step(inertia, held, h, velocity, orientation, angular_velocity, None)
        orientation, angular_velocity = step.orientation, step.angular_velocity
        high, low = grown(high, low, step, h)
    return orientation, angular_velocity, high, low


def _step(*arguments: Any) -> Increment:
    """Stand where the step of a method will."""
    raise NotImplementedError


def _run_on_numbers(constants: Numbers, h: float, n: int, state: Numbers) -> None:
    """Do the same on arrays: 25 times faster to hand over than tuples."""
    c, s = constants, state
    inertia = Inertia(c[0], (c[1], c[2], c[3]))
    held = HeldWrench((c[4], c[5], c[6]), (c[7], c[8], c[9]), (c[10], c[11], c[12]), (c[13], c[14], c[15]))
    high: Sums = (s[7], s[8], s[9], s[10], s[11], s[12], s[13], s[14], s[15], s[16], s[17], s[18], s[19], s[20])
    low: Sums = (s[21], s[22], s[23], s[24], s[25], s[26], s[27], s[28], s[29], s[30], s[31], s[32], s[33], s[34])
    q, w, high, low = run(inertia, held, h, n, (s[0], s[1], s[2], s[3]), (s[4], s[5], s[6]), high, low)
    s[0], s[1], s[2], s[3] = q
    s[4], s[5], s[6] = w
    for i in range(14):
        s[7 + i] = high[i]
        s[21 + i] = low[i]


def plain(method: Method) -> Callable[..., tuple[Quaternion, Vector, Sums, Sums]]:
    """Return `run` for `method`, in plain Python."""
    return specialise(run, f"run_{method.name}", _step=method.step)


class OnDemand:
    """A function that is compiled when it is worth it, which it knows by counting the steps of this process."""

    def __init__(self, name: str, function: Callable[..., Any], signature: str, price: float = 1.0) -> None:
        """Compile nothing yet.

        Args:
            name: to find it by in the cache.
            function: to be compiled, with the name.
            signature: its types.
            price: of what it does at a time in plain Python, in steps.
        """
        self._name, self._function, self._signature, self._price = name, function, signature, price
        self._compiled: Callable[..., Any] | None = None
        self._steps = 0.0
        self._given_up = False
        self._is_cached: bool | None = None

    def get(self, ahead: float, missed: float) -> Callable[..., Any] | None:
        """Return the compiled function; None if it is not worth it, though `ahead` are known to come.

        `missed` of them will then be done without it.
        """
        when = _when()
        if when == "never":
            return None
        try:
            if self._compiled is None and (when == "always" or self._is_worth(ahead * self._price)):
                self._compiled = compile_kernel(self._function, self._signature)
        except (ImportError, OSError, RuntimeError) as error:
            if when == "always":
                raise
            self._given_up = True
            _log.warning("%s runs in plain Python: %s", self._name, error)
        if self._compiled is None:
            self._steps += missed * self._price
        return self._compiled

    def _is_worth(self, ahead: float) -> bool:
        if self._given_up or not available():
            return False
        steps = self._steps + ahead
        if steps >= WORTH_LOADING and self._is_cached is None:
            self._is_cached = is_cached(self._name)
        return steps >= WORTH_COMPILING or bool(self._is_cached)


class Kernel(OnDemand):
    """The stretches of one method."""

    def __init__(self, method: Method) -> None:
        """Compile nothing yet."""
        name = f"{_run_on_numbers.__name__}_{method.name}"
        super().__init__(name, specialise(_run_on_numbers, name, run=plain(method)), _SIGNATURE)

    def after(self, inertia: Inertia, held: HeldWrench, h: float, n: int, ahead: int, phase: Phase) -> Phase | None:
        """Return the phase after n steps of h s, `ahead` being known to come; None if they are to be taken in Python.

        So they are if this is not worth compiling, or if a step is refused.
        """
        compiled = self.get(ahead, ahead)
        if compiled is None:
            return None
        import numpy as np

        constants = np.array((inertia.mass, *inertia.moments, *held[0], *held[1], *held[2], *held[3]), dtype=np.float64)
        state = np.array((*phase.orientation, *phase.angular_velocity, *phase.high, *phase.low), dtype=np.float64)
        compiled(constants, h, n, state)
        s = state.tolist()
        if not all(map(math.isfinite, s)):
            return None
        return Phase((s[0], s[1], s[2], s[3]), (s[4], s[5], s[6]), tuple(s[7:21]), tuple(s[21:]))


@cache
def kernel(method: Method) -> Kernel | None:
    """Return the kernel of `method`, None if it cannot be compiled."""
    return Kernel(method) if method.compiles else None


def _when() -> str:
    found = os.environ.get("RB_DYNAMICS_COMPILE", "auto")
    if found not in ("never", "auto", "always"):
        raise ValueError(f"RB_DYNAMICS_COMPILE is {found!r}, expected never, auto or always")
    return found
