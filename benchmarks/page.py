"""Write docs/benchmarks.md and its pictures from what `compare.py` measured. Never measures anything itself."""

from __future__ import annotations

import io
import math
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib import colormaps, style
from matplotlib.figure import Figure
from peers.c import COMMON, FLAGS

if TYPE_CHECKING:
    from compare import Row, StepRow
    from peers.problem import Problem

DOCS = Path(__file__).resolve().parents[1] / "docs"
PICTURES = DOCS / "benchmarks"
GREY, DARK = "#8a949e", "#24292f"

Results = Mapping[str, "tuple[Problem, Sequence[Row]]"]
StepTables = Sequence["tuple[Problem, Sequence[StepRow]]"]


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
    )
    (DOCS / "benchmarks.md").write_text(text, encoding="utf-8")


def machine() -> str:
    """Return processor, cores, system and Python; no name and no date."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    cores = os.cpu_count()
    return f"{model} ({cores} cores), {platform.system()} {platform.machine()}, Python {platform.python_version()}"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


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
        f"## {task.title}\n\n{task.text} Attitude wanted to {task.wanted:g} rad.\n\n"
        f"{table(head, map(result, ordered))}\n![{task.title}: error over time](benchmarks/{task.name}.svg)\n"
    )


def step_section(task: Problem, rows: Sequence[StepRow]) -> str:
    title = "One body" if task.bodies == 1 else f"{task.bodies} bodies"
    cells = [[r.name, f"{r.nanoseconds:.1f}", f"{r.ratio:.2f}", "yes" if r.same_bits else "no"] for r in rows]
    return f"{title}:\n\n{table(['', 'ns for each', 'ours / theirs', 'same bits as ours'], cells)}"


def summary(results: Results, steps: StepTables) -> str:
    """Return the bars that the project set itself, and what was found."""
    rows = []
    for task, found in results.values():
        for name, bar in task.bars.items():
            theirs = [row for row in found if row.points and row.name.startswith(name)]
            if not theirs:
                continue
            best = min(theirs, key=lambda row: (row.chosen is None, row.seconds))
            above = "" if best.chosen else "> "
            verdict = "met" if best.ratio >= bar else "**missed**"
            rows.append([f"{task.title}, against {best.name}", f">= {bar:g}", above + digits(best.ratio), verdict])
    for task, found in steps:
        for row in found:
            if "same rounding" in row.name:
                what = f"An rk4 step, {task.bodies} {'body' if task.bodies == 1 else 'bodies'}: time over {row.name}"
                rows.append([what, "<= 1.3", f"{row.ratio:.2f}", "met" if row.ratio <= 1.3 else "**missed**"])
    return table(["", "bar", "measured", ""], rows)


def losses(results: Results, steps: StepTables) -> str:
    """Return where somebody was faster than we are."""
    lines = []
    for task, found in results.values():
        faster = [row for row in found if row.chosen and not row.is_ours and row.ratio < 1.0]
        lines += [f"- {task.title}: {row.name} takes {digits(row.ratio)} of our time." for row in faster]
    for task, found in steps:
        for row in found:
            if row.ratio > 1.0:
                bodies = "one body" if task.bodies == 1 else f"{task.bodies} bodies"
                lines.append(f"- A step of rk4, {bodies}: we take {row.ratio:.2f} times as long as {row.name}.")
    for task, found in results.values():
        ours = [row for row in found if row.is_ours and row.chosen]
        start = next((row for row in ours if row.way.startswith("simulate")), None)
        if start and start.ratio > 1.0:
            lines.append(
                f"- {task.title}: `simulate`, where users start, takes {digits(start.ratio)} times as long as our "
                "fastest way: it knows channels, frames, timeouts and logs."
            )
    return "\n".join(lines)


def figure(task: Problem, rows: Sequence[Row]) -> Figure:
    """Draw error over time: one colour for each peer, one dash for each of its ways."""
    drawn = Figure(figsize=(8.4, 4.6), layout="constrained")
    axes = drawn.subplots()
    peers = list(dict.fromkeys(row.peer for row in rows if row.points))
    colors, dashes = dict(zip(peers, colormaps["tab10"].colors, strict=False)), ("-", "--", ":", "-.")
    count: dict[str, int] = {}
    for row in rows:
        if not row.points:
            continue
        dash = dashes[count.get(row.peer, 0) % len(dashes)]
        count[row.peer] = count.get(row.peer, 0) + 1
        points = sorted((p.seconds, min(max(p.error, 1e-16), math.pi)) for p in row.points)
        marker, width = ("o", 1.8) if row.is_ours else (".", 1.0)
        axes.plot(*zip(*points, strict=True), dash, marker=marker, markersize=4, color=colors[row.peer],
                  linewidth=width, label=row.name)  # fmt: skip
    axes.axhline(task.wanted, color=DARK, linewidth=0.8, linestyle=(0, (6, 3)))
    axes.set(xscale="log", yscale="log", ylim=(5e-17, 10.0), xlabel="time, s", ylabel="error of the attitude, rad")
    axes.grid(color=GREY, alpha=0.25, linewidth=0.5)
    drawn.legend(fontsize=7, frameon=False, loc="outside right center")
    return drawn


def svg(name: str, drawn: Figure) -> bytes:
    buffer = io.BytesIO()
    with style.context(["default", {"svg.hashsalt": name, "svg.fonttype": "path"}]):
        drawn.savefig(buffer, format="svg", facecolor="white", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


PAGE = """# Benchmarks

