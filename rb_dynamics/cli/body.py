"""Show the mass properties of a scene's body: principal axes and moments, radii of gyration, inertia ellipsoid.

Warns where the initial spin is close to the middle principal axis, about which no spin is stable.
"""

from __future__ import annotations

import argparse

HELP = "show the mass properties of a scene's body"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `body`."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (YAML)")
    parser.add_argument("--json", action="store_true", help="print one JSON object, floats in full")


def run(args: argparse.Namespace) -> int:
    """Print the mass properties; exit code 0."""
    import json

    from rb_dynamics.body.properties import MassProperties
    from rb_dynamics.scene import read_scene

    scene = read_scene(args.scene)
    properties = MassProperties.of(scene.body, scene.initial.angular_velocity_body)
    print(json.dumps(properties.as_dict()) if args.json else properties.as_text())
    return 0
