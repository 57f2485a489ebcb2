"""The rows of a campaign on disk: one Parquet file per block while it runs, and one file at the end.

A file is written under a temporary name, synced and then renamed, so every file on disk is complete. Only one process
at a time writes, and existing files are checked before they are used. The final file depends only on the campaign, not
on how its runs were divided, interrupted or ordered.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import weakref
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rb_dynamics.errors import LogError, needing
from rb_dynamics.formats.output_file import make_folder, renamed
from rb_dynamics.study.campaign.compatibility import Facts, check_same, facts_of
from rb_dynamics.study.campaign.lock import lock
from rb_dynamics.study.campaign.model import Campaign

if TYPE_CHECKING:
    from rb_dynamics.study.campaign.block_of_runs import Columns

ROWS = 1 << 16
"""Rows per row group of the final file, which bounds the memory needed to write it."""

_NO_ROWS = ", expected the rows of a campaign in Parquet; check the path"
_METADATA = b"rb_dynamics"
_ANEW = "give another file with --out, or --overwrite to start again"
_REMOVE = "remove the file, so that its runs are repeated"
_PART = re.compile(r"runs-(\d+)-(\d+)\.parquet")


class Store:
    """The rows of one campaign: `path` when it is complete, files in `path` + ".parts" before.

    It is locked for this process until it is closed or garbage-collected.
    """

    def __init__(self, path: str | os.PathLike[str], campaign: Campaign, overwrite: bool = False) -> None:
        """Open the store and check existing rows of the same campaign.

        Raises:
            LogError: existing rows belong to another campaign, are damaged, or are being written by another process, or
                the folder cannot be written.
            MissingExtraError: pyarrow is not installed.
        """
        self._parquet = _parquet()
        self.path, self._campaign = Path(path), campaign
        self._parts = Path(f"{self.path}.parts")
        make_folder(self.path)
        self._release = weakref.finalize(self, lock(self.path))
        try:
            if overwrite:
                self.path.unlink(missing_ok=True)
                shutil.rmtree(self._parts, ignore_errors=True)
            self.complete = False
            if self.path.exists():
                self._use_existing()
            else:
                self._begin()
        except OSError as error:
            self.close()
            raise LogError(
                f"cannot write {self._parts}: {error.strerror or error}; give another file with --out"
            ) from error
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Release the lock."""
        self._release()

    def _use_existing(self) -> None:
        """Use the file at `path`, which holds all runs; rows of a smaller campaign become a block of this one."""
        check_same(read_facts(self.path), self.path, self._campaign, _ANEW)
        runs = self._count_runs()
        self._check_not_more(runs, self.path)
        # A kill may have left the blocks that the file was made from.
        shutil.rmtree(self._parts, ignore_errors=True)
        self.complete = runs == self._campaign.runs
        if not self.complete:
            # Write the facts first: a kill between the two must not leave rows without facts.
            self._begin()
            os.replace(self.path, self._part(0, runs))

    def _count_runs(self) -> int:
        """Return how many runs the file at `path` holds, which must be the first ones, in order."""
        with _readable(self.path, _NO_ROWS):
            found = _table_in(self.path, columns=["run"])["run"].to_pylist()
        if found != list(range(len(found))):
            place, run = next((place, run) for place, run in enumerate(found) if run != place)
            raise LogError(
                f"{self.path} holds run {run} in row {place}, expected the runs 0 to {len(found) - 1} in order, as a "
                f"campaign writes them; put the file back as it was, or {_ANEW}"
            )
        return len(found)

    def _begin(self) -> None:
        self._parts.mkdir(exist_ok=True)
        facts = self._parts / "campaign.json"
        if facts.exists():
            check_same(_read_json(facts), self._parts, self._campaign, _ANEW)
        elif self._on_disk():
            raise LogError(f"found rows in {self._parts}, but no {facts.name} that says of which campaign; {_ANEW}")
        self._check_parts()
        self._check_not_more(max((last for _, last in self._on_disk()), default=0), self._parts)
        with renamed(facts) as new:
            new.write_text(json.dumps(facts_of(self._campaign)), encoding="utf-8")

    def _check_parts(self) -> None:
        """Check that each file holds the runs in its name, and that no run is in two files."""
        end, before = 0, None
        for first, last in self._on_disk():
            path = self._part(first, last)
            if first < end:
                raise LogError(
                    f"{before} and {path.name} in {self._parts} both hold run {first}; remove one of them, whose other "
                    f"runs are then flown again, or {_ANEW}"
                )
            rows, least, most = _runs_in(self._parquet, path)
            if (rows, least, most) != (last - first, first, last - 1):
                found = f"{rows} of the runs {least} to {most}" if rows else "no runs"
                raise LogError(
                    f"{path} holds {found}, expected all of {first} to {last - 1} as its name says; {_REMOVE}, or "
                    f"{_ANEW}"
                )
            end, before = last, path.name

    def _check_not_more(self, runs: int, place: Path) -> None:
        if runs > self._campaign.runs:
            raise LogError(
                f"{place} holds rows up to run {runs - 1} of this campaign, which has {self._campaign.runs} runs now; "
                f"give at least --runs {runs}, or {_ANEW}"
            )

    @property
    def done(self) -> int:
        """Number of runs whose rows are on disk."""
        return self._campaign.runs if self.complete else sum(last - first for first, last in self._on_disk())

    def missing(self, block: int) -> Iterator[tuple[int, int]]:
        """Yield (first, last + 1) of blocks of at most `block` runs that are not on disk, in order."""
        if self.complete:
            return
        runs = self._campaign.runs
        for (_, begin), (end, _) in pairwise([(0, 0), *self._on_disk(), (runs, runs)]):
            for first in range(begin, end, block):
                yield first, min(first + block, end)

    def write(self, columns: Columns) -> None:
        """Store the rows of a block.

        Raises:
            LogError: the rows cannot be written.
        """
        first, last = int(columns["run"][0]), int(columns["run"][-1]) + 1
        try:
            with renamed(self._part(first, last)) as new:
                self._parquet.write_table(self._table(columns), new, write_page_checksum=True)
        except OSError as error:
            raise LogError(
                f"cannot write to {self._parts}: {error.strerror or error}; make room and run again"
            ) from error

    def finish(self) -> None:
        """Merge all blocks into one file and remove them.

        Raises:
            LogError: the file cannot be written, or a block cannot be read or was removed.
        """
        if self.complete:
            return
        if (lost := next(self.missing(self._campaign.runs), None)) is not None:
            raise LogError(
                f"the rows of the runs {lost[0]} to {lost[1] - 1} were removed from {self._parts} after they were "
                "written; run the same command again, which flies them"
            )
        try:
            with renamed(self.path) as new:
                self._join(new)
        except OSError as error:
            raise LogError(f"cannot write {self.path}: {error.strerror or error}; make room and run again") from error
        self.complete = True
        shutil.rmtree(self._parts)

    def _join(self, target: Path) -> None:
        import pyarrow as pa

        writer, waiting = None, None
        for table in self._tables():
            waiting = table if waiting is None else pa.concat_tables([waiting, table])
            writer = writer or self._parquet.ParquetWriter(
                target, table.schema, compression="zstd", write_page_checksum=True
            )
            while waiting.num_rows >= ROWS:
                # As one chunk; otherwise the pages of the file would depend on the blocks.
                writer.write_table(waiting.slice(0, ROWS).combine_chunks(), ROWS)
                waiting = waiting.slice(ROWS)
        if writer is not None and waiting is not None:
            if waiting.num_rows:
                writer.write_table(waiting.combine_chunks(), ROWS)
            writer.close()

    def _tables(self) -> Iterator[Any]:
        """Yield all rows in order, at most one row group at a time: a block may be a whole campaign."""
        facts = {_METADATA: json.dumps(facts_of(self._campaign))}
        for first, last in self._on_disk():
            path = self._part(first, last)
            with _readable(path), self._opened(path) as file:
                for group in range(file.num_row_groups):
                    yield file.read_row_group(group).replace_schema_metadata(facts)

    def _opened(self, path: Path) -> Any:
        return self._parquet.ParquetFile(path, page_checksum_verification=True)

    def _table(self, columns: Columns) -> Any:
        import pyarrow as pa

        return pa.table({name: pa.array(column) for name, column in columns.items()})

    def _part(self, first: int, last: int) -> Path:
        return self._parts / f"runs-{first:012d}-{last:012d}.parquet"

    def _on_disk(self) -> list[tuple[int, int]]:
        matches = (_PART.fullmatch(path.name) for path in self._parts.iterdir())
        return sorted((int(match[1]), int(match[2])) for match in matches if match)


