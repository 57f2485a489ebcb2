"""Plots that answer when touched have the numbers of the pictures, and nothing in them is markup."""

from __future__ import annotations

import base64
import gzip
import json
import re
from typing import Any

import numpy as np
import pytest

from rb_dynamics.report import campaign_figures, interactive_plots, plots, svg
from rb_dynamics.report.path_figure import path_in_space

pytest.importorskip("matplotlib", reason="extra 'plot' is not installed")

TIME = np.linspace(0.0, 10.0, 301)
WAVE = np.stack([np.sin(TIME), np.cos(TIME), 0.1 * TIME], axis=1)
STILL = np.tile([0.0, 0.0, 0.0, 1.0], (len(TIME), 1))


def decoded(data: dict[str, Any], place: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(data["arrays"][place]), "<f8")


def test_a_plot_has_every_sample_to_the_last_bit_and_time_once() -> None:
    data = json.loads(interactive_plots.encode([plots.momenta(TIME, WAVE, 2.0 * WAVE)]))
    (figure,) = data["figures"]
    angular, linear = figure["plots"]
    assert [curve["label"] for curve in angular["curves"]] == ["x", "y", "z"]
    assert angular["second"] == 1.0
    for plot, factor in ((angular, 1.0), (linear, 2.0)):
        for curve, column in zip(plot["curves"], factor * WAVE.T, strict=True):
            assert decoded(data, curve["points"][0]).tolist() == TIME.tolist()
            assert decoded(data, curve["points"][1]).tolist() == column.tolist()
    assert len(data["arrays"]) == 7


def test_long_series_are_thinned_but_less_than_in_the_picture() -> None:
    time_s = np.linspace(0.0, 10.0, 50_000)
    noise = np.random.default_rng(1).normal(size=len(time_s))
    (plot,) = plots.energy(time_s, noise).plots()
    shown, values = plot.curves[0].points
    assert svg.MAX_POINTS < len(shown) <= svg.MOST_TOUCHED
    assert set(zip(shown, values, strict=True)) <= set(zip(time_s, noise, strict=True))


def test_steps_dashes_holes_and_logarithms_are_kept() -> None:
    (plot,) = plots.wrench_history([("Force [N]", np.array([0.0, 1.0]), np.eye(3)[:2])], np.array([0.0, 4.0])).plots()
    assert {curve.look for curve in plot.curves} == {"step"}
    assert plot.curves[0].points[0].tolist() == [0.0, 1.0, 4.0]
    (plot,) = plots.energy(TIME, WAVE[:, 0], WAVE[:, 0]).plots()
    assert [curve.look for curve in plot.curves] == ["line", "dash"]
    there = (TIME < 4.0) | (TIME > 7.0)
    (plot,) = plots.energy(TIME[there], WAVE[there, 0]).plots()
    assert np.isnan(plot.curves[0].points[1]).sum() == 1
    (plot,) = plots.comparison(TIME, {"x": TIME}).plots()
    assert plot.log == [False, True]


@pytest.mark.parametrize("text", ["</script><b>", "a & b", "\x1b\u202e"])
def test_names_are_no_markup(text: str) -> None:
    figure = svg.draw([svg.Panel(text, [svg.Line(text, TIME, TIME), svg.Line("y", TIME, TIME)])], "any")
    encoded = interactive_plots.encode([figure])
    assert not set("<>&") & set(encoded)
    assert encoded.isascii()
    assert json.loads(encoded)["figures"][0]["plots"][0]["title"] == text


def test_the_name_of_a_metric_is_no_markup_at_an_axis() -> None:
    picture = interactive_plots.Picture("", lambda: [interactive_plots.Plot("", [], ["r<b>te</b>", "s"])])
    assert json.loads(interactive_plots.encode([picture]))["figures"][0]["plots"][0]["axes"] == [
        "r&lt;b>te&lt;/b>",
        "s",
    ]


def test_figures_of_a_campaign_can_be_read() -> None:
    values = np.linspace(1.0, 2.0, 40)
    passed = values < 1.8
    (histogram,) = campaign_figures.histograms([("settling [s]", values, passed, 1.8)]).plots()
    assert [(curve.label, curve.look) for curve in histogram.curves] == [("passed", "bars"), ("failed", "bars")]
    assert sum(curve.points[1].sum() for curve in histogram.curves) == len(values)
    assert [shape["x0"] for shape in histogram.shapes] == [1.8]
    (bars,) = campaign_figures.sensitivities([("settling", [("body.mass", 0.5), ("control.gain", -0.2)], 0.1)]).plots()
    assert sorted(bars.curves[0].points[0].tolist()) == [-0.2, 0.5]
    assert [(shape["x0"], shape["x1"]) for shape in bars.shapes] == [(-0.1, 0.1)]
    assert {note["text"] for note in bars.notes} == {"mass", "gain"}
    (bars,) = campaign_figures.sensitivities([("never settled", [], 0.1)]).plots()
    assert bars.curves == []
    (dots,) = campaign_figures.scatters([("body.mass", "settling [s]", values, 2.0 * values, passed)]).plots()
    assert [len(curve.points[0]) for curve in dots.curves] == [passed.sum(), (~passed).sum()]
    (over,) = campaign_figures.over_time(
        TIME, "rate", np.tile(TIME, (4, 1)).T + np.arange(4.0), np.eye(4)[0] > 0
    ).plots()
    assert [(curve.label, curve.look) for curve in over.curves] == [
        ("middle 90 %", "fill"),
        ("failed 1", "line"),
        ("median", "line"),
    ]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("runs", [5, 4, 1])
