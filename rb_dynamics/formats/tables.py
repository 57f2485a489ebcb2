"""Tables as CSV or Parquet files, written by columns in blocks of rows, with all digits."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from rb_dynamics.errors import LogError, needing
from rb_dynamics.formats.output_file import OutputFile, make_folder, renamed


@dataclass(frozen=True)
class Column:
    """One column: its name, what its cells are, and their unit as Parquet files have it in the metadata of a field."""

    name: str
    kind: Literal["real", "whole", "text"] = "real"
    unit: str = ""


Rows: TypeAlias = "Sequence[Sequence[Any] | None]"
"""A block of rows, column by column, of one length; None for a column without values, in a cell likewise."""


def write_table(path: Path, columns: Sequence[Column], blocks: Iterable[Rows]) -> int:
    """Write a table to `path`, .parquet or else CSV; returns the number of rows.

    Raises:
        LogError: the file cannot be written.
        MissingExtraError: a .parquet file without pyarrow.
    """
    return _write_parquet(path, columns, blocks) if path.suffix == ".parquet" else _write_csv(path, columns, blocks)


def _count(block: Rows) -> int:
    return next(len(column) for column in block if column is not None)


def _write_csv(path: Path, columns: Sequence[Column], blocks: Iterable[Rows]) -> int:
    count = 0
    with OutputFile.whole(path) as file:
        file.write((",".join(column.name for column in columns) + "\n").encode())
        for block in blocks:
            rows = _count(block)
            cells = [itertools.repeat("", rows) if column is None else _cells(column) for column in block]
            text = "".join(",".join(row) + "\n" for row in zip(*cells, strict=True))
            file.write(text.encode("utf-8", "replace"))
            count += rows
    return count


def _cells(column: Sequence[Any]) -> Iterable[str]:
    values = column.tolist() if hasattr(column, "tolist") else column
    return map(_cell, values)


def _cell(value: object) -> str:
    if isinstance(value, str):
        quoted = value.replace('"', '""')
        return f'"{quoted}"' if set(value) & set('",\r\n') else value
    return "" if value is None else repr(value)


def _write_parquet(path: Path, columns: Sequence[Column], blocks: Iterable[Rows]) -> int:
    with needing("pyarrow", "log", "writing a .parquet file"):
        import pyarrow as pa  # type: ignore[import-untyped,import-not-found,unused-ignore]
        from pyarrow import parquet
    types = {"real": pa.float64(), "whole": pa.int64(), "text": pa.string()}
    units = [{"unit": column.unit} if column.unit else None for column in columns]
    fields = [
        pa.field(column.name, types[column.kind], metadata=unit) for column, unit in zip(columns, units, strict=True)
    ]
    schema, count = pa.schema(fields), 0
    make_folder(path)
    try:
        with renamed(path) as new, parquet.ParquetWriter(new, schema) as writer:
            for block in blocks:
                rows = _count(block)
                arrays = [
                    pa.nulls(rows, field.type) if column is None else pa.array(column, field.type)
                    for column, field in zip(block, schema, strict=True)
                ]
                writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
                count += rows
    except OSError as error:
        raise LogError(f"cannot write {path}: {error}; free space or give another file") from error
    return count
