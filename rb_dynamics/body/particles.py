"""Systems of particles: mass, centre of mass, momentum, force, angular momentum, torque and inertia.

Lecture 24, pages 14 to 22, whose formulas carry no numbers there. Sums are exact except for the rounding of each term
(`math.fsum`). Second moments are taken about the centre of mass, so that nothing cancels however far away the origin
is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from rb_dynamics.body.moments_of_force_and_momentum import moment_of_force, moment_of_momentum
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics.argument_checks import items, number, vector
from rb_dynamics.numerics.rotation import Matrix
from rb_dynamics.numerics.vector import ZERO, Vector, add, cross, norm, scale, subtract

# Particles this close to one line, relative to their largest coordinate, are on it: positions are rounded to that.
_COLLINEAR = 16.0 * 2.0**-52


def total_mass(masses: Sequence[float]) -> float:
    """Return M = sum m_k, kg (page 16)."""
    return _fsum(masses)


def center_of_mass(masses: Sequence[float], positions: Sequence[Vector]) -> Vector:
    """Return X = (1 / M) sum m_k x_k, m (page 16)."""
    center, rest = _split_center(masses, positions)
    return add(center, rest)


def momentum(masses: Sequence[float], velocities: Sequence[Vector]) -> Vector:
    """Return P = sum p_k with p_k = m_k v_k, kg m/s (page 14); it is M times the velocity of the centre of mass."""
    return _sum(_weighted(masses, velocities))


def external_force(forces: Sequence[Vector]) -> Vector:
    """Return F = sum F_k, N, of the external forces (page 14); F = dP/dt (page 15)."""
    return _sum(forces)


def angular_momentum(
    masses: Sequence[float], positions: Sequence[Vector], velocities: Sequence[Vector], about: Vector = ZERO
) -> Vector:
    """Return L = sum (x_k - o) x m_k v_k, kg m^2/s, about the point `about` (pages 10 and 17).

    Positions (m) and velocities (m/s) are in one set of axes, and so is the result.
    """
    momenta = _weighted(masses, velocities)
    return _sum(moment_of_momentum(p, x, about) for p, x in zip(momenta, positions, strict=True))


def total_torque(positions: Sequence[Vector], forces: Sequence[Vector], about: Vector = ZERO) -> Vector:
    """Return N = sum (x_k - o) x F_k, N m, of the external forces about `about` (page 17); N = dL/dt (page 18)."""
    return _sum(moment_of_force(f, x, about) for f, x in zip(forces, positions, strict=True))


def inertia_matrix(masses: Sequence[float], positions: Sequence[Vector], about: Vector | None = None) -> Matrix:
    """Return I = sum m_k (|x_k|^2 1 - x_k x_k^T), kg m^2 (page 22), about `about`, by default the centre of mass."""
    arms = _arms(masses, positions) if about is None else [subtract(x, about) for x in positions]
    return inertia_from_second_moments(lambda i, j: _fsum(m * r[i] * r[j] for m, r in zip(masses, arms, strict=True)))


def inertia_from_second_moments(second_moment: Callable[[int, int], float]) -> Matrix:
    """Return I = int (|x|^2 1 - x x^T) dm from S_ij = int x_i x_j dm (eqs. 4 to 9), symmetric to the bit."""
    xx, yy, zz = (second_moment(i, i) for i in range(3))
    xy, xz, yz = -second_moment(0, 1), -second_moment(0, 2), -second_moment(1, 2)
    return ((yy + zz, xy, xz), (xy, xx + zz, yz), (xz, yz, xx + yy))


def body_of_particles(masses: Sequence[float], positions: Sequence[Vector]) -> RigidBody:
    """Return the rigid body of particles with these masses (kg) and positions (m, body axes, from the body origin).

    Pages 16 and 19 to 22: a rigid body is a bunch of particles with all distances fixed.

    Raises:
        BodyError: a mass is not positive, a number is not finite or too large, or all particles are on one line.
    """
    masses, positions = items(masses, "masses", "numbers (kg)"), items(positions, "positions", "points (m)")
    expected = "a finite number greater than 0 (kg)"
    masses = [number(mass, f"masses[{k}]", expected, BodyError, above=0.0) for k, mass in enumerate(masses)]
    positions = [vector(x, f"positions[{k}]", "a point (m)", BodyError) for k, x in enumerate(positions)]
    if len(masses) != len(positions):
        raise BodyError(
            f"masses has {len(masses)} entries and positions {len(positions)}, expected one of each for each particle; "
            "give as many"
        )
    if not masses:
        raise BodyError("found no particles, expected at least 3 that are not on one line; add them")
    inertia = inertia_matrix(masses, positions)
    _check_spread(masses, positions)
    return RigidBody.from_matrix(total_mass(masses), inertia, center_of_mass(masses, positions))


def _check_spread(masses: Sequence[float], positions: Sequence[Vector]) -> None:
    """Raise where a moment is zero: particles at one point, or on one line."""
    arms = _arms(masses, positions)
    far = max(arms, key=norm)
    length = norm(far)
    resolution = _COLLINEAR * max(abs(c) for x in positions for c in x)
    if length <= resolution:
        raise BodyError(
            f"found {len(masses)} particle{'s' if len(masses) > 1 else ''} at one point, expected at least 3 that are "
            "not on one line: one point has no inertia, so its rotation is not defined; "
            "place particles apart, or use another form of inertia"
        )
    along = scale(1.0 / length, far)
    if max(norm(cross(arm, along)) for arm in arms) <= resolution:
        raise BodyError(
            f"found {len(masses)} particles on one line along {[round(c, 6) for c in along]}, expected at least 3 that "
            "are not: the moment about that line is zero, so the spin about it is not defined; add particles beside "
            "the line, or give the rod a thickness with shape: {type: rod, radius:, length:}"
        )


def _arms(masses: Sequence[float], positions: Sequence[Vector]) -> list[Vector]:
    """Return x_k - X, each with a rounding relative to itself and not to x_k."""
    center, rest = _split_center(masses, positions)
    return [subtract(subtract(x, center), rest) for x in positions]


def _split_center(masses: Sequence[float], positions: Sequence[Vector]) -> tuple[Vector, Vector]:
    """Return the centre of mass as a sum: a point near it, and the rest to full relative accuracy.

    Any near point will do: the rest is found from positions relative to that very point.
    """
    mass = total_mass(masses)
    near = _divide(_sum(_weighted(masses, positions)), mass)
    rest = _sum(_weighted(masses, [subtract(x, near) for x in positions]))
    return near, _divide(rest, mass)


def _divide(v: Vector, s: float) -> Vector:
    return (v[0] / s, v[1] / s, v[2] / s)


def _weighted(masses: Sequence[float], vectors: Sequence[Vector]) -> list[Vector]:
    return [scale(m, v) for m, v in zip(masses, vectors, strict=True)]


def _sum(vectors: Iterable[Vector]) -> Vector:
    rows = list(vectors)
    return (_fsum(v[0] for v in rows), _fsum(v[1] for v in rows), _fsum(v[2] for v in rows))


def _fsum(values: Iterable[float]) -> float:
    """Return the sum, rounded once."""
    try:
        total = math.fsum(values)
    except (OverflowError, ValueError):
        total = math.inf
    if not math.isfinite(total):
        raise BodyError(
            "found particles whose masses, positions, velocities or forces are not finite or have products beyond "
            "1e308, expected numbers in SI units; check the units"
        )
    return total
