"""Figures: thinning keeps their look; the SVG is small, reproducible and harmless."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from rb_dynamics.report import plots, svg

mpl = pytest.importorskip("matplotlib", reason="extra 'plot' is not installed")

TIME = np.linspace(0.0, 10.0, 20_001)
WAVE = np.stack([np.sin(TIME), np.cos(TIME), 0.1 * TIME], axis=1)


def texts(picture: str) -> list[str]:
    return ["".join(text.itertext()).strip() for text in ElementTree.fromstring(picture).iter("text")]


def test_thinning_keeps_a_single_peak_and_both_ends() -> None:
    values = np.sin(TIME)
    values[7_777], values[12_345] = 9.0, -9.0
    kept = svg.thin(values)
    assert len(kept) <= svg.MAX_POINTS
    assert {0, 7_777, 12_345, len(values) - 1} <= set(kept.tolist())
    assert (np.diff(kept) > 0).all()


def test_thinning_leaves_short_series_alone() -> None:
    assert svg.thin(np.arange(svg.MAX_POINTS, dtype=float)).tolist() == list(range(svg.MAX_POINTS))


def test_thinning_keeps_gaps() -> None:
    values = np.sin(TIME)
    values[5_000:9_000] = np.nan
    values[15_000] = np.nan
    shown = values[svg.thin(values)]
    assert np.isnan(shown).any()
    assert 15_000 in svg.thin(values)
    assert np.nanmax(shown) == np.nanmax(values)


def strokes(picture: str) -> int:
    """Return the number of path segments of the first line in a figure."""
    lines = [path for path in ElementTree.fromstring(picture).iter("path") if svg.COLORS[0] in path.get("style", "")]
    return lines[0].get("d", "").count("M")


@pytest.mark.parametrize("every", [1, 40])
@pytest.mark.parametrize("uneven", [0.0, 0.4])
def test_a_line_breaks_at_a_hole(every: int, uneven: float) -> None:
    time_s = TIME[::every] + uneven * TIME[every] * np.random.default_rng(1).random(len(TIME[::every]))
    there = (time_s < 4.0) | (time_s > 7.0)
    whole = plots.energy(time_s, np.sin(time_s)).svg
    broken = plots.energy(time_s[there], np.sin(time_s[there])).svg
    assert (strokes(whole), strokes(broken)) == (1, 2)


def test_the_same_numbers_give_the_same_bytes_and_settings_stay() -> None:
    before = dict(mpl.rcParams)
    mpl_style = {"axes.facecolor": "red", "font.size": 40.0}
    with mpl.rc_context(mpl_style):
        styled = plots.momenta(TIME, WAVE, WAVE).svg
        assert mpl.rcParams["font.size"] == 40.0
    assert plots.momenta(TIME, WAVE, WAVE).svg == styled
    assert dict(mpl.rcParams) == before


def test_svg_stands_alone() -> None:
    picture = plots.position_and_attitude(TIME, WAVE, np.column_stack([WAVE, TIME])).svg
    root = ElementTree.fromstring(picture)
    assert root.tag == "svg"
    assert root.get("viewBox")
    assert "http" not in picture
    assert root.find(".//style") is None
    assert root.find(".//metadata") is None
    for element in root.iter():
        assert element.get("href", "#").startswith("#")
    references = set(re.findall(r'href="#([^"]+)"', picture)) | set(re.findall(r"url\(#([^)]+)\)", picture))
    assert references <= set(re.findall(r'id="([^"]+)"', picture))
    assert len(picture) < 200_000


def test_figures_of_one_page_share_no_id() -> None:
    first, second = plots.momenta(TIME, WAVE, WAVE).svg, plots.rates_and_velocity(TIME, WAVE, WAVE).svg
    assert not set(re.findall(r' id="([^"]+)"', first)) & set(re.findall(r' id="([^"]+)"', second))


@pytest.mark.parametrize("title", ["$x_{", "_hidden", "<script>alert(1)</script>", "推力 🚀", 'a"b&c', "\x1b[31mred"])
def test_titles_and_labels_are_plain_text(title: str) -> None:
    lines = [svg.Line(title, TIME, TIME), svg.Line("other", TIME, 2 * TIME, dashed=True)]
    picture = svg.draw([svg.Panel(title, lines)], title).svg
    shown = title.replace("\x1b", "\\u001b")
    root = ElementTree.fromstring(picture)
    assert shown in texts(picture)
    assert any(shown in text and "other" in text for text in texts(picture))
    assert root.get("aria-label") == shown
    assert root.find(".//script") is None


def test_text_takes_the_colour_of_the_page() -> None:
    picture = plots.energy_defect(TIME, WAVE[:, 0], 1.0).svg
    assert "currentColor" in picture
    assert svg.TEXT not in picture
    assert "#ffffff" not in picture
    assert "#000000" not in picture


@pytest.mark.parametrize(
    "values",
    [np.full(50, 3.0), np.zeros(50), 1000.0 + 1e-9 * np.arange(50), np.full(50, np.nan), np.empty(0)],
    ids=["constant", "zero", "tiny change", "unknown", "empty"],
)
def test_any_series_can_be_drawn(values: np.ndarray) -> None:
    time_s = np.linspace(0.0, 1.0, len(values))
    for log in (False, True):
        picture = svg.draw([svg.Panel("any", [svg.Line("", time_s, values)], log)], "any").svg
        assert ElementTree.fromstring(picture).tag == "svg"


def test_comparison_is_logarithmic_and_shows_lengths() -> None:
    difference = np.outer(np.logspace(-15, -9, 200), [3.0, 0.0, 4.0])
    difference[0] = 0.0
    labels = texts(plots.comparison(np.arange(200.0), {"position [m]": difference}).svg)
    assert "position [m]" in labels
    # Which powers get a tick depends on the version of matplotlib.
    assert len([label for label in labels if label.startswith("1e\N{MINUS SIGN}")]) >= 3
    assert not [label for label in labels if label.startswith("$")]


@pytest.mark.parametrize(
    ("places", "labels"),
    [
        ([0.0, 0.5, 1.0], ["0", "0.5", "1"]),
        ([1000.0, 1000.0001, 1000.0002], ["1000", "1000.0001", "1000.0002"]),
        ([-2e-17, 0.0, 2e-17], ["\N{MINUS SIGN}2e\N{MINUS SIGN}17", "0", "2e\N{MINUS SIGN}17"]),
        ([20000.0, 40000.0, 60000.0], ["20000", "40000", "60000"]),
        ([0.25, 0.5, 0.75], ["0.25", "0.5", "0.75"]),
        ([2e9, 2.5e9, 3e9], ["2e9", "2.5e9", "3e9"]),
        ([2e-05, 4e-05], ["2e\N{MINUS SIGN}5", "4e\N{MINUS SIGN}5"]),
    ],
)
def test_ticks_have_the_digits_that_tell_them_apart(places: list[float], labels: list[str]) -> None:
    assert [svg.tick(place, places) for place in places] == labels


def test_steps_hold_to_the_end() -> None:
    line = svg.Line("", np.array([0.0, 1.0]), np.array([2.0, 5.0]), step=True)
    time_s, values = svg._points(line, log=False, end=3.0)
    assert time_s.tolist() == [0.0, 1.0, 3.0]
    assert values.tolist() == [2.0, 5.0, 5.0]


def test_quaternions_do_not_jump() -> None:
    angle = np.linspace(0.0, 20.0, 500)
    attitude = np.column_stack([np.sin(angle / 2), 0 * angle, 0 * angle, np.cos(angle / 2)])
    flipped = attitude * np.where(attitude[:, 3:] < 0.0, -1.0, 1.0)
    assert np.abs(np.diff(flipped, axis=0)).max() > 1.0
    np.testing.assert_allclose(plots.continuous(flipped), attitude, atol=1e-15)


def test_lines_of_one_panel_all_look_different() -> None:
    lines = [svg.Line(str(i), np.zeros(1), np.zeros(1)) for i in range(2 * len(svg.COLORS))]
    assert len(set(svg._looks(lines))) == len(lines)
    assert svg._looks([svg.Line("x", np.zeros(1), np.zeros(1), dashed=True)]) == [(svg.COLORS[0], True)]


@pytest.mark.parametrize(("count", "more"), [(2, 0), (12, 0), (30, 16)])
def test_a_legend_stands_on_the_left_below_its_title(count: int, more: int) -> None:
    time_s = np.linspace(0.0, 1.0, 3)
    lines = [svg.Line(f"wrench/{k} x", time_s, time_s) for k in range(count)]
    picture = svg.draw([svg.Panel("Force of each channel [N]", lines)], "forces").svg
    legend = " ".join(picture.split("\N{NO-BREAK SPACE}"))
    assert legend.count("wrench/") == count - more
    assert (f", and {more} more" in legend) is bool(more)
    rows = [text for text in ElementTree.fromstring(picture).iter("text") if len(text)]
    # A screen of 360 px shows 400 of the 690 units; a letter is about half as wide as it is high.
    assert all(row.get("x") == "2" and 0.5 * 9.5 * len("".join(row.itertext()).rstrip()) < 440.0 for row in rows)
    assert len({row.get("y") for row in rows}) == len(rows)


@pytest.mark.parametrize(
    ("end", "label", "tick"), [(7200.0, "time [s]", "2000"), (36000.0, "time [h]", "6"), (864000.0, "time [d]", "8")]
)
def test_long_axes_are_in_hours_and_days(end: float, label: str, tick: str) -> None:
    time_s = np.linspace(0.0, end, 50)
    picture = plots.energy(time_s, time_s)
    assert {label, tick} <= set(texts(picture.svg))
    (plot,) = picture.plots()
    assert plot.curves[0].points[0][-1] / plot.second == pytest.approx(end)


@pytest.mark.parametrize(
    ("size", "unit"), [(3e-15, "1e-16"), (4e-8, "1e-9"), (0.02, "1e-3"), (2.0, "1"), (0.0, "1e-16")]
)
def test_defects_are_relative_in_units_that_can_be_read(size: float, unit: str) -> None:
    picture = plots.energy_defect(np.arange(3.0), np.array([0.0, 5.0 * size, np.nan]), 5.0)
    assert f"Energy defect T − T₀ − W, relative to 5 J [{unit}]" in texts(picture.svg)
    (plot,) = picture.plots()
    assert plot.curves[0].points[1][1] * float(unit) == pytest.approx(size)


def test_a_defect_without_a_scale_is_shown_as_it_is() -> None:
    assert "Energy defect T − T₀ − W [J]" in texts(plots.energy_defect(np.arange(3.0), np.zeros(3), 0.0).svg)
