"""Many logs in one command: which they are, one process per core, a row for each; bad files do not stop the others."""

from __future__ import annotations

import contextlib
import glob
import json
import re
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rb_dynamics.errors import LogError, RigidBodyError
from rb_dynamics.numerics.cores import cores

if TYPE_CHECKING:
    import argparse
    from concurrent.futures import Future, ProcessPoolExecutor

PASSED, FAILED, ERROR = "passed", "FAILED", "error"


@dataclass(frozen=True)
class Row:
    """The result for one log.

    Attributes:
        path: as given, or as found.
        verdict: `PASSED`, `FAILED`, or `ERROR` where it cannot be read.
        detail: why, in a line.
        facts: for JSON.
        cells: of a table, by the names of its columns.
    """

    path: str
    verdict: str
    detail: str
    facts: dict[str, Any] = field(default_factory=dict)
    cells: dict[str, str] = field(default_factory=dict)


def logs_of(given: Sequence[str]) -> list[str] | None:
    """Return every log that is named by files, bags, patterns and folders of them; None for one file or bag.

    Raises:
        LogError: a pattern fits nothing.
    """
    found: list[str] = []
    for each in given:
        names = [each]
        if glob.has_magic(each) and not Path(each).exists():
            names = sorted(glob.glob(each, recursive=True))
            if not names:
                raise LogError(f"found no file that fits {each}, expected some; check the pattern")
        for name in names:
            found += _below(Path(name)) if _collection(Path(name)) else [name]
    return None if len(found) == 1 and found == list(given) else list(dict.fromkeys(found))


def _is_bag(folder: Path) -> bool:
    """Return whether a folder is one bag: it has metadata, or its MCAP files differ in their numbers alone."""
    from rb_dynamics.formats.rosbag2_metadata import METADATA_FILE

    if (folder / METADATA_FILE).is_file():
        return True
    names = {re.sub(r"_\d+$", "", file.stem) for file in folder.glob("*.mcap")}
    return len(names) == 1


def _collection(path: Path) -> bool:
    """Return whether a path is a folder that is not a bag, but has some below."""
    return path.is_dir() and not _is_bag(path) and bool(_below(path))


def _below(folder: Path) -> list[str]:
    """Return the bags and logs below a folder, in order of their names."""
    found: list[str] = []
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            found += [str(path)] if _is_bag(path) else _below(path)
        elif path.suffix in (".mcap", ".db3"):
            found.append(str(path))
    return found


def report(
    args: argparse.Namespace, logs: Sequence[str], work: Callable[[str], Row], columns: Sequence[str], title: str
) -> int:
    """Print a row for each log, as a JSON list with --json, and write a page with --html.

    Args:
        args: with `json`, `html` and `jobs`.
        logs: the files and bags.
        work: makes a row; a function of a module, or a partial of one.
        columns: names of the cells of a row.
        title: of the page.

    Returns:
        0 if all pass, 2 if none can be read, else 1.
    """
    from rb_dynamics.cli import output

    rows, width = [], max(map(len, logs))
    if not args.json:
        output.say(f"{'':6}  {'log':{width}}{''.join(f'{name:>14}' for name in columns)}")
    with output.counting(title, "log", 0, len(logs)) as count:
        for row in each_of(logs, work, args.jobs):
            rows.append(row)
            count(len(rows), len(logs))
            if not args.json:
                cells = "".join(f"{row.cells.get(name, ''):>14}" for name in columns)
                output.say(f"{row.verdict:6}  {row.path:{width}}{cells}  {row.detail}".rstrip())
    if args.json:
        output.say(json.dumps([row.facts for row in rows], allow_nan=False))
    counts = {name: sum(row.verdict == name for row in rows) for name in (PASSED, FAILED, ERROR)}
    said = output.note_of(args)
    print(f"{len(rows)} logs: {', '.join(f'{n} {name}' for name, n in counts.items() if n)}", file=said)
    if args.html:
        from rb_dynamics.report.html import write_html
        from rb_dynamics.report.logs_page import logs_report

        lines = [(row.path, row.verdict, row.cells, row.detail) for row in rows]
        write_html(args.html, logs_report(title, columns, lines))
        print(f"wrote {args.html}", file=said)
    if counts[ERROR] == len(rows):
        return 2
    return 0 if counts[PASSED] == len(rows) else 1


def each_of(logs: Sequence[str], work: Callable[[str], Row], jobs: int | None = None) -> Iterator[Row]:
    """Yield what `work` makes of each log, in their order, from so many processes at a time.

    A process that dies, for lack of memory, loses only its own log.
    """
    safely = partial(_row, work)
    jobs = min(jobs or cores(), len(logs))
    if jobs == 1:
        yield from map(safely, logs)
        return
    waiting = list(logs)
    while waiting:
        with processes(jobs) as pool:
            futures = [pool.submit(safely, log) for log in waiting]
            done = 0
            for future in futures:
                row = _result(future)
                if row is None:
                    break
                done += 1
                yield row
        waiting = waiting[done:]
        if waiting:
            # One of those that ran is to blame: running the first alone shows whether it is that one.
            with processes(1) as pool:
                row = _result(pool.submit(safely, waiting[0]))
            yield row or _error(
                waiting[0], "the process that read it was killed, perhaps for lack of memory; try --jobs 1"
            )
            waiting = waiting[1:]


@contextlib.contextmanager
def processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Yield so many new processes, which end with an interrupt."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=_end_silently)
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _end_silently() -> None:
    """Let an interrupt, which a terminal sends to all processes, end this one without a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _result(future: Future[Row]) -> Row | None:
    from concurrent.futures.process import BrokenProcessPool

    try:
        return future.result()
    except BrokenProcessPool:
        return None


def _row(work: Callable[[str], Row], log: str) -> Row:
    try:
        return work(log)
    except RigidBodyError as error:
        return _error(log, str(error))
    except Exception as error:  # noqa: BLE001, whatever is wrong with one log stops no other
        return _error(log, f"{type(error).__name__}: {error}")


def _error(log: str, why: str) -> Row:
    return Row(log, ERROR, why.splitlines()[0].removeprefix(f"{log}: "), {"path": log, "passed": False, "error": why})
