"""Poinsot's construction of a recorded motion as inline SVG: polhode on the ellipsoid, herpolhode in the plane.

Drawn from the samples. In driven motion, in which the plane moves, the herpolhode is viewed along the first L.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.numerics.rotation import matrix
from rb_dynamics.report.interactive_plots import Picture
from rb_dynamics.report.svg import COLORS, MAX_POINTS, TEXT, Array, picture
from rb_dynamics.theory.poinsot_contact import LARGEST_CHORD, contact, half_axes, separatrices

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Viewing direction of the ellipsoid, principal axes: no axis points at the viewer.
_FROM = np.array([0.62, 0.36, 0.70])

# Extent of a herpolhode, in half axes, that is a point but for rounding.
_POINT = 1e-9


def poinsot_view(
    body: RigidBody, time_s: Array, orientation_xyzw: Array, angular_velocity_body: Array
) -> Picture | None:
    """Return both curves of samples at `time_s` (n,): attitudes (n, 4), angular velocities (n, 3), rad/s, body axes.

    None for a particle, and for a body that does not rotate.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    turns = angular_velocity_body.any(axis=1)
    if body.is_particle or not turns.any():
        return None
    time_s, attitude, rates = time_s[turns], orientation_xyzw[turns], angular_velocity_body[turns]
    kept = np.unique(np.linspace(0, len(time_s) - 1, 10 * MAX_POINTS).astype(int))
    touch = contact(body, attitude[kept], rates[kept])
    turn = np.linalg.norm(rates[kept], axis=1).max() * np.diff(time_s[kept]).max(initial=0.0)
    look = "-" if turn < LARGEST_CHORD else "."
    principal = np.array(matrix(body.principal_orientation_xyzw))
    seen = _screen(_FROM / np.linalg.norm(_FROM))
    ellipsoid = [curve @ principal @ seen for curve in separatrices(body)]
    return _draw(
        [outline(np.array(half_axes(body)), seen), *ellipsoid],
        touch.body @ principal @ seen,
        touch.world @ _screen(touch.normal[0]),
        look,
    )


def _screen(direction: Array) -> Array:
    """Return (3, 2): the axes of a picture viewed from `direction`, a unit vector."""
    up = np.eye(3)[int(np.abs(direction).argmin())]
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    axes: Array = np.column_stack([right, np.cross(direction, right)])
    return axes


def outline(half: Array, seen: Array) -> Array:
    """Return the outline of the ellipsoid: the image of the unit circle under the root of S^T diag(half^2) S."""
    values, vectors = np.linalg.eigh(seen.T @ np.diag(half**2) @ seen)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    outline: Array = circle * np.sqrt(values) @ vectors.T
    return outline


def scale_bar(axes: Axes, unit: str) -> None:
    """Draw a bar of a round length below what `axes` show, with the length in `unit`; none for a single point."""
    (left, low), (width, height) = axes.dataLim.min, axes.dataLim.size
    if not max(width, height) > _POINT:
        return
    about = 0.4 * max(width, height)
    power = 10.0 ** math.floor(math.log10(about))
    length = power * max(step for step in (1.0, 2.0, 5.0) if step * power <= about)
    low -= 0.08 * max(width, height)
    axes.plot([left, left + length], [low, low], "|-", color=TEXT, linewidth=1.0, markersize=6.0)
    axes.annotate(
        f"{length:g} {unit}".rstrip(),
        (left + length, low),
        (6.0, 0.0),
        textcoords="offset points",
        color=TEXT,
        va="center",
    )


def _draw(ellipsoid: list[Array], polhode: Array, herpolhode: Array, look: str) -> Picture:
    def fill(figure: Figure, _most: int) -> None:
        left, right = figure.add_axes((0.0, 0.0, 0.5, 0.9)), figure.add_axes((0.5, 0.0, 0.5, 0.9))
        for curve in ellipsoid:
            left.plot(*curve.T, color="#808080", linewidth=0.8)
        left.plot(*polhode.T, look, color=COLORS[1], linewidth=1.2, markersize=1.5)
        left.plot(*polhode[0], "o", color=COLORS[1], markersize=4.0)
        right.plot(*herpolhode.T, look, color=COLORS[2], linewidth=1.2, markersize=1.5)
        right.plot(*herpolhode[0], "o", color=COLORS[2], markersize=4.0)
        right.plot(0.0, 0.0, "+", color="#808080", markersize=8.0)
        for axes, title in ((left, "Polhode on the ellipsoid of inertia"), (right, "Herpolhode, seen along L (+)")):
            axes.set_axis_off()
            axes.set_aspect("equal")
            axes.margins(0.05)
            axes.set_title(title, color=TEXT, fontsize=11.0)
            scale_bar(axes, "of the longest half axis")

    name = "Poinsot's construction: polhode and herpolhode"
    return picture(fill, (690.0, 300.0), name, columns=2)
