"""Write docs/scaling.md and its figure: time, memory and bytes of a run, and how they grow.

Usage: python benchmarks/scaling.py     # two minutes of computing

Processor time, which other load hardly affects; best of several repeats. Only start-up is measured in wall-clock time,
as a median. Times are for this machine. The script does not judge the figures.
"""

from __future__ import annotations

import os

# Set before numba reads it, so that plain Python is measured as such.
os.environ["RB_DYNAMICS_COMPILE"] = "never"

import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import ensemble
import numpy as np
import startup
from matplotlib import style
from matplotlib.figure import Figure
from written import processor, svg, table

from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS
from rb_dynamics.numerics.compilation import available
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.run.sink import Sink
from rb_dynamics.scene import parse_scene, read_scene
from rb_dynamics.scene.model import Scene
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.sinks.memory_sink import MemorySink
from rb_dynamics.sinks.rerun_sink import RerunSink
from rb_dynamics.sinks.state_hash import HashSink

ROOT = Path(__file__).resolve().parent.parent
SCENE = """
body: {mass: 16.8, inertia: {matrix: [[0.2975, 0.0021, -0.0008], [0.0021, 0.2930, 0.0013], [-0.0008, 0.0013, 0.3104]]}}
initial: {angular_velocity_body: [0.03, 0.2, 0.03]}
wrenches: [{topic: wrench}]
"""
HELD = [("wrench", Wrench((0.1, 0.0, 0.2), (1e-4, -2e-4, 1e-4), "world"))]
REPEATS = 2
STARTS = 15
LOGS = ("none", "hash", "MCAP", "Rerun")
RATE = 100.0  # Hz of outputs where nothing else is said
GREY, DARK = "#8a949e", "#24292f"
COLORS = ("#0b6e99", "#c2571a", "#5b7f2b", "#7a4fa3", "#a8456b", "#7d6a1f")

Series = dict[str, dict[float, float]]


class Nowhere:
    """A sink that discards everything."""

    def open(self, run: object) -> None: ...

    def write(self, event: object) -> None: ...

    def close(self, result: object) -> None: ...


def sink(log: str, folder: str) -> Sink:
    to_files = {"MCAP": McapSink, "Rerun": RerunSink}
    if log in to_files:
        return to_files[log](file_of(log, folder))
    return {"hash": HashSink, "memory": MemorySink}.get(log, Nowhere)()


def file_of(log: str, folder: str) -> Path:
    return Path(folder, {"MCAP": "run.mcap", "Rerun": "run.rrd"}[log])


