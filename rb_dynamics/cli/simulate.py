"""Run a scene offline, without ROS, and print its final state.

Wrench commands come from ROS 2 bags (--wrench) whose WrenchStamped or Wrench topics have the names of the scene's
channels; without a bag the body coasts. The same commands through the node in lockstep give the same bits. A bag
without any command that acts is an error.

In place of a scene, a log of this package stands for its scene with its commands: simulate RUN.mcap gives the same
bits, and simulate RUN.mcap --set body.mass=17 shows what another mass would have done.
"""

from __future__ import annotations

import argparse

from rb_dynamics.cli.logs import add_log, log_sinks
from rb_dynamics.cli.scene import add_scene, add_solver, add_wrench, read_with_commands

HELP = "run a scene offline and print its final state"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `simulate`."""
    add_scene(parser)
    add_wrench(parser)
    add_solver(parser)
    add_log(parser)
    parser.add_argument("--html", metavar="F", help="write a report (extras: log, plot)")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object, floats in full")


def run(args: argparse.Namespace) -> int:
    """Simulate and print; exit code 0, or 1 if a log failed."""
    import contextlib
    import tempfile
    from pathlib import Path

    from rb_dynamics.cli import output
    from rb_dynamics.formats.log_file import make_folder
    from rb_dynamics.run.simulation import simulate

    scene, commands = read_with_commands(args)
    if not len(commands):
        output.note_coasting(scene)
    with contextlib.ExitStack() as stack:
        mcap, outputs = args.mcap or args.bag, (args.mcap, args.bag, args.rerun, args.html)
        if args.html and not mcap:
            mcap = args.mcap = str(Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run.mcap")
        sinks = log_sinks(args)
        if args.html:
            make_folder(Path(args.html))
        with output.progress(args.scene) as progress:
            result = simulate(scene, commands, sinks, progress, getattr(commands, "facts", None))
        output.warn_rejected(result, len(commands))
        print(output.as_json(result) if args.json else output.as_text(result), flush=True)
        if args.html:
            from rb_dynamics.report.run_page import write_run_report

            write_run_report(mcap, args.html)
    for written in outputs:
        if written and not args.json:
            print(output.written(written))
    return 1 if any(sink.error for sink in sinks) else 0
