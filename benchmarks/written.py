"""Shared by the scripts that write pages: name of the machine, tables in Markdown, figures as SVG."""

from __future__ import annotations

import io
import platform
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path

from matplotlib import style
from matplotlib.figure import Figure


def processor() -> str:
    """Return the name of the processor."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def table(head: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> str:
    """Return a table; its first `words` columns are not numbers."""
    lines = [head, ["---"] * words + ["---:"] * (len(head) - words), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def wrapped(text: str) -> str:
    """Return Markdown with lines of at most 120 characters, except in tables, headings and pictures."""

    def lines(line: str) -> str:
        if len(line) <= 120 or line.startswith(("|", "#", "!")):
            return line
        begin = " " * (len(line) - len(line.lstrip()))
        rest = begin + "  " * line.lstrip().startswith("- ")
        return textwrap.fill(line, 120, subsequent_indent=rest, break_long_words=False, break_on_hyphens=False)

    return "\n".join(map(lines, text.split("\n")))


def svg(name: str, drawn: Figure) -> bytes:
    """Return a figure as SVG, the same bytes in every run; ids in it depend on `name`."""
    buffer = io.BytesIO()
    with style.context(["default", {"svg.hashsalt": name, "svg.fonttype": "path"}]):
        drawn.savefig(buffer, format="svg", facecolor="white", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
