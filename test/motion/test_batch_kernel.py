"""Bodies computed side by side have the bits of each one alone."""

from __future__ import annotations

import random

import numpy as np
import pytest

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia, batch_kernel
from rb_dynamics.motion.arc import Arc
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.step_control import FixedStep
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.rotation import normalize
from rb_dynamics.numerics.vector import Vector, scale

BODIES = 150
LANE_METHODS = [name for name in METHODS if name in batch_kernel._LANE_STEPS]
LONG = {"dlm2", "dlm4", "dlm6"}
needs_numba = pytest.mark.skipif(not compilation.available(), reason="nothing to compare with: numba is not installed")


def case(r: random.Random, fastest: float) -> tuple[Inertia, HeldWrench, PhaseState]:
    def vector(size: float) -> Vector:
        return (r.uniform(-size, size), r.uniform(-size, size), r.uniform(-size, size))

    a, b = sorted((10.0 ** r.uniform(-0.5, 0.5), 10.0 ** r.uniform(-0.5, 0.5)))
    moments = [a, b, r.uniform(b, a + b)]
    r.shuffle(moments)
    held = HeldWrench(*(vector(1.0) for _ in range(4)))
    start = normalize((r.gauss(0.0, 1.0), r.gauss(0.0, 1.0), r.gauss(0.0, 1.0), r.gauss(0.0, 1.0)))
    high = (*vector(10.0), *vector(10.0), *([0.0] * 8))
    spin = scale(fastest * 10.0 ** r.uniform(-3.0, 0.0), vector(1.0))
    inertia = Inertia(10.0 ** r.uniform(-3.0, 3.0), (moments[0], moments[1], moments[2]))
    return inertia, held, PhaseState(start, spin, high, (0.0,) * 14)


class Case:
    """Bodies in principal axes, under one wrench each, and a step."""

    def __init__(self, bodies: int, fastest: float, step: float = 0.01, seed: int = 1) -> None:
        r = random.Random(seed)
        self.step, self.cases = step, [case(r, fastest) for _ in range(bodies)]
        inertias, helds, phases = zip(*self.cases, strict=True)
        self.constants = np.array([(i.mass, *i.moments, 0.0, 0.0, 0.0, 1.0) for i in inertias])
        self.state = np.array([(*p.orientation, *p.angular_velocity, *p.high, *p.low) for p in phases])
        self.wrenches = [np.array([[held[k] for held in helds]]) for k in range(4)]

    def schedule(self, count: int) -> batch_kernel.Schedule:
        return batch_kernel.Schedule(self.step, np.array([count]), np.array([0.25 * self.step]), *self.wrenches)

    def moved(self, name: str, count: int, threads: int = 1) -> list[str]:
        method = METHODS[name]
        after = np.empty_like(self.state)
        batch_kernel.mover(method).move(self.constants, self.schedule(count), self.state, after, threads)
        return [repr(tuple(row)) for row in after.tolist()]

    def alone(self, name: str, i: int, count: int) -> str:
        inertia, held, phase = self.cases[i]
        arc = Arc(METHODS[name], inertia, held, FixedStep(self.step), 0, phase)
        orientation, spin, high, low = tuple(
            getattr(arc.at(round((count + 0.25) * self.step * 1e9)), f) for f in FIELDS
        )
        return repr((*orientation, *spin, *high, *low))


FIELDS = ("orientation", "angular_velocity", "high", "low")


@pytest.mark.parametrize("name", LANE_METHODS)
def test_a_step_for_lanes_is_the_step(name: str) -> None:
    """In plain Python, so that it is also tested without numba."""
    for seed in range(50):
        inertia, held, phase = case(random.Random(seed), 1.0)
        arguments = inertia, held, 0.01, (0.1, 0.2, 0.3), phase.orientation, phase.angular_velocity, None

        assert repr(batch_kernel._LANE_STEPS[name](*arguments)) == repr(METHODS[name].step(*arguments))


@needs_numba
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in LONG)) for n in LANE_METHODS])
class TestLanes:
    def test_have_the_bits_of_a_body_alone(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        """The number of bodies is not a multiple of the block, one thread and several; alone in plain Python."""
        case = Case(BODIES, fastest=5.0)
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
        moved = case.moved(name, 20)
        monkeypatch.setattr(batch_kernel, "WORTH_A_THREAD", 1)

        assert case.moved(name, 20, threads=3) == moved
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
        assert [case.alone(name, i, 20) for i in range(BODIES)] == moved

    def test_a_body_that_cannot_be_moved_is_named(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
        case = Case(BODIES, fastest=5.0)
        case.state[77, 4:7] = 1e4

        with pytest.raises(ConvergenceError, match=f"body 77: {name}: "):
            case.moved(name, 5)


@needs_numba
def test_where_iterations_do_not_do_for_lanes_they_go_on_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of these bodies turn by up to a radian in a step, which takes more than four iterations."""
    case = Case(BODIES, fastest=10.0, step=0.1)
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    mover, after = batch_kernel.mover(METHODS["midpoint"]), np.full_like(case.state, np.nan)
    blocks = mover._lanes.get(1, 1)
    blocks(case.constants, *case.schedule(10), case.state, after, 0, BODIES)
    refused = int(np.isnan(after).any(axis=1).sum())
    moved = case.moved("midpoint", 10)
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")

    assert 5 < refused < BODIES - 5
    assert [case.alone("midpoint", i, 10) for i in range(BODIES)] == moved


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize(("bodies", "least"), [(1, 64), (64, 64), (65, 64), (1000, 64), (1000, 1), (3, 1)])
def test_parts_are_whole_blocks_and_leave_nobody_out(bodies: int, least: int, threads: int) -> None:
    parts = batch_kernel.parts_of(bodies, least, threads, 10**6)

    assert len(parts) <= threads
    assert [i for first, last in parts for i in range(first, last)] == list(range(bodies))
    assert all(first % least == 0 for first, _ in parts)


def test_a_short_way_takes_no_second_thread() -> None:
    assert batch_kernel.parts_of(1000, 64, 8, 1) == [(0, 1000)]
