"""Run a scene offline, without ROS, and print its final state.

The wrench commands come from a ROS 2 MCAP bag (--wrench) whose WrenchStamped or Wrench topics carry the names of the
scene's channels; without one the body coasts. The same commands through the node in lockstep give the same bits.
"""

from __future__ import annotations

import argparse

HELP = "run a scene offline and print its final state"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `simulate`."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (YAML)")
    parser.add_argument("--wrench", metavar="BAG", help="MCAP bag with wrench commands; each takes effect at its stamp")
    parser.add_argument("--duration", type=float, metavar="S", help="length of the run in s, instead of the scene's")
    parser.add_argument("--method", metavar="M", help="method of integration, instead of the scene's")
    steps = parser.add_mutually_exclusive_group()
    steps.add_argument("--step", type=float, metavar="S", help="fixed step in s")
    steps.add_argument("--accuracy", type=float, metavar="A", help="accepted error at the end, in rad; sets the steps")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE",
        help="another value for any key of the scene, such as body.mass=2 or effects=[]; may be given again",
    )  # fmt: skip
    parser.add_argument("--mcap", metavar="F", help="write the run as an MCAP log (extra: log)")
    parser.add_argument("--rerun", metavar="F", help="write the run as a Rerun recording (extra: log)")
    parser.add_argument("--html", metavar="F", help="write a report (extras: log, plot)")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object, floats in full")


def run(args: argparse.Namespace) -> int:
    """Simulate and print; exit code 0."""
    import contextlib
    import tempfile
    from pathlib import Path

    from rb_dynamics.cli import output
    from rb_dynamics.recording.sink import Sink
    from rb_dynamics.scene import read_scene
    from rb_dynamics.simulate import simulate

    given = {
        **dict(map(_override, args.set)),
        "duration": args.duration,
        "solver.method": args.method,
        "solver.step": args.step,
        "solver.accuracy": args.accuracy,
    }
    scene = read_scene(args.scene, {key: value for key, value in given.items() if value is not None})
    commands = []
    if args.wrench:
        from rb_dynamics.recording.mcap_reader import read_wrenches

        commands = read_wrenches(args.wrench, [channel.topic for channel in scene.channels])
        output.warn_outside(commands, scene)
    with contextlib.ExitStack() as stack:
        mcap = args.mcap
        if args.html and not mcap:
            mcap = str(Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run.mcap")
        sinks: list[Sink] = []
        if mcap:
            from rb_dynamics.recording.mcap_sink import McapSink

            sinks.append(McapSink(mcap))
        if args.rerun:
            from rb_dynamics.recording.rerun_sink import RerunSink

            sinks.append(RerunSink(args.rerun))
        with output.progress(args.scene) as progress:
            result = simulate(scene, commands, sinks, progress)
        output.warn_rejected(result, len(commands))
        if args.html:
            from rb_dynamics.report.run import write_run_report

            write_run_report(mcap, args.html)
    print(output.as_json(result) if args.json else output.as_text(result))
    for written in (args.mcap, args.rerun, args.html):
        if written and not args.json:
            print(f"wrote {written}")
    return 0


def _override(text: str) -> tuple[str, object]:
    """Return key and value of KEY=VALUE, the value read as in a scene file.

    Raises:
        SceneError: there is no key, or the value cannot be read.
    """
    from rb_dynamics.errors import SceneError
    from rb_dynamics.scene.document import value_of

    key, equals, value = text.partition("=")
    if not (key and equals):
        raise SceneError(f"--set: found {text!r}, expected KEY=VALUE such as body.mass=2")
    return key, value_of(value, f"--set {key}")
