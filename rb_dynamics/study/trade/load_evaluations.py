"""How often a method evaluates the load, counted on a real step, so that the number is never out of date."""

from __future__ import annotations

from functools import cache

from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia, Method
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector


def evaluations_in(methods: str, steps: int, *, by_accuracy: bool) -> int | None:
    """Return the number of load evaluations in `steps` accepted steps, error estimates included.

    None if it is not a fixed number: more than one method, an implicit method (it iterates), or a Taylor series (it
    uses derivatives instead). Rejected steps are not counted.
    """
    method = METHODS.get(methods)
    once = None if method is None else _in_a_step(method)
    if method is None or once is None:
        return None
    # Step doubling takes two steps and the one that they are compared with.
    return steps * once * (3 if by_accuracy and method.pair is None else 1)


@cache
def _in_a_step(method: Method) -> int | None:
    """Return the evaluations in one step, including its embedded error estimate if it has one."""
    if method.order is None:
        return 0
    if method.takes == LoadDependence.HELD:
        return None
    few, many = (_counted(method, h) for h in (1e-3, 0.1))
    return few if few == many else None


def _counted(method: Method, h: float) -> int:
    load = _Counting()
    step = method.pair or method.step
    step(Inertia(1.0, (1.0, 2.0, 2.5)), HeldWrench(), h, ZERO, IDENTITY, (0.3, 1.0, 0.2), load)
    return load.evaluations


class _Counting:
    """A load that counts its evaluations."""

    def __init__(self) -> None:
        self.evaluations = 0

    def __call__(
        self, t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
    ) -> tuple[Vector, Vector]:
        self.evaluations += 1
        return ZERO, (0.1 * orientation[0], 0.2, 0.3)
