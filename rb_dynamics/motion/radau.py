"""Radau IIA of order 5: implicit and L-stable, for drag so stiff that explicit methods would need tiny steps."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method
from rb_dynamics.motion.step_checks import require_finite, require_small_turn
from rb_dynamics.numerics.rotation import Quaternion, dexpinv, exp, multiply, renormalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, divide, dot, norm, scale
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

_ROOT = math.sqrt(6.0)
_A = (
    ((88.0 - 7.0 * _ROOT) / 360.0, (296.0 - 169.0 * _ROOT) / 1800.0, (-2.0 + 3.0 * _ROOT) / 225.0),
    ((296.0 + 169.0 * _ROOT) / 1800.0, (88.0 + 7.0 * _ROOT) / 360.0, (-2.0 - 3.0 * _ROOT) / 225.0),
    ((16.0 - _ROOT) / 36.0, (16.0 + _ROOT) / 36.0, 1.0 / 9.0),
)
_NODES = ((4.0 - _ROOT) / 10.0, (4.0 + _ROOT) / 10.0, 1.0)

_ITERATIONS = 50
# Newton has converged when the unknowns change by less than their rounding errors.
_CONVERGED = 2.0**-54
# Corrections that no longer shrink count as rounding errors below this.
_ROUNDING = 1e-11
# rad. Where nothing turns the body, Newton's pivots still put rounding errors of a large push into its rotation, and
# each correction of these leaves some of its own; below this they do not count.
_LEAST_TURN = 1e-30
# A slower convergence than this requires a new Jacobian.
_SLOW = 0.1
# dexpinv is singular at a rotation by 2 pi.
_LARGEST_TURN = 6.0
# About the square root of the precision: the best step of a one-sided difference.
_DIFFERENCE = 2.0**-26


def step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance by Radau IIA with three stages (Hairer & Wanner II, table IV.5.6), solved to round-off.

    The equations are those of `rkmk4`: the rotation vector and the torque impulse in the axes of R0, and under a load
    the impulse and the displacement with them; without one these two follow by quadrature. Order 5, under any load too;
    L-stable; conserves the angular momentum and the unit quaternion.

    Raises:
        ConvergenceError: Newton's method finds no stages for this step, or the step diverges.
    """
    mass, moments = inertia
    momentum = times(moments, angular_velocity)
    force_0 = rotate_inverse(orientation, held.force_world)
    torque_0 = rotate_inverse(orientation, held.torque_world)
    # Units in which all unknowns have the size of rotation and displacement, so that no pivot of Newton's matrix mixes
    # unknowns that are not coupled; any will do if h is 0.
    spin_unit, push_unit = min(moments) / (h or 1.0), mass / (h or 1.0)

    def at(node: float, y: list[float]) -> tuple[Quaternion, Vector, Vector]:
        """Return rotation, angular velocity and change of velocity (axes of R0) at a stage."""
        ahead = node * h
        turn = exp((y[0], y[1], y[2]))
        carried = add_scaled(add_scaled(momentum, ahead, torque_0), spin_unit, (y[3], y[4], y[5]))
        gain = scale(1.0 / mass, add_scaled(scale(push_unit, (y[6], y[7], y[8])), ahead, force_0))
        return turn, divide(rotate_inverse(turn, carried), moments), gain

    def slope(node: float, y: list[float]) -> list[float]:
        """Return h y': of theta, torque impulse, impulse, displacement, all in the axes of R0."""
        turn, omega, gain = at(node, y)
        push, torque = rotate(turn, held.force_body), held.torque_body
        if load is not None:
            place = add_scaled(rotate(orientation, (y[9], y[10], y[11])), node * h, velocity)
            v = add(velocity, rotate(orientation, gain))
            force, more = load(node * h, place, v, multiply(orientation, turn), omega)
            push, torque = add(push, rotate_inverse(orientation, force)), add(torque, more)
        theta_dot = dexpinv((-y[0], -y[1], -y[2]), omega)
        return [
            *scale(h, theta_dot),
            *scale(h / spin_unit, rotate(turn, torque)),
            *scale(h / push_unit, push),
            *scale(h, gain),
        ]

    # Quantities that do not depend on the unknowns need no Newton iteration: without a load, the translation is one.
    sought = 6 if load is None else 12
    start = slope(0.0, [0.0] * 12)
    spin, way = norm(momentum) / spin_unit, norm(scale(h, velocity))
    sizes = [norm(scale(h, angular_velocity)), spin, way, way][: sought // 3]
    differences = [1.0, spin + norm((start[3], start[4], start[5])) or 1.0]
    differences += [way + norm((start[6], start[7], start[8])) or 1.0] * 2
    z, rates = _solve(slope, h, sought, sizes, [_DIFFERENCE * d for d in differences for _ in range(3)])

    work = 0.0
    moved = ZERO
    for weight, node, y, rate in zip(_A[2], _NODES, z, rates, strict=True):
        turn, omega, gain = at(node, y)
        require_small_turn("radau", h, norm(omega))
        twist = add_scaled(scale(spin_unit, (rate[3], rate[4], rate[5])), h, torque_0)
        push = add_scaled(scale(push_unit, (rate[6], rate[7], rate[8])), h, force_0)
        work += weight * (dot(twist, rotate(turn, omega)) + dot(push, gain))
        moved = add_scaled(moved, weight * h, gain)
    impulse = add_scaled(rotate(orientation, scale(push_unit, (y[6], y[7], y[8]))), h, held.force_world)
    end = Increment(
        add_scaled(rotate(orientation, moved), h, velocity),
        renormalize(multiply(orientation, turn)),
        omega,
        impulse,
        add_scaled(rotate(orientation, scale(spin_unit, (y[3], y[4], y[5]))), h, held.torque_world),
        work + dot(impulse, velocity),
    )
    return require_finite("radau", h, end)


def _solve(
    slope: Callable[[float, list[float]], list[float]],
    h: float,
    sought: int,
    sizes: list[float],
    differences: list[float],
) -> tuple[list[list[float]], list[list[float]]]:
    """Return the stages z = A slope(z), three of twelve numbers, and their slopes h y'.

    The first `sought` numbers of z are solved for; the impulse follows from them if it is not among them.

    Args:
        slope: h y' at a node and a stage.
        h: s, for the message.
        sought: number of unknowns in a stage.
        sizes: scale of each group of three unknowns, by which corrections are measured.
        differences: for the Jacobian, one for each unknown.

    Raises:
        ConvergenceError: the corrections do not shrink to rounding errors.
    """
    import numpy as np

    a = np.array(_A)

    def jacobian(node: float, y: list[float]) -> list[list[float]]:
        return _jacobian(slope, node, y, differences[:sought])

    def matrix(jacobians: list[list[list[float]]]) -> Array:
        blocks: Array = np.eye(3 * sought)
        blocks -= np.einsum("ij,jkl->ikjl", a, np.array(jacobians)).reshape(blocks.shape)
        return blocks

    z = np.zeros((3, 12))
    size = previous = math.inf
    # The size of the correction reveals an overflow.
    with np.errstate(all="ignore"), contextlib.suppress(np.linalg.LinAlgError):
        newton = matrix([jacobian(0.0, [0.0] * 12)] * 3)
        for _ in range(_ITERATIONS):
            by_slopes = a @ np.array(list(map(slope, _NODES, z.tolist())))
            residual = by_slopes[:, :sought] - z[:, :sought]
            correction = np.linalg.solve(newton, residual.ravel()).reshape(3, sought)
            z[:, :sought] += correction
            z[:, sought:9] = by_slopes[:, sought:9]
            size = _relative(correction, z, sizes)
            if size <= _CONVERGED or (size >= 0.5 * previous and size <= _ROUNDING):
                # Slopes from z and not from the equations, in which stiffness would amplify the rounding errors of z.
                return z.tolist(), np.linalg.solve(a, z).tolist()
            if not (math.isfinite(size) and np.abs(z[:, :3]).max() < _LARGEST_TURN):
                break
            if size > _SLOW * previous:
                newton = matrix(list(map(jacobian, _NODES, z.tolist())))
            previous = size
    raise ConvergenceError(
        f"radau: Newton's method did not converge for a step of {h:g} s (last correction {size:.3g} of the unknowns, "
        f"expected {_ROUNDING:g} or less); use a step below {0.5 * abs(h):.3g} s"
    )


def _jacobian(
    slope: Callable[[float, list[float]], list[float]], node: float, y: list[float], differences: list[float]
) -> list[list[float]]:
    """Return d slope / dy by one-sided differences; rows are slopes."""
    here = slope(node, y)
    columns = []
    for k, least in enumerate(differences):
        # A load that grows within the step may make an unknown so large that the difference would be rounded away.
        difference = max(abs(least), _DIFFERENCE * abs(y[k]))
        there = [*y[:k], y[k] + difference, *y[k + 1 :]]
        columns.append([(b - c) / (there[k] - y[k]) for b, c in zip(slope(node, there), here, strict=True)])
    return [list(row) for row in zip(*columns, strict=True)][: len(differences)]


def _relative(correction: Array, z: Array, sizes: list[float]) -> float:
    """Return the relative size of the correction, by groups of three; NaN if it has none."""
    found = 0.0
    for k, size in enumerate(sizes):
        change = float(abs(correction[:, 3 * k : 3 * k + 3]).max())
        known = size + float(abs(z[:, 3 * k : 3 * k + 3]).max()) + (_LEAST_TURN if k < 2 else 0.0)
        found += change / (known or change) if change else 0.0
    return found


RADAU = Method(
    "radau", order=5, invariants=frozenset({"angular_momentum", "unit_quaternion"}), step=step, takes=LoadDependence.ANY
)
