"""The page is well-formed and self-contained, and escapes text."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from rb_dynamics.errors import LogError
from rb_dynamics.report import html, svg
from rb_dynamics.report.html import Figure, Report, Section, Table, Tile, printable, render_html, write_html

HOSTILE = "<script>alert('1')</script>\"><img src=x onerror=alert(2)>&amp;{{ 7*7 }}\x1b[31m\x00\u202e]]>"


def assert_self_contained(page: str) -> None:
    root = ElementTree.fromstring(page.removeprefix("<!DOCTYPE html>"))
    assert not {"link", "iframe", "img", "object", "embed", "base"} & {element.tag for element in root.iter()}
    for element in root.iter():
        assert not {name for name in element.attrib if name.startswith("on") or name == "src"}
        assert element.get("href", "#").startswith("#")
    # plotly.js, compressed, is letters without meaning.
    packed = root.findtext(".//script[@id='plotly-script']", "")
    assert "http" not in page.replace(packed or "\0", "")
    assert "@import" not in page
    assert not re.search(r"url\((?!#)", page)
    ids = re.findall(r'\sid="([^"]+)"', page)
    assert len(ids) == len(set(ids))


def example(text: str) -> Report:
    time_s = np.linspace(0.0, 1.0, 20)
    figure = Figure(svg.draw([svg.Panel(text, svg.components(time_s, np.eye(20)))], text), text)
    section = Section(
        heading=text,
        text=f"{text}\n\n{text}",
        tiles=[Tile(text, text, text, "good")],
        figures=[figure],
        table=Table([text, text], [[text, text]]),
        source=text,
        source_title=text,
    )
    return Report(text, text, [section, Section("empty"), Section("table", table=Table(["", ""], [["a", "b"]]))], text)


@pytest.mark.parametrize("text", ["plain", HOSTILE, "推力 🚀 é"])
def test_page_is_well_formed_and_self_contained(text: str) -> None:
    assert_self_contained(render_html(example(text)))


def test_cells_of_a_wide_table_have_the_heads_of_their_columns_for_a_phone() -> None:
    for count, wide in ((2, False), (3, True)):
        heads = ["", *(f"head {k}" for k in range(1, count))]
        page = render_html(Report("r", "", [Section("s", table=Table(heads, [["name", *map(str, range(1, count))]]))]))
        root = ElementTree.fromstring(page.removeprefix("<!DOCTYPE html>"))
        (table,) = root.iter("table")
        assert ("wide" in table.get("class", "").split()) is wide
        assert [cell.get("data-head", "") for cell in table.iter("td")] == heads


def test_without_plotly_the_page_is_static_and_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    with_it = render_html(example("plain"))
    monkeypatch.setattr(html, "library", lambda: "")
    page = render_html(example("plain"))
    assert_self_contained(page)
    assert 'id="plot-data"' not in page
    assert len(page) < 40_000
    footer = ElementTree.fromstring(page.removeprefix("<!DOCTYPE html>")).findtext(".//footer", "")
    assert "install the extra 'interactive'" in footer
    pytest.importorskip("plotly", reason="extra 'interactive' is not installed")
    assert 'id="plot-data"' in with_it
    assert "the extra" not in with_it


def test_lines_to_copy_are_kept_as_they_are() -> None:
    line = "solver: {method: rk4, step: 0.01}  # <b>"
    root = ElementTree.fromstring(render_html(Report("t", "l", [Section("s", lines=[line])])).partition("\n")[2])
    assert [pre.text for pre in root.iter("pre") if pre.get("class") == "copy"] == [line]


def test_hostile_text_is_shown_as_text() -> None:
    page = render_html(example(HOSTILE))
    root = ElementTree.fromstring(page.removeprefix("<!DOCTYPE html>"))
    shown = HOSTILE.replace("\x1b", "\\u001b").replace("\x00", "\\u0000").replace("\u202e", "\\u202e")
    for tag in ("title", "h1", "h2", "p", "dt", "figcaption", "th", "td", "summary", "pre", "footer"):
        element = root.find(f".//{tag}")
        assert element is not None
        # Without plotly the footer goes on.
        assert "".join(element.itertext()).startswith(shown)


def test_printable_keeps_letters_of_every_script_and_line_breaks() -> None:
    assert printable("é 推 🚀\n\tx") == "é 推 🚀\n\tx"
    assert printable("a\x07\x9b\u2066b\ud800") == "a\\u0007\\u009b\\u2066b\\ud800"


def test_page_follows_light_and_dark_and_prints() -> None:
    page = render_html(Report("t", "l"))
    assert "prefers-color-scheme: dark" in page
    assert "@media print" in page


def test_file_is_utf8_and_folders_are_made(tmp_path: Path) -> None:
    target = tmp_path / "new" / "run.html"
    write_html(target, Report("推力", "lead"))
    assert "推力" in target.read_text(encoding="utf-8")


def test_unwritable_file_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"cannot write .*expected the name of a file"):
        write_html(tmp_path, Report("t", "l"))
