"""Invariants of free motion: declared ones hold to round-off over thousands of steps, others at the declared order.

Near the middle axis of a triaxial body with off-diagonal inertia, where the motion flips repeatedly and amplifies
errors of energy or momentum most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import pytest
from motions import EPS, METHODS, STEPPED, Case, forced, move

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.arc import Arc
from rb_dynamics.motion.phase_state import PhaseState, inertia_of
from rb_dynamics.motion.step_control import FixedStep
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import norm, subtract
from rb_dynamics.run.sample import kinetic_energy

N = 2000


@cache
def tumbler() -> Case:
    """Spins at 2 rad/s, 0.07 rad off its middle axis."""
    axes = (0.5, -0.1, 0.7, 0.5)
    body = RigidBody.from_matrix(2.0, RigidBody.from_principal(1.0, (1.0, 2.0, 2.9), axes).inertia, (0.3, -0.2, 0.1))
    spin = rotation.rotate(axes, (0.1, 2.0, 0.1))
    return Case(
        body,
        State(
            linear_velocity_world=(0.3, -0.1, 0.2),
            angular_velocity_body=spin,
            orientation_xyzw=rotation.normalize((0.1, 0.2, 0.3, 0.4)),
        ),
        HeldWrench(),
        {},
    )


@dataclass(frozen=True)
class Drift:
    """Largest deviations over a run, relative."""

    energy: float
    angular_momentum: float
    unit_quaternion: float
    linear_momentum: float


@cache
def drift(method: str, step: float, count: int) -> Drift:
    case = tumbler()
    start = PhaseState.of(case.body, case.initial)
    arc = Arc(METHODS[method], inertia_of(case.body), HeldWrench(), FixedStep(step), 0, start)
    t0, l0 = kinetic_energy(case.body, start), start.angular_momentum_world(case.body)
    energy = spin = unit = push = 0.0
    for k in range(1, count + 1):
        phase = arc.at(round(k * step * NANOSECONDS))
        energy = max(energy, abs(kinetic_energy(case.body, phase) / t0 - 1.0))
        spin = max(spin, norm(subtract(phase.angular_momentum_world(case.body), l0)) / norm(l0))
        unit = max(unit, abs(math.hypot(*phase.orientation) - 1.0))
        push = max(push, norm(subtract(phase.linear_momentum_world, start.linear_momentum_world)))
    return Drift(energy, spin, unit, push)


each_method = pytest.mark.parametrize("method", METHODS)
# A random walk of roundings: a few units in the last place in each step.
ROUND_OFF = 4.0 * EPS * math.sqrt(N)


@each_method
def test_declared_invariants_are_kept_to_round_off(method: str) -> None:
    found = drift(method, 0.02, N)

    for invariant in METHODS[method].invariants - {"unit_quaternion"}:
        assert getattr(found, invariant) <= ROUND_OFF, invariant


@each_method
def test_attitude_stays_a_rotation_and_nothing_pushes(method: str) -> None:
    found = drift(method, 0.02, N)

    # `renormalize` leaves the last two bits alone.
    assert found.unit_quaternion <= 3.0 * EPS
    assert found.linear_momentum == 0.0


@pytest.mark.parametrize("step", [0.1, 0.25])
@pytest.mark.parametrize(
    ("method", "invariant"),
    [(name, i) for name, m in METHODS.items() for i in ("energy", "angular_momentum") if i in m.invariants],
)
def test_declared_invariants_do_not_depend_on_the_step(method: str, invariant: str, step: float) -> None:
    """Conserved to round-off even with steps too long for the motion: a property of the method, not of its error."""
    assert getattr(drift(method, step, 400), invariant) <= 8.0 * EPS * math.sqrt(400)


@pytest.mark.parametrize(
    ("method", "invariant"),
    [(name, i) for name, m in STEPPED.items() for i in ("energy", "angular_momentum") if i not in m.invariants],
)
def test_other_invariants_drift_as_the_order_says(method: str, invariant: str) -> None:
    order = STEPPED[method].order
    h = 0.02 if order < 6 else 0.1
    coarse, fine = (getattr(drift(method, step, round(20.0 / step)), invariant) for step in (2.0 * h, h))

    assert coarse > 100.0 * EPS, "kept to round-off: declare it"
    assert math.log2(coarse / fine) >= 0.95 * order
    # The drift over 20 s stays below the local error (|w| 2h)^p times the 40 rad turned.
    assert coarse <= 40.0 * (4.0 * h) ** order


@each_method
def test_defects_of_long_runs_grow_like_roundings(method: str) -> None:
    """Round-off is a random walk: four times the steps give about twice the drift, not four times."""
    for invariant in METHODS[method].invariants - {"unit_quaternion"}:
        assert getattr(drift(method, 0.02, N), invariant) <= 8.0 * max(
            getattr(drift(method, 0.02, N // 4), invariant), EPS * math.sqrt(N)
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "invariant"),
    [(name, i) for name, m in METHODS.items() for i in ("energy", "angular_momentum") if i in m.invariants],
)
def test_declared_invariants_are_kept_over_200000_steps(method: str, invariant: str) -> None:
    assert getattr(drift(method, 0.02, 200_000), invariant) <= 8.0 * EPS * math.sqrt(200_000)


def test_midpoint_closes_the_energy_balance_of_a_long_driven_run() -> None:
    """Its design: T changes by w . lambda exactly, in each step and under every held wrench."""
    case = forced()
    start = PhaseState.of(case.body, case.initial)

    phase = move(case, METHODS["midpoint"], 0.01, 40.0)

    gained = kinetic_energy(case.body, phase) - kinetic_energy(case.body, start)
    assert gained > 10.0
    assert abs(gained - phase.work) <= 8.0 * EPS * math.sqrt(4000) * gained
