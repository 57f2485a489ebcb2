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
from rb_dynamics.motion.fixed_step_kernel import LONGEST_STRETCH, OnDemand, dense_kernel, kernel
from rb_dynamics.motion.kernel_layout import CONSTANTS, PHASE, constant_numbers, phase_numbers, phase_of
from rb_dynamics.motion.method import Inertia, Method
from rb_dynamics.motion.phase_state import PhaseState, RoundingHistory
from rb_dynamics.motion.plugin_kernels import are_ready, plugin_kernels
from rb_dynamics.motion.step_control import AccuracyControl, FixedStep, Goal, Learnt, OwnControl, StepControl, WholeArc

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Numbers = npt.NDArray[np.float64]
    Whole = npt.NDArray[np.int64]

# Cost of an edge in plain Python, in steps of rk4.
_STEPS_PER_EDGE = 8
_EXACT_WHOLE = 2**53


class Edges(NamedTuple):
    """Edges: times at which there is an output or the held wrench changes.

    Attributes:
        at: (K,), ns, growing.
        kinds: (K,), `OUTPUT`, `CHANGE` or their sum.
        held: (changes, 12), the wrench held from each change on, body parts in principal axes.
    """

    at: Whole
    kinds: Whole
    held: Numbers

    @classmethod
    def of_outputs(cls, at: Whole) -> Edges:
        """Return edges for outputs at these times; the held wrench does not change."""
        import numpy as np

        return cls(at, np.full(len(at), layout.OUTPUT, dtype=np.int64), np.empty((0, CONSTANTS - 4)))

    def behind(self, index: int) -> Edges:
        """Return the edges from this index on."""
        changes = len((self.kinds[:index] & layout.CHANGE).nonzero()[0])
        return Edges(self.at[index:], self.kinds[index:], self.held[changes:])

    def before(self, index: int) -> Edges:
        """Return the edges before this index."""
        return Edges(self.at[:index], self.kinds[:index], self.held)

    def stretch(self, least: int) -> tuple[int, int]:
        """Return the places where `least` or more outputs without a change first begin and end.

        Both are behind the last edge if there are none.
        """
        import numpy as np

        ends = np.append((self.kinds & layout.CHANGE).nonzero()[0], len(self.at))
        begins = np.append(0, ends[:-1] + 1)
        long = (ends - begins >= least).nonzero()[0]
        return (int(begins[long[0]]), int(ends[long[0]])) if len(long) else (len(self.at), len(self.at))


