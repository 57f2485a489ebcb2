"""Run a log again from its own content and compare all that it says of the run, every number to the last bit.

Scene, initial state and commands come from the log alone. On the version and platform that wrote it the bits are the
same; elsewhere, as the log says, the largest difference is shown and held against --bound. With --into ros the log is
not run again: its messages are published, with their stamps, at the pace of the run; --ros-args remaps them.

Exit codes: 0 the same bits, or on another version or platform within --bound; 1 different; 2 the log cannot be read.
"""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, Any

from rb_dynamics.cli.parser import add_many, require_ros, require_with
from rb_dynamics.numerics.command_line_numbers import real

if TYPE_CHECKING:
    from rb_dynamics.cli.many_logs import Row
    from rb_dynamics.study.replay import Replay

HELP = "run a log again and compare bit for bit, or publish it"

_NUMBER = real("a number, 0 or more", lambda v: v >= 0.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `replay`."""
    add_many(parser, "log of a run: a file, or a rosbag2 folder")
    parser.add_argument(
        "--json", action="store_true", help="print the result as one JSON object, of several logs a list"
    )
    parser.add_argument("--html", metavar="F", help="write a page with a line for each log (extra: plot)")
    parser.add_argument(
        "--bound", type=_NUMBER, default=1e-9, metavar="REL",
        help="largest relative difference accepted on another version or platform (default 1e-9)",
    )  # fmt: skip
    parser.add_argument("--into", choices=["ros"], help="publish the log's topics instead (extra: ros)")
    parser.add_argument(
        "--rate",
        type=_NUMBER,
        metavar="R",
        help="with --into ros: multiple of real time (default 1); 0: as fast as possible",
    )
    parser.add_argument("--clock", action="store_true", help="with --into ros: publish /clock")


def run(args: argparse.Namespace) -> int:
    """Replay; exit code 0, or 1 if the log and the replay differ."""
    import json
    from functools import partial

    from rb_dynamics.cli import output
    from rb_dynamics.cli.many_logs import logs_of, report
    from rb_dynamics.formats.output_file import require_other

    require_with(args, "--rate", args.rate is not None, "--into ros", args.into)
    require_with(args, "--clock", args.clock, "--into ros", args.into)
    logs = logs_of(args.log)
    if args.into == "ros":
        if logs is not None:
            args.parser.error(f"found {len(logs)} logs with --into ros, expected one; publish them one after the other")
        return _publish(args)
    if args.html:
        require_other(args.html, *(logs or args.log))
    if logs is not None or args.html:
        return report(args, logs or args.log, partial(_row, bound=args.bound), _COLUMNS, "Replayed logs")
    from rb_dynamics.study.replay import replay

    (log,) = args.log
    with output.progress(log) as progress:
        found = replay(log, progress)
    print(json.dumps(_facts_of(log, found, args.bound)) if args.json else "\n".join(_report(found, args.bound)))
    return 0 if found.identical or found.within(args.bound) else 1


_COLUMNS = ("samples", "commands", "relative")


def _row(log: str, *, bound: float) -> Row:
    """Return the result for one of several logs."""
    from rb_dynamics.cli.many_logs import FAILED, PASSED, Row
    from rb_dynamics.study.replay import replay

    found = replay(log)
    facts = _facts_of(log, found, bound)
    cells = (str(found.samples), str(found.commands), f"{found.relative:.2g}")
    return Row(
        log, PASSED if facts["passed"] else FAILED, facts["verdict"], facts, dict(zip(_COLUMNS, cells, strict=True))
    )


def _facts_of(log: str, found: Replay, bound: float) -> dict[str, Any]:
    """Return a replay for JSON; what is infinite is None."""
    first = found.first
    lines = _report(found, bound)
    return {
        "path": log,
        "passed": found.identical or found.within(bound),
        "identical": found.identical,
        "within_bound": found.identical or found.within(bound),
        "relative": found.relative if math.isfinite(found.relative) else None,
        "samples": found.samples,
        "commands": found.commands,
        "complete": found.complete,
        "first_difference_s": None if first is None else first[0] / 1e9,
        "first_difference_topic": None if first is None else first[1],
        "differing_facts": found.differing,
        "missing": found.missing,
        "software": {name: list(pair) for name, pair in found.software.items()},
        "verdict": lines[-1],
        "report": lines,
    }


def _publish(args: argparse.Namespace) -> int:
    require_ros("replay --into ros")
    from rb_dynamics.ros.log_publisher import publish

    (log,) = args.log
    count = publish(log, 1.0 if args.rate is None else args.rate, args.clock, args.ros_args)
    print(f"published {count} messages of {log}")
    return 0


def _report(found: Replay, bound: float) -> list[str]:
    """Return the result of a replay as text."""
    lines = [f"replayed {found.samples} samples under {found.commands} commands; times are simulation time"]
    if not found.complete:
        lines.append("the log was cut off; the part that exists is compared")
    if found.software:
        lines.append("as the log says, it was made by another version or on another platform:")
    lines += [f"  {name} was {was or 'none'}, here {here or 'none'}" for name, (was, here) in found.software.items()]
    if found.other_code and "version.rb_dynamics" not in found.software:
        lines.append("  the version is the same but the code is not: one of the two was changed")
    lines += [*_differences(found), *found.missing, *found.torn]
    lines += [f"{topic}: {count} {what}: not compared" for (topic, what), count in found.uncompared.items()]
    lines += _facts(found)
    if found.unchecked:
        lines.append(f"not checked, because a replay does not reproduce them: {', '.join(sorted(found.unchecked))}")
    if found.proven_ns is not None and not (found.complete or found.identical):
        lines.append(f"the hash of the states proves the log up to {found.proven_ns / 1e9:.9f} s")
    if found.software and found.corrupt:
        lines.append(f"another version or platform does not explain it: {', '.join(found.corrupt)}")
    if found.gap_ns is not None:
        gap = f"{found.gap_ns / 1e9:.9f} s"
        before = "NOT the same bits" if found.first is not None else "the same bits"
        return [*lines, f"commands are missing from {gap} on: {before} up to {gap}, nothing can be said after"]
    return [*lines, *_verdict(found, bound)]


def _differences(found: Replay) -> list[str]:
    if found.first is None:
        return []
    time_ns, topic = found.first
    return [
        f"first difference at {time_ns / 1e9:.9f} s, on {topic}; largest of each topic:",
        *(
            f"  {name:24} {each.largest:<12.3g} at {each.largest_ns / 1e9:.9f} s, relative {each.relative:.3g}"
            for name, each in found.differences.items()
        ),
    ]


def _facts(found: Replay) -> list[str]:
    """Return what the metadata of the log say against what the replay found; hashes in full."""
    from rb_dynamics.numerics.argument_checks import shown

    lines = [
        f"{name}: {logged} agrees" if logged == here else f"{name}: {shown(logged)} in the log, {shown(here)} here"
        for name, (logged, here) in found.facts.items()
        if logged != here or name.endswith("sha256")
    ]
    agreeing = [
        name
        for name, (logged, here) in found.facts.items()
        if logged == here and not name.endswith(("sha256", ".QoS", ".schema"))
    ]
    return [*lines, f"agree: {', '.join(agreeing)}, QoS and schemas"] if agreeing else lines


def _verdict(found: Replay, bound: float) -> list[str]:
    from rb_dynamics.formats.log_metadata import RESULT

    if found.identical:
        if found.complete:
            return ["the same to the last bit"]
        if f"{RESULT}.states_sha256" in found.facts:
            return ["what is left is the same to the last bit, and the hash at its end proves it"]
        proven = "no hash proves it" if found.proven_ns is None else f"proven only up to {found.proven_ns / 1e9:.9f} s"
        return [f"what is left is the same to the last bit, but {proven}"]
    if not found.software:
        return ["NOT the same bits"]
    if not found.within(bound):
        more = f": {found.relative:.2g}; accept more with --bound if the motion amplifies rounding errors"
        return ["NOT the same bits", f"NOT within {bound:g}{more if found.within(found.relative) else ''}"]
    if not found.differences:
        return [
            f"every number is the same to the last bit, but NOT {', '.join(found.differing)}",
            "another version may write that differently; not proven: which version made the log (only the log says so)",
        ]
    return [
        f"NOT the same bits, but every number is within {found.relative:.2g} of the largest of its kind",
        f"within {bound:g}, as another version or platform may round or step differently (CHANGELOG.rst)",
        "not proven: digits below that, and which version and platform made the log (only the log says so)",
    ]
