"""The figure of what a run costs."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import pytest

pytest.importorskip("matplotlib")
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def test_a_legend_stands_below_its_curves(script: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch) -> None:
    # The script sets it for its own measurements.
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    figure = Figure(figsize=(8.4, 9.4), layout="constrained")
    series = {name: {1.0: 1.0 + k, 10.0: 2.0} for k, name in enumerate(("exact", "rkmk4", "auto", "compiled"))}
    script("scaling").plot(figure, 1, "Duration", series, "simulated time, s", "time, s")
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    legend = axes.get_legend()
    assert legend is not None
    assert legend.get_window_extent().y1 < axes.xaxis.label.get_window_extent().y0
