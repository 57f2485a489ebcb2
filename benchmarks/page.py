"""Write docs/benchmarks.md and its pictures from the results of `compare.py`."""

from __future__ import annotations

import math
import os
import platform
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from found import Row, StepRow
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation
from peers.c import COMMON, FLAGS
from written import processor, svg, table, wrapped

if TYPE_CHECKING:
    from peers.problem import Problem

DOCS = Path(__file__).resolve().parents[1] / "docs"
PICTURES = DOCS / "benchmarks"
GREY, DARK = "#8a949e", "#24292f"

# Ours in cold colours, one for each way; the others in warm ones and grey, one for each peer, in all pictures the same.
OURS = (
    *(("#0b3d91", "o"), ("#00a0c6", "s"), ("#12916a", "D")),
    *(("#6a4cd6", "^"), ("#3b86d1", "v"), ("#4d7c8a", "*")),
)
THEIRS = {
    "scipy": ("#e07b00", "P"),
    "Basilisk": ("#9a7d0a", "X"),
    "MuJoCo": ("#c2185b", "<"),
    "Drake": ("#8d6e63", "p"),
    "Pinocchio": ("#e58fb1", ">"),
    "heyoka": ("#e02020", "H"),
    "diffrax": ("#f5b301", "8"),
    "C RK4": ("#5f6770", "d"),
}
DASHES = ("-", "--", ":", "-.")

STEPS = "One step of rk4"
SIMULATE = (
    "- `simulate`, the usual way to start, handles channels, frames, timeouts and logs. For that a short run makes 350 "
    "to 700 calls in Python, which take 0.1 to 0.2 ms; heyoka is given numbers that are ready for it. Under ten "
    "thousand pairs of commands the kernel takes half of the time, half of what heyoka takes; a third goes to checking "
    "commands and putting them in order. It takes"
)
Results = Mapping[str, tuple["Problem", Sequence[Row]]]
StepTables = Sequence[tuple["Problem", Sequence[StepRow]]]


def write(results: Results, steps: StepTables, versions: Mapping[str, str], missing: Mapping[str, str]) -> None:
    """Write the page and a picture for each problem."""
    PICTURES.mkdir(exist_ok=True)
    sections = []
    for name, (task, rows) in results.items():
        (PICTURES / f"{name}.svg").write_bytes(svg(name, figure(task, rows)))
        sections.append(section(task, rows))
    text = PAGE.format(
        machine=machine(),
        versions="\n".join(f"- {name}: {found}" for name, found in versions.items()),
        missing="".join(f"- {name}: left out, {why.splitlines()[0]}\n" for name, why in missing.items()),
        summary=summary(results, steps),
        sections="\n".join(sections),
        steps="\n".join(step_section(task, rows) for task, rows in steps),
        gcc=" ".join(("gcc", *COMMON)),
        flags=", ".join(f"{name}: `{' '.join(flags)}`" for name, flags in FLAGS.items()),
        losses=losses(results, steps),
        step_title=STEPS,
    )
    (DOCS / "benchmarks.md").write_text(wrapped(text), encoding="utf-8")


def machine() -> str:
    """Return processor, cores, system and Python; no name and no date."""
    system = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"
    return f"{processor()} ({os.cpu_count()} cores), {system}"


