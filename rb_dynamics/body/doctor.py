"""The inertia doctor: what is suspicious about mass properties, why, and what to do.

What no body can have is an error of `RigidBody`; the doctor names the slip that may have led there, and for a valid body
what is unlikely. It states its criteria as constants, never changes a number, and stays silent where it has no reason.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from rb_dynamics.body.principal import diagonalize
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import BodyError
from rb_dynamics.rotation import Matrix, rotate_inverse
from rb_dynamics.vector import Vector, norm

SAME_MOMENT = 1e-9
"""Moments that differ by less than this, relative to the largest, count as equal in the symmetry class."""

FLAT = 1e-6
"""A body is called flat where (I1 + I2 - I3) / I3 is below this: thinner than a thousandth of its width."""

LEVERAGE = 0.7
"""The inertia is suspected to be about the origin where m c^T S^-1 c lies between this and 1, S = int x x^T dm.

The inertia less the parallel-axis term of c is a body's exactly up to 1; a uniform body about its own end, face or
corner has 0.75 or more. Read about the centre of mass, c would have to lie between 0.84 and 1 standard deviations of the
mass along it.
"""

LARGE_PRODUCT, SMALL_PRODUCT = 0.2, 0.05
"""Row-major slip: a product above the first part of the largest moment, and after reordering all below the second."""

DENSITIES = (5.0, 23_000.0)
"""Mean densities (kg/m^3) that are believed: from a foam to osmium."""

SMALLEST_GYRATION = 0.1
"""The least believed largest radius of gyration, relative to the reach of the geometry; a ball has 0.63."""

CLOSE, FAR = 0.1, 0.3
"""A slip explains an inertia that is farther than FAR from a reference where undoing it brings it within CLOSE."""


class Symmetry(str, Enum):
    """What the principal moments say about the body, with moments equal within `SAME_MOMENT`."""

    SPHERE = "sphere"
    OBLATE = "oblate"
    PROLATE = "prolate"
    TRIAXIAL = "triaxial"


def symmetry(body: RigidBody) -> Symmetry:
    """Return the class of `body`: all moments equal; the two smaller equal (disc); the two larger (rod); none."""
    low, middle, high = sorted(body.principal_moments)
    disc, rod = middle - low <= SAME_MOMENT * high, high - middle <= SAME_MOMENT * high
    if high - low <= SAME_MOMENT * high:
        return Symmetry.SPHERE
    # Both may hold where the tolerance covers two steps: the smaller difference decides.
    if disc and (not rod or middle - low <= high - middle):
        return Symmetry.OBLATE
    return Symmetry.PROLATE if rod else Symmetry.TRIAXIAL


@dataclass(frozen=True, slots=True)
class Finding:
    """Something suspicious: its `name`, what was `seen`, `why` that is suspicious, and the `remedy`."""

    name: str
    seen: str
    why: str
    remedy: str

    def __str__(self) -> str:
        """Return it as one sentence."""
        return f"{self.seen}; {self.why}; {self.remedy}"


def examine(body: RigidBody) -> tuple[Finding, ...]:
    """Return what is suspicious about `body` as it stands."""
    found = (_flat(body), _row_major(body), _about_origin(body))
    return tuple(finding for finding in found if finding)


def slip_behind(inertia: Matrix) -> str:
    """Return a remark on a matrix that no body has, where the order of its six numbers looks mistaken; else ""."""
    for order, reorder in _ORDERS.items():
        if reorder(inertia) != inertia and _is_body(reorder(inertia)):
            return f"read in the order {order}, its six numbers would be valid: a slip of their order is suspected"
    return ""


def examine_density(mass: float, volume: float) -> Finding | None:
    """Return a finding where no material has this mean density: `mass` (kg) over `volume` (m^3)."""
    density = mass / volume if volume > 0.0 else math.inf
    if DENSITIES[0] <= density <= DENSITIES[1]:
        return None
    light = density < DENSITIES[0]
    return Finding(
        "density",
        f"the mean density is {density:.3g} kg/m^3 ({mass:.6g} kg in {volume:.6g} m^3)",
        f"{'lighter than a foam' if light else 'heavier than osmium'}, so the unit of a length or of the mass is "
        "probably another",
        "a file in mm needs scale: 0.001, a density in g/cm^3 a factor of 1000; check mass, density and lengths",
    )


def examine_reach(body: RigidBody, reach: float) -> Finding | None:
    """Return a finding where the radii of gyration do not fit geometry within `reach` (m) of the centre of mass."""
    largest = math.sqrt(max(body.principal_moments) / body.mass)
    if SMALLEST_GYRATION * reach <= largest <= reach:
        return None
    large = largest > reach
    return Finding(
        "size",
        f"the largest radius of gyration is {largest:.3g} m and the geometry reaches {reach:.3g} m from the centre of "
        "mass",
        "no mass within that geometry can have it"
        if large
        else f"that is less than {SMALLEST_GYRATION:g} of the reach, which no ordinary body has",
        "check the units (kg m^2; one kg mm^2 is 1e-6 of that) and that the inertia is not a placeholder",
    )


def compare(body: RigidBody, reference: RigidBody, reach: float) -> tuple[Finding, ...]:
    """Return how `body` differs from a uniform body of the same shape, and the slip that would explain it.

    `reference` is that body, in the same axes; `reach` (m) the distance of its farthest point from its centre of mass.
    Inertia is compared per mass, and differs where the largest entry of the difference exceeds FAR of the largest of
    the reference.
    """
    findings = []
    if finding := _density_of(body, reference):
        findings.append(finding)
    offset = math.dist(body.center_of_mass, reference.center_of_mass)
    if offset > reach:
        findings.append(
            Finding(
                "centre-of-mass",
                f"the centre of mass is {offset:.3g} m from that of the mesh, which reaches {reach:.3g} m",
                "no mass within the mesh has its centre there",
                "check units and axes of center_of_mass, and that mesh and body have the same origin",
            )
        )
    own = _per_mass(body.inertia, body.mass)
    expected = _per_mass(reference.inertia, reference.mass)
    apart = _apart(own, expected)
    if apart > FAR:
        findings.append(_explain(own, expected, body.center_of_mass, apart))
    elif finding := _negated(own, expected, apart):
        findings.append(finding)
    return tuple(findings)


def _density_of(body: RigidBody, reference: RigidBody) -> Finding | None:
    """Return a finding where `body` has a mass that the reference, made with a density of 1, shows to be absurd."""
    return examine_density(body.mass, reference.mass)


def _explain(own: Matrix, expected: Matrix, center: Vector, apart: float) -> Finding:
    seen = f"the inertia differs from that of the mesh, filled uniformly, by {apart:.0%}"
    for name, undone, why, remedy in _slips(own, center):
        if _is_body(undone) and _apart(undone, expected) <= CLOSE:
            return Finding(name, seen, f"{why}, it agrees within {CLOSE:.0%}", remedy)
    for factor, unit in _UNITS:
        if _apart(_scaled(own, 1.0 / factor), expected) <= CLOSE:
            remedy = "convert the inertia to kg m^2"
            return Finding("unit", seen, f"divided by {factor:g} ({unit}), it agrees within {CLOSE:.0%}", remedy)
    remedy = "check axes, units and reference point; a body that is not uniform may differ"
    return Finding("differs", seen, "no usual slip explains it", remedy)


def _negated(own: Matrix, expected: Matrix, apart: float) -> Finding | None:
    """Return a finding where products have the sign opposite to the reference's, though the moments agree."""
    opposite = _apart(_negate(own), expected)
    if opposite < 0.5 * apart and apart > 0.02:
        return Finding(
            "negated-products",
            f"the inertia differs from that of the mesh, filled uniformly, by {apart:.0%}",
            f"with its products negated, it differs by {opposite:.0%}",
            "products stand as in the matrix, Ixy = -int xy dm; negate them",
        )
    return None


