"""The page of `trade`: error against time, the measured runs, and the recommendation.

Every number comes from a `Trade`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from rb_dynamics.report.html import Figure, Report, Section, Table, Tile, made_by, printable
from rb_dynamics.report.interactive_plots import Array, Curve, Picture, Plot
from rb_dynamics.report.svg import COLORS
from rb_dynamics.study.trade import Trade, TradeRow

# Three more, with the same contrast.
_COLORS = (*COLORS, "#7b73d9", "#5b9122", "#7d828a")
_DASHES = ("", "6 3", "2 2.5", "8 3 2 3", "1 3")

_WIDTH, _LEFT, _RIGHT, _TOP, _HEIGHT, _BOTTOM = 690.0, 58.0, 14.0, 24.0, 360.0, 42.0
_LEGEND_COLUMNS, _LEGEND_ROW = 6, 17.0

# Larger errors than a whole revolution are not distinguished.
_WORST = 10.0

# Height of a label, and width of one of its letters.
_NAME, _LETTER = 11.0, 5.0

# This fraction of the height is below the lines, for their labels.
_BELOW = 0.3


def trade_report(found: Trade) -> Report:
    """Return the page of `found`."""
    reference = found.reference
    lead = (
        f"Speed and accuracy, measured over {found.trial_s:g} s of this scene: "
        f"{len(found.rows)} runs of {found.measured}."
    )
    trusted = (
        f"The reference is {reference.method}; {reference.check}, a method of another family, differs from it by "
        f"{reference.attitude:.2g} rad in attitude, {reference.rate:.2g} rad/s in rate and {reference.position:.2g} m "
        f"in position after {found.trial_s:g} s and a path of {reference.path:.4g} m, rounding included. Smaller "
        "errors are shown as <= that bound."
    )
    remarks = [f"{remark[0].upper()}{remark[1:]}." for remark in found.remarks]
    ended = [[method, why] for method, why in found.ended.items()]
    sections = [
        Section(
            "Recommendation",
            "\n\n".join([*_taken(found), *_compiled(found), *remarks]),
            tiles=_tiles(found),
            lines=[found.recommended.solver] if found.recommended else (),
        ),
        Section(
            "Speed and accuracy",
            figures=[Figure(Picture(work_precision(found), lambda: [_plot(found)]), _CAPTION)] if found.rows else (),
        ),
        Section("The front", _COLUMNS, table=_table(found, found.front)),
        Section("The reference", trusted),
        Section("All runs", table=_table(found, found.rows)),
        Section("Why each method ended", table=Table(["method", "ended by"], ended, numeric=False)),
    ]
    return Report(f"Trade: {found.scene}", lead, sections, made_by())


_CAPTION = (
    "Below and to the left is better. Error: of attitude in rad or of position relative to the path, whichever is "
    "larger, at the end. Time: with all outputs of the scene. Rings mark the front, the runs that no other one beats "
    "in both; the double ring is the recommendation. Errors below the dashed line are less than that of the reference. "
    "Times were measured on this machine."
)

_COLUMNS = (
    "From fast to accurate. Attitude, rate and position: errors at the end. As run: with all outputs of the scene, but "
    "without writing a log; end alone: without outputs. Energy, L and p: defects of the balances of energy, angular "
    "and linear momentum at the end. Evaluations: of torque and force in the accepted steps, error estimates "
    "included; none if a method has no fixed number of them."
)


def _taken(found: Trade) -> list[str]:
    """Return why the line for the scene is recommended."""
    if found.recommended is None:
        return [found.shortfall]
    whole = found.recommended.whole
    said = [f"This is {found.recommended.reason}."]
    if not whole.measured:
        said.append(
            f"Its error is known after {found.trial_s:g} s of {found.whole:g} s only. At the end it is "
            f"{whole.error:.1e} if it grows with the square of time, which was not measured{_would_do(found)}."
        )
    elif found.trial_s < found.whole:
        said.append(f"It was run to the end for that: the error is the one after all {found.whole:g} s.")
    return said


def _would_do(found: Trade) -> str:
    return "" if found.enough_s is None else f": there would be time for that with about --time {found.enough_s:g}"


def _compiled(found: Trade) -> list[str]:
    """Return which times are those of compiled code, and the compile times."""
    compiled = sum(row.compiled for row in found.rows)
    said = []
    if compiled:
        said.append(
            f"{compiled} of the {len(found.rows)} runs are compiled, as each would be over the whole scene: a short "
            "run is not worth it."
        )
    if found.kernels:
        took = math.fsum(found.kernels.values())
        said.append(
            f"Kernels compiled, or loaded where that had been done before: {len(found.kernels)}, in {took:.3g} s, "
            "which no time below holds."
        )
    return [" ".join(said)] if said else []


def _tiles(found: Trade) -> list[Tile]:
    reference = found.reference
    verdict = "good" if reference.is_useful else "bad"
    trust = Tile("Reference good to", f"{reference.error:.1e}", f"{reference.method}; {reference.check}", verdict)
    if found.recommended is None:
        return [Tile("Take", "nothing measured", verdict="bad"), trust]
    row, whole = found.recommended.row, found.recommended.whole
    at_end = whole.measured and found.trial_s < found.whole
    error = f"{whole.error:.1e}" if at_end else f"{'<= ' if row.within_trust else ''}{row.error:.1e}"
    after = f", after {found.whole if at_end else found.trial_s:g} s of {found.whole:g} s"
    return [
        Tile("Take", row.method, row.setting, "good"),
        Tile(
            "Its speed",
            f"{row.real_time_factor:.3g} x",
            f"real time with all outputs, {row.bare_real_time_factor:.3g} x without",
        ),
        Tile("Its error", error, f"rad, or relative to the path{after if found.trial_s < found.whole else ''}"),
        trust,
    ]


def _table(found: Trade, rows: Iterable[TradeRow]) -> Table:
    header = [
        "method",
        "setting",
        "attitude [rad]",
        "rate [rad/s]",
        "position [m]",
        "as run [s per s]",
        "end alone [s per s]",
        "x real time",
    ]
    header += ["energy [J]", "L [kg m²/s]", "p [kg m/s]", "steps", "evals", "compiled", "front"]
    return Table(header, [_cells(found, row) for row in rows])


def _cells(found: Trade, row: TradeRow) -> list[str]:
    defects = (row.energy_defect, row.angular_momentum_defect, row.linear_momentum_defect)
    return [
        row.method,
        row.setting,
        *found.reference.errors(row),
        f"{row.time_per_s:.2e}",
        f"{row.bare_time_per_s:.2e}",
        f"{row.real_time_factor:.3g}",
        *(f"{abs(defect):.1e}" for defect in defects),
        f"{row.steps}",
        "" if row.evaluations is None else f"{row.evaluations}",
        "yes" if row.compiled else "",
        "yes" if row.front else "",
    ]


def work_precision(found: Trade) -> str:
    """Return error against time per simulated second as an SVG element, both logarithmic, one line per method."""
    styles = _styles(list(dict.fromkeys(row.method for row in found.rows)))
    height = _TOP + _HEIGHT + _BOTTOM + _LEGEND_ROW * math.ceil(len(styles) / _LEGEND_COLUMNS)
    name = "Error against computing time, one line per method"
    root = Element("svg", {"viewBox": f"0 0 {_WIDTH:g} {height:g}", "role": "img", "aria-label": name})
    times = [row.time_per_s for row in found.rows] + ([1.0 / found.budget] if found.budget else [])
    lines = [found.reference.error] + ([found.target] if found.target else [])
    errors = [row.error for row in found.rows] + lines + [_BELOW * min(lines)]
    across = _Axis(times, _LEFT, _WIDTH - _RIGHT)
    up = _Axis([min(error, _WORST) for error in errors], _TOP + _HEIGHT, _TOP)
    _text(root, 2.0, 12.0, "Error [rad, or relative to the path]", "font-size: 11px; font-weight: 600")
    _grid(root, across, up)
    names = _bounds(root, found, across, up)
    at = {row: (across.place(row.time_per_s), up.place(min(row.error, _WORST))) for row in found.rows}
    _staircase(root, [at[row] for row in found.front])
    for method, style in styles.items():
        rows = [row for row in found.rows if row.method == method]
        style.line(root, [at[row] for row in rows])
        for row in rows:
            error = f"error {row.error:.1e}, {row.real_time_factor:.3g} times real time"
            SubElement(style.mark(root, *at[row]), "title").text = f"{_name(row)}: {error}"
    _mark_front(root, [(_name(row), *at[row]) for row in found.front], names)
    if found.recommended is not None:
        _ring(root, *at[found.recommended.row], 8.5)
    _legend(root, styles)
    return tostring(root, encoding="unicode")


def _plot(found: Trade) -> Plot:
    """Return the same as a plot; what is beyond the axes of the picture is beyond those of the plot."""
    times, errors = _columns(found.rows)
    curves = []
    for number, method in enumerate(dict.fromkeys(row.method for row in found.rows)):
        rows = [row for row in found.rows if row.method == method]
        color = _COLORS[number % len(_COLORS)]
        names = [f"{_name(row)}: {row.real_time_factor:.3g} times real time" for row in rows]
        curves.append(Curve(method, _columns(rows), color, more={"mode": "lines+markers", "text": names}))
    front = Curve(
        "front", _columns(found.front), "#808080", more={"line": {"color": "#808080", "width": 5}, "opacity": 0.4}
    )
    limits = [(0.7 * float(each.min()), 1.4 * float(each.max())) for each in (times, errors)]
    return Plot(
        "Error [rad, or relative to the path]",
        [front, *curves],
        ["computing for each simulated second [s]", ""],
        limits,
        (True, True),
    )


def _columns(rows: Sequence[TradeRow]) -> tuple[Array, Array]:
    return np.array([row.time_per_s for row in rows]), np.array([min(row.error, _WORST) for row in rows])


def _name(row: TradeRow) -> str:
    return f"{row.method}, {row.setting}"


class _Names:
    """Writes labels where there is room."""

    def __init__(self, root: Element) -> None:
        self._root = root
        self._taken: list[tuple[float, float, float]] = []

    def write(self, name: str, x: float, y: float, *, to_left: bool = False) -> bool:
        """Write `name` starting, or ending, at x on the line y; return whether there was room."""
        width = _LETTER * len(name)
        left = x - width if to_left else x
        if left < _LEFT or any(
            abs(y - line) < _NAME and left < end and start < left + width for start, end, line in self._taken
        ):
            return False
        self._taken.append((left, left + width, y))
        _text(self._root, x, y, name, f"font-size: 9px{'; text-anchor: end' * to_left}")
        return True


def _mark_front(root: Element, points: Sequence[tuple[str, float, float]], names: _Names) -> None:
    """Draw rings round the runs of the front, with labels as far as there is room."""
    for name, x, y in points:
        _ring(root, x, y, 5.5)
        # To the left of the front there is free space; a double ring is given room, too.
        if not names.write(name, x - 11.0, y + 3.0, to_left=True):
            names.write(name, x + 11.0, y - 7.0)


class _Axis:
    """A logarithmic axis over whole decades, from `start` to `end` in the units of the picture."""

    def __init__(self, values: Sequence[float], start: float, end: float) -> None:
        positive = [value for value in values if value > 0.0]
        self.low = math.floor(math.log10(min(positive)))
        self.high = max(self.low + 1, math.ceil(math.log10(max(positive))))
        self._start, self._scale = start, (end - start) / (self.high - self.low)

    def place(self, value: float) -> float:
        """Return the position of `value`."""
        return self._start + self._scale * (math.log10(value) - self.low)

    def ticks(self) -> list[tuple[float, str]]:
        """Return positions and labels of the decades."""
        every = math.ceil((self.high - self.low) / 16)
        decades = range(self.low, self.high + 1, every)
        return [(self.place(10.0**k), f"1e{k}".replace("-", "\N{MINUS SIGN}")) for k in decades]


class _Style:
    """Style of a method's line and marks: a colour and a mark for the family, a dash for the member."""

    def __init__(self, family: int, member: int) -> None:
        self._color = _COLORS[family % len(_COLORS)]
        # The numbers of colours and of shapes are coprime, so a repeated colour has another shape.
        self._shape = _SHAPES[family % len(_SHAPES)]
        self._dash = _DASHES[member % len(_DASHES)]

    def line(self, parent: Element, points: Sequence[tuple[float, float]]) -> None:
        """Draw a line through `points`."""
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        look = {"fill": "none", "stroke": self._color, "stroke-width": "1.3", "stroke-linejoin": "round"}
        if self._dash:
            look["stroke-dasharray"] = self._dash
        SubElement(parent, "polyline", {"points": path, **look})

    def mark(self, parent: Element, x: float, y: float) -> Element:
        """Draw and return a mark."""
        tag, place = self._shape(x, y)
        return SubElement(parent, tag, {**place, "fill": self._color})


