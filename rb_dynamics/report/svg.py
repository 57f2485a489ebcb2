"""Pictures as inline SVG, readable on light and on dark pages; time series as stacks of panels over one time axis.

`draw` thins long series while keeping their peaks, writes titles and legends as plain text (names from a log are not
markup), and gives the same bytes for the same numbers. Must not open a window or change matplotlib's settings for the
caller.
"""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.gaps import after_gaps
from rb_dynamics.errors import needing
from rb_dynamics.report.html import printable
from rb_dynamics.report.interactive_plots import Picture, Plot, read, time_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array: TypeAlias = NDArray[np.float64]

# Vermilion, green, blue, violet, which colour-blind readers can distinguish; red, green, blue for x, y, z as usual in
# robotics. Three more for more lines. All have a contrast of at least 3:1 against white and near-black.
COLORS = ("#d9591b", "#12916a", "#3b86d1", "#a86fc0", "#c7508f", "#8a7a1f", "#0e8f9e")

# Motion of less than this part of the distance from zero is not visible.
_FAR = 0.01

# Per line, in a picture and in a plot that can be zoomed; four points per bucket.
MAX_POINTS = 2000
MOST_TOUCHED = 4000

# Axes of at least this many seconds are in hours, or days.
_UNITS = ((3.0 * 86400.0, 86400.0, "d"), (3.0 * 3600.0, 3600.0, "h"), (0.0, 1.0, "s"))

_WIDTH, _PANEL, _TOP, _BOTTOM, _LEFT, _RIGHT = 690.0, 112.0, 32.0, 36.0, 72.0, 14.0
_FONT = 9.5
# Height of a row of a legend, most rows, and a width that a screen of 360 px shows of the picture.
_ROW, _MOST_ROWS, _LEGEND = 14.0, 3, 400.0
# Replaced by currentColor, which matplotlib does not support.
TEXT = "#010203"
SETTINGS = {"font.size": _FONT, "svg.fonttype": "none"}


@dataclass(frozen=True)
class Line:
    """Values over time (s); `step` holds each value until the next, `dashed` shows the line below. NaN is a gap.

    `color` is a place in `COLORS`; None: the place of the line in its panel.
    """

    label: str
    time_s: Array
    values: Array
    step: bool = False
    dashed: bool = False
    color: int | None = None


@dataclass(frozen=True)
class Panel:
    """Lines over one y axis; `log` shows magnitudes on a logarithmic axis."""

    title: str
    lines: Sequence[Line]
    log: bool = False


def components(time_s: Array, values: Array, labels: Sequence[str] = "xyz", *, step: bool = False) -> list[Line]:
    """Return one line per column of `values`."""
    return [Line(label, time_s, column, step) for label, column in zip(labels, values.T, strict=False)]


def far_off(position: Array) -> tuple[Array, str]:
    """Return what to subtract from positions (m) whose motion would not be seen so far from zero, and words for that.

    Zero and "" if it would.
    """
    known = position[np.isfinite(position).all(axis=1)]
    extent = float(np.ptp(known, axis=0).max()) if len(known) else 0.0
    if not 0.0 < extent < _FAR * float(np.abs(known[0]).max(initial=0.0)):
        return np.zeros(3), ""
    place = np.round(known[0], -math.floor(math.log10(extent)))
    return place, f" less ({', '.join(f'{each:.12g}' for each in place.tolist())}) m"


