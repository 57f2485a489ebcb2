"""Print what a scene models, what it leaves out and why, which solver runs it, its cost and its error.

Cost and error are measured: the scene is run for about a second, and once more by another method to compare with. The
error is that at the end if there is time, or else after the time printed with it. Give the commands of --wrench to
measure with them; without a bag the channels are tried with a probe.
"""

from __future__ import annotations

import argparse

from rb_dynamics.cli.scene_arguments import add_scene, add_solver, add_wrench, listed, read_with_commands

HELP = "print what a scene models, which solver runs it, its cost and error"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `explain`."""
    add_scene(parser)
    add_solver(parser)
    add_wrench(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object, floats in full")


def run(args: argparse.Namespace) -> int:
    """Explain; exit code 0."""
    import json

    from rb_dynamics.study.explain import explain

    scene, commands = read_with_commands(args)
    explanation = explain(scene, listed(commands))
    print(json.dumps(explanation.as_dict()) if args.json else explanation.as_text())
    return 0
