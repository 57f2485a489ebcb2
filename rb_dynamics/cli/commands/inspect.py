"""Analyse a recorded run: states, momenta, energy, defects, wrenches, rates and gaps.

Works on logs of this package and on any ROS 2 bag of pose, twist, IMU, wrench or /tf; topics are found by type, or
named with --pose-topic and the like. A bag without mass properties gives motion and rates; with --scene also momenta
and energy, from the twist.

Several logs are read by as many processes as there are cores, and give one line each; --html is then one page of all.

Exit codes: 0 every check passed; 1 the log is incomplete, a defect is beyond --bound or --verify found a fault (the
last lines say which), or one of several logs cannot be read; 2 none can be read.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from rb_dynamics.cli.parser import add_many, add_window
from rb_dynamics.cli.topic_arguments import add_topics, chosen_topics
from rb_dynamics.numerics.command_line_numbers import real
from rb_dynamics.numerics.number_parsing import real_number

if TYPE_CHECKING:
    from rb_dynamics.analysis.bag_selection import Window
    from rb_dynamics.analysis.read_track import TopicChoice
    from rb_dynamics.cli.many_logs import Row
    from rb_dynamics.numerics.rotation import Quaternion

HELP = "analyse a recorded run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `inspect`."""
    add_many(parser, "log of a run, or any bag")
    parser.add_argument(
        "--html", metavar="F", help="write a report with figures (extra: plot); an existing one is replaced"
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="print the summary as one JSON object, of several logs a list; floats in full",
    )
    parser.add_argument("--video", metavar="F", help="write a video of the motion as .mp4 or .gif (extra: video)")
    parser.add_argument("--scene", metavar="SCENE", help="scene file whose body and frames belong to the bag")
    parser.add_argument(
        "--target",
        metavar="X,Y,Z,W",
        type=_attitude,
        help="attitude to point at, body to world: report the angle from it",
    )
    add_topics(parser)
    add_window(parser, "inspect")
    parser.add_argument(
        "--bound",
        type=real("a number greater than 0 such as 1e-6", lambda v: v > 0.0),
        metavar="REL",
        help="largest defect accepted, relative to the largest energy or momentum seen (default 1e-6)",
    )
    parser.add_argument(
        "--verify",
        action="store_true",
        help="also read the MCAP file with the package mcap (extra: log): checksums, index, counts, order",
    )


def run(args: argparse.Namespace) -> int:
    """Print the summary; exit code 0, or 1 if a check fails."""
    from functools import partial
    from pathlib import Path

    from rb_dynamics.analysis.checks import BOUND
    from rb_dynamics.analysis.inspection import inspect
    from rb_dynamics.cli import output
    from rb_dynamics.cli.many_logs import logs_of, report
    from rb_dynamics.errors import LogError
    from rb_dynamics.formats.mcap_integrity import require_library, verify_bag
    from rb_dynamics.report.inspection_text import as_text
    from rb_dynamics.scene import read_scene

    if args.verify:
        require_library("--verify")
    window = (args.from_s, args.to_s)
    bound, topics, logs = BOUND if args.bound is None else args.bound, chosen_topics(args), logs_of(args.log)
    output.prepare((args.html, args.video), *(logs or args.log), args.scene)
    if logs is not None:
        if args.video:
            args.parser.error(f"found --video for {len(logs)} logs, expected one; a video shows one log")
        if args.scene:
            read_scene(args.scene)
        work = partial(
            _row, scene=args.scene, bound=bound, topics=topics, verify=args.verify, window=window, target=args.target
        )
        return report(args, logs, work, _COLUMNS, "Inspected logs")
    if args.video:
        from rb_dynamics.report.video import require_format, write_video

        require_format(args.video)
    (log,) = args.log
    found = inspect(log, args.scene, bound, topics, window, args.target)
    output.show(args, found.as_dict, lambda: as_text(found.summary))
    if args.html:
        from rb_dynamics.report.run_page import run_report

        output.write_page(args, run_report(found.track, found.summary))
    if args.video:
        with output.progress(f"rendering {args.video}") as progress:
            frames = write_video(args.video, found.track, progress=progress)
        print(f"wrote {args.video}: {frames} frames", file=output.note_of(args))
    if args.verify:
        try:
            count = verify_bag(Path(log))
        except LogError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        said = f"verified with the package mcap: {count} messages, their checksums, index and order"
        print(said, file=output.note_of(args))
    return 0 if found.passed else 1


def _attitude(text: str) -> Quaternion:
    from rb_dynamics.numerics.argument_checks import quaternion

    try:
        return quaternion([real_number(part) for part in text.split(",")], "the attitude")
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected four numbers such as 0,0,0,1: {error}") from error


# The defects of energy and angular momentum are relative to the largest seen.
_COLUMNS = ("duration [s]", "samples", "T defect", "L defect", "warnings")


def _row(
    log: str,
    *,
    scene: str | None,
    bound: float,
    topics: TopicChoice,
    verify: bool,
    window: Window,
    target: Quaternion | None,
) -> Row:
    """Return the result for one of several logs."""
    from pathlib import Path

    from rb_dynamics.analysis.inspection import inspect
    from rb_dynamics.cli.many_logs import FAILED, PASSED, Row
    from rb_dynamics.errors import LogError
    from rb_dynamics.formats.mcap_integrity import verify_bag

    found = inspect(log, scene, bound, topics, window, target)
    summary = found.summary
    wrong = [f"{check.name}: {check.detail}" for check in summary.checks if not check.passed]
    facts = {"path": log} | found.as_dict()
    if verify:
        try:
            facts["verified_messages"] = verify_bag(Path(log))
        except LogError as error:
            wrong.append(str(error))
            facts |= {"passed": False, "verify_error": str(error)}
    balances = {name: summary.balance(name) for name in ("energy", "angular momentum")}
    energy, momentum = ("" if b is None else f"{b.relative:.2e}" for b in balances.values())
    cells = (f"{summary.duration_s:.6g}", str(summary.samples), energy, momentum, str(len(summary.warnings)))
    detail = "; ".join(wrong) or summary.reservation.removeprefix(", ")
    return Row(log, FAILED if wrong else PASSED, detail, facts, dict(zip(_COLUMNS, cells, strict=True)))
