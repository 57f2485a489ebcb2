"""Common mistakes in writing an inertia matrix: the matrix with each of them undone, and how likely each is.

Pure functions of matrices; `plausibility.py` decides what to tell the user.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from rb_dynamics.body.rigid_body import RigidBody, root_of_ratio
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics.rotation import Matrix, rotate_inverse
from rb_dynamics.numerics.vector import Vector, norm, scale

_POUND, _FOOT, _INCH = 0.45359237, 0.3048, 0.0254

UNITS = (
    (1e3, "given in g m^2"),
    (1e4, "given in kg cm^2"),
    (1e6, "given in kg mm^2"),
    (1e7, "given in g cm^2"),
    (1e9, "given in g mm^2"),
    (1e-3, "the mass taken for one in g"),
    (1e-6, "lengths taken for mm"),
    (1.0 / (_POUND * _FOOT**2), "given in lb ft^2"),
    (1.0 / (_POUND * _INCH**2), "given in lb in^2"),
)


@dataclass(frozen=True, slots=True)
class Slip:
    """A slip: its `name`, the matrix with it `undone`, `how` that was done, and the `remedy`."""

    name: str
    undone: Matrix
    how: str
    remedy: str


def slips(inertia: Matrix, mass: float, center_of_mass: Vector) -> Iterator[Slip]:
    """Yield every usual slip that `inertia` (kg m^2) could hold, the commonest first; units come last."""
    signs = "products stand as in the matrix, Ixy = -int xy dm: negate them"
    yield Slip("negated-products", negated(inertia), "with its products negated", signs)
    point = "give the inertia about the centre of mass c: subtract m (|c|^2 1 - c c^T)"
    shifted = about_center(inertia, mass, center_of_mass)
    yield Slip("about-origin", shifted, "taken as about the body origin and moved to the centre of mass", point)
    for order, reorder in ORDERS.items():
        yield Slip("row-major", reorder(inertia), f"with its six numbers in the order {order}", "correct their order")
    for axes in itertools.permutations(range(3)):
        named = ", ".join("xyz"[i] for i in axes)
        yield Slip("axes", _permuted(inertia, axes), f"with its axes in the order {named}", "correct the axes")
    for factor, unit in UNITS:
        yield Slip("unit", scaled(inertia, 1.0 / factor), f"divided by {factor:g} ({unit})", "convert it to kg m^2")


def is_body(inertia: Matrix) -> bool:
    """Return whether a body can have this inertia."""
    try:
        RigidBody.from_matrix(1.0, inertia)
    except BodyError:
        return False
    return True


def largest_product(inertia: Matrix) -> float:
    """Return the largest product relative to the largest moment."""
    xx, xy, xz, yy, yz, zz = _upper(inertia)
    return max(abs(xy), abs(xz), abs(yz)) / max(xx, yy, zz)


def difference(a: Matrix, b: Matrix) -> float:
    """Return the largest difference of entries, relative to the largest of `b`."""
    largest = max(abs(v) for row in b for v in row)
    return max(abs(x - y) for p, q in zip(a, b, strict=True) for x, y in zip(p, q, strict=True)) / largest


def leverage(body: RigidBody) -> float:
    """Return m c^T S^-1 c, with S = int x x^T dm about the centre of mass: below 1 where I could be about the origin.

    S - m c c^T, the second moments if the given inertia were about the body origin, is positive definite just then.
    """
    along = rotate_inverse(body.principal_orientation_xyzw, body.center_of_mass)
    # In units of the largest: the sum of three moments may be beyond double precision.
    largest = max(body.principal_moments)
    moments = [moment / largest for moment in body.principal_moments]
    gyration = root_of_ratio(largest, body.mass)
    half = 0.5 * math.fsum(moments)
    share = 0.0
    for moment, c in zip(moments, along, strict=True):
        spread = half - moment
        # A plate has no spread along its normal: an offset along it counts for nothing where it is round-off.
        if spread > 1e-12 * half:
            arm = c / gyration
            share += arm * arm / spread
        elif abs(c) > 1e-6 * norm(body.center_of_mass):
            return math.inf
    return share


def negated(inertia: Matrix) -> Matrix:
    """Return the matrix with its products negated."""
    xx, xy, xz, yy, yz, zz = _upper(inertia)
    return _matrix(xx, -xy, -xz, yy, -yz, zz)


def about_center(inertia: Matrix, mass: float, center_of_mass: Vector) -> Matrix:
    """Return an inertia about the body origin moved to the centre of mass c: less m (|c|^2 1 - c c^T)."""
    xx, xy, xz, yy, yz, zz = _upper(inertia)
    x, y, z = center_of_mass
    return _matrix(
        xx - mass * (y * y + z * z),
        xy + mass * x * y,
        xz + mass * x * z,
        yy - mass * (x * x + z * z),
        yz + mass * y * z,
        zz - mass * (x * x + y * y),
    )


def scaled(inertia: Matrix, factor: float) -> Matrix:
    """Return the matrix times `factor`."""
    first, second, third = inertia
    return (scale(factor, first), scale(factor, second), scale(factor, third))


def _upper(inertia: Matrix) -> tuple[float, float, float, float, float, float]:
    """Return the six numbers row by row."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    return xx, xy, xz, yy, yz, zz


def _matrix(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> Matrix:
    return ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))


def _permuted(inertia: Matrix, axes: tuple[int, ...]) -> Matrix:
    i, j, k = axes
    m = inertia
    return _matrix(m[i][i], m[i][j], m[i][k], m[j][j], m[j][k], m[k][k])


def _moments_first(inertia: Matrix) -> Matrix:
    """Undo: written Ixx Iyy Izz Ixy Ixz Iyz, read row by row."""
    xx, yy, zz, xy, xz, yz = _upper(inertia)
    return _matrix(xx, xy, xz, yy, yz, zz)


def _by_rows(inertia: Matrix) -> Matrix:
    """Undo: written row by row, read as Ixx Iyy Izz Ixy Ixz Iyz, whose numbers are first, fourth, sixth, ..."""
    first, fourth, fifth, second, sixth, third = _upper(inertia)
    return _matrix(first, second, third, fourth, fifth, sixth)


def _by_columns(inertia: Matrix) -> Matrix:
    """Undo: written Ixx Ixy Iyy Ixz Iyz Izz, read row by row."""
    xx, xy, yy, xz, yz, zz = _upper(inertia)
    return _matrix(xx, xy, xz, yy, yz, zz)


ORDERS: dict[str, Callable[[Matrix], Matrix]] = {
    "Ixx Iyy Izz Ixy Ixz Iyz": _moments_first,
    "Ixx Ixy Ixz Iyy Iyz Izz": _by_rows,
    "Ixx Ixy Iyy Ixz Iyz Izz": _by_columns,
}