What users would pick instead, given the same problems on the same machine in one run: `make bench` measures all this
and writes this page. Times are medians of runs taken in turn (A B C A B C), ratios are medians of the ratios of each
turn; "times ours" is against our fastest way. Times are those of the run alone, without what is done once: import,
set-up, compilation, which stand in the last column, with the first run (our kernels come out of their cache after the
first time; see `benchmarks/kernels.py`). Each peer goes from coarse to fine settings until its attitude is as right as
wanted; "not reached" shows its most accurate setting of those under 5 s. The reference is the closed form, or two of
our methods that agree to a tenth of what is wanted; the tests hold both to 30 digits
([verification](verification.md)). An error of 0 is that of the closed form against itself: what it is off by stands
there. Where a peer does not reach what is wanted, times and ratios are those of its best, and so lower bounds.

{machine}

{versions}
{missing}
## The bars

What the project set out to reach.

{summary}
## Where we lose

{losses}
- Compilation: without numba nothing here is compiled and a step takes some 20 us; with it the first run ever of a
  method waits some seconds, later processes half a second for the cache. MuJoCo, Basilisk, Drake and Pinocchio come
  compiled.
- Contact, joints, several bodies that touch or hang together, sensors, optics, environments: MuJoCo, Drake, Basilisk
  and Pinocchio have them. Here is one free rigid body.
- Accelerators: diffrax and MuJoCo (MJX, Warp) run ensembles on a GPU; nothing here does.
- Derivatives: diffrax, Pinocchio and Drake differentiate through the motion.
- Any other equation: scipy, heyoka and diffrax integrate what one writes down.

{sections}
## One step of rk4

The same step in C (`benchmarks/reference.c`), with the same books of work and impulse and the same operations in the
same order, n steps of 1 ms without a return to Python. `{gcc}`;
{flags}. Contraction and fast-math change the result; fast-math also takes out the compensation of the sums, which is
what keeps 1e9 additions right.

{steps}
## How each peer is used

- All: principal loop compiled where the peer can (rollout of MuJoCo, jit of diffrax, compiled Taylor series of heyoka,
  simulation loop of Basilisk and Drake), no logging, contact and constraints off.
- MuJoCo: body-frame wrenches as actuators on a site, which turn with the body inside a step; world-frame forces as
  `xfrc_applied`.
- Basilisk: wrenches are set from Python once a command; RKF78 divides steps of about a radian, as attitude parameters
  are switched between two steps only. The time includes starting over, some ms.
- Drake: no wrench in body axes without a system in Python, so it is left out where there is one.
- Pinocchio: it has no integrator; Munthe-Kaas RK4 on its own Lie group, in Python.
- heyoka: called once a command, with the wrench as parameters; compensated (`high_accuracy`); ensembles in batches.
- diffrax: equal steps of Dopri8 in one `scan` over the commands, else with step control; double precision, CPU.
- scipy: `solve_ivp` once a command; an ensemble is one vector.
- C: what has "same books" does all that our step does, "state alone" what one writes by hand.
"""
