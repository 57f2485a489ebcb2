"""What is suspicious about mass properties, why, and what to do about it.

For an inertia that no body can have it names the likely mistake; for a valid body it reports what is unlikely. The
constants below are its criteria. It only reports and must not change a number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from rb_dynamics.body import inertia_mistakes
from rb_dynamics.body.rigid_body import RigidBody, require_body, root_of_ratio
from rb_dynamics.numerics.rotation import Matrix
from rb_dynamics.numerics.vector import Vector, norm

if TYPE_CHECKING:
    from rb_dynamics.body.mesh import Solid

SAME_MOMENT = 1e-9
"""Moments that differ by at most this, relative to the largest, count as equal in the symmetry class."""

FLAT = 1e-6
"""A body is flat where (I1 + I2 - I3) / I3 is below this: thinner than about a thousandth of its width."""

LEVERAGE = 0.7
"""The inertia is suspected to be about the origin where m c^T S^-1 c is from this to 1, S = int x x^T dm.

Up to 1 the inertia less the parallel-axis term of c is that of a body. Had it been taken about the origin, a uniform
body with the origin at its end, in a face or at a corner would have 0.75 or more. If it was not, the origin lies
between 0.84 and 1 standard deviations of the mass from its centre, where few bodies have it.
"""

DENSITIES = (5.0, 23_000.0)
"""Mean densities (kg/m^3) that are believed: from a light foam to osmium."""

THINNEST = 1e-5
"""The least believed mass (kg) for each m^3 of the ball of a body's inertia: booms and sails come to 1e-4."""

LEAST_GYRATION = 0.1
"""The least believed largest radius of gyration, relative to the reach of the geometry; a uniform ball has 0.63."""

FAR, CLOSE = 0.3, 0.1
"""A slip explains an inertia that is farther than FAR from that of the mesh, if undoing it comes within CLOSE."""

ROUND_OFF = 1e-3
"""Being about the origin explains a smaller difference, of 10 ROUND_OFF at least, if undoing it comes within this."""


class Symmetry(str, Enum):
    """Which principal moments are equal: all, the two smaller (a disc), the two larger (a rod), or none.

    A particle has none.
    """

    SPHERE = "sphere"
    OBLATE = "oblate"
    PROLATE = "prolate"
    TRIAXIAL = "triaxial"
    PARTICLE = "particle"


def symmetry(body: RigidBody) -> Symmetry:
    """Return the symmetry class of `body`, with moments equal within `SAME_MOMENT`."""
    if require_body(body).is_particle:
        return Symmetry.PARTICLE
    low, middle, high = sorted(body.principal_moments)
    same = SAME_MOMENT * high
    if high - low <= same:
        return Symmetry.SPHERE
    if min(middle - low, high - middle) > same:
        return Symmetry.TRIAXIAL
    return Symmetry.OBLATE if middle - low <= high - middle else Symmetry.PROLATE


@dataclass(frozen=True, slots=True)
class Finding:
    """Something suspicious: its `name`, what was `seen`, `why` that is suspicious, and the `remedy`."""

    name: str
    seen: str
    why: str
    remedy: str

    def __str__(self) -> str:
        """Return it as one sentence."""
        return f"{self.seen}: {self.why}; {self.remedy}"


def examine(body: RigidBody) -> tuple[Finding, ...]:
    """Return what is suspicious about `body`, from its mass properties alone; a particle never is."""
    if require_body(body).is_particle:
        return ()
    found = (_flat(body), _about_origin(body), _size(body))
    return tuple(finding for finding in found if finding)


def slip_behind(inertia: Matrix) -> str:
    """Return a remark on a matrix that no body has but in another order of its six numbers; "" if there is none.

    In a valid matrix such a slip cannot be seen: 2 |Ixz| <= Iyy and so on for every body, so that a product in the
    place of a moment leaves no room for a moment in the place of a product.
    """
    for order, reorder in inertia_mistakes.ORDERS.items():
        if inertia_mistakes.is_body(reorder(inertia)):
            return f"; with its six numbers in the order {order} it would be valid: they are probably in another order"
    return ""


def examine_density(mass: float, volume: float) -> Finding | None:
    """Return a finding where no material has the mean density of `mass` (kg) in `volume` (m^3)."""
    density = mass / volume if volume > 0.0 else math.inf
    least, most = DENSITIES
    if least <= density <= most:
        return None
    return Finding(
        "density",
        f"the mean density is {density:.3g} kg/m^3 ({mass:.6g} kg in {volume:.6g} m^3)",
        f"{'lighter than a foam' if density < least else 'heavier than osmium'}, so a unit is probably another one",
        "lengths in mm are 1000 times too large (a mesh needs scale: 0.001), densities in g/cm^3 1000 times too small",
    )