def _styles(methods: Sequence[str]) -> dict[str, _Style]:
    """Return a style for each method; methods whose names differ only in the final digits are a family."""
    families: dict[str, int] = {}
    styles: dict[str, _Style] = {}
    for method in methods:
        name = method.rstrip("0123456789")
        members = [other for other in styles if other.rstrip("0123456789") == name]
        styles[method] = _Style(families.setdefault(name, len(families)), len(members))
    return styles


_Shape = Callable[[float, float], tuple[str, dict[str, str]]]


def _circle(x: float, y: float) -> tuple[str, dict[str, str]]:
    return "circle", {"cx": f"{x:.1f}", "cy": f"{y:.1f}", "r": "3"}


def _square(x: float, y: float) -> tuple[str, dict[str, str]]:
    return "rect", {"x": f"{x - 2.7:.1f}", "y": f"{y - 2.7:.1f}", "width": "5.4", "height": "5.4"}


def _triangle(x: float, y: float) -> tuple[str, dict[str, str]]:
    return "path", {"d": f"M{x - 3.6:.1f},{y + 2.7:.1f}h7.2l-3.6,-6.3z"}


_SHAPES: tuple[_Shape, ...] = (_circle, _square, _triangle)


def _grid(root: Element, across: _Axis, up: _Axis) -> None:
    bottom, right = _TOP + _HEIGHT, _WIDTH - _RIGHT
    for x, label in across.ticks():
        _stroke(root, [(x, _TOP), (x, bottom)], "0.6", "0.25")
        _text(root, x, bottom + 14.0, label, "font-size: 9.5px; text-anchor: middle")
    for y, label in up.ticks():
        _stroke(root, [(_LEFT, y), (right, y)], "0.6", "0.25")
        _text(root, _LEFT - 6.0, y + 3.0, label, "font-size: 9.5px; text-anchor: end")
    middle = 0.5 * (_LEFT + right)
    _text(
        root,
        middle,
        bottom + 29.0,
        "computing for each simulated second [s]",
        "font-size: 9.5px; text-anchor: middle",
    )


