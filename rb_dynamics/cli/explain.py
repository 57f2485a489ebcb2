"""Say what a scene models, what it leaves out and why, which solver runs it, what that costs and how wrong it is.

Cost and error are measured on the scene itself: it is run for about a second, and once more, finer, to compare with.
"""

from __future__ import annotations

import argparse

HELP = "say what a scene models, which solver runs it, its cost and error"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `explain`."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (YAML)")
    parser.add_argument("--wrench", metavar="BAG", help="MCAP bag with wrench commands to try the scene with")
    parser.add_argument("--json", action="store_true", help="print one JSON object, floats in full")


def run(args: argparse.Namespace) -> int:
    """Explain; exit code 0."""
    import json

    from rb_dynamics.explain import explain
    from rb_dynamics.scene import read_scene

    scene = read_scene(args.scene)
    commands = []
    if args.wrench:
        from rb_dynamics.recording.mcap_reader import read_wrenches

        commands = read_wrenches(args.wrench, [channel.topic for channel in scene.channels])
    explanation = explain(scene, commands)
    print(json.dumps(explanation.as_dict()) if args.json else explanation.as_text())
    return 0