def thin(values: Array, max_points: int = MAX_POINTS) -> NDArray[np.intp]:
    """Return indices, ascending, of at most `max_points` values that look the same.

    Each bucket keeps its first, last, smallest and largest value, and one NaN if there is a gap.
    """
    count = len(values)
    if count <= max_points:
        return np.arange(count)
    edges = np.linspace(0, count, max_points // 5 + 1).astype(int)
    starts = edges[:-1]
    bucket = np.repeat(np.arange(len(starts)), np.diff(edges))
    gaps = np.isnan(values)
    kept = [starts, edges[1:] - 1, _first(gaps, bucket)]
    for extreme, other in ((np.minimum, np.inf), (np.maximum, -np.inf)):
        known = np.where(gaps, other, values)
        kept.append(_first(known == extreme.reduceat(known, starts)[bucket], bucket))
    return np.unique(np.concatenate(kept))


def _first(which: NDArray[np.bool_], bucket: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the first index in each bucket that has one."""
    found = np.flatnonzero(which)
    return found[np.unique(bucket[found], return_index=True)[1]]


def draw(panels: Sequence[Panel], name: str, span_s: Array | None = None) -> Picture:
    """Return the panels, one above the other.

    Args:
        panels: at least one.
        name: description of the figure for readers who cannot see it.
        span_s: first and last time to show; None for all.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    headings = [_heading(panel) for panel in panels]
    tops = [_TOP + _ROW * len(legend) for _, legend in headings]
    height = _BOTTOM + sum(tops) + len(panels) * _PANEL
    start, end = _span(panels, span_s)
    second, unit = time_unit(end - start)

    def fill(figure: Figure, most: int) -> None:
        bottom = height
        for panel, top in zip(panels, tops, strict=True):
            bottom -= top + _PANEL
            box = (_LEFT / _WIDTH, bottom / height, (_WIDTH - _LEFT - _RIGHT) / _WIDTH, _PANEL / height)
            axes = figure.add_axes(box, label=panel.title)
            _plot(axes, panel, end, second, most)
            axes.set_xlim(start * second, end * second)
            time_axis(axes, second)
            if panel is not panels[-1]:
                axes.tick_params(labelbottom=False)
        axes.set_xlabel(f"time [{unit}]", color=TEXT, labelpad=2.0)

    above, y = [], 0.0
    for (title, legend), top in zip(headings, tops, strict=True):
        for number, element in enumerate([title, *legend]):
            element.set("y", f"{y + _TOP - 9.0 + number * _ROW:g}")
            above.append(element)
        y += top + _PANEL
    return picture(fill, (_WIDTH, height), name, [panel.title for panel in panels], above=above)


def time_unit(span_s: float) -> tuple[float, str]:
    """Return the length of a second, and the unit, on an axis of `span_s`: seconds, hours or days."""
    return next((1.0 / size, unit) for least, size, unit in _UNITS if span_s >= least)


def picture(
    fill: Callable[[Figure, int], None],
    size: tuple[float, float],
    name: str,
    titles: Sequence[str] = (),
    *,
    above: Sequence[ElementTree.Element] = (),
    layout: Literal["constrained"] | None = None,
    columns: int = 1,
) -> Picture:
    """Return the figure of `size` (pt) that `fill` draws, with a limited number of points per line.

    Args:
        fill: draws on an empty figure: once for the picture, once for the plots.
        size: of the picture.
        name: description for readers who cannot see it; with `titles` it makes the ids, the same in every run.
        titles: of the plots.
        above: elements drawn last.
        layout: of matplotlib.
        columns: in how many columns the plots stand.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    with needing("matplotlib", "plot", "a figure"):
        from matplotlib import style
        from matplotlib.figure import Figure

    def drawn(most: int) -> Figure:
        figure = Figure(figsize=(size[0] / 72.0, size[1] / 72.0), layout=layout)
        fill(figure, most)
        return figure

    def plots() -> list[Plot]:
        with style.context(["default", SETTINGS]):
            return read(drawn(MOST_TOUCHED))

    buffer = io.BytesIO()
    # The settings are also needed while drawing; the context restores the caller's.
    with style.context(["default", {**SETTINGS, "svg.hashsalt": "|".join([name, *titles])}]):
        drawn(MAX_POINTS).savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return Picture(_inline(buffer.getvalue(), name, above), plots, columns)


def _span(panels: Sequence[Panel], span_s: Array | None) -> tuple[float, float]:
    times = [line.time_s for panel in panels for line in panel.lines] if span_s is None else [span_s]
    start = min((float(time[0]) for time in times if len(time)), default=0.0)
    end = max((float(time[-1]) for time in times if len(time)), default=1.0)
    return (start, end) if end > start else (start - 0.5, start + 0.5)


def _plot(axes: Axes, panel: Panel, end: float, second: float, most: int) -> None:
    from matplotlib.ticker import MaxNLocator

    for line, (color, dashed) in zip(panel.lines, _looks(panel.lines), strict=True):
        time_s, values = _points(line, panel.log, end, most)
        look = (0, (4, 3)) if dashed else "solid"
        drawn = "steps-post" if line.step else "default"
        axes.plot(
            time_s * second, values, color=color, linewidth=1.3, linestyle=look, drawstyle=drawn, label=line.label
        )
    if panel.log:
        _logarithmic(axes)
    else:
        axes.margins(y=0.1)
        _widen(axes)
        axes.yaxis.set_major_locator(MaxNLocator(5, min_n_ticks=3))
    quiet(axes, "y")


def quiet(axes: Axes, grid: Literal["both", "y"] = "both") -> None:
    """Draw axes in grey, without a box, with a grid across those named, and with few digits at their ticks."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#808080")
    axes.grid(axis=grid, color="#808080", alpha=0.25, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(which="both", color="#808080", labelcolor=TEXT, length=3.0)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_minor_formatter(NullFormatter())
        axis.set_major_formatter(FuncFormatter(lambda value, _, axis=axis: tick(value, axis.get_majorticklocs())))


def _looks(lines: Sequence[Line]) -> list[tuple[str, bool]]:
    """Return colour and dash of each line; when colours repeat, dashes distinguish them."""
    rounds = (divmod(i if line.color is None else line.color, len(COLORS)) for i, line in enumerate(lines))
    return [(COLORS[i], line.dashed or turn % 2 == 1) for line, (turn, i) in zip(lines, rounds, strict=True)]


def _points(line: Line, log: bool, end: float, most: int = MAX_POINTS) -> tuple[Array, Array]:
    values = np.abs(line.values) if log else line.values
    time_s = line.time_s
    if not line.step:
        # No line across a gap, in which the values are unknown.
        holes = after_gaps(time_s)
        time_s, values = np.insert(time_s, holes, time_s[holes - 1]), np.insert(values, holes, np.nan)
    kept = thin(values, most)
    time_s, values = time_s[kept], values[kept]
    if line.step and len(time_s):
        # The last value holds to the end of the figure; before its first value a channel is zero, without a line.
        return np.append(time_s, end), np.append(values, values[-1])
    return time_s, values


def _widen(axes: Axes) -> None:
    """Widen the axis so that a value that is constant up to round-off looks constant; figures of defects show more."""
    low, high = axes.get_ylim()
    middle, least = 0.5 * (low + high), 1e-4 * max(abs(low), abs(high))
    if high - low < least:
        axes.set_ylim(middle - 0.5 * least, middle + 0.5 * least)


def _logarithmic(axes: Axes) -> None:
    from matplotlib.ticker import LogLocator, NullLocator

    shown = [np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()]
    values = np.concatenate([*shown, [np.nan]])
    positive = values[np.isfinite(values) & (values > 0.0)]
    low, high = (float(positive.min()), float(positive.max())) if len(positive) else (1e-16, 1e-15)
    # A few samples that agree to the last bit would stretch the axis over many empty decades.
    low = max(low, 1e-6 * high)
    axes.set_ylim(10.0 ** math.floor(math.log10(low)), 10.0 ** (math.floor(math.log10(high)) + 1))
    axes.set_yscale("log", nonpositive="mask")
    axes.yaxis.set_major_locator(LogLocator(numticks=5))
    axes.yaxis.set_minor_locator(NullLocator())


def tick(value: float, places: Sequence[float] | Array) -> str:
    """Return the label of a tick with just enough digits to distinguish it from its neighbours."""
    around = sorted(float(place) for place in places)
    steps = [b - a for a, b in itertools.pairwise(around) if b > a]
    if not steps:
        return f"{value:g}"
    if abs(value) < 1e-9 * min(steps):
        return "0"
    size, apart = math.floor(math.log10(abs(value))), math.floor(math.log10(min(steps)) + 1e-9)
    if -4 <= size < 6:
        text = f"{value:.{min(max(1 - apart, 0), 12)}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
    else:
        mantissa, _, exponent = f"{value:.{min(max(size - apart + 1, 0), 11)}e}".partition("e")
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        text = f"{mantissa}e{int(exponent)}"
    return text.replace("-", "\N{MINUS SIGN}")


def _inline(document: bytes, name: str, above: Sequence[ElementTree.Element]) -> str:
    """Return the svg element without namespaces, unused ids and fonts; `above` is drawn last."""
    root = ElementTree.fromstring(document)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
        attributes = {key.rpartition("}")[2]: value for key, value in element.attrib.items()}
        element.attrib.clear()
        element.attrib.update(attributes)
        if "style" in attributes:
            element.set("style", _style(attributes["style"]))
        if element.tag == "g":
            element.attrib.pop("id", None)
    _drop(root, "metadata")
    for defs in root.findall("defs"):
        # It would apply to the whole page.
        _drop(defs, "style")
    for key in ("width", "height", "version"):
        root.attrib.pop(key, None)
    root.attrib.update({"role": "img", "aria-label": printable(name), "stroke-linejoin": "round"})
    root.extend(above)
    return ElementTree.tostring(root, encoding="unicode")


def _drop(parent: ElementTree.Element, tag: str) -> None:
    for child in parent.findall(tag):
        parent.remove(child)


def _style(text: str) -> str:
    parts = [part.strip() for part in text.replace(TEXT, "currentColor").split(";")]
    kept = [f"font-size: {_FONT:g}px" if part.startswith("font:") else part for part in parts]
    return "; ".join(part for part in kept if part and not part.startswith("font-family"))


def _heading(panel: Panel) -> tuple[ElementTree.Element, list[ElementTree.Element]]:
    """Return the title, and the rows of the legend below it: on the left, where a narrow screen shows them."""
    title = ElementTree.Element(
        "text", {"x": "2", "fill": "currentColor", "style": "font-size: 11px; font-weight: 600"}
    )
    title.text = printable(panel.title)
    if len(panel.lines) < 2:
        return title, []
    rows: list[ElementTree.Element] = []
    room = 0.0
    for line, (color, dashed) in zip(panel.lines, _looks(panel.lines), strict=True):
        width = 0.55 * _FONT * (len(printable(line.label)) + 5)
        if width > room:
            if len(rows) == _MOST_ROWS:
                last = rows[-1][-1]
                more = len(panel.lines) - sum(len(row) for row in rows)
                last.tail = (
                    f"{(last.tail or '').rstrip()},\N{NO-BREAK SPACE}and\N{NO-BREAK SPACE}{more}\N{NO-BREAK SPACE}more"
                )
                break
            style = f"font-size: {_FONT:g}px"
            rows.append(ElementTree.Element("text", {"x": "2", "fill": "currentColor", "style": style}))
            room = _LEGEND
        room -= width
        swatch = ElementTree.SubElement(rows[-1], "tspan", {"fill": color, "style": "font-weight: 700"})
        swatch.text = "\N{EN DASH}\N{EN DASH}" if dashed else "\N{EM DASH}"
        # Non-breaking spaces: a shift by dx would be ignored at the end of the text.
        swatch.tail = f"\N{NO-BREAK SPACE}{printable(line.label)}" + 3 * "\N{NO-BREAK SPACE}"
    return title, rows
