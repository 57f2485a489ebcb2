"""`Report`: sections of text, figures and tables, written as one self-contained HTML file.

The file loads no script, font or picture from elsewhere, follows the reader's light or dark setting, and can be
printed. All text is escaped; figures are inserted unchanged. If plotly is installed, the page contains its script, and
each figure is interactive; with scripts off, and on paper, it is a static picture.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rb_dynamics.errors import needing
from rb_dynamics.formats.log_metadata import version
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.report.interactive_plots import EXTRA, Picture, encode, library

# All characters except text: those that HTML forbids, and marks that change the writing direction (202a.., 2066..).
_UNSHOWABLE = re.compile(
    "[^\t\n\x20-\x7e\xa0-\u2029\u202f-\u2065\u206a-\ud7ff\ue000-\ufdcf\ufdf0-\ufffd\U00010000-\U0001fffd]"
)


@dataclass(frozen=True)
class Figure:
    """A picture with a caption."""

    picture: Picture
    caption: str


@dataclass(frozen=True)
class Table:
    """Rows of text under a header; the first column is left-aligned, with `numeric` the others right-aligned."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: bool = True

    @classmethod
    def of(cls, rows: Sequence[Sequence[str]]) -> Table:
        """Return the table whose header is the first of `rows`."""
        return cls(rows[0], rows[1:])


@dataclass(frozen=True)
class Tile:
    """One number at a glance; `verdict` is "good", "bad" or "" if nothing is judged."""

    label: str
    value: str
    note: str = ""
    verdict: str = ""


@dataclass(frozen=True)
class Section:
    """One part of a report, shown in the order of the fields.

    Attributes:
        heading: also its entry in the table of contents.
        text: paragraphs, separated by empty lines.
        tiles: numbers at a glance.
        figures: below one another.
        lines: text to copy, each with a button for it.
        table: one table, or None.
        source: preformatted text, collapsed; "" for none.
        source_title: label to click on for `source`.
    """

    heading: str
    text: str = ""
    tiles: Sequence[Tile] = ()
    figures: Sequence[Figure] = ()
    lines: Sequence[str] = ()
    table: Table | None = None
    source: str = ""
    source_title: str = ""

    @property
    def paragraphs(self) -> list[str]:
        """`text`, split at empty lines."""
        return [part for part in re.split(r"\n\s*\n", self.text.strip()) if part]


@dataclass(frozen=True)
class Report:
    """A page: title, lead sentence, sections; `footer` names the program."""

    title: str
    lead: str
    sections: Sequence[Section] = field(default_factory=tuple)
    footer: str = ""


def made_by() -> str:
    """Return the name of the package, with its version if it is installed."""
    return f"rb_dynamics {version()}".removesuffix(" not installed")


def printable(text: object) -> str:
    """Return `text` with every character that is not a letter, mark or line break shown as its code point.

    Control characters are not allowed in HTML and affect a terminal; marks that change the writing direction mislead.
    """
    return _UNSHOWABLE.sub(lambda match: f"\\u{ord(match[0]):04x}", str(text))


def render_html(report: Report) -> str:
    """Return the page.

    Raises:
        MissingExtraError: jinja2 is not installed.
    """
    with needing("jinja2", "plot", "an HTML report"):
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
        from markupsafe import Markup
    folder = Path(__file__).parent / "templates"
    environment = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: printable(value) if type(value) is str else value,
    )
    pictures = [figure.picture for section in report.sections for figure in section.figures]
    script = library() if pictures else ""
    return environment.get_template("report.html.j2").render(
        report=report,
        page_script=Markup((folder / "page.js").read_text(encoding="utf-8")),
        plotly=Markup(script),
        plots=Markup(encode(pictures) if script else ""),
        static=f"The figures are pictures: install the extra '{EXTRA}' to zoom, read values and turn paths in them."
        if pictures and not script
        else "",
    )


def write_html(path: str | os.PathLike[str], report: Report) -> None:
    """Write `report` to `path`; missing folders are created.

    Raises:
        LogError: the file cannot be written.
        MissingExtraError: jinja2 is not installed.
    """
    page = render_html(report)
    with OutputFile.whole(Path(path)) as file:
        file.write(page.encode())
