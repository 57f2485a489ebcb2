"""The page of `trade`: error against time, the measured runs, and the recommendation.

Every number comes from a `Trade`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from rb_dynamics.report import html
from rb_dynamics.report.html import Report, Section, Table, Tile, made_by
from rb_dynamics.report.interactive_plots import Array, Curve, Picture, Plot
from rb_dynamics.report.svg import COLORS, TEXT, picture
from rb_dynamics.study.trade import Trade, TradeRow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

# Three more, with the same contrast.
_COLORS = (*COLORS, "#7b73d9", "#5b9122", "#7d828a")
_DASHES = ("-", (0, (4.6, 2.3)), (0, (1.5, 1.9)), (0, (6.2, 2.3, 1.5, 2.3)), (0, (0.8, 2.3)))
_MARKS = "os^"

_WIDTH, _LEFT, _RIGHT, _TOP, _HEIGHT, _BOTTOM = 690.0, 58.0, 14.0, 24.0, 360.0, 42.0
_LEGEND_COLUMNS, _LEGEND_ROW = 6, 17.0

# Larger errors than a whole revolution are not distinguished.
_WORST = 10.0

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
            figures=[html.Figure(work_precision(found), _CAPTION)] if found.rows else (),
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
    return said + [f"{doubt[0].upper()}{doubt[1:]}." for doubt in found.doubts]


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


def work_precision(found: Trade) -> Picture:
    """Return error against time per simulated second, both logarithmic, one line per method.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    methods = len({row.method for row in found.rows})
    height = _TOP + _HEIGHT + _BOTTOM + _LEGEND_ROW * math.ceil(methods / _LEGEND_COLUMNS)
    across, up = _limits(found)
    # Titles are shown under the pointer; matplotlib has none.
    titles = []
    for row, x, y in zip(found.rows, *_columns(found.rows), strict=True):
        left, top = (_WIDTH - _LEFT - _RIGHT) * _share(x, across), _HEIGHT * (1.0 - _share(y, up))
        place = {"cx": f"{_LEFT + left:.1f}", "cy": f"{_TOP + top:.1f}"}
        titles.append(Element("circle", {**place, "r": "4", "fill": "transparent"}))
        error = f"error {row.error:.1e}, {row.real_time_factor:.3g} times real time"
        SubElement(titles[-1], "title").text = f"{_name(row)}: {error}"
    name = "Error against computing time, one line per method"
    drawn = picture(lambda figure, _: _draw(figure, found), (_WIDTH, height), name, above=titles)
    return replace(drawn, plots=lambda: [_plot(found)])


def _draw(figure: Figure, found: Trade) -> None:
    height = 72.0 * figure.get_figheight()
    box = (_LEFT / _WIDTH, 1.0 - (_TOP + _HEIGHT) / height, (_WIDTH - _LEFT - _RIGHT) / _WIDTH, _HEIGHT / height)
    across, up = _limits(found)
    axes = figure.add_axes(box, xscale="log", yscale="log", xlim=across, ylim=up)
    _frame(axes)
    for method, look in _looks(list(dict.fromkeys(row.method for row in found.rows))).items():
        points = _columns([row for row in found.rows if row.method == method])
        axes.plot(*points, label=method, linewidth=1.3, markersize=5.0, **look)
    below: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (0.0, -0.1), "frameon": False}
    axes.legend(ncols=_LEGEND_COLUMNS, labelcolor=TEXT, **below)
    _mark_front(axes, found)
    _bounds(axes, found, _Names(axes))


