"""Signs of other units than SI: mass, inertia or centre of mass far from those given, or gravity in other units.

Positions in millimetres, under forces in N, are those of a body a thousand times lighter: nothing contradicts that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

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
_CAUSES_OF_INERTIA = {
    1e-3: "torques in kN m",
    1.0 / math.degrees(1.0): "rates in degrees per second",
    1e2: "torques in N cm",
    1e3: "torques in mN m",
}

# m/s^2, that of the Earth to this fraction: it differs from place to place, and a scene may have it once already.
_GRAVITY, _OF_GRAVITY = 9.81, 0.015


def is_far(fitted: float, given: float) -> bool:
    """Return whether a mass or an inertia is so far from the one given that units are the likelier cause."""
    return not 1.0 / _FAR < fitted / given < _FAR


def doubt_of_mass(fitted: float, given: float, of_inertia: float | None = None) -> str:
    """Return what a fitted mass that is far from the one given tells; "" for one that is not.

    `of_inertia` is the factor of the inertia, where that is known.
    """
    if not is_far(fitted, given):
        return ""
    ratio = fitted / given
    cause = _cause(ratio, _CAUSES) or "lengths or forces in other units"
    if of_inertia is not None and 1.0 / _NEAR < of_inertia / ratio < _NEAR:
        cause = "all wrenches, or the body given, in other units, for so is the inertia"
    return f"{_times(ratio)} than the {given:g} kg given, as of {cause}"


def doubt_of_inertia(ratio: float) -> str:
    """Return what a fitted inertia that is far from the one given tells, by their ratio; "" for one that is not."""
    if not is_far(ratio, 1.0):
        return ""
    return f"{_times(ratio)} than that given, as of {_cause(ratio, _CAUSES_OF_INERTIA) or 'torques in other units'}"


def _times(ratio: float) -> str:
    return f"{ratio:.4g} times more" if ratio > 1.0 else f"{1.0 / ratio:.4g} times less"


def _cause(ratio: float, causes: Mapping[float, str]) -> str:
    """Return the cause of the nearest factor; "" where none is near."""
    factor = min(causes, key=lambda each: abs(math.log(ratio / each)))
    return causes[factor] if 1.0 / _NEAR < ratio / factor < _NEAR else ""


def doubt_of_center(distance: float, radius: float) -> str:
    """Return what a centre of mass far from the body origin tells, by the radius of gyration; "" for a near one."""
    if distance < _FAR_OFF * radius:
        return ""
    return (
        f"the centre of mass found is {distance:.3g} m from the body origin, {distance / radius:.3g} times the radius "
        "of gyration of the body given, as of positions in a smaller unit than m"
    )


def doubt_of_acceleration(found: float) -> str:
    """Return what a constant acceleration in world axes, m/s^2, tells that is gravity in other units; else ""."""
    for unit, size in POSITIONS.items():
        if size < 1.0 and abs(found * size / _GRAVITY - 1.0) < _OF_GRAVITY:
            return (
                f"a constant acceleration of {found:.4g} m/s^2 is found, which is gravity if positions are in {unit}; "
                "convert them to m, and write gravity among the effects of the scene"
            )
    return ""
