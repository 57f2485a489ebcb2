"""The log of a command that runs a scene: where it goes, how it is kept, and what happens if it fails.

A failing log stops itself and not the run.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from rb_dynamics.cli.parser import require_with
from rb_dynamics.numerics.option_types import real, whole

if TYPE_CHECKING:
    from rb_dynamics.recording.failure_guard import GuardedSink

_SECONDS = real("a number of seconds, 0 or more", lambda v: v >= 0.0)


def add_log(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a log."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--mcap", metavar="F", default="", help="write the run as an MCAP log; an earlier one is replaced"
    )
    where.add_argument(
        "--bag", metavar="DIR", default="", help="write it as a rosbag2 folder: MCAP files and metadata.yaml"
    )
    parser.add_argument(
        "--rerun",
        metavar="F",
        default="",
        help="write it as a Rerun recording, or show it in the viewer at rerun+http://HOST:PORT/proxy (extra: log)",
    )
    parser.add_argument(
        "--sink", action="append", default=[], metavar="NAME=TARGET",
        help="tell the run to a sink by name, such as one of a plug-in; may be given again",
    )  # fmt: skip
    parser.add_argument(
        "--max-bag-size",
        type=whole("a whole number of bytes, 0 or more", lambda v: v >= 0),
        default=0,
        metavar="BYTES",
        help="size at which --bag begins the next file",
    )
    parser.add_argument(
        "--max-bag-duration", type=_SECONDS, default=0.0, metavar="S", help="simulated time in one file of --bag"
    )
    parser.add_argument(
        "--flush", type=_SECONDS, default=None, metavar="S",
        help="wall time after which what was logged survives a kill (default 0.5); 0: whole chunks only",
    )  # fmt: skip
    parser.add_argument("--accel", action="store_true", help="log the acceleration of the body origin too")
    parser.add_argument(
        "--verify", action="store_true", help="read the finished log again with the package mcap (extra: log)"
    )


def log_sinks(args: argparse.Namespace) -> list[GuardedSink]:
    """Return the logs that are asked for; one that fails says so on stderr, and the run goes on without it.

    Raises:
        LogError: the arguments do not go together, or a log would replace what the run reads.
        PluginError: a sink is of a plug-in that cannot be loaded.
    """
    from rb_dynamics.formats.log_file import require_apart, require_other

    targets = (text.partition("=")[2] for text in args.sink)
    written = [*filter(None, (args.mcap, args.bag, args.rerun, args.html, *targets))]
    require_apart(written)
    for name in written:
        require_other(name, *filter(None, (args.scene, *args.wrench)))
    logged = any((args.mcap, args.bag, args.rerun, args.sink))
    for option, is_given in (("--flush", args.flush is not None), ("--accel", args.accel), ("--verify", args.verify)):
        require_with(args, option, is_given, "a log (--mcap, --bag or --rerun)", logged)
    for option, is_given in (("--max-bag-size", args.max_bag_size), ("--max-bag-duration", args.max_bag_duration)):
        require_with(args, option, is_given > 0, "--bag", args.bag)
    if not logged:
        return []
    from rb_dynamics.recording.failure_guard import GuardedSink
    from rb_dynamics.recording.log_outputs import Logs
    from rb_dynamics.recording.mcap_sink import FLUSH_S, LogSettings

    settings = LogSettings(FLUSH_S if args.flush is None else args.flush, args.verify, args.accel)
    logs = Logs(args.mcap, args.bag, args.rerun, args.max_bag_size, args.max_bag_duration, settings, args.sink)
    return [GuardedSink(log, _warn, guard_open=False) for log in logs.sinks()]


def _warn(error: Exception) -> None:
    print(f"warning: a log has stopped, the run goes on without it: {error}", file=sys.stderr)