def read_rows(path: str | os.PathLike[str]) -> Columns:
    """Return the rows of a complete campaign: arrays by column name, and a list of texts for `error`.

    Raises:
        LogError: the file cannot be read.
        MissingExtraError: pyarrow is not installed.
    """
    with _readable(path, _NO_ROWS):
        table = _table_in(path)
    return {name: table[name].to_pylist() if name == "error" else table[name].to_numpy() for name in table.column_names}


def read_row(path: str | os.PathLike[str], run: int) -> dict[str, Any] | None:
    """Return the row of one run, wherever it is, None if there is none; reads only row groups that may have it.

    Raises:
        LogError: the file cannot be read.
        MissingExtraError: pyarrow is not installed.
    """
    with _readable(path, _NO_ROWS):
        rows: list[dict[str, Any]] = _table_in(path, filters=[("run", "==", run)]).to_pylist()
    return rows[0] if rows else None


def read_facts(path: str | os.PathLike[str]) -> Facts:
    """Return the facts stored with the rows of a campaign; empty if the file has none.

    Raises:
        LogError: the file cannot be read.
        MissingExtraError: pyarrow is not installed.
    """
    with _readable(path, ", expected the rows of a campaign; give another file with --out"):
        metadata = _parquet().read_schema(path).metadata or {}
        facts: Facts = json.loads(metadata.get(_METADATA, b"{}"))
    return facts


