"""Write a log in another format, chosen by the name of OUT: a Rerun recording, a CSV or a Parquet table, or its scene.

A table has one line per logged sample, with all digits; the wrench commands go to a second file, with .wrenches before
the ending of OUT. The scene is the text in the log, which can be run again or edited. A CSV of wrenches (time_ns or
time_s, force_x ... torque_z, and topic and frame_id if needed) becomes an MCAP bag for simulate --wrench. Bags of other
programs are not converted. An earlier OUT is replaced.
"""

from __future__ import annotations

import argparse

HELP = "write a log as .rrd, .csv or .parquet, its scene as .yaml, or a .csv of wrenches as .mcap"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `convert`."""
    parser.add_argument("source", metavar="IN", help="log of a run (file or rosbag2 folder), or .csv of wrenches")
    parser.add_argument("target", metavar="OUT", help="name that ends in .rrd, .csv, .parquet, .yaml or .mcap")


def run(args: argparse.Namespace) -> int:
    """Convert; exit code 0."""
    from pathlib import Path

    from rb_dynamics.errors import LogError
    from rb_dynamics.sinks import convert

    source, target = Path(args.source), Path(args.target)
    way = ("table" if source.suffix == ".csv" else "log", target.suffix)
    if way in (("log", ".csv"), ("log", ".parquet")):
        written = convert.log_to_table(source, target)
    elif way == ("log", ".rrd"):
        written = [(target, convert.log_to_rerun(source, target))]
    elif way in (("log", ".yaml"), ("log", ".yml")):
        convert.log_to_scene(source, target)
        print(f"wrote {target}: the scene of {source}")
        return 0
    elif way == ("table", ".mcap"):
        written = [(target, convert.table_to_bag(source, target))]
    else:
        raise LogError(
            f"cannot convert {source.name} to {target.name}, expected a log to .rrd, .csv, .parquet or .yaml, or a "
            ".csv of wrenches to .mcap; give OUT such an ending"
        )
    for path, count in written:
        print(f"wrote {path}: {count} {'commands' if path != target or way[0] == 'table' else 'samples'}")
    return 0
