"""Shapes with textbook inertia: solids, hollow bodies and thin shells, each in its principal axes.

Every shape is uniform, with its moments about the centre of mass and its axis of symmetry along z. A cone points
along +z, its base h / 4 below the centre of mass. Moments are kept per mass (squared radii of gyration), in forms
that lose no digits for thin walls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics.rotation import IDENTITY
from rb_dynamics.numerics.vector import ZERO, Vector, scale

# m. Fourth powers of lengths in between are within double precision with all their digits.
SMALLEST, LARGEST = 1e-70, 1e70


@dataclass(frozen=True, slots=True)
class Shape:
    """A uniform shape about its centre of mass.

    Attributes:
        squared_gyration: squared radii of gyration about x, y and z, m^2 (eq. 13): the moments per mass.
        volume: m^3; None for a thin shell, which has none.
    """

    squared_gyration: Vector
    volume: float | None

    def body(
        self,
        mass: float,
        center_of_mass: Sequence[float] = ZERO,
        orientation_xyzw: Sequence[float] = IDENTITY,
    ) -> RigidBody:
        """Return the body of this shape with `mass` (kg) and its centre of mass at `center_of_mass` (m, body axes).

        `orientation_xyzw` turns the axes of the shape into body axes.

        Raises:
            BodyError: the mass is not positive, or the moments are beyond double precision.
        """
        return RigidBody.from_principal(mass, scale(mass, self.squared_gyration), orientation_xyzw, center_of_mass)

    def mass(self, density: float) -> float:
        """Return the mass (kg) at `density` (kg/m^3).

        Raises:
            BodyError: the density is not positive, or this is a thin shell.
        """
        if self.volume is None:
            raise BodyError("a thin shell has no volume, expected a mass (kg) instead of a density; give body.mass")
        if not (math.isfinite(density) and density > 0.0):
            raise BodyError(f"density is {density!r}, expected a finite number greater than 0 (kg/m^3)")
        return density * self.volume


def box(size: Sequence[float]) -> Shape:
    """Return a solid box with edges `size` (m) along x, y and z: k_x^2 = (b^2 + c^2) / 12."""
    a, b, c = _three("size", size)
    return Shape(((b * b + c * c) / 12.0, (c * c + a * a) / 12.0, (a * a + b * b) / 12.0), a * b * c)


def ellipsoid(semi_axes: Sequence[float]) -> Shape:
    """Return a solid ellipsoid with these semi-axes (m) along x, y and z: k_x^2 = (b^2 + c^2) / 5."""
    a, b, c = _three("semi_axes", semi_axes)
    squares = ((b * b + c * c) / 5.0, (c * c + a * a) / 5.0, (a * a + b * b) / 5.0)
    return Shape(squares, 4.0 / 3.0 * math.pi * a * b * c)


def sphere(radius: float) -> Shape:
    """Return a solid sphere: k^2 = 2 r^2 / 5."""
    return ellipsoid((radius, radius, radius))


def cylinder(radius: float, length: float) -> Shape:
    """Return a solid cylinder along z, h long: k_z^2 = r^2 / 2, k_x^2 = r^2 / 4 + h^2 / 12."""
    r, h = _positive(radius=radius, length=length)
    return _of_revolution(r * r / 4.0 + h * h / 12.0, r * r / 2.0, math.pi * r * r * h)


def cone(radius: float, height: float) -> Shape:
    """Return a solid cone that points along +z: k_z^2 = 3 r^2 / 10, k_x^2 = 3 r^2 / 20 + 3 h^2 / 80.

    About its centre of mass, h / 4 above the base.
    """
    r, h = _positive(radius=radius, height=height)
    return _of_revolution(0.15 * r * r + 0.0375 * h * h, 0.3 * r * r, math.pi * r * r * h / 3.0)


def capsule(radius: float, length: float) -> Shape:
    """Return a solid cylinder along z of `length` (m, without the caps), with a half sphere on each end.

    A half sphere has its centre of mass 3 r / 8 from its flat face and 83 r^2 / 320 about it; so the two caps have
    2 r^2 / 5 + h^2 / 4 + 3 h r / 8 across the axis.
    """
    r, h = _positive(radius=radius, length=length)
    tube, caps = h, 4.0 / 3.0 * r  # volumes over pi r^2
    across = tube * (r * r / 4.0 + h * h / 12.0) + caps * (0.4 * r * r + h * h / 4.0 + 0.375 * h * r)
    along = tube * r * r / 2.0 + caps * 0.4 * r * r
    return _of_revolution(across / (tube + caps), along / (tube + caps), math.pi * r * r * (tube + caps))


def hollow_sphere(outer_radius: float, inner_radius: float) -> Shape:
    """Return a ball with a concentric hole: k^2 = 2/5 (R^5 - r^5) / (R^3 - r^3), the factor R - r divided out."""
    R, r = _wall(outer_radius, inner_radius)
    shell = R * R + R * r + r * r
    square = 0.4 * (R**4 + R**3 * r + R * R * r * r + R * r**3 + r**4) / shell
    return Shape((square, square, square), 4.0 / 3.0 * math.pi * (R - r) * shell)


def hollow_cylinder(outer_radius: float, inner_radius: float, length: float) -> Shape:
    """Return a thick tube along z, h long: k_z^2 = (R^2 + r^2) / 2, k_x^2 = (R^2 + r^2) / 4 + h^2 / 12."""
    R, r = _wall(outer_radius, inner_radius)
    (h,) = _positive(length=length)
    squares = R * R + r * r
    return _of_revolution(squares / 4.0 + h * h / 12.0, squares / 2.0, math.pi * (R - r) * (R + r) * h)


def spherical_shell(radius: float) -> Shape:
    """Return a thin spherical shell: k^2 = 2 r^2 / 3."""
    (r,) = _positive(radius=radius)
    square = r * r / 1.5
    return Shape((square, square, square), None)


def cylindrical_shell(radius: float, length: float) -> Shape:
    """Return a thin tube along z, h long and open at both ends: k_z^2 = r^2, k_x^2 = r^2 / 2 + h^2 / 12."""
    r, h = _positive(radius=radius, length=length)
    return _of_revolution(r * r / 2.0 + h * h / 12.0, r * r, None)


def closed_cylindrical_shell(radius: float, length: float) -> Shape:
    """Return a thin can along z, h long: tube and two end discs of the same sheet, so their masses are as h to r.

    A disc has k_z^2 = r^2 / 2 and, at h / 2 from the centre, k_x^2 = r^2 / 4 + h^2 / 4.
    """
    r, h = _positive(radius=radius, length=length)
    tube, ends = h / (h + r), r / (h + r)
    across = tube * (r * r / 2.0 + h * h / 12.0) + ends * (r * r + h * h) / 4.0
    return _of_revolution(across, tube * r * r + ends * r * r / 2.0, None)


@dataclass(frozen=True, slots=True)
class Form:
    """How a shape is written in a scene: its dimensions, and whether they are one vector or numbers each."""

    make: Callable[..., Shape]
    dimensions: tuple[str, ...]
    vector: bool = False


SHAPES: dict[str, Form] = {
    "box": Form(box, ("size",), vector=True),
    "sphere": Form(sphere, ("radius",)),
    "ellipsoid": Form(ellipsoid, ("semi_axes",), vector=True),
    "cylinder": Form(cylinder, ("radius", "length")),
    "rod": Form(cylinder, ("radius", "length")),
    "cone": Form(cone, ("radius", "height")),
    "capsule": Form(capsule, ("radius", "length")),
    "hollow_sphere": Form(hollow_sphere, ("outer_radius", "inner_radius")),
    "hollow_cylinder": Form(hollow_cylinder, ("outer_radius", "inner_radius", "length")),
    "spherical_shell": Form(spherical_shell, ("radius",)),
    "cylindrical_shell": Form(cylindrical_shell, ("radius", "length")),
    "closed_cylindrical_shell": Form(closed_cylindrical_shell, ("radius", "length")),
}


def _of_revolution(across: float, along: float, volume: float | None) -> Shape:
    return Shape((across, across, along), volume)


def _positive(**dimensions: float) -> tuple[float, ...]:
    for name, value in dimensions.items():
        if not (math.isfinite(value) and value > 0.0):
            raise BodyError(
                f"{name} is {value!r}, expected a finite number greater than 0 (m); a body without thickness has a "
                "moment that is zero or none at all, give it a small one"
            )
        if not SMALLEST <= value <= LARGEST:
            raise BodyError(
                f"{name} is {value!r}, expected a length from {SMALLEST:g} to {LARGEST:g} m: beyond that its powers "
                "lose digits; check the unit"
            )
    return tuple(float(value) for value in dimensions.values())


def _three(name: str, values: Sequence[float]) -> tuple[float, ...]:
    if len(values) != 3:
        raise BodyError(f"{name} is {list(values)}, expected three numbers greater than 0 (m)")
    return _positive(**{f"{name}[{i}]": value for i, value in enumerate(values)})


def _wall(outer: float, inner: float) -> tuple[float, float]:
    R, r = _positive(outer_radius=outer, inner_radius=inner)
    if not r < R:
        raise BodyError(
            f"inner_radius is {inner!r} and outer_radius {outer!r}, expected inner_radius less than outer_radius (m); "
            "exchange them"
        )
    return R, r
