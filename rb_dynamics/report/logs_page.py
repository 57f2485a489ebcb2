"""The page of many logs: how many passed, and a row for each, the bad ones first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rb_dynamics.report.html import Report, Section, Table, Tile, made_by

Line = tuple[str, str, Mapping[str, str], str]
"""Path, verdict, cells by column, detail."""


def logs_report(title: str, columns: Sequence[str], lines: Sequence[Line]) -> Report:
    """Return the page; `columns` are the names of the cells."""
    good = [line for line in lines if line[1] == "passed"]
    bad = [line for line in lines if line[1] != "passed"]
    tiles = [
        Tile("logs", str(len(lines))),
        Tile("passed", str(len(good)), verdict="good" if not bad else ""),
        Tile("failed or not readable", str(len(bad)), verdict="bad" if bad else ""),
    ]
    sections = [Section("Result", tiles=tiles)]
    for heading, part in (("Failed", bad), ("Passed", good)):
        if part:
            rows = [
                [path, verdict, detail, *(cells.get(name, "") for name in columns)]
                for path, verdict, cells, detail in part
            ]
            header = ["log", "result", "remarks", *columns]
            sections.append(Section(heading, table=Table(header, rows, numeric=False)))
    lead = "all passed" if not bad else f"{len(bad)} of {len(lines)} failed or cannot be read"
    return Report(title, f"{len(lines)} logs: {lead}.", sections, made_by())
