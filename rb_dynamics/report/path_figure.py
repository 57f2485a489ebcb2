"""The paths of bodies in space: as a picture seen from above and from the side, and as a plot that can be turned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rb_dynamics.analysis.gaps import after_gaps
from rb_dynamics.numerics.rotation import matrix
from rb_dynamics.report.interactive_plots import Curve, Picture, Plot
from rb_dynamics.report.svg import COLORS, MAX_POINTS, TEXT, Array, far_off, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Columns: right and up in the picture, in world axes; z points up.
_SEEN = np.array([[-0.6, -0.4], [0.8, -0.3], [0.0, math.sqrt(0.75)]])

# Where the body axes are drawn, and their length relative to the extent of the path.
_PLACES, _ARM = 9, 0.08


def path_in_space(tracks: Sequence[tuple[str, Array, Array, Array]]) -> Picture | None:
    """Return paths of (label, times (n,) in s, positions (n, 3) in m, attitudes (n, 4) xyzw); None if nothing moves.

    The body axes stand at some places of the first path. No line crosses a gap.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    known = [(name, *_known(time_s, position, attitude)) for name, time_s, position, attitude in tracks]
    moving = [each for each in known if len(each[1])]
    if not moving:
        return None
    every = np.concatenate([position for _, position, _ in moving])
    place, less = far_off(every)
    every, moving = every - place, [(name, position - place, attitude) for name, position, attitude in moving]
    title = f"Path of the body origin{less}, world axes [m]"
    extent = float((np.nanmax(every, axis=0) - np.nanmin(every, axis=0)).max())
    if not extent > 1e-9 * float(np.nanmax(np.abs(every + place))):
        return None
    curves = _triads(*moving[0][1:], _ARM * extent)
    for number, (name, position, _) in enumerate(moving):
        color = COLORS[3 + number]
        curves.append(Curve(name, _columns(position), color, "dash" if number else "line"))
        curves.append(Curve(f"start of {name}", _columns(position[:1]), color, "dots"))
    plot = Plot(title, curves, ["x [m]", "y [m]", "z [m]"])
    corner, length = np.nanmin(every, axis=0), 10.0 ** math.floor(math.log10(0.5 * extent))

    def fill(figure: Figure, _most: int) -> None:
        axes = figure.add_axes((0.05, 0.05, 0.9, 0.8))
        for end, letter in zip(corner + length * np.eye(3), "xyz", strict=True):
            axes.plot(*(np.array([corner, end]) @ _SEEN).T, color="#808080", linewidth=1.2)
            x, y = (1.12 * end - 0.12 * corner) @ _SEEN
            axes.text(x, y, letter, color=TEXT, ha="center", va="center")
            # Text alone makes no room for itself.
            axes.update_datalim([(x, y)])
        for curve in curves:
            x, y = (np.column_stack(list(curve.points)) @ _SEEN).T
            look = {"line": "-", "dash": "--", "dots": "o"}[curve.look]
            axes.plot(x, y, look, color=curve.color, linewidth=1.3, markersize=4.5)
        axes.set_axis_off()
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.05)
        axes.set_title(f"{title}; the grey axes are {length:g} m long", loc="left", color=TEXT, fontsize=11.0)

    return replace(picture(fill, (690.0, 330.0), "Path of the body origin in space"), plots=lambda: [plot])


def _known(time_s: Array, position: Array, attitude: Array) -> tuple[Array, Array]:
    """Return samples of known position, enough of them to look the same, and a row of NaN in each gap."""
    there = np.flatnonzero(np.isfinite(position).all(axis=1))
    if not len(there):
        return position[there], attitude[there]
    time_s = time_s[there]
    after = after_gaps(time_s)
    # The samples at both ends of a gap are kept; of very many gaps only the longest are shown.
    after = after[np.argsort(time_s[after - 1] - time_s[after], kind="stable")[:MAX_POINTS]]
    even = np.linspace(0, len(there) - 1, 2 * MAX_POINTS).astype(int)
    kept = np.unique(np.concatenate([even, after - 1, after]))
    holes = np.searchsorted(kept, np.sort(after))
    rows = there[kept]
    return np.insert(position[rows], holes, np.nan, axis=0), np.insert(attitude[rows], holes, np.nan, axis=0)


def _columns(rows: Array) -> list[Array]:
    return [rows[:, axis] for axis in range(3)]


def _triads(position: Array, attitude: Array, arm: float) -> list[Curve]:
    there = np.flatnonzero(np.isfinite(position).all(axis=1))
    places = there[np.unique(np.linspace(0, len(there) - 1, _PLACES).astype(int))]
    start, turned = position[places], attitude[places]
    if not np.isfinite(turned).all():
        return []
    axes = np.array([matrix((*each,)) for each in turned.tolist()])
    ends = [start + arm * axes[:, :, axis] for axis in range(3)]
    gap = np.full_like(start, np.nan)
    lines = [np.stack([start, end, gap], axis=1).reshape(-1, 3) for end in ends]
    return [
        Curve(f"body {name}", _columns(line), color) for name, line, color in zip("xyz", lines, COLORS, strict=False)
    ]
