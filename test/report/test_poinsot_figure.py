"""Poinsot's construction has a scale."""

from __future__ import annotations

import pytest

pytest.importorskip("matplotlib")
from matplotlib.figure import Figure

from rb_dynamics.report.poinsot_figure import scale_bar


@pytest.mark.parametrize(("extent", "length"), [(2.0, 0.5), (2.6, 1.0), (0.3, 0.1), (7e-3, 2e-3)])
def test_a_bar_of_a_round_length_stands_below_the_curves(extent: float, length: float) -> None:
    axes = Figure().add_subplot()
    axes.plot([-1.0, extent - 1.0], [-3.0, -3.0 + 0.5 * extent])
    scale_bar(axes, "rad/s")
    (left, right), (low, level) = axes.lines[1].get_data()
    assert right - left == pytest.approx(length)
    assert low == level == pytest.approx(-3.0 - 0.08 * extent)
    (text,) = axes.texts
    assert text.get_text() == f"{length:g} rad/s"


def test_the_point_of_a_steady_spin_has_no_bar() -> None:
    axes = Figure().add_subplot()
    axes.plot([0.0, 1e-16], [0.0, 0.0])
    scale_bar(axes, "rad/s")
    assert (len(axes.lines), len(axes.texts)) == (1, 0)