def seconds(value: float) -> str:
    """Return a time in a unit that suits it, to two digits."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if value >= size or unit == "us":
            return f"{float(f'{value / size:.2g}'):g} {unit}"
    return ""


def digits(value: float) -> str:
    """Return a number to two digits."""
    return (
        f"{float(f'{value:.2g}'):,g}"
        if 0.01 <= value < 1e6
        else f"{value:.1e}".replace("e+0", "e").replace("e-0", "e-")
    )


def error(value: float) -> str:
    return f"{value:.0e}".replace("e-0", "e-") if value else "0"


def setting(row: Row) -> str:
    if row.chosen is None or not row.kind:
        return ""
    return f"{row.chosen.setting:.0f} steps" if row.kind == "steps" else f"tolerance {row.chosen.setting:.0e}"


def result(row: Row) -> list[str]:
    """Return the cells of a row: name, setting, error, time, ratio, set-up."""
    if not row.points:
        return [row.name, row.trouble.splitlines()[0], "", "", "", ""]
    shown = row.chosen or row.best
    above = "" if row.chosen else "> "
    how = setting(row) if row.chosen else "not reached"
    cells = [error(shown.error), above + seconds(row.seconds), above + digits(row.ratio), seconds(shown.setup)]
    return [row.name, how, *cells]


def section(task: Problem, rows: Sequence[Row]) -> str:
    ordered = sorted(rows, key=lambda row: (not row.points, row.chosen is None, row.seconds))
    head = ["", "setting", "error, rad", "time", "times ours", "set-up and first run"]
    return (
        f"## {task.title}\n\n{task.text} Accuracy wanted in attitude: {task.wanted:g} rad.\n\n"
        f"{table(head, map(result, ordered))}\n![{task.title}: error over time](benchmarks/{task.name}.svg)\n"
    )


def step_section(task: Problem, rows: Sequence[StepRow]) -> str:
    cells = [[r.name, f"{r.nanoseconds:.1f}", f"{r.ratio:.2f}", "yes" if r.same_bits else "no"] for r in rows]
    return f"{bodies(task).capitalize()}:\n\n{table(['', 'ns for each', 'ours / theirs', 'same bits as ours'], cells)}"


def summary(results: Results, steps: StepTables) -> str:
    """Return the goals of the project, with the results."""
    rows = []
    for task, found in results.values():
        for name, bar in task.bars.items():
            theirs = [row for row in found if row.points and row.name.startswith(name)]
            if not theirs:
                continue
            best = min(theirs, key=lambda row: (row.chosen is None, row.seconds))
            above = "" if best.chosen else "> "
            verdict = "met" if best.ratio >= bar else "**missed**"
            rows.append(
                [
                    linked(task.title),
                    f"time of {best.name} over ours",
                    f">= {bar:g}",
                    above + digits(best.ratio),
                    verdict,
                ]
            )
    for task, found in steps:
        for row in found:
            if "same rounding" in row.name:
                what = f"our time over {row.name}"
                verdict = "met" if row.ratio <= 1.3 else "**missed**"
                rows.append([f"{linked(STEPS)}, {bodies(task)}", what, "<= 1.3", f"{row.ratio:.2f}", verdict])
    return table(["scene", "ratio", "goal", "measured", "result"], rows, words=2)


def linked(title: str) -> str:
    """Return a link to the section of this title."""
    return f"[{title}](#{re.sub(r'[^a-z0-9 -]', '', title.lower()).replace(' ', '-')})"


def bodies(task: Problem) -> str:
    return "one body" if task.bodies == 1 else f"{task.bodies} bodies"


def losses(results: Results, steps: StepTables) -> str:
    """Return where a peer is faster than this package, and where `simulate` is slower than our fastest way."""
    lines, starts = [], []
    for task, found in results.values():
        faster = [(row.peer, row.way, row.ratio) for row in found if row.chosen and not row.is_ours and row.ratio < 1.0]
        lines += grouped(task.title, faster)
        start = next((row for row in found if row.is_ours and row.chosen and row.way.startswith("simulate")), None)
        if start and start.ratio > 1.0:
            others = dict.fromkeys(
                row.peer for row in found if row.chosen and not row.is_ours and row.seconds < start.seconds
            )
            than = f"; slower than {', '.join(others)}" if others else ""
            starts.append(f"    - {task.title}: {digits(start.ratio)} times as long as our fastest way{than}")
    for task, found in steps:
        theirs = ((row.name.partition("C RK4 ")[2], row.ratio) for row in found)
        faster = [("C RK4", way, 1.0 / ratio) for way, ratio in theirs if way and ratio > 1.0]
        lines += grouped(f"{STEPS}, {bodies(task)}", faster)
    if starts:
        lines += [SIMULATE, *starts]
    return "\n".join(lines)


def grouped(title: str, faster: Sequence[tuple[str, str, float]]) -> list[str]:
    """Return a line per peer with the times of its ways relative to ours."""
    lines = []
    for peer in dict.fromkeys(peer for peer, *_ in faster):
        ways = sorted((ratio, way) for found, way, ratio in faster if found == peer)
        parts = ", ".join(f"{digits(ratio)} ({way})" if way else digits(ratio) for ratio, way in ways)
        lines.append(f"- {title}: {peer} takes {parts} of our time.")
    return lines


def figure(task: Problem, rows: Sequence[Row]) -> Figure:
    """Draw error over time; our lines are thick, those of peers above them, one dash pattern for each way of a peer."""
    drawn = Figure(figsize=(9.6, 5.2), layout="constrained")
    axes = drawn.subplots()
    count: dict[str, int] = {}
    for row in rows:
        if not row.points:
            continue
        number = count[row.peer] = count.get(row.peer, -1) + 1
        points = sorted((p.seconds, min(max(p.error, 1e-16), math.pi)) for p in row.points)
        color, marker = OURS[number] if row.is_ours else THEIRS[row.peer]
        dash, width, size, order = ("-", 3.0, 8.0, 3) if row.is_ours else (DASHES[number], 1.1, 6.5, 4)
        axes.plot(*zip(*points, strict=True), dash, color=color, linewidth=width, marker=marker, markersize=size,
                  markeredgecolor="white", markeredgewidth=0.4, zorder=order, label=row.name)  # fmt: skip
    axes.axhline(task.wanted, color=DARK, linewidth=0.8, linestyle=(0, (6, 3)), label="wanted")
    axes.set(xscale="log", yscale="log", ylim=(5e-17, 10.0), xlabel="time, s", ylabel="error of the attitude, rad")
    # Between powers of ten too, where there are few of them.
    axes.xaxis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(2.0, 0.5)))
    axes.tick_params(axis="x", which="minor", labelsize=7.5)
    axes.grid(color=GREY, alpha=0.25, linewidth=0.5)
    drawn.legend(fontsize=7.5, frameon=False, loc="outside right center", handlelength=3.0)
    return drawn


PAGE = """# Benchmarks

