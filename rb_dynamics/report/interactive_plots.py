"""Interactive plots: the numbers of a figure, for plotly.js in the page.

The numbers are read from the figure that also gives the static picture, so the two cannot differ. plotly.js comes from
the package plotly, about 4.8 MB, and goes into the page compressed, 2 MB. Must not draw.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import Collection
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

Array: TypeAlias = NDArray[np.float64]

EXTRA = "interactive"


@dataclass(frozen=True)
class Curve:
    """Points in two or three coordinates; `look` is line, dash, step, dots, fill or bars.

    `more` are keys of a trace of plotly.js.
    """

    label: str
    points: Sequence[Array]
    color: str
    look: str = "line"
    more: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Plot:
    """Curves over two axes, or in space.

    Attributes:
        title: with the unit.
        curves: in the order of drawing.
        axes: names of the axes, with units; three in space.
        limits: first and last number of each axis; none in space.
        log: which axes are logarithmic.
        second: length of a second on the first axis; 0 if that is not time.
        equal: whether both axes have the same scale, which is then not shown.
        shapes: lines and areas across the plot, as plotly.js has them.
        notes: words in the plot, as plotly.js has them.
    """

    title: str
    curves: Sequence[Curve]
    axes: Sequence[str]
    limits: Sequence[tuple[float, float]] = ()
    log: Sequence[bool] = ()
    second: float = 0.0
    equal: bool = False
    shapes: Sequence[dict[str, Any]] = ()
    notes: Sequence[dict[str, Any]] = ()


@dataclass(frozen=True)
class Picture:
    """A figure as inline SVG, and `plots` for its numbers in `columns`, called only if they can be shown."""

    svg: str
    plots: Callable[[], Sequence[Plot]] = tuple
    columns: int = 1


@lru_cache(maxsize=1)
def library() -> str:
    """Return plotly.js, compressed, in base64; "" if plotly is not installed."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        return ""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode("ascii")


def encode(pictures: Sequence[Picture]) -> str:
    """Return the plots of `pictures` as JSON without markup; numbers as little-endian doubles in base64, each once."""
    arrays: dict[str, int] = {}

    def place(values: Array) -> int:
        text = base64.b64encode(np.ascontiguousarray(values, "<f8").tobytes()).decode("ascii")
        return arrays.setdefault(text, len(arrays))

    def plain(plot: Plot) -> dict[str, Any]:
        curves = [{**vars(curve), "points": [place(each) for each in curve.points]} for curve in plot.curves]
        # plotly takes the text of an axis for markup.
        return {**vars(plot), "curves": curves, "axes": [each.replace("<", "&lt;") for each in plot.axes]}

    figures = [{"columns": each.columns, "plots": [plain(plot) for plot in each.plots()]} for each in pictures]
    # ASCII: characters that a page must not hold are escaped.
    text = json.dumps({"figures": figures, "arrays": list(arrays)}, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def read(figure: Figure) -> list[Plot]:
    """Return the plots of a matplotlib figure.

    What `time_axis` marked is time. Of each axes the lines, dots, bars, filled areas and words are read.
    """
    return [_plot(axes) for axes in figure.axes]


def time_axis(axes: Axes, second: float) -> None:
    """Mark the first axis as time, on which a second has the length `second`."""
    axes.xaxis.set_gid(f"{second!r}")


def _plot(axes: Axes) -> Plot:
    across = axes.get_xaxis_transform()
    curves, shapes = [_collection(each) for each in axes.collections], []
    for line in axes.get_lines():
        if line.get_transform() == across:
            x = np.asarray(line.get_xdata(orig=True), float)
            shapes.append(_shape("line", x[0], x[-1], line={"dash": "dash", "width": 1}))
        else:
            curves.append(_line(line))
    bars = [_bars(each) for each in axes.containers]
    barred = {patch for each in axes.containers for patch in each}
    for patch in axes.patches:
        if patch not in barred:
            # A rectangle or, before matplotlib 3.9, a polygon.
            x = patch.get_patch_transform().transform(patch.get_path().vertices)[:, 0]
            gray = {"fillcolor": "#808080", "opacity": 0.25, "line": {"width": 0}}
            shapes.append(_shape("rect", x.min(), x.max(), **gray))
    second = axes.xaxis.get_gid()
    return Plot(
        str(axes.get_label()) or axes.get_title(loc="left") or axes.get_title(),
        [*curves, *bars],
        [axes.get_xlabel(), axes.get_ylabel()],
        [_pair(axes.get_xlim()), _pair(axes.get_ylim())],
        [axes.get_xscale() == "log", axes.get_yscale() == "log"],
        float(second) if second else 0.0,
        axes.get_aspect() == 1.0,
        shapes,
        [_note(each) for each in axes.texts if each.get_transform() == axes.transData],
    )


def _collection(collection: Collection) -> Curve:
    from matplotlib.collections import PathCollection
    from matplotlib.colors import to_hex

    color = to_hex(np.asarray(collection.get_facecolor()).reshape(-1, 4)[0].tolist())
    dots = isinstance(collection, PathCollection)
    # An area none of which is finite has no outline.
    outlines = [np.empty((0, 2)), *(path.vertices for path in collection.get_paths())]
    rows = collection.get_offsets() if dots else np.concatenate(outlines)
    return Curve(_label(collection), [*np.asarray(rows, float).T], color, "dots" if dots else "fill")


def _line(line: Line2D) -> Curve:
    from matplotlib.colors import to_hex

    points = [np.asarray(each, float) for each in line.get_data(orig=True)]
    looks = {
        "dots": line.get_linestyle() == "None",
        "step": line.get_drawstyle() == "steps-post",
        "dash": line.is_dashed(),
        "line": True,
    }
    look = next(name for name, fits in looks.items() if fits)
    return Curve(_label(line), points, to_hex(line.get_color()), look)


def _bars(container: Any) -> Curve:
    from matplotlib.colors import to_hex

    patches = list(container)
    across = getattr(container, "orientation", "vertical") == "horizontal"
    x, y, width, height = np.array(
        [[each.get_x(), each.get_y(), each.get_width(), each.get_height()] for each in patches], float
    ).T
    colors = [to_hex(each.get_facecolor()) for each in patches]
    more = {"marker": {"color": colors}, "orientation": "h" if across else "v"}
    if across:
        more |= {"base": x.tolist(), "width": height.tolist()}
        points = [width, y + 0.5 * height]
    else:
        more |= {"base": y.tolist(), "width": width.tolist()}
        points = [x + 0.5 * width, height]
    # A histogram labels the first of its bars.
    return Curve(_label(container) or _label(patches[0]), points, colors[0], "bars", more)


def _shape(kind: str, first: float, last: float, **more: Any) -> dict[str, Any]:
    return {"type": kind, "x0": float(first), "x1": float(last), "y0": 0, "y1": 1, "yref": "paper", **more}


def _note(text: Text) -> dict[str, Any]:
    x, y = text.get_position()
    return {
        "text": text.get_text().replace("<", "&lt;"),
        "x": float(x),
        "y": float(y),
        "xanchor": str(text.get_horizontalalignment()),
        "showarrow": False,
    }


def _label(artist: Any) -> str:
    """Return the label that was given; those that matplotlib gives begin with "_"."""
    label = str(artist.get_label())
    return "" if label.startswith("_") else label


def _pair(limits: Sequence[float]) -> tuple[float, float]:
    return float(limits[0]), float(limits[1])
