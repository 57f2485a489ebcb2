"""Compile a scene: the method for each arc, and how its steps are chosen."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.effect import Point
from rb_dynamics.loads.reaction_wheel import friction_rate
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Method, array_steps
from rb_dynamics.motion.arc import Arc, Enough, LoadFrom, LoadScales, OfPhase, Stepper
from rb_dynamics.motion.auto_method import CANDIDATES, cheapest, costs_least
from rb_dynamics.motion.closed_form import EXACT, has_closed_form, is_free
from rb_dynamics.motion.kernel_layout import phase_of
from rb_dynamics.motion.method import stable_until
from rb_dynamics.motion.phase_state import PhaseState, RoundingHistory, inertia_of
from rb_dynamics.motion.propagation import Arcs, Edges, Propagated, propagate
from rb_dynamics.motion.propagation_kernel import CHANGE, DONE
from rb_dynamics.motion.step_control import AccuracyControl, FixedStep, Learnt, OwnControl, StepControl, WholeArc
from rb_dynamics.numerics.argument_checks import number
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, SHORTEST_STEP
from rb_dynamics.numerics.vector import Vector
from rb_dynamics.scene.model import DEFAULT_ACCURACY, Scene

OPEN_END_HORIZON = 3600.0
"""The time (s) over which `accuracy` applies if a scene has no duration."""


@dataclass
class _Choice:
    """The choice of `auto` for arcs of one kind, and what it has learnt about them.

    Attributes:
        chosen: method and control of driven arcs.
        driven_arcs: number of driven arcs so far.
        length_ns: length of the last arc, driven or not; 0 before the first.
        judged_ns: time at which it was last judged whether a cheaper method is possible.
        best: whether none was.
    """

    chosen: tuple[Method, StepControl] | None = None
    driven_arcs: int = 0
    length_ns: int = 0
    judged_ns: int = -1
    best: bool = False


class Plan:
    """Method and step control of one run; it learns step sizes, so each run needs its own plan.

    Attributes:
        name: name of the method; "auto" if it varies during the run.
        start: the first phase.
    """

    def __init__(self, scene: Scene, begin_ns: int = 0, elapsed: float = 0.0) -> None:
        """Choose the smallest model that meets `scene.solver`, for a run that begins at `begin_ns`.

        `elapsed` is the time (s) of its first phase: of effects, which may count from an earlier run.

        Raises:
            SceneError: the method does not support the effects of the scene.
        """
        self._scene = scene
        self._inertia = inertia_of(scene.body)
        self._accuracy = scene.solver.accuracy or DEFAULT_ACCURACY
        self._from_ns, self._course = begin_ns, RoundingHistory()
        self.start = self._from = PhaseState.of(scene.body, scene.initial, elapsed)
        self._ends = bool(scene.duration)
        self._length = scene.duration or OPEN_END_HORIZON
        self._horizon = self._length + elapsed if self._ends else self._length
        effects, body = scene.combined_effects, scene.body
        slowing, sight, strength = (
            None if part is None else _of_phase(part, body)
            for part in (effects.slowing(), effects.sight(), effects.strength())
        )
        self._scales = LoadScales(slowing, sight, strength)
        self.takes = scene.combined_effects.takes
        # A choice of one needs no trials.
        candidates = CANDIDATES[self.takes] if scene.solver.method == "auto" else (scene.solver.method,)
        self._method = METHODS[candidates[0]] if len(candidates) == 1 else None
        check_method(scene)
        self.name = scene.solver.method
        # Arcs with transients are short and take short steps, so they are no guide to others.
        self._choice, self._gradual_choice = _Choice(), _Choice()
        self._last = self._choice
        self._driven = False
        self._start_ns = begin_ns
        # Lengths (ns) of the last arc, and of the next one if the last two were equally long; 0 if not known.
        self._length_ns = self._expected_ns = 0
        # The control of the last arc that began at the present time, with what it knew at the start.
        self._began: tuple[StepControl | None, Learnt] = None, Learnt()
        if self._method is not None:
            self._choice.chosen = self._gradual_choice.chosen = self._method, self.control_of(self._method)

    @property
    def description(self) -> str:
        """Method and steps as text."""
        if self._method is not None:
            which = self.name if self.name == self._method.name else f"{self.name}: {self._method.name}"
            return f"{which}, {self._steps(self._method)}"
        if not self._scene.channels and _turns_nothing(self._scene):
            return "auto: exact, as nothing turns the body"
        names = ", ".join(CANDIDATES[self.takes])
        closed = "exact where the motion has a closed form; elsewhere " if self.takes == LoadDependence.HELD else ""
        return f"auto: {closed}the cheapest of {names}, {self._steps(None)}"

    def arc(
        self,
        held: HeldWrench,
        start_ns: int,
        phase: PhaseState,
        load_from: LoadFrom | None,
        numbers: tuple[float, ...] | None = None,
        wheels: tuple[float, ...] = (),
        gradually: tuple[float, OfPhase] | None = None,
        sight: OfPhase | None = None,
    ) -> Arc:
        """Return the motion from `start_ns` on, with `held` (body parts in principal axes) and the load of `load_from`.

        `numbers` are the same load for kernels, without the `wheels` that act beside it. `gradually` gives, for loads
        that change gradually, the time (s of the run) at which they are over, and for how long (s) a phase predicts
        them; `sight` gives that for what acts all the time.

        Raises:
            ConvergenceError: no method meets the accuracy here.
        """
        scales = self._scales._replace(numbers=numbers or (), wheels=wheels)
        if gradually is not None:
            settled, near = gradually
            scales = scales._replace(settled=settled, sight=_nearer(self._scales.sight, near))
        scales = scales._replace(sight=_nearer(scales.sight, sight))

        def stepper(method: Method) -> Stepper:
            return Stepper(method, self._inertia, held, load_from, scales)

        # Several commands may come at the same time, each with an arc of zero duration.
        goes_on = start_ns > self._from_ns
        if goes_on:
            length_ns = start_ns - self._from_ns
            self._expected_ns, self._length_ns = length_ns if length_ns == self._length_ns else 0, length_ns
            self._course = self.course(phase)
            self._from_ns, self._from = start_ns, phase
            self._began = None, Learnt()
        method, control = self._choose(held, start_ns, phase, load_from is None, gradually is not None, stepper)
        if isinstance(control, AccuracyControl):
            if not goes_on and self._began[0] is control:
                # The last arc had no duration; a search for a wheel that switches may have gone ahead in it.
                control.learnt = self._began[1]
            self._began = control, control.learnt
        # An arc in closed form never chooses again, but those after it in a kernel for propagation do.
        again = None if self._method is not None else self._cheapest
        # Under commands at regular times, the stride tried first leads to the next of them: no other step is needed.
        first = self._expected_ns / NANOSECONDS if self._expected_ns else math.inf
        return Arc(method, self._inertia, held, control, start_ns, phase, load_from, again, scales, first)

    def separated(self) -> Plan:
        """Return this shallow copy of a plan, for an arc that is only tried: the other does not learn from it."""
        gradual = self._last is self._gradual_choice
        # Both choices may share one control, which may be that of the last arc.
        chosen = filter(None, (self._choice.chosen, self._gradual_choice.chosen))
        controls = {id(control): copy(control) for _, control in chosen}

        def apart(choice: _Choice) -> _Choice:
            return replace(choice, chosen=choice.chosen and (choice.chosen[0], controls[id(choice.chosen[1])]))

        self._choice, self._gradual_choice = apart(self._choice), apart(self._gradual_choice)
        self._last = self._gradual_choice if gradual else self._choice
        last, learnt = self._began
        self._began = controls.get(id(last), last), learnt
        return self

    def propagate(self, arc: Arc, edges: Edges, enough: Enough | None = None) -> tuple[Arc, Propagated] | None:
        """Propagate from edge to edge by the kernel or, up to the next change, by array steps; None if neither can.

        Return the arc that has been reached, and the result of the propagation.
        """
        return self._by_kernel(arc, edges) or self._by_arrays(arc, edges, enough)

    def _by_arrays(self, arc: Arc, edges: Edges, enough: Enough | None) -> tuple[Arc, Propagated] | None:
        begin, end = edges.stretch(array_steps.FEWEST)
        rows = arc.outputs(edges.at[:end], enough) if begin == 0 else None
        if rows is None:
            return None
        k, here = len(rows), phase_of(tuple(rows[-1].tolist()))
        steps = arc.steps_to(int(edges.at[k - 1]))
        behind = self._behind(None, False, math.inf)
        return arc, Propagated(DONE, k, 0, 0, steps, rows, here, False, (), arc.state, behind)

    def _behind(self, driven_by: tuple[Method, StepControl] | None, may_close: bool, accuracy: float) -> Arcs:
        lengths = self._length_ns, self._expected_ns
        return Arcs(self._course, self._from, self._choice.driven_arcs, driven_by, may_close, accuracy, *lengths)

    def _by_kernel(self, arc: Arc, edges: Edges) -> tuple[Arc, Propagated] | None:
        load_from, scales = arc.load
        arc_state, auto = arc.state, self._method is None
        closed, driven_by = isinstance(arc_state.control, WholeArc), self._choice.chosen
        if closed and not auto:
            driven_by = None
        elif not closed and (driven_by is None or arc_state.control is not driven_by[1]):
            # The arc has chosen another method.
            changes = (edges.kinds & CHANGE).nonzero()[0]
            driven_by = arc_state.method, arc_state.control
            if len(changes):
                edges = edges.before(int(changes[0]))
        if not len(edges.at):
            return None
        accuracy = self._accuracy if auto and self._ends else math.inf
        behind = self._behind(driven_by, auto or closed, accuracy)
        if auto and driven_by is not None and driven_by is self._choice.chosen:
            by_accuracy = isinstance(driven_by[1], AccuracyControl)
            behind = behind._replace(costs_least=by_accuracy and costs_least(driven_by[0], self.takes))
        propagated = propagate(self._inertia, arc_state, behind, edges, scales.numbers)
        if propagated is None:
            return None
        if propagated.changes:
            new, behind = propagated.arc_state, propagated.arcs
            self._from_ns, self._from, self._course = new.start_ns, behind.origin, behind.history
            self._start_ns, self._choice.length_ns = new.start_ns, behind.length_ns
            self._length_ns, self._expected_ns = behind.length_ns, behind.expected_ns
            self._choice.driven_arcs, self._driven = behind.driven, not propagated.closed
            self._began = None, Learnt()
            method, control = new.method, new.control
            if propagated.closed:
                method, control = EXACT, WholeArc(accuracy, self._course.turned)
            again = self._cheapest if auto else None
            what = method, self._inertia, new.held, control
            arc = Arc(*what, new.start_ns, behind.origin, load_from, again, scales)
        arc.resume(propagated.arc_state)
        return arc, propagated

    def course(self, phase: PhaseState) -> RoundingHistory:
        """Return the rounding history up to `phase`, which is on the last arc."""
        return self._course.on(self._inertia, self._from, phase)

    def _choose(
        self,
        held: HeldWrench,
        start_ns: int,
        phase: PhaseState,
        steady: bool,
        gradual: bool,
        stepper: Callable[[Method], Stepper],
    ) -> tuple[Method, StepControl]:
        choice = self._gradual_choice if gradual else self._choice
        if self._method is None:
            # An arc of zero duration must leave no trace, so that commands of one time may come one by one.
            if start_ns > self._start_ns:
                self._last.length_ns, self._start_ns = start_ns - self._start_ns, start_ns
                self._last.driven_arcs += self._driven
            self._last = choice
            self._driven = not (steady and has_closed_form(held, phase.orientation, phase.angular_velocity))
            if not self._driven:
                return EXACT, WholeArc(self._accuracy if self._ends else math.inf, self._course.turned)
            # Choose again after 0, 1, 2, 4, 8 ... driven arcs: the choice adapts to the scene at little cost.
            if choice.driven_arcs & (choice.driven_arcs - 1) == 0:
                # Once for each time, before a choice for an arc of zero duration.
                if choice.judged_ns != start_ns:
                    choice.judged_ns, choice.best = start_ns, self._is_best(choice)
                if not choice.best:
                    choice.chosen = self._cheapest(phase, stepper)
        if choice.chosen is None:
            raise TypeError("a method with a name has been chosen at the start")
        return choice.chosen

    def _is_best(self, choice: _Choice) -> bool:
        """Return whether no method could be cheaper: one of the lowest price takes an arc as long as the last at once.

        The kernel of propagation has the same rule.
        """
        if choice.chosen is None or not costs_least(choice.chosen[0], self.takes):
            return False
        control = choice.chosen[1]
        return isinstance(control, AccuracyControl) and control.learnt.step >= choice.length_ns * 1e-9 > 0.0

    def _cheapest(self, phase: PhaseState, stepper: Callable[[Method], Stepper]) -> tuple[Method, StepControl]:
        # The length of an arc is unknown; the last one is the best guess, and initially the whole run. An arc that has
        # lasted longer shows that guess to be wrong: a pulse of milliseconds is no guide to the coast after it.
        rest = max(self._horizon - phase.time, 1e-9) if self._ends else self._horizon
        arc = max(self._last.length_ns * 1e-9, phase.time - self._from.time) if self._last.length_ns else rest
        methods = tuple(METHODS[name] for name in CANDIDATES[self.takes])
        if self._scene.solver.step is not None:  # the most accurate, because it chooses no steps
            methods = methods[:1]
        return cheapest(methods, self.control_of, stepper, phase, arc, rest)

    def control_of(self, method: Method) -> StepControl:
        """Return a control of the steps of a run by `method`, that of the scene or a candidate of `auto`."""
        return control_of(self._scene, method, self.start.center_of_mass_world, self._horizon)

    def _steps(self, method: Method | None) -> str:
        solver = self._scene.solver
        if method is not None and method.order is None:
            return "in closed form"
        if solver.step is not None:
            return f"step {solver.step!r} s"
        return f"steps chosen to keep the error below {self._accuracy!r} for {self._length!r} s"


def control_of(scene: Scene, method: Method, start: Vector, horizon: float) -> StepControl:
    """Return a control of the steps of a run by `method`, from a centre of mass (m) to a time (s)."""
    solver, ends = scene.solver, bool(scene.duration)
    if method.order is None:
        return WholeArc()
    if solver.step is not None:
        expected = f"a number of {SHORTEST_STEP:g} or more (s), because shorter steps would not advance the run"
        control = FixedStep(number(solver.step, "solver.step", expected, SceneError, least=SHORTEST_STEP))
        control.require_few(scene.end_ns or 0, f"{scene.source}: solver.step", SceneError)
        slowing, slowed = friction_rate(scene.wheels, scene.body)
        if method.tableau is not None and slowing * solver.step > stable_until(method.tableau):
            raise ConvergenceError(
                f"{scene.source}: solver.step: found {solver.step:g} s, expected {1.0 / slowing:.1g} s or less, as "
                f"{slowed}: {method.name} is unstable there, and errors of the speed would grow with each step; write "
                "that, or solver.accuracy"
            )
        return control
    accuracy = solver.accuracy or DEFAULT_ACCURACY
    if method.longest_step is not None:
        return OwnControl(accuracy, horizon, ends=ends)
    inertia, pair = inertia_of(scene.body), method.pair is not None
    return AccuracyControl(accuracy, horizon, method.order, inertia, embedded=pair, ends=ends, start=start)


def _of_phase(part: Callable[[Point], float], body: RigidBody) -> OfPhase:
    return lambda phase: part(phase.point(body))


def _nearer(one: OfPhase | None, other: OfPhase | None) -> OfPhase | None:
    """Return the shorter of two sights."""
    if one is None or other is None:
        return one or other
    return lambda phase: min(one(phase), other(phase))


def _turns_nothing(scene: Scene) -> bool:
    """Return whether all effects are forces that are constant in the world."""
    held = [scene.frames.hold(wrench) for _, entries in scene.combined_effects.schedules() for _, wrench in entries]
    return scene.combined_effects.takes == LoadDependence.HELD and all(map(is_free, held))


def check_method(scene: Scene) -> None:
    """Check that the method of `scene` supports its load.

    Raises:
        SceneError: it does not.
    """
    takes, name = scene.combined_effects.takes, scene.solver.method
    if name != "auto" and METHODS[name].takes < takes:
        raise SceneError(cannot_take(scene, METHODS[name], takes))


def cannot_take(scene: Scene, method: Method, takes: LoadDependence) -> str:
    """Return the error message if `method` does not support the load of `scene`, which requires `takes`."""
    able = sorted(other.name for other in METHODS.usable() if other.takes >= takes)
    acting = ", ".join(scene.combined_effects.varying)
    return (
        f"{scene.source}: solver.method: found {method.name}, expected a method that supports {acting}: auto or one of "
        f"{', '.join(able)}; write one of these, or remove the effect"
    )
