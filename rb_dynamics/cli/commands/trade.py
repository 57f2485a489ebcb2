"""Measure speed and accuracy of all methods that can run a scene, and recommend one.

Speed includes all outputs of the scene, as with a log; the column "end alone" is without them. Every method is refined
from coarse settings to fine ones, in turns, for --time seconds altogether. Errors are those at the end of the run,
relative to a reference on which two methods of different families agree; the first lines say how well. If there is no
time for the whole scene, a part of it is measured; the recommended row is then run to the end of the scene, for a third
of --time at most, and its error is the one there, or, without time for that, extrapolated with the square of time.

Steps are compiled if a run of the whole scene with the same setting would compile them. Compiling takes place once per
method, is announced, is part of no time in the table, and comes on top of --time, for as long again at most.

The table shows the runs that no other run beats in both speed and accuracy, and the line to write in the scene; --json
and --html have all runs. If there is no time for all settings on the way to --target, some are skipped by the order
that the errors show. Without --wrench the channels are tried with a probe.

Exit code 1: no row meets the target or budget.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
import textwrap
from typing import TYPE_CHECKING

from rb_dynamics.cli.scene_arguments import add_scene, add_wrench, listed, read_with_commands
from rb_dynamics.numerics.command_line_numbers import real

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rb_dynamics.study.trade import Trade

HELP = "measure speed and accuracy of all methods on a scene, and recommend one"

_POSITIVE = real("a finite number greater than 0", lambda v: v > 0.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `trade`."""
    add_scene(parser)
    add_wrench(parser)
    wish = parser.add_mutually_exclusive_group()
    wish.add_argument(
        "--target", type=_POSITIVE, metavar="E",
        help="find the fastest with at most this error, in rad and relative to the path; default: the scene's accuracy",
    )  # fmt: skip
    wish.add_argument(
        "--budget", type=_POSITIVE, metavar="X", help="find the most accurate that runs at X times real time or faster"
    )
    parser.add_argument(
        "--methods", type=lambda text: text.split(","), metavar="M,...",
        help="measure only these methods, such as rk4,dverk; the reference is the same",
    )  # fmt: skip
    parser.add_argument(
        "--time", type=_POSITIVE, default=30.0, metavar="S", help="how long to measure, in s; default: %(default)g"
    )
    parser.add_argument("--html", metavar="F", help="write a page with the plot and all runs (extra: plot)")
    parser.add_argument("--json", action="store_true", help="print one JSON object, floats in full")


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 0, or 1 if nothing can be recommended."""
    from rb_dynamics.cli import output
    from rb_dynamics.study.trade import trade

    scene, commands = read_with_commands(args)
    output.prepare([args.html], args.scene, *args.wrench)
    with output.progress(args.scene) as progress:
        found = trade(
            scene,
            listed(commands),
            target=args.target,
            budget=args.budget,
            time_s=args.time,
            methods=args.methods,
            progress=progress,
            compiling=_note_once("compiling kernels: some seconds each, once, on top of --time"),
        )
    output.show(args, found.as_dict, lambda: as_text(found))
    if args.html:
        from rb_dynamics.report.trade_page import trade_report

        output.write_page(args, trade_report(found))
    if found.recommended is None:
        print(f"rb-dynamics: {found.shortfall}", file=sys.stderr)
        return 1
    return 0


def _note_once(text: str) -> Callable[[str], None]:
    """Return a function that announces compiling on stderr when it is first called."""
    from rb_dynamics.cli.output import note

    said: list[str] = []

    def say(kernel: str) -> None:
        if not said:
            note(text)
        said.append(kernel)

    return say


def as_text(found: Trade) -> str:
    """Return reference, front and recommendation as text."""
    trust, measured = found.reference, {row.method for row in found.rows}
    more = "" if found.enough_s is None else f"; about --time {found.enough_s:g} would do"
    lines = [
        f"reference   {trust.method}, over {found.trial_s:g} s and a path of {trust.path:.4g} m",
        f"trust       {trust.attitude:.1e} rad, {trust.rate:.1e} rad/s, {trust.position:.1e} m, from {trust.check}",
    ]
    if found.front:
        lines.append(f"front       of {len(found.rows)} runs of {found.measured}, from fast to accurate")
        lines += _table(found)
    if compiled := sum(row.compiled for row in found.rows):
        lines.append(f"compiled    {compiled} of {len(found.rows)} runs, as they would be over the whole scene")
    if found.kernels:
        took, count = math.fsum(found.kernels.values()), len(found.kernels)
        lines.append(f"kernels     {count} compiled or loaded in {took:.3g} s, not included in the times above")
    lines += _left_out({method: why for method, why in found.ended.items() if method not in measured})
    lines += [f"note        {remark}" for remark in found.remarks]
    if found.recommended is not None:
        row, whole = found.recommended.row, found.recommended.whole
        speed = f"{row.real_time_factor:.3g} times real time with all outputs, {row.bare_real_time_factor:.3g} without"
        least = "<=" if row.within_trust else ""
        error, end = f"{least}{row.error:.1e}", []
        if not whole.measured:
            error += f" after {found.trial_s:g} s of {found.whole:g} s"
            grown = f"{least}{whole.error:.1e} at the end if it grows with the square of time: not measured"
            end = [f"            {grown}{more}"]
        elif found.trial_s < found.whole:
            error = f"{whole.error:.1e} after all {found.whole:g} s"
        lines += [
            f"take        {found.recommended.solver}",
            f"            {found.recommended.reason}",
            f"            error {error}, {speed}",
            *end,
            *(f"            {line}" for doubt in found.doubts for line in textwrap.wrap(doubt, 108)),
        ]
    return "\n".join(lines)


def _left_out(ended: Mapping[str, str]) -> list[str]:
    """Return a line for each reason, shortened; --html has the full text."""
    methods: dict[str, list[str]] = {}
    for method, why in ended.items():
        found = why.removeprefix("refused: ").removeprefix(f"{method}: ")
        methods.setdefault(re.split(r", expected|; ", found)[0], []).append(method)
    return [f"left out    {', '.join(names)}: {why}" for why, names in methods.items()]


def _table(found: Trade) -> list[str]:
    names = ("attitude", "rate", "position", "energy", "ang.mom.", "lin.mom.", "as run", "end alone", "steps", "evals")
    units = ("rad", "rad/s", "m", "J", "kg m2/s", "kg m/s", "x real", "x real", "", "")
    lines = [_line("method", "setting", names), _line("", "", units)]
    for row in found.front:
        defects = (row.energy_defect, row.angular_momentum_defect, row.linear_momentum_defect)
        cells = [*found.reference.errors(row), *(f"{abs(defect):.1e}" for defect in defects)]
        cells += [f"{row.real_time_factor:.3g}", f"{row.bare_real_time_factor:.3g}", f"{row.steps}"]
        cells.append("-" if row.evaluations is None else f"{row.evaluations}")
        lines.append(_line(row.method, row.setting, cells))
    return lines


_WIDTHS = (10, 10, 10, 9, 9, 9, 9, 10, 8, 9)


def _line(method: str, setting: str, cells: Sequence[str]) -> str:
    numbers = "".join(f"{cell:>{width}}" for cell, width in zip(cells, _WIDTHS, strict=True))
    return f"  {method:10}{setting:15}{numbers}".rstrip()