def _size(body: RigidBody) -> Finding | None:
    """Return a finding where no material is as dense as the ball with the mass and the largest moment of `body`.

    Of all bodies with that moment the ball is the largest, so a body is at least as dense as its ball.
    """
    gyration = root_of_ratio(max(body.principal_moments), body.mass)
    radius = math.sqrt(2.5) * gyration
    # One division after the other: the volume may be beyond double precision.
    density = body.mass / (4.0 / 3.0 * math.pi) / radius / radius / radius
    if THINNEST <= density <= DENSITIES[1]:
        return None
    return Finding(
        "size",
        f"the largest radius of gyration is {gyration:.3g} m for {body.mass:.6g} kg",
        "a ball of that inertia would be "
        + (f"less dense than any structure ({density:.1g} kg/m^3)" if density < THINNEST else "heavier than osmium"),
        "moments are in kg m^2; one in kg mm^2 is 1e6 times too large, one in g cm^2 1e7 times",
    )


def examine_reach(body: RigidBody, reach: float) -> Finding | None:
    """Return a finding where the inertia does not fit geometry that ends at `reach` (m) from the centre of mass."""
    gyration = root_of_ratio(max(body.principal_moments), body.mass)
    if LEAST_GYRATION * reach <= gyration <= reach:
        return None
    return Finding(
        "size",
        f"the largest radius of gyration is {gyration:.3g} m, and the geometry ends {reach:.3g} m from the centre of "
        "mass",
        "no mass within it has so much inertia"
        if gyration > reach
        else f"that is less than {LEAST_GYRATION:g} of it, where a uniform ball has 0.63",
        "check the units (1 kg mm^2 is 1e-6 kg m^2), and that the inertia is not a placeholder",
    )


def compare(body: RigidBody, solid: Solid) -> tuple[Finding, ...]:
    """Return how `body` differs from its mass spread uniformly in `solid`, in the same axes, and the slip behind it.

    Raises:
        BodyError: that has moments beyond double precision.
    """
    found = (
        examine_density(body.mass, solid.volume),
        _center(body.center_of_mass, solid),
        _inertia(body, solid.body(body.mass).inertia),
    )
    return tuple(finding for finding in found if finding)


def _flat(body: RigidBody) -> Finding | None:
    low, middle, high = sorted(body.principal_moments)
    if (low + middle - high) / high >= FLAT:
        return None
    return Finding(
        "triangle",
        f"the largest principal moment is that of a body without thickness: {low:.9g} + {middle:.9g} = {high:.9g} "
        f"kg m^2 within {FLAT:g}",
        "it is at the limit of what is possible, a plate thinner than a thousandth of its width",
        "this is right for a plate; otherwise check the moments",
    )


def _about_origin(body: RigidBody) -> Finding | None:
    share = inertia_mistakes.leverage(body)
    if not LEVERAGE <= share <= 1.0:
        return None
    return Finding(
        "about-origin",
        f"the centre of mass is {norm(body.center_of_mass):.3g} m from the origin, and without its "
        f"parallel-axis term the inertia is barely possible for a body (m c^T S^-1 c = {share:.2f}, at most 1)",
        "so it looks as if it was taken about the origin; otherwise the radius of gyration is implausibly large: the "
        f"standard deviation of the mass along that line is {math.sqrt(1.0 / share):.2f} times that distance",
        "if it is about the origin, subtract m (|c|^2 1 - c c^T); if not, nothing has to change",
    )


def _center(center_of_mass: Vector, solid: Solid) -> Finding | None:
    offset = math.dist(center_of_mass, solid.center_of_mass)
    if offset <= solid.reach:
        return None
    return Finding(
        "centre-of-mass",
        f"the centre of mass is {offset:.3g} m from that of the mesh, which ends at {solid.reach:.3g} m",
        "no mass within the mesh has its centre there",
        "check the units and axes of center_of_mass, and that the mesh has the origin of the body",
    )


def _inertia(body: RigidBody, uniform: Matrix) -> Finding | None:
    """Return a finding where the inertia is far from that of the mesh, or has products of the opposite sign."""
    apart = inertia_mistakes.difference(body.inertia, uniform)
    seen = f"the inertia differs from that of the mesh, filled uniformly, by {apart:.2g} of its largest entry"
    if apart > FAR:
        for slip in inertia_mistakes.slips(body.inertia, body.mass, body.center_of_mass):
            if inertia_mistakes.is_body(slip.undone) and inertia_mistakes.difference(slip.undone, uniform) <= CLOSE:
                return Finding(slip.name, seen, f"{slip.how} it agrees within {CLOSE:.0%}", slip.remedy)
        return Finding("mesh", seen, "no common mistake explains it", "check axes, units, and how uniform the body is")
    shifted = inertia_mistakes.about_center(body.inertia, body.mass, body.center_of_mass)
    if apart > 10 * ROUND_OFF and inertia_mistakes.difference(shifted, uniform) <= ROUND_OFF:
        how = f"taken as about the body origin and moved to the centre of mass it agrees within {ROUND_OFF:g}"
        remedy = "give the inertia about the centre of mass c: subtract m (|c|^2 1 - c c^T)"
        return Finding("about-origin", seen, how, remedy)
    # Products are small beside moments, so that a wrong sign is not far: it has to halve the difference.
    opposite = inertia_mistakes.difference(inertia_mistakes.negated(body.inertia), uniform)
    if opposite < 0.5 * apart and inertia_mistakes.largest_product(uniform) > 0.01:
        remedy = "products stand as in the matrix, Ixy = -int xy dm: negate them"
        return Finding("negated-products", seen, f"with its products negated, by {opposite:.2g}", remedy)
    return None
