"""Kernels for fixed steps: many steps of one length under a held wrench in one compiled call.

The same function runs in plain Python and, if numba is installed (extra `fast`) and it pays, compiled, with the same
bits. It pays once the steps taken and known to come would take plain Python as long as compilation (a few seconds) or
loading the kernel from the cache (half a second). The environment variable `RB_DYNAMICS_COMPILE`
overrides that: `never`, `always` (at the first step) or `auto` (the default).

A kernel does not support a load that varies in the step, and does not raise: non-finite numbers propagate to its end,
where the caller notices them and repeats the steps in plain Python, which raises the error.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from functools import cache
from struct import Struct
from typing import TYPE_CHECKING, Any

from rb_dynamics.errors import MissingExtraError, RigidBodyError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.kernel_layout import (
    CONSTANTS,
    PHASE,
    constant_numbers,
    constants_at,
    phase_at,
    phase_numbers,
    phase_of,
    write_phase,
)
from rb_dynamics.motion.method import Increment, Inertia, Method
from rb_dynamics.motion.phase_state import PhaseState, Sums, grown
from rb_dynamics.numerics.compilation import available, compile_kernel, is_cached, specialise
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector, scale

if TYPE_CHECKING:
    from rb_dynamics.numerics.arrays import Numbers

LONGEST_STRETCH = 10_000
"""Steps per call: more would save nothing, and all are repeated if one of them is refused."""

WORTH_COMPILING = 200_000
"""Number of `rk4` steps that take as long in plain Python as compiling a kernel: 2 to 6 s."""

WORTH_LOADING = 20_000
"""The same for loading a kernel from the cache, including the import of numba: 0.5 s."""

# Time of a step in plain Python relative to rk4, if different: the plain column of `benchmarks/kernels.py`.
_PLAIN_PRICE = {
    name: price
    for price, names in (
        (0.4, "euler"),
        (2.0, "rkmk4 cf4"),
        (3.0, "dverk rkmk54 dlm4 dmv82 strang2 exact"),
        (4.5, "taylor dop853 dlm6 dmv864 dmv104 midpoint4"),
        (8.5, "midpoint6"),
        (20.0, "strang6"),
    )
    for name in names.split()
}

_SIGNATURE = "void(float64[::1], float64, int64)"

# Arguments of a stretch: body and wrench, and the phase. Packing them like this takes a third of the time of
# numpy.array.
_NUMBERS, _PHASE = Struct(f"{CONSTANTS + PHASE}d"), Struct(f"{PHASE}d")
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
    """Return attitude, angular velocity, books (see `PhaseState`) after n steps of h s under `held`; principal axes.

    Raises:
        ConvergenceError: a step cannot be solved; a compiled kernel returns NaN instead.
    """
    for _ in range(n):
        momentum = (high[3] + low[3], high[4] + low[4], high[5] + low[5])
        velocity = scale(1.0 / inertia.mass, momentum)
        step = _step(inertia, held, h, velocity, orientation, angular_velocity, None)
        orientation, angular_velocity = step.orientation, step.angular_velocity
        high, low = grown(high, low, step, h)
    return orientation, angular_velocity, high, low


def _step(*arguments: Any) -> Increment:
    """Placeholder for the step of a method."""
    raise NotImplementedError


def _run_on_numbers(numbers: Numbers, h: float, n: int) -> None:
    """Like `run`, on an array, which is 25 times faster to pass than tuples."""
    inertia, held = constants_at(numbers)
    start = phase_at(numbers, CONSTANTS)
    q, w, high, low = run(inertia, held, h, n, start.orientation, start.angular_velocity, start.high, start.low)
    write_phase(numbers, CONSTANTS, PhaseState(q, w, high, low))


def plain(method: Method) -> Callable[..., tuple[Quaternion, Vector, Sums, Sums]]:
    """Return `run` for `method`, in plain Python."""
    return specialise(run, f"run_{method.name}", _step=method.step)


class Tally:
    """Counts steps taken without kernels, to decide whether one is worth compiling; shared by all runs of a process.

    A run within `counted_by` a tally of its own decides as if it were alone in its process, whatever is loaded.

    Attributes:
        used: the kernels that were worth it.
        built: time (s) to compile or load each of them, by name.
    """

    def __init__(
        self,
        scale: float = 1.0,
        worth: float | None = None,
        clock: Callable[[], float] = time.perf_counter,
        built: dict[str, float] | None = None,
        compiling: Callable[[str], None] | None = None,
    ) -> None:
        """Start without steps.

        Args:
            scale: what each step counts for, if only a part of a run is executed.
            worth: steps that compiling is worth, in place of `WORTH_COMPILING`; if infinite, loading is not worth it
                either.
            clock: s.
            built: receives the times.
            compiling: called with the name of a kernel before it is compiled (not when it is loaded from the cache).
        """
        self.used: set[OnDemand] = set()
        self.built = {} if built is None else built
        self.worth, self.clock, self.compiling = worth, clock, compiling
        self._scale = scale
        self._steps: dict[OnDemand, float] = {}

    @property
    def asked(self) -> bool:
        """Whether there was anything that a kernel could do."""
        return bool(self.used or self._steps)

    def miss(self, kernel: OnDemand, steps: float) -> None:
        """Record `steps` taken without `kernel`."""
        self._steps[kernel] = self._steps.get(kernel, 0.0) + steps

    def expected(self, kernel: OnDemand, ahead: float) -> float:
        """Return how many steps there will be, at least."""
        steps = self._steps.get(kernel, 0.0) + ahead
        return steps if steps <= _TELLS_NOTHING else steps * self._scale


# Any arc may end with a step, or with two halves of one.
_TELLS_NOTHING = 2.0

_of_the_process = Tally()
_tally = ContextVar("_tally", default=_of_the_process)


@contextlib.contextmanager
def counted_by(tally: Tally) -> Iterator[None]:
    """Let `tally` decide what is worth compiling in this context; `RB_DYNAMICS_COMPILE` still applies."""
    token = _tally.set(tally)
    try:
        yield
    finally:
        _tally.reset(token)


class OnDemand:
    """A function that is compiled when that pays."""

    def __init__(
        self, method: str, function: Callable[..., Any], signature: str | Callable[[], Any], price: float = 1.0
    ) -> None:
        """Compile nothing yet.

        Args:
            method: the method that it belongs to.
            function: to be compiled; cached by its name.
            signature: its types, or a function that returns them: what needs numba to say.
            price: cost of one call per step in plain Python, in steps of the method.
        """
        self._method, self._function, self._signature = method, function, signature
        self._price = price * _PLAIN_PRICE.get(method, 1.0)
        self._compiled: Callable[..., Any] | None = None
        self._given_up = False
        self._is_cached: bool | None = None

    def get(self, ahead: float, missed: float) -> Callable[..., Any] | None:
        """Return the compiled function; None if it is not worth compiling for `ahead` more steps.

        In that case `missed` of them will be taken without it.
        """
        when, tally = _when(), _tally.get()
        if when == "never" or tally.worth == math.inf:
            return None
        try:
            if self not in tally.used and (when == "always" or self._is_worth(tally, ahead * self._price)):
                self._build(tally)
                tally.used.add(self)
        except (ImportError, OSError, RuntimeError) as error:
            if when == "always":
                raise
            self._given_up = True
            _log.warning("%s runs in plain Python: %s", self._method, error)
        if self in tally.used:
            return self._compiled
        tally.miss(self, missed * self._price)
        return None

    def _is_worth(self, tally: Tally, ahead: float) -> bool:
        if self._given_up or not available():
            return False
        steps = tally.expected(self, ahead)
        if steps >= WORTH_LOADING and self._is_cached is None:
            self._is_cached = is_cached(self._function.__name__)
        worth = WORTH_COMPILING if tally.worth is None else tally.worth
        return steps >= worth or (steps >= WORTH_LOADING and bool(self._is_cached))

    def _build(self, tally: Tally) -> None:
        if self._compiled is None:
            if tally.compiling is not None and not is_cached(self._function.__name__):
                tally.compiling(self._function.__name__)
            begin = tally.clock()
            self._compiled = compile_kernel(self._function, self._signature)
            self._is_cached = True
            tally.built[self._function.__name__] = tally.clock() - begin


class Kernel(OnDemand):
    """The stretches of one method."""

    def __init__(self, method: Method) -> None:
        """Compile nothing yet."""
        name = f"{_run_on_numbers.__name__}_{method.name}"
        super().__init__(method.name, specialise(_run_on_numbers, name, run=plain(method)), _SIGNATURE)

    def after(
        self, inertia: Inertia, held: HeldWrench, h: float, n: int, phase: PhaseState, ahead: int, missed: int
    ) -> PhaseState | None:
        """Return the phase after n steps of h s; None if they must be taken in plain Python.

        That is so if a step is refused, or if compiling is not worth it for `ahead` more steps; then `missed` of them
        are taken before the next call.
        """
        compiled = self.get(ahead, missed)
        if compiled is None:
            return None
        import numpy as np

        numbers = np.empty(CONSTANTS + PHASE)
        _NUMBERS.pack_into(numbers.data, 0, *constant_numbers(inertia, held), *phase_numbers(phase))
        compiled(numbers, h, n)
        end = _PHASE.unpack_from(numbers.data, 8 * CONSTANTS)
        return phase_of(end) if all(map(math.isfinite, end)) else None


@cache
def kernel(method: Method) -> Kernel | None:
    """Return the kernel of `method`, None if it cannot be compiled."""
    return Kernel(method) if method.compiles else None


def longest_in_plain(method: Method) -> float:
    """Return the steps of a long run in plain Python before its kernel is worth loading; inf if there is no kernel."""
    if _when() == "never" or not available() or not method.compiles:
        return math.inf
    return WORTH_LOADING / _PLAIN_PRICE.get(method.name, 1.0)


def _when() -> str:
    found = os.environ.get("RB_DYNAMICS_COMPILE", "auto")
    if found not in ("never", "auto", "always"):
        raise RigidBodyError(f"RB_DYNAMICS_COMPILE is {found!r}, expected never, auto or always; set one, or unset it")
    if found == "always" and not available():
        raise MissingExtraError("numba", "fast", "RB_DYNAMICS_COMPILE=always")
    return found
