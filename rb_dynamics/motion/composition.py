"""Composition: a symmetric method of order 2, applied several times forward and backward, becomes order 4 or 6.

It needs no derivatives and keeps the invariants of the method that it composes.
"""

from __future__ import annotations

import math
from functools import wraps

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, Method
from rb_dynamics.motion.midpoint import MIDPOINT
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion, multiply, renormalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, dot, scale

_QUARTIC = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))

SUZUKI4 = (_QUARTIC, _QUARTIC, 1.0 - 4.0 * _QUARTIC, _QUARTIC, _QUARTIC)
"""Order 4 in 5 stages (Suzuki, Phys. Lett. A 146 (1990) 319; HLW II.4, example 4.3)."""

_KAHAN_LI = (
    0.39216144400731413927925056,
    0.33259913678935943859974864,
    -0.70624617255763935980996482,
    0.08221359629355080023149045,
)

KAHAN_LI6 = (*_KAHAN_LI, 1.0 - 2.0 * math.fsum(_KAHAN_LI), *_KAHAN_LI[::-1])
"""Order 6 in 9 stages (Kahan & Li, Math. Comp. 66 (1997) 1089; HLW V.3.2)."""


def compose(name: str, order: int, base: Method, coefficients: tuple[float, ...], source: str) -> Method:
    """Return the method that takes a step of `base` for each coefficient; a symmetric base and coefficients of `order`.

    Args:
        name: of the new method.
        order: the order that the coefficients give, see `SUZUKI4` and `KAHAN_LI6`.
        base: a symmetric method of order 2.
        coefficients: lengths of the stages in units of the step; their sum is 1.
        source: reference for the coefficients.
    """

    # A kernel has the step of `base` itself here, which does not raise.
    @wraps(base.step)
    def stage(
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None,
    ) -> Increment:
        try:
            return base.step(inertia, held, h, velocity, orientation, angular_velocity, load)
        except ConvergenceError as error:
            raise ConvergenceError(f"{name}: a stage of {h:.3g} s failed: {error}") from error

    def step(
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> Increment:
        # Relative to the axes of R0 and to an observer who moves with `velocity`, so that numbers and their rounding
        # errors are small.
        here = HeldWrench(
            held.force_body,
            held.torque_body,
            rotate_inverse(orientation, held.force_world),
            rotate_inverse(orientation, held.torque_world),
        )
        turn, omega = IDENTITY, angular_velocity
        displacement, impulse, torque_impulse, work, elapsed = ZERO, ZERO, ZERO, 0.0, 0.0
        for coefficient in coefficients:
            gain = scale(1.0 / inertia.mass, impulse)
            seen = None if load is None else _seen_from(load, elapsed, displacement, velocity, orientation)
            done = stage(inertia, here, coefficient * h, gain, turn, omega, seen)
            turn, omega = done.orientation, done.angular_velocity
            displacement = add(displacement, done.displacement)
            impulse = add(impulse, done.impulse)
            torque_impulse = add(torque_impulse, done.torque_impulse)
            work += done.work
            elapsed += coefficient * h
        impulse = rotate(orientation, impulse)
        return Increment(
            add_scaled(rotate(orientation, displacement), h, velocity),
            renormalize(multiply(orientation, turn)),
            omega,
            impulse,
            rotate(orientation, torque_impulse),
            work + dot(velocity, impulse),
        )

    step.__doc__ = f"""Advance by {len(coefficients)} steps of `{base.name}` ({source}).

    Order {order}, symmetric; keeps what `{base.name}` keeps and takes the loads that it takes.

    Raises:
        ConvergenceError: a step of `{base.name}` cannot be solved.
    """
    return Method(name, order, base.invariants, step, takes=base.takes, compiles=base.compiles, compiles_loads=False)


def _seen_from(load: Load, start: float, moved: Vector, drift: Vector, axes: Quaternion) -> Load:
    """Return `load` for a stage: in the axes of R0 and for an observer who moves with the velocity before the step.

    Args:
        load: of the whole step.
        start: of the stage, s since the start of the step.
        moved: displacement before the stage as the observer sees it, axes of R0.
        drift: velocity of the observer, world axes.
        axes: R0, principal to world axes at the start of the step.
    """

    def seen(
        t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
    ) -> tuple[Vector, Vector]:
        time = start + t
        force, torque = load(
            time,
            add_scaled(rotate(axes, add(moved, displacement)), time, drift),
            add(drift, rotate(axes, velocity)),
            renormalize(multiply(axes, orientation)),
            angular_velocity,
        )
        return rotate_inverse(axes, force), torque

    return seen


MIDPOINT4 = compose("midpoint4", 4, MIDPOINT, SUZUKI4, "Suzuki, Phys. Lett. A 146 (1990) 319; HLW II.4")
MIDPOINT6 = compose("midpoint6", 6, MIDPOINT, KAHAN_LI6, "Kahan & Li, Math. Comp. 66 (1997) 1089; HLW V.3.2")
