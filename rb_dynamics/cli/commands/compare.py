"""Compare two flights: logs of this package, bags of other programs, or a scene simulated under the commands of a bag.

  compare A.mcap B.mcap              two recordings
  compare BAG BAG --pose-topic /odom --pose-topic /mocap   two topics of one bag
  compare SCENE.yaml BAG             the scene, simulated under the commands of BAG, against the motion in BAG
  compare BAG --scene SCENE          likewise; with two recordings, --scene gives body and frames of bags without them

Times are aligned by the commands if one was simulated under those of the other, else by stamps if the recordings then
overlap, else by the lag that fits best, with its uncertainty; it is an error if no lag is certain. Values are compared
at common stamps, or interpolated, never across a gap.

Exit codes: 0 compared; 1 a difference of attitude, position or velocities is beyond --bound, or less than --share of
the time is compared; 2 nothing to compare.
"""

from __future__ import annotations

import argparse
from decimal import Decimal

from rb_dynamics.cli.parser import add_window
from rb_dynamics.cli.scene_arguments import add_start_and_topics, mapping_of
from rb_dynamics.cli.topic_arguments import add_topics, topics_of_two
from rb_dynamics.numerics.command_line_numbers import real

HELP = "compare two flights, or a scene with a recording"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `compare`."""
    parser.add_argument("a", metavar="A", help="log of a run, bag of pose, twist or wrench, or scene file")
    parser.add_argument("b", metavar="B", nargs="?", help="the same; default: the scene of --scene")
    parser.add_argument("--scene", metavar="SCENE", help="body and frames of bags; simulated in place of a missing B")
    parser.add_argument(
        "--align", type=_align, metavar="start|stamp|SECONDS",
        help="start: the motions begin together; stamp: one clock; SECONDS: time of B minus time of A",
    )  # fmt: skip
    parser.add_argument(
        "--bound", type=_bound, metavar="X|NAME=X,...",
        help="largest difference accepted in attitude (rad), position (m) and velocities (rad/s, m/s); or of some of "
        "them, as in attitude=0.01,position=0.05 (also angular_velocity, linear_velocity)",
    )  # fmt: skip
    parser.add_argument(
        "--share", type=real("a number from 0 to 1", lambda v: 0.0 <= v <= 1.0), default=0.0, metavar="X",
        help="least fraction, 0 to 1, of the longer recording, within --from and --to, that must be compared",
    )  # fmt: skip
    add_window(parser, "compare")
    add_start_and_topics(parser, "for a simulated scene: ")
    add_topics(parser, "; given twice: of A and of B")
    parser.add_argument(
        "--html", metavar="F", help="write a page with both motions and their differences (extra: plot)"
    )
    parser.add_argument(
        "--rerun",
        metavar="F",
        default="",
        help="write both bodies as a Rerun recording, or show them in a viewer (extra: log)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object, floats in full")


def _bound(text: str) -> float | dict[str, float]:
    from rb_dynamics.analysis.recording_differences import MOTION

    if "=" not in text:
        return real("a number, 0 or more, or names and numbers such as attitude=0.01,position=0.05", _accepts)(text)
    bounds: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = (word.strip() for word in part.partition("="))
        if name not in MOTION or name in bounds:
            raise argparse.ArgumentTypeError(f"found {name!r} in {text!r}, expected each of {', '.join(MOTION)} once")
        bounds[name] = real("a number, 0 or more", _accepts)(value)
    return bounds


def _accepts(bound: float) -> bool:
    return bound >= 0.0


def run(args: argparse.Namespace) -> int:
    """Compare and print; exit code 0, or 1 beyond the bound or below the share."""
    from rb_dynamics.cli import output
    from rb_dynamics.report.comparison_text import as_text
    from rb_dynamics.study.compare import compare

    output.prepare((args.html, args.rerun), args.a, args.b, args.scene)
    found = compare(
        args.a,
        args.b,
        scene=args.scene,
        align=args.align,
        bound=args.bound,
        share=args.share,
        start_s=args.from_s,
        end_s=args.to_s,
        wrench_start="auto" if args.wrench_start is None else args.wrench_start,
        mapping=mapping_of(args),
        topics=topics_of_two(args),
    )
    output.show(args, found.as_dict, lambda: as_text(found))
    if args.html:
        from rb_dynamics.report.comparison_page import comparison_report

        output.write_page(args, comparison_report(found))
    if args.rerun:
        from rb_dynamics.report.comparison_rerun import write_comparison_recording

        write_comparison_recording(found, args.rerun)
        print(output.written(args.rerun), file=output.note_of(args))
    return 0 if found.passed else 1


def _align(text: str) -> str | Decimal:
    if text in ("start", "stamp"):
        return text
    real("start, stamp or a number of seconds", lambda value: abs(value) < 2.0**33)(text)
    # In exact decimals: a float would lose nanoseconds of a wall clock.
    return Decimal(text)