def _limits(found: Trade) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the first and the last number of both axes."""
    times, errors = (each.tolist() for each in _columns(found.rows))
    lines = [found.reference.error] + ([min(found.target, _WORST)] if found.target else [])
    asked = [1.0 / found.budget] if found.budget else []
    return _decades(times + asked), _decades([*errors, *lines, _BELOW * min(lines)])


def _decades(values: Sequence[float]) -> tuple[float, float]:
    """Return the whole decades that hold the positive ones of `values`: at least one."""
    positive = [value for value in values if value > 0.0]
    low = math.floor(math.log10(min(positive)))
    return 10.0**low, 10.0 ** max(low + 1, math.ceil(math.log10(max(positive))))


def _share(value: float, limits: tuple[float, float]) -> float:
    """Return where `value` is on a logarithmic axis, from 0 to 1."""
    return math.log(value / limits[0]) / math.log(limits[1] / limits[0])


def _frame(axes: Axes) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_xlabel("computing for each simulated second [s]", color=TEXT)
    axes.set_title("Error [rad, or relative to the path]", loc="left", color=TEXT, fontsize=11.0, weight="bold")
    axes.grid(color="#808080", alpha=0.25, linewidth=0.6)
    axes.tick_params(length=0.0, labelcolor=TEXT)
    axes.spines[:].set_visible(False)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(numticks=16))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(
            FuncFormatter(lambda value, _: f"1e{math.log10(value):.0f}".replace("-", "\N{MINUS SIGN}"))
        )


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
    rings = [
        Curve(label, _columns(rows), "#808080", "dots", {"marker": _ring(size), "hoverinfo": "skip"})
        for label, rows, size in _rings(found)
    ]
    limits = [(0.7 * float(each.min()), 1.4 * float(each.max())) for each in (times, errors)]
    bound = [np.array(limits[0]), np.full(2, found.reference.error)]
    limits[1] = min(limits[1][0], 0.7 * found.reference.error), max(limits[1][1], 1.4 * found.reference.error)
    return Plot(
        "Error [rad, or relative to the path]",
        [front, *curves, *rings, Curve("error of the reference", bound, "#808080", "dash")],
        ["computing for each simulated second [s]", ""],
        limits,
        (True, True),
    )


def _ring(size: float) -> dict[str, Any]:
    return {"symbol": "circle-open", "size": size, "color": "#808080", "line": {"width": 1.2}}


def _rings(found: Trade) -> list[tuple[str, Sequence[TradeRow], float]]:
    """Return what rings mark: its name, the runs, and the diameter (pt)."""
    recommended = [("recommended", [found.recommended.row], 17.0)] if found.recommended else []
    return [("on the front", found.front, 11.0), *recommended]


def _columns(rows: Sequence[TradeRow]) -> tuple[Array, Array]:
    return np.array([row.time_per_s for row in rows]), np.array([min(row.error, _WORST) for row in rows])


def _name(row: TradeRow) -> str:
    return f"{row.method}, {row.setting}"


class _Names:
    """Writes labels where there is room."""

    def __init__(self, axes: Axes) -> None:
        self._axes = axes
        self._taken: list[Bbox] = []

    def write(
        self, name: str, place: tuple[float, float], aside: tuple[float, float], *, to_left: bool = False
    ) -> bool:
        """Write `name` starting, or ending, `aside` (pt) of a place; return whether there was room."""
        text = self._axes.annotate(
            name, place, aside, textcoords="offset points", ha="right" if to_left else "left", color=TEXT, fontsize=9.0
        )
        extent = text.get_window_extent()
        if extent.x0 < self._axes.bbox.x0 or extent.count_overlaps(self._taken):
            text.remove()
            return False
        self._taken.append(extent)
        return True


def _mark_front(axes: Axes, found: Trade) -> None:
    """Draw the line of the front, rings round its runs, and another round the recommended one."""
    x, y = _columns(found.front)
    axes.step(x, y, where="post", color="#808080", alpha=0.2, linewidth=5.0)
    for _, rows, size in _rings(found):
        axes.plot(*_columns(rows), "o", markersize=size, fillstyle="none", color=TEXT, markeredgewidth=1.2)


def _bounds(axes: Axes, found: Trade, names: _Names) -> None:
    """Draw the error of the reference and what was asked for, and label both and the front, as far as there is room."""
    right, top = axes.get_xlim()[1], axes.get_ylim()[1]
    dashed: dict[str, Any] = {"color": "#808080", "linewidth": 1.0, "alpha": 0.8, "linestyle": (0, (5, 4))}
    dotted = {**dashed, "linestyle": (0, (1, 3))}
    axes.axhline(found.reference.error, **dashed)
    # No run can be below it, and to its right there is no ring of a fast one.
    names.write("the reference is good to here", (right, found.reference.error), (-4.0, -10.0), to_left=True)
    if found.target:
        y = min(found.target, _WORST)
        axes.axhline(y, **dotted)
        place = axes.get_xlim()[0], y
        told = f"asked for: {found.target:g}"
        if not names.write(told, place, (4.0, 4.0)):
            names.write(told, place, (4.0, -10.0))
    if found.budget:
        axes.axvline(1.0 / found.budget, **dotted)
        names.write(f"asked for: {found.budget:g} x real time", (1.0 / found.budget, top), (4.0, -10.0))
    for row, x, y in zip(found.front, *_columns(found.front), strict=True):
        # To the left of the front there is free space; a double ring is given room, too.
        if not names.write(_name(row), (x, y), (-11.0, -3.0), to_left=True):
            names.write(_name(row), (x, y), (11.0, 7.0))


def _looks(methods: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return colour, mark and dash of each method; a dash for each of a family, whose names differ in the last digits.

    The numbers of colours and of marks are coprime, so a repeated colour has another mark.
    """
    families: dict[str, int] = {}
    members: Counter[str] = Counter()
    looks: dict[str, dict[str, Any]] = {}
    for method in methods:
        name = method.rstrip("0123456789")
        family = families.setdefault(name, len(families))
        dash = _DASHES[members[name] % len(_DASHES)]
        color, mark = _COLORS[family % len(_COLORS)], _MARKS[family % len(_MARKS)]
        looks[method] = {"color": color, "marker": mark, "linestyle": dash}
        members[name] += 1
    return looks
