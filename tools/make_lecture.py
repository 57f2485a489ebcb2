"""Write docs/lecture.md and its figures: the equations of both texts, the functions that compute them, residuals.

The page is tools/lecture.template.md with its code blocks run and the results inserted: <<expression :: bound>> is a
residual, <<expression :: .3f>> a number. Residuals are rounded up to a power of ten with a margin, so that every
machine makes the same page.

    python tools/make_lecture.py           # write the page and the figures
    python tools/make_lecture.py --check   # exit code 1 if the page on disk is out of date
"""

from __future__ import annotations

import importlib
import inspect
import io
import math
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

import rb_dynamics as rb
from rb_dynamics.body import shapes
from rb_dynamics.numerics.rotation import matrix
from rb_dynamics.report.poinsot_figure import scale_bar
from rb_dynamics.report.svg import COLORS
from rb_dynamics.theory.poinsot import energy_ellipsoid, herpolhode, invariable_plane, polhode

ROOT = Path(__file__).resolve().parent.parent
TEMPLATE = ROOT / "tools" / "lecture.template.md"
PAGE = ROOT / "docs" / "lecture.md"
IMAGES = ROOT / "docs" / "images"

LARGEST = 1e-12

# What a template is made of, in the order in which it takes effect: code to run, places to fill, functions to link.
_PARTS = re.compile(
    r"```python\n(?P<code>.+?)```|<<(?P<value>.+?) :: (?P<form>\S+?)>>|`(?P<name>rb_dynamics[\w.]+)`", re.DOTALL
)
_BOUND = re.compile(r"< 1e(-\d+)")
_NUMBER = re.compile(r"(?<![\w.])-?\d+\.\d+")


@dataclass
class Page:
    """A page with the results of its code, and the residuals by expression."""

    text: str = ""
    residuals: dict[str, float] = field(default_factory=dict)


def make_page() -> Page:
    """Run the code of the template and return the page."""
    page, names = Page(), {"__name__": "lecture"}

    def put(part: re.Match[str]) -> str:
        code, value, form, name = part.groups()
        if code:
            exec(compile(code, str(TEMPLATE), "exec"), names)
            return part[0]
        if name:
            return f"[`{name}`](../{source(name)})"
        found = eval(value, names)
        if form == "bound":
            page.residuals[value] = float(found)
            return f"< {bound(float(found)):.0e}"
        return ", ".join(format(each, form) for each in (found if isinstance(found, np.ndarray) else [found]))

    page.text = _PARTS.sub(put, TEMPLATE.read_text(encoding="utf-8"))
    return page


def find(name: str) -> Any:
    """Return the object with this name, for example rb_dynamics.body.moments_of_force_and_momentum.unit."""
    module, _, last = name.rpartition(".")
    return getattr(importlib.import_module(module), last)


def source(name: str) -> str:
    """Return the file, from the root of the tree, in which an object is defined."""
    return Path(inspect.getsourcefile(find(name)) or "").resolve().relative_to(ROOT).as_posix()


def bound(residual: float) -> float:
    """Return a power of ten that is at least ten times as large; 1e-14 for all that is round-off.

    Raises:
        ValueError: it is larger than any residual on the page may be.
    """
    if not residual <= LARGEST:
        raise ValueError(f"a residual on the page is {residual}, expected at most {LARGEST:g}: its claim is wrong")
    return 10.0 ** math.ceil(math.log10(max(residual, 1e-15)) + 1.0 - 1e-9)


def difference(found: str, made: str) -> str:
    """Return the first line in which two pages differ by more than last digits and a decade of residual, or ""."""
    old, new = found.splitlines(), made.splitlines()
    for a, b in zip(old, new, strict=False):
        if not _same(a, b):
            return f"found    {a}\nexpected {b}"
    return "" if len(old) == len(new) else f"found {len(old)} lines, expected {len(new)}"


def _same(a: str, b: str) -> bool:
    plain_a, plain_b = (_NUMBER.sub("#", _BOUND.sub("~", text)) for text in (a, b))
    if plain_a != plain_b:
        return False
    bounds = zip(_BOUND.findall(a), _BOUND.findall(b), strict=True)
    numbers = zip(_NUMBER.findall(a), _NUMBER.findall(b), strict=True)
    return all(int(q) <= int(p) + 1 for p, q in bounds) and all(_close(p, q) for p, q in numbers)


def _close(a: str, b: str) -> bool:
    places = [len(text.partition(".")[2]) for text in (a, b)]
    return places[0] == places[1] and abs(float(a) - float(b)) < 1.5 * 10.0 ** -places[0]


# --- Figures ----------------------------------------------------------------------------------------------------------

