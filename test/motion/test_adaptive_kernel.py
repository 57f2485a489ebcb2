"""Strides by accuracy are identical compiled and in plain Python: lengths, bits, choices of `auto`, refusals."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Increment, Inertia, Method, adaptive_kernel
from rb_dynamics.motion.arc import Arc, Choose
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.step_control import AccuracyControl, OwnControl, StepControl
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import Quaternion, normalize, rotate
from rb_dynamics.numerics.vector import ZERO, Vector, dot, norm, scale

needs_numba = pytest.mark.skipif(not compilation.available(), reason="nothing to compare with: numba is not installed")

RK4, MIDPOINT = METHODS["rk4"].step, METHODS["midpoint"].step


def pair(
    inertia: Inertia, held: HeldWrench, h: float, v: Vector, q: Quaternion, omega: Vector, load: None = None
) -> tuple[Increment, Increment]:
    """Estimate the error of the midpoint rule by rk4."""
    return RK4(inertia, held, h, v, q, omega, load), MIDPOINT(inertia, held, h, v, q, omega, load)


def longest_step(
    inertia: Inertia, held: HeldWrench, v: Vector, q: Quaternion, omega: Vector, accuracy: float, horizon: float
) -> float:
    """Return a rough estimate of the longest step, too long for the method if the accuracy is low."""
    rate = norm(omega) + norm(held.torque_body) / inertia.moments[0] + 1e-3 * dot(q, q)
    return (accuracy / horizon) ** 0.25 / rate


# What the kernels reach is found by its module; these stand in the one of the tests.
for function in (pair, longest_step):
    function.__module__ = "rb_dynamics.motion.in_tests"

KINDS: dict[str, Method] = {
    "doubling": METHODS["rk4"],
    "low": METHODS["dlm2"],
    "pair": replace(METHODS["rk4"], name="rk4_with_midpoint", order=3, pair=pair),
    "own": replace(METHODS["rk4"], name="rk4_that_knows", longest_step=longest_step),
}

# The other kinds have kernels of their own to compile.
each_kind = pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind in ("low", "own"))) for kind in KINDS]
)


def control_of(
    method: Method, inertia: Inertia, accuracy: float, horizon: float, *, start: Vector = ZERO, ends: bool
) -> StepControl:
    if method.longest_step is not None:
        return OwnControl(accuracy, horizon, ends=ends)
    embedded = method.pair is not None
    return AccuracyControl(accuracy, horizon, method.order, inertia, start=start, embedded=embedded, ends=ends)


def case(method: Method, seed: int, choose_again: Choose | None = None) -> tuple[Arc, int]:
    """Return an arc and its end; one in four has a torque so large that the first trials are refused.

    In another the forces cancel: what is left is rounding.
    """
    r = random.Random(seed)

    def vector(size: float) -> Vector:
        return (r.uniform(-size, size), r.uniform(-size, size), r.uniform(-size, size))

    hard = 10.0 ** r.uniform(3.0, 6.0) if seed % 4 == 0 else 0.0
    inertia = Inertia(10.0 ** r.uniform(-2.0, 2.0), (r.uniform(1.0, 2.0), r.uniform(1.0, 2.0), r.uniform(1.0, 2.0)))
    held = HeldWrench(vector(1.0), vector(max(hard, 1.0)), vector(1.0), vector(1.0))
    spin = ZERO if r.random() < 0.1 else vector(10.0 ** r.uniform(-2.0, 1.0))
    attitude = normalize((r.gauss(0.0, 1.0), r.gauss(0.0, 1.0), r.gauss(0.0, 1.0), r.gauss(0.0, 1.0)))
    if seed % 4 == 3:
        thrust = (0.0, 0.0, held.force_body[2])
        held = HeldWrench(force_body=thrust, force_world=scale(-1.0, rotate(attitude, thrust)))
        spin = (0.0, 0.0, spin[2])
    phase = PhaseState(attitude, spin, (*vector(10.0), *vector(1.0), *ZERO, *ZERO, 0.0, 0.0), (0.0,) * 14)
    # The first trial is a hundredth of the horizon; it is to fail, but not many strides are to follow.
    time, part, loose = (500.0 * hard**-0.5, 0.015, 1e6) if hard else (10.0 ** r.uniform(-1.0, 0.5), 1.0, 1.0)
    accuracy, start = loose * 10.0 ** r.uniform(-6.0, -2.0), phase.center_of_mass_world
    control = control_of(method, inertia, accuracy, time, start=start, ends=r.random() < 0.8)
    end_ns = round(part * time * NANOSECONDS)
    return Arc(method, inertia, held, control, 0, phase, choose_again=choose_again), end_ns


def end(arc: Arc, end_ns: int, looks: tuple[float, ...] = ()) -> tuple[object, ...]:
    """Return the end of an arc with its steps and methods, or the error."""
    try:
        for look in looks:
            arc.advance(round(0.9 * look * end_ns))
            arc.at(round(look * end_ns))
        # By repr, which shows the sign of a zero too.
        return repr(arc.at(end_ns)), arc.steps_to(end_ns), arc.next_grid_ns(), arc.methods
    except ConvergenceError as error:
        return type(error), str(error)


@needs_numba
@each_kind
def test_strides_and_bits_are_those_of_plain_python(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    refused = 0
    # At order 2 a run has many strides.
    for seed in range(20 if kind == "low" else 40):
        ends = []
        for when, looks in (("never", ()), ("always", ()), ("always", (0.1, 0.11, 0.5, 0.9))):
            monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
            ends.append(end(*case(KINDS[kind], seed), looks))
        assert ends[0] == ends[1] == ends[2], seed
        refused += ends[0][0] is ConvergenceError

    assert refused < 20


@needs_numba
@each_kind
def test_what_cannot_be_kept_is_refused_in_the_same_words(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    inertia, said = Inertia(1.0, (1.0, 2.0, 2.5)), set()
    for accuracy, spin in ((1e-17, 1.0), (1e-6, 1e10), (1e-6, 1e200)):
        ends = []
        for when in ("never", "always"):
            monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
            control = control_of(KINDS[kind], inertia, accuracy, 1.0, ends=True)
            start = PhaseState((0.0, 0.0, 0.0, 1.0), (0.7 * spin, -spin, 0.9 * spin), (0.0,) * 14, (0.0,) * 14)
            ends.append(end(Arc(KINDS[kind], inertia, HeldWrench(), control, 0, start), NANOSECONDS))
        assert ends[0] == ends[1]
        assert ends[0][0] is ConvergenceError
        said.add(ends[0][1])

    assert len(said) >= 2


@needs_numba
@each_kind
def test_pieces_meet_without_a_seam(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    whole = end(*case(KINDS[kind], 5))
    monkeypatch.setattr("rb_dynamics.motion.arc.LONGEST_STRETCH", 7)

    assert end(*case(KINDS[kind], 5)) == whole


@needs_numba
def test_a_choice_is_made_after_the_same_strides(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = []
    for when, looks in (("never", ()), ("always", ()), ("always", tuple(k / 100.0 for k in range(1, 100)))):
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
        asked: list[PhaseState] = []

        def other(phase: PhaseState, stepper: object, asked: list[PhaseState] = asked) -> tuple[Method, StepControl]:
            asked.append(phase)
            method = KINDS["doubling" if len(asked) == 2 else "low"]
            accuracy = 1e-6 if method.order == 2 else 1e-12
            start = asked[0].center_of_mass_world
            return method, AccuracyControl(accuracy, 3.0, method.order, Inertia(1.0, (1.0, 1.0, 1.0)), start=start)

        ends.append((end(*case(KINDS["low"], 1, other), looks), asked))

    assert ends[0] == ends[1] == ends[2]
    assert len(ends[0][1]) >= 4


@needs_numba
def test_short_arcs_come_to_be_worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    monkeypatch.setattr("rb_dynamics.motion.fixed_step_kernel.FEW", 300)
    monkeypatch.setattr("rb_dynamics.motion.fixed_step_kernel.MANY", 300)
    # As where no other process can compile, and none has.
    monkeypatch.setattr("rb_dynamics.motion.fixed_step_kernel.is_cached", lambda name: False)
    monkeypatch.setattr("rb_dynamics.motion.fixed_step_kernel.ask_for", lambda *_: False)
    arc, _ = case(KINDS["doubling"], 5)
    (inertia, held, *_), control, phase = arc._what_acts, arc._control, arc._phase
    assert isinstance(control, AccuracyControl)
    what = (inertia, held), control.goal, control.learnt
    runs = adaptive_kernel.Strides(KINDS["doubling"], "doubling")

    found = [runs.after(*what, phase, 10**6, 5, 1) is not None for _ in range(102)]

    assert found == [False] * 99 + [True] * 3
    assert adaptive_kernel.Strides(KINDS["doubling"], "doubling").after(*what, phase, 10**6, 5, 100)


def test_what_has_no_kernel_runs_in_plain_python() -> None:
    method = METHODS["rk4"]
    control = AccuracyControl(1e-5, 1.0, 4, Inertia(1.0, (1.0, 1.0, 1.0)), start=ZERO)

    assert adaptive_kernel.strides_by(method, control) is adaptive_kernel.strides_by(method, control) is not None
    assert adaptive_kernel.strides_by(replace(method, compiles=False), control) is None