_UNITS = (
    (1e6, "given in kg mm^2"),
    (1e4, "given in kg cm^2"),
    (1e3, "given in g m^2"),
    (1e9, "given in g mm^2"),
    (1e7, "given in g cm^2"),
    (1e-6, "lengths taken for mm"),
    (1e-3, "mass taken for g"),
    (0.45359237 ** -1 * 0.3048**-2, "given in lb ft^2"),
    (0.45359237 ** -1 * 0.0254**-2, "given in lb in^2"),
)


def _slips(own: Matrix, center: Vector) -> list[tuple[str, Matrix, str, str]]:
    """Return for each slip: its name, the matrix (per mass) with it undone, why, and the remedy."""
    slips = [
        (
            "negated-products",
            _negate(own),
            "with its products negated",
            "products stand as in the matrix, Ixy = -int xy dm; negate them",
        ),
        (
            "about-origin",
            _shifted(own, center),
            "taken about the body origin and moved to the centre of mass",
            "give the inertia about the centre of mass: subtract m (|c|^2 1 - c c^T)",
        ),
    ]
    for order, reorder in _ORDERS.items():
        slips.append(("row-major", reorder(own), f"with its six numbers in the order {order}", "correct the order"))
    for axes in itertools.permutations(range(3)):
        if axes != (0, 1, 2):
            swapped: Matrix = tuple(tuple(own[i][j] for j in axes) for i in axes)  # type: ignore[assignment]
            names = ", ".join("xyz"[i] for i in axes)
            slips.append(("axes", swapped, f"with its axes taken as {names}", "correct the order of the axes"))
    return slips


def _flat(body: RigidBody) -> Finding | None:
    low, middle, high = sorted(body.principal_moments)
    thickness = (low + middle - high) / high
    if thickness >= FLAT:
        return None
    return Finding(
        "triangle",
        f"the largest principal moment is the sum of the other two within {max(thickness, 0.0):.1g}: "
        f"{low:.9g} + {middle:.9g} and {high:.9g} kg m^2",
        "that is a body without thickness, thinner than a thousandth of its width, at the limit of what is possible",
        "nothing is wrong with a thin plate; otherwise check the moments",
    )