def _table_in(path: str | os.PathLike[str], **which: Any) -> Any:
    """Return the rows of a file, with the checksums of its pages verified; `which` columns or rows, by default all."""
    return _parquet().read_table(path, page_checksum_verification=True, **which)


def _read_json(path: Path) -> Facts:
    with _readable(path, f"; it is damaged, {_ANEW}"):
        facts: Facts = json.loads(path.read_text(encoding="utf-8"))
    return facts


def _runs_in(parquet: Any, path: Path) -> tuple[int, int, int]:
    """Return number, first and last of the runs in a block, from the column statistics of the file.

    Raises:
        LogError: the file cannot be read.
    """
    with _readable(path), parquet.ParquetFile(path) as file:
        column = file.schema_arrow.get_field_index("run")
        groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
        known = [group.column(column).statistics for group in groups if column >= 0]
        if not known or any(each is None or not each.has_min_max for each in known):
            raise ValueError("no runs in it")
        rows = sum(group.num_rows for group in groups)
        return rows, min(each.min for each in known), max(each.max for each in known)


@contextlib.contextmanager
def _readable(path: str | os.PathLike[str], rest: str = f"; it is damaged, {_REMOVE}, or {_ANEW}") -> Iterator[None]:
    """Turn an error in reading a file into a `LogError` that names it; `rest` ends the message."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise LogError(f"cannot read {path}: {' '.join(str(error).split()).rstrip('.')}{rest}") from error


def _parquet() -> Any:
    with needing("pyarrow", "scale", "a campaign"):
        from pyarrow import parquet
    return parquet
