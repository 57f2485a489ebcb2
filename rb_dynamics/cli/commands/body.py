"""Show the mass properties of a scene's body: principal axes and moments, radii of gyration, inertia ellipsoid.

Warns of suspicious values: inertia about the origin, products of inertia of the wrong sign, numbers in the wrong order,
moments at the limit of what is possible, a wrong unit; and of an initial rotation close to the intermediate principal
axis, which is unstable. Give --mesh to compare the inertia with that of a shape.
"""

from __future__ import annotations

import argparse

from rb_dynamics.cli.parser import require_with
from rb_dynamics.cli.scene_arguments import add_scene, read
from rb_dynamics.numerics.command_line_numbers import real

HELP = "show the mass properties of a scene's body"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `body`."""
    add_scene(parser)
    parser.add_argument(
        "--axis", nargs=3, type=real("a finite number"), metavar=("X", "Y", "Z"),
        help="also print the moment of inertia and radius of gyration about this direction (body axes)",
    )  # fmt: skip
    parser.add_argument(
        "--through", nargs=3, type=real("a finite number"), metavar=("X", "Y", "Z"),
        help="a point of that axis (m, from the body origin); default: the centre of mass",
    )  # fmt: skip
    parser.add_argument(
        "--mesh", metavar="FILE", help="compare with this closed mesh (STL, OBJ, PLY) of uniform density"
    )
    parser.add_argument(
        "--scale",
        type=real("a number greater than 0", lambda v: v > 0.0),
        metavar="S",
        help="m per unit of the mesh (default 1); 0.001 for mm",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object, floats in full")


def run(args: argparse.Namespace) -> int:
    """Print the mass properties; exit code 0."""
    import json
    from dataclasses import asdict

    from rb_dynamics.body.inertia_quantities import AxisProperties, MassProperties

    require_with(args, "--through", bool(args.through), "--axis", args.axis)
    require_with(args, "--scale", args.scale is not None, "--mesh", args.mesh)
    scene = read(args)
    noticed = [*scene.findings]
    if args.mesh:
        from rb_dynamics.body.mesh import read_solid
        from rb_dynamics.body.plausibility import compare

        noticed += compare(scene.body, read_solid(args.mesh, args.scale or 1.0))
    properties = MassProperties.of(scene.body, scene.initial.angular_velocity_body, noticed)
    through = tuple(args.through) if args.through else None
    axis = AxisProperties.of(scene.body, tuple(args.axis), through) if args.axis else None
    if args.json:
        print(json.dumps(properties.as_dict() | ({"axis": asdict(axis)} if axis else {})))
    else:
        print(properties.as_text() + (f"\n\n{axis.as_text()}" if axis else ""))
    return 0
