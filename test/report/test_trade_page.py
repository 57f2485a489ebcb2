"""The page of `trade` is well-formed and self-contained, shows every run once, and has legible figures."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="extra 'plot' is not installed")

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rb_dynamics.motion import METHODS
from rb_dynamics.report import trade_page
from rb_dynamics.report.html import render_html, write_html
from rb_dynamics.report.trade_page import trade_report, work_precision
from rb_dynamics.study.trade import Reference, Trade, TradeRow, recommend, with_front
from rb_dynamics.study.trade.result import Verdict

REFERENCE = Reference("taylor, accuracy 1e-13", "dop853, accuracy 1e-13", 1e-13, 2e-13, 3e-14, 1e-13, 7.0)


def row(method: str, step: float, error: float, time: float) -> TradeRow:
    within = error <= REFERENCE.error
    return TradeRow(
        method,
        step,
        None,
        error,
        error,
        error,
        error,
        within,
        1e-9,
        2e-9,
        -3e-9,
        time,
        1.0 / time,
        0.5 * time,
        100,
        None if method == "taylor" else 400,
        step < 0.3,
    )


def traded(scene: str = "scene.yaml", target: float | None = 1e-6, budget: float | None = None) -> Trade:
    """Return a trade of all methods, each with four runs; the later ones are slower."""
    rows = with_front(
        [
            row(method, 0.5**k, max(10.0 ** (1 - 4 * k), 1e-13), 1e-6 * (index + 1) * 3.0**k)
            for index, method in enumerate([*METHODS, "auto"])
            for k in range(4)
        ]
    )
    recommended = recommend(rows, target, budget)
    return Trade(
        scene,
        10.0,
        REFERENCE,
        rows,
        recommended,
        target,
        budget,
        {"rk4": "its time was up"},
        {"run_rk4": 2.0},
        ("a remark",),
        10.0,
        None,
    )


def parsed(found: Trade) -> ElementTree.Element:
    return ElementTree.fromstring(work_precision(found).svg)


def drawn(found: Trade) -> Axes:
    """Return the axes of the picture."""
    figure = Figure(figsize=(690.0 / 72.0, 510.0 / 72.0))
    trade_page._draw(figure, found)
    return figure.axes[0]


def texts(root: ElementTree.Element) -> list[str]:
    return [text.text or "" for text in root.iter("text")]


def test_page_is_well_formed_self_contained_and_complete(tmp_path: Path) -> None:
    found = traded('<script>"x"</script>')
    write_html(tmp_path / "trade.html", trade_report(found))
    page = (tmp_path / "trade.html").read_text(encoding="utf-8")

    root = ElementTree.fromstring(page.removeprefix("<!DOCTYPE html>"))
    assert not {"link", "img", "iframe"} & {element.tag for element in root.iter()}
    assert "http" not in page.replace(root.findtext(".//script[@id='plotly-script']", "") or "\0", "")
    assert not re.search(r"url\((?!#)", page)
    cells = ["".join(cell.itertext()) for cell in root.iter("td")]
    assert cells.count("rk4") == 4 + sum(one.method == "rk4" for one in found.front) + 1
    paragraphs = ["".join(paragraph.itertext()) for paragraph in root.iter("p")]
    assert found.recommended is not None
    assert [pre.text for pre in root.iter("pre")] == [found.recommended.solver]
    assert "A remark." in paragraphs
    assert any("compiled" in paragraph and ": 1, in 2 s" in paragraph for paragraph in paragraphs)
    assert cells.count("400") == sum(one.evaluations == 400 for one in (*found.rows, *found.front))
    assert any("dop853, accuracy 1e-13" in paragraph for paragraph in paragraphs)


def test_plot_has_every_run_once_every_method_in_the_legend_and_the_front_ringed() -> None:
    found = traded()
    root = parsed(found)
    titles = [title.text for title in root.iter("title")]
    assert len(titles) == len(set(titles)) == len(found.rows)
    for method in (*METHODS, "auto"):
        assert texts(root).count(method) == 1
    rings = [line for line in drawn(found).get_lines() if line.get_fillstyle() == "none"]
    assert sum(len(line.get_xdata()) for line in rings) == len(found.front) + 1


def test_the_plot_has_the_same_runs_as_the_picture() -> None:
    found = traded()
    plot = trade_page._plot(found)
    curves = {curve.label: curve.points for curve in plot.curves}
    rows = [curves.pop(method) for method in (*METHODS, "auto")]
    assert sum(len(points[0]) for points in rows) == len(found.rows)
    # What the caption names.
    assert [len(curves[name][0]) for name in ("front", "on the front", "recommended")] == [*[len(found.front)] * 2, 1]
    assert curves["error of the reference"][1].tolist() == [found.reference.error] * 2
    assert plot.log == (True, True)


def test_lines_run_from_slow_to_accurate_inside_the_axes() -> None:
    axes = drawn(traded())
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    curves = [line for line in axes.get_lines() if line.get_marker() in ("o", "s", "^") and len(line.get_xdata()) == 4]
    assert len(curves) == len(METHODS) + 1
    for curve in curves:
        points = list(zip(*curve.get_data(), strict=True))
        assert all(left <= x <= right and low <= y <= high for x, y in points)
        # Ten thousand times less error is lower, three times the time further right.
        assert all(a[0] < b[0] and a[1] > b[1] for a, b in itertools.pairwise(points))


def test_the_title_of_each_run_is_over_its_mark() -> None:
    found = traded()
    root = parsed(found)
    _, _, width, height = map(float, (root.get("viewBox") or "").split())
    figure = Figure(figsize=(width / 72.0, height / 72.0), dpi=72)
    trade_page._draw(figure, found)
    places = figure.axes[0].transData.transform(np.column_stack(trade_page._columns(found.rows)))
    titled = [(float(c.get("cx") or 0), height - float(c.get("cy") or 0)) for c in root.iter("circle")]
    np.testing.assert_allclose(titled, places, atol=0.1)


@pytest.mark.parametrize("target", [1e-6, 2e-13, 1e-13, 1e-15])
def test_no_name_is_drawn_over_another(target: float) -> None:
    """As for a free scene, where the closed form lies on the line of the reference."""
    fast = replace(row("exact", 1.0, 1e-13, 1e-8), step=None, front=True)
    found = traded(target=target)
    found = replace(found, rows=with_front([fast, *found.rows]), recommended=None)
    axes = drawn(found)
    names = {text.get_text() for text in axes.texts}
    assert {"the reference is good to here", f"asked for: {target:g}"} <= names
    # One for which there is no room is left out.
    assert ("exact, closed form" in names) is (target in (1e-6, 1e-15))
    for one, other in itertools.combinations((text.get_window_extent() for text in axes.texts), 2):
        assert not one.overlaps(other)


def test_what_was_asked_for_is_drawn() -> None:
    assert "asked for: 1e-06" in texts(parsed(traded()))
    assert "asked for: 50 x real time" in texts(parsed(traded(target=None, budget=50.0)))


def test_looks_of_methods_differ() -> None:
    looks = trade_page._looks([*METHODS, "auto"])
    assert len({repr(look) for look in looks.values()}) == len(looks)


def test_colours_can_be_read_on_light_and_on_dark() -> None:
    def luminance(color: str) -> float:
        parts = [int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    light, dark = luminance("#ffffff"), luminance("#12161c")
    for color in trade_page.COLORS:
        assert (light + 0.05) / (luminance(color) + 0.05) > 3.0
        assert (luminance(color) + 0.05) / (dark + 0.05) > 3.0


def test_a_trade_without_rows_says_why() -> None:
    bad = replace(REFERENCE, attitude=1.0, error=1.0)
    page = render_html(trade_report(replace(traded(), rows=(), recommended=None, reference=bad)))
    assert "nothing tells which is right" in page
    assert "<svg" not in page


def test_page_says_about_how_much_time_would_do() -> None:
    found = traded()
    assert found.recommended is not None
    taken = replace(found.recommended, whole=Verdict(5e-7, measured=False))
    page = render_html(trade_report(replace(found, whole=60.0, recommended=taken, enough_s=90.0)))
    assert "with about --time 90." in page
    assert f"of {len(METHODS)} methods and auto." in page


def test_one_row_can_be_drawn() -> None:
    found = traded()
    alone = replace(found, rows=found.rows[:1], recommended=None, target=1.0)
    assert len(list(parsed(alone).iter("title"))) == 1


@pytest.mark.parametrize(("measured", "says"), [(True, "after all 60 s"), (False, "after 10 s of 60 s only")])
def test_page_says_after_how_long_the_error_is(measured: bool, says: str) -> None:
    found = traded()
    assert found.recommended is not None
    whole = Verdict(5e-7, measured)
    page = render_html(trade_report(replace(found, whole=60.0, recommended=replace(found.recommended, whole=whole))))
    assert says in page
    assert f"after {60 if measured else 10} s of 60 s" in page
