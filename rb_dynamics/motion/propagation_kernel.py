"""The kernel of propagation: from edge to edge, across changes of what is held, in one compiled call.

An edge is a time at which something happens: a state is looked at, or what is held changes and a new arc begins. What
happens in an arc is what `arc.py` does, to the same bits: steps lie on a grid that begins with the arc; an edge between
two grid points is reached by a shorter step from the last one, which is then discarded. One kernel serves all methods:
it is passed the kernel of the method. Where a step is refused or a method has to be chosen, it stops before the edge;
plain Python goes on from there and raises the error.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rb_dynamics.loads.compiled_load import has_effects
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import closed_form, planar_motion
from rb_dynamics.motion.adaptive_kernel import FOREVER
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.kernel_layout import CONSTANTS, PHASE, constants_at, phase_at, write_phase
from rb_dynamics.motion.method import Inertia
from rb_dynamics.motion.phase_state import MOMENTUM, PhaseState, RoundingHistory, grown, is_finite, total, with_arc
from rb_dynamics.motion.step_checks import LARGEST_FREE_TURN, NO_INCREMENT
from rb_dynamics.motion.step_control import Goal, Learnt, closed_form_rounding
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import dot, norm, scale
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    import numpy.typing as npt

    Numbers = npt.NDArray[np.float64]
    Whole = npt.NDArray[np.int64]

LOOK, CHANGE = 1, 2
"""What is done at an edge, added up: the state is kept, and what is held changes."""

DONE, CHOOSE, STOPPED = 0, 1, 2
"""Why the kernel returns: no edge is left, a method may be to choose, or it cannot get to the next edge."""

# Where things stand among the numbers that the kernel is handed, and puts back. The first are those of a kernel of
# strides by accuracy: body and wrench, goal, the phase at the grid point, what is learnt, and both after the next
# stride. Then what closed forms may round away, what lies behind, the phases where the arc began and at the last edge,
# and room for the numbers of a kernel for fixed steps. At the end come those of the effects, where all kernels look.
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

# And among the whole numbers: start of the arc (ns), length of the way to the grid point, strides that led there,
# length of the next one (0 if it has not been chosen), all in units of 1/denominator ns, length of all strides (0 if
# each is chosen), steps that are as accurate as a stride; the number of strides after which a method is chosen (0 for
# never), whether the arc is in closed form, whether arcs may be, arcs behind that were not, start of the arc before;
# strides that may still be taken; edges and changes that lie behind, steps of the arcs that have ended, all steps to
# the last edge; whether a method led there, and whether a closed form did; time of the next edge.
START, REACHED, STRIDES, STRIDE, DENOMINATOR, LENGTH, PARTS, CHOOSE_AFTER, CLOSED, MAY_CLOSE = range(10)
DRIVEN_ARCS, BEFORE, BUDGET, EDGES, CHANGES, STEPS, STEPS_HERE, BY_METHOD, BY_CLOSED_FORM, _AT, WHOLE = range(10, 21)


def propagate(
    f: Numbers,
    w: Whole,
    at: Whole,
    kinds: Whole,
    held: Numbers,
    rows: Numbers,
    steps: Callable[[Numbers, float, int], None],
    strides: Callable[[Numbers, int, int], tuple[int, int, int]],
    in_closed_form: Callable[[Numbers, float, int], None],
) -> int:
    """Go from edge to edge, and return why not further.

    Args:
        f: numbers: see above.
        w: whole numbers: see above.
        at: (K,), ns, of the edges; they grow.
        kinds: (K,), what is done at each.
        held: (changes, 12), what is held from each change on, body parts in principal axes.
        rows: (looks, `PHASE`): where the phase at each look is written.
        steps: the kernel of the method for fixed steps.
        strides: its kernel for strides by accuracy.
        in_closed_form: as `steps`, for what has a closed form.
    """
    room, looks = f[ROOM:], 0
    while w[EDGES] < len(at):
        w[_AT] = at[w[EDGES]]
        kind, target = kinds[w[EDGES]], (w[_AT] - w[START]) * w[DENOMINATOR]
        if w[CLOSED] == 0:
            reason = _advance(f, w, target, room, steps, strides)
            if reason != DONE:
                return reason
        if not _reach(f, w, target, room, steps, in_closed_form):
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
            if w[MAY_CLOSE] != 0 and not closed and driven & (driven - 1) == 0:
                return CHOOSE
        w[BY_METHOD if w[CLOSED] == 0 else BY_CLOSED_FORM] = 1
        if kind & LOOK:
            _copy(room, CONSTANTS, rows[looks], 0, PHASE)
            looks += 1
        _copy(room, CONSTANTS, f, HERE, PHASE)
        w[STEPS_HERE] = w[STEPS] + w[STRIDES] + (1 if target > w[REACHED] else 0)
        if kind & CHANGE:
            _begin_arc(f, w, here, held[k], driven, closed)
        w[EDGES] += 1
    return DONE


def _begin_arc(f: Numbers, w: Whole, here: PhaseState, held: Numbers, driven: int, closed: bool) -> None:
    """Begin an arc at the edge, in the phase that has been reached."""
    inertia = Inertia(f[0], (f[1], f[2], f[3]))
    course = RoundingHistory(f[HISTORY], f[HISTORY + 1], f[HISTORY + 2], f[HISTORY + 3], f[HISTORY + 4])
    course = with_arc(course, inertia, phase_at(f, ORIGIN), here)
    f[HISTORY], f[HISTORY + 1], f[HISTORY + 2], f[HISTORY + 3], f[HISTORY + 4] = course
    _copy(held, 0, f, 4, CONSTANTS - 4)
    _copy(f, HERE, f, ORIGIN, PHASE)
    _copy(f, HERE, f, GRID_POINT, PHASE)
    # As `AccuracyControl.start` does.
    f[GRID_POINT + PHASE + _LEARNT - 1] = 0.0
    w[STEPS] = w[STEPS_HERE]
    w[BEFORE], w[START], w[DRIVEN_ARCS], w[CLOSED] = w[START], w[_AT], driven, 1 if closed else 0
    w[REACHED] = w[STRIDES] = w[STRIDE] = 0
    w[CHANGES] += 1


def _reach(
    f: Numbers,
    w: Whole,
    target: int,
    room: Numbers,
    steps: Callable[[Numbers, float, int], None],
    in_closed_form: Callable[[Numbers, float, int], None],
) -> bool:
    """Write the phase at `target` to `room`, from the last grid point; return whether it can be kept."""
    rest = (target - w[REACHED]) / (w[DENOMINATOR] * NANOSECONDS)
    _copy(f, 0, room, 0, CONSTANTS)
    _copy(f, GRID_POINT, room, CONSTANTS, PHASE)
    if rest > 0.0:
        if w[CLOSED] == 0:
            steps(room, rest / w[PARTS], w[PARTS])
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
    """Take the strides of the arc that end by `target`, and choose the one after them if time goes into it."""
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
            if count < most and w[STRIDE] == 0:
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


def _in_closed_form(numbers: Numbers, h: float, _: int) -> None:
    """Advance by h s in a motion that has a closed form; beyond its reach, to NaN."""
    (inertia, held), phase = constants_at(numbers), phase_at(numbers, CONSTANTS)
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


def _no_strides(numbers: Numbers, room: int, count: int) -> tuple[int, int, int]:  # noqa: ARG001
    """Stand where no stride is chosen."""
    return 0, 0, 0


_STEPS = "void(float64[::1], float64, int64)"
_STRIDES = "UniTuple(int64, 3)(float64[::1], int64, int64)"


_TAKEN = "float64[::1], int64[::1], int64[::1], int64[::1], float64[:, ::1], float64[:, ::1]"
_HANDED = ", ".join(f"FunctionType({each})" for each in (_STEPS, _STRIDES, _STEPS))


PROPAGATE = OnDemand("rk4", propagate, f"int64({_TAKEN}, {_HANDED})")
CLOSED_FORM = OnDemand("exact", _in_closed_form, _STEPS)
NO_STRIDES = OnDemand("rk4", _no_strides, _STRIDES)
