"""Signs of other units than SI that only the body given can show: a mass or a centre of mass far from its own.

Positions in millimetres, under forces in N, are those of a body a thousand times lighter: nothing contradicts that.
"""

from __future__ import annotations

POSITIONS = {"millimetres": 1e-3, "centimetres": 1e-2, "kilometres": 1e3}
"""m in other units of positions."""

# A body is known to better than this factor; a centre of mass lies nearer than so many radii of gyration.
_FAR, _FAR_OFF = 50.0, 30.0
# Within this factor of a power of ten, the mass given is only a rough one.
_NEAR = 3.0
_CAUSES = {
    1e-3: "lengths in millimetres or forces in kN",
    1e-2: "lengths in centimetres",
    1e3: "lengths in kilometres or forces in mN",
}


def is_far(fitted: float, given: float) -> bool:
    """Return whether a mass is so far from the one given that units are the likelier cause."""
    return not 1.0 / _FAR < fitted / given < _FAR


def doubt_of_mass(fitted: float, given: float, of_inertia: float | None = None) -> str:
    """Return what a fitted mass that is far from the one given tells; "" for one that is not.

    `of_inertia` is the factor of the inertia, where that is known.
    """
    if not is_far(fitted, given):
        return ""
    ratio = fitted / given
    told = f"{ratio:.4g} times more" if ratio > 1.0 else f"{1.0 / ratio:.4g} times less"
    cause = next((cause for power, cause in _CAUSES.items() if 1.0 / _NEAR < ratio / power < _NEAR), "")
    cause = cause or "lengths or forces in other units"
    if of_inertia is not None and 1.0 / _NEAR < of_inertia / ratio < _NEAR:
        cause = "all wrenches, or the body given, in other units, for so is the inertia"
    return f"{told} than the {given:g} kg given, as of {cause}"


def doubt_of_center(distance: float, radius: float) -> str:
    """Return what a centre of mass far from the body origin tells, by the radius of gyration; "" for a near one."""
    if distance < _FAR_OFF * radius:
        return ""
    return (
        f"the centre of mass found is {distance:.3g} m from the body origin, {distance / radius:.3g} times the radius "
        "of gyration of the body given, as of positions in a smaller unit than m"
    )
