"""Analyse a recorded run: states, momenta, energy, defects, wrenches, rates and gaps.

Works on logs of this package and on any ROS 2 bag of pose, twist, IMU, wrench or /tf; topics are found by type, or
named with --pose-topic and the like. A bag without mass properties gives motion and rates; with --scene also momenta
and energy, from the twist.

Exit codes: 0 every check passed; 1 the log is incomplete, a defect is beyond --bound or --verify found a fault (the
last lines say which); 2 the file cannot be read.
"""

from __future__ import annotations

import argparse
import sys

from rb_dynamics.cli.topics import add_topics, chosen_topics
from rb_dynamics.numerics.option_types import real

HELP = "analyse a recorded run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `inspect`."""
    parser.add_argument("log", metavar="RUN.mcap", help="log of a run, or a bag of pose, twist and wrench")
    parser.add_argument(
        "--html", metavar="F", help="write a report with figures (extra: plot); an existing one is replaced"
    )
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON object, floats in full")
    parser.add_argument("--video", metavar="F", help="write a video of the motion as .mp4 or .gif (extra: video)")
    parser.add_argument("--scene", metavar="SCENE", help="scene file whose body and frames belong to the bag")
    add_topics(parser)
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
    import json
    from pathlib import Path

    from rb_dynamics.analysis.checks import BOUND
    from rb_dynamics.analysis.inspection import inspect
    from rb_dynamics.cli import output
    from rb_dynamics.errors import LogError
    from rb_dynamics.formats.log_file import make_folder, require_apart, require_other
    from rb_dynamics.formats.mcap_integrity import require_library, verify_bag
    from rb_dynamics.report.text import as_text

    if args.verify:
        require_library("--verify")
    require_apart(filter(None, (args.html, args.video)))
    for written in filter(None, (args.html, args.video)):
        require_other(written, *filter(None, (args.log, args.scene)))
        make_folder(Path(written))
    found = inspect(args.log, args.scene, BOUND if args.bound is None else args.bound, chosen_topics(args))
    encoding = sys.stdout.encoding or "utf-8"
    text = json.dumps(found.as_dict(), allow_nan=False) if args.json else as_text(found.summary)
    print(text.encode(encoding, "backslashreplace").decode(encoding), flush=True)
    # Only one JSON object on stdout, whatever else is written.
    said = sys.stderr if args.json else sys.stdout
    if args.html:
        from rb_dynamics.report.html import write_html
        from rb_dynamics.report.run_page import run_report

        write_html(args.html, run_report(found.track, found.summary))
        print(f"wrote {args.html}", file=said)
    if args.video:
        from rb_dynamics.report.video import write_video

        with output.progress(f"rendering {args.video}") as progress:
            frames = write_video(args.video, found.track, progress=progress)
        print(f"wrote {args.video}: {frames} frames", file=said)
    if args.verify:
        try:
            count = verify_bag(Path(args.log))
        except LogError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        print(f"verified with the package mcap: {count} messages, their checksums, index and order", file=said)
    return 0 if found.passed else 1
