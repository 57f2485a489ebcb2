"""The declared order, measured for each quantity on a general body.

Triaxial, off-diagonal inertia, centre of mass off its origin, torque and force in body and in world axes, against
states to 30 digits.
"""

from __future__ import annotations

import math
from functools import cache

import pytest
from motions import EPS, STEPPED, errors, forced, move, slope
from word_series import QUANTITIES, TIME

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.numerics.vector import norm
from rb_dynamics.run.sample import SampleBuilder

BALANCES = ["energy_defect", "angular_momentum_defect_world", "linear_momentum_defect_world"]
COUNTS = [1, 2, 3, 4, 5, 6, 8, 12, 18, 27, 40, 60, 90, 135, 200, 300, 450, 675, 1000]
STEPS = [TIME / count for count in COUNTS]
# Below FLOOR it is round-off: 1000 steps of a state of size 1 to 10. Above COARSE a method need not show its order.
FLOOR = 1e-13
COARSE = 1e-2
NEEDED = 4
AT_MOST = 6
# The error of its work passes through zero at a step among those that are looked at: the finest three tell the order.
CHANGES_SIGN = {"dverk"}

each_method = pytest.mark.parametrize("method", STEPPED)


@cache
def measured(method: str) -> dict[str, list[float]]:
    """Return the error of each quantity and the defect of each balance at STEPS, down to round-off; inf if refused."""
    case = forced()
    start = SampleBuilder(CombinedEffects(case.body), PhaseState.of(case.body, case.initial))
    found: dict[str, list[float]] = {name: [] for name in (*QUANTITIES, *BALANCES)}
    for h in STEPS:
        try:
            phase = move(case, STEPPED[method], h, TIME)
        except ConvergenceError:
            for values in found.values():
                values.append(math.inf)
            continue
        sample = start.sample(phase, 0)
        for name, error in errors(case, TIME, phase).items():
            found[name].append(error)
        found["energy_defect"].append(abs(sample.energy_defect))
        for name in BALANCES[1:]:
            found[name].append(norm(getattr(sample, name)))
        if all(values[-1] < FLOOR for values in found.values()):
            break
    return found


def resolved(values: list[float], floor: float = FLOOR) -> tuple[list[float], list[float]]:
    """Return the finest steps, and their errors, before the first error that rounding may have touched."""
    count = next((k for k, value in enumerate(values) if value < floor), len(values))
    window = [(h, value) for h, value in zip(STEPS, values[:count], strict=False) if value < COARSE][-AT_MOST:]
    return [h for h, _ in window], [value for _, value in window]


@each_method
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_error_falls_as_the_declared_order(method: str, quantity: str) -> None:
    sizes, values = resolved(measured(method)[quantity])

    assert len(sizes) >= NEEDED, f"only {len(sizes)} steps above round-off: {measured(method)[quantity]}"
    found, order = slope(sizes, values), STEPPED[method].order
    if quantity == "work" and method in CHANGES_SIGN:
        assert slope(sizes[-3:], values[-3:]) >= order - 0.5, values
    elif order <= 8:
        assert found >= order - 0.2, values
        # The leading term of a single number may vanish by chance; then its error falls faster.
        assert quantity == "work" or found <= order + 0.2, values
    else:
        # From 1 s steps to round-off there are but six, and the leading term does not rule all of them.
        assert found >= order - 0.5, values


@each_method
@pytest.mark.parametrize("balance", BALANCES)
def test_balances_close_as_fast_or_exactly(method: str, balance: str) -> None:
    """T - T0 - W, L - L0 - int N dt and p - p0 - int F dt: no larger than the method allows, at round-off if it can."""
    # A defect is a difference of sums: rounding shows earlier.
    sizes, values = resolved(measured(method)[balance], 4.0 * FLOOR)

    if len(sizes) >= 3 and method in CHANGES_SIGN:
        assert slope(sizes[-3:], values[-3:]) >= STEPPED[method].order - 0.5, values
    elif len(sizes) >= 3:
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
    """The books equal the changes of a step of any length, under torque and force of both kinds."""
    assert max(v for v in measured(method)[balance] if v < math.inf) <= 1000.0 * EPS


@pytest.mark.parametrize(("method", "balance"), [("rkmk4", "energy_defect"), ("rk4", "angular_momentum_defect_world")])
def test_balances_that_do_not_close_show(method: str, balance: str) -> None:
    """Defects are not zero by construction: they show the error of a method that does not close the balance."""
    assert max(measured(method)[balance]) > 1e-9


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

    phase = move(still, STEPPED[method], step, 0.5)

    assert phase.impulse_world == pytest.approx([0.5 * f for f in case.held.force_world], rel=8.0 * EPS)
    assert phase.torque_impulse_world == pytest.approx([0.5 * t for t in case.held.torque_world], rel=100.0 * EPS)