def test_a_quantity_that_is_no_number_in_some_or_all_runs_is_drawn_as_far_as_it_is_one(value: float, runs: int) -> None:
    values = np.tile(TIME, (5, 1)).T.copy()
    values[:, :runs] = value
    over = campaign_figures.over_time(TIME, "distance [m]", values, np.eye(5)[4] > 0)
    json.loads(interactive_plots.encode([over]))
    (plot,) = over.plots()
    assert bool(plot.curves) == (runs < 5)
    for curve in plot.curves:
        if curve.label == "failed 1":
            assert curve.points[1].tolist() == TIME.tolist()


def test_positions_far_from_zero_count_from_where_their_motion_is_seen() -> None:
    far = WAVE + np.array([369_644.7, 3_280_417.0, 0.0])
    (path,) = path_in_space([("A", TIME, far, STILL)]).plots()  # type: ignore[union-attr]
    place = next(curve for curve in path.curves if curve.label == "A")
    assert "less (369" in path.title
    assert max(float(np.abs(each).max()) for each in place.points) < 10.0
    assert "less (369" in plots.position_and_attitude(np.arange(float(len(far))), far, STILL).svg
    (near,) = path_in_space([("A", TIME, WAVE, STILL)]).plots()  # type: ignore[union-attr]
    assert "less" not in near.title


@pytest.mark.parametrize("axis", range(3))
def test_the_title_of_a_straight_path_is_at_the_left_and_the_letters_are_below_it(axis: int) -> None:
    found = path_in_space([("A", TIME, np.outer(TIME, np.eye(3)[axis]), STILL)])
    assert found is not None
    texts = re.findall(r'x="([\d.]+)" y="([\d.]+)"[^>]*>([^<]*)</text>', found.svg)
    at = {text[:4]: (float(x), float(y)) for x, y, text in texts}
    assert at["Path"][0] < 60.0
    assert all(at[letter][1] > at["Path"][1] + 10.0 for letter in "xyz")


def test_a_path_in_space_has_the_positions_and_the_body_axes() -> None:
    found = path_in_space([("A", TIME, WAVE, STILL), ("B", TIME, WAVE + 1.0, STILL)])
    assert found is not None
    (plot,) = found.plots()
    curves = {curve.label: np.column_stack(list(curve.points)) for curve in plot.curves}
    np.testing.assert_array_equal(curves["A"], WAVE)
    np.testing.assert_array_equal(curves["start of B"], WAVE[:1] + 1.0)
    foot, tip, gap = curves["body y"][:3]
    np.testing.assert_allclose((tip - foot) / np.linalg.norm(tip - foot), [0.0, 1.0, 0.0], atol=1e-12)
    assert np.isnan(gap).all()
    assert "1 m long" in found.svg


def test_no_path_crosses_a_gap() -> None:
    """Neither where messages are missing nor where a position is unknown; however the samples are thinned."""
    long = np.arange(100_000) * 1e-3
    position = np.stack([np.sin(long), np.cos(long), long], axis=1)
    still = np.tile([0.0, 0.0, 0.0, 1.0], (len(long), 1))
    there = (long < 30.0) | (long > 31.0)
    position[(long > 60.0) & (long < 60.01)] = np.nan
    (plot,) = path_in_space([("A", long[there], position[there], still[there])]).plots()  # type: ignore[union-attr]
    z = next(curve for curve in plot.curves if curve.label == "A").points[2]
    holes = np.flatnonzero(np.isnan(z))
    np.testing.assert_allclose(np.stack([z[holes - 1], z[holes + 1]]), [[29.999, 60.0], [31.001, 60.01]], atol=1e-6)
    assert len(z) < 3 * svg.MAX_POINTS
    assert any(curve.label == "body x" for curve in plot.curves)


@pytest.mark.parametrize(
    "position", [np.zeros((5, 3)), np.full((5, 3), np.nan), np.full((5, 3), 1e6), np.zeros((0, 3))]
)
def test_what_does_not_move_has_no_path(position: np.ndarray) -> None:
    assert path_in_space([("A", TIME[: len(position)], position, STILL[: len(position)])]) is None


def test_the_library_is_plotly_compressed_and_always_the_same() -> None:
    pytest.importorskip("plotly", reason="extra 'interactive' is not installed")
    packed = interactive_plots.library()
    assert b"Plotly" in gzip.decompress(base64.b64decode(packed))[:300]
    assert len(packed) < 2_500_000
    interactive_plots.library.cache_clear()
    assert interactive_plots.library() == packed
