"""Order conditions of a splitting, by brute force: exp(a1 A) exp(b1 B) ... against exp(A + B), word by word.

A and B do not commute and satisfy no other relation, so a condition that holds here holds for any two flows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from motions import Case, errors, move, slope
from mpmath import mp, mpf

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion.method import Method

Stages = Iterable[tuple[float, float]]


def worst(stages: Stages, wanted: Callable[[str], bool]) -> float:
    """Return the largest |coefficient - 1/n!| of the words that are wanted, relative to 1/n!; B is the kick.

    Args:
        stages: (kick, free) in units of the step.
        wanted: of a word; true for every beginning of a word for which it is true.
    """
    series = {"": mpf(1)}
    with mp.workdps(30):
        for kick, free in stages:
            series = _times_exp(_times_exp(series, "B", mpf(kick), wanted), "A", mpf(free), wanted)
        return float(max(abs(c * mp.factorial(len(word)) - 1) for word, c in series.items()))


def _times_exp(series: dict[str, mpf], letter: str, factor: mpf, wanted: Callable[[str], bool]) -> dict[str, mpf]:
    out: dict[str, mpf] = {}
    for word, coefficient in series.items():
        longer, term, n = word, coefficient, 0
        while wanted(longer):
            out[longer] = out.get(longer, mpf(0)) + term
            n += 1
            longer, term = longer + letter, term * factor / n
    return out


QUANTITIES = (
    "attitude",
    "angular_velocity_body",
    "position_world",
    "linear_velocity_world",
    "work",
    "impulse_world",
    "torque_impulse_world",
)
TIME = 2
COUNTS = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
# Rounding of up to 100 steps of many stages.
FLOOR = 2e-13


def measured_orders(case: Case, method: Method) -> dict[str, float]:
    """Return the order of each quantity, from the finest 4 to 5 steps above round-off."""
    steps, found = [], []
    for h in (TIME / n for n in COUNTS):
        try:
            found.append(errors(case, TIME, move(case, method, h, TIME)))
            steps.append(h)
        except ConvergenceError:
            continue
    orders = {}
    for name in QUANTITIES:
        above = [(h, e[name]) for h, e in zip(steps, found, strict=True) if e[name] > FLOOR][-5:]
        assert len(above) >= 4, f"{name}: only {len(above)} steps above round-off"
        orders[name] = slope([h for h, _ in above], [e for _, e in above])
        assert math.isfinite(orders[name])
    return orders
