"""Figures of a campaign: metrics over time, their distributions, and their sensitivities."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.report.interactive_plots import Picture, time_axis
from rb_dynamics.report.svg import COLORS, TEXT, picture, quiet, time_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Numbers = NDArray[np.float64]

BAD, ACCENT = COLORS[0], COLORS[2]
_WIDTH, _ROW = 690.0, 168.0
_MOST_POINTS = 1500
_BINS = 60


def over_time(time_s: Numbers, title: str, values: Numbers, failed: NDArray[np.bool_]) -> Picture:
    """Return the values (K, N) of N runs over time: median, the middle 90 %, and the failed runs."""
    second, unit = time_unit(float(time_s[-1] - time_s[0]))
    shown = time_s * second

    def plot(axes: Any) -> None:
        if not np.isfinite(values).any():
            _say_no_numbers(axes)
            return
        log = _is_wide(values)
        low, middle, high = np.full((3, len(values)), np.nan)
        some = ~np.isnan(values).all(axis=1)
        with np.errstate(invalid="ignore"):
            low[some], middle[some], high[some] = np.nanquantile(values[some], (0.05, 0.5, 0.95), axis=1)
        axes.fill_between(shown, low, high, color=ACCENT, alpha=0.25, linewidth=0, label="middle 90 %")
        for number, column in enumerate(values[:, failed].T[:8]):
            axes.plot(shown, column, color=BAD, linewidth=0.9, label=f"failed {number + 1}")
        axes.plot(shown, middle, color=ACCENT, linewidth=1.6, label="median")
        if log:
            axes.set_yscale("log")
        axes.set_xlabel(f"time [{unit}]", color=TEXT)
        axes.set_xlim(shown[0], shown[-1])
        time_axis(axes, second)

    return _draw([(title, plot)], f"{title} over time", 1)


def histograms(columns: Sequence[tuple[str, Numbers, NDArray[np.bool_], float | None]]) -> Picture:
    """Return a histogram for each (title, values, passed, limit)."""

    def panel(values: Numbers, passed: NDArray[np.bool_], limit: float | None) -> Callable[[Any], None]:
        def plot(axes: Any) -> None:
            shown = np.isfinite(values)
            if not shown.any():
                _say_no_numbers(axes)
                return
            edges = _edges(values[shown])
            parts, labels = [values[shown & passed], values[shown & ~passed]], ["passed", "failed"]
            axes.hist(parts, edges, stacked=True, color=[ACCENT, BAD], linewidth=0, label=labels)
            if edges[0] > 0.0 and not np.allclose(np.diff(edges), edges[1] - edges[0]):
                axes.set_xscale("log")
            if limit is not None:
                axes.axvline(limit, color=TEXT, linewidth=1.0, linestyle=(0, (4, 3)))
            axes.set_ylabel("runs", color=TEXT)

        return plot

    return _draw(
        [(title, panel(values, passed, limit)) for title, values, passed, limit in columns],
        "Histograms of the metrics",
        2,
    )


def sensitivities(metrics: Sequence[tuple[str, Sequence[tuple[str, float]], float]]) -> Picture:
    """Return for each (metric, [(input, rank correlation), ...], noise) bars of the strongest."""

    def panel(pairs: Sequence[tuple[str, float]], noise: float) -> Callable[[Any], None]:
        def plot(axes: Any) -> None:
            shown = list(pairs)[:6][::-1]
            if not shown:
                _say_no_numbers(axes)
                return
            places = np.arange(len(shown))
            sizes = [value for _, value in shown]
            axes.axvspan(-noise, noise, color="#808080", alpha=0.25, linewidth=0)
            axes.barh(places, sizes, 0.62, color=[ACCENT if value > 0.0 else COLORS[3] for value in sizes])
            for place, (name, value) in zip(places, shown, strict=True):
                side = "left" if value <= 0.0 else "right"
                axes.text(-0.03 if value > 0.0 else 0.03, place, _short(name), ha=side, va="center", color=TEXT)
            axes.set_yticks([])
            axes.set_xlim(-1.0, 1.0)
            axes.set_xlabel("rank correlation", color=TEXT)

        return plot

    panels = [(title, panel(pairs, noise)) for title, pairs, noise in metrics]
    return _draw(panels, "Rank correlation of inputs and metrics", 2)


def scatters(pairs: Sequence[tuple[str, str, Numbers, Numbers, NDArray[np.bool_]]]) -> Picture:
    """Return for each (input, metric, values, values, passed) one dot per run, up to a limit."""

    def panel(name: str, x: Numbers, y: Numbers, passed: NDArray[np.bool_]) -> Callable[[Any], None]:
        def plot(axes: Any) -> None:
            # Failed runs first: they are few, and of interest.
            order = np.argsort(passed, kind="stable")[:_MOST_POINTS]
            order = order[np.isfinite(y[order])]
            good = passed[order]
            # Few dots have to be seen, many must not hide each other.
            size = min(30.0, max(4.0, 2000.0 / max(1, len(order))))
            for chosen, look in (
                (good, {"label": "passed", "color": ACCENT, "s": size, "alpha": 0.55}),
                (~good, {"label": "failed", "color": BAD, "s": max(12.0, size), "alpha": 0.9}),
            ):
                axes.scatter(x[order][chosen], y[order][chosen], linewidths=0, **look)
            if len(order) and _is_wide(y[order]):
                axes.set_yscale("log")
            axes.set_xlabel(_short(name), color=TEXT)

        return plot

    panels = [(metric, panel(name, x, y, passed)) for name, metric, x, y, passed in pairs]
    return _draw(panels, "Each metric against its strongest input", 2)


def _draw(panels: Sequence[tuple[str, Callable[[Any], None]]], name: str, columns: int) -> Picture:
    columns = min(columns, len(panels))
    rows = math.ceil(len(panels) / columns)
    height = rows * (_ROW if columns > 1 else 190.0)

    def fill(figure: Figure, _most: int) -> None:
        for number, (title, plot) in enumerate(panels):
            axes = figure.add_subplot(rows, columns, number + 1)
            plot(axes)
            axes.set_title(title, loc="left", color=TEXT, fontsize=10.5)
            quiet(axes)

    titles = [title for title, _ in panels]
    return picture(fill, (_WIDTH, height), name, titles, layout="constrained", columns=columns)


def _say_no_numbers(axes: Any) -> None:
    axes.text(0.5, 0.5, "no numbers", transform=axes.transAxes, color=TEXT, ha="center")


def _is_wide(values: Numbers) -> bool:
    """Return whether positive values span orders of magnitude."""
    finite = values[np.isfinite(values)]
    return bool(len(finite) and finite.min() > 0.0 and np.quantile(finite, 0.98) > 50.0 * np.quantile(finite, 0.02))


def _edges(values: Numbers) -> Numbers:
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return np.array([low - 0.5 * (abs(low) or 1.0), low + 0.5 * (abs(low) or 1.0)])
    bins = min(_BINS, max(8, round(math.sqrt(len(values)))))
    edges: Numbers = np.geomspace(low, high, bins + 1) if _is_wide(values) else np.linspace(low, high, bins + 1)
    edges[0], edges[-1] = low, high
    return edges


def _short(name: str) -> str:
    """Return the last part of a dotted key, by which it is known."""
    for start in ("control.parameters.", "control.", "initial.", "body."):
        if name.startswith(start):
            return name.removeprefix(start)
    return name
