"""Checks that refuse a step: numbers that are not finite, and rotations too large for the stages to resolve.

`step_control.py` chooses the step size.
"""

from __future__ import annotations

import math
from itertools import chain

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion.method import Increment
from rb_dynamics.numerics.compilation import compiled_as
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector

NOWHERE: Vector = (math.nan, math.nan, math.nan)
NO_ATTITUDE: Quaternion = (math.nan, math.nan, math.nan, math.nan)
NO_INCREMENT = Increment(NOWHERE, NO_ATTITUDE, NOWHERE, NOWHERE, NOWHERE, math.nan)
"""Result of a refused step in a kernel: NaN, which propagates to all later steps."""

LARGEST_TURN = 3.0
"""Largest rotation (rad) in a step. exp and dexpinv are regular below 2 pi; half of that is left for the stages."""

LARGEST_FREE_TURN = 1e15
"""Rotation (rad) beyond which double precision leaves no digit of the attitude."""


def out_of_range(when: str) -> ConvergenceError:
    """Return the error of a run whose state is not finite."""
    return ConvergenceError(
        f"the state is no longer finite {when}: a momentum, a position or an energy has left the range of double "
        "precision; check the size of velocities, wrench, mass and inertia, or use a smaller step"
    )


@compiled_as()
def require_known_attitude(name: str, h: float, rate: float) -> None:
    """Check that a closed-form motion of h s at `rate` (rad/s) leaves digits of the attitude; not in a kernel.

    Raises:
        ConvergenceError: it rotates further than `LARGEST_FREE_TURN`.
    """
    if not rate * abs(h) < LARGEST_FREE_TURN:
        raise ConvergenceError(
            f"{name}: {h:g} s at {rate:.3g} rad/s are {rate * abs(h):.3g} rad, expected less than "
            f"{LARGEST_FREE_TURN:g} rad: beyond that no digit of the attitude is known; use a shorter duration"
        )


@compiled_as()
def require_finite(name: str, h: float, step: Increment) -> Increment:
    """Return `step`, taken by the method `name` with h s. Not checked in a kernel, where NaN propagates by itself.

    Raises:
        ConvergenceError: a number in it is not finite.
    """
    (a, b, c), (d, e, f, g), (i, j, k), (m, n, o), (p, q, r), work = step
    # If one number is not finite, neither is the sum; one check is cheaper than 17.
    total = a + b + c + d + e + f + g + i + j + k + m + n + o + p + q + r + work
    if not math.isfinite(total) and not all(map(math.isfinite, (*chain.from_iterable(step[:5]), work))):
        raise _without_numbers(name, h)
    return step


def require_small_turn(name: str, h: float, rate: float) -> None:
    """Check that a stage of h s at `rate` (rad/s) rotates the body by less than `LARGEST_TURN`.

    Raises:
        ConvergenceError: it rotates further.
    """
    if not rate * abs(h) < LARGEST_TURN:
        turns_too_far(name, h, rate)


@compiled_as(NO_INCREMENT)
def turns_too_far(name: str, h: float, rate: float) -> Increment:
    """Refuse a stage of h s at `rate` (rad/s), which rotates the body too far.

    Raises:
        ConvergenceError: always.
    """
    turn = rate * abs(h)
    if not math.isfinite(turn):
        raise _without_numbers(name, h)
    raise ConvergenceError(
        f"{name}: a step of {h:g} s turns the body by {turn:.3g} rad, expected less than {LARGEST_TURN:g} rad; "
        f"use a step below {LARGEST_TURN / rate:.3g} s"
    )


def is_rotation(square: float) -> bool:
    """Return whether the sum of the squares of a quaternion after a step is near 1."""
    return 0.5 < square < 2.0


@compiled_as(NO_INCREMENT)
def no_rotation(name: str, h: float, square: float, rate: float) -> Increment:
    """Refuse a quaternion of norm `square`^(1/2), reached in h s from `rate` (rad/s).

    Raises:
        ConvergenceError: always.
    """
    raise ConvergenceError(
        f"{name}: after a step of {h:g} s the quaternion has norm {square**0.5:.3g}, expected about 1; "
        f"the body turns too far in one step, from {rate:.3g} rad/s on: use a shorter step, or check the size of the "
        "wrench, of the effects and of the friction of wheels"
    )


def _without_numbers(name: str, h: float) -> ConvergenceError:
    return ConvergenceError(
        f"{name}: a step of {h:g} s leads to numbers that are no longer finite, expected a motion that it resolves; "
        f"use a step below {0.5 * abs(h):.3g} s or check the size of the wrench and of the effects"
    )