def best(run: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the shortest processor time (s) of several runs."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
    return min(times)


def flown(
    method: str,
    seconds: float,
    *,
    step: float | None = None,
    rate: float = 0.001,
    commands: Sequence[tuple[str, Wrench]] = (),
    sinks: Sequence[Sink] = (),
) -> int:
    """Fly the scene; return the steps."""
    solver = {"solver.step": step} if step else {"solver.accuracy": 1e-9}
    keys = {"solver.method": method, **solver, "duration": seconds, "output_rate": rate}
    return simulate(parse_scene(SCENE, overrides=keys), commands, sinks).steps


def step_times(count: int = 300) -> dict[str, tuple[float, float]]:
    """Return the time (s) for a step of 1 ms, without outputs and with a sample of each step."""
    found = {}
    for name, method in METHODS.own.items():
        # A closed form takes free motion only.
        held = HELD if method.order else []

        def fly(rate: float, name: str = name, held: Sequence[tuple[str, Wrench]] = held) -> None:
            flown(name, count / 1000, step=1e-3, rate=rate, commands=held, sinks=[Nowhere()])

        found[name] = best(lambda fly=fly: fly(0.001), 5) / count, best(lambda fly=fly: fly(1e3)) / count
    return found


def duration_times() -> Series:
    """Return the time (s) of a run over the simulated time (s)."""
    found: Series = {
        "exact, free": {t: best(lambda t=t: flown("exact", t)) for t in (1.0, 10.0, 1e2, 1e3, 1e4, 1e5, 1e6)},
        "rkmk4, 10 ms": {
            t: best(lambda t=t: flown("rkmk4", t, step=0.01, commands=HELD)) for t in (1.0, 10.0, 1e2, 3e2)
        },
        "auto, 1e-9 rad": {t: best(lambda t=t: flown("auto", t, commands=HELD)) for t in (1.0, 10.0, 1e2, 1e3)},
    }
    if available():
        os.environ["RB_DYNAMICS_COMPILE"] = "always"
        flown("rkmk4", 1.0, step=0.01, commands=HELD)
        found["rkmk4, 10 ms, compiled"] = {
            t: best(lambda t=t: flown("rkmk4", t, step=0.01, commands=HELD)) for t in (1.0, 10.0, 1e2, 1e3, 1e4, 1e5)
        }
        os.environ["RB_DYNAMICS_COMPILE"] = "never"
    return found


def body_times() -> Series:
    """Return the time (ns) of a step and body over the number of bodies that move at once, compiled."""
    if not available():
        return {}
    os.environ["RB_DYNAMICS_COMPILE"] = "always"
    found: Series = {}
    for name in ("rk4", "dlm2", "dop853"):
        for threads in (1, 2):
            label = f"{name}, {threads} thread{'s' if threads > 1 else ''}"
            found[label] = {float(n): ensemble.many(name, n, threads, max(10, 100_000 // n)) for n in ensemble.BODIES}
    os.environ["RB_DYNAMICS_COMPILE"] = "never"
    return found


def streamed(count: int, seconds: int) -> Iterator[tuple[str, Wrench]]:
    for k in range(count):
        yield "wrench", Wrench((0.1, 0.0, 0.2), (1e-4, -2e-4 * (k % 3), 1e-4), "world", k * seconds * 10**9 // count)


def command_times() -> Series:
    """Return the time (s) of commands in 100 s without that of the steps, over their number."""
    # Every command falls on a step, so that a run without commands takes the same steps.
    steps = {n: max(n, 1000) for n in (100, 1000, 10_000, 30_000)}
    found = {}
    for n, count in steps.items():
        many, step = list(streamed(n, 100)), 100 / count
        driven, alone = (
            best(lambda step=step, given=given: flown("euler", 100.0, step=step, commands=given))
            for given in (many, many[:1])
        )
        found[float(n)] = driven - alone
    return {"held wrenches": found}


def output_times() -> tuple[Series, Series]:
    """Return the time (s) and the bytes of a log over the number of outputs of 10 s of free motion."""
    times: Series = {log: {} for log in LOGS}
    sizes: Series = {log: {} for log in LOGS if log in ("MCAP", "Rerun")}
    with tempfile.TemporaryDirectory() as folder:
        for log in LOGS:
            for rate in (1.0, 10.0, 100.0, 1000.0, 2000.0):
                run = best(lambda log=log, rate=rate: flown("exact", 10.0, rate=rate, sinks=[sink(log, folder)]), 2)
                times[log][10 * rate] = run
                if log in sizes:
                    sizes[log][10 * rate] = float(file_of(log, folder).stat().st_size)
    return times, sizes


DENSE = {
    "a tumble": ("dzhanibekov", 300.0, "dop853"),
    "the same, taylor": ("dzhanibekov", 300.0, "taylor"),
    "drag": ("linear_drag", 300.0, "dop853"),
    "gravity": ("central_gravity", 3.0, "dop853"),
}
"""Scenes with many outputs in each step: the file, outputs per second, and the method."""


def dense_times() -> dict[str, list[float]]:
    """Return the time (s) of the step to an output, and of the output in memory and in MCAP, in plain Python last."""
    found: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (file, rate, method) in DENSE.items():
            found[name] = []
            for when, some, logs in (("always", rate, ("memory", "MCAP")), ("never", rate / 10, ("memory",))):
                os.environ["RB_DYNAMICS_COMPILE"] = when
                keys = {"solver": {"method": method, "accuracy": 1e-9}}
                for log in ("steps", *logs):
                    points: dict[float, float] = {}
                    for each in (some / 10, some):
                        scene = read_scene(ROOT / "config" / f"{file}.yaml", {**keys, "output_rate": each})

                        def fly(log: str = log, scene: Scene = scene) -> None:
                            if log == "steps":
                                look(scene)
                            else:
                                simulate(scene, sinks=[sink(log, folder)])

                        fly()
                        points[scene.duration * each] = best(fly, 3)
                    found[name].append(slope(points))
    os.environ["RB_DYNAMICS_COMPILE"] = "never"
    return found


def look(scene: Scene) -> None:
    """Compute the motion at the times of the outputs, without momenta and energies."""
    run, period_ns = Simulation(replace(scene, output_rate=1e-6)), round(1e9 / scene.output_rate)
    times_ns = np.arange(period_ns, round(scene.duration * 1e9), period_ns)
    first = 0
    while first < len(times_ns):
        first += len(run.phases(times_ns[first : first + 1000]))


def peak(log: str, seconds: str) -> None:
    """Print the peak of memory (MB) of a run in this process."""
    with tempfile.TemporaryDirectory() as folder:
        flown("exact", float(seconds), rate=RATE, sinks=[sink(log, folder)])
    # Not ru_maxrss, which begins with that of the parent.
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    print(int(status.partition("VmHWM:")[2].split()[0]) / 1024)


def peaks() -> Series:
    """Return the peak of memory (MB) over the simulated time (s), each in a process of its own."""
    found: Series = {}
    for log in ("none", "MCAP", "Rerun"):
        found[log] = {}
        for seconds in (1, 10, 100, 500):
            command = [sys.executable, __file__, "--peak", log, str(seconds)]
            result = subprocess.run(command, capture_output=True, text=True, check=True)
            found[log][float(seconds)] = float(result.stdout.split()[-1])
    return found


def slope(points: dict[float, float]) -> float:
    """Return the cost of one more, from the last two points."""
    (a, low), (b, high) = list(points.items())[-2:]
    return (high - low) / (b - a)


# The page -------------------------------------------------------------------------------------------------------------


def across(title: str, series: Series, unit: Callable[[float], str]) -> str:
    """Return a table with a row for each line."""
    places = sorted({x for points in series.values() for x in points})
    rows = [[name, *(unit(points[x]) if x in points else "" for x in places)] for name, points in series.items()]
    return table([title, *(f"{x:g}" for x in places)], rows)


def seconds(value: float) -> str:
    return f"{value * 1e6:.0f} us" if value < 1e-3 else f"{value * 1e3:.3g} ms" if value < 1.0 else f"{value:.3g} s"


def plot(figure: Figure, place: int, title: str, series: Series, across_: str, up: str, log: str = "both") -> None:
    axes = figure.add_subplot(3, 2, place)
    for color, (name, points) in zip(COLORS, series.items(), strict=False):
        axes.plot(list(points), list(points.values()), "o-", color=color, linewidth=1.2, markersize=3.5, label=name)
    axes.set(xscale="log", yscale="log" if log == "both" else "linear", xlabel=across_, ylabel=up)
    if log == "x":
        axes.set_ylim(bottom=0.0)
    axes.set_title(title, color=DARK)
    axes.grid(color=GREY, alpha=0.25, linewidth=0.5)
    if len(series) > 1:
        # Below, where it crosses no curve.
        axes.legend(fontsize=7, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)


TEXT = """# What a run costs, and how the cost grows

Written by `python benchmarks/scaling.py` (`make scaling`) on {machine}. Times are the best processor time of {repeats}
runs; other work on the same cores can make them up to twice as long.

![Time against duration, bodies, commands and outputs; peak memory against duration](images/scaling.svg)

## Starting

Wall time of a process: medians over several turns of all commands, with cached byte code
(`python benchmarks/startup.py`).

{starting}
`simulate config/slew.yaml` includes its 6000 steps of rkmk4.

## A step in plain Python

The time of a step of 1 ms without numba, and how much of a core it leaves free at 1 kHz in real time: for the step
alone, and with a sample (state, momenta, energy, defects) after each step. A constant wrench acts, except with `exact`,
which is for free motion.

{steps}
{bar}

## Duration

Time of a run against its simulated time, without outputs. A closed form takes the same time for any duration; a method
with steps takes the same time for each step. `auto` bounds the error at the end of the run, so a longer run also needs
more accurate steps.

{durations}
## Bodies

Nanoseconds for one step of one body against the number of bodies in an `Ensemble`, compiled. rk4 and dlm2 compute
several bodies at once in the vector units, dop853 one after the other. Processor time for one thread, wall time for
two.

{bodies}
## Commands

The extra time that held wrenches take, against their number in 100 s. Each command ends a step, makes the method
recompute what it needs for the new load, and is added to the hash of the inputs. From the difference of the last two
columns, each further command costs {command}.

{commands}
Commands from a bag or another iterator are read during the run, at most 1000 ahead of it. A bag is read twice and not
kept in memory, except for commands that were stamped out of order.

## Outputs and logs

Time for 10 s of free motion against the number of outputs, for each kind of log:

{outputs}
From the difference of the last two columns, each further output costs:

{each}
In MCAP an output is 9 messages, compressed with zstd if that is installed. A Rerun recording keeps at most about 200
000 samples of a run, evenly thinned, so its size is bounded.

An output between two steps is reached by a step of its own from the last one, which is then discarded: it is as
accurate as the motion, and looking changes nothing. The Taylor method expands the motion once for all outputs within a
step. Where no kernel is compiled, rk4, dverk and dop853 reach 64 outputs or more at once, by one step on numpy arrays.
Neither changes a bit. By an accuracy of 1e-9, with dop853 unless the table says taylor, such an output costs:

{dense}
A continuous extension of dop853 would replace the step by a polynomial of order 7, from three more evaluations in each
step of the run. The step is the most that it could save: at most a sixth of an output in a log. It would also need a
second state at each output at which a command arrives, because motion that went on from the polynomial would not have
the accuracy of the method. Therefore there is none.

## Memory

Peak of the resident memory in MB against the simulated time, at {rate:g} outputs per second, interpreter and libraries
included:

{memory}
A run keeps neither its outputs nor past commands, except for the reasons why commands were rejected. The MCAP writer
holds a chunk (256 KiB) and, for each chunk written, some 300 bytes for the index at the end. The Rerun writer holds a
batch of 4096 samples, paths of at most 16 384 points and an index entry for each chunk: 200 000 outputs took 138 MB,
and 2 million, thinned as they come, 136 MB. A `MemorySink` keeps everything; that is its purpose.
`test/run/test_memory_growth.py` checks these statements.
"""


def page() -> tuple[str, Figure]:
    starts, steps = startup.medians(STARTS), step_times()
    durations, commands, (outputs, sizes), memory = duration_times(), command_times(), output_times(), peaks()
    bodies = body_times()
    within = [name for name, (alone, _) in steps.items() if alone <= 200e-6]
    beyond = [name for name in steps if name not in within]
    bar = f"At 1 kHz {len(within)} of {len(steps)} methods leave at least 80 % of a core" + (
        f"; those that do not: {', '.join(beyond)}." if beyond else "."
    )
    packages = ("numpy", "scipy", "mcap", "rerun-sdk", "numba")
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in packages if name != "numba" or available())
    system = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    text = TEXT.format(
        machine=f"{system}, {os.cpu_count()} x {processor()}, {versions}",
        repeats=REPEATS,
        starting=table(
            ["command", "time", "relative to import numpy"],
            [[f"`{n}`", seconds(t), f"{t / starts[startup.YARDSTICK]:.2f}"] for n, t in starts.items()],
        ),
        steps=table(
            ["method", "step", "left of a core", "step and sample", "left of a core"],
            [
                [name, *(cell for t in both for cell in (f"{t * 1e6:.0f} us", f"{100 * (1 - t / 1e-3):.0f} %"))]
                for name, both in steps.items()
            ],
        ),
        bar=bar,
        durations=across("simulated time, s", durations, seconds),
        bodies=across("bodies", bodies, lambda value: f"{value:.0f}") if bodies else "numba is not installed.\n",
        command=seconds(slope(commands["held wrenches"])),
        commands=across("commands", commands, seconds),
        outputs=across("outputs", outputs, seconds),
        each=table(
            ["log", "time", "bytes"],
            [[n, seconds(slope(t)), f"{slope(sizes[n]):.0f}" if n in sizes else ""] for n, t in outputs.items()],
        ),
        dense=table(
            ["scene", "step", "in memory", "in MCAP", "step, plain Python", "in memory, plain Python"],
            [[name, *(f"{t * 1e6:.3g} us" for t in times)] for name, times in dense_times().items()],
        ),
        rate=RATE,
        memory=across("simulated time, s", memory, lambda value: f"{value:.0f}"),
    )
    figure = Figure(figsize=(8.4, 9.4), layout="constrained")
    plot(figure, 1, "Duration", durations, "simulated time, s", "time, s")
    plot(figure, 2, "Commands", commands, "held wrenches in 100 s", "time beside the steps, s")
    plot(figure, 3, "Outputs, by log", outputs, "outputs of 10 s", "time, s")
    plot(figure, 4, "Memory, 100 outputs per second", memory, "simulated time, s", "peak resident size, MB", "x")
    plot(figure, 5, "Bodies at once", bodies, "bodies", "time of a step and body, ns")
    return text, figure


def main() -> None:
    with style.context(["default", {"font.size": 9.0}]):
        text, figure = page()
        (ROOT / "docs" / "images" / "scaling.svg").write_bytes(svg("scaling", figure))
    (ROOT / "docs" / "scaling.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--peak"]:
        peak(*sys.argv[2:])
    else:
        main()
