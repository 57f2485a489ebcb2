"""The kernel of propagation: from edge to edge, across changes of the held wrench, in one compiled call.

An edge is a time with an output, or one at which the held wrench changes and a new arc begins. Within an arc the kernel
does what `arc.py` does, with the same bits: steps lie on a grid that begins with the arc; an edge between two grid
points is reached by a shorter step from the last one, which is then discarded. One kernel serves all methods: it gets
the kernel of the method as an argument. Where a step is refused or a method has to be chosen, it stops before the edge.
Plain Python continues from there and raises the error.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rb_dynamics.loads.compiled_load import has_effects
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import closed_form
from rb_dynamics.motion.adaptive_kernel import FOREVER
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.kernel_layout import CONSTANTS, PHASE, phase_at
from rb_dynamics.motion.method import Inertia
from rb_dynamics.motion.phase_state import MOMENTUM, PhaseState, RoundingHistory, is_finite, total, with_arc
from rb_dynamics.motion.step_control import Goal, Learnt, closed_form_rounding
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import dot, scale
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    import numpy.typing as npt

    Numbers = npt.NDArray[np.float64]
    Whole = npt.NDArray[np.int64]

OUTPUT, CHANGE = 1, 2
"""Kinds of edges: the state is an output; the held wrench changes. An edge that does both has their sum."""

DONE, CHOOSE, STOPPED = 0, 1, 2
"""Why the kernel returns: all edges are done, a method has to be chosen, or it cannot reach the next edge."""

# Layout of the array of floats that the kernel reads and updates. It begins like that of a kernel for strides by
# accuracy: body and wrench, goal, phase at the grid point, learnt state, and both after the next stride. Then: largest
# rounding error allowed to a closed form, history, phases at the start of the arc and at the last edge, room for the
# numbers of a kernel for fixed steps, and the memory of a dense one. The numbers of the effects come last, where all
# kernels expect them.
_LEARNT = len(Learnt._fields)
GOAL = CONSTANTS
GRID_POINT = GOAL + len(Goal._fields)
AFTER = GRID_POINT + PHASE + _LEARNT
MOST_ROUNDING = AFTER + PHASE + _LEARNT
HISTORY = MOST_ROUNDING + 1
ORIGIN = HISTORY + len(RoundingHistory._fields)
HERE = ORIGIN + PHASE
ROOM = HERE + PHASE
NUMBERS = ROOM + CONSTANTS + PHASE

# Layout of the array of integers. Lengths are in units of 1/denominator ns.
# START: start of the arc, ns. REACHED: time from there to the grid point. STRIDES: number of strides up to it. STRIDE:
# length of the next stride (0 if it has not been chosen). LENGTH: length of all strides (0 if each is chosen). PARTS:
# number of steps that are as accurate as a stride. CHOOSE_AFTER: number of strides after which a method is chosen (0
# for never). CLOSED: whether the arc is in closed form. MAY_CLOSE: whether arcs may be. DRIVEN_ARCS: number of earlier
# arcs that were not in closed form. BEFORE: start of the arc before. EXPECTED: length (ns) of the arc if the two before
# were equally long, otherwise 0. BUDGET: number of strides that may still be taken.
# EDGES, CHANGES: numbers that have been passed. STEPS: number of steps of the arcs that have ended. STEPS_HERE: number
# of steps to the last edge. BY_METHOD, BY_CLOSED_FORM: whether one led there. COSTS_LEAST: whether no stride of another
# method costs less. _AT: time of the next edge.
START, REACHED, STRIDES, STRIDE, DENOMINATOR, LENGTH, PARTS, CHOOSE_AFTER, CLOSED, MAY_CLOSE = range(10)
DRIVEN_ARCS, BEFORE, EXPECTED, BUDGET, EDGES, CHANGES, STEPS, STEPS_HERE = range(10, 18)
BY_METHOD, BY_CLOSED_FORM, COSTS_LEAST, _AT, WHOLE = range(18, 23)


def propagate(
    f: Numbers,
    w: Whole,
    at: Whole,
    kinds: Whole,
    held: Numbers,
    rows: Numbers,
    steps: Callable[[Numbers, float, int], None],
    strides: Callable[[Numbers, int, int], tuple[int, int, int]],
    within: Callable[[Numbers, float, int], None],
    in_closed_form: Callable[[Numbers, float, int], None],
) -> int:
    """Propagate from edge to edge, and return the reason for ending.

    Args:
        f: floats, see above.
        w: integers, see above.
        at: (K,), times of the edges, ns, increasing.
        kinds: (K,), kinds of the edges.
        held: (changes, 12), the wrench held from each change on, body parts in principal axes.
        rows: (outputs, `PHASE`), receives the phase at each output.
        steps: the kernel of the method for fixed steps.
        strides: the kernel of the method for strides by accuracy.
        within: as `steps`, for a time within a stride; may keep what serves other times in what `room` has beyond the
            phase.
        in_closed_form: as `steps`, for motion with a closed form.
    """
    room, outputs = f[ROOM:], 0
    while w[EDGES] < len(at):
        w[_AT] = at[w[EDGES]]
        kind, target = kinds[w[EDGES]], (w[_AT] - w[START]) * w[DENOMINATOR]
        if w[CLOSED] == 0:
            reason = _advance(f, w, target, room, steps, strides)
            if reason != DONE:
                return reason
        if not _reach(f, w, target, room, within, in_closed_form):
            return STOPPED
        here = phase_at(room, CONSTANTS)
        if kind & CHANGE:
            k, driven = w[CHANGES], w[DRIVEN_ARCS] + 1 - w[CLOSED]
            following = _held(held, k)
            closed = (
                w[MAY_CLOSE] != 0
                and not has_effects(f)
                and closed_form.has_closed_form(following, here.orientation, here.angular_velocity)
            )
            if w[MAY_CLOSE] != 0 and not closed and driven & (driven - 1) == 0 and not _is_best(f, w):
                return CHOOSE
        w[BY_METHOD if w[CLOSED] == 0 else BY_CLOSED_FORM] = 1
        if kind & OUTPUT:
            _copy(room, CONSTANTS, rows[outputs], 0, PHASE)
            outputs += 1
        _copy(room, CONSTANTS, f, HERE, PHASE)
        w[STEPS_HERE] = w[STEPS] + w[STRIDES] + (1 if target > w[REACHED] else 0)
        if kind & CHANGE:
            _begin_arc(f, w, here, held[k], driven, closed)
        w[EDGES] += 1
    return DONE


def _is_best(f: Numbers, w: Whole) -> bool:
    """As `Plan._is_best`."""
    return bool(w[COSTS_LEAST] != 0 and f[GRID_POINT + PHASE] >= (w[_AT] - w[START]) * 1e-9)


def _begin_arc(f: Numbers, w: Whole, here: PhaseState, held: Numbers, driven: int, closed: bool) -> None:
    """Begin an arc at the edge, in the present phase."""
    inertia = Inertia(f[0], (f[1], f[2], f[3]))
    course = RoundingHistory(f[HISTORY], f[HISTORY + 1], f[HISTORY + 2], f[HISTORY + 3], f[HISTORY + 4])
    course = with_arc(course, inertia, phase_at(f, ORIGIN), here)
    f[HISTORY], f[HISTORY + 1], f[HISTORY + 2], f[HISTORY + 3], f[HISTORY + 4] = course
    _copy(held, 0, f, 4, CONSTANTS - 4)
    _copy(f, HERE, f, ORIGIN, PHASE)
    _copy(f, HERE, f, GRID_POINT, PHASE)
    length = w[_AT] - w[START]
    w[EXPECTED] = length if length == w[START] - w[BEFORE] else 0
    if not closed:
        # As `AccuracyControl.start` does.
        f[GRID_POINT + PHASE + _LEARNT - 1] = 0.0
        if w[EXPECTED] > 0:
            f[GRID_POINT + PHASE] = min(f[GRID_POINT + PHASE], w[EXPECTED] / NANOSECONDS)
    w[STEPS] = w[STEPS_HERE]
    w[BEFORE], w[START], w[DRIVEN_ARCS], w[CLOSED] = w[START], w[_AT], driven, 1 if closed else 0
    w[REACHED] = w[STRIDES] = w[STRIDE] = 0
    w[CHANGES] += 1


def _reach(
    f: Numbers,
    w: Whole,
    target: int,
    room: Numbers,
    within: Callable[[Numbers, float, int], None],
    in_closed_form: Callable[[Numbers, float, int], None],
) -> bool:
    """Write the phase at `target` to `room`, by a step from the last grid point; return whether it is valid."""
    rest = (target - w[REACHED]) / (w[DENOMINATOR] * NANOSECONDS)
    _copy(f, 0, room, 0, CONSTANTS)
    _copy(f, GRID_POINT, room, CONSTANTS, PHASE)
    if rest > 0.0:
        if w[CLOSED] == 0:
            within(room, rest / w[PARTS], w[PARTS])
        else:
            in_closed_form(room, rest, 1)
    here = phase_at(room, CONSTANTS)
    if w[CLOSED] != 0 and rest > 0.0:
        rounded = closed_form_rounding(f[HISTORY + 1], phase_at(f, GRID_POINT), here, rest)
        if rounded > f[MOST_ROUNDING]:
            return False
    return is_finite(here) and math.isfinite(_energy(f, here))


def _advance(
    f: Numbers,
    w: Whole,
    target: int,
    room: Numbers,
    steps: Callable[[Numbers, float, int], None],
    strides: Callable[[Numbers, int, int], tuple[int, int, int]],
) -> int:
    """Take the strides of the arc that end by `target`; choose the next one if `target` lies within it."""
    while target > w[REACHED]:
        most = min(w[BUDGET], _until_choice(w[CHOOSE_AFTER], w[STRIDES]))
        if most <= 0:
            return CHOOSE
        count = 0
        if w[LENGTH] > 0:
            count = min((target - w[REACHED]) // w[LENGTH], most)
            if count == 0:
                return DONE
            _copy(f, 0, room, 0, CONSTANTS)
            _copy(f, GRID_POINT, room, CONSTANTS, PHASE)
            steps(room, w[LENGTH] / (w[DENOMINATOR] * NANOSECONDS), count)
            if not is_finite(phase_at(room, CONSTANTS)):
                return STOPPED
            _copy(room, CONSTANTS, f, GRID_POINT, PHASE)
            w[REACHED] += count * w[LENGTH]
        elif w[STRIDE] == 0:
            count, way, w[STRIDE] = strides(f, min(target - w[REACHED], FOREVER), most)
            w[REACHED] += way
            if count < most and w[STRIDE] == 0 and target > w[REACHED]:
                w[STRIDES] += count
                return STOPPED
        else:
            _copy(f, AFTER + PHASE, f, GRID_POINT + PHASE, _LEARNT)
            if w[STRIDE] > target - w[REACHED]:
                return DONE
            _copy(f, AFTER, f, GRID_POINT, PHASE)
            w[REACHED] += w[STRIDE]
            w[STRIDE], count = 0, 1
        w[STRIDES] += count
        w[BUDGET] -= count
        if count == most:
            return CHOOSE
    return DONE


def _until_choice(choose_after: int, strides: int) -> int:
    """Return how many strides of an arc may be taken before a method is chosen again."""
    if choose_after == 0:
        return FOREVER
    choice = choose_after
    while choice <= strides:
        choice *= 2
    return choice - strides


def _copy(source: Numbers, i: int, target: Numbers, j: int, count: int) -> None:
    for k in range(count):
        target[j + k] = source[i + k]


def _energy(f: Numbers, phase: PhaseState) -> float:
    momentum, omega = total(phase, MOMENTUM), phase.angular_velocity
    return 0.5 * (dot(momentum, scale(1.0 / f[0], momentum)) + dot(omega, times((f[1], f[2], f[3]), omega)))


def _held(rows: Numbers, k: int) -> HeldWrench:
    r = rows[k]
    return HeldWrench((r[0], r[1], r[2]), (r[3], r[4], r[5]), (r[6], r[7], r[8]), (r[9], r[10], r[11]))


def _no_strides(numbers: Numbers, room: int, count: int) -> tuple[int, int, int]:  # noqa: ARG001
    """Placeholder for methods without strides by accuracy."""
    return 0, 0, 0


_STEPS = "void(float64[::1], float64, int64)"
_STRIDES = "UniTuple(int64, 3)(float64[::1], int64, int64)"


_ARRAYS = "float64[::1], int64[::1], int64[::1], int64[::1], float64[:, ::1], float64[:, ::1]"
_FUNCTIONS = ", ".join(f"FunctionType({each})" for each in (_STEPS, _STRIDES, _STEPS, _STEPS))


PROPAGATE = OnDemand("rk4", propagate, f"int64({_ARRAYS}, {_FUNCTIONS})")
NO_STRIDES = OnDemand("rk4", _no_strides, _STRIDES)
