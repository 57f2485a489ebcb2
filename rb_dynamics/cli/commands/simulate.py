"""Run a scene offline, without ROS, and print its final state.

Wrench commands come from ROS 2 bags (--wrench) whose WrenchStamped or Wrench topics have the names of the scene's
channels; without a bag the body coasts. The same commands through the node in lockstep give the same bits. A bag
without any command that acts is an error.

In place of a scene, a log of this package stands for its scene with its commands: simulate RUN.mcap gives the same
bits, and simulate RUN.mcap --set body.mass=17 shows what another mass would have done.

--sigma and --covariance show how an uncertainty of state and body grows along the flight, to first order, and how far
that is true. The names are mass, center_of_mass, inertia, initial.orientation (rad, a turn about body axes),
initial.angular_velocity_body, initial.position_world, initial.linear_velocity_world, wrench_scale.TOPIC, and numbers of
effects such as effects[0].rotation; one axis of them is named as in inertia.xx.
"""

from __future__ import annotations

import argparse

from rb_dynamics.cli.log_arguments import add_log, log_sinks
from rb_dynamics.cli.scene_arguments import add_scene, add_solver, add_wrench, read_with_commands

HELP = "run a scene offline and print its final state"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `simulate`."""
    add_scene(parser)
    add_wrench(parser)
    add_solver(parser)
    add_log(parser)
    parser.add_argument(
        "--sigma", action="append", default=[], metavar="NAME=VALUE",
        help="standard deviation of a number of state or body, in SI units, as in mass=0.1; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--covariance", metavar="FILE",
        help="standard deviations by name (YAML), or the output of identify --json, with its correlations",
    )  # fmt: skip
    parser.add_argument("--html", metavar="F", help="write a report (extras: log, plot)")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object, floats in full")


def run(args: argparse.Namespace) -> int:
    """Simulate and print; exit code 0, or 1 if a log failed."""
    import contextlib
    import tempfile
    from pathlib import Path

    from rb_dynamics.cli import output
    from rb_dynamics.run.simulate import simulate

    scene, commands = read_with_commands(args)
    spread = None
    if args.sigma or args.covariance:
        from rb_dynamics.study.covariance import covariance
        from rb_dynamics.study.uncertain_inputs import uncertain_numbers

        sigmas = dict(map(_sigma, args.sigma))
        uncertain_numbers(args.covariance, sigmas, scene)
    if not len(commands):
        output.note_coasting(scene)
    output.note_remarks(scene)
    with contextlib.ExitStack() as stack:
        mcap, outputs = args.mcap or args.bag, (args.mcap, args.bag, args.rerun, args.html)
        if (args.html or args.sigma or args.covariance) and not mcap:
            mcap = args.mcap = str(Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run.mcap")
        sinks = log_sinks(args)
        output.prepare([args.html])
        with output.progress(args.scene) as progress:
            result = simulate(scene, commands, sinks, progress, getattr(commands, "facts", None))
        output.warn_rejected(result, len(commands))
        for remark in result.remarks:
            output.note(remark)
        if args.sigma or args.covariance:
            spread = covariance(mcap, args.covariance, sigmas)
        output.show(args, lambda: output.as_dict(result, spread), lambda: output.as_text(result, spread))
        if args.html:
            from rb_dynamics.report.run_page import write_run_report

            write_run_report(mcap, args.html)
    if not args.json:
        for name in filter(None, outputs):
            print(output.written_page(name) if name == args.html else output.written(name))
    return 1 if any(sink.error for sink in sinks) else 0


def _sigma(text: str) -> tuple[str, object]:
    from rb_dynamics.errors import SceneError
    from rb_dynamics.formats.yaml.document import value_of

    name, equals, value = text.partition("=")
    if not (name and equals and value.strip()):
        raise SceneError(f"--sigma: found {text!r}, expected NAME=VALUE; write it as in mass=0.1")
    return name, value_of(value, f"--sigma {name}")