def _row_major(body: RigidBody) -> Finding | None:
    product = _largest_product(body.inertia)
    if product < LARGE_PRODUCT:
        return None
    for order, reorder in _ORDERS.items():
        other = reorder(body.inertia)
        if _is_body(other) and _largest_product(other) < SMALL_PRODUCT:
            return Finding(
                "row-major",
                f"the largest product is {product:.2g} of the largest moment",
                f"with its six numbers in the order {order} the matrix would be nearly diagonal, as most are",
                "check in which order the six numbers came: matrix takes full rows",
            )
    return None


def _about_origin(body: RigidBody) -> Finding | None:
    share = leverage(body)
    if not LEVERAGE <= share <= 1.0:
        return None
    return Finding(
        "about-origin",
        f"the inertia less the parallel-axis term of the centre of mass, {norm(body.center_of_mass):.3g} m from the "
        f"origin, is still that of a body, and hardly more (m c^T S^-1 c = {share:.2f} of at most 1)",
        "an inertia that is about the body origin instead of the centre of mass looks like this, and else the mass "
        f"would have to be spread from the centre of mass to beyond the origin, {math.sqrt(1.0 / share):.2f} times as "
        "far as that (standard deviation)",
        "if it is about the origin, subtract m (|c|^2 1 - c c^T); if not, all is well",
    )


def leverage(body: RigidBody) -> float:
    """Return m c^T S^-1 c, with S = int x x^T dm about the centre of mass: below 1 where I could be about the origin.

    S - m c c^T, the second moments if the inertia given were about the body origin, is positive definite just then.
    """
    along = rotate_inverse(body.principal_orientation_xyzw, body.center_of_mass)
    half = 0.5 * math.fsum(body.principal_moments)
    share = 0.0
    for moment, c in zip(body.principal_moments, along, strict=True):
        # A plate has no spread along its normal: below round-off, an offset along it counts for nothing or for all.
        spread = (half - moment) / body.mass
        if spread > 1e-12 * half / body.mass:
            share += c / spread * c
        elif abs(c) > 1e-6 * norm(body.center_of_mass):
            return math.inf
    return share


def _upper(inertia: Matrix) -> tuple[float, float, float, float, float, float]:
    (a, b, c), (_, d, e), (_, _, f) = inertia
    return a, b, c, d, e, f


def _moments_first(inertia: Matrix) -> Matrix:
    """Return the matrix whose numbers were written Ixx Iyy Izz Ixy Ixz Iyz but read row by row."""
    xx, yy, zz, xy, xz, yz = _upper(inertia)
    return ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))


def _rows(inertia: Matrix) -> Matrix:
    """Return the matrix whose numbers were written row by row but read as Ixx Iyy Izz Ixy Ixz Iyz."""
    (a, d, e), (_, b, f), (_, _, c) = inertia
    return ((a, b, c), (b, d, e), (c, e, f))


def _columns(inertia: Matrix) -> Matrix:
    """Return the matrix whose numbers were written Ixx Ixy Iyy Ixz Iyz Izz but read row by row."""
    xx, xy, yy, xz, yz, zz = _upper(inertia)
    return ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))


_ORDERS: dict[str, Callable[[Matrix], Matrix]] = {
    "Ixx Iyy Izz Ixy Ixz Iyz": _moments_first,
    "Ixx Ixy Ixz Iyy Iyz Izz": _rows,
    "Ixx Ixy Iyy Ixz Iyz Izz": _columns,
}


def _is_body(inertia: Matrix) -> bool:
    try:
        RigidBody.from_matrix(1.0, inertia)
    except BodyError:
        return False
    return True


def _largest_product(inertia: Matrix) -> float:
    """Return the largest product relative to the largest moment."""
    a, b, c, d, e, f = _upper(inertia)
    return max(abs(b), abs(c), abs(e)) / max(a, d, f)


def _negate(inertia: Matrix) -> Matrix:
    a, b, c, d, e, f = _upper(inertia)
    return ((a, -b, -c), (-b, d, -e), (-c, -e, f))


def _per_mass(inertia: Matrix, mass: float) -> Matrix:
    return _scaled(inertia, 1.0 / mass)


def _scaled(inertia: Matrix, factor: float) -> Matrix:
    return tuple((row[0] * factor, row[1] * factor, row[2] * factor) for row in inertia)  # type: ignore[return-value]


def _shifted(own: Matrix, c: Vector) -> Matrix:
    """Return `own` (per mass) less the parallel-axis term |c|^2 1 - c c^T."""
    square = math.fsum(v * v for v in c)
    rows = [[own[i][j] + c[i] * c[j] - (square if i == j else 0.0) for j in range(3)] for i in range(3)]
    return tuple((row[0], row[1], row[2]) for row in rows)  # type: ignore[return-value]


def _apart(a: Matrix, b: Matrix) -> float:
    """Return the largest difference of entries, relative to the largest of `b`."""
    largest = max(abs(v) for row in b for v in row)
    return max(abs(x - y) for p, q in zip(a, b, strict=True) for x, y in zip(p, q, strict=True)) / largest
