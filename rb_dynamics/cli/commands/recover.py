"""Save what can be read of a log that was cut off or damaged by a kill, a full disk or a power failure.

Writes a complete MCAP file, with index and statistics, that other tools can open; the damaged file is not changed. A
folder gives a rosbag2 folder with metadata.yaml.

Times are counted from the first message, as in inspect.

Exit codes: 0 success, nothing is missing except the end; 1 damaged pieces were left out, or a file before the last is
missing (see the output); 2 nothing could be read.
"""

from __future__ import annotations

import argparse

HELP = "save what can be read of a log that was cut off"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `recover`."""
    parser.add_argument("source", metavar="IN", help="MCAP file, or a folder of them")
    parser.add_argument("target", metavar="OUT", help="the file or folder to write; an existing one is replaced")


def run(args: argparse.Namespace) -> int:
    """Recover and report; exit code 0, or 1 if data before the end are lost."""
    from pathlib import Path

    from rb_dynamics.formats.recovery import recover
    from rb_dynamics.numerics.nanoseconds import seconds_text

    saved = recover(Path(args.source), Path(args.target))
    starts = (each.file.start_ns for each in saved if each.file.counts.total())
    start_ns = min(starts, default=0)
    for each in saved:
        file = each.file
        for name in each.absent_before:
            print(f"{name} is missing")
        begin, end = ((time_ns - start_ns) * 1e-9 for time_ns in (file.start_ns, file.end_ns))
        span = f" from t = {begin:.9g} to {end:.9g} s" if file.counts.total() else ""
        print(f"{file.name}: {file.counts.total()} messages{span}; the file was {each.state}")
        if each.unchecked:
            print("  its writer left out checksums: whether messages were changed or hidden cannot be known")
        for piece in each.damage:
            print(f"  {piece}")
        for begin_ns, end_ns in each.missing:
            begin, end = ((time_ns - start_ns) * 1e-9 for time_ns in (begin_ns, end_ns))
            print(f"  missing: t = {begin:.9g} to {end:.9g} s")
        if each.unplaced:
            print("  messages may be missing of which no time is known")
    if saved[-1].next_file:
        print(f"  the next file, {saved[-1].next_file}, is missing")
    since = f"; t counts from the first message, log time {seconds_text(start_ns)} s" if start_ns else ""
    print(f"wrote {args.target}{since}")
    return 1 if any(each.damage or each.absent_before for each in saved) else 0
