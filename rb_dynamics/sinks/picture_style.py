"""Colours and viewpoint that the Rerun recording and the video share."""

from __future__ import annotations

from typing import NamedTuple

from rb_dynamics.numerics.vector import Vector, dot, norm, scale, subtract

Color = tuple[int, int, int]

RED, GREEN, BLUE = (236, 92, 92), (102, 194, 102), (96, 148, 245)
ORANGE, CYAN, MAGENTA, YELLOW, GREY = (255, 170, 51), (64, 208, 220), (224, 96, 200), (240, 220, 80), (170, 175, 185)


class Eye(NamedTuple):
    """A viewpoint and its up direction; it looks at the origin."""

    position: Vector
    up: Vector


EYE = Eye((3.6, -4.0, 2.8), (0.0, 0.0, 1.0))
"""Viewpoint for objects within about 3 of the origin, with all axes about equally foreshortened."""


def eye_above(normal_world: Vector | None) -> Eye:
    """Return the viewpoint from which the plane looks like a floor; None if the plane is not yet known."""
    if normal_world is None:
        return EYE
    up = scale(-1.0, normal_world)
    along = subtract(EYE.position, scale(dot(EYE.position, up), up))
    if norm(along) < 1.0:
        along = subtract((5.0, 0.0, 0.0), scale(5.0 * up[0], up))
    x, y, z = (2.9 * a / norm(along) + 1.4 * u for a, u in zip(along, up, strict=True))
    return Eye((x, y, z), up)