def _bounds(root: Element, found: Trade, across: _Axis, up: _Axis) -> _Names:
    """Draw the error of the reference and the target; return their labels, which other labels must avoid."""
    right, names = _WIDTH - _RIGHT, _Names(root)
    y = up.place(found.reference.error)
    _stroke(root, [(_LEFT, y), (right, y)], "1", "0.8", "5 4")
    # No run can be below it, and to its right there is no ring of a fast one.
    names.write("the reference is good to here", right - 4.0, y + _NAME, to_left=True)
    if found.target:
        y = up.place(min(found.target, _WORST))
        _stroke(root, [(_LEFT, y), (right, y)], "1", "0.8", "1 3")
        told = f"asked for: {found.target:g}"
        if not names.write(told, _LEFT + 4.0, y - 4.0):
            names.write(told, _LEFT + 4.0, y + _NAME)
    if found.budget:
        x = across.place(1.0 / found.budget)
        _stroke(root, [(x, _TOP), (x, _TOP + _HEIGHT)], "1", "0.8", "1 3")
        names.write(f"asked for: {found.budget:g} x real time", x + 4.0, _TOP + 9.0)
    return names


def _staircase(root: Element, points: Sequence[tuple[float, float]]) -> None:
    corners = [(b[0], a[1]) for a, b in itertools.pairwise(points)]
    path = [point for pair in itertools.zip_longest(points, corners) for point in pair if point is not None]
    _stroke(root, path, "5", "0.2")


