"""Identify mass properties and more from recordings, with standard errors and 95 % intervals.

A recording is a log of this package, any ROS 2 bag of pose, odometry, twist or gyro, or a .csv (--columns), with the
commands in it or in another bag (--wrench). The scene says what is known: the body to begin with, frames, channels and
effects. What the recordings cannot determine is reported and keeps the value of the scene: a flight without torque
determines only ratios of the moments, one without force no mass.

Residuals far beyond noise are named: the model then lacks something. Exit codes: 0 everything asked for is known; 1
something asked for cannot be known from these recordings, the fit does not follow them or does not converge; 2 bad
input.
"""

from __future__ import annotations

import argparse
import sys
from decimal import Decimal
from typing import TYPE_CHECKING

from rb_dynamics.cli.scene_arguments import add_scene
from rb_dynamics.cli.topic_arguments import add_topics, chosen_topics
from rb_dynamics.numerics.command_line_numbers import whole

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rb_dynamics.analysis.identification.identify import Identification

HELP = "estimate mass properties from recordings, with error bars"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `identify`."""
    add_scene(parser)
    parser.add_argument("recordings", metavar="RECORDING", nargs="+", help="log, bag or .csv; several are of one body")
    parser.add_argument(
        "--fit", metavar="NAMES",
        help="what to fit, separated by commas: mass, center_of_mass, inertia, inertia_ratios, initial, gyro_bias, "
        "gyro_scale, gyro_alignment, accelerometer, delay, wrench_scale, or numbers of an effect such as "
        "effects[0].rotation; default: the mass properties, as far as the recordings determine them",
    )  # fmt: skip
    parser.add_argument(
        "--wrench", action="append", default=[], metavar="BAG",
        help="bag with the commands, of the same clock, where the recordings have none; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--columns", action="append", default=[], metavar="QUANTITY=NAMES",
        help="columns of .csv recordings, in SI units, as in gyro=wx,wy,wz: time_s (or _ms, _us, _ns), attitude "
        "(x, y, z, w), position, velocity_world, velocity_body, rates, gyro, accelerometer, force, torque, wheels "
        "(in the order of the scene); may be repeated",
    )  # fmt: skip
    add_topics(parser)
    parser.add_argument(
        "--validate", action="append", default=[], metavar="BAG",
        help="recording to predict with the result, fitting only its initial state; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--loss", choices=("linear", "soft_l1", "huber", "cauchy"), default="linear",
        help="weighting of large residuals; all but linear (least squares) tolerate outliers",
    )  # fmt: skip
    starts = whole("a whole number of at least 1", lambda v: v >= 1)
    parser.add_argument("--starts", type=starts, default=4, metavar="N", help="starts of the fit (default 4)")
    parser.add_argument("--out", metavar="FITTED.yaml", help="write the scene with what was found")
    parser.add_argument(
        "--html", metavar="F", help="write a page: measured and fitted, residuals, ellipses of errors (extra: plot)"
    )
    parser.add_argument(
        "--advise", action="store_true", help="also say which recording would determine what is not known"
    )
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object, floats in full")


def run(args: argparse.Namespace) -> int:
    """Fit and print; exit code 0, or 1 if something asked for is not known."""
    from pathlib import Path

    from rb_dynamics.analysis.identification.identify import identify
    from rb_dynamics.cli import output, scene_arguments
    from rb_dynamics.formats.output_file import OutputFile

    output.prepare((args.out, args.html), args.scene, *args.recordings, *args.wrench, *args.validate)
    names = None if args.fit is None else [name.strip() for name in args.fit.split(",") if name.strip()]
    with output.progress(args.scene) as progress:
        found = identify(
            scene_arguments.read(args),
            args.recordings,
            names,
            commands=args.wrench,
            columns=_columns(args.columns),
            topics=chosen_topics(args),
            validate=args.validate,
            loss=args.loss,
            starts=args.starts,
            progress=progress,
        )
    output.show(args, found.as_dict, lambda: as_text(found, args.advise))
    if args.out:
        with OutputFile.whole(Path(args.out)) as file:
            file.write(found.scene.text.encode())
        print(f"wrote {args.out}{_time_0(found)}", file=output.note_of(args))
    if args.html:
        from rb_dynamics.report.identification_page import identification_report

        output.write_page(args, identification_report(found))
    for line in (*found.unexplained, *_missing(found)):
        print(f"rb-dynamics: {line}", file=sys.stderr)
    return 0 if found.passed else 1


def _time_0(found: Identification) -> str:
    """Return which stamp is time 0 of the scene, and how its commands begin there; "" if it is stamp 0."""
    if not found.zero_ns:
        return ""
    at_s = Decimal(found.zero_ns).scaleb(-9)
    told = f": its time 0 is stamp {at_s} s of {found.recordings[0]}"
    return f"{told}; fly commands of that clock with --wrench-start {at_s}"


def _columns(texts: Sequence[str]) -> dict[str, list[str]]:
    """Return the names of columns by what they hold."""
    from rb_dynamics.errors import LogError

    found: dict[str, list[str]] = {}
    for text in texts:
        quantity, _, names = (part.strip() for part in text.partition("="))
        if not (quantity and names) or quantity in found:
            told = f"{quantity} twice" if quantity in found else repr(text)
            raise LogError(f"--columns: found {told}, expected QUANTITY=NAMES once each; write it as in gyro=wx,wy,wz")
        found[quantity] = [name.strip() for name in names.split(",")]
    return found


def as_text(found: Identification, advise: bool) -> str:
    """Return the result as a table."""
    lines = [f"{'':34}{'value':>14} {'± s.e.':>11}   95 % interval"]
    for each in found.parameters:
        if each.interval is None:
            lines.append(f"{each.name:34}{'not known':>14}{'':14}({each.taken}: {each.value:.6g} {each.unit})".rstrip())
        else:
            low, high = each.interval
            lines.append(
                f"{each.name:34}{each.value:>14.7g} {each.standard_error:>11.2g}   "
                f"{low:.7g} … {high:.7g} {each.unit}".rstrip()
            )
    lines += ["", f"{'residuals':34}{'samples':>8}{'rms':>13}{'times noise':>13}"]
    for each_left in (*found.residuals, *found.validation):
        held = "" if each_left in found.residuals else " (held out)"
        white = "" if each_left.white else f"   {each_left.whiteness}"
        name = f"{each_left.topic} {each_left.kind}{held}"
        lines.append(
            f"{name:34}{each_left.count:>8}{each_left.rms:>13.4g}{each_left.times_noise:>13.3g} {each_left.unit}{white}"
        )
    lines += [
        "",
        f"{found.agreeing} of {found.starts} starts found this minimum"
        + ("" if found.converged else "; the fit did not converge"),
    ]
    lines += found.unexplained
    if found.unknown_combinations:
        lines += ["not determined by these recordings:", *(f"  {each}" for each in found.unknown_combinations)]
    if advise and found.advice:
        lines += ["what would determine it:", *(f"  {each}" for each in found.advice)]
    lines += [f"note: {note}" for note in found.notes]
    return "\n".join(lines)


def _missing(found: Identification) -> list[str]:
    """Return why the exit code is 1."""
    lacks = [each.name for each in found.parameters if each.asked and not each.known]
    lines = []
    if not found.converged:
        lines.append("the fit did not converge; give a scene closer to the body, or more --starts")
    if lacks:
        told = f"; to know {found.advice[0]}" if found.advice else ""
        lines.append(f"not known from these recordings: {', '.join(lacks)}{told}")
    elif not found.passed and found.converged and found.validated is not False:
        told = f"; to know {found.advice[0]}" if found.advice else ""
        lines.append(f"these recordings determine nothing about the body{told}")
    return lines