This page compares the package with other programs on the same problems, on one machine and in one session. `make bench`
measures all figures and writes this page. What whole commands take, bag, logs and start of Python included, is on [a
page of its own](whole-runs.md). Campaigns are [with the campaigns](campaigns.md#speed), the node is [with
ROS](ros.md#rate).

- **Times** are medians over several turns in which every program runs once (A B C A B C); ratios are medians of the
  ratios within each turn. "Times ours" is the ratio to our fastest way. Times are those of the run alone. Import,
  set-up and compilation happen once; the last column shows them, together with the first run. Our kernels are compiled
  only the first time ever, and then loaded from a cache (see `benchmarks/kernels.py`).
- **Settings** of each program go from coarse to fine until its attitude has the wanted accuracy. "Not reached" means
  that none had it: the row shows the most accurate setting that takes less than 5 s, so its times and ratios are lower
  bounds.
- **Errors** are relative to the closed form, or to two of our methods that agree within a tenth of the wanted accuracy.
  The tests check both against references of 30 digits; [verification](verification.md) shows their errors. An error of
  0 means that the closed form is compared with itself; the plots show it at 1e-16.

{machine}

{versions}
{missing}
## Goals

The goals of the project are ratios of times measured in one session.

{summary}
## Where we lose

{losses}
- Compilation: without numba this package compiles nothing, and a step takes 30 to 100 us. With numba, the very first
  run of a method is in plain Python while another process compiles; later runs load the machine code in some
  milliseconds ([whole runs](whole-runs.md)). MuJoCo, Basilisk, Drake and Pinocchio are compiled programs.
- Contact, joints, connected bodies, cameras: MuJoCo, Drake, Basilisk and Pinocchio have some or all of them. This
  package has one free rigid body, with wheels, thrusters, magnetorquers and sensors.
- Accelerators: diffrax and MuJoCo (MJX, Warp) run ensembles on a GPU; this package does not.
- Derivatives: diffrax, Pinocchio and Drake differentiate any function of the motion; this package has the
  sensitivities that [identify](identify.md) and `simulate --covariance` need.
- Other equations: scipy, heyoka and diffrax integrate any equation; this package does not.

{sections}
## {step_title}

The comparison is with the same step in C (`benchmarks/reference.c`): the same operations in the same order, with work
and impulse accumulated as in ours. Both take n steps of 1 ms without returning to Python. The C code is compiled with
`{gcc}`; {flags}. Contraction and fast-math change the result. Fast-math also removes the compensation of the sums,
which keeps 1e9 additions accurate.

{steps}
## How each program is used

- All: the main loop is compiled if the program can do that (rollout of MuJoCo, jit of diffrax, compiled Taylor series
  of heyoka, simulation loop of Basilisk and Drake); no logging; contact and constraints are off.
- MuJoCo: body-frame wrenches are actuators on a site, which turn with the body within a step; world-frame forces are
  `xfrc_applied`.
- Basilisk: wrenches are set from Python once for each command. RKF78 subdivides steps of about a radian, because
  attitude parameters are switched only between two steps. The time includes a restart, some ms.
- Drake: has no wrench in body axes without a system in Python, so it is omitted from scenes with one.
- Pinocchio: has no integrator, so we use Munthe-Kaas RK4 on its own Lie group, in Python.
- heyoka: called once for each command, with the wrench as parameters; compensated (`high_accuracy`); ensembles in
  batches.
- diffrax: for commands, equal steps of Dopri8 in one `scan`; otherwise step control; double precision, CPU.
- scipy: `solve_ivp` once for each command; an ensemble is one vector.
- C: "same books" also accumulates impulse and work, as our step does; "state alone" computes only the state, as one
  would write it by hand.
"""