class ArcState(NamedTuple):
    """State of an arc and its grid.

    Attributes:
        method: the method of the arc.
        control: its step control.
        held: the held wrench.
        start_ns: start of the arc.
        phase: the phase at the last grid point.
        reached: time from the start to the last grid point, in units of 1/denominator ns.
        strides: number of strides up to there.
        stride: length of the next stride; 0 if it has not been chosen.
        after: the phase at the end of the next stride.
        choose_after: number of strides after which a method is chosen again; 0 for never.
        learnt: learnt state of the step control after the strides that time has entered.
        following: the same after the next stride.
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
    """History of a run before the present arc, and rules for the next arcs.

    Attributes:
        history: of the arcs before the present one.
        origin: the phase in which the present arc began.
        driven: number of earlier arcs that were not in closed form.
        driven_by: method and control of arcs that are not in closed form; None if they have not been chosen.
        may_close: whether arcs that have a closed form are propagated by it.
        accuracy: the accuracy that a closed form must reach in spite of rounding.
        length_ns: length of the arc before the present one; 0 if there was none.
        expected_ns: length of the present arc if the two before were equally long; 0 if not.
        costs_least: whether no method of `auto` has a stride that costs less than that of `driven_by`.
    """

    history: RoundingHistory
    origin: PhaseState
    driven: int
    driven_by: tuple[Method, StepControl] | None
    may_close: bool
    accuracy: float
    length_ns: int
    expected_ns: int
    costs_least: bool = False


class Propagated(NamedTuple):
    """Result of a propagation.

    Attributes:
        reason: why it ended: `DONE`, `CHOOSE` or `STOPPED`.
        edges: number of edges that it passed.
        changes: number of changes among them.
        steps: number of steps of the arcs that have ended.
        steps_here: number of steps to the last edge.
        outputs: (n, `PHASE`), the phases at the outputs.
        here: the phase at the last edge.
        closed: whether the present arc is in closed form.
        methods: names of the methods used.
        arc_state: state of the present arc.
        arcs: history before the present arc.
    """

    reason: int
    edges: int
    changes: int
    steps: int
    steps_here: int
    outputs: Numbers
    here: PhaseState
    closed: bool
    methods: tuple[str, ...]
    arc_state: ArcState
    arcs: Arcs


def pays(edges: int) -> bool:
    """Return whether there is a kernel for this number of edges."""
    return layout.PROPAGATE.get(edges * _STEPS_PER_EDGE, 0) is not None


def propagate(
    inertia: Inertia, arc_state: ArcState, arcs: Arcs, edges: Edges, effects: tuple[float, ...] = ()
) -> Propagated | None:
    """Propagate from edge to edge, as far as the kernel can; None if there is none or the times are too large for it.

    `effects` are the numbers of the effects, which act throughout.
    """
    import numpy as np

    closed, driven_by = isinstance(arc_state.control, WholeArc), arcs.driven_by
    grid = driven_by[1] if driven_by else arc_state.control
    if not countable(grid, int(edges.at[-1]) - arc_state.start_ns, int(edges.at[-1])):
        return None
    kernels = _kernels(driven_by, closed or (arcs.may_close and not effects), len(edges.at), effects)
    if kernels is None:
        return None
    memory = 0 if driven_by is None or driven_by[0].dense is None else driven_by[0].dense.size
    f = _numbers(inertia, arc_state, arcs, grid, (*(0.0,) * memory, *(effects or NO_EFFECTS)))
    w = _whole_numbers(arc_state, arcs, grid, closed)
    rows = np.empty((int(np.count_nonzero(edges.kinds & layout.OUTPUT)), PHASE))
    run, *handed = kernels
    reason = run(f, w, edges.at, edges.kinds, edges.held, rows, *handed)
    return _propagated(reason, f.tolist(), w.tolist(), rows, arc_state, arcs)


def countable(grid: StepControl, length_ns: int, time_ns: int) -> bool:
    """Return whether 64-bit integers, and doubles, represent all lengths exactly."""
    denominator = grid.denominator
    return max(abs(length_ns), abs(time_ns), 10**9) * denominator < _EXACT_WHOLE and (
        not isinstance(grid, FixedStep) or grid.length < _EXACT_WHOLE
    )


def _kernels(
    driven_by: tuple[Method, StepControl] | None, closed: bool, edges: int, effects: tuple[float, ...]
) -> list[Callable[..., Any]] | None:
    """Return the kernel for propagation and the kernels that it calls; None if one is missing."""
    exact = kernel(EXACT)
    steps: OnDemand | None = exact
    within: OnDemand | None = None
    strides: OnDemand | None = layout.NO_STRIDES
    if driven_by is not None:
        method, control = driven_by
        steps = kernel(method, effects=bool(effects))
        within = dense_kernel(method)
        fixed = isinstance(control, FixedStep)
        strides = layout.NO_STRIDES if fixed else strides_by(method, control, effects=bool(effects))
    wanted = (layout.PROPAGATE, steps, strides, within or steps, exact if closed else steps)
    if not are_ready(plugin_kernels(effects), [each for each in wanted if each], edges * _STEPS_PER_EDGE, 0):
        return None
    # Request all of them, so that the next call finds all compiled.
    found = [None if each is None else each.get(edges * _STEPS_PER_EDGE, 0) for each in wanted]
    return [each for each in found if each is not None] if None not in found else None


def _numbers(inertia: Inertia, arc_state: ArcState, arcs: Arcs, grid: StepControl, rest: tuple[float, ...]) -> Numbers:
    import numpy as np

    f = np.zeros(layout.NUMBERS + len(rest))
    f[layout.NUMBERS :] = rest
    goal, learnt, following = Goal(math.inf, 1.0, ends=False), Learnt(), Learnt()
    if isinstance(grid, (AccuracyControl, OwnControl)):
        goal, learnt, following = grid.goal, grid.learnt, grid.following
    f[: layout.ROOM] = (
        *constant_numbers(inertia, arc_state.held),
        *goal,
        *phase_numbers(arc_state.phase),
        *learnt,
        *phase_numbers(arc_state.after),
        *following,
        arcs.accuracy,
        *arcs.history,
        *phase_numbers(arcs.origin),
        *phase_numbers(arc_state.phase),
    )
    return f


def _whole_numbers(arc_state: ArcState, arcs: Arcs, grid: StepControl, closed: bool) -> Whole:
    import numpy as np

    w = np.zeros(layout.WHOLE, dtype=np.int64)
    w[layout.START], w[layout.REACHED] = arc_state.start_ns, arc_state.reached
    w[layout.STRIDES], w[layout.STRIDE] = arc_state.strides, arc_state.stride
    w[layout.DENOMINATOR], w[layout.PARTS] = grid.denominator, grid.parts
    w[layout.LENGTH] = grid.length if isinstance(grid, FixedStep) else 0
    w[layout.CHOOSE_AFTER], w[layout.CLOSED], w[layout.MAY_CLOSE] = arc_state.choose_after, closed, arcs.may_close
    w[layout.DRIVEN_ARCS], w[layout.BUDGET] = arcs.driven, 10 * LONGEST_STRETCH
    w[layout.BEFORE], w[layout.EXPECTED] = arc_state.start_ns - arcs.length_ns, arcs.expected_ns
    w[layout.COSTS_LEAST] = arcs.costs_least
    return w


def _propagated(
    reason: int, f: list[float], w: list[int], rows: Numbers, arc_state: ArcState, arcs: Arcs
) -> Propagated:
    def phase(first: int) -> PhaseState:
        return phase_of(tuple(f[first : first + PHASE]))

    closed, (method, control) = bool(w[layout.CLOSED]), (arc_state.method, arc_state.control)
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
        ArcState(
            method,
            control,
            held,
            w[layout.START],
            phase(layout.GRID_POINT),
            w[layout.REACHED],
            w[layout.STRIDES],
            w[layout.STRIDE],
            phase(layout.AFTER),
            arc_state.choose_after,
            learnt,
            following,
        ),
        arcs._replace(
            history=RoundingHistory(int(f[layout.HISTORY]), *f[layout.HISTORY + 1 : layout.ORIGIN]),
            origin=phase(layout.ORIGIN),
            driven=w[layout.DRIVEN_ARCS],
            length_ns=w[layout.START] - w[layout.BEFORE],
            expected_ns=w[layout.EXPECTED],
        ),
    )
