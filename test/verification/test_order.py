"""The declared order, measured for each quantity on a body that hides nothing.

Triaxial, off-diagonal, the centre of mass off its origin, under torque and force in body and in world axes, against
states to 30 digits.
"""

from __future__ import annotations

from functools import cache

import pytest
from motions import EPS, STEPPED, errors, forced, move, slope

from rb_dynamics.diagnostics import Baseline, observe
from rb_dynamics.motion.phase import Phase
from rb_dynamics.vector import norm

QUANTITIES = [
    "attitude",
    "angular_velocity_body",
    "position_world",
    "linear_velocity_world",
    "work",
    "impulse_world",
    "torque_impulse_world",
]
BALANCES = ["energy_defect", "angular_momentum_defect_world", "linear_momentum_defect_world"]

TIME = 1
STEPS = [TIME / 2**k for k in range(4, 11)]
# Errors below are round-off: 1000 steps of a state of size 1 to 10.
FLOOR = 1e-13

each_method = pytest.mark.parametrize("method", STEPPED)


@cache
def measured(method: str) -> dict[str, list[float]]:
    """Return for each quantity its error, and for each balance its defect, at STEPS."""
    case = forced()
    start = Baseline.of(case.body, Phase.of(case.body, case.initial))
    found: dict[str, list[float]] = {name: [] for name in (*QUANTITIES, *BALANCES)}
    for h in STEPS:
        phase = move(case, STEPPED[method], h, TIME)
        sample = observe(case.body, phase, 0, start)
        for name, error in errors(case, TIME, phase).items():
            found[name].append(error)
        found["energy_defect"].append(abs(sample.energy_defect))
        for name in BALANCES[1:]:
            found[name].append(norm(getattr(sample, name)))
    return found


def above_the_floor(values: list[float]) -> tuple[list[float], list[float]]:
    """Return steps and errors down to the first error that rounding may have touched."""
    count = next((k for k, value in enumerate(values) if value < FLOOR), len(values))
    return STEPS[:count], values[:count]


@each_method
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_error_falls_as_the_declared_order(method: str, quantity: str) -> None:
    sizes, values = above_the_floor(measured(method)[quantity])

    assert len(sizes) >= 4, f"only {len(sizes)} steps above round-off: {measured(method)[quantity]}"
    assert abs(slope(sizes, values) - STEPPED[method].order) <= 0.2, values


@each_method
@pytest.mark.parametrize("balance", BALANCES)
def test_balances_close_as_fast_or_exactly(method: str, balance: str) -> None:
    """T - T0 - W, L - L0 - int N dt and p - p0 - int F dt: no larger than the method allows, at round-off if it can."""
    sizes, values = above_the_floor(measured(method)[balance])

    if len(sizes) >= 2:
        assert slope(sizes, values) >= STEPPED[method].order - 0.2, values


@pytest.mark.parametrize(
    ("method", "balance"),
    [
        ("midpoint", "energy_defect"),
        ("midpoint", "angular_momentum_defect_world"),
        ("midpoint", "linear_momentum_defect_world"),
        ("rkmk4", "angular_momentum_defect_world"),
        ("rkmk4", "linear_momentum_defect_world"),
        ("rk4", "linear_momentum_defect_world"),
    ],
)
def test_balances_that_close_exactly(method: str, balance: str) -> None:
    """What the books take is what the step does, at any step: under torque and force of both kinds."""
    assert max(measured(method)[balance]) <= 300.0 * EPS


@pytest.mark.parametrize(("method", "balance"), [("rkmk4", "energy_defect"), ("rk4", "angular_momentum_defect_world")])
def test_balances_that_do_not_close_show(method: str, balance: str) -> None:
    """The defects are no identity: they see the error of a method that does not keep the balance."""
    assert measured(method)[balance][0] > 1e-9


@each_method
@pytest.mark.parametrize("step", [0.25, 0.01, 0.0037])
def test_impulse_of_a_held_world_wrench_is_its_product_with_time(method: str, step: float) -> None:
    case = forced()
    still = type(case)(
        case.body,
        case.initial,
        type(case.held)(force_world=case.held.force_world, torque_world=case.held.torque_world),
        {},
    )

    phase = move(still, STEPPED[method], step, 2.0)

    assert phase.impulse_world == pytest.approx([2.0 * f for f in case.held.force_world], rel=8.0 * EPS)
    assert phase.torque_impulse_world == pytest.approx([2.0 * t for t in case.held.torque_world], rel=100.0 * EPS)
