"""The log options of a command that runs a scene, and what happens if a log fails.

A log that fails stops on its own; the run continues.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from rb_dynamics.cli.parser import require_with
from rb_dynamics.numerics.command_line_numbers import real, whole

if TYPE_CHECKING:
    from rb_dynamics.sinks.failure_guard import GuardedSink

_SECONDS = real("a number of seconds, 0 or more", lambda v: v >= 0.0)


def add_log(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a log."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--mcap", metavar="F", default="", help="write the run as an MCAP log; an existing one is replaced"
    )
    where.add_argument(
        "--bag", metavar="DIR", default="", help="write it as a rosbag2 folder: MCAP files and metadata.yaml"
    )
    parser.add_argument(
        "--rerun",
        metavar="F",
        default="",
        help="write it as a Rerun recording; or show it in the viewer at rerun+http://HOST:PORT/proxy, or in a new one "
        "with spawn (extra: log)",
    )
    parser.add_argument(
        "--sink", action="append", default=[], metavar="NAME=TARGET",
        help="also write the run to another sink, such as that of a plug-in; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--max-bag-size",
        type=whole("a whole number of bytes, 0 or more", lambda v: v >= 0),
        default=0,
        metavar="BYTES",
        help="size at which --bag starts a new file",
    )
    parser.add_argument(
        "--max-bag-duration", type=_SECONDS, default=0.0, metavar="S", help="simulated time per file of --bag"
    )
    parser.add_argument(
        "--flush", type=_SECONDS, default=None, metavar="S",
        help="longest wall time of logged data that a kill can lose (default 0.5); 0: whole chunks only",
    )  # fmt: skip
    parser.add_argument("--accel", action="store_true", help="also log the acceleration of the body origin")
    parser.add_argument(
        "--verify", action="store_true", help="read the finished log back with the package mcap (extra: log)"
    )


def log_sinks(args: argparse.Namespace) -> list[GuardedSink]:
    """Return the requested logs; one that fails is reported on stderr, and the run continues without it.

    Raises:
        LogError: the arguments cannot be combined, or a log would replace an input of the run.
        PluginError: the plug-in of a sink cannot be loaded.
    """
    from rb_dynamics.formats.output_file import require_apart, require_other

    targets = (text.partition("=")[2] for text in args.sink)
    written = [*filter(None, (args.mcap, args.bag, args.rerun, args.html, *targets))]
    require_apart(written)
    for name in written:
        require_other(name, *filter(None, (args.scene, args.covariance, *args.wrench)))
    logged = any((args.mcap, args.bag, args.rerun, args.sink))
    for option, is_given in (("--flush", args.flush is not None), ("--accel", args.accel), ("--verify", args.verify)):
        require_with(args, option, is_given, "a log (--mcap, --bag or --rerun)", logged)
    for option, is_given in (("--max-bag-size", args.max_bag_size), ("--max-bag-duration", args.max_bag_duration)):
        require_with(args, option, is_given > 0, "--bag", args.bag)
    if not logged:
        return []
    from rb_dynamics.sinks.failure_guard import GuardedSink
    from rb_dynamics.sinks.log_options import LogOptions
    from rb_dynamics.sinks.mcap_sink import FLUSH_S, LogSettings

    settings = LogSettings(FLUSH_S if args.flush is None else args.flush, args.verify, args.accel)
    logs = LogOptions(args.mcap, args.bag, args.rerun, args.max_bag_size, args.max_bag_duration, settings, args.sink)
    return [GuardedSink(log, _warn, guard_open=False) for log in logs.sinks()]


def _warn(error: Exception) -> None:
    print(f"warning: a log has stopped, the run continues without it: {error}", file=sys.stderr)
