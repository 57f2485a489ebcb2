"""The point where the inertia ellipsoid touches the invariable plane, for free and forced motion alike.

Everything is in the space of rho = w / sqrt(2 T), where the ellipsoid rho . I rho = 1 does not depend on the energy
(Goldstein, Classical Mechanics, section 5.6). The unit of length is its longest half axis. The plane touches it at rho
and is normal to I w; T and I w do not include rotors inside the body. `poinsot.py` treats free motion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.numerics.rotation import matrix
from rb_dynamics.numerics.rotation_arrays import rotate_all
from rb_dynamics.numerics.vector import Vector

Array = NDArray[np.float64]

LARGEST_CHORD = 0.5
"""Largest rotation (rad) between two points for which a straight line may stand for the curve."""

DISC = 1.15
"""Radius of the disc that represents the plane in pictures."""


class Contact(NamedTuple):
    """Points of contact, one row per time; NaN while the body does not turn.

    Attributes:
        body: point of contact, body axes.
        world: the same in world axes.
        normal: of the plane, away from the centre, world axes.
        distance: of the plane from the centre.
    """

    body: Array
    world: Array
    normal: Array
    distance: Array


def half_axes(body: RigidBody) -> Vector:
    """Return the half axes of the ellipsoid along the principal axes; the longest is 1."""
    least = min(body.principal_moments)
    x, y, z = (float(np.sqrt(least / moment)) for moment in body.principal_moments)
    return x, y, z


def contact(body: RigidBody, orientation_xyzw: Array, angular_velocity_body: Array) -> Contact:
    """Return the contact at attitudes (n, 4) and angular velocities (n, 3), rad/s, in body axes."""
    largest = np.abs(angular_velocity_body).max(axis=1, keepdims=True)
    # Only the direction of the spin matters; scaling it keeps squares within double precision.
    axis = angular_velocity_body / np.where(largest > 0.0, largest, np.nan)
    least = min(body.principal_moments)
    momentum = axis @ (np.array(body.inertia) / least)
    point: Array = axis / np.sqrt(np.sum(axis * momentum, axis=1, keepdims=True))
    normal = rotate_all(orientation_xyzw, momentum / np.linalg.norm(momentum, axis=1, keepdims=True))
    world = rotate_all(orientation_xyzw, point)
    return Contact(point, world, normal, np.sum(world * normal, axis=1))


def separatrices(body: RigidBody, n: int = 129) -> list[Array]:
    """Return the separatrices: curves through the middle axis that divide the two kinds of polhodes, (n, 3), body axes.

    On rho . I rho = 1 and |I rho|^2 = I_2: I_1 (I_2 - I_1) x1^2 = I_3 (I_3 - I_2) x3^2, two planes through the middle
    axis. Empty for a body with two equal moments, which has no middle axis.
    """
    low, middle, high = sorted(range(3), key=lambda k: body.principal_moments[k])
    i1, i2, i3 = (body.principal_moments[k] / body.principal_moments[low] for k in (low, middle, high))
    if not i1 < i2 < i3:
        return []
    angle = np.linspace(0.0, 2.0 * np.pi, n)
    curves = []
    for side in (1.0, -1.0):
        across = np.zeros(3)
        across[low], across[high] = np.sqrt(i3 * (i3 - i2)), side * np.sqrt(i1 * (i2 - i1))
        across /= np.sqrt(i1 * across[low] ** 2 + i3 * across[high] ** 2)
        points = np.outer(np.sin(angle), across)
        points[:, middle] = np.cos(angle) / np.sqrt(i2)
        curves.append(points @ np.array(matrix(body.principal_orientation_xyzw)).T)
    return curves
