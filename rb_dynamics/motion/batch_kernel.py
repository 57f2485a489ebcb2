"""Kernels for many bodies, each under a sequence of held wrenches: one call for all bodies and all intervals.

`lanes` takes a block of bodies through each step side by side, so that the compiler vectorises over bodies. It copies
the block onto the stack, where the compiler knows that rows do not overlap and the data fit the first-level cache. It
needs a step without loops and branches; `one_by_one` accepts any step. Both give the same bits. A body whose step is
refused becomes NaN, as in `fixed_step_kernel.py`. `run/ensemble.py` converts axes and times.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.effect import Point
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import closed_form, fixed_step_kernel, midpoint, rk4, rotation_splitting
from rb_dynamics.motion.kernel_layout import (
    CONSTANTS,
    PHASE,
    constants_in,
    phase_in,
    phase_numbers,
    phase_of,
    write_held,
    write_phase_in,
)
from rb_dynamics.motion.method import Increment, Inertia, Load, Method, Step
from rb_dynamics.motion.phase_state import PhaseState, Sums
from rb_dynamics.motion.plugin_kernels import PluginKernel, are_ready
from rb_dynamics.motion.step_checks import LARGEST_FREE_TURN, NO_INCREMENT, out_of_range
from rb_dynamics.numerics.compilation import block, compiled_as, lane, specialise
from rb_dynamics.numerics.rotation import Quaternion, rotate_inverse
from rb_dynamics.numerics.vector import Vector, norm

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

    Counts = npt.NDArray[np.int64]

LANES = 64
"""Bodies in a block: enough to hide the latency of divisions, few enough for the first-level cache."""

FEWEST = 12
"""Smallest number of bodies for which a block pays: it takes about as long as this many bodies one by one."""

WORTH_A_THREAD = 20_000
"""Number of steps for which starting a thread pays."""

_WRENCH = "Array(float64, 3, 'A', True)"
_SHARED = f"float64[:, ::1], float64, int64[::1], float64[::1], {', '.join(4 * (_WRENCH,))}"
_LANES = f"boolean({_SHARED}, float64[:, ::1], float64[:, ::1], int64, int64)"
_ONE_BY_ONE = f"void({_SHARED}, float64[:, ::1], float64[:, ::1], float64[:, ::1], int64, int64)"


Loads = Sequence[Callable[[Point], Load] | None]
"""For each body, a function that returns the load of a step from its start; empty without effects."""


class Schedule(NamedTuple):
    """Steps and held wrenches of consecutive intervals.

    Attributes:
        h: length of a full step, s.
        counts: (K,), number of full steps in each interval.
        rests: (K,), length of the shorter step at the end of the interval, s; 0 if there is none.
        force_body: (K, N, 3), N, body axes, through the centre of mass; of each interval and body.
        torque_body: likewise, N m, about the centre of mass.
        force_world: likewise, world axes.
        torque_world: likewise.
    """

    h: float
    counts: Counts
    rests: Numbers
    force_body: Numbers
    torque_body: Numbers
    force_world: Numbers
    torque_world: Numbers

    def between(self, first: int, last: int) -> Schedule:
        """Return the schedule of the intervals from `first` up to `last`."""
        rows: list[Any] = list(self[1:])
        return Schedule(self.h, *(row[first:last] for row in rows))

    @property
    def steps(self) -> int:
        """Number of steps of each body."""
        import numpy as np

        return int(np.add.reduce(self.counts)) + int(np.count_nonzero(self.rests))


def run(*_: Any) -> tuple[Quaternion, Vector, Sums, Sums]:
    """Placeholder for `kernel.run` of a method."""
    raise NotImplementedError


def one_by_one(
    properties: Numbers,
    h: float,
    counts: Counts,
    rests: Numbers,
    force_body: Numbers,
    torque_body: Numbers,
    force_world: Numbers,
    torque_world: Numbers,
    state: Numbers,
    after: Numbers,
    trace: Numbers,
    first: int,
    last: int,
) -> None:
    """Move the bodies `first` to `last` from `state` to `after` by counts[k] steps of h s and one of rests[k] s.

    Wrenches are (interval, body, axis), body parts in body axes; effects have their numbers at the end of the rows of
    `properties`. If `trace` has rows, they receive the states after
    each interval; there is only one body then.
    """
    for i in range(first, last):
        inertia = Inertia(properties[i, 0], (properties[i, 1], properties[i, 2], properties[i, 3]))
        q, w, high, low = phase_in(state.T, i)
        for k in range(len(counts)):
            held = _held(properties, force_body, torque_body, force_world, torque_world, k, i)
            count, rest = counts[k], rests[k]
            for j in range(count + (1 if rest > 0.0 else 0)):
                q, w, high, low = run(inertia, held, h if j < count else rest, 1, q, w, high, low, properties[i])
            if len(trace) > 0:
                write_phase_in(trace.T, k, q, w, high, low)
        write_phase_in(after.T, i, q, w, high, low)


def lanes(
    properties: Numbers,
    h: float,
    counts: Counts,
    rests: Numbers,
    force_body: Numbers,
    torque_body: Numbers,
    force_world: Numbers,
    torque_world: Numbers,
    state: Numbers,
    after: Numbers,
    first: int,
    last: int,
) -> bool:
    """Do the same without a trace, `LANES` bodies at a time; the last block is padded with the last body.

    Return whether every number, and their sum, is finite.
    """
    c = block(CONSTANTS, LANES)
    s = block(PHASE, LANES)
    finite = True
    for start in range(first, last, LANES):
        bodies = min(LANES, last - start)
        for i in range(LANES):
            b = start + min(i, bodies - 1)
            for r in range(4):
                c[r, i] = properties[b, r]
            for r in range(PHASE):
                s[r, i] = state[b, r]
        for k in range(len(counts)):
            for i in range(LANES):
                b = start + min(i, bodies - 1)
                write_held(c, i, _held(properties, force_body, torque_body, force_world, torque_world, k, b))
            count, rest = counts[k], rests[k]
            for j in range(count + (1 if rest > 0.0 else 0)):
                t = h if j < count else rest
                for i in range(LANES):
                    o = lane(i)
                    inertia, held = constants_in(c, o)
                    q, w, high, low = phase_in(s, o)
                    q, w, high, low = run(inertia, held, t, 1, q, w, high, low)
                    write_phase_in(s, o, q, w, high, low)
        for i in range(bodies):
            for r in range(PHASE):
                after[start + i, r] = s[r, i]
        finite = _all_finite(s, c) and finite
    return finite


def _held(
    properties: Numbers,
    force_body: Numbers,
    torque_body: Numbers,
    force_world: Numbers,
    torque_world: Numbers,
    k: int,
    i: int,
) -> HeldWrench:
    """Return the wrench on body i in interval k, body parts in principal axes."""
    axes = (properties[i, 4], properties[i, 5], properties[i, 6], properties[i, 7])
    return HeldWrench(
        rotate_inverse(axes, _part(force_body, k, i)),
        rotate_inverse(axes, _part(torque_body, k, i)),
        _part(force_world, k, i),
        _part(torque_world, k, i),
    )


def _part(part: Numbers, k: int, i: int) -> Vector:
    """Return one part for body i in interval k, with -0 replaced by 0, as the sum over channels does."""
    return (part[k, i, 0] + 0.0, part[k, i, 1] + 0.0, part[k, i, 2] + 0.0)


def _all_finite(s: Numbers, sums: Numbers) -> bool:
    """Return whether the sum of each column of `s` is finite; the sums are left in the first row of `sums`."""
    for i in range(LANES):
        sums[0, i] = s[0, i]
    for r in range(1, PHASE):
        for i in range(LANES):
            sums[0, i] += s[r, i]
    finite = True
    for i in range(LANES):
        finite = finite and abs(sums[0, i]) < math.inf
    return finite


class Mover:
    """Moves many bodies by one method."""

    def __init__(self, method: Method, *, effects: bool = False) -> None:
        """Prepare, without compiling. `effects`: for bodies with effects."""
        self._plain = fixed_step_kernel.plain(method, fixed_step_kernel.load_in_plain)
        lane_step = None if effects else _LANE_STEPS.get(method.name)
        self._lanes = _on_demand(lanes, _LANES, method.name, lane_step)
        step = method.step if method.compiles else _COMPILED_STEPS.get(method.name)
        if effects and not fixed_step_kernel.compiles(method, effects=True):
            step = None
        self._one_by_one = _on_demand(one_by_one, _ONE_BY_ONE, method.name, step, effects=effects)

    @property
    def kernels(self) -> tuple[fixed_step_kernel.OnDemand | None, ...]:
        """The kernels for blocks and for single bodies."""
        return self._lanes, self._one_by_one

    def move(
        self,
        properties: Numbers,
        schedule: Schedule,
        state: Numbers,
        after: Numbers,
        threads: int,
        loads: Loads = (),
        plugins: Sequence[PluginKernel] = (),
    ) -> None:
        """Write the state of all bodies after `schedule` to `after`; `state` is unchanged.

        Args:
            properties: (N, 8 or more), for each body mass, principal moments, rotation from principal to body axes, and
                at the end the numbers of its effects.
            schedule: steps and wrenches.
            state: (N, `PHASE`).
            after: same shape.
            threads: largest number of threads; the bits do not depend on it.
            loads: functions for the effects of each body in plain Python.
            plugins: functions of plug-ins that the kernels call for them.

        Raises:
            ConvergenceError: a step of a body cannot be solved; names the first such body.
        """
        import numpy as np

        bodies = len(state)
        left, no_trace = np.arange(bodies), np.empty((0, PHASE))
        if self._lanes is not None and bodies >= FEWEST:
            blocks = self._lanes.get(bodies * schedule.steps, bodies * schedule.steps)
            if blocks is not None:
                parts = parts_of(bodies, LANES, threads, schedule.steps)
                finite = each_part(lambda part: blocks(properties, *schedule, state, after, *part), parts)
                left = left[:0] if all(finite) else _not_finite(after)
        if self._one_by_one is not None and len(left) > 0:
            steps = len(left) * schedule.steps
            ready = are_ready(plugins, (self._one_by_one,), steps, steps)
            single = self._one_by_one.get(steps, steps) if ready else None
            if single is not None:

                def some(part: tuple[int, int]) -> None:
                    if len(left) == bodies:
                        single(properties, *schedule, state, after, no_trace, *part)
                        return
                    for i in left[part[0] : part[1]].tolist():
                        single(properties, *schedule, state, after, no_trace, i, i + 1)

                each_part(some, parts_of(len(left), 1, threads, schedule.steps))
                left = _not_finite(after)
        for i in left.tolist():
            try:
                load_from = loads[i] if loads else None
                for numbers in self._in_plain_python(properties, schedule, state[i].tolist(), i, load_from):
                    after[i] = numbers
            except ConvergenceError as error:
                raise ConvergenceError(f"body {i}: {error}" if bodies > 1 else str(error)) from error

    def trace(self, properties: Numbers, schedule: Schedule, state: Numbers, trace: Numbers) -> None:
        """Write the state of one body after each interval of `schedule` to the rows of `trace`; see `move`."""
        import numpy as np

        good, intervals = 0, len(schedule.counts)
        single = None if self._one_by_one is None else self._one_by_one.get(schedule.steps, schedule.steps)
        if single is not None:
            single(properties, *schedule, state, np.empty_like(state), trace, 0, 1)
            # A number that is not finite stays so: checking the last state is enough.
            good = intervals
            if len(_not_finite(trace[-1:])) > 0:
                good = int(_not_finite(trace)[0])
        if good < intervals:
            before = (trace[good - 1] if good else state[0]).tolist()
            rest = schedule.between(good, intervals)
            for k, numbers in enumerate(self._in_plain_python(properties, rest, before, 0), start=good):
                trace[k] = numbers

    def _in_plain_python(
        self,
        properties: Numbers,
        schedule: Schedule,
        state: list[float],
        i: int,
        load_from: Callable[[Point], Load] | None = None,
    ) -> Iterator[tuple[float, ...]]:
        """Yield the states of body i after each interval."""
        mass, i1, i2, i3, *axes = properties[i, :8].tolist()
        inertia, axes = Inertia(mass, (i1, i2, i3)), tuple(axes)
        q, w, high, low = phase_of(tuple(state))
        h, counts, rests, *wrenches = schedule
        for k, (count, rest) in enumerate(zip(counts.tolist(), rests.tolist(), strict=True)):
            force, torque, force_world, torque_world = (tuple((wrench[k, i] + 0.0).tolist()) for wrench in wrenches)
            held = HeldWrench(rotate_inverse(axes, force), rotate_inverse(axes, torque), force_world, torque_world)
            until = high[13] + low[13] + count * h + rest
            try:
                q, w, high, low = self._plain(inertia, held, h, count, q, w, high, low, load_from)
                if rest > 0.0:
                    q, w, high, low = self._plain(inertia, held, rest, 1, q, w, high, low, load_from)
            except ArithmeticError as error:
                raise out_of_range(f"after {until:.9g} s") from error
            numbers = phase_numbers(PhaseState(q, w, high, low))
            if not all(map(math.isfinite, numbers)):
                raise out_of_range(f"after {until:.9g} s")
            yield numbers


@cache
def mover(method: Method, *, effects: bool = False) -> Mover:
    """Return the `Mover` of `method`, for bodies with or without effects."""
    return Mover(method, effects=effects)


@compiled_as(NO_INCREMENT)
def _no_free_motion() -> Increment:
    raise ConvergenceError("exact: expected free motion")


def _free_step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,  # noqa: ARG001
) -> Increment:
    """Take a step of `exact`, for free motion only."""
    if not (closed_form.is_free(held) and norm(angular_velocity) * abs(h) < LARGEST_FREE_TURN):
        return _no_free_motion()
    return closed_form.free_step(inertia, held, h, velocity, orientation, angular_velocity)


_COMPILED_STEPS: dict[str, Step] = {"exact": _free_step}
_LANE_STEPS: dict[str, Step] = {"rk4": rk4.step, "midpoint": midpoint.lane_step, **rotation_splitting.LANE_STEPS}


def _on_demand(
    template: Callable[..., Any], signature: str, name: str, step: Step | None, *, effects: bool = False
) -> fixed_step_kernel.OnDemand | None:
    if step is None:
        return None
    full = f"{template.__name__}_{name}{fixed_step_kernel.WITH_EFFECTS if effects else ''}"
    load = fixed_step_kernel.load_of_effects if effects else fixed_step_kernel.no_load
    one = specialise(fixed_step_kernel.run, f"run_{full}", _step=step, _load=load)
    return fixed_step_kernel.OnDemand(name, specialise(template, full, run=one), signature)


def parts_of(bodies: int, least: int, threads: int, steps: int) -> list[tuple[int, int]]:
    """Return ranges of bodies, one per thread if that is worth it, with lengths that are multiples of `least`."""
    blocks = -(-bodies // least)
    count = max(1, min(threads, blocks, bodies * steps // WORTH_A_THREAD))
    ends = [min(bodies, k * blocks // count * least) for k in range(count + 1)]
    return list(pairwise(ends))


def each_part(do: Callable[[tuple[int, int]], Any], parts: list[tuple[int, int]]) -> list[Any]:
    """Return the results of `do` for each part, each in its own thread, the first in this one."""
    others = [_pool(len(parts) - 1).submit(do, part) for part in parts[1:]]
    try:
        return [do(parts[0]), *(other.result() for other in others)]
    finally:
        # Wait for all threads, even after an error: none may write to the arrays after this function returns.
        if others:
            wait(others)


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, __name__)


if hasattr(os, "register_at_fork"):
    # A forked process inherits the pool, but not its threads.
    os.register_at_fork(after_in_child=_pool.cache_clear)


def _not_finite(state: Numbers) -> Counts:
    """Return the bodies with a number that is not finite; one check of the sum first saves 35 checks."""
    import numpy as np

    with np.errstate(all="ignore"):
        return np.flatnonzero(~np.isfinite(np.add.reduce(state, axis=1)))
