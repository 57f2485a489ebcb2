"""Moments of a force and of momentum about a point and about a line (lecture 24, pages 9 and 10).

All vectors of one call are in the same axes, whichever these are.
"""

from __future__ import annotations

import math

from rb_dynamics.errors import BodyError
from rb_dynamics.numerics.vector import ZERO, Vector, cross, dot, norm, scale, subtract


def moment_of_force(force: Vector, position: Vector, about: Vector = ZERO) -> Vector:
    """Return n = (x - o) x f, N m: the moment about the point `about` of a force (N) that acts at `position` (m).

    Page 9, there with the point at the origin.
    """
    return cross(subtract(position, about), force)


def moment_of_force_about_line(force: Vector, position: Vector, direction: Vector, through: Vector = ZERO) -> float:
    """Return n_l = l . n, N m: the moment of a force (N) at `position` (m) about the line with `direction`.

    Page 9, there with a line `through` the origin; any point of the line gives the same. `direction` may have any
    length.

    Raises:
        BodyError: the direction is not finite or zero.
    """
    return dot(unit(direction), moment_of_force(force, position, through))


def moment_of_momentum(momentum: Vector, position: Vector, about: Vector = ZERO) -> Vector:
    """Return L = (x - o) x p, kg m^2/s: the angular momentum about `about` of a particle at `position` (m).

    Page 10, there with the point at the origin; `momentum` in kg m/s.
    """
    return cross(subtract(position, about), momentum)


def moment_of_momentum_about_line(
    momentum: Vector, position: Vector, direction: Vector, through: Vector = ZERO
) -> float:
    """Return L_l = l . L, kg m^2/s: the moment of momentum about the line with `direction` (page 10).

    Raises:
        BodyError: the direction is not finite or zero.
    """
    return dot(unit(direction), moment_of_momentum(momentum, position, through))


def unit(direction: Vector) -> Vector:
    """Return `direction` with length 1.

    Raises:
        BodyError: it is not finite or zero.
    """
    length = norm(direction)
    if not (math.isfinite(length) and length > 0.0):
        raise BodyError(f"axis is {list(direction)}, expected a direction: three finite numbers, not all zero")
    # The largest component first: the reciprocal of a subnormal length would be infinite.
    largest = max(map(abs, direction))
    scaled = (direction[0] / largest, direction[1] / largest, direction[2] / largest)
    return scale(1.0 / norm(scaled), scaled)
