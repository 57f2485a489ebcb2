"""Propagation: many edges in one call of `propagation_kernel.py`, from the present state of an arc and back to it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.loads.compiled_load import NO_EFFECTS
from rb_dynamics.loads.wrench import HeldWrench, held_of
from rb_dynamics.motion import propagation_kernel as layout
from rb_dynamics.motion.adaptive_kernel import strides_by
from rb_dynamics.motion.closed_form import EXACT
from rb_dynamics.motion.fixed_step_kernel import LONGEST_STRETCH, OnDemand, kernel
from rb_dynamics.motion.kernel_layout import CONSTANTS, PHASE, constant_numbers, phase_numbers, phase_of
from rb_dynamics.motion.method import Inertia, Method
from rb_dynamics.motion.phase_state import PhaseState, RoundingHistory
from rb_dynamics.motion.step_control import AccuracyControl, FixedStep, Goal, Learnt, OwnControl, StepControl, WholeArc

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Numbers = npt.NDArray[np.float64]
    Whole = npt.NDArray[np.int64]

# An edge costs plain Python as much as so many steps of rk4.
_PRICE_OF_AN_EDGE = 8
_EXACT_WHOLE = 2**53


class Edges(NamedTuple):
    """Times at which something happens.

    Attributes:
        at: (K,), ns, growing.
        kinds: (K,), `LOOK`, `CHANGE` or both.
        held: (changes, 12), what is held from each change on, body parts in principal axes.
    """

    at: Whole
    kinds: Whole
    held: Numbers

    @classmethod
    def looks(cls, at: Whole) -> Edges:
        """Return these times, at which nothing changes."""
        import numpy as np

        return cls(at, np.full(len(at), layout.LOOK, dtype=np.int64), np.empty((0, CONSTANTS - 4)))

    def behind(self, index: int) -> Edges:
        """Return the edges from that of this index on."""
        changes = len((self.kinds[:index] & layout.CHANGE).nonzero()[0])
        return Edges(self.at[index:], self.kinds[index:], self.held[changes:])

    def before(self, index: int) -> Edges:
        """Return the edges before that of this index."""
        return Edges(self.at[:index], self.kinds[:index], self.held)


class Standing(NamedTuple):
    """The present state of an arc, and its grid.

    Attributes:
        method: that moves the body.
        control: that chooses its strides.
        held: meanwhile.
        start_ns: when it began.
        phase: at the grid point that has been reached.
        reached: length of the way there, in units of 1/denominator ns.
        strides: that led there.
        stride: length of the next one, 0 if it has not been chosen.
        after: the phase at its end.
        choose_after: strides after which a method is chosen again; 0 for never.
        learnt: what the strides teach that time has gone into.
        following: the same with the next one.
    """

    method: Method
    control: StepControl
    held: HeldWrench
    start_ns: int
    phase: PhaseState
    reached: int
    strides: int
    stride: int
    after: PhaseState
    choose_after: int
    learnt: Learnt = Learnt()
    following: Learnt = Learnt()


class Arcs(NamedTuple):
    """The history of a run before an arc, and what decides how the next arcs are propagated.

    Attributes:
        history: without the arc itself.
        origin: the phase in which it began.
        driven: how many behind it were not in closed form.
        driven_by: method and control of those that are not in closed form; None if they have not been chosen.
        may_close: whether those that have a closed form are propagated by it.
        accuracy: which rounding must leave to a closed form.
    """

    history: RoundingHistory
    origin: PhaseState
    driven: int
    driven_by: tuple[Method, StepControl] | None
    may_close: bool
    accuracy: float


class Propagated(NamedTuple):
    """The result of a propagation.

    Attributes:
        reason: why it ended: `DONE`, `CHOOSE` or `STOPPED`.
        edges: that lie behind.
        changes: of them.
        steps: of the arcs that have ended.
        steps_here: to the last edge.
        looks: (n, `PHASE`), the phases at the looks.
        here: the phase at the last edge.
        closed: whether the arc is in closed form.
        methods: names of those that have moved the body.
        standing: of the arc.
        length_ns: of the arc before it, where it began on the way.
        arcs: what lies behind it.
    """

    reason: int
    edges: int
    changes: int
    steps: int
    steps_here: int
    looks: Numbers
    here: PhaseState
    closed: bool
    methods: tuple[str, ...]
    standing: Standing
    length_ns: int
    arcs: Arcs


def pays(edges: int) -> bool:
    """Return whether the kernel is there for so many edges, or worth loading or compiling."""
    return layout.PROPAGATE.get(edges * _PRICE_OF_AN_EDGE, 0) is not None


def propagate(
    inertia: Inertia, standing: Standing, arcs: Arcs, edges: Edges, effects: tuple[float, ...] = ()
) -> Propagated | None:
    """Go from edge to edge as far as the kernel gets; None if it is not worth compiling or cannot count so far.

    `effects` are the numbers of those that act all the way.
    """
    import numpy as np

    closed, driven_by = isinstance(standing.control, WholeArc), arcs.driven_by
    grid = driven_by[1] if driven_by else standing.control
    if not _countable(grid, int(edges.at[-1]) - standing.start_ns, int(edges.at[-1])):
        return None
    kernels = _kernels(driven_by, closed or (arcs.may_close and not effects), len(edges.at), effects=bool(effects))
    if kernels is None:
        return None
    f, w = _numbers(inertia, standing, arcs, grid, effects or NO_EFFECTS), _whole_numbers(standing, arcs, grid, closed)
    rows = np.empty((int(np.count_nonzero(edges.kinds & layout.LOOK)), PHASE))
    run, *handed = kernels
    reason = run(f, w, edges.at, edges.kinds, edges.held, rows, *handed)
    return _propagated(reason, f.tolist(), w.tolist(), rows, standing, arcs)


def _countable(grid: StepControl, length_ns: int, time_ns: int) -> bool:
    """Return whether lengths are counted exactly in 64 bits, and in doubles."""
    denominator = grid.denominator
    return max(abs(length_ns), abs(time_ns), 10**9) * denominator < _EXACT_WHOLE and (
        not isinstance(grid, FixedStep) or grid.length < _EXACT_WHOLE
    )


def _kernels(
    driven_by: tuple[Method, StepControl] | None, closed: bool, edges: int, *, effects: bool
) -> list[Callable[..., Any]] | None:
    """Return the kernel for propagation and those that it is handed; None if one is not worth compiling."""
    steps: OnDemand | None = layout.CLOSED_FORM
    strides: OnDemand | None = layout.NO_STRIDES
    if driven_by is not None:
        method, control = driven_by
        steps = kernel(method, effects=effects)
        fixed = isinstance(control, FixedStep)
        strides = layout.NO_STRIDES if fixed else strides_by(method, control, effects=effects)
    wanted = (layout.PROPAGATE, steps, strides, layout.CLOSED_FORM if closed else steps)
    # All are asked for, so that all are there the next time.
    found = [None if each is None else each.get(edges * _PRICE_OF_AN_EDGE, 0) for each in wanted]
    return [each for each in found if each is not None] if None not in found else None


def _numbers(
    inertia: Inertia, standing: Standing, arcs: Arcs, grid: StepControl, effects: tuple[float, ...]
) -> Numbers:
    import numpy as np

    f = np.zeros(layout.NUMBERS + len(effects))
    f[layout.NUMBERS :] = effects
    goal, learnt, following = Goal(math.inf, 1.0, ends=False), Learnt(), Learnt()
    if isinstance(grid, (AccuracyControl, OwnControl)):
        goal, learnt, following = grid.goal, grid.learnt, grid.following
    f[: layout.ROOM] = (
        *constant_numbers(inertia, standing.held),
        *goal,
        *phase_numbers(standing.phase),
        *learnt,
        *phase_numbers(standing.after),
        *following,
        arcs.accuracy,
        *arcs.history,
        *phase_numbers(arcs.origin),
        *phase_numbers(standing.phase),
    )
    return f


def _whole_numbers(standing: Standing, arcs: Arcs, grid: StepControl, closed: bool) -> Whole:
    import numpy as np

    w = np.zeros(layout.WHOLE, dtype=np.int64)
    w[layout.START], w[layout.REACHED] = standing.start_ns, standing.reached
    w[layout.STRIDES], w[layout.STRIDE] = standing.strides, standing.stride
    w[layout.DENOMINATOR], w[layout.PARTS] = grid.denominator, grid.parts
    w[layout.LENGTH] = grid.length if isinstance(grid, FixedStep) else 0
    w[layout.CHOOSE_AFTER], w[layout.CLOSED], w[layout.MAY_CLOSE] = standing.choose_after, closed, arcs.may_close
    w[layout.DRIVEN_ARCS], w[layout.BUDGET] = arcs.driven, 10 * LONGEST_STRETCH
    return w


def _propagated(reason: int, f: list[float], w: list[int], rows: Numbers, standing: Standing, arcs: Arcs) -> Propagated:
    def phase(first: int) -> PhaseState:
        return phase_of(tuple(f[first : first + PHASE]))

    closed, (method, control) = bool(w[layout.CLOSED]), (standing.method, standing.control)
    places = layout.GRID_POINT + PHASE, layout.AFTER + PHASE
    learnt, following = (Learnt(*f[at : at + len(Learnt._fields)]) for at in places)
    if arcs.driven_by is not None:
        if isinstance(arcs.driven_by[1], (AccuracyControl, OwnControl)):
            arcs.driven_by[1].learnt, arcs.driven_by[1].following = learnt, following
        if not closed:
            method, control = arcs.driven_by
    methods = (EXACT.name,) if w[layout.BY_CLOSED_FORM] else ()
    if w[layout.BY_METHOD] and arcs.driven_by is not None:
        methods = (*methods, arcs.driven_by[0].name)
    held = held_of(f[4:CONSTANTS])
    return Propagated(
        reason,
        w[layout.EDGES],
        w[layout.CHANGES],
        w[layout.STEPS],
        w[layout.STEPS_HERE],
        rows,
        phase(layout.HERE),
        closed,
        methods,
        Standing(
            method,
            control,
            held,
            w[layout.START],
            phase(layout.GRID_POINT),
            w[layout.REACHED],
            w[layout.STRIDES],
            w[layout.STRIDE],
            phase(layout.AFTER),
            standing.choose_after,
            learnt,
            following,
        ),
        w[layout.START] - w[layout.BEFORE],
        arcs._replace(
            history=RoundingHistory(int(f[layout.HISTORY]), *f[layout.HISTORY + 1 : layout.ORIGIN]),
            origin=phase(layout.ORIGIN),
            driven=w[layout.DRIVEN_ARCS],
        ),
    )