def _ring(root: Element, x: float, y: float, radius: float) -> None:
    look = {"fill": "none", "stroke": "currentColor", "stroke-width": "1.2", "class": "front"}
    SubElement(root, "circle", {"cx": f"{x:.1f}", "cy": f"{y:.1f}", "r": f"{radius:g}", **look})


def _legend(root: Element, styles: dict[str, _Style]) -> None:
    width = (_WIDTH - _LEFT - _RIGHT) / _LEGEND_COLUMNS
    rows = math.ceil(len(styles) / _LEGEND_COLUMNS)
    for index, (method, style) in enumerate(styles.items()):
        x, y = _LEFT + index // rows * width, _TOP + _HEIGHT + _BOTTOM + index % rows * _LEGEND_ROW + 6.0
        style.line(root, [(x, y), (x + 26.0, y)])
        style.mark(root, x + 13.0, y)
        _text(root, x + 32.0, y + 3.2, method, "font-size: 9.5px")


def _stroke(root: Element, points: Sequence[tuple[float, float]], width: str, opacity: str, dash: str = "") -> None:
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    look = {"fill": "none", "stroke": "#808080", "stroke-width": width, "stroke-opacity": opacity}
    if dash:
        look["stroke-dasharray"] = dash
    SubElement(root, "polyline", {"points": path, **look})


def _text(root: Element, x: float, y: float, text: str, style: str) -> None:
    place = {"x": f"{x:.1f}", "y": f"{y:.1f}", "fill": "currentColor", "style": style}
    SubElement(root, "text", place).text = printable(text)
