"""Kernels for fixed steps: many steps of one length in one compiled call.

The same function runs in plain Python and, if numba is installed (extra `fast`), compiled, with the same bits. All but
the shortest runs use the kernels that the cache has; those that it lacks are compiled meanwhile by another process. The
environment variable `RB_DYNAMICS_COMPILE` overrides this: `never`, `always` (at the first step, by this process) or
`auto` (the default).

Scenes with effects of this package have kernels of their own (`loads/compiled_load.py`). Other loads that vary within a
step have none.

A kernel does not raise: non-finite numbers propagate to its end, where the caller notices them and repeats the steps in
plain Python, which raises the error.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import math
import os
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from functools import cache
from struct import Struct
from typing import TYPE_CHECKING, Any, Literal

from rb_dynamics.errors import MissingExtraError, RigidBodyError
from rb_dynamics.loads.compiled_load import EffectLoad, GradualLoad
from rb_dynamics.loads.effect import Point
from rb_dynamics.loads.varying_load import Load, LoadDependence
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import closed_form, planar_motion
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
from rb_dynamics.motion.phase_state import MOMENTUM, PhaseState, Sums, grown, total
from rb_dynamics.motion.step_checks import LARGEST_FREE_TURN, NO_INCREMENT
from rb_dynamics.numerics.background_compilation import ask_for
from rb_dynamics.numerics.compilation import available, compile_kernel, failure_of, is_cached, specialise
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector, norm, scale

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers
    from rb_dynamics.numerics.object_code import Native

WITH_EFFECTS = "_with_effects"
"""Suffix of the names of kernels for scenes with effects."""

LONGEST_STRETCH = 10_000
"""Largest number of steps in a call: more would save nothing, and all are repeated if one of them is refused."""

FEW = 500
"""Steps of most methods that take plain Python as long as loading LLVM, which comes with the first kernel: 0.06 s."""

MANY = 50_000
"""Steps that take plain Python as long as compiling a kernel for them: 2 to 10 s, as dear steps have large kernels."""

# Number of requests for a kernel after which to check whether another process has compiled it.
_ASKS = 200

_SIGNATURE = "void(float64[::1], float64, int64)"

# Arguments of a kernel: body and wrench, and the phase. Packing them like this takes a third of the time of
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
    effects: Any = (),
) -> tuple[Quaternion, Vector, Sums, Sums]:
    """Return attitude, angular velocity, sums (see `PhaseState`) after n steps of h s under `held`; principal axes.

    `effects` are the numbers that `_load` reads.

    Raises:
        ConvergenceError: a step cannot be solved; a compiled kernel returns NaN instead.
    """
    for _ in range(n):
        momentum = (high[3] + low[3], high[4] + low[4], high[5] + low[5])
        velocity = scale(1.0 / inertia.mass, momentum)
        load = _load(effects, high, low)
        step = _step(inertia, held, h, velocity, orientation, angular_velocity, load)
        orientation, angular_velocity = step.orientation, step.angular_velocity
        high, low = grown(high, low, step, h)
    return orientation, angular_velocity, high, low


def _step(*arguments: Any) -> Increment:
    """Placeholder for the step of a method."""
    raise NotImplementedError


def no_load(_effects: Any, _high: Sums, _low: Sums) -> EffectLoad | None:
    """Return None; a kernel for scenes with effects has `load_of_effects` in place of this function."""
    return None


_load = no_load


def load_of_effects(effects: Any, high: Sums, low: Sums) -> EffectLoad:
    """Return the load of a step that starts with these sums; the numbers of the effects are at the end of `effects`."""
    return EffectLoad(effects, high[13] + low[13], (high[0] + low[0], high[1] + low[1], high[2] + low[2]))


def load_with_transients(effects: Any, high: Sums, low: Sums) -> GradualLoad:
    """Return the same with transients."""
    at = load_of_effects(effects, high, low)
    return GradualLoad(effects, at.time, at.position, high[13], low[13])


def load_of(*, effects: bool, gradual: bool) -> tuple[str, Callable[..., Any]]:
    """Return the suffix of the names of kernels, and the load of their steps."""
    if gradual:
        return "_with_transients", load_with_transients
    return (WITH_EFFECTS, load_of_effects) if effects else ("", no_load)


def _run_on_numbers(numbers: Numbers, h: float, n: int) -> None:
    """Like `run`, on an array, which is 25 times faster to pass than tuples."""
    inertia, held = constants_at(numbers)
    start = phase_at(numbers, CONSTANTS)
    q, w, high, low = run(
        inertia, held, h, n, start.orientation, start.angular_velocity, start.high, start.low, numbers
    )
    write_phase(numbers, CONSTANTS, PhaseState(q, w, high, low))


def _dense_on_numbers(numbers: Numbers, h: float, _: int) -> None:
    """Advance by one step of h s, whose memory begins after the phase."""
    (inertia, held), start = constants_at(numbers), phase_at(numbers, CONSTANTS)
    velocity = scale(1.0 / inertia.mass, total(start, MOMENTUM))
    memory = numbers[CONSTANTS + PHASE :]
    step = _step(inertia, held, h, velocity, start.orientation, start.angular_velocity, memory)
    high, low = grown(start.high, start.low, step, h)
    write_phase(numbers, CONSTANTS, PhaseState(step.orientation, step.angular_velocity, high, low))


def _in_closed_form(numbers: Numbers, h: float, n: int) -> None:
    """Advance by n steps of h s in closed form; give NaN if the closed form does not apply."""
    inertia, held = constants_at(numbers)
    for _ in range(n):
        phase = phase_at(numbers, CONSTANTS)
        velocity = scale(1.0 / inertia.mass, total(phase, MOMENTUM))
        q, omega = phase.orientation, phase.angular_velocity
        axis = planar_motion.fixed_axis(held, q, omega)
        if closed_form.is_free(held):
            step = closed_form.free_step(inertia, held, h, velocity, q, omega)
        elif axis >= 0:
            step = planar_motion.advance(inertia, held, h, velocity, q, omega, axis)
        else:
            step = NO_INCREMENT
        if not max(norm(omega), norm(step.angular_velocity)) * h < LARGEST_FREE_TURN:
            step = NO_INCREMENT
        high, low = grown(phase.high, phase.low, step, h)
        write_phase(numbers, CONSTANTS, PhaseState(step.orientation, step.angular_velocity, high, low))


def load_in_plain(load_from: Callable[[Point], Load] | None, high: Sums, low: Sums) -> Load | None:
    """Return the load of a step that starts with these sums; effects in plain Python."""
    if load_from is None:
        return None
    start = load_of_effects(load_from, high, low)
    return load_from(Point(start.time, start.position, ZERO, IDENTITY, ZERO))


def plain(method: Method, load: Callable[..., Any] = no_load) -> Callable[..., tuple[Quaternion, Vector, Sums, Sums]]:
    """Return `run` for `method`, in plain Python; `load` computes the load of a step from the argument `effects`."""
    return specialise(run, f"run_{method.name}", _step=method.step, _load=load)


class Tally:
    """Counts steps taken without kernels, of which a few take none and many are compiled here; shared by a process.

    A run within `counted_by(tally)` decides as if it were alone in its process, whatever is loaded.

    Attributes:
        used: the kernels that were there or have been compiled.
        built: time (s) to compile or load each kernel, by name.
        lacking: names of the kernels that would have taken many steps, but are not compiled yet.
    """

    def __init__(
        self,
        scale: float = 1.0,
        clock: Callable[[], float] = time.perf_counter,
        built: dict[str, float] | None = None,
        compiling: Callable[[str], None] | None = None,
        missing: Literal["beside", "here", "plain"] = "here",
        *,
        none: bool = False,
    ) -> None:
        """Start counting.

        Args:
            scale: weight of each step, if only a part of a run is executed.
            clock: returns the time, s.
            built: receives the times to compile or load.
            compiling: called with the name of a kernel before it is compiled (not when it is loaded from the cache).
            missing: where to compile kernels that the cache lacks, if at all; "beside" is another process.
            none: use no kernel, even from the cache.
        """
        self.used: set[OnDemand] = set()
        self.lacking: set[str] = set()
        self.built = {} if built is None else built
        self.clock, self.compiling = clock, compiling
        self.missing, self.none, self._scale = missing, none, scale
        self._steps: dict[OnDemand, float] = {}

    @property
    def asked(self) -> bool:
        """Whether any kernel was requested."""
        return bool(self.used or self._steps)

    def miss(self, kernel: OnDemand, steps: float) -> None:
        """Record `steps` taken without `kernel`."""
        self._steps[kernel] = self._steps.get(kernel, 0.0) + steps

    def expected(self, kernel: OnDemand, ahead: float) -> float:
        """Return the least number of steps to expect."""
        steps = self._steps.get(kernel, 0.0) + ahead
        return steps if steps <= _TELLS_NOTHING else steps * self._scale


# Any arc may end with a step, or with two halves of one.
_TELLS_NOTHING = 2.0

_of_the_process = Tally(missing="beside")
_tally = ContextVar("_tally", default=_of_the_process)


@contextlib.contextmanager
def counted_by(tally: Tally) -> Iterator[None]:
    """Let `tally` decide in this context which kernels to use; `RB_DYNAMICS_COMPILE` still applies."""
    token = _tally.set(tally)
    try:
        yield
    finally:
        _tally.reset(token)


class OnDemand:
    """A function that is compiled or loaded once it is needed.

    Attributes:
        method: the method that it belongs to.
    """

    def __init__(self, method: str, function: Callable[..., Any], signature: str, steps: float = 1.0) -> None:
        """Prepare, without compiling.

        Args:
            method: the method that the function belongs to.
            function: the function to compile; cached by its name.
            signature: its types, as numba writes them.
            steps: number of steps of the method that take as long in plain Python as one call for one step.
        """
        self.method, self._function, self._signature = method, function, signature
        self._each = steps
        self._compiled: Native | None = None
        self._given_up = False
        # Why it cannot be compiled, whether that is an error if it must be, and how it is compiled ahead.
        self._fault, self._required = "", True
        self._ahead = f"`rb-dynamics compile {function.__name__}` does it ahead"
        # Number of requests until the next check whether another process has compiled it.
        self._look_after = 0

    @property
    def name(self) -> str:
        """Name in the cache."""
        return self._function.__name__

    @property
    def order(self) -> str | None:
        """What another process needs besides the name to compile it; None if it cannot."""
        return ""

    def at_hand(self, missed: float) -> bool:
        """Return whether the function is compiled and LLVM loaded, so that using it costs nothing.

        If not, `missed` steps will be taken without it. They are counted, and another process compiles what is missed
        often.
        """
        tally = _tally.get()
        if self in tally.used or (tally.used and is_cached(self.name)):
            return True
        return tally.missing == "beside" and _when() == "auto" and self.get(missed, missed) is not None

    def get(self, ahead: float, missed: float) -> Native | None:
        """Return the compiled function; None if there is none for `ahead` more steps.

        In that case, `missed` of them will be taken without it.
        """
        when, tally = _when(), _tally.get()
        if when == "never" or tally.none or (self._given_up and not self._required):
            return None
        try:
            if self not in tally.used and (
                when == "always" or self._is_due(tally, ahead * self._each, missed * self._each)
            ):
                self.build(tally)
                tally.used.add(self)
                tally.lacking.discard(self.name)
        except (ImportError, OSError, RuntimeError) as error:
            if when == "always" and self._required:
                raise
            self._give_up(str(error))
        if self in tally.used:
            return self._compiled
        tally.miss(self, missed * self._each)
        return None

    def _is_due(self, tally: Tally, ahead: float, missed: float) -> bool:
        """Return whether to compile or load it now. If another process is to compile it, send the request."""
        if self._given_up or not available():
            return False
        if _when() == "cached" and not is_cached(self.name):
            self._give_up(f"nothing is compiled now; {self._ahead}")
            return False
        steps = tally.expected(self, ahead)
        if self._fault and steps >= FEW:
            self._give_up(self._fault)
            return False
        if tally.used or steps >= FEW:
            # Looking for a file takes as long as half a step: nothing beside many.
            self._look_after -= 1
            if self._look_after > 0 and tally.missing == "beside" and missed < FEW:
                return False
            if is_cached(self.name):
                return True
            if tally.missing == "beside" and ask_for(self.name, self.order):
                self._look_after = _ASKS
                if reason := failure_of(self.name):
                    self._give_up(reason)
                return False
        due = tally.missing != "plain" and steps >= MANY
        if steps >= FEW and not due and not self.order:
            tally.lacking.add(self.name)
        return due

    def _give_up(self, reason: str) -> None:
        self._given_up = True
        _log.warning("%s runs in plain Python: %s", self.method, reason)

    def build(self, tally: Tally) -> None:
        """Compile or load the function, unless this has been done.

        Raises:
            ImportError, RuntimeError: as `compile_kernel`.
        """
        if self._compiled is None:
            if tally.compiling is not None and not is_cached(self.name):
                tally.compiling(self.name)
            begin = tally.clock()
            if self._fault:
                raise RuntimeError(self._fault)
            self._compiled = self._compile()
            tally.built[self.name] = tally.clock() - begin

    def _compile(self) -> Native:
        return compile_kernel(self._function, self._signature)


class Kernel(OnDemand):
    """Kernel for fixed steps of one method, or for steps in closed form."""

    def __init__(self, method: Method, *, effects: bool = False, gradual: bool = False) -> None:
        """Prepare, without compiling. `effects`: for scenes with effects; `gradual`: while there are transients."""
        if method is closed_form.EXACT:
            super().__init__(method.name, _in_closed_form, _SIGNATURE)
            return
        name, run = f"{_run_on_numbers.__name__}_{method.name}", plain(method)
        suffix, load = load_of(effects=effects, gradual=gradual)
        if suffix:
            name += suffix
            run = specialise(run, f"{run.__name__}{suffix}", _load=load)
        super().__init__(method.name, specialise(_run_on_numbers, name, run=run), _SIGNATURE)

    def after(
        self,
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        n: int,
        phase: PhaseState,
        ahead: int,
        missed: int,
        effects: tuple[float, ...] = (),
    ) -> PhaseState | None:
        """Return the phase after n steps of h s; None if they must be taken in plain Python.

        That is so if a step is refused, or if there is no kernel for `ahead` more steps; then `missed` are taken before
        the next call.
        """
        compiled = self.get(ahead, missed)
        if compiled is None:
            return None
        numbers = _doubles(CONSTANTS + PHASE + len(effects))()
        if effects:
            numbers[CONSTANTS + PHASE :] = [*effects]
        _NUMBERS.pack_into(numbers, 0, *constant_numbers(inertia, held), *phase_numbers(phase))
        compiled.on_doubles(numbers, h, n)
        end = _PHASE.unpack_from(numbers, 8 * CONSTANTS)
        return phase_of(end) if all(map(math.isfinite, end)) else None


@cache
def _doubles(count: int) -> type[ctypes.Array[ctypes.c_double]]:
    return ctypes.c_double * count


def compiles(method: Method, *, effects: bool = False) -> bool:
    """Return whether `method` can be compiled for scenes with or without effects."""
    return method.compiles and not (effects and (method.takes == LoadDependence.HELD or not method.compiles_loads))


def takes_compiled(method: Method, takes: LoadDependence) -> bool:
    """Return whether the kernels of `method` support effects that depend on `takes`."""
    return method.takes >= takes and compiles(method, effects=True)


@cache
def kernel(method: Method, *, effects: bool = False) -> Kernel | None:
    """Return the kernel of `method`, for scenes with or without effects; None if it cannot be compiled."""
    able = compiles(method, effects=effects) or (method is closed_form.EXACT and not effects)
    return Kernel(method, effects=effects) if able else None


@cache
def dense_kernel(method: Method) -> OnDemand | None:
    """Return the kernel for steps to many times within a stride of `method`; None if it has none of its own."""
    if method.dense is None or not method.compiles:
        return None
    function = specialise(_dense_on_numbers, f"dense_{method.name}", _step=method.dense.step)
    return OnDemand(method.name, function, _SIGNATURE)


@cache
def gradual_kernel(method: Method) -> Kernel | None:
    """Return the kernel of `method` while there are transients; None if it cannot be compiled."""
    return Kernel(method, effects=True, gradual=True) if compiles(method, effects=True) else None


def longest_in_plain(method: Method) -> float:
    """Return how many steps of `method` stay in plain Python; inf if it has no kernel."""
    return math.inf if _when() == "never" or not available() or not method.compiles else MANY


def _when() -> str:
    found = os.environ.get("RB_DYNAMICS_COMPILE", "auto")
    if found not in ("never", "cached", "auto", "always"):
        raise RigidBodyError(
            f"RB_DYNAMICS_COMPILE is {found!r}, expected never, cached, auto or always; set one, or unset it"
        )
    if found == "always" and not available():
        raise MissingExtraError("numba", "fast", "RB_DYNAMICS_COMPILE=always")
    return found
