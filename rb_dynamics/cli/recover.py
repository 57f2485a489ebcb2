"""Save what can be read of a log that was cut off or damaged: by a kill, a full disk, a lost power supply.

Writes a whole MCAP file, with index and statistics, that opens everywhere; the damaged one stays as it is. A folder
gives a rosbag2 folder with metadata.yaml.

Exit codes: 0 done, and nothing is missing but the end; 1 damaged pieces were left out (the lines say which); 2 nothing
could be read.
"""

from __future__ import annotations

import argparse
import sys

HELP = "save what can be read of a log that was cut off"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `recover`."""
    parser.add_argument("source", metavar="IN", help="MCAP file, or a folder of them")
    parser.add_argument("target", metavar="OUT", help="the file or folder to write; an earlier one is replaced")


def run(args: argparse.Namespace) -> int:
    """Recover and say what was found; exit code 0, 1 where something within the file is lost, 2 where all of it is."""
    from pathlib import Path

    from rb_dynamics.recording.recover import recover

    saved = recover(Path(args.source), Path(args.target))
    for each in saved:
        file = each.file
        state = "whole" if each.complete else "cut off or damaged"
        print(f"{file.name}: {file.counts.total()} messages up to {file.end_ns / 1e9:.9g} s; the file was {state}")
        for piece in each.damage:
            print(f"  left out: {piece}")
    print(f"wrote {args.target}")
    if not all(each.complete for each in saved) and not any(each.file.counts.total() for each in saved):
        print(
            f"rb-dynamics: found no whole message in {args.source}, expected at least one before it was cut off or "
            "damaged; record it again",
            file=sys.stderr,
        )
        return 2
    return 1 if any(each.damage for each in saved) else 0
