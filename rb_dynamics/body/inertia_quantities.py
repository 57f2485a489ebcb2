"""Quantities derived from an inertia matrix: scalar inertia, radii of gyration, ellipsoid, box, stability of a spin.

Equation numbers are those of lecture 24. `plausibility.py` says what is suspicious about the numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from rb_dynamics.body.moments_of_force_and_momentum import unit
from rb_dynamics.body.plausibility import Finding, examine, symmetry
from rb_dynamics.body.rigid_body import RigidBody, require_body, root_of_ratio
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics.argument_checks import vector
from rb_dynamics.numerics.rotation import Matrix, matrix, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, cross, dot, norm, subtract

# A spin within this angle of the middle axis is warned of; it leaves the axis within a few growth times.
NEAR_AXIS = 0.2

# kg/m^3, to give a particle a size to be drawn with.
_WATER = 1000.0


def scalar_inertia(body: RigidBody, axis: Vector, through: Vector | None = None) -> float:
    """Return I_n = n^T I n about the direction `axis`, body axes, kg m^2 (eq. 12).

    The axis goes through the centre of mass, or through the point `through` (m, from the body origin, body axes): then
    m d^2 is added, with d its distance from the centre of mass.

    Raises:
        BodyError: the axis has no direction, the point is not finite, or the inertia beyond double precision.
    """
    n = unit(vector(axis, "axis", "a direction", BodyError))
    require_body(body)
    inertia = dot(n, (dot(body.inertia[0], n), dot(body.inertia[1], n), dot(body.inertia[2], n)))
    if through is None:
        return inertia
    point = vector(through, "through", "a point of the axis (m)", BodyError)
    distance = norm(cross(subtract(body.center_of_mass, point), n))
    inertia += body.mass * distance * distance
    if not math.isfinite(inertia):
        raise BodyError(
            f"through is {list(point)}, expected a point (m) about which the inertia of {body.mass:.6g} kg is within "
            "double precision; check the unit"
        )
    return inertia


def radius_of_gyration(body: RigidBody, axis: Vector, through: Vector | None = None) -> float:
    """Return k_n = sqrt(I_n / m), m: the distance of a point mass with the same inertia (eq. 13)."""
    require_body(body)
    return root_of_ratio(scalar_inertia(body, axis, through), body.mass)


def inertia_ellipsoid(body: RigidBody) -> Vector:
    """Return the half axes of r^T I r = a along the principal axes, with a = I_max so that the shortest is 1.

    Eqs. 14 to 16: r = sqrt(a / I_n), long where the inertia is small.
    """
    if require_body(body).is_particle:
        return ZERO
    i1, i2, i3 = body.principal_moments
    a = max(i1, i2, i3)
    return (root_of_ratio(a, i1), root_of_ratio(a, i2), root_of_ratio(a, i3))


def equivalent_box(body: RigidBody) -> tuple[Vector, float]:
    """Return (half sizes, half diagonal) in m of the uniform box with the mass and principal moments of `body`.

    Eqs. 6 and 7 give I2 + I3 - I1 = 2 int x1^2 dm, which is 2/3 m h1^2 for a uniform box; so h1^2 = 3 (I2 + I3 - I1) /
    2m, and cyclically. A flat or thin body gets 1 % of its half diagonal there, to be seen; a particle is a cube of
    water.
    """
    if body.is_particle:
        edge = 0.5 * (body.mass / _WATER) ** (1.0 / 3.0)
        return (edge, edge, edge), math.sqrt(3.0) * edge
    # In units of the largest: the sum of two moments may be beyond double precision.
    largest = max(body.principal_moments)
    i1, i2, i3 = (moment / largest for moment in body.principal_moments)
    gyration = root_of_ratio(largest, body.mass)
    squares = [1.5 * (pair - own) for pair, own in ((i2 + i3, i1), (i3 + i1, i2), (i1 + i2, i3))]
    half = [gyration * math.sqrt(max(square, 0.0)) for square in squares]
    size = math.hypot(*half)
    x, y, z = (max(h, 0.01 * size) for h in half)
    return (x, y, z), size


def middle_axis_growth_time(body: RigidBody, angular_velocity_body: Vector) -> float | None:
    """Return the time (s) in which a small deviation from a spin about the middle axis grows e-fold.

    From eqs. 20 to 22 linearised about the middle axis: 1 / (|w| sqrt((I2 - I1)(I3 - I2) / (I1 I3))). None if the
    spin is not within `NEAR_AXIS` rad of the middle axis or the body has no middle axis.
    """
    if body.is_particle:
        return None
    spin = rotate_inverse(body.principal_orientation_xyzw, angular_velocity_body)
    rate = norm(spin)
    low, middle, high = sorted(range(3), key=lambda i: body.principal_moments[i])
    i1, i2, i3 = (body.principal_moments[i] for i in (low, middle, high))
    growth = rate * math.sqrt(max(0.0, (i2 - i1) / i1 * ((i3 - i2) / i3)))
    if growth == 0.0 or math.hypot(spin[low], spin[high]) > NEAR_AXIS * abs(spin[middle]):
        return None
    return 1.0 / growth


def examine_spin(body: RigidBody, angular_velocity_body: Vector) -> Finding | None:
    """Return a finding where the spin (rad/s) is near the middle principal axis."""
    growth = middle_axis_growth_time(body, angular_velocity_body)
    if growth is None:
        return None
    return Finding(
        "middle-axis",
        "the initial spin is close to the middle principal axis, which is unstable",
        f"a deviation grows e-fold in {growth:.3g} s and the body flips over and over",
        "this is physics, not an error of the integration",
    )


@dataclass(frozen=True, slots=True)
class AxisProperties:
    """Properties for a rotation about one axis: its unit vector in body axes, and one of its points if one was given.

    `scalar_inertia` in kg m^2 (eq. 12), `radius_of_gyration` in m (eq. 13).
    """

    axis: Vector
    through: Vector | None
    scalar_inertia: float
    radius_of_gyration: float

    @classmethod
    def of(cls, body: RigidBody, axis: Vector, through: Vector | None = None) -> AxisProperties:
        """Return the properties about `axis`, through the centre of mass or through a point."""
        inertia, radius = scalar_inertia(body, axis, through), radius_of_gyration(body, axis, through)
        return cls(unit(axis), through, inertia, radius)

    def as_text(self) -> str:
        """Return the properties as text."""
        place = "the centre of mass" if self.through is None else f"[{', '.join(f'{c:g}' for c in self.through)}] m"
        return "\n".join(
            (
                f"about the axis {_row(self.axis)}  through {place}",
                f"scalar inertia   {self.scalar_inertia:.9g} kg m^2",
                f"gyration         {self.radius_of_gyration:.9g} m",
            )
        )


@dataclass(frozen=True, slots=True)
class MassProperties:
    """Mass properties of a body, and what follows from them. Columns of `principal_axes` are these axes in body axes.

    `warnings` are the `findings` of the inertia doctor as sentences.
    """

    mass: float
    center_of_mass: Vector
    inertia: Matrix
    principal_moments: Vector
    principal_axes: Matrix
    radii_of_gyration: Vector
    inertia_ellipsoid: Vector
    symmetry: str
    warnings: tuple[str, ...]
    findings: tuple[Finding, ...]

    @classmethod
    def of(cls, body: RigidBody, angular_velocity_body: Vector, noticed: Sequence[Finding] = ()) -> MassProperties:
        """Return the properties of `body`; the angular velocity (rad/s) is checked for stability.

        `noticed` are findings from elsewhere, for example from the reading of a mesh.
        """
        spin = examine_spin(body, angular_velocity_body)
        findings = (*noticed, *examine(body), *((spin,) if spin else ()))
        i1, i2, i3 = (root_of_ratio(moment, body.mass) for moment in body.principal_moments)
        return cls(
            body.mass,
            body.center_of_mass,
            body.inertia,
            body.principal_moments,
            matrix(body.principal_orientation_xyzw),
            (i1, i2, i3),
            inertia_ellipsoid(body),
            symmetry(body).value,
            tuple(map(str, findings)),
            findings,
        )

    def as_dict(self) -> dict[str, object]:
        """Return the fields by name."""
        return asdict(self)

    def as_text(self) -> str:
        """Return the properties as text."""
        if self.symmetry == "particle":
            return f"mass             {self.mass:.9g} kg\nsymmetry         particle ({_SYMMETRY_WORDS['particle']})"
        columns = list(zip(*self.principal_axes, strict=True))
        lines = [
            f"mass             {self.mass:.9g} kg",
            f"centre of mass {_row(self.center_of_mass)}  m, from the body origin",
            "inertia about the centre of mass, body axes, kg m^2",
            *(f"{'':15}{_row(row)}" for row in self.inertia),
            "",
            f"{'principal axis':17}{'moment':>14}{'gyration':>14}{'ellipsoid':>14}   direction in body axes",
            f"{'':17}{'kg m^2':>14}{'m':>14}{'(relative)':>14}",
        ]
        for i, axis in enumerate(columns):
            numbers = (self.principal_moments[i], self.radii_of_gyration[i], self.inertia_ellipsoid[i])
            lines.append(f"{i + 1:<17}{''.join(f'{number:>14.6g}' for number in numbers)}   {_row(axis)}")
        lines.append(f"symmetry         {self.symmetry} ({_SYMMETRY_WORDS[self.symmetry]})")
        return "\n".join([*lines, *(f"\nwarning: {warning}" for warning in self.warnings)])


_SYMMETRY_WORDS = {
    "sphere": "three equal moments: every axis is a principal axis",
    "oblate": "two equal moments and a larger one, like a disc",
    "prolate": "two equal moments and a smaller one, like a rod",
    "triaxial": "three different moments",
    "particle": "no inertia: three degrees of freedom, no attitude",
}


def _row(values: Vector) -> str:
    # 16 characters hold any number of 9 digits, such as -1.58818678e-122.
    return "".join(f" {value + 0.0:>15.9g}" for value in values)