RED, GREEN, BLUE = COLORS[:3]
GREY, DARK = "#9a9a9a", "#333333"
TUMBLER = rb.RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0))


def canvas(width: float, height: float, panels: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure of this size (inches) with panels for drawings: equal scales, no frames."""
    figure = Figure(figsize=(width, height))
    axes = [figure.add_axes((k / panels, 0.0, 1.0 / panels, 1.0)) for k in range(panels)]
    for panel in axes:
        panel.set_aspect("equal")
        panel.set_axis_off()
    return figure, axes


class View:
    """An orthographic look at space from an azimuth and an elevation (degrees)."""

    def __init__(self, azimuth: float, elevation: float) -> None:
        a, e = math.radians(azimuth), math.radians(elevation)
        self.towards = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
        right = np.array([-math.sin(a), math.cos(a), 0.0])
        self.screen = np.array([right, np.cross(self.towards, right)])

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return np.asarray(points) @ self.screen.T

    def outline(self, half_axes: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return the outline of an ellipsoid about the origin, its axes turned by a matrix."""
        image = self.screen @ turn * half_axes
        circle = np.linspace(0.0, 2.0 * np.pi, 181)
        return np.column_stack([np.cos(circle), np.sin(circle)]) @ np.linalg.cholesky(image @ image.T).T

    def faces(self, points: np.ndarray, half_axes: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return which points of that ellipsoid are on its near side."""
        return (points @ turn / half_axes**2) @ (turn.T @ self.towards) >= 0.0


def trail(axes: Axes, view: View, points: np.ndarray, near: np.ndarray, color: str, width: float = 1.2) -> None:
    """Draw a curve, faint where it is on the far side."""
    flat = view(points)
    for visible, alpha, z in ((~near, 0.22, 2.0), (near, 1.0, 4.0)):
        # Both ends of a piece that leaves a side are drawn, so that no gap opens.
        shown = visible | np.roll(visible, 1) | np.roll(visible, -1)
        x, y = np.where(shown[:, None], flat, np.nan).T
        axes.plot(x, y, color=color, alpha=alpha, linewidth=width, zorder=z, solid_capstyle="round")


def arrow(axes: Axes, start: np.ndarray, end: np.ndarray, color: str, z: float = 5.0) -> None:
    axes.annotate(
        "",
        xy=(end[0], end[1]),
        xytext=(start[0], start[1]),
        arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0},
        zorder=z,
    )


def label(axes: Axes, at: np.ndarray, text: str, color: str = DARK, dx: float = 0.0, dy: float = 0.0) -> None:
    axes.annotate(text, xy=(at[0], at[1]), xytext=(dx, dy), textcoords="offset points", color=color, zorder=6.0)


def ellipsoid(axes: Axes, view: View, half_axes: np.ndarray, turn: np.ndarray, alpha: float = 1.0) -> None:
    """Draw an ellipsoid with its three principal sections."""
    axes.add_patch(
        Polygon(
            view.outline(half_axes, turn), facecolor="#f3f1ea", edgecolor=DARK, alpha=alpha, linewidth=1.0, zorder=1.0
        )
    )
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    for k in range(3):
        section = np.zeros((len(angle), 3))
        section[:, k - 1], section[:, k - 2] = np.cos(angle), np.sin(angle)
        points = (section * half_axes) @ turn.T
        trail(axes, view, points, view.faces(points, half_axes, turn), "#cfcabb", 0.7)


def cylinder() -> Figure:
    figure, (left, right) = canvas(6.4, 3.0, 2)
    view, radius, length = View(25.0, 18.0), 0.5, 2.0
    body = shapes.cylinder(radius, length).body(1.0)
    half_axes = 0.62 * np.array(rb.inertia_ellipsoid(body))
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    top = np.array([0.0, 0.0, 0.5 * length])
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)])
    low, high = view(ring - top), view(ring + top)
    edge = view.screen[0] * radius
    corners = view(np.array([s * edge + z * top for s, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))]))
    for outline in (low, corners):
        left.add_patch(Polygon(outline, facecolor="#e9edf2", edgecolor="none", zorder=1.0))
    left.plot(*corners[[0, 3]].T, color=DARK, linewidth=1.0)
    left.plot(*corners[[1, 2]].T, color=DARK, linewidth=1.0)
    front = np.cos(angle - math.radians(25.0)) >= 0.0
    left.plot(*np.where(front[:, None], low, np.nan).T, color=DARK, linewidth=1.0)
    left.plot(*np.where(front[:, None], np.nan, low).T, color=GREY, linewidth=0.7, linestyle=(0, (3, 3)))
    left.add_patch(Polygon(high, facecolor="#f6f8fa", edgecolor=DARK, linewidth=1.0, zorder=2.0))
    ellipsoid(right, view, half_axes, np.eye(3))
    for panel, ends in ((left, (radius, radius, 0.5 * length)), (right, half_axes)):
        for k, name in enumerate("xyz"):
            direction = np.eye(3)[k]
            start, end = view(direction * ends[k]), view(direction * (ends[k] + 0.55))
            arrow(panel, start, end, GREY)
            label(panel, end, name, dx=-9.0 if k == 0 else 4.0, dy=-4.0)
        panel.set_xlim(-1.75, 1.75)
        panel.set_ylim(-1.5, 1.8)
    return figure


def tumble() -> Figure:
    scene = rb.read_scene(ROOT / "config" / "dzhanibekov.yaml")
    times = np.linspace(0.0, 50.0, 1501)
    omega = rb.free_motion(scene.body, scene.initial, times).angular_velocity_body
    figure = Figure(figsize=(7.2, 2.9))
    axes = figure.add_axes((0.085, 0.165, 0.9, 0.74))
    names = ("least moment", "middle moment", "greatest moment")
    for k, (name, color) in enumerate(zip(names, COLORS, strict=False)):
        axes.plot(times, omega[:, k], color=color, linewidth=1.4, label=f"$\\omega_{k + 1}$, {name}")
    axes.set_xlim(times[0], times[-1])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("angular velocity [rad/s]")
    axes.grid(color=GREY, alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(ncols=3, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 0.98), borderaxespad=0.0)
    return figure


def polhodes() -> Figure:
    figure, (axes,) = canvas(6.0, 4.2)
    # Of one energy, 2 T = 1; w begins in the plane of the outer axes, where the separatrix is half-way.
    half_axes = 1.0 / np.sqrt(np.array(TUMBLER.principal_moments))
    view, here = View(38.0, 22.0), np.eye(3)
    ellipsoid(axes, view, half_axes, here)
    for degrees in (10.0, 20.0, 30.0, 38.0, 43.0, 45.0, 47.0, 52.0, 60.0, 70.0, 80.0):
        color = DARK if degrees == 45.0 else RED if degrees < 45.0 else BLUE
        first, third = half_axes[0] * math.cos(math.radians(degrees)), half_axes[2] * math.sin(math.radians(degrees))
        curve = polhode(TUMBLER, rb.State(angular_velocity_body=(first, 0.0, third)), 1441).angular_velocity_body
        sides = [(1.0, 1.0, 1.0), (-1.0, -1.0, 1.0) if degrees < 45.0 else (1.0, -1.0, -1.0)]
        if degrees == 45.0:
            # Two ellipses through the middle axis, of which a period is one: the other is its mirror image.
            angle = np.linspace(0.0, 2.0 * np.pi, 361)
            curve = np.column_stack([first * np.cos(angle), half_axes[1] * np.sin(angle), third * np.cos(angle)])
            sides = [(1.0, 1.0, 1.0), (-1.0, 1.0, 1.0)]
        for side in sides:
            points = curve * side
            trail(axes, view, points, view.faces(points, half_axes, here), color, 1.8 if degrees == 45.0 else 1.1)
    for k, name in enumerate(("least moment", "middle", "greatest moment")):
        direction = np.eye(3)[k]
        start, end = view(direction * half_axes[k]), view(direction * (half_axes[k] + 0.38))
        arrow(axes, start, end, DARK)
        label(axes, end, f"{k + 1}, {name}", dx=(-52.0, 5.0, 6.0)[k], dy=(-14.0, -4.0, -2.0)[k])
    axes.set_xlim(-1.2, 1.3)
    axes.set_ylim(-0.95, 0.95)
    scale_bar(axes, "rad/s")
    return figure


def _onto_floor(normal: np.ndarray) -> tuple[float, float, float, float]:
    """Return the shortest rotation of a direction onto -z, so that the plane is a floor."""
    down = np.array([0.0, 0.0, -1.0])
    axis, w = np.cross(normal, down), 1.0 + float(normal @ down)
    x, y, z, w = (np.array([*axis, w]) / math.hypot(*axis, w)).tolist()
    return (x, y, z, w)


def plane() -> Figure:
    figure, (axes,) = canvas(6.4, 4.6)
    spin = (1.0, 0.45, 0.42)
    normal = invariable_plane(TUMBLER, rb.State(angular_velocity_body=spin)).normal_world
    level = rb.State(orientation_xyzw=_onto_floor(normal), angular_velocity_body=spin)
    floor, half_axes = invariable_plane(TUMBLER, level), energy_ellipsoid(TUMBLER, level)
    view = View(-62.0, 20.0)
    turn = np.array(matrix(level.orientation_xyzw))
    contact = turn @ np.array(spin)
    foot = floor.distance * floor.normal_world
    corners = np.array([foot + 1.55 * (a * floor.axes_world[0] + b * floor.axes_world[1]) for a, b in _SQUARE])
    axes.add_patch(Polygon(view(corners), facecolor="#e6edf5", edgecolor=GREY, linewidth=0.8, zorder=0.0))
    trace = herpolhode(TUMBLER, level, times=np.linspace(0.0, 6.0, 3001) * herpolhode(TUMBLER, level, 2).period)
    axes.plot(*view(trace.angular_velocity_world).T, color=BLUE, linewidth=1.0, zorder=0.5)
    ellipsoid(axes, view, half_axes, turn, 0.86)
    points = polhode(TUMBLER, level, 721).angular_velocity_body @ turn.T
    trail(axes, view, points, view.faces(points, half_axes, turn), RED, 1.8)
    center, touch, below = view(np.zeros(3)), view(contact), view(1.45 * foot)
    arrow(axes, center, touch, GREEN)
    arrow(axes, center, below, DARK)
    axes.plot(*touch, "o", color=GREEN, markersize=5, zorder=6.0)
    axes.plot(*center, "o", color=DARK, markersize=3, zorder=6.0)
    label(axes, 0.5 * (center + touch), "$\\omega$", GREEN, -14.0, 0.0)
    label(axes, below, "$L$", DARK, 6.0, 0.0)
    label(axes, max(view(corners), key=lambda corner: corner[0]), "invariable plane", DARK, -100.0, -14.0)
    scale_bar(axes, "rad/s")
    axes.set_xlim(-2.25, 2.25)
    axes.set_ylim(-2.1, 1.35)
    return figure


_SQUARE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))


def herpolhodes() -> Figure:
    figure, panels = canvas(7.2, 2.9, 3)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    spins = ((1.0, 0.45, 0.42), (1.0, 0.25, 0.57), (0.6, 0.5, 0.6))
    titles = ("about the axis of the least moment", "close to the separatrix", "about the axis of the greatest")
    for axes, spin, title, color in zip(panels, spins, titles, (RED, DARK, BLUE), strict=True):
        start = rb.State(angular_velocity_body=spin)
        period = herpolhode(TUMBLER, start, 2).period
        trace = herpolhode(TUMBLER, start, times=np.linspace(0.0, 6.0, 2401) * period)
        for radius in (trace.inner_radius, trace.outer_radius):
            axes.plot(*(radius * circle).T, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
        axes.plot(*trace.points.T, color=color, linewidth=1.0)
        axes.plot(0.0, 0.0, "+", color=DARK, markersize=7)
        scale_bar(axes, "rad/s")
        reach = 1.12 * trace.outer_radius
        axes.set_xlim(-reach, reach)
        axes.set_ylim(-1.2 * reach, 1.3 * reach)
        axes.text(0.0, 1.13 * reach, title, ha="center", va="center", color=DARK)
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "lecture-cylinder.svg": cylinder,
    "lecture-tumble.svg": tumble,
    "lecture-polhodes.svg": polhodes,
    "lecture-plane.svg": plane,
    "lecture-herpolhodes.svg": herpolhodes,
}


def draw(name: str, kind: str = "svg") -> bytes:
    """Return a figure of the page; as SVG the same bytes every time."""
    # Text as outlines: every browser shows the same.
    settings = {"font.size": 9.0, "svg.hashsalt": name, "svg.fonttype": "path", "mathtext.fontset": "dejavuserif"}
    metadata = {"Date": None, "Creator": None} if kind == "svg" else None
    buffer = io.BytesIO()
    with style.context(["default", settings]):
        FIGURES[name]().savefig(buffer, format=kind, facecolor="white", metadata=metadata, dpi=130)
    return buffer.getvalue()


def main(arguments: list[str]) -> int:
    page = make_page()
    if "--check" in arguments:
        found = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
        missing = [name for name in FIGURES if not (IMAGES / name).exists()]
        problem = difference(found, page.text) or (f"missing figures: {missing}" if missing else "")
        if problem:
            print(f"docs/lecture.md is not what its code finds; run `python tools/make_lecture.py`\n{problem}")
        return 1 if problem else 0
    IMAGES.mkdir(exist_ok=True)
    PAGE.write_text(page.text, encoding="utf-8")
    for name in FIGURES:
        (IMAGES / name).write_bytes(draw(name))
    print(f"docs/lecture.md: {len(page.residuals)} residuals, largest {max(page.residuals.values()):.1e}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
