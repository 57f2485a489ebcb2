"""`RigidBody`: mass, centre of mass and inertia, with the principal axes in which the motion is computed.

Numbers that no real body can have are errors; they are not repaired by guessing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from rb_dynamics.body.principal_axes import diagonalize
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.argument_checks import instance, items, number, quaternion, vector
from rb_dynamics.numerics.rotation import IDENTITY, Matrix, Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector

# Relative to the largest entry. Inertia matrices are often typed with few digits; this admits their last digit in
# double precision, not a wrong one.
SYMMETRY_TOLERANCE = 1e-9
TRIANGLE_TOLERANCE = 1e-9
# Likewise, between the inertia and what the principal moments and axes make of it: round-off, and no more.
PARTS_TOLERANCE = 1e-13


def _not_checked() -> Any:
    raise TypeError(
        "RigidBody(mass, inertia) leaves out the principal axes, expected a body whose numbers are checked; make one "
        "with RigidBody.from_matrix(mass, inertia, center_of_mass), RigidBody.from_diagonal(mass, moments, "
        "center_of_mass) or RigidBody.particle(mass)"
    )


@dataclass(frozen=True, slots=True)
class RigidBody:
    """Mass properties of one rigid body; build it with `particle` or one of the `from_*` functions.

    The motion is computed in the principal axes, so that `inertia` says the same as `principal_moments` and
    `principal_orientation_xyzw`: `replace(body, inertia=...)` alone is refused.

    Attributes:
        mass: kg.
        inertia: about the centre of mass, body axes, products as they stand in the matrix (Ixy = -int xy dm), kg m^2.
        center_of_mass: from the body origin, body axes, m.
        principal_moments: kg m^2, one for each principal axis.
        principal_orientation_xyzw: rotation from principal to body axes; identity where the inertia is diagonal.
    """

    mass: float
    inertia: Matrix
    center_of_mass: Vector = field(default_factory=_not_checked)
    principal_moments: Vector = field(default_factory=_not_checked)
    principal_orientation_xyzw: Quaternion = field(default_factory=_not_checked)

    def __post_init__(self) -> None:
        """Keep plain numbers, and refuse those of no body, or of two.

        Raises:
            TypeError: an argument is not of its type.
            BodyError: no body has these numbers, or the inertia is not that of the principal moments and axes.
        """
        moments = vector(self.principal_moments, "principal_moments", "the principal moments (kg m^2)", BodyError)
        axes = quaternion(self.principal_orientation_xyzw, "principal_orientation_xyzw", BodyError)
        rows, same = _symmetric(self.inertia), _in_body_axes(moments, axes)
        if moments != ZERO:
            _check(moments, None)
        most = PARTS_TOLERANCE * max(moments)
        if any(abs(rows[i][j] - same[i][j]) > most for i in range(3) for j in range(3)):
            raise BodyError(
                f"inertia is {rows}, but the principal moments {moments} about their axes make {same}, expected the "
                "same of both, as the motion is computed in principal axes; make another body with "
                "RigidBody.from_matrix(mass, inertia, center_of_mass)"
            )
        self._keep(_mass(self.mass), rows, _center(self.center_of_mass), moments, axes)

    def _keep(self, *checked: object) -> RigidBody:
        for name, value in zip(self.__slots__, checked, strict=True):
            object.__setattr__(self, name, value)
        return self

    @property
    def is_particle(self) -> bool:
        """Whether it has no inertia: a particle has three degrees of freedom and no attitude of its own."""
        return self.principal_moments == ZERO

    @classmethod
    def particle(cls, mass: float) -> RigidBody:
        """Return a body of this mass (kg) without extent: it moves as F = m a says and never turns.

        Lecture 24, pages 6 to 8.

        Raises:
            BodyError: the mass is not a finite number greater than 0.
        """
        return cls(_mass(mass), (ZERO, ZERO, ZERO), ZERO, ZERO, IDENTITY)

    @classmethod
    def from_matrix(
        cls, mass: float, inertia: Sequence[Sequence[float]], center_of_mass: Sequence[float] = ZERO
    ) -> RigidBody:
        """Return the body with this inertia matrix (kg m^2, about the centre of mass, body axes).

        Lecture 24, eqs. 10 and 11: the principal moments are the eigenvalues, the principal axes the eigenvectors.

        Raises:
            BodyError: the matrix is not symmetric, or no body has such moments.
        """
        rows = _symmetric(inertia)
        moments, axes = diagonalize(rows)
        _check(moments, rows)
        return cls(_mass(mass), rows, _center(center_of_mass), moments, axes)

    @classmethod
    def from_diagonal(cls, mass: float, moments: Sequence[float], center_of_mass: Sequence[float] = ZERO) -> RigidBody:
        """Return the body whose body axes are principal axes with these moments (kg m^2).

        Raises:
            BodyError: no body has such moments.
        """
        return cls.from_principal(mass, moments, IDENTITY, center_of_mass)

    @classmethod
    def from_principal(
        cls,
        mass: float,
        moments: Sequence[float],
        orientation_xyzw: Sequence[float],
        center_of_mass: Sequence[float] = ZERO,
    ) -> RigidBody:
        """Return the body with these principal moments (kg m^2); `orientation_xyzw` turns principal into body axes.

        Lecture 24, eq. 11 read backwards: I = A^T diag(moments) A.

        Raises:
            BodyError: no body has such moments, or the quaternion is not of unit length within 1e-3.
        """
        diagonal = vector(moments, "moments", "the principal moments (kg m^2)", BodyError)
        _check(diagonal, None)
        axes = quaternion(orientation_xyzw, "orientation_xyzw", BodyError)
        if axes[:3] == ZERO:
            axes = IDENTITY
        # Campaigns make one for each run: nothing is checked twice.
        found = object.__new__(cls)
        return found._keep(_mass(mass), _in_body_axes(diagonal, axes), _center(center_of_mass), diagonal, axes)


def require_body(body: RigidBody) -> RigidBody:
    """Return `body`.

    Raises:
        TypeError: it is something else.
    """
    return instance(body, RigidBody, "body", "make one with RigidBody.from_diagonal(mass, moments), or take scene.body")


def root_of_ratio(a: float, b: float) -> float:
    """Return sqrt(a / b) for a >= 0 and b > 0, whose ratio may be beyond double precision.

    Raises:
        BodyError: the root is too.
    """
    ratio = a / b
    root = math.sqrt(ratio) if 1e-290 < ratio < math.inf else math.sqrt(a) / math.sqrt(b)
    if not math.isfinite(root):
        raise BodyError(
            f"mass properties {a:.6g} and {b:.6g} have a ratio beyond double precision, expected those of one body in "
            "SI units (kg, kg m^2); check the units"
        )
    return root


def _in_body_axes(moments: Vector, axes: Quaternion) -> Matrix:
    """Return R diag(moments) R^T, symmetric to the bit."""
    r = rotation.matrix(axes)

    def entry(i: int, j: int) -> float:
        return r[i][0] * moments[0] * r[j][0] + r[i][1] * moments[1] * r[j][1] + r[i][2] * moments[2] * r[j][2]

    xy, xz, yz = entry(0, 1), entry(0, 2), entry(1, 2)
    return ((entry(0, 0), xy, xz), (xy, entry(1, 1), yz), (xz, yz, entry(2, 2)))


def _symmetric(inertia: Sequence[Sequence[float]]) -> Matrix:
    given = items(inertia, "inertia", "a matrix (kg m^2)")
    if len(given) != 3:
        raise BodyError(f"inertia has {len(given)} rows, expected a matrix: write 3 rows of 3 numbers (kg m^2)")
    expected = "a row of the inertia matrix (kg m^2)"
    rows = [list(vector(row, f"inertia[{k}]", expected, BodyError)) for k, row in enumerate(given)]
    largest = max(abs(v) for row in rows for v in row)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if abs(rows[i][j] - rows[j][i]) > SYMMETRY_TOLERANCE * largest:
            raise BodyError(
                f"inertia matrix is not symmetric: I[{i}][{j}] = {rows[i][j]!r} but I[{j}][{i}] = {rows[j][i]!r}; "
                "an inertia matrix is symmetric, write each product twice"
            )
        rows[i][j] = rows[j][i] = 0.5 * (rows[i][j] + rows[j][i])
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows
    return ((xx, xy, xz), (yx, yy, yz), (zx, zy, zz))


def _mass(mass: float) -> float:
    return number(mass, "mass", "a finite number greater than 0 (kg)", BodyError, above=0.0)


def _center(center_of_mass: Sequence[float]) -> Vector:
    return vector(center_of_mass, "center_of_mass", "a point (m)", BodyError)


def _check(moments: Vector, rows: Matrix | None) -> None:
    if problem := _moments_problem(moments):
        raise BodyError(problem + (_negated_products_hint(rows) if rows else ""))


def _moments_problem(moments: Vector) -> str:
    """Return what is wrong with principal moments, or "": each is positive and at most the sum of the others.

    I1 + I2 - I3 = 2 int x3^2 dm >= 0 (lecture 24, eqs. 6 and 7 added).
    """
    shown = [float(f"{moment:.6g}") for moment in moments]
    if not all(map(math.isfinite, moments)):
        return (
            "principal moments are beyond double precision, expected three finite numbers greater than 0 (kg m^2); "
            "check the units"
        )
    if not all(m > 0.0 for m in moments):
        return (
            f"principal moments are {shown}, expected three finite numbers greater than 0 (kg m^2); "
            "the inertia matrix of a body is positive definite"
        )
    low, middle, high = sorted(moments)
    if low + middle < high * (1.0 - TRIANGLE_TOLERANCE):
        return (
            f"principal moments are {shown} and {low:.6g} + {middle:.6g} < {high:.6g}: no body has them, because each "
            "moment is at most the sum of the other two; check units, the reference point (centre of mass) and the axes"
        )
    return ""


def _negated_products_hint(rows: Matrix) -> str:
    """Return a remark where the same matrix with its products negated would be a body: the usual sign slip."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = rows
    if xy == xz == yz == 0.0:
        return ""
    negated = ((xx, -xy, -xz), (-xy, yy, -yz), (-xz, -yz, zz))
    if _moments_problem(diagonalize(negated)[0]):
        return ""
    return (
        "; with its products negated the matrix would be valid: products of wrong sign suspected, "
        "expected the matrix entries Ixy = -int xy dm"
    )
